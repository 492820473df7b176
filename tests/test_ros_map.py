"""Maps of ROS map_server: values by its documentation, places by hand, and every way to be wrong."""

from __future__ import annotations

import math
from pathlib import Path

import cv2
import numpy as np
import pytest

from wheelsight.errors import MapError
from wheelsight.ros_map import FREE, OCCUPIED, UNKNOWN, read_ros_map

YAML = "image: a.pgm\nresolution: 0.1\norigin: [1, 2, 0]\nnegate: 0\noccupied_thresh: 0.65\nfree_thresh: 0.196\n"
# Black, grey as map_saver writes what is unknown, and the two whites in use; below it, what falls between.
PIXELS = np.array([[0, 205, 254, 255], [100, 60, 206, 128]], np.uint8)


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
    with pytest.raises(MapError, match="tells its resolution itself"):
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
        ((YAML, "- 1\n"), ": holds no names and values ("),
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
def test_an_image_that_is_no_map_is_named(tmp_path: Path, image: np.ndarray, problem: str) -> None:
    path = written(tmp_path, YAML.replace("a.pgm", "a.png"), image, "a.png")
    with pytest.raises(MapError) as caught:
        read_ros_map(path)
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


def test_real_maps_are_read(data_folder: Path) -> None:
    for path in sorted((data_folder / "maps").glob("*.yaml")):
        plan = read_ros_map(path)
        assert set(np.unique(plan.occupancy)) == {UNKNOWN, FREE, OCCUPIED}, path.name
        assert 0.02 < (plan.occupancy == FREE).mean() < 0.9
