"""Where the joint least squares begin: lenses from corners alone, poses, and where the cameras are to each other."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import cv2
import numpy as np

from wheelsight.camera_calibration.board import Board
from wheelsight.camera_calibration.views import Corners, DepthCells
from wheelsight.errors import CalibrationError
from wheelsight.geometry import FloatArray, PinholeCamera, se3, so3

_FLAGS = (
    cv2.CALIB_FIX_ASPECT_RATIO
    | cv2.CALIB_FIX_PRINCIPAL_POINT
    | cv2.CALIB_ZERO_TANGENT_DIST
    | cv2.CALIB_FIX_K2
    | cv2.CALIB_FIX_K3
)
# Of depth cameras whose numbers nobody gives, focal length by width: Kinect v1's and v2's; others see about 60°.
_KNOWN_FOCAL = {(640, 480): 586.0, (512, 424): 365.5}
_USUAL_FOCAL = 0.87
_USUAL_COLOR_FOCAL = 0.85


class LensStart(NamedTuple):
    """A lens, and (V, 4, 4) from boards, in squares, into it."""

    camera: PinholeCamera
    T_camera_board: FloatArray


def lens_from_corners(corners: Sequence[Corners], board: Board, size: tuple[int, int]) -> LensStart:
    """A lens and poses from corners alone, with one number of distortion: enough to begin with.

    Raises:
        CalibrationError: OpenCV finds none.
    """
    squares = (board.points_m / board.square_m).astype(np.float32)
    focal = _USUAL_COLOR_FOCAL * size[0]
    K = np.array([[focal, 0, (size[0] - 1) / 2], [0, focal, (size[1] - 1) / 2], [0, 0, 1]])
    points = [squares[seen.ids] for seen in corners]
    px = [seen.px.astype(np.float32).reshape(-1, 1, 2) for seen in corners]
    try:
        _, K, k, turns, ways = cv2.calibrateCamera(
            points, px, size, K, np.zeros(5), flags=_FLAGS | cv2.CALIB_USE_INTRINSIC_GUESS
        )
    except cv2.error as error:
        raise CalibrationError("the corners give no lens", fix="take other views: tilted, near and far") from error
    k1, k2, p1, p2, k3 = np.ravel(k)[:5].tolist()
    try:
        camera = PinholeCamera(
            *size, float(K[0, 0]), float(K[1, 1]), float(K[0, 2]), float(K[1, 2]), (k1, k2, p1, p2, k3)
        )
    except CalibrationError:
        camera = PinholeCamera(*size, focal, focal, (size[0] - 1) / 2, (size[1] - 1) / 2)
        return poses_in(camera, corners, board)
    T = se3.from_parts(so3.exp(np.reshape(turns, (-1, 3))), np.reshape(ways, (-1, 3)))
    return LensStart(camera, T)


def poses_in(camera: PinholeCamera, corners: Sequence[Corners], board: Board) -> LensStart:
    """Poses of boards, in squares, before a lens that is known."""
    squares, poses = board.points_m / board.square_m, []
    for seen in corners:
        xy = camera.normalise(seen.px)
        _, turn, way = cv2.solvePnP(squares[seen.ids], xy, np.eye(3), None, flags=cv2.SOLVEPNP_IPPE)
        poses.append(se3.from_parts(so3.exp(np.ravel(turn)), np.ravel(way)))
    return LensStart(camera, np.array(poses))


def usual_lens(size: tuple[int, int]) -> PinholeCamera:
    """A depth lens of which nothing is known but its size."""
    focal = _KNOWN_FOCAL.get(size, _USUAL_FOCAL * size[0])
    return PinholeCamera(*size, focal, focal, (size[0] - 1) / 2, (size[1] - 1) / 2)


def apart_by_poses(T_color_board: FloatArray, T_depth_board: FloatArray) -> FloatArray:
    """T_color_depth from poses (V, 4, 4) of the same boards in both cameras: the median way, the mean turn."""
    T = T_color_board @ se3.invert(T_depth_board)
    return se3.from_parts(so3.nearest(T[:, :3, :3].mean(axis=0)), np.median(T[:, :3, 3], axis=0))


def apart_by_planes(
    T_color_board: FloatArray, planes: FloatArray, prior_m: float, T_color_depth: FloatArray
) -> FloatArray:
    """T_color_depth from poses (V, 4, 4) of boards, metres, and planes (V, 4), n · p = h, in the depth camera.

    Turns by Kabsch over normals; ways by least squares, held near `T_color_depth`'s where normals tell little.
    """
    known = np.isfinite(planes).all(axis=1)
    if np.count_nonzero(known) < 3:
        return T_color_depth
    n_color = T_color_board[known, :3, 2]
    h_color = (n_color * T_color_board[known, :3, 3]).sum(axis=1)
    n_depth, h_depth = planes[known, :3], planes[known, 3]
    # Normals of boards that are all alike say nothing of the turn about them: the known one holds it.
    held = 0.3 * T_color_depth[:3, :3]
    R = so3.nearest(n_color.T @ n_depth + held)
    rows = np.concatenate([n_color, np.eye(3) * 0.02 / prior_m])
    values = np.concatenate([h_color - h_depth, T_color_depth[:3, 3] * 0.02 / prior_m])
    return se3.from_parts(R, np.linalg.lstsq(rows, values, rcond=None)[0])


def plane_of(cells: DepthCells, depth_m: FloatArray, camera: PinholeCamera) -> FloatArray:
    """(4,) n · p = h, h positive, of cells at depths (N,); NaN where there are too few."""
    kept = np.isfinite(depth_m) & (depth_m > 0)
    if np.count_nonzero(kept) < 3:
        return np.full(4, np.nan)
    rays = np.concatenate([camera.normalise(cells.px[kept]), np.ones((np.count_nonzero(kept), 1))], axis=1)
    m = np.linalg.lstsq(rays, 1 / depth_m[kept], rcond=None)[0]
    h = 1 / float(np.linalg.norm(m))
    return np.append(m * h, h)
