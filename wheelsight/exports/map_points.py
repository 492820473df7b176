"""The points of a map, thinned: one for each cube of space."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from wheelsight.errors import MapError
from wheelsight.exports.sources import Exported
from wheelsight.geometry import ByteArray, FloatArray
from wheelsight.mapping import colors_of, load_map


@dataclass(frozen=True, slots=True, eq=False)
class ColoredPoints:
    """Points (N, 3) in the map, metres, and their colours (N, 3), red green blue."""

    p_map: FloatArray
    colors: ByteArray


def points_of(source: Exported, voxel_m: float) -> ColoredPoints | None:
    """Stable surfels of a map, or of all where none is stable, thinned; None where there are none. Raises MapError."""
    surfel_map = None if source.map is None else source.map.surfels()
    if surfel_map is None and source.surfels_file is not None:
        surfel_map = load_map(source.surfels_file)
    if surfel_map is None:
        return None
    surfels = surfel_map.surfels("stable")
    surfels = surfels if len(surfels.grey) else surfel_map.surfels("all")
    if not len(surfels.grey):
        return None
    return thinned(ColoredPoints(surfels.position.astype(float), colors_of(surfels)), voxel_m)


def thinned(points: ColoredPoints, voxel_m: float) -> ColoredPoints:
    """The mean point and colour of each cube of `voxel_m` that holds any. Raises MapError."""
    if not (np.isfinite(voxel_m) and voxel_m > 0):
        raise MapError(f"voxel_m is {voxel_m}, not a positive length")
    cells = np.floor(points.p_map / voxel_m).astype(np.int64)
    _, number, count = np.unique(cells, axis=0, return_inverse=True, return_counts=True)
    sums = np.zeros((len(count), 6))
    np.add.at(sums, number.reshape(-1), np.concatenate([points.p_map, points.colors], axis=1))
    means = sums / count[:, None]
    return ColoredPoints(means[:, :3], np.rint(means[:, 3:]).astype(np.uint8))
