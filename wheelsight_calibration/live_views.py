"""`ViewTaker` collects views of a board from a live camera. `advise` returns which views are still missing."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from wheelsight.core.files import make_output_folder
from wheelsight.core.geometry import FloatArray, PinholeCamera
from wheelsight.core.geometry.arrays import UInt16Array
from wheelsight.core.messages import RgbdFrame
from wheelsight.core.settings.calibration import CoachSettings
from wheelsight.io.recordings.images import write_color, write_units
from wheelsight_calibration.board import Board
from wheelsight_calibration.camera_model import poses_in, usual_lens
from wheelsight_calibration.views import Corners, as_grey, find_corners

_NONE = np.iinfo(np.uint16).max

# A live view is still if half of the corners move by less than this share of the image's width, 1 px of 640, for this
# time: depth that cameras average over frames is then of one place. It is new if a corner moved by the last share since
# each view before. Chosen.
_STILL_SHARE, _STILL_S, _NEW_SHARE = 0.0015, 0.4, 0.02
_MORE_VIEWS = 5  # live views after which a refused calibration is tried again
# Tilt to each of four sides (Zhang 2000: errors are least about 45°, those of corners at 25°), columns and rows of the
# image that boards should reach, and ratio of the farthest to the nearest board; chosen.
_TILT_DEG, _COLUMNS, _ROWS, _NEAR_FAR = 25.0, 3, 3, 2.0


class ViewTaker:
    """Collects frames in which the board is at rest at a new place.

    Args:
        board: the board.
        lens: nominal lens of the colour camera.
        settings: how many views are enough.
        seen: corners of earlier views.

    Attributes:
        seen: corners of all views.
    """

    def __init__(
        self, board: Board, lens: PinholeCamera, settings: CoachSettings | None = None, seen: Sequence[Corners] = ()
    ) -> None:
        self._board, self._lens, self._settings = board, lens, settings or CoachSettings()
        self.seen = list(seen)
        self._still: tuple[float, Corners] | None = None
        self._more = 0

    @property
    def advice(self) -> Advice:
        """The views that are missing."""
        size = self._lens.width, self._lens.height
        return advise(self.seen, self._board, size, self._settings, self._lens)

    def has_enough(self) -> bool:
        """Whether nothing is missing, and as many views followed `ask_more` as requested."""
        return len(self.seen) >= self._more and not self.advice.missing

    def ask_more(self) -> None:
        """Request more views after a calibration that they did not determine."""
        self._more = len(self.seen) + _MORE_VIEWS

    def add(self, frame: RgbdFrame) -> str:
        """The reason why a frame is no new view, or "" after it is added."""
        found = find_corners(as_grey(frame.color[..., ::-1]), self._board)
        if isinstance(found, str):
            self._still = None
            return found
        width = self._lens.width
        if self._still is None or np.median(_apart_px(found, self._still[1])) > _STILL_SHARE * width:
            self._still = frame.stamp_s, found
        if any(_apart_px(found, other).max() < _NEW_SHARE * width for other in self.seen):
            return "such a view is there already: move the board"
        if frame.stamp_s - self._still[0] < _STILL_S:
            return "hold still"
        self.seen.append(found)
        return ""


def _apart_px(one: Corners, other: Corners) -> FloatArray:
    """The displacement of each corner that both show; one infinite value if they share none."""
    _, first, second = np.intersect1d(one.ids, other.ids, return_indices=True)
    if not len(first):
        return np.array([np.inf])
    return np.asarray(np.linalg.norm(one.px[first] - other.px[second], axis=1))


def save_view(folder: Path, frame: RgbdFrame, infrared: UInt16Array | None = None, depth_factor: float = 1000.0) -> str:
    """Write a view into a folder in the form of `read_views`, beside earlier ones; returns its name.

    Raises OutputError.
    """
    make_output_folder(folder, force=True)
    number = 1
    while (folder / f"{number:03d}-color.png").exists():
        number += 1
    name = f"{number:03d}"
    units = np.rint(np.asarray(frame.depth_m, np.float64) * depth_factor)
    write_units(folder / f"{name}-depth.png", np.where(units < _NONE, units, 0).astype(np.uint16))
    if infrared is not None:
        write_units(folder / f"{name}-ir.png", infrared)
    write_color(folder / f"{name}-color.png", frame.color, "png")
    return name


_ACROSS, _DOWN = 8, 6
_WHERE_X, _WHERE_Y = ("left", "", "right"), ("upper", "", "lower")


@dataclass(frozen=True, slots=True)
class Advice:
    """The present views and the missing ones.

    Attributes:
        missing: instructions, the next one first; empty if nothing is missing.
        cover: share of the image's 8 × 6 cells that hold corners.
        nearest_m, farthest_m: distances of boards by the given lens or a typical one; in squares if their side is
            unknown.
        tilts_deg: largest tilts with the board's left side, right side, top and bottom nearer.
    """

    missing: tuple[str, ...]
    cover: float
    nearest_m: float
    farthest_m: float
    tilts_deg: tuple[float, float, float, float]

    def __str__(self) -> str:
        """The next instruction."""
        return f"next: {self.missing[0]}" if self.missing else "nothing is missing"


def advise(
    seen: Sequence[Corners],
    board: Board,
    size: tuple[int, int],
    settings: CoachSettings | None = None,
    lens: PinholeCamera | None = None,
) -> Advice:
    """The missing views, by corners seen in images of `size`; without `lens` a typical one is assumed."""
    enough = (settings or CoachSettings()).enough
    if not seen:
        return Advice(("the whole board, in the middle of the image",), 0.0, np.nan, np.nan, (0.0, 0.0, 0.0, 0.0))
    T = poses_in(lens or usual_lens(size), seen, board).T_camera_board
    T[:, :3, 3] *= board.square_m
    cover = covered_share([corners.px for corners in seen], size)
    nearest_m, farthest_m = distances(T)
    n = T[:, :3, 2]
    across, down = np.degrees(np.arctan2(n[:, 0], n[:, 2])), np.degrees(np.arctan2(n[:, 1], n[:, 2]))
    # A board whose right side is nearer has a normal that points away and to the right.
    greatest = ((-across).max(), across.max(), (-down).max(), down.max())
    left, right, top, bottom = (max(float(value), 0.0) for value in greatest)
    tilts = left, right, top, bottom
    sides = ("left side", "right side", "upper edge", "lower edge")
    missing = [
        f"the board's {side} nearer to the camera, by about {_TILT_DEG:.0f}°"
        for side, tilt in zip(sides, tilts, strict=True)
        if tilt < 0.8 * _TILT_DEG
    ]
    px = np.concatenate([corners.px for corners in seen])
    cells = np.floor(px * (_COLUMNS / size[0], _ROWS / size[1])).astype(int).clip(0, (_COLUMNS - 1, _ROWS - 1))
    there = {(int(u), int(v)) for u, v in cells}
    missing += [
        f"the board in the {_place(u, v)} of the image"
        for v in range(_ROWS)
        for u in range(_COLUMNS)
        if (u, v) not in there
    ]
    if farthest_m < _NEAR_FAR * nearest_m:
        word = "nearer" if cover < 0.5 else "farther away"
        missing.insert(0, f"{word}: boards are all {nearest_m:.2g} to {farthest_m:.2g} m away")
    if not missing and len(seen) < enough:
        missing.append(f"more like these: {len(seen)} of {enough} views")
    return Advice(tuple(missing), cover, nearest_m, farthest_m, tilts)


def covered_share(px: Sequence[FloatArray], size: tuple[int, int]) -> float:
    """Share of the image's 8 × 6 cells that hold corners of any view."""
    cells = np.concatenate([np.asarray(points).reshape(-1, 2) for points in px]) * (_ACROSS / size[0], _DOWN / size[1])
    whole = np.unique(np.floor(cells).astype(int).clip(0, (_ACROSS - 1, _DOWN - 1)), axis=0)
    return len(whole) / (_ACROSS * _DOWN)


def largest_tilt_deg(T_camera_board: FloatArray) -> float:
    """The largest angle between two boards' normals (V, 4, 4)."""
    n = T_camera_board[:, :3, 2]
    return float(np.degrees(np.arccos(np.clip((n @ n.T).min(), -1, 1))))


def distances(T_camera_board: FloatArray) -> tuple[float, float]:
    """Nearest and farthest board along the camera's axis."""
    z = T_camera_board[:, 2, 3]
    return float(z.min()), float(z.max())


def _place(u: int, v: int) -> str:
    x = _WHERE_X[1 + int(np.sign(2 * u - _COLUMNS + 1))]
    y = _WHERE_Y[1 + int(np.sign(2 * v - _ROWS + 1))]
    if x and y:
        return f"{y} {x} corner"
    return f"{x} part" if x else f"{y} part" if y else "middle"
