"""`python -m benchmarks.assist`: people who steer through doors, with and without help.

A chair with a small depth camera stands before a wall with a door, up to 0.4 m aside and turned by up to 10 degrees. A
simulated driver steers it through, by the truth, to a point 1.2 m behind the door:

- perfect: a point ahead on the line through the door.
- tremor: the same with 20 % of the full stick at 3 to 7 Hz on both axes.
- bias: the same, as if all were 15 degrees farther to one side.
- late: the same by the pose of 0.4 s ago.
- switches: four directions, on or off.
- spasm: the perfect one, who at a random moment holds the full stick in a random direction for 0.5 s.
- asleep: the stick stays as it was at a random moment.

A run has a contact if the outline meets a wall. It is through if the axle is 1 m behind the door within 40 s. "Changed"
is the share of periods in which help changed the stick's command by more than 5 % of the limits. Rays in a plan give
the depth images; there is neither noise nor a map.
"""

from __future__ import annotations

import argparse
import math
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from rich.console import Console

from benchmarks.plain_rooms import RoomRobot, Walls, walls_about
from benchmarks.table import Sheet
from wheelsight.core.files import write_text
from wheelsight.core.geometry import FloatArray
from wheelsight.core.messages import StickPosition
from wheelsight.navigation import NavigationSettings
from wheelsight.navigation.shared_control import Assist, AssistLevel

DRIVERS = ("perfect", "tremor", "bias", "late", "switches", "spasm", "asleep")
WIDTHS_M = (0.80, 0.85, 0.90)
_ROOM_M, _WALL_X_M, _THICK_M, _LONGEST_S = (8.0, 6.0), 4.0, 0.12, 40.0
# A driver slows down by himself within this distance of the door.
_LOOK_AHEAD_M, _SPEED, _SPEED_NEAR, _NEAR_M = 0.9, 0.5, 0.35, 0.8


@dataclass(frozen=True)
class DoorRun:
    """What became of one run.

    Attributes:
        seconds: until it was through, or the longest time.
        closest_m: least distance of the outline from a wall.
        jerk: mean absolute change of the forward command a second, m/s².
    """

    driver: str
    width_m: float
    level: str
    is_through: bool
    has_contact: bool
    seconds: float
    closest_m: float
    changed: float
    jerk: float


class Driver:
    """A person at the stick.

    Args:
        kind: of `DRIVERS`.
        goal: (2,) the point behind the door.
        door: (2,) the middle of the door.
    """

    def __init__(self, kind: str, door: FloatArray, goal: FloatArray, rng: np.random.Generator) -> None:
        self._kind, self._door, self._goal, self._rng = kind, door, goal, rng
        self._phases, self._rates = rng.uniform(0, 2 * np.pi, 2), rng.uniform(3, 7, 2)
        self._side = float(rng.choice([-1.0, 1.0]))
        self._event_s = float(rng.uniform(1.5, 6.0))
        self._jerked = rng.choice([-1.0, 1.0], 2)
        self._poses: list[FloatArray] = []
        self._held: StickPosition | None = None

    def stick(self, pose: FloatArray, now_s: float) -> StickPosition:
        """The stick's position at a true pose (3,)."""
        self._poses.append(pose.copy())
        if self._kind == "late":
            pose = self._poses[max(len(self._poses) - 9, 0)]
        forward, left = self._aim(pose, math.radians(15) * self._side if self._kind == "bias" else 0.0)
        if self._kind == "tremor":
            shake = 0.2 * np.sin(2 * np.pi * self._rates * now_s + self._phases)
            forward, left = forward + float(shake[0]), left + float(shake[1])
        elif self._kind == "switches":
            is_turning = abs(left) > 0.12
            forward, left = (0.0, math.copysign(0.3, left)) if is_turning else (0.4 * (forward > 0), 0.0)
        elif self._kind == "spasm" and self._event_s <= now_s < self._event_s + 0.5:
            forward, left = map(float, self._jerked)
        found = StickPosition(now_s, float(np.clip(forward, -1, 1)), float(np.clip(left, -1, 1)))
        if self._kind == "asleep" and now_s >= self._event_s:
            self._held = self._held or found
            return StickPosition(now_s, self._held.forward, self._held.left)
        return found

    def _aim(self, pose: FloatArray, off_rad: float) -> tuple[float, float]:
        """Forward and left toward a point ahead on the line through the door."""
        along = min(pose[0] + _LOOK_AHEAD_M, self._goal[0])
        way = np.array([along, self._door[1]]) - pose[:2]
        if pose[0] > self._goal[0] - 0.05:
            return 0.0, 0.0
        bearing = math.atan2(way[1], way[0]) - pose[2] + off_rad
        bearing = (bearing + math.pi) % (2 * math.pi) - math.pi
        is_near = abs(pose[0] - self._door[0]) < _NEAR_M
        forward = (_SPEED_NEAR if is_near else _SPEED) * max(1 - abs(bearing) / 0.8, 0.0)
        turn = 2 * forward * math.sin(bearing) / max(float(np.hypot(*way)), 0.3) if forward > 0.1 else 0.8 * bearing
        return forward, float(np.clip(turn, -1, 1))


def run_door(driver: str, width_m: float, level: AssistLevel, seed: int) -> DoorRun:
    """Let a driver steer through a door; the same seed gives the same start and the same driver."""
    rng = np.random.default_rng([seed, round(100 * width_m)])
    middle = float(rng.uniform(2.0, 4.0))
    low, high, far = middle - width_m / 2, middle + width_m / 2, _WALL_X_M + _THICK_M
    walls = Walls.of(
        *walls_about(*_ROOM_M),
        ((_WALL_X_M, 0.0), (_WALL_X_M, low)),
        ((_WALL_X_M, high), (_WALL_X_M, _ROOM_M[1])),
        ((_WALL_X_M, low), (far, low)),
        ((_WALL_X_M, high), (far, high)),
        ((far, 0.0), (far, low)),
        ((far, high), (far, _ROOM_M[1])),
    )
    start = (float(rng.uniform(1.2, 1.8)), middle + float(rng.uniform(-0.4, 0.4)), math.radians(rng.uniform(-10, 10)))
    robot = RoomRobot(walls, start)
    door, goal = np.array([_WALL_X_M, middle]), np.array([_WALL_X_M + 1.2, middle])
    person, settings = Driver(driver, door, goal, rng), NavigationSettings()
    assist = Assist(robot, settings, level)
    closest_m, is_through, before, jerk = math.inf, False, 0.0, 0.0
    while robot.now_s < _LONGEST_S and not is_through and closest_m > 0.003:
        assist.move(person.stick(robot.base.pose, robot.now_s))
        feedback = assist.step()
        jerk += abs(feedback.command.forward_m_s - before)
        before = feedback.command.forward_m_s
        closest_m = min(closest_m, walls.clearance_m(settings.footprint.outline.at(robot.base.pose)))
        is_through = bool(robot.base.pose[0] > _WALL_X_M + 1.0)
    changed = assist.record.changed / max(assist.record.periods, 1)
    seconds = robot.now_s
    return DoorRun(
        driver, width_m, level.value, is_through, closest_m <= 0.003, seconds, closest_m, changed, jerk / seconds
    )


def door_sheet(runs: Sequence[DoorRun]) -> Sheet:
    """A row a driver and level."""
    rows = []
    for driver in DRIVERS:
        for level in AssistLevel:
            some = [run for run in runs if run.driver == driver and run.level == level.value]
            if not some:
                continue
            through = [run for run in some if run.is_through]
            times = f"{np.median([run.seconds for run in through]):.1f}" if through else "–"
            rows.append(
                (
                    driver,
                    level.value,
                    str(len(some)),
                    str(sum(run.has_contact for run in some)),
                    f"{100 * len(through) / len(some):.0f} %",
                    times,
                    f"{100 * np.mean([run.changed for run in some]):.1f} %",
                    f"{np.mean([run.jerk for run in some]):.2f}",
                )
            )
    heads = ("driver", "level", "runs", "contacts", "through", "median s", "changed", "m/s²")
    return Sheet("Doors by simulated drivers", heads, tuple(rows))


def main(arguments: Sequence[str] | None = None) -> int:
    """Run all drivers at all levels; print the table and write it."""
    assert __doc__ is not None
    parser = argparse.ArgumentParser(prog="python -m benchmarks.assist", description=__doc__.split("\n\n")[0])
    parser.add_argument("--runs", type=int, default=10, help="of each driver, level and width of a door")
    parser.add_argument("--first", type=int, default=0, help="seed of the first run; thresholds were found on 0 to 4")
    parser.add_argument("--drivers", nargs="+", choices=DRIVERS, default=list(DRIVERS))
    parser.add_argument(
        "--levels", nargs="+", choices=[level.value for level in AssistLevel], default=list(AssistLevel)
    )
    parser.add_argument("--widths", nargs="+", type=float, default=list(WIDTHS_M), help="of doors, metres")
    parser.add_argument("--out", type=Path, help="Markdown file for the table")
    given = parser.parse_args(arguments)
    runs = []
    for driver in given.drivers:
        for level in map(AssistLevel, given.levels):
            for width_m in given.widths:
                runs += [
                    run_door(driver, width_m, level, seed) for seed in range(given.first, given.first + given.runs)
                ]
            print(f"{driver}, {level}: done", file=sys.stderr, flush=True)
    sheet = door_sheet(runs)
    Console().print(sheet.to_rich())
    if given.out is not None:
        write_text(given.out, sheet.to_markdown())
    return 0


if __name__ == "__main__":
    sys.exit(main())
