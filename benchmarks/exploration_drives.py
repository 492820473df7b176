"""A robot that explores a world by its own localization; its map is judged by the simulator's truth."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
import shapely

from benchmarks.exploration_truth import CELL_M, TruePlan, tour_m
from benchmarks.session_starts import Building
from wheelsight.app.run.drives import exploring
from wheelsight.config import Config, load_config
from wheelsight.core.files import write_bytes
from wheelsight.core.geometry import BoolArray, ByteArray, FloatArray, se2, se3
from wheelsight.core.trajectory import Trajectory
from wheelsight.evaluation import ate
from wheelsight.mapping.occupancy import camera_over_floor
from wheelsight.navigation import DepthViewer, KnownFloor, NavigationResult, StaticLayer, planar_pose
from wheelsight.navigation.costmap import CellState
from wheelsight.navigation.exploration import ViewSector
from wheelsight.slam.maps import MapFolder, driven_way, occupancy_of
from wheelsight_sim import SimulationSettings
from wheelsight_sim.clearance import obstacles
from wheelsight_sim.simulator import Simulator
from wheelsight_sim.world import World

SHARE_PERCENT = 97.0
# Nearer to open floor than this, a cell that is called free is off by rounding alone: a cell's diagonal.
_ROUNDING_M = 0.07


@dataclass(frozen=True)
class Explored:
    """What became of an exploration.

    Attributes:
        building, seed: which.
        ended: in words; "" where it says that nothing is left.
        reachable_m2: floor that the outline covers wherever it can come to from the start.
        free_m2: how much of it the map calls free.
        wrong_m2: floor that the map calls free, and that something stands on, or that is behind walls.
        ate_m: RMSE of keyframes' places after rigid alignment.
        walls_m: median distance from occupied cells beside free ones to the nearest true side of a thing.
        way_m, tour_m: truly driven, and of somebody who knows the plan.
        contacts: what the robot touched by its own motion.
        clearance_m: least true distance from outline to things.
        time_s: simulated.
        keyframes, loops: of the map.
    """

    building: str
    seed: int
    ended: str
    reachable_m2: float
    free_m2: float
    wrong_m2: float
    ate_m: float
    walls_m: float
    way_m: float
    tour_m: float
    contacts: tuple[str, ...]
    clearance_m: float
    time_s: float
    keyframes: int
    loops: int

    @property
    def share_percent(self) -> float:
        """Of the reachable floor that the map calls free."""
        return 100 * self.free_m2 / self.reachable_m2

    @property
    def tours(self) -> float:
        """How many times as far as the tour it drove."""
        return self.way_m / self.tour_m

    @property
    def sentence(self) -> str:
        """For the terminal, and for what went wrong."""
        touched = f", touched {', '.join(self.contacts)}" if self.contacts else ""
        return (
            f"{self.building}, seed {self.seed}: {self.ended or 'nothing left to see'} after {self.time_s:.0f} s,"
            f" {self.share_percent:.1f} % of {self.reachable_m2:.1f} m², {self.way_m:.1f} m for a tour of"
            f" {self.tour_m:.1f} m, map {self.ate_m:.3f} m off, clearance {self.clearance_m:.2f} m{touched}"
        )


@dataclass(frozen=True)
class How:
    """Images a second, how long at most, and a folder for pictures of maps over the truth, or None."""

    rate_hz: float = 10.0
    longest_s: float = 1200.0
    pictures: Path | None = None


@dataclass(frozen=True, eq=False)
class Driven:
    """The truth of a drive: stamps (N,), poses (N, 4, 4), least clearance, what was touched, and how it ended."""

    stamps_s: FloatArray
    T_world_base: FloatArray
    clearance_m: float
    contacts: tuple[str, ...]
    result: NavigationResult | None

    @property
    def way_m(self) -> float:
        """Truly driven."""
        return float(np.hypot(*np.diff(self.T_world_base[:, :2, 3], axis=0).T).sum())

    @property
    def ended(self) -> str:
        """Why, in words; empty where it says that nothing is left."""
        if self.result is None:
            return "took too long"
        return "" if self.result.has_arrived else f"{self.result.reason}: {self.result.detail}"


def explored(building: Building, how: How, seed: int, folder: Path) -> Explored:
    """Explore, and judge the map, which is left in a folder."""
    sensors = {"size": (320, 240), "rate_hz": how.rate_hz, "seed": seed, "realism": "real"}
    settings = SimulationSettings(**building.where, **sensors)  # type: ignore[arg-type]
    config = load_config(overrides={"odometry": "wheels,dense", "loops.source": "keyframes"})
    with Simulator(settings, limits=config.navigation.limits) as simulator:
        driven = _driven(simulator, config, how.longest_s, folder)
        with _opened(folder) as kept:
            judge = Judge(simulator.world, config, driven, kept)
            if how.pictures is not None:
                how.pictures.mkdir(parents=True, exist_ok=True)
                judge.draw(how.pictures / f"{building.name}-{seed}.png")
            return judge.explored(building.name, seed)


def _driven(simulator: Simulator, config: Config, longest_s: float, folder: Path) -> Driven:
    """Until nothing is left, it gives up, or it takes too long."""
    stamps, poses, clearance_m = [simulator.time_s], [simulator.T_world_base.copy()], simulator.clearance_m()
    with exploring(simulator, config, folder, in_step=True, trusts_floor=True) as drive:
        navigator = drive.navigator
        navigator.explore()
        while not navigator.is_task_complete() and simulator.time_s < longest_s:
            navigator.step()
            stamps.append(simulator.time_s)
            poses.append(simulator.T_world_base.copy())
            clearance_m = min(clearance_m, simulator.clearance_m())
        touched = tuple(one.name for one in simulator.contacts if one.is_by_robot)
        return Driven(np.array(stamps), np.array(poses), clearance_m, touched, navigator.result)


@contextmanager
def _opened(folder: Path) -> Iterator[MapFolder]:
    kept = MapFolder.open(folder)
    try:
        yield kept
    finally:
        kept.close()


class Judge:
    """Holds the map of an exploration against the truth.

    Args:
        world: that was explored.
        config: of the robot.
        driven: the truth of the drive.
        kept: the map, open.
    """

    def __init__(self, world: World, config: Config, driven: Driven, kept: MapFolder) -> None:
        navigation, footprint = config.navigation, config.navigation.footprint.outline
        self._world, self._driven, self._kept = world, driven, kept
        self._start = planar_pose(driven.T_world_base[0])
        camera_m = float(camera_over_floor(kept.calibration)[2, 3])
        margin_m = max(navigation.planner.margin_m, navigation.follow.margin_m)
        self.plan = TruePlan.of(world, footprint, margin_m, camera_m)
        self._reached = self.plan.reached(self._start)
        self._is_reachable = self.plan.covered(self._reached)
        self._ate_m, self._T_world_map = _alignment(kept, driven)
        self._layer = KnownFloor(occupancy_of(kept), driven=driven_way(kept), footprint=footprint).layer
        self._state = _state_in(self._layer, self.plan, self._T_world_map)
        viewer = DepthViewer(kept.calibration, footprint, navigation.live)
        self._sight = ViewSector(viewer.near_m, config.sessions.occupancy.far_m, viewer.half_rad)

    def explored(self, building: str, seed: int) -> Explored:
        """All figures."""
        driven, is_free = self._driven, self._state == CellState.FREE
        return Explored(
            building=building,
            seed=seed,
            ended=driven.ended,
            reachable_m2=_m2(self._is_reachable),
            free_m2=_m2(self._is_reachable & is_free),
            wrong_m2=_m2(is_free & _is_wrong(self.plan, self._start)),
            ate_m=self._ate_m,
            walls_m=self._walls_m(),
            way_m=driven.way_m,
            tour_m=tour_m(self.plan, self._reached, self._start, self._sight, SHARE_PERCENT / 100),
            contacts=driven.contacts,
            clearance_m=driven.clearance_m,
            time_s=float(driven.stamps_s[-1]),
            keyframes=len(self._kept.store),
            loops=sum(edge.is_loop for edge in self._kept.edges),
        )

    def draw(self, path: Path) -> None:
        """The map over the truth: reachable floor that it lacks is red, floor that it makes up is violet."""
        state, is_taken = self._state, self.plan.is_taken
        picture = np.full((*state.shape, 3), 190, np.uint8)
        picture[state == CellState.FREE] = 255
        picture[state == CellState.OCCUPIED] = 60
        edge = is_taken & (cv2.erode(is_taken.astype(np.uint8), np.ones((3, 3), np.uint8)) == 0)
        picture[edge] = (60, 160, 60)
        picture[self._is_reachable & (state == CellState.UNKNOWN)] = (80, 80, 255)
        picture[self._is_reachable & (state == CellState.OCCUPIED)] = (0, 0, 150)
        picture[_is_wrong(self.plan, self._start) & (state == CellState.FREE)] = (220, 100, 220)
        large = cv2.resize(picture, None, fx=4, fy=4, interpolation=cv2.INTER_NEAREST)
        cells = (self.plan.cells_at(self._driven.T_world_base[:, :2, 3])[:, ::-1] * 4 + 2).astype(np.int32)
        cv2.polylines(large, [cells], False, (200, 120, 0), 2)
        cv2.circle(large, cells[0].tolist(), 8, (0, 160, 0), -1)
        write_bytes(path, cv2.imencode(".png", large[::-1])[1].tobytes())

    def _walls_m(self) -> float:
        """Median distance of occupied cells beside free ones from the sides of what truly stands there."""
        layer, T = self._layer, self._T_world_map
        beside = cv2.dilate((layer.state == CellState.FREE).astype(np.uint8), np.ones((3, 3), np.uint8)) > 0
        row, column = np.nonzero((layer.state == CellState.OCCUPIED) & beside)
        places = (np.column_stack([column, row]) + 0.5) * layer.resolution_m + layer.origin
        places = places @ T[:2, :2].T + T[:2, 2]
        return float(np.median(shapely.distance(shapely.points(places), obstacles(self._world).boundary)))


def _alignment(kept: MapFolder, driven: Driven) -> tuple[float, FloatArray]:
    """RMSE of the keyframes' places, and T_world_map (3, 3) in the plane."""
    numbers = list(kept.store)
    stamps_s = np.array([kept.store[number].stamp_s for number in numbers])
    T_map_base = kept.store.T_map_keyframe[numbers] @ se3.invert(camera_over_floor(kept.calibration))
    at_s, first = np.unique(np.clip(stamps_s, *driven.stamps_s[[0, -1]]), return_index=True)
    truth = Trajectory(driven.stamps_s, driven.T_world_base, body="base")
    true = Trajectory(at_s, truth.at(at_s), body="base")
    found = ate(Trajectory(at_s, T_map_base[first], body="base"), true)
    return found.translation.rmse, se2.from_parts(*planar_pose(found.T_truth_estimate))


def _state_in(layer: StaticLayer, plan: TruePlan, T_world_map: FloatArray) -> ByteArray:
    """(H, W) of `CellState` that the map has at each cell of the true plan."""
    places = plan.middle_of(np.argwhere(np.ones_like(plan.is_taken)))
    T_map_world = se2.invert(T_world_map)
    at = np.floor((places @ T_map_world[:2, :2].T + T_map_world[:2, 2] - layer.origin) / layer.resolution_m)
    column, row = at.astype(int).T
    inside = (row >= 0) & (column >= 0) & (row < layer.state.shape[0]) & (column < layer.state.shape[1])
    state = np.full(len(places), CellState.UNKNOWN, np.uint8)
    state[inside] = layer.state[row[inside], column[inside]]
    return state.reshape(plan.is_taken.shape)


def _is_wrong(plan: TruePlan, start: FloatArray) -> BoolArray:
    """(H, W) cells that no map may call free: farther from open floor than rounding explains."""
    shut = (~plan.open_floor(start)).astype(np.uint8)
    cells = cv2.distanceTransform(shut, cv2.DIST_L2, cv2.DIST_MASK_PRECISE)
    return np.asarray(cells * CELL_M > _ROUNDING_M)


def _m2(is_so: BoolArray) -> float:
    return float(np.count_nonzero(is_so) * CELL_M**2)
