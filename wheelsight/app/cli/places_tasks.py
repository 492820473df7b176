"""The tasks of `wheelsight places`: they open recordings, find labels and write files."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

from wheelsight.app.cli.compiling import compile_missing
from wheelsight.app.cli.options import check_out

if TYPE_CHECKING:
    from wheelsight.io.recordings import Recording
    from wheelsight.places import Describer, LabelledDrive, LabelSource


_KERNELS = ("places",)


def label_images(
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
    from wheelsight.app.cli.console import print_note
    from wheelsight.app.report.places_page import write_sheet
    from wheelsight.places import make_sheet

    check_out(out, force)
    recording = open_listed(folder, topics)
    source = source_of(recording, labels, areas, trajectory)
    with show_progress("reading", None) as advance:
        sheet = make_sheet(recording, source, every_s, advance)
    write_sheet(sheet, out, source.told)
    shown = f"{len(sheet.pictures)} thumbnails, {int((sheet.labels >= 0).sum())} of them with an area proposed"
    print_note(f"{shown}, are in {out}; open it in a browser, and hand what it saves to places train --labels")


def train_model(
    folders: Sequence[Path],
    out: Path,
    labels: Sequence[Path],
    areas: Path | None,
    description: str,
    forest: dict[str, Any],
    topics: Sequence[str] | None,
    force: bool,
) -> None:
    """Train a model on recordings, save it, and print its accuracy."""
    from wheelsight.app.cli.console import console
    from wheelsight.app.cli.places_tables import training_tables
    from wheelsight.core.runtime import needed
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


def try_model_on(
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
    from wheelsight.app.cli.console import console, print_json
    from wheelsight.app.cli.places_tables import trial_document, trial_tables
    from wheelsight.app.report.places_page import write_places_page
    from wheelsight.core.runtime import needed
    from wheelsight.places import PlaceModel, frames_of, stamps_of, try_places

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


def predict_places(model_path: Path, folder: Path, out: Path, topics: Sequence[str] | None, force: bool) -> None:
    """Write a model's answers on a recording."""
    from wheelsight.app.cli.console import percent, print_note
    from wheelsight.core.files import write_text
    from wheelsight.places import PlaceModel, answer_all, frames_of, predictions_csv

    check_out(out, force)
    model, recording = PlaceModel.load(model_path), open_listed(folder, topics)
    compile_missing(_KERNELS)
    with show_progress("naming areas", recording.frame_count) as advance:
        answers = answer_all(model, frames_of(recording, advance))
    write_text(out, predictions_csv(answers, model.area_names))
    named = percent(float((answers.named >= 0).mean()))
    print_note(f"{len(answers)} frames are in {out}, {named} of them with an area named")


# Inputs


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
    from wheelsight.core.errors import AreaError
    from wheelsight.core.trajectory import read_tum
    from wheelsight.io.recordings import express_for
    from wheelsight.places import label_source, read_labels

    file = None if labels is None else read_labels(labels)
    way = None
    if trajectory is not None:
        way = express_for(recording.body, read_tum(trajectory, recording.body), recording.calibration)
    source = label_source(recording, file, areas, way)
    if needed and not source.told:
        missing = "no ground truth to go with areas" if source.areas is not None else "no labels"
        fix = "give --labels FILE; wheelsight places label makes a page to write one"
        raise AreaError(f"has {missing}", path=recording.path, fix=fix)
    return source


@contextmanager
def show_progress(action: str, count: int | None) -> Iterator[Callable[[], None]]:
    """A progress bar; what it hands out moves it on by one."""
    from wheelsight.app.cli.progress import FrameProgress

    with FrameProgress(action, count) as progress:
        yield progress.advance


def open_labelled(
    folders: Sequence[Path], labels: Sequence[Path], areas: Path | None, topics: Sequence[str] | None
) -> tuple[list[Recording], list[LabelSource], tuple[str, ...]]:
    """Recordings, the sources of their labels, and the names of all areas that some frame shows."""
    from wheelsight.core.errors import ConfigError
    from wheelsight.places import check_every_area, names_of_all, stamps_of

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


def described(
    recordings: Sequence[Recording], sources: Sequence[LabelSource], names: tuple[str, ...], describer: Describer
) -> list[LabelledDrive]:
    """Each recording in numbers and labels."""
    from wheelsight.places import describe_drive

    drives = []
    for recording, source in zip(recordings, sources, strict=True):
        with show_progress(f"describing {recording.name}", recording.frame_count) as advance:
            drives.append(describe_drive(recording, source, names, describer, advance))
    return drives
