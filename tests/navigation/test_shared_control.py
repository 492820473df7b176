"""A person steers, and the robot helps: what it may change, what it never does, and that it says why."""

from __future__ import annotations

import itertools
import math

import numpy as np
import pytest

from benchmarks.assist import run_door
from benchmarks.plain_rooms import RoomRobot, Walls, walls_about
from wheelsight.core.messages import StickPosition
from wheelsight.navigation import MonitorReason, MonitorState, NavigationSettings
from wheelsight.navigation.clearance_kernels import all_outside_m, can_pass, clear_share, moved
from wheelsight.navigation.settings import outline_of
from wheelsight.navigation.shared_control import (
    MOST_ADDED_RAD_S,
    OVERRIDE_HELD_S,
    OVERRIDE_M_S,
    OVERRIDE_S,
    STICK_AGE_S,
    Assist,
    AssistFeedback,
    AssistLevel,
)

SETTINGS = NavigationSettings()


class Seat:
    """A chair in a room of 8 m by 6 m, and the stick in it."""

    def __init__(
        self, level: AssistLevel = AssistLevel.STEER, pose: tuple[float, float, float] = (1.5, 3.0, 0.0)
    ) -> None:
        self.walls = Walls.of(*walls_about(8.0, 6.0))
        self.robot = RoomRobot(self.walls, pose)
        self.assist = Assist(self.robot, SETTINGS, level)
        self.closest_m = math.inf

    def hold(self, seconds: float, forward: float, left: float = 0.0, *, button: bool = False) -> list[AssistFeedback]:
        """Hold the stick at a position, sent in each period."""
        found = []
        for _ in range(round(seconds / 0.05)):
            self.assist.move(StickPosition(self.robot.now_s, forward, left, button))
            found.append(self.step())
        return found

    def step(self) -> AssistFeedback:
        feedback = self.assist.step()
        outline = SETTINGS.footprint.outline.at(self.robot.base.pose)
        self.closest_m = min(self.closest_m, self.walls.clearance_m(outline))
        return feedback


@pytest.mark.parametrize("level", AssistLevel)
def test_a_stick_that_is_released_moves_nothing(level: AssistLevel) -> None:
    seat = Seat(level)
    assert all(feedback.command.is_stop for feedback in seat.hold(2.0, 0.0))
    assert seat.robot.base.stands


@pytest.mark.parametrize("level", AssistLevel)
def test_a_stick_that_sends_nothing_stops_the_robot(level: AssistLevel) -> None:
    seat = Seat(level)
    assert seat.hold(1.5, 0.4)[-1].intended.forward_m_s > 0
    silent = [seat.step() for _ in range(round((STICK_AGE_S + 0.1) / 0.05))]
    assert silent[-1].intended.is_stop
    for _ in range(30):
        seat.step()
    assert seat.robot.base.stands


@pytest.mark.parametrize("wrong", [math.nan, math.inf, 1.5])
def test_a_position_that_is_not_sound_counts_as_let_go(wrong: float) -> None:
    seat = Seat()
    seat.hold(0.5, 0.4)
    seat.assist.move(StickPosition(seat.robot.now_s, wrong, 0.0))
    assert seat.step().intended.is_stop


@pytest.mark.parametrize("level", [AssistLevel.STOP, AssistLevel.SLOW, AssistLevel.STEER])
def test_full_stick_at_a_wall_touches_nothing_and_says_why(level: AssistLevel) -> None:
    seat = Seat(level, (5.0, 3.0, 0.0))
    said = seat.hold(8.0, 1.0)
    assert seat.closest_m > 0.02
    if level is AssistLevel.STEER:  # along the wall
        assert any("steers" in feedback.words for feedback in said)
        return
    assert said[-1].command.is_stop
    assert str(MonitorReason.OBSTACLE) in said[-1].words or str(MonitorReason.NEAR) in said[-1].words


def test_without_help_the_same_touches_the_wall() -> None:
    seat = Seat(AssistLevel.OFF, (6.0, 3.0, 0.0))
    seat.hold(4.0, 0.5)
    assert seat.closest_m < 0.01


def test_one_who_only_stops_is_never_slowed_for_a_thing_ahead() -> None:
    seat = Seat(AssistLevel.STOP, (5.0, 3.0, 0.0))
    for feedback in seat.hold(8.0, 0.3):
        is_slowed = feedback.monitor.state is MonitorState.SLOWED
        assert not (is_slowed and feedback.monitor.reason in (MonitorReason.OBSTACLE, MonitorReason.NEVER_SEEN))
        assert feedback.monitor.reason is not MonitorReason.WHEELS_OFF


def test_help_never_adds_speed_and_bounds_the_turn() -> None:
    rng = np.random.default_rng(4)
    seat = Seat(pose=(4.0, 1.0, 0.6))
    for _ in range(12):
        for feedback in seat.hold(0.5, float(rng.uniform(-0.5, 0.8)), float(rng.uniform(-0.6, 0.6))):
            assert abs(feedback.added_rad_s) <= MOST_ADDED_RAD_S + 1e-9
            if feedback.intended.forward_m_s <= 0:
                assert feedback.added_rad_s == 0
    assert seat.closest_m > 0.02


def test_in_a_free_room_nothing_is_changed() -> None:
    seat = Seat(pose=(2.0, 3.0, 0.0))
    seat.hold(0.2, 0.0)  # the first image comes
    seat.hold(3.0, 0.3)
    assert seat.assist.record.changed == 0
    assert seat.assist.record.periods == 60


def test_full_control_begins_after_a_second_ends_in_time_and_is_slow() -> None:
    seat = Seat(pose=(1.5, 3.0, 0.0))
    found = seat.hold(OVERRIDE_HELD_S + OVERRIDE_S + 1.0, 0.05, button=True)
    driven = [feedback for feedback in found if feedback.override_s > 0]
    assert len(driven) == pytest.approx(OVERRIDE_S / 0.05, abs=2)
    assert found[round(OVERRIDE_HELD_S / 0.05) - 3].override_s == 0
    assert found[-1].override_s == 0
    assert "full control" in driven[0].words
    assert seat.assist.record.overrides == 1


def test_full_control_is_limited_in_speed_and_passes_the_monitor() -> None:
    seat = Seat(pose=(6.9, 3.0, 0.0))
    seat.hold(3.0, 0.5)
    assert seat.robot.base.stands
    before_m = seat.closest_m
    found = seat.hold(2.0, 1.0, button=True)
    assert max(feedback.command.forward_m_s for feedback in found) <= OVERRIDE_M_S + 1e-9
    assert seat.closest_m < before_m - 0.02


def test_a_way_of_two_arcs_is_found_where_one_arc_meets_a_wall_and_none_where_there_is_no_gap() -> None:
    sides = outline_of(SETTINGS.footprint.outline).sides
    bends = np.array([0.0, -0.3, 0.3])
    # A gap of 0.9 m, 0.15 m to the left of the way, from 1.6 m ahead on.
    posts = np.array([(x, y) for x in np.arange(1.6, 2.4, 0.05) for y in (-0.3, 0.6)])
    assert clear_share(sides, posts, (1.4, 0.0), 28, 0.05) < 1.0
    assert can_pass(sides, posts, 0.7, 14, bends, 0.05)
    assert not can_pass(sides, posts, 0.7, 14, bends[:1], 0.05)
    wall = np.array([(1.2, y) for y in np.arange(-1.5, 1.5, 0.05)])
    assert not can_pass(sides, wall, 0.7, 14, bends, 0.05)
    # The plain form: all pairs of arcs, each pose of theirs checked by the outline's distance.
    assert can_pass(sides, posts, 0.7, 14, bends, 0.05) == any(
        _passes(sides, posts, 0.7, pair, 0.05) for pair in itertools.product(bends, bends)
    )


def _passes(sides: np.ndarray, points: np.ndarray, length_m: float, pair: tuple[float, float], margin_m: float) -> bool:
    pose = (0.0, 0.0, 1.0, 0.0)
    for bend in pair:
        for n in range(1, 15):
            x, y, c, s = moved(pose, length_m * n / 14, bend * length_m * n / 14)
            seen = (points - (x, y)) @ np.array([[c, -s], [s, c]])
            if all_outside_m(sides, seen).min() < margin_m:
                return False
        pose = moved(pose, length_m, bend * length_m)
    return True


@pytest.mark.slow
def test_a_driver_who_needs_no_help_is_hardly_changed() -> None:
    run = run_door("perfect", 0.85, AssistLevel.STEER, 6)
    assert run.is_through
    assert not run.has_contact
    assert run.changed < 0.05


@pytest.mark.slow
@pytest.mark.parametrize("seed", [0, 1])
def test_a_driver_who_keeps_to_one_side_comes_through_a_door_by_help_alone(seed: int) -> None:
    alone = run_door("bias", 0.85, AssistLevel.OFF, seed)
    helped = run_door("bias", 0.85, AssistLevel.STEER, seed)
    assert alone.has_contact
    assert helped.is_through
    assert not helped.has_contact
