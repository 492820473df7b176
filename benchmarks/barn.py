"""`python -m benchmarks.barn`: a wheelchair crosses fields of obstacles without a map, as in the BARN challenge.

A cellular automaton draws each world. As in the challenge, a way leads through it for a square of five cells
(1.31 m), cleared where there was none; and our own planner finds one for the wheelchair's outline in the true plan. All
lengths are 1.75 times those of the challenge, whose Jackal is that much smaller. The robot knows nothing but how far on
the goal is. It has a depth camera of 60° and the simulator's real sensors (`realism="real"`), its own localization, and
the navigation of `wheelsight drive`, to which unknown floor costs more but is not forbidden. It has its own top speed
of 1 m/s.

"Success" is to come within 1 m of the goal, by the truth, in 350 s (the challenge's 100 s at 2 m/s, for a way 1.75
times as long), without having touched anything. Time counts from the begin; simulated time stands still while the
program computes. The score is that of the challenge since 2025: success · OT / clip(AT, 2 OT, 8 OT), where AT is the
time taken and OT the length of the best way, by our own planner that knows the whole world, over the top speed; at
most 0.5. "Old score" is that of 2022 to 2024: clip(AT, 4 OT, 8 OT), at most 0.25.
"""

from __future__ import annotations

import argparse
import statistics
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console

from benchmarks import machine
from benchmarks.barn_worlds import SCALE, WAY_M, Field, field_of
from benchmarks.kept_records import KeptRecords
from benchmarks.navigation_page import write_section
from benchmarks.table import Sheet, targets_sheet
from benchmarks.targets import Target
from wheelsight.config import load_config
from wheelsight.estimation import Localizer, LocalizerInStep
from wheelsight.navigation import CostmapSettings, GrowingFloor, NavigationSettings, Navigator
from wheelsight_sim import SimulationSettings, Simulator

SUCCESS_PERCENT, COLLISION_PERCENT, SCORE = 95.0, 1.0, 0.42
GOAL_M, LONGEST_S = 1.0, 100.0 * SCALE * 2.0
NEWER, OLDER, SLOWEST = 2.0, 4.0, 8.0
_TITLE = "Fields of obstacles without a map (BARN)"
_PUBLISHED = (
    ("DWA on a Jackal with a lidar (published: the challenge's README)", "500", "88.0 %", "4.8 %", "0.169", "—", "34"),
    ("best of 2026 in simulation, likewise (published: its report)", "500", "—", "—", "0.498", "—", "—"),
)
_HEADER = ("robot, worlds", "drives", "success", "touched", "score", "old score", "s")


@dataclass(frozen=True)
class Crossing:
    """What became of a world.

    Attributes:
        number, fill, rounds, tries: of the world.
        best_m: length of the best way.
        time_s, way_m: taken and driven.
        off_m: least distance to the goal.
        contacts: what was touched.
        clearance_m: least true distance to things.
        ended: why it was over, in words.
    """

    number: int
    fill: float
    rounds: int
    tries: int
    best_m: float
    time_s: float
    way_m: float
    off_m: float
    contacts: tuple[str, ...]
    clearance_m: float
    ended: str

    @property
    def is_success(self) -> bool:
        """At the goal in time, with nothing touched."""
        return self.off_m <= GOAL_M and self.time_s <= LONGEST_S and not self.contacts

    def score(self, top_m_s: float, quickest: float = NEWER) -> float:
        """Of the challenge; `quickest` is how many optimal times are as good as fewer."""
        optimal_s = self.best_m / top_m_s
        taken_s = min(max(self.time_s, quickest * optimal_s), SLOWEST * optimal_s)
        return optimal_s / taken_s if self.is_success else 0.0

    @property
    def sentence(self) -> str:
        """For the terminal."""
        what = "success" if self.is_success else f"{self.ended}, {self.off_m:.1f} m from the goal"
        touched = f", touched {', '.join(self.contacts)}" if self.contacts else ""
        return (
            f"world {self.number} ({100 * self.fill:.0f} %, {self.rounds} times): {what} after {self.time_s:.0f} s,"
            f" {self.way_m:.1f} m for {self.best_m:.1f}, clearance {self.clearance_m:.2f} m{touched}"
        )


def crossed(field: Field, seed: int, settings: NavigationSettings, rate_hz: float) -> Crossing:
    """Drive through a world."""
    how = SimulationSettings(size=(320, 240), rate_hz=rate_hz, seed=seed, day=1 + field.number, realism="real")
    config = load_config(overrides={"odometry": "wheels,dense", "loops.source": "keyframes"})
    goal = np.array([WAY_M, 0.0])
    with Simulator(how, world=field.world, start=(0.0, 0.0, 0.0), limits=settings.limits) as simulator:
        localization = LocalizerInStep(Localizer(simulator.calibration, config, waits=True))
        try:
            footprint = settings.footprint.outline
            floor = GrowingFloor(localization, simulator.calibration, footprint, SCALE, holds=[goal])
            navigator = Navigator(simulator, localization, floor, settings, trusts_floor=True)
            return _driven(field, simulator, navigator, goal)
        finally:
            localization.close()


def _driven(field: Field, simulator: Simulator, navigator: Navigator, goal: np.ndarray) -> Crossing:
    last, way_m, off_m, clearance_m = simulator.T_world_base[:2, 3].copy(), 0.0, np.inf, np.inf
    navigator.go_to_pose(goal)
    ended = ""
    while not ended:
        navigator.step()
        here = simulator.T_world_base[:2, 3].copy()
        way_m, last = way_m + float(np.hypot(*(here - last))), here
        off_m, clearance_m = min(off_m, float(np.hypot(*(here - goal)))), min(clearance_m, simulator.clearance_m())
        ended = _why_over(simulator, navigator, off_m)
    return Crossing(
        field.number,
        field.fill,
        field.rounds,
        field.tries,
        field.plan.length_m,
        simulator.time_s,
        way_m,
        off_m,
        tuple(one.name for one in simulator.contacts if one.is_by_robot),
        clearance_m,
        ended,
    )


def _why_over(simulator: Simulator, navigator: Navigator, off_m: float) -> str:
    """In words; empty where it goes on. As in the challenge, whoever touches something is out."""
    if any(one.is_by_robot for one in simulator.contacts):
        return "a contact"
    if off_m <= GOAL_M:
        return "at the goal"
    if navigator.is_task_complete():
        return "gave up" if navigator.result is None else f"gave up: {navigator.result.detail}"
    return "took too long" if simulator.time_s > LONGEST_S else ""


def row_of(name: str, crossings: Sequence[Crossing], top_m_s: float) -> tuple[str, ...]:
    """Of the table."""
    count, done = len(crossings), [one for one in crossings if one.is_success]
    return (
        name,
        str(count),
        f"{100 * len(done) / count:.1f} %",
        f"{100 * sum(bool(one.contacts) for one in crossings) / count:.1f} %",
        f"{statistics.mean(one.score(top_m_s) for one in crossings):.3f}",
        f"{statistics.mean(one.score(top_m_s, OLDER) for one in crossings):.3f}",
        f"{statistics.mean(one.time_s for one in done):.0f}" if done else "—",
    )


def sheets_of(crossings: Sequence[Crossing], top_m_s: float) -> list[Sheet]:
    """Each density of obstacles, all of them, what others have published, and what must be reached."""
    fills = sorted({one.fill for one in crossings})
    rows = [
        row_of(f"wheelsight, {100 * fill:.0f} % filled", [o for o in crossings if o.fill == fill], top_m_s)
        for fill in fills
    ]
    rows += [row_of("wheelsight, all", crossings, top_m_s), *_PUBLISHED]
    count = len(crossings)
    success = 100 * sum(one.is_success for one in crossings) / count
    touched = 100 * sum(bool(one.contacts) for one in crossings) / count
    score = statistics.mean(one.score(top_m_s) for one in crossings)
    targets = [
        Target(f"success, of {count} worlds", SUCCESS_PERCENT, success, "%", is_least=True),
        Target("worlds in which something was touched", COLLISION_PERCENT, touched, "%"),
        Target("score, of 0.50", SCORE, score, "", 3, is_least=True),
    ]
    missed = tuple((one.sentence,) for one in crossings if not one.is_success)
    sheets = [Sheet("Crossings", _HEADER, tuple(rows)), targets_sheet(targets)]
    return [*sheets, Sheet("Worlds that were not crossed", ("world",), missed)] if missed else sheets


def _of(record: dict[str, Any]) -> Crossing:
    return Crossing(**{**record, "contacts": tuple(record["contacts"])})


def main() -> None:
    """Print what was measured, and write it where asked to."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.barn", description=__doc__)
    parser.add_argument("--worlds", type=int, default=12, help="the challenge has 300, and 50 to judge by")
    parser.add_argument("--first", type=int, default=0, help="number of the first world")
    parser.add_argument("--seed", type=int, default=1, help="of the worlds, and of all that is random about the robot")
    parser.add_argument("--rate", type=float, default=10.0, help="images a second")
    parser.add_argument("--out", type=Path, help="page whose section is written, docs/benchmarks/navigation.md")
    parser.add_argument("--keep", type=Path, metavar="DIR", help="keeps drives; those kept are not measured again")
    arguments = parser.parse_args()
    what = f"--worlds {arguments.worlds} --first {arguments.first} --seed {arguments.seed} --rate {arguments.rate:g}"
    about = machine.description() | {"Command": f"`python -m benchmarks.barn {what}`", "Images": "320×240"}
    settings = NavigationSettings(costmap=CostmapSettings(unknown="costly"))
    top_m_s, kept = settings.limits.forward_m_s, KeptRecords(arguments.keep, {"rate_hz": arguments.rate})
    console, crossings = Console(width=150), list[Crossing]()
    for number in range(arguments.first, arguments.first + arguments.worlds):
        name = f"world-{arguments.seed}-{number}"
        record = kept.of(name)
        if record is None:
            field = field_of(number, arguments.seed, settings)
            record = asdict(crossed(field, arguments.seed, settings, arguments.rate))
            kept.keep(name, record)
        crossings.append(_of(record))
        console.print(f"{crossings[-1].sentence}, score {crossings[-1].score(top_m_s):.2f}")
        if arguments.out is not None:  # now, since hours of drives may be broken off
            write_section(arguments.out, _TITLE, __doc__ or "", about, sheets_of(crossings, top_m_s))
    for sheet in sheets_of(crossings, top_m_s):
        console.print(sheet.to_rich())


if __name__ == "__main__":
    main()
