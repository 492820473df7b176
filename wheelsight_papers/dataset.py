"""Labelled drives for training: frames with the areas they show.

Labels come from polygons and a trajectory, from time ranges, or frame by frame. `ContactSheet` shows a recording for
labelling.
"""

from __future__ import annotations

import csv
import math
import re
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from difflib import get_close_matches
from itertools import pairwise
from pathlib import Path
from typing import Protocol, runtime_checkable

import cv2
import numpy as np
from numpy.typing import ArrayLike

from wheelsight.core.areas import AreaMap, load_areas
from wheelsight.core.errors import AreaError, PlaceError, RecordingError
from wheelsight.core.files import StrPath
from wheelsight.core.geometry import ByteArray, FloatArray, IntArray
from wheelsight.core.inputs import Kind, as_number, is_there, lines_of, read_text
from wheelsight.core.messages import RgbdFrame, SkippedFrame
from wheelsight.core.trajectory import Trajectory
from wheelsight.io.recordings import Recording
from wheelsight.places.describers import Describer
from wheelsight.places.model import ForestSettings, PlaceModel
from wheelsight_papers.training import DescribedFrames, describe_all, train_places

RANGES_HEADER = ("from_s", "to_s", "area")
FRAMES_HEADER = ("stamp_s", "area")
_FORMS = f"{','.join(RANGES_HEADER)} or {','.join(FRAMES_HEADER)}"
# Stamps of one frame in two files differ at most in the last decimal.
_SAME_STAMP_S = 1e-3
_NAMES_SHOWN = 12
_FILE = Kind("a list of labels", most_mb=64, most_lines=500_000, fix=f"a CSV of {_FORMS}")
_LARGEST_STAMP = 1e15
_LONGEST_NUMBER = 18  # digits of one number in names


@dataclass(frozen=True, slots=True)
class Entry:
    """A line of a label file: an area, "" for none, from a stamp to a stamp. Both are equal for a single frame."""

    line: int
    from_s: float
    to_s: float
    area: str


@dataclass(frozen=True, eq=False)
class LabelFile:
    """A CSV of labels: areas of time ranges, or the area of each frame.

    Stamps are those of the recording. A frame at the border of two ranges belongs to the later one. Ranges may extend
    beyond the recording, and frames in gaps have no area.

    Attributes:
        path: the file.
        entries: its lines, in order of time.
        is_of_frames: whether each line is for one frame.
    """

    path: Path
    entries: tuple[Entry, ...]
    is_of_frames: bool

    @property
    def names(self) -> tuple[str, ...]:
        """Named areas in natural order: 2 before 10."""
        return natural_order({entry.area for entry in self.entries if entry.area})

    def check_names(self, names: Sequence[str]) -> None:
        """Raise AreaError for the first line whose area is not in `names`."""
        for entry in self.entries:
            if entry.area and entry.area not in names:
                close = get_close_matches(entry.area, names, 1)
                shown = ", ".join(names[:_NAMES_SHOWN]) + (", …" if len(names) > _NAMES_SHOWN else "")
                hint = f"did you mean {close[0]}?" if close else f"areas: {shown}"
                raise self._error(entry, f"there is no area {entry.area!r}", hint)

    def of_frames(self, stamps_s: ArrayLike, names: Sequence[str]) -> IntArray:
        """Return the index in `names` of each frame's area (N,), -1 for none.

        Args:
            stamps_s: (N,) ascending stamps of all frames of the recording.
            names: names of the areas.

        Raises:
            AreaError: a line has an unknown area, is outside the recording, or names a missing frame.
        """
        stamps_s = np.asarray(stamps_s, float)
        self.check_names(names)
        indices = {"": -1} | {name: index for index, name in enumerate(names)}
        labels = np.full(len(stamps_s), -1, np.int64)
        entries = self.entries
        if self.is_of_frames and entries and len(stamps_s) and entries[-1].from_s > stamps_s[-1] + _SAME_STAMP_S:
            entries = entries[:-1]  # recording was interrupted between the label and its frame
        first_s, last_s = (stamps_s[0], stamps_s[-1]) if len(stamps_s) else (math.inf, -math.inf)
        for entry in entries:
            if entry.from_s > last_s + _SAME_STAMP_S or entry.to_s < first_s - _SAME_STAMP_S:
                problem = f"{_span(entry)} lies outside the recording, {first_s:.3f} to {last_s:.3f} s"
                raise self._error(entry, problem, "stamps are the recording's own, and each file is of one recording")
            if not self.is_of_frames:
                labels[(stamps_s >= entry.from_s) & (stamps_s <= entry.to_s)] = indices[entry.area]
                continue
            nearest = int(np.abs(stamps_s - entry.from_s).argmin())
            if abs(stamps_s[nearest] - entry.from_s) > _SAME_STAMP_S:
                problem = f"no frame has the stamp {entry.from_s:.6f}; the nearest has {stamps_s[nearest]:.6f}"
                raise self._error(entry, problem, "label the frames of this recording, or give ranges of time")
            labels[nearest] = indices[entry.area]
        return labels

    def _error(self, entry: Entry, problem: str, fix: str) -> AreaError:
        return AreaError(problem, path=self.path, line=entry.line, fix=fix)


def labels_on_the_way(areas: AreaMap, trajectory: Trajectory, stamps_s: ArrayLike, max_gap_s: float = 0.5) -> IntArray:
    """Return the index of the robot's area at each stamp (N,), -1 outside all areas or without a pose.

    Args:
        areas: polygons in the map frame.
        trajectory: trajectory of the base in the same frame, or of a hand-held camera.
        stamps_s: (N,) stamps of frames.
        max_gap_s: poses are not interpolated over longer gaps.
    """
    stamps_s = np.asarray(stamps_s, float)
    return areas.index_at(trajectory.at(stamps_s, max_gap_s)[:, :2, 3])


def read_labels(path: StrPath) -> LabelFile:
    """Read a CSV of labels, by time ranges or by frames as its first line says. Further columns are ignored.

    Raises:
        AreaError: the file is missing, its first line is unknown, stamps are invalid or repeated, or ranges are empty
            or overlap.
    """
    path = Path(path)
    header, rows = _read_rows(path)
    is_of_frames = header == FRAMES_HEADER
    entries = [_entry(path, line, words, header) for line, words in rows]
    entries.sort(key=lambda entry: entry.from_s)
    for before, after in pairwise(entries):
        if is_of_frames and after.from_s <= before.from_s:
            problem = f"stamp {after.from_s:.6f} is that of line {before.line} too"
            raise AreaError(problem, path=path, line=after.line, fix="one line a frame")
        if not is_of_frames and after.from_s < before.to_s:
            problem = f"{_span(after)} overlaps line {before.line}, {_span(before)}"
            raise AreaError(problem, path=path, line=after.line, fix="begin a range where the one before it ends")
    return LabelFile(path, tuple(entries), is_of_frames)


def natural_order(names: set[str]) -> tuple[str, ...]:
    """Return names sorted with numbers by value."""

    def key(name: str) -> list[tuple[int, int | str]]:
        parts = re.split(rf"(\d{{1,{_LONGEST_NUMBER}}})", name.casefold())
        return [(0, int(part)) if part.isdecimal() else (1, part) for part in parts if part]

    return tuple(sorted(names, key=lambda name: (key(name), name)))


def _read_rows(path: Path) -> tuple[tuple[str, ...], list[tuple[int, list[str]]]]:
    """Return the form of the file, and each line's number and words."""
    text = read_text(path, _FILE, AreaError)
    rows = []
    for number, line in enumerate(lines_of(text), 1):
        if not line.strip() or line.lstrip().startswith("#"):
            continue
        # An area's name may have commas in quotes, or in a line with semicolons.
        between = ";" if ";" in line else ","
        try:
            words = next(csv.reader([line], delimiter=between))
        except csv.Error:
            words = line.split(between)
        rows.append((number, [word.strip() for word in words]))
    for header in (RANGES_HEADER, FRAMES_HEADER):
        if rows and tuple(word.lower() for word in rows[0][1][: len(header)]) == header:
            is_cut_off = header == FRAMES_HEADER and rows[-1][0] == len(lines_of(text))
            return header, rows[1:-1] if is_cut_off else rows[1:]
    at, first = (rows[0][0], ",".join(rows[0][1])) if rows else (1, "")
    raise AreaError(f"the first line is {first!r}", path=path, line=at, fix=f"name the columns: {_FORMS}")


def _entry(path: Path, line: int, words: list[str], header: tuple[str, ...]) -> Entry:
    if len(words) < len(header):
        problem = f"{len(words)} values where {len(header)} are expected"
        raise AreaError(problem, path=path, line=line, fix=",".join(header))
    stamps_s = []
    for column, word in zip(header[:-1], words, strict=False):
        stamps_s.append(as_number(word))
        if not abs(stamps_s[-1]) <= _LARGEST_STAMP:
            raise AreaError(f"{column} is {word!r}, no stamp in seconds", path=path, line=line, fix=",".join(header))
    from_s, to_s = stamps_s[0], stamps_s[-1]
    if header == RANGES_HEADER and from_s >= to_s:
        raise AreaError(f"the range {from_s:g} to {to_s:g} s is empty", path=path, line=line, fix="from_s before to_s")
    return Entry(line, from_s, to_s, words[len(header) - 1])


def _span(entry: Entry) -> str:
    return f"{entry.from_s:.3f} s" if entry.from_s == entry.to_s else f"{entry.from_s:.3f} to {entry.to_s:.3f} s"


AREAS_FILE = "areas.yaml"
LABELS_FILE = "labels.csv"
_BLOCK_S, _GAP_S = 1.0, 0.2


@dataclass(frozen=True, eq=False)
class LabelSource:
    """Source of the areas of a recording's frames: a label file, or polygons and a trajectory.

    Attributes:
        areas: the polygons, or None.
        areas_path: their file, for error messages.
        file: labels, which have priority over polygons, or None.
        trajectory: trajectory of the robot, or None.
    """

    areas: AreaMap | None = None
    areas_path: Path | None = None
    file: LabelFile | None = None
    trajectory: Trajectory | None = None

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the areas: of the polygons in their order, if there are any."""
        return self.areas.names if self.areas is not None else self.file.names if self.file is not None else ()

    @property
    def path(self) -> Path | None:
        """File to name in errors about the labels."""
        return self.file.path if self.file is not None else self.areas_path

    @property
    def description(self) -> str:
        """Short description of the source; "" if there is none."""
        if self.file is not None:
            return self.file.path.name
        if self.areas is None or self.trajectory is None:
            return ""
        return f"{AREAS_FILE if self.areas_path is None else self.areas_path.name} and trajectory"

    def of_frames(self, stamps_s: Sequence[float], names: Sequence[str]) -> IntArray:
        """Return the index in `names` of each frame's area (N,), -1 for none.

        Raises:
            AreaError: an area is not in `names`, or as `LabelFile.of_frames`.
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
    """Return the source of the areas of a recording; by default the recording's own.

    These are areas.yaml and the ground truth, if it has both; otherwise labels.csv.

    Args:
        recording: recording to label.
        labels: labels, which have priority over polygons; these then only name the areas.
        areas_path: path of an areas.yaml.
        trajectory: trajectory of the recording's body, in the map of the polygons.

    Raises:
        AreaError: the areas.yaml is invalid, or a label has an area that it lacks.
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
    """Return the areas of several recordings: those of the first polygons, else all that the labels name.

    Raises:
        AreaError: polygons have other names or another order.
    """
    maps = [source for source in sources if source.areas is not None]
    for source in maps:
        if source.names != maps[0].names:
            problem = f"has areas {', '.join(source.names)}, but {maps[0].areas_path} {', '.join(maps[0].names)}"
            raise AreaError(problem, path=source.areas_path, fix="give one areas.yaml for all by --areas")
    return maps[0].names if maps else natural_order({name for source in sources for name in source.names})


@dataclass(frozen=True, eq=False)
class LabelledDrive:
    """Features of a drive's frames, and the indices of their areas (N,), -1 for none."""

    name: str
    frames: DescribedFrames
    labels: IntArray


def stamps_of(recording: Recording) -> list[float]:
    """Return the stamps of all frames of a recording, including skipped ones, in seconds."""
    listed = getattr(recording, "frames", None)  # of image files, without decoding any
    if listed is not None:
        return [frame.stamp_s for frame in listed]
    return [event.stamp_s for event in recording.events() if isinstance(event, RgbdFrame | SkippedFrame)]


def frames_of(recording: Recording, on_frame: Callable[[], None] = lambda: None) -> Iterator[RgbdFrame]:
    """Yield a recording's usable frames in order of time; call `on_frame` after each frame, usable or not."""
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
    """Return the features of a recording's frames with their areas; frames without depth have none.

    Raises:
        AreaError: the labels do not belong to the recording; raised before features are computed.
        PlaceError: there are no usable frames, or the images change in size.
    """
    stamps_s = stamps_of(recording)
    labels = source.of_frames(stamps_s, names)
    described = describe_all(frames_of(recording, on_frame), describer)
    of_described = labels[np.searchsorted(stamps_s, described.stamps_s)]
    return LabelledDrive(recording.name, described, np.where(described.has_depth, of_described, -1))


def train_on_drives(
    drives: Sequence[LabelledDrive], names: Sequence[str], describer: Describer, settings: ForestSettings
) -> PlaceModel:
    """Return a model trained on all drives together.

    With a single drive, blocks of one second are held out, and 0.2 s beside them are not used, unless `settings` say
    otherwise. The frames in between are about as new as the same place on another day.

    Raises:
        PlaceError: as `train_places`, and for images of different sizes.
    """
    size = drives[0].frames.frame_size
    for drive in drives:
        if drive.frames.frame_size != size:
            fix = "train on recordings of one camera at one resolution"
            raise PlaceError(f"{drive.name} has images of another size than {drives[0].name}", fix=fix)
    stamps_s = drives[0].frames.stamps_s
    period_s = float(np.median(np.diff(stamps_s))) if len(stamps_s) > 1 else _BLOCK_S
    blocks = {"block_frames": max(round(_BLOCK_S / period_s), 2), "gap_frames": max(round(_GAP_S / period_s), 1)}
    unset = {name: value for name, value in blocks.items() if name not in settings.model_fields_set}
    return train_places(
        np.concatenate([drive.frames.features for drive in drives]),
        np.concatenate([drive.labels for drive in drives]),
        names,
        describer,
        settings.model_copy(update=unset),
        frame_size=size,
        drives=np.repeat(np.arange(len(drives)), [len(drive.labels) for drive in drives]),
    )


def check_every_area(labels: Sequence[IntArray], names: Sequence[str], path: StrPath | None) -> None:
    """Raise AreaError with `path` for the first area without frames."""
    path = None if path is None else Path(path)
    seen = np.unique(np.concatenate(labels)) if labels else np.array([])
    for index, name in enumerate(names):
        if index not in seen:
            fix = "drive through it, or leave the area out"
            raise AreaError(f"area {name!r} has no training frames", path=path, fix=fix)
    if len(names) < 2:
        raise AreaError(f"{len(names)} areas cannot be distinguished", path=path, fix="label at least two")


_WIDTH_PX = 240
_MOST_UNASKED = 600


@runtime_checkable
class _Files(Protocol):
    """A recording with random access to frames."""

    def read_frame(self, index: int) -> RgbdFrame: ...


@dataclass(frozen=True, eq=False)
class ContactSheet:
    """N thumbnails of a recording, in order of time.

    Attributes:
        name: name of the recording.
        frame_count: number of its frames.
        every_s: approximate seconds between thumbnails.
        pictures: (N) images (h, w, 3) uint8, red, green, blue.
        stamps_s: (N,).
        borders_s: (N + 1,) borders of the thumbnails' parts of the drive: halfway between thumbnails, or where the
            proposed area changes once between them.
        labels: (N,) index of the proposed area, -1 for none.
        names: names of the areas.
        areas: their polygons, or None.
        xy_m: (N, 2) position of the robot, NaN if unknown.
    """

    name: str
    frame_count: int
    every_s: float
    pictures: tuple[ByteArray, ...]
    stamps_s: FloatArray
    borders_s: FloatArray
    labels: IntArray
    names: tuple[str, ...]
    areas: AreaMap | None
    xy_m: FloatArray


def make_sheet(
    recording: Recording,
    source: LabelSource,
    every_s: float | None = None,
    on_picture: Callable[[], None] = lambda: None,
) -> ContactSheet:
    """Return thumbnails of a recording with the areas that `source` proposes.

    Args:
        recording: recording with frames.
        source: source of the proposed areas.
        every_s: seconds between thumbnails; None: one second, or more to have at most 600.
        on_picture: called after each thumbnail.

    Raises:
        PlaceError: the recording has no usable frames.
        AreaError: the labels do not belong to it.
    """
    stamps_s = np.array(stamps_of(recording), float)
    if not len(stamps_s):
        raise PlaceError(f"{recording.name} has no frames", fix="give a recording with colour and depth")
    every_s = every_s or max(1.0, float(stamps_s[-1] - stamps_s[0]) / _MOST_UNASKED)
    of_frames = source.of_frames(stamps_s.tolist(), source.names)
    kept = []
    for frame in _read(recording, chosen_frames(stamps_s, every_s)):
        on_picture()
        scale = min(_WIDTH_PX / frame.color.shape[1], 1.0)
        width, height = (max(round(side * scale), 1) for side in frame.color.shape[1::-1])
        thumbnail = np.asarray(cv2.resize(frame.color, (width, height), interpolation=cv2.INTER_AREA), np.uint8)
        kept.append((frame.index, thumbnail))
    if not kept:
        raise PlaceError(f"{recording.name} has no usable frames", fix="see wheelsight info")
    indices = np.array([index for index, _ in kept])
    xy_m: FloatArray = np.full((len(kept), 2), np.nan)
    if source.trajectory is not None and source.areas is not None:
        xy_m = source.trajectory.at(stamps_s[indices])[:, :2, 3]
    return ContactSheet(
        recording.name,
        len(stamps_s),
        every_s,
        tuple(picture for _, picture in kept),
        stamps_s[indices],
        _borders(stamps_s, of_frames, indices),
        of_frames[indices],
        source.names,
        source.areas,
        xy_m,
    )


def chosen_frames(stamps_s: FloatArray, every_s: float) -> list[int]:
    """Return the indices of frames about `every_s` apart: those nearest to the middle of each part of the drive."""
    parts = max(round((stamps_s[-1] - stamps_s[0]) / every_s), 1)
    middles_s = stamps_s[0] + (np.arange(parts) + 0.5) * every_s
    after = np.searchsorted(stamps_s, middles_s).clip(0, len(stamps_s) - 1)
    before = (after - 1).clip(0)
    nearer = np.abs(stamps_s[before] - middles_s) < np.abs(stamps_s[after] - middles_s)
    return sorted(set(np.where(nearer, before, after).tolist()))


def _read(recording: Recording, chosen: Sequence[int]) -> Iterator[RgbdFrame]:
    if not isinstance(recording, _Files):
        wanted = set(chosen)
        yield from (e for e in recording.events() if isinstance(e, RgbdFrame) and e.index in wanted)
        return
    for index in chosen:
        try:
            yield recording.read_frame(index)
        except RecordingError:
            continue  # its neighbours represent it


def _borders(stamps_s: FloatArray, labels: IntArray, indices: IntArray) -> FloatArray:
    def between(left: int, right: int) -> float:
        changes = np.flatnonzero(np.diff(labels[left : right + 1])) + left
        if len(changes) != 1:
            return float(stamps_s[left] + stamps_s[right]) / 2
        return float(stamps_s[changes[0]] + stamps_s[changes[0] + 1]) / 2

    inner = [between(left, right) for left, right in pairwise(indices.tolist())]
    return np.array([stamps_s[0], *inner, stamps_s[-1]])
