"""What the commands of `wheelsight places` are given, opened: recordings, labels, places for outputs."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from wheelsight.places import Describer, LabelledDrive, LabelSource
    from wheelsight.recordings import Recording


def open_listed(folder: Path, topics: Sequence[str] | None) -> Recording:
    """A recording, its warnings told on stderr; `topics` of a bag, as `--topic` says them."""
    from wheelsight.cli._console import print_warning
    from wheelsight.cli._options import open_source, settings_from

    recording = open_source(folder, settings_from({"--topic": topics}))
    for warning in recording.warnings:
        print_warning(f"{recording.name}: {warning}")
    return recording


def source_of(
    recording: Recording, labels: Path | None, areas: Path | None, trajectory: Path | None, needed: bool = False
) -> LabelSource:
    """What tells the areas of a recording's frames. Raises AreaError where nothing does and it is needed."""
    from wheelsight.errors import AreaError
    from wheelsight.places import label_source, read_labels
    from wheelsight.recordings import express_for
    from wheelsight.trajectory import read_tum

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
    from wheelsight.cli._progress import FrameProgress

    with FrameProgress(action, count) as progress:
        yield progress.advance


def open_labelled(
    folders: Sequence[Path], labels: Sequence[Path], areas: Path | None, topics: Sequence[str] | None
) -> tuple[list[Recording], list[LabelSource], tuple[str, ...]]:
    """Recordings, where their labels come from, and the names of all areas, each of which some frame shows."""
    from wheelsight.errors import ConfigError
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
