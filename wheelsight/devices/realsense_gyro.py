"""The gyroscope in a RealSense camera (D435i, D455), where there is one: rates about the axes of the depth camera."""

from __future__ import annotations

from typing import Any

import numpy as np

from wheelsight.devices.camera_driver import DeviceAngularVelocity
from wheelsight.geometry import FloatArray

# Of readings that the library keeps while we are away: half a second of the fastest.
_QUEUED = 200


class RealSenseGyro:
    """One that streams into a queue of its own, so that images and readings push each other out of none.

    Args:
        rs: the library.
        sensor: that has it.
        profile: of its stream.
        R_camera_gyro: (3, 3).
    """

    def __init__(self, rs: Any, sensor: Any, profile: Any, R_camera_gyro: FloatArray) -> None:
        self.sensor, self.profile = sensor, profile
        self._R, self._queue = R_camera_gyro, rs.frame_queue(_QUEUED, True)

    def start(self) -> None:
        """Stream. Raises RuntimeError, as the library does."""
        self.sensor.open([self.profile])
        self.sensor.start(self._queue)

    def take(self) -> list[DeviceAngularVelocity]:
        """What came since the last call, in order; waits for none."""
        found = []
        while frame := self._queue.poll_for_frame():
            data = frame.as_motion_frame().get_motion_data()
            x, y, z = (self._R @ np.array([data.x, data.y, data.z])).tolist()
            found.append(DeviceAngularVelocity(1e-3 * frame.get_timestamp(), x, y, z))
        return found


def gyro_of(rs: Any, device: Any, depth_profile: Any) -> RealSenseGyro | None:
    """The device's gyroscope at the slowest rate that it has, still many times a turn of a robot; None for none.

    Raises RuntimeError, as the library does, of a device that does not tell how it is mounted.
    """
    offered = [
        (profile.fps(), sensor, profile)
        for sensor in device.query_sensors()
        for profile in sensor.get_stream_profiles()
        if profile.stream_type() == rs.stream.gyro and profile.format() == rs.format.motion_xyz32f
    ]
    if not offered:
        return None
    _, sensor, profile = min(offered, key=lambda one: one[0])
    rotation = profile.get_extrinsics_to(depth_profile).rotation
    return RealSenseGyro(rs, sensor, profile, np.reshape(rotation, (3, 3)).T)  # column by column, as the library has it
