"""Compiled views: floor and obstacles in a depth image, and the floor that a camera sees along a plan."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from wheelsight.core.compiled import kernel
from wheelsight.core.geometry.arrays import BoolArray, FloatArray, IntArray
from wheelsight.navigation.clearance_kernels import outside_m

# Floor and obstacles in a depth image, by bearing and by cell of the base.


_NEITHER, _FLOOR, _THING = 0, 1, 2


class Rays(NamedTuple):
    """Ray of each pixel (h, w): the point at depth 1 relative to the camera along the base's axes, and its bearing.

    Attributes:
        ways: (h, w, 3) float32.
        columns: (h, w) int16 number of the bearing, -1 outside of the view that all rows share.
        camera: (3,) place of the camera in the base.
    """

    ways: Any
    columns: Any
    camera: Any


class Heights(NamedTuple):
    """Limits between floor and obstacles, metres; as in `LiveLayerSettings`."""

    floor_m: float
    drop_m: float
    tilt_rad: float
    height_m: float
    far_m: float


class Shown(NamedTuple):
    """Content of a depth image.

    Attributes:
        floor: (columns, bins) uint8, whether a bearing shows floor at a distance from the camera.
        cells: (n, n, 3) of obstacles: pixels, sums of x and y in the base.
        tops: (n, n, k) the k largest heights of a cell's pixels over the floor, the largest first.
        measured: (columns,) pixels with a depth.
        bin_m, cell_m: side of a bin and of a cell.
    """

    floor: Any
    cells: Any
    tops: Any
    measured: Any
    bin_m: float
    cell_m: float


@kernel(error_model="numpy")
def sort_pixels(depth_m: Any, rays: Rays, heights: Heights, shown: Shown) -> None:
    """Sort the pixels of a depth image (h, w) in metres; pixels that are not finite and over 0 have no depth."""
    rows, columns = depth_m.shape
    bins, lowest = shown.floor.shape[1], shown.tops.shape[2] - 1
    for v in range(rows):
        for u in range(columns):
            z, column = depth_m[v, u], rays.columns[v, u]
            if column < 0 or not (z > 0 and z < np.inf):
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
def reach(depth_m: Any, rays: Rays, heights: Heights, shown: Shown, is_thing: Any, nearest_m: Any) -> None:
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
def _met(dx: float, dy: float, dz: float, camera_m: float, heights: Heights) -> Any:
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
def _cell(shown: Shown, x: float, y: float) -> Any:
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
