"""Text files of recordings: lines with their numbers, stamps, and that these must grow."""

from __future__ import annotations

import re
from bisect import bisect_left
from collections.abc import Sequence
from dataclasses import dataclass, replace
from operator import lt
from pathlib import Path
from typing import Protocol, TypeVar

from wheelsight.errors import RecordingError
from wheelsight.inputs import Kind, as_number, lines_of, read_text, unquoted
from wheelsight.recordings.protocol import LeftOut
from wheelsight.stamps import column_unit

_SHARE_OUT_OF_ORDER_ALLOWED = 0.01
# In stretches that are shorter on the average, lines lie about; longer ones are in order, each by itself.
_FEWEST_IN_ORDER = 10
LARGEST_STAMP = 1e20  # over a hundred years in nanoseconds: a wrong unit, which others name; beyond, no unit has it
_STAMP_NAME = re.compile(r"(?:time_?stamps?|stamps?|time|t)(?![a-z])", re.IGNORECASE)
_OTHER_UNIT = re.compile(r"(?<![a-z])(?:[nmuµ]s|[nmu]secs?|(?:nano|micro|milli)sec\w*)(?![a-z])", re.IGNORECASE)
COMMENT = re.compile(r"(^|\s)#.*")


class _Stamped(Protocol):
    @property
    def stamp_s(self) -> float: ...


# An hour of a gyroscope at 1 kHz has 3.6 million lines and 110 MB.
LIST = Kind("a list", most_mb=192, most_lines=6_000_000, missing="is missing", fix="each recording needs it")

IMAGE_LIST = replace(LIST, name="a list of images", most_mb=96, most_lines=500_000)

S = TypeVar("S", bound=_Stamped)


@dataclass(frozen=True, slots=True)
class Line:
    """One line that is no comment, with its number in the file, from 1."""

    number: int
    text: str


def read_list(path: Path, kind: Kind = LIST) -> str:
    """The text of a list or table of a recording. Raises RecordingError naming the file."""
    return read_text(path, kind, RecordingError)


def read_lines(path: Path) -> list[Line]:
    """The lines of a text file without comments and blank lines; any line ends, with or without byte order mark.

    Raises:
        RecordingError: naming the file, if it is missing, no text, no regular file, or too large.
    """
    lines = enumerate(lines_of(read_list(path)), start=1)
    bare = (Line(number, COMMENT.sub("", line).strip()) for number, line in lines)
    return [line for line in bare if line.text]


def listed_lines(path: Path) -> tuple[list[Line], float]:
    """The lines of a list of images, and how many of their stamps are a second, as a line above them may name it.

    # may stand in a name: only lines that begin with it are comments. A first line of names is left out.

    Raises:
        RecordingError: as `read_lines`, and for a unit in the first line that cannot be told.
    """
    lines: list[Line] = []
    per_second = 1.0
    for number, text in enumerate(lines_of(read_list(path, IMAGE_LIST)), start=1):
        bare = text.strip()
        if not lines and (unit := column_unit(bare.lstrip("# \t"))) is not None and unit.per_second is not None:
            per_second = unit.per_second
        if bare and not bare.startswith("#"):
            lines.append(Line(number, bare))
    return lines[bool(lines and _is_header(lines[0], path)) :], per_second


def _is_header(line: Line, path: Path) -> bool:
    """Whether a list's first line names its columns, a stamp first. Raises RecordingError for a unit not understood."""
    name = unquoted(re.split(r"[;,\t]", line.text)[0])
    if not _STAMP_NAME.match(name):
        return False
    if column_unit(line.text) is None and _OTHER_UNIT.search(name):
        fix = "write them in seconds, or name their unit as in stamp_ms"
        raise RecordingError(f"stamps are {name!r}", path=path, line=line.number, fix=fix)
    return True


def parse_stamp(word: str, path: Path, line: int) -> float:
    """A stamp in seconds. Raises RecordingError naming file and line."""
    stamp_s = as_number(word)
    if not abs(stamp_s) <= LARGEST_STAMP:
        fix = "begin the line with the time in seconds, such as 12.034"
        raise RecordingError(f"{word!r} is not a stamp in seconds", path=path, line=line, fix=fix)
    return stamp_s


def keep_growing(items: Sequence[S], lines: Sequence[int], path: Path) -> tuple[list[S], list[str]]:
    """The longest part of `items` whose stamps strictly grow, and a warning if that leaves any out.

    A few lines out of order, up to 1 % of the file, are left out; more say that the file is wrong.

    Raises:
        RecordingError: naming file and line of the first that would have to go, or at which a clock was set back.
    """
    stamps_s = [item.stamp_s for item in items]
    if all(map(lt, stamps_s, stamps_s[1:])):
        return list(items), []
    kept = _longest_growing(stamps_s)
    first = next(i for i, item in enumerate(items) if i >= len(kept) or kept[i] != i)
    problem = f"stamp {items[first].stamp_s:.6f} repeats another or is out of order"
    if len(items) - len(kept) > _SHARE_OUT_OF_ORDER_ALLOWED * len(items):
        _refuse_clock_set_back(stamps_s, lines, path)
        raise RecordingError(
            problem, path=path, line=lines[first], fix="sort the lines by stamp and keep one of each stamp"
        )
    gone = len(items) - len(kept)
    told = f"{path.name}:{lines[first]}: {problem}; {gone} of {len(items)} lines like it were left out"
    reason = f"{path.name}: stamps repeat others or are out of order"
    return [items[i] for i in kept], [LeftOut(told, gone, len(items), reason)]


def _refuse_clock_set_back(stamps_s: Sequence[float], lines: Sequence[int], path: Path) -> None:
    """Refuse stretches in order that begin again earlier, which sorting would mix. Raises RecordingError."""
    begins = [i for i in range(2, len(stamps_s)) if _begins_again(stamps_s, i)]
    if not begins or len(stamps_s) < _FEWEST_IN_ORDER * (len(begins) + 1):
        return
    at = begins[0]
    by_s = stamps_s[at - 1] - stamps_s[at]
    problem = f"stamp {stamps_s[at]:.6f} is {by_s:.3g} s earlier than the one before it: a clock was set back"
    fix = "cut the file before this line, or record again; sort the lines only if somebody put them in another order"
    raise RecordingError(problem, path=path, line=lines[at], fix=fix)


def _begins_again(stamps_s: Sequence[float], i: int) -> bool:
    """Whether a stamp and the one after it come before both of those that were; one alone may be a bad one."""
    before_s = stamps_s[i - 2 : i]
    return stamps_s[i] < min(before_s) and stamps_s[min(i + 1, len(stamps_s) - 1)] < before_s[1]


def _longest_growing(stamps: Sequence[float]) -> list[int]:
    """Indices of a longest strictly growing subsequence (patience sorting); of equal stamps the first."""
    ends: list[float] = []
    indices: list[int] = []
    before: list[int] = []
    for i, stamp in enumerate(stamps):
        length = bisect_left(ends, stamp)
        before.append(indices[length - 1] if length else -1)
        if length == len(ends):
            ends.append(stamp)
            indices.append(i)
        elif stamp < ends[length]:
            ends[length], indices[length] = stamp, i
    chain = [indices[-1]] if indices else []
    while chain and before[chain[-1]] >= 0:
        chain.append(before[chain[-1]])
    return chain[::-1]
