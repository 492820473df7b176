"""`python -m benchmarks.hardware_faults`: faults between computer and wheels, with the real firmware in the loop.

A simulated chair drives straight on in an empty hall. Its commands pass `LinkRobot`, the serial protocol, the compiled
firmware on a simulated chip, its PWM outputs, motors and wheels, and come back as edges of encoders. At a random moment
a fault begins. A run ends 4 s later.

Neutral: way from the fault, or for commands out of order and a motor that runs on from a stop 0.3 s later, until both
outputs of the chip are neutral for good. Stands: way until the chair stands. Blind: of faults that leave readings
(noise, lost bytes, commands out of order) the longest way between two readings that reach the program while the motors
are driven; of the others the way to neutral. Said: `stop_reason` of the robot.

A motor that runs on has its outputs neutral and turns nevertheless: only a switch of its power stops it.
"""

from __future__ import annotations

import argparse
import math
import sys
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from rich.console import Console

from benchmarks.table import Sheet
from firmware.simulation.boards import BOARDS
from firmware.simulation.hardware_robot import FAULT_KINDS, FaultKind, HardwareFault, HardwareRobot
from wheelsight.core.drive_model import DriveAxis, DriveModel
from wheelsight.core.errors import DeviceError
from wheelsight.core.files import write_text
from wheelsight.core.messages import STOP, VelocityCommand, WheelTicks
from wheelsight.core.robots import RobotLimits
from wheelsight_sim import SimulationSettings
from wheelsight_sim.physics import TRUTH_PERIOD_S

# Of the shared log of a powered wheelchair (docs/drive-calibration.md).
CHAIR = DriveModel("joystick", DriveAxis(0.27, 0.43, 0.45), DriveAxis(0.20, 0.10, 0.11))
_WATCHED_S, _STOP_AFTER_S = 4.0, 0.3
_NEUTRAL, _STANDS_M_S = 0.02, 0.02
_LASTING: dict[FaultKind, float] = {"host frozen": 1.0, "brownout": 0.2}
# Faults in which STOP is pressed after 0.3 s, since the drive goes on as before.
_PRESSED: tuple[FaultKind, ...] = ("commands out of order", "motor runs on")
_READABLE = ("line noise", "bytes lost", "commands out of order")


@dataclass(frozen=True)
class HardwareRun:
    """What became of one run; see the module."""

    kind: FaultKind
    speed_m_s: float
    neutral_m: float
    stands_m: float
    blind_m: float
    said: str


def run_fault(hardware: str, kind: FaultKind, seed: int, drive: DriveModel | None) -> HardwareRun:
    """Drive until a fault begins, and watch what follows; equal arguments, equal results."""
    rng = np.random.default_rng([seed, FAULT_KINDS.index(kind)])
    speed_m_s = float(rng.uniform(0.4, 1.0))
    begin_s = float(rng.uniform(2.5, 3.5))
    fault = HardwareFault(kind, begin_s, begin_s + _LASTING.get(kind, math.inf), int(rng.integers(2)))
    limits = RobotLimits(forward_m_s=1.0)
    settings = SimulationSettings("square", realism="real", seed=seed)
    with HardwareRobot(
        hardware, settings, faults=[fault], limits=limits, drive=drive, has_camera=False, start=(0.0, 0.0, 0.0)
    ) as robot:
        is_pressed, is_stopped = kind in _PRESSED, False
        watch = _Watch(robot, begin_s + _STOP_AFTER_S * is_pressed)
        robot.on_tick = watch.follow
        while robot.host_s < begin_s + _WATCHED_S:
            if is_pressed and not is_stopped and robot.host_s >= begin_s + _STOP_AFTER_S:
                is_stopped = True
                try:
                    robot.stop()
                except DeviceError as error:
                    watch.said = error.problem
            # A motor that runs on is led down to a stop, so that the control meets it.
            command = STOP if is_stopped and kind == "motor runs on" else VelocityCommand(speed_m_s)
            watch.add(robot.step(command))
    neutral_m = watch.neutral_m
    return HardwareRun(
        kind, watch.speed_m_s, neutral_m, watch.stands_m, watch.unread_m if kind in _READABLE else neutral_m, watch.said
    )


class _Watch:
    """Ways since the fault, measured each 5 ms."""

    def __init__(self, robot: HardwareRobot, begin_s: float) -> None:
        self._robot, self._begin_s = robot, begin_s
        self._at, self._way_m, self._read_m = robot.T_world_base[:2, 3], 0.0, 0.0
        self.speed_m_s, self.neutral_m, self.stands_m, self.unread_m, self.said = 0.0, math.inf, math.inf, 0.0, ""

    def add(self, events: Sequence[object]) -> None:
        """Take the events of a period."""
        if any(isinstance(event, WheelTicks) for event in events):
            self._read_m = self._way_m
        if self._robot.host_s >= self._begin_s:
            self.said = self.said or self._robot.stop_reason

    def follow(self) -> None:
        """Add 5 ms."""
        at = self._robot.T_world_base[:2, 3]
        moved_m = float(np.hypot(*(at - self._at)))
        self._at = at
        if self._robot.host_s < self._begin_s:
            self.speed_m_s = moved_m / TRUTH_PERIOD_S
            return
        self._way_m += moved_m
        is_neutral = max(map(abs, self._robot.duties)) < _NEUTRAL
        self.neutral_m = min(self.neutral_m, self._way_m) if is_neutral else math.inf
        is_standing = moved_m < _STANDS_M_S * TRUTH_PERIOD_S
        self.stands_m = min(self.stands_m, self._way_m) if is_standing else math.inf
        if is_neutral:
            self._read_m = self._way_m
        self.unread_m = max(self.unread_m, self._way_m - self._read_m)


def fault_sheet(runs: Sequence[HardwareRun]) -> Sheet:
    """A row a fault."""
    rows = []
    for kind in FAULT_KINDS:
        some = [run for run in runs if run.kind == kind]
        if not some:
            continue
        said = Counter(run.said.split(":")[0] or "nothing" for run in some)
        rows.append(
            (
                kind,
                str(len(some)),
                f"{max(run.speed_m_s for run in some):.2f}",
                *(
                    f"{max(values):.2f}" if max(values) < math.inf else f"on in {sum(map(math.isinf, values))}"
                    for values in (
                        [run.neutral_m for run in some],
                        [run.stands_m for run in some],
                        [run.blind_m for run in some],
                    )
                ),
                "; ".join(f"{words} ({count})" for words, count in said.most_common()),
            )
        )
    heads = ("fault", "runs", "m/s, most", "neutral, m", "stands, m", "blind, m", "said")
    return Sheet("Faults between computer and wheels, largest ways", heads, tuple(rows))


def main(arguments: Sequence[str] | None = None) -> int:
    """Run all faults; print the table and write it."""
    assert __doc__ is not None
    parser = argparse.ArgumentParser(prog="python -m benchmarks.hardware_faults", description=__doc__.split("\n\n")[0])
    parser.add_argument("--hardware", choices=list(BOARDS), default="atmega8")
    parser.add_argument("--runs", type=int, default=5, help="of each fault")
    parser.add_argument("--faults", nargs="+", choices=FAULT_KINDS, default=list(FAULT_KINDS), metavar="FAULT")
    parser.add_argument("--quick-motors", action="store_true", help="motors with a lag of 0.1 s, not a real chair's")
    parser.add_argument("--out", type=Path, help="Markdown file for the table")
    given = parser.parse_args(arguments)
    drive, runs = None if given.quick_motors else CHAIR, list[HardwareRun]()
    for kind in given.faults:
        runs += [run_fault(given.hardware, kind, seed, drive) for seed in range(given.runs)]
        print(f"{kind}: done", file=sys.stderr, flush=True)
    sheet = fault_sheet(runs)
    Console().print(sheet.to_rich())
    if given.out is not None:
        write_text(given.out, sheet.to_markdown())
    return 0


if __name__ == "__main__":
    sys.exit(main())
