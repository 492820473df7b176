"""A simulated robot whose wheels are driven through the compiled firmware: its way, its faults, and a drive by it."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
import pytest

from firmware.simulation.hardware_robot import FaultKind, HardwareFault, HardwareRobot
from wheelsight.core.errors import ConfigError
from wheelsight.core.messages import STOP, Event, VelocityCommand, WheelTicks
from wheelsight_sim import SimulationSettings

AHEAD = VelocityCommand(0.5, 0.0)
Make = Callable[..., HardwareRobot]


@pytest.fixture
def make(request: pytest.FixtureRequest) -> Make:
    """Makes a robot in an empty hall; skips, or fails in CI, where compilers are missing."""

    def made(hardware: str = "atmega8", faults: Sequence[HardwareFault] = ()) -> HardwareRobot:
        request.getfixturevalue("built" if hardware == "atmega8" else "built_stm32")
        settings = SimulationSettings("square", realism="ideal", has_slip=False)
        return HardwareRobot(hardware, settings, faults=faults, has_camera=False)

    return made


def run(robot: HardwareRobot, command: VelocityCommand, seconds: float) -> list[Event]:
    return [event for _ in range(round(seconds / 0.05)) for event in robot.step(command)]


def way_m(robot: HardwareRobot, command: VelocityCommand, seconds: float) -> float:
    begin = robot.T_world_base[:2, 3]
    run(robot, command, seconds)
    return float(np.hypot(*(robot.T_world_base[:2, 3] - begin)))


@pytest.mark.slow
@pytest.mark.parametrize("hardware", ["atmega8", "stm32"])
def test_commands_reach_the_wheels_and_their_edges_come_back(make: Make, hardware: str) -> None:
    with make(hardware) as robot:
        events = run(robot, AHEAD, 3.0) + run(robot, STOP, 1.5)
        ticks = [event for event in events if isinstance(event, WheelTicks)]
        wheels = robot.calibration.wheels
        assert wheels is not None
        # The chip counts a step of the shaft where the true wheel made it.
        counted_rad = 2 * np.pi * np.array([ticks[-1].left, ticks[-1].right]) / wheels.ticks_per_turn
        assert np.abs(counted_rad - robot.wheels_rad).max() < 4 * np.pi / wheels.ticks_per_turn
        assert robot.wheels_rad.min() * 0.17 > 1.0
        assert np.diff([one.stamp_s for one in ticks[10:]]) == pytest.approx(0.02, abs=0.003)
        assert robot.stop_reason == ""
        assert max(map(abs, robot.duties)) < 0.01


@pytest.mark.slow
def test_equal_commands_give_equal_events(make: Make) -> None:
    with make() as one, make() as other:
        first, second = run(one, AHEAD, 0.7), run(other, AHEAD, 0.7)
    assert len(first) > 20
    assert first == second


@pytest.mark.slow
@pytest.mark.parametrize(
    ("kind", "lasts_s", "said"),
    [
        ("line cut", np.inf, "no wheel readings come"),
        ("host frozen", 1.0, "the program stood still"),
        ("chip reset", np.inf, "the wheel controller restarted"),
        ("encoder dead", np.inf, "the left wheel is blocked"),
    ],
)
def test_a_fault_stops_the_motors_and_is_named(make: Make, kind: FaultKind, lasts_s: float, said: str) -> None:
    with make(faults=[HardwareFault(kind, 1.7, 1.7 + lasts_s)]) as robot:
        run(robot, AHEAD, 1.5)
        assert robot.stop_reason == ""
        assert min(robot.duties) > 0.1
        # The firmware's quarter of a second at 0.4 m/s, or the control's time for a fault, and then the motors' lag.
        assert way_m(robot, AHEAD, 1.7) < 0.4
        assert robot.stop_reason.startswith(said)
        assert max(map(abs, robot.duties)) < 0.01


@pytest.mark.slow
def test_damaged_bytes_do_not_move_the_robot_otherwise(make: Make) -> None:
    with make() as sound, make(faults=[HardwareFault("bytes lost", 1.0, 1.4)]) as damaged:
        ways = [way_m(robot, AHEAD, 2.0) for robot in (sound, damaged)]
        assert damaged.link.report().line.lost > 0
    assert ways[1] == pytest.approx(ways[0], abs=0.1)


def test_an_unknown_chip_and_an_impossible_fault_are_refused() -> None:
    with pytest.raises(ConfigError, match="--hardware is 'z80'"):
        HardwareRobot("z80", SimulationSettings("square"))
    with pytest.raises(ConfigError, match="a fault of hardware is 'rust'"):
        HardwareFault("rust", 0.0)  # type: ignore[arg-type]
    with pytest.raises(ConfigError, match="begin, end or wheel wrong"):
        HardwareFault("line cut", 2.0, 1.0)
