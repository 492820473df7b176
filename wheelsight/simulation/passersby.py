"""People who walk to and fro along a route while the robot drives it, and keep out of the robot's way."""

from __future__ import annotations

import math
from typing import Any

import cv2
import numpy as np
from scipy.ndimage import gaussian_filter1d

from wheelsight.errors import ConfigError
from wheelsight.geometry import BoolArray, ByteArray, FloatArray
from wheelsight.simulation import _walk_kernels as kernels
from wheelsight.simulation.drive import Drive
from wheelsight.simulation.robot import Robot
from wheelsight.simulation.world import Surface, World

RADIUS_M = 0.25
HEIGHT_M = 1.70
CLEARANCE_M = 0.6

_STEP_S = 0.25
_CELL_M = 0.1
_WIDEST_M = 1.5
_WALK_M_S = (0.8, 1.3)
_FASTEST_M_S = 1.6
_SIDEWAYS_M_S = 0.8
# Between two steps both go on straight, which can bring them nearer than at either end.
_MARGIN_M = 0.1
_GAP_TO_WALL_M = 0.05
_PATIENCE_S = 3.0
_APART_M = 0.8
_START_AWAY_M = 3.0
_LEG_S = (8.0, 40.0)
_TAIL_M = 0.3  # how far a wheelchair reaches behind its axle
_CORNER_M = 0.4
_CLOTHES = ((0.15, 0.17, 0.3), (0.45, 0.1, 0.12), (0.2, 0.35, 0.2), (0.5, 0.5, 0.48), (0.1, 0.1, 0.1), (0.6, 0.5, 0.3))


class Passersby:
    """Upright cylinders the size of people, walking to and fro along the world's route at 0.8 to 1.3 m/s.

    The drive is known before they walk. Going back from its end, all places are found from which somebody can still
    get out of the robot's way: those that are clear now and have one within a step that will be. Walkers choose among
    these only, so that they step aside, wait or turn back in time. Their axes stay at least 0.6 m from the robot's
    outline and 0.3 m from what stands in the world; from each other they keep away where they can.

    Args:
        world: whose route they walk and whose obstacles they go round.
        drive: finished; they have walked since its first pose and stand still after its last.
        count: how many.
        seed: of where they begin, how fast they walk and what they wear.
        robot: whose outline they keep away from.

    Raises:
        ConfigError: a negative count, or a route so narrow that there is nowhere to go.
    """

    def __init__(self, world: World, drive: Drive, count: int, seed: int, robot: Robot | None = None) -> None:
        if count < 0:
            raise ConfigError(f"{count} passers-by", fix="0 or more")
        self.count = count
        self._start_s = float(drive.truth.stamps_s[0])
        robot = robot or Robot()
        outline_m = np.array([-_TAIL_M, robot.length_m - _TAIL_M, robot.width_m / 2])
        places = _Places(world)
        self._xy_m = np.zeros((1, 0, 2))
        if count:
            times = np.arange(math.ceil(drive.duration_s / _STEP_S) + 1) * _STEP_S + self._start_s
            T = drive.truth.at(times.clip(None, drive.truth.stamps_s[-1]))
            safe = _safe_places(places, T, outline_m, world.name)
            self._xy_m = _walk(places, safe, T, count, np.random.default_rng((seed, 0x9A55)))

    @property
    def surfaces(self) -> dict[str, Surface]:
        """What they wear: a material each."""
        return {f"passerby{i}": _clothes(i) for i in range(self.count)}

    def positions_at(self, stamp_s: float) -> FloatArray:
        """(N, 2) where their axes stand at a time in seconds; before and after the drive, where they begin and end."""
        step = min(max((stamp_s - self._start_s) / _STEP_S, 0.0), len(self._xy_m) - 1.0)
        before = int(step)
        after = min(before + 1, len(self._xy_m) - 1)
        return np.asarray(self._xy_m[before] + (step - before) * (self._xy_m[after] - self._xy_m[before]))

    def add_to(self, spec: Any) -> None:
        """Put them as mocap bodies into a MuJoCo MjSpec."""
        import mujoco

        for i, (x, y) in enumerate(self._xy_m[0]):
            name, rgb = f"passerby{i}", _clothes(i).rgb
            spec.add_material(name=name, rgba=[*rgb, 1.0])
            body = spec.worldbody.add_body(name=name, mocap=True, pos=[x, y, HEIGHT_M / 2])
            cylinder = mujoco.mjtGeom.mjGEOM_CYLINDER
            body.add_geom(name=name, type=cylinder, size=[RADIUS_M, HEIGHT_M / 2, 0], material=name, contype=0)


class _Places:
    """A grid along a route, 10 cm wide each way.

    Attributes:
        xy_m: (S, L, 2) places; S along the route, L across it from right to left.
        is_free: (S, L) whether nothing stands there.
        is_loop: whether the last S is next to the first.
    """

    def __init__(self, world: World) -> None:
        self.is_loop = world.is_loop
        points = np.concatenate([world.route, world.route[:1]]) if world.is_loop else np.asarray(world.route, float)
        along = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(points, axis=0).T))])
        samples = np.linspace(0, along[-1], max(int(along[-1] / _CELL_M), 4), endpoint=not world.is_loop)
        line = np.stack([np.interp(samples, along, column) for column in points.T], axis=-1)
        mode = "wrap" if world.is_loop else "nearest"
        line = gaussian_filter1d(line, _CORNER_M / _CELL_M, axis=0, mode=mode)
        ahead = np.roll(line, -1, axis=0) - np.roll(line, 1, axis=0) if world.is_loop else np.gradient(line, axis=0)
        ahead = gaussian_filter1d(ahead, _CORNER_M / _CELL_M, axis=0, mode=mode)
        ahead /= np.hypot(*ahead.T)[:, None]
        left = np.stack([-ahead[:, 1], ahead[:, 0]], axis=-1)
        across = np.arange(-_WIDEST_M, _WIDEST_M + _CELL_M / 2, _CELL_M)
        self.xy_m = np.ascontiguousarray(line[:, None] + across[:, None] * left[:, None])
        self.is_free = _free(world, self.xy_m)


def _free(world: World, xy_m: FloatArray) -> BoolArray:
    """(...) whether somebody can stand at places (..., 2): nothing to bump into is nearer than 5 cm."""
    import mujoco
    import shapely

    model = mujoco.MjModel.from_xml_string(world.mjcf)
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    corners = np.array(np.meshgrid([-1, 1], [-1, 1], [-1, 1])).reshape(3, 8).T
    footprints = []
    for g in np.flatnonzero((model.geom_contype != 0) & (model.geom_type != mujoco.mjtGeom.mjGEOM_PLANE)):
        box = model.geom_aabb[g, :3] + corners * model.geom_aabb[g, 3:]
        box = data.geom_xpos[g] + box @ data.geom_xmat[g].reshape(3, 3).T
        if box[:, 2].max() > _GAP_TO_WALL_M and box[:, 2].min() < HEIGHT_M:
            footprints.append(shapely.MultiPoint(box[:, :2]).convex_hull)
    points = shapely.points(xy_m.reshape(-1, 2))
    is_free = np.ones(len(points), bool)
    if footprints:
        touched = shapely.STRtree(footprints).query(points, "dwithin", distance=RADIUS_M + _GAP_TO_WALL_M)
        is_free[touched[0]] = False
    return is_free.reshape(xy_m.shape[:-1])


def _safe_places(places: _Places, T_world_robot: FloatArray, outline_m: FloatArray, world: str) -> list[ByteArray]:
    """For each pose (N, 4, 4) the packed (S, L) places from which the robot can be avoided until the drive's end."""
    rows, columns = _reach()
    reach = np.ones((2 * rows + 1, 2 * columns + 1), np.uint8)
    safe = np.ones(places.is_free.shape, np.uint8)
    packed = []
    for T in T_world_robot[::-1]:
        R, xy = np.ascontiguousarray(T[:2, :2]), np.ascontiguousarray(T[:2, 3])
        clear = kernels.keeps_clear(places.xy_m, places.is_free, xy, R, outline_m, CLEARANCE_M + _MARGIN_M)
        safe = clear & _dilated(safe, reach, rows, places.is_loop)
        packed.append(np.packbits(safe))
    if not safe.any():
        raise ConfigError(f"world {world} leaves no room for passers-by beside the robot", fix="--passers-by 0")
    return packed[::-1]


def _dilated(safe: ByteArray, reach: ByteArray, rows: int, is_loop: bool) -> ByteArray:
    if not is_loop:
        return np.asarray(cv2.dilate(safe, reach, borderType=cv2.BORDER_CONSTANT, borderValue=0))
    wrapped = np.concatenate([safe[-rows:], safe, safe[:rows]])
    return np.asarray(cv2.dilate(wrapped, reach, borderType=cv2.BORDER_CONSTANT, borderValue=0)[rows:-rows])


def _reach() -> tuple[int, int]:
    """How many cells along and across one step can go."""
    return round(_FASTEST_M_S * _STEP_S / _CELL_M), round(_SIDEWAYS_M_S * _STEP_S / _CELL_M)


def _walk(
    places: _Places, safe: list[ByteArray], T_world_robot: FloatArray, count: int, rng: np.random.Generator
) -> FloatArray:
    """(N, count, 2) positions at the times of poses (N, 4, 4)."""
    shape = places.is_free.shape
    now = _unpacked(safe[0], shape)
    at = _starts(places, now, T_world_robot[0, :2, 3], count, rng)
    heading = rng.choice([-1, 1], count)
    stride_m = rng.uniform(*_WALK_M_S, count) * _STEP_S
    keeps_right = rng.integers(2, 6, count)
    turns_at_s = rng.uniform(*_LEG_S, count)
    stuck_s = np.zeros(count)
    rows, columns = _reach()
    xy_m = np.empty((len(safe), count, 2))
    xy_m[0] = places.xy_m[at[:, 0], at[:, 1]]
    for k in range(1, len(safe)):
        now = _unpacked(safe[k], shape)
        for i in range(count):
            favourite = shape[1] // 2 - heading[i] * keeps_right[i]
            others = np.concatenate([xy_m[k, :i], xy_m[k - 1, i + 1 :]])
            s, side = at[i]
            step = kernels.best_step(
                now,
                places.xy_m,
                places.is_loop,
                s,
                side,
                rows,
                columns,
                heading[i],
                stride_m[i],
                favourite,
                others,
                _APART_M,
            )
            moved_m = float(np.hypot(*(places.xy_m[step] - places.xy_m[s, side])))
            stuck_s[i] = stuck_s[i] + _STEP_S if moved_m < 0.3 * stride_m[i] else 0.0
            if stuck_s[i] > _PATIENCE_S or k * _STEP_S > turns_at_s[i]:
                heading[i], stuck_s[i] = -heading[i], 0.0
                turns_at_s[i] = k * _STEP_S + rng.uniform(*_LEG_S)
            at[i], xy_m[k, i] = step, places.xy_m[step]
    return xy_m


def _unpacked(packed: ByteArray, shape: tuple[int, ...]) -> ByteArray:
    return np.unpackbits(packed, count=math.prod(shape)).reshape(shape)


def _starts(
    places: _Places, safe: ByteArray, xy_robot_m: FloatArray, count: int, rng: np.random.Generator
) -> np.ndarray[Any, np.dtype[np.int64]]:
    """(count, 2) safe cells, some metres from the robot where there are such."""
    cells = np.argwhere(safe)
    away_m = np.hypot(*(places.xy_m[cells[:, 0], cells[:, 1]] - xy_robot_m).T)
    far = cells[away_m > _START_AWAY_M]
    return rng.choice(far if len(far) else cells, count)


def _clothes(index: int) -> Surface:
    return Surface("fabric", _CLOTHES[index % len(_CLOTHES)], scale_m=0.3, contrast=0.3, infrared=0.45)
