"""How a building is lit: lamps in and under the ceiling, windows on one side, light from all round."""

from __future__ import annotations

import zlib
from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from wheelsight.geometry import ByteArray, Float32Array, FloatArray
from wheelsight.simulation import _light_kernels as kernels
from wheelsight.simulation.view import Geoms
from wheelsight.simulation.world import Surface

_USUAL_CEILING_M = 2.6
_PANELS_TO_NEXT_LAMP = 3
_LAMP_RIM_M = 0.03
_LAMP_GLOW = 5.0
LAMP_REACH_M = 5.0
_NEAREST_LAMP_M = 0.4
_FLUX_CELL_M = 0.3
_CLEARANCE_CELL_M = 0.1
_LAYERS = 4
_LARGEST_M = 200.0
_ON_FLOOR_M, _LOWEST_M, _TALL_M = 0.3, 0.1, 1.8
_PLANE, _BOX = 0, 6


@dataclass(frozen=True, slots=True, eq=False)
class Lighting:
    """What the painter's kernels need to know of the light.

    Attributes:
        tints: (3, 3) rows: light from all round, of lamps, of windows; columns: red, green, blue.
        sun: (3,) unit vector towards the windows.
        grid: (6,) x and y of the tables' first cell, size of a cell in `flux` and in `clearance`, distance between
            the layers of `flux`, height of the ceiling, metres.
        flux: (Z, Y, X, 4) vector towards the lamps, as long as they are bright, and the sum of their brightness.
        clearance: (2, Y, X) metres to what stands on the floor, and to what stands there and is tall.
        lattice: (5,) lamps in ceilings of panels: pitch, half lengths in x and y, glow, seed of their ages.
        lamps: (L, 6) all lamps: position, power, half lengths in x and y.
    """

    tints: FloatArray
    sun: FloatArray
    grid: FloatArray
    flux: Float32Array
    clearance: Float32Array
    lattice: FloatArray
    lamps: FloatArray

    @classmethod
    def of(cls, geoms: Geoms, looks: Sequence[Surface], seed: int) -> Lighting:
        """Level, colour temperature, the windows' side and the lamps' ages by a seed; lamps where the scene has them.

        Those are what glows, and a lattice in ceilings of panels.
        """
        rng = np.random.default_rng([seed & 0xFFFFFFFF, zlib.crc32(b"light")])
        level, warmth = rng.uniform(0.75, 1.25), rng.uniform(-1.0, 1.0)
        # Lamps of about 3000 K to 5500 K, seen by a camera balanced between them; skylight is bluer.
        lamp, sky = np.array([1 + 0.08 * warmth, 1.0, 1 - 0.11 * warmth]), np.array([0.94, 1.0, 1.08])
        strengths = rng.uniform([0.38, 0.55, 0.05], [0.5, 0.75, 0.22])
        azimuth = rng.uniform(0, 2 * np.pi)
        tints = level * strengths[:, None] * np.array([0.5 * (lamp + 1), lamp, sky])
        sun = np.array([np.cos(azimuth), np.sin(azimuth), 0.25]) / np.hypot(1, 0.25)

        ceilings = [g for g, look in enumerate(looks) if look.kind == "ceiling"]
        heights = [_underside_m(geoms, g) for g in ceilings]
        panel_m = looks[ceilings[0]].scale_m if ceilings else 1.0
        half = max(0.5 * panel_m - _LAMP_RIM_M, 0.2 * panel_m)
        lattice = np.array([_PANELS_TO_NEXT_LAMP * panel_m, half, half, _LAMP_GLOW, float(rng.integers(2**31))])
        low, high = _extent(geoms)
        ceiling_m = min(heights, default=_USUAL_CEILING_M)
        lamps = np.concatenate([_glowing(geoms, looks), *(_in_ceiling(geoms, g, lattice, low, high) for g in ceilings)])
        grid = np.array([*low, _FLUX_CELL_M, _CLEARANCE_CELL_M, ceiling_m / (_LAYERS - 1), ceiling_m])
        return cls(tints, sun, grid, _flux(lamps, grid, high), _clearance(geoms, grid, high), lattice, lamps)


def _underside_m(geoms: Geoms, g: int) -> float:
    thickness = abs(geoms.R_world_geom[g, 2]) @ geoms.size_m[g] if geoms.kind[g] == _BOX else 0.0
    return float(geoms.position_world[g, 2] - thickness)


def _half_m(geoms: Geoms, g: int) -> FloatArray:
    """Half lengths (3,) of the box along the world's axes around a geom; of planes only those along it."""
    size = geoms.size_m[g].copy()
    if geoms.kind[g] == _PLANE:
        size[2] = 0.0
    elif geoms.kind[g] not in (_BOX, 4):
        size = np.array([size[0], size[0], size[0] if geoms.kind[g] == 2 else size[1]])
    return np.asarray(abs(geoms.R_world_geom[g]) @ size, float)


def _extent(geoms: Geoms) -> tuple[FloatArray, FloatArray]:
    """Least and largest x and y (2,) of all geoms, half a metre further, and not beyond what a building measures."""
    half = np.array([_half_m(geoms, g)[:2] for g in range(len(geoms.names))]).reshape(-1, 2)
    low, high = geoms.position_world[:, :2] - half, geoms.position_world[:, :2] + half
    if not len(half):
        return np.full(2, -1.0), np.full(2, 1.0)
    low, high = low.min(axis=0) - 0.5, high.max(axis=0) + 0.5
    middle = 0.5 * (low + high)
    return np.maximum(low, middle - _LARGEST_M / 2), np.minimum(high, middle + _LARGEST_M / 2)


def _glowing(geoms: Geoms, looks: Sequence[Surface]) -> FloatArray:
    """Position, power and half lengths (N, 6) of the geoms that glow, of power 1 where they are as a panel's lamp."""
    found = [
        [*geoms.position_world[g], look.glow / _LAMP_GLOW * _area_m2(geoms, g) / 0.3, *_half_m(geoms, g)[:2]]
        for g, look in enumerate(looks)
        if look.glow > 0
    ]
    return np.array(found, float).reshape(-1, 6)


def _area_m2(geoms: Geoms, g: int) -> float:
    half = _half_m(geoms, g)
    return float(4 * half[0] * half[1])


def _in_ceiling(geoms: Geoms, g: int, lattice: FloatArray, low: FloatArray, high: FloatArray) -> FloatArray:
    """Position, power and half lengths (N, 6) of the lattice's lamps that lie in one ceiling."""
    half = _half_m(geoms, g)[:2]
    middle = geoms.position_world[g, :2]
    low, high = np.maximum(low, middle - half), np.minimum(high, middle + half)
    if geoms.kind[g] == _PLANE and not half.all():
        low, high = middle - _LARGEST_M / 8, middle + _LARGEST_M / 8
    first, last = np.ceil(low / lattice[0] - 0.5).astype(int), np.floor(high / lattice[0] - 0.5).astype(int)
    height_m = _underside_m(geoms, g)
    found = [
        [
            *((i + 0.5) * lattice[0], (j + 0.5) * lattice[0], height_m),
            *(kernels.lamp_power(i, j, int(lattice[4])), lattice[1], lattice[2]),
        ]
        for i in range(first[0], last[0] + 1)
        for j in range(first[1], last[1] + 1)
    ]
    return np.array(found, float).reshape(-1, 6)


def _flux(lamps: FloatArray, grid: FloatArray, high: FloatArray) -> Float32Array:
    """The table of light (Z, Y, X, 4); a lamp's light falls with the square of distance, and ends within its reach."""
    columns, rows = (np.ceil((high - grid[:2]) / grid[2]).astype(int) + 1).clip(2)
    x, y = grid[0] + grid[2] * np.arange(columns), grid[1] + grid[2] * np.arange(rows)
    z = grid[4] * np.arange(_LAYERS)
    flux = np.zeros((_LAYERS, rows, columns, 4))
    for lamp in lamps:
        i0, i1 = np.searchsorted(x, [lamp[0] - LAMP_REACH_M, lamp[0] + LAMP_REACH_M])
        j0, j1 = np.searchsorted(y, [lamp[1] - LAMP_REACH_M, lamp[1] + LAMP_REACH_M])
        dx, dy = (lamp[0] - x[i0:i1])[None, None, :], (lamp[1] - y[j0:j1])[None, :, None]
        dz = np.maximum(lamp[2] - z, _NEAREST_LAMP_M)[:, None, None]
        square = dx**2 + dy**2 + dz**2
        window = np.maximum(1 - (dx**2 + dy**2) / LAMP_REACH_M**2, 0) ** 2
        # A lamp in the ceiling sends most straight down; that much of it, times the square of distance, arrives.
        power = lamp[3] * window * dz / (0.3 + square) ** 1.5
        for axis, d in enumerate((dx, dy, dz)):
            flux[:, j0:j1, i0:i1, axis] += power * d / np.sqrt(square)
        flux[:, j0:j1, i0:i1, 3] += power
    return np.ascontiguousarray(flux, np.float32)


def _clearance(geoms: Geoms, grid: FloatArray, high: FloatArray) -> Float32Array:
    """Distances (2, Y, X) on the floor to the nearest thing that stands on it, and to the nearest tall one, metres."""
    columns, rows = (np.ceil((high - grid[:2]) / grid[3]).astype(int) + 1).clip(2)
    free = np.ones((2, rows, columns), np.uint8)
    for g in range(len(geoms.names)):
        bottom, top = geoms.position_world[g, 2] + np.array([-1, 1]) * _half_m(geoms, g)[2]
        if geoms.kind[g] == _PLANE or bottom > _ON_FLOOR_M or top < _LOWEST_M:
            continue
        for level in free if top > _TALL_M else free[:1]:
            _stand(level, geoms, g, grid)
    distances = [cv2.distanceTransform(level, cv2.DIST_L2, 5) * grid[3] for level in free]
    return np.ascontiguousarray(distances, np.float32)


def _stand(level: ByteArray, geoms: Geoms, g: int, grid: FloatArray) -> None:
    """Mark on a map of the floor (Y, X) what a geom covers of it."""
    middle, size = geoms.position_world[g, :2], geoms.size_m[g]
    if geoms.kind[g] == _BOX:
        corners = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]) * size[:2] @ geoms.R_world_geom[g][:2, :2].T + middle
        cv2.fillConvexPoly(level, np.round((corners - grid[:2]) / grid[3]).astype(np.int32), 0)
    else:
        centre = np.round((middle - grid[:2]) / grid[3]).astype(int).tolist()
        cv2.circle(level, centre, round(float(size[0] / grid[3])), 0, -1)
