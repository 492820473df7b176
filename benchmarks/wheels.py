"""`python -m benchmarks.wheels`: how quick dead reckoning is, over a whole log and reading by reading."""

from __future__ import annotations

import statistics
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from benchmarks import machine
from wheelsight.calibration import Wheels
from wheelsight.events import WheelTicks
from wheelsight.odometry.wheels import WheelOdometry, integrate_log

LOG_SAMPLES = 1_000_000
LOG_LIMIT_MS = 100.0
UPDATES = 50_000
UPDATE_LIMIT_US = 10.0
_WHEELS = Wheels(0.17, 0.17, 0.52, 3200.0, counter_bits=32)
_PERIOD_S = 0.02
_REPEATS = 7


@dataclass(frozen=True, slots=True)
class WheelTimes:
    """Medians over repeats.

    Attributes:
        log_ms: a million samples with covariance, single-threaded.
        log_with_gyro_ms: the same with a yaw rate for each.
        update_us: one reading of a stream, from the event to the Estimate with its covariance.
    """

    log_ms: float
    log_with_gyro_ms: float
    update_us: float


def measure_wheels() -> WheelTimes:
    """Time dead reckoning on a drive of random bends; compiled kernels are warmed first."""
    rng = np.random.default_rng(0)
    stamps_s = _PERIOD_S * np.arange(LOG_SAMPLES)
    left, right = np.cumsum(rng.integers(40, 100, (2, LOG_SAMPLES)), axis=1)
    rates_rad_s = rng.normal(0, 0.3, LOG_SAMPLES)

    def log_s(rates: np.ndarray | None) -> float:
        begin = time.perf_counter()
        integrate_log(_WHEELS, stamps_s, left, right, yaw_rates_rad_s=rates)
        return time.perf_counter() - begin

    readings = [WheelTicks(*r) for r in zip(*(a[:UPDATES].tolist() for a in (stamps_s, left, right)), strict=True)]

    def update_s() -> float:
        process = WheelOdometry(_WHEELS).process
        begin = time.perf_counter()
        for reading in readings:
            process(reading)
        return (time.perf_counter() - begin) / len(readings)

    medians = [_median_s(lambda: log_s(None)), _median_s(lambda: log_s(rates_rad_s)), _median_s(update_s)]
    return WheelTimes(1e3 * medians[0], 1e3 * medians[1], 1e6 * medians[2])


def _median_s(measure: Callable[[], float]) -> float:
    measure()
    return statistics.median(measure() for _ in range(_REPEATS))


def main() -> int:
    """Print the times beside their limits; 0 if all are met, else 1."""
    times = measure_wheels()
    rows = (
        ("1,000,000 samples with covariance", times.log_ms, LOG_LIMIT_MS, "ms"),
        ("the same with a gyroscope", times.log_with_gyro_ms, LOG_LIMIT_MS, "ms"),
        ("one reading of a stream, to its Estimate", times.update_us, UPDATE_LIMIT_US, "µs"),
    )
    print(", ".join(f"{name}: {value}" for name, value in machine.description().items()))
    for what, measured, limit, unit in rows:
        print(f"{what:42} {measured:8.1f} {unit}   limit {limit:g} {unit}")
    return 0 if all(measured < limit for _, measured, limit, _ in rows) else 1


if __name__ == "__main__":
    sys.exit(main())
