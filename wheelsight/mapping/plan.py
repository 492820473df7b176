"""A map as a plan: seen from straight above and to scale, with the ceiling cut away."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from wheelsight.geometry import BoolArray, ByteArray, FloatArray, IntArray
from wheelsight.mapping.export import colors_of
from wheelsight.mapping.values import Parts, Surfels

_LONGER_SIDE_PX = 1100
_FINEST_M = 0.004
_AIR_M = 0.25
# Of the surfels, on each side: strays must not make a plan of a room as large as a town's.
_STRAY_SHARE = 0.0005
_CEILING = -0.3
_LARGEST_PX = 4
# What stands upright is drawn darker by so much, which makes walls lines.
_SHADE = 0.55


@dataclass(frozen=True, slots=True, eq=False)
class Plan:
    """A map seen from above.

    Attributes:
        image: (h, w, 3) uint8 red, green, blue; white where nothing is known.
        is_known: (h, w).
        m_per_px: how wide a pixel is.
        R_plan_map: (3, 3): x to the right of the page, y up the page, z towards the reader.
        corner_m: (2,) x and y in the plan of the middle of the image's first pixel.
    """

    image: ByteArray
    is_known: BoolArray
    m_per_px: float
    R_plan_map: FloatArray
    corner_m: FloatArray

    def project(self, p_map: FloatArray) -> FloatArray:
        """Pixels (n, 2), u to the right and v down, of points (n, 3) in the map."""
        p_plan = p_map @ self.R_plan_map.T
        return np.stack([p_plan[:, 0] - self.corner_m[0], self.corner_m[1] - p_plan[:, 1]], axis=-1) / self.m_per_px


def plan_of(parts: Parts, up: FloatArray, below_m: float, shown: FloatArray, right: FloatArray) -> Plan | None:
    """The plan of a map; None without surfels.

    Args:
        parts: of the map.
        up: (3,) of length 1, in the map.
        below_m: height along `up` above which nothing is drawn. Ceilings, which face down, never are.
        shown: (n, 3) points in the map that the plan must hold too: a path.
        right: (3,) what points to the right on the page, as far as it is level.
    """
    R_plan_map = _levelled(up, right)
    extents = [_extent(parts, (up, below_m), axis, shown @ axis) for axis in R_plan_map[:2]]
    if None in extents:
        return None
    low, high = np.array(extents).T
    m_per_px = max(float((high - low).max()) / _LONGER_SIDE_PX, _FINEST_M)
    width, height = (int(n) for n in np.ceil((high - low) / m_per_px).astype(int) + 1)
    plan = Plan(*_blank(height, width), m_per_px, R_plan_map, np.array([low[0], high[1]]))
    top_m = np.full(height * width, -np.inf)
    for surfels in parts():
        _draw(surfels, _is_drawn(surfels, up, below_m), plan, top_m)
    return plan


def _is_drawn(surfels: Surfels, up: FloatArray, below_m: float) -> BoolArray:
    return (surfels.normal.astype(float) @ up > _CEILING) & (surfels.position.astype(float) @ up < below_m)


def _draw(surfels: Surfels, kept: BoolArray, plan: Plan, top_m: FloatArray) -> None:
    """Lay those that are kept over what has been drawn, whose heights (h · w,) are `top_m`."""
    position, up = surfels.position[kept].astype(float), plan.R_plan_map[2]
    px = np.rint(plan.project(position)).astype(np.int64)
    reach_px = np.clip(np.rint(surfels.radius_m[kept] / plan.m_per_px), 1, _LARGEST_PX).astype(np.int64)
    height_m = (position @ plan.R_plan_map.T)[:, 2]
    at, highest = _highest(px, reach_px, height_m, plan.is_known.shape)
    is_over = height_m[highest] >= top_m[at]
    at, highest = at[is_over], highest[is_over]
    facing = np.clip(surfels.normal[kept][highest].astype(float) @ up, 0, 1)[:, None]
    shade = colors_of(surfels)[kept][highest] * (1 - _SHADE + _SHADE * facing)
    top_m[at], plan.is_known.reshape(-1)[at] = height_m[highest], True
    plan.image.reshape(-1, 3)[at] = np.rint(shade)


def _blank(height: int, width: int) -> tuple[ByteArray, BoolArray]:
    return np.full((height, width, 3), 255, np.uint8), np.zeros((height, width), bool)


def _levelled(up: FloatArray, right: FloatArray) -> FloatArray:
    """R_plan_map (3, 3)."""
    level = right - (right @ up) * up
    if np.linalg.norm(level) < 1e-3 * np.linalg.norm(right):
        level = np.cross(up, np.eye(3)[np.argmin(np.abs(up))])
    level /= np.linalg.norm(level)
    return np.stack([level, np.cross(up, level), up])


def _extent(
    parts: Parts, drawn: tuple[FloatArray, float], axis: FloatArray, shown_m: FloatArray
) -> tuple[float, float] | None:
    """From where to where the plan reaches along an axis (3,); None where nothing is drawn."""
    along = [(s.position[_is_drawn(s, *drawn)].astype(float) @ axis).astype(np.float32) for s in parts()]
    all_m = np.concatenate([np.zeros(0, np.float32), *along])
    if not len(all_m):
        return None
    low, high = np.quantile(all_m, [_STRAY_SHARE, 1 - _STRAY_SHARE], overwrite_input=True).astype(float)
    return min([low, *shown_m]) - _AIR_M, max([high, *shown_m]) + _AIR_M


def _highest(
    px: IntArray, reach_px: IntArray, height_m: FloatArray, shape: tuple[int, ...]
) -> tuple[IntArray, IntArray]:
    """Pixels (k,) of all h · w that surfels cover, and which one is the highest there; each is a disk of `reach_px`."""
    order = np.argsort(height_m, kind="stable")
    rank = np.empty(len(order), np.int32)
    rank[order] = np.arange(len(order))
    top = np.full(shape[0] * shape[1], -1, np.int32)
    for dv, du in np.ndindex(2 * _LARGEST_PX - 1, 2 * _LARGEST_PX - 1):
        v, u = px[:, 1] + dv - _LARGEST_PX + 1, px[:, 0] + du - _LARGEST_PX + 1
        near = (dv - _LARGEST_PX + 1) ** 2 + (du - _LARGEST_PX + 1) ** 2 < reach_px**2
        near &= (v >= 0) & (v < shape[0]) & (u >= 0) & (u < shape[1])
        np.maximum.at(top, v[near] * shape[1] + u[near], rank[near])
    at = np.flatnonzero(top >= 0)
    return at, order[top[at]]
