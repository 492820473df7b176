"""Brown's five coefficients that bend lines as another model of a lens does, by least squares, and how well."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from wheelsight.geometry.arrays import FloatArray


class LensFit(NamedTuple):
    """k1, k2, p1, p2, k3, and the largest distance that is left and the median one, on the plane z = 1."""

    distortion: tuple[float, float, float, float, float]
    worst: float
    median: float


def fitted_lens(xy: ArrayLike, xy_distorted: ArrayLike) -> LensFit:
    """The fit to points on the plane z = 1 and where a lens shows them, both (N, 2); the model is linear in it."""
    seen: FloatArray = np.asarray(xy, float)
    shift: FloatArray = np.asarray(xy_distorted, float) - seen
    x, y = seen.T
    r2 = x**2 + y**2
    rows = np.stack(
        [
            np.stack([x * r2, x * r2**2, 2 * x * y, r2 + 2 * x**2, x * r2**3], axis=1),
            np.stack([y * r2, y * r2**2, r2 + 2 * y**2, 2 * x * y, y * r2**3], axis=1),
        ],
        axis=1,
    )
    found = np.linalg.lstsq(rows.reshape(-1, 5), shift.reshape(-1), rcond=None)[0]
    left = rows @ found - shift
    k1, k2, p1, p2, k3 = (float(k) for k in found)
    off = np.linalg.norm(left, axis=1)
    return LensFit((k1, k2, p1, p2, k3), float(off.max()), float(np.median(off)))
