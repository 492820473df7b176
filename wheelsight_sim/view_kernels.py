"""Compiled parts of a view: rays are aimed and become hits, outlines are found, and each pixel is painted."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np

from wheelsight.core.compiled import kernel
from wheelsight.core.geometry.arrays import Float32Array, FloatArray, Int32Array, IntArray
from wheelsight_sim.light_kernels import Lighting, View, lamp_at, light_at, light_row, nine, three, tinted, turned
from wheelsight_sim.texture_kernels import (
    Look,
    PixelFootprint,
    books,
    carpet,
    ceiling,
    door,
    fabric,
    notice_board,
    plaster,
    poster,
    scaled,
    tiles,
    used_wall,
    wood,
)

# A tile is a rectangle of pixels, rows `tile`[0] to `tile`[1] and columns `tile`[2] to `tile`[3], the last left out;
# its N rays are numbered row by row.

_PLANE, _SPHERE, _CAPSULE, _ELLIPSOID, _CYLINDER, _BOX = 0, 2, 3, 4, 5, 6
_BEHIND = 1e-3
# Below this cosine between ray and surface, a shift of the origin may not be carried along the ray.
_GRAZING = 0.02
_TOLERANCE_M = 1e-6
# Of a part of a tile, the most rays and columns: few enough that most rays of a part hit the same geoms.
_PART_RAYS, _PART_COLUMNS = 128, 16
_PARALLEL = 1e-15


class Boxes(NamedTuple):
    """Of each of G geoms MuJoCo's kind and size, its middle, half the box around it, -1 for not to be hit, and turn."""

    kind: Int32Array
    size_m: FloatArray
    center: FloatArray
    half_m: FloatArray
    R_world_geom: FloatArray


@kernel
def cast(view: View, tiles: Any, boxes: Boxes) -> None:
    """Write into a view what rays of `tiles` (T, 4) hit first. Where nothing is hit, the view stays.

    A tile's rays begin where the camera is as its middle row is read, and are aimed row by row. For each part of a
    tile they are cast only at what they can hit.
    """
    everything = np.arange(len(boxes.kind)).astype(np.int32)
    for t in range(len(tiles)):
        top, bottom, left, right = tiles[t]
        middle = view.T_world_camera[(top + bottom) // 2]
        R, origin = middle[:3, :3].copy(), middle[:3, 3].copy()
        columns = min(right - left, _PART_COLUMNS)
        rows = _PART_RAYS // columns
        count = -(-(bottom - top) // rows) * -(-(right - left) // columns)
        parts, ends, bounds = np.empty((count, 4), np.int64), np.zeros(count + 1, np.int64), np.empty((count, 4))
        rays, p = np.empty(((bottom - top) * (right - left), 3)), 0
        for row in range(top, bottom, rows):
            for column in range(left, right, columns):
                part = np.array([row, min(row + rows, bottom), column, min(column + columns, right)])
                parts[p], ends[p + 1] = part, ends[p] + (part[1] - part[0]) * (part[3] - part[2])
                bounds[p] = aim(view.rays, view.T_world_camera, part, R, rays[ends[p] : ends[p + 1]])
                p += 1
        whole = np.array([bounds[:, 0].min(), bounds[:, 1].max(), bounds[:, 2].min(), bounds[:, 3].max()])
        among = choose(boxes, everything, R, origin, whole)
        for p in range(count if len(among) else 0):
            own = rays[ends[p] : ends[p + 1]]
            hits = (np.full(len(own), np.inf), np.full(len(own), -1, np.int32), np.zeros(len(own), np.int32))
            for g in choose(boxes, among, R, origin, bounds[p]):
                meet(g, boxes, origin, own, hits)
            gather(hits, boxes, own, parts[p], origin, view)


@kernel
def aim(rays: Any, T_world_rows: Any, tile: Any, R: Any, out: Any) -> Any:
    """Turn a tile's `rays` (H, W, 3) into the world, each by its row of `T_world_rows` (H, 4, 4), into `out` (N, 3).

    Returns (4,) the least and greatest x/z and y/z of all of them in a camera frame turned by R (3, 3); infinite where
    one points backwards in it.
    """
    bounds = np.array([np.inf, -np.inf, np.inf, -np.inf])
    i = 0
    for row in range(tile[0], tile[1]):
        T = T_world_rows[row]
        for column in range(tile[2], tile[3]):
            x, y, z = rays[row, column]
            for k in range(3):
                out[i, k] = T[k, 0] * x + T[k, 1] * y + T[k, 2] * z
            a, b, c = out[i]
            i += 1
            depth = R[0, 2] * a + R[1, 2] * b + R[2, 2] * c
            if depth < _BEHIND:
                bounds[0], bounds[1], bounds[2], bounds[3] = -np.inf, np.inf, -np.inf, np.inf
                continue
            u = (R[0, 0] * a + R[1, 0] * b + R[2, 0] * c) / depth
            v = (R[0, 1] * a + R[1, 1] * b + R[2, 1] * c) / depth
            bounds[0], bounds[1] = min(bounds[0], u), max(bounds[1], u)
            bounds[2], bounds[3] = min(bounds[2], v), max(bounds[3], v)
    return bounds


@kernel
def choose(boxes: Boxes, among: Any, R: Any, origin: Any, bounds: Any) -> Any:
    """Indices of the geoms `among` (K,) that rays in a frustum can hit; none that they can is left out.

    The frustum starts at `origin` (3,), is turned by R (3, 3), and has `bounds` (u_min, u_max, v_min, v_max) on the
    plane z = 1.

    Left out is what lies outside, and what lies behind a box or plane that the frustum's four corners hit: such a body
    is convex, so that every ray between hits it too, and no deeper than the deepest corner.
    """
    kind, _, center, half_m, R_world_geom = boxes
    bounded = np.isfinite(bounds[0])
    # Inward normals (5, 3) in the world of the frustum's planes, which go through its origin.
    sides = np.zeros((5, 3))
    for k in range(3 if bounded else 0):
        sides[0, k], sides[1, k] = R[k, 0] - bounds[0] * R[k, 2], bounds[1] * R[k, 2] - R[k, 0]
        sides[2, k], sides[3, k] = R[k, 1] - bounds[2] * R[k, 2], bounds[3] * R[k, 2] - R[k, 1]
        sides[4, k] = R[k, 2]
    found, nearest, corners = np.empty(len(among), np.int32), np.empty(len(among)), np.zeros((4, 3))
    distance, hit, face = np.empty(4), np.empty(4, np.int32), np.empty(4, np.int32)
    for c in range(4 if bounded else 0):
        # A little outside, so that no ray passes by where all four of them hit.
        u = bounds[c % 2] + _TOLERANCE_M * (2 * (c % 2) - 1)
        v = bounds[2 + c // 2] + _TOLERANCE_M * (2 * (c // 2) - 1)
        for k in range(3):
            corners[c, k] = R[k, 0] * u + R[k, 1] * v + R[k, 2]
    count, limit = 0, np.inf
    for g in among:
        if half_m[g, 0] < 0:
            continue
        if kind[g] == _PLANE:
            nearest[count] = -np.inf
        else:
            x, y, z = center[g, 0] - origin[0], center[g, 1] - origin[1], center[g, 2] - origin[2]
            T = transposed(R_world_geom, g)
            reach = 0.0
            for s in range(4, -1 if bounded else 3, -1):
                n = (sides[s, 0], sides[s, 1], sides[s, 2]) if bounded else (R[0, 2], R[1, 2], R[2, 2])
                along = turned(T, n)
                wide = abs(along[0]) * half_m[g, 0] + abs(along[1]) * half_m[g, 1] + abs(along[2]) * half_m[g, 2]
                reach = n[0] * x + n[1] * y + n[2] * z
                if s == 4:
                    nearest[count] = reach - wide
                reach += wide + _TOLERANCE_M
                if reach < 0:
                    break
            if reach < 0 and bounded:
                continue
        found[count] = g
        count += 1
        if bounded and (kind[g] == _BOX or kind[g] == _PLANE):
            distance[:] = np.inf
            meet(g, boxes, origin, corners, (distance, hit, face))
            # Rays that begin inside hide nothing.
            limit = min(limit, distance.max() if kind[g] == _PLANE or face.min() >= 0 else np.inf)
    kept = 0
    for i in range(count):
        if nearest[i] <= limit + _TOLERANCE_M:
            found[kept] = found[i]
            kept += 1
    return found[:kept]


@kernel(error_model="numpy")
def meet(g: int, boxes: Boxes, origin: Any, rays: Any, hits: Any) -> None:
    """Put geom `g` into `hits` wherever rays (N, 3) from `origin` (3,) come to it before what they hit so far.

    `hits` are (N,) how many ray lengths away what is hit first is, which geom, -1 for none, and on which of its faces.
    As MuJoCo's `mj_ray` does, to the last bit: planes are seen from above, and of equally near geoms the first counts.
    """
    distance, geom, face = hits
    kind, T, size = boxes.kind[g], transposed(boxes.R_world_geom, g), row_of(boxes.size_m, g)
    center = row_of(boxes.center, g)
    o = turned(T, (origin[0] - center[0], origin[1] - center[1], origin[2] - center[2]))
    # On which side of a box the rays begin, by axis; where they begin inside, they meet the far side.
    side = (np.sign(o[0]), np.sign(o[1]), np.sign(o[2]))
    side = (side[0] * (abs(o[0]) > size[0]), side[1] * (abs(o[1]) > size[1]), side[2] * (abs(o[2]) > size[2]))
    is_inside = side[0] == 0 and side[1] == 0 and side[2] == 0
    for i in range(len(rays)):
        d, near = turned(T, (rays[i, 0], rays[i, 1], rays[i, 2])), distance[i]
        x, on = near, 0
        if kind == _BOX:
            s0, s1, s2 = side
            if is_inside:
                s0, s1, s2 = -np.sign(d[0]), -np.sign(d[1]), -np.sign(d[2])
            f = -1.0 if is_inside else 1.0
            a, b, c = (o[0], d[0], size[0]), (o[1], d[1], size[1]), (o[2], d[2], size[2])
            x = _on_side(f * s0, s0 * d[0], a, b, c, near)
            y = _on_side(f * s1, s1 * d[1], b, a, c, x)
            z = _on_side(f * s2, s2 * d[2], c, a, b, y)
            x, on = z, 2 if z < y else (1 if y < x else 0)
            on = on - 3 if is_inside else on
        elif kind == _PLANE:
            if d[2] <= -_PARALLEL and o[2] >= 0:
                x = -o[2] / d[2]
                for k in range(2):
                    if size[k] > 0 and abs(o[k] + x * d[k]) > size[k]:
                        x = near
        else:
            x, on = meet_curved(kind, size, o, d)
            if x < 0:
                continue
        if x < near:
            distance[i], geom[i], face[i] = x, g, on


@kernel(error_model="numpy")
def _on_side(side: float, facing: float, own: Any, one: Any, other: Any, limit: float) -> Any:
    """Where a ray meets a box's side before `limit`, or that. Each axis: the ray's origin and way, the half size."""
    if facing < -_PARALLEL:
        x = (side * own[2] - own[0]) / own[1]
        if x < limit and abs(one[0] + x * one[1]) <= one[2] and abs(other[0] + x * other[1]) <= other[2]:
            return x
    return limit


@kernel(error_model="numpy")
def roots(a: float, b: float, c: float) -> Any:
    """Both solutions of a x² + 2 b x + c = 0, the lesser first; -1 where there is none."""
    square = b * b - a * c
    if square < _PARALLEL:
        return -1.0, -1.0
    root = np.sqrt(square)
    return (-b - root) / a, (-b + root) / a


@kernel(error_model="numpy")
def meet_curved(kind: int, size: Any, o: Any, d: Any) -> Any:
    """Where a ray from o along d meets what is curved, -1 if nowhere, and at which end: -1, 1, or 0 between them."""
    if kind in (_SPHERE, _ELLIPSOID):
        s, square = (1.0, 1.0, 1.0), size[0] * size[0]
        if kind == _ELLIPSOID:
            s, square = (1 / (size[0] * size[0]), 1 / (size[1] * size[1]), 1 / (size[2] * size[2])), 1.0
        first, second = roots(
            s[0] * d[0] * d[0] + s[1] * d[1] * d[1] + s[2] * d[2] * d[2],
            s[0] * d[0] * o[0] + s[1] * d[1] * o[1] + s[2] * d[2] * o[2],
            s[0] * o[0] * o[0] + s[1] * o[1] * o[1] + s[2] * o[2] * o[2] - square,
        )
        return (first if first >= 0 else second), 0
    across, along = d[0] * d[0] + d[1] * d[1], d[0] * o[0] + d[1] * o[1]
    from_axis = o[0] * o[0] + o[1] * o[1]
    first, second = roots(across, along, from_axis - size[0] * size[0])
    best, at = (first if first >= 0 else second), 0
    if abs(o[2] + best * d[2]) > size[1]:
        best = -1.0
    for end in (-1, 1):
        if kind == _CYLINDER:
            first = (end * size[1] - o[2]) / d[2]
            x, y = o[0] + first * d[0], o[1] + first * d[1]
            if abs(d[2]) <= _PARALLEL or x * x + y * y > size[0] * size[0]:
                first = -1.0
            second = first
        else:
            up = o[2] - end * size[1]
            square = from_axis + up * up - size[0] * size[0]
            first, second = roots(across + d[2] * d[2], along + d[2] * up, square)
            first = first if end * (o[2] + first * d[2]) >= size[1] else -1.0
            second = second if end * (o[2] + second * d[2]) >= size[1] else -1.0
        nearer = first if first >= 0 else second
        if nearer >= 0 and (best < 0 or nearer < best):
            best, at = nearer, end
    return best, at


@kernel(error_model="numpy")
def normal_at(g: int, boxes: Boxes, origin: Any, ray: Any, distance: float, face: int) -> Any:
    """Outward unit normal where a ray meets a geom."""
    kind, T, size = boxes.kind[g], transposed(boxes.R_world_geom, g), row_of(boxes.size_m, g)
    if kind == _PLANE:
        return T[6], T[7], T[8]
    center, d = row_of(boxes.center, g), turned(T, ray)
    o = turned(T, (origin[0] - center[0], origin[1] - center[1], origin[2] - center[2]))
    x, y, z = o[0] + distance * d[0], o[1] + distance * d[1], o[2] + distance * d[2]
    if kind == _BOX:
        x, y, z = (x if face % 3 == 0 else 0.0), (y if face % 3 == 1 else 0.0), (z if face % 3 == 2 else 0.0)
    elif kind == _ELLIPSOID:
        x, y, z = x / (size[0] * size[0]), y / (size[1] * size[1]), z / (size[2] * size[2])
    elif kind == _CYLINDER:
        x, y, z = (0.0, 0.0, float(face)) if face else (x, y, 0.0)
    elif kind == _CAPSULE:
        z = z - face * size[1] if face else 0.0
    long = np.sqrt(x * x + y * y + z * z)
    return turned((T[0], T[3], T[6], T[1], T[4], T[7], T[2], T[5], T[8]), (x / long, y / long, z / long))


@kernel(error_model="numpy")
def gather(hits: Any, boxes: Boxes, rays_world: Any, tile: Any, origin: Any, view: View) -> None:
    """Write what the rays of a part of a tile hit into a view.

    `rays_world` (N, 3) begin at `origin` (3,). A hit surface is carried along its tangent plane to where the row's own
    origin sees it: exact for flat ones; where the ray grazes it, the distance stays as it was.
    """
    depth_m, geom, normal_world, T_world_rows, _ = view
    (distance, hit, face), i = hits, -1
    for row in range(tile[0], tile[1]):
        here = place(T_world_rows, row)
        away = (origin[0] - here[0], origin[1] - here[1], origin[2] - here[2])
        for column in range(tile[2], tile[3]):
            i += 1
            z, g = distance[i], hit[i]
            if g < 0:
                continue
            ray = (rays_world[i, 0], rays_world[i, 1], rays_world[i, 2])
            n = normal_at(g, boxes, origin, ray, z, face[i])
            across = n[0] * ray[0] + n[1] * ray[1] + n[2] * ray[2]
            square = ray[0] * ray[0] + ray[1] * ray[1] + ray[2] * ray[2]
            if abs(across) > _GRAZING * np.sqrt(square):
                z += (n[0] * away[0] + n[1] * away[1] + n[2] * away[2]) / across
            if z > 0:
                depth_m[row, column], geom[row, column] = z, g
                for k in range(3):
                    normal_world[row, column, k] = n[k]


# Faces of a box meet at 90 degrees; a curved face turns by less from a pixel to the next, unless it is tiny.
_SAME_FACE = 0.9
# x and y from a pixel's middle, in pixels. With the ray through the middle there is one in each fifth of the width and
# of the height: upright and level edges, of which rooms are full, are found as finely as by a grid of 25.
OFFSETS = np.array([[-0.4, 0.2], [-0.2, -0.4], [0.2, 0.4], [0.4, -0.2]])


@kernel
def is_same_face(one: int, n: Any, other: int, m: Any) -> Any:
    """Whether two rays met one face of one geom, or both nothing.

    Given are the geoms' indices, -1 for none, and the normals as three numbers: handing arrays over would take most of
    the time.
    """
    return one == other and (one < 0 or n[0] * m[0] + n[1] * m[1] + n[2] * m[2] > _SAME_FACE)


@kernel
def find(geom: Any, normal_world: Any, tiles: Any) -> Any:
    """Rows and columns (N, 2) of pixels with another face above, below, on the left or the right.

    They come tile by tile of `tiles` (T, 4), which cover the whole view's `geom` (H, W) and `normal_world` (H, W, 3);
    the second answer (T + 1,) is where each tile's begin. A straight edge through a pixel parts it from at least one
    of those four, if nothing else is near.
    """
    height, width = geom.shape
    found, ends = np.empty((height * width, 2), np.int32), np.zeros(len(tiles) + 1, np.int64)
    count = 0
    for t in range(len(tiles)):
        for v in range(tiles[t, 0], tiles[t, 1]):
            for u in range(tiles[t, 2], tiles[t, 3]):
                g, n = geom[v, u], three(normal_world, v, u)
                for a, b in ((v - 1, u), (v + 1, u), (v, u - 1), (v, u + 1)):
                    inside = 0 <= a < height and 0 <= b < width
                    if inside and not is_same_face(g, n, geom[a, b], three(normal_world, a, b)):
                        found[count, 0], found[count, 1] = v, u
                        count += 1
                        break
        ends[t + 1] = count
    return found[:count], ends


@kernel
def spread(rays: Any, pixels: Any) -> Any:
    """Rays (N, S, 3) through parts of pixels, rows and columns (N, 2), from the `rays` (H, W, 3) through their middles.

    Between neighbouring pixels a lens bends rays evenly.
    """
    height, width = rays.shape[:2]
    out = np.empty((len(pixels), len(OFFSETS), 3))
    for i in range(len(pixels)):
        v, u = pixels[i]
        left, right = max(u - 1, 0), min(u + 1, width - 1)
        above, below = max(v - 1, 0), min(v + 1, height - 1)
        for s in range(len(OFFSETS)):
            x, y = OFFSETS[s, 0] / max(right - left, 1), OFFSETS[s, 1] / max(below - above, 1)
            for k in range(3):
                across, down = rays[v, right, k] - rays[v, left, k], rays[below, u, k] - rays[above, u, k]
                out[i, s, k] = rays[v, u, k] + x * across + y * down
    return out


PLAIN, PLASTER, CARPET, TILES, WOOD, CEILING, DOOR, POSTER, NOTICE_BOARD, FABRIC, BOOKS = range(11)
_CURVED = 3
_FLAT_THING_M = 0.12
_LEAST_FOOTPRINT_M = 1e-4
_MOST_FOOTPRINT_M = 20.0


class Things(NamedTuple):
    """Of each of G geoms MuJoCo's type and size, middle and orientation, and its texture.

    Attributes:
        kind: (G,).
        size_m: (G, 3).
        position_world: (G, 3).
        R_world_geom: (G, 3, 3).
        origin: (G, 3) where the texture's origin lies in the geom's own frame.
        looks: (G, 2) number of the texture, and seed.
        colours: (G, 6) main and accent colour.
        numbers: (G, 3) scale in metres, contrast and glow.
    """

    kind: Int32Array
    size_m: FloatArray
    position_world: FloatArray
    R_world_geom: FloatArray
    origin: FloatArray
    looks: IntArray
    colours: FloatArray
    numbers: FloatArray


class Scenery(NamedTuple):
    """What is painted, and its light."""

    things: Things
    light: Lighting


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
def albedo_at(kind: int, at: PixelFootprint, hs: float, ht: float, look: Look) -> Any:
    """Reflectances of one texture at a point of a face of half size `hs` by `ht`."""
    if kind == PLASTER:
        return plaster(at.s, at.t, at.ws, at.wt, look.rgb, look.contrast, look.seed)
    if kind == CARPET:
        return carpet(at, look)
    if kind == TILES:
        return tiles(at, look)
    if kind == WOOD:
        return wood(at, look)
    if kind == CEILING:
        return ceiling(at, look)
    if kind == FABRIC:
        return fabric(at, look)
    if kind != PLAIN and min(hs, ht) < _FLAT_THING_M:
        return scaled(look.accent, 0.8)
    if kind == DOOR:
        return door(at, hs, ht, look)
    if kind == POSTER:
        return poster(at, hs, ht, look)
    if kind == NOTICE_BOARD:
        return notice_board(at, hs, ht, look)
    if kind == BOOKS:
        return books(at, hs, ht, look)
    return look.rgb


@kernel(error_model="numpy")
def paint_rows(first: int, last: int, view: View, scenery: Scenery, out: Float32Array) -> None:
    """Radiance `out` (H, W, 3) of the rows from first up to last."""
    depth_m, geom, normal_world, T_world_camera, rays = view
    width = depth_m.shape[1]
    things, light = scenery
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
            r, e, b = albedo_on_geom(g, p, n, step_u, step_v, things)
            glow = glow_of(g, p, n, step_u, step_v, scenery)
            out[v, u, 0] *= r
            out[v, u, 1] *= e
            out[v, u, 2] *= b
            if glow > 0:
                for c in range(3):
                    out[v, u, c] += glow * light.tints[1, c]


@kernel(error_model="numpy")
def paint_outlines(
    first: int, last: int, pixels: IntArray, samples: View, view: View, scenery: Scenery, out: Float32Array
) -> None:
    """Put into `out` (H, W, 3) the mean radiance over each of the `pixels` (N, 2), from first up to last.

    `samples` is the view of `Outlines`; the others are as for `paint_rows`, which has painted `out` by the ray
    through each pixel's middle. Samples on the face which that ray met have its colour: textures are averaged over the
    pixel already.
    """
    depth_m, geom, normal_world, T_world_camera, rays = samples
    seen, facing, middles = view.geom, view.normal_world, view.rays
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
                r, e, b = radiance_of(g, p, n, step_u, step_v, scenery)
            red, green, blue = red + r, green + e, blue + b
        out[v, u, 0], out[v, u, 1], out[v, u, 2] = share * red, share * green, share * blue


@kernel(error_model="numpy")
def radiance_of(g: int, p: Any, n: Any, step_u: Any, step_v: Any, scenery: Scenery) -> tuple[Any, Any, Any]:
    """What a geom sends from p with normal n, over a pixel whose edges there are two steps."""
    tints, sun, grid, flux, clearance, _, _ = scenery.light
    r, e, b = albedo_on_geom(g, p, n, step_u, step_v, scenery.things)
    glow = glow_of(g, p, n, step_u, step_v, scenery)
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
def glow_of(g: int, p: Any, n: Any, step_u: Any, step_v: Any, scenery: Scenery) -> Any:
    """How bright a geom shines by itself at p with normal n, over a pixel whose edges there are two steps."""
    things, light = scenery
    glow = things.numbers[g, 2]
    if things.looks[g, 0] == CEILING and n[2] < -0.9:
        glow += lamp_at(p[0], p[1], abs(step_u[0]) + abs(step_v[0]), abs(step_u[1]) + abs(step_v[1]), light.lattice)
    return glow


@kernel(error_model="numpy")
def albedo_on_geom(g: int, p: Any, n: Any, step_u: Any, step_v: Any, things: Things) -> Any:
    """Reflectances at a point p of a geom, with normal n in the world, over a pixel whose edges there are two steps."""
    shape, size_m, position_world, R_world_geom, origin, looks, colours, numbers = things
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
    look = Look(rgb, accent, numbers[g, 0], numbers[g, 1], int(looks[g, 1]))
    colour = albedo_at(kind, PixelFootprint(s, t, ws, wt), hs, ht, look)
    if kind == PLASTER and abs(n[2]) < 0.3:
        height_w = max(abs(step_u[2]) + abs(step_v[2]), _LEAST_FOOTPRINT_M)
        colour = used_wall(colour, s, p[2], 2 * ht if face != _CURVED else 0.0, ws, height_w, int(looks[g, 1]))
    return colour


@kernel(error_model="numpy")
def row_of(vectors: Any, g: int) -> Any:
    """A geom's vector as three numbers."""
    return vectors[g, 0], vectors[g, 1], vectors[g, 2]


@kernel(error_model="numpy")
def transposed(R: Any, g: int) -> Any:
    """R_geom_world as nine numbers."""
    return R[g, 0, 0], R[g, 1, 0], R[g, 2, 0], R[g, 0, 1], R[g, 1, 1], R[g, 2, 1], R[g, 0, 2], R[g, 1, 2], R[g, 2, 2]
