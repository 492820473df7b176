"""Messages: the events that sensors yield in order of time, the velocity commands that a robot takes, and `Match`,
two instants at one place.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from wheelsight.core.errors import ArgumentError
from wheelsight.core.geometry import ByteArray, Float32Array, FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class RgbdFrame:
    """One colour image and the depth image that belongs to it.

    Attributes:
        stamp_s: time of the colour image, seconds.
        color: (H, W, 3) uint8, red green blue.
        depth_m: (H, W) float32, metres along the depth camera's z axis; 0 where nothing was measured.
        index: number of frames that the source listed before this one, skipped ones included.
        depth_late_s: delay of the depth image behind the colour image, by their stamps; negative if it is older.
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
    """Angular speeds of the left and right driven wheel, rad/s forward, from `stamp_s` seconds to the next reading.

    A recorded v and ω of a robot is converted to this by the track width and radii of its driver.
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
    """The pose of a holonomic base by its own odometry at `stamp_s` seconds, in the frame of that odometry.

    Only increments between readings count, so a missing reading loses no motion.

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
    """A reading of a camera's gyroscope at `stamp_s` seconds: rad/s about the camera's x, y and z.

    It is no event of a run: the mount of the camera converts it to a `YawRate`.
    """

    stamp_s: float
    x_rad_s: float
    y_rad_s: float
    z_rad_s: float

    def yaw_rate(self, T_base_camera: FloatArray) -> YawRate:
        """The component about the base's z axis."""
        x, y, z = T_base_camera[2, :3].tolist()
        return YawRate(self.stamp_s, x * self.x_rad_s + y * self.y_rad_s + z * self.z_rad_s)


@dataclass(frozen=True, slots=True)
class NearbyReading:
    """Bumpers and ultrasonic rangers at `stamp_s` seconds, in the order of the controller's inputs.

    It is no event of a run: the collision monitor takes it from `nearby` of a robot.

    Attributes:
        ranges_m: of each ranger; infinite where nothing is within reach, NaN where it does not answer.
    """

    stamp_s: float
    is_pressed: tuple[bool, ...]
    ranges_m: tuple[float, ...]


NOTHING_MEASURED = "depth image measured nothing: no pixel is valid"


@dataclass(frozen=True, slots=True)
class SkippedFrame:
    """A listed frame that is unusable, with the reason; the stream continues after it."""

    stamp_s: float
    reason: str
    index: int = 0

    @property
    def is_blind(self) -> bool:
        """Whether the image is valid and shows nothing, as that of a covered camera."""
        return self.reason == NOTHING_MEASURED


HolonomicReading = WheelCounts | OdometryReading
"""A reading of a holonomic base."""

WheelReading = WheelTicks | WheelSpeeds | HolonomicReading
"""A reading of the wheels of any base."""
WHEEL_READINGS = (WheelTicks, WheelSpeeds, WheelCounts, OdometryReading)
"""Its types."""

Event = RgbdFrame | WheelTicks | WheelSpeeds | WheelCounts | OdometryReading | YawRate | SkippedFrame
"""A message of a sensor at one stamp."""


@dataclass(frozen=True, slots=True)
class VelocityCommand:
    """The commanded velocity of a base, in its own frame.

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
        """Whether it commands a standstill."""
        return self.forward_m_s == 0.0 and self.turn_rad_s == 0.0


STOP = VelocityCommand()
"""A standstill."""


@dataclass(frozen=True, slots=True, eq=False)
class Match:
    """Two times of one drive at the same place, by external place recognition; it may be wrong.

    Attributes:
        stamp_a_s, stamp_b_s: the times, seconds.
        T_a_b: (4, 4) pose of the body at b relative to that at a; None if only the place is known.
        covariance: (6, 6) of the left perturbation (v, ω) of `T_a_b`; None if unknown.
        score: probability that the places are the same, 0 to 1; None if unknown.
    """

    stamp_a_s: float
    stamp_b_s: float
    T_a_b: FloatArray | None = None
    covariance: FloatArray | None = None
    score: float | None = None


@dataclass(frozen=True, slots=True, eq=False)
class SpeedVariances:
    """Variances of a recording's own odometry, as the recording states them.

    Attributes:
        stamps_s: (N,) start time of each variance, which holds until the next one.
        variances: (N, 3) of forward and left speed, (m/s)², and of the yaw rate, (rad/s)².
    """

    stamps_s: FloatArray
    variances: FloatArray


# Deflection below which a stick is released, as a share of the full one.
_DEAD_ZONE = 0.05


@dataclass(frozen=True, slots=True)
class StickPosition:
    """Position of a stick.

    Attributes:
        stamp_s: by the robot's clock.
        forward: from -1, fully back, to 1.
        left: from -1, fully right, to 1.
        has_override: whether the switch for full control is held.
    """

    stamp_s: float
    forward: float = 0.0
    left: float = 0.0
    has_override: bool = False

    @property
    def is_sound(self) -> bool:
        """Whether all numbers are finite, and within -1 and 1."""
        return math.isfinite(self.stamp_s) and all(abs(value) <= 1 for value in (self.forward, self.left))

    @property
    def is_released(self) -> bool:
        """Whether it is within the dead zone."""
        return max(abs(self.forward), abs(self.left)) < _DEAD_ZONE
