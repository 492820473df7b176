"""What the commands of `wheelsight places` are given, opened: recordings, labels, places for outputs."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from wheelsight.places import LabelSource
    from wheelsight.recordings import Recording


def open_listed(folder: Path) -> Recording:
    """A recording, its warnings told on stderr."""
    from wheelsight.cli._console import print_warning
    from wheelsight.recordings import open_recording

    recording = open_recording(folder)
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
