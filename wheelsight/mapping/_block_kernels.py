"""Compiled inner loops of blocks: which cell of space holds which pages of surfels, and which cells are in view.

Slots of surfels come in pages of PAGE. A cell of space owns a chain of pages; only the last of a chain has room.
A surfel whose confidence is not positive is dead: it is passed over until its cell is compacted.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from wheelsight.compiled import kernel

# Small, for few surfels are all that some cells hold, and a page is theirs alone. The other kernels of this folder are
# compiled with it, and numba's cache looks at their own files only: who changes it saves those anew.
PAGE = 32
# Columns of a surfel's geometry.
RADIUS, CONFIDENCE = 3, 7
# How far a surfel may stray from the cell it was made in.
STRAY_M = 0.05
# Entries of the counters.
CELLS, FREE, PAGES, ALIVE = 0, 1, 2, 3


@kernel(inline="always")
def _hash(x: Any, y: Any, z: Any, size: Any) -> Any:
    h = (int(x) * 73856093) ^ (int(y) * 19349663) ^ (int(z) * 83492791)
    h ^= (h >> 15) & 0x1FFFF
    return (h * 0x9E3779B1) >> 7 & (size - 1)


@kernel
def find_cell(table: Any, cell_xyz: Any, x: Any, y: Any, z: Any) -> Any:
    """The cell at a place, or -(1 + where in the table it belongs)."""
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
        k = -1 - find_cell(table, cell_xyz, cell_xyz[cell, 0], cell_xyz[cell, 1], cell_xyz[cell, 2])
        table[k] = cell


@kernel
def append(
    new: Any,
    new_look: Any,
    new_seen_s: Any,
    new_variance: Any,
    begin: Any,
    block_m: Any,
    geometry: Any,
    look: Any,
    seen_s: Any,
    variance: Any,
    page_next: Any,
    page_fill: Any,
    page_cell: Any,
    free: Any,
    cell_xyz: Any,
    cell_pages: Any,
    cell_seen_s: Any,
    table: Any,
    counters: Any,
) -> Any:
    """Put new surfels, from number `begin` on, into their cells; the number of the first that found no room."""
    for i in range(begin, len(new)):
        x = int(np.floor(new[i, 0] / block_m))
        y = int(np.floor(new[i, 1] / block_m))
        z = int(np.floor(new[i, 2] / block_m))
        cell = find_cell(table, cell_xyz, x, y, z)
        if cell < 0:
            if counters[CELLS] == len(cell_xyz) or 2 * counters[CELLS] >= len(table):
                return i
            table[-1 - cell] = counters[CELLS]
            cell = counters[CELLS]
            counters[CELLS] += 1
            cell_xyz[cell, 0], cell_xyz[cell, 1], cell_xyz[cell, 2] = x, y, z
            cell_pages[cell, 0] = cell_pages[cell, 1] = -1
            cell_seen_s[cell] = -np.inf
        page = cell_pages[cell, 1]
        if page < 0 or page_fill[page] == PAGE:
            page = _new_page(cell, page_next, page_fill, page_cell, free, cell_pages, counters)
            if page < 0:
                return i
        slot = page * PAGE + page_fill[page]
        page_fill[page] += 1
        _copy(i, slot, new, new_look, new_seen_s, new_variance, geometry, look, seen_s, variance)
        cell_seen_s[cell] = max(cell_seen_s[cell], new_seen_s[i, 1])
        counters[ALIVE] += 1
    return len(new)


@kernel(inline="always")
def _copy(
    i: Any, j: Any, geometry: Any, look: Any, seen_s: Any, variance: Any, to: Any, to_look: Any, to_s: Any, to_var: Any
) -> None:
    """Copy surfel i of some arrays to place j of others, number by number: views of rows would be counted."""
    for k in range(8):
        to[j, k] = geometry[i, k]
    for k in range(4):
        to_look[j, k] = look[i, k]
    to_s[j, 0], to_s[j, 1], to_var[j] = seen_s[i, 0], seen_s[i, 1], variance[i]


@kernel
def _new_page(cell: Any, page_next: Any, page_fill: Any, page_cell: Any, free: Any, pages: Any, counters: Any) -> Any:
    """A page at the end of a cell's chain; -1 where there is none left."""
    if counters[FREE] > 0:
        counters[FREE] -= 1
        page = free[counters[FREE]]
    elif counters[PAGES] < len(page_next):
        page = counters[PAGES]
        counters[PAGES] += 1
    else:
        return -1
    page_next[page], page_fill[page], page_cell[page] = -1, 0, cell
    if pages[cell, 1] < 0:
        pages[cell, 0] = page
    else:
        page_next[pages[cell, 1]] = page
    pages[cell, 1] = page
    return int(page)


@kernel
def pages_in_view(
    T: Any,
    grid: Any,
    width: Any,
    height: Any,
    far_m: Any,
    since_s: Any,
    block_m: Any,
    cell_xyz: Any,
    cell_pages: Any,
    cell_seen_s: Any,
    page_next: Any,
    table: Any,
    out: Any,
) -> Any:
    """Write the pages of all cells that may be seen into `out`; how many.

    Args:
        T: (4, 4) T_map_camera. grid: fx, fy, cx, cy.
        since_s: cells of which nothing was seen since are left out.
    """
    low, high = _frustum_box(T, grid, width, height, far_m)
    reach = np.sqrt(3.0) * 0.5 * block_m + STRAY_M
    count = 0
    first = np.floor((low - STRAY_M) / block_m).astype(np.int64)
    last = np.floor((high + STRAY_M) / block_m).astype(np.int64)
    for x in range(first[0], last[0] + 1):
        for y in range(first[1], last[1] + 1):
            for z in range(first[2], last[2] + 1):
                if not _may_be_seen(T, grid, width, height, far_m, reach, block_m, x, y, z):
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
def _frustum_box(T: Any, grid: Any, width: Any, height: Any, far_m: Any) -> Any:
    """Lowest and highest coordinates (3,) of the camera's centre and the four far corners of its view."""
    low, high = T[:3, 3].copy(), T[:3, 3].copy()
    for u in (-0.5, width - 0.5):
        for v in (-0.5, height - 0.5):
            x, y = (u - grid[2]) / grid[0] * far_m, (v - grid[3]) / grid[1] * far_m
            for k in range(3):
                p = T[k, 0] * x + T[k, 1] * y + T[k, 2] * far_m + T[k, 3]
                low[k], high[k] = min(low[k], p), max(high[k], p)
    return low, high


@kernel
def _may_be_seen(
    T: Any, grid: Any, width: Any, height: Any, far_m: Any, reach: Any, block_m: Any, x: Any, y: Any, z: Any
) -> Any:
    """Whether the ball of radius `reach` about a cell's middle meets the frustum's planes."""
    a, b, c = (x + 0.5) * block_m - T[0, 3], (y + 0.5) * block_m - T[1, 3], (z + 0.5) * block_m - T[2, 3]
    depth = T[0, 2] * a + T[1, 2] * b + T[2, 2] * c
    if depth < -reach or depth > far_m + reach:
        return False
    right, down = T[0, 0] * a + T[1, 0] * b + T[2, 0] * c, T[0, 1] * a + T[1, 1] * b + T[2, 1] * c
    west, east = (grid[2] + 0.5) / grid[0], (width - 0.5 - grid[2]) / grid[0]
    north, south = (grid[3] + 0.5) / grid[1], (height - 0.5 - grid[3]) / grid[1]
    return bool(
        right + west * depth > -reach * np.sqrt(1 + west * west)
        and -right + east * depth > -reach * np.sqrt(1 + east * east)
        and down + north * depth > -reach * np.sqrt(1 + north * north)
        and -down + south * depth > -reach * np.sqrt(1 + south * south)
    )


@kernel
def usefulness(confidence: Any, age_s: Any, active_s: Any) -> Any:
    """Surfels seen often and lately are of use."""
    return confidence / (1.0 + age_s / active_s)


@kernel
def usefulness_bin(confidence: Any, age_s: Any, active_s: Any, bins: Any) -> Any:
    """The bin, from the least useful up, on a logarithmic scale from 1e-4 to 1e3."""
    share = (np.log10(max(usefulness(confidence, age_s, active_s), 1e-4)) + 4.0) / 7.0
    return min(int(share * bins), bins - 1)


@kernel
def count_usefulness(
    geometry: Any, seen_s: Any, page_fill: Any, pages: Any, now_s: Any, active_s: Any, out: Any
) -> None:
    """Histogram of all surfels alive over `out`'s bins."""
    for page in range(pages):
        for slot in range(page * PAGE, page * PAGE + page_fill[page]):
            if geometry[slot, CONFIDENCE] > 0:
                out[usefulness_bin(geometry[slot, CONFIDENCE], now_s - seen_s[slot, 1], active_s, len(out))] += 1


@kernel
def compact(
    begin: Any,
    end: Any,
    budget: Any,
    now_s: Any,
    rules: Any,
    quota: Any,
    geometry: Any,
    look: Any,
    seen_s: Any,
    variance: Any,
    page_next: Any,
    page_fill: Any,
    free: Any,
    cell_pages: Any,
    cell_seen_s: Any,
    counters: Any,
) -> Any:
    """Close the gaps that dead surfels leave in cells `begin` to `end`, and free pages.

    Returns how many more died here, and the cell to go on with: that after the one in which `budget` surfels had been
    looked at.

    Args:
        rules: confidence of the stable, seconds after which others die, active window in seconds, and seconds for which
            others may go unseen.
        quota: of each bin of usefulness, how many surfels may still be dropped.
    """
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
                    place = to_page * PAGE + to
                    _copy(slot, place, geometry, look, seen_s, variance, geometry, look, seen_s, variance)
                to += 1
                last_s = max(last_s, seen_s[slot, 1])
            page = page_next[page]
        _trim(cell, to_page, to, page_next, page_fill, free, cell_pages, counters)
        cell_seen_s[cell] = last_s
    counters[ALIVE] -= died
    return died, end


@kernel
def _must_go(confidence: Any, first_s: Any, last_s: Any, now_s: Any, rules: Any, quota: Any) -> Any:
    """Whether a surfel's time has come, or its usefulness is among what may still be dropped: `quota` counts it."""
    if confidence < rules[0] and (now_s - first_s > rules[1] or now_s - last_s > rules[3]):
        return True
    if len(quota) == 0:
        return False
    k = usefulness_bin(confidence, now_s - last_s, rules[2], len(quota))
    must_go = quota[k] > 0
    quota[k] -= must_go
    return must_go


@kernel
def _trim(
    cell: Any, last: Any, fill: Any, page_next: Any, page_fill: Any, free: Any, pages: Any, counters: Any
) -> None:
    """End a cell's chain at page `last`, which keeps `fill` surfels, and free what follows."""
    page = pages[cell, 0]
    if page < 0:
        return
    while page != last:
        page_fill[page] = PAGE
        page = page_next[page]
    page_fill[last] = fill
    page = page_next[last]
    if fill == 0:
        pages[cell, 0] = pages[cell, 1] = -1
        page = last
    else:
        pages[cell, 1] = last
        page_next[last] = -1
    while page >= 0:
        following = page_next[page]
        page_fill[page] = 0
        free[counters[FREE]] = page
        counters[FREE] += 1
        page = following
