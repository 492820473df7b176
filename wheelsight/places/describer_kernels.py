"""Compiled inner loops of place classification: histograms, layout features and evaluation of a forest."""

from __future__ import annotations

from typing import Any

import numpy as np

from wheelsight.core.compiled import kernel

# Compiled inner loops of places: histograms of a frame, and the way of features down a forest's trees.


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


# LayoutDescriber: a frame sampled on a grid, then described cell by cell.

QUANTILES = (0.2, 0.5, 0.8)
OF_COLOR, OF_DEPTH = 6, 6
_DEPTH_BINS = 64
_RED, _GREEN, _BLUE = 0.299, 0.587, 0.114
_LEAST_DEVIATION = 2.0
_STEEPEST = 0.1


@kernel
def sample_color(color: Any, out: Any) -> Any:
    """Fill `out` (3, h, w) with grey and two chromaticities, red to green and yellow to blue, at the grid's places.

    Grey is standardised over the frame and chromaticities are shares of the brightness, so that neither depends on
    how bright the light is.
    """
    h, w = out.shape[1:]
    total, squares = 0.0, 0.0
    for j in range(h):
        row = (2 * j + 1) * color.shape[0] // (2 * h)
        for i in range(w):
            column = (2 * i + 1) * color.shape[1] // (2 * w)
            red, green, blue = float(color[row, column, 0]), float(color[row, column, 1]), float(color[row, column, 2])
            grey = _RED * red + _GREEN * green + _BLUE * blue
            light = red + green + blue + 1.0
            out[0, j, i], out[1, j, i], out[2, j, i] = grey, (red - green) / light, (red + green - 2 * blue) / light
            total += grey
            squares += grey * grey
    mean = total / (h * w)
    scale = 1 / max(np.sqrt(max(squares / (h * w) - mean * mean, 0.0)), _LEAST_DEVIATION)
    for j in range(h):
        for i in range(w):
            out[0, j, i] = (out[0, j, i] - mean) * scale


@kernel
def sample_depth(depth_m: Any, far_m: float, out: Any) -> Any:
    """Fill `out` (h, w) with the depth at the grid's places, at most `far_m`, 0 where there is none; how many have it.

    A hole of one pixel is filled by the next one that has depth among the four beside it.
    """
    h, w = out.shape
    last_row, last_column = depth_m.shape[0] - 1, depth_m.shape[1] - 1
    found = 0
    for j in range(h):
        row = (2 * j + 1) * depth_m.shape[0] // (2 * h)
        for i in range(w):
            column = (2 * i + 1) * depth_m.shape[1] // (2 * w)
            z = depth_m[row, column]
            if not 0 < z < np.inf:
                z = depth_m[row, min(column + 1, last_column)]
            if not 0 < z < np.inf:
                z = depth_m[row, max(column - 1, 0)]
            if not 0 < z < np.inf:
                z = depth_m[min(row + 1, last_row), column]
            if not 0 < z < np.inf:
                z = depth_m[max(row - 1, 0), column]
            valid = 0 < z < np.inf
            out[j, i] = min(z, far_m) if valid else 0.0
            found += valid
    return found


@kernel
def normals_of(depth_m: Any, focal: float, aspect: float, out: Any) -> Any:
    """Fill `out` (2, h, w) with x and y of unit normals towards the camera; NaN at holes and edges of objects.

    `focal` is the focal length in image widths, `aspect` the image's height in widths. With a = z_u f/z, b = z_v f/z
    and the ray (x, y, 1), the surface's two tangents make the normal (a, b, -(1 + a x + b y)).
    """
    h, w = depth_m.shape
    out[:] = np.nan
    for j in range(1, h - 1):
        y = ((j + 0.5) / h - 0.5) * aspect / focal
        for i in range(1, w - 1):
            z = depth_m[j, i]
            left, right, up, down = depth_m[j, i - 1], depth_m[j, i + 1], depth_m[j - 1, i], depth_m[j + 1, i]
            jump = max(abs(left - z), abs(right - z), abs(up - z), abs(down - z))
            if z == 0 or jump > _STEEPEST * z:
                continue
            a = (right - left) * w * focal / (2 * z)
            b = (down - up) * h * focal / (2 * z * aspect)
            x = ((i + 0.5) / w - 0.5) / focal
            c = 1 + a * x + b * y
            length = np.sqrt(a * a + b * b + c * c)
            out[0, j, i], out[1, j, i] = a / length, b / length


@kernel
def describe_color(samples: Any, out: Any) -> Any:
    """Fill `out` (rows, columns, 6): mean and deviation of grey, its mean step across and down, mean chromaticities."""
    rows, columns = out.shape[:2]
    tall, wide = samples.shape[1] // rows, samples.shape[2] // columns
    n = tall * wide
    for r in range(rows):
        for c in range(columns):
            total, squares, across, down, red, yellow = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
            for j in range(r * tall, (r + 1) * tall):
                for i in range(c * wide, (c + 1) * wide):
                    grey = samples[0, j, i]
                    total += grey
                    squares += grey * grey
                    across += abs(samples[0, j, min(i + 1, samples.shape[2] - 1)] - grey)
                    down += abs(samples[0, min(j + 1, samples.shape[1] - 1), i] - grey)
                    red += samples[1, j, i]
                    yellow += samples[2, j, i]
            mean = total / n
            out[r, c, 0], out[r, c, 1] = mean, np.sqrt(max(squares / n - mean * mean, 0.0))
            out[r, c, 2], out[r, c, 3], out[r, c, 4], out[r, c, 5] = across / n, down / n, red / n, yellow / n


@kernel
def describe_depth(depth_m: Any, normals: Any, far_m: float, out: Any) -> Any:
    """Fill `out` (rows, columns, 6): three quantiles of depth, share of holes, mean x and y of normals."""
    rows, columns = out.shape[:2]
    tall, wide = depth_m.shape[0] // rows, depth_m.shape[1] // columns
    counts = np.empty(_DEPTH_BINS, np.int64)
    for r in range(rows):
        for c in range(columns):
            found = _count(depth_m, r * tall, (r + 1) * tall, c * wide, (c + 1) * wide, far_m, counts)
            for q in range(3):
                out[r, c, q] = _quantile(counts, found, QUANTILES[q], far_m)
            out[r, c, 3] = 1 - found / (tall * wide)
            x, y, n = 0.0, 0.0, 0
            for j in range(r * tall, (r + 1) * tall):
                for i in range(c * wide, (c + 1) * wide):
                    if normals[0, j, i] == normals[0, j, i]:
                        x += normals[0, j, i]
                        y += normals[1, j, i]
                        n += 1
            out[r, c, 4], out[r, c, 5] = x / max(n, 1), y / max(n, 1)


@kernel
def describe_profile(depth_m: Any, far_m: float, out: Any) -> Any:
    """Fill `out` (columns, 2): median and eight tenths of depth in upright strips of the image's middle third.

    About what a laser scanner at the camera's height would see: the walls' distances, little floor or ceiling.
    """
    columns = len(out)
    wide = depth_m.shape[1] // columns
    top, bottom = depth_m.shape[0] // 3, 2 * depth_m.shape[0] // 3
    counts = np.empty(_DEPTH_BINS, np.int64)
    for c in range(columns):
        found = _count(depth_m, top, bottom, c * wide, (c + 1) * wide, far_m, counts)
        out[c, 0] = _quantile(counts, found, 0.5, far_m)
        out[c, 1] = _quantile(counts, found, 0.8, far_m)


@kernel
def describe_whole(samples: Any, depth_m: Any, normals: Any, far_m: float, grey: Any, depth: Any, sides: Any) -> Any:
    """Fill shares of the whole frame: standardised grey (B,), depth (B,) and normals (S, S) by x and y."""
    h, w = depth_m.shape
    share = 1.0 / (h * w)
    bins, side = len(grey), len(sides)
    for j in range(h):
        for i in range(w):
            grey[int(min(max((samples[0, j, i] + 2.5) * bins / 5, 0.0), bins - 1.0))] += share
            if depth_m[j, i] > 0:
                depth[int(min(depth_m[j, i] * bins / far_m, bins - 1.0))] += share
            x = normals[0, j, i]
            if x == x:
                y = normals[1, j, i]
                sides[int(min((y + 1) * side / 2, side - 1.0)), int(min((x + 1) * side / 2, side - 1.0))] += share


@kernel
def _count(depth_m: Any, top: int, bottom: int, left: int, right: int, far_m: float, counts: Any) -> Any:
    counts[:] = 0
    scale = _DEPTH_BINS / far_m
    found = 0
    for j in range(top, bottom):
        for i in range(left, right):
            if depth_m[j, i] > 0:
                counts[min(int(depth_m[j, i] * scale), _DEPTH_BINS - 1)] += 1
                found += 1
    return found


@kernel
def _quantile(counts: Any, found: int, share: float, far_m: float) -> Any:
    """Depth below which `share` of what was found lies, as if spread evenly within a bin; 0 where nothing was."""
    if found == 0:
        return 0.0
    wanted, below = share * found, 0
    for i in range(len(counts)):
        if counts[i] and below + counts[i] >= wanted:
            return (i + (wanted - below) / counts[i]) * far_m / len(counts)
        below += counts[i]
    return far_m
