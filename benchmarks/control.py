"""`python -m benchmarks.control`: milliseconds a command, of controllers and collision monitor, on one core.

The costs of the same rollouts are also computed by numpy (`benchmarks.plain_rollouts`) in the same run: a machine's
speed alone says little, the ratio of both does.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console
from scipy import ndimage

from benchmarks import machine
from benchmarks.navigation_page import write_section
from benchmarks.plain_rollouts import plain_costs
from benchmarks.plain_views import view_of_points
from benchmarks.table import Sheet, targets_sheet
from benchmarks.targets import Target
from wheelsight.core.estimates import Status
from wheelsight.core.geometry import BoolArray, FloatArray
from wheelsight.core.messages import VelocityCommand
from wheelsight.navigation import Footprint, RobotLimits
from wheelsight.navigation.clearance_kernels import CostField
from wheelsight.navigation.collision_monitor import CollisionMonitor
from wheelsight.navigation.controllers import (
    Controller,
    MotionState,
    MppiController,
    PurePursuitController,
    Rollouts,
    Situation,
    cut,
)
from wheelsight.navigation.settings import FollowSettings, MppiSettings, outline_of

CHAIR = Footprint.rectangle(0.8, 0.3, 0.6)
MPPI_MS = 5.0
_TITLE = "Commands on one core"
_RESOLUTION_M, _TIMES, _PLAIN_TIMES = 0.05, 100, 3
_NOBODY = np.empty((0, 5))
_CROWD = np.array([[5, 5, -1, 0, 0.3], [4, 6, 0, -0.5, 0.3], [6, 6, 0, -0.5, 0.3], [6, 3, 0, 0.5, 0.3]])


@dataclass(frozen=True)
class _Path:
    poses: FloatArray


def places() -> dict[str, tuple[CostField, FloatArray]]:
    """Fields and people: an open room, a corridor of 1.2 m, and four people who walk."""
    room = np.zeros((200, 200), bool)
    room[[0, -1]] = room[:, [0, -1]] = True
    corridor = np.ones((200, 200), bool)
    corridor[88:112, 5:195] = False
    return {
        "open room": (_field(room), _NOBODY),
        "corridor of 1.2 m": (_field(corridor), _NOBODY),
        "open room, four people": (_field(room), _CROWD),
    }


def _field(is_obstacle: BoolArray) -> CostField:
    distance = (ndimage.distance_transform_edt(~is_obstacle) * _RESOLUTION_M).astype(np.float32)
    return CostField(distance, np.zeros_like(distance), _RESOLUTION_M, (0.0, 0.0))


def times_ms(work: Callable[[], Any], times: int) -> tuple[float, float]:
    """Least and median of this thread's processor time."""
    work()
    spent = []
    for _ in range(times):
        begin_s = time.thread_time()
        work()
        spent.append(1e3 * (time.thread_time() - begin_s))
    return min(spent), float(np.median(spent))


def command_ms(controller: Controller, field: CostField, people: FloatArray) -> tuple[float, float]:
    """Of a drive along a straight path, whose state goes on a little each time."""
    path, count = _Path(np.array([[2.0, 5, 0], [8.5, 5, 0]])), iter(range(10 * _TIMES))

    def work() -> None:
        state = MotionState(np.array([2.0 + 0.01 * (next(count) % 100), 5.03, 0.05]), 0.6, 0.1)
        controller.command(state, path, field, people)

    return times_ms(work, _TIMES)


def rollouts_ms(field: CostField) -> tuple[float, float]:
    """Costs of the same rollouts by the kernel and by numpy, least of several."""
    rollouts = Rollouts(outline_of(CHAIR), RobotLimits(), MppiSettings().rollouts, FollowSettings())
    (segment,) = cut(np.array([[2.0, 5, 0], [8.5, 5, 0]]))
    given = rollouts.given(
        Situation(
            MotionState(np.array([2.0, 5.03, 0.05]), 0.6, 0.1), segment, 0, field, _NOBODY, FollowSettings().margin_m
        )
    )
    _, drawn = rollouts.costs(given)
    kernel_ms, _ = times_ms(lambda: rollouts.costs(given), _TIMES)
    plain_ms, _ = times_ms(lambda: plain_costs(*given, drawn), _PLAIN_TIMES)
    return kernel_ms, plain_ms


def monitor_ms() -> dict[str, tuple[float, float]]:
    """A frame of 1000 points that is seen, and a command that is checked, on a drive along a wall.

    Raises:
        RuntimeError: the monitor stopped, so that what was measured is not a drive.
    """
    monitor, asked = CollisionMonitor(CHAIR), VelocityCommand(0.3, 0.0)
    along, spent = np.linspace(0.9, 3.9, 1000), []
    for n in range(_TIMES + 20):
        now_s = 0.05 * n
        monitor.add_reading(now_s, min(0.02 * n, 0.3), 0.0)
        points = np.stack([along, 0.6 + 0.0 * along], axis=-1)
        view = view_of_points(now_s, points, (0.35, 0.0), np.pi / 6, (0.5, 4.0))
        stamps = [time.thread_time()]
        monitor.add_view(view)
        stamps.append(time.thread_time())
        result = monitor.check(asked, now_s, Status.TRACKING)
        spent.append(1e3 * np.diff([*stamps, time.thread_time()]))
        if result.command.is_stop:
            raise RuntimeError(f"the monitor stopped: {result.reason}")
    steady = np.array(spent[20:])
    return {
        name: (float(ms.min()), float(np.median(ms)))
        for name, ms in zip(("frame seen", "command checked"), steady.T, strict=True)
    }


def sheets() -> list[Sheet]:
    """Measured now: commands, rollouts beside numpy's, and what must be reached."""
    rows = []
    for name, (field, people) in places().items():
        for kind in (MppiController, PurePursuitController):
            least, median = command_ms(kind(CHAIR), field, people)
            rows.append((f"{kind.__name__}, {name}", f"{least:.2f}", f"{median:.2f}"))
    rows += [(f"CollisionMonitor, {name}", f"{a:.2f}", f"{b:.2f}") for name, (a, b) in monitor_ms().items()]
    compared, targets = [], []
    for name, (field, people) in places().items():
        if not len(people):
            kernel_ms, plain_ms = rollouts_ms(field)
            compared.append((name, f"{kernel_ms:.2f}", f"{plain_ms:.0f}", f"{plain_ms / kernel_ms:.0f}"))
            targets.append(Target(f"2000 rollouts of 56 steps, {name}, least", MPPI_MS, kernel_ms, "ms", 2))
    return [
        Sheet("One command, ms of processor time", ("what", "least", "median"), tuple(rows)),
        Sheet("2000 rollouts of 56 steps, least ms", ("where", "kernel", "numpy", "ratio"), tuple(compared)),
        targets_sheet(targets),
    ]


def main() -> None:
    """Measure, print, and write where asked to."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.control", description=__doc__)
    parser.add_argument("--out", type=Path, help="page whose section is written, docs/benchmarks/navigation.md")
    arguments = parser.parse_args()
    console, about = Console(width=120), machine.description() | {"Command": "`python -m benchmarks.control`"}
    if machine.is_busy():
        console.print(f"The machine is busy ({about['Load']}): times will be too long.", style="yellow")
    measured = sheets()
    for sheet in measured:
        console.print(sheet.to_rich())
    if arguments.out is not None:
        write_section(arguments.out, _TITLE, __doc__ or "", about, measured)


if __name__ == "__main__":
    main()
