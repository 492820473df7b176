"""`python -m benchmarks.given_starts`: starts that a person gives in a known map, right and wrong ones.

Each building is mapped on one day and driven on the next, as in `benchmarks.sessions`: other light, chairs elsewhere,
people who walk about. That drive is begun at many moments, each time with a start near the true one (0.1 m and 5°),
with a wrong one (1.5 to 5 m off, any heading), and with a start in another building's map.

A frame is wrong if it is `tracking` and over 0.5 m off beside the map's nearest keyframe; in another
building each `tracking` frame is. A right start is refused if the localizer refutes it.
"""

from __future__ import annotations

import argparse
import math
import statistics
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from rich.console import Console

from benchmarks import calibrated_unit, machine
from benchmarks.kept_records import KeptRecords
from benchmarks.sequences import default_data_folder
from benchmarks.session_maps import kept_day, kept_one
from benchmarks.session_starts import FirstDay, SecondDay, beside_nearest, moments_of, off_by, second_day
from benchmarks.sessions import buildings_of, map_settings
from benchmarks.table import Sheet, write_page
from wheelsight import Localizer, Status, load_config
from wheelsight.app.run.maps import open_known
from wheelsight.core.calibration import Calibration
from wheelsight.core.messages import RgbdFrame
from wheelsight.navigation.senses import planar_pose

KINDS = ("right", "wrong", "another building")
FAR_M = 0.5
_WINDOW_S = 30.0


@dataclass(frozen=True)
class GivenStart:
    """The result of a start.

    Attributes:
        building, kind: of `KINDS`.
        moment_s: of the second day.
        off_m: of the given start from the true one.
        frames, tracking, wrong: numbers of frames; wrong have a wrong pose.
        confirmed_s: time until the first frame that is `tracking`; NaN without any.
        refuted_s, refuted_m: time and way until the start was refuted; NaN if it was not.
        wrong_m: way from the first to the last frame with a wrong pose.
        error_m: median error of frames that are `tracking`.
    """

    building: str
    kind: str
    moment_s: float
    off_m: float
    frames: int
    tracking: int
    wrong: int
    confirmed_s: float
    refuted_s: float
    refuted_m: float
    wrong_m: float
    error_m: float


def given_start(
    kind: str, moment_s: float, calibration: Calibration, day: SecondDay, known: FirstDay, rng: np.random.Generator
) -> GivenStart:
    """Begin a day at a moment with a start of a kind, and drive on for `_WINDOW_S`."""
    events = [event for event in day.events if moment_s <= event.stamp_s < moment_s + _WINDOW_S]
    T_world_base = day.truth.at([max(events[0].stamp_s, day.truth.stamps_s[0])])[0]
    x, y, yaw = planar_pose(beside_nearest(T_world_base, known.T_world_base, known.T_map_base))
    away_m, away_rad = (0.1, math.radians(5.0)) if kind == "right" else (rng.uniform(1.5, 5.0), rng.uniform(-3.1, 3.1))
    towards = rng.uniform(-math.pi, math.pi)
    start = (x + away_m * math.cos(towards), y + away_m * math.sin(towards), math.degrees(yaw + away_rad))
    names = ("x_m", "y_m", "yaw_deg")
    given = {f"known_map.start.{name}": float(value) for name, value in zip(names, start, strict=True)}
    config = load_config(overrides={"odometry": "wheels,dense", "known_map.path": str(known.folder), **given})
    opened = open_known(day.source.calibration, config)
    assert opened is not None
    subject = Localizer(calibration, config, known=opened[0], waits=True)
    rows = list[tuple[float, float, Status, float, bool]]()  # stamp, way, status, error, refuted
    last, way_m = T_world_base, 0.0
    for event in events:
        answer = subject.process(event)
        if not isinstance(event, RgbdFrame) or answer is None:
            continue
        now = day.truth.at([min(max(event.stamp_s, day.truth.stamps_s[0]), day.truth.stamps_s[-1])])[0]
        way_m, last = way_m + float(np.linalg.norm((now - last)[:2, 3])), now
        is_posed = answer.T_map_body is not None
        off_m = off_by(answer, day.truth, known)[0] if is_posed and kind != "another building" else math.inf
        refuted = any("nothing looks like" in one for one in subject.warnings)
        rows.append((event.stamp_s - events[0].stamp_s, way_m, answer.status, off_m, refuted))
    subject.close()
    opened[1].close()
    tracked = [row for row in rows if row[2] is Status.TRACKING]
    wrong = [row for row in tracked if row[3] > FAR_M]
    refuted_at = next(((s, m) for s, m, _, _, is_refuted in rows if is_refuted), (math.nan, math.nan))
    return GivenStart(
        known.name,
        kind,
        moment_s,
        away_m,
        len(rows),
        len(tracked),
        len(wrong),
        tracked[0][0] if tracked else math.nan,
        *refuted_at,
        wrong[-1][1] - wrong[0][1] if wrong else 0.0,
        statistics.median(row[3] for row in tracked) if tracked else math.nan,
    )


def summary_sheet(starts: Sequence[GivenStart]) -> Sheet:
    """One row for each building and kind."""
    header = (
        *("building, start", "starts", "wrong frames", "way with them, at most m", "confirmed in 5 s"),
        *("to confirm s, median", "refuted", "after m", "error m"),
    )
    rows = list[tuple[str, ...]]()
    for name in dict.fromkeys(one.building for one in starts):
        for kind in KINDS:
            of = [one for one in starts if (one.building, one.kind) == (name, kind)]
            if not of:
                continue
            confirmed = [one.confirmed_s for one in of if not math.isnan(one.confirmed_s)]
            refuted = [one.refuted_m for one in of if not math.isnan(one.refuted_m)]
            errors = [one.error_m for one in of if math.isfinite(one.error_m)]
            row = (
                f"{name}, {kind}",
                str(len(of)),
                f"{sum(one.wrong for one in of)} of {sum(one.tracking for one in of)}",
                f"{max(one.wrong_m for one in of):.1f}",
                str(sum(one <= 5.0 for one in confirmed)),
                f"{statistics.median(confirmed):.1f}" if confirmed else "—",
                str(len(refuted)),
                f"{statistics.median(refuted):.1f}" if refuted else "—",
                f"{statistics.median(errors):.3f}" if errors else "—",
            )
            rows.append(row)
    return Sheet("Given starts", header, tuple(rows))


def main() -> None:
    """Print what was measured, and write it where asked to."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.given_starts", description=__doc__)
    parser.add_argument("--data", type=Path, default=default_data_folder(), help="folder with maps/PLAN in it")
    parser.add_argument("--buildings", nargs="+", default=["flat", "Freiburg79_scan_furnitures.png"])
    parser.add_argument("--starts", type=int, default=15, help="of each kind in each building")
    parser.add_argument("--rate", type=float, default=10.0, help="images a second")
    parser.add_argument("--way", type=float, default=40.0, help="metres of the tour through a plan")
    parser.add_argument(
        "--keep", type=Path, metavar="DIR", help="keeps results, and maps, which may be those of benchmarks.sessions"
    )
    calibrated_unit.add_option(parser)
    parser.add_argument("--out", type=Path, help="Markdown to write")
    arguments = parser.parse_args()
    console, about = Console(width=150), machine.description()
    buildings, found = buildings_of(arguments.buildings, arguments.data, arguments.way), list[GivenStart]()
    with TemporaryDirectory() as name:
        folder = arguments.keep or Path(name)
        how = map_settings(arguments)
        known = [kept_day(one, folder, how, arguments.rate, arguments.calibrated) for one in buildings]
        records = KeptRecords(folder / "given-starts", how)
        for number, (building, own) in enumerate(zip(buildings, known, strict=True)):
            calibration, day = second_day(building, arguments.rate, arguments.calibrated)
            other = known[number - 1]
            maps = {"right": own, "wrong": own} | ({} if other is own else {"another building": other})
            for at, moment_s in enumerate(moments_of(day, arguments.starts)):
                for kind, of in maps.items():
                    rng = np.random.default_rng([number, at, KINDS.index(kind)])
                    measured = partial(given_start, kind, moment_s, calibration, day, of, rng)
                    found.append(kept_one(records, f"{building.name} {kind} {at}", GivenStart, measured))
                    console.print(found[-1])
    sheet = summary_sheet(found)
    console.print(sheet.to_rich())
    if arguments.out is not None:
        what = f"--buildings {' '.join(arguments.buildings)} --starts {arguments.starts} --rate {arguments.rate:g} "
        what += f"--way {arguments.way:g}{' --calibrated' if arguments.calibrated else ''}"
        about |= {"Command": f"`python -m benchmarks.given_starts {what}`", "Images": "320×240"}
        write_page(arguments.out, "Given starts", __doc__ or "", about, [sheet])


if __name__ == "__main__":
    main()
