"""Ready lists of pairs, `stamp color stamp depth` a line or depth first; names or images tell which is which."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from wheelsight.errors import RecordingError
from wheelsight.recordings._file_lists import find_files, pair_of_files
from wheelsight.recordings._images import is_depth_image
from wheelsight.recordings.image_recording import FramePaths
from wheelsight.recordings.text import keep_growing, listed_lines

# The last such word in a path counts: depth/rgb_17.png is colour's.
_WORD = re.compile(r"(?P<depth>depth)|(?:rgb|colou?r)(?!-?d(?![a-z]))", re.IGNORECASE)
_PAIRS_TRIED = 8

_Stamped = tuple[float, str]


@dataclass(frozen=True, slots=True)
class Pair:
    """One line of an associations file."""

    stamp_s: float
    frame: FramePaths
    gap_s: float


def read_associations(path: Path, rate_hz: float | None) -> tuple[list[Pair], list[str]]:
    """Pairs of `stamp color stamp depth`, or depth first; stamps count `rate_hz` a second, else as the file names it.

    Raises:
        RecordingError: naming file and line; also where neither names nor images tell colour from depth.
    """
    lines, per_second = listed_lines(path)
    rate = rate_hz or per_second
    if not lines:
        raise RecordingError("pairs no images", path=path, fix="remove the file to have them paired by stamp")
    numbers = [line.number for line in lines]
    told = _color_first([pair_of_files(line, path) for line in lines], numbers, path)
    color, warnings = find_files([first[1] for first, _ in told], path, "rgb")
    depth, more = find_files([second[1] for _, second in told], path, "depth")
    pairs = [
        Pair(
            first[0] / rate,
            FramePaths(first[0] / rate, color_path, depth_path, (second[0] - first[0]) / rate),
            abs(first[0] - second[0]) / rate,
        )
        for (first, second), color_path, depth_path in zip(told, color, depth, strict=True)
    ]
    growing, left_out = keep_growing(pairs, numbers, path)
    return growing, warnings + more + left_out


def _color_first(
    pairs: list[tuple[_Stamped, _Stamped]], numbers: Sequence[int], path: Path
) -> list[tuple[_Stamped, _Stamped]]:
    """The pairs with colour first: by their names; where these do not tell, by the type of some of their images."""
    depth_first = [_is_depth_first(first[1], second[1]) for first, second in pairs]
    untold = [i for i, known in enumerate(depth_first) if known is None]
    if untold:
        by_images = _by_images([pairs[i] for i in untold], path, numbers[untold[0]])
        depth_first = [by_images if known is None else known for known in depth_first]
    return [
        (second, first) if turned else (first, second)
        for (first, second), turned in zip(pairs, depth_first, strict=True)
    ]


def _is_depth_first(first: str, second: str) -> bool | None:
    """Whether names say that the first of two is the depth image; None where they say nothing, or both the same."""
    kinds = [_kind(first), _kind(second)]
    if kinds[0] == kinds[1]:
        return None
    return kinds[0] == "depth" or kinds[1] == "color"


def _kind(name: str) -> str | None:
    words = list(_WORD.finditer(name))
    return None if not words else "depth" if words[-1]["depth"] else "color"


def _by_images(pairs: Sequence[tuple[_Stamped, _Stamped]], path: Path, line: int) -> bool:
    """Whether the first images are of 16 bits and grey, the second ones not; colour first where none can be read."""
    tried = pairs[:: max(len(pairs) // _PAIRS_TRIED, 1)]
    columns = [find_files([pair[k][1] for pair in tried], path, folder)[0] for k, folder in ((0, "rgb"), (1, "depth"))]
    kinds = {(is_depth_image(first), is_depth_image(second)) for first, second in zip(*columns, strict=True)}
    known = {kind for kind in kinds if None not in kind}
    if known == {(True, False)}:
        return True
    if known in (set(), {(False, True)}):
        return False
    problem = "neither names nor images tell which of the two is depth"
    raise RecordingError(problem, path=path, line=line, fix="put depth images, of 16 bits, into a folder called depth")
