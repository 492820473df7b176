"""Poses on the pipe: the odometry's own, with their covariance in x, y and yaw."""

from __future__ import annotations

import json
import math
from typing import Any

import numpy as np
import pytest
from narrowing import not_none

from wheelsight.app.telemetry import Telemetry, covariance_of_pose
from wheelsight.core.calibration_parts import Wheels
from wheelsight.core.estimates import Reason
from wheelsight.core.geometry import se3
from wheelsight.core.messages import WheelTicks
from wheelsight.wheels import WheelOdometry

WHEELS = Wheels(0.17, 0.17, 0.6, 3200.0, counter_bits=32, delay_s=0.01)
M_PER_TICK = 2 * math.pi * 0.17 / 3200


def drive(count: int, left: int, right: int) -> list[WheelTicks]:
    return [WheelTicks(100 + 0.02 * n, left * n, right * n) for n in range(count)]


def reported(ticks: list[WheelTicks]) -> list[dict[str, Any]]:
    telemetry = Telemetry(WHEELS)
    return [json.loads(telemetry.line(reading)) for reading in ticks]


def test_a_line_holds_what_the_docs_say() -> None:
    line = reported(drive(51, 60, 60))[-1]
    assert list(line) == [
        "stamp_s",
        "ticks_stamp_s",
        "left_ticks",
        "right_ticks",
        "x_m",
        "y_m",
        "yaw_rad",
        "v_m_s",
        "w_rad_s",
        "covariance",
        "reason",
    ]
    assert (line["left_ticks"], line["right_ticks"], line["reason"]) == (3000, 3000, None)
    assert line["ticks_stamp_s"] == pytest.approx(101.0)
    assert line["stamp_s"] == pytest.approx(100.99)
    assert line["x_m"] == pytest.approx(3000 * M_PER_TICK)
    assert line["v_m_s"] == pytest.approx(60 * M_PER_TICK / 0.02)
    assert (line["y_m"], line["yaw_rad"], line["w_rad_s"]) == pytest.approx((0, 0, 0))
    assert len(line["covariance"]) == 9


def test_a_circle_closes() -> None:
    ticks_around = 2 * math.pi * 0.6 / (2 * 30 * M_PER_TICK)
    lines = reported(drive(round(ticks_around) + 1, -30, 30))
    assert lines[-1]["w_rad_s"] == pytest.approx(2 * 30 * M_PER_TICK / 0.6 / 0.02)
    assert abs(lines[-1]["yaw_rad"]) < 0.02
    assert np.hypot(lines[-1]["x_m"], lines[-1]["y_m"]) < 1e-9


def test_the_covariance_is_that_of_x_y_and_yaw(rng: np.random.Generator) -> None:
    odometry = WheelOdometry(WHEELS)
    for reading in drive(200, 50, 70):
        estimate = odometry.process(reading)
    T = not_none(estimate.T_odom_body)
    samples = rng.multivariate_normal(np.zeros(6), 1e-4 * not_none(estimate.covariance), 20_000, method="svd")
    moved = np.array([se3.exp(sample) @ T for sample in samples])
    yaws = np.arctan2(moved[:, 1, 0], moved[:, 0, 0]) - np.arctan2(T[1, 0], T[0, 0])
    sampled = np.cov(np.column_stack([moved[:, 0, 3], moved[:, 1, 3], yaws]).T) / 1e-4
    expected = covariance_of_pose(estimate)
    sigmas = np.sqrt(np.diag(expected))
    np.testing.assert_allclose(sampled / np.outer(sigmas, sigmas), expected / np.outer(sigmas, sigmas), atol=0.04)


def test_counters_are_not_unrolled_twice() -> None:
    ticks = [WheelTicks(0.0, 0, 0), WheelTicks(0.02, 60, 60), WheelTicks(0.04, (1 << 32) + 60, 60)]
    assert reported(ticks)[-1]["reason"] == Reason.IMPLAUSIBLE_MOTION


def test_a_gap_is_reported_with_the_reason_and_the_way_goes_on() -> None:
    lines = reported([*drive(10, 60, 60), WheelTicks(105.0, 900, 900), WheelTicks(105.02, 960, 960)])
    assert lines[-2]["reason"] == Reason.GAP
    assert lines[-2]["x_m"] == pytest.approx(540 * M_PER_TICK)
    assert lines[-2]["covariance"][0] > lines[-3]["covariance"][0]
    assert lines[-1]["reason"] is None
    assert lines[-1]["x_m"] == pytest.approx(600 * M_PER_TICK)
