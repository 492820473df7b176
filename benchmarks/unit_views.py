"""Views of a board by one unit of a simulated camera: its own lens, registration, distortion of depth and noise.

The board and its plate are reckoned by ray and plane; what the depth sensor makes of them is the simulator's own code,
as in each frame of a drive. Corners are the lens's projection with noise.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from benchmarks.board_views import BOARD, board_corners, on_plate
from wheelsight.core.geometry import Float32Array, FloatArray, PinholeCamera, se3, so3
from wheelsight_calibration.board import Board
from wheelsight_calibration.views import BoardView, ViewSet
from wheelsight_sim import CameraUnit, camera_model, realism_of, stream, unit_of
from wheelsight_sim.depth_sensor import DepthDistortion
from wheelsight_sim.scene import View as Seen
from wheelsight_sim.settings import SimulationSettings

VIEWS = 40
NEAR_M, FAR_M = 0.7, 4.0
CORNER_SIGMA_PX = 0.1
# A matt white plate: the share of infrared that it throws back, and that it mirrors.
_INFRARED, _SHINE = np.array([0.8]), np.array([0.0])
_TILTS_DEG, _TURN_RAD, _INSIDE = (5.0, 45.0), 0.4, (0.05, 0.95)


@dataclass(frozen=True, eq=False)
class BoardBench:
    """A camera's unit before a board."""

    unit: CameraUnit
    board: Board = BOARD

    @property
    def lens(self) -> PinholeCamera:
        """The true one."""
        return self.unit.lens.true

    def views(self, rng: np.random.Generator, count: int = VIEWS) -> ViewSet:
        """So many, all over image and distances, tilted by up to 45°; where the board is not whole, another is tried.

        Depth images are as the unit's driver registers them; no infrared image is taken.
        """
        views: list[BoardView] = []
        while len(views) < count:
            T = self._pose(rng)
            corners = board_corners(self.lens, T, CORNER_SIGMA_PX, self.board, rng)
            if corners is not None:
                views.append(BoardView(f"{len(views):04d}", corners, None, self.depth_image(T, rng)))
        size = self.lens.width, self.lens.height
        return ViewSet(tuple(views), size, size)

    def depth_image(self, T_camera_board: FloatArray, rng: np.random.Generator) -> Float32Array:
        """(H, W) metres of the plate, 0 around it, while board and camera stand still."""
        seen = plate_seen(self._rays, T_camera_board, self.board)
        measured = self.unit.seen_by_depth(seen, None, self._distortion, np.zeros(6), 0.0)
        return self.unit.model.depth.measure(measured, self.lens, _INFRARED, _SHINE, rng)

    def wall_m(self, depth_m: float) -> Float32Array:
        """(H, W) what depth pixels say, without noise, of a wall all over the image at so many metres of depth."""
        wall = np.full(self._rays.shape[:2], depth_m, np.float32)
        normal = np.tile(np.array([0, 0, -1], np.float32), (*wall.shape, 1))
        seen = Seen(wall, np.zeros(wall.shape, np.int32), normal, np.tile(np.eye(4), (len(wall), 1, 1)), self._rays)
        return self.unit.seen_by_depth(seen, None, self._distortion, np.zeros(6), 0.0).depth_m

    @cached_property
    def _rays(self) -> FloatArray:
        return self.lens.rays()

    @cached_property
    def _distortion(self) -> DepthDistortion | None:
        return self.unit.distortion(_INFRARED * (1 - _SHINE))

    def _pose(self, rng: np.random.Generator) -> FloatArray:
        z = np.exp(rng.uniform(np.log(NEAR_M), np.log(FAR_M)))
        middle = self.lens.back_project(rng.uniform(*_INSIDE, 2) * (self.lens.width, self.lens.height), z)
        tilt, about = np.radians(rng.uniform(*_TILTS_DEG)), rng.uniform(0, 2 * np.pi)
        R = so3.exp(np.array([np.cos(about), np.sin(about), 0]) * tilt)
        R = R @ so3.exp([0, 0, rng.uniform(-_TURN_RAD, _TURN_RAD)])
        return se3.from_parts(R, middle - R @ self.board.points_m.mean(axis=0))


def plate_seen(rays: FloatArray, T_camera_board: FloatArray, board: Board) -> Seen:
    """What rays (H, W, 3) hit where there is nothing but the board's plate; the world is the camera's frame."""
    n, t = T_camera_board[:3, 2], T_camera_board[:3, 3]
    z = float(n @ t) / (rays @ n)
    is_plate = on_plate((rays * z[..., None] - t) @ T_camera_board[:3, :2], board) & (z > 0)
    depth_m = np.where(is_plate, z, 0).astype(np.float32)
    normal = np.where(is_plate[..., None], -n * np.sign(n @ t), 0).astype(np.float32)
    poses = np.tile(np.eye(4), (len(rays), 1, 1))
    return Seen(depth_m, np.where(is_plate, 0, -1).astype(np.int32), normal, poses, rays)


def bench_of(settings: SimulationSettings, size: tuple[int, int] | None = None) -> BoardBench:
    """The unit of a drive's camera before a board, in the camera's own size unless another is given."""
    return BoardBench(unit_of(camera_model(settings.camera, size), realism_of(settings.realism), settings.seed))


def views_of(settings: SimulationSettings, count: int = VIEWS) -> ViewSet:
    """Views of a board by the unit of a drive's camera; equal settings, equal views."""
    return bench_of(settings).views(stream(settings.seed, "board views"), count)
