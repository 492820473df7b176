"""Colours of a view: textures under lamps and windows, with shadows and sunlight, as radiance before any camera."""

from __future__ import annotations

import zlib
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from itertools import pairwise
from typing import get_args

import cv2
import numpy as np

from wheelsight.core.errors import ConfigError
from wheelsight.core.geometry import Float32Array, FloatArray, Int32Array
from wheelsight_sim import light_kernels as kernels
from wheelsight_sim import view_kernels
from wheelsight_sim.light_kernels import Lighting
from wheelsight_sim.scene import Geoms, Outlines, Scene, View
from wheelsight_sim.world import Surface, SurfaceKind

# Textures are computed where a ray hits, from integer hashes, in metres on the face hit, and averaged over the pixel's
# footprint; at the outlines of what is seen, so is the view.
_KINDS: tuple[str, ...] = get_args(SurfaceKind)
# Textures that continue on a neighbouring geom of the same material; others restart on each geom.
_CONTINUED = ("plain", "plaster", "carpet", "tiles", "ceiling")


class Painter:
    """Paints views of one scene.

    Equal seeds give equal bytes with any number of threads; `light_seed` is of the lighting, where that is another.

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
        self.lighting = lighting_of(geoms, looks, seed if light_seed is None else light_seed)
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

        `geoms` gives their present poses if any has moved since the painter was made. With `outlines` of the
        view, their pixels have the mean of all their rays; without, each pixel is what its middle shows.
        """
        geoms = geoms or self._geoms
        out = np.empty((*view.depth_m.shape, 3), np.float32)
        things = view_kernels.Things(geoms.kind, geoms.size_m, geoms.position_world, geoms.R_world_geom, *self._painted)
        arguments = view, view_kernels.Scenery(things, self.lighting), out
        self._in_parts(view_kernels.paint_rows, len(out), *arguments)
        if outlines is not None:
            samples = outlines.pixels, outlines.samples
            self._in_parts(view_kernels.paint_outlines, len(outlines.pixels), *samples, *arguments)
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


def _surface_of(geom: str, material: str, surfaces: Mapping[str, Surface]) -> Surface:
    surface = surfaces.get(material)
    if surface is None:
        raise ConfigError(
            f"geom {geom!r} has the material {material!r} without a surface",
            fix=f"give it one of {', '.join(sorted(surfaces))}, or add a Surface",
        )
    if surface.kind not in _KINDS:
        problem = f"surface {material!r} has the unknown kind {surface.kind!r}"
        raise ConfigError(problem, fix=f"one of {', '.join(_KINDS)}")
    shares = (*surface.rgb, *surface.accent_rgb, surface.contrast, surface.shine)
    if not all(0 <= share <= 1 for share in shares):
        raise ConfigError(f"surface {material!r}: reflectances, contrast and shine lie between 0 and 1")
    if not 0 <= surface.glow < np.inf:
        raise ConfigError(f"surface {material!r} glows by {surface.glow}", fix="0 or more")
    if not 0.01 <= surface.scale_m < np.inf:
        raise ConfigError(f"surface {material!r}: a scale of {surface.scale_m} m (at least 0.01)")
    return surface


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


def lighting_of(geoms: Geoms, looks: Sequence[Surface], seed: int) -> Lighting:
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
    found = []
    for g, look in enumerate(looks):
        if look.glow > 0:
            sides = _half_m(geoms, g)[:2]
            power = look.glow / _LAMP_GLOW * float(4 * sides[0] * sides[1]) / 0.3
            found.append([*geoms.position_world[g], power, *sides])
    lamps = np.concatenate(
        [np.array(found, float).reshape(-1, 6), *(_in_ceiling(geoms, g, lattice, low, high) for g in ceilings)]
    )
    grid = np.array([*low, _FLUX_CELL_M, _CLEARANCE_CELL_M, ceiling_m / (_LAYERS - 1), ceiling_m])
    # The table of light (Z, Y, X, 4); a lamp's light falls with the square of distance, and ends within its reach.
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
    return Lighting(
        tints, sun, grid, np.ascontiguousarray(flux, np.float32), _clearance(geoms, grid, high), lattice, lamps
    )


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


def _clearance(geoms: Geoms, grid: FloatArray, high: FloatArray) -> Float32Array:
    """Distances (2, Y, X) on the floor to the nearest thing that stands on it, and to the nearest tall one, metres."""
    columns, rows = (np.ceil((high - grid[:2]) / grid[3]).astype(int) + 1).clip(2)
    free = np.ones((2, rows, columns), np.uint8)
    for g in range(len(geoms.names)):
        bottom, top = geoms.position_world[g, 2] + np.array([-1, 1]) * _half_m(geoms, g)[2]
        if geoms.kind[g] == _PLANE or bottom > _ON_FLOOR_M or top < _LOWEST_M:
            continue
        for level in free if top > _TALL_M else free[:1]:
            # Mark on a map of the floor (Y, X) what a geom covers of it.
            middle, size = geoms.position_world[g, :2], geoms.size_m[g]
            if geoms.kind[g] == _BOX:
                corners = (
                    np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]) * size[:2] @ geoms.R_world_geom[g][:2, :2].T + middle
                )
                cv2.fillConvexPoly(level, np.round((corners - grid[:2]) / grid[3]).astype(np.int32), 0)
            else:
                centre = np.round((middle - grid[:2]) / grid[3]).astype(int).tolist()
                cv2.circle(level, centre, round(float(size[0] / grid[3])), 0, -1)
    distances = [cv2.distanceTransform(level, cv2.DIST_L2, 5) * grid[3] for level in free]
    return np.ascontiguousarray(distances, np.float32)


_SPHERE, _ELLIPSOID, _CYLINDER = 2, 4, 5
_CELL_M = 0.5
_LAMPS, _CANDIDATES = 5, 9
# What is flatter hangs on a wall or lies on the floor: it has no shadow worth a ray.
_THINNEST_M = 0.025
_SHADOWS_LOWEST_M = 0.02
_UPRIGHT = 0.999
# Chair and rider in the base frame, metres: x from and to, half width, z from and to.
_ROBOT_M = (
    (-0.15, 0.36, 0.22, 0.22, 0.52),
    (-0.15, -0.09, 0.22, 0.50, 1.00),
    (0.56, 0.80, 0.16, 0.10, 0.14),
    (-0.10, 0.14, 0.22, 0.52, 1.10),
    (-0.08, 0.12, 0.09, 1.10, 1.35),
    (0.14, 0.60, 0.18, 0.40, 0.62),
)


@dataclass(frozen=True, slots=True)
class ShadowSettings:
    """How dark shadows are.

    Attributes:
        strength: share of a place's light that is gone where all lamps are hidden, 0 to 1. On a wall of one paint in
            red_kitchen (frame 250), 0.79 to 0.83 of it is gone right below a shelf, where much of what walls send is
            hidden too, and 0.6 of it 24 px lower, which is taken: one shelf in one room.
    """

    strength: float = 0.6


class Shadows:
    """What lamps do not reach.

    The brightest lamps that are seen from somewhere near a place stand for all. Walls throw no shadow: what they hide
    of a lamp counts as if it was not there, as `Lighting` knows no walls either.
    """

    def __init__(self, settings: ShadowSettings, scene: Scene, lighting: Lighting, *, has_robot: bool) -> None:
        self._scene, self._strength = scene, settings.strength
        geoms = scene.geoms
        looks = [scene.surfaces[material] for material in geoms.materials]
        self._glows = np.array([look.glow > 0 for look in looks])
        count = len(_ROBOT_M) if has_robot else 0
        # What hides light: no planes, lamps or ceilings, nothing flat, and no panes.
        half = np.where(geoms.kind[:, None] == _BOX, geoms.size_m, geoms.size_m[:, :1])
        blocks = (geoms.kind != _PLANE) & (2 * half.min(axis=1) > _THINNEST_M)
        blocks &= ~np.array([look.glow > 0 or look.kind == "ceiling" for look in looks])
        blocks &= ~np.array([name.startswith(_PANE) for name in geoms.names])
        blocks &= np.array([_box_of(geoms, g)[3] for g in range(len(looks))]) > _SHADOWS_LOWEST_M
        is_moving = np.isin(np.arange(len(looks)), scene.moving)
        self._geom = np.concatenate([np.flatnonzero(blocks), np.full(count, -1)]).astype(np.int32)
        self._robot = slice(len(self._geom) - count, len(self._geom))
        self._boxes = np.zeros((len(self._geom), 10))
        self._boxes[:, 8] = self._geom
        seen = self._geom[: self._robot.start]
        self._boxes[: len(seen), 9] = np.isin(geoms.kind[seen], (_SPHERE, _ELLIPSOID, _CYLINDER))
        moves = np.concatenate([is_moving[seen], np.ones(count, bool)])
        self._moving = np.flatnonzero(moves).astype(np.int32)
        for b, g in enumerate(seen):
            self._boxes[b, :8] = _box_of(geoms, int(g))
        self._still = np.flatnonzero(~moves).astype(np.int32)
        rows, columns = lighting.flux.shape[1:3]
        shape = (np.ceil(np.array([rows, columns]) * lighting.grid[2] / _CELL_M).astype(int) + 1).tolist()
        grid = np.array([*lighting.grid[:2], _CELL_M])
        brightest = np.empty((*shape, _CANDIDATES), np.int32)
        kernels.brightest_lamps(lighting.lamps, grid, LAMP_REACH_M, brightest)
        # Each cell's brightest lamps of those that walls do not hide from all of it.
        lamps = kernels.Lamps(lighting.lamps, grid, brightest)
        starts, listed = _listed(lamps, self._boxes, self._still)
        blockers = kernels.Blockers(self._boxes, np.empty(0, np.int32), starts, listed)
        seen_lamps = np.empty((*lamps.brightest.shape[:2], _LAMPS), np.int32)
        kernels.drop_hidden(lamps, blockers, seen_lamps)
        self._lamps = lamps._replace(brightest=seen_lamps)
        self._starts, self._listed = _listed(self._lamps, self._boxes, self._still)

    def kept(self, view: View, level: float, T_world_base: FloatArray | None) -> Float32Array:
        """(H, W) share of the light that is left on what a view shows, with all that moves where the scene has it.

        `level` is the share of the lamps' light that is switched on: shadows are so much weaker.
        """
        boxes = self._boxes.copy()
        for b in self._moving:
            if self._geom[b] >= 0:
                boxes[b, :8] = _box_of(self._scene.geoms, int(self._geom[b]))
        if T_world_base is not None:
            # (P, 8) the boxes of chair and rider.
            x_from, x_to, half_y, low, high = np.array(_ROBOT_M).T
            ahead = T_world_base[:2, 0] / np.hypot(*T_world_base[:2, 0])
            middle = T_world_base[:2, 3] + ((x_from + x_to) / 2)[:, None] * ahead
            ones = np.ones(len(half_y))
            sides = (x_to - x_from) / 2, half_y
            boxes[self._robot, :8] = np.stack(
                [middle[:, 0], middle[:, 1], low, high, ahead[0] * ones, ahead[1] * ones, *sides], axis=1
            )
        out = np.empty(view.depth_m.shape, np.float32)
        blockers = kernels.Blockers(boxes, self._moving, self._starts, self._listed)
        kernels.keep(view, kernels.Shadowing(self._lamps, blockers, self._glows, level * self._strength), out)
        return out


def _box_of(geoms: Geoms, g: int) -> FloatArray:
    """(8,) the upright box around a geom, as `Blockers` has it."""
    R, (x, y, z), size = geoms.R_world_geom[g], geoms.position_world[g], geoms.size_m[g]
    if geoms.kind[g] in (_BOX, _ELLIPSOID):
        half = size
    elif geoms.kind[g] == _SPHERE:
        half = size[[0, 0, 0]]
    else:
        half = np.array([size[0], size[0], size[1] + (0.0 if geoms.kind[g] == _CYLINDER else size[0])])
    if R[2, 2] > _UPRIGHT:
        return np.array([x, y, z - half[2], z + half[2], R[0, 0], R[1, 0], half[0], half[1]])
    half = abs(R) @ half
    return np.array([x, y, z - half[2], z + half[2], 1.0, 0.0, half[0], half[1]])


def _listed(lamps: kernels.Lamps, boxes: FloatArray, still: Int32Array) -> tuple[Int32Array, Int32Array]:
    """`starts` and `listed` of `Blockers`."""
    starts = np.empty(lamps.brightest.size + 1, np.int32)
    listed = np.empty(0, np.int32)
    count = kernels.list_blockers(lamps, boxes, still, starts, listed)
    listed = np.empty(count, np.int32)
    kernels.list_blockers(lamps, boxes, still, starts, listed)
    return starts, listed


_PANE = "pane"  # what the names of windows' geoms begin with
_CELLS = 64, 32
_BEHIND_M = 0.01


@dataclass(frozen=True, slots=True)
class SunlightSettings:
    """How often and how strongly the sun shines in.

    Attributes:
        chance: share of the drives on which it does. Chosen.
        elevation_deg: (lowest, highest) above the horizon; at 50° north the sun stands up to 63° high.
        brightness: of a patch that faces the sun, over what the room's lamps send it. Direct sun is 100 klx, half of it
            comes through two panes at a slant, and offices are lit by 500 lx (EN 12464-1): a hundred times; chosen for
            a sensor that saturates anyway.
        blinds_from: share of that from which a depth camera sees nothing; Kinect fails in direct sunlight (Suarez &
            Murphy, "Using the Kinect for search and rescue robotics", SSRR 2012).
    """

    chance: float = 0.5
    elevation_deg: tuple[float, float] = (20.0, 50.0)
    brightness: float = 12.0
    blinds_from: float = 0.1


class Sunlight:
    """The sun of one drive. What stands in its way throws a shadow; people do not.

    The windows are the boxes whose names begin with "pane". `towards` (3,) leads to where their light comes from; its
    height is replaced.
    """

    def __init__(self, settings: SunlightSettings, scene: Scene, towards: FloatArray, rng: np.random.Generator) -> None:
        elevation_rad = np.radians(rng.uniform(*settings.elevation_deg))
        level = np.asarray(towards[:2], float) / np.hypot(*towards[:2])
        self.brightness = settings.brightness
        self.towards = np.array([*(np.cos(elevation_rad) * level), np.sin(elevation_rad)])
        # The windows of a scene, and how far the sun comes through them; none where it does not shine.
        shines = bool(rng.random() < settings.chance)
        geoms = scene.geoms
        panes = [g for g, name in enumerate(geoms.names) if shines and name.startswith(_PANE) and geoms.kind[g] == _BOX]
        axes, halves = np.zeros((len(panes), 3, 3)), np.zeros((len(panes), 2))
        reach_m = np.zeros((len(panes), *_CELLS), np.float32)
        for k, g in enumerate(panes):
            # Across, along, and last through it.
            order = np.argsort(-geoms.size_m[g])
            axes[k], halves[k] = geoms.R_world_geom[g].T[order], geoms.size_m[g][order[:2]]
            across, along = ((np.arange(count) + 0.5) / count * 2 - 1 for count in _CELLS)
            grid = across[:, None, None] * halves[k, 0] * axes[k, 0] + along[None, :, None] * halves[k, 1] * axes[k, 1]
            # Begun behind the pane, which would stop the ray itself.
            through_m = geoms.size_m[g][order[2]] + _BEHIND_M
            slant = max(abs(float(axes[k, 2] @ self.towards)), 0.05)
            begins = geoms.position_world[g] + grid - self.towards * through_m / slant
            reach_m[k] = scene.reach_m(begins.reshape(-1, 3), -self.towards).reshape(_CELLS) + through_m / slant
        self._panes = kernels.Panes(np.ascontiguousarray(geoms.position_world[panes]), axes, halves, reach_m)

    def on(self, view: View) -> Float32Array:
        """(H, W) share of full sunlight on what a view shows: the cosine of incidence in patches, 0 elsewhere."""
        out = np.empty(view.depth_m.shape, np.float32)
        kernels.shine_in(view, self._panes, self.towards, out)
        return out


@dataclass(frozen=True, slots=True)
class LightSettings:
    """How often light changes.

    Attributes:
        every_s: mean time between two switches. Chosen: motion detectors in corridors wait minutes, people switch
            lamps when they come and go.
        dimmed: (least, most) share of the lamps' light that is left while some of them are off. Chosen.
    """

    every_s: float = 40.0
    dimmed: tuple[float, float] = (0.35, 0.8)


class Lights:
    """The switches of one drive. All lamps are dimmed alike, those seen directly too."""

    def __init__(self, settings: LightSettings, duration_s: float, rng: np.random.Generator) -> None:
        count = int(rng.poisson(duration_s / settings.every_s))
        self._switches_s = np.sort(rng.uniform(0, duration_s, count))
        self._levels = np.concatenate([[1.0], rng.uniform(*settings.dimmed, count)])
        self._levels[2::2] = 1.0

    def level_at(self, stamp_s: float) -> float:
        """Share of the lamps' light at a time."""
        return float(self._levels[np.searchsorted(self._switches_s, stamp_s, side="right")])

    def lit(self, lighting: Lighting, stamp_s: float) -> Lighting:
        """A building's lighting as it is at a time."""
        tints = lighting.tints.copy()
        level = self.level_at(stamp_s)
        tints[1] *= level
        tints[0] *= 0.5 * (1 + level)  # half of the light from all round is that of lamps
        return lighting._replace(tints=tints)
