"""Views of a map for pages: a plan from above, a point cloud, and the direction that floors face."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from wheelsight.core.geometry import BoolArray, ByteArray, Float32Array, FloatArray, IntArray
from wheelsight.mapping.surfels import Parts, Surfels

_GREY = 128
# Ratio of successive edges tried; a smaller ratio would fit hardly more points.
_STEP = 1.1
# Keys have 64 bits: 20 for each coordinate, and 3 for the side from which a surfel is seen.
_COORDINATE_BITS = 20


@dataclass(frozen=True, slots=True, eq=False)
class MapCloud:
    """Points of a map, each the mean of the surfels in a cube that are seen from the same side.

    Attributes:
        position: (n, 3) float32 in metres, in the map frame.
        normal: (n, 3) float32 of length 1, towards the viewpoint.
        color: (n, 3) uint8 red, green, blue.
        edge_m: edge of the cubes; 0 if each point is a surfel.
        of: number of surfels.
    """

    position: Float32Array
    normal: Float32Array
    color: ByteArray
    edge_m: float
    of: int

    def __len__(self) -> int:
        return len(self.position)


def cloud_of(parts: Parts, most: int) -> MapCloud | None:
    """Return at most `most` points of a map, evenly over its surfaces; None without surfels.

    Surfels on both sides of a thin wall are separated by the axis nearest to their normals.
    """
    count, low, high = 0, np.full(3, np.inf), np.full(3, -np.inf)
    for surfels in parts():
        count += len(surfels.grey)
        low = np.minimum(low, surfels.position.min(axis=0, initial=np.inf))
        high = np.maximum(high, surfels.position.max(axis=0, initial=-np.inf))
    if not (count and most > 0):
        return None
    if count <= most:
        pieces = [(surfels.position, surfels.normal, colors_of(surfels)) for surfels in parts()]
        position, normal, color = (np.concatenate(column) for column in zip(*pieces, strict=True))
        return MapCloud(position, normal, color, 0.0, count)
    edge_m, cubes = _cubes(parts, (low, max(float((high - low).max()), 1e-6)), most)
    sums, counts = np.zeros((len(cubes), 9)), np.zeros(len(cubes))
    for surfels in parts():
        cube = np.searchsorted(cubes, _keys(surfels, low, edge_m))
        np.add.at(sums, cube, np.hstack([surfels.position, surfels.normal, colors_of(surfels)]).astype(float))
        np.add.at(counts, cube, 1)
    at, facing, mean_color = np.split(sums / counts[:, None], 3, axis=1)
    facing /= np.maximum(np.linalg.norm(facing, axis=1, keepdims=True), 1e-9)
    colors = np.rint(mean_color).astype(np.uint8)
    return MapCloud(at.astype(np.float32), facing.astype(np.float32), colors, edge_m, count)


def _cubes(parts: Parts, within: tuple[FloatArray, float], most: int) -> tuple[float, IntArray]:
    """Return the shortest edge, within a step, with at most `most` filled cubes, and their keys in order.

    `within` is the lowest corner (3,) and the extent in metres.
    """
    low, extent_m = within
    steps = int(np.log(2 ** (_COORDINATE_BITS + 1)) / np.log(_STEP)) + 1
    edges_m = extent_m / 2**_COORDINATE_BITS * _STEP ** np.arange(steps)
    first, last = 0, len(edges_m) - 1  # an edge with too many cubes, and the shortest known one without
    filled = _filled(parts, low, float(edges_m[last]), most)
    while last - first > 1:
        middle = (first + last) // 2
        found = _filled(parts, low, float(edges_m[middle]), most)
        if found is None:
            first = middle
        else:
            last, filled = middle, found
    assert filled is not None
    return float(edges_m[last]), filled


def _filled(parts: Parts, low: FloatArray, edge_m: float, most: int) -> IntArray | None:
    """Return the keys of all filled cubes in order; None if there are more than `most`."""
    found = np.zeros(0, np.int64)
    for surfels in parts():
        more = np.unique(_keys(surfels, low, edge_m))
        # A stable sort merges two sorted arrays in one pass.
        both = np.sort(np.concatenate([found, more]), kind="stable")
        found = both[np.diff(both, prepend=-1) > 0]
        if len(found) > most:
            return None
    return found


def _keys(surfels: Surfels, low: FloatArray, edge_m: float) -> IntArray:
    """Return a key (n,) of each surfel's cube and side; keys of neighbours along z are consecutive."""
    cells = np.floor((surfels.position - low) / edge_m).astype(np.int64)
    x, y, z = cells.clip(0, 2**_COORDINATE_BITS - 1).T
    axis = np.abs(surfels.normal).argmax(axis=1)
    side = np.asarray(2 * axis + (surfels.normal[np.arange(len(axis)), axis] < 0), np.int64)
    return np.asarray(((x << _COORDINATE_BITS | y) << _COORDINATE_BITS | z) * 8 + side)


_LONGER_SIDE_PX = 1100
_FINEST_M = 0.004
_AIR_M = 0.25
# Share of outliers on each side, so that they do not enlarge the plan.
_STRAY_SHARE = 0.0005
_CEILING = -0.3
_LARGEST_PX = 4
# Vertical surfaces are drawn darker, so that walls become lines.
_SHADE = 0.55


@dataclass(frozen=True, slots=True, eq=False)
class MapPlan:
    """A map seen from above.

    Attributes:
        image: (h, w, 3) uint8 red, green, blue; white if unknown.
        is_known: (h, w).
        m_per_px: size of a pixel.
        R_plan_map: (3, 3): x to the right of the page, y up the page, z towards the reader.
        corner_m: (2,) x and y in the plan of the first pixel's centre.
    """

    image: ByteArray
    is_known: BoolArray
    m_per_px: float
    R_plan_map: FloatArray
    corner_m: FloatArray

    def project(self, p_map: FloatArray) -> FloatArray:
        """Return pixels (n, 2), u to the right and v down, of points (n, 3) in the map."""
        p_plan = p_map @ self.R_plan_map.T
        return np.stack([p_plan[:, 0] - self.corner_m[0], self.corner_m[1] - p_plan[:, 1]], axis=-1) / self.m_per_px


def plan_of(parts: Parts, up: FloatArray, below_m: float, shown: FloatArray, right: FloatArray) -> MapPlan | None:
    """Return the plan of a map; None without surfels.

    Args:
        parts: surfels of the map.
        up: (3,) unit vector in the map.
        below_m: height along `up` above which nothing is drawn. Ceilings, which face down, are never drawn.
        shown: (n, 3) further points in the map within the plan: a path.
        right: (3,) direction to the right of the page, as far as it is level.
    """
    level = right - (right @ up) * up
    if np.linalg.norm(level) < 1e-3 * np.linalg.norm(right):
        level = np.cross(up, np.eye(3)[np.argmin(np.abs(up))])
    level /= np.linalg.norm(level)
    R_plan_map = np.stack([level, np.cross(up, level), up])
    extents = [_extent(parts, (up, below_m), axis, shown @ axis) for axis in R_plan_map[:2]]
    if None in extents:
        return None
    low, high = np.array(extents).T
    m_per_px = max(float((high - low).max()) / _LONGER_SIDE_PX, _FINEST_M)
    width, height = (int(n) for n in np.ceil((high - low) / m_per_px).astype(int) + 1)
    blank = np.full((height, width, 3), 255, np.uint8), np.zeros((height, width), bool)
    plan = MapPlan(*blank, m_per_px, R_plan_map, np.array([low[0], high[1]]))
    top_m = np.full(height * width, -np.inf)
    for surfels in parts():
        _draw(surfels, _is_drawn(surfels, up, below_m), plan, top_m)
    return plan


def _is_drawn(surfels: Surfels, up: FloatArray, below_m: float) -> BoolArray:
    return (surfels.normal.astype(float) @ up > _CEILING) & (surfels.position.astype(float) @ up < below_m)


def _draw(surfels: Surfels, kept: BoolArray, plan: MapPlan, top_m: FloatArray) -> None:
    """Draw kept surfels over the plan where they are higher than `top_m` (h · w,), and update it."""
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


def _extent(
    parts: Parts, drawn: tuple[FloatArray, float], axis: FloatArray, shown_m: FloatArray
) -> tuple[float, float] | None:
    """Return the range of the plan along an axis (3,); None if nothing is drawn."""
    along = [(s.position[_is_drawn(s, *drawn)].astype(float) @ axis).astype(np.float32) for s in parts()]
    all_m = np.concatenate([np.zeros(0, np.float32), *along])
    if not len(all_m):
        return None
    low, high = np.quantile(all_m, [_STRAY_SHARE, 1 - _STRAY_SHARE], overwrite_input=True).astype(float)
    return min([low, *shown_m]) - _AIR_M, max([high, *shown_m]) + _AIR_M


def _highest(
    px: IntArray, reach_px: IntArray, height_m: FloatArray, shape: tuple[int, ...]
) -> tuple[IntArray, IntArray]:
    """Return covered pixels (k,) of all h · w, and the highest surfel at each; a surfel is a disk of `reach_px`."""
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


# Hand-held cameras look down by less than the widest. The narrower cones exclude walls and slopes.
_CONES_DEG = (40.0, 20.0, 10.0)
_LEAST_SURFELS = 100


def upward(parts: Parts, R_map_camera: FloatArray) -> FloatArray:
    """Return the unit vector (3,) that floors and tables face: the mean normal of surfels near the camera's up, by
    area.

    Args:
        parts: surfels of the map.
        R_map_camera: (3, 3) of a camera held upright within 40°. Its own up is returned if no surfels face up.
    """
    up = -np.asarray(R_map_camera, float)[:, 1]
    for cone_deg in _CONES_DEG:
        total, count = np.zeros(3), 0
        for surfels in parts():
            facing = surfels.normal @ up > np.cos(np.radians(cone_deg))
            total += (surfels.normal[facing] * surfels.radius_m[facing, None].astype(float) ** 2).sum(axis=0)
            count += int(np.count_nonzero(facing))
        if count < _LEAST_SURFELS:
            break
        up = total / np.linalg.norm(total)
    return up


def colors_of(surfels: Surfels) -> ByteArray:
    """Return red, green, blue (n, 3) of surfels; grey if the colour is unknown; mid-grey if both are."""
    grey = np.where(surfels.grey < 0, _GREY, surfels.grey)[:, None]
    color = np.where(surfels.color[:, :1] < 0, grey, surfels.color)
    return np.asarray(np.clip(np.rint(color), 0, 255), np.uint8)
