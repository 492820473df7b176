"""Trajectory: poses of one body at growing stamps; read and written as TUM and KITTI text."""

from __future__ import annotations

import logging
import math
import re
from array import array
from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import dataclass
from itertools import chain
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from wheelsight.core.errors import TrajectoryError
from wheelsight.core.files import StrPath, write_lines
from wheelsight.core.geometry import BoolArray, FloatArray, IntArray, interpolate_at, se3, so3
from wheelsight.core.inputs import Kind, as_number, lines_of, numbers_with_commas, plain_rows, read_text, split_words
from wheelsight.core.stamps import StampUnit, column_unit

_log = logging.getLogger(__name__)

_ORTHONORMAL_TOLERANCE = 1e-2
# Motion-capture files repeat a few stamps (TUM fr2/desk: one); stamps cut to seconds repeat nearly all.
_REPEATED_SHARE_ALLOWED = 0.01
_LINE_OF = {8: "stamp tx ty tz qx qy qz qw", 12: "three rows of R and t"}
_TUM_COLUMNS = 8
# By programs that write a first line of names.
_COLUMN_NAMES = (
    ("timestamp", "stamp", "time", "t", "stamp_s", "time_s", "timestamp_s"),
    *((f"t{axis}", axis, f"p{axis}", f"p_{axis}", f"pos_{axis}", f"{axis}_m") for axis in "xyz"),
    *((f"q{axis}", f"q_{axis}") for axis in "xyzw"),
)
_UNIT_APART = re.compile(r"\s+(?=[\[(])")  # of "timestamp [ns]", one name
_FILE = Kind("a trajectory", most_mb=192)
_LARGEST_STAMP, _LARGEST = 1e20, 1e12  # squares of these are summed; stamps may have a wrong unit
_FRAMES_LINE = re.compile(r"^#\s*frames:\s*T_(?P<frame>[a-z0-9]+)_(?P<body>[a-z0-9]+)\b")


@dataclass(frozen=True, eq=False)
class Trajectory:
    """Poses of one body in one fixed frame, at strictly growing stamps. Its arrays are read-only.

    Attributes:
        stamps_s: (N,) seconds.
        T_frame_body: (N, 4, 4) poses.
        covariances: (N, 6, 6) of the left perturbation (v, ω), or None.
        body: "camera" or "base".
        frame: the fixed frame, "map" or "odom".

    Raises:
        TrajectoryError: inconsistent shapes, stamps that do not grow, poses that are no rigid motions.
    """

    stamps_s: FloatArray
    T_frame_body: FloatArray
    covariances: FloatArray | None = None
    body: str = "camera"
    frame: str = "map"

    def __post_init__(self) -> None:
        for name in ("stamps_s", "T_frame_body", "covariances"):
            if getattr(self, name) is not None:
                values = np.asarray(getattr(self, name), float)
                # A read-only array is not copied: covariances of an hour take 57 MB.
                if values.flags.writeable or not values.flags.owndata:
                    values = values.copy()
                    values.setflags(write=False)
                object.__setattr__(self, name, values)
        n = self.stamps_s.size
        if self.stamps_s.shape != (n,) or self.T_frame_body.shape != (n, 4, 4):
            shapes = f"{self.stamps_s.shape} and {self.T_frame_body.shape}"
            raise TrajectoryError(f"a trajectory needs (N,) stamps and (N, 4, 4) poses, not {shapes}")
        if self.covariances is not None and self.covariances.shape != (n, 6, 6):
            raise TrajectoryError(f"covariances must be ({n}, 6, 6), not {self.covariances.shape}")
        if not np.isfinite(self.stamps_s).all() or (np.diff(self.stamps_s) <= 0).any():
            raise TrajectoryError("stamps must be finite and strictly growing")
        if n and not se3.is_valid(self.T_frame_body, tolerance=1e-6):
            raise TrajectoryError("poses must be finite rigid motions")

    def __len__(self) -> int:
        return len(self.stamps_s)

    def __iter__(self) -> Iterator[tuple[float, FloatArray]]:
        return iter(zip(self.stamps_s.tolist(), self.T_frame_body, strict=True))

    @property
    def positions_m(self) -> FloatArray:
        """Positions (N, 3) of the body in the map."""
        return self.T_frame_body[:, :3, 3]

    @property
    def duration_s(self) -> float:
        """Seconds from the first stamp to the last; 0 for fewer than two."""
        return float(self.stamps_s[-1] - self.stamps_s[0]) if len(self) else 0.0

    @property
    def distances_m(self) -> FloatArray:
        """Distance travelled (N,) up to each stamp: the sum of the straight steps."""
        steps = np.linalg.norm(np.diff(self.positions_m, axis=0), axis=1)
        return np.concatenate([np.zeros(min(len(self), 1)), np.cumsum(steps)])

    @property
    def length_m(self) -> float:
        """Distance travelled in all."""
        return float(self.distances_m[-1]) if len(self) else 0.0

    def at(self, stamps_s: ArrayLike, max_gap_s: float = np.inf) -> FloatArray:
        """Return poses (M, 4, 4) at stamps (M,), on geodesics between neighbours; NaN outside and in gaps."""
        return interpolate_at(self.stamps_s, self.T_frame_body, stamps_s, max_gap_s)

    def between(self, start_s: float, end_s: float) -> Trajectory:
        """Return the part with start ≤ stamp ≤ end, seconds."""
        return self.select((self.stamps_s >= start_s) & (self.stamps_s <= end_s))

    def select(self, which: ArrayLike | slice) -> Trajectory:
        """Return the poses of a mask (N,), a slice, or indices (M,). Raises TrajectoryError if these do not grow."""
        if not isinstance(which, slice):
            which = np.asarray(which)
            which = which if which.size else which.astype(int)
        index = np.arange(len(self))[which]
        covariances = None if self.covariances is None else self.covariances[index]
        return Trajectory(self.stamps_s[index], self.T_frame_body[index], covariances, self.body, self.frame)

    def moved(self, T_new_frame: ArrayLike) -> Trajectory:
        """Return the trajectory in another fixed frame: every pose multiplied by (4, 4) from the left."""
        T = np.asarray(T_new_frame, float)
        Ad = se3.adjoint(T)
        covariances = None if self.covariances is None else Ad @ self.covariances @ Ad.T
        return Trajectory(self.stamps_s, T @ self.T_frame_body, covariances, self.body, self.frame)


def read_tum(path: StrPath, body: str = "camera", warn: Callable[[str], None] = _log.warning) -> Trajectory:
    """Read TUM text: `stamp tx ty tz qx qy qz qw` a line, metres; # starts a comment.

    Numbers are separated by commas, semicolons (with decimal commas) or white space. A first line may name the columns,
    in any order and among others. A line "# frames: T_frame_base", as wheelsight writes it, names the frames; else
    `body` does. Quaternions within 1 % of unit length are normalised. If fewer than 1 % of the lines repeat a stamp,
    the first of each is kept, and `warn` gets one sentence.

    Raises:
        TrajectoryError: with file and line: no such text, values that are not finite, quaternions far from unit length,
            stamps that run backwards or repeat often, or no poses.
    """
    path = Path(path)
    lines, values, frames = _read_rows(path, columns=8)
    norms = np.linalg.norm(values[:, 4:], axis=1)
    for bad in np.flatnonzero(np.abs(norms - 1) > _ORTHONORMAL_TOLERANCE):
        raise TrajectoryError(
            f"quaternion has length {norms[bad]:.4g}, not 1", path=path, line=int(lines[bad]), fix="write qx qy qz qw"
        )
    values = values[_first_of_each_stamp(values[:, 0], lines, path, warn)]
    frame, body = frames or ("map", body)
    return Trajectory(values[:, 0], se3.from_quaternion(values[:, 1:4], values[:, 4:]), None, body, frame)


def _first_of_each_stamp(stamps_s: FloatArray, lines: IntArray, path: Path, warn: Callable[[str], None]) -> BoolArray:
    """Return the rows (N,) with which stamps (N,) strictly grow. Raises TrajectoryError if many are lost."""
    steps_s = np.diff(stamps_s)
    for later in np.flatnonzero(steps_s < 0) + 1:
        raise TrajectoryError(
            f"stamp {stamps_s[later]:.6f} comes before the stamp of the line above",
            path=path,
            line=int(lines[later]),
            fix="sort the lines by stamp",
        )
    is_first = np.concatenate([[True], steps_s > 0])
    repeated = np.flatnonzero(~is_first)
    if len(repeated) > _REPEATED_SHARE_ALLOWED * len(stamps_s):
        raise TrajectoryError(
            f"stamp {stamps_s[repeated[0]]:.6f} repeats the line above, as {len(repeated)} of {len(stamps_s)} lines do",
            path=path,
            line=int(lines[repeated[0]]),
            fix="write stamps with all their decimals and one pose a stamp",
        )
    if len(repeated):
        first = lines[repeated[0]]
        warn(f"{path}: {len(repeated)} of {len(stamps_s)} lines repeat a stamp (first: line {first}) and were left out")
    return is_first


def write_tum(trajectory: Trajectory, path: StrPath) -> None:
    """Write TUM text atomically, with a header of frames and exact stamps. Raises OutputError."""
    write_lines(path, chain((tum_header(trajectory),), tum_lines(trajectory)))


def tum_header(trajectory: Trajectory) -> str:
    """Return the comment lines at the begin of TUM text, with the trajectory's frames."""
    name = f"T_{trajectory.frame}_{trajectory.body}"
    frames = f"# frames: {name} (pose of the {trajectory.body} in the {trajectory.frame} frame)"
    return f"{frames}\n# timestamp tx ty tz qx qy qz qw\n"


def tum_lines(trajectory: Trajectory) -> Iterator[str]:
    """Yield a line of TUM text for each pose."""
    t, q = trajectory.positions_m, so3.to_quaternion(trajectory.T_frame_body[:, :3, :3])
    for stamp, position, quaternion in zip(trajectory.stamps_s, t, q, strict=True):
        seconds = np.format_float_positional(stamp, min_digits=6)
        yield f"{seconds} " + " ".join(f"{x:.9f}" for x in (*position, *quaternion)) + "\n"


def read_kitti(path: StrPath, period_s: float = 0.1, body: str = "camera") -> Trajectory:
    """Read KITTI text: the first three rows of a pose, twelve numbers a line, every `period_s`.

    Rotations become the nearest orthonormal ones, since the text rounds them. Raises TrajectoryError as `read_tum`.
    """
    path = Path(path)
    lines, rows, frames = _read_rows(path, columns=12)
    values = rows.reshape(-1, 3, 4)
    R = so3.nearest(values[:, :, :3])
    for bad in np.flatnonzero(np.abs(R - values[:, :, :3]).max(axis=(1, 2), initial=0) > _ORTHONORMAL_TOLERANCE):
        raise TrajectoryError("the first 3×3 numbers are no rotation", path=path, line=int(lines[bad]))
    frame, body = frames or ("map", body)
    stamps_s: FloatArray = period_s * np.arange(len(values), dtype=np.float64)
    return Trajectory(stamps_s, se3.from_parts(R, values[:, :, 3]), None, body, frame)


def write_kitti(trajectory: Trajectory, path: StrPath) -> None:
    """Write KITTI text, which has no stamps, atomically. Raises OutputError."""
    rows = trajectory.T_frame_body[:, :3, :].reshape(-1, 12)
    write_lines(path, (" ".join(f"{x:.9e}" for x in row) + "\n" for row in rows))


def _read_rows(path: Path, columns: int) -> tuple[IntArray, FloatArray, tuple[str, str] | None]:
    """Return line numbers (N,) and values (N, columns) without comments, and the frames by a comment."""
    text = read_text(path, _FILE, TrajectoryError)
    begin, first, frames, unit = _comments_above(text)
    first_line = text[begin : text.find("\n", begin)]
    found = plain_rows(text[begin:], [False] * columns, "," if "," in first_line else None)
    if found is not None:
        numbers, values = np.arange(first, first + len(found[0]), dtype=np.int64), np.column_stack(found)
    else:
        numbers, values, frames, named = _read_lines(text, columns, path)
        unit = named or unit
    if columns == _TUM_COLUMNS and unit is not None and unit.per_second is not None:
        values[:, 0] /= unit.per_second
    largest = np.abs(values)
    for bad in np.flatnonzero(~(largest.max(axis=1) <= _LARGEST_STAMP) | (largest[:, 1:].max(axis=1) > _LARGEST)):
        problem = f"a value of {largest[bad].max():g} is no stamp in seconds and no metres"
        if not np.isfinite(values[bad]).all():
            problem = "a value is not finite"
        raise TrajectoryError(problem, path=path, line=int(numbers[int(bad)]), fix="remove the line")
    return numbers, values, frames


def _comments_above(text: str) -> tuple[int, int, tuple[str, str] | None, StampUnit | None]:
    """Return the end of the comments at the top, the number of the next line, and the frames and unit in them."""
    begin, number, frames, unit = 0, 1, None, None
    while text.startswith("#", begin):
        end = text.find("\n", begin)
        line = text[begin : end if end >= 0 else None]
        if named := _FRAMES_LINE.match(line):
            frames = _frames_of(named)
        unit = column_unit(line.lstrip("# \t")) or unit
        if end < 0:
            return len(text), number, frames, unit
        begin, number = end + 1, number + 1
    return begin, number, frames, unit


def _frames_of(named: re.Match[str]) -> tuple[str, str]:
    """Return the names of frame and body; files before 2026-12 call the map frame "world"."""
    return "map" if named["frame"] == "world" else named["frame"], named["body"]


def _read_lines(
    text: str, columns: int, path: Path
) -> tuple[IntArray, FloatArray, tuple[str, str] | None, StampUnit | None]:
    """As `_read_rows`, line by line, for any text; also the unit of stamps in the first line."""
    numbers, values = array("q"), array("d")
    frames, order, unit = None, None, None
    for number, line in enumerate(lines_of(text), start=1):
        bare = line
        if "#" in line:
            if named := _FRAMES_LINE.match(line):
                frames = _frames_of(named)
            bare = line.split("#")[0]
        words = split_words(bare)
        if not words:
            continue
        is_first = order is None and not numbers and columns == _TUM_COLUMNS and len(words) > 1
        if is_first and all(math.isnan(as_number(word)) and word.lower() != "nan" for word in words):
            order, unit = _order(split_words(_UNIT_APART.sub("", bare)), path, number)
            continue
        if order is not None:
            *places, width = order
            if len(words) != width:
                problem = f"{len(words)} values where the first line names {width}"
                raise TrajectoryError(problem, path=path, line=number, fix="correct or remove the line")
            words = [words[place] for place in places]
        values.extend(_numbers(words, columns, path, number))
        numbers.append(number)
    if not numbers:
        raise TrajectoryError("holds no poses", path=path, fix=f"{columns} numbers a line are expected")
    return np.array(numbers, np.int64), np.array(values, np.float64).reshape(-1, columns), frames, unit


def _order(words: list[str], path: Path, line: int) -> tuple[list[int], StampUnit | None]:
    """Return the places of TUM's columns in a first line of names, its width, and the unit of stamps in it.

    Raises TrajectoryError if it lacks a column.
    """
    names = [word.lower() for word in words]
    stamps = [column_unit(name) for name in names]
    places = []
    for known in _COLUMN_NAMES:
        is_stamp = known is _COLUMN_NAMES[0]
        found = [i for i, name in enumerate(names) if name in known or (is_stamp and stamps[i] is not None)]
        if len(found) != 1:
            problem = f"names {'no' if not found else 'more than one'} column {known[0]}"
            raise TrajectoryError(problem, path=path, line=line, fix=f"name the columns {_LINE_OF[8]}")
        places.append(found[0])
    return [*places, len(names)], stamps[places[0]]


def _numbers(words: list[str], columns: int, path: Path, line: int) -> list[float]:
    if len(words) != columns:
        problem = f"{len(words)} values where {columns} are expected"
        raise TrajectoryError(problem, path=path, line=line, fix=f"{_LINE_OF[columns]} a line")
    with suppress(ValueError):
        return [float(word) for word in words]
    try:
        return [float(word) for word in numbers_with_commas(words)]
    except ValueError as error:
        raise TrajectoryError(f"{error}", path=path, line=line, fix=f"{_LINE_OF[columns]} a line") from error
