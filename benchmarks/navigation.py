"""`python -m benchmarks.navigation`: a wheelchair that drives to goals by itself, in a map of the day before.

Each building is driven once by the simulator with `realism="real"`, and mapped by wheels and camera joined. On the next
days, which have other light, and chairs and bins elsewhere, the chair starts somewhere on free floor where it may turn
on the spot, without a given pose. It localizes itself in the map, and drives to random goals among the reachable
poses of the map. Localization, map, planner, controller and collision monitor are those of `wheelsight drive`:
no truth in the loop. A plan takes 0.15 s of simulated time.

"Arrived" is by the truth: within 0.15 m and 10° of the goal beside the map's nearest keyframe, and it says so itself.
"Touched" is what the chair drove into; a person who walks into a standing chair is not counted. "SPL" is success
weighted by path length (Anderson et al. 2018), against our planner's way for the same outline, by the map with the
things in it. "Clearance" is the least true distance from the outline to things.

With `--things N`, N boxes stand on the ways of each start, a little aside, each so that another way is left to every
goal; with `--people N`, N people walk about, and a tenth of them do not look.
With `--calibrated`, the chair's unit is calibrated (depth, lens, registration, mount, wheels) by a board and a drive
before, as in docs/tutorial-your-robot.md; else it has its data-sheet calibration.
"""

from __future__ import annotations

import argparse
import statistics
from collections.abc import Callable, Sequence
from dataclasses import asdict
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from rich.console import Console

from benchmarks import calibrated_unit, machine
from benchmarks.kept_records import KeptRecords
from benchmarks.navigation_courses import KnownBuilding
from benchmarks.navigation_drives import Drive, Hardness, drives_from
from benchmarks.navigation_page import write_section
from benchmarks.sequences import default_data_folder
from benchmarks.session_maps import kept_day
from benchmarks.session_starts import Building
from benchmarks.sessions import buildings_of, map_settings
from benchmarks.table import Sheet, targets_sheet
from benchmarks.targets import Target
from wheelsight.navigation import NavigationSettings

ARRIVED_PERCENT, ARRIVED_AMONG_PERCENT, SPL, CLEARANCE_M = 98.0, 95.0, 0.90, 0.05
"""Of the issue; the second with people and things in the way, where it asks for neither of the last two."""

FOUR_BUILDINGS = (
    "Freiburg79_scan_furnitures.png",
    "lab_ipa_furnitures.png",
    "office_b_furnitures.png",
    "ctrl_room.yaml",
)
_HEADER = ("building", "goals", "arrived", "touched", "SPL", "clearance m", "error m", "error °", "s a goal", "plans")


def row_of(building: str, drives: Sequence[Drive]) -> tuple[str, ...]:
    """Of the table."""
    arrived = [drive for drive in drives if drive.has_arrived]
    said = [drive for drive in drives if drive.says_arrived]
    errors = [(drive.off_m, drive.off_deg) for drive in said] or [(float("nan"), float("nan"))]
    plans = [drive.plans for drive in drives if drive.plans is not None]
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


def targets_of(drives: Sequence[Drive], hard: Hardness) -> list[Target]:
    """What must be reached."""
    arrived = 100 * sum(drive.has_arrived for drive in drives) / len(drives)
    touched = sum(bool(drive.contacts) for drive in drives)
    is_among = bool(hard.people or hard.things)
    least = ARRIVED_AMONG_PERCENT if is_among else ARRIVED_PERCENT
    targets = [
        Target(f"arrived, of {len(drives)} goals", least, arrived, "%", is_least=True),
        Target("goals on whose way something was touched", 0, touched, "", 0),
    ]
    if is_among:
        return targets
    spl, clearance_m = statistics.mean(drive.spl for drive in drives), min(drive.clearance_m for drive in drives)
    return [
        *targets,
        Target("SPL", SPL, spl, "", 2, is_least=True),
        Target("clearance", CLEARANCE_M, clearance_m, "m", 2, is_least=True),
    ]


def title_of(hard: Hardness) -> str:
    """Of the page's section."""
    among = [f"{count} {what}" for count, what in ((hard.people, "people"), (hard.things, "things")) if count]
    by = ", by a calibrated robot" if hard.units is not None else ""
    return "Goals in a known map" + (f", among {' and '.join(among)}" if among else "") + by


def sheets_of(drives: Sequence[Drive], hard: Hardness) -> list[Sheet]:
    """What drives came to, why some did not arrive, and what must be reached."""
    names = dict.fromkeys(drive.building for drive in drives)
    rows = tuple(row_of(name, [drive for drive in drives if drive.building == name]) for name in names)
    missed = tuple((drive.sentence,) for drive in drives if not drive.has_arrived or drive.contacts)
    sheets = [Sheet("Goals", _HEADER, rows), targets_sheet(targets_of(drives, hard))]
    return [*sheets, Sheet("Failures", ("goal",), missed)] if missed else sheets


def drives_in(
    building: Building,
    arguments: argparse.Namespace,
    hard: Hardness,
    kept: KeptRecords,
    reported: Callable[[Drive], None],
) -> None:
    """From all starts; the map of the first day is made where not all of them are kept."""
    names = [f"{building.name}-{arguments.seed}-{number}" for number in range(arguments.starts)]
    records = [kept.of(name) for name in names]
    with TemporaryDirectory() as folder:
        maps = Path(folder) if arguments.keep is None else arguments.keep / "maps"
        known: KnownBuilding | None = None
        for number, (name, record) in enumerate(zip(names, records, strict=True)):
            if record is not None:
                for one in record:
                    reported(_of(one))
                continue
            known = known or known_building(building, arguments, maps)
            done = drives_from(known, number, arguments.goals, arguments.seed, hard, reported)
            kept.keep(name, [asdict(drive) for drive in done])


def known_building(building: Building, asked: argparse.Namespace, folder: Path) -> KnownBuilding:
    """By the map that `folder` has, or else by one that is made now, and kept there."""
    day = kept_day(building, folder, map_settings(asked), asked.rate, asked.calibrated)
    return KnownBuilding(building, day, NavigationSettings())


def _of(record: dict[str, Any]) -> Drive:
    return Drive(**{**record, "goal": tuple(record["goal"]), "contacts": tuple(record["contacts"])})


def _asked() -> argparse.Namespace:
    parser = argparse.ArgumentParser(prog="python -m benchmarks.navigation", description=__doc__)
    parser.add_argument("--data", type=Path, default=default_data_folder(), help="folder with maps/PLAN in it")
    parser.add_argument("--buildings", nargs="+", default=list(FOUR_BUILDINGS), help="plans, or worlds: flat, floor4")
    parser.add_argument("--starts", type=int, default=5, help="in each building")
    parser.add_argument("--goals", type=int, default=3, help="from each start, one after another")
    parser.add_argument("--people", type=int, default=0, help="who walk about")
    parser.add_argument("--things", type=int, default=0, help="in the way, that the map does not know")
    parser.add_argument("--rate", type=float, default=10.0, help="images a second")
    parser.add_argument("--way", type=float, default=40.0, help="metres of the tour of the first day through a plan")
    parser.add_argument("--seed", type=int, default=1, help="of starts and goals")
    calibrated_unit.add_option(parser)
    parser.add_argument("--out", type=Path, help="page whose section is written, docs/benchmarks/navigation.md")
    parser.add_argument("--keep", type=Path, metavar="DIR", help="keeps maps and drives; those kept are not made again")
    return parser.parse_args()


def main() -> None:
    """Print what was measured, and write it where asked to."""
    asked = _asked()
    what = f"--buildings {' '.join(asked.buildings)} --starts {asked.starts} --goals {asked.goals} "
    what += f"--people {asked.people} --things {asked.things} --rate {asked.rate:g} --way {asked.way:g} "
    what += "--calibrated " if asked.calibrated else ""
    about = machine.description() | {
        "Command": f"`python -m benchmarks.navigation {what}--seed {asked.seed}`",
        "Images": "320×240",
    }
    console, drives = Console(width=150), list[Drive]()
    hard = Hardness(people=asked.people, things=asked.things, rate_hz=asked.rate, units=asked.calibrated)
    same = {name: getattr(asked, name) for name in ("goals", "people", "things", "rate", "way")}
    same |= {"calibrated": True} if asked.calibrated else {}
    kept = KeptRecords(asked.keep, same)

    def reported(drive: Drive) -> None:
        drives.append(drive)
        console.print(drive.sentence)
        if asked.out is not None:  # now, since hours of drives may be broken off
            write_section(asked.out, title_of(hard), __doc__ or "", about, sheets_of(drives, hard))

    for building in buildings_of(asked.buildings, asked.data, asked.way):
        drives_in(building, asked, hard, kept, reported)
    for sheet in sheets_of(drives, hard):
        console.print(sheet.to_rich())


if __name__ == "__main__":
    main()
