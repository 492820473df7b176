"""Floor that is expected and returns nothing is not floor: a well, a black carpet, and the word of a person."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import pytest
from navigation.rooms import Ride
from navigation.test_live_layer import CALIBRATION, depth_of

from benchmarks.drops import Ground, Place
from benchmarks.plain_rooms import EYE, DepthEye, Walls, walls_about
from wheelsight.core.geometry import FloatArray
from wheelsight.mapping import EditKind, MapEdit, MapEdits
from wheelsight.navigation import CellState, DepthViewer, KnownFloor, NavigationSettings
from wheelsight.navigation.settings import PeopleSettings

SIZE_M, BEGIN, GOAL = (9.0, 4.0), (1.5, 2.0, 0.0), (7.8, 2.0, 0.0)
ROOM = Walls.of(*walls_about(*SIZE_M))
SETTINGS = NavigationSettings(controller="pure_pursuit", people=PeopleSettings(is_predicted=False))
EDGE_M, LENGTH_M = 4.0, 1.12
ALL_OF_IT = np.array([[EDGE_M, 0.0], [EDGE_M + LENGTH_M, 0.0], [EDGE_M + LENGTH_M, 4.0], [EDGE_M, 4.0]])


@dataclass
class Dark(Walls):
    """Walls, and floor from x = 4 m on that returns nothing, from wall to wall or less."""

    place: Place

    def depth_m(self, T_map_camera: FloatArray, eye: DepthEye = EYE) -> FloatArray:
        rays, origin = eye.camera.rays() @ T_map_camera[:3, :3].T, T_map_camera[:3, 3]
        seen = super().depth_m(T_map_camera, eye)
        with np.errstate(divide="ignore", invalid="ignore"):
            floor = np.where(rays[..., 2] < 0, -origin[2] / rays[..., 2], np.inf)
        at = origin[:2] + np.where(np.isfinite(floor), floor, 0)[..., None] * rays[..., :2] - (0.0, BEGIN[1])
        is_dark = np.isfinite(floor) & (self.place.within_m(at) > 0) & np.isclose(seen, floor)
        return np.where(is_dark, 0.0, seen)


def ride_at(half_width_m: float = math.inf, floor: KnownFloor | None = None) -> Ride:
    """A map that has all floor free, with a dark place in it."""
    place = Place(Ground.WELL, EDGE_M, 0.0, LENGTH_M, half_width_m, 1.0)
    ride = Ride.of(Dark(ROOM.ends, place), BEGIN, SIZE_M, ROOM, SETTINGS)
    if floor is not None:
        ride.navigator.senses.floor, ride.navigator.senses._track = floor, floor.driven  # noqa: SLF001
    return ride


def farthest_m(ride: Ride, goal: tuple[float, float, float], seconds: float) -> float:
    """How far the outline came over the edge at x = 4 m."""
    most_m = -math.inf

    def looks() -> bool:
        nonlocal most_m
        corners = ride.navigator.footprint.at(ride.robot.base.pose)
        walls = ride.robot.walls
        assert isinstance(walls, Dark)
        sides = np.concatenate([np.linspace(a, b, 12) for a, b in zip(corners, np.roll(corners, 1, 0), strict=True)])
        most_m = max(most_m, float(walls.place.within_m(sides - (0.0, BEGIN[1])).max()))
        return most_m > 0.3

    ride.navigator.go_to_pose(goal)
    ride.go(seconds, looks)
    return most_m


def test_a_view_names_floor_without_depth_and_ends_before_it() -> None:
    viewer = DepthViewer(CALIBRATION, SETTINGS.footprint.outline)
    whole = depth_of([(6.0, 6.1, -5.0, 5.0, 0.0, 3.0)])
    assert not len(viewer.view(whole, 0.0).voids)
    camera_x, height_m = viewer.camera[0], float(viewer._rays.camera[2])  # noqa: SLF001
    ways = viewer._rays.ways  # noqa: SLF001
    with np.errstate(divide="ignore"):
        share = np.where(ways[..., 2] < 0, -height_m / ways[..., 2], np.inf)
    x, y = camera_x + share * ways[..., 0], share * ways[..., 1]
    from_m = viewer.near_m + 0.4
    is_dark = (x > from_m) & (x < from_m + 0.8) & (np.abs(y) < 0.4) & np.isfinite(share)
    view = viewer.view(np.where(is_dark, 0, whole), 0.0)
    assert len(view.voids) > 20
    assert view.voids[:, 0].min() == pytest.approx(from_m, abs=0.08)
    assert np.abs(view.voids[:, 1]).max() == pytest.approx(0.4, abs=0.08)
    middle = len(view.seen_m) // 2
    assert view.seen_m[middle] == pytest.approx(from_m - camera_x, abs=0.08)
    # Single pixels, and a strip as narrow as a projector's shadow, are no hole.
    is_strip = is_dark & (np.abs(y) < 0.04)
    assert not len(viewer.view(np.where(is_strip, 0, whole), 0.0).voids)
    # What carries is seen as floor.
    carried = viewer.view(np.where(is_dark, 0, whole), 0.0, lambda points: np.ones(len(points), bool))
    assert not len(carried.voids)
    assert carried.seen_m[middle] > from_m + 0.7 - camera_x


@pytest.mark.slow
def test_it_stops_before_a_well_that_the_map_calls_free() -> None:
    ride = ride_at()
    assert farthest_m(ride, GOAL, 9.0) < 0.05
    # It came near, and then knew that no way leads on.
    assert ride.robot.base.pose[0] > 2.0
    assert any("is in the only way" in transition.why for transition in ride.transitions)


@pytest.mark.slow
def test_it_drives_around_one_where_there_is_room() -> None:
    ride = ride_at(0.5)
    assert farthest_m(ride, (7.0, 2.0, 0.0), 40.0) < 0.05
    assert ride.navigator.result


@pytest.mark.slow
def test_floor_that_a_person_declared_carries() -> None:
    grid = ROOM.grid(*SIZE_M)
    floor = KnownFloor(grid, MapEdits((MapEdit(EditKind.FLOOR, ALL_OF_IT),)))
    ride = ride_at(floor=floor)
    assert farthest_m(ride, GOAL, 12.0) > 0.3


@pytest.mark.slow
def test_floor_that_it_crossed_on_an_earlier_drive_carries_and_what_is_beside_it_does_not() -> None:
    across = np.array([[1.5, 2.0, 0.0], [7.8, 2.0, 0.0]])
    beside = np.array([[1.5, 2.0, 0.0], [3.0, 2.0, np.pi / 2], [3.0, 3.5, np.pi / 2]])
    for driven, crosses in ((across, True), (beside, False)):
        floor = KnownFloor(ROOM.grid(*SIZE_M), driven=[driven], footprint=SETTINGS.footprint.outline)
        past_m = farthest_m(ride_at(floor=floor), GOAL, 10.0)
        assert (past_m > 0.3) == crosses
        assert crosses or past_m < 0.05


def test_declared_floor_is_free_in_the_map_where_it_was_unknown() -> None:
    grid = ROOM.grid(*SIZE_M)
    unknown = grid.kind.copy()
    unknown[:, 80:102] = 0
    dark = type(grid).of_kinds(unknown, unknown == 1, grid.resolution_m, grid.origin)
    at = [[EDGE_M + 0.5, 2.0]]
    assert KnownFloor(dark).layer.state_at(at)[0] == CellState.UNKNOWN
    edits = MapEdits((MapEdit(EditKind.FLOOR, ALL_OF_IT),))
    assert KnownFloor(dark, edits).layer.state_at(at)[0] == CellState.FREE
