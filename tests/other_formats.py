"""Recordings of the synthetic room in formats of other people, as their publishers lay files out."""

from __future__ import annotations

import json
import struct
import zlib
from pathlib import Path

import cv2
import numpy as np
from synthetic import CAMERA, make_tum_recording, render_room, wobbling_trajectory

from wheelsight.core.geometry import ByteArray, Float32Array, FloatArray, PinholeCamera
from wheelsight.core.trajectory import Trajectory, write_tum

FINE_JPEG = (cv2.IMWRITE_JPEG_QUALITY, 98, cv2.IMWRITE_JPEG_SAMPLING_FACTOR, cv2.IMWRITE_JPEG_SAMPLING_FACTOR_444)


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


def make_replica(folder: Path, frames: int = 2, camera: PinholeCamera = CAMERA) -> Trajectory:
    """A room with the camera's file in the folder above, as it serves all rooms."""
    truth = numbered_truth(frames)
    for number, (color, depth_m) in enumerate(rendered(truth, camera)):
        names = (f"frame{number:06}.jpg", f"depth{number:06}.png")
        color_path, depth_path = (folder / "results" / name for name in names)
        write_images(color_path, depth_path, color, depth_m, 6553.5)
    lines = (" ".join(f"{value:.18e}" for value in T.ravel()) + "\n" for T in truth.T_frame_body)
    (folder / "traj.txt").write_text("".join(lines))
    numbers = {
        "w": camera.width,
        "h": camera.height,
        "fx": camera.fx,
        "fy": camera.fy,
        "cx": camera.cx,
        "cy": camera.cy,
    }
    (folder.parent / "cam_params.json").write_text(json.dumps({"camera": {**numbers, "scale": 6553.5}}))
    return truth


SENS_COLOR, SENS_DEPTH = PinholeCamera(324, 242, 290.0, 291.0, 162.0, 121.0), PinholeCamera(160, 120, 140, 141, 80, 60)


def make_scannet(path: Path, frames: int = 2, *, microseconds: int = 33_333) -> Trajectory:
    """A .sens: a colour camera larger than depth's, both at one place. Stamps count from a second; 0 gives none."""
    truth = numbered_truth(frames)
    eye = np.eye(4)
    head = struct.pack("<IQ9s", 4, 9, b"StructIO.")
    for camera in (SENS_COLOR, SENS_DEPTH):
        K = eye.copy()
        K[:3, :3] = camera.K
        head += struct.pack("<16f16f", *K.ravel(), *eye.ravel())
    sizes = (SENS_COLOR.width, SENS_COLOR.height, SENS_DEPTH.width, SENS_DEPTH.height)
    parts = [head + struct.pack("<iiIIIIfQ", 2, 1, *sizes, 1000.0, frames)]
    for number, T in enumerate(truth.T_frame_body):
        color, depth_m = render_room(T, SENS_COLOR)[0], render_room(T, SENS_DEPTH)[1]
        jpeg = cv2.imencode(".jpg", color[..., ::-1], FINE_JPEG)[1].tobytes()
        depth = zlib.compress(np.rint(depth_m * 1000.0).astype("<u2").tobytes())
        stamp = (1_000_000 + number * microseconds) * (microseconds > 0)
        parts.append(struct.pack("<16fQQQQ", *T.ravel(), stamp, stamp, len(jpeg), len(depth)) + jpeg + depth)
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(b"".join(parts))
    return truth


def make_three_d_match(folder: Path, frames: int = 2, camera: PinholeCamera = CAMERA) -> Trajectory:
    """A sequence, with the camera of all in the folder above."""
    truth = numbered_truth(frames)
    for number, ((color, depth_m), T) in enumerate(zip(rendered(truth, camera), truth.T_frame_body, strict=True)):
        color_path, depth_path = (folder / f"frame-{number:06}.{kind}.png" for kind in ("color", "depth"))
        write_images(color_path, depth_path, color, depth_m, 1000.0)
        (folder / f"frame-{number:06}.pose.txt").write_text(text_of(T))
    (folder.parent / "camera-intrinsics.txt").write_text(text_of(camera.K))
    return truth


REDWOOD_CAMERA = PinholeCamera(640, 480, 525.0, 525.0, 319.5, 239.5)


def make_redwood(folder: Path, frames: int = 2) -> Trajectory:
    """Images counted from 0, poses from 1."""
    truth = numbered_truth(frames)
    log = ""
    for number, ((color, depth_m), T) in enumerate(
        zip(rendered(truth, REDWOOD_CAMERA), truth.T_frame_body, strict=True)
    ):
        names = folder / "image" / f"{number:05}.jpg", folder / "depth" / f"{number:05}.png"
        write_images(*names, color, depth_m, 1000.0)
        log += f"{number} {number} {number + 1}\n{text_of(T)}"
    (folder / "livingroom1-traj.log").write_text(log)
    return truth


BONN_CAMERA = PinholeCamera(
    640, 480, 542.822841, 542.576870, 315.593520, 237.756098, (0.039903, -0.099343, -0.000730, -0.000144, 0.0)
)


def make_bonn(folder: Path, frames: int = 2) -> Trajectory:
    """TUM's lists; the camera's poses are written, and tests say what they mean."""
    truth = make_tum_recording(folder, frames, BONN_CAMERA)
    (folder / "calibration.yaml").unlink()
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
    assert cv2.imwrite(str(color_path), color[..., ::-1], FINE_JPEG)
    assert cv2.imwrite(str(depth_path), units)


def text_of(matrix: FloatArray) -> str:
    """A matrix, one row a line."""
    return "".join(" ".join(f"{value:.10g}" for value in row) + "\n" for row in matrix)
