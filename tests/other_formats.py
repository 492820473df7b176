"""Recordings of the synthetic room in formats of other people, as their publishers lay files out."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
from synthetic import CAMERA, make_tum_recording, render_room, wobbling_trajectory

from wheelsight.geometry import ByteArray, Float32Array, FloatArray, PinholeCamera
from wheelsight.trajectory import Trajectory, write_tum


def make_eth3d(folder: Path, frames: int = 3, camera: PinholeCamera = CAMERA) -> Trajectory:
    """TUM's lists with calibration.txt in place of a calibration of this package."""
    truth = make_tum_recording(folder, frames, camera)
    (folder / "calibration.yaml").unlink()
    (folder / "calibration.txt").write_text(f"{camera.fx} {camera.fy} {camera.cx} {camera.cy}\n")
    return truth


ICL_CAMERA = PinholeCamera(640, 480, 481.2, 480.0, 319.5, 239.5)


def make_icl_nuim(folder: Path, frames: int = 2, *, as_rendered: bool = False) -> Trajectory:
    """Frames from 1, as published for TUM's tools or as rendered; true poses with y up."""
    truth = numbered_truth(frames, first=1)
    mirror = np.diag([1.0, -1.0, 1.0, 1.0])
    numbers = np.arange(1.0, frames + 1)
    folder.mkdir(parents=True, exist_ok=True)
    write_tum(Trajectory(numbers, mirror @ truth.T_frame_body @ mirror), folder / "livingRoom2.gt.freiburg")
    lengths = np.linalg.norm(ICL_CAMERA.rays(), axis=-1)
    for number, (color, depth_m) in enumerate(rendered(truth, ICL_CAMERA), start=1):
        if not as_rendered:
            names = folder / "rgb" / f"{number}.png", folder / "depth" / f"{number}.png"
            write_images(*names, color, depth_m, 5000.0)
            continue
        assert cv2.imwrite(str(folder / f"scene_00_{number:04}.png"), color[..., ::-1])
        np.savetxt(folder / f"scene_00_{number:04}.depth", (depth_m * lengths).reshape(1, -1), fmt="%.6g")
    return truth


def rendered(truth: Trajectory, camera: PinholeCamera) -> list[tuple[ByteArray, Float32Array]]:
    """Colour and depth of each pose."""
    return [render_room(T, camera) for T in truth.T_frame_body]


def numbered_truth(frames: int, first: int = 0, rate_hz: float = 30.0) -> Trajectory:
    """A hand-held drive whose stamps are numbers at a rate, from `first`."""
    return wobbling_trajectory(frames, rate_hz, start_s=first / rate_hz)


def write_images(color_path: Path, depth_path: Path, color: ByteArray, depth_m: Float32Array, factor: float) -> None:
    """Colour, as its name says, and depth of 16 bits at so many units a metre."""
    for path in (color_path, depth_path):
        path.parent.mkdir(parents=True, exist_ok=True)
    units = np.rint(depth_m.astype(np.float64) * factor).clip(0, 65535).astype(np.uint16)
    assert cv2.imwrite(str(color_path), color[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, 98])
    assert cv2.imwrite(str(depth_path), units)


def text_of(matrix: FloatArray) -> str:
    """A matrix, one row a line."""
    return "".join(" ".join(f"{value:.10g}" for value in row) + "\n" for row in matrix)
