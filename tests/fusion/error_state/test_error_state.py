"""ErrorStateFilter: what it answers, in which order events may come, and what it refuses."""

from __future__ import annotations

from dataclasses import replace
from operator import methodcaller

import numpy as np
import pytest
from fusion.error_state.fused_drives import (
    CAMERA_COVARIANCE,
    T_BASE_CAMERA,
    Drive,
    blind,
    error_of,
    looked,
    run,
    simulate,
)
from hypothesis import given
from hypothesis import settings as hypothesis_settings
from hypothesis import strategies as st
from narrowing import not_none
from pydantic import ValidationError

from wheelsight.core.calibration_parts import Gyro, Wheels
from wheelsight.core.errors import ArgumentError, ConfigError
from wheelsight.core.estimates import MotionEstimate, Reason, Status
from wheelsight.core.geometry import se3
from wheelsight.core.messages import WheelTicks
from wheelsight.estimation import ErrorStateFilter, ErrorStateSettings
from wheelsight.estimation.pose_belief import FilterParameters
from wheelsight.wheels import WheelOdometry

SETTINGS = FilterParameters.of()
NO_NOISE = np.zeros((6, 6))
KNOWN_CAMERA = replace(FilterParameters.of(), camera_turn_sigma=0.005)


def drive(seed=0, **others):
    return simulate(replace(Drive(seconds=2.0), **others), np.random.default_rng(seed), SETTINGS)


def events_of(steps):
    """What to call of a filter at which stamp, in order."""
    calls = [(steps[0].begin_s, methodcaller("clone", steps[0].begin_s, "frame"))]
    for s in steps:
        calls.append((s.end_s, methodcaller("predict", s.end_s, s.wheels, s.wheel_covariance, s.begin_s)))
        if s.yaw_rate_rad_s is not None:
            calls.append((s.end_s, methodcaller("update_yaw_rate", s.end_s, s.yaw_rate_rad_s)))
        if s.measurement is not None:
            calls.append((s.end_s, methodcaller("update_relative", s.end_s, s.measurement, "frame")))
            calls.append((s.end_s, methodcaller("clone", s.end_s, "frame")))
    return calls


def same(one, other, atol):
    np.testing.assert_allclose(one.T_odom_body, other.T_odom_body, atol=atol)
    np.testing.assert_allclose(one.covariance, other.covariance, atol=atol)
    np.testing.assert_allclose(one.twist, other.twist, atol=atol)
    assert (one.stamp_s, one.status) == (other.stamp_s, other.status)


def test_no_pose_before_any_event():
    answer = ErrorStateFilter().estimate
    assert (answer.status, answer.T_odom_body) == (Status.INITIALIZING, None)


def test_wheels_alone_are_followed_and_the_covariance_grows():
    answers = run(drive(camera_fault=lambda t, motion: blind(motion)))
    assert all(a.status is Status.COASTING for a in answers)
    xy = np.array([np.trace(not_none(a.covariance)[:2, :2]) for a in answers])
    assert (np.diff(xy) > 0).all()


def test_a_camera_is_believed_and_reported():
    steps = drive(errors=(0.02, 0.01, 0.02))
    answers = run(steps)
    assert all(a.status is Status.TRACKING and a.reason is None and not a.slip for a in answers)
    assert np.abs(error_of(answers[-1], steps[-1].T_truth)[[0, 1]]).max() < 0.03


def test_wheels_that_are_wrong_are_learned_of_a_camera_that_is_known_well(rng):
    errors = (0.03, 0.03, 0.04)
    steps = simulate(Drive(seconds=40, errors=errors, slip_m_per_sqrt_m=0.002), rng, SETTINGS)
    answer = run(steps, fusion=ErrorStateFilter(T_BASE_CAMERA, settings=KNOWN_CAMERA))[-1]
    np.testing.assert_allclose(not_none(answer.wheel_errors), errors, atol=0.01)


def test_tracking_coasting_and_tracking_again():
    steps = drive(seconds=4.0, camera_fault=lambda t, motion: blind(motion) if 1 < t <= 2 else motion)
    answers = run(steps)
    reported = {round(a.stamp_s, 2): a.status for a in answers}
    assert reported[1.0] is reported[1.2] is Status.TRACKING
    assert reported[1.4] is reported[2.0] is Status.COASTING
    assert reported[2.2] is Status.TRACKING


def test_silence_is_lost_until_a_remembered_pose_is_seen(rng):
    fusion = ErrorStateFilter(T_BASE_CAMERA)
    run(drive(), fusion=fusion)
    lost = fusion.predict(6.02, np.eye(4), NO_NOISE, 6.0)
    assert (lost.status, lost.T_odom_body, lost.covariance) == (Status.LOST, None, None)
    assert fusion.update_position(6.1, [1.0, 0.5], 0.01 * np.eye(2)).status is Status.LOST
    T_odom_frame = not_none(run(drive())[-1].T_odom_body)
    T_frame_base = se3.from_plane(-1.0, 0.5, 1.0)
    back = fusion.update_relative(6.1, looked(rng, T_frame_base), "frame")
    assert back.status is Status.TRACKING
    np.testing.assert_allclose(not_none(back.T_odom_body), T_odom_frame @ T_frame_base, atol=0.02)


def test_a_keyframe_recovers_what_coasting_lost(rng):
    steps = drive(seconds=6.0, camera_fault=lambda t, motion: blind(motion) if t > 0.5 else motion, errors=(0.03, 0, 0))
    fusion = ErrorStateFilter(T_BASE_CAMERA, settings=KNOWN_CAMERA)
    fusion.predict(0.0, np.eye(4), NO_NOISE, -0.1)  # it stands: how late the camera is does not matter
    fusion.clone(0.0, "keyframe")
    before = run(steps, fusion=fusion)[-1]
    after = fusion.update_relative(steps[-1].end_s, looked(rng, steps[-1].T_truth), "keyframe")
    assert after.status is Status.TRACKING
    off = [np.abs((a.T_odom_body - steps[-1].T_truth)[:2, 3]).max() for a in (before, after)]
    assert off[0] > 0.05
    assert off[1] < 0.025  # how the camera is mounted and how long its metre is are not known any better


def test_a_place_pulls_within_its_gate_and_not_outside():
    fusion = ErrorStateFilter(covariance=np.diag([0.25, 0.25, 0, 0, 0, 0.01]))
    fusion.predict(0.1, np.eye(4), NO_NOISE, 0.0)
    near = fusion.update_position(0.2, [0.5, 0.0], 0.25 * np.eye(2))
    np.testing.assert_allclose(not_none(near.T_odom_body)[:2, 3], [0.25, 0], atol=1e-3)
    far = fusion.update_position(0.3, [20.0, 0.0], 0.25 * np.eye(2))
    assert far.reason is Reason.OUTLIER
    np.testing.assert_allclose(not_none(far.T_odom_body)[:2, 3], [0.25, 0], atol=1e-3)


def test_a_gyroscope_shows_the_turn_that_wheels_get_wrong(rng):
    steps = simulate(Drive(seconds=10, slip_m_per_sqrt_m=0.02), rng, SETTINGS)
    alone = [replace(s, measurement=None) for s in steps]
    rates = [replace(s, yaw_rate_rad_s=Drive().twist(s.begin_s + 0.025)[2]) for s in alone]
    gyro = Gyro(bias_sigma_rad_s=0.001)
    without, with_it = (run(d, fusion=ErrorStateFilter(T_BASE_CAMERA, gyro=gyro))[-1] for d in (alone, rates))
    assert not_none(with_it.covariance)[5, 5] < 0.05 * not_none(without.covariance)[5, 5]
    assert abs(error_of(with_it, steps[-1].T_truth)[5]) < 3 * not_none(with_it.covariance)[5, 5] ** 0.5


def test_what_is_to_be_expected_is_what_will_be_seen():
    steps = drive()
    fusion = ErrorStateFilter(T_BASE_CAMERA)
    run(steps[:-1], fusion=fusion)
    last = steps[-1]
    fusion.predict(last.end_s, last.wheels, last.wheel_covariance, last.begin_s)
    T, C = not_none(fusion.expect(last.end_s, "frame"))
    off = se3.log(last.measurement.T_reference_current @ se3.invert(T))
    assert off @ np.linalg.solve(C + CAMERA_COVARIANCE, off) < 22.5
    assert fusion.expect(last.end_s, "nobody") is None


def test_a_corridor_keeps_the_wheels_motion_along_and_the_cameras_turn(rng):
    """The camera says 0.3 m and a turn of 0.05; along its own z, which is forward, it names itself blind."""
    fusion = ErrorStateFilter(T_BASE_CAMERA, settings=replace(SETTINGS, clock_sigma_s=0.0, camera_lag_sigma_s=0.0))
    fusion.clone(0.0, "frame")
    Q = np.diag([1e-4, 1e-4, 1e-6, 1e-4, 1e-4, 1e-2])
    fusion.predict(0.1, se3.from_plane(0.1, 0.0, 0.0), Q, 0.0)
    seen = looked(rng, se3.from_plane(0.3, 0.0, 0.05), 1e-8 * np.eye(6))
    along = np.array([[0.0, 0, 1, 0, 0, 0]])
    answer = fusion.update_relative(0.1, replace(seen, degenerate=along), "frame")
    assert answer.degenerate
    assert answer.reason is None
    # Unseen is the camera's shift along its axis; the base turns about another point, 0.05 m aside.
    np.testing.assert_allclose(not_none(answer.T_odom_body)[0, 3], 0.1, atol=0.005)
    np.testing.assert_allclose(
        np.arctan2(not_none(answer.T_odom_body)[1, 0], not_none(answer.T_odom_body)[0, 0]), 0.05, atol=1e-3
    )
    assert not_none(answer.covariance)[0, 0] > 0.5e-4
    assert not_none(answer.covariance)[5, 5] < 1e-6


def test_a_camera_that_sees_no_direction_is_no_measurement(rng):
    fusion = ErrorStateFilter(T_BASE_CAMERA)
    fusion.clone(0.0, "frame")
    answer = fusion.update_relative(0.1, replace(looked(rng, np.eye(4)), degenerate=np.eye(6)), "frame")
    assert answer.reason is Reason.DEGENERATE


@pytest.mark.parametrize("seed", range(4))
def test_events_in_any_order_within_the_window_end_alike(seed):
    rng = np.random.default_rng(seed)
    calls = events_of([replace(s, yaw_rate_rad_s=Drive().twist(s.begin_s)[2]) for s in drive(seed)])
    late = sorted(range(len(calls)), key=lambda i: calls[i][0] + rng.uniform(0, 0.3))
    # Events at one stamp keep their order where their kind does not give one; here each kind comes once a stamp.
    in_order, shuffled = (ErrorStateFilter(T_BASE_CAMERA) for _ in range(2))
    for _, call in calls:
        call(in_order)
    for i in late:
        assert calls[i][1](shuffled).reason is not Reason.TOO_LATE
    same(in_order.estimate, shuffled.estimate, 1e-9)


def test_a_frame_between_readings_that_come_after_it(rng):
    """A frame is placed by the speed at first; once the wheels cover that time, as if they had done so before."""
    steps = drive(steps_a_frame=4)
    one, other = ErrorStateFilter(T_BASE_CAMERA), ErrorStateFilter(T_BASE_CAMERA)
    for fusion, wheels_first in ((one, True), (other, False)):
        fusion.clone(0.0, "frame")
        for s in steps:
            of_wheels = [methodcaller("predict", s.end_s, s.wheels, s.wheel_covariance, s.begin_s)]
            of_camera = []
            if s.measurement is not None:
                middle = (s.begin_s + s.end_s) / 2
                of_camera = [
                    methodcaller("update_relative", middle, s.measurement, "frame"),
                    methodcaller("clone", middle, "frame"),
                ]
            for call in of_wheels + of_camera if wheels_first else of_camera + of_wheels:
                call(fusion)
    same(one.estimate, other.estimate, 1e-9)


def test_the_same_events_give_the_same_bits():
    one, other = (run(drive())[-1] for _ in range(2))
    assert not_none(one.T_odom_body).tobytes() == not_none(other.T_odom_body).tobytes()
    assert not_none(one.covariance).tobytes() == not_none(other.covariance).tobytes()


@hypothesis_settings(max_examples=5)
@given(st.floats(-50, 50), st.floats(-50, 50), st.floats(-3, 3))
def test_the_world_may_lie_anywhere(x, y, yaw):
    steps, T_there_here = drive(seconds=1.0), se3.from_plane(x, y, yaw)
    here = run(steps)[-1]
    there = run(steps, fusion=ErrorStateFilter(T_BASE_CAMERA, T_there_here))[-1]
    np.testing.assert_allclose(not_none(there.T_odom_body), T_there_here @ not_none(here.T_odom_body), atol=1e-8)
    Ad = se3.adjoint(T_there_here)
    np.testing.assert_allclose(not_none(there.covariance), Ad @ not_none(here.covariance) @ Ad.T, atol=1e-8, rtol=1e-6)


def broken(T):
    return MotionEstimate(T, CAMERA_COVARIANCE)


@pytest.mark.parametrize(
    "event",
    [
        lambda f: f.predict(2.1, np.full((4, 4), np.nan), NO_NOISE, 2.0),
        lambda f: f.predict(2.1, 1.1 * np.eye(4), NO_NOISE, 2.0),
        lambda f: f.predict(2.1, np.eye(4), -np.eye(6), 2.0),
        lambda f: f.predict(2.1, np.eye(4), np.full((6, 6), np.nan), 2.0),
        lambda f: f.predict(2.1, np.eye(3), NO_NOISE, 2.0),
        lambda f: f.predict(2.0, np.eye(4), NO_NOISE, 2.1),
        lambda f: f.predict(np.nan, np.eye(4), NO_NOISE, 2.0),
        lambda f: f.predict(2.1, np.eye(4), NO_NOISE, -np.inf),
        lambda f: f.clone(np.inf, "frame"),
        lambda f: f.update_position(2.1, [np.nan, 0], np.eye(2)),
        lambda f: f.update_position(2.1, [0, 0], np.zeros((2, 2))),
        lambda f: f.update_position(2.1, [0, 0, 0], np.eye(2)),
        lambda f: f.update_yaw_rate(2.1, np.nan),
        lambda f: f.update_relative(2.0, broken(np.full((4, 4), np.inf)), "frame"),
        lambda f: f.update_relative(2.0, broken(np.diag([1.0, 1, -1, 1])), "frame"),
        lambda f: f.update_relative(2.0, MotionEstimate(np.eye(4), np.zeros((6, 6))), "frame"),
        lambda f: f.update_relative(
            2.0, MotionEstimate(np.eye(4), np.eye(6), degenerate=np.full((1, 6), np.nan)), "frame"
        ),
    ],
)
def test_numbers_that_are_no_measurement_move_nothing(event):
    fusion = ErrorStateFilter(T_BASE_CAMERA)
    before = run(drive(), fusion=fusion)[-1]
    answer = event(fusion)
    assert answer.reason is Reason.INVALID
    np.testing.assert_array_equal(answer.T_odom_body, before.T_odom_body)
    np.testing.assert_array_equal(fusion.estimate.covariance, before.covariance)


@pytest.mark.parametrize("odd", [None, "1.0", [1.0]])
@pytest.mark.parametrize(
    "event",
    [
        lambda f, odd: f.predict(odd, np.eye(4), NO_NOISE, 2.0),
        lambda f, odd: f.predict(2.1, np.eye(4), NO_NOISE, odd),
        lambda f, odd: f.clone(odd, "frame"),
        lambda f, odd: f.update_yaw_rate(2.1, odd),
        lambda f, odd: f.update_position(odd, [0, 0], np.eye(2)),
    ],
)
def test_a_stamp_or_rate_that_is_no_number_is_refused_by_its_name(event, odd):
    fusion = ErrorStateFilter(T_BASE_CAMERA)
    with pytest.raises(ArgumentError, match=r"(stamp_s|begin_s|yaw_rate_rad_s) is .*not a number"):
        event(fusion, odd)


@pytest.mark.parametrize("odd", [None, "a", {}])
def test_a_motion_that_is_no_array_is_no_measurement(odd):
    fusion = ErrorStateFilter(T_BASE_CAMERA)
    assert fusion.predict(2.1, odd, NO_NOISE, 2.0).reason is Reason.INVALID
    assert fusion.predict(2.1, np.eye(4), odd, 2.0).reason is Reason.INVALID
    assert fusion.update_position(2.1, odd, np.eye(2)).reason is Reason.INVALID


def test_what_comes_too_late_is_refused():
    fusion = ErrorStateFilter(T_BASE_CAMERA)
    before = run(drive(), fusion=fusion)[-1]
    assert fusion.predict(1.45, np.eye(4), NO_NOISE, 1.4).reason is Reason.TOO_LATE
    assert fusion.clone(1.49, "late").reason is Reason.TOO_LATE
    same(fusion.estimate, before, 0.0)


@pytest.mark.parametrize("ahead_s", [3.0, 3600.0, 1.7e9, 1e300])
def test_at_any_stamp_far_ahead_the_base_is_lost_and_what_is_known_stays_finite(ahead_s: float):
    fusion = ErrorStateFilter(T_BASE_CAMERA)
    run(drive(), fusion=fusion)
    assert fusion.clone(2.0 + ahead_s, "frame").status is Status.LOST
    T, C = not_none(fusion.expect(2.0 + ahead_s, "frame"))
    assert np.isfinite(T).all()
    assert np.isfinite(C).all()


def test_after_a_pause_of_all_sensors_the_place_is_lost_not_the_time():
    fusion = ErrorStateFilter(T_BASE_CAMERA)
    run(drive(), fusion=fusion)
    answers = [fusion.predict(60 + 0.1 * i, np.eye(4), NO_NOISE, 59.9 + 0.1 * i) for i in range(6)]
    assert answers[0].status is Status.LOST
    assert (answers[-1].status, answers[-1].reason) == (Status.LOST, None)


def test_an_unknown_reference_is_refused(rng):
    fusion = ErrorStateFilter(T_BASE_CAMERA)
    run(drive(), fusion=fusion)
    assert fusion.update_relative(2.0, looked(rng, np.eye(4)), "nobody").reason is Reason.UNKNOWN_REFERENCE
    fusion.drop(2.005, "frame")
    assert fusion.update_relative(2.01, looked(rng, np.eye(4)), "frame").reason is Reason.UNKNOWN_REFERENCE


@pytest.mark.parametrize(
    "arguments",
    [
        {"T_base_camera": 2 * np.eye(4)},
        {"T_odom_base": np.full((4, 4), np.nan)},
        {"covariance": -np.eye(6)},
        {"covariance": np.eye(3)},
    ],
)
def test_a_start_that_is_none_is_an_error(arguments):
    with pytest.raises(ConfigError):
        ErrorStateFilter(**arguments)


@pytest.mark.parametrize(
    "wrong",
    [{"scale_sigma": -1}, {"confidence": 1.0}, {"window_s": np.inf}, {"mount_sigma_m": np.nan}],
)
def test_settings_that_are_none_are_errors(wrong):
    with pytest.raises(ValidationError, match=next(iter(wrong))):
        ErrorStateSettings(**wrong)


@pytest.mark.parametrize("seed", [1, 2])
def test_a_look_that_is_remembered_at_once_is_as_one_that_is_remembered_afterwards(seed: int) -> None:
    """Nor does it matter that wheels come later than the frame, which is taken again then."""
    answers = []
    for at_once in (True, False):
        fusion = ErrorStateFilter(T_BASE_CAMERA, settings=SETTINGS)
        fusion.clone(0.0, "frame")
        for s in drive(seed):
            if s.measurement is not None:
                fusion.update_relative(s.end_s, s.measurement, "frame", remember="frame" if at_once else None)
            if s.measurement is not None and not at_once:
                fusion.clone(s.end_s, "frame")
            fusion.predict(s.end_s, s.wheels, s.wheel_covariance, s.begin_s)
        answers.append(fusion.estimate)
    assert answers[0].status is Status.TRACKING
    same(answers[0], answers[1], atol=0)


def test_what_too_short_a_step_shows_counts_with_the_next_ones() -> None:
    """Two readings of three arrive together: no speed is formed over their stamps, and no way is lost."""
    wheels, fusion = WheelOdometry(Wheels(0.17, 0.17, 0.52, 3200)), ErrorStateFilter()
    for i in range(30):
        stamp_s = 0.15 * (i // 3) + (0.0, 0.002, 0.1)[i % 3]
        answer = fusion.predict_to(wheels.process(WheelTicks(stamp_s, 60 * i, 66 * i)))
    assert answer.T_odom_body is not None
    np.testing.assert_allclose(answer.T_odom_body, wheels.T_odom_base, atol=1e-9)
    assert answer.twist is not None
    assert abs(answer.twist[0]) < 2 * 0.7


def test_the_first_estimate_of_wheels_is_the_start_whatever_step_it_shows() -> None:
    wheels, fusion = WheelOdometry(Wheels(0.17, 0.17, 0.52, 3200)), ErrorStateFilter()
    for i in range(6):
        estimate = wheels.process(WheelTicks(0.1 * i, 60 * i, 60 * i))
        if i >= 3:
            answer = fusion.predict_to(estimate)
    np.testing.assert_allclose(not_none(answer.T_odom_body)[0, 3], 2 * 60 * 2 * np.pi * 0.17 / 3200, atol=1e-9)
