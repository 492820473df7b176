"""What the live layer keeps of somebody who has left where no camera looks: a behaviour's clearing forgets it."""

from __future__ import annotations

import re

import numpy as np
import pytest
from narrowing import not_none
from navigation.rooms import Ride, is_near

from benchmarks.plain_rooms import DepthEye, Walls, walls_about
from wheelsight.app.run.drive_record import monitor_words
from wheelsight.core.calibration import Calibration
from wheelsight.core.calibration_parts import DepthNoise
from wheelsight.core.errors import ArgumentError
from wheelsight.core.geometry import PinholeCamera
from wheelsight.navigation import (
    Footprint,
    LiveLayer,
    NavigationReason,
    NavigationSettings,
    NavigatorSettings,
    perception,
)
from wheelsight.navigation.senses import Senses

SIZE_M = (8.0, 6.0)
OPEN = (*walls_about(*SIZE_M), ((4.0, 0.0), (4.0, 2.3)), ((4.0, 3.7), (4.0, 6.0)))
IN_THE_DOOR = ((4.0, 2.3), (4.0, 3.7))
BEGIN, AWAY, BEYOND = (1.5, 3.0, 0.0), (1.5, 3.0, 3.1), (6.0, 3.0, 0.0)
# Longer than somebody who walks by, shorter than what settles.
STOOD_S = 4.0


def ride_past_a_ghost(monkeypatch: pytest.MonkeyPatch) -> Ride:
    """Somebody stood in the only door, and left it when the robot had turned its camera away; then it is to go there.

    By itself the layer would keep that for an hour.
    """
    monkeypatch.setattr(perception, "_STAYS", 1000.0)
    settings = NavigationSettings(controller="pure_pursuit", navigator=NavigatorSettings(tries=3, patience_s=0))
    ride = Ride.of(Walls.of(*OPEN, IN_THE_DOOR), BEGIN, SIZE_M, Walls.of(*OPEN), settings)
    ride.go(STOOD_S)
    ride.navigator.go_to_pose(AWAY)
    ride.go(20.0)
    assert not_none(ride.navigator.result).has_arrived
    ride.robot.walls = Walls.of(*OPEN)
    ride.transitions.clear()
    ride.navigator.go_to_pose(BEYOND)
    ride.go(60.0)
    return ride


def test_a_ghost_in_the_only_door_is_forgotten_after_a_behaviour(monkeypatch: pytest.MonkeyPatch) -> None:
    ride = ride_past_a_ghost(monkeypatch)
    result = not_none(ride.navigator.result)
    assert result.has_arrived
    assert is_near(ride.robot.base.pose, BEYOND)
    assert result.recoveries == 1
    assert ride.states[:3] == ["planning", "recovering", "planning"]
    assert ride.clearance_m > 0


def test_without_that_it_bars_the_door(monkeypatch: pytest.MonkeyPatch) -> None:
    """So the test above is about the clearing, and nothing else."""
    monkeypatch.setattr(Senses, "clear", lambda self, *, only_ahead=False: None)
    ride = ride_past_a_ghost(monkeypatch)
    result = not_none(ride.navigator.result)
    assert (result.has_arrived, result.reason) == (False, NavigationReason.BLOCKED)
    assert result.recoveries == 3
    assert ride.robot.base.pose[0] < 2.0


CAMERA = PinholeCamera(160, 120, 138.0, 138.0, 79.5, 59.5)
AHEAD_M, HEIGHT_M = 0.35, 0.9
MOUNT = np.array([[0, 0, 1, AHEAD_M], [-1.0, 0, 0, 0], [0, -1.0, 0, HEIGHT_M], [0, 0, 0, 1]])
EYE_CALIBRATION = Calibration.registered_camera(CAMERA, T_base_camera=MOUNT, depth_noise=DepthNoise(0.001, 0.001))
THING_M, NEAR_M = 2.0, 1.0
NOT_SEEN_THROUGH = r"what stood at \([\d.]+, [\d.]+\) m is not seen through: no depth behind it"


def depth_m(has_thing: bool, wall_m: float, floor_m: float, hides_m: float = np.inf) -> np.ndarray:
    """Floor up to a way, a wall at another, a thing of a person's width 2 m ahead, and a board before it."""
    rays = CAMERA.rays() @ MOUNT[:3, :3].T
    with np.errstate(divide="ignore", invalid="ignore"):
        floor = np.where(rays[..., 2] < 0, -HEIGHT_M / rays[..., 2], np.inf)
    z = np.where(AHEAD_M + floor * rays[..., 0] > floor_m, np.inf, floor)
    z = np.minimum(z, wall_m - AHEAD_M)
    for at_m in (THING_M if has_thing else np.inf, hides_m):
        away_m = at_m - AHEAD_M
        if np.isfinite(away_m):
            height_m = HEIGHT_M + away_m * rays[..., 2]
            is_thing = (np.abs(away_m * rays[..., 1]) < 0.2) & (height_m > 0) & (height_m < 1.7)
            z = np.where(is_thing, np.minimum(z, away_m), z)
    return np.where(np.isfinite(z) & (z < 10), z, 0).astype(np.float32)


def layer_with_a_ghost(wall_m: float, floor_m: float, hides_m: float = np.inf) -> LiveLayer:
    """Somebody stood there for 20 s and left 3 s ago."""
    layer = LiveLayer(EYE_CALIBRATION, Footprint.rectangle(0.8, 0.3, 0.6))
    for k in range(115):
        layer.update(depth_m(k < 100, wall_m, floor_m, np.inf if k < 100 else hides_m), (0, 0, 0), 0.2 * k)
    return layer


def stays(layer: LiveLayer, yaw: float = 0.0) -> np.ndarray:
    half_rad = float(np.arctan(80 / 138))
    return layer.not_seen_through((AHEAD_M, 0.0, yaw), half_rad, NEAR_M - AHEAD_M)


def is_occupied(layer: LiveLayer) -> bool:
    found = layer.obstacles()
    column, row = np.floor((np.array([THING_M + 0.02, 0.0]) - found.origin) / found.resolution_m).astype(int)
    return bool(found.is_occupied[row - 3 : row + 4, column - 2 : column + 3].any())


@pytest.mark.parametrize("floor_m", [99.0, 2.5, 1.9], ids=["a hall", "floor to 2.5 m", "a strip of floor"])
def test_what_left_before_no_depth_stays_and_is_named(floor_m: float) -> None:
    layer = layer_with_a_ghost(np.inf, floor_m)
    assert is_occupied(layer)
    places = stays(layer)
    assert len(places)
    np.testing.assert_allclose(places[:, 0], THING_M, atol=0.15)
    assert (np.abs(places[:, 1]) < 0.3).all()
    assert not len(stays(layer, yaw=2.0))  # a camera that looks elsewhere


def test_what_left_before_a_wall_is_gone_and_nothing_is_named() -> None:
    layer = layer_with_a_ghost(4.0, 99.0)
    assert not is_occupied(layer)
    assert not len(stays(layer))


@pytest.mark.slow
def test_what_is_still_shown_or_hidden_by_another_thing_is_not_named() -> None:
    standing = LiveLayer(EYE_CALIBRATION, Footprint.rectangle(0.8, 0.3, 0.6))
    for k in range(50):
        standing.update(depth_m(True, np.inf, 99.0), (0, 0, 0), 0.2 * k)
    assert is_occupied(standing)
    assert not len(stays(standing))
    hidden = layer_with_a_ghost(np.inf, 99.0, hides_m=1.5)
    assert is_occupied(hidden)
    assert not len(stays(hidden))


def test_a_look_from_another_side_with_depth_behind_it_ends_it() -> None:
    layer = layer_with_a_ghost(np.inf, 99.0)
    for k in range(5):  # from 4 m ahead, looking back: a wall is behind it from there
        layer.update(depth_m(False, 5.0, 99.0), (4.0, 0.0, np.pi), 23.0 + 0.2 * k)
    assert not is_occupied(layer)


def ride_before_a_ghost(monkeypatch: pytest.MonkeyPatch) -> Ride:
    """Somebody stood long in the only door and left; nothing in the next room gives depth."""
    monkeypatch.setattr(Senses, "clear", lambda self, *, only_ahead=False: None)
    beyond = tuple(((x, 2.3), (x, 3.7)) for x in (4.0,))
    navigator = NavigatorSettings(tries=2, patience_s=0)
    settings = NavigationSettings(controller="pure_pursuit", navigator=navigator)
    ride = Ride.of(Walls.of(*OPEN, *beyond), BEGIN, SIZE_M, Walls.of(*OPEN), settings)
    stand(ride, 15.0)
    ride.robot.walls = Walls.of(*OPEN)
    # Floor that returns no depth is an obstacle of its own, but for a person who has declared it.
    ride.navigator.senses.floor.declared = (np.array([[2.0, 1.0], [8.0, 1.0], [8.0, 5.0], [2.0, 5.0]]),)
    sees = ride.robot.walls.depth_m

    def blind_beyond(T_map_camera: np.ndarray, eye: DepthEye) -> np.ndarray:
        depth = sees(T_map_camera, eye)
        return np.where(depth < 4.1 - T_map_camera[0, 3], depth, 0.0)

    monkeypatch.setattr(ride.robot.walls, "depth_m", blind_beyond)
    stand(ride, 2.0)
    ride.transitions.clear()
    ride.navigator.go_to_pose(BEYOND)
    return ride


def stand(ride: Ride, seconds: float) -> None:
    """Look on, without a task."""
    for _ in range(round(seconds / 0.05)):
        ride.navigator.step()


@pytest.mark.slow
def test_a_plan_that_fails_for_a_ghost_says_that_no_depth_is_behind_it(monkeypatch: pytest.MonkeyPatch) -> None:
    ride = ride_before_a_ghost(monkeypatch)
    ride.go(1.0)
    assert re.fullmatch(NOT_SEEN_THROUGH, ride.navigator.feedback.stays)
    assert monitor_words(ride.navigator.feedback).endswith(ride.navigator.feedback.stays)
    ride.go(60.0)
    result = not_none(ride.navigator.result)
    assert result.reason is NavigationReason.BLOCKED
    assert re.search(NOT_SEEN_THROUGH, result.detail)
    assert ride.navigator.feedback.stays == ""


@pytest.mark.slow
@pytest.mark.parametrize("says_so", [True, False])
def test_a_person_who_says_that_nothing_is_there_ends_it(says_so: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    ride = ride_before_a_ghost(monkeypatch)
    ride.go(1.0)
    if says_so:
        ride.navigator.clear_obstacles((4.0, 3.0), 1.0)
    ride.go(8.0)
    assert bool(ride.navigator.feedback.stays) is not says_so
    assert bool(ride.robot.base.pose[0] > BEGIN[0] + 0.5) is says_so
    assert ride.clearance_m > 0


@pytest.mark.slow
def test_what_does_stand_there_is_met_again_at_once() -> None:
    ride = Ride.of(Walls.of(*OPEN, IN_THE_DOOR), BEGIN, SIZE_M, Walls.of(*OPEN))
    stand(ride, 3.0)
    ride.navigator.clear_obstacles((4.0, 3.0), 2.0)
    stand(ride, 0.3)
    ride.navigator.go_to_pose(BEYOND)
    ride.go(3.0)
    assert ride.robot.base.pose[0] < 3.0
    assert not not_none(ride.navigator.feedback).stays


@pytest.mark.parametrize("radius_m", [0.0, -1.0, np.nan, np.inf])
def test_a_radius_that_is_none_is_refused(radius_m: float) -> None:
    ride = Ride.of(Walls.of(*OPEN), BEGIN, SIZE_M)
    with pytest.raises(ArgumentError, match="a radius of"):
        ride.navigator.clear_obstacles((4.0, 3.0), radius_m)
