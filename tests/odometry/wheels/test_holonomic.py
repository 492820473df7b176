"""Dead reckoning of holonomic bases: known motions, closed forms, and what comes of noisy and slipping wheels."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from wheelsight.core.calibration_parts import Gyro, HolonomicWheels
from wheelsight.core.errors import ArgumentError
from wheelsight.core.estimates import Reason, Status
from wheelsight.core.geometry import FloatArray, se2
from wheelsight.core.messages import HolonomicReading, OdometryReading, WheelCounts, WheelTicks
from wheelsight.wheels import HolonomicOdometry

FINE = 2e6  # counts a turn: rounding is nothing
MECANUM = HolonomicWheels("mecanum", radius_m=0.05, half_length_m=0.2, half_width_m=0.15, ticks_per_turn=FINE)
THREE = HolonomicWheels(
    "omni", radius_m=0.04, distance_m=0.18, angles_rad=(math.pi / 3, math.pi, -math.pi / 3), ticks_per_turn=FINE
)
FOUR = HolonomicWheels(
    "omni",
    radius_m=0.04,
    distance_m=0.2,
    angles_rad=tuple(math.pi / 4 + np.arange(4) * math.pi / 2),
    ticks_per_turn=FINE,
)
INCREMENTS = HolonomicWheels("increments", distance_m=0.2)
ALL = {"mecanum": MECANUM, "omni of three": THREE, "omni of four": FOUR, "increments": INCREMENTS}
WITH_WHEELS = {name: wheels for name, wheels in ALL.items() if wheels.wheel_names}
PERIOD_S = 0.02

speeds = st.floats(-1.0, 1.0)
twists = st.lists(st.tuples(speeds, speeds, st.floats(-2.0, 2.0)), min_size=1, max_size=20)


def readings_of(wheels: HolonomicWheels, steps: FloatArray, ways_m: FloatArray | None = None) -> list[HolonomicReading]:
    """Readings of steps (N, 3) of the base, each along an arc; `ways_m` (N, wheels) adds to what wheels roll."""
    stamps_s = PERIOD_S * np.arange(len(steps) + 1)
    if not wheels.wheel_names:
        poses = [np.eye(3)]
        for step in steps:
            poses.append(poses[-1] @ se2.exp(step))
        parts = (map(float, se2.to_parts(T)) for T in poses)
        return [OdometryReading(float(stamp_s), *part) for stamp_s, part in zip(stamps_s, parts, strict=True)]
    ways = steps @ wheels.jacobian.T + (0.0 if ways_m is None else ways_m)
    counts = np.rint(np.vstack([np.zeros(ways.shape[1]), np.cumsum(ways, axis=0)]) / wheels.m_per_tick)
    return [WheelCounts(float(s), tuple(map(int, row))) for s, row in zip(stamps_s, counts, strict=True)]


def driven(wheels: HolonomicWheels, steps: FloatArray, ways_m: FloatArray | None = None) -> HolonomicOdometry:
    odometry = HolonomicOdometry(wheels)
    for reading in readings_of(wheels, steps, ways_m):
        assert odometry.process(reading).status is Status.TRACKING
    return odometry


@pytest.mark.parametrize("name", ALL)
@given(velocities=twists)
def test_constant_velocities_between_readings_are_integrated_exactly(
    name: str, velocities: list[tuple[float, float, float]]
) -> None:
    steps = PERIOD_S * np.array(velocities)
    expected = se2.compose(*(se2.exp(step) for step in steps))
    found = driven(ALL[name], steps).T_odom_base
    np.testing.assert_allclose(found[:2, :2], expected[:2, :2], atol=2e-5)
    np.testing.assert_allclose(found[:2, 3], expected[:2, 2], atol=2e-5)
    np.testing.assert_allclose(found[2], [0, 0, 1, 0], atol=1e-12)


@pytest.mark.parametrize("name", ALL)
def test_a_way_to_the_left_is_one_to_the_left(name: str) -> None:
    odometry = driven(ALL[name], np.tile([0.0, 0.01, 0.0], (100, 1)))
    np.testing.assert_allclose(odometry.T_odom_base[:3, 3], [0, 1, 0], atol=1e-6)
    np.testing.assert_allclose(odometry.twist, [0, 0.5, 0], atol=1e-4)


@pytest.mark.parametrize("name", ALL)
def test_a_circle_driven_sideways_closes(name: str) -> None:
    """Heading stays while the way turns: the path is a circle, of which no wheel of a differential drive could know."""
    angle = np.linspace(0, 2 * np.pi, 501)
    steps = np.column_stack([np.diff(np.cos(angle)), np.diff(np.sin(angle)), np.zeros(500)])
    np.testing.assert_allclose(driven(ALL[name], steps).T_odom_base, np.eye(4), atol=1e-5)


def test_mecanum_wheels_roll_as_the_textbook_has_it() -> None:
    """Taheri, Qiao & Ghaeminezhad, "Kinematic model of a four mecanum wheeled mobile robot", 2015."""
    vx, vy, w = 0.3, -0.2, 0.7
    lever = 0.35
    expected = [vx - vy - lever * w, vx + vy + lever * w, vx + vy - lever * w, vx - vy + lever * w]
    np.testing.assert_allclose(MECANUM.jacobian @ [vx, vy, w], expected)
    np.testing.assert_allclose(MECANUM.to_base @ expected, [vx, vy, w])


@pytest.mark.parametrize("name", WITH_WHEELS)
@given(twist=st.tuples(speeds, speeds, speeds))
def test_forward_kinematics_undo_inverse_ones_and_contradict_nothing(
    name: str, twist: tuple[float, float, float]
) -> None:
    wheels = ALL[name]
    ways = wheels.jacobian @ twist
    np.testing.assert_allclose(wheels.to_base @ ways, twist, atol=1e-12)
    assert wheels.contradictions.shape == (len(ways) - 3, len(ways))
    np.testing.assert_allclose(wheels.contradictions @ ways, 0, atol=1e-12)


@pytest.mark.parametrize("name", WITH_WHEELS)
def test_the_covariance_is_that_of_first_order(name: str, rng: np.random.Generator) -> None:
    """Against Jacobians of the whole drive by each wheel's way at each step, by central differences."""
    wheels = ALL[name]
    steps = rng.uniform(-1, 1, (6, 3)) * [0.02, 0.02, 0.05]
    T = driven(wheels, steps).T_odom_base
    ways, expected, h = steps @ wheels.jacobian.T, np.zeros((3, 3)), 1e-4
    for i, j in np.ndindex(ways.shape):
        moved = []
        for sign in (1, -1):
            changed = ways.copy()
            changed[i, j] += sign * h
            poses = se2.compose(*(se2.exp(wheels.to_base @ way) for way in changed))
            moved.append(se2.log(poses @ se2.invert(se2.from_parts(T[0, 3], T[1, 3], math.atan2(T[1, 0], T[0, 0])))))
        J = (moved[0] - moved[1]) / (2 * h)
        expected += np.outer(J, J) * wheels.slip_m_per_sqrt_m**2 * abs(ways[i, j])
    found = driven(wheels, steps).covariance[np.ix_([0, 1, 5], [0, 1, 5])]
    np.testing.assert_allclose(found, expected, rtol=2e-3, atol=1e-9)


@pytest.mark.parametrize("name", WITH_WHEELS)
def test_the_covariance_covers_what_noisy_wheels_make(name: str, rng: np.random.Generator) -> None:
    wheels = ALL[name]
    steps = np.tile([0.006, 0.008, 0.01], (100, 1))
    ways = np.abs(steps @ wheels.jacobian.T)
    truth = se2.compose(*(se2.exp(step) for step in steps))
    nees = []
    for _ in range(60):
        noise = wheels.slip_m_per_sqrt_m * np.sqrt(ways) * rng.standard_normal(ways.shape)
        odometry = driven(wheels, steps, noise)
        T, C = odometry.T_odom_base, odometry.covariance[np.ix_([0, 1, 5], [0, 1, 5])]
        off = se2.log(truth @ se2.invert(se2.from_parts(T[0, 3], T[1, 3], math.atan2(T[1, 0], T[0, 0]))))
        nees.append(off @ np.linalg.solve(C, off))
    # χ² with 180 degrees of freedom lies within 145 to 219 in 95 of 100 cases; 99.9 % lie within 124 to 249.
    assert 124 < sum(nees) < 249


@pytest.mark.parametrize("wheels", [MECANUM, FOUR], ids=["mecanum", "omni"])
def test_a_wheel_that_spins_is_known_by_the_others_and_covered(wheels: HolonomicWheels) -> None:
    steps = np.tile([0.01, 0.004, 0.0], (100, 1))
    spinning = np.zeros((100, 4))
    spinning[40:60, 1] = 0.008
    sound, odometry = driven(wheels, steps), driven(wheels, steps, spinning)
    assert not sound.is_slipping
    C_sound, C = sound.covariance, odometry.covariance
    off_m = np.linalg.norm(odometry.T_odom_base[:2, 3] - sound.T_odom_base[:2, 3])
    assert off_m > 5 * math.sqrt(np.trace(C_sound[:2, :2]))
    assert off_m < 3 * math.sqrt(np.trace(C[:2, :2]))


def test_slip_is_reported_while_it_lasts() -> None:
    odometry, reported = HolonomicOdometry(MECANUM), []
    spinning = np.zeros((200, 4))
    spinning[50:80, 2] = 0.01
    for reading in readings_of(MECANUM, np.tile([0.01, 0.0, 0.0], (200, 1)), spinning):
        odometry.process(reading)
        reported.append(odometry.is_slipping)
    assert not any(reported[:51])
    assert all(reported[60:81])
    assert not any(reported[-40:])


def test_three_wheels_cannot_contradict_each_other(rng: np.random.Generator) -> None:
    odometry = driven(THREE, np.tile([0.01, 0.0, 0.0], (50, 1)), 0.01 * rng.standard_normal((50, 3)))
    assert odometry.slip_chi2 == 0
    assert not odometry.is_slipping


def test_counters_roll_over() -> None:
    wheels = HolonomicWheels(
        "mecanum", radius_m=0.05, half_length_m=0.2, half_width_m=0.15, ticks_per_turn=4096, counter_bits=16
    )
    steps = np.tile([0.0, 0.01, 0.001], (1000, 1))
    odometry = HolonomicOdometry(wheels)
    for reading in readings_of(wheels, steps):
        assert isinstance(reading, WheelCounts)
        odometry.process(WheelCounts(reading.stamp_s, tuple(count % 65536 for count in reading.counts)))
    expected = se2.compose(*(se2.exp(step) for step in steps))
    np.testing.assert_allclose(odometry.T_odom_base[:2, 3], expected[:2, 2], atol=1e-3)


def test_where_the_base_own_frame_lies_is_no_matter(rng: np.random.Generator) -> None:
    steps = rng.uniform(-1, 1, (80, 3)) * [0.01, 0.01, 0.1]
    elsewhere, odometry = se2.from_parts(4.0, -3.0, 2.5), HolonomicOdometry(INCREMENTS)
    for reading in readings_of(INCREMENTS, steps):
        assert isinstance(reading, OdometryReading)
        T = elsewhere @ se2.from_parts(reading.x_m, reading.y_m, reading.yaw_rad)
        odometry.process(OdometryReading(reading.stamp_s, *map(float, se2.to_parts(T))))
    np.testing.assert_allclose(odometry.T_odom_base, driven(INCREMENTS, steps).T_odom_base, atol=1e-9)


@pytest.mark.parametrize(
    ("stamp_s", "counts", "reason"),
    [
        (0.02, (0, 0, 0, 0), Reason.CLOCK_BACKWARDS),
        (0.9, (0, 0, 0, 0), Reason.GAP),
        (0.06, (0, 0, 0, 10 * int(FINE)), Reason.IMPLAUSIBLE_MOTION),
    ],
)
def test_readings_that_cannot_be_are_refused(stamp_s: float, counts: tuple[int, ...], reason: Reason) -> None:
    odometry = HolonomicOdometry(MECANUM)
    for stamp in (0.0, 0.02, 0.04):
        odometry.process(WheelCounts(stamp, (0, 0, 0, 0)))
    before = odometry.covariance
    answer = odometry.process(WheelCounts(stamp_s, counts))
    assert (answer.status, answer.reason) == (Status.FAILING, reason)
    np.testing.assert_array_equal(odometry.T_odom_base, np.eye(4))
    grows = np.diag(odometry.covariance - before)[[0, 1, 5]] > 0
    assert grows.all() if reason is not Reason.CLOCK_BACKWARDS else not grows.any()


def test_a_gyroscope_corrects_turns_once_its_bias_is_known(rng: np.random.Generator) -> None:
    """The wheels slip in turns by 5 %; the gyroscope has a bias of 0.02 rad/s, which a second's rest shows."""
    steps = np.vstack([np.zeros((50, 3)), np.tile([0.0, 0.01, 0.02], (300, 1))])
    slipping = np.vstack([np.zeros((50, 4)), np.tile([0.0, 0.0, 0.001], (300, 1)) @ MECANUM.jacobian.T])
    bias_rad_s, gyro = 0.02, Gyro(noise_rad_per_sqrt_s=1e-4)
    odometry = HolonomicOdometry(MECANUM, gyro)
    for index, reading in enumerate(readings_of(MECANUM, steps, slipping)):
        rate = bias_rad_s + (0.0 if index == 0 else steps[index - 1, 2] / PERIOD_S)
        odometry.process(reading, rate + 1e-4 / math.sqrt(PERIOD_S) * rng.standard_normal())
    T = odometry.T_odom_base
    yaw_rad = math.atan2(T[1, 0], T[0, 0])
    by_wheels = driven(MECANUM, steps, slipping).T_odom_base
    off_by_wheels = abs(se2.wrap_angle(math.atan2(by_wheels[1, 0], by_wheels[0, 0]) - 6.0))
    assert off_by_wheels > 0.25
    assert abs(se2.wrap_angle(yaw_rad - 6.0)) < 0.01
    assert odometry.gyro_bias_rad_s == pytest.approx(bias_rad_s, abs=4 * odometry.gyro_bias_sigma_rad_s)


def test_readings_of_other_wheels_are_refused_with_what_to_give() -> None:
    odometry = HolonomicOdometry(MECANUM)
    with pytest.raises(ArgumentError, match="3 counts are given, and the calibration has 4 wheels"):
        odometry.process(WheelCounts(0.0, (1, 2, 3)))
    with pytest.raises(ArgumentError, match="WheelTicks is no reading of a holonomic base"):
        odometry.process(WheelTicks(0.0, 1, 2))
    with pytest.raises(ArgumentError, match="OdometryReading, as layout increments says"):
        HolonomicOdometry(INCREMENTS).process(WheelCounts(0.0, (1, 2, 3, 4)))


def test_a_copy_goes_on_by_itself() -> None:
    readings = readings_of(MECANUM, np.tile([0.0, 0.01, 0.01], (20, 1)))
    odometry = HolonomicOdometry(MECANUM)
    for reading in readings[:10]:
        odometry.process(reading)
    other, there = odometry.copy(), odometry.T_odom_base
    for reading in readings[10:]:
        other.process(reading)
    np.testing.assert_array_equal(odometry.T_odom_base, there)
    for reading in readings[10:]:
        odometry.process(reading)
    np.testing.assert_array_equal(odometry.T_odom_base, other.T_odom_base)
