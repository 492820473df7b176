"""A robot to command: it does what it is reported, shows it as recordings do, and truth judges it."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from narrowing import not_none

from wheelsight.core.errors import ArgumentError, ConfigError
from wheelsight.core.geometry import FloatArray, se3
from wheelsight.core.messages import STOP, Event, RgbdFrame, VelocityCommand, WheelTicks, YawRate
from wheelsight.core.robots import Robot as RobotProtocol
from wheelsight.core.robots import RobotLimits
from wheelsight.core.trajectory import Trajectory
from wheelsight_sim import (
    Drive,
    Renderer,
    RobotModel,
    SimulationSettings,
    Simulator,
    WheelFaults,
    camera_model,
    realism_of,
    stream,
)
from wheelsight_sim.body_motion import mounted

SETTINGS = SimulationSettings(world="square", size=(64, 48), rate_hz=10.0, seed=3, robot=RobotModel(has_gyro=True))
REAL = replace(SETTINGS, world="flat", realism="real", passersby=2, doors=1)
AHEAD, LEFT = VelocityCommand(0.5), VelocityCommand(0.0, 0.6)


def run(simulator: Simulator, command: VelocityCommand, seconds: float) -> list[Event]:
    steps = round(seconds / 0.05)
    return [event for _ in range(steps) for event in simulator.step(command)]


def check_same(one: Sequence[Event], other: Sequence[Event]) -> None:
    assert len(one) == len(other) > 0
    for a, b in zip(one, other, strict=True):
        if isinstance(a, RgbdFrame):
            assert isinstance(b, RgbdFrame)
            assert (a.stamp_s, a.index) == (b.stamp_s, b.index)
            np.testing.assert_array_equal(a.color, b.color)
            np.testing.assert_array_equal(a.depth_m, b.depth_m)
        else:
            assert a == b


def moved(T_before: FloatArray, T_after: FloatArray) -> tuple[float, float, float]:
    T = se3.compose(se3.invert(T_before), T_after)
    return float(T[0, 3]), float(T[1, 3]), math.atan2(T[1, 0], T[0, 0])


def test_it_is_a_robot() -> None:
    with Simulator(SETTINGS, has_camera=False) as simulator:
        assert isinstance(simulator, RobotProtocol)
        assert simulator.calibration.wheels == SETTINGS.robot.nominal
    with pytest.raises(ArgumentError, match="is closed"):
        simulator.step(STOP)


def test_equal_seeds_equal_events_to_the_last_bit() -> None:
    commands = [(AHEAD, 0.6), (VelocityCommand(0.3, 0.5), 0.6)]
    one, other = ([e for c, s in commands for e in run(made, c, s)] for made in (Simulator(REAL), Simulator(REAL)))
    check_same(one, other)
    assert {type(event) for event in one} == {RgbdFrame, WheelTicks, YawRate}
    third = Simulator(replace(REAL, seed=4))
    assert [event.stamp_s for event in run(third, AHEAD, 0.6)] != [e.stamp_s for e in one if e.stamp_s < 0.6]


def test_threads_make_no_difference() -> None:
    check_same(run(Simulator(REAL), AHEAD, 0.5), run(Simulator(REAL, threads=2), AHEAD, 0.5))


def test_reported_to_stand_it_stands() -> None:
    simulator = Simulator(REAL, has_camera=False)
    T_start = simulator.T_world_base
    ticks = [event for event in run(simulator, STOP, 5.0) if isinstance(event, WheelTicks)]
    assert len(ticks) >= 245
    x_m, y_m, yaw_rad = moved(T_start, simulator.T_world_base)
    assert math.hypot(x_m, y_m) < 0.002
    assert abs(yaw_rad) < 0.002
    assert (simulator.stop_reason, simulator.contact) == ("", None)


@pytest.mark.parametrize(("has_slip", "error_m", "error_rad"), [(False, 0.002, 0.004), (True, 0.01, 0.02)])
def test_a_metre_and_a_quarter_turn_are_what_wheels_say(has_slip: bool, error_m: float, error_rad: float) -> None:
    """Ideal wheels know their sizes; what is left of a way of 1 m is slip, of which tyres have a hundredth."""
    simulator = Simulator(replace(SETTINGS, has_slip=has_slip), has_camera=False)
    wheels = not_none(simulator.calibration.wheels)

    def drive(command: VelocityCommand, is_there) -> tuple[float, float]:
        """(way, turn) by the encoders."""
        first = last = next(event for event in simulator.step(STOP) if isinstance(event, WheelTicks))
        for _ in range(200):
            for event in simulator.step(STOP if is_there(*by(first, last)) else command):
                last = event if isinstance(event, WheelTicks) else last
        return by(first, last)

    def by(first: WheelTicks, last: WheelTicks) -> tuple[float, float]:
        left_m = wheels.left_m_per_tick * (last.left - first.left)
        right_m = wheels.right_m_per_tick * (last.right - first.right)
        return (left_m + right_m) / 2, (right_m - left_m) / wheels.track_width_m

    T_start = simulator.T_world_base
    way_m, _ = drive(AHEAD, lambda way_m, _: way_m > 0.8)
    assert way_m == pytest.approx(1.0, abs=0.15)
    x_m, y_m, _ = moved(T_start, simulator.T_world_base)
    assert x_m == pytest.approx(way_m, abs=error_m)
    assert abs(y_m) < 10 * error_m
    T_start = simulator.T_world_base
    _, turn_rad = drive(LEFT, lambda _, turn_rad: turn_rad > math.radians(75))
    assert turn_rad == pytest.approx(math.pi / 2, abs=0.15)
    assert moved(T_start, simulator.T_world_base)[2] == pytest.approx(turn_rad, abs=error_rad)


def test_events_come_in_the_order_of_stamps_and_none_is_missing() -> None:
    simulator = Simulator(REAL)
    events = run(simulator, AHEAD, 4.0)
    stamps_s = [event.stamp_s for event in events]
    assert stamps_s == sorted(stamps_s)
    assert stamps_s[-1] < simulator.time_s == pytest.approx(4.0)
    counted = {kind: sum(isinstance(event, kind) for event in events) for kind in (RgbdFrame, WheelTicks, YawRate)}
    assert 34 <= counted[RgbdFrame] <= 40  # one in fifty is lost, and others with it
    assert counted[WheelTicks] in range(195, 201)
    assert counted[YawRate] in range(390, 401)


def test_what_is_stamped_later_waits_for_a_frame() -> None:
    """Steps that end while a frame's rows are still read."""
    simulator = Simulator(replace(SETTINGS, rate_hz=15.0), period_s=0.005)
    stamps_s = [event.stamp_s for _ in range(80) for event in simulator.step(AHEAD)]
    assert stamps_s == sorted(stamps_s)
    assert len(stamps_s) > 50


def test_the_camera_is_mounted_as_that_of_recorded_drives() -> None:
    simulator = Simulator(replace(REAL, passersby=0, doors=0))
    run(simulator, STOP, 1.0)
    realism = not_none(realism_of("real"))
    mount = mounted(REAL.robot.T_base_camera, realism.mount, stream(REAL.seed, "mount"))
    off = se3.log(se3.compose(se3.invert(simulator.T_world_base @ mount), simulator.T_world_camera))
    assert np.abs(off).max() < 1e-3  # of the body on its springs
    assert np.abs(se3.log(se3.compose(se3.invert(REAL.robot.T_base_camera), mount))).max() > 3e-3


def test_frames_are_those_of_a_recorded_drive_along_the_same_way() -> None:
    settings = replace(SETTINGS, has_motion_blur=True)
    simulator = Simulator(settings, period_s=0.005)
    poses, frames = [], []
    for _ in range(200):
        poses.append(simulator.T_world_base)
        frames += [e for e in simulator.step(VelocityCommand(0.6, 0.5)) if isinstance(e, RgbdFrame)]
    drive = Drive(Trajectory(0.005 * np.arange(200.0), np.array(poses), body="base"), ())
    recorded = Renderer(simulator.world, drive, settings, camera_model(settings.camera, settings.size))
    check_same(frames, [recorded.frame(index) for index in range(len(frames))])
    assert len(frames) == 10
    np.testing.assert_array_equal(simulator.calibration.color, recorded.calibration.color)


def test_a_covered_camera_sees_nothing() -> None:
    settings = replace(SETTINGS, covered_s=((0.45, 0.75),))
    frames = [event for event in run(Simulator(settings), STOP, 1.2) if isinstance(event, RgbdFrame)]
    is_blind = [not frame.depth_m.any() for frame in frames]
    assert is_blind == [0.45 <= frame.stamp_s < 0.75 for frame in frames]
    assert sum(is_blind) == 3


def test_speeds_keep_the_limits() -> None:
    limits = RobotLimits(forward_m_s=0.4, turn_rad_s=0.5, acceleration_m_s2=0.3, braking_m_s2=0.6)
    simulator = Simulator(SETTINGS, limits=limits, has_camera=False)
    poses = []
    for command in [VelocityCommand(2.0, 0.0)] * 50 + [STOP] * 30:
        simulator.step(command)
        poses.append(simulator.T_world_base[:2, 3])
    speeds_m_s = np.hypot(*np.diff(poses, axis=0).T) / 0.05
    assert speeds_m_s[30:48].mean() == pytest.approx(0.4, abs=0.01)
    assert speeds_m_s.max() < 0.44
    smooth = np.convolve(speeds_m_s, np.ones(4) / 4, "valid")
    rates_m_s2 = np.diff(smooth) / 0.05
    assert rates_m_s2.max() < 0.3 * 1.35  # motors that lag catch up
    assert rates_m_s2.min() > -0.6 * 1.35
    assert speeds_m_s[-1] < 0.005


def test_a_robot_that_may_not_drive_stands() -> None:
    nothing = RobotLimits(forward_m_s=0, backward_m_s=0, turn_rad_s=0)
    simulator = Simulator(SETTINGS, limits=nothing, has_camera=False)
    T_start = simulator.T_world_base
    run(simulator, VelocityCommand(1.0, 1.0), 2.0)
    assert np.abs(moved(T_start, simulator.T_world_base)).max() < 0.002


def test_driven_into_a_wall_it_stops_and_says_so() -> None:
    simulator = Simulator(replace(SETTINGS, world="flat"), has_camera=False)
    run(simulator, VelocityCommand(1.0), 12.0)
    contact = simulator.contacts[0]
    assert contact.is_by_robot
    assert contact.robot_m_s > 0.2
    assert simulator.clearance_m() < 0.01
    assert "is blocked" in simulator.stop_reason
    T_there = simulator.T_world_base
    run(simulator, VelocityCommand(-0.2), 2.0)  # not before it was commanded to stand
    assert abs(moved(T_there, simulator.T_world_base)[0]) < 0.01
    run(simulator, STOP, 0.5)
    assert simulator.stop_reason == ""
    run(simulator, VelocityCommand(-0.2), 2.0)
    assert moved(T_there, simulator.T_world_base)[0] < -0.15


def test_without_wheel_readings_it_stops() -> None:
    faults = WheelFaults(dropouts_s=((3.0, 4.5),))
    simulator = Simulator(replace(SETTINGS, faults=faults), has_camera=False)
    run(simulator, AHEAD, 3.0)
    T_silent = simulator.T_world_base
    run(simulator, AHEAD, 1.5)
    assert simulator.stop_reason == "no wheel readings come"
    assert 0.05 < moved(T_silent, simulator.T_world_base)[0] < 0.35  # 0.15 s on, and braking from 0.5 m/s
    T_stands = simulator.T_world_base
    run(simulator, AHEAD, 1.0)  # they come again, and no one has let go
    assert moved(T_stands, simulator.T_world_base)[0] < 0.01


def test_an_encoder_that_is_out_is_found() -> None:
    faults = WheelFaults(unplugged_s=((3.0, 60.0),))
    simulator = Simulator(replace(SETTINGS, faults=faults), has_camera=False)
    run(simulator, AHEAD, 3.0)
    T_out = simulator.T_world_base
    run(simulator, AHEAD, 3.0)
    assert "is blocked: command 0.50 m/s, encoder 0.00" in simulator.stop_reason
    assert moved(T_out, simulator.T_world_base)[0] < 0.4


def test_stop_keeps_no_limits() -> None:
    stopped, gentle = Simulator(SETTINGS, has_camera=False), RobotLimits(braking_m_s2=0.1)
    braked = Simulator(SETTINGS, limits=gentle, has_camera=False)
    ways_m = []
    for simulator in (stopped, braked):
        run(simulator, AHEAD, 3.0)
        T = simulator.T_world_base
        if simulator is stopped:
            simulator.stop()
            run(simulator, AHEAD, 0.5)
            assert simulator.stop_reason == "it was stopped"
        run(simulator, STOP, 2.0)
        ways_m.append(moved(T, simulator.T_world_base)[0])
    assert ways_m[0] < 0.2
    assert ways_m[1] > 0.5


def test_what_cannot_be_is_refused() -> None:
    for period_s in (0.0, 0.007, 10.0, math.nan):
        with pytest.raises(ConfigError, match="period_s"):
            Simulator(SETTINGS, period_s=period_s)
    x, y = Simulator(SETTINGS, has_camera=False).world.size_m[:2]
    with pytest.raises(ConfigError, match="something stands there"):
        Simulator(SETTINGS, start=(x, y, 0.0))
    with pytest.raises(ConfigError, match="cannot begin"):
        Simulator(SETTINGS, start=(math.nan, 0.0, 0.0))


def test_the_example_of_the_docs_runs(project_folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    page = (project_folder / "docs" / "simulation.md").read_text(encoding="utf-8")
    section = page[page.index("## A robot to command") :]
    exec(re.findall(r"^```python\n(.*?)^```", section, re.MULTILINE | re.DOTALL)[0], {})
    assert "obeys ()" in capsys.readouterr().out
