"""`wheelsight places`: labels a recording by areas, trains a model, tests it, and names areas with it."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from wheelsight.app.cli.compiling import compile_missing
from wheelsight.app.cli.console import CliCommand, Group
from wheelsight.app.cli.options import RecordingPath, Topics, check_out, option
from wheelsight.core.errors import AreaError, ConfigError

if TYPE_CHECKING:
    from rich.table import Table

    from wheelsight.io.recordings import Recording
    from wheelsight.places import PlaceModel
    from wheelsight_papers.dataset import LabelledDrive, LabelSource
    from wheelsight_papers.training import PlaceTrial

_KERNELS = ("places",)

# Options


class DescriberKind(StrEnum):
    """The descriptor of a frame."""

    HISTOGRAMS = "histograms"
    LAYOUT = "layout"


Recordings = Annotated[
    list[Path], typer.Argument(metavar="RECORDING...", help="Folders of recordings.", show_default=False)
]
Model = Annotated[Path, typer.Argument(metavar="MODEL", help="What places train wrote.", show_default=False)]
LabelFiles = Annotated[
    list[Path] | None,
    option(
        "CSV of labels, from_s,to_s,area or stamp_s,area; one for each recording, in their order.",
        "FILE",
        "by areas and trajectory",
        flag="--labels",
    ),
]
Labels = Annotated[
    Path | None, option("CSV of labels, from_s,to_s,area or stamp_s,area.", "FILE", "by areas and trajectory")
]
Areas = Annotated[
    Path | None,
    typer.Option(metavar="FILE", help="areas.yaml with polygons.", show_default="that in the recording's folder"),
]
Trajectory = Annotated[
    Path | None,
    typer.Option(metavar="FILE", help="Where the robot went, TUM text.", show_default="the recording's ground truth"),
]
Description = Annotated[
    DescriberKind, typer.Option(help="How a frame is described: the paper's histograms, or layout, with geometry.")
]
Trees = Annotated[int, typer.Option(metavar="T", min=1, max=1000, help="How many trees; the paper tries 1 to 6.")]
Depth = Annotated[int, typer.Option(metavar="D", min=1, max=64, help="Splits from root to leaf, at most.")]
Seed = Annotated[
    int, typer.Option(min=0, max=2**32 - 1, help="Of everything random; the same seed grows the same forest.")
]
Force = Annotated[bool, typer.Option("--force", help="Overwrite what is there.")]

Page = Annotated[Path, typer.Option(metavar="PAGE", help="HTML page to write.", show_default=False)]
PageIfWanted = Annotated[
    Path | None, typer.Option(metavar="PAGE", help="HTML page with figures to write.", show_default="none")
]
ModelToWrite = Annotated[
    Path, typer.Option(metavar="MODEL", help="Model to write, such as floor.places.", show_default=False)
]
CsvFile = Annotated[Path, typer.Option(metavar="FILE", help="CSV to write.", show_default=False)]
Every = Annotated[
    float | None,
    typer.Option(metavar="SECONDS", min=0.01, help="Time between thumbnails.", show_default="1, for up to 600"),
]
AsJson = Annotated[bool, typer.Option("--json", help="Print JSON instead of tables.")]


places_app = typer.Typer(cls=Group, no_args_is_help=True, rich_markup_mode="rich")


@places_app.callback()
def _about() -> None:
    """Which area of a building a frame was taken in: label, train, test, predict."""


@places_app.command(cls=CliCommand)
def label(
    recording: RecordingPath,
    out: Page,
    labels: Labels = None,
    areas: Areas = None,
    trajectory: Trajectory = None,
    every: Every = None,
    topic: Topics = None,
    force: Force = False,
) -> None:
    """Make a page of thumbnails along time, on which a person says which area each part of a drive is in.

    Open PAGE in a browser: select thumbnails, press the area's key, save. The CSV it saves is what --labels takes.
    Known labels, from labels or from areas and trajectory, are filled in, to be checked.

    [bold]Examples[/bold]

    wheelsight places label my_drive --out labels.html

    wheelsight places label my_drive --labels my_drive-labels.csv --every 0.5 --out check.html
    """
    from wheelsight.app.cli.console import print_note
    from wheelsight.app.cli.progress import FrameProgress
    from wheelsight_papers.dataset import make_sheet
    from wheelsight_papers.places_page import write_sheet

    check_out(out, force)
    opened = open_listed(recording, topic)
    source = source_of(opened, labels, areas, trajectory)
    with FrameProgress("reading", None) as progress:
        sheet = make_sheet(opened, source, every, progress.advance)
    write_sheet(sheet, out, source.description)
    shown = f"{len(sheet.pictures)} thumbnails, {int((sheet.labels >= 0).sum())} of them with an area proposed"
    print_note(f"{shown}, are in {out}; open it in a browser, and hand what it saves to places train --labels")


@places_app.command(cls=CliCommand)
def train(
    recordings: Recordings,
    out: ModelToWrite,
    labels: LabelFiles = None,
    areas: Areas = None,
    description: Description = DescriberKind.LAYOUT,
    trees: Trees = 64,
    depth: Depth = 16,
    seed: Seed = 0,
    topic: Topics = None,
    force: Force = False,
) -> None:
    """Grow a random forest that names the area of a frame, and calibrate how sure it says to be.

    Areas come from --labels; else from polygons, and the ground truth. Several drives of one building, in other
    light and on other days, make a better model than one: each is then held out once to calibrate.

    [bold]Examples[/bold]

    wheelsight places train monday tuesday --out floor.places

    wheelsight places train my_drive --labels my_drive-labels.csv --description histograms --trees 6 --out six.places
    """
    from wheelsight.app.cli.console import console
    from wheelsight.app.cli.progress import FrameProgress
    from wheelsight.core.runtime import needed
    from wheelsight.places import ForestSettings, describer_from
    from wheelsight_papers.dataset import describe_drive, train_on_drives

    for library in ("sklearn", "skops"):  # refused before the long work
        needed(library)
    check_out(out, force)
    opened, sources, names = open_labelled(recordings, labels or [], areas, topic)
    compile_missing(_KERNELS)
    describer = describer_from({"kind": description})
    drives = []
    for one, source in zip(opened, sources, strict=True):
        with FrameProgress(f"describing {one.name}", one.frame_count) as progress:
            drives.append(describe_drive(one, source, names, describer, progress.advance))
    with FrameProgress("growing trees", None):
        model = train_on_drives(drives, names, describer, ForestSettings(trees=trees, max_depth=depth, seed=seed))
    model.save(out)
    for table in training_tables(model, drives):
        console().print(table)
    console().print(f"model: {out}", markup=False)


@places_app.command("test", cls=CliCommand)
def try_model(
    model: Model,
    recording: RecordingPath,
    labels: Labels = None,
    areas: Areas = None,
    trajectory: Trajectory = None,
    out: PageIfWanted = None,
    topic: Topics = None,
    as_json: AsJson = False,
    force: Force = False,
) -> None:
    """Try a model on a drive that it was not trained on: what it takes for what, and whether it knows how sure it is.

    [bold]Examples[/bold]

    wheelsight places test floor.places wednesday --out wednesday.html

    wheelsight places test floor.places my_drive --labels my_drive-labels.csv --json
    """
    from wheelsight.app.cli.console import console, print_json
    from wheelsight.app.cli.progress import FrameProgress
    from wheelsight.core.runtime import needed
    from wheelsight.places import PlaceModel
    from wheelsight_papers.dataset import frames_of, stamps_of
    from wheelsight_papers.places_page import write_places_page
    from wheelsight_papers.training import try_places

    if out is not None:
        needed("plotly")
        check_out(out, force)
    known, opened = PlaceModel.load(model), open_listed(recording, topic)
    source = source_of(opened, labels, areas, trajectory, needed=True)
    stamps_s = stamps_of(opened)
    label_at = dict(zip(stamps_s, source.of_frames(stamps_s, known.area_names).tolist(), strict=True))
    compile_missing(_KERNELS)
    with FrameProgress("naming areas", opened.frame_count) as progress:
        trial = try_places(known, frames_of(opened, progress.advance), label_at.__getitem__)
    if out is not None:
        write_places_page(trial, known, opened.name, out)
    if as_json:
        print_json(trial_document(trial))
        return
    for table in trial_tables(trial, opened.name):
        console().print(table)
    if out is not None:
        console().print(f"page: {out}", markup=False)


@places_app.command(cls=CliCommand)
def predict(model: Model, recording: RecordingPath, out: CsvFile, topic: Topics = None, force: Force = False) -> None:
    """Name the area of each frame: stamp_s, area (empty: unknown), and the probability of every area.

    [bold]Examples[/bold]

    wheelsight places predict floor.places thursday --out predictions.csv

    wheelsight places label thursday --labels predictions.csv --out check.html
    """
    from wheelsight.app.cli.console import percent, print_note
    from wheelsight.app.cli.progress import FrameProgress
    from wheelsight.core.files import write_text
    from wheelsight.places import PlaceModel
    from wheelsight_papers.dataset import frames_of
    from wheelsight_papers.training import answer_all, predictions_csv

    check_out(out, force)
    known, opened = PlaceModel.load(model), open_listed(recording, topic)
    compile_missing(_KERNELS)
    with FrameProgress("naming areas", opened.frame_count) as progress:
        answers = answer_all(known, frames_of(opened, progress.advance))
    write_text(out, predictions_csv(answers, known.area_names))
    named = percent(float((answers.named >= 0).mean()))
    print_note(f"{len(answers)} frames are in {out}, {named} of them with an area named")


def open_listed(folder: Path, topics: Sequence[str] | None) -> Recording:
    """A recording, its warnings printed on stderr; `topics` of a bag, as `--topic` says them."""
    from wheelsight.app.cli.console import print_warning
    from wheelsight.app.cli.options import open_source, settings_from

    recording = open_source(folder, settings_from({"recording.topics": topics}))
    for warning in recording.warnings:
        print_warning(f"{recording.name}: {warning}")
    return recording


def source_of(
    recording: Recording, labels: Path | None, areas: Path | None, trajectory: Path | None, needed: bool = False
) -> LabelSource:
    """The source of a recording's area labels. Raises AreaError if it is needed and there is none."""
    from wheelsight.core.trajectory import read_tum
    from wheelsight.io.recordings import express_for
    from wheelsight_papers.dataset import label_source, read_labels

    file = None if labels is None else read_labels(labels)
    way = None
    if trajectory is not None:
        way = express_for(recording.body, read_tum(trajectory, recording.body), recording.calibration)
    source = label_source(recording, file, areas, way)
    if needed and not source.description:
        missing = "no ground truth to go with areas" if source.areas is not None else "no labels"
        fix = "give --labels FILE; wheelsight places label makes a page to write one"
        raise AreaError(f"has {missing}", path=recording.path, fix=fix)
    return source


def open_labelled(
    folders: Sequence[Path], labels: Sequence[Path], areas: Path | None, topics: Sequence[str] | None
) -> tuple[list[Recording], list[LabelSource], tuple[str, ...]]:
    """Recordings, the sources of their labels, and the names of all areas that some frame shows."""
    from wheelsight_papers.dataset import check_every_area, names_of_all, stamps_of

    if labels and len(labels) != len(folders):
        fix = "give --labels once for each recording, in their order, or not at all"
        raise ConfigError(f"{len(labels)} --labels for {len(folders)} recordings", fix=fix)
    recordings = [open_listed(folder, topics) for folder in folders]
    files: Sequence[Path | None] = labels or [None] * len(folders)
    sources = [source_of(r, file, areas, None, needed=True) for r, file in zip(recordings, files, strict=True)]
    names = names_of_all(sources)
    of_frames = [source.of_frames(stamps_of(r), names) for r, source in zip(recordings, sources, strict=True)]
    check_every_area(of_frames, names, sources[0].path if len(sources) == 1 else sources[0].areas_path)
    return recordings, sources, names


def training_tables(model: PlaceModel, drives: Sequence[LabelledDrive]) -> Iterator[Table]:
    """Tables of a model: its areas and its figures."""
    from wheelsight.app.cli.console import facts_table, rows_table
    from wheelsight_papers.places_page import TRAINING_HEAD, training_facts, training_rows

    held_out = "whole drives held out in turn"
    if len(drives) == 1:
        held_out = "seconds of the drive held out in turn, where whole drives would prove more"
    forest = f"{model.forest.tree_count} trees of at most {model.settings.max_depth} splits, {model.describer.kind}"
    yield rows_table(f"{forest}; {held_out}", TRAINING_HEAD, training_rows(model, drives))
    yield facts_table("", training_facts(model))


def trial_tables(trial: PlaceTrial, recording: str) -> Iterator[Table]:
    """Tables of a trial: accuracy of each area, confusions, calibration."""
    from wheelsight.app.cli.console import facts_table, rows_table
    from wheelsight.app.run import words
    from wheelsight_papers.places_page import AREA_HEAD, CURVE_HEAD, area_rows, confusion_rows, curve_rows

    judged = words.count(int(trial.is_judged.sum()), "frame")
    yield rows_table(f"{recording}: {judged} with a true area", AREA_HEAD, area_rows(trial))
    yield rows_table("frames by true area (rows) and most probable area (columns)", *confusion_rows(trial))
    yield rows_table("how sure it says to be, and how often it is right", CURVE_HEAD, curve_rows(trial.curve))
    named = f"{words.percent(trial.answered)} of frames, {words.percent(trial.answered_accuracy)} of them rightly"
    facts = [
        ("accuracy", words.percent(trial.accuracy)),
        ("names an area of", named),
        ("calibration error", f"{trial.curve.error:.3f}"),
    ]
    yield facts_table("", facts)


def trial_document(trial: PlaceTrial) -> dict[str, Any]:
    """The figures of a trial as nested values."""
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
