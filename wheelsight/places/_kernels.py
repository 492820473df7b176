"""Compiled inner loops of places: histograms of a frame, and the way of features down a forest's trees."""

from __future__ import annotations

from typing import Any

import numpy as np

from wheelsight.compiled import kernel

# Rec. 601's weights of red, green and blue, in 256ths.
RED, GREEN, BLUE = 77, 150, 29


@kernel
def count_frame(
    color: Any, depth_m: Any, step_px: int, bin_of_grey: Any, near_m: float, far_m: float, grey: Any, depth: Any
) -> Any:
    """Count every `step_px`th pixel of both images into `grey` (B,) and `depth` (B + 1,), its last for missing.

    Depths outside near_m … far_m count in the end bins. Two tables in turn, since neighbouring pixels often fall into
    one bin, and a counter that was just written is slow to be read.
    """
    tables = np.zeros((2, len(grey)), np.int64)
    for row in range(0, color.shape[0], step_px):
        turn = 0
        for column in range(0, color.shape[1], step_px):
            red, green, blue = color[row, column, 0], color[row, column, 1], color[row, column, 2]
            tables[turn, bin_of_grey[(RED * red + GREEN * green + BLUE * blue) >> 8]] += 1
            turn = 1 - turn
    for i in range(len(grey)):
        grey[i] += tables[0, i] + tables[1, i]
    bins = len(depth) - 1
    scale = bins / (far_m - near_m)
    tables = np.zeros((2, bins + 1), np.int64)
    for row in range(0, depth_m.shape[0], step_px):
        turn = 0
        for column in range(0, depth_m.shape[1], step_px):
            z = depth_m[row, column]
            found = bins
            if 0 < z < np.inf:
                found = int(min(max((z - near_m) * scale, 0.0), bins - 1.0))
            tables[turn, found] += 1
            turn = 1 - turn
    for i in range(bins + 1):
        depth[i] += tables[0, i] + tables[1, i]


@kernel
def mean_of_leaves(features: Any, roots: Any, left: Any, right: Any, feature: Any, threshold: Any, share: Any) -> Any:
    """Mean over trees (A,) of the distribution in the leaf that features (D,) reach (Trinh et al., eq. 7).

    Trees lie one after the other in flat arrays of nodes (M,); `left` is -1 in leaves, `share` is (M, A).
    """
    total = np.zeros(share.shape[1])
    for tree in range(len(roots)):
        node = roots[tree]
        while left[node] >= 0:
            node = left[node] if features[feature[node]] <= threshold[node] else right[node]
        for area in range(len(total)):
            total[area] += share[node, area]
    return total / len(roots)


@kernel
def means_of_leaves(features: Any, roots: Any, left: Any, right: Any, feature: Any, threshold: Any, share: Any) -> Any:
    """`mean_of_leaves` of many: features (N, D) to (N, A)."""
    means = np.empty((len(features), share.shape[1]))
    for i in range(len(features)):
        means[i] = mean_of_leaves(features[i], roots, left, right, feature, threshold, share)
    return means
