"""What camera_clock.csv shows in figures: offset, drift, σ, arrival, and numbers that are missing."""

from __future__ import annotations

import pytest

from wheelsight.io.recordings.inspection import clock_mapping
from wheelsight.io.recordings.native import FrameClock

PERIOD_S, OFFSET_S = 1 / 30, 1000.0


def clocks(count: int, drift: float = 0.0, late_s: float = 0.02, missing: tuple[int, ...] = ()) -> list[FrameClock]:
    """Of a camera whose clock begins `OFFSET_S` before the host's and runs faster by a share."""
    made = []
    for number in (number for number in range(count) if number not in missing):
        stamp_s = OFFSET_S + number * PERIOD_S
        sigma_s = 0.001 / (1 + number)
        made.append(FrameClock(stamp_s, sigma_s, stamp_s + late_s, number * PERIOD_S * (1 + drift), number))
    return made


def test_a_mapping_is_reported_by_its_offset_and_drift() -> None:
    found = clock_mapping(clocks(301, drift=40e-6))
    assert found is not None
    assert found.frames == 301
    assert found.offset_s == pytest.approx(OFFSET_S)
    assert found.drift_ppm == pytest.approx(40, abs=0.1)
    assert found.sigma_largest_s == pytest.approx(0.001)
    assert found.sigma_median_s == pytest.approx(0.001 / 151)
    assert (found.arrival_median_s, found.arrival_p95_s) == pytest.approx((0.02, 0.02))
    assert found.missing == 0


def test_numbers_that_never_came_are_counted_and_those_that_begin_again_are_not() -> None:
    first = clocks(20, missing=(5, 6, 11))
    again = [FrameClock(c.stamp_s + 10, c.stamp_sigma_s, c.arrived_s + 10, c.device_s, c.sequence) for c in clocks(5)]
    found = clock_mapping([*first, *again])
    assert found is not None
    assert found.missing == 3


def test_a_clock_that_leaps_leaves_the_drift_as_it_is() -> None:
    before, after = clocks(100, drift=20e-6), clocks(140, drift=20e-6)[100:]
    leapt = [FrameClock(c.stamp_s, c.stamp_sigma_s, c.arrived_s, (c.device_s or 0) + 5, c.sequence) for c in after]
    found = clock_mapping([*before, *leapt])
    assert found is not None
    assert found.drift_ppm == pytest.approx(20, abs=1)


def test_a_camera_without_a_clock_has_no_offset() -> None:
    found = clock_mapping([FrameClock(1.0, 0.03, 1.0), FrameClock(1.03, 0.03, 1.03)])
    assert found is not None
    assert (found.offset_s, found.drift_ppm, found.missing) == (None, None, 0)
    assert clock_mapping([]) is None
