"""What a depth camera shows about a robot: made floors and boxes, by rays in plain numpy."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from navigation.floors import CHAIR
from odometry.plain_kernels import plain

from wheelsight.core.calibration import Calibration
from wheelsight.core.calibration_parts import DepthNoise
from wheelsight.core.errors import ArgumentError, CalibrationError, MapError
from wheelsight.core.geometry import PinholeCamera
from wheelsight.navigation import LiveLayer, perception
from wheelsight.navigation import costmap_kernels as kernels

CAMERA = PinholeCamera(160, 120, 138.0, 138.0, 79.5, 59.5)
CAMERA_HALF_RAD = math.atan(80 / 138)
# 0.9 m high, 0.35 m ahead of the axle, level.
T_BASE_CAMERA = np.array([[0, 0, 1, 0.35], [-1.0, 0, 0, 0], [0, -1.0, 0, 0.9], [0, 0, 0, 1]])
CALIBRATION = Calibration.registered_camera(CAMERA, T_base_camera=T_BASE_CAMERA, depth_noise=DepthNoise(0.001, 0.001))
Box = tuple[float, float, float, float, float, float]
AHEAD: Box = (2.0, 2.2, -0.2, 0.2, 0.0, 1.7)
WALL: Box = (4.0, 4.1, -5.0, 5.0, 0.0, 3.0)


def depth_of(boxes: list[Box], pose: tuple[float, float, float] = (0, 0, 0), floor_until_m: float = 99.0) -> np.ndarray:
    """Of boxes (x, x, y, y, z, z) in the layer's frame, and a floor up to some x, beyond which it is 1 m lower."""
    c, s = np.cos(pose[2]), np.sin(pose[2])
    R = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])
    begin = R @ T_BASE_CAMERA[:3, 3] + [pose[0], pose[1], 0]
    rays = CAMERA.rays() @ (R @ T_BASE_CAMERA[:3, :3]).T
    with np.errstate(divide="ignore", invalid="ignore"):
        floor = np.where(rays[..., 2] < 0, -begin[2] / rays[..., 2], np.inf)
        beyond = begin[0] + floor * rays[..., 0] > floor_until_m
        depth = np.where(beyond, (-1.0 - begin[2]) / rays[..., 2], floor)
        depth = np.asarray(np.where(rays[..., 2] < 0, depth, np.inf))
        for box in boxes:
            ends = (np.array(box).reshape(3, 2) - begin[:, None])[None, None] / rays[..., None]
            near, far = np.asarray(ends.min(axis=-1).max(axis=-1)), np.asarray(ends.max(axis=-1).min(axis=-1))
            depth = np.where((near <= far) & (near > 0), np.minimum(depth, near), depth)
    return np.where(np.isfinite(depth), depth, 0).astype(np.float32)


def layer() -> LiveLayer:
    return LiveLayer(CALIBRATION, CHAIR)


def is_occupied_at(found: LiveLayer, x: float, y: float, *, is_standing: bool = False) -> bool:
    """Whether anything is within a cell of a place."""
    obstacles = found.obstacles().standing() if is_standing else found.obstacles()
    column, row = np.floor((np.array([x, y]) - obstacles.origin) / obstacles.resolution_m).astype(int)
    return bool(obstacles.is_occupied[row - 1 : row + 2, column - 1 : column + 2].any())


def test_what_stands_ahead_is_there_at_once_and_the_floor_is_free() -> None:
    found = layer()
    found.update(depth_of([AHEAD, WALL]), (0, 0, 0), 1.0)
    for aside_m in (-0.15, 0.0, 0.15):
        assert is_occupied_at(found, 2.02, aside_m)
    assert is_occupied_at(found, 4.0, 1.0)
    rows, columns = np.nonzero(found.obstacles().is_occupied)
    x, y = (0.05 * (at + 0.5) + low for at, low in zip((columns, rows), found.obstacles().origin, strict=True))
    at_box, at_wall = (np.abs(x - 2.0) < 0.1) & (np.abs(y) < 0.3), np.abs(x - 4.0) < 0.1
    assert (at_box | at_wall).all()
    assert found.obstacles().stamp_s == 1.0


def test_a_ghost_is_gone_once_it_is_seen_through_and_not_before_its_passes(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(perception, "_PASSES", 3)
    found = layer()
    found.update(depth_of([AHEAD, WALL]), (0, 0, 0), 0.0)
    left = []
    for number in range(1, 5):
        found.update(depth_of([WALL]), (0, 0, 0), 0.2 * number)
        left.append(is_occupied_at(found, 2.02, 0.0))
    assert left == [True, True, False, False]
    assert is_occupied_at(found, 4.0, 1.0)


def test_what_stood_and_is_not_looked_at_is_not_forgotten_soon() -> None:
    found = layer()
    for stamp_s in (-6.0, 0.0):
        found.update(depth_of([AHEAD, WALL]), (0, 0, 0), stamp_s)
    turned = (0.0, 0.0, np.pi)
    for number in range(20):
        found.update(depth_of([WALL], turned), turned, 1.0 + number)
    assert is_occupied_at(found, 2.02, 0.0)
    # Nor is what stands behind something else.
    for number in range(20):
        found.update(depth_of([(1.2, 1.3, -1.0, 1.0, 0.0, 2.0)]), (0, 0, 0), 30.0 + number)
    assert is_occupied_at(found, 2.02, 0.0)


def passer_by(stamp_s: float, walk_m_s: float = 0.8) -> Box:
    """Half a metre wide, who crosses 2 m ahead, in the middle after a second."""
    y = walk_m_s * (stamp_s - 1.0)
    return 2.0, 2.3, y - 0.25, y + 0.25, 0.0, 1.7


def test_who_walks_past_stands_nowhere_and_what_stands_does() -> None:
    found = layer()
    bin_: Box = (2.6, 2.9, -1.2, -0.9, 0.0, 0.8)
    for number in range(32):
        stamp_s = 0.1 * number
        found.update(depth_of([passer_by(stamp_s), bin_, WALL]), (0, 0, 0), stamp_s)
        y = 0.8 * (stamp_s - 1.0)
        assert is_occupied_at(found, 2.02, y) or y > 0.9
        assert not is_occupied_at(found, 2.02, y, is_standing=True)
    assert is_occupied_at(found, 2.62, -1.05, is_standing=True)
    assert is_occupied_at(found, 4.0, 1.0, is_standing=True)


def test_who_stops_stands() -> None:
    found = layer()
    for number in range(32):
        found.update(depth_of([passer_by(min(0.1 * number, 1.0)), WALL]), (0, 0, 0), 0.1 * number)
    assert is_occupied_at(found, 2.02, 0.0, is_standing=True)


@pytest.mark.parametrize("shows", ["a wall elsewhere", "nothing"])
def test_who_walked_past_is_forgotten_by_a_camera_that_looks_elsewhere_and_not_by_one_that_is_covered(
    shows: str,
) -> None:
    found, turned = layer(), (0.0, 0.0, np.pi)
    for number in range(11):
        found.update(depth_of([passer_by(0.1 * number), WALL]), (0, 0, 0), 0.1 * number)
    image = depth_of([(-3.1, -3.0, -5.0, 5.0, 0.0, 3.0)], turned) if shows != "nothing" else np.zeros((120, 160))
    left = []
    # He was met there for 0.3 s at least, and for 0.6 at most.
    for stamp_s in (6.9, 10.1):
        found.update(image, turned, stamp_s)
        left.append(is_occupied_at(found, 2.02, 0.0))
    assert left == [True, shows == "nothing"]


def test_what_stands_stays_so_while_the_robot_goes_on() -> None:
    found = layer()
    for stamp_s in (0.0, 2.1):
        found.update(depth_of([AHEAD]), (0, 0, 0), stamp_s)
    found.update(np.zeros((120, 160)), (0.7, 0.3, 0.4), 2.5)
    assert is_occupied_at(found, 2.02, 0.0, is_standing=True)


def test_what_came_lately_is_cleared_and_what_has_stood_for_long_is_not() -> None:
    found = layer()
    for stamp_s in (0.0, 8.0, 11.0):
        boxes = [AHEAD] if stamp_s < 5 else [AHEAD, (2.0, 2.2, 0.8, 1.0, 0.0, 1.7)]
        found.update(depth_of(boxes), (0, 0, 0), stamp_s)
    found.clear(stood_s=10.0)
    assert is_occupied_at(found, 2.02, 0.0)
    assert not is_occupied_at(found, 2.02, 0.9)
    found.update(np.zeros((120, 160)), (0, 0, 0), 11.1)
    assert is_occupied_at(found, 2.02, 0.0, is_standing=True)


def test_what_came_lately_is_cleared_in_view_alone() -> None:
    """A person ahead, who may have gone with his feet out of view, and a box beside the view that is still there."""
    found = layer()
    ahead, aside = (1.5, 1.7, -0.2, 0.2, 0.0, 1.7), (1.5, 1.7, 1.2, 1.5, 0.0, 1.7)
    found.update(depth_of([ahead, aside, WALL], turned := (0, 0, 0.5)), turned, 0.0)
    for stamp_s in (0.5, 1.0):
        found.update(depth_of([ahead, aside, WALL]), (0, 0, 0), stamp_s)
    assert is_occupied_at(found, 1.52, 1.25)
    found.clear_ahead(math.inf, (0.35, 0.0, 0.0), CAMERA_HALF_RAD)
    assert not is_occupied_at(found, 1.52, 0.0)
    assert not is_occupied_at(found, 4.0, 1.0)
    assert is_occupied_at(found, 1.52, 1.25)


def test_in_view_what_has_stood_for_long_is_not_cleared() -> None:
    found = layer()
    for stamp_s in (0.0, 11.0):
        found.update(depth_of([AHEAD]), (0, 0, 0), stamp_s)
    found.clear_ahead(10.0, (0.35, 0.0, 0.0), CAMERA_HALF_RAD)
    assert is_occupied_at(found, 2.02, 0.0)
    found.clear_ahead(12.0, (0.35, 0.0, 0.0), CAMERA_HALF_RAD)
    assert not is_occupied_at(found, 2.02, 0.0)


def test_a_ray_below_a_table_leaves_its_top() -> None:
    """At a height at which the camera sees its edge alone, and then only the floor below."""
    top: Box = (2.0, 2.8, -0.6, 0.6, 0.7, 0.75)
    found = layer()
    for stamp_s in (-2.0, 0.0):
        found.update(depth_of([top, WALL]), (0, 0, 0), stamp_s)
    assert is_occupied_at(found, 2.02, 0.0)
    below = depth_of([top, WALL])
    # The upper part is measured by nothing any more; what passes under the table is.
    below[:80] = 0
    for number in range(10):
        found.update(below, (0, 0, 0), 1.0 + number)
    assert is_occupied_at(found, 2.02, 0.0)


@pytest.mark.parametrize("nothing", [0.0, np.nan, np.inf, -1.0])
def test_an_image_of_nothing_changes_nothing(nothing: float) -> None:
    found = layer()
    found.update(depth_of([AHEAD]), (0, 0, 0), 0.0)
    before = found.obstacles().is_occupied
    for number in range(5):
        found.update(np.full((120, 160), nothing), (0, 0, 0), 1.0 + number)
    np.testing.assert_array_equal(found.obstacles().is_occupied, before)
    assert before.any()


def test_a_floor_that_is_missing_is_an_obstacle_until_it_is_seen() -> None:
    found = layer()
    found.update(depth_of([], floor_until_m=2.5), (0, 0, 0), 0.0)
    assert is_occupied_at(found, 2.6, 0.0)
    assert not is_occupied_at(found, 2.2, 0.0)
    for number in range(3):
        found.update(depth_of([]), (0, 0, 0), 1.0 + number)
    assert not is_occupied_at(found, 2.6, 0.0)


@pytest.mark.parametrize("pose", [(0.0, 0.0, 0.0), (1.3, -0.8, 2.1), (-20.0, 31.0, -0.7)])
def test_obstacles_stand_in_the_layers_frame(pose: tuple[float, float, float]) -> None:
    c, s = np.cos(pose[2]), np.sin(pose[2])
    x, y = pose[0] + 2.5 * c, pose[1] + 2.5 * s
    found = layer()
    found.update(depth_of([(x - 0.1, x + 0.1, y - 0.1, y + 0.1, 0.0, 1.0)], pose), pose, 0.0)
    assert is_occupied_at(found, x - 0.1 * c, y - 0.1 * s)
    # It stays there while the robot goes on.
    found.update(np.zeros((120, 160)), (pose[0] + 1.0, pose[1] - 0.5, 0.3), 1.0)
    assert is_occupied_at(found, x - 0.1 * c, y - 0.1 * s)


def test_far_behind_it_is_forgotten_and_where_the_robot_stands_there_is_nothing() -> None:
    found = layer()
    found.update(depth_of([AHEAD]), (0, 0, 0), 0.0)
    found.update(np.zeros((120, 160)), (1.6, 0, 0), 1.0)
    obstacles = found.obstacles()
    rows, columns = np.nonzero(obstacles.is_occupied)
    at = np.stack([columns, rows], axis=-1) * 0.05 + np.array(obstacles.origin) - [1.6, 0.0]
    corners = at[:, None] + 0.05 * np.array([[0, 0], [1, 0], [0, 1], [1, 1]])
    assert not CHAIR.contains(corners).all(axis=1).any()
    found.update(np.zeros((120, 160)), (30.0, 0, 0), 2.0)
    found.update(np.zeros((120, 160)), (0, 0, 0), 3.0)
    assert not found.obstacles().is_occupied.any()


def test_what_it_is_given_is_a_value_and_clear_forgets() -> None:
    found = layer()
    found.update(depth_of([AHEAD]), (0, 0, 0), 0.0)
    before = found.obstacles()
    found.clear()
    assert before.is_occupied.any()
    assert not found.obstacles().is_occupied.any()


@pytest.mark.parametrize(
    ("shape", "pose", "stamp_s"),
    [
        ((120, 161), (0.0, 0.0, 0.0), 0.0),
        ((120, 160), (0.0, np.nan, 0.0), 0.0),
        ((120, 160), (0.0, 0.0), 0.0),
        ((120, 160), (0.0, 0.0, 0.0), np.inf),
    ],
)
def test_what_is_no_view_is_refused_and_changes_nothing(shape: Any, pose: Any, stamp_s: float) -> None:
    found = layer()
    found.update(depth_of([AHEAD]), (0, 0, 0), 0.0)
    before = found.obstacles()
    with pytest.raises(ArgumentError):
        found.update(np.ones(shape), pose, stamp_s)
    np.testing.assert_array_equal(found.obstacles().is_occupied, before.is_occupied)
    assert found.obstacles().stamp_s == 0.0


def test_without_a_camera_or_its_place_there_is_no_layer() -> None:
    with pytest.raises(MapError, match="pose above the floor is unknown"):
        LiveLayer(Calibration.registered_camera(CAMERA), CHAIR)
    with pytest.raises(CalibrationError):
        LiveLayer(Calibration(T_base_camera=T_BASE_CAMERA), CHAIR)


def test_compiled_and_plain_kernels_say_the_same(rng: np.random.Generator) -> None:
    depth = depth_of([AHEAD, WALL])[::4, ::4] + rng.normal(0, 0.02, (30, 40)).astype(np.float32)
    depth[rng.random(depth.shape) < 0.1] = 0
    slopes = np.ascontiguousarray(CAMERA.rays()[::4, ::4, :2], np.float32)
    M = T_BASE_CAMERA[:3].copy()
    M[:2] *= 10
    M[:2, 3] += 30
    heights = kernels.LayerHeights(0.1, 0.05, 0.1, 0.015, 0.1, 1.4, 4.5, 0.5, 4)
    met, met_for = rng.choice([2.0, 9.5], (60, 80)), rng.choice([0.5, 7.5], (60, 80))
    results = []
    for module in (kernels, plain(kernels)):
        met_s = np.stack([met - met_for, met], axis=-1)
        seen, left = np.zeros((60, 80, 15), np.uint8), np.ones((60, 80, 15), np.uint8)
        is_own = np.zeros((60, 80), bool)
        is_own[28:32, 28:36] = True
        view = kernels.DepthPixels(depth, slopes, M)
        module.mark_met(view, heights, is_own, seen)
        module.mark_passed(view, heights, kernels.RayNoise(0.001, 0.001, 3.0), seen)
        marked = seen.copy()
        module.remember(seen, is_own, left, met_s, 10.0, kernels.ClearingRules(3, 1.0, 1.0))
        assert not seen.any()
        results.append((marked, left, met_s))
    for one, other in zip(*results, strict=True):
        np.testing.assert_array_equal(one, other)
    assert set(np.unique(results[0][1])) == {0, 1, 3}
    # What was met for a moment is gone sooner than what was met for longer, and not at once.
    marked, left, _ = results[0]
    is_other = ~marked.any(axis=2) & ~is_own
    is_gone = (met < 9) & (met_for < 1)
    assert not left[is_other & is_gone].any()
    assert left[is_other & ~is_gone].all()


def test_what_is_wiped_is_gone_until_it_is_seen_again() -> None:
    found = layer()
    found.update(depth_of([AHEAD, (2.0, 2.2, 0.8, 1.0, 0.0, 1.7)]), (0, 0, 0), 1.0)
    found.wipe([(2.0, -0.3), (2.1, 0.3)], 0.3)
    assert not is_occupied_at(found, 2.02, 0.0)
    assert is_occupied_at(found, 2.02, 0.9)
    found.update(depth_of([AHEAD]), (0, 0, 0), 1.1)
    assert is_occupied_at(found, 2.02, 0.0)


@pytest.mark.parametrize(("columns", "clears"), [(80, False), (160, True)])
def test_a_block_of_pixels_clears_no_farther_than_its_nearest(
    columns: int, clears: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Every second column shows something near: single pixels see past it to what is behind, pairs do not."""
    monkeypatch.setattr(perception, "_COLUMNS", columns)
    monkeypatch.setattr(perception, "_PASSES", 1)
    found = layer()
    found.update(depth_of([AHEAD]), (0, 0, 0), 1.0)
    empty = depth_of([WALL])
    empty[:, 1::2] = np.minimum(empty[:, 1::2], np.where(empty[:, 1::2] > 0, 0.9, 0))
    found.update(empty, (0, 0, 0), 1.2)
    assert is_occupied_at(found, 2.02, 0.0) is not clears


def test_images_that_come_too_soon_are_left_out_and_clocks_that_were_set_back_stop_none() -> None:
    found = layer()
    assert found.is_due(5.0)
    found.update(depth_of([AHEAD]), (0, 0, 0), 5.0)
    assert [found.is_due(stamp_s) for stamp_s in (5.0, 5.05, 5.1, 4.99, 0.0)] == [False, False, True, True, True]
