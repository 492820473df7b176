"""Compiled inner loops of blocks: pages of surfels by cells of space, and the cells in view.

Slots of surfels come in pages of PAGE. A cell of space owns a chain of pages; only the last of a chain has room.
A surfel without positive confidence is dead: it is skipped until its cell is compacted.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from wheelsight.core.compiled import kernel

# Small, since some cells have few surfels, and cells do not share a page.
PAGE = 32
# Columns of a surfel's geometry.
RADIUS, CONFIDENCE = 3, 7
# Largest distance of a surfel from the cell in which it was made.
STRAY_M = 0.05
# Entries of the counters.
CELLS, FREE, PAGES, ALIVE = 0, 1, 2, 3


class SurfelArrays(NamedTuple):
    """Surfels by slot, or new ones by number.

    Attributes:
        geometry: (n, 8) float32: position (3), radius, normal (3), confidence; not positive where dead.
        look: (n, 4) float32: red, green, blue, grey from 0 to 255, -1 where unknown.
        seen_s: (n, 2) float64, first and last time seen.
        variance: (n,) float32 of the position along the normal, in m².
        keyframe: (n,) int32 keyframe of the surfel; -1 for none.
    """

    geometry: Any
    look: Any
    seen_s: Any
    variance: Any
    keyframe: Any


class Pages(NamedTuple):
    """Pages of slots.

    Attributes:
        next: (pages,) int32 next page in its cell's chain, -1 at the end.
        fill: (pages,) int32 number of slots with a surfel, dead or alive.
        cell: (pages,) int32 cell that owns it.
        free: (pages,) int32 pages without an owner; the counters have their number.
    """

    next: Any
    fill: Any
    cell: Any
    free: Any


class SurfelCells(NamedTuple):
    """Cells of space.

    Attributes:
        block_m: edge of a cell.
        xyz: (cells, 3) int32 position, in edges.
        pages: (cells, 2) int32 first and last page of its chain, -1 for none.
        seen_s: (cells,) float64 last time that any surfel of it was seen.
        table: (2^k,) int32 by hash, -1 where empty.
        counters: (4,) int64 of cells, free pages, pages ever owned, and surfels alive.
    """

    block_m: Any
    xyz: Any
    pages: Any
    seen_s: Any
    table: Any
    counters: Any


class InView(NamedTuple):
    """Pages that a camera may see: their numbers (n,), and the fill of all pages (pages,)."""

    pages: Any
    fill: Any


class Going(NamedTuple):
    """Rules for removing surfels.

    Attributes:
        now_s: the map's time.
        rules: (4,) confidence of stable surfels, lifetime of others in seconds, active window in seconds, and time
            without observation of others in seconds.
        quota: number of surfels that may still be dropped from each bin of usefulness; or none (0,).
    """

    now_s: Any
    rules: Any
    quota: Any


class Frustum(NamedTuple):
    """View of a camera: T_map_camera (4, 4), fx, fy, cx, cy, the image size, and the largest distance."""

    T: Any
    grid: Any
    width: Any
    height: Any
    far_m: Any


@kernel(inline="always")
def _hash(x: Any, y: Any, z: Any, size: Any) -> Any:
    h = (int(x) * 73856093) ^ (int(y) * 19349663) ^ (int(z) * 83492791)
    h ^= (h >> 15) & 0x1FFFF
    return (h * 0x9E3779B1) >> 7 & (size - 1)


@kernel
def find_cell(table: Any, cell_xyz: Any, x: Any, y: Any, z: Any) -> Any:
    """Return the cell at a position, or -(1 + its place in the table)."""
    k = _hash(x, y, z, len(table))
    while table[k] >= 0:
        cell = table[k]
        if cell_xyz[cell, 0] == x and cell_xyz[cell, 1] == y and cell_xyz[cell, 2] == z:
            return cell
        k = (k + 1) & (len(table) - 1)
    return -1 - k


@kernel
def rebuild_table(table: Any, cell_xyz: Any, cells: int) -> None:
    """Fill an empty table (all -1) with `cells` cells."""
    for cell in range(cells):
        x, y, z = np.int64(cell_xyz[cell, 0]), np.int64(cell_xyz[cell, 1]), np.int64(cell_xyz[cell, 2])
        table[-1 - find_cell(table, cell_xyz, x, y, z)] = cell


@kernel
def append(new: SurfelArrays, begin: Any, surfels: SurfelArrays, pages: Pages, cells: SurfelCells) -> Any:
    """Add new surfels from number `begin` on to their cells; return the number of the first one without room."""
    place, seen_s, page_fill = new.geometry, new.seen_s, pages.fill
    cell_pages, cell_seen_s, block_m = cells.pages, cells.seen_s, cells.block_m
    for i in range(begin, len(place)):
        x = int(np.floor(place[i, 0] / block_m))
        y = int(np.floor(place[i, 1] / block_m))
        z = int(np.floor(place[i, 2] / block_m))
        cell = _cell_at(cells, x, y, z)
        if cell < 0:
            return i
        page = cell_pages[cell, 1]
        if page < 0 or page_fill[page] == PAGE:
            page = _new_page(cell, pages, cells)
            if page < 0:
                return i
        slot = page * PAGE + page_fill[page]
        page_fill[page] += 1
        _copy(i, slot, new, surfels)
        cell_seen_s[cell] = max(cell_seen_s[cell], seen_s[i, 1])
        cells.counters[ALIVE] += 1
    return len(place)


@kernel
def _cell_at(cells: SurfelCells, x: Any, y: Any, z: Any) -> Any:
    """Return the cell at a position, made if it does not exist; -1 without room for it."""
    cell = find_cell(cells.table, cells.xyz, x, y, z)
    if cell >= 0:
        return cell
    made = cells.counters[CELLS]
    if made == len(cells.xyz) or 2 * made >= len(cells.table):
        return -1
    cells.table[-1 - cell] = made
    cells.counters[CELLS] += 1
    cells.xyz[made, 0], cells.xyz[made, 1], cells.xyz[made, 2] = x, y, z
    cells.pages[made, 0] = cells.pages[made, 1] = -1
    cells.seen_s[made] = -np.inf
    return made


@kernel(inline="always")
def _copy(i: Any, j: Any, source: SurfelArrays, to: SurfelArrays) -> None:
    """Copy surfel i to place j of other arrays, number by number: views of rows would be reference-counted."""
    for k in range(8):
        to.geometry[j, k] = source.geometry[i, k]
    for k in range(4):
        to.look[j, k] = source.look[i, k]
    to.seen_s[j, 0], to.seen_s[j, 1] = source.seen_s[i, 0], source.seen_s[i, 1]
    to.variance[j], to.keyframe[j] = source.variance[i], source.keyframe[i]


@kernel
def _new_page(cell: Any, pages: Pages, cells: SurfelCells) -> Any:
    """Return a new page at the end of a cell's chain; -1 if none is left."""
    counters, chain = cells.counters, cells.pages
    if counters[FREE] > 0:
        counters[FREE] -= 1
        page = pages.free[counters[FREE]]
    elif counters[PAGES] < len(pages.next):
        page = counters[PAGES]
        counters[PAGES] += 1
    else:
        return -1
    pages.next[page], pages.fill[page], pages.cell[page] = -1, 0, cell
    if chain[cell, 1] < 0:
        chain[cell, 0] = page
    else:
        pages.next[chain[cell, 1]] = page
    chain[cell, 1] = page
    return int(page)


@kernel
def pages_in_view(view: Frustum, since_s: Any, page_next: Any, cells: SurfelCells, out: Any) -> Any:
    """Write the pages of all cells that may be seen into `out`; return their number.

    Args:
        since_s: cells last seen before are left out.
    """
    # Read from the tuples once: each access would be reference-counted.
    T, far_m, block_m = view.T, view.far_m, cells.block_m
    cell_xyz, cell_pages, cell_seen_s, table = cells.xyz, cells.pages, cells.seen_s, cells.table
    low, high = _frustum_box(view)
    reach = np.sqrt(3.0) * 0.5 * block_m + STRAY_M
    sides, count = _sides(view, reach), 0
    first = np.floor((low - STRAY_M) / block_m).astype(np.int64)
    last = np.floor((high + STRAY_M) / block_m).astype(np.int64)
    _clip(first, last, cell_xyz, cells.counters[CELLS])
    for x in range(first[0], last[0] + 1):
        for y in range(first[1], last[1] + 1):
            for z in range(first[2], last[2] + 1):
                a, b, c = (x + 0.5) * block_m - T[0, 3], (y + 0.5) * block_m - T[1, 3], (z + 0.5) * block_m - T[2, 3]
                if not _may_be_seen(T, a, b, c, far_m, reach, sides):
                    continue
                cell = find_cell(table, cell_xyz, x, y, z)
                if cell < 0 or cell_seen_s[cell] < since_s:
                    continue
                page = cell_pages[cell, 0]
                while page >= 0:
                    out[count] = page
                    count += 1
                    page = page_next[page]
    return count


@kernel
def _clip(first: Any, last: Any, cell_xyz: Any, count: Any) -> None:
    """Clip a box of cells, `first` (3,) to `last` (3,), to the existing ones: a far view would have millions."""
    if count == 0 or (last[0] - first[0]) * (last[1] - first[1]) * (last[2] - first[2]) < count:
        return
    low, high = cell_xyz[0].copy(), cell_xyz[0].copy()
    for i in range(count):
        for k in range(3):
            low[k], high[k] = min(low[k], cell_xyz[i, k]), max(high[k], cell_xyz[i, k])
    for k in range(3):
        first[k], last[k] = max(first[k], low[k]), min(last[k], high[k])


@kernel
def _frustum_box(view: Frustum) -> Any:
    """Return the lowest and highest coordinates (3,) of the camera's centre and the four far corners of its view."""
    T, grid, far_m = view.T, view.grid, view.far_m
    low, high = T[:3, 3].copy(), T[:3, 3].copy()
    for u in (-0.5, view.width - 0.5):
        for v in (-0.5, view.height - 0.5):
            x, y = (u - grid[2]) / grid[0] * far_m, (v - grid[3]) / grid[1] * far_m
            for k in range(3):
                p = T[k, 0] * x + T[k, 1] * y + T[k, 2] * far_m + T[k, 3]
                low[k], high[k] = min(low[k], p), max(high[k], p)
    return low, high


@kernel
def _sides(view: Frustum, reach: Any) -> Any:
    """Return slopes of the frustum's left, right, top and bottom, and limits of a ball's centre beyond each: (4, 2)."""
    grid, sides = view.grid, np.empty((4, 2))
    sides[0, 0], sides[1, 0] = (grid[2] + 0.5) / grid[0], (view.width - 0.5 - grid[2]) / grid[0]
    sides[2, 0], sides[3, 0] = (grid[3] + 0.5) / grid[1], (view.height - 0.5 - grid[3]) / grid[1]
    for k in range(4):
        sides[k, 1] = -reach * np.sqrt(1 + sides[k, 0] * sides[k, 0])
    return sides


@kernel(inline="always")
def _may_be_seen(T: Any, a: Any, b: Any, c: Any, far_m: Any, reach: Any, sides: Any) -> Any:
    """Return whether a ball of radius `reach` meets the frustum; its centre is (a, b, c) from the camera."""
    depth = T[0, 2] * a + T[1, 2] * b + T[2, 2] * c
    if depth < -reach or depth > far_m + reach:
        return False
    right, down = T[0, 0] * a + T[1, 0] * b + T[2, 0] * c, T[0, 1] * a + T[1, 1] * b + T[2, 1] * c
    return bool(
        right + sides[0, 0] * depth > sides[0, 1]
        and -right + sides[1, 0] * depth > sides[1, 1]
        and down + sides[2, 0] * depth > sides[2, 1]
        and -down + sides[3, 0] * depth > sides[3, 1]
    )


@kernel
def usefulness(confidence: Any, age_s: Any, active_s: Any) -> Any:
    """Return the usefulness of a surfel: those seen often and recently are useful."""
    return confidence / (1.0 + age_s / active_s)


@kernel
def usefulness_bin(confidence: Any, age_s: Any, active_s: Any, bins: Any) -> Any:
    """Return the bin, from the least useful up, on a logarithmic scale from 1e-4 to 1e3."""
    share = (np.log10(max(usefulness(confidence, age_s, active_s), 1e-4)) + 4.0) / 7.0
    return min(int(share * bins), bins - 1)


@kernel
def count_usefulness(
    geometry: Any, seen_s: Any, page_fill: Any, pages: Any, now_s: Any, active_s: Any, out: Any
) -> None:
    """Count all live surfels by bins into `out`."""
    for page in range(pages):
        for slot in range(page * PAGE, page * PAGE + page_fill[page]):
            if geometry[slot, CONFIDENCE] > 0:
                out[usefulness_bin(geometry[slot, CONFIDENCE], now_s - seen_s[slot, 1], active_s, len(out))] += 1


@kernel
def compact(
    begin: Any, end: Any, budget: Any, going: Going, surfels: SurfelArrays, pages: Pages, cells: SurfelCells
) -> Any:
    """Close the gaps of dead surfels in cells `begin` to `end`, and free pages.

    Returns the number of surfels removed here, and the next cell: the one after `budget` surfels were visited.
    `going.quota` counts down.
    """
    page_next, page_fill, cell_pages = pages.next, pages.fill, cells.pages
    geometry, seen_s, now_s, rules, quota = surfels.geometry, surfels.seen_s, going.now_s, going.rules, going.quota
    died, looked_at = 0, 0
    for cell in range(begin, end):
        if looked_at >= budget:
            end = cell
            break
        to_page, to, last_s = cell_pages[cell, 0], 0, -np.inf
        page = to_page
        while page >= 0:
            looked_at += page_fill[page]
            for slot in range(page * PAGE, page * PAGE + page_fill[page]):
                confidence = geometry[slot, CONFIDENCE]
                if confidence <= 0:
                    continue
                if _must_go(confidence, seen_s[slot, 0], seen_s[slot, 1], now_s, rules, quota):
                    died += 1
                    continue
                if to == PAGE:
                    to_page, to = page_next[to_page], 0
                if to_page * PAGE + to != slot:
                    _copy(slot, to_page * PAGE + to, surfels, surfels)
                to += 1
                last_s = max(last_s, seen_s[slot, 1])
            page = page_next[page]
        _trim(cell, to_page, to, pages, cells)
        cells.seen_s[cell] = last_s
    cells.counters[ALIVE] -= died
    return died, end


@kernel
def _must_go(confidence: Any, first_s: Any, last_s: Any, now_s: Any, rules: Any, quota: Any) -> Any:
    """Return whether a surfel has expired, or is dropped for its usefulness: `quota` counts it."""
    if confidence < rules[0] and (now_s - first_s > rules[1] or now_s - last_s > rules[3]):
        return True
    if len(quota) == 0:
        return False
    k = usefulness_bin(confidence, now_s - last_s, rules[2], len(quota))
    must_go = quota[k] > 0
    quota[k] -= must_go
    return must_go


@kernel
def _trim(cell: Any, last: Any, fill: Any, pages: Pages, cells: SurfelCells) -> None:
    """End a cell's chain at page `last`, which keeps `fill` surfels, and free the pages after it."""
    page_next, page_fill, chain, counters = pages.next, pages.fill, cells.pages, cells.counters
    page = chain[cell, 0]
    if page < 0:
        return
    while page != last:
        page_fill[page] = PAGE
        page = page_next[page]
    page_fill[last] = fill
    page = page_next[last]
    if fill == 0:
        chain[cell, 0] = chain[cell, 1] = -1
        page = last
    else:
        chain[cell, 1] = last
        page_next[last] = -1
    while page >= 0:
        following = page_next[page]
        page_fill[page] = 0
        pages.free[counters[FREE]] = page
        counters[FREE] += 1
        page = following
