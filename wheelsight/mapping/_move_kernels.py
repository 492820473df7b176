"""Compiled inner loop that moves surfels with their keyframes."""

from __future__ import annotations

from typing import Any

import numpy as np

from wheelsight.compiled import kernel
from wheelsight.mapping._block_kernels import CONFIDENCE, PAGE, PAGES, Cells, Pages, SurfelArrays


@kernel
def move(T_new_old: Any, has_moved: Any, surfels: SurfelArrays, pages: Pages, cells: Cells, left: Any) -> Any:
    """Move surfels with their keyframes; how many have left their cell, whose slots are the first of `left`.

    Args:
        T_new_old: (K + 1, 4, 4) by keyframe; the last is of surfels that name none of these.
        has_moved: (K + 1,).
        left: (slots,) room.
    """
    geometry, keyframe, count = surfels.geometry, surfels.keyframe, 0
    p, n = np.empty(3), np.empty(3)
    for page in range(cells.counters[PAGES]):
        cell = pages.cell[page]
        for slot in range(page * PAGE, page * PAGE + pages.fill[page]):
            k = keyframe[slot] if 0 <= keyframe[slot] < len(has_moved) - 1 else len(has_moved) - 1
            if not has_moved[k] or geometry[slot, CONFIDENCE] <= 0:
                continue
            for i in range(3):
                p[i], n[i] = T_new_old[k, i, 3], 0.0
                for j in range(3):
                    p[i] += T_new_old[k, i, j] * geometry[slot, j]
                    n[i] += T_new_old[k, i, j] * geometry[slot, 4 + j]
            has_left = False
            for i in range(3):
                geometry[slot, i], geometry[slot, 4 + i] = p[i], n[i]
                has_left |= int(np.floor(geometry[slot, i] / cells.block_m)) != cells.xyz[cell, i]
            if has_left:
                left[count] = slot
                count += 1
    return count
