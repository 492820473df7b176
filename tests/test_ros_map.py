"""Maps of ROS map_server: values by its documentation, places by hand, and every way to be wrong."""

from __future__ import annotations

import math
from fractions import Fraction
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
import yaml
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import array_shapes, arrays

from wheelsight.core.errors import MapError, OutputError
from wheelsight.io.ros_map import FREE, OCCUPIED, UNKNOWN, Mode, RosMap, read_ros_map, write_ros_map

YAML = "image: a.pgm\nresolution: 0.1\norigin: [1, 2, 0]\nnegate: 0\noccupied_thresh: 0.65\nfree_thresh: 0.196\n"
# Black, grey as map_saver writes what is unknown, and the two whites in use; below it, what falls between.
PIXELS = np.array([[0, 205, 254, 255], [100, 60, 206, 128]], np.uint8)
MODES: tuple[Mode, ...] = ("trinary", "scale", "raw")


def written(folder: Path, text: str = YAML, image: np.ndarray = PIXELS, name: str = "a.pgm") -> Path:
    cv2.imwrite(str(folder / name), image)
    (folder / "map.yaml").write_text(text)
    return folder / "map.yaml"


def test_trinary_values_are_those_of_map_server(tmp_path: Path) -> None:
    plan = read_ros_map(written(tmp_path))
    upper = [OCCUPIED, FREE if 1 - 205 / 255 < 0.196 else UNKNOWN, FREE, FREE]
    assert upper[1] == UNKNOWN
    np.testing.assert_array_equal(plan.occupancy, [[UNKNOWN, OCCUPIED, FREE, UNKNOWN], upper])


def test_negated_values_are_turned_round(tmp_path: Path) -> None:
    plan = read_ros_map(written(tmp_path, YAML.replace("negate: 0", "negate: 1")))
    np.testing.assert_array_equal(plan.occupancy[1], [FREE, OCCUPIED, OCCUPIED, OCCUPIED])


def test_scaled_values_lie_between_the_thresholds(tmp_path: Path) -> None:
    plan = read_ros_map(written(tmp_path, YAML + "mode: scale\n"))
    share = ((255 - 100) / 255 - 0.196) / (0.65 - 0.196)
    assert plan.occupancy[0].tolist() == [round(100 * share), OCCUPIED, FREE, round(100 * (127 / 255 - 0.196) / 0.454)]


def test_raw_values_are_taken_as_they_are(tmp_path: Path) -> None:
    plan = read_ros_map(written(tmp_path, YAML + "mode: raw\n"))
    assert plan.occupancy.tolist() == [[100, 60, UNKNOWN, UNKNOWN], [0, UNKNOWN, UNKNOWN, UNKNOWN]]


@pytest.mark.parametrize("yaw_rad", [0.0, math.pi / 2, 3.14])
def test_cells_lie_where_origin_and_yaw_put_them(tmp_path: Path, yaw_rad: float) -> None:
    plan = read_ros_map(written(tmp_path, YAML.replace("[1, 2, 0]", f"[1, 2, {yaw_rad}]")))
    c, s = math.cos(yaw_rad), math.sin(yaw_rad)
    corners = np.array([[1, 2], [1 + 0.4 * c - 0.2 * s, 2 + 0.4 * s + 0.2 * c]])
    np.testing.assert_allclose(plan.to_map([[0, 0], [4, 2]]), corners)
    cells = np.array([[0.5, 1.5], [3, 0]])
    np.testing.assert_allclose(plan.to_cells(plan.to_map(cells)), cells, atol=1e-9)


def test_a_bare_image_needs_its_resolution(tmp_path: Path) -> None:
    written(tmp_path)
    plan = read_ros_map(tmp_path / "a.pgm", 0.02)
    assert (plan.resolution_m, plan.origin) == (0.02, (0, 0, 0))
    with pytest.raises(MapError, match="is an image without a scale"):
        read_ros_map(tmp_path / "a.pgm")
    with pytest.raises(MapError, match="states its own resolution"):
        read_ros_map(tmp_path / "map.yaml", 0.02)
    with pytest.raises(MapError, match="--resolution is nan"):
        read_ros_map(tmp_path / "a.pgm", math.nan)


def test_colours_count_by_their_mean_and_an_opaque_alpha_channel_not_at_all(tmp_path: Path) -> None:
    grey = read_ros_map(written(tmp_path)).occupancy
    opaque = np.dstack([PIXELS, PIXELS, PIXELS, np.full_like(PIXELS, 255)])
    path = written(tmp_path, YAML.replace("a.pgm", "a.png"), opaque, "a.png")
    np.testing.assert_array_equal(read_ros_map(path).occupancy, grey)
    written(tmp_path, YAML.replace("a.pgm", "a.png"), np.dstack([0 * PIXELS, PIXELS, 0 * PIXELS + 255]), "a.png")
    assert read_ros_map(path).occupancy[1, 3] == UNKNOWN  # a mean of 170


@pytest.mark.parametrize(
    ("change", "problem"),
    [
        (("resolution: 0.1", "resolution: 0"), ":2: resolution is 0 (metres a cell: over 0, up to 10)"),
        (("resolution: 0.1", "resolution: -0.05"), ":2: resolution is -0.05 ("),
        (("resolution: 0.1", "resolution: .nan"), ":2: resolution is nan ("),
        (("resolution: 0.1\n", ""), ": field resolution is missing (a number)"),
        (("[1, 2, 0]", "[1, 2]"), ":3: origin is [1, 2] ("),
        (("[1, 2, 0]", "[1, 2, .inf]"), ":3: origin is [1, 2, inf] ("),
        (("negate: 0", "negate: maybe"), ":4: negate is 'maybe' (0 or 1)"),
        (("0.65", "65"), ":5: occupied_thresh is 65 (a share from 0 to 1)"),
        (("0.196", "0.7"), ":6: free_thresh is 0.7 (at most occupied_thresh, 0.65)"),
        (("negate: 0", "mode: ternary"), ":4: mode is 'ternary' (one of trinary, scale, raw)"),
        (("image: a.pgm", "image: [1]"), ":1: image is [1] ("),
        (("image: a.pgm", "image: !!python/object:os.system x"), ":1: has the tag "),
        (("image: a.pgm", "image: ["), ": is not YAML: "),
        ((YAML, "- 1\n"), ": has no names and values ("),
    ],
)
def test_a_field_that_is_wrong_is_named_with_its_line(tmp_path: Path, change: tuple[str, str], problem: str) -> None:
    path = written(tmp_path, YAML.replace(*change))
    with pytest.raises(MapError) as caught:
        read_ros_map(path)
    assert problem in str(caught.value)
    assert str(caught.value).startswith(f"{path}:")


@pytest.mark.parametrize(
    ("image", "problem"),
    [
        (np.zeros((4, 4), np.uint16), "has 16 bits a pixel and colour (save it with 8 bits"),
        (np.zeros((4, 4, 4), np.uint8), "is transparent in places (save it without alpha channel"),
    ],
)
def test_a_bare_image_that_is_no_map_is_named(tmp_path: Path, image: np.ndarray, problem: str) -> None:
    written(tmp_path, YAML, image, "a.png")
    with pytest.raises(MapError) as caught:
        read_ros_map(tmp_path / "a.png", 0.05)
    assert str(caught.value).startswith(f"{tmp_path / 'a.png'}: {problem}")


def test_an_image_that_is_missing_or_damaged_is_named(tmp_path: Path) -> None:
    path = written(tmp_path)
    (tmp_path / "a.pgm").write_bytes(b"P5 40000 40000 255\n")
    with pytest.raises(MapError, match="says it is 40000×40000 pixels"):
        read_ros_map(path)
    (tmp_path / "a.pgm").write_bytes(b"no image")
    with pytest.raises(MapError, match=r"a\.pgm: is no image"):
        read_ros_map(path)
    (tmp_path / "a.pgm").unlink()
    with pytest.raises(MapError, match=r"a\.pgm: the map's image is missing"):
        read_ros_map(path)


@pytest.mark.parametrize("mode", MODES)
def test_what_is_transparent_is_unknown_but_in_raw_maps(tmp_path: Path, mode: str) -> None:
    alpha = np.array([[255, 0, 255, 255], [254, 255, 255, 0]], np.uint8)
    image = np.dstack([PIXELS, PIXELS, PIXELS, alpha])
    plain = read_ros_map(written(tmp_path, YAML + f"mode: {mode}\n")).occupancy
    seen = read_ros_map(written(tmp_path, YAML.replace("a.pgm", "a.png") + f"mode: {mode}\n", image, "a.png")).occupancy
    expected = plain if mode == "raw" else np.where(alpha[::-1] < 255, UNKNOWN, plain)
    np.testing.assert_array_equal(seen, expected)


def test_thresholds_count_themselves(tmp_path: Path) -> None:
    """Half of 255 is no pixel; 0 and 1 are."""
    text = YAML.replace("0.65", "1.0").replace("0.196", "0.0")
    plan = read_ros_map(written(tmp_path, text))
    np.testing.assert_array_equal(plan.occupancy[1], [OCCUPIED, UNKNOWN, UNKNOWN, FREE])


def pixels_of(path: Path) -> tuple[np.ndarray, np.ndarray]:
    """Shades and what is opaque: a plain PGM by its own bytes; a PNG, whose colours are all alike, by one of them."""
    if path.suffix == ".png":
        image = cv2.imread(str(path), cv2.IMREAD_UNCHANGED)
        assert image is not None
        return image[..., 1], image[..., 3] == 255 if image.shape[2] == 4 else np.ones(image.shape[:2], bool)
    data, numbers, at = path.read_bytes(), list[int](), 2
    assert data.startswith(b"P5")
    while len(numbers) < 3:
        line = data[at : data.index(b"\n", at)]
        at += len(line) + 1
        numbers += [int(word) for word in line.split(b"#")[0].split()]
    width, height, _ = numbers
    return np.frombuffer(data, np.uint8, width * height, at).reshape(height, width), np.ones((height, width), bool)


def plain_value(shade: int, mode: object, reported: dict[str, Any]) -> int:
    """Of one shade as Nav2's map_server reads it, in exact fractions; none lies midway between two whole numbers."""
    if mode == "raw":
        return shade if shade <= 100 else -1
    occupied = Fraction(shade if reported["negate"] else 255 - shade, 255)
    occupied_at, free_at = Fraction(str(reported["occupied_thresh"])), Fraction(str(reported["free_thresh"]))
    if occupied >= occupied_at:
        return 100
    if occupied <= free_at:
        return 0
    return -1 if mode == "trinary" else round(100 * (occupied - free_at) / (occupied_at - free_at))


def plainly_read(path: Path) -> tuple[np.ndarray, dict[str, Any]]:
    """A map by map_server's documentation, shade by shade."""
    reported = yaml.safe_load(path.read_text())
    mode = reported.get("mode", "trinary")
    table = np.array([plain_value(shade, mode, reported) for shade in range(256)], np.int8)
    shades, is_opaque = pixels_of(path.parent / reported["image"])
    return np.where(is_opaque, table[shades], -1)[::-1], reported


def real_maps(data_folder: Path) -> list[Path]:
    paths = sorted((data_folder / "maps").glob("*.yaml"))
    assert len(paths) >= 5
    return paths


def check_returns(plan: RosMap, path: Path, mode: Mode) -> None:
    """What is written is read as the same map, by us and plainly."""
    write_ros_map(plan, path, mode)
    again, (cells, reported) = read_ros_map(path), plainly_read(path)
    assert reported["mode"] == mode
    for back in (again.occupancy, cells):
        np.testing.assert_array_equal(back, plan.occupancy, err_msg=f"{path.name}, {mode}")
    assert (again.resolution_m, again.origin) == (plan.resolution_m, plan.origin)


@pytest.mark.parametrize("mode", MODES)
def test_cells_of_real_maps_are_those_of_a_plain_reading_and_come_back(
    data_folder: Path, tmp_path: Path, mode: Mode
) -> None:
    for path in real_maps(data_folder):
        plan, (cells, reported) = read_ros_map(path), plainly_read(path)
        np.testing.assert_array_equal(plan.occupancy, cells, err_msg=path.name)
        assert [plan.resolution_m, *plan.origin] == [reported["resolution"], *reported["origin"]]
        check_returns(plan, tmp_path / path.name, mode)


@pytest.mark.parametrize("mode", ["scale", "raw"])
def test_every_percent_of_real_maps_is_that_of_a_plain_reading_and_comes_back(
    data_folder: Path, tmp_path: Path, mode: Mode
) -> None:
    """Their images, the greys of some and all, as a file of that mode shows them."""
    seen = set[int]()
    for path in real_maps(data_folder):
        fields = yaml.safe_load(path.read_text())
        image = path.parent / fields["image"]
        (tmp_path / "read.yaml").write_text(yaml.safe_dump({**fields, "image": str(image), "mode": mode}))
        plan, (cells, _) = read_ros_map(tmp_path / "read.yaml"), plainly_read(tmp_path / "read.yaml")
        np.testing.assert_array_equal(plan.occupancy, cells, err_msg=path.name)
        check_returns(plan, tmp_path / path.name, mode)
        seen |= set(np.unique(cells).tolist())
    assert len(seen) > 90


@pytest.mark.parametrize("mode", MODES)
def test_a_thing_in_a_real_map_that_is_turned_stands_where_origin_and_yaw_put_it(
    data_folder: Path, tmp_path: Path, mode: Mode
) -> None:
    """Two black pixels that stand alone, the 69th and 70th of a row with 1024 more below it, of 0.0504 m each.

    They lie 3.478 m along and 51.635 m above the lower left corner, which is at (25.9, 48.5); turned by 3.14 rad both
    ways are subtracted but for 1.6 mm a metre: 25.9 - 3.478 - 51.635 * 0.00159 and 48.5 + 3.478 * 0.00159 - 51.635.
    """
    plan = read_ros_map(data_folder / "maps" / "basement_fixed.map.yaml")
    write_ros_map(plan, tmp_path / "turned.yaml", mode)
    for read in (plan, read_ros_map(tmp_path / "turned.yaml")):
        assert read.origin[2] == 3.14
        things = read.to_map(np.argwhere(read.occupancy == OCCUPIED)[:, ::-1] + 0.5)
        near = things[np.hypot(*(things - (22.340, -3.129)).T) < 0.25]
        np.testing.assert_allclose(near.mean(axis=0), (22.340, -3.129), atol=0.002)


METRES = st.floats(-1e4, 1e4)
ORIGINS = st.tuples(METRES, METRES, st.floats(-math.pi, math.pi))
RESOLUTIONS = st.floats(0.001, 1.0)
SHAPES = array_shapes(min_dims=2, max_dims=2, max_side=12)
PERCENT = st.integers(UNKNOWN, OCCUPIED)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("maps")


@given(arrays(np.int8, SHAPES, elements=st.sampled_from([UNKNOWN, FREE, OCCUPIED])), RESOLUTIONS, ORIGINS)
def test_a_trinary_map_comes_back_exactly(
    folder: Path, cells: np.ndarray, resolution_m: float, origin: tuple[float, float, float]
) -> None:
    path, image = write_ros_map(RosMap(cells, resolution_m, origin), folder / "a.yaml")
    back = read_ros_map(path)
    np.testing.assert_array_equal(back.occupancy, cells)
    assert (back.resolution_m, back.origin) == (resolution_m, origin)
    np.testing.assert_array_equal(plainly_read(path)[0], cells)
    assert set(np.unique(pixels_of(image)[0])) <= {0, 205, 254}


@given(arrays(np.int8, SHAPES, elements=PERCENT), st.sampled_from(["scale", "raw"]))
def test_shares_come_back_exactly(folder: Path, cells: np.ndarray, mode: Mode) -> None:
    path, _ = write_ros_map(RosMap(cells, 0.05), folder / "shares.yaml", mode)
    for back in (read_ros_map(path).occupancy, plainly_read(path)[0]):
        np.testing.assert_array_equal(back, cells)


def test_what_lies_between_the_thresholds_is_unknown_once_written(tmp_path: Path) -> None:
    cells = np.array([[0, 19, 20, 21, 64, 65, 100, -1]], np.int8)
    write_ros_map(RosMap(cells, 0.05), tmp_path / "a.yaml")
    assert read_ros_map(tmp_path / "a.yaml").occupancy.tolist() == [[0, 0, 0, -1, -1, 100, 100, -1]]


def test_a_map_that_cannot_be_written_is_refused_and_leaves_the_old_one(tmp_path: Path) -> None:
    plan = RosMap(np.zeros((2, 3), np.int8), 0.05)
    with pytest.raises(MapError, match=r"a\.pgm: does not end in \.yaml or \.yml \(the image stands beside it\)"):
        write_ros_map(plan, tmp_path / "a.pgm")
    with pytest.raises(MapError, match="mode is 'colour'"):
        write_ros_map(plan, tmp_path / "a.yaml", "colour")  # type: ignore[arg-type]
    with pytest.raises(OutputError, match="does not exist"):
        write_ros_map(plan, tmp_path / "nowhere" / "a.yaml")
    assert list(tmp_path.iterdir()) == []


def warned(path: Path) -> tuple[RosMap, list[str]]:
    """A map, and what is said about it."""
    said: list[str] = []
    return read_ros_map(path, warn=said.append), said


@pytest.mark.parametrize(
    "stated",
    [
        "/home/somebody/maps/a.pgm",
        "maps/a.pgm",
        "../maps/a.pgm",
        "~/.ros/a.pgm",
        "$(find nav)/maps/a.pgm",
        "file:///srv/maps/a.pgm",
        "'C:\\Users\\me\\maps\\a.pgm'",
        "maps\\a.pgm",
        "A.PGM",
        "/somewhere/A.Pgm",
    ],
)
def test_an_image_that_was_left_behind_is_the_one_of_that_name_beside_the_map(tmp_path: Path, stated: str) -> None:
    plain = read_ros_map(written(tmp_path)).occupancy
    (tmp_path / "b.pgm").write_bytes((tmp_path / "a.pgm").read_bytes()[:-8] + bytes(8))
    plan, said = warned(written(tmp_path, YAML.replace("image: a.pgm", f"image: {stated}")))
    np.testing.assert_array_equal(plan.occupancy, plain)
    assert len(said) == 1
    assert "is missing" in said[0]
    assert said[0].endswith(f"{tmp_path / 'a.pgm'} is used")


def test_separators_of_windows_lead_into_a_folder_beside_the_map(tmp_path: Path) -> None:
    (tmp_path / "maps").mkdir()
    plain = read_ros_map(written(tmp_path)).occupancy
    (tmp_path / "a.pgm").rename(tmp_path / "maps" / "a.pgm")
    (tmp_path / "map.yaml").write_text(YAML.replace("a.pgm", "maps\\a.pgm"))
    plan, said = warned(tmp_path / "map.yaml")
    np.testing.assert_array_equal(plan.occupancy, plain)
    assert str(tmp_path / "maps" / "a.pgm") in said[0]


def test_an_image_that_is_where_the_file_says_is_taken_without_a_word(tmp_path: Path) -> None:
    (tmp_path / "maps").mkdir()
    path = written(tmp_path, YAML.replace("a.pgm", "maps/a.pgm"), 255 - PIXELS)
    cv2.imwrite(str(tmp_path / "maps" / "a.pgm"), PIXELS)
    plan, said = warned(path)
    assert not said
    assert plan.occupancy[1, 0] == OCCUPIED


@pytest.mark.parametrize("stated", ["/home/somebody/maps/other.pgm", "maps/", "..", "/", "a\\"])
def test_an_image_that_is_nowhere_is_still_refused(tmp_path: Path, stated: str) -> None:
    with pytest.raises(MapError):
        warned(written(tmp_path, YAML.replace("a.pgm", stated)))


@pytest.mark.parametrize("yaw", ["-nan", "nan", ".nan", "-.NaN", "NaN", "-nan(ind)", "1.#QNAN", "-1.#IND"])
def test_a_yaw_that_is_no_number_is_0_with_a_warning(tmp_path: Path, yaw: str) -> None:
    plan, said = warned(written(tmp_path, YAML.replace("[1, 2, 0]", f"[1, 2, {yaw}]")))
    assert plan.origin == (1.0, 2.0, 0.0)
    assert len(said) == 1
    assert "map.yaml:3: the origin's yaw is" in said[0]


@pytest.mark.parametrize("place", ["[nan, 2, 0]", "[1, -nan, 0]", "[1, 2, left]", "[1, 2, null]", "[1, 2, -.inf]"])
def test_a_place_that_is_no_number_is_refused(tmp_path: Path, place: str) -> None:
    with pytest.raises(MapError, match=r":3: origin is"):
        read_ros_map(written(tmp_path, YAML.replace("[1, 2, 0]", place)))


@pytest.mark.parametrize("free_thresh", ["0.25", "0.2", "0.6"])
def test_map_savers_grey_stays_unknown_where_thresholds_make_it_free(tmp_path: Path, free_thresh: str) -> None:
    plain = read_ros_map(written(tmp_path)).occupancy
    plan, said = warned(written(tmp_path, YAML.replace("0.196", free_thresh)))
    assert plan.occupancy[1].tolist() == plain[1].tolist() == [OCCUPIED, UNKNOWN, FREE, FREE]
    problem = f"1 cells have map_saver's grey for unknown, and are free by free_thresh {free_thresh}"
    assert said == [f"{tmp_path / 'map.yaml'}: {problem}: they are read as unknown; set free_thresh to 0.196"]
    assert plan.occupancy[0, 2] == FREE  # 206 is no grey of map_saver


def test_where_the_floor_itself_is_of_that_grey_it_is_free(tmp_path: Path) -> None:
    """No cell is whiter: then the threshold was set for it."""
    drawn = np.where(PIXELS > 205, 205, PIXELS).astype(np.uint8)
    plan, said = warned(written(tmp_path, YAML.replace("0.196", "0.25"), drawn))
    assert plan.occupancy[1].tolist() == [OCCUPIED, FREE, FREE, FREE]
    assert not said


@pytest.mark.parametrize("fields", ["mode: scale\n", "negate: 1\n"])
def test_of_other_maps_no_grey_is_unknown_by_itself(tmp_path: Path, fields: str) -> None:
    text = YAML.replace("negate: 0\n", "").replace("0.196", "0.25") + fields
    said = warned(written(tmp_path, text))[1]
    assert not said


@pytest.mark.parametrize("is_binary", [True, False], ids=["binary", "text"])
@pytest.mark.parametrize("white", [1, 3, 15, 100, 254, 255, 256, 1000, 65535])
def test_white_of_a_pgm_is_what_its_header_says(tmp_path: Path, white: int, is_binary: bool) -> None:
    """Black, white, white less a tenth and half, and a value beyond white as damaged files have it."""
    values = np.array([0, white, round(0.9 * white), white // 2, min(white + 1, 255 if white < 256 else 65535)])
    header = f"{'P5' if is_binary else 'P2'}\n# by hand\n5 1\n# white:\n{white}\n".encode()
    body = values.astype(">u2" if white > 255 else "u1").tobytes() if is_binary else " ".join(map(str, values)).encode()
    (tmp_path / "map.yaml").write_text(YAML)
    (tmp_path / "a.pgm").write_bytes(header + body)
    occupied = 1 - np.minimum(values / white, 1)
    expected = np.where(occupied >= 0.65, OCCUPIED, np.where(occupied <= 0.196, FREE, UNKNOWN))
    for plan in (read_ros_map(tmp_path / "map.yaml"), read_ros_map(tmp_path / "a.pgm", 0.05)):
        assert plan.occupancy[0].tolist() == expected.tolist()
    (tmp_path / "map.yaml").write_text(YAML + "mode: scale\n")
    shares = read_ros_map(tmp_path / "map.yaml").occupancy[0]
    between = np.floor(100 * (occupied - 0.196) / (0.65 - 0.196) + 0.5)
    assert shares.tolist() == np.where(expected == UNKNOWN, between, expected).tolist()


def test_raw_values_of_a_pgm_are_those_of_255(tmp_path: Path) -> None:
    (tmp_path / "map.yaml").write_text(YAML + "mode: raw\n")
    (tmp_path / "a.pgm").write_bytes(b"P5 4 1 51\n" + bytes([0, 10, 20, 51]))
    assert read_ros_map(tmp_path / "map.yaml").occupancy.tolist() == [[0, 50, 100, UNKNOWN]]


@pytest.mark.parametrize("has_alpha", [False, True])
def test_an_image_of_16_bits_is_read_by_its_white(tmp_path: Path, has_alpha: bool) -> None:
    plain = read_ros_map(written(tmp_path)).occupancy
    deep = PIXELS.astype(np.uint16) * 257
    alpha = np.full_like(deep, 65535)
    alpha[0, 2] = 65534
    image = np.dstack([deep, deep, deep, alpha]) if has_alpha else deep
    plan = read_ros_map(written(tmp_path, YAML.replace("a.pgm", "a.png"), image, "a.png"))
    expected = plain.copy()
    expected[1, 2] = UNKNOWN if has_alpha else plain[1, 2]
    np.testing.assert_array_equal(plan.occupancy, expected)


@pytest.mark.parametrize("white", [0, 65536, 99999])
def test_a_pgm_without_a_white_that_can_be_is_refused(tmp_path: Path, white: int) -> None:
    path = written(tmp_path)
    (tmp_path / "a.pgm").write_bytes(b"P5 2 1 %d\n" % white + bytes(4))
    with pytest.raises(MapError, match=rf"a\.pgm: says that {white} is white"):
        read_ros_map(path)


@pytest.mark.parametrize("left_out", ["negate: 0\n", "occupied_thresh: 0.65\n", "free_thresh: 0.196\n"])
def test_fields_that_may_be_missing_are_what_map_server_takes(tmp_path: Path, left_out: str) -> None:
    plain = read_ros_map(written(tmp_path)).occupancy
    np.testing.assert_array_equal(read_ros_map(written(tmp_path, YAML.replace(left_out, ""))).occupancy, plain)


@pytest.mark.parametrize("missing", ["image", "resolution", "origin"])
def test_fields_that_may_not_be_missing_are_named(tmp_path: Path, missing: str) -> None:
    text = "".join(line + "\n" for line in YAML.splitlines() if not line.startswith(missing))
    with pytest.raises(MapError, match=f"field {missing} is missing"):
        read_ros_map(written(tmp_path, text))
