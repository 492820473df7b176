"""`python -m benchmarks.laps`: two laps of a building, with loops closed, and each loop held against the truth.

Each building is driven by the simulator with `realism="real"`, by the camera alone and by joined sensors. "As lived" is
the trajectory while driving, in `odom`; "at the end" is the corrected one. A loop is false that is more than 0.5 m or
10° off, and farther than its covariance allows (in a corridor it does not constrain the way along). A revisit is a
keyframe that lies within 1 m and 30° of one that is at least 20 s older; it is closed where a kept loop ends at it.
"Right" are true loops that were refused. "In 2 cm" are stable surfels of the map at the end that lie within
2 cm of a true surface, the map laid where it fits best. The robot does not know its unit's errors of depth, lens,
registration and mount, except with `--calibrated`: then its owner has found them by a board and a drive before.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from rich.console import Console
from scipy.stats import chi2

from benchmarks import calibrated_unit, machine
from benchmarks.kept_records import KeptRecords
from benchmarks.laps_surface import share_within, surface_of
from benchmarks.sequences import default_data_folder
from benchmarks.session_starts import Building, drive_in
from benchmarks.sessions import buildings_of
from benchmarks.table import Sheet, targets_sheet, write_page
from benchmarks.targets import Target
from wheelsight.app.run.loops import CorrectionRecord
from wheelsight.app.run.run_record import RunRecord
from wheelsight.app.runs import run_each
from wheelsight.config import load_config
from wheelsight.core.estimates import Status
from wheelsight.core.geometry import BoolArray, FloatArray, IntArray, se3
from wheelsight.mapping import load_map
from wheelsight.slam.graph import RelativePose
from wheelsight_sim import SimulatedRecording

MODES = {"camera alone": ("dense", "dense"), "joined": ("joined", "wheels,dense")}
FALSE_M, FALSE_DEG, BEYOND = 0.5, 10.0, 1e-4
NEAR_M, ALIKE_DEG, OLDER_S = 1.0, 30.0, 20.0
POSED = (Status.TRACKING, Status.COASTING)
CLOSED_PERCENT, OF_LIVED = 80.0, 0.5
_LOOPS = "kept", "false", "refused", "right", "closed"
HEADER = ("drive", "way m", "posed", "as lived m", "at the end m", "share", *_LOOPS, "in 2 cm")


@dataclass(frozen=True)
class Laps:
    """What came of one drive.

    Attributes:
        building, mode: where, and by what.
        seed: of the drive.
        way_m: how long it was.
        posed: the share of frames with a pose.
        lived_m, end_m: RMSE of positions by rigid alignment.
        kept, refused: loops that were offered.
        false: of those kept.
        refused_true: of those refused, how many were right.
        revisits, closed: keyframes.
        surfels_near: the share of stable surfels within 2 cm of a true surface; None where that was not measured.
    """

    building: str
    mode: str
    seed: int
    way_m: float
    posed: float
    lived_m: float
    end_m: float
    kept: int
    refused: int
    false: int
    refused_true: int
    revisits: int
    closed: int
    surfels_near: float | None = None

    @property
    def row(self) -> tuple[str, ...]:
        """Of the table."""
        name = f"{self.building}, seed {self.seed}, {self.mode}"
        errors = f"{self.lived_m:.3f}", f"{self.end_m:.3f}", f"{self.end_m / self.lived_m:.2f}"
        loops = str(self.kept), str(self.false), str(self.refused), str(self.refused_true)
        return (
            name,
            f"{self.way_m:.0f}",
            f"{100 * self.posed:.0f} %",
            *errors,
            *loops,
            f"{self.closed}/{self.revisits}",
            "—" if self.surfels_near is None else f"{100 * self.surfels_near:.1f} %",
        )


@dataclass(frozen=True)
class Kept:
    """A folder of drives that were all measured in one way, so that hours of them can be broken off.

    Attributes:
        folder: of a file for each; None keeps nothing.
        measured_with: what they depend on besides, which each file repeats.
    """

    folder: Path | None
    measured_with: dict[str, float]

    def of(self, building: str, mode: str, seed: int) -> Laps | None:
        """What was measured before, if anything. Raises InputError for a file that was measured otherwise."""
        found = self._records.of(_name_of(building, mode, seed))
        return None if found is None else Laps(**found)

    def keep(self, found: Laps) -> None:
        """Write a file, whole or not at all."""
        self._records.keep(_name_of(found.building, found.mode, found.seed), asdict(found))

    @property
    def _records(self) -> KeptRecords:
        return KeptRecords(self.folder, self.measured_with)


def _name_of(building: str, mode: str, seed: int) -> str:
    return f"{building}-{mode.replace(' ', '-')}-{seed}"


def driven(building: Building, mode: str, seed: int, laps: int, rate_hz: float, units: Path | None = None) -> Laps:
    """Drive, map, and hold the loops against the truth; `units` as in `drive_in`."""
    source = drive_in(building, rate_hz, seed, laps=laps, units=units)
    name, odometry = MODES[mode]
    config = load_config(overrides={"odometry": odometry, "map": "surfels", "loops.source": "keyframes"})
    with TemporaryDirectory() as folder:
        record = next(one for one in run_each(source, config, Path(folder)) if one.odometry == name)
        near = _surfels_near(record, Path(folder), source)
    assert source.calibration.T_base_camera is not None
    found = judged(record, np.asarray(source.calibration.T_base_camera), building.name, mode, seed)
    return replace(found, surfels_near=near)


def _surfels_near(record: RunRecord, folder: Path, source: SimulatedRecording) -> float:
    assert record.map is not None
    assert record.correction is not None
    assert record.correction.evaluation is not None
    stable = load_map(next(folder.rglob(record.map.file))).surfels("stable")
    return share_within(
        stable.position.astype(float), record.correction.evaluation.ate.T_truth_estimate, surface_of(source)
    )


def judged(record: RunRecord, T_base_camera: FloatArray, building: str, mode: str, seed: int) -> Laps:
    """The figures of a run."""
    truth, correction = record.ground_truth, record.correction
    assert truth is not None
    assert correction is not None
    assert record.evaluation is not None
    assert correction.evaluation is not None
    stamps_s = np.asarray(correction.stamps_s)
    body = truth.at(np.clip(stamps_s, *truth.stamps_s[[0, -1]]))
    T_world_camera = body @ T_base_camera if truth.body == "base" else body
    kept, refused, ends = _loops(correction, T_world_camera)
    is_revisit = revisits(stamps_s, T_world_camera)
    posed = float(np.mean([frame.status in POSED for frame in record.frames]))
    lived_m, end_m = (one.ate.translation.rmse for one in (record.evaluation, correction.evaluation))
    counts = len(kept), len(refused), int(np.sum(~kept)), int(np.sum(refused))
    closed = int(np.count_nonzero(is_revisit & np.isin(np.arange(len(stamps_s)), ends)))
    way_m = float(truth.distances_m[-1])
    return Laps(building, mode, seed, way_m, posed, lived_m, end_m, *counts, int(is_revisit.sum()), closed)


def _loops(correction: CorrectionRecord, T_world_camera: FloatArray) -> tuple[BoolArray, BoolArray, IntArray]:
    """Whether those kept are right, and those refused; and keyframes at which kept ones end."""
    loops = correction.found.loops
    answers = []
    for some in (loops.kept, loops.refused):
        right = [is_right(T_world_camera[[one.first, one.second]], one) for one in some]
        answers.append(np.array(right, bool))
    ends = np.array([max(one.first, one.second) for one in loops.kept], int)
    return answers[0], answers[1], ends


def is_right(T_world_ends: FloatArray, loop: RelativePose) -> bool:
    """Whether a loop between cameras that truly are at (2, 4, 4) shows how they lie, in directions that it shows."""
    off = loop.T_first_second @ se3.invert(se3.invert(T_world_ends[0]) @ T_world_ends[1])
    xi = se3.log(off)
    is_near = np.linalg.norm(off[:3, 3]) <= FALSE_M and np.degrees(np.linalg.norm(xi[3:])) <= FALSE_DEG
    return bool(is_near or xi @ np.linalg.solve(loop.covariance, xi) <= chi2.isf(BEYOND, 6))


def revisits(stamps_s: FloatArray, T_world_camera: FloatArray) -> BoolArray:
    """(K,) which keyframes show what a much older one shows."""
    position, forward = T_world_camera[:, :3, 3], T_world_camera[:, :3, 2]
    near = np.linalg.norm(position[:, None] - position[None], axis=-1) <= NEAR_M
    alike = forward @ forward.T >= np.cos(np.radians(ALIKE_DEG))
    older = stamps_s[:, None] - stamps_s[None] >= OLDER_S
    return np.asarray((near & alike & older).any(axis=1))


def judge(drives: list[Laps]) -> Iterator[Target]:
    """What must be reached."""
    yield Target(f"false loops kept, in {len(drives)} drives", 0, sum(one.false for one in drives), "loops", 0)
    closed, all_revisits = (sum(getattr(one, name) for one in drives) for name in ("closed", "revisits"))
    yield Target("true revisits closed", CLOSED_PERCENT, 100 * closed / max(all_revisits, 1), "%", is_least=True)
    for mode in MODES:
        shares = [one.end_m / one.lived_m for one in drives if one.mode == mode and one.revisits]
        yield Target(
            f"{mode}: ATE of that as lived, median", OF_LIVED, float(np.median(shares)) if shares else None, "", 2
        )


def sheets_of(drives: list[Laps]) -> list[Sheet]:
    """What drives came to, and what must be reached."""
    return [Sheet("Laps", HEADER, tuple(one.row for one in drives)), targets_sheet(list(judge(drives)))]


def main() -> None:
    """Print what was measured, and write it where asked to."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.laps", description=__doc__)
    parser.add_argument("--data", type=Path, default=default_data_folder(), help="folder with maps/PLAN in it")
    parser.add_argument("--buildings", nargs="+", default=["flat", "floor4", "Freiburg79_scan_furnitures.png"])
    parser.add_argument("--seeds", type=int, default=1, help="drives of each building by each way")
    parser.add_argument("--laps", type=int, default=2)
    parser.add_argument("--rate", type=float, default=10.0, help="images a second")
    parser.add_argument("--way", type=float, default=40.0, help="metres of a lap through a plan")
    parser.add_argument("--modes", nargs="+", choices=list(MODES), default=list(MODES))
    calibrated_unit.add_option(parser)
    parser.add_argument("--out", type=Path, help="Markdown to write")
    parser.add_argument("--keep", type=Path, metavar="DIR", help="keeps drives; those kept are not measured again")
    arguments = parser.parse_args()
    what = f"--buildings {' '.join(arguments.buildings)} --seeds {arguments.seeds} --laps {arguments.laps} "
    what += f"--rate {arguments.rate:g} --way {arguments.way:g} --modes {' '.join(map(repr, arguments.modes))}"
    what += " --calibrated" if arguments.calibrated else ""
    about = machine.description() | {"Command": f"`python -m benchmarks.laps {what}`", "Images": "320×240"}
    how = {"laps": arguments.laps, "rate_hz": arguments.rate, "way_m": arguments.way}
    kept = Kept(arguments.keep, how | ({"calibrated": 1.0} if arguments.calibrated else {}))
    console, drives = Console(width=150), list[Laps]()
    for building in buildings_of(arguments.buildings, arguments.data, arguments.way):
        for seed in range(1, arguments.seeds + 1):
            for mode in arguments.modes:
                found = kept.of(building.name, mode, seed)
                how_driven = arguments.laps, arguments.rate, arguments.calibrated
                drives.append(found or driven(building, mode, seed, *how_driven))
                kept.keep(drives[-1])
                console.print(" · ".join(drives[-1].row))
                if arguments.out is not None:  # now, since hours of drives may be broken off
                    write_page(arguments.out, "Laps", __doc__ or "", about, sheets_of(drives))
    for sheet in sheets_of(drives):
        console.print(sheet.to_rich())


if __name__ == "__main__":
    main()
