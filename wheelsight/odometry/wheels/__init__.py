"""Wheel odometry: encoder counts to a pose with its covariance (Trinh et al., section II; Ligocki, section 3)."""

from wheelsight.odometry.wheels.encoder import Encoder
from wheelsight.odometry.wheels.gyro import YawRateMeter, mean_yaw_rates
from wheelsight.odometry.wheels.odometry import (
    Integration,
    WheelOdometry,
    WheelTrack,
    integrate_log,
    sides_of_four,
    ticks_from_speeds,
)

__all__ = [
    "Encoder",
    "Integration",
    "WheelOdometry",
    "WheelTrack",
    "YawRateMeter",
    "integrate_log",
    "mean_yaw_rates",
    "sides_of_four",
    "ticks_from_speeds",
]
