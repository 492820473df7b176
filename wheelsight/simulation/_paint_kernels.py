"""Compiled painting of a view: where each pixel lies on its geom, what is printed there, and how it is lit."""

from __future__ import annotations

import math
from typing import Any

from numba import njit

from wheelsight.simulation._picture_kernels import books, door, notice_board, poster
from wheelsight.simulation._texture_kernels import (
    carpet,
    ceiling,
    cover,
    fabric,
    hash_unit,
    plaster,
    scaled,
    skirting,
    stripes,
    tiles,
    wood,
)

PLAIN, PLASTER, CARPET, TILES, WOOD, CEILING, DOOR, POSTER, NOTICE_BOARD, FABRIC, BOOKS = range(11)
_CURVED = 3
_LAMP_RADIANCE = 4.0
_FLAT_THING_M = 0.12
_LEAST_FOOTPRINT_M = 1e-4
_MOST_FOOTPRINT_M = 20.0


@njit(cache=True, nogil=True)
def face_of(kind: int, n: Any) -> int:
    """Along which axis of its own a geom shows a face: 0, 1, 2, or 3 where it is curved. `n`: normal in its frame."""
    if kind in (2, 3, 4) or (kind == 5 and abs(n[2]) < 0.9):
        return _CURVED
    if abs(n[2]) >= abs(n[0]) and abs(n[2]) >= abs(n[1]):
        return 2
    return 0 if abs(n[0]) >= abs(n[1]) else 1


@njit(cache=True, nogil=True)
def on_face(face: int, n: Any, p: Any) -> Any:
    """Texture coordinates in metres of a point in the geom's frame; seen from outside, s runs right and t up."""
    if face == 2:
        return p[0], p[1]
    if face == 0:
        return (p[1] if n[0] > 0 else -p[1]), p[2]
    if face == 1:
        return (-p[0] if n[1] > 0 else p[0]), p[2]
    return math.hypot(p[0], p[1]) * math.atan2(p[1], p[0]), p[2]


@njit(cache=True, nogil=True)
def along_face(face: int, p: Any, d: Any) -> Any:
    """How far a small step d in the geom's frame goes along s and t, without sign."""
    if face == 2:
        return abs(d[0]), abs(d[1])
    if face == 0:
        return abs(d[1]), abs(d[2])
    if face == 1:
        return abs(d[0]), abs(d[2])
    radius = max(math.hypot(p[0], p[1]), 1e-6)
    return abs(p[0] * d[1] - p[1] * d[0]) / radius, abs(d[2])


@njit(cache=True, nogil=True)
def pixel_step(n: Any, ray: Any, to_next: Any, depth_m: float) -> Any:
    """From where a ray meets a plane of normal n to where the next pixel's does: ray and `to_next` in n's frame."""
    along = n[0] * ray[0] + n[1] * ray[1] + n[2] * ray[2]
    # At grazing angles the next pixel's ray may miss the plane; the footprint is then as long as it can be.
    along = min(along, -1e-4)
    k = (n[0] * to_next[0] + n[1] * to_next[1] + n[2] * to_next[2]) / along
    return (
        depth_m * (to_next[0] - k * ray[0]),
        depth_m * (to_next[1] - k * ray[1]),
        depth_m * (to_next[2] - k * ray[2]),
    )


@njit(cache=True, nogil=True)
def turned(R: Any, v: Any) -> Any:
    """R v of a (3, 3) matrix and three numbers."""
    return (
        R[0, 0] * v[0] + R[0, 1] * v[1] + R[0, 2] * v[2],
        R[1, 0] * v[0] + R[1, 1] * v[1] + R[1, 2] * v[2],
        R[2, 0] * v[0] + R[2, 1] * v[1] + R[2, 2] * v[2],
    )


@njit(cache=True, nogil=True)
def albedo_at(
    kind: int,
    s: float,
    t: float,
    hs: float,
    ht: float,
    ws: float,
    wt: float,
    rgb: Any,
    accent: Any,
    scale_m: float,
    contrast: float,
    seed: int,
) -> Any:
    """Reflectances of one texture at a point of a face."""
    if kind == PLASTER:
        return plaster(s, t, ws, wt, rgb, contrast, seed)
    if kind == CARPET:
        return carpet(s, t, ws, wt, rgb, accent, scale_m, contrast, seed)
    if kind == TILES:
        return tiles(s, t, ws, wt, rgb, accent, scale_m, contrast, seed)
    if kind == WOOD:
        return wood(s, t, ws, wt, rgb, accent, scale_m, contrast, seed)
    if kind == CEILING:
        return ceiling(s, t, ws, wt, rgb, accent, scale_m, contrast, seed)
    if kind == FABRIC:
        return fabric(s, t, ws, wt, rgb, accent, scale_m, contrast, seed)
    if kind != PLAIN and min(hs, ht) < _FLAT_THING_M:
        return scaled(accent, 0.8)
    if kind == DOOR:
        return door(s, t, hs, ht, ws, wt, rgb, accent, contrast, seed)
    if kind == POSTER:
        return poster(s, t, hs, ht, ws, wt, rgb, accent, contrast, seed)
    if kind == NOTICE_BOARD:
        return notice_board(s, t, hs, ht, ws, wt, rgb, accent, scale_m, contrast, seed)
    if kind == BOOKS:
        return books(s, t, hs, ht, ws, wt, rgb, scale_m, contrast, seed)
    return rgb


@njit(cache=True, nogil=True)
def lamp_power(i: int, j: int, seed: int) -> float:
    """Relative brightness of a lamp of the ceiling's grid: they have aged, and some are switched off."""
    draw = hash_unit(i, j, seed)
    return 0.25 if draw < 0.12 else 0.8 + 0.3 * draw


@njit(cache=True, nogil=True)
def lamp_at(x: float, y: float, wx: float, wy: float, lamps: Any) -> Any:
    """Share of a footprint on the ceiling that is lamp, times its power; `lamps`: pitch, half lengths, height, seed."""
    pitch, half_x, half_y, seed = lamps[0], lamps[1], lamps[2], int(lamps[4])
    i, j = math.floor(x / pitch), math.floor(y / pitch)
    a, b = x - (i + 0.5) * pitch, y - (j + 0.5) * pitch
    share = cover(a, -half_x, half_x, wx) * cover(b, -half_y, half_y, wy)
    if share <= 0:
        return 0.0
    tubes = 0.75 + 0.5 * stripes(a - 0.25 * half_x, 0.5 * half_x, 0.25 * half_x, wx)
    return share * lamp_power(i, j, seed) * tubes


@njit(cache=True, nogil=True)
def lamp_light(p: Any, n: Any, lamps: Any) -> Any:
    """Light of the four nearest lamps of a grid under the ceiling, by Lambert's law; each fades out over one pitch."""
    pitch, height, seed = lamps[0], lamps[3], int(lamps[4])
    a, b = p[0] / pitch - 0.5, p[1] / pitch - 0.5
    i, j = math.floor(a), math.floor(b)
    a, b = a - i, b - j
    rise = max(height - p[2], 0.3)
    total = 0.0
    for di in range(2):
        x = (di - a) * pitch
        share_x = a if di else 1 - a
        for dj in range(2):
            y = (dj - b) * pitch
            share = share_x * (b if dj else 1 - b)
            square = x * x + y * y + rise * rise
            facing = (n[0] * x + n[1] * y + n[2] * rise) / math.sqrt(square)
            # A lamp is no point: what faces away a little is still lit by its far end.
            facing = max(facing + 0.15, 0.0) / 1.15
            total += share * facing * lamp_power(i + di, j + dj, seed) * 2.2 / (0.6 + 0.3 * square)
    return total


@njit(cache=True, nogil=True)
def light_at(p: Any, n: Any, tints: Any, lamps: Any, sun: Any) -> Any:
    """Irradiance over π, three colours: of walls and floor all round, of lamps, and of windows on one side."""
    up = 0.5 + 0.5 * n[2]
    window = max(0.0, n[0] * sun[0] + n[1] * sun[1] + n[2] * sun[2])
    lamp = lamp_light(p, n, lamps)
    shade = 1.0
    if abs(n[2]) < 0.5:
        # Little light reaches the seams where a wall meets floor and ceiling.
        shade -= 0.3 * math.exp(-max(p[2], 0.0) / 0.12) + 0.2 * math.exp(-max(lamps[3] - p[2], 0.0) / 0.15)
    return (
        shade * (tints[0, 0] * (0.8 + 0.2 * up) + tints[1, 0] * lamp + tints[2, 0] * window),
        shade * (tints[0, 1] * (0.8 + 0.2 * up) + tints[1, 1] * lamp + tints[2, 1] * window),
        shade * (tints[0, 2] * (0.8 + 0.2 * up) + tints[1, 2] * lamp + tints[2, 2] * window),
    )


@njit(cache=True, nogil=True)
def paint_rows(
    first: int,
    last: int,
    depth_m: Any,
    geom: Any,
    normal_world: Any,
    T_world_camera: Any,
    rays: Any,
    shape: Any,
    size_m: Any,
    position_world: Any,
    R_geom_world: Any,
    origin: Any,
    looks: Any,
    colours: Any,
    numbers: Any,
    tints: Any,
    lamps: Any,
    sun: Any,
    out: Any,
) -> None:
    """Radiance `out` (H, W, 3) of the rows from first up to last.

    For each geom, `shape` is MuJoCo's type, `origin` (G, 3) where its texture's origin lies in its own frame, `looks`
    (G, 2) the texture's number and its seed, `colours` (G, 2, 3) main and accent, `numbers` (G, 3) scale in metres,
    contrast and shine.
    """
    height, width = depth_m.shape
    for v in range(first, last):
        R_world_camera, p_camera = T_world_camera[v, :3, :3], T_world_camera[v, :3, 3]
        below = v + 1 if v + 1 < height else v - 1
        for u in range(width):
            g, z = geom[v, u], float(depth_m[v, u])
            if g < 0 or z <= 0:
                out[v, u, 0] = out[v, u, 1] = out[v, u, 2] = 0.0
                continue
            beside = u + 1 if u + 1 < width else u - 1
            ray = turned(R_world_camera, (rays[v, u, 0], rays[v, u, 1], rays[v, u, 2]))
            right = (rays[v, beside, 0] - rays[v, u, 0], rays[v, beside, 1] - rays[v, u, 1], 0.0)
            down = (rays[below, u, 0] - rays[v, u, 0], rays[below, u, 1] - rays[v, u, 1], 0.0)
            n = (float(normal_world[v, u, 0]), float(normal_world[v, u, 1]), float(normal_world[v, u, 2]))
            p = (p_camera[0] + z * ray[0], p_camera[1] + z * ray[1], p_camera[2] + z * ray[2])
            step_u = pixel_step(n, ray, turned(R_world_camera, right), z)
            step_v = pixel_step(n, ray, turned(R_world_camera, down), z)
            colour = albedo_on_geom(
                p, n, step_u, step_v, shape[g], size_m[g], position_world[g], R_geom_world[g], origin[g], looks[g],
                colours[g], numbers[g],
            )  # fmt: skip
            light = light_at(p, n, tints, lamps, sun)
            glow = 0.0
            if looks[g, 0] == CEILING and n[2] < -0.9:
                glow = lamp_at(p[0], p[1], abs(step_u[0]) + abs(step_v[0]), abs(step_u[1]) + abs(step_v[1]), lamps)
            for c in range(3):
                out[v, u, c] = colour[c] * light[c] + _LAMP_RADIANCE * glow * tints[1, c]


@njit(cache=True, nogil=True)
def albedo_on_geom(
    p: Any,
    n: Any,
    step_u: Any,
    step_v: Any,
    shape: int,
    size_m: Any,
    position_world: Any,
    R_geom_world: Any,
    origin: Any,
    look: Any,
    colours: Any,
    numbers: Any,
) -> Any:
    """Reflectances at a point p with normal n in the world, over a pixel whose edges there are two steps."""
    kind = int(look[0])
    local = turned(R_geom_world, (p[0] - position_world[0], p[1] - position_world[1], p[2] - position_world[2]))
    normal = turned(R_geom_world, n)
    face = face_of(int(shape), normal)
    ws_u, wt_u = along_face(face, local, turned(R_geom_world, step_u))
    ws_v, wt_v = along_face(face, local, turned(R_geom_world, step_v))
    ws = min(max(ws_u + ws_v, _LEAST_FOOTPRINT_M), _MOST_FOOTPRINT_M)
    wt = min(max(wt_u + wt_v, _LEAST_FOOTPRINT_M), _MOST_FOOTPRINT_M)
    s, t = on_face(face, normal, (local[0] + origin[0], local[1] + origin[1], local[2] + origin[2]))
    hs, ht = size_m[1 if face == 0 else 0], size_m[1 if face == 2 else 2]
    rgb, accent = (colours[0, 0], colours[0, 1], colours[0, 2]), (colours[1, 0], colours[1, 1], colours[1, 2])
    colour = albedo_at(kind, s, t, hs, ht, ws, wt, rgb, accent, numbers[0], numbers[1], int(look[1]))
    if kind == PLASTER and abs(n[2]) < 0.3:
        colour = skirting(colour, accent, p[2], abs(step_u[2]) + abs(step_v[2]))
    return colour
