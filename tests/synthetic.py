"""A textured room with boxes in it, ray-cast exactly: recordings whose every pixel and pose is known.

The world's z axis points up, its origin lies on the floor in the middle of the room. Depth is exact at pixel
centres; colour is one sample a pixel of textures with detail from 2 cm to 1 m.
"""

from __future__ import annotations

from collections.abc import Collection
from functools import lru_cache
from pathlib import Path

import cv2
import numpy as np

from wheelsight.core.calibration import Calibration, save_calibration
from wheelsight.core.geometry import ByteArray, Float32Array, FloatArray, IntArray, PinholeCamera, se3, so3
from wheelsight.core.trajectory import Trajectory, write_tum

CAMERA = PinholeCamera(320, 240, 262.0, 260.0, 161.3, 118.4)

ROOM = ((-3.0, -2.5, 0.0), (3.0, 2.5, 2.8))
BOXES = (
    ((1.2, -1.4, 0.0), (1.8, -0.7, 0.9)),
    ((1.6, 0.3, 0.0), (2.2, 1.1, 1.3)),
    ((0.6, -0.2, 0.0), (0.9, 0.2, 0.5)),
    ((2.4, -0.5, 0.8), (3.0, 0.2, 1.6)),
    ((-2.4, 1.5, 0.0), (-1.6, 2.2, 1.1)),
    ((-2.0, -2.1, 0.0), (-1.2, -1.5, 0.7)),
)
_TEXEL_M = 0.01
_TEXTURE_SIZE = 512
_LOOKING_ALONG_X = np.array([[0.0, 0, 1], [-1, 0, 0], [0, -1, 0]])


def undistorted_by_opencv(px: np.ndarray, K: np.ndarray, distortion: np.ndarray) -> np.ndarray:
    """Points (N, 1, 2) of an image without distortion, x/z and y/z; as precisely as OpenCV 4 and 5 can."""
    stop = (cv2.TERM_CRITERIA_COUNT + cv2.TERM_CRITERIA_EPS, 100, 1e-14)
    if hasattr(cv2, "undistortPointsIter"):
        return np.asarray(cv2.undistortPointsIter(px, K, distortion, None, None, stop))
    return np.asarray(cv2.undistortPoints(px, K, distortion, criteria=stop))


def render_room(
    T_odom_camera: FloatArray,
    camera: PinholeCamera = CAMERA,
    seed: int = 0,
    depth_noise: bool = False,
    blank: bool = False,
    rows: tuple[int, int] | None = None,
) -> tuple[ByteArray, Float32Array]:
    """Colour (H, W, 3) uint8 and depth (H, W) float32 in metres as seen from a pose (4, 4) in the room.

    `seed` chooses the textures. `depth_noise` adds Kinect v1's σ(z) = 1.425e-3 z², seeded by pose and `seed`.
    `blank` paints every surface the same grey; depth stays. `rows`, a first one and an end, ask for a band alone.
    """
    pose = np.ascontiguousarray(T_odom_camera, dtype=float).tobytes()
    color, depth_m = _rendered(pose, camera, seed, depth_noise, blank, rows or (0, camera.height))
    return color.copy(), depth_m.copy()


@lru_cache(maxsize=8)
def _rays(camera: PinholeCamera) -> FloatArray:
    return camera.rays()


# Tests ask for the same few poses again and again: half a megabyte an image.
@lru_cache(maxsize=256)
def _rendered(
    pose: bytes, camera: PinholeCamera, seed: int, depth_noise: bool, blank: bool, rows: tuple[int, int]
) -> tuple[ByteArray, Float32Array]:
    T_odom_camera = np.frombuffer(pose).reshape(4, 4)
    origin, rays = T_odom_camera[:3, 3], _rays(camera)[slice(*rows)] @ T_odom_camera[:3, :3].T
    depth_m, face = _cast(origin, rays.reshape(-1, 3))
    depth_m, face = depth_m.reshape(rays.shape[:2]), face.reshape(rays.shape[:2])
    color = _paint(origin + rays * depth_m[..., None], face, seed)
    if blank:
        color = np.full_like(color, 128)
    if depth_noise:
        rng = np.random.default_rng([seed, *pose])
        depth_m = depth_m + 1.425e-3 * depth_m**2 * rng.standard_normal(depth_m.shape)
    return color, depth_m.astype(np.float32)


def wobbling_trajectory(frames: int, rate_hz: float = 30.0, speed: float = 1.0, start_s: float = 100.0) -> Trajectory:
    """T_odom_camera of a hand-held camera that sways and turns before the boxes; `speed` 1 is about 0.4 m/s."""
    stamps_s = start_s + np.arange(frames) / rate_hz
    phase = speed * (stamps_s - start_s)
    sway = np.stack([0.25 * np.sin(0.9 * phase), 0.35 * np.sin(1.1 * phase), 0.12 * np.sin(1.7 * phase)], axis=-1)
    yaw, pitch, roll = 0.35 * np.sin(0.7 * phase), 0.15 + 0.10 * np.sin(1.3 * phase), 0.06 * np.sin(0.9 * phase)
    zero = np.zeros(frames)
    turns = [so3.exp(np.stack(axis, axis=-1)) for axis in ((zero, zero, yaw), (zero, pitch, zero), (roll, zero, zero))]
    R_odom_camera = turns[0] @ turns[1] @ turns[2] @ _LOOKING_ALONG_X
    return Trajectory(stamps_s, se3.from_parts(R_odom_camera, np.array([-1.2, 0.0, 1.3]) + sway))


def make_tum_recording(
    folder: Path,
    frames: int = 30,
    camera: PinholeCamera = CAMERA,
    seed: int = 0,
    *,
    trajectory: Trajectory | None = None,
    depth_noise: bool = False,
    blank: Collection[int] = (),
    dark: Collection[int] = (),
    covered: Collection[int] = (),
    depth_delay_s: float = 0.002,
) -> Trajectory:
    """Write a TUM recording of the room with calibration.yaml, and return the true T_odom_camera at its colour stamps.

    `blank` frames see bare grey walls; `dark` frames are black but keep their depth; `covered` ones are black
    and have none. Depth images are stamped `depth_delay_s` after their colour image, though exact at its pose.
    """
    truth = wobbling_trajectory(frames) if trajectory is None else trajectory
    lists: dict[str, list[str]] = {"rgb": ["# color images"], "depth": ["# depth maps"]}
    for name in lists:
        (folder / name).mkdir(parents=True, exist_ok=True)
    for index, (stamp_s, T_odom_camera) in enumerate(truth):
        color, depth_m = render_room(T_odom_camera, camera, seed, depth_noise, blank=index in blank)
        if index in dark or index in covered:
            color = np.zeros_like(color)
        if index in covered:
            depth_m = np.zeros_like(depth_m)
        units = np.rint(depth_m * 5000).clip(0, 65535).astype(np.uint16)
        for name, image, stamp in (("rgb", color[..., ::-1], stamp_s), ("depth", units, stamp_s + depth_delay_s)):
            file = f"{name}/{stamp:.6f}.png"
            assert cv2.imwrite(str(folder / file), image, [cv2.IMWRITE_PNG_COMPRESSION, 0])
            lists[name].append(f"{stamp:.6f} {file}")
    for name, lines in lists.items():
        (folder / f"{name}.txt").write_text("\n".join(lines) + "\n")
    write_tum(truth, folder / "groundtruth.txt")
    save_calibration(Calibration.registered_camera(camera, source="synthetic room"), folder / "calibration.yaml")
    return truth


def _cast(origin: FloatArray, rays: FloatArray) -> tuple[FloatArray, IntArray]:
    """Where rays (N, 3) first meet a surface: the factor (N,) along the ray, and the surface's number (N,)."""
    with np.errstate(divide="ignore"):
        inverse = np.ascontiguousarray(1.0 / rays.T)
    leaves = _slabs(origin, inverse, *ROOM)[1]
    best, axis = _nearest(leaves)
    face = axis + 3 * (np.take_along_axis(inverse, axis[None], axis=0)[0] >= 0)
    lengths = np.sqrt(np.einsum("nk,nk->n", rays, rays))
    for number, (low, high) in enumerate(BOXES, start=1):
        near = _rays_near(origin, rays, lengths, low, high)
        toward = inverse[:, near]
        enters, leaves = _slabs(origin, toward, low, high)
        enter = np.maximum(np.maximum(enters[0], enters[1]), enters[2])
        leave = np.minimum(np.minimum(leaves[0], leaves[1]), leaves[2])
        hit = np.flatnonzero((enter > 1e-6) & (enter < leave) & (enter < best[near]))
        axis = enters[:, hit].argmax(axis=0)
        best[near[hit]], face[near[hit]] = enter[hit], axis + 3 * (toward[axis, hit] < 0) + 6 * number
    return best, face


def _rays_near(
    origin: FloatArray, rays: FloatArray, lengths: FloatArray, low: tuple[float, ...], high: tuple[float, ...]
) -> IntArray:
    """Which rays (N, 3) of those lengths (N,) may meet a box: those within the cone about the ball around it."""
    to_middle = (np.array(low) + high) / 2 - origin
    distance_m, radius_m = np.linalg.norm(to_middle), 1.001 * np.linalg.norm(np.subtract(high, low)) / 2
    if distance_m <= radius_m:
        return np.arange(len(rays))
    cosine = np.sqrt(1 - (radius_m / distance_m) ** 2)
    return np.flatnonzero(rays @ to_middle >= cosine * distance_m * lengths)


def _slabs(
    origin: FloatArray, inverse: FloatArray, low: tuple[float, ...], high: tuple[float, ...]
) -> tuple[FloatArray, FloatArray]:
    """Factors (3, N) at which rays enter and leave what lies between a box's two faces across each axis."""
    to_low, to_high = ((np.array(face) - origin)[:, None] * inverse for face in (low, high))
    return np.minimum(to_low, to_high), np.maximum(to_low, to_high)


def _nearest(factors: FloatArray) -> tuple[FloatArray, IntArray]:
    """The least (N,) of factors (3, N), and its axis."""
    least, axis = np.minimum(factors[0], factors[1]), (factors[1] < factors[0]).astype(int)
    return np.minimum(least, factors[2]), np.where(factors[2] < least, 2, axis)


def _paint(p_odom: FloatArray, face: IntArray, seed: int) -> ByteArray:
    """Colours (H, W, 3) uint8 of points (H, W, 3) on surfaces (H, W): each shows its own part of one texture."""
    axis = face % 3
    u = np.where(axis == 0, p_odom[..., 1], p_odom[..., 0]) / _TEXEL_M + 197.3 * face
    v = np.where(axis == 2, p_odom[..., 1], p_odom[..., 2]) / _TEXEL_M + 89.7 * face
    in_u, in_v = ((px % _TEXTURE_SIZE).astype(np.float32) for px in (u, v))
    return np.asarray(cv2.remap(_texture(seed), in_u, in_v, cv2.INTER_LINEAR, borderMode=cv2.BORDER_WRAP))


@lru_cache(maxsize=4)
def _texture(seed: int) -> ByteArray:
    """A texture (512, 512, 3) uint8 that repeats without seams: noise at four scales and hard-edged patches."""
    rng = np.random.default_rng(seed)
    total = np.zeros((_TEXTURE_SIZE, _TEXTURE_SIZE, 3))
    for cell, weight in ((2, 0.45), (4, 0.7), (16, 0.8), (64, 0.6)):
        n = _TEXTURE_SIZE // cell
        noise = np.pad(rng.standard_normal((n, n, 3)), ((1, 1), (1, 1), (0, 0)), mode="wrap")
        smooth = cv2.resize(noise, None, fx=cell, fy=cell, interpolation=cv2.INTER_CUBIC)[cell:-cell, cell:-cell]
        total += weight * (smooth + 0.7 * np.sign(smooth.mean(axis=2, keepdims=True)) * (cell >= 16))
    return (128 + 42 * total).clip(0, 255).astype(np.uint8)
