"""Trinh et al., Position Rectification with Depth Camera: Table I and Fig. 8, and what a probabilistic way makes of it.

A wheelchair whose wheels are not what its owner believes drives round a simulated floor. A random forest learns from
1433 frames of some drives which area looks how; on other drives, in other light, with other posters and with people
about, its answers rectify the wheels, by the paper's eq. 5 and by a probabilistic filter. Printed beside the paper's
figures, mean and spread over several sets of drives. The drives are kept in the output folder, so that a second run
takes seconds.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path

import numpy as np
from _trinh_drives import DescribedDrive, DriveSettings, make_drives
from _trinh_trial import ODOMETRY_TERMS, Trial, run_trial

from wheelsight.core.errors import InputError, WheelsightError
from wheelsight.core.files import make_output_folder, write_text
from wheelsight_sim import RobotModel, SimulationSettings, World, build_world

EXAMPLES = """examples:
  python papers/trinh_rectification.py
      five sets of drives, Table I, and the figure, into ./trinh_rectification
  python papers/trinh_rectification.py --quick
      one set only
  python papers/trinh_rectification.py --both-ways --out both_ways
      every other drive goes round the other way
"""

PAPER_WITHOUT_M = 26.4
PAPER_WITH_M = (10.4, 10.0, 9.4, 9.1, 9.1, 8.9)
DRAWN_TERM = "absolute"  # eq. 5 to the letter
HEAD = ("method", "trees", "mean distance", "of the wheels'", "true RMS", "areas right", "calibration error", "paper")

# Tyres of a wheelchair pumped unevenly, and wheels that touch the ground a little wider apart than the data sheet says.
# Chosen on the training drives of the first set: they leave the wheels alone an error of the paper's size there.
ROBOT = RobotModel(left_radius_m=0.16924, right_radius_m=0.17076, track_width_m=0.525)


@dataclass(frozen=True)
class Plan:
    """How much is driven.

    Attributes:
        seeds: sets of drives, each with forests of its own.
        laps: of each drive.
        training, frames: drives of a set to train on, and how many of their frames in all, as many as the paper's.
        test: drives of a set to test on, with frames as far apart as in training.
        passersby: people about on test drives; none on training drives.
        both_ways: whether every other drive goes the other way round.
        trees: eq. 5 is tried with 1 to so many trees.
        full_trees: of the probabilistic way's own forests.
        robot: whose wheels are driven on.
    """

    seeds: int = 5
    laps: int = 2
    training: int = 8
    frames: int = 1433
    test: int = 2
    passersby: int = 3
    both_ways: bool = False
    trees: int = 6
    full_trees: int = 64
    robot: RobotModel = field(default=ROBOT)

    def training_drives(self, seed: int) -> list[DriveSettings]:
        """Of one set; what is left over of the frames goes to the first drives."""
        counts = [len(part) for part in np.array_split(np.arange(self.frames), self.training)]
        return [self._drive(1000 * seed + k, count, 0, k) for k, count in enumerate(counts, 1)]

    def test_drives(self, seed: int) -> list[DriveSettings]:
        """Of one set."""
        count = round(self.frames / self.training)
        return [self._drive(1000 * seed + 500 + k, count, self.passersby, k) for k in range(1, self.test + 1)]

    def _drive(self, seed: int, frames: int, passersby: int, number: int) -> DriveSettings:
        is_reverse = self.both_ways and number % 2 == 0
        simulation = SimulationSettings(
            seed=seed, laps=self.laps, passersby=passersby, is_reverse=is_reverse, robot=self.robot
        )
        return DriveSettings(simulation, frames)


def main(arguments: list[str] | None = None, plan: Plan | None = None) -> int:
    """Run the script; returns 0, or 2 after a one-line error. A `plan` goes before the arguments'."""
    options = _parser().parse_args(arguments)
    try:
        if options.seeds < 1:
            raise InputError(f"--seeds is {options.seeds}", fix="give 1 or more")
        seeds = 1 if options.quick else options.seeds
        reproduce(plan or Plan(seeds=seeds, both_ways=options.both_ways), options.out)
    except WheelsightError as error:
        print(f"error: {error}", file=sys.stderr)
        return 2
    return 0


def reproduce(plan: Plan, out: Path) -> None:
    """Print the table, and write it, all figures as JSON and the drawing into the folder `out`."""
    from _trinh_figure import draw

    folder = make_output_folder(out, force=True)
    kept = make_output_folder(folder / "drives", force=True)
    world = build_world("floor4", 0)
    sets = drives_of(plan, kept)
    trials = [tried(plan, world, *drives, seed) for seed, drives in enumerate(sets, 1)]
    text = table(trials, plan)
    print(text)
    write_text(folder / "table.md", text + "\n")
    write_text(folder / "results.json", json.dumps(_plain(plan, trials), indent=1) + "\n")
    tracks = trials[0].tracks
    drawn = {title: tracks[name] for title, name in drawn_methods(plan).items()}
    draw(world, sets[0][1][0].truth, tracks["wheels"], drawn, folder / "rectification.png")
    print(f"wrote {folder / 'rectification.png'}, table.md and results.json beside it")


def drives_of(plan: Plan, kept: Path) -> list[tuple[list[DescribedDrive], list[DescribedDrive]]]:
    """Training and test drives of each set."""
    wanted = [(plan.training_drives(seed), plan.test_drives(seed)) for seed in range(1, plan.seeds + 1)]
    made = iter(make_drives([drive for pair in wanted for part in pair for drive in part], kept))
    return [([next(made) for _ in training], [next(made) for _ in test]) for training, test in wanted]


def tried(plan: Plan, world: World, training: list[DescribedDrive], test: list[DescribedDrive], seed: int) -> Trial:
    """All methods on one set of drives."""
    print(f"set {seed} of {plan.seeds}: forests, weights, rectification", file=sys.stderr)
    wheels = plan.robot.nominal
    return run_trial(world.areas, wheels, training, test, most_trees=plan.trees, full_trees=plan.full_trees, seed=seed)


def drawn_methods(plan: Plan) -> dict[str, str]:
    """The names of the tracks that the figure shows, by their titles."""
    return {
        f"Trinh et al., {plan.trees} trees": f"eq. 5, {DRAWN_TERM}, {plan.trees}",
        "probabilistic": f"probabilistic, layout, {plan.full_trees}",
    }


def table(trials: Sequence[Trial], plan: Plan) -> str:
    """Table I of the paper beside ours, as Markdown: means over the sets, ± their standard deviation."""
    alone_m = [trial.errors["wheels"].mean_m for trial in trials]
    rows = [HEAD, tuple("---" for _ in HEAD)]
    for name in trials[0].errors:
        method, _, trees = name.rpartition(", ")
        found = [trial.errors[name] for trial in trials]
        shares = [errors.mean_m / alone for errors, alone in zip(found, alone_m, strict=True)]
        rows.append(
            (
                method or "wheels alone",
                trees if method else "",
                _spread([errors.mean_m for errors in found], "{:.2f}", " m"),
                _spread(shares, "{:.3f}") if method else "",
                _spread([errors.rms_m for errors in found], "{:.2f}", " m"),
                _spread([errors.accuracy for errors in found], "{:.3f}") if method else "",
                _spread([errors.calibration_error for errors in found], "{:.3f}") if method else "",
                _of_paper(method, trees),
            )
        )
    training_m = _spread([trial.unrectified_training_m for trial in trials], "{:.2f}", " m")
    said = f"{plan.seeds} set(s) of {plan.training} training and {plan.test} test drives of {plan.laps} lap(s)"
    lines = [f"| {' | '.join(row)} |" for row in rows]
    return "\n".join([*lines, "", f"{said}; on the training drives the wheels alone are off by {training_m}."])


def _of_paper(method: str, trees: str) -> str:
    if not method:
        return f"{PAPER_WITHOUT_M} m"
    if not method.startswith("eq. 5") or int(trees) > len(PAPER_WITH_M):
        return ""
    with_m = PAPER_WITH_M[int(trees) - 1]
    return f"{with_m} m, {with_m / PAPER_WITHOUT_M:.2f}"


def _spread(values: Sequence[float], form: str, unit: str = "") -> str:
    """Mean ± standard deviation; the mean alone of one value."""
    mean = form.format(np.mean(values))
    return f"{mean}{unit}" if len(values) == 1 else f"{mean} ± {form.format(np.std(values, ddof=1))}{unit}"


def _plain(plan: Plan, trials: Sequence[Trial]) -> dict[str, object]:
    """All figures, of each set."""
    sets = [
        {
            "wheels_on_training_drives_m": trial.unrectified_training_m,
            "errors": {name: asdict(errors) for name, errors in trial.errors.items()},
        }
        for trial in trials
    ]
    return {"plan": asdict(plan), "odometry_terms": list(ODOMETRY_TERMS), "sets": sets}


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        description=__doc__, epilog=EXAMPLES, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--seeds", type=int, default=5, help="sets of drives (%(default)s)")
    parser.add_argument("--quick", action="store_true", help="one set of drives")
    parser.add_argument("--both-ways", action="store_true", help="every other drive goes the other way round")
    parser.add_argument(
        "--out", type=Path, default=Path("trinh_rectification"), help="folder for results and drives (%(default)s)"
    )
    return parser


if __name__ == "__main__":
    sys.exit(main())
