"""People who walk: `Passersby` along a finished drive; `LivePassersby` react to a commanded robot."""

from __future__ import annotations

import math
import zlib
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter1d, label
from scipy.spatial import cKDTree

from wheelsight.core.errors import ConfigError
from wheelsight.core.geometry import BoolArray, ByteArray, FloatArray, IntArray
from wheelsight_sim import walking_kernels as kernels
from wheelsight_sim.robot import Drive, RobotModel, outline_m
from wheelsight_sim.world import Surface, World

RADIUS_M = 0.25
HEIGHT_M = 1.70
STEP_S = 0.25
CELL_M = 0.1

_WIDEST_M = 1.5
_BEYOND_M = 6.0
_CORNER_M = 0.4
_WALK_M_S = (0.8, 1.3)
_FASTEST_M_S = 1.6
_GAP_TO_WALL_M = 0.05
_PATIENCE_S = 3.0
_APART_M = 0.8
_START_AWAY_M = 3.0
_TURNS_AFTER_S = (8.0, 40.0)
_KEEPS_RIGHT_M = (0.2, 0.6)
_CLOTHES = ((0.15, 0.17, 0.3), (0.45, 0.1, 0.12), (0.2, 0.35, 0.2), (0.5, 0.5, 0.48), (0.1, 0.1, 0.1), (0.6, 0.5, 0.3))


class WalkableGrid:
    """A grid of cells 10 cm wide over the ground, and the route on it.

    Attributes:
        corner_m: (2,) centre of the cell (0, 0); columns go along x, rows along y.
        is_free: (R, C) uint8, whether a person can stand there and reach the route.
        along_m: (R, C) distance along the route of its point nearest to the cell.
        left_m: (R, C) distance of the cell to the left of the route.
        lap_m: length of a lap.
    """

    def __init__(self, world: World) -> None:
        # Points (N, 2) every 10 cm along the route with rounded corners, and its directions (N, 2).
        points, is_loop = np.asarray(world.route, float), world.is_loop
        if is_loop:
            points = np.concatenate([points, points[:1]])
        else:
            # Longer at both ends: people come from farther than where the robot begins.
            first, last = points[0] - points[1], points[-1] - points[-2]
            ends = points[0] + _BEYOND_M * first / np.hypot(*first), points[-1] + _BEYOND_M * last / np.hypot(*last)
            points = np.concatenate([ends[0][None], points, ends[1][None]])
        along = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(points, axis=0).T))])
        samples = np.linspace(0, along[-1], max(int(along[-1] / CELL_M), 4), endpoint=not is_loop)
        line = np.stack([np.interp(samples, along, column) for column in points.T], axis=-1)
        line = gaussian_filter1d(line, _CORNER_M / CELL_M, axis=0, mode="wrap" if is_loop else "nearest")
        ahead = np.roll(line, -1, axis=0) - np.roll(line, 1, axis=0) if is_loop else np.gradient(line, axis=0)
        ahead = ahead / np.hypot(*ahead.T)[:, None]
        low, high = line.min(axis=0) - _WIDEST_M, line.max(axis=0) + _WIDEST_M
        self.corner_m = np.floor(low / CELL_M) * CELL_M
        columns, rows = (np.ceil((high - self.corner_m) / CELL_M).astype(int) + 1).tolist()
        xy_m = self.corner_m + CELL_M * np.stack(np.meshgrid(np.arange(columns), np.arange(rows)), axis=-1)
        away_m, nearest = cKDTree(line).query(xy_m)
        apart = xy_m - line[nearest]
        self.along_m = CELL_M * nearest.astype(float)
        self.left_m = ahead[nearest, 0] * apart[..., 1] - ahead[nearest, 1] * apart[..., 0]
        self.lap_m = CELL_M * len(line) if is_loop else 1e9
        is_free = away_m <= _WIDEST_M
        is_free[is_free] = _free(world, xy_m[is_free])
        pieces, _ = label(is_free)
        extra = 0 if is_loop else round(_BEYOND_M / CELL_M)
        on_route = np.round((line[extra : len(line) - extra] - self.corner_m) / CELL_M).astype(int)
        reached = np.unique(pieces[on_route[:, 1], on_route[:, 0]])
        self.is_free = np.isin(pieces, reached[reached > 0]).astype(np.uint8)

    def xy_of(self, cells: IntArray) -> FloatArray:
        """Centres (..., 2) of cells (..., 2) of row and column."""
        return np.asarray(self.corner_m + CELL_M * cells[..., ::-1])

    def keep_clear(self, clear: ByteArray, T_world_base: FloatArray, outline_m: FloatArray, distance_m: float) -> None:
        """Set cells of `clear` (R, C) to 0 that are nearer to the outline of a robot at a pose (4, 4)."""
        R, xy_m = np.ascontiguousarray(T_world_base[:2, :2]), np.ascontiguousarray(T_world_base[:2, 3])
        kernels.keep_clear(clear, CELL_M, self.corner_m, xy_m, R, outline_m, distance_m)


def _free(world: World, xy_m: FloatArray) -> BoolArray:
    """(N,) whether a person can stand at places (N, 2): no obstacle is nearer than 5 cm."""
    import mujoco
    import shapely

    model, data = world.at_rest()
    corners = np.array(np.meshgrid([-1, 1], [-1, 1], [-1, 1])).reshape(3, 8).T
    footprints = []
    for g in np.flatnonzero((model.geom_contype != 0) & (model.geom_type != mujoco.mjtGeom.mjGEOM_PLANE)):
        box = model.geom_aabb[g, :3] + corners * model.geom_aabb[g, 3:]
        box = data.geom_xpos[g] + box @ data.geom_xmat[g].reshape(3, 3).T
        if box[:, 2].max() > _GAP_TO_WALL_M and box[:, 2].min() < HEIGHT_M:
            footprints.append(shapely.MultiPoint(box[:, :2]).convex_hull)
    is_free = np.ones(len(xy_m), bool)
    if footprints:
        reach_m = RADIUS_M + _GAP_TO_WALL_M
        touched = shapely.STRtree(footprints).query(shapely.points(xy_m), "dwithin", distance=reach_m)
        is_free[touched[0]] = False
    return is_free


class Walkers:
    """Each walks to and fro along the route at a speed of its own, on its own side, and turns back now and then.

    Attributes:
        cells: (count, 2) row and column where they stand.

    `rng` decides who they are.
    """

    def __init__(self, ground: WalkableGrid, cells: NDArray[np.int64], rng: np.random.Generator) -> None:
        count = len(cells)
        self.cells = cells
        self._rng, self._now = rng, 0
        self._heading = rng.choice([-1, 1], count)
        self._stride_m = rng.uniform(*_WALK_M_S, count) * STEP_S
        self._right_m = rng.uniform(*_KEEPS_RIGHT_M, count)
        self._turns_at_s = rng.uniform(*_TURNS_AFTER_S, count)
        self._stuck_s = np.zeros(count)
        self._steps = steps_within_reach()
        self._route = kernels.RouteGrid(ground.along_m, ground.left_m, ground.lap_m)

    def step(self, safe: Sequence[Sequence[ByteArray]]) -> NDArray[np.int64]:
        """Where they stand a step of `STEP_S` later (count, 2).

        Args:
            safe: for each of them, cells (R, C) to step to; others, in turn, where none is in reach; else it stays.
        """
        self._now += 1
        before, after = self.cells, self.cells.copy()
        for i, choices in enumerate(safe):
            others = np.concatenate([after[:i], before[i + 1 :]])
            heading = self._heading[i]
            wish = kernels.Wish(heading * self._stride_m[i], -heading * self._right_m[i])
            row, column = self.cells[i]
            for cells in choices:
                found = kernels.best_step(cells, self._route, self._steps, row, column, wish, others, _APART_M / CELL_M)
                if found[0] >= 0:
                    after[i] = found
                    break
            moved_m = CELL_M * float(np.hypot(*(after[i] - before[i])))
            now_s = self._now * STEP_S
            self._stuck_s[i] = self._stuck_s[i] + STEP_S if moved_m < 0.3 * self._stride_m[i] else 0.0
            if self._stuck_s[i] > _PATIENCE_S or now_s > self._turns_at_s[i]:
                self._heading[i], self._stuck_s[i] = -self._heading[i], 0.0
                self._turns_at_s[i] = now_s + self._rng.uniform(*_TURNS_AFTER_S)
        self.cells = after
        return after


class Cylinders:
    """Upright cylinders the size of people; subclasses give their positions."""

    def __init__(self, xy_m: FloatArray) -> None:
        self._begin_m = xy_m

    @property
    def count(self) -> int:
        """Number of people."""
        return len(self._begin_m)

    @property
    def surfaces(self) -> dict[str, Surface]:
        """The material of each."""
        return {f"passerby{i}": _clothes(i) for i in range(self.count)}

    def positions_at(self, stamp_s: float) -> FloatArray:
        """(N, 2) positions of their axes at a time in seconds, metres."""
        raise NotImplementedError

    def add_to(self, spec: Any) -> None:
        """Add them to a MuJoCo MjSpec as mocap bodies."""
        import mujoco

        for i, (x, y) in enumerate(self._begin_m):
            name = f"passerby{i}"
            spec.add_material(name=name, rgba=[*_clothes(i).rgb, 1.0])
            body = spec.worldbody.add_body(name=name, mocap=True, pos=[x, y, HEIGHT_M / 2])
            cylinder = mujoco.mjtGeom.mjGEOM_CYLINDER
            body.add_geom(name=name, type=cylinder, size=[RADIUS_M, HEIGHT_M / 2, 0], material=name, contype=0)


def reach_cells() -> int:
    """Largest number of cells in a step."""
    return int(_FASTEST_M_S * STEP_S / CELL_M + 1e-9)


def steps_within_reach() -> NDArray[np.int64]:
    """(K, 2) cells within a step's reach."""
    side = np.arange(-reach_cells(), reach_cells() + 1)
    steps: NDArray[np.int64] = np.stack(np.meshgrid(side, side, indexing="ij"), axis=-1).reshape(-1, 2)
    return np.asarray(steps[np.hypot(*steps.T) <= reach_cells()])


def starts(
    ground: WalkableGrid, safe: ByteArray, xy_robot_m: FloatArray, count: int, rng: np.random.Generator
) -> NDArray[np.int64]:
    """(count, 2) random safe cells, some metres from the robot if possible."""
    cells = np.argwhere(safe)
    away_m = np.hypot(*(ground.xy_of(cells) - xy_robot_m).T)
    far = cells[away_m > _START_AWAY_M]
    return rng.choice(far if len(far) else cells, count)


def _clothes(index: int) -> Surface:
    return Surface("fabric", _CLOTHES[index % len(_CLOTHES)], scale_m=0.3, contrast=0.3, infrared=0.45)


CLEARANCE_M = 0.6

# Between two steps both move straight, and may be nearer than at either end.
_MARGIN_M = 0.1
_STREAM = 0x9A55


class Passersby(Cylinders):
    """Upright cylinders the size of people, walking to and fro along the world's route at 0.8 to 1.3 m/s.

    The drive is finished before they walk. A backward pass finds all cells from which a person can still leave the
    robot's path: those that are clear now, with a clear one within the next step. Walkers choose among these only, so
    that they step aside, wait or turn back in time. Their axes stay at least 0.6 m from the robot's outline and 0.3 m
    from obstacles, and they avoid each other if possible.

    Raises:
        ConfigError: a negative count, or a world without room for people.
    """

    def __init__(self, world: World, drive: Drive, count: int, seed: int, robot: RobotModel | None = None) -> None:
        if count < 0:
            raise ConfigError(f"{count} passers-by", fix="0 or more")
        self._start_s = float(drive.truth.stamps_s[0])
        self._xy_m = np.zeros((1, 0, 2))
        if count:
            robot = robot or RobotModel()
            times_s = np.arange(math.ceil(drive.duration_s / STEP_S) + 1) * STEP_S + self._start_s
            T = drive.truth.at(times_s.clip(None, drive.truth.stamps_s[-1]))
            ground = WalkableGrid(world)
            safe = _SafeCells(ground, T, outline_m(robot), world.name)
            # (N, count, 2) positions, a step apart.
            xy_robot_m = T[0, :2, 3]
            rng = np.random.default_rng((seed, _STREAM))
            walkers = Walkers(ground, starts(ground, safe.at(0), xy_robot_m, count, rng), rng)
            cells = [walkers.cells, *(walkers.step([[safe.at(k)]] * count) for k in range(1, len(safe)))]
            self._xy_m = ground.xy_of(np.array(cells))
        super().__init__(self._xy_m[0])

    def positions_at(self, stamp_s: float) -> FloatArray:
        """(N, 2) positions of their axes at a time in seconds, clamped to the drive."""
        step = min(max((stamp_s - self._start_s) / STEP_S, 0.0), len(self._xy_m) - 1.0)
        before = int(step)
        after = min(before + 1, len(self._xy_m) - 1)
        return np.asarray(self._xy_m[before] + (step - before) * (self._xy_m[after] - self._xy_m[before]))


class _SafeCells:
    """Cells (R, C) from which the robot at poses (N, 4, 4), a step apart, can be avoided until the last of them.

    Those of each step are stored as the small difference to the free ones.
    """

    def __init__(self, ground: WalkableGrid, T_world_robot: FloatArray, reach_m: FloatArray, world: str) -> None:
        self._is_free, self._packed = ground.is_free, list[bytes]()
        reach = np.zeros((2 * reach_cells() + 1,) * 2, np.uint8)
        reach[tuple((steps_within_reach() + reach_cells()).T)] = 1
        safe = ground.is_free
        for T in T_world_robot[::-1]:
            near_safe = cv2.dilate(safe, reach, borderType=cv2.BORDER_CONSTANT, borderValue=0)
            safe = np.where(near_safe, ground.is_free, np.uint8(0))
            ground.keep_clear(safe, T, reach_m, CLEARANCE_M + _MARGIN_M)
            self._packed.append(zlib.compress(np.packbits(safe ^ self._is_free).tobytes(), 1))
        if not safe.any():
            raise ConfigError(f"world {world} leaves no room for passers-by beside the robot", fix="--passers-by 0")

    def __len__(self) -> int:
        return len(self._packed)

    def at(self, step: int) -> ByteArray:
        """(R, C) uint8."""
        bits = np.frombuffer(zlib.decompress(self._packed[-1 - step]), np.uint8)
        return np.unpackbits(bits, count=self._is_free.size).reshape(self._is_free.shape) ^ self._is_free


_LIVE_PASSERSBY_STREAM = 0x11FE
_KEPT_STEPS = 8  # two seconds; frames need the last tenth


@dataclass(frozen=True, slots=True)
class LivePeopleSettings:
    """Reaction of people to a robot.

    Attributes:
        clearance_m: distance from its outline to their axes that they keep if possible, as `Passersby` do. Chosen.
        least_m: the distance without room for that. Chosen: a hand's breadth from skin to robot.
        careless: share of people who ignore the robot until they bump into it. Chosen.
    """

    clearance_m: float = 0.6
    least_m: float = 0.33
    careless: float = 0.1


class LivePassersby(Cylinders):
    """Upright cylinders the size of people that walk to and fro along the world's route and react to the robot.

    Each step avoids the robot's present pose and the one a step later at constant velocity. A robot may still hit
    people without room to avoid it, and careless ones walk into it.

    `T_world_base` (4, 4) is the initial pose of the robot.

    Raises:
        ConfigError: a world without room for people.
    """

    def __init__(
        self,
        world: World,
        T_world_base: FloatArray,
        count: int,
        seed: int,
        robot: RobotModel,
        settings: LivePeopleSettings | None = None,
    ) -> None:
        self._settings = settings or LivePeopleSettings()
        self._ground, self._outline_m = WalkableGrid(world), outline_m(robot)
        rng = np.random.default_rng((seed, _LIVE_PASSERSBY_STREAM))
        clear = self._clear_of([T_world_base], self._settings.clearance_m)
        if not clear.any():
            raise ConfigError(
                f"world {world.name} leaves no room for passers-by beside the robot", fix="--passers-by 0"
            )
        self._walkers = Walkers(self._ground, starts(self._ground, clear, T_world_base[:2, 3], count, rng), rng)
        self._is_careless = rng.random(count) < self._settings.careless
        self._steps_m: deque[FloatArray] = deque([self._ground.xy_of(self._walkers.cells)], _KEPT_STEPS)
        self._newest = 0
        super().__init__(self._steps_m[0])

    def step(self, T_world_base: FloatArray, T_world_next: FloatArray) -> None:
        """Choose positions for `STEP_S` later, with the robot's present pose and its pose then at constant velocity."""
        both = [T_world_base, T_world_next]
        minding = [self._clear_of(both, self._settings.clearance_m), self._clear_of(both, self._settings.least_m)]
        # A careless person notices the robot when half of the body overlaps its outline.
        careless = [self._clear_of([T_world_base], RADIUS_M / 2)]
        cells = self._walkers.step([careless if is_careless else minding for is_careless in self._is_careless])
        self._steps_m.append(self._ground.xy_of(cells))
        self._newest += 1

    def positions_at(self, stamp_s: float) -> FloatArray:
        """(N, 2) positions of their axes at a time up to the last step, metres, clamped to the stored steps."""
        before, after, share = self._around(stamp_s)
        return np.asarray(before + share * (after - before))

    def velocities_at(self, stamp_s: float) -> FloatArray:
        """(N, 2) velocities, m/s."""
        before, after, _ = self._around(stamp_s)
        return np.asarray((after - before) / STEP_S)

    def _around(self, stamp_s: float) -> tuple[FloatArray, FloatArray, float]:
        oldest = self._newest + 1 - len(self._steps_m)
        step = min(max(stamp_s / STEP_S - oldest, 0.0), len(self._steps_m) - 1.0)
        index = min(int(step), max(len(self._steps_m) - 2, 0))
        return self._steps_m[index], self._steps_m[min(index + 1, len(self._steps_m) - 1)], step - index

    def _clear_of(self, poses: list[FloatArray], distance_m: float) -> ByteArray:
        """(R, C) free cells that are not so near to the robot at any of the poses."""
        clear = self._ground.is_free.copy()
        for T in poses:
            self._ground.keep_clear(clear, T, self._outline_m, distance_m)
        return clear
