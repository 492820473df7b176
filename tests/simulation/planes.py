"""A bare floor to drive on, with a wall where a test wants one, and what the wheels make of a drive."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from wheelsight.core.areas import AreaMap
from wheelsight.core.calibration_parts import Wheels
from wheelsight.core.geometry import FloatArray
from wheelsight.core.trajectory import Trajectory
from wheelsight.wheels import integrate_log
from wheelsight_sim.robot import Drive
from wheelsight_sim.world import World

WALL = '<geom name="wall" type="box" pos="3 0 1" size="0.1 5 1"/>'


def plane(route: ArrayLike = ((0, 0), (6, 0), (6, 4), (0, 4)), *, is_loop: bool = False, extra: str = "") -> World:
    floor = '<geom name="floor" type="plane" size="20 20 1"/>'
    mjcf = f"<mujoco><worldbody>{floor}{extra}</worldbody></mujoco>"
    return World("plane", "a bare floor", mjcf, {}, AreaMap(), np.array(route, float), is_loop, (-20, -20, 20, 20))


def by_wheels(drive: Drive, wheels: Wheels) -> tuple[Trajectory, FloatArray]:
    """Dead reckoning at the readings, moved to where the drive began; and the truth (N, 4, 4) at the same stamps."""
    stamps_s, left, right = np.array([(t.stamp_s, t.left, t.right) for t in drive.ticks]).T
    path = integrate_log(wheels, stamps_s, left.astype(int), right.astype(int)).trajectory()
    return path.moved(drive.truth.at(path.stamps_s[:1])[0]), drive.truth.at(path.stamps_s)


def yaws_rad(T: FloatArray) -> FloatArray:
    return np.unwrap(np.arctan2(T[:, 1, 0], T[:, 0, 0]))
