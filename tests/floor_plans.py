"""Small floor plans, drawn by tests."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np

CELL_M = 0.05
FREE, WALL, UNKNOWN = 254, 0, 205
# Walls of the two rooms and the corridor of `two_rooms`, metres: x from, y from, x to, y to.
WALLS_M = ((0, 0, 12, 0.2), (0, 8, 12, 8.2), (0, 0, 0.2, 8.2), (11.8, 0, 12, 8.2), (0, 2.2, 12, 2.4), (6, 2.2, 6.2, 8))
DOORWAYS_M = ((2.5, 2.2, 3.5, 2.4), (8.5, 2.2, 9.5, 2.4))


def one_room(width_m: float, depth_m: float) -> np.ndarray:
    """(H, W) uint8 of a room between walls of 0.2 m, its sides measured outside; a metre of unknown is round about."""
    image = np.full((round((depth_m + 2) / CELL_M), round((width_m + 2) / CELL_M)), UNKNOWN, np.uint8)
    _fill(image, (0, 0, width_m, depth_m), WALL)
    _fill(image, (0.2, 0.2, width_m - 0.2, depth_m - 0.2), FREE)
    return image


def two_rooms(specks: np.random.Generator | None = None) -> np.ndarray:
    """(H, W) uint8 of a corridor, 2 m wide, along x, and two rooms that open to it by doorways of 1 m.

    Row 0 is the greatest y, as in images; one metre of unknown is round about.
    """
    image = np.full((round(10.2 / CELL_M), round(14 / CELL_M)), UNKNOWN, np.uint8)
    _fill(image, (0, 0, 12, 8.2), FREE)
    for wall in WALLS_M:
        _fill(image, wall, WALL)
    for doorway in DOORWAYS_M:
        _fill(image, doorway, FREE)
    if specks is not None:
        rows, columns = specks.integers(0, image.shape[0], 400), specks.integers(0, image.shape[1], 400)
        image[rows, columns] = WALL
    return image


def _fill(image: np.ndarray, box_m: tuple[float, float, float, float], value: int) -> None:
    left, low, right, high = (round((side + 1) / CELL_M) for side in box_m)
    image[image.shape[0] - high : image.shape[0] - low, left:right] = value


def rooms_in_colours() -> np.ndarray:
    """(H, W, 3) uint8 of the same size: corridor and rooms, a colour each."""
    image = np.full((*two_rooms().shape, 3), 120, np.uint8)
    for box_m, colour in (
        ((0.2, 0.2, 11.8, 2.2), (40, 90, 200)),
        ((0.2, 2.4, 6, 8), (200, 60, 60)),
        ((6.2, 2.4, 11.8, 8), (60, 180, 70)),
    ):
        for channel, value in enumerate(colour):
            _fill(image[..., channel], box_m, value)
    return image


def write_plan(folder: Path, image: np.ndarray, origin: tuple[float, float, float] = (-1.0, -1.0, 0.0)) -> Path:
    """The YAML file of a plan; with the origin as it is, walls are where WALLS_M has them."""
    cv2.imwrite(str(folder / "plan.pgm"), image)
    path = folder / "house.yaml"
    path.write_text(f"image: plan.pgm\nresolution: {CELL_M}\norigin: [{origin[0]}, {origin[1]}, {origin[2]}]\n")
    return path
