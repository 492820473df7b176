"""Stamps as robots' are, beside a camera: joined is no worse for having wheels, and never sure where it is wrong."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from grids import mostly_slow
from localizer.joined_drives import (
    CALIBRATION,
    WHEELS,
    answers_to,
    drive,
    eye_by_index,
    joined,
    of_frames,
    off_m,
    spread_m,
)

from benchmarks.clock_faults import ClockFault, ClockLeaps, ReadingsJitter, ReadingsStalled, ReadingsTogether, Sensors
from wheelsight.core.estimates import Reason, Status
from wheelsight.core.geometry import FloatArray
from wheelsight.core.messages import Event, RgbdFrame, WheelTicks
from wheelsight.estimation import FusedEstimate

SEEDS, FEW_SEEDS = (
    pytest.mark.parametrize("seed", [0, *(pytest.param(seed, marks=pytest.mark.slow) for seed in range(1, count))])
    for count in (3, 1)
)
AT_S = 102.0


@SEEDS
@pytest.mark.parametrize("apart_s", mostly_slow([1e-6, 1e-4, 1e-3, 5e-3], quick=[1e-6, 5e-3]))
def test_readings_that_arrive_together_cost_little_accuracy(
    monkeypatch: pytest.MonkeyPatch, apart_s: float, seed: int
) -> None:
    # 0.036 since cameras' errors add up along the way (docs/decisions/filter); 0.02 before.
    assert worst_m(monkeypatch, lambda _: ReadingsTogether(apart_s=apart_s), seed) < 0.04


@SEEDS
@pytest.mark.parametrize("apart_s", [1e-6, 1e-3])
def test_a_busy_host_that_reads_several_at_once_costs_no_accuracy(
    monkeypatch: pytest.MonkeyPatch, apart_s: float, seed: int
) -> None:
    assert worst_m(monkeypatch, lambda n: ReadingsStalled(apart_s=apart_s, seed=n), seed) < 0.03


@SEEDS
def test_stamps_that_are_off_by_half_a_period_cost_little(monkeypatch: pytest.MonkeyPatch, seed: int) -> None:
    off = errors_m(monkeypatch, lambda n: ReadingsJitter(0.01, n), seed)
    assert np.sqrt(np.mean(off**2)) < 0.03  # 6 m, of which neither metre is known better than to 2 %


@FEW_SEEDS
@pytest.mark.parametrize("sensors", ["both", "wheels", "camera"])
@pytest.mark.parametrize("by_s", [60.0, *(pytest.param(by_s, marks=pytest.mark.slow) for by_s in (-60.0, 1.6e9, 0.5))])
def test_a_clock_that_leaps_is_mapped_and_reported(
    monkeypatch: pytest.MonkeyPatch, by_s: float, sensors: Sensors, seed: int
) -> None:
    made = drive(seed=seed)
    subject, _ = joined(monkeypatch, eye_by_index(made))
    events = ClockLeaps(AT_S, by_s, sensors).apply(made.events())
    true_s = {id(now): before.stamp_s for before, now in zip(made.events(), events, strict=True)}
    answers = answers_to(subject, events)
    heard = [(true_s[id(e)], a) for e, a in answers if isinstance(e, RgbdFrame) and a.reason is not Reason.CLOCKS_APART]
    assert len(heard) > len(of_frames(answers)) - 6
    assert max(off_m(answer, made.truth, stamp_s) for stamp_s, answer in heard) < 0.02
    assert {answer.status for stamp_s, answer in heard if stamp_s > AT_S + 0.5} == {Status.TRACKING}
    if by_s != 0.5 or sensors != "both":  # so short a leap of all is a gap like any other
        assert "leapt by" in subject.warnings[0]


@SEEDS
@pytest.mark.parametrize("missing_s", [0.1, 1.0, 1.5])
def test_a_host_that_sleeps_while_the_robot_moves_is_put_right_by_the_camera(
    monkeypatch: pytest.MonkeyPatch, missing_s: float, seed: int
) -> None:
    made = drive(seed=seed)
    subject, _ = joined(monkeypatch, eye_by_index(made))
    events = ClockLeaps(AT_S + missing_s, 300.0, "both", missing_s).apply(made.events())
    answers = [(e.stamp_s, a) for e, a in answers_to(subject, events) if isinstance(e, RgbdFrame)]
    asleep = [answer for _, answer in answers if answer.reason is Reason.CLOCKS_APART]
    assert all(answer.status is Status.COASTING for answer in asleep)
    after = [(stamp_s - 300, a) for stamp_s, a in answers if stamp_s > 300 + AT_S and a not in asleep]
    assert all(is_honest(a, off_m(a, made.truth, stamp_s)) for stamp_s, a in after)
    assert max(off_m(a, made.truth, stamp_s) for stamp_s, a in after[8:]) < 0.03


def test_with_all_readings_refused_the_camera_leads(monkeypatch: pytest.MonkeyPatch) -> None:
    narrow, made = replace(CALIBRATION, wheels=replace(WHEELS, counter_bits=8)), drive()
    subject, _ = joined(monkeypatch, made.eye(), calibration=narrow)
    answers = answers_to(subject, [rolled_over(event) for event in made.events()])
    readings = [answer for event, answer in answers if isinstance(event, WheelTicks)]
    assert {answer.reason for answer in readings[1:]} == {Reason.COUNTER_AMBIGUOUS}
    assert max(off_m(answer, made.truth) for answer in of_frames(answers)) < 0.03


def worst_m(monkeypatch: pytest.MonkeyPatch, fault_of: Callable[[int], ClockFault], seed: int) -> float:
    return float(errors_m(monkeypatch, fault_of, seed).max())


def errors_m(monkeypatch: pytest.MonkeyPatch, fault_of: Callable[[int], ClockFault], seed: int) -> FloatArray:
    """At the frames of a drive with a fault, hardly any of which is farther off than its covariance says.

    Of a position in the plane, 1.1 % is beyond three standard deviations by chance.
    """
    made = drive(seed=seed)
    subject, _ = joined(monkeypatch, made.eye())
    answers = of_frames(answers_to(subject, fault_of(seed).apply(made.events())))
    off = np.array([off_m(answer, made.truth) for answer in answers])
    assert np.isfinite(off).all()
    honest = [is_honest(answer, error) for answer, error in zip(answers, off, strict=True)]
    assert np.mean(honest) > 0.98
    return off


def is_honest(answer: FusedEstimate, error_m: float) -> bool:
    return answer.status is not Status.TRACKING or error_m < 3 * spread_m(answer) + 0.001


def rolled_over(event: Event) -> Event:
    return replace(event, left=event.left % 256, right=event.right % 256) if isinstance(event, WheelTicks) else event
