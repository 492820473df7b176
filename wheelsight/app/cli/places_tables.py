"""Tables of `wheelsight places`: the accuracy of a model, and its answers beside the truth."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

from rich.box import SIMPLE_HEAD
from rich.table import Table

from wheelsight.app.cli.console import facts_table
from wheelsight.app.report.places_page import (
    AREA_HEAD,
    CURVE_HEAD,
    TRAINING_HEAD,
    area_rows,
    confusion_rows,
    curve_rows,
    training_facts,
    training_rows,
)
from wheelsight.app.run import words
from wheelsight.places import LabelledDrive, PlaceModel, PlaceTrial


def training_tables(model: PlaceModel, drives: Sequence[LabelledDrive]) -> Iterator[Table]:
    """A model's areas and figures."""
    held_out = "whole drives held out in turn"
    if len(drives) == 1:
        held_out = "seconds of the drive held out in turn, where whole drives would prove more"
    forest = f"{model.forest.tree_count} trees of at most {model.settings.max_depth} splits, {model.describer.kind}"
    yield _table(f"{forest}; {held_out}", TRAINING_HEAD, training_rows(model, drives))
    yield facts_table("", training_facts(model))


def trial_tables(trial: PlaceTrial, recording: str) -> Iterator[Table]:
    """Accuracy of each area, confusions, calibration."""
    judged = words.count(int(trial.is_judged.sum()), "frame")
    yield _table(f"{recording}: {judged} with a true area", AREA_HEAD, area_rows(trial))
    yield _table("frames by true area (rows) and most probable area (columns)", *confusion_rows(trial))
    yield _table("how sure it says to be, and how often it is right", CURVE_HEAD, curve_rows(trial.curve))
    named = f"{words.percent(trial.answered)} of frames, {words.percent(trial.answered_accuracy)} of them rightly"
    facts = [
        ("accuracy", words.percent(trial.accuracy)),
        ("names an area of", named),
        ("calibration error", f"{trial.curve.error:.3f}"),
    ]
    yield facts_table("", facts)


def trial_document(trial: PlaceTrial) -> dict[str, Any]:
    """The same as nested values."""
    counts, curve = trial.confusion, trial.curve
    return {
        "frames": len(trial.answers),
        "judged_frames": int(trial.is_judged.sum()),
        "accuracy": trial.accuracy,
        "answered": trial.answered,
        "answered_accuracy": trial.answered_accuracy,
        "calibration_error": curve.error,
        "areas": list(trial.area_names),
        "confusion": counts[:, :-1].tolist(),
        "frames_without_depth": counts[:, -1].tolist(),
        "calibration_curve": {
            "confidence": curve.confidence.tolist(),
            "accuracy": curve.accuracy.tolist(),
            "frames": curve.count.tolist(),
        },
    }


def _table(title: str, head: Sequence[str], rows: Sequence[Sequence[str]]) -> Table:
    table = Table(title=title, title_justify="left", title_style="bold", box=SIMPLE_HEAD)
    for number, column in enumerate(head):
        table.add_column(column, justify="right" if number else "left")
    for row in rows:
        table.add_row(*row)
    return table
