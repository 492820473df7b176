"""Wheel odometry: encoder counts to a pose with its covariance (Trinh et al., section II; Ligocki, section 3).

Also calibration of the wheels, by squares or against a reference trajectory.
"""

from wheelsight.wheels.calibration import WheelFit, WheelTrial, fit_wheels, try_calibration
from wheelsight.wheels.drive import WheelDrive, drive_from_ticks, drive_of, drive_path
from wheelsight.wheels.gyroscope import GyroCheck, YawRateMeter, gyro_warnings, mean_yaw_rates
from wheelsight.wheels.holonomic import AnyWheelOdometry, HolonomicOdometry, odometry_of
from wheelsight.wheels.loop_check import LoopCause, LoopCheck, check_loop, with_sigmas
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
from wheelsight.wheels.umbmark import Umbmark, umbmark

__all__ = [
    "AnyWheelOdometry",
    "GyroCheck",
    "HolonomicOdometry",
    "Integration",
    "LoopCause",
    "LoopCheck",
    "ReadingTimes",
    "Umbmark",
    "WheelDrive",
    "WheelFit",
    "WheelOdometry",
    "WheelSettings",
    "WheelTrack",
    "WheelTrial",
    "YawRateMeter",
    "check_loop",
    "drive_from_ticks",
    "drive_of",
    "drive_path",
    "fit_wheels",
    "gyro_warnings",
    "integrate_log",
    "mean_yaw_rates",
    "odometry_of",
    "sides_of_four",
    "ticks_from_speeds",
    "try_calibration",
    "umbmark",
    "with_sigmas",
]
