"""Compiled: how far a footprint is from what a field or people's discs hold; and how a base moves."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from wheelsight.compiled import kernel
from wheelsight.geometry.arrays import Float32Array, FloatArray

ANY_SPEED: Float32Array = np.full((1, 1), np.inf, np.float32)
ANY_SPEED.setflags(write=False)
# How far a cover of discs reaches out of an outline, at most.
OVERHANG_M = 0.04
# By so much of a cell a distance between cells' middles is off, with what lies between points along a side.
_OFF = 0.25
# Beyond so many metres of clearance nobody asks how much it is.
_ENOUGH_M = 0.5
# What leaves infinity and NaN as they are.
_FAST = {"contract", "nsz", "arcp"}


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


class Outline(NamedTuple):
    """A footprint as kernels take it.

    Attributes:
        sides: (N, 5) x, y of a corner, unit vector to the next one, and how far that is.
        cover: (K, 3) discs that together hold all of it, and little else.
        around: x, y, radius of a disc that holds all.
    """

    sides: FloatArray
    cover: FloatArray
    around: tuple[float, float, float]


@kernel(error_model="numpy", fastmath=_FAST)
def distance_at(field: CostField, x: float, y: float) -> Any:
    """Metres from a point to the nearest obstacle, between the cells' centres bilinear; 0 outside of the field."""
    u = (x - field.origin[0]) / field.resolution - 0.5
    v = (y - field.origin[1]) / field.resolution - 0.5
    return _between_cells(field.distance_m, u, v)


@kernel(error_model="numpy", fastmath=_FAST)
def _between_cells(distance_m: Float32Array, u: float, v: float) -> Any:
    """The same, at a column and a row that count from the first cell's centre."""
    rows, columns = distance_m.shape
    if not (u >= 0.0 and v >= 0.0 and u < columns - 1 and v < rows - 1):
        return 0.0
    i, j = int(v), int(u)
    a, b = u - j, v - i
    low = distance_m[i, j] * (1.0 - a) + distance_m[i, j + 1] * a
    high = distance_m[i + 1, j] * (1.0 - a) + distance_m[i + 1, j + 1] * a
    return low * (1.0 - b) + high * b


@kernel(error_model="numpy", fastmath=_FAST)
def cost_and_speed_at(field: CostField, x: float, y: float) -> Any:
    """Cost and fastest speed of the cell of a point; 1 and 0 outside of the field."""
    j = int(np.floor((x - field.origin[0]) / field.resolution))
    i = int(np.floor((y - field.origin[1]) / field.resolution))
    rows, columns = field.distance_m.shape
    if i < 0 or j < 0 or i >= rows or j >= columns:
        return 1.0, 0.0
    everywhere = field.speed_m_s.shape[0] == 1 and field.speed_m_s.shape[1] == 1
    speed = field.speed_m_s[0, 0] if everywhere else field.speed_m_s[i, j]
    return float(field.cost[i, j]), float(speed)


@kernel(error_model="numpy", fastmath=_FAST)
def clearance_at(field: CostField, outline: Outline, pose: Any, margin_m: float) -> Any:
    """Metres from a footprint at (x, y, cosine, sine) to the nearest obstacle.

    Where it is more than the margin, it may be more than what is answered, by what the cover reaches out. Else it is
    from the nearest cell's middle to the nearest side: below 0 within, and beside a corner it may be less than it is.
    """
    x, y, c, s = pose
    ax, ay, around_m = outline.around
    far = distance_at(field, x + c * ax - s * ay, y + s * ax + c * ay) - around_m
    if far > _ENOUGH_M:
        return far
    least = np.inf
    # In cells: a division each time would take as long as all else.
    cells = 1.0 / field.resolution
    u, v = (x - field.origin[0]) * cells - 0.5, (y - field.origin[1]) * cells - 0.5
    cc, sc = c * cells, s * cells
    for k in range(len(outline.cover)):
        dx, dy = outline.cover[k, 0], outline.cover[k, 1]
        away = _between_cells(field.distance_m, u + cc * dx - sc * dy, v + sc * dx + cc * dy) - outline.cover[k, 2]
        least = min(least, away)
    if least > margin_m:
        return least
    # What lies within is held by the cover: where that is clear, sides alone are asked, which is quicker.
    off_m = _OFF * field.resolution
    if least > off_m:
        along_m = _along_sides(field, outline, pose, margin_m + off_m)
        if along_m > margin_m + off_m:
            return along_m
    return _of_cells(field, outline, pose, max(margin_m, 0.0) + 2 * off_m)


@kernel(error_model="numpy", fastmath=_FAST)
def _along_sides(field: CostField, outline: Outline, pose: Any, enough_m: float) -> Any:
    """Metres from an outline's sides to the nearest obstacle, by points along them; or some that are not enough."""
    x, y, c, s = pose
    least = np.inf
    for k in range(len(outline.sides)):
        bx, by, ux, uy, length = outline.sides[k]
        px, py = x + c * bx - s * by, y + s * bx + c * by
        wx, wy = c * ux - s * uy, s * ux + c * uy
        along = 0.0
        while along < length:
            d = distance_at(field, px + wx * along, py + wy * along)
            least = min(least, d)
            if d <= enough_m:
                return d
            along += max(d - enough_m, field.resolution / 2)
    return least


@kernel(error_model="numpy", fastmath=_FAST)
def clearances_at(field: CostField, outline: Outline, poses: FloatArray, margin_m: float, found: FloatArray) -> None:
    """`clearance_at` of each of poses (N, 3) of x, y, yaw."""
    for k in range(len(poses)):
        pose = (poses[k, 0], poses[k, 1], np.cos(poses[k, 2]), np.sin(poses[k, 2]))
        found[k] = clearance_at(field, outline, pose, margin_m)


@kernel(error_model="numpy", fastmath=_FAST)
def _of_cells(field: CostField, outline: Outline, pose: Any, most_m: float) -> Any:
    """As `clearance_at`, up to so much: of each cell with an obstacle about a footprint."""
    rows, columns = field.distance_m.shape
    low_x, low_y, high_x, high_y = _box(outline, pose)
    least, size_m, (x0, y0) = most_m, field.resolution, field.origin
    first, last = int(np.floor((low_x - most_m - x0) / size_m)), int(np.floor((high_x + most_m - x0) / size_m))
    for i in range(int(np.floor((low_y - most_m - y0) / size_m)), int(np.floor((high_y + most_m - y0) / size_m)) + 1):
        j = first
        while j <= last:
            away = 0.0
            if i >= 0 and j >= 0 and i < rows and j < columns:
                away = field.distance_m[i, j]
            if away == 0.0:
                least = min(least, apart_from(outline, pose, x0 + (j + 0.5) * size_m, y0 + (i + 0.5) * size_m))
            # No cell that is nearer than the nearest obstacle holds one.
            j += max(int(min(away / size_m, 1e6) - 1e-3), 1)
    return least


@kernel(error_model="numpy", fastmath=_FAST)
def _box(outline: Outline, pose: Any) -> Any:
    """The least and the most x and y of a footprint at a pose."""
    x, y, c, s = pose
    low_x, low_y, high_x, high_y = np.inf, np.inf, -np.inf, -np.inf
    for k in range(len(outline.sides)):
        bx, by = outline.sides[k, 0], outline.sides[k, 1]
        px, py = x + c * bx - s * by, y + s * bx + c * by
        low_x, low_y, high_x, high_y = min(low_x, px), min(low_y, py), max(high_x, px), max(high_y, py)
    return low_x, low_y, high_x, high_y


@kernel(error_model="numpy", fastmath=_FAST)
def apart_from(outline: Outline, pose: Any, x: float, y: float) -> Any:
    """Metres from a footprint at (x, y, cosine, sine) to a point, negative within; beside a corner it may be less."""
    dx, dy = x - pose[0], y - pose[1]
    bx, by = pose[2] * dx + pose[3] * dy, -pose[3] * dx + pose[2] * dy
    most = -np.inf
    for k in range(len(outline.sides)):
        cx, cy, ux, uy, _ = outline.sides[k]
        most = max(most, uy * (bx - cx) - ux * (by - cy))
    return most


@kernel(error_model="numpy", fastmath=_FAST)
def people_apart(people: FloatArray, outline: Outline, pose: Any, after_s: float) -> Any:
    """Metres from a footprint to the nearest of people (P, 5: x, y, vx, vy, radius) after some time; infinite: none."""
    least = np.inf
    for k in range(len(people)):
        x, y = people[k, 0] + after_s * people[k, 2], people[k, 1] + after_s * people[k, 3]
        least = min(least, apart_from(outline, pose, x, y) - people[k, 4])
    return least


@kernel(error_model="numpy", fastmath=_FAST)
def moved(pose: Any, way_m: float, turn_rad: float) -> Any:
    """Of (x, y, cosine, sine): the same after a piece of an arc, exactly."""
    x, y, c, s = pose
    half = turn_rad / 2
    hc, hs = np.cos(half), np.sin(half)
    chord = way_m * (hs / half if abs(half) > 1e-9 else 1.0)
    mc, ms = c * hc - s * hs, s * hc + c * hs
    return x + chord * mc, y + chord * ms, mc * hc - ms * hs, ms * hc + mc * hs


@kernel(error_model="numpy", fastmath=_FAST)
def toward(speed: float, wanted: float, faster: float, slower: float) -> Any:
    """A speed one step on, that may grow away from zero and fall toward it by so much."""
    if speed * (wanted - speed) >= 0.0:
        return speed + min(max(wanted - speed, -faster), faster)
    change = min(max(wanted - speed, -slower), slower)
    if speed * (speed + change) < 0.0:
        # It crosses zero: from there on it grows, if it has time left.
        left = 1.0 - abs(speed) / slower
        return min(max(wanted, -faster * left), faster * left)
    return speed + change


@kernel(error_model="numpy", fastmath=_FAST)
def free_arc(field: CostField, outline: Outline, people: FloatArray, pose: Any, arc: Any, margin_m: float) -> Any:
    """How many steps of an arc (way, turn and seconds a step; steps) a footprint goes before it is too near to a thing.

    Nearness counts only where it grows: a robot that stands too near may leave.
    """
    step_m, step_rad, step_s, steps = arc
    before = min(clearance_at(field, outline, pose, margin_m), people_apart(people, outline, pose, 0.0))
    for n in range(1, steps + 1):
        pose = moved(pose, step_m, step_rad)
        clearance = clearance_at(field, outline, pose, margin_m)
        clearance = min(clearance, people_apart(people, outline, pose, n * step_s))
        if clearance <= margin_m and not (before <= margin_m and clearance >= before - 1e-6):
            return n - 1
        before = clearance
    return steps
