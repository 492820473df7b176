"""Dead reckoning: closed forms, roll-over, readings that are refused, and the stream against the whole log."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from narrowing import not_none
from numpy.typing import ArrayLike

from wheelsight.core.calibration_parts import Gyro, Wheels
from wheelsight.core.estimates import Reason, Status
from wheelsight.core.geometry import se3
from wheelsight.core.messages import WheelSpeeds, WheelTicks
from wheelsight.wheels import WheelOdometry, integrate_log, sides_of_four, ticks_from_speeds
from wheelsight.wheels.odometry import Integration

METRE_TICKS = Wheels(1 / (2 * math.pi), 1 / (2 * math.pi), 0.5, 1.0)  # a tick is a metre
WHEELCHAIR = Wheels(0.17, 0.17, 0.52, 3200.0)
ALL: tuple[Integration, ...] = ("arc", "midpoint", "euler")


def final_pose(wheels: Wheels, left: ArrayLike, right: ArrayLike, integration: Integration) -> np.ndarray:
    return integrate_log(wheels, 0.1 * np.arange(np.size(left)), left, right, integration=integration).poses[-1]


@pytest.mark.parametrize("integration", ALL)
def test_straight_on_all_agree(integration: Integration) -> None:
    np.testing.assert_allclose(final_pose(METRE_TICKS, [0, 0.2, 0.4], [0, 0.2, 0.4], integration), [0.4, 0, 0])


def test_one_step_is_what_each_papers_equation_says() -> None:
    left, right, track = 0.2, 0.3, 0.5
    way, turn = 0.25, (right - left) / track
    ways = np.array([0, left]), np.array([0, right])
    np.testing.assert_allclose(final_pose(METRE_TICKS, *ways, "euler"), [way, 0, turn])
    np.testing.assert_allclose(
        final_pose(METRE_TICKS, *ways, "midpoint"), [way * np.cos(turn / 2), way * np.sin(turn / 2), turn]
    )
    radius = way / turn
    np.testing.assert_allclose(
        final_pose(METRE_TICKS, *ways, "arc"), [radius * np.sin(turn), radius * (1 - np.cos(turn)), turn]
    )


@given(st.floats(-0.3, 0.3), st.floats(-0.3, 0.3))
def test_an_arc_is_the_exponential_of_its_twist(left: float, right: float) -> None:
    way, turn = (left + right) / 2, (right - left) / 0.5
    T = integrate_log(METRE_TICKS, [0, 0.1], [0, left], [0, right]).trajectory().T_frame_body[-1]
    np.testing.assert_allclose(T, se3.exp([way, 0, 0, 0, 0, turn]), atol=1e-14)


def test_an_arc_needs_no_small_steps() -> None:
    coarse = final_pose(METRE_TICKS, [0, 0.5], [0, 0.6], "arc")
    fine = final_pose(METRE_TICKS, list(np.linspace(0, 0.5, 1001)), list(np.linspace(0, 0.6, 1001)), "arc")
    np.testing.assert_allclose(coarse, fine, atol=1e-12)


@pytest.mark.parametrize(("integration", "order"), [("euler", 1), ("midpoint", 2)])
def test_the_others_come_near_it_as_their_order_says(integration: Integration, order: int) -> None:
    def error(steps: int) -> float:
        ways = list(np.linspace(0, 0.5, steps + 1)), list(np.linspace(0, 0.9, steps + 1))
        off = final_pose(METRE_TICKS, *ways, integration) - final_pose(METRE_TICKS, *ways, "arc")
        return float(np.linalg.norm(off[:2]))

    assert error(50) / error(100) == pytest.approx(2**order, rel=0.05)


def test_yaw_stays_within_a_half_turn() -> None:
    ways = np.linspace(0, 10, 400)
    yaw = integrate_log(METRE_TICKS, 0.1 * np.arange(400), -ways, ways).poses[:, 2]
    assert np.abs(yaw).max() <= math.pi
    expected = 2 * ways / 0.5
    np.testing.assert_allclose(yaw, np.arctan2(np.sin(expected), np.cos(expected)), atol=1e-9)


@pytest.mark.parametrize("integration", ALL)
def test_a_stream_gives_what_the_whole_log_gives(integration: Integration, rng: np.random.Generator) -> None:
    steps = rng.integers(-40, 120, (400, 2))
    left, right = np.cumsum(steps, axis=0).T
    stamps = np.cumsum(rng.uniform(0.01, 0.03, 400))
    stamps[[100, 200]] += (-0.5, 3.0)  # a stamp out of order and a gap
    left[250:] += 100_000
    rates = rng.normal(0, 1, 400)
    rates[::7] = np.nan
    track = integrate_log(WHEELCHAIR, stamps, left, right, integration=integration, yaw_rates_rad_s=rates)
    odometry = WheelOdometry(WHEELCHAIR, integration)
    streamed = [
        odometry.process(WheelTicks(*reading), None if np.isnan(rate) else rate)
        for *reading, rate in zip(stamps.tolist(), left.tolist(), right.tolist(), rates.tolist(), strict=True)
    ]
    assert {e.reason for e in streamed} == {
        None,
        Reason.CLOCK_BACKWARDS,
        Reason.GAP,
        Reason.IMPLAUSIBLE_MOTION,
    }
    assert [e.reason for e in streamed] == [track.reason(i) for i in range(len(track))]
    kept = [e for e in streamed if e.reason is None]
    trajectory = track.trajectory()
    assert (trajectory.frame, trajectory.body) == ("odom", "base")
    np.testing.assert_array_equal(trajectory.stamps_s, [e.stamp_s for e in kept])
    np.testing.assert_allclose(trajectory.T_frame_body, [not_none(e.T_odom_body) for e in kept], atol=1e-9)
    np.testing.assert_allclose(
        not_none(trajectory.covariances), [not_none(e.covariance) for e in kept], rtol=1e-9, atol=1e-12
    )
    np.testing.assert_allclose(odometry.pose, track.poses[-1], atol=1e-9)


@pytest.mark.parametrize("modulus", [250, 9000, 3600, 2**12])
def test_counters_of_any_modulus_roll_over(modulus: int, rng: np.random.Generator) -> None:
    wheels = replace(WHEELCHAIR, max_speed_m_s=2.0)
    true = np.cumsum(rng.integers(-100, 101, (3000, 2)), axis=0) + (modulus - 20, 30)
    stamps = 0.02 * np.arange(3000)
    rolled = true % modulus
    assert (np.abs(np.diff(rolled, axis=0)) > modulus / 2).any()
    modular = replace(wheels, counter_modulus=modulus)
    track = integrate_log(modular, stamps, *rolled.T)
    assert not track.is_refused.any()
    np.testing.assert_allclose(track.poses, integrate_log(wheels, stamps, *true.T).poses, atol=1e-9)
    odometry = WheelOdometry(modular)
    for stamp, (left, right) in zip(stamps.tolist(), rolled.tolist(), strict=True):
        odometry.process(WheelTicks(stamp, left, right))
    np.testing.assert_allclose(odometry.pose, track.poses[-1], atol=1e-9)


@pytest.mark.parametrize(
    ("bits", "before", "after"), [(64, 3, 2**64 - 4), (64, 2**63 - 3, -(2**63) + 4), (60, 2**60 - 1, 6)]
)
def test_the_widest_counters_lose_no_count_where_they_roll_over(bits: int, before: int, after: int) -> None:
    odometry = WheelOdometry(replace(WHEELCHAIR, counter_bits=bits))
    odometry.process(WheelTicks(0.0, before, before))
    odometry.process(WheelTicks(0.02, after, after))
    ticks = -7 if after > before else 7
    assert odometry.pose[0] == pytest.approx(ticks * WHEELCHAIR.left_m_per_tick)


SMALL = Wheels(0.033, 0.033, 0.16, 4096.0)  # whose absolute encoders count 0 … 4095


@pytest.mark.parametrize("period_s", [0.01, 0.02, 0.05, 0.1])
def test_a_leap_of_a_whole_turn_is_no_motion(period_s: float) -> None:
    stamps = period_s * np.arange(round(10 / period_s) + 1)
    true = np.rint(0.2 * stamps / SMALL.left_m_per_tick).astype(int) + 1000
    right = integrate_log(replace(SMALL, counter_bits=12, max_speed_m_s=1.0), stamps, true % 4096, true % 4096)
    assert not right.is_refused.any()
    assert right.poses[-1, 0] == pytest.approx(2.0, abs=1e-4)
    unsaid = integrate_log(SMALL, stamps, true % 4096, true % 4096)
    leaps = np.flatnonzero(np.diff(true % 4096) < 0) + 1
    np.testing.assert_array_equal(np.flatnonzero(unsaid.is_refused), leaps)
    assert {unsaid.reason(int(i)) for i in leaps} == {Reason.IMPLAUSIBLE_MOTION}
    assert unsaid.poses[-1, 0] == pytest.approx(2.0 - 0.2 * period_s * len(leaps), abs=1e-3)


def test_a_robot_may_turn_back_at_once() -> None:
    speeds_m_s = np.concatenate([np.full(50, 0.6), np.full(50, -0.6)])
    counts = np.rint(np.cumsum(0.02 * speeds_m_s) / SMALL.left_m_per_tick)
    assert not integrate_log(SMALL, 0.02 * np.arange(100), counts, counts).is_refused.any()


@pytest.mark.parametrize("speed_m_s", [0.2, 1.0, 3.0])
def test_readings_that_come_late_and_at_once_are_no_leaps(speed_m_s: float, rng: np.random.Generator) -> None:
    """In pairs 0.1 ms apart, or one in twenty 60 ms late and the next ones at once: no count is lost."""
    true_s = 0.02 * np.arange(500)
    counts = np.rint(speed_m_s * true_s / SMALL.left_m_per_tick)
    pairs = np.where(np.arange(500) % 2 == 0, true_s + 0.0199, true_s)
    late = np.maximum.accumulate(true_s + 0.06 * (rng.random(500) < 0.05)) + 1e-6 * np.arange(500)
    for stamps in (pairs, late):
        track = integrate_log(SMALL, stamps, counts, counts)
        assert not track.is_refused.any()
        assert track.poses[-1, 0] == pytest.approx(counts[-1] * SMALL.left_m_per_tick)


@pytest.mark.parametrize("bits", [8, 16, 32])
def test_counters_that_roll_over(bits: int, rng: np.random.Generator) -> None:
    wheels = replace(WHEELCHAIR, max_speed_m_s=2.0)
    true = np.cumsum(rng.integers(-100, 101, (3000, 2)), axis=0) + (2 ** (bits - 1) - 300, 300 - 2 ** (bits - 1))
    stamps = 0.02 * np.arange(3000)
    rolled = (true + 2 ** (bits - 1)) % 2**bits - 2 ** (bits - 1)
    assert (np.abs(np.diff(rolled, axis=0)) > 2 ** (bits - 1)).any()
    expected = integrate_log(wheels, stamps, *true.T)
    assert not expected.is_refused.any()
    track = integrate_log(replace(wheels, counter_bits=bits), stamps, *rolled.T)
    np.testing.assert_allclose(track.poses, expected.poses, atol=1e-9)
    assert not track.is_refused.any()


def test_a_counter_of_32_bits_at_its_end() -> None:
    odometry = WheelOdometry(replace(WHEELCHAIR, counter_bits=32))
    odometry.process(WheelTicks(0.0, 2**31 - 10, -(2**31) + 5))
    odometry.process(WheelTicks(0.02, -(2**31) + 20, 2**31 - 25))
    assert odometry.pose[2] == pytest.approx(-60 * WHEELCHAIR.left_m_per_tick / 0.52)


def test_a_narrow_counter_that_may_have_gone_round_unseen_is_not_believed() -> None:
    eight = replace(WHEELCHAIR, counter_bits=8, max_speed_m_s=2.0)
    stamps = [0.0, 0.02, 0.06, 0.08]
    track = integrate_log(eight, stamps, [0, 10, 20, 30], [0, 10, 20, 30])
    assert [track.reason(i) for i in range(4)] == [None, None, Reason.COUNTER_AMBIGUOUS, None]
    assert track.poses[-1, 0] == pytest.approx(20 * WHEELCHAIR.left_m_per_tick)


def test_ticks_far_beyond_doubles_keep_every_count_in_a_stream() -> None:
    odometry = WheelOdometry(WHEELCHAIR)
    odometry.process(WheelTicks(0.0, 2**60, 2**60))
    odometry.process(WheelTicks(0.02, 2**60 + 7, 2**60 + 7))
    assert odometry.pose[0] == pytest.approx(7 * WHEELCHAIR.left_m_per_tick)


@pytest.mark.parametrize(
    ("reading", "reason"),
    [
        (WheelTicks(0.0, 20, 20), Reason.CLOCK_BACKWARDS),
        (WheelTicks(0.02, 20, 20), Reason.CLOCK_BACKWARDS),
        (WheelTicks(math.nan, 20, 20), Reason.CLOCK_BACKWARDS),
        (WheelTicks(0.6, 20, 20), Reason.GAP),
        (WheelTicks(math.inf, 20, 20), Reason.CLOCK_BACKWARDS),
        (WheelTicks(0.04, 20, 9_000), Reason.IMPLAUSIBLE_MOTION),
        (WheelTicks(0.04, -9_000, 20), Reason.IMPLAUSIBLE_MOTION),
    ],
)
def test_a_refused_reading_invents_nothing(reading: WheelTicks, reason: Reason) -> None:
    odometry = WheelOdometry(WHEELCHAIR)
    odometry.process(WheelTicks(0.0, 0, 0))
    before = odometry.process(WheelTicks(0.02, 10, 12))
    refused = odometry.process(reading)
    assert (refused.status, refused.reason, refused.body) == (Status.FAILING, reason, "base")
    np.testing.assert_array_equal(refused.T_odom_body, before.T_odom_body)
    growth = np.linalg.eigvalsh(
        (not_none(refused.covariance) - not_none(before.covariance))[np.ix_([0, 1, 5], [0, 1, 5])]
    )
    if reason is Reason.CLOCK_BACKWARDS:
        np.testing.assert_array_equal(refused.covariance, before.covariance)
    else:
        assert growth.min() > 0
        assert odometry.twist == (0.0, 0.0)


def test_after_a_refusal_the_way_goes_on_from_the_new_counts() -> None:
    odometry = WheelOdometry(WHEELCHAIR)
    for reading in [(0.0, 0, 0), (0.02, 10, 10), (5.0, 9_000, 9_000), (5.02, 9_010, 9_010)]:
        estimate = odometry.process(WheelTicks(*reading))
    assert (estimate.status, estimate.reason) == (Status.TRACKING, None)
    assert odometry.pose[0] == pytest.approx(20 * WHEELCHAIR.left_m_per_tick)


def test_a_controller_that_starts_again_at_zero_costs_one_reading() -> None:
    track = integrate_log(WHEELCHAIR, 0.02 * np.arange(5), [50_000, 50_010, 0, 10, 20], [50_000, 50_010, 0, 10, 20])
    assert [track.reason(i) for i in range(5)] == [None, None, Reason.IMPLAUSIBLE_MOTION, None, None]
    assert track.poses[-1, 0] == pytest.approx(30 * WHEELCHAIR.left_m_per_tick)


def test_a_reading_stamped_late_once_is_no_jump() -> None:
    ticks = [0, 100, 200, 300]
    assert not integrate_log(WHEELCHAIR, [0.0, 0.038, 0.04, 0.06], ticks, ticks).is_refused.any()


def test_what_a_gap_may_have_held_lies_within_the_covariance() -> None:
    odometry = WheelOdometry(WHEELCHAIR)
    odometry.process(WheelTicks(0.0, 0, 0))
    gap_s = 0.6
    covariance = not_none(odometry.process(WheelTicks(gap_s, 0, 0)).covariance)
    reach_m = WHEELCHAIR.max_speed_m_s * gap_s
    assert math.sqrt(covariance[0, 0]) > reach_m / math.sqrt(3)
    assert math.sqrt(covariance[5, 5]) == pytest.approx(math.pi / math.sqrt(3))


def test_a_pose_is_stamped_with_the_time_the_wheels_stood_so() -> None:
    late = replace(WHEELCHAIR, delay_s=0.03)
    assert WheelOdometry(late).process(WheelTicks(10.0, 0, 0)).stamp_s == pytest.approx(9.97)
    np.testing.assert_allclose(integrate_log(late, [10.0, 10.02], [0, 1], [0, 1]).stamps_s, [9.97, 9.99])


def test_the_first_reading_is_where_odom_begins() -> None:
    estimate = WheelOdometry(WHEELCHAIR).process(WheelTicks(3.0, 400, -7))
    np.testing.assert_array_equal(estimate.T_odom_body, np.eye(4))
    np.testing.assert_array_equal(estimate.covariance, np.zeros((6, 6)))


@pytest.mark.parametrize("counts", [(0, 0), (40, 40), (50, 20), (-30, 30), (-9, -10)])
@pytest.mark.parametrize("seconds", [-0.3, 0.0, 1e-9, 0.02, 2.0])
def test_the_motion_in_some_time_is_the_exponential_of_the_twist(counts: tuple[int, int], seconds: float) -> None:
    odometry = WheelOdometry(WHEELCHAIR)
    odometry.process(WheelTicks(0.0, 0, 0))
    odometry.process(WheelTicks(0.02, *counts))
    v, yaw_rate = odometry.twist
    T = se3.exp(np.array([v, 0, 0, 0, 0, yaw_rate]) * seconds)
    np.testing.assert_allclose(odometry.motion_in(seconds), T, rtol=0, atol=1e-14)


def test_twist_is_that_of_the_last_step() -> None:
    odometry = WheelOdometry(WHEELCHAIR)
    odometry.process(WheelTicks(0.0, 0, 0))
    odometry.process(WheelTicks(0.02, 40, 60))
    tick_m = WHEELCHAIR.left_m_per_tick
    np.testing.assert_allclose(odometry.twist, (50 * tick_m / 0.02, 20 * tick_m / 0.52 / 0.02))


def test_answers_are_not_changed_by_later_readings() -> None:
    odometry = WheelOdometry(WHEELCHAIR)
    first = odometry.process(WheelTicks(0.0, 0, 0))
    held = odometry.T_odom_base, odometry.covariance
    odometry.process(WheelTicks(0.02, 40, 60))
    np.testing.assert_array_equal(first.T_odom_body, np.eye(4))
    np.testing.assert_array_equal(held[0], np.eye(4))
    np.testing.assert_array_equal(held[1], np.zeros((6, 6)))


@given(st.lists(st.tuples(st.floats(-5, 5), st.floats(-5, 5)), min_size=2, max_size=20))
def test_speeds_in_a_stream_are_their_ticks_in_a_log(speeds: list[tuple[float, float]]) -> None:
    stamps = 0.1 * np.arange(len(speeds))
    odometry = WheelOdometry(WHEELCHAIR)
    for stamp, pair in zip(stamps.tolist(), speeds, strict=True):
        odometry.process(WheelSpeeds(stamp, *pair))
    ticks = ticks_from_speeds(WHEELCHAIR, stamps, *np.transpose(speeds))
    np.testing.assert_allclose(odometry.pose, integrate_log(WHEELCHAIR, stamps, *ticks).poses[-1], atol=1e-9)


def test_speeds_never_roll_over() -> None:
    odometry = WheelOdometry(replace(WHEELCHAIR, counter_bits=8))
    for stamp in (0.0, 0.1):
        odometry.process(WheelSpeeds(stamp, 10.0, 10.0))
    assert odometry.pose[0] == pytest.approx(10.0 * 0.1 * 0.17)


def test_a_wheel_cannot_tell_ticks_and_speeds() -> None:
    odometry = WheelOdometry(WHEELCHAIR)
    odometry.process(WheelTicks(0.0, 0, 0))
    with pytest.raises(TypeError, match="not both"):
        odometry.process(WheelSpeeds(0.1, 0.0, 0.0))


def test_four_wheels_are_two_sides() -> None:
    left, right = sides_of_four([0, 3], [0, 4], [0, 7], [0, 9])
    np.testing.assert_array_equal([left, right], [[0, 3.5], [0, 8]])


def test_a_log_whose_columns_differ_in_length_is_no_log() -> None:
    with pytest.raises(ValueError, match="as many ticks"):
        integrate_log(WHEELCHAIR, [0, 1], [0], [0, 1])
    with pytest.raises(ValueError, match="as many yaw rates"):
        integrate_log(WHEELCHAIR, [0, 1], [0, 1], [0, 1], yaw_rates_rad_s=[0.0])


@pytest.mark.parametrize("n", [0, 1])
def test_a_log_of_hardly_anything(n: int) -> None:
    track = integrate_log(WHEELCHAIR, np.arange(n), np.zeros(n), np.zeros(n), gyro=Gyro())
    assert len(track) == len(track.trajectory()) == n


def test_steps_make_up_the_pose_and_its_covariance(rng: np.random.Generator) -> None:
    """Those of an arc are what its own twist and slip say, whatever the way before."""
    odometry, way = WheelOdometry(WHEELCHAIR), None
    ticks = np.concatenate([[[0, 0]], np.cumsum(rng.integers(50, 90, (20, 2)), axis=0)])
    for i, (left, right) in enumerate(ticks.tolist()):
        answer = odometry.process(WheelTicks(0.1 * i, left, right))
        if answer.step is None:
            assert i == 0
            continue
        way = answer.step if way is None else way.then(answer.step)
        of_this, turn = (ticks[i] - ticks[i - 1]) * 2 * np.pi * 0.17 / 3200, 0.0
        turn = (of_this[1] - of_this[0]) / 0.52
        expected = se3.exp([of_this.mean(), 0, 0, 0, 0, turn])
        np.testing.assert_allclose(answer.step.T_before_now, expected, atol=1e-12)
        assert (answer.step.begin_s, answer.step.end_s) == pytest.approx((0.1 * (i - 1), 0.1 * i))
    assert way is not None
    np.testing.assert_allclose(way.T_before_now, not_none(answer.T_odom_body), atol=1e-12)
    np.testing.assert_allclose(way.covariance, not_none(answer.covariance), atol=1e-12)
    assert way.begin_s == 0.0
    assert way.end_s == pytest.approx(2.0)


def test_a_reading_that_was_refused_shows_no_way_and_the_next_one_goes_on_from_it() -> None:
    odometry = WheelOdometry(replace(WHEELCHAIR, max_gap_s=0.5))
    for stamp_s, ticks in ((0.0, 0), (0.1, 60)):
        odometry.process(WheelTicks(stamp_s, ticks, ticks))
    gap = odometry.process(WheelTicks(2.0, 900, 900))
    assert gap.reason is Reason.GAP
    assert gap.step is not None
    np.testing.assert_allclose(gap.step.T_before_now, np.eye(4), atol=1e-12)
    assert gap.step.covariance[0, 0] > 1.0  # metres²: anywhere its wheels could take it
    backwards = odometry.process(WheelTicks(1.0, 950, 950))
    assert (backwards.reason, backwards.step) == (Reason.CLOCK_BACKWARDS, None)
    after = odometry.process(WheelTicks(2.1, 960, 960)).step
    assert after is not None
    assert (after.begin_s, after.T_before_now[0, 3]) == (2.0, pytest.approx(60 * 2 * np.pi * 0.17 / 3200))


def test_numbers_that_are_not_finite_tell_no_step() -> None:
    odometry = WheelOdometry(WHEELCHAIR)
    answers = [odometry.process(WheelSpeeds(0.1 * i, math.nan if i == 2 else 1.0, 1.0)) for i in range(5)]
    assert [answer.step is None for answer in answers] == [True, False, False, True, True]


@pytest.mark.parametrize("paused_s", [0.0, 0.4, 5.0])
def test_a_way_too_long_for_its_stamps_is_believed_after_a_pause_that_was_long_enough(paused_s: float) -> None:
    subject = WheelOdometry(WHEELCHAIR)
    ticks = int(3.0 / WHEELCHAIR.left_m_per_tick)  # in 0.4 s, by stamps
    subject.process(WheelTicks(0.0, 0, 0))
    subject.pause(paused_s)
    answer = subject.process(WheelTicks(0.4, ticks, ticks))
    if paused_s < 0.6:  # at 5 m/s
        assert answer.reason is Reason.IMPLAUSIBLE_MOTION
    else:
        assert answer.reason is None
        assert subject.pose[0] == pytest.approx(3.0, abs=1e-3)
    # That was of one reading.
    assert subject.process(WheelTicks(0.8, 2 * ticks, 2 * ticks)).reason is Reason.IMPLAUSIBLE_MOTION
