"""The plan of the floor about a robot, as half-block characters: two cells above each other are a letter."""

from __future__ import annotations

from enum import IntEnum

import numpy as np
from rich.style import Style
from rich.text import Text

from wheelsight.geometry import ByteArray, FloatArray
from wheelsight.navigation import CellState, Costmap, Feedback, Footprint, StaticLayer


class Sign(IntEnum):
    """What a cell of the plan shows; of several the highest."""

    FREE = 0
    UNKNOWN = 1
    WALL = 2
    WAY = 3
    GOAL = 4
    ROBOT = 5
    FRONT = 6


# Told apart by people who see no red and green (Okabe & Ito 2008).
_COLOURS = {
    Sign.FREE: "#e9e9e9",
    Sign.UNKNOWN: "#9a9a9a",
    Sign.WALL: "#202020",
    Sign.WAY: "#0072b2",
    Sign.GOAL: "#cc79a7",
    Sign.ROBOT: "#009e73",
    Sign.FRONT: "#d55e00",
}
_LETTERS = {
    Sign.FREE: ".",
    Sign.UNKNOWN: " ",
    Sign.WALL: "#",
    Sign.WAY: "+",
    Sign.GOAL: "X",
    Sign.ROBOT: "o",
    Sign.FRONT: "^",
}
# Points of a cell of the plan that are looked up: a wall between two of them is not missed.
_LOOKS = 3
_GOAL_CELLS = 1


def plan_signs(
    floor: StaticLayer | Costmap, feedback: Feedback, footprint: Footprint, shape: tuple[int, int], cell_m: float
) -> ByteArray:
    """(H, W) of `Sign`, y up, with the robot in the middle; of a robot that does not know where it is, the map's.

    Args:
        floor: what is known of it.
        feedback: of now.
        footprint: of the robot.
        shape: rows and columns.
        cell_m: side of a cell.
    """
    middle = _middle(floor) if feedback.pose is None else feedback.pose[:2]
    rows, columns = shape
    x = (np.arange(columns) + 0.5 - columns / 2) * cell_m + middle[0]
    y = (rows / 2 - np.arange(rows) - 0.5) * cell_m + middle[1]
    signs = _floor_signs(floor, x, y, cell_m)
    if feedback.plan is not None:
        _mark(signs, feedback.plan.poses[:, :2], x, y, Sign.WAY)
    if feedback.goal is not None:
        around = np.arange(-_GOAL_CELLS, _GOAL_CELLS + 1) * cell_m
        spots = feedback.goal[:2] + np.stack(np.meshgrid(around, around), axis=-1).reshape(-1, 2)
        _mark(signs, spots, x, y, Sign.GOAL)
    if feedback.pose is not None:
        _draw_robot(signs, feedback.pose, footprint, x, y)
    return signs


def as_text(signs: ByteArray, *, in_colour: bool = True) -> Text:
    """Signs (H, W), H even, as H / 2 lines; without colours as letters, of two cells the higher one."""
    text = Text(no_wrap=True)
    for upper, lower in zip(signs[::2], signs[1::2], strict=True):
        for above, below in zip(upper.tolist(), lower.tolist(), strict=True):
            if in_colour:
                text.append("▀", Style(color=_COLOURS[Sign(above)], bgcolor=_COLOURS[Sign(below)]))
            else:
                text.append(_LETTERS[Sign(max(above, below))])
        text.append("\n")
    text.right_crop(1)
    return text


def _middle(floor: StaticLayer | Costmap) -> FloatArray:
    return np.array(floor.origin) + np.array(floor.state.shape[::-1]) * floor.resolution_m / 2


def _floor_signs(floor: StaticLayer | Costmap, x: FloatArray, y: FloatArray, cell_m: float) -> ByteArray:
    """A cell in which anything is occupied is a wall; else it is what its middle is."""
    offsets = (np.arange(_LOOKS) - (_LOOKS - 1) / 2) * cell_m / _LOOKS
    columns = np.floor((x[:, None] + offsets - floor.origin[0]) / floor.resolution_m).astype(int)
    rows = np.floor((y[:, None] - offsets - floor.origin[1]) / floor.resolution_m).astype(int)
    height, width = floor.state.shape
    looked = floor.state[np.clip(rows, 0, height - 1).ravel()][:, np.clip(columns, 0, width - 1).ravel()]
    inside = ((rows >= 0) & (rows < height)).ravel()[:, None] & ((columns >= 0) & (columns < width)).ravel()
    states = np.where(inside, looked, CellState.UNKNOWN).reshape(len(y), _LOOKS, len(x), _LOOKS)
    is_wall = (states == CellState.OCCUPIED).any(axis=(1, 3))
    middle = states[:, _LOOKS // 2, :, _LOOKS // 2]
    signs = np.where(middle == CellState.FREE, Sign.FREE, Sign.UNKNOWN)
    return np.where(is_wall, Sign.WALL, signs).astype(np.uint8)


def _mark(signs: ByteArray, points: FloatArray, x: FloatArray, y: FloatArray, sign: Sign) -> None:
    """Where points (N, 2) are."""
    cell_m = x[1] - x[0]
    columns = np.floor((points[:, 0] - x[0]) / cell_m + 0.5).astype(int)
    rows = np.floor((y[0] - points[:, 1]) / cell_m + 0.5).astype(int)
    inside = (columns >= 0) & (columns < len(x)) & (rows >= 0) & (rows < len(y))
    at = rows[inside], columns[inside]
    signs[at] = np.maximum(signs[at], sign)


def _draw_robot(signs: ByteArray, pose: FloatArray, footprint: Footprint, x: FloatArray, y: FloatArray) -> None:
    """Its outline, filled; the foremost quarter shows where it looks."""
    c, s = np.cos(pose[2]), np.sin(pose[2])
    away = np.stack(np.meshgrid(x, y), axis=-1) - pose[:2]
    in_base = away @ np.array([[c, -s], [s, c]])
    under = footprint.contains(in_base)
    low, high = footprint.corners[:, 0].min(), footprint.corners[:, 0].max()
    signs[under] = Sign.ROBOT
    signs[under & (in_base[..., 0] > high - (high - low) / 4)] = Sign.FRONT
