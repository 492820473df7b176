"""Views of a few boxes by closed form, a corridor made of them, and light that only shows what a surface reflects."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from wheelsight.core.geometry import FloatArray
from wheelsight_sim.appearance import Painter
from wheelsight_sim.scene import Geoms, View
from wheelsight_sim.world import Surface

SURFACES = {
    "wall": Surface("plaster", (0.78, 0.76, 0.70), (0.25, 0.2, 0.16), 1.0, 0.5),
    "floor": Surface("carpet", (0.28, 0.33, 0.42), (0.16, 0.18, 0.24), 0.05, 0.6),
    "tiles": Surface("tiles", (0.62, 0.58, 0.52), (0.3, 0.28, 0.26), 0.33, 0.5),
    "ceiling": Surface("ceiling", (0.85, 0.85, 0.83), (0.7, 0.7, 0.7), 0.6, 0.5),
    "door": Surface("door", (0.55, 0.38, 0.22), (0.35, 0.33, 0.32), 1.0, 0.6),
    "poster": Surface("poster", (0.5, 0.6, 0.75), (0.12, 0.2, 0.4), 1.0, 0.8),
    "board": Surface("notice_board", (0.55, 0.4, 0.25), (0.3, 0.22, 0.14), 0.35, 0.8),
    "wood": Surface("wood", (0.6, 0.45, 0.28), (0.3, 0.18, 0.1), 0.13, 0.6),
    "books": Surface("books", (0.45, 0.32, 0.2), (0.2, 0.1, 0.1), 0.045, 0.9),
    "fabric": Surface("fabric", (0.3, 0.12, 0.12), (0.5, 0.4, 0.2), 0.2, 0.5),
    "blank": Surface("plain", (0.8, 0.8, 0.78)),
}


def boxes(*things: tuple[str, str, ArrayLike, ArrayLike]) -> Geoms:
    """Boxes along the world's axes: name, material, middle, half lengths."""
    names, materials, middles, halves = zip(*things, strict=True)
    count = len(names)
    R = np.tile(np.eye(3), (count, 1, 1))
    return Geoms(names, materials, np.full(count, 6, np.int32), np.array(halves, float), np.array(middles, float), R)


def corridor(left: str = "wall") -> Geoms:
    things = [
        ("floor", "floor", (6, 0, -0.05), (10, 1.1, 0.05)),
        ("ceiling", "ceiling", (6, 0, 2.65), (10, 1.1, 0.05)),
        ("left", left, (6, 1.1, 1.3), (10, 0.05, 1.3)),
        ("right", "wall", (6, -1.1, 1.3), (10, 0.05, 1.3)),
        ("end", "wall", (14, 0, 1.3), (0.05, 1.1, 1.3)),
        ("notices", "board", (1.6, -1.045, 1.4), (0.8, 0.012, 0.55)),
        ("shelf", "books", (9, -0.9, 1.0), (0.5, 0.15, 1.0)),
        ("sofa", "fabric", (11.5, 0.8, 0.4), (0.8, 0.3, 0.4)),
        ("cupboard", "wood", (12.6, -0.7, 0.45), (0.5, 0.3, 0.45)),
        ("poster_end", "poster", (13.94, 0, 1.5), (0.01, 0.5, 0.7)),
    ]
    things += [(f"door_{x}", "door", (x, 1.045, 1.03), (0.48, 0.01, 1.03)) for x in (2.2, 5.4, 9.0)]
    things += [(f"door_{x}", "door", (x, -1.045, 1.03), (0.48, 0.01, 1.03)) for x in (3.4, 7.0)]
    things += [(f"poster_{x}", "poster", (x, 1.045, 1.45), (0.35, 0.008, 0.5)) for x in (3.6, 7.3)]
    return boxes(*things)


def heading(x: float, y: float, z: float, yaw: float = 0.0, pitch: float = 0.0) -> FloatArray:
    """T_world_camera (4, 4) of a camera at a point that looks along a yaw and down by a pitch, radians."""
    forward = np.array([np.cos(yaw) * np.cos(pitch), np.sin(yaw) * np.cos(pitch), -np.sin(pitch)])
    right = np.array([np.sin(yaw), -np.cos(yaw), 0])
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = np.stack([right, np.cross(forward, right), forward], axis=1), (x, y, z)
    return T


def see(geoms: Geoms, T_world_camera: FloatArray, size: tuple[int, int] = (320, 240), focal_px: float = 290.0) -> View:
    """What a pinhole camera (width, height) sees of boxes."""
    width, height = size
    u, v = np.meshgrid(np.arange(width), np.arange(height))
    rays = np.stack([(u - (width - 1) / 2) / focal_px, (v - (height - 1) / 2) / focal_px, np.ones_like(u, float)], -1)
    rays_world = rays @ T_world_camera[:3, :3].T
    depth_m, geom = np.full((height, width), np.inf), np.full((height, width), -1, np.int32)
    normal_world = np.zeros((height, width, 3), np.float32)
    for g, (R, middle, half) in enumerate(zip(geoms.R_world_geom, geoms.position_world, geoms.size_m, strict=True)):
        origin, d = R.T @ (T_world_camera[:3, 3] - middle), rays_world @ R
        d = np.where(abs(d) < 1e-12, 1e-12, d)
        near, far = np.sort([(-half - origin) / d, (half - origin) / d], axis=0)
        enters, leaves = near.max(-1), far.min(-1)
        hit = (enters <= leaves) & (enters > 0.05) & (enters < depth_m)
        axis = near.argmax(-1)[..., None]
        n = np.zeros_like(d)
        np.put_along_axis(n, axis, -np.sign(np.take_along_axis(d, axis, -1)), -1)
        depth_m[hit], geom[hit], normal_world[hit] = enters[hit], g, (n @ R.T)[hit]
    depth_m[geom < 0] = 0
    T = np.broadcast_to(T_world_camera, (height, 4, 4)).copy()
    return View(depth_m.astype(np.float32), geom, normal_world, T, rays)


def albedo_painter(geoms: Geoms, seed: int = 1) -> Painter:
    """Under light from all round alone, far from any corner, so that radiance is what a surface reflects."""
    painter = Painter(geoms, SURFACES, seed)
    light = painter.lighting
    painter.lighting = light._replace(
        tints=np.array([[1.0, 1, 1], [0, 0, 0], [0, 0, 0]]),
        clearance=np.full_like(light.clearance, 9.0),
        lattice=light.lattice * [1, 1, 1, 0, 1],
    )
    return painter
