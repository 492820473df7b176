"""Colours of a view: procedural textures on every geom under a building's lamps, as radiance before any camera.

Textures are computed where a ray hits, from integer hashes (no images), in metres on the face hit, and averaged over
the pixel's footprint. Light has no shadows: what is round about, a grid of lamps in the ceiling, windows on one side.
"""

from __future__ import annotations

import zlib
from collections.abc import Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from itertools import pairwise
from typing import get_args

import numpy as np

from wheelsight.errors import ConfigError
from wheelsight.geometry import Float32Array, FloatArray
from wheelsight.simulation import _paint_kernels as kernels
from wheelsight.simulation.view import Geoms, View
from wheelsight.simulation.world import Surface, SurfaceKind

_KINDS: tuple[str, ...] = get_args(SurfaceKind)
# Textures of which a neighbouring geom of the same material shows the continuation; others begin anew on each geom.
_CONTINUED = ("plain", "plaster", "carpet", "tiles", "ceiling")
_CEILING_M = 2.6
_PANEL_M = 0.6
_PANELS_TO_NEXT_LAMP = 3


@dataclass(frozen=True, slots=True, eq=False)
class Lighting:
    """How a building is lit.

    Attributes:
        tints: (3, 3) rows: light from all round, of lamps, of windows; columns: red, green, blue.
        lamps: (5,) lamps stand in a square grid: its pitch, a lamp's half lengths in x and y, the ceiling's height,
            all in metres, and the seed of their ages.
        sun: (3,) unit vector towards the windows.
    """

    tints: FloatArray
    lamps: FloatArray
    sun: FloatArray

    @classmethod
    def of_seed(cls, seed: int, ceiling_m: float = _CEILING_M, panel_m: float = _PANEL_M) -> Lighting:
        """Level, colour temperature, the windows' side and the lamps' ages, drawn by a seed."""
        rng = np.random.default_rng([seed, zlib.crc32(b"light")])
        level, warmth = rng.uniform(0.75, 1.25), rng.uniform(-1.0, 1.0)
        # Lamps of about 3000 K to 5500 K seen by a camera balanced for 4000 K; skylight is bluer.
        lamp = np.array([1 + 0.10 * warmth, 1.0, 1 - 0.14 * warmth])
        sky = np.array([0.93, 1.0, 1.10])
        round_about = 0.5 * (lamp + 1.0)
        strengths = rng.uniform([0.38, 0.55, 0.05], [0.5, 0.75, 0.25])
        azimuth = rng.uniform(0, 2 * np.pi)
        sun = np.array([np.cos(azimuth), np.sin(azimuth), 0.25]) / np.hypot(1, 0.25)
        tints = level * strengths[:, None] * np.array([round_about, lamp, sky])
        half = 0.5 * panel_m - 0.03
        lamps = np.array([_PANELS_TO_NEXT_LAMP * panel_m, half, half, ceiling_m, float(rng.integers(2**31))])
        return cls(tints, lamps, sun)


class Painter:
    """Paints views of one scene.

    Args:
        geoms: the scene's geoms as it starts.
        surfaces: how each of their materials looks.
        seed: of textures and lighting; the same seed gives the same bytes with any number of threads.
        threads: how many a picture is painted by.

    Raises:
        ConfigError: a geom's material is in no surface, or a surface is impossible.
    """

    def __init__(self, geoms: Geoms, surfaces: Mapping[str, Surface], seed: int, *, threads: int = 2) -> None:
        looks = [
            _surface_of(name, material, surfaces) for name, material in zip(geoms.names, geoms.materials, strict=True)
        ]
        self._geoms = geoms
        self.lighting = Lighting.of_seed(seed, *_ceiling_of(geoms, looks))
        self._origin = np.zeros((len(looks), 3))
        self._looks = np.zeros((len(looks), 2), np.int64)
        self._colours = np.array([[look.rgb, look.accent_rgb] for look in looks], float).reshape(-1, 2, 3)
        self._numbers = np.array([[look.scale_m, look.contrast, look.shine] for look in looks], float).reshape(-1, 3)
        for g, look in enumerate(looks):
            is_continued = look.kind in _CONTINUED
            key = geoms.materials[g] if is_continued else geoms.names[g] or str(g)
            self._looks[g] = _KINDS.index(look.kind), zlib.crc32(key.encode(), seed & 0xFFFFFFFF) >> 1
            if is_continued:
                self._origin[g] = geoms.R_world_geom[g].T @ geoms.position_world[g]
        self._pool = ThreadPoolExecutor(threads) if threads > 1 else None
        self._threads = threads

    def paint(self, view: View, geoms: Geoms | None = None) -> Float32Array:
        """Linear radiance (H, W, 3) of a view: 1 is what white paper sends back in ordinary light; 0 where nothing is.

        `geoms` tells where the geoms stand now, if any has moved since the painter was made.
        """
        geoms = geoms or self._geoms
        out = np.empty((*view.depth_m.shape, 3), np.float32)
        height = len(out)
        arguments = (
            view.depth_m,
            view.geom,
            view.normal_world,
            view.T_world_camera,
            view.rays,
            geoms.kind,
            geoms.size_m,
            geoms.position_world,
            np.ascontiguousarray(np.swapaxes(geoms.R_world_geom, 1, 2)),
            self._origin,
            self._looks,
            self._colours,
            self._numbers,
            self.lighting.tints,
            self.lighting.lamps,
            self.lighting.sun,
            out,
        )
        if self._pool is None:
            kernels.paint_rows(0, height, *arguments)
            return out
        # More parts than threads: floor and notice boards cost more than bare walls.
        edges = np.linspace(0, height, 4 * self._threads + 1).astype(int)
        parts = [self._pool.submit(kernels.paint_rows, a, b, *arguments) for a, b in pairwise(edges)]
        for part in parts:
            part.result()
        return out


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
    if not 0.01 <= surface.scale_m < np.inf:
        raise ConfigError(f"surface {material!r}: a scale of {surface.scale_m} m (at least 0.01)")
    return surface


def _ceiling_of(geoms: Geoms, looks: list[Surface]) -> tuple[float, float]:
    """Height of the lowest ceiling and the size of its panels, in metres; what is usual where there is none."""
    found = [
        (geoms.position_world[g, 2] - (geoms.size_m[g, 2] if geoms.kind[g] == 6 else 0.0), look.scale_m)
        for g, look in enumerate(looks)
        if look.kind == "ceiling"
    ]
    return min(found, default=(_CEILING_M, _PANEL_M))
