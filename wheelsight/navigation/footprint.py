"""Footprint: the robot's outline, and its conversion to the values of the kernels."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.distance import cdist

from wheelsight.core.errors import ArgumentError
from wheelsight.core.geometry import FloatArray
from wheelsight.navigation.clearance_kernels import OVERHANG_M, CostField, Outline

# Sides of the polygon that stands for a circle.
_ROUND_SIDES = 16
# Grid of the points that the discs of an outline must cover. A coarser one needs more discs; a chair has 14.
_COVER_STEP_M = 0.02


@dataclass(frozen=True, eq=False)
class Footprint:
    """Convex outline of a robot in the frame `base`, whose origin is the centre of the axle.

    Attributes:
        corners: (N, 2) counter-clockwise, metres.
    """

    corners: FloatArray

    @classmethod
    def of(cls, corners: ArrayLike) -> Footprint:
        """Return the footprint with corners (N, 2) of a convex outline, in either order.

        Raises:
            ArgumentError: fewer than three corners, not finite, not convex, or without the centre of rotation.
        """
        points = np.asarray(corners, float)
        if points.ndim != 2 or points.shape[1:] != (2,) or len(points) < 3 or not np.isfinite(points).all():
            raise ArgumentError(f"a footprint of shape {points.shape}", fix="give three corners (N, 2) or more, metres")
        after = np.roll(points, -1, axis=0)
        if (points[:, 0] * after[:, 1] - points[:, 1] * after[:, 0]).sum() < 0:
            points = points[::-1]
        sides = np.roll(points, -1, axis=0) - points
        turns = sides[:, 0] * np.roll(sides, -1, axis=0)[:, 1] - sides[:, 1] * np.roll(sides, -1, axis=0)[:, 0]
        if (turns <= 0).any():
            raise ArgumentError("the footprint is not convex", fix="give its convex hull")
        made = cls(points)
        if made.inscribed_m <= 0:
            raise ArgumentError(
                "the centre of rotation lies outside of the footprint", fix="give corners about the axle"
            )
        return made

    @classmethod
    def rectangle(cls, front_m: float, back_m: float, width_m: float) -> Footprint:
        """Return a rectangle with lengths ahead of the axle and behind it. Raises ArgumentError."""
        half = width_m / 2
        return cls.of([(-back_m, -half), (front_m, -half), (front_m, half), (-back_m, half)])

    @classmethod
    def circle(cls, radius_m: float) -> Footprint:
        """Return a polygon around a circle about the axle. Raises ArgumentError."""
        angles = np.arange(_ROUND_SIDES) * 2 * np.pi / _ROUND_SIDES
        return cls.of(radius_m / np.cos(np.pi / _ROUND_SIDES) * np.stack([np.cos(angles), np.sin(angles)], axis=-1))

    @property
    def inscribed_m(self) -> float:
        """Distance from the centre of rotation to the nearest side; any obstacle nearer to it collides."""
        sides = np.roll(self.corners, -1, axis=0) - self.corners
        crosses = self.corners[:, 0] * sides[:, 1] - self.corners[:, 1] * sides[:, 0]
        return float((crosses / np.linalg.norm(sides, axis=1)).min())

    @property
    def circumscribed_m(self) -> float:
        """Distance to the farthest corner; without obstacles nearer to it the robot may turn in place."""
        return float(np.linalg.norm(self.corners, axis=1).max())

    def padded(self, margin_m: float) -> Footprint:
        """Return the footprint with all sides moved outward. Raises ArgumentError if nothing is left of it."""
        sides = np.roll(self.corners, -1, axis=0) - self.corners
        normals = np.stack([sides[:, 1], -sides[:, 0]], axis=-1) / np.linalg.norm(sides, axis=1, keepdims=True)
        offsets = (normals * self.corners).sum(axis=1) + margin_m
        before_n, before_o = np.roll(normals, 1, axis=0), np.roll(offsets, 1)
        corners = [
            np.linalg.solve(np.stack([n0, n1]), np.array([o0, o1]))
            for n0, n1, o0, o1 in zip(before_n, normals, before_o, offsets, strict=True)
        ]
        return Footprint.of(corners)

    def at(self, pose: ArrayLike) -> FloatArray:
        """Return corners (..., N, 2) of a base at poses (..., 3) of x, y, yaw."""
        pose = np.asarray(pose, float)
        c, s = np.cos(pose[..., 2]), np.sin(pose[..., 2])
        R = np.stack([np.stack([c, -s], axis=-1), np.stack([s, c], axis=-1)], axis=-2)
        return np.asarray(self.corners @ np.swapaxes(R, -1, -2) + pose[..., None, :2])

    def contains(self, points: ArrayLike) -> np.ndarray:
        """Return (...,) whether points (..., 2) in `base` lie inside or on the outline."""
        points = np.asarray(points, float)
        sides = np.roll(self.corners, -1, axis=0) - self.corners
        apart = points[..., None, :] - self.corners
        return np.asarray((sides[:, 0] * apart[..., 1] - sides[:, 1] * apart[..., 0] >= -1e-12).all(axis=-1))


def checked(field: CostField) -> CostField:
    """Return a field with the types of the kernels. Raises ArgumentError for wrong shapes or numbers."""
    distance, cost, speed = (np.ascontiguousarray(a, np.float32) for a in (field[0], field[1], field[4]))
    if distance.ndim != 2 or min(distance.shape) < 2 or cost.shape != distance.shape:
        raise ArgumentError(f"a field of shapes {distance.shape}, {cost.shape}", fix="give two of (H, W)")
    if speed.shape not in (distance.shape, (1, 1)):
        raise ArgumentError(f"speeds of zones of shape {speed.shape}", fix=f"give {distance.shape} or (1, 1)")
    numbers = np.array([field.resolution, *field.origin], float)
    if not np.isfinite(numbers).all() or field.resolution <= 0:
        raise ArgumentError(f"a field of {field.resolution} m at {field.origin}", fix="give finite metres")
    if np.isnan(distance).any() or np.isnan(cost).any() or np.isnan(speed).any():
        raise ArgumentError("a field holds NaN", fix="make unknown cells obstacles, or give them a cost")
    return CostField(distance, cost, float(numbers[0]), (float(numbers[1]), float(numbers[2])), speed)


def sides_of(footprint: Footprint) -> FloatArray:
    """Return (N, 5), the start, direction and length of each side."""
    ways = np.roll(footprint.corners, -1, axis=0) - footprint.corners
    lengths = np.linalg.norm(ways, axis=1, keepdims=True)
    return np.ascontiguousarray(np.concatenate([footprint.corners, ways / lengths, lengths], axis=1))


def outline_of(footprint: Footprint) -> Outline:
    """Return the footprint as kernels use it."""
    corners, sides = footprint.corners, sides_of(footprint)
    middle = (corners.min(axis=0) + corners.max(axis=0)) / 2
    radius = float(np.linalg.norm(corners - middle, axis=1).max())
    return Outline(sides, _cover(footprint, sides), (float(middle[0]), float(middle[1]), radius))


def _inside_m(sides: FloatArray, at: FloatArray) -> FloatArray:
    """Return (...,) distances of points (..., 2) to the nearest side; negative outside."""
    apart = at[..., None, :] - sides[:, :2]
    return np.asarray((sides[:, 2] * apart[..., 1] - sides[:, 3] * apart[..., 0]).min(axis=-1))


def _cover(footprint: Footprint, sides: FloatArray) -> FloatArray:
    """Return discs (K, 3) that cover an outline, and exceed it by less than `OVERHANG_M`.

    A greedy choice: each disc covers the most points that are left.
    """
    low, high = footprint.corners.min(axis=0), footprint.corners.max(axis=0)
    counts = np.maximum(np.ceil((high - low) / _COVER_STEP_M).astype(int) + 1, 2)
    axes = (np.linspace(*ends) for ends in zip(low, high, counts, strict=True))
    inside = np.stack(np.meshgrid(*axes), axis=-1).reshape(-1, 2)
    on_sides = [
        corner + np.linspace(0, length, 2 + int(length / _COVER_STEP_M))[:, None] * way
        for corner, way, length in zip(sides[:, :2], sides[:, 2:4], sides[:, 4], strict=True)
    ]
    # Its own disc covers each point at least.
    points = np.concatenate([inside[_inside_m(sides, inside) >= 0], *on_sides])
    radii = np.maximum(_inside_m(sides, points), 0) + OVERHANG_M
    # Other points of the outline lie up to half a diagonal of the grid away.
    held = cdist(points, points) <= radii[:, None] - _COVER_STEP_M * np.sqrt(0.5)
    chosen = []
    while held.shape[1]:
        chosen.append(int(held.sum(axis=1).argmax()))
        held = held[:, ~held[chosen[-1]]]
    return np.concatenate([points[chosen], radii[chosen, None]], axis=1)
