"""Compiled inner loop that moves surfels with their keyframes."""

from __future__ import annotations

from typing import Any

from wheelsight.compiled import kernel
from wheelsight.mapping._block_kernels import CONFIDENCE, PAGE, Cells, Pages, SurfelArrays
from wheelsight.mapping._fusion_kernels import _has_left


@kernel
def move(
    begin: Any, end: Any, T_new_old: Any, has_moved: Any, surfels: SurfelArrays, pages: Pages, cells: Cells, left: Any
) -> None:
    """Move the surfels of pages `begin` to `end` with their keyframes, and mark in `left` those that left their cell.

    Args:
        T_new_old: (K + 1, 4, 4) by keyframe; the last is of surfels that name none of these.
        has_moved: (K + 1,).
        left: (slots,) bool, all False.
    """
    # Taken out of their tuples once: each time would be counted.
    geometry, keyframe, block_m, cell_xyz = surfels.geometry, surfels.keyframe, cells.block_m, cells.xyz
    fill, page_cell, known = pages.fill, pages.cell, len(has_moved) - 1
    for page in range(begin, end):
        cell = page_cell[page]
        for slot in range(page * PAGE, page * PAGE + fill[page]):
            k = keyframe[slot] if 0 <= keyframe[slot] < known else known
            if not has_moved[k] or geometry[slot, CONFIDENCE] <= 0:
                continue
            x, y, z = geometry[slot, 0], geometry[slot, 1], geometry[slot, 2]
            a, b, c = geometry[slot, 4], geometry[slot, 5], geometry[slot, 6]
            for i in range(3):
                r, s, t = T_new_old[k, i, 0], T_new_old[k, i, 1], T_new_old[k, i, 2]
                geometry[slot, i] = T_new_old[k, i, 3] + r * x + s * y + t * z
                geometry[slot, 4 + i] = r * a + s * b + t * c
            # Not at once: a floor between two blocks would go over and back at each loop.
            left[slot] = _has_left(geometry, slot, cell_xyz, cell, block_m)
