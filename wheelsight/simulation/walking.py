"""People who walk: the ground they walk on, how each chooses a step, and what they look like."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter1d, label
from scipy.spatial import cKDTree

from wheelsight.geometry import BoolArray, ByteArray, FloatArray, IntArray
from wheelsight.simulation import _walk_kernels as kernels
from wheelsight.simulation.world import Surface, World

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


class Ground:
    """A grid of cells 10 cm wide over the ground, and the route on it.

    Attributes:
        corner_m: (2,) centre of the cell (0, 0); columns go along x, rows along y.
        is_free: (R, C) uint8, whether somebody can stand there and walk there from the route.
        along_m: (R, C) way along the route to its point nearest to the cell.
        left_m: (R, C) how far left of it the cell is.
        lap_m: after which way the route starts anew.
    """

    def __init__(self, world: World) -> None:
        line, ahead = _line(np.asarray(world.route, float), world.is_loop)
        low, high = line.min(axis=0) - _WIDEST_M, line.max(axis=0) + _WIDEST_M
        self.corner_m = np.floor(low / CELL_M) * CELL_M
        columns, rows = (np.ceil((high - self.corner_m) / CELL_M).astype(int) + 1).tolist()
        xy_m = self.corner_m + CELL_M * np.stack(np.meshgrid(np.arange(columns), np.arange(rows)), axis=-1)
        away_m, nearest = cKDTree(line).query(xy_m)
        apart = xy_m - line[nearest]
        self.along_m = CELL_M * nearest.astype(float)
        self.left_m = ahead[nearest, 0] * apart[..., 1] - ahead[nearest, 1] * apart[..., 0]
        self.lap_m = CELL_M * len(line) if world.is_loop else 1e9
        is_free = away_m <= _WIDEST_M
        is_free[is_free] = _free(world, xy_m[is_free])
        pieces, _ = label(is_free)
        extra = 0 if world.is_loop else round(_BEYOND_M / CELL_M)
        on_route = np.round((line[extra : len(line) - extra] - self.corner_m) / CELL_M).astype(int)
        reached = np.unique(pieces[on_route[:, 1], on_route[:, 0]])
        self.is_free = np.isin(pieces, reached[reached > 0]).astype(np.uint8)

    def xy_of(self, cells: IntArray) -> FloatArray:
        """Centres (..., 2) of cells (..., 2) of row and column."""
        return np.asarray(self.corner_m + CELL_M * cells[..., ::-1])


def _line(points: FloatArray, is_loop: bool) -> tuple[FloatArray, FloatArray]:
    """Points (N, 2) every 10 cm along a route with rounded corners, and its directions (N, 2).

    Routes with two ends are made longer at both: people come from farther than where the robot begins.
    """
    if is_loop:
        points = np.concatenate([points, points[:1]])
    else:
        first, last = points[0] - points[1], points[-1] - points[-2]
        ends = points[0] + _BEYOND_M * first / np.hypot(*first), points[-1] + _BEYOND_M * last / np.hypot(*last)
        points = np.concatenate([ends[0][None], points, ends[1][None]])
    along = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(points, axis=0).T))])
    samples = np.linspace(0, along[-1], max(int(along[-1] / CELL_M), 4), endpoint=not is_loop)
    line = np.stack([np.interp(samples, along, column) for column in points.T], axis=-1)
    line = gaussian_filter1d(line, _CORNER_M / CELL_M, axis=0, mode="wrap" if is_loop else "nearest")
    ahead = np.roll(line, -1, axis=0) - np.roll(line, 1, axis=0) if is_loop else np.gradient(line, axis=0)
    return line, ahead / np.hypot(*ahead.T)[:, None]


def _free(world: World, xy_m: FloatArray) -> BoolArray:
    """(N,) whether somebody can stand at places (N, 2): nothing to bump into is nearer than 5 cm."""
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

    Args:
        ground: where they walk.
        cells: (count, 2) where they begin.
        rng: of who they are.
    """

    def __init__(self, ground: Ground, cells: NDArray[np.int64], rng: np.random.Generator) -> None:
        count = len(cells)
        self.cells = cells
        self._rng, self._now = rng, 0
        self._heading = rng.choice([-1, 1], count)
        self._stride_m = rng.uniform(*_WALK_M_S, count) * STEP_S
        self._right_m = rng.uniform(*_KEEPS_RIGHT_M, count)
        self._turns_at_s = rng.uniform(*_TURNS_AFTER_S, count)
        self._stuck_s = np.zeros(count)
        self._steps = steps_within_reach()
        self._route = kernels.Route(ground.along_m, ground.left_m, ground.lap_m)

    def step(self, safe: Sequence[Sequence[ByteArray]]) -> NDArray[np.int64]:
        """Where they stand a step of `STEP_S` later (count, 2).

        Args:
            safe: for each of them, cells (R, C) to step to; others, in turn, where none is in reach; else it stays.
        """
        self._now += 1
        before, after = self.cells, self.cells.copy()
        for i, choices in enumerate(safe):
            others = np.concatenate([after[:i], before[i + 1 :]])
            after[i] = self._step_of(i, choices, others)
            moved_m = CELL_M * float(np.hypot(*(after[i] - before[i])))
            self._turn_back(i, is_stuck=moved_m < 0.3 * self._stride_m[i])
        self.cells = after
        return after

    def _step_of(self, i: int, choices: Sequence[ByteArray], others: NDArray[np.int64]) -> tuple[int, int]:
        heading = self._heading[i]
        wish = kernels.Wish(heading * self._stride_m[i], -heading * self._right_m[i])
        row, column = self.cells[i]
        for safe in choices:
            found = kernels.best_step(safe, self._route, self._steps, row, column, wish, others, _APART_M / CELL_M)
            if found[0] >= 0:
                return found
        return int(row), int(column)

    def _turn_back(self, i: int, *, is_stuck: bool) -> None:
        now_s = self._now * STEP_S
        self._stuck_s[i] = self._stuck_s[i] + STEP_S if is_stuck else 0.0
        if self._stuck_s[i] > _PATIENCE_S or now_s > self._turns_at_s[i]:
            self._heading[i], self._stuck_s[i] = -self._heading[i], 0.0
            self._turns_at_s[i] = now_s + self._rng.uniform(*_TURNS_AFTER_S)


class Cylinders:
    """Upright cylinders the size of people; whoever moves them says where they are.

    Args:
        xy_m: (N, 2) where they begin.
    """

    def __init__(self, xy_m: FloatArray) -> None:
        self._begin_m = xy_m

    @property
    def count(self) -> int:
        """How many."""
        return len(self._begin_m)

    @property
    def surfaces(self) -> dict[str, Surface]:
        """What they wear: a material each."""
        return {f"passerby{i}": _clothes(i) for i in range(self.count)}

    def add_to(self, spec: Any) -> None:
        """Put them as mocap bodies into a MuJoCo MjSpec."""
        import mujoco

        for i, (x, y) in enumerate(self._begin_m):
            name = f"passerby{i}"
            spec.add_material(name=name, rgba=[*_clothes(i).rgb, 1.0])
            body = spec.worldbody.add_body(name=name, mocap=True, pos=[x, y, HEIGHT_M / 2])
            cylinder = mujoco.mjtGeom.mjGEOM_CYLINDER
            body.add_geom(name=name, type=cylinder, size=[RADIUS_M, HEIGHT_M / 2, 0], material=name, contype=0)


def reach_cells() -> int:
    """How many cells somebody gets on in a step, at most."""
    return int(_FASTEST_M_S * STEP_S / CELL_M + 1e-9)


def steps_within_reach() -> NDArray[np.int64]:
    """(K, 2) cells within a step's reach."""
    side = np.arange(-reach_cells(), reach_cells() + 1)
    steps: NDArray[np.int64] = np.stack(np.meshgrid(side, side, indexing="ij"), axis=-1).reshape(-1, 2)
    return np.asarray(steps[np.hypot(*steps.T) <= reach_cells()])


def starts(
    ground: Ground, safe: ByteArray, xy_robot_m: FloatArray, count: int, rng: np.random.Generator
) -> NDArray[np.int64]:
    """(count, 2) safe cells, some metres from the robot where there are such."""
    cells = np.argwhere(safe)
    away_m = np.hypot(*(ground.xy_of(cells) - xy_robot_m).T)
    far = cells[away_m > _START_AWAY_M]
    return rng.choice(far if len(far) else cells, count)


def _clothes(index: int) -> Surface:
    return Surface("fabric", _CLOTHES[index % len(_CLOTHES)], scale_m=0.3, contrast=0.3, infrared=0.45)
