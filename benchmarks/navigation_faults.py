"""`python -m benchmarks.navigation_faults`: something breaks while a wheelchair drives at full speed at a thing.

In a hall of its own for each fault, which the simulator shows with real sensors (`realism="real"`), a wheelchair has
1 m/s when a fault begins, and a wall or a thing stands 0.3 to 3 m before it, which no map knows; where that is nearer
than it brakes, it is slower already. In half of the faults a controller always commands full speed straight on,
through ramp and collision monitor alone. The others are driven by the navigator of
`wheelsight drive`, on its way to a goal behind the thing. Localization is our own, of wheels and camera joined, in
all of them: no truth in the loop.

The kinds: something lies on the camera; no frame comes any more; no wheel reading comes any more; commands do not
arrive any more (the wheel controller's watchdog takes the motors' voltage after 0.25 s, docs/serial-link.md); the
whole program stands still for 1 s (likewise); the left driven wheel hangs free; the map lies up to 0.5 m, 1 m and 0.2
rad elsewhere.

"Stopped" is without a contact. "Could stop" counts those contacts before which the way was free that braking takes:
0.3 s, then 0.8 of the limits' braking, as in the collision monitor. "Blind" is the way driven, by the truth, from
the fault until braking begins: the motors are commanded to stand, or lose their voltage. "Until it stands" is the whole
way from the fault, with that of braking. No reaction makes the latter 0.3 m at 1 m/s: braking at the limits' 1 m/s²
takes 0.5 m of it. With a lifted wheel or a wrong map the robot is not blind.
"""

from __future__ import annotations

import argparse
import statistics
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

from rich.console import Console

from benchmarks import machine
from benchmarks.fault_drives import FaultDrive, driven
from benchmarks.fault_robot import BLIND, FaultKind, drawn
from benchmarks.kept_records import KeptRecords
from benchmarks.navigation_page import write_section
from benchmarks.table import Sheet, targets_sheet
from benchmarks.targets import Target

BLIND_M, FULL_M_S = 0.3, 0.9
_TITLE = "Faults at full speed"
_HEADER = (
    "fault",
    "faults",
    "from 0.9 m/s",
    "stopped",
    "could stop, touched",
    "blind m, median",
    "blind m, most",
    "until it stands m, most",
    "went on blind",
)


def went_on(drive: FaultDrive) -> bool:
    """Whether it drove on blind for longer than it may."""
    return drive.blind_m > BLIND_M


def row_of(kind: FaultKind, drives: Sequence[FaultDrive]) -> tuple[str, ...]:
    """Of the table."""
    is_blind = kind in BLIND
    return (
        str(kind),
        str(len(drives)),
        str(sum(drive.forward_m_s >= FULL_M_S for drive in drives)),
        str(sum(not drive.contacts for drive in drives)),
        str(sum(bool(drive.contacts) and drive.could_stop for drive in drives)),
        f"{statistics.median(drive.blind_m for drive in drives):.2f}" if is_blind else "—",
        f"{max(drive.blind_m for drive in drives):.2f}" if is_blind else "—",
        f"{max(drive.stopped_m for drive in drives):.2f}" if is_blind else "—",
        str(sum(map(went_on, drives))) if is_blind else "—",
    )


def targets_of(drives: Sequence[FaultDrive]) -> list[Target]:
    """What must be reached."""
    touched = sum(bool(drive.contacts) and drive.could_stop for drive in drives)
    on = sum(map(went_on, drives))
    return [
        Target(f"contacts where the braking way was free, in {len(drives)} faults", 0, touched, "", 0),
        Target(f"drives that went on blind for more than {BLIND_M:g} m", 0, on, "", 0),
    ]


def sheets_of(drives: Sequence[FaultDrive]) -> list[Sheet]:
    """A row for each kind, what must be reached, and what went wrong."""
    by_kind = {kind: [drive for drive in drives if drive.kind == kind] for kind in FaultKind}
    rows = tuple(row_of(kind, some) for kind, some in by_kind.items() if some)
    wrong = tuple((drive.sentence,) for drive in drives if drive.contacts or went_on(drive))
    sheets = [Sheet("Outcomes", _HEADER, rows), targets_sheet(targets_of(drives))]
    return [*sheets, Sheet("Failures", ("fault",), wrong)] if wrong else sheets


def _of(record: dict[str, Any]) -> FaultDrive:
    return FaultDrive(**{**record, "contacts": tuple(record["contacts"])})


def main() -> None:
    """Print what was measured, and write it where asked to."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.navigation_faults", description=__doc__)
    parser.add_argument("--faults", type=int, default=21, help="the seven kinds take turns")
    parser.add_argument("--first", type=int, default=0, help="number of the first fault")
    parser.add_argument(
        "--seed", type=int, default=1, help="of what is drawn, and of all that is random about the robot"
    )
    parser.add_argument("--out", type=Path, help="page whose section is written, docs/benchmarks/navigation.md")
    parser.add_argument("--keep", type=Path, metavar="DIR", help="keeps drives; those kept are not measured again")
    arguments = parser.parse_args()
    what = f"--faults {arguments.faults} --first {arguments.first} --seed {arguments.seed}"
    about = machine.description() | {"Command": f"`python -m benchmarks.navigation_faults {what}`", "Images": "320×240"}
    console, drives, kept = Console(width=170), list[FaultDrive](), KeptRecords(arguments.keep, {})
    for number in range(arguments.first, arguments.first + arguments.faults):
        name = f"fault-{arguments.seed}-{number}"
        record = kept.of(name)
        if record is None:
            record = asdict(driven(drawn(number, arguments.seed), arguments.seed))
            kept.keep(name, record)
        drives.append(_of(record))
        console.print(drives[-1].sentence)
        if arguments.out is not None:  # now, since hours of drives may be broken off
            write_section(arguments.out, _TITLE, __doc__ or "", about, sheets_of(drives))
    for sheet in sheets_of(drives):
        console.print(sheet.to_rich())


if __name__ == "__main__":
    main()
