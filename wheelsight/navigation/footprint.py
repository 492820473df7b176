"""Footprint: the outline of a robot on the floor, about its centre of rotation."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from wheelsight.errors import ArgumentError
from wheelsight.geometry import FloatArray

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
