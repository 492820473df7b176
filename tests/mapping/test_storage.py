"""Maps in files: what was saved is what is loaded, and what is no map is refused in one line."""

from __future__ import annotations

import json
import struct
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mapping.scenes import FRAME_S, GRID, SHAPE, Wall, fuse, kept_keyframes, look_at, made_map, pose, see

from wheelsight.errors import MapError, OutputError
from wheelsight.mapping import SurfelMap, Surfels, SurfelSettings, load_map, save_map


@pytest.fixture(scope="module")
def surfel_map() -> SurfelMap:
    """Of which some surfels hang on two keyframes, and others on none; nobody changes it."""
    store, rng = kept_keyframes(2), np.random.default_rng(20240817)
    made = SurfelMap(SurfelSettings(active_s=7.0, threads=1), store)
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
    first, second = surfel_map.surfels(), loaded.surfels()
    orders = [np.lexsort(surfels.position.T) for surfels in (first, second)]
    for name in Surfels.__slots__:
        np.testing.assert_array_equal(getattr(first, name)[orders[0]], getattr(second, name)[orders[1]])
    views = [m.predict(pose(), GRID, SHAPE) for m in (surfel_map, loaded)]
    np.testing.assert_allclose(views[0].depth_m, views[1].depth_m, atol=1e-3)


def test_saving_what_was_loaded_gives_the_same_bytes(surfel_map, tmp_path):
    save_map(surfel_map, tmp_path / "a.map")
    save_map(load_map(tmp_path / "a.map"), tmp_path / "b.map")
    assert (tmp_path / "a.map").read_bytes() == (tmp_path / "b.map").read_bytes()


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


def test_the_format_can_be_read_without_wheelsight(surfel_map, tmp_path):
    save_map(surfel_map, tmp_path / "a.map")
    name, header, body = (tmp_path / "a.map").read_bytes().split(b"\n", 2)
    assert name == b"wheelsight-map-2"
    about = json.loads(header)
    assert about["frame"] == "map"
    assert about["fields"][0] == ["position", "<f4", 3]
    x, y, z = struct.unpack_from("<3f", body)
    assert np.isin([x, y, z], surfel_map.surfels().position).all()
    assert about["surfels"] == len(surfel_map)


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


def first_version(data: bytes) -> bytes:
    """The file as wheelsight wrote it before surfels hung on keyframes."""
    _, header, body = data.split(b"\n", 2)
    about = json.loads(header)
    numbers = body[: len(body) - 128 * about.pop("keyframes") - 4 * about["surfels"]]
    del about["frame"], about["fields"][-1]
    for later in ("colored_every", "merged_every", "laid_sigmas", "radial_sigma"):
        del about["settings"][later]
    about["crc32"] = zlib.crc32(numbers)
    return b"\n".join([b"wheelsight-map-1", json.dumps(about).encode(), numbers])


def test_a_setting_that_means_nothing_now_is_passed_over(surfel_map, tmp_path):
    save_map(surfel_map, tmp_path / "new.map")
    name, header, body = (tmp_path / "new.map").read_bytes().split(b"\n", 2)
    about = json.loads(header)
    about["settings"]["beyond_share"] = 0.05
    (tmp_path / "old.map").write_bytes(b"\n".join([name, json.dumps(about).encode(), body]))
    assert len(load_map(tmp_path / "old.map")) == len(surfel_map)


def test_a_file_of_the_first_version_is_a_map_whose_surfels_hang_on_no_keyframe(surfel_map, tmp_path):
    save_map(surfel_map, tmp_path / "new.map")
    (tmp_path / "old.map").write_bytes(first_version((tmp_path / "new.map").read_bytes()))
    new, old = (load_map(tmp_path / name) for name in ("new.map", "old.map"))
    for name in set(Surfels.__slots__) - {"keyframe"}:
        np.testing.assert_array_equal(getattr(old.surfels(), name), getattr(new.surfels(), name))
    assert (old.surfels().keyframe == -1).all()
    assert len(old.T_map_keyframe) == 0
    assert (old.settings, old.stamp_s) == (new.settings, new.stamp_s)


def header_entry(name: str, value: object) -> Callable[[dict[str, Any], bytearray], None]:
    return lambda about, _: about.__setitem__(name, value)


@pytest.mark.parametrize(
    ("damage", "word"),
    [
        (lambda data: b"", "is no map"),
        (lambda data: b"ply\n" + data, "is no map"),
        (lambda data: data.replace(b"map-2", b"map-3", 1), "version"),
        (lambda data: data[:10], "is no map|version"),
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
def test_what_is_no_map_is_refused_in_one_line(saved, tmp_path, damage, word):
    path = tmp_path / "a.map"
    path.write_bytes(damage(saved))
    with pytest.raises(MapError, match=word) as raised:
        load_map(path)
    assert str(path) in str(raised.value)
    assert "\n" not in str(raised.value)


def test_a_missing_file_is_named(tmp_path):
    with pytest.raises(MapError, match=r"a\.map: cannot be read"):
        load_map(tmp_path / "a.map")


def test_a_folder_that_is_not_there_is_an_output_error_and_leaves_nothing(surfel_map, tmp_path: Path):
    with pytest.raises(OutputError):
        save_map(surfel_map, tmp_path / "nowhere" / "a.map")
    assert not list(tmp_path.iterdir())
