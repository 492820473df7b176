"""A map as so few points that a page can hold and turn them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from wheelsight.geometry import ByteArray, Float32Array, FloatArray, IntArray
from wheelsight.mapping.export import colors_of
from wheelsight.mapping.values import Surfels

# Edges of cubes are tried in steps of so much; a finer one would find hardly any more room for points.
_STEP = 1.1
# Keys are 64 bits: 20 for each coordinate, and 3 for the side that a surfel is seen from.
_COORDINATE_BITS = 20


@dataclass(frozen=True, slots=True, eq=False)
class MapCloud:
    """Points of a map, each the mean of the surfels that lie in one cube and are seen from one side.

    Attributes:
        position: (n, 3) float32 in metres, in the map frame.
        normal: (n, 3) float32 of length 1, towards where they were seen from.
        color: (n, 3) uint8 red, green, blue.
        edge_m: of the cubes; 0 where each point is a surfel.
        of: how many surfels there were.
    """

    position: Float32Array
    normal: Float32Array
    color: ByteArray
    edge_m: float
    of: int

    def __len__(self) -> int:
        return len(self.position)


def cloud_of(surfels: Surfels, most: int) -> MapCloud | None:
    """At most `most` points of a map, evenly over its surfaces; None without surfels.

    Surfels of both sides of a thin wall stay apart: they are told apart by the axis that their normal is nearest to.
    """
    count = len(surfels.grey)
    if not (count and most > 0):
        return None
    if count <= most:
        return MapCloud(surfels.position, surfels.normal, colors_of(surfels), 0.0, count)
    side = _sides(surfels.normal)
    edge_m, cube = _cubes(surfels.position.astype(float), side, most)
    position, normal = _means(surfels.position, cube), _means(surfels.normal, cube)
    normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-9)
    colors = np.rint(_means(colors_of(surfels), cube)).astype(np.uint8)
    return MapCloud(position.astype(np.float32), normal.astype(np.float32), colors, edge_m, count)


def _sides(normal: Float32Array) -> IntArray:
    """(n,) from 0 to 5."""
    axis = np.abs(normal).argmax(axis=1)
    return np.asarray(2 * axis + (normal[np.arange(len(normal)), axis] < 0), np.int64)


def _cubes(position: FloatArray, side: IntArray, most: int) -> tuple[float, IntArray]:
    """The shortest edge (but for a step) with which no more than `most` cubes are filled, and (n,) the cube of each."""
    low = position.min(axis=0)
    extent_m = max(float((position.max(axis=0) - low).max()), 1e-6)
    steps = int(np.log(2 ** (_COORDINATE_BITS + 1)) / np.log(_STEP)) + 1
    edges_m = extent_m / 2**_COORDINATE_BITS * _STEP ** np.arange(steps)
    first, last = 0, len(edges_m) - 1  # what fills too many cubes, and the shortest edge known not to
    while last - first > 1:
        middle = (first + last) // 2
        filled = np.sort(_keys(position - low, side, float(edges_m[middle])))
        first, last = (first, middle) if np.count_nonzero(np.diff(filled)) < most else (middle, last)
    cube = np.unique(_keys(position - low, side, float(edges_m[last])), return_inverse=True)[1]
    return float(edges_m[last]), np.asarray(cube, np.int64)


def _keys(offset_m: FloatArray, side: IntArray, edge_m: float) -> IntArray:
    """(n,) a number of each cube and side; neighbours along z follow each other."""
    x, y, z = np.floor(offset_m / edge_m).astype(np.int64).clip(0, 2**_COORDINATE_BITS - 1).T
    return np.asarray(((x << _COORDINATE_BITS | y) << _COORDINATE_BITS | z) * 8 + side)


def _means(values: Float32Array | ByteArray, cube: IntArray) -> FloatArray:
    """(m, 3) of values (n, 3) by cube."""
    counts = np.bincount(cube)
    return np.stack([np.bincount(cube, column) for column in values.T.astype(float)], axis=-1) / counts[:, None]
