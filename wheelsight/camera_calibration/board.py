"""The board that cameras are calibrated by: a checkerboard or a ChArUco board, as a user names it."""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np

from wheelsight.errors import ConfigError
from wheelsight.geometry import FloatArray

_FEWEST, _MOST = 3, 60
_SMALLEST_M, _LARGEST_M = 0.002, 1.0
_MARKER_SHARE = 0.72  # of a square: OpenCV's own examples have 0.5 to 0.8; its border stays wider than a module
_UNITS = {"mm": 1e-3, "cm": 1e-2, "m": 1.0}
_DICTIONARY_SIZES = (50, 100, 250, 1000)
_SAY = "say --board 9x6:25mm, inner corners and side of a square, or charuco:9x6:30mm, squares and side"


@dataclass(frozen=True, slots=True)
class Board:
    """A flat board of black and white squares.

    Attributes:
        columns, rows: of inner corners, where four squares meet.
        square_m: side of a square, metres; where nobody knows it, 1.0.
        marker_m: side of the markers in a ChArUco board's white squares; 0 for a checkerboard.
        dictionary: of those markers, OpenCV's name without DICT_, such as 5X5_100.
        is_size_known: whether `square_m` is.
    """

    columns: int
    rows: int
    square_m: float
    marker_m: float = 0.0
    dictionary: str = ""
    is_size_known: bool = True

    @property
    def is_charuco(self) -> bool:
        """Whether its corners are told apart by markers, so that a part of the board will do."""
        return bool(self.marker_m)

    @property
    def count(self) -> int:
        """How many inner corners it has."""
        return self.columns * self.rows

    @property
    def points_m(self) -> FloatArray:
        """Its corners (count, 3), row by row, in its own frame: x along rows, y down, z = 0 away from who looks."""
        v, u = np.mgrid[0 : self.rows, 0 : self.columns]
        return self.square_m * np.stack([u.ravel(), v.ravel(), np.zeros(self.count)], axis=-1)

    @property
    def is_half_turn_seen(self) -> bool:
        """Whether it looks otherwise upside down: a checkerboard does where one count is even and one is odd."""
        return self.is_charuco or (self.columns + self.rows) % 2 == 1

    def __str__(self) -> str:
        """As `--board` takes it."""
        side = f"{1e3 * self.square_m:g}mm" if self.is_size_known else "?"
        if not self.is_charuco:
            return f"{self.columns}x{self.rows}:{side}"
        marker = f"{1e3 * self.marker_m:g}mm" if self.is_size_known else f"{self.marker_m:g}"
        return f"charuco:{self.columns + 1}x{self.rows + 1}:{side}:{marker}:{self.dictionary}"

    def charuco(self) -> Any:
        """OpenCV's `CharucoBoard` of it."""
        markers = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, f"DICT_{self.dictionary}"))
        return cv2.aruco.CharucoBoard((self.columns + 1, self.rows + 1), self.square_m, self.marker_m, markers)


def board_from(text: str) -> Board:
    """The board that `--board` names: `9x6:25mm`, `9x6:?` or `charuco:9x6:30mm[:MARKER[:DICTIONARY]]`.

    Raises:
        ConfigError: a text that names none, with what would.
    """
    kind, *parts = [part.strip() for part in text.split(":")]
    is_charuco = kind.lower() == "charuco"
    if not is_charuco:
        kind, parts = "checkerboard", [kind, *parts]
    if not 2 <= len(parts) <= (4 if is_charuco else 2):
        raise ConfigError(f"--board {text!r} names no board", fix=_SAY)
    columns, rows = _counts(parts[0], text)
    side_m = 1.0 if parts[1] == "?" else _length_m(parts[1], text)
    if not is_charuco:
        return Board(columns, rows, side_m, is_size_known=parts[1] != "?")
    marker_m = _marker_m(parts, side_m, text)
    if not 0.3 * side_m <= marker_m < side_m:
        raise ConfigError(f"--board {text!r}: a marker must be smaller than its square, and no speck in it", fix=_SAY)
    dictionary = parts[3].upper().removeprefix("DICT_") if len(parts) == 4 else _dictionary(columns * rows)
    board = Board(columns - 1, rows - 1, side_m, marker_m, dictionary, parts[1] != "?")
    _check_dictionary(board, columns * rows // 2, text)
    return board


def _counts(text: str, whole: str) -> tuple[int, int]:
    found = re.fullmatch(r"(\d{1,3})\s*[xX×]\s*(\d{1,3})", text)
    if not found:
        raise ConfigError(f"--board {whole!r} has no counts such as 9x6", fix=_SAY)
    columns, rows = int(found[1]), int(found[2])
    if not (min(columns, rows) >= _FEWEST and max(columns, rows) <= _MOST):
        raise ConfigError(f"--board {whole!r} is {columns}×{rows}, not {_FEWEST} to {_MOST} each way", fix=_SAY)
    return columns, rows


def _length_m(text: str, whole: str) -> float:
    found = re.fullmatch(r"([0-9]*\.?[0-9]+)\s*(mm|cm|m)", text)
    if not found:
        raise ConfigError(f"--board {whole!r}: {text!r} is no length with its unit", fix="25mm, 2.5cm or 0.025m; or ?")
    length_m = float(found[1]) * _UNITS[found[2]]
    if not _SMALLEST_M <= length_m <= _LARGEST_M:
        raise ConfigError(f"--board {whole!r}: {length_m:g} m is no side of a square", fix="give 2 mm to 1 m")
    return length_m


def _marker_m(parts: list[str], side_m: float, whole: str) -> float:
    if len(parts) < 3 or not parts[2]:
        return round(_MARKER_SHARE * side_m, 3) if side_m < 1 else _MARKER_SHARE * side_m
    if parts[1] == "?":
        raise ConfigError(f"--board {whole!r}: the marker's size is known, the square's is not", fix=_SAY)
    return _length_m(parts[2], whole)


def _dictionary(squares: int) -> str:
    return f"5X5_{next(size for size in _DICTIONARY_SIZES if 2 * size >= squares or size == _DICTIONARY_SIZES[-1])}"


def _check_dictionary(board: Board, markers: int, text: str) -> None:
    if not hasattr(cv2.aruco, f"DICT_{board.dictionary}"):
        raise ConfigError(f"--board {text!r}: OpenCV has no dictionary {board.dictionary}", fix="5X5_100, for one")
    known = len(cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, f"DICT_{board.dictionary}")).bytesList)
    if markers > known:
        problem = f"--board {text!r} has {markers} markers, its dictionary {board.dictionary} {known}"
        raise ConfigError(problem, fix=f"take {_dictionary(2 * markers)}")
