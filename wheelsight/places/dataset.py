"""Labelled drives: frames in numbers beside the areas they were taken in, from one recording or several."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from wheelsight.areas import AreaMap, load_areas
from wheelsight.errors import AreaError, PlaceError
from wheelsight.events import RgbdFrame, SkippedFrame
from wheelsight.files import StrPath
from wheelsight.geometry import FloatArray, IntArray
from wheelsight.inputs import is_there
from wheelsight.places.describer import Describer
from wheelsight.places.forest import ForestSettings
from wheelsight.places.labels import LabelFile, labels_on_the_way, natural_order, read_labels
from wheelsight.places.model import PlaceModel
from wheelsight.places.training import DescribedFrames, describe_all, train_places
from wheelsight.recordings import Recording
from wheelsight.trajectory import Trajectory

AREAS_FILE = "areas.yaml"
LABELS_FILE = "labels.csv"
_BLOCK_S, _GAP_S = 1.0, 0.2


@dataclass(frozen=True, eq=False)
class LabelSource:
    """What tells the areas of a recording's frames: a file of labels, or polygons and where the robot went.

    Attributes:
        areas: the polygons, or None.
        areas_path: their file, for what is said of them.
        file: the labels, which go before polygons, or None.
        trajectory: where the robot went, or None.
    """

    areas: AreaMap | None = None
    areas_path: Path | None = None
    file: LabelFile | None = None
    trajectory: Trajectory | None = None

    @property
    def names(self) -> tuple[str, ...]:
        """Of the areas: of the polygons, in their order, where there are some."""
        return self.areas.names if self.areas is not None else self.file.names if self.file is not None else ()

    @property
    def path(self) -> Path | None:
        """The file to name where something is wrong with the labels."""
        return self.file.path if self.file is not None else self.areas_path

    @property
    def told(self) -> str:
        """What the labels come from, in a few words; "" where nothing tells them."""
        if self.file is not None:
            return self.file.path.name
        if self.areas is None or self.trajectory is None:
            return ""
        return f"{AREAS_FILE if self.areas_path is None else self.areas_path.name} and trajectory"

    def of_frames(self, stamps_s: Sequence[float], names: Sequence[str]) -> IntArray:
        """The index in `names` of each frame's area (N,), -1 for none.

        Raises:
            AreaError: an area that is not among `names`, or as `LabelFile.of_frames`.
        """
        if self.file is not None:
            return self.file.of_frames(stamps_s, names)
        if self.areas is None or self.trajectory is None:
            return np.full(len(stamps_s), -1, np.int64)
        for name in self.areas.names:
            if name not in names:
                problem = f"area {name!r} is not known here"
                raise AreaError(problem, path=self.areas_path, fix=f"known: {', '.join(names)}")
        order = np.array([*(names.index(name) for name in self.areas.names), -1])
        return np.asarray(order[labels_on_the_way(self.areas, self.trajectory, stamps_s)], np.int64)


def label_source(
    recording: Recording,
    labels: LabelFile | None = None,
    areas_path: StrPath | None = None,
    trajectory: Trajectory | None = None,
) -> LabelSource:
    """What tells the areas of a recording; what is not given is the recording's own.

    These are areas.yaml and the ground truth, where it has both; else labels.csv.

    Args:
        recording: whose frames are to be labelled.
        labels: go before polygons; these then only say which areas there are.
        areas_path: an areas.yaml.
        trajectory: in the map of the polygons, of the recording's body.

    Raises:
        AreaError: an areas.yaml that is wrong, or a label of an area that it lacks.
    """
    areas_path = None if areas_path is None else Path(areas_path)
    own = recording.path / AREAS_FILE
    if areas_path is None and is_there(own):
        areas_path = own
    areas = None if areas_path is None else load_areas(areas_path)
    trajectory = recording.ground_truth if trajectory is None else trajectory
    own_labels = recording.path / LABELS_FILE
    if labels is None and (areas is None or trajectory is None) and is_there(own_labels):
        labels = read_labels(own_labels)
    if labels is not None and areas is not None:
        labels.check_names(areas.names)
    return LabelSource(areas, areas_path, labels, trajectory)


def names_of_all(sources: Sequence[LabelSource]) -> tuple[str, ...]:
    """The areas of several recordings: of the first polygons there are, else all that the labels name.

    Raises:
        AreaError: polygons of other names or in another order.
    """
    maps = [source for source in sources if source.areas is not None]
    for source in maps:
        if source.names != maps[0].names:
            problem = f"has areas {', '.join(source.names)}, but {maps[0].areas_path} {', '.join(maps[0].names)}"
            raise AreaError(problem, path=source.areas_path, fix="give one areas.yaml for all by --areas")
    return maps[0].names if maps else natural_order({name for source in sources for name in source.names})


@dataclass(frozen=True, eq=False)
class LabelledDrive:
    """A drive's frames in numbers, and the indices of their areas (N,), -1 for none."""

    name: str
    frames: DescribedFrames
    labels: IntArray


def stamps_of(recording: Recording) -> list[float]:
    """Stamps of all frames that a recording lists, skipped ones included, in seconds."""
    listed = getattr(recording, "frames", None)  # of images kept as files: none needs to be decoded
    if listed is not None:
        return [frame.stamp_s for frame in listed]
    return [event.stamp_s for event in recording.events() if isinstance(event, RgbdFrame | SkippedFrame)]


def frames_of(recording: Recording, on_frame: Callable[[], None] = lambda: None) -> Iterator[RgbdFrame]:
    """A recording's usable frames in order of time; `on_frame` is called after each one that it lists."""
    for event in recording.events():
        if isinstance(event, RgbdFrame):
            yield event
        if isinstance(event, RgbdFrame | SkippedFrame):
            on_frame()


def describe_drive(
    recording: Recording,
    source: LabelSource,
    names: Sequence[str],
    describer: Describer,
    on_frame: Callable[[], None] = lambda: None,
) -> LabelledDrive:
    """A recording's frames in numbers with their areas; frames without depth have none, as they tell nothing.

    Raises:
        AreaError: labels that do not belong to the recording, told before the long work.
        PlaceError: no usable frame, or images that change in size.
    """
    stamps_s = stamps_of(recording)
    labels = source.of_frames(stamps_s, names)
    described = describe_all(frames_of(recording, on_frame), describer)
    of_described = labels[np.searchsorted(stamps_s, described.stamps_s)]
    return LabelledDrive(recording.name, described, np.where(described.has_depth, of_described, -1))


def train_on_drives(
    drives: Sequence[LabelledDrive], names: Sequence[str], describer: Describer, settings: ForestSettings
) -> PlaceModel:
    """A model of all drives together.

    Of a single drive, blocks of one second are held out, and a fifth of a second beside them left out, unless
    `settings` say otherwise: what lies between them is about as new as the same place on another day.

    Raises:
        PlaceError: as `train_places`, and for images of different sizes.
    """
    size = drives[0].frames.frame_size
    for drive in drives:
        if drive.frames.frame_size != size:
            fix = "train on recordings of one camera at one resolution"
            raise PlaceError(f"{drive.name} has images of another size than {drives[0].name}", fix=fix)
    return train_places(
        np.concatenate([drive.frames.features for drive in drives]),
        np.concatenate([drive.labels for drive in drives]),
        names,
        describer,
        _with_blocks(settings, drives[0].frames.stamps_s),
        frame_size=size,
        drives=np.repeat(np.arange(len(drives)), [len(drive.labels) for drive in drives]),
    )


def _with_blocks(settings: ForestSettings, stamps_s: FloatArray) -> ForestSettings:
    period_s = float(np.median(np.diff(stamps_s))) if len(stamps_s) > 1 else _BLOCK_S
    told = {"block_frames": max(round(_BLOCK_S / period_s), 2), "gap_frames": max(round(_GAP_S / period_s), 1)}
    return settings.model_copy(update={k: v for k, v in told.items() if k not in settings.model_fields_set})


def check_every_area(labels: Sequence[IntArray], names: Sequence[str], path: StrPath | None) -> None:
    """Raises AreaError naming `path` and the first area that has no frame."""
    path = None if path is None else Path(path)
    seen = np.unique(np.concatenate(labels)) if labels else np.array([])
    for index, name in enumerate(names):
        if index not in seen:
            fix = "drive through it, or leave the area out"
            raise AreaError(f"area {name!r} has no training frames", path=path, fix=fix)
    if len(names) < 2:
        raise AreaError(f"{len(names)} areas cannot be told apart", path=path, fix="label at least two")
