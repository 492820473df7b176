"""The controller's clock against simulated transports whose delays are known."""

from __future__ import annotations

import numpy as np
import pytest

from wheelsight.io.devices.host_clock import ClockMap

PERIOD_S = 0.02


def jittery(count: int, rng: np.random.Generator) -> np.ndarray:
    """Delays as of a USB adapter on a busy machine: waiting for the millisecond, queues, and now and then a stall."""
    delays_s = 0.001 * rng.random(count) + rng.exponential(0.0015, count)
    stalls = rng.random(count) < 0.01
    return delays_s + stalls * rng.uniform(0.01, 0.2, count)


def arrivals(clock_s: np.ndarray, drift_ppm: float, delays_s: np.ndarray, offset_s: float = 1e9) -> np.ndarray:
    """Arrivals in order at a host; the controller's clock runs `drift_ppm` fast."""
    sent_s = offset_s + clock_s / (1 + 1e-6 * drift_ppm)
    return np.maximum.accumulate(sent_s + delays_s)


def mapped(clock: ClockMap, clock_s: np.ndarray, arrival_s: np.ndarray) -> np.ndarray:
    stamps = []
    for c, h in zip(clock_s.tolist(), arrival_s.tolist(), strict=True):
        clock.update(c, h)
        stamps.append(clock.stamp_s(c))
    return np.array(stamps)


@pytest.mark.parametrize("drift_ppm", [-200.0, -20.0, 0.0, 50.0, 200.0])
def test_offset_and_drift_are_found_beneath_the_jitter(drift_ppm: float, rng: np.random.Generator) -> None:
    clock_s = 5.0 + PERIOD_S * np.arange(6000)
    clock = ClockMap()
    delays_s = jittery(len(clock_s), rng)
    stamps_s = mapped(clock, clock_s, arrivals(clock_s, drift_ppm, delays_s))
    errors_s = stamps_s - (1e9 + clock_s / (1 + 1e-6 * drift_ppm))
    assert clock.drift_ppm == pytest.approx(drift_ppm, abs=3)
    assert np.abs(errors_s[500:]).max() < 0.0005
    assert np.abs(errors_s[50:]).max() < 0.0015  # after a second
    assert errors_s[500:].std() < 0.1 * delays_s.std()
    assert np.all(np.diff(stamps_s) > 0)


def test_a_first_frame_that_came_late_is_forgotten_without_a_stamp_running_back() -> None:
    clock_s = PERIOD_S * np.arange(200)
    delays_s = np.zeros(200)
    delays_s[0] = 0.3
    sent_s = 1e9 + clock_s
    stamps_s = mapped(ClockMap(), clock_s, sent_s + delays_s)
    assert np.all(np.diff(stamps_s) >= 0.49 * PERIOD_S)
    np.testing.assert_allclose(stamps_s[60:], sent_s[60:], atol=1e-6)


def test_a_stall_of_the_host_moves_no_stamp() -> None:
    clock_s = PERIOD_S * np.arange(3000)
    sent_s = 1e9 + clock_s
    arrival_s = sent_s.copy()
    stalled = (clock_s > 30) & (clock_s < 34)
    arrival_s[stalled] = 1e9 + 34
    stamps_s = mapped(ClockMap(), clock_s, arrival_s)
    np.testing.assert_allclose(stamps_s, sent_s, atol=1e-6)


def test_a_drift_that_changes_is_followed(rng: np.random.Generator) -> None:
    """A controller that warms up: from 0 to 100 ppm; the map is of the last minute."""
    clock_s = PERIOD_S * np.arange(15_000)
    rate = 1 + 1e-4 * np.clip(clock_s / 100, 0, 1)
    sent_s = 1e9 + np.concatenate([[0], np.cumsum(PERIOD_S / rate[1:])])
    clock = ClockMap()
    stamps_s = mapped(clock, clock_s, sent_s + rng.exponential(0.001, len(clock_s)))
    assert clock.drift_ppm == pytest.approx(100, abs=3)
    assert np.abs(stamps_s - sent_s)[500:].max() < 0.002


def test_after_a_restart_the_old_clock_is_forgotten() -> None:
    clock = ClockMap()
    mapped(clock, np.arange(0, 100, 0.02), 50 + np.arange(0, 100, 0.02))
    before_s = clock.stamp_s(100.0)
    clock.restart()
    clock.update(0.02, 151.0)
    assert clock.stamp_s(0.02) == pytest.approx(151.0)
    assert clock.stamp_s(0.02) > before_s
    assert clock.drift_ppm == 0
