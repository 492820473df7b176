"""Maps in files: what was saved is what is loaded, and what is no map is refused in one line."""

from __future__ import annotations

import json
import lzma
import struct
import zlib
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mapping.old_maps import first_version, second_version
from mapping.scenes import (
    FRAME_S,
    GRID,
    SHAPE,
    Wall,
    crowd,
    fuse,
    kept_keyframes,
    look_at,
    made_map,
    peak_bytes,
    pose,
    see,
)

from wheelsight.core.errors import MapError, OutputError
from wheelsight.mapping import SurfelMap, Surfels, SurfelSettings, load_map, save_map, storage, surfels
from wheelsight.mapping.columns import COLUMNS, columns_of, packed, unpacked


@pytest.fixture(scope="module")
def surfel_map() -> SurfelMap:
    """Of which some surfels hang on two keyframes, and others on none; no one changes it."""
    store, rng = kept_keyframes(2), np.random.default_rng(20240817)
    made = SurfelMap(SurfelSettings(active_s=7.0), store)
    walls = [Wall(2.0, slope=0.3), Wall(1.4, low=-0.1, high=0.1)]
    for k, keyframe in enumerate([None] * 4 + [0] * 4 + [1] * 4):
        T = pose(0.05 * k)
        fuse(made, see(walls, T, rng), T, k * FRAME_S, keyframe)
    return made


@pytest.fixture(scope="module")
def saved(surfel_map: SurfelMap, tmp_path_factory: pytest.TempPathFactory) -> bytes:
    """Its file."""
    path = tmp_path_factory.mktemp("saved") / "a.map"
    save_map(surfel_map, path)
    return path.read_bytes()


def test_what_was_saved_is_loaded(surfel_map, tmp_path):
    save_map(surfel_map, tmp_path / "a.map")
    loaded = load_map(tmp_path / "a.map")
    assert loaded.settings == surfel_map.settings
    np.testing.assert_array_equal(loaded.T_map_keyframe, surfel_map.T_map_keyframe)
    assert set(loaded.surfels().keyframe) == {-1, 0, 1}
    assert (loaded.stamp_s, loaded.dropped) == (surfel_map.stamp_s, surfel_map.dropped)
    # What each number comes back as: test_columns.py.
    first, second = (columns_of(m.surfels(), m.stamp_s, 10.0) for m in (surfel_map, loaded))
    for name, column in first.items():
        np.testing.assert_array_equal(column, second[name], err_msg=name)
    views = [m.predict(pose(), GRID, SHAPE).depth_m for m in (surfel_map, loaded)]
    # Surfels stay within 0.25 mm. Of noise of 6 mm another disk may now be the one before the others.
    apart_m = np.abs(views[0] - views[1])
    assert np.median(apart_m) < 0.3e-3
    assert np.mean(apart_m > 1e-3) < 0.02


def test_saving_what_was_loaded_gives_the_same_bytes(surfel_map, tmp_path):
    save_map(surfel_map, tmp_path / "a.map")
    save_map(load_map(tmp_path / "a.map"), tmp_path / "b.map")
    assert (tmp_path / "a.map").read_bytes() == (tmp_path / "b.map").read_bytes()


def test_how_much_is_turned_into_columns_at_once_changes_no_byte(surfel_map, saved, tmp_path, monkeypatch):
    monkeypatch.setattr(storage, "_COLUMNS_AT_ONCE", 1)
    monkeypatch.setattr(surfels, "_COPIED_AT_ONCE", 100)
    save_map(surfel_map, tmp_path / "a.map")
    assert (tmp_path / "a.map").read_bytes() == saved


def test_an_empty_map_has_no_parts_that_are_missed(tmp_path):
    """The least there is to concatenate: nothing."""
    made = made_map()
    assert sum(len(part.grey) for part in made.parts()) == 0
    assert list(made.parts("stable")) == list(made.parts(keyframes=(0, 9))) == []


def test_saving_takes_a_part_of_what_the_map_takes(tmp_path, monkeypatch):
    """In memory: 72 bytes a surfel are copies of them all. What does not grow with the map is taken off."""
    monkeypatch.setattr(storage, "_COLUMNS_AT_ONCE", 1000)
    monkeypatch.setattr(surfels, "_COPIED_AT_ONCE", 1000)
    small, large = crowd(5_000, keyframes=50), crowd(40_000, keyframes=400)
    peaks = [peak_bytes(partial(save_map, made, tmp_path / "a.map")) for made in (small, large)]
    assert peaks[1] - peaks[0] < 0.5 * 72 * (len(large) - len(small))
    assert len(load_map(tmp_path / "a.map")) == len(large)


def test_a_loaded_map_goes_on(surfel_map, tmp_path):
    save_map(surfel_map, tmp_path / "a.map")
    loaded = load_map(tmp_path / "a.map")
    fused = look_at(loaded, [Wall(2.0, slope=0.3)], [pose()], start_s=1.0)
    assert fused[0].matched > 8 * fused[0].added


def test_an_empty_map_is_saved_and_loaded(tmp_path):
    save_map(made_map(), tmp_path / "a.map")
    loaded = load_map(tmp_path / "a.map")
    assert len(loaded) == 0
    assert look_at(loaded, [Wall(2.0)], [pose()])[0].added > 0


def test_keyframes_without_surfels_are_saved_and_loaded(tmp_path):
    save_map(SurfelMap(store=kept_keyframes(2)), tmp_path / "a.map")
    loaded = load_map(tmp_path / "a.map")
    assert len(loaded) == 0
    np.testing.assert_array_equal(loaded.T_map_keyframe, kept_keyframes(2).T_map_keyframe)


def test_the_format_can_be_read_without_wheelsight(surfel_map, tmp_path):
    save_map(surfel_map, tmp_path / "a.map")
    name, header, body = (tmp_path / "a.map").read_bytes().split(b"\n", 2)
    assert name == b"wheelsight-map-3"
    about, numbers = json.loads(header), lzma.decompress(body)
    assert about["frame"] == "map"
    assert about["surfels"] == len(surfel_map)
    width = {name: np.dtype(dtype).itemsize for name, dtype in about["columns"]}
    begin = len(surfel_map) * sum(list(width.values())[: list(width).index("green")])
    low, high = np.frombuffer(numbers, np.uint8, 2 * len(surfel_map), begin).reshape(2, -1).astype(int)
    zigzag = low + 256 * high
    green = np.cumsum(np.where(zigzag % 2, -(zigzag + 1) // 2, zigzag // 2))
    np.testing.assert_array_equal(np.sort(green), np.sort(np.rint(surfel_map.surfels().color[:, 1])))
    np.testing.assert_array_equal(np.frombuffer(numbers, "<f8")[-16:].reshape(4, 4), surfel_map.T_map_keyframe[-1])


def test_a_surfel_takes_a_ninth_of_what_it_took(surfel_map, tmp_path):
    save_map(surfel_map, tmp_path / "a.map")
    assert (tmp_path / "a.map").stat().st_size < len(second_version(surfel_map)) / 9


def rewritten(data: bytes, change: Callable[[dict[str, Any], bytearray], None]) -> bytes:
    """With header and body changed, and the checksum made right."""
    name, header, body = data.split(b"\n", 2)
    about, numbers = json.loads(header), bytearray(body)
    change(about, numbers)
    about["crc32"] = zlib.crc32(numbers)
    return b"\n".join([name, json.dumps(about).encode(), bytes(numbers)])


def put(offset_fields: int, value: float) -> Callable[[dict[str, Any], bytearray], None]:
    """Write a number as the first surfel's in the field that begins after so many floats a surfel."""

    def change(about: dict[str, Any], numbers: bytearray) -> None:
        struct.pack_into("<f", numbers, 4 * offset_fields * about["surfels"], value)

    return change


def put_pose(entry: int, value: float) -> Callable[[dict[str, Any], bytearray], None]:
    """Write a number into the pose of the last keyframe."""
    return lambda _, numbers: struct.pack_into("<d", numbers, len(numbers) - 8 * (16 - entry), value)


def put_keyframe(value: int) -> Callable[[dict[str, Any], bytearray], None]:
    """Write the number of the keyframe that the last surfel hangs on."""

    def change(about: dict[str, Any], numbers: bytearray) -> None:
        struct.pack_into("<i", numbers, len(numbers) - 128 * about["keyframes"] - 4, value)

    return change


def test_a_setting_that_means_nothing_now_is_passed_over(surfel_map, tmp_path):
    save_map(surfel_map, tmp_path / "new.map")
    name, header, body = (tmp_path / "new.map").read_bytes().split(b"\n", 2)
    about = json.loads(header)
    about["settings"]["beyond_share"] = 0.05
    (tmp_path / "old.map").write_bytes(b"\n".join([name, json.dumps(about).encode(), body]))
    assert len(load_map(tmp_path / "old.map")) == len(surfel_map)


def test_a_file_of_the_second_version_is_the_same_map(surfel_map, tmp_path):
    (tmp_path / "old.map").write_bytes(second_version(surfel_map))
    old = load_map(tmp_path / "old.map")
    first, second = surfel_map.surfels(), old.surfels()
    orders = [np.lexsort(surfels.position.T) for surfels in (first, second)]
    for name in Surfels.__slots__:
        np.testing.assert_array_equal(getattr(first, name)[orders[0]], getattr(second, name)[orders[1]])
    np.testing.assert_array_equal(old.T_map_keyframe, surfel_map.T_map_keyframe)
    assert (old.settings, old.stamp_s, old.dropped) == (surfel_map.settings, surfel_map.stamp_s, surfel_map.dropped)


def test_a_file_of_the_first_version_is_a_map_whose_surfels_hang_on_no_keyframe(surfel_map, tmp_path):
    (tmp_path / "second.map").write_bytes(second_version(surfel_map))
    (tmp_path / "first.map").write_bytes(first_version(second_version(surfel_map)))
    new, old = (load_map(tmp_path / name) for name in ("second.map", "first.map"))
    for name in set(Surfels.__slots__) - {"keyframe"}:
        np.testing.assert_array_equal(getattr(old.surfels(), name), getattr(new.surfels(), name))
    assert (old.surfels().keyframe == -1).all()
    assert len(old.T_map_keyframe) == 0
    assert (old.settings, old.stamp_s) == (new.settings, new.stamp_s)
    save_map(old, tmp_path / "new.map")
    assert len(load_map(tmp_path / "new.map")) == len(surfel_map)


def header_entry(name: str, value: object) -> Callable[[dict[str, Any], bytearray], None]:
    return lambda about, _: about.__setitem__(name, value)


def repacked(data: bytes, change: Callable[[dict[str, np.ndarray], np.ndarray], None], more: bytes = b"") -> bytes:
    """With columns and poses changed, and lengths and checksum made right."""
    _, header, body = data.split(b"\n", 2)
    about, numbers, begin, columns = json.loads(header), lzma.decompress(body), 0, {}
    for column, dtype in COLUMNS:
        length = about["surfels"] * np.dtype(dtype).itemsize
        columns[column] = unpacked(numbers[begin : begin + length], dtype).copy()
        begin += length
    poses = np.frombuffer(numbers, "<f8", offset=begin).copy()
    change(columns, poses)
    return compressed(data, b"".join([*(packed(column) for column in columns.values()), poses.tobytes(), more]))


def compressed(data: bytes, numbers: bytes) -> bytes:
    """A file with these numbers in place of its own."""
    name, header, _ = data.split(b"\n", 2)
    about, body = json.loads(header), lzma.compress(numbers)
    about |= {"bytes": len(body), "crc32": zlib.crc32(body)}
    return b"\n".join([name, json.dumps(about).encode(), body])


def entry(name: str, value: int) -> Callable[[bytes], bytes]:
    """Of a column's first surfel."""
    return lambda data: repacked(data, lambda columns, _: columns[name].__setitem__(0, value))


def pose_entry(at: int, value: float) -> Callable[[bytes], bytes]:
    """Of the last keyframe's pose."""
    return lambda data: repacked(data, lambda _, poses: poses.__setitem__(at - 16, value))


@pytest.mark.parametrize(
    ("damage", "word"),
    [
        (lambda data: b"", "is no map"),
        (lambda data: b"ply\n" + data, "is no map"),
        (lambda data: data.replace(b"map-3", b"map-4", 1), "version"),
        (lambda data: data[:10], "is no map|version"),
        (lambda data: data[:60], "header"),
        (lambda data: data[:-1], "bytes of surfels"),
        (lambda data: data + b"\0", "bytes of surfels"),
        (lambda data: data[:-5000], "bytes of surfels"),
        (lambda data: data[:-9] + bytes([data[-9] ^ 1]) + data[-8:], "checksum"),
        (lambda data: data.replace(b'{"frame"', b'["frame"', 1), "header"),
        (lambda data: b"wheelsight-map-3\n[]\n", "header"),
        (lambda data: b"wheelsight-map-3\n{}\n", "header"),
        (lambda data: rewritten(data, header_entry("surfels", -1)), "fields"),
        (lambda data: rewritten(data, header_entry("surfels", 10**12)), "counts"),
        (lambda data: rewritten(data, header_entry("surfels", 90_000)), "fewer surfels and keyframes than stated"),
        (
            lambda data: rewritten(data, header_entry("surfels", 20_000_000)),
            r"states 20,000,000 surfels in [0-9,]+ bytes",
        ),
        (lambda data: rewritten(data, header_entry("keyframes", 9_000_000)), "states 9,000,000 keyframes in"),
        (lambda data: rewritten(data, header_entry("surfels", 5)), "more surfels and keyframes than stated"),
        (lambda data: rewritten(data, header_entry("columns", [])), "fields"),
        (lambda data: rewritten(data, header_entry("frame", "odom")), "frame"),
        (lambda data: rewritten(data, header_entry("keyframes", None)), "counts"),
        (lambda data: rewritten(data, header_entry("keyframes", 3)), "fewer surfels and keyframes than stated"),
        (lambda data: rewritten(data, header_entry("keyframes", 1)), "more surfels and keyframes than stated"),
        (lambda data: rewritten(data, header_entry("settings", {"far_m": -1})), "settings"),
        (lambda data: rewritten(data, header_entry("settings", {"max_surfels": 1024})), "no room"),
        (lambda data: rewritten(data, header_entry("stamp_s", "now")), "header"),
        (lambda data: rewritten(data, header_entry("dropped", -3)), "dropped"),
        (lambda data: rewritten(data, lambda _, body: body.__setitem__(0, 0)), "cannot be unpacked"),
        (
            lambda data: rewritten(data, lambda _, body: body.__setitem__(len(body) // 2, 77)),
            "cannot be unpacked|holds",
        ),
        (lambda data: compressed(data, b""), "fewer surfels and keyframes than stated"),
        (lambda data: repacked(data, lambda columns, poses: None, b"\0"), "more surfels and keyframes than stated"),
        (pose_entry(0, 2.0), "rigid"),
        (pose_entry(3, np.nan), "rigid"),
        (entry("keyframe", 2), "keyframe holds numbers beyond the 2"),
        (entry("keyframe", -2), "keyframe holds numbers beyond the 2"),
        (entry("last_age", -1), "after it ends"),
        (entry("last_age", 2**31 - 1), "before they were first seen"),
        (entry("radius", 32000), "holds numbers that are not finite"),
        (entry("radius", -32000), "radius_m holds numbers that are not positive"),
        (entry("radius", 320), "holds numbers beyond"),
        (entry("confidence", 2000), "confidence holds"),
        (entry("variance", 2000), "variance_m2 holds"),
        (entry("green", 30000), "color holds"),
        (entry("along", 2**31 - 1), "position holds numbers beyond 16000"),
    ],
)
def test_what_is_no_map_is_refused_in_one_line(surfel_map, tmp_path, damage, word):
    save_map(surfel_map, tmp_path / "a.map")
    refused(tmp_path / "a.map", damage((tmp_path / "a.map").read_bytes()), word)


def refused(path: Path, data: bytes, word: str) -> None:
    path.write_bytes(data)
    with pytest.raises(MapError, match=word) as raised:
        load_map(path)
    assert str(path) in str(raised.value)
    assert "\n" not in str(raised.value)


@pytest.mark.parametrize(
    ("damage", "word"),
    [
        (lambda data: data.replace(b"map-2", b"map-3", 1), "header"),
        (lambda data: data[:60], "header"),
        (lambda data: data[:-1], "bytes of surfels"),
        (lambda data: data + b"\0", "bytes of surfels"),
        (lambda data: data[:-5000], "bytes of surfels"),
        (lambda data: data[:-9] + bytes([data[-9] ^ 1]) + data[-8:], "checksum"),
        (lambda data: data.replace(b'{"frame"', b'["frame"', 1), "header"),
        (lambda data: b"wheelsight-map-2\n[]\n", "header"),
        (lambda data: b"wheelsight-map-2\n{}\n", "header"),
        (lambda data: rewritten(data, header_entry("surfels", -1)), "fields"),
        (lambda data: rewritten(data, header_entry("surfels", 1e400)), "holds Infinity"),
        (lambda data: rewritten(data, header_entry("fields", [])), "fields"),
        (lambda data: rewritten(data, header_entry("frame", "odom")), "frame"),
        (lambda data: rewritten(data, header_entry("keyframes", None)), "counts"),
        (lambda data: rewritten(data, header_entry("keyframes", 3)), "bytes of surfels and keyframes"),
        (lambda data: rewritten(data, put_pose(0, 2.0)), "rigid"),
        (lambda data: rewritten(data, put_pose(3, np.nan)), "rigid"),
        (lambda data: rewritten(data, put_keyframe(2)), "keyframe holds numbers beyond the 2"),
        (lambda data: rewritten(data, put_keyframe(-2)), "keyframe holds numbers beyond the 2"),
        (lambda data: rewritten(data, header_entry("settings", {"far_m": -1})), "settings"),
        (lambda data: rewritten(data, header_entry("settings", {"unknown": 1})), "settings"),
        (lambda data: rewritten(data, header_entry("settings", {"max_surfels": 1024})), "no room"),
        (lambda data: rewritten(data, header_entry("stamp_s", -5.0)), "after it ends"),
        (lambda data: data.replace(b'"settings": ', b'"settings": ' + b'{"a":' * 10_000, 1), "nested too deeply"),
        (
            lambda data: data.replace(b'"settings": ', b'"deep": ' + b"[" * 90 + b"]" * 90 + b', "settings": ', 1),
            "deeper",
        ),
        (lambda data: rewritten(data, put(3, 1e30)), "normal holds numbers beyond 1.01"),
        (lambda data: rewritten(data, put(6, 1e30)), "radius_m holds numbers beyond 100"),
        (lambda data: rewritten(data, header_entry("stamp_s", float("nan"))), "holds NaN"),
        (lambda data: rewritten(data, header_entry("stamp_s", "now")), "header"),
        (lambda data: rewritten(data, header_entry("dropped", -3)), "dropped"),
        (lambda data: rewritten(data, put(0, np.nan)), "position"),
        (lambda data: rewritten(data, put(0, np.inf)), "position"),
        (lambda data: rewritten(data, put(0, 1e9)), "position"),
        (lambda data: rewritten(data, put(3, 5.0)), "normal"),
        (lambda data: rewritten(data, put(6, -1.0)), "radius_m"),
        (lambda data: rewritten(data, put(11, 0.0)), "confidence"),
        (lambda data: rewritten(data, put(12, np.nan)), "variance_m2"),
    ],
)
def test_a_damaged_map_of_the_second_version_is_refused_in_one_line(surfel_map, tmp_path, damage, word):
    refused(tmp_path / "a.map", damage(second_version(surfel_map)), word)


def test_a_missing_file_is_named(tmp_path):
    with pytest.raises(MapError, match=r"a\.map: cannot be read"):
        load_map(tmp_path / "a.map")


def test_a_folder_that_is_not_there_is_an_output_error_and_leaves_nothing(surfel_map, tmp_path: Path):
    with pytest.raises(OutputError):
        save_map(surfel_map, tmp_path / "nowhere" / "a.map")
    assert not list(tmp_path.iterdir())
