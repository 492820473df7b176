"""Colours of a view: procedural textures on every geom under a building's lamps, as radiance before any camera.

Textures are computed where a ray hits, from integer hashes (no images), in metres on the face hit, and averaged over
the pixel's footprint; at the outlines of what is seen, so is the view. Light has no shadows: what is round about, a
grid of lamps in the ceiling, windows on one side.
"""

from __future__ import annotations

import zlib
from collections.abc import Callable, Mapping
from concurrent.futures import ThreadPoolExecutor
from itertools import pairwise
from typing import get_args

import numpy as np

from wheelsight.errors import ConfigError
from wheelsight.geometry import Float32Array
from wheelsight.simulation import _paint_kernels as kernels
from wheelsight.simulation._light_kernels import Light, Views
from wheelsight.simulation.lighting import Lighting
from wheelsight.simulation.view import Geoms, Outlines, View
from wheelsight.simulation.world import Surface, SurfaceKind

_KINDS: tuple[str, ...] = get_args(SurfaceKind)
# Textures of which a neighbouring geom of the same material shows the continuation; others begin anew on each geom.
_CONTINUED = ("plain", "plaster", "carpet", "tiles", "ceiling")


class Painter:
    """Paints views of one scene.

    Args:
        geoms: the scene's geoms as it starts.
        surfaces: how each of their materials looks.
        seed: of textures and lighting; the same seed gives the same bytes with any number of threads.
        light_seed: of the lighting, where that is another.
        threads: how many a picture is painted by.

    Raises:
        ConfigError: a geom's material is in no surface, or a surface is impossible.
    """

    def __init__(
        self,
        geoms: Geoms,
        surfaces: Mapping[str, Surface],
        seed: int,
        *,
        light_seed: int | None = None,
        threads: int = 2,
    ) -> None:
        looks = [
            _surface_of(name, material, surfaces) for name, material in zip(geoms.names, geoms.materials, strict=True)
        ]
        self._geoms = geoms
        self.lighting = Lighting.of(geoms, looks, seed if light_seed is None else light_seed)
        origin = np.zeros((len(looks), 3))
        painted = np.zeros((len(looks), 2), np.int64)
        colours = np.array([[look.rgb, look.accent_rgb] for look in looks], float).reshape(-1, 6)
        numbers = np.array([[look.scale_m, look.contrast, look.glow] for look in looks], float).reshape(-1, 3)
        for g, look in enumerate(looks):
            is_continued = look.kind in _CONTINUED
            key = geoms.materials[g] if is_continued else geoms.names[g] or str(g)
            painted[g] = _KINDS.index(look.kind), zlib.crc32(key.encode(), seed & 0xFFFFFFFF) >> 1
            if is_continued:
                origin[g] = geoms.R_world_geom[g].T @ geoms.position_world[g]
        self._painted = origin, painted, colours, numbers
        self._pool = ThreadPoolExecutor(threads) if threads > 1 else None
        self._threads = threads

    def paint(self, view: View, geoms: Geoms | None = None, outlines: Outlines | None = None) -> Float32Array:
        """Linear radiance (H, W, 3) of a view: 1 is what white paper sends back in ordinary light; 0 where nothing is.

        `geoms` tells where the geoms stand now, if any has moved since the painter was made. With `outlines` of the
        view, their pixels have the mean of all their rays; without, each pixel is what its middle shows.
        """
        geoms = geoms or self._geoms
        out = np.empty((*view.depth_m.shape, 3), np.float32)
        light = self.lighting
        things = kernels.Things(geoms.kind, geoms.size_m, geoms.position_world, geoms.R_world_geom, *self._painted)
        rays = Light(light.tints, light.sun, light.grid, light.flux, light.clearance)
        arguments = _arrays(view), kernels.Scenery(things, rays, light.lattice), out
        self._in_parts(kernels.paint_rows, len(out), *arguments)
        if outlines is not None:
            samples = outlines.pixels, _arrays(outlines.samples)
            self._in_parts(kernels.paint_outlines, len(outlines.pixels), *samples, *arguments)
        return out

    def _in_parts(self, kernel: Callable[..., None], count: int, *arguments: object) -> None:
        if self._pool is None:
            kernel(0, count, *arguments)
            return
        # More parts than threads: floor and notice boards cost more than bare walls.
        edges = np.linspace(0, count, 4 * self._threads + 1).astype(int)
        parts = [self._pool.submit(kernel, a, b, *arguments) for a, b in pairwise(edges)]
        for part in parts:
            part.result()


def _arrays(view: View) -> Views:
    return Views(view.depth_m, view.geom, view.normal_world, view.T_world_camera, view.rays)


def _surface_of(geom: str, material: str, surfaces: Mapping[str, Surface]) -> Surface:
    surface = surfaces.get(material)
    if surface is None:
        raise ConfigError(
            f"geom {geom!r} has the material {material!r}, of which nothing tells the look",
            fix=f"give it one of {', '.join(sorted(surfaces))}, or add a Surface",
        )
    if surface.kind not in _KINDS:
        raise ConfigError(
            f"surface {material!r} has the unknown kind {surface.kind!r}", fix=f"one of {', '.join(_KINDS)}"
        )
    shares = (*surface.rgb, *surface.accent_rgb, surface.contrast, surface.shine)
    if not all(0 <= share <= 1 for share in shares):
        raise ConfigError(f"surface {material!r}: reflectances, contrast and shine lie between 0 and 1")
    if not 0 <= surface.glow < np.inf:
        raise ConfigError(f"surface {material!r} glows by {surface.glow}", fix="0 or more")
    if not 0.01 <= surface.scale_m < np.inf:
        raise ConfigError(f"surface {material!r}: a scale of {surface.scale_m} m (at least 0.01)")
    return surface
