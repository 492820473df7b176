"""Footprint: the robot's outline. Functions convert it and its cost field to the kernels' values."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.distance import cdist

from wheelsight.core.errors import ArgumentError
from wheelsight.core.geometry import FloatArray
from wheelsight.navigation.clearance_kernels import ANY_SPEED, OVERHANG_M, CostField, Outline

__all__ = ["ANY_SPEED", "CostField", "Outline", "checked", "outline_of", "sides_of"]


# Footprint: the outline of a robot on the floor, about its centre of rotation.


_ROUND_SIDES = 16


@dataclass(frozen=True, eq=False)
class Footprint:
    """A convex outline in the frame `base`, whose origin is the middle of the axle.

    Attributes:
        corners: (N, 2) counter-clockwise, metres.
    """

    corners: FloatArray

    @classmethod
    def of(cls, corners: ArrayLike) -> Footprint:
        """Of the corners (N, 2) of a convex outline, in any order of turn.

        Raises:
            ArgumentError: fewer than three, not finite, not convex, or with the centre of rotation outside.
        """
        points = np.asarray(corners, float)
        if points.ndim != 2 or points.shape[1:] != (2,) or len(points) < 3 or not np.isfinite(points).all():
            raise ArgumentError(f"a footprint of shape {points.shape}", fix="give three corners (N, 2) or more, metres")
        if _area_m2(points) < 0:
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
        """That reaches so far ahead of the axle and behind it. Raises ArgumentError."""
        half = width_m / 2
        return cls.of([(-back_m, -half), (front_m, -half), (front_m, half), (-back_m, half)])

    @classmethod
    def circle(cls, radius_m: float) -> Footprint:
        """The polygon around a circle about the axle. Raises ArgumentError."""
        angles = np.arange(_ROUND_SIDES) * 2 * np.pi / _ROUND_SIDES
        return cls.of(radius_m / np.cos(np.pi / _ROUND_SIDES) * np.stack([np.cos(angles), np.sin(angles)], axis=-1))

    @property
    def inscribed_m(self) -> float:
        """How far from the centre of rotation the nearest side is: nothing may ever be nearer to it."""
        sides = np.roll(self.corners, -1, axis=0) - self.corners
        crosses = self.corners[:, 0] * sides[:, 1] - self.corners[:, 1] * sides[:, 0]
        return float((crosses / np.linalg.norm(sides, axis=1)).min())

    @property
    def circumscribed_m(self) -> float:
        """How far from the centre of rotation the farthest corner is: where nothing is nearer, it may turn in place."""
        return float(np.linalg.norm(self.corners, axis=1).max())

    def padded(self, margin_m: float) -> Footprint:
        """With each side so much farther out. Raises ArgumentError where it becomes none."""
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
        """Corners (..., N, 2) of a base at poses (..., 3) of x, y, yaw."""
        pose = np.asarray(pose, float)
        c, s = np.cos(pose[..., 2]), np.sin(pose[..., 2])
        R = np.stack([np.stack([c, -s], axis=-1), np.stack([s, c], axis=-1)], axis=-2)
        return np.asarray(self.corners @ np.swapaxes(R, -1, -2) + pose[..., None, :2])

    def contains(self, points: ArrayLike) -> np.ndarray:
        """(...,) whether points (..., 2) in `base` lie inside or on the outline."""
        points = np.asarray(points, float)
        sides = np.roll(self.corners, -1, axis=0) - self.corners
        apart = points[..., None, :] - self.corners
        return np.asarray((sides[:, 0] * apart[..., 1] - sides[:, 1] * apart[..., 0] >= -1e-12).all(axis=-1))


def _area_m2(points: FloatArray) -> float:
    after = np.roll(points, -1, axis=0)
    return float((points[:, 0] * after[:, 1] - points[:, 1] * after[:, 0]).sum() / 2)


# CostField: what a controller asks of the surroundings; and outlines as kernels take them.


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
