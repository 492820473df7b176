"""The gyroscope: its rates at the wheels' times, its bias, and what it is worth to a robot whose wheels slip."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from wheelsight.core.calibration_parts import Gyro, Wheels
from wheelsight.core.messages import WheelTicks
from wheelsight.wheels import WheelOdometry, WheelTrack, YawRateMeter, integrate_log, mean_yaw_rates

WHEELS = Wheels(0.1, 0.1, 0.5, 1000.0, slip_m_per_sqrt_m=0.02)


def yaw(stamps: np.ndarray) -> np.ndarray:
    return 0.7 * np.sin(stamps)


def test_means_are_the_yaw_turned_over_the_time() -> None:
    gyro_stamps, stamps = np.arange(-0.1, 10, 0.01), np.arange(0, 9.9, 0.033)
    means = mean_yaw_rates(stamps, gyro_stamps, 0.7 * np.cos(gyro_stamps))
    assert np.isnan(means[0])
    np.testing.assert_allclose(means[1:], np.diff(yaw(stamps)) / 0.033, atol=5e-4)


def test_the_meter_gives_the_same_as_the_whole_log_but_for_what_it_cannot_know_yet() -> None:
    gyro_stamps, stamps = np.arange(-0.1, 10, 0.01), np.arange(0, 9.8, 0.033)
    rates = 0.7 * np.cos(gyro_stamps)
    meter, means, given = YawRateMeter(), [], 0
    for stamp in stamps:
        while given < len(gyro_stamps) and gyro_stamps[given] <= stamp:
            meter.add(gyro_stamps[given], rates[given])
            given += 1
        means.append(meter.mean_until(stamp))
    expected = mean_yaw_rates(stamps, gyro_stamps, rates)
    assert means[0] is None
    np.testing.assert_allclose(np.array(means[1:], float), expected[1:], atol=1e-3)


def test_where_the_gyroscope_was_silent_there_is_no_mean() -> None:
    gyro_stamps = np.concatenate([np.arange(1, 2, 0.01), np.arange(3, 4, 0.01)])
    stamps = np.arange(0.5, 5, 0.1)
    means = mean_yaw_rates(stamps, gyro_stamps, np.ones(len(gyro_stamps)))
    known = stamps[~np.isnan(means)]
    np.testing.assert_allclose(means[~np.isnan(means)], 1.0)
    assert known.min() > 1.05
    assert not ((known > 2.0) & (known < 3.09)).any()
    assert known.max() < 4.0


def test_the_meter_says_so_too() -> None:
    meter = YawRateMeter()
    assert meter.mean_until(0.0) is None
    meter.add(0.0, 1.0)
    assert meter.mean_until(0.02) is None
    assert meter.mean_until(0.05) == pytest.approx(1.0)
    assert meter.mean_until(0.2) is None
    meter.add(0.3, 3.0)
    assert meter.mean_until(0.3) is None
    assert meter.mean_until(0.32) == pytest.approx(3.0)
    assert meter.mean_until(0.32) is None


def test_the_meter_takes_no_reading_that_is_none() -> None:
    meter = YawRateMeter()
    for stamp, rate in [(0.0, 1.0), (0.01, np.nan), (np.nan, 5.0), (0.0, 9.0), (-1.0, 9.0)]:
        meter.add(stamp, rate)
    meter.mean_until(0.01)
    assert meter.mean_until(0.02) == pytest.approx(1.0)


def drive(rng: np.random.Generator, gyro: Gyro | None, standing: int = 100) -> tuple[np.ndarray, np.ndarray]:
    """True and found yaw at the end of drives whose wheels slip and whose gyroscope is biased."""
    n, true_end, found_end = 600, [], []
    for _ in range(20):
        steps = np.where(np.arange(n)[:, None] < standing, 0, rng.uniform(30, 60, (n, 2)))
        noisy = steps + rng.normal(0, 6.0, steps.shape) * (steps > 0)
        turned = (steps[:, 1] - steps[:, 0]) * WHEELS.left_m_per_tick / WHEELS.track_width_m
        rates = turned / 0.02 + 0.05 + rng.normal(0, 0.005, n)
        given = None if gyro is None else np.concatenate([[np.nan], rates])
        ticks = np.concatenate([[[0, 0]], np.cumsum(noisy, axis=0)])
        track = integrate_log(WHEELS, 0.02 * np.arange(n + 1), *ticks.T, yaw_rates_rad_s=given, gyro=gyro)
        true_end.append(turned.sum())
        found_end.append(track.poses[-1, 2])
    return np.array(true_end), np.array(found_end)


def test_a_gyroscope_helps_wheels_that_slip(rng: np.random.Generator) -> None:
    def error(gyro: Gyro | None) -> float:
        true, found = drive(rng, gyro)
        return float(np.sqrt(np.mean(np.sin(found - true) ** 2)))

    # Rates that leap by 0.8 rad/s from step to step are as much as stamps may be late for.
    assert error(Gyro(7e-4)) < 0.35 * error(None)


def test_the_bias_is_learnt_while_the_wheels_stand_still() -> None:
    odometry = WheelOdometry(WHEELS, gyro=Gyro(1e-3, bias_sigma_rad_s=0.1))
    for i in range(200):
        odometry.process(WheelTicks(0.02 * i, 0, 0), 0.05)
    assert odometry.gyro_bias_rad_s == pytest.approx(0.05, rel=1e-3)


def test_a_bias_that_is_known_stays() -> None:
    known = Gyro(1e-3, bias_rad_s=0.02, bias_sigma_rad_s=0.0, bias_walk_rad_s_per_sqrt_s=0.0)
    odometry = WheelOdometry(WHEELS, gyro=known)
    for i in range(200):
        odometry.process(WheelTicks(0.02 * i, 0, 0), 0.05)
    assert odometry.gyro_bias_rad_s == 0.02


def test_the_reading_in_which_the_wheels_come_to_rest_shows_nothing_of_the_bias() -> None:
    odometry = WheelOdometry(WHEELS, gyro=Gyro(1e-3))
    odometry.process(WheelTicks(0.0, 0, 0), 9.0)
    odometry.process(WheelTicks(0.02, 5, 5), 9.0)
    odometry.process(WheelTicks(0.04, 5, 5), 9.0)
    assert odometry.gyro_bias_rad_s == 0.0
    for i in range(3, 14):
        odometry.process(WheelTicks(0.02 * i, 5, 5), 1.0)
    assert odometry.gyro_bias_rad_s == pytest.approx(1.0, rel=0.02)


def off_rad(track: WheelTrack, yaw: np.ndarray) -> np.ndarray:
    """(N,) by how much the yaw is off."""
    return np.asarray((track.poses[:, 2] - yaw + np.pi) % (2 * np.pi) - np.pi)


def curves(
    wheels: Wheels, slip: float, bias_rad_s: float, seed: int
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Stamps, ticks, mean rates and true yaw of 40 s through curves, at speeds that change, without a rest."""
    rng, dt = np.random.default_rng(seed), 0.02
    t = dt * np.arange(2000)
    way, turn = dt * (0.5 + 0.3 * np.sin(t / 3)), dt * 0.6 * np.sin(t / 2)
    travels = np.stack([way - turn * wheels.track_width_m / 2, way + turn * wheels.track_width_m / 2], axis=-1)
    noisy = travels + rng.normal(0, slip * np.sqrt(np.abs(travels)))
    ticks = np.concatenate([[[0, 0]], np.cumsum(noisy, axis=0)]) / [wheels.left_m_per_tick, wheels.right_m_per_tick]
    rates = np.concatenate([[np.nan], turn / dt + bias_rad_s + rng.normal(0, 1e-3 / np.sqrt(dt), len(t))])
    return dt * np.arange(2001), np.floor(ticks), rates, np.concatenate([[0.0], np.cumsum(turn)])


def test_unequal_wheels_leave_the_bias_uncertain() -> None:
    """Radii 0.3 % apart turn the base by 6 mrad a metre. A short drive does not separate that from a bias."""
    right = replace(WHEELS, right_radius_m=1.003 * WHEELS.right_radius_m)
    stamps, ticks, rates, _ = curves(WHEELS, 0.0005, 0.01, 3)
    odometry = WheelOdometry(right)
    for stamp, (left, right_), rate in zip(stamps[:400], ticks.astype(int), rates, strict=False):
        odometry.process(WheelTicks(stamp, left, right_), None if np.isnan(rate) else rate)
    off_rad_s = abs(odometry.gyro_bias_rad_s - 0.01)
    assert off_rad_s < 3 * odometry.gyro_bias_sigma_rad_s < 0.05


@pytest.mark.parametrize("bias_rad_s", [0.0, -0.05, 0.2])
def test_the_bias_is_learnt_while_driving(bias_rad_s: float) -> None:
    """Against wheels that grip much better than stated; however far it is off of what was to be expected."""
    for seed in range(5):
        stamps, ticks, rates, yaw = curves(WHEELS, 0.0005, bias_rad_s, seed)
        alone = off_rad(integrate_log(WHEELS, stamps, *ticks.T), yaw)
        both = off_rad(integrate_log(WHEELS, stamps, *ticks.T, yaw_rates_rad_s=rates), yaw)
        assert np.sqrt(np.mean(both**2)) < 1.2 * np.sqrt(np.mean(alone**2)) + 0.005
        odometry = WheelOdometry(WHEELS)
        for stamp, (left, right), rate in zip(stamps, ticks.astype(int), rates, strict=True):
            odometry.process(WheelTicks(stamp, left, right), None if np.isnan(rate) else rate)
        assert odometry.gyro_bias_rad_s == pytest.approx(bias_rad_s, abs=1.5e-3)
        assert abs(odometry.gyro_bias_rad_s - bias_rad_s) < 3 * odometry.gyro_bias_sigma_rad_s
        assert odometry.gyro_bias_sigma_rad_s < 1.5e-3


def test_wheels_that_differ_from_their_calibration_do_not_turn_the_bias() -> None:
    """Radii a percent apart are 0.7 rad off after 40 s; that goes with the way, and not with the time."""
    true = replace(WHEELS, right_radius_m=0.101, track_width_m=0.51)
    for seed in range(5):
        stamps, ticks, rates, yaw = curves(true, 0.001, 0.03, seed)
        alone = off_rad(integrate_log(WHEELS, stamps, *ticks.T), yaw)
        both = off_rad(integrate_log(WHEELS, stamps, *ticks.T, yaw_rates_rad_s=rates), yaw)
        assert abs(alone[-1]) > 0.3
        assert abs(both[-1]) < 0.08


def test_a_slip_is_the_wheels() -> None:
    """One of them spins by half a metre within 0.3 s: a radian, of which the gyroscope knows nothing."""
    stamps, ticks, rates, yaw = curves(WHEELS, 0.0005, 0.02, 1)
    spun = ticks.copy()
    spun[:, 1] += np.floor(np.clip((stamps - 20) / 0.3, 0, 1) * 0.5 / WHEELS.right_m_per_tick)
    assert off_rad(integrate_log(WHEELS, stamps, *spun.T), yaw)[-1] == pytest.approx(1.0, abs=0.02)
    assert abs(off_rad(integrate_log(WHEELS, stamps, *spun.T, yaw_rates_rad_s=rates), yaw)[-1]) < 0.02


def test_reading_by_reading_is_as_the_whole_log() -> None:
    stamps, ticks, rates, _ = curves(WHEELS, 0.01, 0.02, 3)
    track, odometry = integrate_log(WHEELS, stamps, *ticks.T, yaw_rates_rad_s=rates), WheelOdometry(WHEELS)
    for i, (stamp, (left, right), rate) in enumerate(zip(stamps, ticks.astype(int), rates, strict=True)):
        odometry.process(WheelTicks(stamp, left, right), None if np.isnan(rate) else rate)
        np.testing.assert_array_equal(odometry.pose, track.poses[i])
    np.testing.assert_array_equal(odometry.covariance[np.ix_([0, 1, 5], [0, 1, 5])], track.covariances[-1])


def test_a_copy_goes_on_by_itself() -> None:
    one = WheelOdometry(WHEELS)
    one.process(WheelTicks(0.0, 0, 0))
    other = one.copy()
    one.process(WheelTicks(0.1, 100, 150))
    assert other.pose == (0.0, 0.0, 0.0)
    np.testing.assert_array_equal(other.process(WheelTicks(0.1, 100, 150)).T_odom_body, one.T_odom_base)
