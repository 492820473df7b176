"""How quick dead reckoning is, over a whole log and reading by reading."""

from __future__ import annotations

import statistics
import time
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from wheelsight.core.calibration_parts import Wheels
from wheelsight.core.messages import WheelTicks
from wheelsight.wheels import WheelOdometry, integrate_log

_SAMPLES = 1_000_000
_UPDATES = 50_000
_WHEELS = Wheels(0.17, 0.17, 0.52, 3200.0, counter_bits=32)
_PERIOD_S = 0.02
_REPEATS = 7


@dataclass(frozen=True, slots=True)
class WheelTimes:
    """Medians over repeats.

    Attributes:
        samples: of the log.
        log_ms: all of them integrated with covariance, single-threaded.
        log_with_gyro_ms: the same with a yaw rate for each.
        update_us: one reading of a stream, from the event to the Estimate with its covariance.
    """

    samples: int
    log_ms: float
    log_with_gyro_ms: float
    update_us: float


def measure_wheels(samples: int = _SAMPLES, updates: int = _UPDATES) -> WheelTimes:
    """Time dead reckoning on a drive of random bends; compiled kernels are warmed first."""
    rng = np.random.default_rng(0)
    stamps_s = _PERIOD_S * np.arange(samples)
    left, right = np.cumsum(rng.integers(40, 100, (2, samples)), axis=1)
    rates_rad_s = rng.normal(0, 0.3, samples)

    def log_s(rates: np.ndarray | None) -> float:
        begin = time.perf_counter()
        integrate_log(_WHEELS, stamps_s, left, right, yaw_rates_rad_s=rates)
        return time.perf_counter() - begin

    readings = [WheelTicks(*r) for r in zip(*(a[:updates].tolist() for a in (stamps_s, left, right)), strict=True)]

    def update_s() -> float:
        process = WheelOdometry(_WHEELS).process
        begin = time.perf_counter()
        for reading in readings:
            process(reading)
        return (time.perf_counter() - begin) / len(readings)

    medians = [_median_s(lambda: log_s(None)), _median_s(lambda: log_s(rates_rad_s)), _median_s(update_s)]
    return WheelTimes(samples, 1e3 * medians[0], 1e3 * medians[1], 1e6 * medians[2])


def _median_s(measure: Callable[[], float]) -> float:
    measure()
    return statistics.median(measure() for _ in range(_REPEATS))
