"""SensorHealth on motions of a base whose sensors have faults, by closed forms."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from wheelsight.core.geometry import FloatArray, se3
from wheelsight.estimation.agreement import Piece, RobotSensor, Usual, begin_of_scale, cause_of, wheel_ways
from wheelsight.estimation.fault_detection import SensorHealth, log_ratios, of_sensors

HALF_M, FAULT_S = 0.25, 10.0
USUAL = Usual(np.ones(2))
T_BASE_CAMERA = se3.from_parts([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]], [0.3, 0.1, 0.9])


class Motion(NamedTuple):
    """Of a base over a step: by both wheels, m; by the gyroscope, rad/s; by the camera, ξ of the base."""

    ways_m: FloatArray
    rate_rad_s: float
    camera: FloatArray


def largest(ratios: FloatArray) -> dict[RobotSensor, float]:
    return {sensor: float(ratios[place]) for sensor, place in of_sensors(ratios).items()}


Fault = Callable[[Motion], Motion]


def left(factor: float) -> Fault:
    return lambda motion: motion._replace(ways_m=motion.ways_m * (factor, 1.0))


def right(factor: float) -> Fault:
    return lambda motion: motion._replace(ways_m=motion.ways_m * (1.0, factor))


def gyro(factor: float) -> Fault:
    return lambda motion: motion._replace(rate_rad_s=motion.rate_rad_s * factor)


def camera(*factors: float, plus: tuple[float, ...] = (0.0,) * 6) -> Fault:
    return lambda motion: motion._replace(camera=motion.camera * factors + plus)


MIRRORED = camera(1, -1, 1, -1, 1, -1)
BUS = camera(1, 1, 1, 1, 1, 1, plus=(0.0, 0.04, 0.0, 0.0, 0.0, 0.0))  # 0.8 m/s to the side


def driven(
    fault: Fault | None,
    seed: int = 0,
    *,
    with_gyro: bool = True,
    until_s: float = 25.0,
    ends_s: float = math.inf,
    is_armed: bool = True,
    knows_turns: bool = True,
    scales: list[FloatArray] | None = None,
) -> tuple[SensorHealth, dict[RobotSensor, float]]:
    """Drive curves of up to 0.5 m/s and 0.5 rad/s, with noise; a fault begins at `FAULT_S`. Also when it was found.

    `scales` receives the scales of the wheels.
    """
    rng, health, T = np.random.default_rng(seed), SensorHealth(2 * HALF_M, T_BASE_CAMERA), np.eye(4)
    step_s, found, health.is_armed, health.knows_turns = 0.05, dict[RobotSensor, float](), is_armed, knows_turns
    by = np.ones(2)
    for n in range(round(until_s / step_s)):
        now_s = 100.0 + n * step_s
        speed, rate = 0.4 + 0.1 * math.sin(0.3 * n * step_s), 0.5 * math.sin(0.7 * n * step_s)
        way_m, turn = speed * step_s, rate * step_s
        motion = Motion(
            np.array([way_m - HALF_M * turn, way_m + HALF_M * turn]), rate, np.array([way_m, *4 * [0], turn])
        )
        if fault is not None and FAULT_S <= now_s - 100.0 < ends_s:
            motion = fault(motion)
        noise = rng.normal(0.0, (0.001, 0.001, 0.001, 0.001, 0.001, 0.0015))
        ways_m = motion.ways_m * (1 + rng.normal(0.0, 0.01, 2)) / by
        health.steps.append((now_s, float(ways_m.mean()), float(np.diff(ways_m)[0] / (2 * HALF_M))))
        if with_gyro:
            health.rates.append((now_s, motion.rate_rad_s + 0.002 * rng.standard_normal()))
        T = T @ se3.exp(motion.camera)
        if n % 2 == 0:
            seen = T @ se3.exp(noise) @ T_BASE_CAMERA
            health.add_frame(now_s, np.ascontiguousarray(seen))
            health.update(now_s)
            by = by * health.take_new_scales()
            if scales is not None:
                scales.append(by)
            for sensor in health.faults:
                found.setdefault(sensor, now_s - 100.0)
    return health, found


@pytest.mark.parametrize("with_gyro", [True, False])
@pytest.mark.parametrize("seed", [1, 2, 3])
def test_sound_sensors_raise_no_alarm(seed: int, with_gyro: bool) -> None:
    health, found = driven(None, seed, with_gyro=with_gyro, until_s=120.0)
    assert not found
    assert not health.warnings
    assert not any(one.is_sure for one in health.exclusions)


@pytest.mark.parametrize("with_gyro", [True, False])
@pytest.mark.parametrize(
    ("fault", "sensor", "words", "within_s"),
    [
        (left(0.0), RobotSensor.LEFT, "does not count", 2.0),
        (right(0.0), RobotSensor.RIGHT, "does not count", 2.0),
        (left(-1.0), RobotSensor.LEFT, "backwards", 2.0),
        (right(1.13), RobotSensor.RIGHT, "counts 1.1", 4.5),
        (left(0.85), RobotSensor.LEFT, "counts 0.8", 4.5),
        (lambda motion: left(1.6)(right(1.6)(motion)), RobotSensor.WHEELS, "slip", 2.0),
        (MIRRORED, RobotSensor.CAMERA, "mirrored", 3.0),
        (BUS, RobotSensor.CAMERA, "sideways", 2.0),
    ],
)
def test_a_fault_is_found_named_and_dated(
    fault: Fault, sensor: RobotSensor, words: str, within_s: float, with_gyro: bool
) -> None:
    health, found = driven(fault, with_gyro=with_gyro)
    assert list(found) == [sensor]
    assert found[sensor] < FAULT_S + within_s
    assert words in health.warnings[0]
    (exclusion,) = [one for one in health.exclusions if one.is_sure]
    assert exclusion.sensor is sensor
    assert -2 * 1.3 < exclusion.begin_s - 100.0 - FAULT_S < 0.05  # before the fault, by up to two pieces


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize(("factor", "wrong_from"), [(1.1, 12), (0.85, 17), (0.0, 20), (-1.0, 20), (1.1, 30)])
def test_a_scale_that_slow_pieces_did_not_show_began_with_them(factor: float, wrong_from: int, seed: int) -> None:
    # The wheel rolls fast, hardly, and fast again; the sum of the last pieces shows its scale.
    rng, after = np.random.default_rng(seed), 20
    true_m = np.repeat([0.15, 0.07, 0.15], [12, 8, 10]) + rng.normal(0.0, 0.001, 30)
    factors = np.where(np.arange(30) < min(wrong_from, after), 1.0, factor)
    ways_m = true_m * factors + rng.normal(0.0, 0.001, 30)
    pieces = [
        Piece(0.3 * i, 0.3 * (i + 1), np.array([true, *5 * [0.0]]), np.array([way, true]), None)
        for i, (true, way) in enumerate(zip(true_m, ways_m, strict=True))
    ]
    ways = wheel_ways(pieces, RobotSensor.LEFT, USUAL, HALF_M)
    np.testing.assert_allclose(ways, (ways_m, true_m))
    assert begin_of_scale(pieces, 0.3 * after, *ways) == pytest.approx(0.3 * min(wrong_from, after))


@pytest.mark.parametrize("with_gyro", [True, False])
@pytest.mark.parametrize("factor", [0.8, 0.9, 1.1, 1.3])
def test_a_wheel_that_agrees_with_a_new_scale_is_used_with_it(factor: float, with_gyro: bool) -> None:
    scales: list[FloatArray] = []
    health, found = driven(left(factor), with_gyro=with_gyro, until_s=40.0, scales=scales)
    assert list(found) == [RobotSensor.LEFT]
    assert not health.faults
    np.testing.assert_allclose(scales[-1], (factor, 1.0), rtol=0.02)
    (past,) = health.exclusions
    assert 4.0 < past.end_s - 100.0 - FAULT_S < 20.0
    assert f"counts {factor:.1f}" in health.warnings[0] or f"counts {factor - 0.01:.2f}" in health.warnings[0]
    assert "used with that scale" in health.warnings[0]


@pytest.mark.parametrize("factor", [0.0, -1.0])
def test_a_wheel_that_counts_nothing_or_backwards_has_no_scale(factor: float) -> None:
    scales: list[FloatArray] = []
    health, _ = driven(left(factor), until_s=40.0, scales=scales)
    assert list(health.faults) == [RobotSensor.LEFT]
    np.testing.assert_array_equal(scales[-1], 1.0)


@pytest.mark.parametrize(("factor", "words"), [(-1.0, "measures -"), (0.0, "measures ")])
def test_a_faulty_gyroscope_is_found(factor: float, words: str) -> None:
    health, found = driven(gyro(factor))
    assert list(found) == [RobotSensor.GYRO]
    assert found[RobotSensor.GYRO] < FAULT_S + 3.0
    assert words in health.warnings[0]


def test_two_faults_are_found_one_after_the_other() -> None:
    def both(motion: Motion) -> Motion:
        return gyro(-1.0)(left(0.0)(motion))

    _, found = driven(both, until_s=40.0)
    assert set(found) == {RobotSensor.LEFT, RobotSensor.GYRO}


def test_a_sensor_that_agrees_again_is_used_again() -> None:
    health, found = driven(left(0.0), ends_s=15.0, until_s=40.0)
    assert list(found) == [RobotSensor.LEFT]
    assert not health.faults
    assert "until" in health.warnings[0]
    (past,) = health.exclusions
    assert past.begin_s < 112.0
    assert 117.0 < past.end_s < 130.0


@pytest.mark.parametrize(("aside_m", "is_out"), [(0.0, False), (0.04, True)])
def test_one_piece_that_contradicts_leaves_out_a_camera_that_restarted(aside_m: float, is_out: bool) -> None:
    health, _ = driven(None, until_s=5.0)
    health.interrupt(105.0)
    assert health.update(105.0) is None
    for n in range(8):
        now_s = 105.0 + 0.05 * n
        health.steps.append((now_s, 0.02, 0.0))
        T = np.ascontiguousarray(se3.from_parts(np.eye(3), [0.02 * n, aside_m * n, 0.0]) @ T_BASE_CAMERA)
        health.add_frame(now_s, T)
    assert health.update(105.4) == (105.0 if is_out else None)
    assert [one.sensor for one in health.exclusions] == ([RobotSensor.CAMERA] if is_out else [])


def track(factor: float) -> Fault:
    """Wheels that are closer together, or farther apart, than is known."""

    def change(motion: Motion) -> Motion:
        middle = motion.ways_m.mean()
        return motion._replace(ways_m=middle + factor * (motion.ways_m - middle))

    return change


@pytest.mark.parametrize("factor", [0.7, 1.4])
def test_a_wrong_track_is_no_fault_before_turns_have_agreed(factor: float) -> None:
    health, _ = driven(track(factor), knows_turns=True)
    assert health.is_suspicious
    health, found = driven(track(factor), knows_turns=False)
    assert not found
    assert not health.is_suspicious


@pytest.mark.parametrize("fault", [left(0.0), left(-1.0), right(0.0)])
def test_a_wheel_that_fails_is_found_before_turns_have_agreed(fault: Fault) -> None:
    _, found = driven(fault, knows_turns=False)
    (sensor,) = found
    assert sensor in (RobotSensor.LEFT, RobotSensor.RIGHT)
    assert found[sensor] < FAULT_S + 3.0


def test_a_fault_before_the_check_of_the_calibration_is_over_is_its_matter() -> None:
    health, found = driven(left(0.0), is_armed=False)
    assert not found
    assert not health.warnings


@given(
    way=st.floats(-0.2, 0.2),
    turn=st.floats(-0.4, 0.4),
    errors=st.lists(st.floats(-0.3, 0.3), min_size=4, max_size=4),
)
def test_the_ratio_of_left_and_right_changes_sides_in_a_mirror(way: float, turn: float, errors: list[float]) -> None:
    """Mirror a drive left to right: what accused the left wheel accuses the right one, and no other sensor changes."""
    y, left_m, right_m, gyro_rad = errors
    ways_m = np.array([way - HALF_M * turn + left_m, way + HALF_M * turn + right_m])
    piece = Piece(0.0, 0.25, np.array([way, y, 0.0, 0.0, 0.0, turn]), ways_m, turn + gyro_rad)
    mirrored = Piece(0.0, 0.25, np.array([way, -y, 0.0, 0.0, 0.0, -turn]), ways_m[::-1], -turn - gyro_rad)
    one, other = (largest(log_ratios(each, HALF_M, USUAL)) for each in (piece, mirrored))
    assert one[RobotSensor.LEFT] == pytest.approx(other[RobotSensor.RIGHT], abs=1e-6)
    for sensor in (RobotSensor.WHEELS, RobotSensor.CAMERA, RobotSensor.GYRO):
        assert one[sensor] == pytest.approx(other[sensor], abs=1e-6)


@given(st.lists(st.floats(-10.0, 10.0), min_size=9, max_size=9))
def test_any_piece_gives_finite_ratios_and_a_cause(numbers: list[float]) -> None:
    piece = Piece(0.0, 0.25, np.array(numbers[:6]), np.array(numbers[6:8]), numbers[8])
    for sensor, ratio in largest(log_ratios(piece, HALF_M, USUAL)).items():
        assert math.isfinite(ratio)
        assert cause_of(sensor, piece.camera[None], piece.ways_m[None], np.array([numbers[8]]), HALF_M, USUAL.ratios)


def test_a_base_that_stands_accuses_no_sensor_and_clears_none() -> None:
    piece = Piece(0.0, 0.25, np.zeros(6), np.zeros(2), 0.0)
    ratios = log_ratios(piece, HALF_M, USUAL)
    assert ratios.max() == pytest.approx(0.0, abs=1e-3)
    assert ratios.min() > -0.8
