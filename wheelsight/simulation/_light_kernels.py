"""Compiled lighting: what lamps, windows and all that is round about send to a point of a surface."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

from wheelsight.compiled import kernel
from wheelsight.geometry.arrays import Float32Array, FloatArray, Int32Array
from wheelsight.simulation._texture_kernels import cover, hash_unit, stripes

_SPILL = 0.25
_SEAM_M = 0.10
_CORNER_M = 0.3
_STRIDE_PX = 4


class Views(NamedTuple):
    """`View`'s arrays."""

    depth_m: Float32Array
    geom: Int32Array
    normal_world: Float32Array
    T_world_camera: FloatArray
    rays: FloatArray


class Light(NamedTuple):
    """`Lighting`'s arrays but for its lattice."""

    tints: FloatArray
    sun: FloatArray
    grid: FloatArray
    flux: Float32Array
    clearance: Float32Array


@kernel(error_model="numpy")
def lamp_power(i: int, j: int, seed: int) -> Any:
    """Relative brightness of a lamp of the ceiling's lattice: they have aged, and some are switched off."""
    draw = hash_unit(i, j, seed)
    return 0.2 if draw < 0.12 else 0.8 + 0.3 * draw


@kernel(error_model="numpy")
def lamp_at(x: float, y: float, wx: float, wy: float, lattice: Any) -> Any:
    """Mean glow of a footprint on a ceiling of panels: `lattice` is pitch, half lengths in x, y, glow, seed."""
    pitch, half_x, half_y, seed = lattice[0], lattice[1], lattice[2], int(lattice[4])
    i, j = math.floor(x / pitch), math.floor(y / pitch)
    a, b = x - (i + 0.5) * pitch, y - (j + 0.5) * pitch
    share = cover(a, -half_x, half_x, wx) * cover(b, -half_y, half_y, wy)
    if share <= 0:
        return 0.0
    tubes = 0.75 + 0.5 * stripes(a - 0.25 * half_x, 0.5 * half_x, 0.25 * half_x, wx)
    return share * lattice[3] * lamp_power(i, j, seed) * tubes


@kernel(error_model="numpy")
def nine(R: Any) -> Any:
    """A matrix (3, 3) as nine numbers, row by row, which stay in registers."""
    return R[0, 0], R[0, 1], R[0, 2], R[1, 0], R[1, 1], R[1, 2], R[2, 0], R[2, 1], R[2, 2]


@kernel(error_model="numpy")
def turned(R: Any, v: Any) -> Any:
    """R v of a matrix as nine numbers and a vector as three."""
    return (
        R[0] * v[0] + R[1] * v[1] + R[2] * v[2],
        R[3] * v[0] + R[4] * v[1] + R[5] * v[2],
        R[6] * v[0] + R[7] * v[1] + R[8] * v[2],
    )


@kernel(error_model="numpy")
def light_row(v: int, view: Views, light: Light, out: Any) -> None:
    """Irradiance over π into row v of `out` (H, W, 3); `view` and `light` as for `paint_rows`.

    Light changes slowly: along a flat face it is computed for each fourth pixel, and between them interpolated.
    """
    depth_m, geom, normal_world, T_world_camera, rays = view
    tints, sun, grid, flux, clearance = light
    width = depth_m.shape[1]
    R = nine(T_world_camera[v])
    last = -1
    for u in range(width):
        g = geom[v, u]
        if g < 0 or (u % _STRIDE_PX and u != width - 1 and _is_between(v, u, geom, normal_world)):
            continue
        z, ray = float(depth_m[v, u]), turned(R, (rays[v, u, 0], rays[v, u, 1], rays[v, u, 2]))
        n = (float(normal_world[v, u, 0]), float(normal_world[v, u, 1]), float(normal_world[v, u, 2]))
        p = (
            T_world_camera[v, 0, 3] + z * ray[0],
            T_world_camera[v, 1, 3] + z * ray[1],
            T_world_camera[v, 2, 3] + z * ray[2],
        )
        shade, lamp, window = light_at(p, n, sun, grid, flux, clearance)
        for c in range(3):
            out[v, u, c] = tinted(c, shade, lamp, window, tints)
        # What was left out since the last one lies between the two.
        for between in range(last + 1, u):
            k = (between - last) / (u - last)
            if last >= 0 and geom[v, between] >= 0:
                for c in range(3):
                    out[v, between, c] = (1 - k) * out[v, last, c] + k * out[v, u, c]
        last = u


@kernel(error_model="numpy")
def tinted(c: int, shade: float, lamp: float, window: float, tints: Any) -> Any:
    """What comes in one of three colours of the light that `light_at` tells."""
    return shade * (tints[0, c] + tints[1, c] * lamp + tints[2, c] * window)


@kernel(error_model="numpy")
def _is_between(v: int, u: int, geom: Any, normal_world: Any) -> Any:
    """Whether a pixel and the strided ones on both sides of it are all on the same flat face."""
    a = u - u % _STRIDE_PX
    b = min(a + _STRIDE_PX, geom.shape[1] - 1)
    for other in range(a, b + 1):
        if geom[v, other] != geom[v, u]:
            return False
    bend = abs(normal_world[v, a, 0] - normal_world[v, b, 0]) + abs(normal_world[v, a, 1] - normal_world[v, b, 1])
    return bend + abs(normal_world[v, a, 2] - normal_world[v, b, 2]) < 1e-3


@kernel(error_model="numpy")
def light_at(p: Any, n: Any, sun: Any, grid: Any, flux: Any, clearance: Any) -> Any:
    """Shade 0 to 1 of the light from all round, light of lamps, and of windows, at p with normal n, by Lambert's law.

    `grid` is x and y of the tables' first cell, the sizes of a cell in flux and in clearance, flux's layers' distance;
    `flux` (Z, Y, X, 4) is the vector towards the lamps, as long as they are bright, and their sum whatever side they
    are on; `clearance` (2, Y, X) the distance to what stands on the floor, and to what is tall too, metres.
    """
    a, b = (p[0] - grid[0]) / grid[2], (p[1] - grid[1]) / grid[2]
    c = p[2] / grid[4]
    a, b, c = _inside(a, flux.shape[2]), _inside(b, flux.shape[1]), _inside(c, flux.shape[0])
    i, j, k = int(a), int(b), int(c)
    a, b, c = a - i, b - j, c - k
    facing, spill = 0.0, 0.0
    for corner in range(8):
        layer, row, column = corner >> 2, (corner >> 1) & 1, corner & 1
        share = (c if layer else 1 - c) * (b if row else 1 - b) * (a if column else 1 - a)
        layer, row, column = k + layer, j + row, i + column
        facing += share * (
            n[0] * flux[layer, row, column, 0] + n[1] * flux[layer, row, column, 1] + n[2] * flux[layer, row, column, 2]
        )
        spill += share * flux[layer, row, column, 3]
    window = max(0.0, n[0] * sun[0] + n[1] * sun[1] + n[2] * sun[2])
    return _shade(p, n, grid, clearance), max(facing, 0.0) + _SPILL * spill, window


@kernel(error_model="numpy")
def _inside(index: float, count: int) -> Any:
    return min(max(index, 0.0), count - 1.001)


@kernel(error_model="numpy")
def _shade(p: Any, n: Any, grid: Any, clearance: Any) -> Any:
    """How open the surroundings are: little light gets to where walls, floor, ceiling and furniture meet."""
    if abs(n[2]) > 0.5 and (n[2] < 0 or p[2] > 0.05):
        return 1.0 if n[2] > 0 else 0.85
    tall = 0 if n[2] > 0.5 else 1
    reach = tall * _CORNER_M
    a, b = (p[0] + reach * n[0] - grid[0]) / grid[3], (p[1] + reach * n[1] - grid[1]) / grid[3]
    a, b = _inside(a, clearance.shape[2]), _inside(b, clearance.shape[1])
    i, j = int(a), int(b)
    a, b = a - i, b - j
    near = (1 - b) * ((1 - a) * clearance[tall, j, i] + a * clearance[tall, j, i + 1])
    near += b * ((1 - a) * clearance[tall, j + 1, i] + a * clearance[tall, j + 1, i + 1])
    if not tall:
        return 1 - 0.4 / (1 + (near / _SEAM_M) ** 2)
    shade = 1 - 0.3 * max(0.0, 1 - near / _CORNER_M) - 0.3 / (1 + (max(p[2], 0.0) / _SEAM_M) ** 2)
    return shade - 0.2 / (1 + (max(grid[5] - p[2], 0.0) / _SEAM_M) ** 2)
