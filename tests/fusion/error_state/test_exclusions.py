"""ErrorStateFilter.exclude: a sensor that is left out in the past leaves no trace."""

from __future__ import annotations

import numpy as np
import pytest
from fusion.error_state.fused_drives import T_BASE_CAMERA, Drive, Step, simulate

from wheelsight.core.estimates import MotionEstimate, Reason
from wheelsight.core.geometry import FloatArray
from wheelsight.estimation import ErrorStateFilter
from wheelsight.estimation.agreement import Exclusion, RobotSensor
from wheelsight.estimation.pose_belief import FilterParameters

SETTINGS = FilterParameters.of()


def driven(steps: list[Step], exclusions: tuple[Exclusion, ...] = ()) -> ErrorStateFilter:
    """The filter after a drive; sensors that are left out from the beginning do not measure."""
    fusion = ErrorStateFilter(T_BASE_CAMERA)
    fusion.clone(0.0, "last")

    def is_out(*sensors: RobotSensor, since_s: float) -> bool:
        return any(one.sensor in sensors and one.begin_s <= since_s < one.end_s for one in exclusions)

    for step in steps:
        if step.yaw_rate_rad_s is not None and not is_out(RobotSensor.GYRO, since_s=step.end_s):
            fusion.update_yaw_rate(step.end_s, step.yaw_rate_rad_s)
        if is_out(RobotSensor.LEFT, RobotSensor.RIGHT, RobotSensor.WHEELS, since_s=step.begin_s):
            fusion.drop(step.end_s, "")
        else:
            fusion.predict(step.end_s, step.wheels, step.wheel_covariance, step.begin_s)
        if step.measurement is not None:
            motion = step.measurement
            if is_out(RobotSensor.CAMERA, since_s=step.end_s):
                motion = MotionEstimate.failed(Reason.CONTRADICTION)
            fusion.update_relative(step.end_s, motion, "last", remember="last")
    return fusion


def pose(fusion: ErrorStateFilter) -> tuple[FloatArray, FloatArray]:
    T, C = fusion.estimate.T_odom_body, fusion.estimate.covariance
    assert T is not None
    assert C is not None
    return T, C


@pytest.mark.parametrize("sensor", [RobotSensor.LEFT, RobotSensor.WHEELS, RobotSensor.CAMERA])
@pytest.mark.parametrize("end_s", [6.0, np.inf])
def test_excluding_later_equals_excluding_at_once(sensor: RobotSensor, end_s: float) -> None:
    steps = simulate(Drive(seconds=8.0), np.random.default_rng(4), SETTINGS)
    exclusion = Exclusion(sensor, 4.0, end_s)
    later, at_once = driven(steps), driven(steps, (exclusion,))
    T_sound = pose(later)[0]
    assert later.exclude([exclusion], 4.0)
    for one, other in zip(pose(later), pose(at_once), strict=True):
        np.testing.assert_allclose(one, other, rtol=0, atol=1e-12)
    assert np.abs(T_sound - pose(later)[0]).max() > 1e-6


def test_a_suspicion_that_is_dropped_leaves_no_trace() -> None:
    steps = simulate(Drive(seconds=8.0), np.random.default_rng(5), SETTINGS)
    fusion = driven(steps[:120])
    assert fusion.exclude([Exclusion(RobotSensor.WHEELS, 5.0)], 5.0)
    for step in steps[120:]:
        fusion.predict(step.end_s, step.wheels, step.wheel_covariance, step.begin_s)
        if step.measurement is not None:
            fusion.update_relative(step.end_s, step.measurement, "last", remember="last")
    assert fusion.exclude([], 5.0)
    for one, other in zip(pose(fusion), pose(driven(steps)), strict=True):
        np.testing.assert_allclose(one, other, rtol=0, atol=1e-12)


def test_a_dead_encoder_is_corrected_in_the_past() -> None:
    def stops(t: float, truth: FloatArray, wheels: FloatArray) -> tuple[FloatArray, FloatArray]:
        return truth, wheels if t < 4.0 else np.array([0.5 * wheels[0], 0, 0, 0, 0, wheels[5] + wheels[0] / 0.52])

    steps = simulate(Drive(seconds=9.0, wheel_fault=stops), np.random.default_rng(6), SETTINGS)
    fusion = driven(steps)
    assert fusion.exclude([Exclusion(RobotSensor.LEFT, 4.0)], 4.0)
    assert np.linalg.norm(pose(fusion)[0][:2, 3] - steps[-1].T_truth[:2, 3]) < 0.1
