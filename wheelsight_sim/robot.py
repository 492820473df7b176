"""`RobotModel`: true and nominal dimensions, outline and motors of the wheelchair; `Drive` is what physics leaves."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace

import numpy as np
import shapely

from wheelsight.core.calibration_parts import Wheels
from wheelsight.core.errors import ConfigError
from wheelsight.core.geometry import FloatArray, so3
from wheelsight.core.messages import HolonomicReading, WheelReading, WheelTicks, YawRate
from wheelsight.core.robots import Duties
from wheelsight.core.trajectory import Trajectory

TICK_PERIOD_S = 0.02
NOMINAL_RADIUS_M, NOMINAL_TRACK_WIDTH_M = 0.17, 0.52

_POSSIBLE = {
    "left_radius_m": (0.05, 0.5),
    "right_radius_m": (0.05, 0.5),
    "track_width_m": (0.2, 2.0),
    "gear_ratio": (0.1, 1000.0),
    "counts_per_turn": (1, 1_000_000),
    "length_m": (0.4, 2.0),
    "width_m": (0.3, 2.0),
    "height_m": (0.6, 2.5),
    "tail_m": (0.1, 1.0),
    "camera_height_m": (0.05, 3.0),
    "camera_forward_m": (-1.0, 2.0),
    "camera_left_m": (-1.0, 1.0),
    "camera_pitch_rad": (-math.pi / 2, math.pi / 2),
    "camera_yaw_rad": (-math.pi, math.pi),
    "camera_roll_rad": (-math.pi, math.pi),
}


@dataclass(frozen=True, slots=True)
class RobotModel:
    """A powered wheelchair with the dimensions of Trinh et al., section II; errors make truth differ from them.

    Attributes:
        left_radius_m, right_radius_m: true radii of the driven wheels.
        track_width_m: true distance between the points where they touch the ground.
        gear_ratio: turns of a motor a turn of its wheel.
        counts_per_turn: of the encoder on the motor.
        length_m, width_m, height_m: of the whole wheelchair; `tail_m` of its length is behind the axle.
        camera_height_m, camera_forward_m, camera_left_m: where the camera sits over the ground, ahead of the axle and
            left of its middle.
        camera_pitch_rad, camera_yaw_rad, camera_roll_rad: how far it looks down, looks to the left, and leans to the
            right.
        has_gyro: whether a gyroscope is read too.

    Raises:
        ConfigError: a value that no wheelchair has.
    """

    left_radius_m: float = NOMINAL_RADIUS_M
    right_radius_m: float = NOMINAL_RADIUS_M
    track_width_m: float = NOMINAL_TRACK_WIDTH_M
    gear_ratio: float = 32.0
    counts_per_turn: int = 100
    length_m: float = 1.10
    width_m: float = 0.60
    height_m: float = 1.00
    camera_height_m: float = 0.90
    camera_forward_m: float = 0.35
    camera_left_m: float = 0.0
    camera_pitch_rad: float = 0.10
    camera_yaw_rad: float = 0.0
    camera_roll_rad: float = 0.0
    has_gyro: bool = False
    tail_m: float = 0.30

    def __post_init__(self) -> None:
        for name, (least, most) in _POSSIBLE.items():
            value = getattr(self, name)
            if not least <= value <= most:
                raise ConfigError(f"{name} is {value}, no wheelchair's", fix=f"{least:g} to {most:g}")
        if self.counts_per_turn != int(self.counts_per_turn):
            raise ConfigError(f"counts_per_turn is {self.counts_per_turn}", fix="give a whole number")

    @property
    def T_base_camera(self) -> FloatArray:
        """(4, 4) the true pose of the camera's optical frame on the base."""
        c, s = math.cos(self.camera_pitch_rad), math.sin(self.camera_pitch_rad)
        T = np.eye(4)
        T[:3, 0], T[:3, 1], T[:3, 2] = (0, -1, 0), (-s, 0, -c), (c, 0, -s)
        if self.camera_yaw_rad or self.camera_roll_rad:
            T[:3, :3] = so3.exp([0, 0, self.camera_yaw_rad]) @ T[:3, :3] @ so3.exp([0, 0, self.camera_roll_rad])
        T[:3, 3] = self.camera_forward_m, self.camera_left_m, self.camera_height_m
        return T

    @property
    def nominal(self) -> Wheels:
        """The nominal wheels: sizes of the data sheet, with the true encoder and gear."""
        radius_m, track_width_m = NOMINAL_RADIUS_M, NOMINAL_TRACK_WIDTH_M
        return Wheels(radius_m, radius_m, track_width_m, self.gear_ratio * self.counts_per_turn)

    @property
    def wheels(self) -> Wheels:
        """The wheels as an ideal calibration would find them."""
        ticks_per_turn = self.gear_ratio * self.counts_per_turn
        return Wheels(self.left_radius_m, self.right_radius_m, self.track_width_m, ticks_per_turn)


@dataclass(frozen=True, slots=True)
class Patch:
    """A round patch of floor with another friction: ice, wet tiles. Raises ConfigError for one that cannot be."""

    x_m: float
    y_m: float
    radius_m: float
    friction: float = 0.05

    def __post_init__(self) -> None:
        if not (math.isfinite(self.x_m) and math.isfinite(self.y_m) and 0 < self.radius_m < math.inf):
            problem = f"a patch of radius {self.radius_m} m at {self.x_m}, {self.y_m} is none"
            raise ConfigError(problem, fix="give metres")
        if not 0.001 <= self.friction <= 2:
            raise ConfigError(f"a patch's friction is {self.friction}", fix="0.001 to 2; ice has about 0.05")


@dataclass(frozen=True, slots=True)
class WheelFaults:
    """Faults of the wheels during a drive: (from, to) times, and patches of low friction.

    No reading arrives in `dropouts_s`, and counting goes on. In `unplugged_s` the pulses of both wheels are lost. In
    `lifted_s` the left driven wheel hangs free. Raises ConfigError for a time that ends before it begins.
    """

    dropouts_s: tuple[tuple[float, float], ...] = ()
    unplugged_s: tuple[tuple[float, float], ...] = ()
    patches: tuple[Patch, ...] = field(default=())
    lifted_s: tuple[tuple[float, float], ...] = ()

    def __post_init__(self) -> None:
        for name in ("dropouts_s", "unplugged_s", "lifted_s"):
            for start_s, end_s in getattr(self, name):
                if not 0 <= start_s < end_s:
                    raise ConfigError(f"{name} has a time from {start_s} to {end_s} s", fix="from 0 on, growing")


@dataclass(frozen=True, eq=False)
class Drive:
    """A finished drive; the camera's images are rendered along `truth` afterwards, in any order.

    Attributes:
        truth: T_world_base at a constant rate of at least 100 Hz, from 0 s; interpolate between.
        ticks: the wheel controller's readings in order of time, every 20 ms where none dropped out.
        yaw_rates: of the gyroscope; empty where the robot has none.
        is_complete, reason: whether the route was driven to its end, and why not.
        holonomic: in place of `ticks`, the readings of a holonomic base.
    """

    truth: Trajectory
    ticks: tuple[WheelTicks, ...]
    yaw_rates: tuple[YawRate, ...] = ()
    is_complete: bool = True
    reason: str = ""
    holonomic: tuple[HolonomicReading, ...] = ()

    @property
    def readings(self) -> tuple[WheelReading, ...]:
        """Of the wheels, whichever the base has."""
        return self.holonomic or self.ticks

    @property
    def duration_s(self) -> float:
        """From the first to the last pose."""
        return self.truth.duration_s


def outline_m(robot: RobotModel) -> FloatArray:
    """(3,) how far it reaches along x, from and to, and half its width, in the frame of the base."""
    return np.array([-robot.tail_m, robot.length_m - robot.tail_m, robot.width_m / 2])


def outline_at(robot: RobotModel, T_world_base: FloatArray) -> shapely.Polygon:
    """The rectangle on the floor of a robot at a pose (4, 4)."""
    back_m, front_m, half_m = outline_m(robot)
    corners = np.array([(back_m, -half_m), (front_m, -half_m), (front_m, half_m), (back_m, half_m)])
    return shapely.Polygon(corners @ T_world_base[:2, :2].T + T_world_base[:2, 3])


FULL_SPEED_M_S = 2.6  # of a rim at a duty of 1: 157 pulses of 0.33 mm in 20 ms (Trinh et al., II.C)
# Share by which motors deviate from that, and their time constant. Chosen: the joystick's filter of docs/firmware.md
# has 0.01 s, the chair's own controller and the motors the rest.
MOTOR_SPREAD, MOTOR_LAG_S = 0.03, 0.1


class Motors:
    """Motors of both driven wheels, with random strengths, or nominal ones if `rng` is None."""

    def __init__(self, rng: np.random.Generator | None = None) -> None:
        shares = np.ones(2) if rng is None else 1 + MOTOR_SPREAD * rng.standard_normal(2)
        self._full_m_s = FULL_SPEED_M_S * shares
        self._rims_m_s: FloatArray = np.zeros(2)

    def after(self, duties: Duties, seconds: float) -> tuple[float, float]:
        """Speeds of the left and right rim without load."""
        share = 1 - math.exp(-seconds / MOTOR_LAG_S)
        wanted = self._full_m_s * (duties.left, duties.right)
        self._rims_m_s = self._rims_m_s + share * (wanted - self._rims_m_s)
        return float(self._rims_m_s[0]), float(self._rims_m_s[1])


@dataclass(frozen=True, slots=True)
class WheelSizeSettings:
    """How far calibrated sizes are off; the calibration states the same.

    Attributes:
        scale_sigma: of both radii, as a share: air and warmth. Computed.
        drift_sigma_rad_per_m: turn a metre by radii that are not alike: two kilograms more on one side press that
            tyre in by 0.06 %, a milliradian a metre on wheels half a metre apart. Computed.
        turn_sigma: of the track width, as a share: where in its width a tyre touches the floor. Computed.
    """

    scale_sigma: float = 0.003
    drift_sigma_rad_per_m: float = 0.001
    turn_sigma: float = 0.003


def as_calibrated(true: Wheels, settings: WheelSizeSettings, rng: np.random.Generator) -> Wheels:
    """Wheels as `wheelsight calibrate wheels` would have left them some days ago."""
    scale, drift, turn = rng.standard_normal(3) * (
        settings.scale_sigma,
        settings.drift_sigma_rad_per_m * true.track_width_m,
        settings.turn_sigma,
    )
    return replace(
        true,
        left_radius_m=true.left_radius_m * (1 + scale - drift / 2),
        right_radius_m=true.right_radius_m * (1 + scale + drift / 2),
        track_width_m=true.track_width_m * (1 + turn),
        scale_sigma=settings.scale_sigma,
        drift_sigma_rad_per_m=settings.drift_sigma_rad_per_m,
        turn_sigma=settings.turn_sigma,
    )
