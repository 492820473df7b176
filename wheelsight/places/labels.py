"""Labels: which area each frame was taken in, by polygons and a trajectory, by ranges of time, or frame by frame."""

from __future__ import annotations

import csv
import math
import re
from collections.abc import Sequence
from dataclasses import dataclass
from difflib import get_close_matches
from itertools import pairwise
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from wheelsight.areas import AreaMap
from wheelsight.errors import AreaError
from wheelsight.files import StrPath
from wheelsight.geometry import FloatArray, IntArray
from wheelsight.inputs import Kind, as_number, lines_of, read_text
from wheelsight.trajectory import Trajectory

RANGES_HEADER = ("from_s", "to_s", "area")
FRAMES_HEADER = ("stamp_s", "area")
_FORMS = f"{','.join(RANGES_HEADER)} or {','.join(FRAMES_HEADER)}"
# Stamps of one frame in two files differ by no more than their last decimal.
_SAME_STAMP_S = 1e-3
_NAMES_SHOWN = 12
_FILE = Kind("a list of labels", most_mb=64, most_lines=500_000, fix=f"a CSV of {_FORMS}")
_LARGEST_STAMP = 1e15
_LONGEST_NUMBER = 18  # digits that are taken for one number


@dataclass(frozen=True, slots=True)
class Entry:
    """A line of a label file: the area, "" for none, from a stamp to a stamp; of a single frame both are its own."""

    line: int
    from_s: float
    to_s: float
    area: str


@dataclass(frozen=True, eq=False)
class LabelFile:
    """What a CSV of labels says: either areas over ranges of time, or the area of each frame.

    Stamps are the recording's own. A frame where two ranges meet belongs to the later one; ranges may reach beyond
    the recording's ends, and leave gaps, whose frames have no area.

    Attributes:
        path: of the file.
        entries: its lines, in order of time.
        is_of_frames: whether each line is of one frame.
    """

    path: Path
    entries: tuple[Entry, ...]
    is_of_frames: bool

    @property
    def names(self) -> tuple[str, ...]:
        """The areas that are named, in natural order: 2 before 10."""
        return natural_order({entry.area for entry in self.entries if entry.area})

    def check_names(self, names: Sequence[str]) -> None:
        """Raises AreaError naming the line whose area is not among `names`."""
        for entry in self.entries:
            if entry.area and entry.area not in names:
                close = get_close_matches(entry.area, names, 1)
                shown = ", ".join(names[:_NAMES_SHOWN]) + (", …" if len(names) > _NAMES_SHOWN else "")
                hint = f"did you mean {close[0]}?" if close else f"areas: {shown}"
                raise self._error(entry, f"there is no area {entry.area!r}", hint)

    def of_frames(self, stamps_s: ArrayLike, names: Sequence[str]) -> IntArray:
        """The index in `names` of each frame's area (N,), -1 for none.

        Args:
            stamps_s: (N,) of all frames that the recording lists, growing.
            names: of the areas.

        Raises:
            AreaError: a line whose area has another name, or that lies outside the recording; of a single frame,
                one that is not there.
        """
        stamps_s = np.asarray(stamps_s, float)
        self.check_names(names)
        indices = {"": -1} | {name: index for index, name in enumerate(names)}
        labels = np.full(len(stamps_s), -1, np.int64)
        entries = self._without_interrupted(stamps_s) if self.is_of_frames else self.entries
        for entry in entries:
            self._check_inside(entry, stamps_s)
            if self.is_of_frames:
                labels[self._frame_at(entry, stamps_s)] = indices[entry.area]
            else:
                labels[(stamps_s >= entry.from_s) & (stamps_s <= entry.to_s)] = indices[entry.area]
        return labels

    def _without_interrupted(self, stamps_s: FloatArray) -> tuple[Entry, ...]:
        """The lines but for a last one without its frame: recording may break off between the two."""
        if self.entries and len(stamps_s) and self.entries[-1].from_s > stamps_s[-1] + _SAME_STAMP_S:
            return self.entries[:-1]
        return self.entries

    def _check_inside(self, entry: Entry, stamps_s: FloatArray) -> None:
        first_s, last_s = (stamps_s[0], stamps_s[-1]) if len(stamps_s) else (math.inf, -math.inf)
        if entry.from_s > last_s + _SAME_STAMP_S or entry.to_s < first_s - _SAME_STAMP_S:
            problem = f"{_span(entry)} lies outside the recording, {first_s:.3f} to {last_s:.3f} s"
            raise self._error(entry, problem, "stamps are the recording's own, and each file is of one recording")

    def _frame_at(self, entry: Entry, stamps_s: FloatArray) -> int:
        nearest = int(np.abs(stamps_s - entry.from_s).argmin())
        if abs(stamps_s[nearest] - entry.from_s) > _SAME_STAMP_S:
            problem = f"no frame has the stamp {entry.from_s:.6f}; the nearest has {stamps_s[nearest]:.6f}"
            raise self._error(entry, problem, "label the frames of this recording, or give ranges of time")
        return nearest

    def _error(self, entry: Entry, problem: str, fix: str) -> AreaError:
        return AreaError(problem, path=self.path, line=entry.line, fix=fix)


def labels_on_the_way(areas: AreaMap, trajectory: Trajectory, stamps_s: ArrayLike, max_gap_s: float = 0.5) -> IntArray:
    """The index of the area that holds the robot at each stamp (N,), -1 in none and where no pose is known.

    Args:
        areas: polygons in the map frame.
        trajectory: of the base, in the same frame; of a camera that is carried by hand, of the camera.
        stamps_s: (N,) of frames.
        max_gap_s: poses further apart tell nothing of the time between them.
    """
    stamps_s = np.asarray(stamps_s, float)
    return areas.index_at(trajectory.at(stamps_s, max_gap_s)[:, :2, 3])


def read_labels(path: StrPath) -> LabelFile:
    """Read a CSV of labels, ranges of time or frames; its first line tells which. More columns may follow.

    Raises:
        AreaError: naming file and line: no such file, another first line, stamps that are none or out of order,
            ranges that are empty or overlap.
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
    """Names sorted as a person would: numbers in them by their value."""

    def key(name: str) -> list[tuple[int, int | str]]:
        parts = re.split(rf"(\d{{1,{_LONGEST_NUMBER}}})", name.casefold())
        return [(0, int(part)) if part.isdecimal() else (1, part) for part in parts if part]

    return tuple(sorted(names, key=lambda name: (key(name), name)))


def _read_rows(path: Path) -> tuple[tuple[str, ...], list[tuple[int, list[str]]]]:
    """Which of the two forms it is, and each line's number and words."""
    text = read_text(path, _FILE, AreaError)
    lines = [(number, line) for number, line in enumerate(lines_of(text), 1) if not line.lstrip().startswith("#")]
    rows = [(number, _words(line)) for number, line in lines if line.strip()]
    for header in (RANGES_HEADER, FRAMES_HEADER):
        if rows and tuple(word.lower() for word in rows[0][1][: len(header)]) == header:
            is_cut_off = header == FRAMES_HEADER and rows[-1][0] == len(lines_of(text))
            return header, rows[1:-1] if is_cut_off else rows[1:]
    line, told = (rows[0][0], ",".join(rows[0][1])) if rows else (1, "")
    raise AreaError(f"the first line is {told!r}", path=path, line=line, fix=f"name the columns: {_FORMS}")


def _words(line: str) -> list[str]:
    """The words of a line; an area's name may have commas in quotes, or in a line with semicolons."""
    between = ";" if ";" in line else ","
    try:
        words = next(csv.reader([line], delimiter=between))
    except csv.Error:
        words = line.split(between)
    return [word.strip() for word in words]


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
