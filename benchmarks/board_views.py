"""Views of a board by closed form: corners projected, depth of its plate by ray and plane, with each sensor's errors.

The errors are not those of the model that is fitted: Kinect v1's is a smooth pattern over the image with a part that
fades and one that does not, in eighths of a pixel; Kinect v2's swings over distance; RealSense's is of its baseline and
of a shift of its images.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from typing import NamedTuple

import cv2
import numpy as np

from wheelsight.core.depth_errors import DepthError
from wheelsight.core.geometry import BoolArray, Float32Array, FloatArray, PinholeCamera, se3, so3
from wheelsight_calibration.board import Board, board_from
from wheelsight_calibration.cameras import reading_m
from wheelsight_calibration.views import BoardView, Corners, ViewSet

BOARD = board_from("8x5:60mm")  # on A2
_PLATE_M = 0.09
_SMALLEST_PX, _TRIES = 7.0, 2000


class Readings(NamedTuple):
    """Pixels (N, 2) of the depth image, and what it answers there, metres (N,)."""

    px: FloatArray
    metres: FloatArray


@dataclass(frozen=True, eq=False)
class Rig:
    """Two cameras and what they err by.

    Attributes:
        name: for tables.
        sensor: as `--sensor` has it.
        color, depth: the true lenses.
        T_color_depth: (4, 4).
        systematic: depth as measured without noise, of true depth (...) at pixels (..., 2); metres.
        sigma_m: noise of a pixel at depths (...).
        near_m, far_m: where boards are held.
        is_disparity: whether raw disparities are what it answers.
        corner_sigma_px: of corners, in both cameras.
        has_infrared: whether there are infrared images.
    """

    name: str
    sensor: str
    color: PinholeCamera
    depth: PinholeCamera
    T_color_depth: FloatArray
    systematic: Callable[[FloatArray, FloatArray], FloatArray]
    sigma_m: Callable[[FloatArray], FloatArray]
    near_m: float = 0.7
    far_m: float = 4.0
    is_disparity: bool = False
    corner_sigma_px: float = 0.1
    has_infrared: bool = True

    def readings_at(self, z: float, error: DepthError, margin: float, counts: tuple[int, int]) -> Readings:
        """Of a wall at so many metres, without noise, as `error` takes them in, still to be corrected.

        All over the depth image but a margin, a share of it; `counts` across and down.
        """
        u, v = (np.linspace(margin, 1 - margin, count) for count in counts)
        px = np.stack([grid.ravel() for grid in np.meshgrid(u * self.depth.width, v * self.depth.height)], axis=-1)
        seen = self.systematic(np.full(len(px), z), px)
        if self.is_disparity:
            seen = reading_m(error, 1090 - 8 * 586.0 * 0.075 / seen)
        return Readings(px, seen)


def kinect_v1(rng: np.random.Generator, *, is_disparity: bool = True) -> Rig:
    """A unit: lenses and apart as published ones differ, an error of disparity that fades, 11 bits."""
    color = _lens(rng, 640, 480, 525.0, (0.26, -0.95, 1.16), 0.1)
    depth = _lens(rng, 640, 480, 586.0, (-0.1, 0.3, 0.0), 0.05)
    near, far = (_smooth(rng, 1.5 * scale) for scale in (1.0, 0.4))
    factor = 1 + 0.007 * rng.standard_normal()

    def systematic(z: FloatArray, px: FloatArray) -> FloatArray:
        x, y = px[..., 0] / 639, px[..., 1] / 479
        steps = near(x, y) * np.exp(-(z - 0.9) / 0.5) + far(x, y)
        return np.asarray(factor / (1 / z - steps / (8 * 586.0 * 0.075)))

    return Rig(
        "Kinect v1", "structured-light", color, depth, _apart(rng, [0.025, 0.0, 0.0]), systematic,
        lambda z: 1.2e-3 * z**2, is_disparity=is_disparity,
    )  # fmt: skip


def kinect_v2(rng: np.random.Generator) -> Rig:
    """A unit: distances that swing by 7 mm in 1.9 m, 1 cm more in the corners, a constant of 25 mm."""
    color = _lens(rng, 1920, 1080, 1060.0, (0.04, -0.04, 0.0), 0.3)
    depth = _lens(rng, 512, 424, 365.5, (0.09, -0.27, 0.09), 0.1)
    phase, offset_m = rng.uniform(0, 2 * np.pi), rng.normal(0.025, 0.005)

    def systematic(z: FloatArray, px: FloatArray) -> FloatArray:
        radius2 = (depth.normalise(px) ** 2).sum(axis=-1)
        return np.asarray(z + 0.007 * np.sin(2 * np.pi * z / 1.9 + phase) + 0.02 * radius2 + offset_m)

    sigma_m = lambda z: 1.5e-3 - 0.5e-3 * z + 0.3e-3 * z**2  # noqa: E731
    return Rig("Kinect v2", "tof", color, depth, _apart(rng, [0.052, 0.0, 0.0]), systematic, sigma_m)


def realsense(rng: np.random.Generator) -> Rig:
    """A unit: a baseline off by half a per cent, images that are shifted by a tenth of a pixel."""
    color = _lens(rng, 1280, 720, 915.0, (0.16, -0.5, 0.45), 0.05)
    depth = _lens(rng, 1280, 720, 640.0, (0.0, 0.0, 0.0), 0.0)
    factor, shift_px = 1 + 0.005 * rng.standard_normal(), 0.1 * rng.standard_normal()

    def systematic(z: FloatArray, px: FloatArray) -> FloatArray:
        return np.asarray(factor / (1 / z + shift_px / (640 * 0.05)))

    sigma_m = lambda z: 0.1 / (640 * 0.05) * z**2  # noqa: E731
    return Rig("RealSense D435", "stereo", color, depth, _apart(rng, [0.015, 0.0, 0.0]), systematic, sigma_m)


RIGS: dict[str, Callable[[np.random.Generator], Rig]] = {
    "kinect-v1": kinect_v1,
    "kinect-v2": kinect_v2,
    "realsense": realsense,
}


def board_views(rig: Rig, rng: np.random.Generator, count: int = 40, board: Board = BOARD) -> ViewSet:
    """So many views of a board on a plate, all over image and distances, tilted by up to 40°."""
    views: list[BoardView] = []
    while len(views) < count:
        T = _pose(rig, rng, board)
        color = board_corners(rig.color, T, rig.corner_sigma_px, board, rng)
        T_depth = se3.invert(rig.T_color_depth) @ T
        infrared = board_corners(rig.depth, T_depth, rig.corner_sigma_px, board, rng)
        if color is None:
            continue
        reading = depth_image(rig, T_depth, rng, board)
        views.append(BoardView(f"{len(views):04d}", color, infrared if rig.has_infrared else None, reading))
    color_size, depth_size = ((camera.width, camera.height) for camera in (rig.color, rig.depth))
    return ViewSet(tuple(views), color_size, depth_size, is_disparity=rig.is_disparity)


def depth_image(rig: Rig, T_depth_board: FloatArray, rng: np.random.Generator, board: Board) -> Float32Array:
    """(H, W) readings of the plate, metres or raw disparities, 0 around it."""
    camera = rig.depth
    rays = _rays(camera)
    n, t = T_depth_board[:3, 2], T_depth_board[:3, 3]
    z = float(n @ t) / (rays @ n)
    px = np.stack(np.meshgrid(np.arange(camera.width), np.arange(camera.height)), axis=-1).astype(float)
    is_plate = on_plate((rays * z[..., None] - t) @ T_depth_board[:3, :2], board) & (z > 0)
    safe = np.where(is_plate, z, 1.0)
    seen = rig.systematic(safe, px) + rig.sigma_m(safe) * rng.standard_normal(z.shape)
    reading = np.round(1090.0 - 8 * 586.0 * 0.075 / seen) if rig.is_disparity else np.round(1000 * seen) / 1000
    return np.where(is_plate, reading, 0).astype(np.float32)


@cache
def _rays(camera: PinholeCamera) -> FloatArray:
    return camera.rays()


def on_plate(xy_m: FloatArray, board: Board) -> BoolArray:
    """Whether places (..., 2) in a board's own frame lie on its plate."""
    low = -board.square_m - _PLATE_M
    high = board.square_m * np.array([board.columns, board.rows]) + _PLATE_M
    return np.asarray(((xy_m > low) & (xy_m < high)).all(axis=-1))


def _pose(rig: Rig, rng: np.random.Generator, board: Board) -> FloatArray:
    z = np.exp(rng.uniform(np.log(rig.near_m), np.log(rig.far_m)))
    px = rng.uniform(0.05, 0.95, 2) * (rig.color.width, rig.color.height)
    middle = rig.color.back_project(px, z)
    tilt, about = np.radians(rng.uniform(5, 45)), rng.uniform(0, 2 * np.pi)
    R = so3.exp(np.array([np.cos(about), np.sin(about), 0]) * tilt) @ so3.exp([0, 0, rng.uniform(-0.4, 0.4)])
    return se3.from_parts(R, middle - R @ board.points_m.mean(axis=0))


def board_corners(
    camera: PinholeCamera, T: FloatArray, sigma_px: float, board: Board, rng: np.random.Generator
) -> Corners | None:
    """All corners with noise, or None where the board is not whole in the image or its squares are too small."""
    px, is_seen = camera.project(se3.apply(T, board.points_m))
    if not is_seen.all():
        return None
    rows = px.reshape(board.rows, board.columns, 2)
    if min(np.linalg.norm(np.diff(rows, axis=axis), axis=-1).min() for axis in (0, 1)) < _SMALLEST_PX:
        return None
    return Corners(np.arange(board.count), px + sigma_px * rng.standard_normal(px.shape))


def _lens(
    rng: np.random.Generator, width: int, height: int, focal: float, radial: tuple[float, float, float], unlike: float
) -> PinholeCamera:
    fx = focal * (1 + 0.01 * rng.standard_normal())
    fy = fx * (1 + 0.001 * rng.standard_normal())
    cx, cy = np.array([width - 1, height - 1]) / 2 + 0.008 * width * rng.standard_normal(2)
    k1, k2, k3 = np.array(radial) * (1 + unlike * rng.standard_normal())
    p1, p2 = 0.0015 * rng.standard_normal(2)
    return PinholeCamera(width, height, fx, fy, cx, cy, (k1, k2, p1, p2, k3))


def _apart(rng: np.random.Generator, way_m: list[float]) -> FloatArray:
    T = se3.from_parts(so3.exp(np.radians(0.5) * rng.standard_normal(3)), way_m)
    T[:3, 3] += 0.002 * rng.standard_normal(3)
    return T


def _smooth(rng: np.random.Generator, steps: float) -> Callable[[FloatArray, FloatArray], FloatArray]:
    """A smooth pattern over shares of width and height, of so many steps of deviation: a radial part and knots."""
    knots = cv2.resize(rng.standard_normal((4, 5)), (64, 48), interpolation=cv2.INTER_CUBIC)
    bowl = rng.standard_normal()

    def pattern(x: FloatArray, y: FloatArray) -> FloatArray:
        maps = (np.clip(x, 0, 1) * 63).astype(np.float32), (np.clip(y, 0, 1) * 47).astype(np.float32)
        flat = [np.atleast_2d(m) for m in maps]
        rough = cv2.remap(knots, flat[0], flat[1], cv2.INTER_LINEAR).reshape(np.shape(x))
        return np.asarray(steps * (0.5 * rough + bowl * (4 * ((x - 0.5) ** 2 + (y - 0.5) ** 2) - 0.7)))

    return pattern
