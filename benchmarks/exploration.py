"""`python -m benchmarks.exploration`: a wheelchair looks at all floor of flats that it does not know.

It begins where the world has it begin, or somewhere roomy in a plan, and explores as `wheelsight drive --explore` does:
real sensors (`realism="real"`), its own localization, no truth in the loop. The map that it leaves is evaluated,
aligned with the truth by the rigid alignment of its keyframes.

"Reachable" is the floor that the chair's outline covers at any pose to which it can come from the start by turning on
the spot and driving along its heading, in the true plan, with the margin that its plans and commands keep (cells of
0.05 m, 48 headings). "Seen" is the share of it that the map calls free, as the next drive would take it. "Made up" is
floor that the map calls free on which something stands, or that lies behind walls, by more than a cell's diagonal.
"Map" is the RMSE of the keyframes' places; "walls" the median distance of occupied cells beside free ones from the
nearest side of what truly stands there.

"Tour" is the way of a robot that knows the plan, and looks all around at some places until it has seen 97 % of what can
be seen of that floor from anywhere, as far as the map uses depth, and no nearer than the camera sees floor. Places
result from a greedy set cover, their order from the nearest next one and 2-opt: a short tour, not proved to be the
shortest.
"Clearance" is the least true distance from the outline to things; time is simulated.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from rich.console import Console

from benchmarks import machine
from benchmarks.exploration_drives import SHARE_PERCENT, Explored, How, explored
from benchmarks.kept_records import KeptRecords
from benchmarks.navigation_page import write_section
from benchmarks.sequences import default_data_folder
from benchmarks.session_starts import Building
from benchmarks.sessions import buildings_of
from benchmarks.table import Sheet, targets_sheet
from benchmarks.targets import Target

TOURS = 2.0
_TOUR_M = 40.0  # of a plan's own route, along which it has furniture, and along which no one drives here
FOUR_FLATS = ("studio", "flat", "map_real.yaml", "indoor.yaml")
_TITLE = "Unknown flats, explored"
_HEADER = (
    "flat",
    "reachable m²",
    "seen",
    "made up m²",
    "map m",
    "walls m",
    "way m",
    "tour m",
    "touched",
    "clearance m",
    "s",
    "keyframes",
    "loops",
)


def row_of(one: Explored) -> tuple[str, ...]:
    """Of the table."""
    return (
        f"{one.building}, seed {one.seed}",
        f"{one.reachable_m2:.1f}",
        f"{one.share_percent:.1f} %",
        f"{one.wrong_m2:.2f}",
        f"{one.ate_m:.3f}",
        f"{one.walls_m:.3f}",
        f"{one.way_m:.1f}",
        f"{one.tour_m:.1f}",
        str(len(one.contacts)),
        f"{one.clearance_m:.2f}",
        f"{one.time_s:.0f}",
        str(one.keyframes),
        str(one.loops),
    )


def is_good(one: Explored) -> bool:
    """Whether it is all that was to be reached."""
    return not (one.ended or one.contacts) and one.share_percent >= SHARE_PERCENT and one.tours <= TOURS


def targets_of(found: Sequence[Explored]) -> list[Target]:
    """What must be reached: in each flat, hence by the worst of them."""
    least, most = min(one.share_percent for one in found), max(one.tours for one in found)
    touched = sum(bool(one.contacts) for one in found)
    return [
        Target(f"least share of reachable floor seen, of {len(found)} flats", SHARE_PERCENT, least, "%", is_least=True),
        Target("longest way, in tours that know the plan", TOURS, most, "", 2),
        Target("flats in which something was touched", 0, touched, "", 0),
    ]


def sheets_of(found: Sequence[Explored]) -> list[Sheet]:
    """What explorations came to, what must be reached, and what fell short of it."""
    short = tuple((one.sentence,) for one in found if not is_good(one))
    sheets = [Sheet("Explorations", _HEADER, tuple(map(row_of, found))), targets_sheet(targets_of(found))]
    return [*sheets, Sheet("Shortfalls", ("exploration",), short)] if short else sheets


def explored_in(building: Building, how: How, seed: int, kept: KeptRecords) -> Explored:
    """Kept from before, or measured now."""
    name = f"{building.name}-{seed}"
    record = kept.of(name)
    if record is None:
        with TemporaryDirectory() as folder:
            found = explored(building, how, seed, Path(folder) / "map")
        kept.keep(name, asdict(found))
        return found
    return _of(record)


def _of(record: dict[str, Any]) -> Explored:
    return Explored(**{**record, "contacts": tuple(record["contacts"])})


def _asked() -> argparse.Namespace:
    parser = argparse.ArgumentParser(prog="python -m benchmarks.exploration", description=__doc__)
    parser.add_argument("--data", type=Path, default=default_data_folder(), help="folder with maps/PLAN in it")
    parser.add_argument("--flats", nargs="+", default=list(FOUR_FLATS), help="plans, or worlds: studio, flat")
    parser.add_argument("--seeds", type=int, nargs="+", default=[1], help="of all that is random")
    parser.add_argument("--rate", type=float, default=10.0, help="images a second")
    parser.add_argument("--longest", type=float, default=1200.0, help="simulated seconds")
    parser.add_argument("--pictures", type=Path, metavar="DIR", help="of maps over the truth")
    parser.add_argument("--out", type=Path, help="page whose section is written, docs/benchmarks/navigation.md")
    parser.add_argument("--keep", type=Path, metavar="DIR", help="keeps drives; those kept are not measured again")
    return parser.parse_args()


def main() -> None:
    """Print what was measured, and write it where asked to."""
    asked = _asked()
    what = f"--flats {' '.join(asked.flats)} --seeds {' '.join(map(str, asked.seeds))} --rate {asked.rate:g}"
    about = machine.description() | {"Command": f"`python -m benchmarks.exploration {what}`", "Images": "320×240"}
    how = How(asked.rate, asked.longest, asked.pictures)
    kept = KeptRecords(asked.keep, {"rate": asked.rate, "longest": asked.longest})
    console, found = Console(width=150), list[Explored]()
    for building in buildings_of(asked.flats, asked.data, _TOUR_M):
        for seed in asked.seeds:
            found.append(explored_in(building, how, seed, kept))
            console.print(found[-1].sentence)
            if asked.out is not None:  # now, since hours of drives may be broken off
                write_section(asked.out, _TITLE, __doc__ or "", about, sheets_of(found))
    for sheet in sheets_of(found):
        console.print(sheet.to_rich())


if __name__ == "__main__":
    main()
