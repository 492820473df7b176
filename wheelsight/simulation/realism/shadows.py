"""Shadows that things, people, doors and the robot throw in the light of lamps."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from wheelsight.geometry import BoolArray, Float32Array, FloatArray, Int32Array
from wheelsight.simulation import _shadow_kernels as kernels
from wheelsight.simulation._light_kernels import Views
from wheelsight.simulation.lighting import LAMP_REACH_M, Lighting
from wheelsight.simulation.scene import Scene
from wheelsight.simulation.view import Geoms, View
from wheelsight.simulation.world import Surface

_PLANE, _SPHERE, _ELLIPSOID, _CYLINDER, _BOX = 0, 2, 4, 5, 6
_CELL_M = 0.5
_LAMPS, _CANDIDATES = 5, 9
# What is flatter hangs on a wall or lies on the floor: it has no shadow worth a ray.
_THINNEST_M = 0.025
_LOWEST_M = 0.02
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

    Args:
        settings: how dark.
        scene: what stands there, and which of it moves.
        lighting: of the scene.
        has_robot: whether it throws a shadow.
    """

    def __init__(self, settings: ShadowSettings, scene: Scene, lighting: Lighting, *, has_robot: bool) -> None:
        self._scene, self._strength = scene, settings.strength
        geoms = scene.geoms
        looks = [scene.surfaces[material] for material in geoms.materials]
        self._glows = np.array([look.glow > 0 for look in looks])
        count = len(_ROBOT_M) if has_robot else 0
        is_moving, blocks = np.isin(np.arange(len(looks)), scene.moving), _blocks(geoms, looks)
        self._geom = np.concatenate([np.flatnonzero(blocks), np.full(count, -1)]).astype(np.int32)
        self._robot = slice(len(self._geom) - count, len(self._geom))
        self._boxes = np.zeros((len(self._geom), 8))
        self._is_round = np.zeros(len(self._geom), bool)
        seen = self._geom[: self._robot.start]
        self._is_round[: len(seen)] = np.isin(geoms.kind[seen], (_SPHERE, _ELLIPSOID, _CYLINDER))
        moves = np.concatenate([is_moving[seen], np.ones(count, bool)])
        self._moving = np.flatnonzero(moves).astype(np.int32)
        for b, g in enumerate(seen):
            self._boxes[b] = _box_of(geoms, int(g))
        self._still = np.flatnonzero(~moves).astype(np.int32)
        self._lamps = self._visible(_lamps_of(lighting))
        self._starts, self._listed = _listed(self._lamps, self._boxes, self._still)

    def _visible(self, lamps: kernels.Lamps) -> kernels.Lamps:
        """Each cell's brightest lamps of those that walls do not hide from all of it."""
        starts, listed = _listed(lamps, self._boxes, self._still)
        nothing = np.empty(0, np.int32)
        blockers = kernels.Blockers(self._boxes, self._is_round, self._geom, nothing, starts, listed)
        brightest = np.empty((*lamps.brightest.shape[:2], _LAMPS), np.int32)
        kernels.drop_hidden(lamps, blockers, brightest)
        return lamps._replace(brightest=brightest)

    def kept(self, view: View, level: float, T_world_base: FloatArray | None) -> Float32Array:
        """(H, W) share of the light that is left on what a view shows, with all that moves where the scene has it.

        `level` is the share of the lamps' light that is switched on: shadows are so much weaker.
        """
        boxes = self._boxes.copy()
        for b in self._moving:
            if self._geom[b] >= 0:
                boxes[b] = _box_of(self._scene.geoms, int(self._geom[b]))
        if T_world_base is not None:
            boxes[self._robot] = _robot_at(T_world_base)
        out = np.empty(view.depth_m.shape, np.float32)
        blockers = kernels.Blockers(boxes, self._is_round, self._geom, self._moving, self._starts, self._listed)
        arrays = Views(view.depth_m, view.geom, view.normal_world, view.T_world_camera, view.rays)
        kernels.keep(arrays, kernels.Shadowing(self._lamps, blockers, self._glows, level * self._strength), out)
        return out


def _blocks(geoms: Geoms, looks: list[Surface]) -> BoolArray:
    """(G,) which geoms hide light: no planes, lamps or ceilings, nothing flat, and no panes."""
    half = np.where(geoms.kind[:, None] == _BOX, geoms.size_m, geoms.size_m[:, :1])
    is_thick = 2 * half.min(axis=1) > _THINNEST_M
    is_other = np.array([look.glow > 0 or look.kind == "ceiling" for look in looks])
    is_pane = np.array([name.startswith("pane") for name in geoms.names])
    boxes = np.array([_box_of(geoms, g) for g in range(len(looks))])
    return np.asarray((geoms.kind != _PLANE) & is_thick & ~is_other & ~is_pane & (boxes[:, 3] > _LOWEST_M))


def _box_of(geoms: Geoms, g: int) -> FloatArray:
    """(8,) the upright box around a geom, as `Blockers` has it."""
    R, (x, y, z), size = geoms.R_world_geom[g], geoms.position_world[g], geoms.size_m[g]
    if geoms.kind[g] == _BOX:
        half = size
    elif geoms.kind[g] == _SPHERE:
        half = size[[0, 0, 0]]
    elif geoms.kind[g] == _ELLIPSOID:
        half = size
    else:
        half = np.array([size[0], size[0], size[1] + (0.0 if geoms.kind[g] == _CYLINDER else size[0])])
    if R[2, 2] > _UPRIGHT:
        return np.array([x, y, z - half[2], z + half[2], R[0, 0], R[1, 0], half[0], half[1]])
    half = abs(R) @ half
    return np.array([x, y, z - half[2], z + half[2], 1.0, 0.0, half[0], half[1]])


def _robot_at(T_world_base: FloatArray) -> FloatArray:
    """(P, 8) the boxes of chair and rider."""
    x_from, x_to, half_y, low, high = np.array(_ROBOT_M).T
    ahead = T_world_base[:2, 0] / np.hypot(*T_world_base[:2, 0])
    middle = T_world_base[:2, 3] + ((x_from + x_to) / 2)[:, None] * ahead
    ones = np.ones(len(half_y))
    sides = (x_to - x_from) / 2, half_y
    return np.stack([middle[:, 0], middle[:, 1], low, high, ahead[0] * ones, ahead[1] * ones, *sides], axis=1)


def _lamps_of(lighting: Lighting) -> kernels.Lamps:
    rows, columns = lighting.flux.shape[1:3]
    shape = (np.ceil(np.array([rows, columns]) * lighting.grid[2] / _CELL_M).astype(int) + 1).tolist()
    grid = np.array([*lighting.grid[:2], _CELL_M])
    brightest = np.empty((*shape, _CANDIDATES), np.int32)
    kernels.brightest_lamps(lighting.lamps, grid, LAMP_REACH_M, brightest)
    return kernels.Lamps(lighting.lamps, grid, brightest)


def _listed(lamps: kernels.Lamps, boxes: FloatArray, still: Int32Array) -> tuple[Int32Array, Int32Array]:
    """`starts` and `listed` of `Blockers`."""
    starts = np.empty(lamps.brightest.size + 1, np.int32)
    listed = np.empty(0, np.int32)
    count = kernels.list_blockers(lamps, boxes, still, starts, listed)
    listed = np.empty(count, np.int32)
    kernels.list_blockers(lamps, boxes, still, starts, listed)
    return starts, listed
