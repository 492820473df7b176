"""CostField: what a controller asks of the surroundings; and outlines as kernels take them."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.spatial.distance import cdist

from wheelsight.errors import ArgumentError
from wheelsight.geometry import Float32Array, FloatArray
from wheelsight.navigation.footprint import Footprint

ANY_SPEED: Float32Array = np.full((1, 1), np.inf, np.float32)
ANY_SPEED.setflags(write=False)

# A cover of fewer discs reaches farther out; with these it has 12 for a chair, and errs by less than a cell.
OVERHANG_M, _COVER_STEP_M = 0.04, 0.02


class CostField(NamedTuple):
    """A window of the floor in cells: rows along y, columns along x. What lies outside of it counts as an obstacle.

    Attributes:
        distance_m: (H, W) from each cell's centre to the centre of the nearest cell with an obstacle; 0 in these.
        cost: (H, W) from 0, free, to 1: what driving there costs beyond being near obstacles, such as unknown floor.
        resolution: metres a cell.
        origin: x and y in metres of the corner of cell (0, 0), in the frame of plan and robot.
        speed_m_s: (H, W) fastest speed in zones, infinite outside of them; (1, 1) where one holds everywhere.
    """

    distance_m: Float32Array
    cost: Float32Array
    resolution: float
    origin: tuple[float, float]
    speed_m_s: Float32Array = ANY_SPEED

    def checked(self) -> CostField:
        """The same with the types that kernels take. Raises ArgumentError where shapes or numbers are none."""
        distance, cost, speed = (np.ascontiguousarray(a, np.float32) for a in (self[0], self[1], self[4]))
        if distance.ndim != 2 or min(distance.shape) < 2 or cost.shape != distance.shape:
            raise ArgumentError(f"a field of shapes {distance.shape}, {cost.shape}", fix="give two of (H, W)")
        if speed.shape not in (distance.shape, (1, 1)):
            raise ArgumentError(f"speeds of zones of shape {speed.shape}", fix=f"give {distance.shape} or (1, 1)")
        numbers = np.array([self.resolution, *self.origin], float)
        if not np.isfinite(numbers).all() or self.resolution <= 0:
            raise ArgumentError(f"a field of {self.resolution} m at {self.origin}", fix="give finite metres")
        if np.isnan(distance).any() or np.isnan(cost).any() or np.isnan(speed).any():
            raise ArgumentError("a field holds NaN", fix="what is unknown is an obstacle, or costs")
        return CostField(distance, cost, float(numbers[0]), (float(numbers[1]), float(numbers[2])), speed)


class Outline(NamedTuple):
    """A footprint as kernels take it.

    Attributes:
        sides: (N, 5) x, y of a corner, unit vector to the next one, and how far that is.
        discs: (K, 3) x, y, radius of discs that lie within.
        cover: (K, 3) discs that together hold all of it, and little else.
        around: x, y, radius of a disc that holds all.
    """

    sides: FloatArray
    discs: FloatArray
    cover: FloatArray
    around: tuple[float, float, float]

    @classmethod
    def of(cls, footprint: Footprint) -> Outline:
        """Of a footprint: the disc about the middle of its corners, and the largest about middle and axle."""
        corners = footprint.corners
        ways = np.roll(corners, -1, axis=0) - corners
        lengths = np.linalg.norm(ways, axis=1, keepdims=True)
        sides = np.ascontiguousarray(np.concatenate([corners, ways / lengths, lengths], axis=1))
        middle = (corners.min(axis=0) + corners.max(axis=0)) / 2
        discs = np.array([[*at, _inside_m(sides, at)] for at in (middle, np.zeros(2))])
        radius = float(np.linalg.norm(corners - middle, axis=1).max())
        return cls(sides, discs, _cover(footprint, sides), (float(middle[0]), float(middle[1]), radius))


def _inside_m(sides: FloatArray, at: FloatArray) -> FloatArray:
    """(...,) how far the nearest side is from points (..., 2); negative outside."""
    apart = at[..., None, :] - sides[:, :2]
    return np.asarray((sides[:, 2] * apart[..., 1] - sides[:, 3] * apart[..., 0]).min(axis=-1))


def _cover(footprint: Footprint, sides: FloatArray) -> FloatArray:
    """Discs that reach less than `OVERHANG_M` out of an outline; each is the one that holds most of what is left."""
    low, high = footprint.corners.min(axis=0), footprint.corners.max(axis=0)
    inside = _grid(low, high, _COVER_STEP_M)
    on_sides = [
        corner + np.linspace(0, length, 2 + int(length / _COVER_STEP_M))[:, None] * way
        for corner, way, length in zip(sides[:, :2], sides[:, 2:4], sides[:, 4], strict=True)
    ]
    # Each is held by its own disc at least.
    points = np.concatenate([inside[_inside_m(sides, inside) >= 0], *on_sides])
    radii = np.maximum(_inside_m(sides, points), 0) + OVERHANG_M
    # Between two of the points that must be held others lie, half a diagonal away from one.
    held = cdist(points, points) <= radii[:, None] - _COVER_STEP_M * np.sqrt(0.5)
    chosen = []
    while held.shape[1]:
        chosen.append(int(held.sum(axis=1).argmax()))
        held = held[:, ~held[chosen[-1]]]
    return np.concatenate([points[chosen], radii[chosen, None]], axis=1)


def _grid(low: FloatArray, high: FloatArray, step_m: float) -> FloatArray:
    """(N, 2) points of a rectangle."""
    counts = np.maximum(np.ceil((high - low) / step_m).astype(int) + 1, 2)
    axes = (np.linspace(*ends) for ends in zip(low, high, counts, strict=True))
    return np.stack(np.meshgrid(*axes), axis=-1).reshape(-1, 2)
