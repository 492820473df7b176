"""Compiled clearance: distances of an outline to obstacles and people, sweeps along arcs, and memory of the floor."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from wheelsight.core.compiled import kernel
from wheelsight.core.geometry.arrays import ByteArray, Float32Array, FloatArray, IntArray

# Distances of a footprint to a cost field and to people, and the motion of a base.


ANY_SPEED: Float32Array = np.full((1, 1), np.inf, np.float32)
ANY_SPEED.setflags(write=False)
# Largest distance by which the cover of discs exceeds a footprint.
OVERHANG_M = 0.04
# Error of a distance between cell centres, in cells, including points between those that are sampled along a side.
_OFF = 0.25
# A clearance above this is not measured further, metres.
_ENOUGH_M = 0.5
# Fast-math flags that keep infinity and NaN.
_FAST = {"contract", "nsz", "arcp"}


class CostField(NamedTuple):
    """A window of the floor in cells: rows along y, columns along x. Everything outside is an obstacle.

    Attributes:
        distance_m: (H, W) from each cell's centre to that of the nearest cell with an obstacle; 0 in these.
        cost: (H, W) from 0, free, to 1: cost of driving besides nearness to obstacles, such as unknown floor.
        resolution: metres per cell.
        origin: x and y in metres of the corner of cell (0, 0), in the frame of plan and robot.
        speed_m_s: (H, W) speed limits of zones, infinite outside of them; (1, 1) for one limit everywhere.
    """

    distance_m: Float32Array
    cost: Float32Array
    resolution: float
    origin: tuple[float, float]
    speed_m_s: Float32Array = ANY_SPEED


class Outline(NamedTuple):
    """A footprint in the form of the kernels.

    Attributes:
        sides: (N, 5) x, y of a corner, unit vector to the next one, and its distance.
        cover: (K, 3) discs that cover the footprint closely.
        around: x, y, radius of a disc that encloses it.
    """

    sides: FloatArray
    cover: FloatArray
    around: tuple[float, float, float]


@kernel(error_model="numpy", fastmath=_FAST)
def distance_at(field: CostField, x: float, y: float) -> Any:
    """Return metres from a point to the nearest obstacle, bilinear between cell centres; 0 outside of the field."""
    u = (x - field.origin[0]) / field.resolution - 0.5
    v = (y - field.origin[1]) / field.resolution - 0.5
    return _between_cells(field.distance_m, u, v)


@kernel(error_model="numpy", fastmath=_FAST)
def _between_cells(distance_m: Float32Array, u: float, v: float) -> Any:
    """Return the same at a column and a row, counted from the first cell's centre."""
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
    """Return cost and speed limit of the cell of a point; 1 and 0 outside of the field."""
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
    """Return metres from a footprint at (x, y, cosine, sine) to the nearest obstacle.

    Above the margin it may be too low, by as much as the cover exceeds the footprint. Below, it is the distance from
    the nearest cell's centre to the nearest side: negative inside, and beside a corner it may be too low.
    """
    x, y, c, s = pose
    ax, ay, around_m = outline.around
    far = distance_at(field, x + c * ax - s * ay, y + s * ax + c * ay) - around_m
    if far > _ENOUGH_M:
        return far
    least = np.inf
    # In cells: a division per point would take as long as everything else.
    cells = 1.0 / field.resolution
    u, v = (x - field.origin[0]) * cells - 0.5, (y - field.origin[1]) * cells - 0.5
    cc, sc = c * cells, s * cells
    for k in range(len(outline.cover)):
        dx, dy = outline.cover[k, 0], outline.cover[k, 1]
        away = _between_cells(field.distance_m, u + cc * dx - sc * dy, v + sc * dx + cc * dy) - outline.cover[k, 2]
        least = min(least, away)
    if least > margin_m:
        return least
    # The cover contains the inside: if it is clear, only the sides need a check, which is faster.
    off_m = _OFF * field.resolution
    if least > off_m:
        along_m = _along_sides(field, outline, pose, margin_m + off_m)
        if along_m > margin_m + off_m:
            return along_m
    return _of_cells(field, outline, pose, max(margin_m, 0.0) + 2 * off_m)


@kernel(error_model="numpy", fastmath=_FAST)
def _along_sides(field: CostField, outline: Outline, pose: Any, enough_m: float) -> Any:
    """Return metres from an outline's sides to the nearest obstacle, sampled; or any value below `enough_m`."""
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
    """Compute `clearance_at` for poses (N, 3) of x, y, yaw."""
    for k in range(len(poses)):
        pose = (poses[k, 0], poses[k, 1], np.cos(poses[k, 2]), np.sin(poses[k, 2]))
        found[k] = clearance_at(field, outline, pose, margin_m)


@kernel(error_model="numpy", fastmath=_FAST)
def _of_cells(field: CostField, outline: Outline, pose: Any, most_m: float) -> Any:
    """Return the same as `clearance_at`, at most `most_m`, from each cell with an obstacle near a footprint."""
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
            # Skip the cells within the distance of the nearest obstacle.
            j += max(int(min(away / size_m, 1e6) - 1e-3), 1)
    return least


@kernel(error_model="numpy", fastmath=_FAST)
def _box(outline: Outline, pose: Any) -> Any:
    """Return the least and largest x and y of a footprint at a pose."""
    x, y, c, s = pose
    low_x, low_y, high_x, high_y = np.inf, np.inf, -np.inf, -np.inf
    for k in range(len(outline.sides)):
        bx, by = outline.sides[k, 0], outline.sides[k, 1]
        px, py = x + c * bx - s * by, y + s * bx + c * by
        low_x, low_y, high_x, high_y = min(low_x, px), min(low_y, py), max(high_x, px), max(high_y, py)
    return low_x, low_y, high_x, high_y


@kernel(error_model="numpy", fastmath=_FAST)
def apart_from(outline: Outline, pose: Any, x: float, y: float) -> Any:
    """Return metres from a footprint at (x, y, cosine, sine) to a point; negative inside, too low beside corners."""
    dx, dy = x - pose[0], y - pose[1]
    bx, by = pose[2] * dx + pose[3] * dy, -pose[3] * dx + pose[2] * dy
    most = -np.inf
    for k in range(len(outline.sides)):
        cx, cy, ux, uy, _ = outline.sides[k]
        most = max(most, uy * (bx - cx) - ux * (by - cy))
    return most


@kernel(error_model="numpy", fastmath=_FAST)
def people_apart(people: FloatArray, outline: Outline, pose: Any, after_s: float) -> Any:
    """Return metres from a footprint to the nearest person (P, 5: x, y, vx, vy, radius) after a time, or infinity."""
    least = np.inf
    for k in range(len(people)):
        x, y = people[k, 0] + after_s * people[k, 2], people[k, 1] + after_s * people[k, 3]
        least = min(least, apart_from(outline, pose, x, y) - people[k, 4])
    return least


@kernel(error_model="numpy", fastmath=_FAST)
def moved(pose: Any, way_m: float, turn_rad: float) -> Any:
    """Return a pose (x, y, cosine, sine) after an arc, exactly."""
    x, y, c, s = pose
    half = turn_rad / 2
    hc, hs = np.cos(half), np.sin(half)
    chord = way_m * (hs / half if abs(half) > 1e-9 else 1.0)
    mc, ms = c * hc - s * hs, s * hc + c * hs
    return x + chord * mc, y + chord * ms, mc * hc - ms * hs, ms * hc + mc * hs


@kernel(error_model="numpy", fastmath=_FAST)
def toward(speed: float, wanted: float, faster: float, slower: float) -> Any:
    """Return a speed after one step, with limited changes away from zero and toward it."""
    if speed * (wanted - speed) >= 0.0:
        return speed + min(max(wanted - speed, -faster), faster)
    change = min(max(wanted - speed, -slower), slower)
    if speed * (speed + change) < 0.0:
        # It crosses zero, and accelerates for the rest of the step.
        left = 1.0 - abs(speed) / slower
        return min(max(wanted, -faster * left), faster * left)
    return speed + change


@kernel(error_model="numpy", fastmath=_FAST)
def free_arc(field: CostField, outline: Outline, people: FloatArray, pose: Any, arc: Any, margin_m: float) -> Any:
    """Return the number of free steps of a footprint along an arc (way, turn and seconds per step; steps).

    A step within the margin is free if the distance does not decrease, so that a robot can move away.
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


# Free part of an arc, by obstacles and by unseen floor.


class UnseenGround(NamedTuple):
    """Unseen floor around a robot.

    Attributes:
        deep_m: (m, m) depth in metres into floor that was never seen; rows along x, columns along y.
        is_old: (m, m) 1 where it was not seen lately.
        first: i and j of the first cell in the plane.
        cell_m: side of a cell.
        pose: of the robot in the plane: x, y, cosine, sine.
    """

    deep_m: Float32Array
    is_old: ByteArray
    first: tuple[int, int]
    cell_m: float
    pose: tuple[float, float, float, float]


@kernel
def outside_m(sides: FloatArray, x: float, y: float) -> Any:
    """Return metres from an outline (sides as in `Outline`) to a point in its frame; too low beside corners."""
    most = -np.inf
    for k in range(len(sides)):
        most = max(most, sides[k, 3] * (x - sides[k, 0]) - sides[k, 2] * (y - sides[k, 1]))
    return most


@kernel
def all_outside_m(sides: FloatArray, points: FloatArray) -> Any:
    """Return the same for points (N, 2)."""
    away = np.empty(len(points))
    for k in range(len(points)):
        away[k] = outside_m(sides, points[k, 0], points[k, 1])
    return away


@kernel
def _steps_free(away_m: float, margin_m: float, stride_m: float) -> Any:
    """Return the number of steps in which a point stays beyond a margin, if each step approaches by a stride."""
    return 1 + int((away_m - margin_m) / stride_m) if away_m > margin_m and stride_m > 0 else 1


@kernel
def _strides_m(points: FloatArray, arc: Any, steps: int) -> Any:
    """Return (N,) the largest approach of points in one step of an arc."""
    strides = np.empty(len(points))
    for k in range(len(points)):
        lever = np.hypot(points[k, 0], points[k, 1]) + abs(arc[0])
        strides[k] = (abs(arc[0]) + lever * abs(arc[1])) / steps
    return strides


@kernel
def clear_share(sides: FloatArray, points: FloatArray, arc: Any, steps: int, margin_m: float) -> Any:
    """Return the share of an arc (way, turn) that an outline drives before a point (N, 2) is within a margin.

    A point that is within it already counts if it comes nearer.
    """
    before = all_outside_m(sides, points)
    strides = _strides_m(points, arc, steps)
    due = np.empty(len(points), np.int64)
    for k in range(len(points)):
        due[k] = _steps_free(before[k], margin_m, strides[k])
    for n in range(1, steps + 1):
        x, y, c, s = moved((0.0, 0.0, 1.0, 0.0), arc[0] * n / steps, arc[1] * n / steps)
        for k in range(len(points)):
            if due[k] > n:
                continue
            dx, dy = points[k, 0] - x, points[k, 1] - y
            away = outside_m(sides, c * dx + s * dy, -s * dx + c * dy)
            if away < margin_m and away < before[k] - 1e-6:
                return (n - 1) / steps
            due[k] = n + _steps_free(away, margin_m, strides[k])
    return 1.0


@kernel
def can_pass(sides: FloatArray, points: FloatArray, length_m: float, steps: int, bends: Any, margin_m: float) -> Any:
    """Return whether two arcs of a length, each with one of the bends (1/m), pass points (N, 2) at a margin."""
    beyond = np.empty_like(points)
    for first in bends:
        arc = (length_m, first * length_m)
        if clear_share(sides, points, arc, steps, margin_m) < 1.0:
            continue
        x, y, c, s = moved((0.0, 0.0, 1.0, 0.0), arc[0], arc[1])
        for k in range(len(points)):
            dx, dy = points[k, 0] - x, points[k, 1] - y
            beyond[k] = c * dx + s * dy, -s * dx + c * dy
        for second in bends:
            if clear_share(sides, beyond, (length_m, second * length_m), steps, margin_m) >= 1.0:
                return True
    return False


@kernel
def zone_share(sides: FloatArray, points: FloatArray, arc: Any, steps: int, zone_m: float) -> Any:
    """Return the share of an arc (way, turn) that an outline drives before a point (N, 2) is within a zone."""
    strides = _strides_m(points, arc, steps)
    due = np.zeros(len(points), np.int64)
    for n in range(steps + 1):
        x, y, c, s = moved((0.0, 0.0, 1.0, 0.0), arc[0] * n / steps, arc[1] * n / steps)
        for k in range(len(points)):
            if due[k] > n:
                continue
            dx, dy = points[k, 0] - x, points[k, 1] - y
            away = outside_m(sides, c * dx + s * dy, -s * dx + c * dy)
            if away < zone_m:
                return max(n - 1, 0) / steps
            due[k] = n + _steps_free(away, zone_m, strides[k])
    return 1.0


@kernel
def seen_shares(
    outline: FloatArray, sides: FloatArray, ground: UnseenGround, arc: Any, steps: int, deep_m: float
) -> Any:
    """Return two shares of an arc for the points (K, 2) of an outline, except for floor under the robot now.

    The first ends where a point is too deep in floor that was never seen, the second at floor not seen lately.
    """
    old = 1.0
    px, py, pc, ps = ground.pose
    rows, columns = ground.deep_m.shape
    for n in range(1, steps + 1):
        x, y, c, s = moved((0.0, 0.0, 1.0, 0.0), arc[0] * n / steps, arc[1] * n / steps)
        for k in range(len(outline)):
            bx, by = x + c * outline[k, 0] - s * outline[k, 1], y + s * outline[k, 0] + c * outline[k, 1]
            beside_m = outside_m(sides, bx, by)
            if beside_m <= 0.0:
                continue
            i = int(np.floor((px + pc * bx - ps * by) / ground.cell_m)) - ground.first[0]
            j = int(np.floor((py + ps * bx + pc * by) / ground.cell_m)) - ground.first[1]
            outside = i < 0 or j < 0 or i >= rows or j >= columns
            # A cell that the robot covers in part is unseen, but not new.
            if old == 1.0 and beside_m > 1.5 * ground.cell_m and (outside or ground.is_old[i, j] == 1):
                old = (n - 1) / steps
            if outside or ground.deep_m[i, j] > deep_m:
                return (n - 1) / steps, old
    return 1.0, old


@kernel
def deepest_m(points: FloatArray, ground: UnseenGround) -> Any:
    """Return the largest depth of points (N, 2) of a robot in unseen floor; infinite beyond the known window."""
    px, py, pc, ps = ground.pose
    rows, columns = ground.deep_m.shape
    most = 0.0
    for k in range(len(points)):
        i = int(np.floor((px + pc * points[k, 0] - ps * points[k, 1]) / ground.cell_m)) - ground.first[0]
        j = int(np.floor((py + ps * points[k, 0] + pc * points[k, 1]) / ground.cell_m)) - ground.first[1]
        if i < 0 or j < 0 or i >= rows or j >= columns:
            return np.inf
        most = max(most, ground.deep_m[i, j])
    return most


# Memory of the floor around a robot, in cells that are addressed by their numbers.


class Memory(NamedTuple):
    """A square window that moves with the robot: cell (i, j) of the plane is stored at (i mod n, j mod n).

    Attributes:
        numbers: (n, n, 2) i and j of the stored cell.
        seen_s: (n, n) when its floor was last seen free, or driven over; minus infinity for never.
        looked_s: (n, n) when a camera last saw its floor, or the air over it; minus infinity for never.
        hit_s: (n, n) when an obstacle was last seen in it; minus infinity for none.
        hits: (n, n, 5) place of the obstacle, distance to a camera at which it is visible, way driven until then, and
            whether it is floor without depth (1).
        cell_m: side of a cell.
    """

    numbers: IntArray
    seen_s: FloatArray
    looked_s: FloatArray
    hit_s: FloatArray
    hits: FloatArray
    cell_m: float


class SeenSector(NamedTuple):
    """A camera's view of the floor in the plane.

    Attributes:
        x, y: place of the camera.
        first_rad: bearing in the plane of the right end of the first column.
        step_rad: angle between columns.
        air_m: least distance of observed air.
        near_m: least distance of visible floor.
        far_m: largest distance of any column.
        seen_m: (B,) distance that each column sees.
        stamp_s: time of the view.
    """

    x: float
    y: float
    first_rad: float
    step_rad: float
    air_m: float
    near_m: float
    far_m: float
    seen_m: FloatArray
    stamp_s: float


@kernel
def slot(memory: Memory, i: int, j: int) -> Any:
    """Return the slot of cell (i, j), cleared if it held another cell."""
    n = len(memory.seen_s)
    a, b = i % n, j % n
    if memory.numbers[a, b, 0] != i or memory.numbers[a, b, 1] != j:
        memory.numbers[a, b, 0], memory.numbers[a, b, 1] = i, j
        memory.seen_s[a, b] = -np.inf
        memory.looked_s[a, b] = -np.inf
        memory.hit_s[a, b] = -np.inf
    return a, b


@kernel
def mark_seen(memory: Memory, sight: SeenSector, x: float, y: float) -> None:
    """Mark what a camera sees, and remove obstacles that it sees through, in the window around (x, y)."""
    n, cell = len(memory.seen_s), memory.cell_m
    first_i, first_j = int(np.floor(x / cell)) - n // 2, int(np.floor(y / cell)) - n // 2
    left, right, below, above = _bounds(sight)
    for i in range(max(first_i, int(left / cell) - 2), min(first_i + n, int(right / cell) + 3)):
        for j in range(max(first_j, int(below / cell) - 2), min(first_j + n, int(above / cell) + 3)):
            a, b = slot(memory, i, j)
            x_m, y_m = (i + 0.5) * cell, (j + 0.5) * cell
            if _is_seen(sight, x_m, y_m, cell / 2, sight.air_m):
                memory.looked_s[a, b] = max(memory.looked_s[a, b], sight.stamp_s)
            if _is_seen(sight, x_m, y_m, cell / 2, sight.near_m):
                memory.seen_s[a, b] = max(memory.seen_s[a, b], sight.stamp_s)
            if -np.inf < memory.hit_s[a, b] < sight.stamp_s:
                # The camera does not see through an obstacle below its lowest ray, however far it sees over it.
                near_m = min(sight.near_m, memory.hits[a, b, 2])
                if _is_seen(sight, memory.hits[a, b, 0], memory.hits[a, b, 1], cell, near_m):
                    memory.hit_s[a, b] = -np.inf


@kernel
def _bounds(sight: SeenSector) -> Any:
    """Return the least and largest x and y that a camera sees."""
    left, right, below, above = sight.x, sight.x, sight.y, sight.y
    # An arc between two columns exceeds the chord.
    far_m = sight.far_m / np.cos(min(sight.step_rad / 2, 1.0))
    for k in range(len(sight.seen_m) + 1):
        bearing = sight.first_rad + k * sight.step_rad
        px, py = sight.x + far_m * np.cos(bearing), sight.y + far_m * np.sin(bearing)
        left, right, below, above = min(left, px), max(right, px), min(below, py), max(above, py)
    return left, right, below, above


@kernel
def _is_seen(sight: SeenSector, x: float, y: float, short_m: float, near_m: float) -> Any:
    """Return whether a column sees more than `short_m` beyond a point that is at `near_m` or farther."""
    dx, dy = x - sight.x, y - sight.y
    away = np.sqrt(dx * dx + dy * dy)
    if away < near_m or away > sight.far_m:
        return False
    bearing = (np.arctan2(dy, dx) - sight.first_rad) % (2 * np.pi)
    column = int(bearing / sight.step_rad)
    return column < len(sight.seen_m) and away <= sight.seen_m[column] - short_m


@kernel
def store_hits(
    memory: Memory, points: FloatArray, shows_m: FloatArray, stamp_s: float, middle: Any, way_m: float, solid: int
) -> None:
    """Store obstacles at points (N, 2) in the plane, within the window around `middle`.

    With each it stores the distance to a camera at which it is visible (N,), and the way driven. The points from number
    `solid` on are floor without depth.
    """
    reach = (len(memory.seen_s) // 2 - 1) * memory.cell_m
    for k in range(len(points)):
        x, y = points[k, 0], points[k, 1]
        if abs(x - middle[0]) < reach and abs(y - middle[1]) < reach:
            a, b = slot(memory, int(np.floor(x / memory.cell_m)), int(np.floor(y / memory.cell_m)))
            memory.hit_s[a, b] = stamp_s
            memory.hits[a, b, 0], memory.hits[a, b, 1] = x, y
            memory.hits[a, b, 2], memory.hits[a, b, 3] = shows_m[k], way_m
            memory.hits[a, b, 4] = 1.0 if k >= solid else 0.0


@kernel
def mark_under(memory: Memory, sides: FloatArray, pose: Any, stamp_s: float, from_m: float) -> None:
    """Mark the floor under an outline (sides as in `Outline`) as driven over, from a distance ahead of the axle on.

    Marking a whole outline counts as observation, too, because a person has looked there. Marking its front alone does
    not.
    """
    x, y, c, s = pose
    cell = memory.cell_m
    reach = int(np.ceil(np.sqrt((sides[:, 0] ** 2 + sides[:, 1] ** 2).max()) / cell)) + 1
    middle_i, middle_j = int(np.floor(x / cell)), int(np.floor(y / cell))
    for i in range(middle_i - reach, middle_i + reach + 1):
        for j in range(middle_j - reach, middle_j + reach + 1):
            dx, dy = (i + 0.5) * cell - x, (j + 0.5) * cell - y
            bx, by = c * dx + s * dy, -s * dx + c * dy
            if bx >= from_m and outside_m(sides, bx, by) <= 0.0:
                a, b = slot(memory, i, j)
                memory.seen_s[a, b] = max(memory.seen_s[a, b], stamp_s)
                if from_m == -np.inf:
                    memory.looked_s[a, b] = max(memory.looked_s[a, b], stamp_s)


@kernel
def remembered(memory: Memory, pose: Any, since: Any, reach_m: float, out: FloatArray) -> Any:
    """Write obstacles since a time and a way into (M, 4), and return how many.

    Each is x and y in the frame of a pose, its time, and whether it is floor without depth.
    """
    x, y, c, s = pose
    found = 0
    n = len(memory.seen_s)
    for a in range(n):
        for b in range(n):
            if memory.hit_s[a, b] < since[0] or memory.hits[a, b, 3] < since[1]:
                continue
            dx, dy = memory.hits[a, b, 0] - x, memory.hits[a, b, 1] - y
            if dx * dx + dy * dy < reach_m * reach_m and found < len(out):
                out[found, 0], out[found, 1] = c * dx + s * dy, -s * dx + c * dy
                out[found, 2], out[found, 3] = memory.hit_s[a, b], memory.hits[a, b, 4]
                found += 1
    return found


@kernel
def unseen(memory: Memory, first: Any, since_s: float, out: ByteArray) -> None:
    """Write flags of unseen floor for a square of cells from the first (i, j) on.

    `out` (m, m, 3) gets 1 where floor was never seen or driven over, not since a time, and never observed.
    """
    for i in range(len(out)):
        for j in range(len(out)):
            a, b = slot(memory, first[0] + i, first[1] + j)
            out[i, j, 0] = 1 if memory.seen_s[a, b] == -np.inf else 0
            out[i, j, 1] = 1 if memory.seen_s[a, b] < since_s else 0
            out[i, j, 2] = 1 if memory.looked_s[a, b] == -np.inf else 0
