"""Floors: where the robot stood there is floor, and near to where it began as far as it sees past nothing."""

from __future__ import annotations

import numpy as np
import pytest
from narrowing import not_none
from numpy.testing import assert_array_equal

from benchmarks.plain_rooms import CALIBRATION, Walls
from wheelsight.core.geometry import FloatArray, se3
from wheelsight.core.keyframes import Keyframe, KeyframeId, KeyframeStore
from wheelsight.mapping import CellKind, OccupancyGrid
from wheelsight.navigation import (
    Costmap,
    Footprint,
    GrowingFloor,
    KnownFloor,
    NavigationSettings,
    Plan,
    Planner,
    SeenFloor,
    StaticLayer,
    WorkerInStep,
)
from wheelsight.navigation.costmap import CellState

CHAIR = Footprint.rectangle(0.8, 0.3, 0.6)
CAMERA = not_none(CALIBRATION.depth)
WALLS = Walls.of(((3.0, -3.0), (3.0, 3.0)), ((-3.0, 1.2), (3.0, 1.2)))


class Seen:
    """A localization that has keyframes."""

    def __init__(self) -> None:
        self.keyframes = KeyframeStore()

    def look(self, pose: tuple[float, float, float]) -> None:
        T_map_camera = se3.from_plane(*pose) @ not_none(CALIBRATION.T_base_camera)
        depth = WALLS.depth_m(T_map_camera).astype(np.float32)
        intrinsics = np.array([CAMERA.fx, CAMERA.fy, CAMERA.cx, CAMERA.cy])
        self.keyframes.add(Keyframe.of_images(0.0, intrinsics, depth, np.zeros_like(depth)), T_map_camera)

    def process(self, events: object) -> list[object]:
        return []

    def close(self) -> None:
        """Nothing to end."""


def state_at(layer: StaticLayer, x: float, y: float) -> CellState:
    column, row = np.floor((np.array([x, y]) - layer.origin) / layer.resolution_m).astype(int)
    inside = 0 <= row < layer.state.shape[0] and 0 <= column < layer.state.shape[1]
    return CellState(int(layer.state[row, column])) if inside else CellState.UNKNOWN


def floor_at(pose: tuple[float, float, float], trusted_m: float = 0.0) -> tuple[Seen, GrowingFloor]:
    seen = Seen()
    seen.look(pose)
    floor = GrowingFloor(seen, CALIBRATION, CHAIR, trusted_m)  # type: ignore[arg-type]
    floor.update(np.array(pose), 0.0)
    return seen, floor


def test_it_knows_what_the_camera_sees_and_where_it_stands() -> None:
    _, floor = floor_at((0.0, 0.0, 0.0))
    assert state_at(floor.layer, 2.0, 0.0) is CellState.FREE
    assert state_at(floor.layer, 3.02, 0.0) is CellState.OCCUPIED
    assert state_at(floor.layer, -0.25, 0.2) is CellState.FREE
    assert state_at(floor.layer, -1.0, 0.0) is CellState.UNKNOWN


def test_trusted_floor_ends_at_walls() -> None:
    seen, floor = floor_at((0.0, 0.0, 1.2), trusted_m=2.0)
    assert state_at(floor.layer, 0.0, -1.5) is CellState.FREE
    assert state_at(floor.layer, 0.6, 1.6) is CellState.UNKNOWN
    assert floor.is_fixed is False
    assert len(seen.keyframes) == 1


def test_it_grows_with_keyframes_and_says_so() -> None:
    seen, floor = floor_at((0.0, 0.0, 0.0))
    before = floor.revision
    floor.update(np.zeros(3), 0.0)
    assert floor.revision == before
    seen.look((-2.0, -1.0, np.pi))
    floor.update(np.zeros(3), 0.0)
    assert floor.revision > before
    assert state_at(floor.layer, -4.0, -1.0) is CellState.FREE


def test_where_it_stood_stays_floor_when_the_map_grows() -> None:
    seen, floor = floor_at((0.0, 0.0, 0.0))
    for x in (-0.5, -1.0, -1.5):
        floor.update(np.array([x, 0.0, 0.0]), 0.0)
    seen.look((-1.5, 0.0, -2.0))
    floor.update(np.array([-1.5, 0.0, -2.0]), 0.0)
    for x in (0.0, -0.5, -1.5):
        assert state_at(floor.layer, x, 0.0) is CellState.FREE


def test_keyframes_that_moved_are_where_they_are_now() -> None:
    seen, floor = floor_at((0.0, 0.0, 0.0))
    moved = seen.keyframes.pose(KeyframeId(0)).copy()
    moved[0, 3] -= 1.0
    seen.keyframes.move([KeyframeId(0)], moved[None])
    floor.update(np.zeros(3), 0.0)
    assert state_at(floor.layer, 2.02, 0.0) is CellState.OCCUPIED
    assert state_at(floor.layer, 3.02, 0.0) is not CellState.OCCUPIED


@pytest.mark.parametrize("middle", [(0.0, 0.0), (2.9, -1.3), (40.0, 0.0)])
def test_a_window_has_the_cells_of_the_whole(middle: tuple[float, float]) -> None:
    _, floor = floor_at((0.0, 0.0, 0.0))
    window = floor.layer.window(middle, 3.0)
    places: FloatArray = np.random.default_rng(0).uniform(-1.4, 1.4, (50, 2)) + middle
    reported = [state_at(window, *place) for place in places.tolist()]
    assert_array_equal(reported, [state_at(floor.layer, *place) for place in places.tolist()])


def test_where_a_robot_drove_there_is_floor_and_things_stay_things() -> None:
    _, seen = floor_at((0.0, 0.0, 0.0))
    grid = seen.grid
    driven = np.array([[-0.2, 0.0, 0.0], [0.4, 0.0, 0.0], [0.8, 0.1, 0.3]])
    floor = KnownFloor(grid, driven=[driven], footprint=CHAIR)
    before = KnownFloor(grid)
    assert floor.is_fixed
    assert state_at(before.layer, 0.5, 0.25) is CellState.UNKNOWN
    assert state_at(floor.layer, 0.5, 0.25) is CellState.FREE
    assert state_at(floor.layer, 0.5, 0.6) is state_at(before.layer, 0.5, 0.6)
    assert state_at(floor.layer, 3.02, 0.0) is CellState.OCCUPIED


def test_it_holds_a_goal_that_no_one_has_seen() -> None:
    seen = Seen()
    seen.look((0.0, 0.0, 0.0))
    floor = GrowingFloor(seen, CALIBRATION, CHAIR, holds=[(12.0, -7.0)])  # type: ignore[arg-type]
    floor.update(np.zeros(3), 0.0)
    layer = floor.layer
    far = np.array(layer.origin) + layer.resolution_m * np.array(layer.state.shape[::-1])
    assert (np.array(layer.origin) < (0.0, -7.0)).all()
    assert (far > (12.0, 0.0)).all()
    assert state_at(layer, 12.0, -7.0) is CellState.UNKNOWN
    assert state_at(layer, 2.0, 0.0) is CellState.FREE


class Hangs(WorkerInStep[SeenFloor]):
    """Is asked for a floor, and does not make it."""

    def answer(self, now_s: float) -> SeenFloor | None:
        return None


def test_a_floor_that_is_not_made_is_noticed() -> None:
    seen = Seen()
    floor = GrowingFloor(seen, CALIBRATION, CHAIR, worker=Hangs())  # type: ignore[arg-type]
    assert not floor.is_silent(100.0)
    seen.look((0.0, 0.0, 0.0))
    floor.update(np.zeros(3), 100.0)
    assert not floor.is_silent(109.0)
    assert floor.is_silent(111.0)
    assert not floor_at((0.0, 0.0, 0.0))[1].is_silent(1e3)


def unknown_hall() -> OccupancyGrid:
    """10 m by 10 m of which nothing is known, from (-2, -5) on."""
    kind = np.full((200, 200), CellKind.UNKNOWN, np.uint8)
    return OccupancyGrid.of_kinds(kind, kind == CellKind.FREE, 0.05, (-2.0, -5.0))


# Keyframes of a drive, as far from each other as maps keep them: straight on, round a bend, and turned in place.
DRIVEN = {
    "straight": [(0.0, 0.0, 0.0), (0.7, 0.0, 0.0), (1.5, 0.02, 0.0), (2.2, 0.0, 0.0)],
    "askew": [(0.013, 0.007, 0.31), (0.78, 0.25, 0.31), (1.54, 0.49, 0.31)],
    "round a bend": [(0.8 * np.sin(a), 0.8 * (1 - np.cos(a)), a) for a in np.linspace(0, 2.2, 9)],
    "turned in place": [(0.0, 0.0, 0.0), (0.9, 0.0, 0.0), (0.9, 0.0, 0.5), (0.9, 0.0, 1.2), (0.9, 0.8, 1.57)],
}


@pytest.mark.parametrize("driven", DRIVEN.values(), ids=DRIVEN)
def test_the_way_of_a_drive_can_be_driven_again_where_nothing_else_is_known(
    driven: list[tuple[float, float, float]],
) -> None:
    floor, rules = KnownFloor(unknown_hall(), driven=[np.array(driven)], footprint=CHAIR), NavigationSettings().drivable
    found = Planner(CHAIR, rules).plan(Costmap.of(floor.layer, CHAIR), driven[0], driven[-1])
    assert isinstance(found, Plan), found
    assert not found.goal_change


def test_a_map_that_ends_where_the_drive_began_holds_the_floor_it_drove_over() -> None:
    """Keyframes see ahead: behind the first there is no cell of theirs."""
    kind = np.full((20, 20), CellKind.FREE, np.uint8)
    grid = OccupancyGrid.of_kinds(kind, kind == CellKind.FREE, 0.05, (0.5, -0.5))
    layer = KnownFloor(grid, driven=[np.array([[0.0, 0.0, 0.0], [0.8, 0.0, 0.0]])], footprint=CHAIR).layer
    assert state_at(layer, -0.28, 0.28) is CellState.FREE
    assert state_at(layer, 1.4, 0.0) is CellState.FREE
    assert state_at(layer, 1.2, 0.45) is CellState.FREE
    assert state_at(layer, -0.28, 0.45) is CellState.UNKNOWN


def test_where_the_robot_stands_now_there_is_floor_in_a_known_map_too() -> None:
    floor = KnownFloor(unknown_hall(), footprint=CHAIR)
    floor.update(None, 0.0)
    assert floor.revision == 0
    for turn in np.linspace(0, 1.0, 12):
        floor.update(np.array([0.0, 0.0, turn]), 0.0)
    assert floor.revision > 0
    planner = Planner(CHAIR, NavigationSettings().drivable)
    back = planner.plan(Costmap.of(floor.layer, CHAIR), (0.0, 0.0, 1.0), (0.0, 0.0, 0.0))
    assert isinstance(back, Plan)
    known = floor.revision
    floor.update(np.array([0.0, 0.0, 0.0]), 0.0)
    assert floor.revision == known
    floor.update(np.array([-3.0, 0.0, 0.0]), 0.0)  # beyond the map's edge
    assert state_at(floor.layer, -3.2, 0.2) is CellState.FREE


def test_of_a_known_map_the_floor_about_the_begin_is_free_for_a_person_who_says_so() -> None:
    _, seen = floor_at((0.0, 0.0, 0.0))
    floor = KnownFloor(seen.grid, footprint=CHAIR, trusted_m=2.0)
    assert state_at(floor.layer, 0.0, -1.5) is CellState.UNKNOWN
    floor.update(np.array([0.0, 0.0, 1.2]), 0.0)
    assert state_at(floor.layer, 0.0, -1.5) is CellState.FREE
    assert state_at(floor.layer, 3.02, 0.0) is CellState.OCCUPIED
    floor.update(np.array([0.0, -2.0, 1.2]), 0.0)
    assert state_at(floor.layer, 0.0, -3.5) is CellState.UNKNOWN
