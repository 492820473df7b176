"""Compiled: what is remembered of the floor about a robot, in cells that are found again by their numbers."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from wheelsight.compiled import kernel
from wheelsight.geometry.arrays import ByteArray, FloatArray, IntArray
from wheelsight.navigation._sweep_kernels import outside_m


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
