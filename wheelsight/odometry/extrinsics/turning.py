"""common_turning: which way is up for the camera, and how late the wheels' clock is, by turns that both have seen.

A robot on a floor turns about the floor's normal only. Seen from the camera, all its turns therefore have one axis, and
their sizes are those of the wheels: the axis and the delay for which they agree best are found together.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from wheelsight.calibration import Wheels
from wheelsight.geometry import FloatArray, IntArray, se3, so3
from wheelsight.odometry.extrinsics.settings import DEFAULTS, TurningSettings
from wheelsight.odometry.wheels.drive import Drive, yaw_at_readings
from wheelsight.trajectory import Trajectory


@dataclass(frozen=True, eq=False)
class Turning:
    """What the turns say.

    Attributes:
        up_camera: (3,) the axis about which left turns go, of length 1, in the camera frame.
        delay_s: of the wheels' stamps against the camera's, to 20 ms, within ±`largest_offset_s` of the nominal one.
        agreement: 0 to 1, the correlation of the camera's turns about that axis with the wheels'.
    """

    up_camera: FloatArray
    delay_s: float
    agreement: float


def common_turning(
    drive: Drive, wheels: Wheels, camera: Trajectory, settings: TurningSettings = DEFAULTS.turning
) -> Turning:
    """The axis and delay for which the turns of `camera` (T_map_camera) and of the wheels agree best.

    Turns that share no time with the readings, at a delay, have no say in it; where fewer than half do, the delay is
    not considered. Without turns the agreement is 0.
    """
    start, end = _intervals(camera.stamps_s, settings)
    turns = so3.log(se3.invert(camera.T_frame_body[start])[:, :3, :3] @ camera.T_frame_body[end, :3, :3])
    steps = round(settings.largest_offset_s / settings.step_s)
    turned_rad = yaw_at_readings(drive, wheels)
    best = Turning(np.array([0.0, -1.0, 0.0]), wheels.delay_s, 0.0)
    for delay_s in wheels.delay_s + settings.step_s * np.arange(-steps, steps + 1):
        begin_s, until_s = camera.stamps_s[start] + delay_s, camera.stamps_s[end] + delay_s
        inside = (begin_s >= drive.stamps_s[0]) & (until_s <= drive.stamps_s[-1])
        if np.count_nonzero(inside) < max(1.0, settings.fewest_share * len(start)):
            continue
        ends_rad = (np.interp(stamps_s[inside], drive.stamps_s, turned_rad) for stamps_s in (until_s, begin_s))
        yaw_rad = np.subtract(*ends_rad)
        axis = yaw_rad @ turns[inside]
        size = float(np.sqrt(np.sum(yaw_rad**2) * np.sum(turns[inside] ** 2)))
        agreement = float(np.linalg.norm(axis)) / size if size > 0 else 0.0
        if agreement > best.agreement:
            best = Turning(axis / np.linalg.norm(axis), float(delay_s), agreement)
    return best


def _intervals(stamps_s: FloatArray, settings: TurningSettings) -> tuple[IntArray, IntArray]:
    """Indices of first and last frame of intervals, without those over gaps."""
    marks = np.floor((stamps_s - stamps_s[:1]) / settings.interval_s) if len(stamps_s) else np.zeros(0)
    cuts = np.flatnonzero(np.diff(marks, prepend=-1) > 0)
    start, end = cuts[:-1], cuts[1:]
    whole = stamps_s[end] - stamps_s[start] <= settings.longest_interval_s
    return start[whole], end[whole]
