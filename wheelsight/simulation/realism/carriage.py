"""How a camera is carried along a drive: where it truly is at any time."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import ArrayLike

from wheelsight.geometry import FloatArray, se3
from wheelsight.simulation.realism.body import BodyMotion
from wheelsight.simulation.realism.mount import mounted
from wheelsight.simulation.realism.presets import Realism, stream
from wheelsight.simulation.robot import Robot
from wheelsight.simulation.world import World
from wheelsight.trajectory import Trajectory

_TWIST_S = 0.01


class MovingBody(Protocol):
    """A body that moves against its base."""

    def T_base_body(self, stamps_s: ArrayLike) -> FloatArray:
        """(N, 4, 4) where it is at times (N,), from where it is on a level floor at rest."""


@dataclass(frozen=True, slots=True, eq=False)
class Carriage:
    """A camera on a robot.

    Attributes:
        truth: T_world_base.
        T_base_camera: (4, 4) the mount as it truly is, of a body at rest.
        body: how the body moves against the base, or None for one that does not.
    """

    truth: Trajectory
    T_base_camera: FloatArray
    body: MovingBody | None = None

    def T_world_base(self, stamp_s: float) -> FloatArray:
        """(4, 4) at a time; before the drive begins and after it ends the robot stands."""
        return np.asarray(self.truth.at(np.clip(stamp_s, *self.truth.stamps_s[[0, -1]]))[0])

    def T_world_camera(self, stamps_s: ArrayLike) -> FloatArray:
        """(N, 4, 4) at times (N,); before the drive begins and after it ends the robot stands."""
        within_s = np.atleast_1d(np.clip(stamps_s, self.truth.stamps_s[0], self.truth.stamps_s[-1]))
        T_world_base = self.truth.at(within_s)
        if self.body is None:
            return np.asarray(se3.compose(T_world_base, self.T_base_camera))
        T_base_camera = se3.compose(self.body.T_base_body(within_s), self.T_base_camera)
        return np.asarray(se3.compose(T_world_base, T_base_camera))

    def twist_camera(self, stamp_s: float) -> FloatArray:
        """(6,) velocity (v, ω) of the camera in its own frame, m/s and rad/s."""
        ends_s = np.clip(
            [stamp_s - _TWIST_S / 2, stamp_s + _TWIST_S / 2], self.truth.stamps_s[0], self.truth.stamps_s[-1]
        )
        before, after = self.T_world_camera(ends_s)
        return np.asarray(se3.log(se3.compose(se3.invert(before), after)) / (ends_s[1] - ends_s[0]))


def carriage_of(truth: Trajectory, world: World, robot: Robot, realism: Realism | None, seed: int) -> Carriage:
    """How a robot carries its camera along a drive."""
    if realism is None:
        return Carriage(truth, robot.T_base_camera)
    floor = realism.floor_of(world, seed)
    body = BodyMotion(truth, robot, floor, realism.body, stream(seed, "body"))
    return Carriage(truth, mounted(robot.T_base_camera, realism.mount, stream(seed, "mount")), body)
