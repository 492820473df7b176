"""A robot in a world, stepped on by 5 ms: what recorded drives and a robot to command have in common."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from wheelsight.calibration import Gyro
from wheelsight.events import WheelTicks, YawRate
from wheelsight.geometry import FloatArray, se3
from wheelsight.simulation._chair import Chair
from wheelsight.simulation._ground import Underfoot
from wheelsight.simulation.doors import Leaves
from wheelsight.simulation.encoders import GYRO_PERIOD_S, Encoders, Gyroscope
from wheelsight.simulation.realism import Realism
from wheelsight.simulation.robot import TICK_PERIOD_S, Robot, WheelFaults
from wheelsight.simulation.wheelchair import TIMESTEP_S
from wheelsight.simulation.world import World

TRUTH_PERIOD_S = 0.005
NO_FAULTS = WheelFaults()

_SETTLING_S = 0.5
_STEPS = round(TRUTH_PERIOD_S / TIMESTEP_S)


@dataclass(frozen=True, slots=True, eq=False)
class Reading:
    """What there is to know of one moment.

    Attributes:
        stamp_s: seconds since the start.
        position_m: (3,) of T_world_base.
        quaternion_wxyz: (4,) of T_world_base.
        ticks: of the wheels, where it was their turn and they did not drop out.
        yaw_rate: of the gyroscope, where there is one and it was its turn.
    """

    stamp_s: float
    position_m: FloatArray
    quaternion_wxyz: FloatArray
    ticks: WheelTicks | None
    yaw_rate: YawRate | None


class SteppedRobot:
    """A chair with its encoders and gyroscope: `read` once and `advance` once every `TRUTH_PERIOD_S`.

    Args:
        world, robot, T_world_start: what stands where; it is let settle on its wheels.
        faults: what goes wrong with the wheels, and when.
        slip: whether the wheels may slip.
        seed: of the rider, castors, encoders' phases and gyroscope.
        floor: what the wheels meet, or None for a level one.
        doors: which swing in the world, or None.

    Attributes:
        chair: what physics moves.
        tick: how often it was advanced.

    Raises:
        ConfigError: a world that MuJoCo does not take.
    """

    def __init__(
        self,
        world: World,
        robot: Robot,
        T_world_start: FloatArray,
        *,
        faults: WheelFaults = NO_FAULTS,
        slip: bool = True,
        seed: int = 0,
        floor: Underfoot | None = None,
        doors: Leaves | None = None,
    ) -> None:
        chair_rng, encoder_rng, gyro_rng = (np.random.default_rng([seed, part]) for part in range(3))
        self.chair = Chair(world, robot, faults, T_world_start, slip=slip, rng=chair_rng, underfoot=floor, doors=doors)
        if doors is not None:
            self.chair.swing(*doors.poses_at(0.0))
        self.chair.settle(_SETTLING_S)
        self._encoders = Encoders(robot, faults, encoder_rng)
        self._gyroscope = Gyroscope(Gyro(), gyro_rng) if robot.has_gyro else None
        self.tick = 0

    @property
    def time_s(self) -> float:
        """Seconds since the start."""
        return self.tick * TRUTH_PERIOD_S

    @property
    def counts(self) -> tuple[int, int]:
        """Of the left and right encoder, as the wheel controller has them, whether it can tell them or not."""
        return self._encoders.counts

    def read(self) -> Reading:
        """The pose, and each sensor whose turn it is."""
        position, quaternion_wxyz = self.chair.pose
        self._encoders.turn(self.time_s, self.chair.wheels_rad)
        ticks = yaw_rate = None
        if self.tick % ticks_of(TICK_PERIOD_S) == 0:
            ticks = self._encoders.read(self.time_s)
        if self._gyroscope is not None and self.tick % ticks_of(GYRO_PERIOD_S) == 0:
            yaw_rate = self._gyroscope.read(self.time_s, self.chair.yaw_rate_rad_s)
        return Reading(self.time_s, position, quaternion_wxyz, ticks, yaw_rate)

    def advance(self) -> None:
        """Go on by `TRUTH_PERIOD_S`."""
        self.chair.step(self.time_s, _STEPS)
        self.tick += 1


def poses_of(readings: Sequence[Reading]) -> FloatArray:
    """T_world_base (N, 4, 4) of readings."""
    quaternions_xyzw = np.roll(np.array([reading.quaternion_wxyz for reading in readings]), -1, axis=1)
    return se3.from_quaternion(np.array([reading.position_m for reading in readings]), quaternions_xyzw)


def floor_of(world: World, realism: Realism | None, seed: int) -> Underfoot | None:
    """What a world's floor and tyres do to wheels, or None where nothing."""
    return None if realism is None else Underfoot(realism.floor_of(world, seed), realism.tyres)


def start_of(world: World) -> FloatArray:
    """T_world_base (4, 4) at the route's first waypoint, heading for the second."""
    (x, y), towards = world.route[0], world.route[1] - world.route[0]
    return se3.from_plane(x, y, np.arctan2(towards[1], towards[0]))


def ticks_of(period_s: float) -> int:
    """How many times `TRUTH_PERIOD_S` a period lasts."""
    return round(period_s / TRUTH_PERIOD_S)
