"""Wheel odometry: encoder counts to a pose with its covariance (Trinh et al., section II; Ligocki, section 3)."""

from wheelsight.wheels.gyroscope import GyroCheck, YawRateMeter, gyro_warnings, mean_yaw_rates
from wheelsight.wheels.holonomic import AnyWheelOdometry, HolonomicOdometry, odometry_of
from wheelsight.wheels.odometry import (
    Integration,
    ReadingTimes,
    WheelOdometry,
    WheelSettings,
    WheelTrack,
    integrate_log,
    sides_of_four,
    ticks_from_speeds,
)

__all__ = [
    "AnyWheelOdometry",
    "GyroCheck",
    "HolonomicOdometry",
    "Integration",
    "ReadingTimes",
    "WheelOdometry",
    "WheelSettings",
    "WheelTrack",
    "YawRateMeter",
    "gyro_warnings",
    "integrate_log",
    "mean_yaw_rates",
    "odometry_of",
    "sides_of_four",
    "ticks_from_speeds",
]
