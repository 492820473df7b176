from __future__ import annotations

import math

import numpy as np
import pytest
from simulation.planes import plane

from wheelsight.core.calibration_parts import Gyro
from wheelsight.core.geometry import se3
from wheelsight.core.messages import WheelTicks
from wheelsight.wheels import integrate_log
from wheelsight_sim.drivers import ManualVelocities
from wheelsight_sim.physics import simulate_drive
from wheelsight_sim.readings import DeadReckoning, Encoders, Gyroscope, is_during
from wheelsight_sim.robot import RobotModel, WheelFaults

ROBOT = RobotModel()
COUNTS_PER_RAD = 3200 / (2 * math.pi)


def turned(encoders: Encoders, until_s: float, rate_rad_s: float = 3.0) -> list[WheelTicks | None]:
    """Readings every 20 ms of a left wheel that turns forward, and a right one that turns back half as fast."""
    readings = []
    for i in range(round(until_s / 0.005) + 1):
        stamp_s = i * 0.005
        encoders.turn(stamp_s, rate_rad_s * stamp_s * np.array([1.0, -0.5]))
        if i % 4 == 0:
            readings.append(encoders.read(stamp_s))
    return readings


def test_counts_are_angles_rounded_to_a_step(rng: np.random.Generator) -> None:
    for reading in turned(Encoders(ROBOT, WheelFaults(), rng), 20.0):
        assert reading is not None
        assert reading.left == pytest.approx(3.0 * reading.stamp_s * COUNTS_PER_RAD, abs=1)
        assert reading.right == pytest.approx(-1.5 * reading.stamp_s * COUNTS_PER_RAD, abs=1)


def test_a_shaft_that_trembles_within_a_step_counts_at_most_one(rng: np.random.Generator) -> None:
    encoders = Encoders(ROBOT, WheelFaults(), rng)
    for i in range(200):
        encoders.turn(i * 0.005, np.array([0.2, -0.2]) / COUNTS_PER_RAD * math.sin(i))
        assert max(map(abs, encoders.counts)) <= 1


def test_where_in_a_step_the_shafts_start_is_chance() -> None:
    firsts = []
    for seed in range(400):
        encoders = Encoders(ROBOT, WheelFaults(), np.random.default_rng(seed))
        encoders.turn(0.0, np.array([0.5, 0.5]) / COUNTS_PER_RAD)
        firsts.append(encoders.counts)
    assert np.mean(firsts, axis=0) == pytest.approx([0.5, 0.5], abs=0.1)


def test_counting_goes_on_while_readings_drop_out(rng: np.random.Generator) -> None:
    readings = turned(Encoders(ROBOT, WheelFaults(dropouts_s=((1.0, 2.0),)), rng), 3.0)
    missing_s = [i * 0.02 for i, reading in enumerate(readings) if reading is None]
    assert missing_s == pytest.approx(np.arange(50) * 0.02 + 1.0)
    assert readings[-1] is not None
    assert readings[-1].left == pytest.approx(9.0 * COUNTS_PER_RAD, abs=1)


def test_pulses_are_lost_while_unplugged(rng: np.random.Generator) -> None:
    readings = turned(Encoders(ROBOT, WheelFaults(unplugged_s=((1.0, 2.0),)), rng), 3.0)
    assert readings[60] is not None
    assert readings[90] is not None
    assert readings[-1] is not None
    assert readings[60].left == readings[90].left
    assert readings[-1].left == pytest.approx(6.0 * COUNTS_PER_RAD, abs=12)


def test_another_gear_and_encoder_count_otherwise(rng: np.random.Generator) -> None:
    reading = turned(Encoders(RobotModel(gear_ratio=20.0, counts_per_turn=500), WheelFaults(), rng), 2.0)[-1]
    assert reading is not None
    assert reading.left == pytest.approx(6.0 * 10000 / (2 * math.pi), abs=1)


def test_a_gyroscope_is_off_by_its_bias_and_noise() -> None:
    gyro = Gyro(noise_rad_per_sqrt_s=0.002, bias_rad_s=0.01, bias_sigma_rad_s=0.003, bias_walk_rad_s_per_sqrt_s=0.0)
    runs = []
    for seed in range(200):
        gyroscope = Gyroscope(gyro, np.random.default_rng(seed))
        runs.append([gyroscope.read(i * 0.01, 0.4).yaw_rate_rad_s for i in range(100)])
    errors = np.array(runs) - 0.4
    assert errors.mean() == pytest.approx(0.01, abs=4 * 0.003 / math.sqrt(200))
    # Over one second the noise comes to what the calibration says of it, beside the bias.
    assert errors.mean(axis=1).std() == pytest.approx(math.hypot(0.003, 0.002), rel=0.15)
    assert np.std(errors - errors.mean(axis=1, keepdims=True)) == pytest.approx(0.02, rel=0.05)


def test_a_gyroscopes_bias_wanders() -> None:
    gyro = Gyro(1e-9, bias_sigma_rad_s=0.0, bias_walk_rad_s_per_sqrt_s=1e-3)
    ends = []
    for seed in range(300):
        gyroscope = Gyroscope(gyro, np.random.default_rng(seed))
        ends.append([gyroscope.read(i * 0.01, 0.0).yaw_rate_rad_s for i in range(400)][-1])
    assert np.std(ends) == pytest.approx(2e-3, rel=0.15)


def test_the_gyroscope_of_a_drive_feels_its_turns() -> None:
    driver = ManualVelocities([0.0, 1.0, 5.0, 6.0], [0.0, 0.3, 0.0, 0.0], [0.0, 0.5, 0.0, 0.0])
    drive = simulate_drive(plane(), RobotModel(has_gyro=True), driver)
    rates = np.array([reading.yaw_rate_rad_s for reading in drive.yaw_rates])
    stamps_s = [reading.stamp_s for reading in drive.yaw_rates]
    np.testing.assert_allclose(np.diff(stamps_s), 0.01, atol=1e-9)
    bias = rates[:100].mean()
    assert 0 < abs(bias) < 0.1
    T = drive.truth.T_frame_body[-1]
    assert np.sum(rates - bias) * 0.01 == pytest.approx(math.atan2(T[1, 0], T[0, 0]), abs=0.02)
    assert not simulate_drive(plane(), ROBOT, driver, time_limit_s=0.1).yaw_rates


def test_reckoning_is_what_odometry_makes_of_the_counts(rng: np.random.Generator) -> None:
    readings = [reading for reading in turned(Encoders(ROBOT, WheelFaults(), rng), 8.0) if reading]
    stamps_s, left, right = np.array([(r.stamp_s, r.left, r.right) for r in readings]).T
    T_world_start = se3.from_plane(1.0, 2.0, 0.7)
    odometry = DeadReckoning(ROBOT.nominal, T_world_start)
    for reading in readings:
        T_world_base = odometry.update(reading.left, reading.right)
    path = integrate_log(ROBOT.nominal, stamps_s, left.astype(int), right.astype(int)).trajectory()
    np.testing.assert_allclose(T_world_base, T_world_start @ path.T_frame_body[-1], atol=1e-3)


def test_a_span_has_its_start_and_not_its_end() -> None:
    spans = ((1.0, 2.0), (3.0, 3.5))
    assert [is_during(t, spans) for t in (0.99, 1.0, 1.99, 2.0, 3.2, 3.5)] == [False, True, True, False, True, False]
