"""A world as the camera's rays meet it. View holds what they hit."""

from __future__ import annotations

import os
from collections.abc import Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from wheelsight.core.errors import ConfigError
from wheelsight.core.geometry import FloatArray, Int32Array, IntArray, PinholeCamera
from wheelsight_sim.doors import Leaves
from wheelsight_sim.light_kernels import View as View
from wheelsight_sim.people import Cylinders
from wheelsight_sim.view_kernels import Boxes, cast, find, spread
from wheelsight_sim.world import Surface, World

_KINDS = {0: "plane", 2: "sphere", 3: "capsule", 4: "ellipsoid", 5: "cylinder", 6: "box"}
_TILE_ROWS = 16
_TILE_COLUMNS = 80
_FIRST_GROUP = np.array([1, 0, 0, 0, 0, 0], np.uint8)


class Scene:
    """A world without robot, and the people who walk and the doors that swing in it, as rays see it.

    Rays are cast in tiles of sixteen rows: every ray has its own row's direction, and what it hits from the origin of
    the tile's middle row is carried to its own along the surface's tangent plane. At 1.2 m/s and Kinect's shutter these
    origins differ by 1 mm at most in images of 320×240: depth is exact on flat surfaces, and off by micrometres on
    curved ones. Nothing a ray could hit is left out, and every tile is cast the same way whichever thread does it.

    `moving` are the indices (M,) of the geoms that `move_to` moves.

    Args:
        world: with a name and a material for every geom.
        passersby: who walks there, or None; `move_to` says when.
        threads: how many cast at a time; None takes as many as there are processors, up to four.
        doors: which swing there, or None.

    Raises:
        ConfigError: a geom without name or material, a material without surface, a mesh or height field.
    """

    def __init__(
        self, world: World, passersby: Cylinders | None = None, threads: int | None = None, doors: Leaves | None = None
    ) -> None:
        import mujoco

        self.world = world
        try:
            spec = mujoco.MjSpec.from_string(world.mjcf)
            if passersby is not None:
                passersby.add_to(spec)
            if doors is not None:
                doors.add_to(spec)
            self.model: Any = spec.compile()
        except ValueError as error:
            raise ConfigError(f"world {world.name}: MuJoCo does not take its MJCF: {error}") from error
        self.data = mujoco.MjData(self.model)
        self.surfaces: Mapping[str, Surface] = {**world.surfaces, **(passersby.surfaces if passersby else {})}
        self._passersby, self._doors = passersby, doors
        self._threads = min(os.cpu_count() or 1, 4) if threads is None else threads
        self._pool = ThreadPoolExecutor(self._threads) if self._threads > 1 else None
        mujoco.mj_kinematics(self.model, self.data)
        names, materials = _names(self.model, self.surfaces, world.name)
        self.geoms = Geoms(
            names,
            materials,
            kind=np.array(self.model.geom_type, np.int32),
            size_m=np.array(self.model.geom_size),
            position_world=np.array(self.data.geom_xpos),
            R_world_geom=np.array(self.data.geom_xmat).reshape(-1, 3, 3),
        )
        is_mocap = self.model.body_mocapid[self.model.geom_bodyid] >= 0
        self.moving: IntArray = np.flatnonzero(is_mocap)
        # Rays pass through geoms whose material is fully transparent, as in MuJoCo.
        is_visible = np.asarray(self.model.mat_rgba[self.model.geom_matid, 3] > 0)
        self._half_m = np.where(is_visible[:, None], self.model.geom_aabb[:, 3:], -1.0)

    def move_to(self, stamp_s: float) -> None:
        """Put people and doors where they are at a time, in seconds; without any nothing moves."""
        if self._passersby is None and self._doors is None:
            return
        import mujoco

        people = 0 if self._passersby is None else self._passersby.count
        if self._passersby is not None:
            self.data.mocap_pos[:people, :2] = self._passersby.positions_at(stamp_s)
        if self._doors is not None:
            middles, yaws_rad = self._doors.poses_at(stamp_s)
            self.data.mocap_pos[people:] = middles
            self.data.mocap_quat[people:, 0] = np.cos(yaws_rad / 2)
            self.data.mocap_quat[people:, 3] = np.sin(yaws_rad / 2)
        mujoco.mj_kinematics(self.model, self.data)
        self.geoms.position_world[:] = self.data.geom_xpos
        self.geoms.R_world_geom[:] = self.data.geom_xmat.reshape(-1, 3, 3)

    def cast(self, camera: PinholeCamera, T_world_camera_rows: ArrayLike) -> View:
        """What each pixel's ray hits first; lens distortion is followed.

        `T_world_camera_rows` (H, 4, 4) is the camera's pose as each row is read, or (4, 4) for all of them.
        """
        h, w = camera.height, camera.width
        # A copy: kernels would be compiled once more for poses that may not be written.
        T = np.array(np.broadcast_to(np.asarray(T_world_camera_rows, float), (h, 4, 4)), order="C")
        view = _nothing(T, _rays(camera))
        self._cast_tiles(view, _tiles(h, w))
        return view

    def outlines(self, view: View) -> Outlines:
        """What further rays hit in the pixels of a view beside which another face is seen.

        They are cast by the rules of `cast`, at the geoms where they stand now, as seen from the poses of their rows:
        people have not moved since `cast` returned the view.
        """
        pixels, ends = find(view.geom, view.normal_world, _tiles(*view.geom.shape))
        rays = spread(view.rays, pixels)
        # Kernels that are compiled for a view's rays need not be compiled once more.
        rays.setflags(write=view.rays.flags.writeable)
        samples = _nothing(view.T_world_camera[pixels[:, 0]], rays)
        tiles = np.zeros((len(ends) - 1, 4), np.int64)
        tiles[:, 0], tiles[:, 1], tiles[:, 3] = ends[:-1], ends[1:], rays.shape[1]
        self._cast_tiles(samples, tiles[tiles[:, 0] < tiles[:, 1]])
        return Outlines(pixels, samples)

    def reach_m(self, begins: FloatArray, direction: FloatArray) -> FloatArray:
        """How far (N,) rays from points (N, 3) come in a unit direction (3,); infinitely far where nothing is hit."""
        import mujoco

        hit, normal = np.zeros(1, np.int32), np.zeros(3)
        ways_m = [
            mujoco.mj_ray(self.model, self.data, begin, direction, _FIRST_GROUP, True, -1, hit, normal)
            for begin in begins
        ]
        return np.array([way_m if way_m >= 0 else np.inf for way_m in ways_m])

    def _cast_tiles(self, view: View, tiles: IntArray) -> None:
        geoms = self.geoms
        boxes = Boxes(geoms.kind, geoms.size_m, geoms.position_world, self._half_m, geoms.R_world_geom)
        if self._pool is None:
            cast(view, tiles, boxes)
        else:
            shares = [tiles[thread :: self._threads].copy() for thread in range(self._threads)]
            list(self._pool.map(lambda share: cast(view, share, boxes), shares))


def _nothing(T_world_camera: FloatArray, rays: FloatArray) -> View:
    """A view (H, W) of rays (H, W, 3) that have not hit anything, from a pose for each row (H, 4, 4)."""
    h, w, _ = rays.shape
    depth_m, normal_world = np.zeros((h, w), np.float32), np.zeros((h, w, 3), np.float32)
    return View(depth_m, np.full((h, w), -1, np.int32), normal_world, T_world_camera, rays)


@lru_cache(maxsize=8)
def _tiles(h: int, w: int) -> IntArray:
    """(T, 4) first and last row and column, the last left out, of the rectangles that cover an image."""
    tops, lefts = np.meshgrid(np.arange(0, h, _TILE_ROWS), np.arange(0, w, _TILE_COLUMNS), indexing="ij")
    ends = (tops + _TILE_ROWS).clip(max=h), (lefts + _TILE_COLUMNS).clip(max=w)
    return np.stack([tops, ends[0], lefts, ends[1]], axis=-1).reshape(-1, 4)


@lru_cache(maxsize=8)
def _rays(camera: PinholeCamera) -> FloatArray:
    rays = np.ascontiguousarray(camera.rays())
    rays.setflags(write=False)
    return rays


def _names(model: Any, surfaces: Mapping[str, Surface], world: str) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Names and materials of all geoms. Raises ConfigError where one cannot be cast at or painted."""
    names, materials = [], []
    for index in range(model.ngeom):
        name = model.geom(index).name
        where = f"world {world}: geom {name or index}"
        if int(model.geom_type[index]) not in _KINDS:
            raise ConfigError(f"{where} is no primitive", fix=f"build it of {', '.join(_KINDS.values())}")
        if not name:
            raise ConfigError(f"{where} has no name")
        if model.geom_matid[index] < 0:
            raise ConfigError(f"{where} has no material")
        material = model.mat(model.geom_matid[index]).name
        if material not in surfaces:
            raise ConfigError(f"{where}: its material {material} has no surface")
        names.append(name)
        materials.append(material)
    return tuple(names), tuple(materials)


@dataclass(frozen=True, slots=True, eq=False)
class Outlines:
    """More rays through the pixels (N, 2), rows and columns, of a view beside which another face is seen.

    `samples` is what each pixel's S further rays hit: (N, S) for (H, W), with the poses of the pixels' rows.
    """

    pixels: Int32Array
    samples: View


@dataclass(frozen=True, slots=True, eq=False)
class Geoms:
    """The G geoms of a scene in the MJCF's order, as arrays that kernels can read; those of moving bodies change.

    Materials are keys of `World.surfaces`, `kind` and `size_m` are MuJoCo's, and `position_world` is of the middles.
    """

    names: tuple[str, ...]
    materials: tuple[str, ...]
    kind: Int32Array
    size_m: FloatArray
    position_world: FloatArray
    R_world_geom: FloatArray
