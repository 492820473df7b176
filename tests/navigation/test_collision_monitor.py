"""CollisionMonitor: closed forms, what it never does, and faults in every part above it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import settings as examples
from hypothesis import strategies as st
from navigation.unicycle import CHAIR, Camera, clearance_m
from scipy.stats import qmc

from benchmarks.plain_rooms import Unicycle
from benchmarks.plain_views import view_of_points
from wheelsight.core.estimates import Status
from wheelsight.core.geometry import FloatArray
from wheelsight.core.messages import STOP, VelocityCommand
from wheelsight.navigation import RobotLimits
from wheelsight.navigation.collision_monitor import (
    CollisionMonitor,
    MonitorReason,
    MonitorResult,
    MonitorState,
    WheelCheck,
)
from wheelsight.navigation.settings import MonitorSettings

NOTHING = np.empty((0, 2))
# A camera that sees all around, for closed forms; nothing is blind.
ALL_AROUND = Camera(0.0, np.pi, 0.0, 5.0)
FULL = VelocityCommand(1.0, 0.0)
SETTINGS = MonitorSettings()
FAR_SLOW = MonitorSettings(slow_zone_m=0.0)


def wall(away_m: float, yaw_rad: float = 0.0) -> FloatArray:
    """(N, 2) points of a wall at right angles to a bearing."""
    along = np.arange(-4.0, 4.0, 0.03)
    c, s = np.cos(yaw_rad), np.sin(yaw_rad)
    return np.stack([away_m * c - along * s, away_m * s + along * c], axis=-1)


def monitor_before(
    points: FloatArray, camera: Camera = ALL_AROUND, settings: MonitorSettings = SETTINGS, speed_m_s: float = 0.0
) -> CollisionMonitor:
    """One that has heard a robot at the origin and seen points."""
    monitor = CollisionMonitor(CHAIR, settings=settings)
    monitor.add_reading(0.0, speed_m_s, 0.0)
    monitor.add_view(camera.view(points, np.zeros(3), 0.0))
    return monitor


def checked(monitor: CollisionMonitor, asked: VelocityCommand, status: Status = Status.TRACKING) -> MonitorResult:
    return monitor.check(asked, 0.0, status)


class Ride:
    """A monitor on a base that obeys, among points."""

    def __init__(
        self, points: FloatArray, camera: Camera = ALL_AROUND, monitor: CollisionMonitor | None = None
    ) -> None:
        self.points, self.camera = points, camera
        self.base, self.monitor = Unicycle((0.0, 0.0, 0.0)), monitor or CollisionMonitor(CHAIR)
        self.time_s, self.period, self.clearance_m = 0.0, 0, np.inf
        self.results: list[MonitorResult] = []

    def drive(self, asked: VelocityCommand, seconds: float, sees: bool = True, hears: bool = True) -> MonitorResult:
        for _ in range(round(seconds / 0.05)):
            if hears:
                self.monitor.add_reading(self.time_s, self.base.forward_m_s, self.base.turn_rad_s)
            if sees and self.period % 2 == 0:
                self.monitor.add_view(self.camera.view(self.points, self.base.pose, self.time_s))
            self.results.append(self.monitor.check(asked, self.time_s, Status.TRACKING))
            self.base.step(self.results[-1].command)
            if self.period % 5 == 0 and len(self.points):
                self.clearance_m = min(self.clearance_m, clearance_m(CHAIR, self.base.pose, self.points))
            self.period, self.time_s = self.period + 1, self.time_s + 0.05
        return self.results[-1]


@pytest.mark.parametrize("free_m", [0.1, 0.3, 0.7, 0.9])
def test_the_speed_is_the_one_from_which_it_stops_in_time(free_m: float) -> None:
    """v t + v² / 2a is the way that is free, but for the step in which arcs are judged."""
    result = checked(monitor_before(wall(0.8 + SETTINGS.margin_m + free_m), settings=FAR_SLOW), FULL)
    assert result.state is MonitorState.SLOWED
    assert result.reason is MonitorReason.OBSTACLE
    v, braking = result.command.forward_m_s, FAR_SLOW.braking_share * RobotLimits().braking_m_s2
    way = v * FAR_SLOW.reaction_s + v**2 / (2 * braking)
    assert free_m - 0.02 - 1e-9 <= way <= free_m


def test_what_is_farther_than_the_way_to_a_stop_is_free() -> None:
    far_m = 0.3 + 0.5 / 0.8 + SETTINGS.margin_m + 0.8 + SETTINGS.slow_zone_m
    assert checked(monitor_before(wall(far_m + 0.03)), FULL) == MonitorResult(FULL, MonitorState.FREE)
    slower = checked(monitor_before(wall(far_m - 0.06)), FULL)
    assert slower.reason is MonitorReason.IN_ZONE


def test_a_turn_ends_before_the_corner_meets_a_point() -> None:
    """The front left corner, 0.854 m from the axle at 20.6°, comes along a circle to a point on it."""
    radius, corner_rad = np.hypot(0.8, 0.3), np.arctan2(0.3, 0.8)
    asked, left_rad = VelocityCommand(0.0, 1.0), 0.35
    settings = MonitorSettings(slow_zone_m=0.0, margin_m=0.0, blind_rad_s=4.0)
    bearing = corner_rad + left_rad
    point = np.array([[(radius - 1e-2) * np.cos(bearing), (radius - 1e-2) * np.sin(bearing)]])
    result = checked(monitor_before(point, settings=settings), asked)
    w, slowing = result.command.turn_rad_s, settings.braking_share * RobotLimits().turn_acceleration_rad_s2
    way = w * settings.reaction_s + w**2 / (2 * slowing)
    assert result.reason is MonitorReason.OBSTACLE
    assert left_rad - 0.02 / radius - 0.01 <= way <= left_rad
    beyond = np.array([[(radius + 1e-3) * np.cos(bearing), (radius + 1e-3) * np.sin(bearing)]])
    assert checked(monitor_before(beyond, settings=settings), asked).state is MonitorState.FREE


def test_a_curve_is_judged_as_the_arc_that_it_is() -> None:
    """A point that the straight way would meet, and a curve of 1 m to the left does not; and the other way about."""
    settings = MonitorSettings(slow_zone_m=0.0, blind_rad_s=4.0)
    right, left = np.array([[1.4, -0.25]]), np.array([[1.1, 0.7]])
    curve = VelocityCommand(0.8, 0.8)
    assert checked(monitor_before(right, settings=settings), VelocityCommand(0.8, 0.0)).state is MonitorState.SLOWED
    assert checked(monitor_before(right, settings=settings), curve).state is MonitorState.FREE
    assert checked(monitor_before(left, settings=settings), VelocityCommand(0.8, 0.0)).state is MonitorState.FREE
    assert checked(monitor_before(left, settings=settings), curve).state is MonitorState.SLOWED


speeds = st.floats(-2.0, 2.0)


@examples(max_examples=60)
@given(
    asked=st.builds(VelocityCommand, speeds, speeds),
    measured=st.tuples(speeds, speeds),
    points=st.lists(st.tuples(st.floats(-2.5, 2.5), st.floats(-2.5, 2.5)), max_size=12),
    camera=st.sampled_from([ALL_AROUND, Camera()]),
    status=st.sampled_from(list(Status)),
)
def test_it_never_makes_a_robot_faster_nor_bends_its_way(
    asked: VelocityCommand,
    measured: tuple[float, float],
    points: list[tuple[float, float]],
    camera: Camera,
    status: Status,
) -> None:
    monitor = CollisionMonitor(CHAIR)
    monitor.add_reading(0.0, *measured)
    monitor.add_view(camera.view(np.array(points, float).reshape(-1, 2), np.zeros(3), 0.0))
    result = monitor.check(asked, 0.0, status)
    given, driven = (asked.forward_m_s, asked.turn_rad_s), (result.command.forward_m_s, result.command.turn_rad_s)
    for before, after in zip(given, driven, strict=True):
        assert abs(after) <= abs(before)
        assert after * before >= 0
    assert driven[0] * given[1] == pytest.approx(driven[1] * given[0], abs=1e-9)
    assert (result.state is MonitorState.FREE) == (result.command == asked and result.reason is None)
    assert (result.state is MonitorState.STOPPED) <= result.command.is_stop


def test_all_that_stops_whatever_is_asked() -> None:
    def reason(monitor: CollisionMonitor, now_s: float = 0.0, status: Status = Status.TRACKING) -> MonitorReason | None:
        result = monitor.check(VelocityCommand(0.1, 0.0), now_s, status)
        assert result.command.is_stop == (result.state is MonitorState.STOPPED)
        return result.reason

    assert reason(monitor_before(NOTHING)) is None
    assert reason(CollisionMonitor(CHAIR)) is MonitorReason.NO_WHEELS
    for status in (Status.LOST, Status.FAILING, Status.INITIALIZING):
        assert reason(monitor_before(NOTHING), status=status) is MonitorReason.STATUS
    monitor = monitor_before(NOTHING)
    assert reason(monitor, 0.14) is None
    assert reason(monitor, 0.16) is MonitorReason.NO_WHEELS
    for n in range(1, 8):
        monitor.add_reading(0.05 * n, 0.0, 0.0)
        assert (reason(monitor, 0.05 * n) is None) == (n <= 5)
    assert reason(monitor, 0.35) is MonitorReason.NO_FRAME
    assert reason(monitor_before(NOTHING), -0.2) is MonitorReason.FROM_AHEAD
    assert reason(monitor_before(NOTHING), np.nan) is MonitorReason.INVALID
    monitor = monitor_before(NOTHING)
    monitor.add_reading(0.05, np.nan, 0.0)
    assert reason(monitor, 0.05) is MonitorReason.INVALID
    monitor = monitor_before(NOTHING)
    monitor.add_view(ALL_AROUND.view(np.array([[2.0, 0.0]]), np.zeros(3), 0.05))
    assert reason(monitor, 0.05) is None
    monitor.add_view(replace(ALL_AROUND.view(NOTHING, np.zeros(3), 0.06), points=np.array([[np.nan, 0.0]])))
    assert reason(monitor, 0.06) is MonitorReason.INVALID


def test_from_what_is_too_near_for_its_camera_it_backs_up_a_little() -> None:
    ride = Ride(NOTHING)
    ride.drive(STOP, 1.0)
    dark = replace(ALL_AROUND.view(NOTHING, np.zeros(3), 0.0), seen_m=np.zeros(64))
    for _ in range(20):
        ride.monitor.add_view(replace(dark, stamp_s=ride.time_s))
        assert ride.drive(STOP, 0.05, sees=False).command.is_stop
    for asked in (FULL, VelocityCommand(-0.1, 0.2)):
        assert ride.monitor.check(asked, ride.time_s, Status.TRACKING).reason is MonitorReason.NO_FRAME
    begin_m = ride.base.pose[0]
    for _ in range(160):
        ride.monitor.add_view(replace(dark, stamp_s=ride.time_s))
        ride.drive(VelocityCommand(-0.1, 0.0), 0.05, sees=False)
    assert ride.base.stands
    assert 0.2 < begin_m - ride.base.pose[0] < SETTINGS.blind_m + 0.05


def test_wheels_alone_lead_slowly() -> None:
    result = checked(monitor_before(NOTHING), FULL, Status.COASTING)
    assert result.command.forward_m_s == pytest.approx(SETTINGS.coasting_m_s)
    assert result.reason is MonitorReason.COASTING


def test_a_thing_nearer_than_the_margin_is_only_left_and_slowly() -> None:
    ahead = np.array([[0.82, 0.0]])
    toward, away = VelocityCommand(0.5, 0.0), VelocityCommand(-0.5, 0.0)
    assert checked(monitor_before(ahead), toward).reason is MonitorReason.OBSTACLE
    assert checked(monitor_before(ahead), toward).command == STOP
    leaving = checked(monitor_before(ahead), away)
    assert 0 < -leaving.command.forward_m_s <= SETTINGS.blind_m_s
    inside = checked(monitor_before(np.array([[0.5, 0.0]])), away)
    assert inside == MonitorResult(STOP, MonitorState.STOPPED, MonitorReason.INSIDE)


def test_beside_a_wall_it_goes_on_slowly() -> None:
    """A door of 0.1 m to either side is passed."""
    sides = np.concatenate([wall(0.4, np.pi / 2), wall(0.4, -np.pi / 2)])
    result = checked(monitor_before(sides, settings=MonitorSettings(blind_m_s=1.0)), FULL)
    assert result.reason is MonitorReason.IN_ZONE
    assert result.command.forward_m_s == pytest.approx(SETTINGS.slow_m_s)


def test_backward_it_goes_no_farther_than_blind_m_and_comes_back() -> None:
    ride = Ride(NOTHING, Camera())
    end = ride.drive(VelocityCommand(-0.2, 0.0), 6.0)
    assert end.reason is MonitorReason.NEVER_SEEN
    assert -SETTINGS.blind_m <= ride.base.pose[0] < -0.1
    assert ride.base.stands
    # Nor in two goes.
    ride.drive(STOP, 4.0)
    ride.drive(VelocityCommand(-0.2, 0.0), 3.0)
    assert -SETTINGS.blind_m <= ride.base.pose[0]
    ride.drive(VelocityCommand(0.3, 0.0), 1.5)
    assert ride.base.pose[0] > 0.0


def test_where_it_came_from_it_may_go_back_and_slowly() -> None:
    ride = Ride(NOTHING, Camera())
    ride.drive(FULL, 3.0)
    ride.drive(STOP, 2.0)
    reached_m = ride.base.pose[0]
    ride.drive(VelocityCommand(-0.5, 0.0), 6.0)
    assert ride.base.pose[0] < reached_m - 0.8
    assert min(result.command.forward_m_s for result in ride.results) >= -SETTINGS.blind_m_s - 1e-9


def test_a_turn_over_floor_that_was_never_seen_is_slow() -> None:
    turn = VelocityCommand(0.0, 1.0)
    blind = Ride(NOTHING, Camera())
    blind.drive(turn, 1.0)
    assert max(result.command.turn_rad_s for result in blind.results) <= SETTINGS.blind_rad_s + 1e-9
    assert Ride(NOTHING).drive(turn, 0.5).state is MonitorState.FREE


def test_a_covered_camera_stops() -> None:
    """It sends frames in which nothing has depth: no points, and nothing seen."""
    ride = Ride(NOTHING, Camera())
    ride.drive(FULL, 3.0)
    assert ride.base.forward_m_s > 0.9
    begin_m = ride.base.pose[0]
    covered = replace(Camera().view(NOTHING, np.zeros(3), 0.0), seen_m=np.zeros(64))
    for _ in range(60):
        ride.monitor.add_view(replace(covered, stamp_s=ride.time_s))
        ride.drive(FULL, 0.05, sees=False)
    assert ride.results[-1].reason is MonitorReason.NO_FRAME
    assert ride.base.stands
    # The age of a frame, a period of frames and one of commands, the base's lag, and the way to a stop.
    assert ride.base.pose[0] - begin_m <= 1.0 * (SETTINGS.frame_age_s + 0.1 + 0.05 + 0.2) + 0.5


@pytest.mark.parametrize(("sees", "hears", "reason"), [(False, True, "NO_FRAME"), (True, False, "NO_WHEELS")])
def test_silence_stops(sees: bool, hears: bool, reason: str) -> None:
    ride = Ride(NOTHING, Camera())
    ride.drive(FULL, 2.0)
    assert ride.drive(FULL, 2.0, sees=sees, hears=hears).reason is MonitorReason[reason]
    assert ride.base.stands
    assert ride.drive(FULL, 1.0).state is not MonitorState.STOPPED


def test_what_left_the_view_is_remembered_and_what_is_seen_through_is_forgotten() -> None:
    """A post 0.75 m to the left: seen from afar, out of view beside the robot, in the way of a turn."""
    post, turn = np.array([[2.3, 0.55]]), VelocityCommand(0.0, 0.5)
    ride = Ride(post, Camera())
    ride.drive(VelocityCommand(0.5, 0.0), 4.2)
    ride.drive(STOP, 1.0)
    assert abs(np.arctan2(0.55, 2.3 - ride.base.pose[0] - 0.35)) > np.pi / 6
    assert ride.drive(turn, 6.0).reason is MonitorReason.OBSTACLE
    assert ride.clearance_m > 0
    passing = Ride(np.array([[2.0, 0.0]]), Camera())
    passing.drive(FULL, 3.0)
    passing.drive(STOP, 1.0)
    assert passing.drive(FULL, 0.1).state is not MonitorState.FREE
    passing.points = NOTHING
    passing.drive(FULL, 0.3)
    assert passing.results[-1].state is MonitorState.FREE


def test_wheels_that_do_not_obey_stop_it_until_somebody_has_looked() -> None:
    monitor = CollisionMonitor(CHAIR)
    found_s = None
    for n in range(60):
        now_s = 0.05 * n
        monitor.add_reading(now_s, 0.0, 0.0)
        monitor.add_view(ALL_AROUND.view(NOTHING, np.zeros(3), now_s))
        if monitor.check(FULL, now_s, Status.TRACKING).reason is MonitorReason.WHEELS_OFF:
            found_s = found_s or now_s
    # The slowest base has 0.15 m/s after 0.3 s of lag and 0.6 s at half its acceleration; then 0.3 s.
    assert found_s == pytest.approx(1.25, abs=0.15)
    assert monitor.check(FULL, 2.95, Status.TRACKING).command == STOP
    monitor.clear_fault()
    assert monitor.check(FULL, 2.95, Status.TRACKING).state is MonitorState.FREE


def off_after_silence(measured_m_s: Callable[[float], float], seconds: float) -> bool:
    """Whether a base counts as off that drove at 0.8 m/s, and moves so for a time in which it is reported nothing."""
    check, found = WheelCheck(RobotLimits()), False
    for n in range(60):
        check.record(VelocityCommand(0.8, 0.0), 0.05 * n)
        found |= check.is_off(min(0.5 * 0.05 * n, 0.8), 0.0, 0.05 * n)
    assert not found
    for n in range(1, round(seconds / 0.05) + 1):
        found |= check.is_off(measured_m_s(0.05 * n), 0.0, 2.95 + 0.05 * n)
    return found


@pytest.mark.parametrize("kept_s", [0.2, 0.25])
def test_a_base_that_stopped_because_nothing_was_said_has_obeyed(kept_s: float) -> None:
    """A program that stood still for a second hears then what came meanwhile."""
    assert not off_after_silence(lambda after_s: max(0.8 - 1.5 * max(after_s - kept_s, 0.0), 0.0), 1.0)


def test_a_base_that_goes_on_though_nothing_is_said_is_found() -> None:
    assert off_after_silence(lambda after_s: 0.8, 2.5)


@pytest.mark.parametrize("fault", ["runs away", "one wheel hangs", "turns the wrong way"])
def test_a_base_that_does_something_else_is_found(fault: str) -> None:
    ride = Ride(NOTHING)
    ride.drive(VelocityCommand(0.5, 0.3), 3.0)
    v, w = {"runs away": (1.0, 0.3), "one wheel hangs": (0.25, 1.0), "turns the wrong way": (0.5, -0.3)}[fault]
    for n in range(20):
        ride.monitor.add_reading(ride.time_s + 0.05 * n, v, w)
        ride.monitor.add_view(ALL_AROUND.view(NOTHING, np.zeros(3), ride.time_s + 0.05 * n))
        result = ride.monitor.check(VelocityCommand(0.5, 0.3), ride.time_s + 0.05 * n, Status.TRACKING)
        if result.reason is MonitorReason.WHEELS_OFF:
            break
    assert result.reason is MonitorReason.WHEELS_OFF
    assert 0.25 <= 0.05 * n <= 0.5


@given(
    seed=st.integers(0, 10_000),
    lag_s=st.sampled_from([0.0, 0.1, 0.25]),
    every=st.sampled_from([1, 5, 20]),
)
def test_a_base_that_obeys_is_never_accused(seed: int, lag_s: float, every: int) -> None:
    rng, limits = np.random.default_rng(seed), RobotLimits()
    base, check = Unicycle((0.0, 0.0, 0.0), limits, lag_s), WheelCheck(limits)
    command = STOP
    for n in range(200):
        assert not check.is_off(base.forward_m_s, base.turn_rad_s, 0.05 * n)
        if n % every == 0:
            command = VelocityCommand(rng.uniform(-0.2, 1.0), rng.uniform(-1.0, 1.0))
        check.record(command, 0.05 * n)
        base.step(command)


def test_a_base_that_gains_speed_quickly_and_brakes_slowly_has_obeyed() -> None:
    """Reported 0.2 m/s at 0.95, it gives way 0.12 s later and by three quarters of what it might brake."""
    check = WheelCheck(RobotLimits())
    for n in range(150):
        now_s = 0.02 * n
        check.record(VelocityCommand(0.5 * now_s if now_s < 1.9 else 0.2, 0.0), now_s)
        braked_m_s = max(0.95 - 0.75 * max(now_s - 2.02, 0.0), 0.2)
        assert not check.is_off(min(0.5 * now_s, braked_m_s), 0.0, now_s)


@pytest.mark.slow
def test_no_one_who_asks_for_full_speed_hits_a_wall() -> None:
    """80 walls, at all distances and bearings, full speed along all curves; the camera is the chair's.

    Distance, bearing, speed and curve are a Latin hypercube: each has 80 values, one in each eightieth of its range.
    """
    monitor, results = CollisionMonitor(CHAIR), []
    drawn = qmc.scale(qmc.LatinHypercube(4, rng=8).random(80), (1.7, -0.6, 0.0, -0.6), (3.0, 0.6, 0.8, 0.6))
    for n, (distance_m, bearing_rad, forward_m_s, turn_rad_s) in enumerate(drawn.tolist()):
        points = wall(distance_m, bearing_rad)
        ride = Ride(points, Camera(), monitor)
        # After such a gap between readings the monitor begins again.
        ride.time_s, ride.base.forward_m_s = 100.0 * n, forward_m_s
        results.append(ride.drive(VelocityCommand(1.0, turn_rad_s), 3.0))
        ride.clearance_m = min(ride.clearance_m, clearance_m(CHAIR, ride.base.pose, points))
        assert ride.clearance_m > 0
    assert sum(result.state is not MonitorState.FREE for result in results) > 64


def test_speeds_of_a_ride_follow_from_what_was_commanded() -> None:
    """The test's own base keeps the limits that the monitor reckons with."""
    base, speeds = Unicycle((0.0, 0.0, 0.0), lag_s=0.0), [0.0]
    for n in range(60):
        base.step(FULL if n < 40 else STOP)
        speeds.append(base.forward_m_s)
    changes = [after - before for before, after in pairwise(speeds)]
    assert max(changes) == pytest.approx(0.5 * 0.05)
    assert min(changes) == pytest.approx(-1.0 * 0.05)


def test_a_view_that_is_no_array_of_numbers_is_refused() -> None:
    view = Camera().view(NOTHING, np.zeros(3), 0.0)
    assert view.is_sound
    for wrong in ({"seen_m": np.array([np.inf])}, {"points": np.zeros(3)}, {"step_rad": 0.0}, {"stamp_s": np.nan}):
        assert not replace(view, **wrong).is_sound
    assert view_of_points(0.0, [[1.0, 0.0]], (0.0, 0.0), 1.0, (0.2, 4.0)).seen_m.min() == 1.0
