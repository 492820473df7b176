"""Occupancy by closed forms: a room of boxes, seen from known poses."""

from __future__ import annotations

from functools import cache
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from mapping.floor_scenes import CAMERA, ROBOT, ROOM, Box, at, depth_of, keyframe, mapped, mount, robot, turning
from numpy.testing import assert_array_equal

from wheelsight.core.calibration import Calibration
from wheelsight.core.errors import ArgumentError, MapError
from wheelsight.core.geometry import FloatArray, se3
from wheelsight.core.keyframes import Keyframe, KeyframeId, KeyframeStore
from wheelsight.core.messages import RgbdFrame
from wheelsight.io.recordings import open_recording
from wheelsight.io.ros_map import FREE, OCCUPIED, UNKNOWN
from wheelsight.mapping import CellKind, OccupancyGrid, OccupancyMapper, OccupancySettings
from wheelsight.mapping.occupancy import SeenDepth

CELL_M = 0.05
TABLE_TOP = Box((1.32, -0.5, 0.58), (2.1, 0.5, 0.73))
LAMP = Box((-1.8, -0.3, 1.6), (-1.22, 0.3, 1.75))
HOLE = Box((1.3, -0.6, -0.5), (2.1, 0.6, 0.0))


def points(low: tuple[float, float], high: tuple[float, float], inset_m: float = 0.0) -> FloatArray:
    """(N, 2) all over a rectangle, some to a cell."""
    x, y = (np.arange(a + inset_m, b - inset_m + 1e-9, CELL_M / 2) for a, b in zip(low, high, strict=True))
    return np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)


def of_box(box: Box, inset_m: float = 2 * CELL_M) -> FloatArray:
    return points(box.low[:2], box.high[:2], inset_m)


def walls(grid: OccupancyGrid) -> FloatArray:
    """(N, 2) middles of obstacles."""
    return grid.middle_of(np.argwhere(grid.kind == CellKind.OBSTACLE))


@pytest.fixture(scope="module")
def empty_room() -> OccupancyGrid:
    return mapped(turning()).grid()


def test_walls_are_within_a_cell_and_whole(empty_room: OccupancyGrid) -> None:
    found = walls(empty_room)
    off = np.minimum(np.abs(np.abs(found[:, 0]) - 3.0), np.abs(np.abs(found[:, 1]) - 2.0))
    assert off.max() <= CELL_M
    for y in (-2.0, 2.0):
        shown = found[np.abs(found[:, 1] - y) <= CELL_M, 0]
        assert np.diff(np.unique(shown.round(3))).max() < 1.5 * CELL_M
        assert (shown.min(), shown.max()) == pytest.approx((-3.0, 3.0), abs=2 * CELL_M)


def test_inside_is_free_and_outside_unknown(empty_room: OccupancyGrid) -> None:
    inside = empty_room.kind_at(points((-3.0, -2.0), (3.0, 2.0), 2 * CELL_M))
    assert set(np.unique(inside)) <= {CellKind.FREE, CellKind.UNKNOWN}
    assert (inside == CellKind.FREE).mean() > 0.97
    x, y = np.moveaxis(points((-6.0, -6.0), (6.0, 6.0)), -1, 0)
    outside = (np.abs(x) > 3.0 + 1.5 * CELL_M) | (np.abs(y) > 2.0 + 1.5 * CELL_M)
    beyond = empty_room.kind_at(np.stack([x, y], axis=-1)[outside])
    assert_array_equal(beyond, CellKind.UNKNOWN)
    assert empty_room.free_m2() == pytest.approx(6.0 * 4.0, rel=0.06)


def test_cells_are_reported_as_ros_shows_them(empty_room: OccupancyGrid) -> None:
    for kind, reported in ((CellKind.FREE, FREE), (CellKind.OBSTACLE, OCCUPIED), (CellKind.UNKNOWN, UNKNOWN)):
        assert_array_equal(empty_room.occupancy[empty_room.kind == kind], reported)
    plan = empty_room.to_ros()
    cells = np.argwhere(empty_room.kind == CellKind.OBSTACLE)
    np.testing.assert_allclose(plan.to_map(cells[:, ::-1] + 0.5), walls(empty_room))
    assert_array_equal(empty_room.cells_at(walls(empty_room)), cells)


def test_what_a_camera_never_saw_is_unknown_even_beside_what_it_saw() -> None:
    one_way = mapped([at(0.0, 0.0, 0.0)]).grid()
    behind = one_way.kind_at(points((-3.0, -2.0), (-0.5, 2.0)))
    assert_array_equal(behind, CellKind.UNKNOWN)


def test_the_floor_on_which_the_robot_stands_is_free() -> None:
    stood = mapped([at(0.0, 0.0, 0.0)]).grid()
    assert_array_equal(stood.kind_at(points((-0.15, -0.15), (0.15, 0.15))), CellKind.FREE)


def test_a_table_is_an_obstacle_although_the_floor_below_it_is_seen(monkeypatch: pytest.MonkeyPatch) -> None:
    """With one layer for all heights, rays below its top would clear the cell: docs/decisions/occupancy."""
    in_layers = mapped(turning(), TABLE_TOP).grid().kind_at(of_box(TABLE_TOP))
    monkeypatch.setattr("wheelsight.mapping.occupancy._LAYER_M", 10.0)
    in_one = mapped(turning(), TABLE_TOP).grid().kind_at(of_box(TABLE_TOP))
    assert (in_layers == CellKind.OBSTACLE).mean() > 0.95
    assert (in_one == CellKind.OBSTACLE).mean() < 0.8


def test_the_inside_of_what_is_seen_from_the_front_alone_is_not_free(monkeypatch: pytest.MonkeyPatch) -> None:
    """The floor below a shelf at the camera's height is seen, its front, and never what is in it."""
    shelf = Box((1.32, -0.5, 1.0), (2.1, 0.5, 1.2))
    hidden = mapped(turning(), shelf).grid()
    monkeypatch.setattr("wheelsight.mapping.occupancy._HIDDEN_M", 0.0)
    seen_as_free = mapped(turning(), shelf).grid()
    assert (hidden.kind_at(points((1.32, -0.4), (1.34, 0.4))) == CellKind.OBSTACLE).all()
    assert CellKind.FREE not in hidden.kind_at(of_box(shelf))
    assert (seen_as_free.kind_at(of_box(shelf)) == CellKind.FREE).mean() > 0.9
    assert hidden.kind_at((-2.0, 1.0)) == CellKind.FREE


def test_a_lamp_above_the_robot_is_an_overhang_and_the_floor_below_it_is_free() -> None:
    level = mount(1.1, 0.0)
    made = OccupancyMapper(robot(level))
    poses = [at(x, y, 180.0, level) for x in (0.2, 0.6, 1.0, 1.4) for y in (-0.2, 0.0, 0.2)]
    for number, T in enumerate(poses):
        made.add(KeyframeId(number), keyframe(depth_of(T, LAMP)), T)
    grid = made.grid()
    below = points((-1.245, -0.2), (-1.225, 0.2))
    assert_array_equal(grid.kind_at(below), CellKind.OVERHANG)
    row, column = grid.cells_at(below).T
    assert_array_equal(grid.occupancy[row, column], FREE)
    assert CellKind.OBSTACLE not in grid.kind_at(of_box(LAMP, 0.0))


def test_a_hole_in_the_floor_is_a_drop_off_and_its_rim_is_floor() -> None:
    grid = mapped(turning(), hole=HOLE).grid()
    kinds = grid.kind_at(of_box(HOLE))
    assert (kinds == CellKind.DROP_OFF).mean() > 0.8
    assert (kinds == CellKind.FREE).mean() < 0.1
    rim = points((0.5, -1.5), (2.8, 1.5))
    around = (np.abs(rim[:, 0] - 1.7) > 0.4 + CELL_M) | (np.abs(rim[:, 1]) > 0.6 + CELL_M)
    assert CellKind.DROP_OFF not in grid.kind_at(rim[around])
    assert (grid.occupancy[grid.kind == CellKind.DROP_OFF] == OCCUPIED).all()


def test_a_stair_down_is_a_drop_off_before_its_bottom_is_seen() -> None:
    """The floor ends at x = 1; what is seen beyond lies deep below."""
    pit = Box((1.0, -2.0, -3.0), (3.0, 2.0, 0.0))
    grid = mapped([at(-0.8, 0.0, 0.0)], hole=pit).grid()
    assert (grid.kind_at(points((1.1, -0.2), (1.5, 0.2))) == CellKind.DROP_OFF).mean() > 0.9
    assert (grid.kind_at(points((0.6, -0.2), (0.9, 0.2))) == CellKind.FREE).mean() > 0.9


def test_a_low_thing_is_an_obstacle_and_a_threshold_is_floor() -> None:
    grid = mapped(turning(), Box((1.4, -0.5, 0.0), (1.7, 0.5, 0.13)), Box((-1.7, -0.5, 0.0), (-1.4, 0.5, 0.02))).grid()
    assert (grid.kind_at(points((1.4, -0.4), (1.7, 0.4), CELL_M)) == CellKind.OBSTACLE).mean() > 0.97
    assert (grid.kind_at(points((-1.7, -0.4), (-1.4, 0.4), CELL_M)) == CellKind.FREE).mean() > 0.97


def test_what_was_taken_away_is_gone_after_some_looks() -> None:
    box = Box((1.4, -0.5, 0.0), (1.7, 0.5, 0.8))
    poses = turning()
    made = mapped(poses, box)
    assert (made.grid().kind_at(of_box(box)) == CellKind.OBSTACLE).any()
    looks = [(T, keyframe(depth_of(T))) for T in poses]
    for number, (T, look) in enumerate([look for look in looks for _ in range(8)], start=len(poses)):
        made.add(KeyframeId(number), look, T)
    assert_array_equal(made.grid().kind_at(of_box(box)), CellKind.FREE)


@cache
def about_the_room() -> OccupancyMapper:
    """Its keyframes may be moved by the test that takes it."""
    return mapped(turning(8))


@given(st.floats(0.01, 0.4), st.floats(-0.4, 0.4), st.floats(-180, 180))
def test_a_correction_of_poses_moves_the_walls_with_them(x: float, y: float, yaw_deg: float) -> None:
    poses, made = turning(8), about_the_room()
    made.move(np.array(poses))
    T_new_old = se3.from_plane(x, y, np.radians(yaw_deg))
    assert made.move(T_new_old @ np.array(poses))
    found = walls(made.grid())
    back = (np.c_[found, np.zeros(len(found))] - T_new_old[:3, 3]) @ T_new_old[:3, :3]
    off = np.minimum(np.abs(np.abs(back[:, 0]) - 3.0), np.abs(np.abs(back[:, 1]) - 2.0))
    assert off.max() <= 1.5 * CELL_M  # a cell that lies askew
    assert len(found) > 200


def test_made_again_is_as_made_at_once() -> None:
    poses = turning(6)
    shifted = [se3.from_plane(7.0, -3.0, 1.0) @ T for T in poses]
    moved = mapped(poses)
    assert not moved.move(np.array(poses))
    assert moved.move(np.array(shifted))
    at_once = OccupancyMapper(ROBOT)
    for number, T in enumerate(shifted):
        at_once.add(KeyframeId(number), keyframe(depth_of(poses[number])), T)
    for one, other in ((moved.grid(), at_once.grid()),):
        assert_array_equal(one.kind, other.kind)
        assert one.origin == pytest.approx(other.origin)


def test_a_store_is_followed() -> None:
    poses, store = turning(4), KeyframeStore()
    for T in poses[:3]:
        store.add(keyframe(depth_of(T)), T)
    made = OccupancyMapper(ROBOT)
    assert not made.update(store)
    store.add(keyframe(depth_of(poses[3])), poses[3])
    store.move([KeyframeId(1)], poses[1][None] @ se3.exp([0.0, 0.0, 0.1, 0.0, 0.0, 0.0]))
    assert made.update(store)
    assert len(made) == 4
    assert not made.update(store)


def counted(monkeypatch: pytest.MonkeyPatch) -> dict[str, int]:
    """How many images of depth are decoded, and how many keyframes are put into a map, from now on."""
    counts, depth_m, rays = {"decoded": 0, "put": 0}, Keyframe.depth_m.fget, SeenDepth.rays  # type: ignore[attr-defined]

    def decode(self: Keyframe) -> np.ndarray:
        counts["decoded"] += 1
        return np.asarray(depth_m(self))

    def put(self: SeenDepth) -> object:
        counts["put"] += 1
        return rays(self)

    monkeypatch.setattr(Keyframe, "depth_m", property(decode))
    monkeypatch.setattr(SeenDepth, "rays", put)
    return counts


def test_a_loop_puts_each_keyframe_once_again_and_decodes_none_but_new_ones(monkeypatch: pytest.MonkeyPatch) -> None:
    """Which is what lets a map be made again within a second: benchmarks measure that, and here is no clock."""
    view, count, bend = keyframe(depth_of(at(0.0, 0.0, 0.0))), 40, se3.exp([0.3, 0.0, 0.0, 0.0, 0.0, 0.0])
    store, made = KeyframeStore(), OccupancyMapper(ROBOT)
    for number in range(count):
        store.add(view, at(0.002 * number, 0.0, 0.0))
    counts = counted(monkeypatch)
    made.update(store)
    assert counts == {"decoded": count, "put": count}
    for loop in (1, 2):
        put, known = counts["put"], len(store)
        store.move([KeyframeId(number) for number in range(known)], bend @ store.T_map_keyframe)
        store.add(view, at(0.0, 0.0, 10.0 * loop))
        assert made.update(store)
        assert counts == {"decoded": known + 1, "put": put + known + 1}
    before = counts.copy()
    assert not made.update(store)
    assert counts == before


@pytest.mark.parametrize(("roll", "pitch", "z"), [(0.02, 0.0, 0.3), (0.0, 0.03, -0.4), (-0.02, -0.02, 1.0)])
def test_a_map_whose_height_drifts_keeps_its_floor(roll: float, pitch: float, z: float) -> None:
    """The floor is the base's, wherever the map has that."""
    poses = turning()
    made, T_drift = OccupancyMapper(ROBOT), se3.exp([0.0, 0.0, z, roll, pitch, 0.0])
    for number, T in enumerate(poses):
        made.add(KeyframeId(number), keyframe(depth_of(T)), T_drift @ T)
    grid = made.grid()
    assert CellKind.DROP_OFF not in grid.kind
    assert (grid.kind_at(points((-2.5, -1.5), (2.5, 1.5))) == CellKind.FREE).mean() > 0.95


def test_nothing_seen_is_one_unknown_cell() -> None:
    assert OccupancyMapper(ROBOT).grid().kind.tolist() == [[CellKind.UNKNOWN]]


def test_depth_that_is_unknown_says_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("wheelsight.mapping.occupancy._STOOD_M", 0.0)
    made = OccupancyMapper(ROBOT)
    made.add(KeyframeId(0), keyframe(np.zeros((120, 160), np.float32)), at(0, 0, 0))
    assert made.grid().kind.tolist() == [[CellKind.UNKNOWN]]


def test_what_is_wrong_is_refused_and_changes_nothing() -> None:
    with pytest.raises(MapError, match="pose above the floor is unknown"):
        OccupancyMapper(Calibration.registered_camera(CAMERA))
    made = mapped(turning(2))
    before = made.grid()
    view = keyframe(depth_of(at(0, 0, 0)))
    with pytest.raises(ArgumentError, match="keyframe 1 is there already"):
        made.add(KeyframeId(1), view, at(0, 0, 0))
    with pytest.raises(ArgumentError, match="keyframe 4 is no rigid motion"):
        made.add(KeyframeId(4), view, 2 * np.eye(4))
    with pytest.raises(ArgumentError, match="poses of 1 keyframes"):
        made.move(np.eye(4)[None])
    far = np.array([at(0, 0, 0), at(9000.0, 9000.0, 0), at(0, 0, 0), at(0, 0, 0)])
    with pytest.raises(MapError, match=r"would be 9\d{3} × 9\d{3} m large \(larger cells than 0.05 m"):
        made.move(far)
    with pytest.raises(MapError, match="m large"):
        made.add(KeyframeId(4), view, far[1])
    assert_array_equal(made.grid().kind, before.kind)
    assert len(made) == 4


def test_heights_in_conflict_are_refused() -> None:
    with pytest.raises(ValueError, match="height_m is not between floor_m and overhang_m"):
        OccupancySettings(height_m=2.5)
    assert OccupancySettings(floor_m=0.05, height_m=1.05).layers == 10
    assert OccupancySettings(height_m=0.1).layers == 1


def test_the_room_is_as_it_was_meant() -> None:
    """The scene itself, of which all else is reported: straight ahead the wall is as far off as it is."""
    level = mount(1.1, 0.0)
    depth_m = depth_of(at(0.0, 0.0, 0.0, level))
    assert depth_m[59, 79] == pytest.approx(ROOM.high[0] - 0.2, abs=1e-5)


def test_a_real_robot_in_a_cafe_sees_floor_before_the_counter_and_chairs_before_itself(data_folder: Path) -> None:
    """Four frames of a RealSense that stands still, looked at by eye: chair backs 1 m ahead, a counter to the left."""
    recording = open_recording(data_folder / "rgbd" / "openloris_sample")
    calibration = recording.calibration
    T, (_, camera) = calibration.T_base_camera, calibration.cameras
    assert T is not None
    made, intrinsics = OccupancyMapper(calibration), np.array([camera.fx, camera.fy, camera.cx, camera.cy])
    frames = [event for event in recording.events() if isinstance(event, RgbdFrame)]
    for number, frame in enumerate(frames):
        grey = np.full(frame.depth_m.shape, 100, np.float32)
        made.add(KeyframeId(number), Keyframe.of_images(frame.stamp_s, intrinsics, frame.depth_m, grey), T)
    grid = made.grid()
    assert (grid.kind_at(points((2.8, 1.3), (3.2, 1.8))) == CellKind.FREE).mean() > 0.9
    assert (grid.kind_at(points((3.5, 1.5), (3.7, 1.9))) == CellKind.OBSTACLE).mean() > 0.9
    ahead = points((0.4, -1.0), (1.8, 0.8))
    chairs = ahead[grid.kind_at(ahead) == CellKind.OBSTACLE]
    assert 0.8 < np.hypot(*chairs.T).min() < 1.2
    # One cell of noise in front of a window.
    assert np.count_nonzero(grid.kind == CellKind.DROP_OFF) <= 3
