"""`python -m benchmarks.navigation`: a wheelchair that drives to goals by itself, in a map of the day before.

Each building is driven once by the simulator with `realism="real"`, and mapped by wheels and camera joined. On the next
days, which have other light, and chairs and bins elsewhere, the chair begins somewhere on free floor where it may turn
on the spot; nobody says where. It finds itself in the map, and drives to goals drawn at random among the poses that the
map says can be reached. Localization, map, planner, controller and collision monitor are those of `wheelsight drive`:
no truth in the loop. A plan takes `navigation.navigator.planning_s` of simulated time.

"Arrived" is by the truth: within 0.15 m and 10° of the goal beside the map's nearest keyframe, and it says so itself.
"Touched" is what the chair drove into; somebody who walks into a chair that stands is not counted. "SPL" is success
weighted by path length, against the plan by the map alone (Anderson et al. 2018). "Clearance" is the least true
distance from the outline to things.
"""

from __future__ import annotations

import argparse
import statistics
from collections.abc import Sequence
from pathlib import Path
from tempfile import TemporaryDirectory

from rich.console import Console

from benchmarks import machine
from benchmarks.navigation_drives import Drive, Hardness, KnownBuilding, drives_in
from benchmarks.sequences import default_data_folder
from benchmarks.session_starts import first_day
from benchmarks.sessions import buildings_of
from benchmarks.table import Sheet, targets_sheet, write_page
from benchmarks.targets import Target
from wheelsight.navigation import NavigationSettings

ARRIVED_PERCENT, SPL, CLEARANCE_M = 98.0, 0.90, 0.05
_HEADER = ("building", "goals", "arrived", "touched", "SPL", "clearance m", "error m", "error °", "s a goal", "plans")


def row_of(building: str, drives: Sequence[Drive]) -> tuple[str, ...]:
    """Of the table."""
    arrived = [drive for drive in drives if drive.has_arrived]
    said = [drive for drive in drives if drive.result is not None and drive.result.has_arrived]
    errors = [(drive.off_m, drive.off_deg) for drive in said] or [(float("nan"), float("nan"))]
    plans = [drive.result.plans for drive in drives if drive.result is not None]
    return (
        building,
        str(len(drives)),
        f"{len(arrived)} ({100 * len(arrived) / len(drives):.0f} %)",
        str(sum(bool(drive.contacts) for drive in drives)),
        f"{statistics.mean(drive.spl for drive in drives):.2f}",
        f"{min(drive.clearance_m for drive in drives):.2f}",
        f"{statistics.median(m for m, _ in errors):.3f}",
        f"{statistics.median(deg for _, deg in errors):.1f}",
        f"{statistics.mean(drive.time_s for drive in drives):.0f}",
        f"{statistics.mean(plans):.1f}" if plans else "—",
    )


def targets_of(drives: Sequence[Drive]) -> list[Target]:
    """What must be reached."""
    arrived = 100 * sum(drive.has_arrived for drive in drives) / len(drives)
    touched = sum(bool(drive.contacts) for drive in drives)
    return [
        Target(f"arrived, of {len(drives)} goals", ARRIVED_PERCENT, arrived, "%", is_least=True),
        Target("goals on whose way something was touched", 0, touched, "", 0),
        Target("SPL", SPL, statistics.mean(drive.spl for drive in drives), "", 2, is_least=True),
        Target("clearance", CLEARANCE_M, min(drive.clearance_m for drive in drives), "m", 2, is_least=True),
    ]


def sheets_of(drives: Sequence[Drive]) -> list[Sheet]:
    """What drives came to, why some did not arrive, and what must be reached."""
    names = dict.fromkeys(drive.building for drive in drives)
    rows = tuple(row_of(name, [drive for drive in drives if drive.building == name]) for name in names)
    missed = tuple((drive.sentence,) for drive in drives if not drive.has_arrived or drive.contacts)
    sheets = [Sheet("Goals in a known map", _HEADER, rows), targets_sheet(targets_of(drives))]
    return [*sheets, Sheet("What went wrong", ("goal",), missed)] if missed else sheets


def main() -> None:
    """Print what was measured, and write it where asked to."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.navigation", description=__doc__)
    parser.add_argument("--data", type=Path, default=default_data_folder(), help="folder with maps/PLAN in it")
    parser.add_argument("--buildings", nargs="+", default=["flat", "Freiburg79_scan_furnitures.png"])
    parser.add_argument("--starts", type=int, default=5, help="in each building")
    parser.add_argument("--goals", type=int, default=3, help="from each start, one after another")
    parser.add_argument("--people", type=int, default=0, help="who walk about")
    parser.add_argument("--rate", type=float, default=10.0, help="images a second")
    parser.add_argument("--way", type=float, default=40.0, help="metres of the tour of the first day through a plan")
    parser.add_argument("--seed", type=int, default=1, help="of starts and goals")
    parser.add_argument("--out", type=Path, help="Markdown to write")
    arguments = parser.parse_args()
    what = f"--buildings {' '.join(arguments.buildings)} --starts {arguments.starts} --goals {arguments.goals} "
    what += f"--people {arguments.people} --rate {arguments.rate:g} --way {arguments.way:g} --seed {arguments.seed}"
    about = machine.description() | {"Command": f"`python -m benchmarks.navigation {what}`", "Images": "320×240"}
    console, drives = Console(width=150), list[Drive]()

    def told(drive: Drive) -> None:
        drives.append(drive)
        console.print(drive.sentence)
        if arguments.out is not None:  # now, since hours of drives may be broken off
            write_page(arguments.out, "Navigation", __doc__ or "", about, sheets_of(drives))

    for building in buildings_of(arguments.buildings, arguments.data, arguments.way):
        with TemporaryDirectory() as folder:
            day = first_day(building, Path(folder), arguments.rate)
            known = KnownBuilding(building, day, NavigationSettings())
            hard = Hardness(people=arguments.people, rate_hz=arguments.rate)
            drives_in(known, arguments.starts, arguments.goals, arguments.seed, hard, told)
    for sheet in sheets_of(drives):
        console.print(sheet.to_rich())


if __name__ == "__main__":
    main()
