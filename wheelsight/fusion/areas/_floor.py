"""FloorShares: which share of each point of the floor belongs to which area, and a Gaussian's parts in them."""

from __future__ import annotations

import numpy as np

from wheelsight.areas import AreaMap
from wheelsight.fusion.areas import _kernels as kernels
from wheelsight.geometry import FloatArray

_MOST_SHARES = 4_000_000
_FEWEST_STEPS, _MOST_STEPS = 15, 81


class FloorShares:
    """Areas with soft borders, sampled on a grid.

    Borders are soft because frames name the next area a little before or behind the line that was drawn.

    Args:
        areas: at least one.
        border_m: standard deviation of the Gaussian that the areas are blurred with.
        cell_m: of the grid; larger where the floor is so large that the grid would take too much memory.
    """

    def __init__(self, areas: AreaMap, border_m: float = 0.4, cell_m: float = 0.1) -> None:
        from scipy.ndimage import gaussian_filter

        corners = np.concatenate([area.polygon for area in areas])
        low, high = corners.min(axis=0) - 4 * border_m, corners.max(axis=0) + 4 * border_m
        self._cell_m = max(cell_m, float(np.sqrt(np.prod(high - low) * len(areas) / _MOST_SHARES)))
        # Half a cell off: borders drawn to the decimetre fall between samples, and no area gains by them.
        low = corners.min(axis=0) - (np.ceil(4 * border_m / self._cell_m) + 1.5) * self._cell_m
        high = high + 2 * self._cell_m
        columns, rows = np.ceil((high - low) / self._cell_m).astype(int) + 1
        x, y = (low[axis] + self._cell_m * np.arange(n) for axis, n in enumerate((columns, rows)))
        index = areas.index_at(np.stack(np.meshgrid(x, y), axis=-1))
        sharp = (index[..., None] == np.arange(len(areas))).astype(np.float32)
        blur = border_m / self._cell_m
        self._shares = np.ascontiguousarray(gaussian_filter(sharp, (blur, blur, 0), mode="constant", truncate=4.0))
        self._corner = low

    def parts_of(self, mean: FloatArray, covariance: FloatArray) -> tuple[FloatArray, FloatArray]:
        """A Gaussian's parts in the areas.

        Args:
            mean: (2,) metres.
            covariance: (2, 2) m².

        Returns:
            (A + 1, 6) mass and moments, see `_kernels.parts_in_areas`, and the axes (2, 2) that these are along.
        """
        variances, directions = np.linalg.eigh(covariance)
        sigmas = np.sqrt(np.maximum(variances, 1e-12))
        axes = np.ascontiguousarray(directions * sigmas)
        finest_m = 2.5 * self._cell_m
        steps = np.clip(np.ceil(2 * kernels.REACH * sigmas / finest_m), _FEWEST_STEPS, _MOST_STEPS).astype(int)
        parts = kernels.parts_in_areas(mean, axes, steps[0], steps[1], self._shares, self._corner, self._cell_m)
        return parts, axes


def reweighted(parts: FloatArray, likelihoods: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Mean (2,) and covariance (2, 2), along the axes of the parts, of a Gaussian seen through `likelihoods` (A + 1,).

    The grid's own rounding is taken off: likelihoods that are all alike give mean 0 and covariance 1 exactly.
    """

    def moments(weights: FloatArray) -> tuple[FloatArray, FloatArray]:
        total = weights @ parts
        first, second = total[1:3] / total[0], total[3:6] / total[0]
        return first, np.array([[second[0], second[1]], [second[1], second[2]]]) - np.outer(first, first)

    base_mean, base_covariance = moments(np.ones(len(parts)))
    mean, covariance = moments(likelihoods / likelihoods.max())
    rescale = 1 / np.sqrt(np.diag(base_covariance))
    return (mean - base_mean) * rescale, covariance * np.outer(rescale, rescale)
