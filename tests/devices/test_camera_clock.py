"""CameraClock: stamps of simulated clocks and delays are as right as they say."""

from __future__ import annotations

import numpy as np
import pytest

from wheelsight.core.settings import LiveCameraSettings
from wheelsight.io.devices.host_clock import CameraClock

SETTINGS = LiveCameraSettings()


def delays(kind: str, count: int, rng: np.random.Generator) -> np.ndarray:
    """Of a transport, beyond its smallest one."""
    if kind == "exponential":
        return rng.exponential(0.003, count)
    if kind == "several":  # two queues: seldom is neither busy
        return rng.gamma(2.0, 0.002, count)
    return np.where(rng.random(count) < 0.05, rng.uniform(0.02, 0.2, count), rng.uniform(0, 0.002, count))


@pytest.mark.parametrize("kind", ["exponential", "several", "bursts"])
@pytest.mark.parametrize("drift_ppm", [-80.0, 0.0, 80.0])
def test_stamps_err_by_as_much_as_they_say(kind: str, drift_ppm: float, rng: np.random.Generator) -> None:
    ratios = []
    for _ in range(10):
        clock = CameraClock(SETTINGS)
        taken_s = np.cumsum(np.full(900, 1 / 30))
        device_s = 5.0 + taken_s * (1 + drift_ppm * 1e-6)
        for index, delay_s in enumerate(delays(kind, len(taken_s), rng)):
            stamp_s, sigma_s = clock.stamp(float(device_s[index]), 1e9 + float(taken_s[index] + delay_s))
            if index % 90 == 89:
                ratios.append((stamp_s - 1e9 - taken_s[index]) / sigma_s)
        assert clock.jumps == 0
    assert np.mean(np.abs(ratios) < 3) >= 0.99
    assert np.mean(np.abs(ratios)) > 0.02  # an honest figure, not one that fits everything


def test_the_uncertainty_falls_from_a_period_to_under_a_millisecond(rng: np.random.Generator) -> None:
    clock, sigmas = CameraClock(SETTINGS), []
    for number, delay_s in enumerate(delays("exponential", 900, rng)):
        sigmas.append(clock.stamp(number / 30, 100 + number / 30 + float(delay_s))[1])
    assert sigmas[0] == pytest.approx(1 / 30)
    assert sigmas[-1] < 1e-3


def test_a_host_that_was_busy_is_no_leap_of_the_clock() -> None:
    """For a second frames wait in the library, then all come at once, stamped as they were taken."""
    clock = CameraClock(SETTINGS)
    for number in range(300):
        taken_s = number / 30
        arrival_s = 6.0 if 5.0 < taken_s < 6.0 else taken_s
        stamp_s, _ = clock.stamp(taken_s, arrival_s + 0.001)
        if number > 60:
            assert stamp_s == pytest.approx(taken_s + 0.001, abs=2e-3)
    assert clock.jumps == 0


def test_a_clock_that_is_set_back_by_less_than_frames_take_is_found_out() -> None:
    """Stamps grow, but lag from then on: after two seconds they are mapped again."""
    clock = CameraClock(SETTINGS)
    for number in range(300):
        stamp_s, _ = clock.stamp(100 + number / 30, 10 + number / 30)
    for number in range(300, 500):
        stamp_s, _ = clock.stamp(100 + number / 30 - 1.0 + (number - 300) * 1e-9, 11 + number / 30)
    assert clock.jumps == 1
    assert stamp_s == pytest.approx(11 + 499 / 30, abs=1e-3)


def test_without_a_clock_arrivals_are_the_stamps() -> None:
    clock = CameraClock(SETTINGS)
    assert [clock.stamp(None, arrival_s)[0] for arrival_s in (5.0, 5.1, 5.1)] == pytest.approx([5.0, 5.1, 5.1])
    assert clock.stamp(None, 6.0)[1] == pytest.approx(1 / 30)
