"""Paths in the plane: a route's waypoints made into legs with rounded corners, and places along them."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import ArrayLike

from wheelsight.errors import ConfigError
from wheelsight.geometry import FloatArray

_SPACING_M = 0.02
_OFF_LEGS_M, _WIDEST_RADIUS_M = 0.1, 1.0
_SHARPEST_ROUNDED_RAD = np.radians(135)
_SEARCH_AHEAD_M = 0.5
_EASED_M = 0.16


@dataclass(frozen=True, eq=False)
class Path2d:
    """Points every 2 cm or so.

    Attributes:
        xy_m: (N, 2).
        along_m: (N,) way from the start, growing.
        yaws_rad: (N,) directions, without jumps of a whole turn.
        bends_per_m: (N,) curvatures, positive to the left, eased over a few points as a driver steers.
    """

    xy_m: FloatArray
    along_m: FloatArray
    yaws_rad: FloatArray
    bends_per_m: FloatArray

    @property
    def length_m(self) -> float:
        """Of the whole path."""
        return float(self.along_m[-1])

    def at(self, along_m: float) -> tuple[float, float, float]:
        """x, y and direction at a way from the start."""
        columns = (*self.xy_m.T, self.yaws_rad)
        x_m, y_m, yaw_rad = (float(np.interp(along_m, self.along_m, column)) for column in columns)
        return x_m, y_m, yaw_rad

    def bend_at(self, along_m: float) -> float:
        """The curvature there; that of the end beyond it."""
        return float(np.interp(along_m, self.along_m, self.bends_per_m))

    def nearest(self, x_m: float, y_m: float, after_m: float) -> float:
        """The way to the place nearest to a point, looked for from `after_m` half a metre on, never back."""
        first = max(int(np.searchsorted(self.along_m, after_m)) - 1, 0)
        last = int(np.searchsorted(self.along_m, after_m + _SEARCH_AHEAD_M)) + 1
        xy, along_m = self.xy_m[first:last], self.along_m[first:last]
        steps, lengths = np.diff(xy, axis=0), np.diff(along_m)
        if not len(steps):
            return after_m
        share = np.einsum("ij,ij->i", (x_m, y_m) - xy[:-1], steps) / np.einsum("ij,ij->i", steps, steps)
        share = share.clip(0, 1)
        feet = xy[:-1] + share[:, None] * steps
        best = int(np.argmin(np.hypot(feet[:, 0] - x_m, feet[:, 1] - y_m)))
        return max(after_m, float(along_m[best] + share[best] * lengths[best]))


def laps_of(route: ArrayLike, is_loop: bool, laps: int, clockwise: bool | None) -> FloatArray:
    """The waypoints (M, 2) of all laps, one after the other; see `drivers.follow_route`. Raises ConfigError."""
    points = np.array(route, float)
    if points.ndim != 2 or points.shape[1:] != (2,) or len(points) < 2 + is_loop or not np.isfinite(points).all():
        raise ConfigError(f"a route needs at least {2 + is_loop} waypoints of x and y, not {points.shape}")
    if laps < 1:
        raise ConfigError(f"laps is {laps}", fix="1 or more")
    if clockwise is not None and not is_loop:
        raise ConfigError("a route that is no loop runs neither clockwise nor the other way")
    if is_loop:
        points = _turned(points, clockwise)
        points = np.concatenate([np.tile(points, (laps, 1)), points[:1]])
    else:
        points = np.concatenate([points, *((points[-2::-1], points[1:])[lap % 2] for lap in range(laps - 1))])
    if (np.hypot(*np.diff(points, axis=0).T) < _SPACING_M).any():
        raise ConfigError("two waypoints in succession are the same", fix="a loop does not repeat its first waypoint")
    return points


def smooth_path(points: FloatArray) -> list[Path2d]:
    """Waypoints (N, 2) as paths with rounded corners, parted where a corner is too sharp to be rounded."""
    yaws = np.arctan2(*np.diff(points, axis=0).T[::-1])
    turns = np.abs((np.diff(yaws) + np.pi) % (2 * np.pi) - np.pi)
    cuts = [0, *(np.flatnonzero(turns > _SHARPEST_ROUNDED_RAD) + 1).tolist(), len(points) - 1]
    return [_rounded(points[first : last + 1]) for first, last in pairwise(cuts)]


def _turned(points: FloatArray, clockwise: bool | None) -> FloatArray:
    """The loop in the direction asked for, from the same first waypoint."""
    x, y = points.T
    is_clockwise = bool(np.sum(x * np.roll(y, -1) - np.roll(x, -1) * y) < 0)
    return points if clockwise in (None, is_clockwise) else np.roll(points[::-1], 1, axis=0)


def _rounded(points: FloatArray) -> Path2d:
    """Legs and arcs, sampled."""
    pieces = [points[:1]]
    for before, corner, after in zip(points, points[1:], points[2:], strict=False):
        pieces.append(_arc(before, corner, after))
    corners = np.concatenate([*pieces, points[-1:]])
    keep = np.concatenate([[True], np.hypot(*np.diff(corners, axis=0).T) > 1e-6])
    corners = corners[keep]
    along = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(corners, axis=0).T))])
    samples = np.linspace(0, along[-1], max(int(np.ceil(along[-1] / _SPACING_M)), 2) + 1)
    xy = np.stack([np.interp(samples, along, column) for column in corners.T], axis=-1)
    directions = np.unwrap(np.arctan2(*np.diff(xy, axis=0).T[::-1]))
    yaws = np.concatenate([directions[:1], (directions[1:] + directions[:-1]) / 2, directions[-1:]])
    bends = np.gradient(yaws, samples)
    width = max(int(_EASED_M / (samples[1] - samples[0])), 1)
    eased = np.convolve(np.pad(bends, width, mode="edge"), np.ones(width) / width, mode="same")[width:-width]
    return Path2d(xy, samples, yaws, eased)


def _arc(before: FloatArray, corner: FloatArray, after: FloatArray) -> FloatArray:
    """Points (N, 2) of the arc that rounds a corner; smaller where a leg is too short for it."""
    into, out = corner - before, after - corner
    reach = np.hypot(*into), np.hypot(*out)
    into, out = into / reach[0], out / reach[1]
    turn = float(np.arctan2(into[0] * out[1] - into[1] * out[0], into @ out))
    if abs(turn) < 1e-6:
        return corner[None]
    # Its middle is (1 - cos(turn / 2)) of the radius off both legs.
    radius = min(_OFF_LEGS_M / (1 - np.cos(turn / 2)), _WIDEST_RADIUS_M)
    tangent = min(radius * abs(np.tan(turn / 2)), 0.5 * min(reach))
    radius = tangent / abs(np.tan(turn / 2))
    inward = np.sign(turn) * np.array([-into[1], into[0]])
    centre = corner - tangent * into + radius * inward
    angles = np.linspace(0, abs(turn), max(int(np.ceil(abs(turn) * radius / _SPACING_M)), 3) + 1)
    sideways, onward = np.cos(angles)[:, None], np.sin(angles)[:, None]
    return np.asarray(centre + radius * (onward * into - sideways * inward))
