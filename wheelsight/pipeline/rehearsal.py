"""A small drive in which everything happens: a recording that calls whatever kernel a run may need.

A box of a room, painted in cells, is driven through in an arc. On the way the camera is covered, a wheel slips, the
robot is carried off, a counter leaps, and the image goes dark.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from wheelsight.calibration import Calibration, Wheels
from wheelsight.events import Event, RgbdFrame, WheelTicks, YawRate
from wheelsight.geometry import ByteArray, Float32Array, FloatArray, PinholeCamera, se3
from wheelsight.mapping import SurfelMap, Surfels
from wheelsight.recordings import RecordingWriter
from wheelsight.trajectory import Trajectory

# Small: images of 320×240 call the same kernels and take more than twice the time.
_CAMERA = PinholeCamera(160, 120, 131.0, 130.0, 80.0, 60.0)
_BENT = PinholeCamera(160, 120, 131.0, 130.0, 80.0, 60.0, (0.1, -0.1, 0.001, 0.001, 0.01))
_MOUNT = np.array([[0.0, 0, 1, 0.2], [-1, 0, 0, 0], [0, -1, 0, 1.2], [0, 0, 0, 1]])
WHEELS = Wheels(0.17, 0.17, 0.52, 3200.0)
LOW, HIGH = np.array([-2.5, -2.0, 0.0]), np.array([2.5, 2.0, 2.6])
_CELL_M = 0.24  # corners for keypoints, and large enough to be seen at half resolution
_STEP_S, _STEPS_A_FRAME = 0.02, 5
_DEEPEST_M = 8.0


@dataclass(frozen=True, slots=True)
class _Leg:
    """So many frames at a speed and a turn; the left wheel turns `slip` times as far as it rolls."""

    frames: int
    v_m_s: float = 0.0
    yaw_rate_rad_s: float = 0.0
    slip: float = 1.0
    is_covered: bool = False
    is_dark: bool = False
    carried_m: float = 0.0


_LEGS = (
    *(_Leg(6), _Leg(14, 0.5, 0.2), _Leg(6, 0.4, -0.9), _Leg(8, 0.4, 0.3, is_covered=True), _Leg(8, 0.4, 0.2)),
    *(_Leg(8, 0.3, 0.0, slip=3.0), _Leg(5, 0.3), _Leg(4, carried_m=0.15), _Leg(5, 0.2, 0.5, is_dark=True), _Leg(5)),
)


def write_rehearsal(folder: Path, *, is_registered: bool) -> None:
    """Write the drive, by a camera with a rolling shutter: of one pixel grid, or of two, with a lens that distorts."""
    with RecordingWriter(folder, _calibration(is_registered)) as writer:
        stamps_s, poses = [], []
        for stamp_s, T_odom_base, events in _drive():
            stamps_s.append(stamp_s)
            poses.append(T_odom_base)
            for event in events:
                writer.add(event)
        writer.add_ground_truth(Trajectory(np.array(stamps_s), np.array(poses), body="base"))


class DrawnDrive:
    """The same drive without a disk, as a source of events.

    Args:
        like: the sensors of the robot that is to be rehearsed for: what it lacks, the drive lacks.
    """

    name, warnings = "rehearsal", ()

    def __init__(self, like: Calibration) -> None:
        own = _calibration(like.is_registered)
        if like.color is None:
            own = replace(own, color=None, depth=None, T_color_depth=None)
        if like.wheels is None:
            own = replace(own, wheels=None)
        self.calibration = own if like.T_base_camera is not None else replace(own, T_base_camera=None)

    def events(self, *, images: bool = True) -> Iterator[Event]:
        """As any source has them."""
        has_wheels = self.calibration.wheels is not None
        for _, _, events in _drive(images):
            yield from (event for event in events if has_wheels or isinstance(event, RgbdFrame))

    def rehearsal(self) -> Iterator[Event]:
        """All of it."""
        return self.events(images=self.calibration.color is not None)


def _drive(images: bool = True) -> Iterator[tuple[float, FloatArray, list[Event]]]:
    """Stamp, T_odom_base and events, reading by reading; frames are drawn only if asked for."""
    for index, (stamp_s, T_odom_base, leg, ticks, is_frame) in enumerate(_steps()):
        events: list[Event] = [YawRate(stamp_s, leg.yaw_rate_rad_s), WheelTicks(stamp_s, *ticks)]
        if is_frame and images:
            color, depth_m = _seen(T_odom_base, leg)
            events.append(RgbdFrame(stamp_s + 1e-3, color, depth_m, index // _STEPS_A_FRAME))
        yield stamp_s, T_odom_base, events


def _calibration(is_registered: bool) -> Calibration:
    robot: dict[str, Any] = {
        "wheels": WHEELS,
        "T_base_camera": _MOUNT,
        "rolling_shutter_s": 0.02,
        "source": "rehearsal",
    }
    if is_registered:
        return Calibration.registered_camera(_CAMERA, **robot)
    beside = se3.from_parts(np.eye(3), np.array([0.002, 0.0, 0.0]))
    return Calibration(_BENT, _CAMERA, beside, color_sigma_px=1.0, **robot)


def _steps() -> Iterator[tuple[float, FloatArray, _Leg, tuple[int, int], bool]]:
    """Stamp, T_odom_base, leg, counters and whether a frame is due, reading by reading."""
    x, y, yaw, left_m, right_m, index = -1.6, -0.4, 0.1, 0.0, 0.0, 0
    for leg in _LEGS:
        y += leg.carried_m
        for _ in range(leg.frames * _STEPS_A_FRAME):
            across_m_s = leg.yaw_rate_rad_s * WHEELS.track_width_m / 2
            left_m += leg.slip * (leg.v_m_s - across_m_s) * _STEP_S
            right_m += (leg.v_m_s + across_m_s) * _STEP_S
            x, y = x + leg.v_m_s * _STEP_S * np.cos(yaw), y + leg.v_m_s * _STEP_S * np.sin(yaw)
            yaw += leg.yaw_rate_rad_s * _STEP_S
            ticks = (round(left_m / WHEELS.left_m_per_tick), round(right_m / WHEELS.right_m_per_tick))
            yield index * _STEP_S, se3.from_plane(x, y, yaw), leg, ticks, index % _STEPS_A_FRAME == 0
            index += 1


def _seen(T_odom_base: FloatArray, leg: _Leg) -> tuple[ByteArray, Float32Array]:
    """Colour (H, W, 3) and depth (H, W) on a leg."""
    color, depth_m = seen_from(T_odom_base)
    if leg.is_dark or leg.is_covered:
        color = np.zeros_like(color)
    return color, np.zeros_like(depth_m) if leg.is_covered else depth_m


def seen_from(T_odom_base: FloatArray, camera: PinholeCamera | None = None) -> tuple[ByteArray, Float32Array]:
    """Colour (H, W, 3) and depth (H, W) of the box from inside, where the base is at (4, 4); None: its own camera."""
    camera = camera or _CAMERA
    T_odom_camera = T_odom_base @ _MOUNT
    rays = camera.rays() @ T_odom_camera[:3, :3].T
    origin = T_odom_camera[:3, 3]
    rays = np.where(rays == 0, 1e-9, rays)
    ways = np.where(rays > 0, (HIGH - origin) / rays, (LOW - origin) / rays)
    axis = ways.argmin(axis=-1)
    depth_m = np.take_along_axis(ways, axis[..., None], axis=-1)[..., 0]
    points = origin + rays * depth_m[..., None]
    cells = np.floor(points / _CELL_M).astype(int)
    np.put_along_axis(cells, axis[..., None], 40 * axis[..., None], axis=-1)  # a wall's own distance says nothing
    shade = (cells @ np.array([7919, 104729, 1299709])) % 1009
    color = np.stack([40 + shade % 97 * 2, 40 + shade % 89 * 2, 40 + shade % 101 * 2], axis=-1).astype(np.uint8)
    return color, depth_m.clip(max=_DEEPEST_M).astype(np.float32)


def floor_map() -> SurfelMap:
    """A square of a floor, 0.3 m wide and between two layers of voxels, where a mesh crosses zero."""
    across, along = np.meshgrid(np.arange(0, 0.3, 0.01), np.arange(0, 0.3, 0.01))
    n = across.size
    position = np.column_stack([across.ravel(), along.ravel(), np.full(n, 0.011)]).astype(np.float32)
    normal = np.tile(np.array([0, 0, 1], np.float32), (n, 1))
    radius_m, grey, confidence, variance_m2 = (np.full(n, x, np.float32) for x in (0.01, 128, 50, 1e-6))
    color, stamps_s = np.full((n, 3), 128, np.float32), np.zeros(n)
    surfel_map = SurfelMap()
    seen = (stamps_s, stamps_s, np.full(n, -1, np.int32))
    surfel_map.add(Surfels(position, normal, radius_m, color, grey, confidence, variance_m2, *seen), stamp_s=0.0)
    return surfel_map
