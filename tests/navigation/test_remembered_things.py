"""What a collision monitor remembers of things that its camera does not show any more, and what it forgets."""

from __future__ import annotations

import numpy as np
import pytest
from navigation.test_collision_monitor import ALL_AROUND, FULL, NOTHING, Ride, monitor_before, wall
from navigation.unicycle import CHAIR, Camera

from wheelsight.core.estimates import Status
from wheelsight.core.geometry import FloatArray
from wheelsight.core.messages import STOP, VelocityCommand
from wheelsight.navigation.collision_monitor import CollisionMonitor, FloorMemory, MonitorReason, MonitorState
from wheelsight.navigation.settings import outline_of

KINECT = Camera(half_angle_rad=0.47, near_m=1.9)
AHEAD = VelocityCommand(0.3)
# Longer than people wait for somebody to step aside.
LONG_S = 40.0
CORNER_M = float(np.hypot(0.8, 0.3))


def standing(ride: Ride, seconds: float) -> None:
    """It stands, and sees what it sees, two times a second."""
    while seconds > 0:
        ride.monitor.add_reading(ride.time_s, 0.0, 0.0)
        ride.monitor.add_view(ride.camera.view(ride.points, ride.base.pose, ride.time_s))
        ride.time_s, seconds = ride.time_s + 0.45, seconds - 0.45
    ride.monitor.add_reading(ride.time_s, 0.0, 0.0)
    ride.monitor.add_view(ride.camera.view(ride.points, ride.base.pose, ride.time_s))


def block(x_m: float, y_m: float) -> FloatArray:
    """(N, 2) points of a box of 0.2 m."""
    along = np.arange(-0.1, 0.11, 0.02)
    sides = [np.stack([along, np.full(len(along), end)], axis=-1) for end in (-0.1, 0.1)]
    return np.concatenate([*sides, *(side[:, ::-1] for side in sides)]) + (x_m, y_m)


def test_what_stands_beside_a_robot_that_stays_is_not_forgotten() -> None:
    """It drives past a box, stands for 40 s, and is asked to turn to it: by then it had been forgotten."""
    ride = Ride(block(1.9, 0.55), KINECT)
    ride.monitor.trust_floor(2.3)
    ride.drive(AHEAD, 5.0)
    ride.drive(STOP, 1.0)
    standing(ride, LONG_S)
    ride.drive(VelocityCommand(0.0, 0.5), 3.0)
    assert ride.clearance_m > 0
    assert ride.results[-1].state is MonitorState.STOPPED


def test_who_stood_before_the_camera_and_has_gone_is_forgotten_at_once() -> None:
    """He is nearer than the floor that it sees, and what showed from there would show still."""
    ride = Ride(block(1.6, 0.0), KINECT)
    ride.monitor.trust_floor(2.3)
    assert ride.drive(AHEAD, 4.0).state is MonitorState.STOPPED
    ride.points = NOTHING
    assert ride.drive(AHEAD, 0.5).state is not MonitorState.STOPPED


def test_a_low_thing_that_came_too_near_to_be_seen_stays() -> None:
    """The camera looks over it from where it stands by now."""
    low, monitor, now_s = block(2.6, 0.0), CollisionMonitor(CHAIR), 0.0
    monitor.trust_floor(2.3)
    for step in range(400):
        now_s, x = 0.05 * step, min(0.3 * 0.05 * step, 1.2)
        monitor.add_reading(now_s, 0.3 if x < 1.2 else 0.0, 0.0)
        shown = low if 2.5 - x - KINECT.x_m > 1.4 else NOTHING
        monitor.add_view(KINECT.view(shown, np.array([x, 0.0, 0.0]), now_s))
    assert monitor.check(AHEAD, now_s, Status.TRACKING).command.forward_m_s < AHEAD.forward_m_s


@pytest.mark.parametrize(("turns", "is_known"), [(1, True), (2, False)])
def test_it_is_forgotten_by_the_way_for_wheels_err_by_that(turns: int, is_known: bool) -> None:
    """Once around, a corner of the front goes 5.4 m."""
    known, box, seconds = FloorMemory(outline_of(CHAIR), 12.0), block(0.4, 0.75), turns * 2 * np.pi / 0.5
    known.add_reading(0.0, 0.0, 0.5)
    known.add_view(Camera(0.0, np.pi, 0.0, 5.0).view(box, np.zeros(3), 0.0))
    for stamp_s in np.linspace(0.0, seconds, 100)[1:]:
        known.add_reading(float(stamp_s), 0.0, 0.5)
    known.add_view(KINECT.view(NOTHING, np.zeros(3), seconds))
    found = known.points_at((0.0, 0.0, 1.0, 0.0), seconds, 3.0)
    assert (len(found) > 0) == is_known == (turns * 2 * np.pi * CORNER_M < 10.0)


@pytest.mark.parametrize(("way_m", "turn_rad"), [(0.3, 0.0), (0.0, 0.4)])
def test_a_thing_stays_where_it_is_while_the_wheels_way_carries_the_robot_on(way_m: float, turn_rad: float) -> None:
    """By their way, whatever speeds come with it: those are late, and a door's posts came into the door."""
    points, reported, shown = np.array([[1.4, 0.1], [1.4, -0.1], [1.5, 0.6]]), [], np.zeros(3)
    for rolls in (True, False):
        monitor = CollisionMonitor(CHAIR)
        monitor.add_reading(0.0, 0.0, 0.0)
        if rolls:
            monitor.add_view(ALL_AROUND.view(points, np.zeros(3), 0.0))
            for n in range(1, 11):
                monitor.add_reading(0.01 * n, 0.0, 0.0, (way_m / 10, turn_rad / 10))
        else:
            shown = np.array([way_m, 0.0, turn_rad])
            monitor.add_view(ALL_AROUND.view(points, shown, 0.0))
            monitor.add_reading(0.1, 0.0, 0.0)
        reported.append(monitor.check(FULL, 0.1, Status.TRACKING).command.forward_m_s)
    assert 0.0 < reported[0] < 1.0
    assert reported[0] == pytest.approx(reported[1], abs=0.01)


def test_a_way_that_is_no_number_stops_it() -> None:
    monitor = monitor_before(wall(5.0))
    monitor.add_reading(0.05, 0.3, 0.0, (np.nan, 0.0))
    assert monitor.check(FULL, 0.05, Status.TRACKING).reason is MonitorReason.INVALID
