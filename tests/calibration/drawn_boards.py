"""Pictures of a board as a camera sees it: the printed sheet, warped by the homography of its plane."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np

from wheelsight.core.geometry import PinholeCamera, se3, so3
from wheelsight_calibration.board import Board, draw_board

PX_PER_MM = 4


def sheet_image(board: Board, paper: str = "A3") -> tuple[np.ndarray, np.ndarray]:
    """The printed sheet (H, W), and (3, 3) that maps metres on the board, from its first corner, to sheet pixels."""
    sheet = draw_board(board, paper)
    image = np.full((round(PX_PER_MM * sheet.height_mm), round(PX_PER_MM * sheet.width_mm)), 255, np.uint8)
    for x, y, w, h in sheet.rectangles:
        a, b = round(PX_PER_MM * x), round(PX_PER_MM * y)
        image[b : round(PX_PER_MM * (y + h)), a : round(PX_PER_MM * (x + w))] = 0
    left = min(x for x, _, w, h in sheet.rectangles if w == h)
    top = min(y for _, y, w, h in sheet.rectangles if w == h)
    scale, side_mm = 1e3 * PX_PER_MM, 1e3 * board.square_m
    # Pixel centres lie at integers: an edge drawn at 40 is between pixels 39 and 40.
    x, y = (PX_PER_MM * (at + side_mm) - 0.5 for at in (left, top))
    return image, np.array([[scale, 0, x], [0, scale, y], [0, 0, 1]])


def seen_board(
    board: Board, camera: PinholeCamera, T_camera_board: np.ndarray, *, blur_px: float = 0.7, paper: str = "A3"
) -> np.ndarray:
    """(H, W) uint8 of a camera without distortion."""
    sheet, sheet_from_board = sheet_image(board, paper)
    to_image = camera.K @ T_camera_board[:3, [0, 1, 3]] @ np.linalg.inv(sheet_from_board)
    big = np.diag([4.0, 4.0, 1.0])
    big[:2, 2] = 1.5
    size = (4 * camera.width, 4 * camera.height)
    large = cv2.warpPerspective(sheet, big @ to_image, size, flags=cv2.INTER_LINEAR, borderValue=120)
    image = cv2.resize(large, (camera.width, camera.height), interpolation=cv2.INTER_AREA)
    return np.asarray(cv2.GaussianBlur(image, (0, 0), blur_px), np.uint8)


def pose(
    board: Board, z: float, tilt_deg: tuple[float, float] = (0, 0), at_m: tuple[float, float] = (0, 0)
) -> np.ndarray:
    """(4, 4) of a board whose middle is at x, y, z of the camera, tilted about x and y."""
    R = so3.exp(np.radians([*tilt_deg, 0.0]))
    return se3.from_parts(R, np.array([*at_m, z]) - R @ board.points_m.mean(axis=0))


def write_views(folder: Path, board: Board, camera: PinholeCamera, poses: list[np.ndarray]) -> None:
    """Colour images, and depth images in millimetres of the infinite plane, registered."""
    folder.mkdir(parents=True)
    rays = camera.rays()
    for number, T in enumerate(poses):
        cv2.imwrite(str(folder / f"{number:02d}-color.png"), seen_board(board, camera, T))
        z = float(T[:3, 2] @ T[:3, 3]) / (rays @ T[:3, 2])
        cv2.imwrite(str(folder / f"{number:02d}-depth.png"), np.round(1000 * z).astype(np.uint16))
