"""Which way is up for a gyroscope: by gravity, which it is in, and by tf, which somebody wrote."""

from __future__ import annotations

import numpy as np

from wheelsight.geometry import FloatArray
from wheelsight.recordings.rosbag.definitions import are_measured
from wheelsight.recordings.rosbag.robot import Robot
from wheelsight.recordings.rosbag.settings import BagSettings
from wheelsight.recordings.rosbag.storage import OpenBag
from wheelsight.recordings.rosbag.topics import Roles

_G_M_S2 = 9.81
_UP = np.array([0.0, 0.0, 1.0])


def up_of_gyro(bag: OpenBag, roles: Roles, robot: Robot, settings: BagSettings) -> tuple[FloatArray, list[str]]:
    """The direction (3,) away from the ground in the gyroscope's frame, and sentences on how it is known.

    An accelerometer at rest shows what holds it up. Where tf tells of the mount, that stands, unless gravity disagrees.
    """
    if roles.gyro is None:
        return _UP, []
    frame = bag.header(bag.first(roles.gyro)[0]).frame
    T = None if robot.base is None else robot.transforms.between(robot.base, frame)
    told = None if T is None else T[2, :3]
    felt = _felt(bag, roles.gyro, settings)
    if told is None and felt is None:
        return _UP, [f"{roles.gyro}: neither tf nor gravity tells which way is up; its z axis is taken."]
    if felt is None or (told is not None and _between_rad(told, felt) <= settings.gravity_apart_rad):
        assert told is not None
        return told, []
    if told is None:
        tilt = np.degrees(_between_rad(_UP, felt))
        how = "which is its z axis" if tilt < np.degrees(settings.gravity_apart_rad) else f"{tilt:.0f}° off its z axis"
        return felt, [f"{roles.gyro}: tf does not tell how it is mounted; up is where gravity says, {how}."]
    apart = np.degrees(_between_rad(told, felt))
    return felt, [f"{roles.gyro}: tf and gravity disagree by {apart:.0f}° on which way is up; gravity is believed."]


def _felt(bag: OpenBag, topic: str, settings: BagSettings) -> FloatArray | None:
    """The mean acceleration's direction over the first seconds, where it is gravity's."""
    stop_ns = bag.first(topic)[0].receipt_ns + round(1e9 * settings.gravity_s)
    read = [bag.decode(message).linear_acceleration for message in bag.messages([topic], stop_ns=stop_ns)]
    measured = [(a.x, a.y, a.z) for a in read if are_measured((a.x, a.y, a.z))]
    if not measured:  # a damaged index may say that the messages come later than they do
        return None
    mean = np.mean(measured, axis=0)
    size = float(np.linalg.norm(mean))
    if not abs(size - _G_M_S2) <= settings.gravity_share * _G_M_S2:
        return None
    return np.asarray(mean / size)


def _between_rad(a: FloatArray, b: FloatArray) -> float:
    return float(np.arccos(np.clip(a @ b, -1, 1)))
