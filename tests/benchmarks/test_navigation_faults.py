"""Faults are drawn evenly, break what they say, and are judged by the way that braking takes."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from narrowing import not_none

from benchmarks import navigation_faults
from benchmarks.box_worlds import Box
from benchmarks.fault_drives import FaultDrive, braking_way_m, is_free_to_stop, map_of
from benchmarks.fault_robot import STALL_S, WATCHDOG_S, Fault, FaultKind, FaultyRobot, Leader, drawn
from wheelsight.core.messages import RgbdFrame, VelocityCommand, WheelTicks
from wheelsight.core.robots import RobotLimits
from wheelsight.mapping import CellKind
from wheelsight.navigation import NavigationSettings

AHEAD = VelocityCommand(0.8, 0.0)
STOOD = FaultDrive(0, "camera covered", "straight on", 1.0, 2.0, True, (), 0.0, 0.25, 0.8, "no fresh depth frame")


def broken(kind: FaultKind, at_s: float = 1.0) -> FaultyRobot:
    fault = Fault(0, kind, Leader.STRAIGHT_ON, at_s, 8.0, None, (0.0, 0.0, 0.0))
    return FaultyRobot.of(fault, 1, RobotLimits())


def test_kinds_take_turns_and_draws_are_by_the_seed() -> None:
    faults = [drawn(number, 1) for number in range(70)]
    assert {kind: [one.kind for one in faults].count(kind) for kind in FaultKind} == dict.fromkeys(FaultKind, 10)
    assert faults == [drawn(number, 1) for number in range(70)]
    assert faults != [drawn(number, 2) for number in range(70)]
    assert {one.leader for one in faults if one.kind is FaultKind.MAP} == {Leader.NAVIGATOR}
    assert all(one.thing is not None for one in faults if one.leader is Leader.NAVIGATOR)
    assert all(any(one.map_off) == (one.kind is FaultKind.MAP) for one in faults)
    assert all(0.3 <= one.away_m <= 3.0 for one in faults)


def test_silent_frames_are_silent_and_wheels_go_on() -> None:
    with broken(FaultKind.FRAMES) as robot:
        events = [event for _ in range(40) for event in robot.step(VelocityCommand())]
    assert max(event.stamp_s for event in events if isinstance(event, RgbdFrame)) < 1.0
    assert max(event.stamp_s for event in events if isinstance(event, WheelTicks)) > 1.8


def test_silent_encoders_are_silent_and_frames_go_on() -> None:
    with broken(FaultKind.ENCODERS) as robot:
        events = [event for _ in range(40) for event in robot.step(VelocityCommand())]
    assert max(event.stamp_s for event in events if isinstance(event, WheelTicks)) < 1.1
    assert max(event.stamp_s for event in events if isinstance(event, RgbdFrame)) > 1.7


def test_a_lost_command_leaves_the_last_one_until_the_watchdog() -> None:
    with broken(FaultKind.COMMAND, at_s=2.0) as robot:
        ways = []
        for _ in range(90):
            before = robot.simulator.T_world_base[0, 3]
            robot.step(AHEAD if robot.now_s < 2.0 else VelocityCommand())
            ways.append((robot.now_s, robot.simulator.T_world_base[0, 3] - before))
        speeds = [(now_s, way_m / 0.05) for now_s, way_m in ways]
        assert min(speed for now_s, speed in speeds if 2.0 < now_s < 2.0 + WATCHDOG_S) > 0.7
        assert speeds[-1][1] == pytest.approx(0.0, abs=0.02)
        assert robot.blind_m == pytest.approx(0.78 * WATCHDOG_S, rel=0.05)
        assert robot.stopped_m > robot.blind_m


def test_a_stalled_program_hears_late_what_came_and_has_not_reported_anything() -> None:
    with broken(FaultKind.STALLED, at_s=2.0) as robot:
        while robot.now_s < 2.0 - 1e-9:
            robot.step(AHEAD)
        events = robot.step(VelocityCommand())
        assert robot.now_s == pytest.approx(2.0 + STALL_S)
        assert len({type(event) for event in events}) > 1
        assert 0.17 < robot.blind_m < 0.23
        blind_m = robot.blind_m
        for _ in range(10):
            robot.step(AHEAD)
        assert robot.blind_m == blind_m


def test_braking_way_is_reaction_and_a_parabola() -> None:
    assert braking_way_m(1.0, 0.3, RobotLimits(braking_m_s2=1.0), 0.8) == pytest.approx(0.3 + 0.625)
    assert braking_way_m(0.0, 0.3, RobotLimits(), 0.8) == 0.0


def test_who_is_too_near_or_passes_by() -> None:
    settings = NavigationSettings()
    footprint = settings.footprint.outline
    near_m = 0.8 + 0.9
    for x_m, y_m, is_free in ((near_m, 0.0, False), (near_m + 0.1, 0.0, True), (near_m, 0.5, True)):
        thing = Box(x_m + 0.1, y_m, 0.2, 0.2, 1.0).corners_m
        assert is_free_to_stop(footprint, np.zeros(3), 1.0, settings, thing) is is_free
        turned = Box(-y_m, x_m + 0.1, 0.2, 0.2, 1.0).corners_m
        assert is_free_to_stop(footprint, np.array([0, 0, np.pi / 2]), 1.0, settings, turned) is is_free


def test_the_map_knows_neither_thing_nor_end_and_a_wrong_one_lies_elsewhere() -> None:
    fault = next(one for one in (drawn(n, 1) for n in range(70)) if one.kind is FaultKind.MAP)
    right = map_of(replace(fault, map_off=(0.0, 0.0, 0.0)))
    thing = not_none(fault.thing)
    assert right.kind_at([thing.x_m, thing.y_m]) == CellKind.FREE
    assert right.kind_at([-1.55, 0.0]) == CellKind.OBSTACLE
    x, y, yaw = fault.map_off
    c, s = np.cos(yaw), np.sin(yaw)
    for place, kind in (
        ((-1.55, 0.0), CellKind.OBSTACLE),
        ((0.0, 2.4), CellKind.FREE),
        ((0.0, 2.55), CellKind.OBSTACLE),
    ):
        moved = (c * place[0] - s * place[1] + x, s * place[0] + c * place[1] + y)
        assert map_of(fault).kind_at(moved) == kind


def test_rows_and_targets_count() -> None:
    drives = [
        STOOD,
        replace(STOOD, blind_m=0.35, stopped_m=1.0),
        replace(STOOD, contacts=("box9",), could_stop=False, forward_m_s=0.5),
        replace(STOOD, kind="map wrong", contacts=("box9",)),
    ]
    sheet, targets, wrong = navigation_faults.sheets_of(drives)
    assert sheet.rows[0] == ("camera covered", "3", "2", "2", "0", "0.25", "0.35", "1.00", "1")
    assert sheet.rows[1][:5] == ("map wrong", "1", "1", "0", "1")
    assert [target.measured for target in navigation_faults.targets_of(drives)] == [1, 1]
    assert len(wrong.rows) == 3
    assert len(targets.rows) == 2
