"""A world as the camera's rays meet it: MuJoCo casts them, many at a time, at the few geoms they can hit."""

from __future__ import annotations

import os
from collections.abc import Mapping
from concurrent.futures import ThreadPoolExecutor
from functools import lru_cache
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from wheelsight.errors import ConfigError
from wheelsight.geometry import FloatArray, Int32Array, PinholeCamera
from wheelsight.simulation import _ray_kernels as kernels
from wheelsight.simulation.view import Geoms, View
from wheelsight.simulation.world import Surface, World

if TYPE_CHECKING:
    from wheelsight.simulation.passersby import Passersby

_KINDS = {0: "plane", 2: "sphere", 3: "capsule", 4: "ellipsoid", 5: "cylinder", 6: "box"}
_BANDS = 30
_NO_LIMIT = 1e10
# MuJoCo's bounding volumes are those of compilation; told that there are none, it tries every target.
_NO_TREE = -1
_SMALLEST_TARGETS = 8
# A row's own z axis may be turned from the band's by as much as a shutter allows.
_FAR_MARGIN = 1.05


class Scene:
    """A world without robot, and the people who walk in it, as rays see it.

    Rows of a rolling shutter have poses of their own, and one call of MuJoCo's `mj_multiRay` has one origin. So rows
    are cast in bands of a thirtieth of the image: every ray has its own row's direction, and what it hits from the
    origin of the band's middle row is carried to its own along the surface's tangent plane. At 1.2 m/s and Kinect's
    shutter the origins of a band differ by at most 0.5 mm: depth is exact on flat surfaces, and off by micrometres on
    curved ones; an object's outline is off by those 0.5 mm at most.

    The rays of a band are cast only at geoms whose boxes reach into its frustum, for which a small model takes their
    place. Nothing a ray could hit is left out, and every band is cast the same way whichever thread does it.

    Args:
        world: with a name and a material for every geom.
        passersby: who walks there, or None; `move_to` says when.
        threads: how many cast at a time; None takes as many as there are processors, up to four.

    Raises:
        ConfigError: a geom without name or material, a material without surface, a mesh or height field.
    """

    def __init__(self, world: World, passersby: Passersby | None = None, threads: int | None = None) -> None:
        import mujoco

        self.world = world
        self.model = _compile(world, passersby)
        self.data = mujoco.MjData(self.model)
        self.surfaces: Mapping[str, Surface] = {**world.surfaces, **(passersby.surfaces if passersby else {})}
        self._passersby = passersby
        self._threads = min(os.cpu_count() or 1, 4) if threads is None else threads
        self._pool = ThreadPoolExecutor(self._threads) if self._threads > 1 else None
        self._targets = [_Targets() for _ in range(self._threads)]
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
        self._is_visible = _visible(self.model)
        self._half_m = np.array(self.model.geom_aabb[:, 3:])

    def move_to(self, stamp_s: float) -> None:
        """Put the people where they are at a time, in seconds; without people nothing moves."""
        if self._passersby is None:
            return
        import mujoco

        self.data.mocap_pos[:, :2] = self._passersby.positions_at(stamp_s)
        mujoco.mj_kinematics(self.model, self.data)
        self.geoms.position_world[:] = self.data.geom_xpos

    def cast(self, camera: PinholeCamera, T_world_camera_rows: ArrayLike, far_m: float = np.inf) -> View:
        """What each pixel's ray hits first, nearer than `far_m` along the camera's z axis.

        Args:
            camera: whose pixels; lens distortion is followed.
            T_world_camera_rows: (H, 4, 4) its pose as each row is read, or (4, 4) for all of them.
            far_m: hits beyond are none.
        """
        h, w = camera.height, camera.width
        T = np.ascontiguousarray(np.broadcast_to(np.asarray(T_world_camera_rows, float), (h, 4, 4)))
        view = View(
            depth_m=np.zeros((h, w), np.float32),
            geom=np.full((h, w), -1, np.int32),
            normal_world=np.zeros((h, w, 3), np.float32),
            T_world_camera=T,
            rays=_rays(camera),
        )
        center = self.geoms.position_world + np.einsum(
            "gij,gj->gi", self.geoms.R_world_geom, self.model.geom_aabb[:, :3]
        )
        step = -(-h // _BANDS)
        bands = [slice(top, min(top + step, h)) for top in range(0, h, step)]

        def work(thread: int) -> None:
            for band in bands[thread :: self._threads]:
                self._cast_band(view, band, center, far_m, self._targets[thread])

        if self._pool is None:
            work(0)
        else:
            list(self._pool.map(work, range(self._threads)))
        return view

    def _cast_band(self, view: View, band: slice, center: FloatArray, far_m: float, targets: _Targets) -> None:
        T = view.T_world_camera[band]
        middle = T[len(T) // 2]
        R, origin = np.ascontiguousarray(middle[:3, :3]), np.ascontiguousarray(middle[:3, 3])
        rays = view.rays[band]
        rays_world = np.empty_like(rays)
        bounds = kernels.aim(rays, np.ascontiguousarray(T[:, :3, :3]), R, rays_world)
        limit = far_m * _FAR_MARGIN
        geoms = self.geoms
        chosen = kernels.within(
            geoms.kind, center, self._half_m, geoms.R_world_geom, self._is_visible, R, origin, bounds, limit
        )
        hit, distance, normal = targets.cast(geoms, chosen, self.model, origin, rays_world)
        shift = origin - T[:, :3, 3]
        out = view.depth_m[band], view.geom[band], view.normal_world[band]
        kernels.gather(hit, distance, normal, rays_world, shift, far_m, chosen, *out)


class _Targets:
    """Small models whose geoms are overwritten with those a band's rays can hit.

    MuJoCo looks at every geom of a model for every ray, a nanosecond for each it can rule out; a floor has a thousand,
    and a band of its image meets twenty.
    """

    def __init__(self) -> None:
        self._models: dict[int, tuple[Any, Any]] = {}

    def cast(
        self, geoms: Geoms, chosen: Int32Array, model: Any, origin: FloatArray, rays_world: FloatArray
    ) -> tuple[Int32Array, FloatArray, FloatArray]:
        """Which of `chosen` (K,) each ray (…, 3) hits first, or -1; how many ray lengths away; outward normals."""
        import mujoco

        n = rays_world.shape[0] * rays_world.shape[1]
        small, data = self._of_size(len(chosen))
        k = len(chosen)
        small.geom_type[:k], small.geom_size[:k] = geoms.kind[chosen], geoms.size_m[chosen]
        small.geom_rbound[:k], small.geom_aabb[:k] = model.geom_rbound[chosen], model.geom_aabb[chosen]
        small.geom_group[:k], small.geom_group[k:] = 0, 1
        data.geom_xpos[:k] = geoms.position_world[chosen]
        data.geom_xmat[:k] = geoms.R_world_geom[chosen].reshape(-1, 9)
        hit, distance, normal = np.empty(n, np.int32), np.empty(n), np.empty(3 * n)
        groups = np.array([1, 0, 0, 0, 0, 0], np.uint8)
        rays = rays_world.reshape(-1)
        mujoco.mj_multiRay(small, data, origin, rays, groups, True, -1, hit, distance, normal, n, _NO_LIMIT)
        return hit, distance, normal.reshape(-1, 3)

    def _of_size(self, count: int) -> tuple[Any, Any]:
        import mujoco

        size = _SMALLEST_TARGETS
        while size < count:
            size *= 2
        if size not in self._models:
            spec = mujoco.MjSpec()
            for _ in range(size):
                spec.worldbody.add_geom(size=[1, 1, 1])
            model = spec.compile()
            model.body_bvhadr[:] = _NO_TREE
            data = mujoco.MjData(model)
            mujoco.mj_kinematics(model, data)
            self._models[size] = model, data
        return self._models[size]


@lru_cache(maxsize=8)
def _rays(camera: PinholeCamera) -> FloatArray:
    rays = np.ascontiguousarray(camera.rays())
    rays.setflags(write=False)
    return rays


def _compile(world: World, passersby: Passersby | None) -> Any:
    import mujoco

    try:
        spec = mujoco.MjSpec.from_string(world.mjcf)
        if passersby is not None:
            passersby.add_to(spec)
        return spec.compile()
    except ValueError as error:
        raise ConfigError(f"world {world.name}: MuJoCo does not take its MJCF: {error}") from error


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


def _visible(model: Any) -> np.ndarray[Any, np.dtype[np.bool_]]:
    """(G,) which geoms rays stop at: as in MuJoCo, those whose material is not fully transparent."""
    return np.asarray(model.mat_rgba[model.geom_matid, 3] > 0)
