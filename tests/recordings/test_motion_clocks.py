"""The turns of camera and wheels on the sample that ships, with the camera's clock set ahead."""

from __future__ import annotations

from dataclasses import replace

import pytest

from wheelsight.core.messages import Event, RgbdFrame
from wheelsight.io.recordings import Recording, open_recording
from wheelsight.io.recordings.clock_checks import MotionClock, MotionOffset

# The controller of the sample stamps its counts so long after the wheels stood so, as real ones do.
_LATENCY_S = 0.016


@pytest.fixture(scope="module")
def sample() -> tuple[Recording, list[Event]]:
    recording = open_recording("sample")
    return recording, list(recording.events())


def _found(sample: tuple[Recording, list[Event]], ahead_s: float, delay_s: float = 0.0) -> MotionOffset:
    recording, events = sample
    wheels = recording.calibration.wheels
    assert wheels is not None
    turns = MotionClock(replace(recording.calibration, wheels=replace(wheels, delay_s=delay_s)))
    for event in events:
        turns.add(replace(event, stamp_s=event.stamp_s + ahead_s) if isinstance(event, RgbdFrame) else event)
    return turns.offset()


@pytest.mark.parametrize("ahead_s", [0.1, 0.3, 1.0, -0.4, 2.5])
def test_a_clock_that_is_ahead_is_found(sample: tuple[Recording, list[Event]], ahead_s: float) -> None:
    found = _found(sample, ahead_s)
    assert found.offset_s == pytest.approx(ahead_s + _LATENCY_S, abs=0.005)
    assert found.is_apart


def test_latency_of_a_controller_is_no_other_clock(sample: tuple[Recording, list[Event]]) -> None:
    assert not _found(sample, 0.0).is_apart


def test_a_delay_that_is_calibrated_counts(sample: tuple[Recording, list[Event]]) -> None:
    found = _found(sample, 0.3, delay_s=-0.3)
    assert found.offset_s == pytest.approx(_LATENCY_S, abs=0.005)
