"""Lists of stamped images, `stamp file` a line, as people's programs write them."""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

from wheelsight.errors import RecordingError
from wheelsight.inputs import is_there, split_words
from wheelsight.recordings.text import Line, keep_growing, listed_lines, parse_stamp

_STAMP = r"[+-]?\d+,\d+(?=[\s;\"'])|[^\s,;\"']+"
_ENTRY = re.compile(rf"[\"']?(?P<stamp>{_STAMP})[\"']?(?:\s*[,;]\s*|\s+)(?P<rest>.*\S)")
_IMAGE = re.compile(r".+?\.(?:png|jpe?g|tiff?|bmp|p[gpn]m)(?=[\s,;]|$)", re.IGNORECASE)
_NUMBER_FIRST = re.compile(r"\d+(?:\.\d+)?[\s,;]")
_PARTS = re.compile(r"[\s,;]")
_NAMES_TRIED = 20


@dataclass(frozen=True, slots=True)
class ListedFile:
    """A file and its time in seconds, as a list file names them."""

    stamp_s: float
    path: Path


def read_file_list(path: Path, rate_hz: float | None = None) -> tuple[list[ListedFile], list[str]]:
    """The files that a list names, one `stamp file` a line, at growing stamps; and warnings about what was done to it.

    White space, comma or semicolon part the two; quotes, more columns and a first line of names are passed over, and
    names that lack the folder called as the list, or part folders by backslashes, are found all the same. Stamps count
    `rate_hz` a second; where that is None, the unit that a first line or comment names, else seconds.

    Raises:
        RecordingError: naming file and line, for a line that is none, stamps out of order, or an empty list.
    """
    lines, per_second = listed_lines(path)
    if not lines:
        raise RecordingError("lists no images", path=path, fix="one `stamp file` a line is expected")
    stamps_s, names = [], []
    for line in lines:
        entry = _ENTRY.fullmatch(line.text)
        name = "" if entry is None else _name_in(entry["rest"], path, line.number)
        if entry is None or not name:
            fix = "one `stamp file` a line is expected"
            raise RecordingError("a stamp and a file are expected", path=path, line=line.number, fix=fix)
        stamps_s.append(parse_stamp(entry["stamp"], path, line.number) / (rate_hz or per_second))
        names.append(name)
    found, warnings = find_files(names, path, path.stem)
    files = [ListedFile(stamp_s, file) for stamp_s, file in zip(stamps_s, found, strict=True)]
    growing, more = keep_growing(files, [line.number for line in lines], path)
    return growing, warnings + more


def find_files(names: Sequence[str], path: Path, folder: str) -> tuple[list[Path], list[str]]:
    """The files that the list at `path` means by `names`, and a warning where they are not as they are written.

    Args:
        names: as written.
        path: of the list; names are relative to its folder.
        folder: below it, where files of names without a folder lie.
    """
    beside = path.parent
    tried = names[:: max(len(names) // _NAMES_TRIED, 1)]
    ways: tuple[Callable[[str], Path], ...] = (
        lambda name: beside / name,
        lambda name: beside / name.replace("\\", "/"),
        lambda name: beside / folder / name,
        lambda name: beside / folder / re.split(r"[\\/]", name)[-1],
    )
    for number, way in enumerate(ways):
        if any(is_there(way(name)) for name in tried):
            told = f"{path.name}: its names are not those of files; the files in {way(names[0]).parent} were taken."
            return [way(name) for name in names], [told] if number > 1 else []
    return [beside / name for name in names], []


def pair_of_files(line: Line, path: Path) -> tuple[tuple[float, str], tuple[float, str]]:
    """The two stamps and names of a line `stamp file stamp file`; more columns are passed over.

    Raises:
        RecordingError: naming file and line.
    """
    words = split_words(line.text)
    has_more = len(words) > 4 and all(_IMAGE.fullmatch(word) for word in (words[1], words[3]))
    if len(words) != 4 and not has_more:
        problem = "`stamp color-file stamp depth-file` is expected"
        fix = "remove the file to have images paired by stamp"
        raise RecordingError(problem, path=path, line=line.number, fix=fix)
    first, second = ((parse_stamp(words[i], path, line.number), words[i + 1]) for i in (0, 2))
    return first, second


def _name_in(rest: str, path: Path, line: int) -> str:
    """The file's name among what follows a stamp."""
    if rest[0] in "\"'" and rest.find(rest[0], 1) > 0:
        return rest[1 : rest.find(rest[0], 1)].strip()
    rest = rest.rstrip(" \t,;")
    if not _PARTS.search(rest) or is_there(path.parent / rest):
        return rest
    if _NUMBER_FIRST.match(rest):
        fix = "write stamps with a decimal point, the file next, and quotes around a name with spaces"
        raise RecordingError(f"{rest!r} is no file", path=path, line=line, fix=fix)
    image = _IMAGE.match(rest)
    return rest if image is None else image[0]
