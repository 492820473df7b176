"""`Board` describes a checkerboard or ChArUco board. `draw_board` draws it in true size as PDF or SVG."""

from __future__ import annotations

import re
from dataclasses import dataclass, field
from html import escape
from typing import Any

import cv2
import numpy as np

from wheelsight.core.errors import ConfigError
from wheelsight.core.geometry import FloatArray

_FEWEST, _MOST = 3, 60
_SMALLEST_M, _LARGEST_M = 0.002, 1.0
_MARKER_SHARE = 0.72  # of a square: OpenCV's own examples have 0.5 to 0.8; its border stays wider than a module
_UNITS = {"mm": 1e-3, "cm": 1e-2, "m": 1.0}
_DICTIONARY_SIZES = (50, 100, 250, 1000)
_SAY = "give --board 9x6:25mm, inner corners and side of a square, or charuco:9x6:30mm, squares and side"


@dataclass(frozen=True, slots=True)
class Board:
    """A flat board of black and white squares.

    Attributes:
        columns, rows: numbers of inner corners, where four squares meet.
        square_m: side of a square, metres; 1.0 if unknown.
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
        """Whether markers identify its corners, so that a part of the board suffices."""
        return bool(self.marker_m)

    @property
    def count(self) -> int:
        """Number of inner corners."""
        return self.columns * self.rows

    @property
    def points_m(self) -> FloatArray:
        """Its corners (count, 3), row by row, in its own frame: x along rows, y down, z away from the camera."""
        v, u = np.mgrid[0 : self.rows, 0 : self.columns]
        return self.square_m * np.stack([u.ravel(), v.ravel(), np.zeros(self.count)], axis=-1)

    @property
    def is_half_turn_seen(self) -> bool:
        """Whether it differs upside down, as a checkerboard with one even and one odd count does."""
        return self.is_charuco or (self.columns + self.rows) % 2 == 1

    def __str__(self) -> str:
        """The form of `--board`."""
        side = f"{1e3 * self.square_m:g}mm" if self.is_size_known else "?"
        if not self.is_charuco:
            return f"{self.columns}x{self.rows}:{side}"
        marker = f"{1e3 * self.marker_m:g}mm" if self.is_size_known else f"{self.marker_m:g}"
        return f"charuco:{self.columns + 1}x{self.rows + 1}:{side}:{marker}:{self.dictionary}"

    def charuco(self) -> Any:
        """OpenCV's `CharucoBoard`."""
        markers = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, f"DICT_{self.dictionary}"))
        return cv2.aruco.CharucoBoard((self.columns + 1, self.rows + 1), self.square_m, self.marker_m, markers)


def board_from(text: str) -> Board:
    """The board that `--board` names: `9x6:25mm`, `9x6:?` or `charuco:9x6:30mm[:MARKER[:DICTIONARY]]`.

    Raises:
        ConfigError: the text names no board.
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
    if len(parts) >= 3 and parts[2]:
        if parts[1] == "?":
            raise ConfigError(f"--board {text!r}: the marker's size is known, the square's is not", fix=_SAY)
        marker_m = _length_m(parts[2], text)
    else:
        marker_m = round(_MARKER_SHARE * side_m, 3) if side_m < 1 else _MARKER_SHARE * side_m
    if not 0.3 * side_m <= marker_m < side_m:
        raise ConfigError(f"--board {text!r}: a marker must be smaller than its square, and no speck in it", fix=_SAY)
    dictionary = parts[3].upper().removeprefix("DICT_") if len(parts) == 4 else _dictionary(columns * rows)
    board = Board(columns - 1, rows - 1, side_m, marker_m, dictionary, parts[1] != "?")
    markers = columns * rows // 2
    if not hasattr(cv2.aruco, f"DICT_{board.dictionary}"):
        raise ConfigError(f"--board {text!r}: OpenCV has no dictionary {board.dictionary}", fix="5X5_100, for one")
    known = len(cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, f"DICT_{board.dictionary}")).bytesList)
    if markers > known:
        problem = f"--board {text!r} has {markers} markers, its dictionary {board.dictionary} {known}"
        raise ConfigError(problem, fix=f"take {_dictionary(2 * markers)}")
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


def _dictionary(squares: int) -> str:
    return f"5X5_{next(size for size in _DICTIONARY_SIZES if 2 * size >= squares or size == _DICTIONARY_SIZES[-1])}"


PAPERS = {"A4": (297.0, 210.0), "A3": (420.0, 297.0), "A2": (594.0, 420.0), "Letter": (279.4, 215.9)}
# Printers leave a rim of some millimetres; below the board is a strip for ruler and words.
_RIM_MM, _STRIP_MM = 8.0, 12.0
_RULER_MM, _TICK_MM, _LINE_MM, _WORD_MM = 100, 10, 0.25, 3.2
_POINTS_PER_MM = 72 / 25.4


@dataclass(frozen=True, slots=True)
class Drawing:
    """A sheet: black rectangles (x, y, width, height) and words (x, y, text), millimetres from its upper left."""

    width_mm: float
    height_mm: float
    title: str
    rectangles: list[tuple[float, float, float, float]] = field(default_factory=list)
    words: list[tuple[float, float, str]] = field(default_factory=list)


def draw_board(board: Board, paper: str = "A4") -> Drawing:
    """The board in the middle of a landscape sheet, with a ruler and its name below.

    Raises:
        ConfigError: the paper is unknown, the board has no known size, or the paper is too small.
    """
    names = {name.lower(): name for name in PAPERS}
    if paper.lower() not in names:
        raise ConfigError(f"paper {paper!r} is not known", fix=f"choose from {', '.join(PAPERS)}")
    if not board.is_size_known:
        raise ConfigError("a board of unknown size cannot be drawn", fix="give the side of its squares: 9x6:25mm")
    sheet = Drawing(*PAPERS[names[paper.lower()]], title=f"wheelsight board {board}")
    side_mm = 1e3 * board.square_m
    columns, rows = board.columns + 1, board.rows + 1
    left = (sheet.width_mm - columns * side_mm) / 2
    top = (sheet.height_mm - _STRIP_MM - rows * side_mm) / 2
    if min(left, top) < _RIM_MM:
        free = (sheet.width_mm - 2 * _RIM_MM) / columns, (sheet.height_mm - 2 * _RIM_MM - _STRIP_MM) / rows
        problem = f"{columns} × {rows} squares of {side_mm:g} mm do not fit on {names[paper.lower()]}"
        raise ConfigError(problem, fix=f"squares of at most {int(min(free))} mm, fewer of them, or larger paper")
    for v in range(rows):
        for u in range(columns):
            if (u + v) % 2 == 0:
                sheet.rectangles.append((left + u * side_mm, top + v * side_mm, side_mm, side_mm))
    if board.is_charuco:
        _draw_markers(sheet, board, left, top)
    base = sheet.height_mm - _RIM_MM
    sheet.rectangles.append((_RIM_MM, base - _LINE_MM / 2, _RULER_MM, _LINE_MM))
    for at in range(0, _RULER_MM + 1, _TICK_MM):
        tall = 3.0 if at % (5 * _TICK_MM) == 0 else 1.8
        sheet.rectangles.append((_RIM_MM + at - _LINE_MM / 2, base - tall, _LINE_MM, tall))
    right = _RIM_MM + _RULER_MM + 4
    sheet.words.append(
        (right, base - 4.2, f"{_RULER_MM} mm by a ruler, else the print was scaled: {names[paper.lower()]}, 100 %")
    )
    sheet.words.append((right, base, f"--board {board}"))
    return sheet


def _draw_markers(sheet: Drawing, board: Board, left: float, top: float) -> None:
    layout = board.charuco()
    markers = layout.getDictionary()
    modules = markers.markerSize + 2
    for number, corners in zip(layout.getIds().ravel(), layout.getObjPoints(), strict=True):
        x, y = left + 1e3 * corners[:, 0].min(), top + 1e3 * corners[:, 1].min()
        side_mm = 1e3 * board.marker_m / modules
        for v, row in enumerate(cv2.aruco.generateImageMarker(markers, int(number), modules)):
            # One rectangle a run: seams between modules print grey.
            edges = np.flatnonzero(np.diff(np.concatenate([[0], row == 0, [0]]).astype(int)))
            for begin, end in edges.reshape(-1, 2):
                sheet.rectangles.append((x + begin * side_mm, y + v * side_mm, (end - begin) * side_mm, side_mm))


def as_svg(sheet: Drawing) -> str:
    """The sheet as SVG in millimetres."""
    size = f'width="{sheet.width_mm:g}mm" height="{sheet.height_mm:g}mm"'
    lines = [
        f'<svg xmlns="http://www.w3.org/2000/svg" {size} viewBox="0 0 {sheet.width_mm:g} {sheet.height_mm:g}">',
        f"<title>{escape(sheet.title)}</title>",
        '<rect width="100%" height="100%" fill="white"/>',
    ]
    # Corners of neighbouring squares must meet: no smoothing, and all digits.
    lines += [
        f'<rect x="{x:.4f}" y="{y:.4f}" width="{w:.4f}" height="{h:.4f}" fill="black"/>'
        for x, y, w, h in sheet.rectangles
    ]
    lines += [
        f'<text x="{x:.2f}" y="{y:.2f}" font-family="Helvetica, Arial, sans-serif" font-size="{_WORD_MM}">'
        f"{escape(text)}</text>"
        for x, y, text in sheet.words
    ]
    return "\n".join([*lines, "</svg>", ""])


def as_pdf(sheet: Drawing) -> bytes:
    """The sheet as a PDF of one page, in true size."""
    k = _POINTS_PER_MM
    content = [f"{k:.8f} 0 0 {k:.8f} 0 0 cm", "0 g"]
    content += [f"{x:.4f} {sheet.height_mm - y - h:.4f} {w:.4f} {h:.4f} re" for x, y, w, h in sheet.rectangles]
    content.append("f")
    for x, y, text in sheet.words:
        content.append(f"BT /F1 {_WORD_MM} Tf {x:.2f} {sheet.height_mm - y:.2f} Td ({_escaped(text)}) Tj ET")
    stream = "\n".join(content).encode("latin-1")
    box = f"[0 0 {sheet.width_mm * k:.4f} {sheet.height_mm * k:.4f}]"
    objects = [
        # Viewers scale to the paper by default.
        b"<< /Type /Catalog /Pages 2 0 R /ViewerPreferences << /PrintScaling /None >> >>",
        b"<< /Type /Pages /Kids [3 0 R] /Count 1 >>",
        f"<< /Type /Page /Parent 2 0 R /MediaBox {box} /Contents 4 0 R "
        "/Resources << /Font << /F1 5 0 R >> >> >>".encode(),
        f"<< /Length {len(stream)} >>\nstream\n".encode() + stream + b"\nendstream",
        b"<< /Type /Font /Subtype /Type1 /BaseFont /Helvetica >>",
        f"<< /Title ({_escaped(sheet.title)}) >>".encode("latin-1"),
    ]
    data, starts = b"%PDF-1.4\n", []
    for number, body in enumerate(objects, start=1):
        starts.append(len(data))
        data += f"{number} 0 obj\n".encode() + body + b"\nendobj\n"
    table = "".join(f"{start:010d} 00000 n \n" for start in starts)
    size = len(objects) + 1
    trailer = f"trailer\n<< /Size {size} /Root 1 0 R /Info {len(objects)} 0 R >>\nstartxref\n{len(data)}\n%%EOF\n"
    return data + f"xref\n0 {size}\n0000000000 65535 f \n{table}{trailer}".encode()


def _escaped(text: str) -> str:
    return text.replace("\\", r"\\").replace("(", r"\(").replace(")", r"\)")
