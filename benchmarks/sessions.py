"""`python -m benchmarks.sessions`: the map of one day, and whether the robot finds itself in it on the next.

Each building is driven twice by the simulator, with `realism="real"`. On the first day wheels and camera, joined, make
a map of one lap. On the second day the light is another, chairs and bins stand elsewhere, and people walk about. That
drive starts at many moments of the lap, with a camera alone and with joined sensors, as `wheelsight run --map-from`
does it, without a given pose. The robot of one building also gets the map of the other.

"Found" is the first frame that is answered `tracking`; errors, of position and heading, are medians of all such frames,
up to 3 s after the first. They are errors relative to the map's nearest keyframe, by the true poses of both days,
since a robot drives by its surroundings. A place is wrong that is more than 0.5 m or 10° off
so at that first frame. "In the whole map" are errors by one rigid alignment of the first day's corrected trajectory
with its truth: they hold what is wrong with the map itself, too.

A robot that has found itself is also carried to another place of the building during four seconds in the dark, in which
its wheels stand. "Unnoticed" is a `tracking` at a wrong place three seconds after the light came back, or later, of a
robot that had not been found again; "then misled" is one of those that had.

The robot does not know its unit's errors of depth, lens, registration and mount, except with `--calibrated`: then
its owner has found them by a board and a drive before, as docs/tutorial-your-robot.md says, for both days.
"""

from __future__ import annotations

import argparse
import statistics
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory

from rich.console import Console

from benchmarks import calibrated_unit, machine
from benchmarks.kept_records import KeptRecords
from benchmarks.sequences import default_data_folder
from benchmarks.session_kidnaps import Kidnapping, kidnap_moments, kidnapped_at
from benchmarks.session_maps import kept_day, kept_one
from benchmarks.session_starts import MODES, Building, FirstDay, SecondDay, Start, moments_of, second_day, start_at
from benchmarks.table import Sheet, targets_sheet, write_page
from benchmarks.targets import Target
from wheelsight.core.calibration import Calibration
from wheelsight_sim import FloorPlan

FOUND_PERCENT, WITHIN_S, MEDIAN_M, MEDIAN_DEG = 95.0, 5.0, 0.05, 1.0
UNNOTICED_PERCENT = 1.0
_PLAN_M = 0.05  # a pixel of the plans that have no YAML file


def buildings_of(names: Sequence[str], data: Path, way_m: float) -> list[Building]:
    """Worlds by their names, and floor plans by those of their files."""
    found = []
    for name in names:
        path = data / "maps" / name
        has_yaml = path.suffix == ".yaml"
        plan = FloorPlan(path, None if has_yaml else _PLAN_M, None, None, way_m) if path.suffix else None
        found.append(Building(path.stem if plan else name, name, plan))
    return found


def map_sheet(days: Sequence[FirstDay]) -> Sheet:
    """What the first days have left."""
    rows = [(day.name, f"{day.way_m:.0f}", str(day.keyframes), str(day.together), f"{day.ate_m:.3f}") for day in days]
    return Sheet(
        "Maps of the first day", ("building", "way m", "keyframes", "that hang together", "ATE m"), tuple(rows)
    )


def own_sheet(starts: Sequence[Start]) -> Sheet:
    """A row for each building and way to begin."""
    header = ("building, begun by", "starts", "found in 5 s", "found in 10 s", "wrong", "to find s, median", "error m")
    rows = []
    for building, mode in dict.fromkeys((start.building, start.mode) for start in starts):
        some = [start for start in starts if (start.building, start.mode) == (building, mode)]
        found = [start for start in some if start.found_s is not None]
        rows.append(
            (
                f"{building}, {mode}",
                str(len(some)),
                str(sum(start.is_found_within(WITHIN_S) for start in some)),
                str(len(found)),
                str(sum(start.is_wrong for start in some)),
                _median([start.found_s or 0.0 for start in found], 1),
                _median([start.error_m for start in found], 3),
                _median([start.error_deg for start in found], 2),
                _median([start.aligned_m for start in found], 3),
                _median([start.aligned_deg for start in found], 2),
                _median([ms for start in some for ms in start.keyframe_ms], 0),
            )
        )
    return Sheet(
        "The second day in the map of the first",
        (*header, "error °", "in the whole map m", "°", "ms a keyframe, loop thread"),
        tuple(rows),
    )


def elsewhere_sheet(starts: Sequence[Start]) -> Sheet:
    """How many starts were taken for a place of a building in which they are not."""
    rows = []
    for building, mode in dict.fromkeys((start.building, start.mode) for start in starts):
        some = [start for start in starts if (start.building, start.mode) == (building, mode)]
        rows.append((f"{building}, {mode}", str(len(some)), str(sum(start.found_s is not None for start in some))))
    return Sheet("In the map of another building", ("begun in, by", "starts", "accepted"), tuple(rows))


def kidnapping_sheet(taken: Sequence[Kidnapping]) -> Sheet:
    """What became of robots that were carried elsewhere in the dark."""
    rows = []
    for building, mode in dict.fromkeys((one.building, one.mode) for one in taken):
        some = [one for one in taken if (one.building, one.mode) == (building, mode)]
        found = [one for one in some if one.was_found]
        again = [one.again_s for one in found if one.again_s is not None]
        counts = (len(some), len(found), sum(one.is_unnoticed for one in found), len(again))
        astray = str(sum(one.is_astray for one in found))
        rows.append((f"{building}, {mode}", *map(str, counts), _median(again, 1), astray))
    header = (
        "carried off in, by",
        "times",
        "found before",
        "unnoticed after 3 s",
        "found again in 10 s",
        "after s, median",
        "then misled",
    )
    return Sheet("Carried elsewhere in the dark", header, tuple(rows))


def judge(own: Sequence[Start], elsewhere: Sequence[Start], taken: Sequence[Kidnapping] = ()) -> list[Target]:
    """What must be reached."""
    unnoticed = 100 * sum(one.is_unnoticed for one in taken) / max(sum(one.was_found for one in taken), 1)
    found = [start for start in own if start.found_s is not None]
    share = 100 * sum(start.is_found_within(WITHIN_S) for start in own) / max(len(own), 1)
    error_m, error_deg = ([getattr(start, name) for start in found] for name in ("error_m", "error_deg"))
    return [
        Target(f"found within 5 s of driving, of {len(own)} starts", FOUND_PERCENT, share, "%", is_least=True),
        Target("error once found, median", MEDIAN_M, statistics.median(error_m) if found else None, "m", 3),
        Target(
            "error of heading once found, median", MEDIAN_DEG, statistics.median(error_deg) if found else None, "°", 2
        ),
        Target(f"wrong places accepted, of {len(own)} starts", 0, sum(start.is_wrong for start in own), "starts", 0),
        Target(
            f"accepted in another building's map, of {len(elsewhere)} starts",
            0,
            sum(start.found_s is not None for start in elsewhere),
            "starts",
            0,
        ),
        Target(f"carried off unnoticed, of {len(taken)} times", UNNOTICED_PERCENT, unnoticed if taken else None, "%"),
    ]


def _median(values: Sequence[float], decimals: int) -> str:
    return f"{statistics.median(values):.{decimals}f}" if values else "—"


@dataclass
class Measured:
    """All that was measured so far.

    Attributes:
        known: maps of first days.
        own, elsewhere: starts, in the map of their own building and in that of another one.
        taken: robots that were carried off.
    """

    known: list[FirstDay] = field(default_factory=list)
    own: list[Start] = field(default_factory=list)
    elsewhere: list[Start] = field(default_factory=list)
    taken: list[Kidnapping] = field(default_factory=list)


def map_settings(asked: argparse.Namespace) -> dict[str, object]:
    """On what a first day's map depends, beside its building."""
    return {"rate": asked.rate, "way": asked.way, "calibrated": asked.calibrated is not None}


def measure(buildings: Sequence[Building], asked: argparse.Namespace, folder: Path, console: Console) -> Measured:
    """All starts and kidnappings, in maps that the folder has, or gets; what it has of them is not measured again."""
    of = Measured()
    for building in buildings:
        of.known.append(kept_day(building, folder, map_settings(asked), asked.rate, asked.calibrated))
        day = of.known[-1]
        reported = f"{day.together} of {day.keyframes} keyframes together, {day.ate_m:.3f} m off"
        console.print(f"{building.name}: first day mapped, {day.way_m:.0f} m, {reported}")
    for number, building in enumerate(buildings):
        calibration, events = second_day(building, asked.rate, asked.calibrated)
        console.print(f"{building.name}: second day rendered")
        records = KeptRecords(folder / f"{building.name}-next-day", map_settings(asked))
        other = of.known[(number + 1) % len(buildings)]
        _measure_starts(of, (of.known[number], other), (calibration, events), asked.starts, records, console)
        for moments_s, mode in kidnap_moments(asked.kidnaps, events):
            what = f"carried-{moments_s[0]:.2f}-{moments_s[1]:.2f}-{mode}"
            taken = partial(kidnapped_at, moments_s, mode, calibration, events, of.known[number])
            of.taken.append(kept_one(records, what, Kidnapping, taken))
            console.print(of.taken[-1].sentence)
    return of


def _measure_starts(
    of: Measured,
    maps: tuple[FirstDay, FirstDay],
    day: tuple[Calibration, SecondDay],
    count: int,
    records: KeptRecords,
    console: Console,
) -> None:
    """So many by each mode in the map of the day's own building, and one each in another building's, in turn."""
    (known, other), (calibration, events) = maps, day
    for number, moment_s in enumerate(moments_of(events, count)):
        for mode in MODES:
            made = partial(start_at, moment_s, mode, calibration, events, known, known.name)
            of.own.append(kept_one(records, f"start-{moment_s:.2f}-{mode}", Start, made))
            console.print(of.own[-1].sentence)
        if other is not known:
            mode = MODES[number % len(MODES)]
            made = partial(start_at, moment_s, mode, calibration, events, other, known.name, has_truth=False)
            of.elsewhere.append(kept_one(records, f"in-{other.name}-{moment_s:.2f}-{mode}", Start, made))
            console.print(f"in the map of {other.name}: {of.elsewhere[-1].sentence}")


def main() -> None:
    """Print what was measured, and write it where asked to."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.sessions", description=__doc__)
    parser.add_argument("--data", type=Path, default=default_data_folder(), help="folder with maps/PLAN in it")
    parser.add_argument("--buildings", nargs="+", default=["flat", "floor4", "Freiburg79_scan_furnitures.png"])
    parser.add_argument("--starts", type=int, default=25, help="in each building, by each way to begin")
    parser.add_argument("--kidnaps", type=int, default=12, help="in each building")
    parser.add_argument("--rate", type=float, default=15.0, help="images a second")
    parser.add_argument("--way", type=float, default=60.0, help="metres of the tour through a plan")
    parser.add_argument(
        "--keep", type=Path, help="folder for maps, starts and the rest: what it has is not measured again"
    )
    calibrated_unit.add_option(parser)
    parser.add_argument("--out", type=Path, help="Markdown to write")
    arguments = parser.parse_args()
    console, about = Console(width=150), machine.description()
    buildings = buildings_of(arguments.buildings, arguments.data, arguments.way)
    with TemporaryDirectory() as name:
        of = measure(buildings, arguments, arguments.keep or Path(name), console)
    targets = targets_sheet(judge(of.own, of.elsewhere, of.taken))
    sheets = [
        map_sheet(of.known),
        own_sheet(of.own),
        elsewhere_sheet(of.elsewhere),
        kidnapping_sheet(of.taken),
        targets,
    ]
    for sheet in sheets:
        console.print(sheet.to_rich())
    if arguments.out is not None:
        what = f"--buildings {' '.join(arguments.buildings)} --starts {arguments.starts} --kidnaps {arguments.kidnaps} "
        what += f"--rate {arguments.rate:g} --way {arguments.way:g}{' --calibrated' if arguments.calibrated else ''}"
        about |= {"Command": f"`python -m benchmarks.sessions {what}`", "Images": "320×240"}
        write_page(arguments.out, "Sessions", __doc__ or "", about, sheets)


if __name__ == "__main__":
    main()
