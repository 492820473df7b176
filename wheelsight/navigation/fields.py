"""CostField: what a controller asks of the surroundings; and outlines as kernels take them."""

from __future__ import annotations

import numpy as np
from scipy.spatial.distance import cdist

from wheelsight.errors import ArgumentError
from wheelsight.geometry import FloatArray
from wheelsight.navigation._field_kernels import ANY_SPEED, OVERHANG_M, CostField, Outline
from wheelsight.navigation.footprint import Footprint

__all__ = ["ANY_SPEED", "CostField", "Outline", "checked", "outline_of", "sides_of"]

# With fewer and larger steps a cover has more discs; a chair's has 14.
_COVER_STEP_M = 0.02


def checked(field: CostField) -> CostField:
    """A field with the types that kernels take. Raises ArgumentError where shapes or numbers are none."""
    distance, cost, speed = (np.ascontiguousarray(a, np.float32) for a in (field[0], field[1], field[4]))
    if distance.ndim != 2 or min(distance.shape) < 2 or cost.shape != distance.shape:
        raise ArgumentError(f"a field of shapes {distance.shape}, {cost.shape}", fix="give two of (H, W)")
    if speed.shape not in (distance.shape, (1, 1)):
        raise ArgumentError(f"speeds of zones of shape {speed.shape}", fix=f"give {distance.shape} or (1, 1)")
    numbers = np.array([field.resolution, *field.origin], float)
    if not np.isfinite(numbers).all() or field.resolution <= 0:
        raise ArgumentError(f"a field of {field.resolution} m at {field.origin}", fix="give finite metres")
    if np.isnan(distance).any() or np.isnan(cost).any() or np.isnan(speed).any():
        raise ArgumentError("a field holds NaN", fix="what is unknown is an obstacle, or costs")
    return CostField(distance, cost, float(numbers[0]), (float(numbers[1]), float(numbers[2])), speed)


def sides_of(footprint: Footprint) -> FloatArray:
    """(N, 5) of a footprint: where each side begins, its direction and length."""
    ways = np.roll(footprint.corners, -1, axis=0) - footprint.corners
    lengths = np.linalg.norm(ways, axis=1, keepdims=True)
    return np.ascontiguousarray(np.concatenate([footprint.corners, ways / lengths, lengths], axis=1))


def outline_of(footprint: Footprint) -> Outline:
    """A footprint as kernels take it."""
    corners, sides = footprint.corners, sides_of(footprint)
    middle = (corners.min(axis=0) + corners.max(axis=0)) / 2
    radius = float(np.linalg.norm(corners - middle, axis=1).max())
    return Outline(sides, _cover(footprint, sides), (float(middle[0]), float(middle[1]), radius))


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
