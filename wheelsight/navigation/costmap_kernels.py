"""Compiled costmap and depth images: costs of cells, the live layer, unknown cells in sight, and views of the floor."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from wheelsight.core.compiled import kernel
from wheelsight.core.geometry.arrays import BoolArray, FloatArray, IntArray
from wheelsight.navigation.clearance_kernels import outside_m

# Costs of cells, and obstacles from the cells of another grid.


_PARTS = 4


class CellFrame(NamedTuple):
    """Cells of a grid: side in metres, and x and y of the corner of cell (0, 0)."""

    resolution_m: float
    x: float
    y: float


class Falls(NamedTuple):
    """Decrease of cost with the distance to obstacles; see `CostmapSettings`.

    Attributes:
        near_m: distance from the centre of an obstacle's cell where the decrease begins.
        inflation_m, decay_per_m, unknown_cost: of the settings.
    """

    near_m: float
    inflation_m: float
    decay_per_m: float
    unknown_cost: float


@kernel
def mark_occupied(is_occupied: Any, of: CellFrame, T: Any, to: CellFrame, occupied: int, state: Any) -> None:
    """Mark all cells of a grid that contain the centre of any sixteenth of another grid's occupied cell.

    Args:
        is_occupied: (h, w) of the other grid, with cells `of`.
        T: x, y, cosine and sine of its frame in this one.
        to, state: (H, W) this grid.
        occupied: value to write.
    """
    x, y, c, s = T
    for i in range(is_occupied.shape[0]):
        for j in range(is_occupied.shape[1]):
            if not is_occupied[i, j]:
                continue
            for k in range(_PARTS * _PARTS):
                a = of.x + of.resolution_m * (j + (k % _PARTS + 0.5) / _PARTS)
                b = of.y + of.resolution_m * (i + (k // _PARTS + 0.5) / _PARTS)
                column = int(np.floor((x + c * a - s * b - to.x) / to.resolution_m))
                row = int(np.floor((y + s * a + c * b - to.y) / to.resolution_m))
                if 0 <= row < state.shape[0] and 0 <= column < state.shape[1]:
                    state[row, column] = occupied


@kernel
def costs(state: Any, is_lethal: Any, distance_m: Any, falls: Falls, unknown: int) -> Any:
    """Return (H, W) float32 from 0 to 1: 1 on obstacles, exp(-decay · distance) around them; or unknown cost."""
    rows, columns = state.shape
    found = np.zeros((rows, columns), np.float32)
    for i in range(rows):
        for j in range(columns):
            cost = 0.0
            beyond_m = max(distance_m[i, j] - falls.near_m, 0.0)
            if is_lethal[i, j]:
                cost = 1.0
            elif beyond_m <= falls.inflation_m:
                cost = np.exp(-falls.decay_per_m * beyond_m)
            if state[i, j] == unknown:
                cost = max(cost, falls.unknown_cost)
            found[i, j] = cost
    return found


# Obstacles of a depth image around the robot, in cells and layers of height.
#
# Channel 0 of a cell is a missing floor, the others are layers of height. One matrix (3, 4) maps points of the camera
# to column and row in cells, and height over the floor in metres.


PASSED, MET = 1, 2


class DepthPixels(NamedTuple):
    """A depth image (h, w), 0 without a depth, and slopes x / z and y / z of its rays (h, w, 2).

    Attributes:
        depth_m, slopes: of the image.
        M: (3, 4) as above.
    """

    depth_m: Any
    slopes: Any
    M: Any


class LayerHeights(NamedTuple):
    """Limits between floor and obstacles; see `LiveLayerSettings`."""

    resolution_m: float
    floor_m: float
    drop_m: float
    tilt_rad: float
    layer_m: float
    height_m: float
    far_m: float
    measured: float
    pixels: int


class RayNoise(NamedTuple):
    """Standard deviation of a depth z, constant_m + quadratic_per_m · z², and how many of them end a ray early."""

    constant_m: float
    quadratic_per_m: float
    margin_sigmas: float


class ClearingRules(NamedTuple):
    """Conditions to remove an obstacle; see `LiveLayerSettings`."""

    passes: int
    forget_s: float
    stays: float


@kernel(error_model="numpy")
def _end(view: DepthPixels, v: int, u: int, z: float) -> Any:
    """Return column, row and height of a pixel's point at a depth."""
    M, a, b = view.M, view.slopes[v, u, 0], view.slopes[v, u, 1]
    x = M[0, 3] + z * (M[0, 0] * a + M[0, 1] * b + M[0, 2])
    y = M[1, 3] + z * (M[1, 0] * a + M[1, 1] * b + M[1, 2])
    return x, y, M[2, 3] + z * (M[2, 0] * a + M[2, 1] * b + M[2, 2])


@kernel(error_model="numpy")
def mark_met(view: DepthPixels, heights: LayerHeights, is_own: Any, seen: Any) -> None:
    """Mark what each pixel shows in `seen` (rows, columns, channels), except on the robot itself (rows, columns)."""
    M, (height, width) = view.M, view.depth_m.shape
    for v in range(height):
        for u in range(width):
            z = view.depth_m[v, u]
            if not (z > 0 and z < np.inf):
                continue
            x, y, h = _end(view, v, u, z)
            way_m = heights.resolution_m * np.sqrt((x - M[0, 3]) ** 2 + (y - M[1, 3]) ** 2)
            tilt_m = heights.tilt_rad * way_m
            channel, what = 0, MET
            if h < -heights.drop_m - tilt_m and M[2, 3] > 0:
                share = M[2, 3] / (M[2, 3] - h)
                x, y, way_m = M[0, 3] + share * (x - M[0, 3]), M[1, 3] + share * (y - M[1, 3]), way_m * share
            elif abs(h) <= heights.floor_m + tilt_m:
                what = PASSED
            elif 0 < h < heights.height_m:
                channel = _channel(h, heights, seen.shape[2])
            else:
                continue
            row, column = int(np.floor(y)), int(np.floor(x))
            if way_m > heights.far_m or not (0 <= row < seen.shape[0] and 0 <= column < seen.shape[1]):
                continue
            if not is_own[row, column]:
                seen[row, column, channel] = max(seen[row, column, channel], what)


@kernel(error_model="numpy")
def _channel(h_m: float, heights: LayerHeights, channels: int) -> int:
    return min(1 + int(max(h_m - heights.floor_m, 0.0) / heights.layer_m), channels - 1)


@kernel(error_model="numpy")
def mark_passed(view: DepthPixels, heights: LayerHeights, noise: RayNoise, seen: Any) -> None:
    """Mark the layers of cells that blocks of pixels see through, up to the nearest depth of each block."""
    (height, width), size = view.depth_m.shape, heights.pixels
    for v in range(0, height, size):
        for u in range(0, width, size):
            nearest, measured, count = np.inf, 0, 0
            for i in range(v, min(v + size, height)):
                for j in range(u, min(u + size, width)):
                    z = float(view.depth_m[i, j])
                    count += 1
                    if z > 0 and z < np.inf:
                        measured += 1
                        nearest = min(nearest, z)
            if measured == 0 or measured < heights.measured * count:
                continue
            i, j = min(v + size // 2, height - 1), min(u + size // 2, width - 1)
            margin_m = noise.margin_sigmas * (noise.constant_m + noise.quadratic_per_m * nearest * nearest)
            _pass(view, (i, j, nearest), margin_m + heights.resolution_m, heights, seen)


@kernel(error_model="numpy")
def _pass(view: DepthPixels, ray: Any, margin_m: float, heights: LayerHeights, seen: Any) -> None:
    """Mark what a ray (row and column of its pixel, depth) passes, up to a margin before its end."""
    M, channels = view.M, seen.shape[2]
    x, y, h = _end(view, ray[0], ray[1], ray[2])
    dx, dy, dh = x - M[0, 3], y - M[1, 3], h - M[2, 3]
    way_m = heights.resolution_m * np.hypot(dx, dy)
    if way_m <= margin_m:
        return
    until = min(1.0 - margin_m / way_m, heights.far_m / way_m)
    steps = int(np.ceil(2.0 * np.hypot(dx, dy)))
    for k in range(int(until * steps) + 1):
        share = (k + 0.5) / steps
        height = M[2, 3] + share * dh
        if share > until or height < heights.floor_m:
            return
        row, column = int(np.floor(M[1, 3] + share * dy)), int(np.floor(M[0, 3] + share * dx))
        if height >= heights.height_m or not (0 <= row < seen.shape[0] and 0 <= column < seen.shape[1]):
            continue
        channel = _channel(height, heights, channels)
        seen[row, column, channel] = max(seen[row, column, channel], PASSED)


@kernel
def remember(seen: Any, is_own: Any, left: Any, met_s: Any, stamp_s: float, rules: ClearingRules) -> None:
    """Update `left` (rows, columns, channels), the number of views through a layer until it is free; clear `seen`.

    `met_s` (rows, columns, 2) holds the first and last time of an obstacle in a cell.
    """
    rows, columns, channels = left.shape
    for i in range(rows):
        for j in range(columns):
            is_met, is_left = False, False
            for channel in range(channels):
                if is_own[i, j]:
                    left[i, j, channel] = 0
                elif seen[i, j, channel] == MET:
                    left[i, j, channel], is_met = rules.passes, True
                elif seen[i, j, channel] == PASSED and left[i, j, channel] > 0:
                    left[i, j, channel] -= 1
                is_left = is_left or left[i, j, channel] > 0
                seen[i, j, channel] = 0
            if is_met:
                met_s[i, j, 1] = stamp_s
                met_s[i, j, 0] = min(met_s[i, j, 0], stamp_s)
            if is_left and stamp_s - met_s[i, j, 1] > rules.forget_s + rules.stays * (met_s[i, j, 1] - met_s[i, j, 0]):
                left[i, j, :] = 0
                is_left = False
            if not is_left:
                met_s[i, j, 0] = np.inf


@kernel
def any_left(left: Any) -> Any:
    """Return (rows, columns) where any channel of `left` is over 0: ten times as fast as numpy."""
    rows, columns, channels = left.shape
    found = np.zeros((rows, columns), np.bool_)
    for i in range(rows):
        for j in range(columns):
            for channel in range(channels):
                if left[i, j, channel] > 0:
                    found[i, j] = True
                    break
    return found


# Unknown cells in sight of a place.


@kernel
def mark_in_sight(state: Any, place: Any, reach: float, states: Any, found: Any) -> None:
    """Mark unknown cells with a centre within reach of a place, and nothing occupied on the line between.

    Args:
        state: (H, W) of cells.
        place: (2,) column and row, in cells from the grid's corner.
        reach: in cells.
        states: the values of unknown and occupied cells.
        found: (H, W) bool, marked.
    """
    unknown, occupied = states
    height, width = state.shape
    for row in range(max(int(place[1] - reach), 0), min(int(place[1] + reach) + 2, height)):
        for column in range(max(int(place[0] - reach), 0), min(int(place[0] + reach) + 2, width)):
            x, y = column + 0.5 - place[0], row + 0.5 - place[1]
            if state[row, column] == unknown and np.sqrt(x * x + y * y) <= reach:
                found[row, column] = _is_open(state, place, (x, y), reach, occupied)


@kernel
def _is_open(state: Any, place: Any, way: Any, reach: float, occupied: int) -> bool:
    """Return whether a line (x, y) in cells from a place meets nothing occupied."""
    steps = 1 + int(2 * reach)
    for k in range(steps + 1):
        share = k / steps
        row, column = int(np.floor(place[1] + share * way[1])), int(np.floor(place[0] + share * way[0]))
        if 0 <= row < state.shape[0] and 0 <= column < state.shape[1] and state[row, column] == occupied:
            return False
    return True


# Floor and obstacles in a depth image, by bearing and by cell of the base.


_NEITHER, _FLOOR, _THING = 0, 1, 2


class Rays(NamedTuple):
    """Ray of each pixel (h, w): the point at depth 1 relative to the camera along the base's axes, and its bearing.

    Attributes:
        ways: (h, w, 3) float32.
        columns: (h, w) int16 number of the bearing, -1 outside of the view that all rows share.
        camera: (3,) place of the camera in the base.
        floor_m: (h, w) float32 distance from the camera, along the floor, at which the ray meets floor that the camera
            should measure; 0 for none.
    """

    ways: Any
    columns: Any
    camera: Any
    floor_m: Any


class ViewHeights(NamedTuple):
    """Limits between floor and obstacles, metres; as in `LiveLayerSettings`."""

    floor_m: float
    drop_m: float
    tilt_rad: float
    height_m: float
    far_m: float


class ViewContent(NamedTuple):
    """Content of a depth image.

    Attributes:
        floor: (columns, bins) uint8, whether a bearing shows floor at a distance from the camera.
        cells: (n, n, 3) of obstacles: pixels, sums of x and y in the base.
        tops: (n, n, k) the k largest heights of a cell's pixels over the floor, the largest first.
        measured: (columns,) pixels with a depth.
        lacks: (columns, bins, 2) pixels that should show floor at a distance: without a depth, and with any.
        lacks_m: (columns, bins) least distance of those without a depth; infinite for none.
        bin_m, cell_m: side of a bin and of a cell.
    """

    floor: Any
    cells: Any
    tops: Any
    measured: Any
    lacks: Any
    lacks_m: Any
    bin_m: float
    cell_m: float


@kernel(error_model="numpy")
def sort_pixels(depth_m: Any, rays: Rays, heights: ViewHeights, shown: ViewContent) -> None:
    """Sort the pixels of a depth image (h, w) in metres; pixels that are not finite and over 0 have no depth."""
    rows, columns = depth_m.shape
    bins, lowest = shown.floor.shape[1], shown.tops.shape[2] - 1
    for v in range(rows):
        for u in range(columns):
            z, column = depth_m[v, u], rays.columns[v, u]
            if column < 0:
                continue
            has_depth, floor_m = z > 0 and z < np.inf, rays.floor_m[v, u]
            at = int(floor_m / shown.bin_m)
            if floor_m > 0 and at < bins:
                shown.lacks[column, at, 1 if has_depth else 0] += 1
                if not has_depth:
                    shown.lacks_m[column, at] = min(shown.lacks_m[column, at], floor_m)
            if not has_depth:
                continue
            shown.measured[column] += 1
            x, y, dz = z * rays.ways[v, u, 0], z * rays.ways[v, u, 1], z * rays.ways[v, u, 2]
            what, dx, dy, way_m = _met(x, y, dz, rays.camera[2], heights)
            if what == _FLOOR:
                at = int(way_m / shown.bin_m)
                if at < bins:
                    shown.floor[column, at] = 1
            elif what == _THING:
                row, place = _cell(shown, rays.camera[0] + dx, rays.camera[1] + dy)
                if row >= 0:
                    shown.cells[row, place, 0] += 1
                    shown.cells[row, place, 1] += rays.camera[0] + dx
                    shown.cells[row, place, 2] += rays.camera[1] + dy
                    height_m = rays.camera[2] + dz
                    if height_m > shown.tops[row, place, lowest]:
                        _keep_highest(shown.tops[row, place], height_m)


@kernel(error_model="numpy")
def _keep_highest(tops: Any, height_m: float) -> None:
    """Insert a height into a cell's largest ones (k,)."""
    for k in range(len(tops)):
        if height_m > tops[k]:
            height_m, tops[k] = tops[k], height_m


@kernel(error_model="numpy")
def reach(depth_m: Any, rays: Rays, heights: ViewHeights, shown: ViewContent, is_thing: Any, nearest_m: Any) -> None:
    """Write the distance of the nearest obstacle of each bearing into (columns,), for cells (n, n) with an obstacle.

    It works by pixels, as a cell close by spans several bearings.
    """
    rows, columns = depth_m.shape
    for v in range(rows):
        for u in range(columns):
            z, column = depth_m[v, u], rays.columns[v, u]
            if column < 0 or not (z > 0 and z < np.inf):
                continue
            x, y, dz = z * rays.ways[v, u, 0], z * rays.ways[v, u, 1], z * rays.ways[v, u, 2]
            what, dx, dy, way_m = _met(x, y, dz, rays.camera[2], heights)
            if what == _THING and way_m < nearest_m[column]:
                row, place = _cell(shown, rays.camera[0] + dx, rays.camera[1] + dy)
                if row >= 0 and is_thing[row, place]:
                    nearest_m[column] = way_m


@kernel(error_model="numpy")
def _met(dx: float, dy: float, dz: float, camera_m: float, heights: ViewHeights) -> Any:
    """Classify the point of a pixel, relative to a camera over the floor.

    Returns what it shows, and where: along x, along y, and its distance.
    """
    h, way_m = camera_m + dz, np.sqrt(dx * dx + dy * dy)
    tilt_m = heights.tilt_rad * way_m
    what = _NEITHER
    if h < -heights.drop_m - tilt_m and camera_m > 0:
        share = camera_m / (camera_m - h)
        what, dx, dy, way_m = _THING, share * dx, share * dy, share * way_m
    elif abs(h) <= heights.floor_m + tilt_m:
        return _FLOOR, dx, dy, way_m
    elif 0 < h < heights.height_m:
        what = _THING
    return (what if way_m <= heights.far_m else _NEITHER), dx, dy, way_m


@kernel(error_model="numpy")
def _cell(shown: ViewContent, x: float, y: float) -> Any:
    """Return row and column of the cell at a point of the base; -1 outside."""
    side = shown.cells.shape[0]
    row, column = int(np.floor(y / shown.cell_m)) + side // 2, int(np.floor(x / shown.cell_m)) + side // 2
    return (row, column) if 0 <= row < side and 0 <= column < side else (-1, -1)


# Floor that a camera observes along a plan, and floor that the robot drives over.


class Eye(NamedTuple):
    """A camera that looks ahead.

    Attributes:
        x, y: its place in the base.
        half_rad: half of its field of view.
        near_m, far_m: distances from it of the nearest floor that it observes, and of the farthest that counts.
    """

    x: float
    y: float
    half_rad: float
    near_m: float
    far_m: float


class Walls(NamedTuple):
    """Cells that block the view.

    Attributes:
        is_there: (H, W) row 0 has the least y.
        resolution: metres per cell.
        origin: x and y of the corner of cell (0, 0).
    """

    is_there: BoolArray
    resolution: float
    origin: tuple[float, float]


@kernel
def first_over(poses: FloatArray, points: FloatArray, sides: FloatArray, out: IntArray) -> None:
    """Write the index of the first pose (N, 3) whose outline covers each point (M, 2), or N, into (M,)."""
    reach2 = (sides[:, 0] ** 2 + sides[:, 1] ** 2).max()
    out[:] = len(poses)
    for n in range(len(poses)):
        c, s = np.cos(poses[n, 2]), np.sin(poses[n, 2])
        for m in range(len(points)):
            if out[m] < n:
                continue
            dx, dy = points[m, 0] - poses[n, 0], points[m, 1] - poses[n, 1]
            if dx * dx + dy * dy > reach2:
                continue
            if outside_m(sides, c * dx + s * dy, -s * dx + c * dy) <= 0.0:
                out[m] = n


@kernel
def first_blind(
    poses: FloatArray, points: FloatArray, slack_m: FloatArray, over: IntArray, eye: Eye, walls: Walls, lag: int
) -> Any:
    """Return the index of the first pose over a point that no pose at least `lag` before it observes; N without any.

    A point counts as observed if the camera sees a place within its slack. `over` comes from `first_over`.
    """
    first = len(poses)
    for m in range(len(points)):
        if over[m] >= first:
            continue
        is_seen = False
        for n in range(over[m] - lag, -1, -1):
            if _looks_at(poses[n], points[m], slack_m[m], eye, walls):
                is_seen = True
                break
        if not is_seen:
            first = over[m]
    return first


@kernel
def _looks_at(pose: FloatArray, point: FloatArray, slack_m: float, eye: Eye, walls: Walls) -> Any:
    c, s = np.cos(pose[2]), np.sin(pose[2])
    x, y = pose[0] + c * eye.x - s * eye.y, pose[1] + s * eye.x + c * eye.y
    dx, dy = point[0] - x, point[1] - y
    away = np.sqrt(dx * dx + dy * dy)
    if away < eye.near_m - slack_m or away > eye.far_m:
        return False
    beyond = abs(np.arctan2(-s * dx + c * dy, c * dx + s * dy)) - eye.half_rad
    if beyond > 0.0 and (beyond > np.pi / 2 or away * np.sin(beyond) > slack_m):
        return False
    steps = int(away / walls.resolution)
    for k in range(1, steps):
        column = int(np.floor((x + dx * k / steps - walls.origin[0]) / walls.resolution))
        row = int(np.floor((y + dy * k / steps - walls.origin[1]) / walls.resolution))
        if 0 <= row < len(walls.is_there) and 0 <= column < walls.is_there.shape[1] and walls.is_there[row, column]:
            return False
    return True


# PlanCells under a footprint, and its distance to occupied cells.
#
# A cell is a square, and lies under a footprint if they share more than an edge. In each row a convex outline covers
# one stretch of cells, whose occupied ones are counted by sums along the row.

# In cells: a square that only touches is not under the footprint.
_TOUCH = 1e-9
OUTSIDE = 1 << 30
_HALF_DIAGONAL = 0.7071068


class PlanCells(NamedTuple):
    """Cells of a costmap.

    Attributes:
        sums: (H, W + 1) int32, number of occupied cells left of each corner, row by row.
        distance_m: (H, W) float32 from each cell's centre to that of the nearest occupied one.
        metre_cost: (H, W) float32 cost of a metre, at least 1.
        resolution_m: side of a cell.
        x0, y0: of the corner of cell (0, 0), metres.
    """

    sums: Any
    distance_m: Any
    metre_cost: Any
    resolution_m: float
    x0: float
    y0: float


class Shape(NamedTuple):
    """A footprint with its margins.

    Attributes:
        outlines: (K, N, 2) corners, from the outline with the wanted margin to the one with the least.
        inscribed_m: of the last.
        middle_x, middle_y, around_m: of a disc in `base` that encloses the first.
    """

    outlines: Any
    inscribed_m: float
    middle_x: float
    middle_y: float
    around_m: float


@kernel(error_model="numpy")
def count_under(cells: PlanCells, corners: Any, x: float, y: float, yaw: float) -> Any:
    """Return the number of occupied cells under an outline (N, 2) at a pose; OUTSIDE if it leaves the cells."""
    rows, columns = cells.distance_m.shape
    n, c, s = len(corners), np.cos(yaw), np.sin(yaw)
    u, v = np.empty(n), np.empty(n)
    low, high = np.inf, -np.inf
    for k in range(n):
        u[k] = (x + c * corners[k, 0] - s * corners[k, 1] - cells.x0) / cells.resolution_m
        v[k] = (y + s * corners[k, 0] + c * corners[k, 1] - cells.y0) / cells.resolution_m
        low, high = min(low, v[k]), max(high, v[k])
        if not (u[k] >= -_TOUCH and u[k] <= columns + _TOUCH):
            return OUTSIDE
    if not (low >= -_TOUCH and high <= rows + _TOUCH):
        return OUTSIDE
    found = 0
    for row in range(max(int(np.floor(low + _TOUCH)), 0), min(int(np.ceil(high - _TOUCH)), rows)):
        left, right = _stretch(u, v, row + _TOUCH, row + 1 - _TOUCH)
        first, after = max(int(np.floor(left + _TOUCH)), 0), min(int(np.ceil(right - _TOUCH)), columns)
        if after > first:
            found += cells.sums[row, after] - cells.sums[row, first]
    return found


@kernel(error_model="numpy")
def _stretch(u: Any, v: Any, low: float, high: float) -> Any:
    """Return where a convex outline begins and ends between two heights."""
    left, right, before = np.inf, -np.inf, len(u) - 1
    for k in range(len(u)):
        if low <= v[k] <= high:
            left, right = min(left, u[k]), max(right, u[k])
        rise = v[k] - v[before]
        for height in (low, high):
            if (v[k] - height) * (v[before] - height) < 0:
                at = u[before] + (u[k] - u[before]) * (height - v[before]) / rise
                left, right = min(left, at), max(right, at)
        before = k
    return left, right


@kernel(error_model="numpy")
def cell_of(cells: PlanCells, x: float, y: float) -> Any:
    """Return row and column of a point; -1 and -1 outside."""
    row = int(np.floor((y - cells.y0) / cells.resolution_m))
    column = int(np.floor((x - cells.x0) / cells.resolution_m))
    rows, columns = cells.distance_m.shape
    if row < 0 or column < 0 or row >= rows or column >= columns:
        return -1, -1
    return row, column


@kernel(error_model="numpy")
def tightness(cells: PlanCells, shape: Shape, x: float, y: float, yaw: float) -> Any:
    """Return 0 if the widest outline is free, 1 if only the narrowest is, a value between for others, else infinity."""
    row, column = cell_of(cells, x, y)
    # The distance from a point to the nearest occupied square differs by this from that between centres.
    slack_m = _HALF_DIAGONAL * cells.resolution_m
    if row < 0 or cells.distance_m[row, column] < shape.inscribed_m + 0.5 * cells.resolution_m - slack_m:
        return np.inf
    c, s = np.cos(yaw), np.sin(yaw)
    at_x, at_y = x + c * shape.middle_x - s * shape.middle_y, y + s * shape.middle_x + c * shape.middle_y
    row, column = cell_of(cells, at_x, at_y)
    if row >= 0 and cells.distance_m[row, column] > shape.around_m + 2 * slack_m:
        edge_m = min(row, column, cells.distance_m.shape[0] - 1 - row, cells.distance_m.shape[1] - 1 - column)
        if edge_m * cells.resolution_m > shape.around_m:
            return 0.0
    last = len(shape.outlines) - 1
    if count_under(cells, shape.outlines[last], x, y, yaw) > 0:
        return np.inf
    for k in range(last):
        if count_under(cells, shape.outlines[k], x, y, yaw) == 0:
            return k / last
    return 1.0


@kernel(error_model="numpy")
def tightnesses(cells: PlanCells, shape: Shape, poses: Any, found: Any) -> None:
    """Compute `tightness` for poses (N, 3)."""
    for k in range(len(poses)):
        found[k] = tightness(cells, shape, poses[k, 0], poses[k, 1], poses[k, 2])


# Spacing of points along an outline, in cells, whose distances bound its clearance from below.
_SPACING = 2.0


@kernel(error_model="numpy")
def least_clearance(cells: PlanCells, corners: Any, poses: Any, most_m: float) -> Any:
    """Return metres from an outline at any of poses (N, 3) to the nearest occupied square, at most `most_m`; or 0."""
    bounds, first = np.empty(len(poses)), 0
    edge = _edge_points(corners, _SPACING * cells.resolution_m)
    for p in range(len(poses)):
        bounds[p] = _clearance_bound(cells, edge, poses[p])
        first = p if bounds[p] < bounds[first] else first
    least = most_m
    # The most promising pose first, so that bounds rule out most of the others.
    for n in range(-1, len(poses)):
        p = first if n < 0 else n
        if bounds[p] >= least:
            continue
        x, y, yaw = poses[p, 0], poses[p, 1], poses[p, 2]
        if cell_of(cells, x, y)[0] < 0 or count_under(cells, corners, x, y, yaw) > 0:
            return 0.0
        least = min(least, _clearance_at(cells, corners, poses[p], least))
    return least


@kernel(error_model="numpy")
def _edge_points(corners: Any, apart_m: float) -> Any:
    """Return (K, 2) points on the sides of an outline, at most so far apart."""
    points, count = np.empty((4096, 2)), 0
    for k in range(len(corners)):
        after = corners[(k + 1) % len(corners)]
        steps = int(np.ceil(np.hypot(after[0] - corners[k, 0], after[1] - corners[k, 1]) / apart_m)) + 1
        for n in range(min(steps, len(points) - count)):
            points[count, 0] = corners[k, 0] + (after[0] - corners[k, 0]) * n / steps
            points[count, 1] = corners[k, 1] + (after[1] - corners[k, 1]) * n / steps
            count += 1
    return points[:count].copy()


@kernel(error_model="numpy")
def _clearance_bound(cells: PlanCells, edge: Any, pose: Any) -> Any:
    """Return a lower bound of the clearance of an outline with points on its sides at a pose; below 0 if unknown."""
    c, s, least = np.cos(pose[2]), np.sin(pose[2]), np.inf
    for k in range(len(edge)):
        row, column = cell_of(
            cells, pose[0] + c * edge[k, 0] - s * edge[k, 1], pose[1] + s * edge[k, 0] + c * edge[k, 1]
        )
        if row < 0:
            return -1.0
        least = min(least, cells.distance_m[row, column])
    return least - (0.5 * _SPACING + 2 * _HALF_DIAGONAL) * cells.resolution_m


@kernel(error_model="numpy")
def _clearance_at(cells: PlanCells, corners: Any, pose: Any, most_m: float) -> Any:
    """Return metres from an outline at a pose to the nearest occupied square, at most `most_m`."""
    size_m, placed = cells.resolution_m, np.empty((len(corners), 2))
    rows, columns = cells.distance_m.shape
    c, s = np.cos(pose[2]), np.sin(pose[2])
    for k in range(len(corners)):
        placed[k, 0] = (pose[0] + c * corners[k, 0] - s * corners[k, 1] - cells.x0) / size_m
        placed[k, 1] = (pose[1] + s * corners[k, 0] + c * corners[k, 1] - cells.y0) / size_m
    least, reach = most_m, most_m / size_m + 1
    for i in range(max(int(placed[:, 1].min() - reach), 0), min(int(placed[:, 1].max() + reach) + 1, rows)):
        for j in range(max(int(placed[:, 0].min() - reach), 0), min(int(placed[:, 0].max() + reach) + 1, columns)):
            if cells.distance_m[i, j] == 0:
                least = min(least, size_m * _apart(placed, j, i))
    return least


@kernel(error_model="numpy")
def _apart(placed: Any, left: int, low: int) -> Any:
    """Return the distance in cells between an outline and the unit square with that lower left corner."""
    least, before = np.inf, len(placed) - 1
    for k in range(len(placed)):
        x, y = placed[k, 0], placed[k, 1]
        least = min(least, np.hypot(max(left - x, x - left - 1, 0.0), max(low - y, y - low - 1, 0.0)))
        bx, by = placed[before, 0], placed[before, 1]
        wx, wy = x - bx, y - by
        length2 = wx * wx + wy * wy
        for corner in range(4):
            px, py = left + corner % 2, low + corner // 2
            share = min(max(((px - bx) * wx + (py - by) * wy) / length2, 0.0), 1.0)
            least = min(least, np.hypot(bx + share * wx - px, by + share * wy - py))
        before = k
    return least
