"""What camera_clock.csv tells of a recording as a whole: how the camera's clock was mapped, and how surely."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from wheelsight.recordings.frame_clocks import FrameClock


@dataclass(frozen=True, slots=True)
class ClockMapping:
    """Of a live camera's clock to the host's, over a recording.

    Attributes:
        frames: how many tell of it.
        offset_s: host time less the camera's, at the first frame that has a stamp of the camera; None where none has.
        drift_ppm: how much faster than the host's the camera's clock ran, millionths; None for fewer than two frames.
        sigma_median_s, sigma_largest_s: standard deviation of the mapping.
        arrival_median_s, arrival_p95_s: from a frame's stamp until the host was handed it.
        missing: numbers that the camera gave and that never came.
    """

    frames: int
    offset_s: float | None
    drift_ppm: float | None
    sigma_median_s: float
    sigma_largest_s: float
    arrival_median_s: float
    arrival_p95_s: float
    missing: int


def clock_mapping(clocks: Sequence[FrameClock]) -> ClockMapping | None:
    """In figures; None where there is no frame."""
    if not clocks:
        return None
    sigmas_s = np.array([clock.stamp_sigma_s for clock in clocks])
    arrivals_s = np.array([clock.arrived_s - clock.stamp_s for clock in clocks])
    paired = [(clock.device_s, clock.stamp_s) for clock in clocks if clock.device_s is not None]
    numbers = [clock.sequence for clock in clocks if clock.sequence is not None]
    steps = np.diff(np.array(numbers, float))
    # A camera that was plugged in again numbers its frames anew: such a step tells of no missing ones.
    missing = int((steps[steps > 0] - 1).sum()) if len(steps) else 0
    return ClockMapping(
        frames=len(clocks),
        offset_s=paired[0][1] - paired[0][0] if paired else None,
        drift_ppm=_drift_ppm(np.array(paired, float).reshape(-1, 2)),
        sigma_median_s=float(np.median(sigmas_s)),
        sigma_largest_s=float(sigmas_s.max()),
        arrival_median_s=float(np.median(arrivals_s)),
        arrival_p95_s=float(np.percentile(arrivals_s, 95)),
        missing=missing,
    )


def _drift_ppm(paired_s: np.ndarray) -> float | None:
    """By the median of the slopes over a quarter of the stamps: a leap of the clock is in a third of them at most."""
    quarter = max(len(paired_s) // 4, 1)
    steps = paired_s[quarter:] - paired_s[:-quarter]
    steps = steps[steps[:, 1] > 0]
    return float(1e6 * np.median(steps[:, 0] / steps[:, 1] - 1)) if len(steps) else None
