"""Wheel readings whose stamps tell of no time between them, beside a camera: joined is no worse for having wheels."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from localizer.joined_drives import CALIBRATION, WHEELS, Drive, answers_to, drive, joined, of_frames, off_m

from wheelsight.estimates import Reason
from wheelsight.events import Event, WheelTicks
from wheelsight.simulation.clock_faults import ClockFault, ReadingsStalled, ReadingsTogether


@pytest.fixture
def made() -> Drive:
    return drive()


@pytest.mark.parametrize("apart_s", [1e-6, 1e-4, 1e-3, 5e-3])
def test_readings_that_arrive_together_cost_no_accuracy(
    monkeypatch: pytest.MonkeyPatch, made: Drive, apart_s: float
) -> None:
    assert worst_m(monkeypatch, made, ReadingsTogether(apart_s=apart_s)) < 0.03


@pytest.mark.parametrize("seed", range(3))
def test_a_busy_host_that_reads_several_at_once_leaves_the_pose_near(
    monkeypatch: pytest.MonkeyPatch, made: Drive, seed: int
) -> None:
    assert worst_m(monkeypatch, made, ReadingsStalled(seed=seed)) < 0.2


def test_with_all_readings_refused_the_camera_leads(monkeypatch: pytest.MonkeyPatch, made: Drive) -> None:
    narrow = replace(CALIBRATION, wheels=replace(WHEELS, counter_bits=8))
    subject, _ = joined(monkeypatch, made.eye(), calibration=narrow)
    answers = answers_to(subject, [rolled_over(event) for event in made.events()])
    readings = [answer for event, answer in answers if isinstance(event, WheelTicks)]
    assert {answer.reason for answer in readings[1:]} == {Reason.COUNTER_AMBIGUOUS}
    assert max(off_m(answer, made.truth) for answer in of_frames(answers)) < 0.03


def worst_m(monkeypatch: pytest.MonkeyPatch, made: Drive, fault: ClockFault) -> float:
    subject, _ = joined(monkeypatch, made.eye())
    off = [off_m(answer, made.truth) for answer in of_frames(answers_to(subject, fault.apply(made.events())))]
    assert np.isfinite(off).all()
    return max(off)


def rolled_over(event: Event) -> Event:
    return replace(event, left=event.left % 256, right=event.right % 256) if isinstance(event, WheelTicks) else event
