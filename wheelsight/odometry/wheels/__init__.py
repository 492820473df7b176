"""Wheel odometry: encoder counts to a pose with its covariance (Trinh et al., section II; Ligocki, section 3).

And how large the wheels are: by squares, or against a reference trajectory.
"""

from wheelsight.odometry.wheels.drive import Drive, drive_from_ticks, drive_of, drive_path
from wheelsight.odometry.wheels.encoder import Encoder
from wheelsight.odometry.wheels.fit import WheelFit, fit_wheels
from wheelsight.odometry.wheels.gyro import YawRateMeter, mean_yaw_rates
from wheelsight.odometry.wheels.gyro_check import GyroCheck, gyro_warnings
from wheelsight.odometry.wheels.holonomic import AnyWheelOdometry, HolonomicOdometry, odometry_of
from wheelsight.odometry.wheels.loop_check import LoopCause, LoopCheck, LoopCheckSettings, check_loop, with_sigmas
from wheelsight.odometry.wheels.odometry import (
    Integration,
    WheelOdometry,
    WheelTrack,
    integrate_log,
    sides_of_four,
    ticks_from_speeds,
)
from wheelsight.odometry.wheels.reading_times import ReadingTimes
from wheelsight.odometry.wheels.settings import GyroCheckSettings, ReadingTimesSettings, WheelSettings
from wheelsight.odometry.wheels.trial import WheelTrial, try_calibration
from wheelsight.odometry.wheels.umbmark import Umbmark, umbmark

__all__ = [
    "AnyWheelOdometry",
    "Drive",
    "Encoder",
    "GyroCheck",
    "GyroCheckSettings",
    "HolonomicOdometry",
    "Integration",
    "LoopCause",
    "LoopCheck",
    "LoopCheckSettings",
    "ReadingTimes",
    "ReadingTimesSettings",
    "Umbmark",
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
