"""Writes a robot's dead-reckoned pose to a pipe, from wheel readings."""

from __future__ import annotations

import json
from collections.abc import Callable
from typing import Protocol

import numpy as np

from wheelsight.core.calibration_parts import Wheels
from wheelsight.core.estimates import Estimate
from wheelsight.core.geometry import FloatArray
from wheelsight.core.messages import WheelTicks
from wheelsight.io.devices import TelemetryPipe
from wheelsight.wheels import Integration, WheelOdometry

_LONGEST_WAIT_S = 0.1
_PLANE = np.array([0, 1, 5])  # vx, vy, ωz of a (6,) perturbation


class LiveTicks(Protocol):
    """Ticks that may be waited for, as `WheelLink` has them."""

    def read(self, timeout_s: float) -> WheelTicks | None:
        """The next ticks, or None if none come in time."""


class Telemetry:
    """Integrates ticks and writes each pose as one line of JSON.

    The numbers of a line: `stamp_s`, when the wheels stood so; `ticks_stamp_s`, as the ticks were stamped;
    `left_ticks` and `right_ticks`; `x_m`, `y_m`, `yaw_rad` in [-π, π], the base in odom, which is where it was at the
    first ticks; `v_m_s` forward and `w_rad_s`; `covariance` of (x, y, yaw), nine numbers row by row; `reason`, why a
    reading was refused, else null.
    """

    def __init__(self, wheels: Wheels, integration: Integration = "arc") -> None:
        unrolled = wheels.never_rolling_over  # the link has undone the counters' roll-over
        odometry = WheelOdometry(unrolled, integration)  # compiles the kernels before readings wait for them
        for index in range(2):
            odometry.process(WheelTicks(0.01 * index, 0, 0))
        self.odometry = WheelOdometry(unrolled, integration)

    def line(self, ticks: WheelTicks) -> str:
        """The line for one reading, without its line end."""
        estimate = self.odometry.process(ticks)
        x_m, y_m, yaw_rad = self.odometry.pose
        v_m_s, w_rad_s = self.odometry.twist
        fields = {
            "stamp_s": estimate.stamp_s,
            "ticks_stamp_s": ticks.stamp_s,
            "left_ticks": ticks.left,
            "right_ticks": ticks.right,
            "x_m": x_m,
            "y_m": y_m,
            "yaw_rad": yaw_rad,
            "v_m_s": v_m_s,
            "w_rad_s": w_rad_s,
            "covariance": covariance_of_pose(estimate).ravel().tolist(),
            "reason": estimate.reason,
        }
        return json.dumps(fields, separators=(",", ":"), allow_nan=False)


def serve(source: LiveTicks, telemetry: Telemetry, pipe: TelemetryPipe, is_over: Callable[[], bool]) -> None:
    """Write the pose after every reading, until `is_over()`, which is asked at least ten times a second."""
    while not is_over():
        ticks = source.read(_LONGEST_WAIT_S)
        if ticks is not None:
            pipe.send(telemetry.line(ticks))


def covariance_of_pose(estimate: Estimate) -> FloatArray:
    """(3, 3) of (x, y, yaw), from that of the left perturbation (v, ω): a turn ω about the map's origin moves
    the base by ω × its position.
    """
    assert estimate.T_odom_body is not None
    assert estimate.covariance is not None
    x_m, y_m = estimate.T_odom_body[:2, 3]
    J = np.array([[1, 0, -y_m], [0, 1, x_m], [0, 0, 1]])
    return np.asarray(J @ estimate.covariance[np.ix_(_PLANE, _PLANE)] @ J.T)
