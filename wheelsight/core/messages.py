"""Messages: the events that sensors yield in order of time, the velocity commands that a robot takes, and `Match`,
two instants at one place.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from wheelsight.core.errors import ArgumentError
from wheelsight.core.geometry import ByteArray, Float32Array, FloatArray

# What sensors say: the events that every source yields in order of time.


@dataclass(frozen=True, slots=True, eq=False)
class RgbdFrame:
    """One colour image and the depth image that belongs to it.

    Attributes:
        stamp_s: time of the colour image, seconds.
        color: (H, W, 3) uint8, red green blue.
        depth_m: (H, W) float32, metres along the depth camera's z axis; 0 where nothing was measured.
        index: how many frames the source listed before this one, skipped ones included.
        depth_late_s: how much later than the colour image the depth image was taken, as its own stamp says; negative
            where it is the older one.
    """

    stamp_s: float
    color: ByteArray
    depth_m: Float32Array
    index: int = 0
    depth_late_s: float = 0.0


@dataclass(frozen=True, slots=True)
class WheelTicks:
    """Cumulative encoder counts of the left and right driven wheel, growing forward, at `stamp_s` seconds."""

    stamp_s: float
    left: int
    right: int


@dataclass(frozen=True, slots=True)
class WheelSpeeds:
    """How fast the left and right driven wheel turn, rad/s forward, from `stamp_s` seconds until the next reading.

    What is recorded as a robot's v and ω comes down to this by the track and radii it was computed with.
    """

    stamp_s: float
    left_rad_s: float
    right_rad_s: float


@dataclass(frozen=True, slots=True)
class WheelCounts:
    """Cumulative encoder counts of all wheels of a holonomic base, growing forward, at `stamp_s` seconds.

    Attributes:
        counts: one a wheel, in the order of `HolonomicWheels.wheel_names`.
    """

    stamp_s: float
    counts: tuple[int, ...]


@dataclass(frozen=True, slots=True)
class OdometryReading:
    """Where a holonomic base's own odometry has it at `stamp_s` seconds, in a frame of that odometry.

    Increments between readings count; where the frame lies does not. What happened between two readings that arrive is
    not lost with those that do not.

    Attributes:
        x_m, y_m, yaw_rad: of the base, metres and radians; yaw may wrap anywhere.
    """

    stamp_s: float
    x_m: float
    y_m: float
    yaw_rad: float


@dataclass(frozen=True, slots=True)
class YawRate:
    """A gyroscope's reading at `stamp_s` seconds: rad/s, counter-clockwise seen from above."""

    stamp_s: float
    yaw_rate_rad_s: float


@dataclass(frozen=True, slots=True)
class AngularVelocity:
    """What the gyroscope in a camera tells at `stamp_s` seconds: rad/s about the camera's x, y and z.

    No event of a run: how the camera sits on its robot makes a `YawRate` of it.
    """

    stamp_s: float
    x_rad_s: float
    y_rad_s: float
    z_rad_s: float

    def yaw_rate(self, T_base_camera: FloatArray) -> YawRate:
        """Its part about the base's z."""
        x, y, z = T_base_camera[2, :3].tolist()
        return YawRate(self.stamp_s, x * self.x_rad_s + y * self.y_rad_s + z * self.z_rad_s)


NOTHING_MEASURED = "depth image measured nothing: no pixel is valid"


@dataclass(frozen=True, slots=True)
class SkippedFrame:
    """A frame that was listed but could not be used, and why; the stream goes on after it."""

    stamp_s: float
    reason: str
    index: int = 0

    @property
    def is_blind(self) -> bool:
        """Whether the image itself is sound, and shows nothing: as of a covered camera."""
        return self.reason == NOTHING_MEASURED


HolonomicReading = WheelCounts | OdometryReading
"""A reading of a holonomic base."""

WheelReading = WheelTicks | WheelSpeeds | HolonomicReading
"""A reading of the wheels of any base."""
WHEEL_READINGS = (WheelTicks, WheelSpeeds, WheelCounts, OdometryReading)
"""Its types."""

Event = RgbdFrame | WheelTicks | WheelSpeeds | WheelCounts | OdometryReading | YawRate | SkippedFrame
"""What a sensor says at one stamp."""


# VelocityCommand: what a robot is told to do.


@dataclass(frozen=True, slots=True)
class VelocityCommand:
    """Speeds that a base is to have, in its own frame.

    Attributes:
        forward_m_s: forward; negative backward.
        turn_rad_s: counter-clockwise, seen from above.

    Raises:
        ArgumentError: numbers that are not finite.
    """

    forward_m_s: float = 0.0
    turn_rad_s: float = 0.0

    def __post_init__(self) -> None:
        for name in ("forward_m_s", "turn_rad_s"):
            value = getattr(self, name)
            if not math.isfinite(value):
                raise ArgumentError(f"{name} is {value}", fix="give a finite number; a robot that is unsure stops")

    @property
    def is_stop(self) -> bool:
        """Whether it tells the base to stand."""
        return self.forward_m_s == 0.0 and self.turn_rad_s == 0.0


STOP = VelocityCommand()
"""Stand."""


# Match: two instants of one drive at which somebody took a place for the same.


@dataclass(frozen=True, slots=True, eq=False)
class Match:
    """What place recognition from outside says; it may well be wrong.

    Attributes:
        stamp_a_s, stamp_b_s: the instants, seconds.
        T_a_b: (4, 4) where the body is at b, seen from where it is at a; None where only the place is the same.
        covariance: (6, 6) of the left perturbation (v, ω) of `T_a_b`; None where nobody says.
        score: how probable it is that the places are the same, 0 to 1; None where nobody says.
    """

    stamp_a_s: float
    stamp_b_s: float
    T_a_b: FloatArray | None = None
    covariance: FloatArray | None = None
    score: float | None = None


@dataclass(frozen=True, slots=True, eq=False)
class SpeedVariances:
    """What a recording states of the errors of its own odometry, reading by reading.

    Attributes:
        stamps_s: (N,) from when on each holds, until the next.
        variances: (N, 3) of the speed ahead and to the left, (m/s)², and of the yaw rate, (rad/s)².
    """

    stamps_s: FloatArray
    variances: FloatArray
