"""A map as so few points that a page can hold and turn them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from wheelsight.geometry import ByteArray, Float32Array, FloatArray, IntArray
from wheelsight.mapping.export import colors_of
from wheelsight.mapping.values import Parts, Surfels

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


def cloud_of(parts: Parts, most: int) -> MapCloud | None:
    """At most `most` points of a map, evenly over its surfaces; None without surfels.

    Surfels of both sides of a thin wall stay apart: they are told apart by the axis that their normal is nearest to.
    """
    count, low, high = 0, np.full(3, np.inf), np.full(3, -np.inf)
    for surfels in parts():
        count += len(surfels.grey)
        low = np.minimum(low, surfels.position.min(axis=0, initial=np.inf))
        high = np.maximum(high, surfels.position.max(axis=0, initial=-np.inf))
    if not (count and most > 0):
        return None
    if count <= most:
        pieces = [(surfels.position, surfels.normal, colors_of(surfels)) for surfels in parts()]
        position, normal, color = (np.concatenate(column) for column in zip(*pieces, strict=True))
        return MapCloud(position, normal, color, 0.0, count)
    edge_m, cubes = _cubes(parts, (low, max(float((high - low).max()), 1e-6)), most)
    sums, counts = np.zeros((len(cubes), 9)), np.zeros(len(cubes))
    for surfels in parts():
        cube = np.searchsorted(cubes, _keys(surfels, low, edge_m))
        np.add.at(sums, cube, np.hstack([surfels.position, surfels.normal, colors_of(surfels)]).astype(float))
        np.add.at(counts, cube, 1)
    at, facing, mean_color = np.split(sums / counts[:, None], 3, axis=1)
    facing /= np.maximum(np.linalg.norm(facing, axis=1, keepdims=True), 1e-9)
    colors = np.rint(mean_color).astype(np.uint8)
    return MapCloud(at.astype(np.float32), facing.astype(np.float32), colors, edge_m, count)


def _sides(normal: Float32Array) -> IntArray:
    """(n,) from 0 to 5."""
    axis = np.abs(normal).argmax(axis=1)
    return np.asarray(2 * axis + (normal[np.arange(len(normal)), axis] < 0), np.int64)


def _cubes(parts: Parts, within: tuple[FloatArray, float], most: int) -> tuple[float, IntArray]:
    """The shortest edge (but for a step) with which no more than `most` cubes are filled, and their keys in order.

    All lie within so many metres of a lowest corner (3,).
    """
    low, extent_m = within
    steps = int(np.log(2 ** (_COORDINATE_BITS + 1)) / np.log(_STEP)) + 1
    edges_m = extent_m / 2**_COORDINATE_BITS * _STEP ** np.arange(steps)
    first, last = 0, len(edges_m) - 1  # what fills too many cubes, and the shortest edge known not to
    filled = _filled(parts, low, float(edges_m[last]), most)
    while last - first > 1:
        middle = (first + last) // 2
        found = _filled(parts, low, float(edges_m[middle]), most)
        if found is None:
            first = middle
        else:
            last, filled = middle, found
    assert filled is not None
    return float(edges_m[last]), filled


def _filled(parts: Parts, low: FloatArray, edge_m: float, most: int) -> IntArray | None:
    """Keys of all cubes of an edge that are filled, in order; None where there are more than `most`."""
    found = np.zeros(0, np.int64)
    for surfels in parts():
        more = np.unique(_keys(surfels, low, edge_m))
        # Two rows that are in order are merged in one go by this kind of sorting.
        both = np.sort(np.concatenate([found, more]), kind="stable")
        found = both[np.diff(both, prepend=-1) > 0]
        if len(found) > most:
            return None
    return found


def _keys(surfels: Surfels, low: FloatArray, edge_m: float) -> IntArray:
    """(n,) a number of each cube and side; neighbours along z follow each other."""
    cells = np.floor((surfels.position - low) / edge_m).astype(np.int64)
    x, y, z = cells.clip(0, 2**_COORDINATE_BITS - 1).T
    side = _sides(surfels.normal)
    return np.asarray(((x << _COORDINATE_BITS | y) << _COORDINATE_BITS | z) * 8 + side)
