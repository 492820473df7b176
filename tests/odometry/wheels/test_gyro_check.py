"""GyroCheck: a gyroscope that shows the wheels' turns is believed, and each way in which it may not is named."""

from __future__ import annotations

import re
from collections.abc import Callable

import numpy as np
import pytest

from wheelsight.wheels import GyroCheck
from wheelsight.wheels.gyroscope import RateLine

WHEEL_S, GYRO_S = 0.02, 0.01
Change = Callable[[np.ndarray, np.ndarray], tuple[np.ndarray, np.ndarray]]  # of stamps and rates


def turning(stamps_s: np.ndarray) -> np.ndarray:
    """The true yaw: straight on for a quarter of the time, else through curves of up to 0.6 rad/s."""
    return np.asarray(0.6 * np.where(stamps_s % 8 < 2, 0.0, 1 - np.cos(np.pi * (stamps_s % 8 - 2) / 3)) * 0.8)


def checked(
    change: Change = lambda stamps, rates: (stamps, rates),
    *,
    seconds: float = 40.0,
    slope: float = 1.0,
    scatter: float = 0.0,
    seed: int = 0,
) -> tuple[GyroCheck, list[float]]:
    """What comes of a drive in which the base turns `slope` times as far as its wheels say, give or take; and when
    it was trusted.
    """
    rng = np.random.default_rng(seed)
    wheel_s, gyro_s = np.arange(0, seconds, WHEEL_S), np.arange(0, seconds, GYRO_S)
    turns = (
        np.diff(turning(wheel_s))
        / slope
        * (1 + scatter * np.repeat(rng.normal(size=len(wheel_s)), 25)[: len(wheel_s) - 1])
    )
    turns += rng.normal(0, 1e-4, len(turns))
    rates = np.gradient(turning(gyro_s), gyro_s) + 0.02 + rng.normal(0, 0.01, len(gyro_s))
    events = [(stamp, 0, rate) for stamp, rate in zip(*change(gyro_s, rates), strict=True)]
    events += [(stamp, 1, turn) for stamp, turn in zip(wheel_s, [0.0, *turns], strict=True)]
    check, trusted = GyroCheck(), []
    for stamp, is_wheels, value in sorted(events):
        if is_wheels:
            check.add_turn(stamp, value)
            trusted += [stamp] if check.is_trusted else []
        else:
            check.add_rate(stamp, value)
    return check, trusted


def test_a_gyroscope_that_agrees_is_trusted_after_some_seconds_of_turning() -> None:
    for seed in range(3):
        check, trusted = checked(seed=seed, seconds=16.0)
        assert check.is_trusted
        assert check.agrees_now
        assert check.warnings == ()
        assert 3.5 < trusted[0] < 6.0
        assert len(trusted) * WHEEL_S == pytest.approx(16.0 - trusted[0], abs=0.1)


def test_one_that_was_never_put_to_the_test_is_not() -> None:
    check, trusted = checked(seconds=1.9)
    assert not trusted
    assert check.warnings == ()


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (lambda stamps, rates: (stamps, -rates), "turns the other way"),
        (lambda stamps, rates: (stamps, np.degrees(rates)), "57.. times as fast as the wheels .degrees instead"),
        (lambda stamps, rates: (stamps, np.radians(rates)), "0.017. times as fast"),
        (lambda stamps, rates: (stamps, 2 * rates), "2 times as fast|2.0. times|1.9. times"),
        (lambda stamps, rates: (stamps, 0.5 * rates), "0.5 times|0.50. times|0.49. times"),
        (lambda stamps, rates: (stamps, 0 * rates), "stays at 0 rad/s"),
        (lambda stamps, rates: (stamps, 0 * rates + 0.031), "stays at 0.031 rad/s"),
        (lambda stamps, rates: (stamps + 0.2, rates), "0.2 s late"),
        (lambda stamps, rates: (stamps - 0.2, rates), "0.2 s early"),
        (lambda stamps, rates: (stamps, np.random.default_rng(1).permutation(rates)), "does not measure the turns"),
        (lambda stamps, rates: (stamps + 1.6e9, rates), "do not overlap"),
        (lambda stamps, rates: (stamps - 5000, rates), "do not overlap"),
    ],
)
def test_a_contradiction_is_named_and_never_believed(change: Change, said: str) -> None:
    check, trusted = checked(change)
    assert not trusted
    (warning,) = check.warnings
    assert warning.startswith("The gyroscope is left out: ")
    assert warning.endswith(".")
    assert re.search(said, warning)


def test_one_that_fails_on_the_way_is_left_out_from_then_on() -> None:
    check, trusted = checked(lambda stamps, rates: (stamps, np.where(stamps < 20, rates, -0.3)))
    assert "stays at -0.3 rad/s" in check.problem
    assert 20 < trusted[-1] < 25
    assert not check.is_trusted


@pytest.mark.parametrize("is_final", [False, True])
def test_a_final_verdict_stays_when_the_wheels_fail(is_final: bool) -> None:
    check, rng = GyroCheck(), np.random.default_rng(2)
    for k in range(3000):
        stamp_s = k * GYRO_S
        check.add_rate(stamp_s, float(np.gradient(turning(stamp_s + np.array([-0.01, 0, 0.01])), 0.01)[1]))
        turn = float(np.diff(turning(np.array([stamp_s - GYRO_S, stamp_s])))[0])
        turn = turn + rng.normal(0, 1e-4) if stamp_s < 12 else 0.005 * np.cos(3 * stamp_s)
        check.add_turn(stamp_s, float(turn))
        check.is_final = is_final and stamp_s > 10
    assert check.is_trusted is is_final
    assert bool(check.warnings) is not is_final


@pytest.mark.parametrize("slope", [0.6, pytest.param(1.0, marks=pytest.mark.slow)])
def test_wheels_that_slip_in_every_turn_do_not_condemn_it(slope: float) -> None:
    """As those of a skid-steered robot, whose track is given as it is measured: never twice alike."""
    for seed in range(3):
        check, trusted = checked(slope=slope, scatter=0.1, seed=seed)
        assert check.is_trusted
        assert trusted
        assert check.warnings == ()


def test_a_factor_that_is_always_the_same_is_no_slip() -> None:
    check, trusted = checked(slope=0.6)
    assert not trusted
    assert "0.6" in check.problem


def test_wheels_that_spin_for_some_seconds_do_not_condemn_it() -> None:
    def spun(stamps: np.ndarray, rates: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        return stamps, rates - np.where((stamps > 15) & (stamps < 19), 1.0, 0.0)

    check, _ = checked(spun)  # it is the same to the check which of both does not tell of a turn
    assert check.is_trusted
    assert check.problem == ""


def test_one_that_rests_at_a_number_while_the_wheels_rest_is_not_stuck() -> None:
    """Many show exactly nothing below some rate."""
    check, trusted = checked(lambda stamps, rates: (stamps, np.where(np.abs(rates - 0.02) < 0.04, 0.0, rates)))
    assert trusted
    assert check.problem == ""


def test_without_wheels_or_without_it_there_is_nothing_to_say() -> None:
    check = GyroCheck()
    check.add_rate(0.0, 1.0)
    assert check.warnings == ()
    check = GyroCheck()
    check.add_turn(0.0, 1.0)
    assert check.warnings == ()
    assert check.readings == 0


@pytest.mark.parametrize(("stamp_s", "rate"), [(np.nan, 0.1), (1.0, np.nan), (1.0, np.inf), (np.inf, 0.1)])
def test_a_reading_that_is_no_number_is_none(stamp_s: float, rate: float) -> None:
    check = GyroCheck()
    check.add_rate(stamp_s, rate)
    assert check.readings == 0


def test_a_refused_step_of_the_wheels_is_not_compared() -> None:
    """Its turn is not known; as when a clock runs backwards."""
    check = GyroCheck()
    for i in range(2000):
        check.add_rate(0.01 * i, 0.5 * np.sin(0.01 * i))
        if i % 2 == 0:
            check.add_turn(0.01 * i, 9.0, is_sound=False)
    assert not check.is_trusted
    assert check.problem == ""


def test_the_line_is_the_one_that_was_drawn_whatever_lies_far_off(rng: np.random.Generator) -> None:
    wheels = rng.uniform(-0.6, 0.6, 200)
    gyro = 0.9 * wheels + 0.03 + rng.normal(0, 0.01, 200)
    gyro[::10] += 2.0
    line = RateLine.through(wheels, gyro)
    assert line.slope == pytest.approx(0.9, abs=0.02)
    assert line.bias_rad_s == pytest.approx(0.03, abs=0.01)
    assert line.sigma < 0.02
    assert line.share > 0.8
