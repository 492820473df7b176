"""`wheelsight evaluate`: compares an estimated trajectory with the truth."""

from __future__ import annotations

import os
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

if TYPE_CHECKING:
    from rich.console import Group

    from wheelsight.evaluation import Evaluation

# What a folder of results holds that was given in place of a file.
_OF_RESULTS = ("trajectory.txt", "joined/trajectory.txt")


def evaluate(
    estimate: Annotated[
        Path, typer.Argument(metavar="ESTIMATE", help="Estimated trajectory, TUM text.", show_default=False)
    ],
    ground_truth: Annotated[
        Path, typer.Argument(metavar="GROUND_TRUTH", help="True trajectory, TUM text.", show_default=False)
    ],
    scale: Annotated[
        bool, typer.Option("--scale", help="Fit the estimate's scale too (hides errors of scale).")
    ] = False,
    max_gap: Annotated[
        float, typer.Option(metavar="SECONDS", min=0, help="Largest distance in time of two poses that are compared.")
    ] = 0.02,
    body: Annotated[
        Literal["camera", "base"], typer.Option(help="What a file describes whose header does not say it.")
    ] = "camera",
    as_json: Annotated[bool, typer.Option("--json", help="Print JSON instead of a table.")] = False,
) -> None:
    """Compare an estimated trajectory with the truth, as the TUM benchmark does.

    ATE after rigid alignment, RPE over a frame, a second and a metre, and how much of the time the estimate covers.

    [bold]Examples[/bold]

    wheelsight evaluate results/trajectory.txt rgbd_dataset_freiburg1_desk/groundtruth.txt
    wheelsight evaluate monocular.txt truth.txt --scale --json
    """
    from wheelsight.app.cli.console import console, print_json, print_note, print_warning
    from wheelsight.core.errors import TrajectoryError
    from wheelsight.core.trajectory import read_tum
    from wheelsight.evaluation import evaluate as compare
    from wheelsight.io.recordings import TRUTH_FILES

    for given, names in ((estimate, _OF_RESULTS), (ground_truth, tuple(TRUTH_FILES.values()))):
        if os.path.isdir(given):  # noqa: PTH112 (a name that is too long is none)
            meant = next((given / name for name in names if (given / name).is_file()), None)
            fix = "give the file" if meant is None else f"did you mean {meant}?"
            raise TrajectoryError("is a folder, not a file", path=given, fix=fix)
    estimated = read_tum(estimate, body)
    truth = read_tum(ground_truth, body)
    beside = ground_truth.with_name(TRUTH_FILES.get(estimated.body, ground_truth.name))
    if truth.body != estimated.body and beside != ground_truth and beside.is_file():
        other = read_tum(beside, estimated.body)
        if other.body == estimated.body:
            print_note(f"{ground_truth} is of the {truth.body}; {beside.name} beside it, of the {other.body}, is taken")
            truth = other
    evaluation = compare(estimated, truth, max_gap_s=max_gap, with_scale=scale)
    if as_json:
        aligned = evaluation.ate.aligned
        warnings = list(evaluation.warnings)
        print_json({"frame": f"T_{aligned.frame}_{aligned.body}", **evaluation.to_dict(), "warnings": warnings})
        return
    console().print(evaluation_table(evaluation))
    for warning in evaluation.warnings:
        print_warning(warning)


def evaluation_table(evaluation: Evaluation) -> Group:
    """Errors of positions, and of rotations: a row each, statistics in columns; coverage and scale below."""
    from rich.box import SIMPLE_HEAD
    from rich.console import Group
    from rich.table import Table

    from wheelsight.app.cli.console import percent

    aligned = evaluation.ate.aligned
    pairs = f"T_{aligned.frame}_{aligned.body}: {evaluation.pairs} pairs of poses"
    covered = f"{pairs}; {percent(evaluation.truth_time_covered)} of the truth's time covered"
    scaled = "" if evaluation.scale is None else f"; estimate scaled by {evaluation.scale:.4f}"
    tables = {unit: Table(box=SIMPLE_HEAD, caption_justify="left", caption_style="") for unit in ("m", "°")}
    for unit, table in tables.items():
        table.add_column("", min_width=len("RPE a second, position"))
        for name in ("RMSE", "mean", "median", "max"):
            table.add_column(f"{name} [{unit}]", justify="right", min_width=len("median [m]"))
    kinds = {
        "ATE": evaluation.ate,
        "RPE a frame": evaluation.rpe_per_frame,
        "RPE a second": evaluation.rpe_per_second,
        "RPE a metre": evaluation.rpe_per_metre,
    }
    for name, error in kinds.items():
        both = (None, None) if error is None else (error.translation, error.rotation.in_degrees())
        for kind, table, errors in zip(("position", "rotation"), tables.values(), both, strict=True):
            values = () if errors is None else (errors.rmse, errors.mean, errors.median, errors.max)
            table.add_row(f"{name}, {kind}", *[f"{value:.4f}" for value in values] or ["too short"])
    tables["°"].caption = covered + scaled
    return Group(*tables.values())
