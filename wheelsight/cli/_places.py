"""The work behind `wheelsight places`: recordings opened, labels found, files written."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from wheelsight.cli._compiling import compile_missing
from wheelsight.cli._outputs import check_out
from wheelsight.cli._places_inputs import described, open_labelled, open_listed, show_progress, source_of

_KERNELS = ("places",)


def label(
    folder: Path,
    out: Path,
    labels: Path | None,
    areas: Path | None,
    trajectory: Path | None,
    every_s: float | None,
    topics: Sequence[str] | None,
    force: bool,
) -> None:
    """Write the contact sheet of a recording."""
    from wheelsight.cli._console import print_note
    from wheelsight.places import make_sheet
    from wheelsight.report.places_sheet import write_sheet

    check_out(out, force)
    recording = open_listed(folder, topics)
    source = source_of(recording, labels, areas, trajectory)
    with show_progress("reading", None) as advance:
        sheet = make_sheet(recording, source, every_s, advance)
    write_sheet(sheet, out, source.told)
    shown = f"{len(sheet.pictures)} thumbnails, {int((sheet.labels >= 0).sum())} of them with an area proposed"
    print_note(f"{shown}, are in {out}; open it in a browser, and hand what it saves to places train --labels")


def train(
    folders: Sequence[Path],
    out: Path,
    labels: Sequence[Path],
    areas: Path | None,
    description: str,
    forest: dict[str, Any],
    topics: Sequence[str] | None,
    force: bool,
) -> None:
    """Train a model on recordings, save it, and tell what it is worth."""
    from wheelsight.cli._console import console
    from wheelsight.cli._places_tables import training_tables
    from wheelsight.extras import needed
    from wheelsight.places import ForestSettings, describer_from, train_on_drives

    for library in ("sklearn", "skops"):  # refused before the long work
        needed(library)
    check_out(out, force)
    recordings, sources, names = open_labelled(folders, labels, areas, topics)
    compile_missing(_KERNELS)
    describer = describer_from({"kind": description})
    drives = described(recordings, sources, names, describer)
    with show_progress("growing trees", None):
        model = train_on_drives(drives, names, describer, ForestSettings(**forest))
    model.save(out)
    for table in training_tables(model, drives):
        console().print(table)
    console().print(f"model: {out}", markup=False)


def try_model(
    model_path: Path,
    folder: Path,
    labels: Path | None,
    areas: Path | None,
    trajectory: Path | None,
    out: Path | None,
    topics: Sequence[str] | None,
    as_json: bool,
    force: bool,
) -> None:
    """Try a model on a labelled recording."""
    from wheelsight.cli._console import console, print_json
    from wheelsight.cli._places_tables import trial_document, trial_tables
    from wheelsight.extras import needed
    from wheelsight.places import PlaceModel, frames_of, stamps_of, try_places
    from wheelsight.report.places_page import write_places_page

    if out is not None:
        needed("plotly")
        check_out(out, force)
    model, recording = PlaceModel.load(model_path), open_listed(folder, topics)
    source = source_of(recording, labels, areas, trajectory, needed=True)
    stamps_s = stamps_of(recording)
    label_at = dict(zip(stamps_s, source.of_frames(stamps_s, model.area_names).tolist(), strict=True))
    compile_missing(_KERNELS)
    with show_progress("naming areas", recording.frame_count) as advance:
        trial = try_places(model, frames_of(recording, advance), label_at.__getitem__)
    if out is not None:
        write_places_page(trial, model, recording.name, out)
    if as_json:
        print_json(trial_document(trial))
        return
    for table in trial_tables(trial, recording.name):
        console().print(table)
    if out is not None:
        console().print(f"page: {out}", markup=False)


def predict(model_path: Path, folder: Path, out: Path, topics: Sequence[str] | None, force: bool) -> None:
    """Write a model's answers on a recording."""
    from wheelsight.cli._console import percent, print_note
    from wheelsight.files import write_text
    from wheelsight.places import PlaceModel, answer_all, frames_of, predictions_csv

    check_out(out, force)
    model, recording = PlaceModel.load(model_path), open_listed(folder, topics)
    compile_missing(_KERNELS)
    with show_progress("naming areas", recording.frame_count) as advance:
        answers = answer_all(model, frames_of(recording, advance))
    write_text(out, predictions_csv(answers, model.area_names))
    named = percent(float((answers.named >= 0).mean()))
    print_note(f"{len(answers)} frames are in {out}, {named} of them with an area named")
