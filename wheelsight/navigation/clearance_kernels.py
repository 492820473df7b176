"""Compiled clearance: distances of an outline to a cost field or people, sweeps along arcs, and the memory of the
floor.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from wheelsight.core.compiled import kernel
from wheelsight.core.geometry.arrays import ByteArray, Float32Array, FloatArray, IntArray

# Compiled: how far a footprint is from what a field or people's discs hold; and how a base moves.


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


# Compiled: how far an outline goes along an arc before it meets things, or floor that was not seen.


class Ground(NamedTuple):
    """What is known of the floor about a robot.

    Attributes:
        deep_m: (m, m) metres into floor that was never seen; rows along x, columns along y.
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
    """Metres from an outline (sides as `Outline` has them) to a point in its frame; beside a corner it may be less."""
    most = -np.inf
    for k in range(len(sides)):
        most = max(most, sides[k, 3] * (x - sides[k, 0]) - sides[k, 2] * (y - sides[k, 1]))
    return most


@kernel
def all_outside_m(sides: FloatArray, points: FloatArray) -> Any:
    """The same of points (N, 2)."""
    away = np.empty(len(points))
    for k in range(len(points)):
        away[k] = outside_m(sides, points[k, 0], points[k, 1])
    return away


@kernel
def _steps_free(away_m: float, margin_m: float, stride_m: float) -> Any:
    """For how many steps a thing stays beyond a margin, for in each it comes nearer by a stride at most."""
    return 1 + int((away_m - margin_m) / stride_m) if away_m > margin_m and stride_m > 0 else 1


@kernel
def _strides_m(points: FloatArray, arc: Any, steps: int) -> Any:
    """(N,) how far things move against the robot in a step of an arc, at most."""
    strides = np.empty(len(points))
    for k in range(len(points)):
        lever = np.hypot(points[k, 0], points[k, 1]) + abs(arc[0])
        strides[k] = (abs(arc[0]) + lever * abs(arc[1])) / steps
    return strides


@kernel
def clear_share(sides: FloatArray, points: FloatArray, arc: Any, steps: int, margin_m: float) -> Any:
    """The share of an arc (way, turn) that an outline goes before a thing (N, 2) is nearer than a margin.

    Things that are nearer already count where they come nearer still.
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
def zone_share(sides: FloatArray, points: FloatArray, arc: Any, steps: int, zone_m: float) -> Any:
    """The share of an arc (way, turn) that an outline goes before a thing (N, 2) is within a zone."""
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
def seen_shares(outline: FloatArray, sides: FloatArray, ground: Ground, arc: Any, steps: int, deep_m: float) -> Any:
    """The shares of an arc that points (K, 2) of an outline go before one is too deep in floor never seen, and before
    one is over floor that was not seen lately. What the robot covers now is none of it.
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
            # A cell that the robot covers in part is not seen, and no news.
            if old == 1.0 and beside_m > 1.5 * ground.cell_m and (outside or ground.is_old[i, j] == 1):
                old = (n - 1) / steps
            if outside or ground.deep_m[i, j] > deep_m:
                return (n - 1) / steps, old
    return 1.0, old


@kernel
def deepest_m(points: FloatArray, ground: Ground) -> Any:
    """How deep in floor never seen the deepest of points (N, 2) of a robot is; infinite beyond what is known."""
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


# Compiled: what is remembered of the floor about a robot, in cells that are found again by their numbers.


class Memory(NamedTuple):
    """A square window that moves with the robot: cell (i, j) of the plane is kept at (i mod n, j mod n).

    Attributes:
        numbers: (n, n, 2) i and j of the cell that is kept there.
        seen_s: (n, n) when its floor was last seen to be free, or the robot was led over it; minus infinity: never.
        looked_s: (n, n) when a camera last saw its floor, or through the air over it; likewise.
        hit_s: (n, n) when a thing was last seen in it; minus infinity: none is there.
        hits: (n, n, 4) where the thing is, how near to a camera it would show, and the way driven until then, metres.
        cell_m: side of a cell.
    """

    numbers: IntArray
    seen_s: FloatArray
    looked_s: FloatArray
    hit_s: FloatArray
    hits: FloatArray
    cell_m: float


class Sight(NamedTuple):
    """A camera's view of the floor, from x and y in the plane.

    Attributes:
        x, y: where the camera is.
        first_rad: bearing in the plane of the first column's left end.
        step_rad: from one column to the next.
        air_m: nearer nothing is looked through.
        near_m: nearer nothing of the floor is seen.
        far_m: farther no column sees.
        seen_m: (B,) how far each column sees through.
        stamp_s: when.
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
    """Where cell (i, j) is kept; emptied, where another was."""
    n = len(memory.seen_s)
    a, b = i % n, j % n
    if memory.numbers[a, b, 0] != i or memory.numbers[a, b, 1] != j:
        memory.numbers[a, b, 0], memory.numbers[a, b, 1] = i, j
        memory.seen_s[a, b] = -np.inf
        memory.looked_s[a, b] = -np.inf
        memory.hit_s[a, b] = -np.inf
    return a, b


@kernel
def look(memory: Memory, sight: Sight, x: float, y: float) -> None:
    """Mark what a camera sees through, and forget the things that were there; window about (x, y)."""
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
                # A thing lower than the lowest ray is not seen through, however far the camera sees over it.
                near_m = min(sight.near_m, memory.hits[a, b, 2])
                if _is_seen(sight, memory.hits[a, b, 0], memory.hits[a, b, 1], cell, near_m):
                    memory.hit_s[a, b] = -np.inf


@kernel
def _bounds(sight: Sight) -> Any:
    """The least and the most x and y that a camera sees."""
    left, right, below, above = sight.x, sight.x, sight.y, sight.y
    # An arc between two columns' edges reaches out beyond both.
    far_m = sight.far_m / np.cos(min(sight.step_rad / 2, 1.0))
    for k in range(len(sight.seen_m) + 1):
        bearing = sight.first_rad + k * sight.step_rad
        px, py = sight.x + far_m * np.cos(bearing), sight.y + far_m * np.sin(bearing)
        left, right, below, above = min(left, px), max(right, px), min(below, py), max(above, py)
    return left, right, below, above


@kernel
def _is_seen(sight: Sight, x: float, y: float, short_m: float, near_m: float) -> Any:
    """Whether a column sees farther than a point, by more than `short_m`, that is not nearer than `near_m`."""
    dx, dy = x - sight.x, y - sight.y
    away = np.sqrt(dx * dx + dy * dy)
    if away < near_m or away > sight.far_m:
        return False
    bearing = (np.arctan2(dy, dx) - sight.first_rad) % (2 * np.pi)
    column = int(bearing / sight.step_rad)
    return column < len(sight.seen_m) and away <= sight.seen_m[column] - short_m


@kernel
def keep(memory: Memory, points: FloatArray, shows_m: FloatArray, stamp_s: float, middle: Any, way_m: float) -> None:
    """Remember things at points (N, 2) in the plane, those within the window about a middle, after so much way; so near
    to a camera (N,) they would show.
    """
    reach = (len(memory.seen_s) // 2 - 1) * memory.cell_m
    for k in range(len(points)):
        x, y = points[k, 0], points[k, 1]
        if abs(x - middle[0]) < reach and abs(y - middle[1]) < reach:
            a, b = slot(memory, int(np.floor(x / memory.cell_m)), int(np.floor(y / memory.cell_m)))
            memory.hit_s[a, b] = stamp_s
            memory.hits[a, b, 0], memory.hits[a, b, 1] = x, y
            memory.hits[a, b, 2], memory.hits[a, b, 3] = shows_m[k], way_m


@kernel
def mark_under(memory: Memory, sides: FloatArray, pose: Any, stamp_s: float, from_m: float) -> None:
    """Mark the floor under an outline (sides as `Outline` has them), so far ahead of the axle and on, as seen.

    All of an outline is looked at, too: nobody asks for that who has not looked. What only its front was led over is
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
    """Things seen since a time and a way, in the frame of a pose, within its reach, and when, into (M, 3); how many."""
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
                out[found, 2] = memory.hit_s[a, b]
                found += 1
    return found


@kernel
def unseen(memory: Memory, first: Any, since_s: float, out: ByteArray) -> None:
    """Of a square of cells from the first (i, j) on, into (m, m, 3): 1 where floor was never seen, not since, and never
    looked at.
    """
    for i in range(len(out)):
        for j in range(len(out)):
            a, b = slot(memory, first[0] + i, first[1] + j)
            out[i, j, 0] = 1 if memory.seen_s[a, b] == -np.inf else 0
            out[i, j, 1] = 1 if memory.seen_s[a, b] < since_s else 0
            out[i, j, 2] = 1 if memory.looked_s[a, b] == -np.inf else 0
