"""A simulated robot with one fault, and what is drawn about it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from enum import StrEnum
from types import TracebackType

import numpy as np

from benchmarks.box_worlds import Box, hall
from wheelsight.core.calibration import Calibration
from wheelsight.core.messages import STOP, Event, RgbdFrame, VelocityCommand
from wheelsight.core.robots import RobotLimits
from wheelsight_sim import SimulationSettings, Simulator, WheelFaults, World
from wheelsight_sim.simulator import PERIOD_S

WATCHDOG_S, STALL_S = 0.25, 1.0
"""The firmware takes the motors' voltage after so long without a command (docs/serial-link.md); a stall, issue 32."""
FRONT_M = 0.8
FINE_S = 0.01
"""The simulator is stepped so, since a watchdog does not wait for the end of a control period."""
STRAIGHT_ON_FROM_S = 1.0
"""Who goes straight on waits so long, until the localization tracks; a navigator knows that by itself."""
_FOREVER_S = 1000.0
# By its ramp a chair has its full speed 2.4 s after it was asked for it, 1.1 m on.
_FULL_S, _FULL_M = 2.4, 1.1
_SIDE_M, _BEHIND_M, _BEYOND_M = 2.5, 1.5, 6.0


class FaultKind(StrEnum):
    """What goes wrong."""

    COVERED = "camera covered"
    FRAMES = "frames silent"
    ENCODERS = "encoders silent"
    COMMAND = "command lost"
    STALLED = "process stalled 1 s"
    LIFTED = "wheel lifted"
    MAP = "map wrong"


BLIND = (FaultKind.COVERED, FaultKind.FRAMES, FaultKind.ENCODERS, FaultKind.COMMAND, FaultKind.STALLED)
"""Those in which something is not known, or not reported, that is needed to drive."""


class Leader(StrEnum):
    """Who asks for speed."""

    STRAIGHT_ON = "straight on"
    NAVIGATOR = "navigator"


@dataclass(frozen=True)
class Fault:
    """One, and where it happens. The robot begins at the origin and heads along x.

    Attributes:
        number: of it.
        kind: of it.
        leader: who drives.
        at_s: when it begins.
        away_m: from the robot's front to the thing then, of a robot that went straight on.
        thing: what stands in the way; None for the hall's end.
        map_off: x, y, yaw by which a wrong map lies elsewhere; zeros of any other.
    """

    number: int
    kind: FaultKind
    leader: Leader
    at_s: float
    away_m: float
    thing: Box | None
    map_off: tuple[float, float, float]

    @property
    def thing_x_m(self) -> float:
        """Where it begins."""
        full_s = _FULL_S + (STRAIGHT_ON_FROM_S if self.leader is Leader.STRAIGHT_ON else 0.0)
        return FRONT_M + _FULL_M + (self.at_s - full_s) + self.away_m

    @property
    def size_m(self) -> tuple[float, float, float, float]:
        """Of the hall."""
        end_m = self.thing_x_m + (0.0 if self.thing is None else _BEYOND_M)
        return (-_BEHIND_M, -_SIDE_M, end_m, _SIDE_M)

    @property
    def mapped_m(self) -> tuple[float, float, float, float]:
        """Of the hall as the map has it, which knows neither thing nor end."""
        return (*self.size_m[:2], self.thing_x_m + _BEYOND_M, self.size_m[3])

    @property
    def goal(self) -> tuple[float, float, float]:
        """Behind the thing."""
        return (self.thing_x_m + 3.0, 0.0, 0.0)

    @property
    def in_the_way(self) -> Box:
        """The thing, or the hall's end as one."""
        if self.thing is not None:
            return self.thing
        return Box(self.thing_x_m + 0.1, 0.0, 0.2, 2 * _SIDE_M, 2.8)

    def world(self) -> World:
        """The hall."""
        return hall(f"fault {self.number}", self.size_m, [] if self.thing is None else [self.thing], self.number)

    def settings(self, seed: int) -> SimulationSettings:
        """Of the simulator, with those faults that are of its sensors and wheels."""
        during = ((self.at_s, _FOREVER_S),)
        wheels = {FaultKind.LIFTED: WheelFaults(lifted_s=during), FaultKind.ENCODERS: WheelFaults(dropouts_s=during)}
        return SimulationSettings(
            size=(320, 240),
            rate_hz=10.0,
            seed=seed,
            day=1 + self.number,
            realism="real",
            faults=wheels.get(self.kind, WheelFaults()),
            covered_s=during if self.kind is FaultKind.COVERED else (),
        )


def drawn(number: int, seed: int) -> Fault:
    """The kinds take turns, so that each comes as often; all else is by the seed.

    A navigator sees a wall that no way leads round before it has its full speed, so that only things are in its way.
    """
    rng, kinds = np.random.default_rng([seed, number]), list(FaultKind)
    kind = kinds[number % len(kinds)]
    leader = Leader.NAVIGATOR if kind is FaultKind.MAP or rng.random() < 0.5 else Leader.STRAIGHT_ON
    is_wall = leader is Leader.STRAIGHT_ON and rng.random() < 0.5
    after_s = _FULL_S + (STRAIGHT_ON_FROM_S if leader is Leader.STRAIGHT_ON else 0.0)
    at_s, away_m = after_s + float(rng.uniform(0.2, 1.2)), float(rng.uniform(0.3, 3.0))
    off = (rng.uniform(-1, 1, 3) * (0.5, 1.0, 0.2)).tolist() if kind is FaultKind.MAP else [0.0, 0.0, 0.0]
    fault = Fault(number, kind, leader, at_s, away_m, None, (off[0], off[1], off[2]))
    if is_wall:
        return fault
    length_m, width_m, height_m = (float(rng.uniform(*bounds)) for bounds in ((0.2, 0.6), (0.2, 0.8), (0.4, 1.6)))
    thing = Box(fault.thing_x_m + length_m / 2, float(rng.uniform(-0.4, 0.4)), length_m, width_m, height_m)
    return replace(fault, thing=thing)


class FaultyRobot:
    """A `Robot`: the simulator, and what comes between it and the program that leads it.

    A lost command and a stalled program leave the motors as they are, until the controller's watchdog takes their
    voltage.

    Args:
        simulator: of the fault's world and settings.
        fault: that it has.

    Attributes:
        blind_m: way driven, by the truth, since the fault began, while the motors were not reported to stand; of kinds
            that are blind, and while they are.
        stopped_m: the same until it stood at first.
    """

    def __init__(self, simulator: Simulator, fault: Fault) -> None:
        self.simulator, self.fault = simulator, fault
        self.blind_m = self.stopped_m = 0.0
        self._obeyed, self._is_cut, self._has_stalled, self._has_stood = STOP, False, False, False

    @classmethod
    def of(cls, fault: Fault, seed: int, limits: RobotLimits) -> FaultyRobot:
        """In its world."""
        simulator = Simulator(
            fault.settings(seed), world=fault.world(), start=(0.0, 0.0, 0.0), limits=limits, period_s=FINE_S
        )
        return cls(simulator, fault)

    @property
    def calibration(self) -> Calibration:
        """As `Robot` has it."""
        return self.simulator.calibration

    @property
    def stop_reason(self) -> str:
        """As `Robot` has it."""
        return self.simulator.stop_reason

    @property
    def now_s(self) -> float:
        """As `Robot` has it."""
        return self.simulator.now_s

    def step(self, command: VelocityCommand) -> list[Event]:
        """As `Robot` has it; of a stalled program, all that came meanwhile."""
        kind, at_s = self.fault.kind, self.fault.at_s
        if kind is FaultKind.STALLED and self.now_s >= at_s and not self._has_stalled:
            self._has_stalled = True
            return [event for _ in range(round(STALL_S / PERIOD_S)) for event in self._unreported()]
        if kind is FaultKind.COMMAND and self.now_s >= at_s:
            return self._unreported()
        self._obeyed = command
        return self._heard(self._moved(command))

    def stop(self) -> None:
        """As `Robot` has it."""
        self.simulator.stop()

    def close(self) -> None:
        """As `Robot` has it."""
        self.simulator.close()

    def __enter__(self) -> FaultyRobot:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def _unreported(self) -> list[Event]:
        """A period in which no command arrives."""
        return self._moved(self._obeyed, is_reported=False)

    def _heard(self, events: Sequence[Event]) -> list[Event]:
        """What arrives of it."""
        if self.fault.kind is not FaultKind.FRAMES:
            return list(events)
        return [event for event in events if not (isinstance(event, RgbdFrame) and event.stamp_s >= self.fault.at_s)]

    def _moved(self, command: VelocityCommand, is_reported: bool = True) -> list[Event]:
        """A control period, in the simulator's finer steps."""
        return [event for _ in range(round(PERIOD_S / FINE_S)) for event in self._moved_a_little(command, is_reported)]

    def _moved_a_little(self, command: VelocityCommand, is_reported: bool) -> list[Event]:
        if not (is_reported or self._is_cut) and self.now_s >= self.fault.at_s + WATCHDOG_S - 1e-9:
            self._is_cut = True
            self.simulator.stop()
        is_braked = command.is_stop or bool(self.simulator.stop_reason)
        begin_s, before = self.now_s, self.simulator.T_world_base[:2, 3].copy()
        events = self.simulator.step(command)
        way_m = float(np.hypot(*(self.simulator.T_world_base[:2, 3] - before)))
        until_s = self.fault.at_s + (STALL_S if self.fault.kind is FaultKind.STALLED else _FOREVER_S)
        if self.fault.kind in BLIND and self.fault.at_s <= begin_s + 1e-9 < until_s:
            self._has_stood |= way_m < 1e-3 * FINE_S / PERIOD_S
            self.blind_m += 0.0 if is_braked else way_m
            self.stopped_m += 0.0 if self._has_stood else way_m
        return events
