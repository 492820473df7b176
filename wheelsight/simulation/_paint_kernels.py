"""Compiled painting of a view: where each pixel lies on its geom, what is printed there, and how it is lit."""

from __future__ import annotations

import math
from typing import Any

from wheelsight.compiled import kernel
from wheelsight.simulation._light_kernels import lamp_at, light_at, light_row, nine, tinted, turned
from wheelsight.simulation._outline_kernels import is_same_face, three
from wheelsight.simulation._picture_kernels import books, door, notice_board, poster
from wheelsight.simulation._texture_kernels import (
    carpet,
    ceiling,
    fabric,
    plaster,
    scaled,
    tiles,
    wood,
)
from wheelsight.simulation._wall_kernels import used_wall

PLAIN, PLASTER, CARPET, TILES, WOOD, CEILING, DOOR, POSTER, NOTICE_BOARD, FABRIC, BOOKS = range(11)
_CURVED = 3
_FLAT_THING_M = 0.12
_LEAST_FOOTPRINT_M = 1e-4
_MOST_FOOTPRINT_M = 20.0


@kernel(error_model="numpy")
def face_of(kind: int, n: Any) -> int:
    """Along which axis of its own a geom shows a face: 0, 1, 2, or 3 where it is curved. `n`: normal in its frame."""
    if kind in (2, 3, 4) or (kind == 5 and abs(n[2]) < 0.9):
        return _CURVED
    if abs(n[2]) >= abs(n[0]) and abs(n[2]) >= abs(n[1]):
        return 2
    return 0 if abs(n[0]) >= abs(n[1]) else 1


@kernel(error_model="numpy")
def on_face(face: int, n: Any, p: Any) -> Any:
    """Texture coordinates in metres of a point in the geom's frame; seen from outside, s runs right and t up."""
    if face == 2:
        return p[0], p[1]
    if face == 0:
        return (p[1] if n[0] > 0 else -p[1]), p[2]
    if face == 1:
        return (-p[0] if n[1] > 0 else p[0]), p[2]
    return math.hypot(p[0], p[1]) * math.atan2(p[1], p[0]), p[2]


@kernel(error_model="numpy")
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


@kernel(error_model="numpy")
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


@kernel(error_model="numpy")
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


@kernel(error_model="numpy")
def paint_rows(first: int, last: int, view: Any, geoms: Any, light: Any, lattice: Any, out: Any) -> None:
    """Radiance `out` (H, W, 3) of the rows from first up to last.

    `view` is `View`'s arrays in their order. `geoms` is of each geom MuJoCo's type and size, middle and orientation,
    where its texture's origin lies in its own frame (G, 3), its texture's number and seed (G, 2), main and accent
    colour (G, 6), and scale in metres, contrast and glow (G, 3). `light` and `lattice` are `Lighting`'s.
    """
    depth_m, geom, normal_world, T_world_camera, rays = view
    width = depth_m.shape[1]
    looks, numbers = geoms[5], geoms[7]
    for v in range(first, last):
        R_world_camera, origin = nine(T_world_camera[v]), place(T_world_camera, v)
        light_row(v, view, light, out)
        for u in range(width):
            g, z = geom[v, u], float(depth_m[v, u])
            if g < 0 or z <= 0:
                out[v, u, 0] = out[v, u, 1] = out[v, u, 2] = 0.0
                continue
            ray, n = turned(R_world_camera, three(rays, v, u)), three(normal_world, v, u)
            p = (origin[0] + z * ray[0], origin[1] + z * ray[1], origin[2] + z * ray[2])
            beside, below = to_neighbours(v, u, rays, R_world_camera)
            step_u, step_v = pixel_step(n, ray, beside, z), pixel_step(n, ray, below, z)
            r, e, b = albedo_on_geom(g, p, n, step_u, step_v, geoms)
            glow = glow_of(g, p, n, step_u, step_v, looks, numbers, lattice)
            out[v, u, 0] *= r
            out[v, u, 1] *= e
            out[v, u, 2] *= b
            if glow > 0:
                for c in range(3):
                    out[v, u, c] += glow * light[0][1, c]


@kernel(error_model="numpy")
def paint_outlines(
    first: int, last: int, pixels: Any, samples: Any, view: Any, geoms: Any, light: Any, lattice: Any, out: Any
) -> None:
    """Put into `out` (H, W, 3) the mean radiance over each of the `pixels` (N, 2), from first up to last.

    `samples` is `Outlines`'s view as arrays; the others are as for `paint_rows`, which has painted `out` by the ray
    through each pixel's middle. Samples on the face which that ray met have its colour: textures are averaged over the
    pixel already.
    """
    depth_m, geom, normal_world, T_world_camera, rays = samples
    seen, facing, middles = view[1], view[2], view[4]
    share = 1 / (depth_m.shape[1] + 1)
    for i in range(first, last):
        v, u = pixels[i]
        R_world_camera, origin = nine(T_world_camera[i]), place(T_world_camera, i)
        beside, below = to_neighbours(v, u, middles, R_world_camera)
        own = three(out, v, u)
        red, green, blue = own
        for s in range(depth_m.shape[1]):
            g, z, n = geom[i, s], float(depth_m[i, s]), three(normal_world, i, s)
            r, e, b = 0.0, 0.0, 0.0
            if is_same_face(seen[v, u], three(facing, v, u), g, n):
                r, e, b = own
            elif g >= 0 and z > 0:
                ray = turned(R_world_camera, three(rays, i, s))
                p = (origin[0] + z * ray[0], origin[1] + z * ray[1], origin[2] + z * ray[2])
                step_u, step_v = pixel_step(n, ray, beside, z), pixel_step(n, ray, below, z)
                r, e, b = radiance_of(g, p, n, step_u, step_v, geoms, light, lattice)
            red, green, blue = red + r, green + e, blue + b
        out[v, u, 0], out[v, u, 1], out[v, u, 2] = share * red, share * green, share * blue


@kernel(error_model="numpy")
def radiance_of(
    g: int, p: Any, n: Any, step_u: Any, step_v: Any, geoms: Any, light: Any, lattice: Any
) -> tuple[Any, Any, Any]:
    """What a geom sends from p with normal n, over a pixel whose edges there are two steps."""
    tints, sun, grid, flux, clearance = light
    r, e, b = albedo_on_geom(g, p, n, step_u, step_v, geoms)
    glow = glow_of(g, p, n, step_u, step_v, geoms[5], geoms[7], lattice)
    shade, lamp, window = light_at(p, n, sun, grid, flux, clearance)
    return (
        r * tinted(0, shade, lamp, window, tints) + glow * tints[1, 0],
        e * tinted(1, shade, lamp, window, tints) + glow * tints[1, 1],
        b * tinted(2, shade, lamp, window, tints) + glow * tints[1, 2],
    )


@kernel(error_model="numpy")
def place(T_world_camera: Any, row: int) -> Any:
    """Where the camera is as a row is read."""
    return T_world_camera[row, 0, 3], T_world_camera[row, 1, 3], T_world_camera[row, 2, 3]


@kernel(error_model="numpy")
def to_neighbours(v: int, u: int, rays: Any, R_world_camera: Any) -> Any:
    """From a pixel's ray to the next one's in its row and in its column, in the world, at a depth of 1 m."""
    height, width = rays.shape[:2]
    beside, below = u + 1 if u + 1 < width else u - 1, v + 1 if v + 1 < height else v - 1
    right = (rays[v, beside, 0] - rays[v, u, 0], rays[v, beside, 1] - rays[v, u, 1], 0.0)
    down = (rays[below, u, 0] - rays[v, u, 0], rays[below, u, 1] - rays[v, u, 1], 0.0)
    return turned(R_world_camera, right), turned(R_world_camera, down)


@kernel(error_model="numpy")
def glow_of(g: int, p: Any, n: Any, step_u: Any, step_v: Any, looks: Any, numbers: Any, lattice: Any) -> Any:
    """How bright a geom shines by itself at p with normal n, over a pixel whose edges there are two steps."""
    glow = numbers[g, 2]
    if looks[g, 0] == CEILING and n[2] < -0.9:
        glow += lamp_at(p[0], p[1], abs(step_u[0]) + abs(step_v[0]), abs(step_u[1]) + abs(step_v[1]), lattice)
    return glow


@kernel(error_model="numpy")
def albedo_on_geom(g: int, p: Any, n: Any, step_u: Any, step_v: Any, geoms: Any) -> Any:
    """Reflectances at a point p of a geom, with normal n in the world, over a pixel whose edges there are two steps."""
    shape, size_m, position_world, R_world_geom, origin, looks, colours, numbers = geoms
    kind = int(looks[g, 0])
    rgb, accent = (colours[g, 0], colours[g, 1], colours[g, 2]), (colours[g, 3], colours[g, 4], colours[g, 5])
    if kind == PLAIN:
        return rgb
    R = transposed(R_world_geom, g)
    local = turned(R, (p[0] - position_world[g, 0], p[1] - position_world[g, 1], p[2] - position_world[g, 2]))
    normal = turned(R, n)
    face = face_of(int(shape[g]), normal)
    ws_u, wt_u = along_face(face, local, turned(R, step_u))
    ws_v, wt_v = along_face(face, local, turned(R, step_v))
    ws = min(max(ws_u + ws_v, _LEAST_FOOTPRINT_M), _MOST_FOOTPRINT_M)
    wt = min(max(wt_u + wt_v, _LEAST_FOOTPRINT_M), _MOST_FOOTPRINT_M)
    s, t = on_face(face, normal, (local[0] + origin[g, 0], local[1] + origin[g, 1], local[2] + origin[g, 2]))
    hs, ht = size_m[g, 1 if face == 0 else 0], size_m[g, 1 if face == 2 else 2]
    colour = albedo_at(kind, s, t, hs, ht, ws, wt, rgb, accent, numbers[g, 0], numbers[g, 1], int(looks[g, 1]))
    if kind == PLASTER and abs(n[2]) < 0.3:
        height_w = max(abs(step_u[2]) + abs(step_v[2]), _LEAST_FOOTPRINT_M)
        colour = used_wall(colour, s, p[2], 2 * ht if face != _CURVED else 0.0, ws, height_w, int(looks[g, 1]))
    return colour


@kernel(error_model="numpy")
def transposed(R: Any, g: int) -> Any:
    """R_geom_world as nine numbers."""
    return R[g, 0, 0], R[g, 1, 0], R[g, 2, 0], R[g, 0, 1], R[g, 1, 1], R[g, 2, 1], R[g, 0, 2], R[g, 1, 2], R[g, 2, 2]
