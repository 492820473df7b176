from __future__ import annotations

import numpy as np
import pytest

from wheelsight.core.stamps import NUMBERS, SECONDS, UNITS, StampUnit, column_unit, unit_of

NAMES = {1e3: "milliseconds", 1e6: "microseconds", 1e9: "nanoseconds"}


@pytest.mark.parametrize("start_s", [0.0, 4711.0, 1.6e9], ids=["of this run", "since boot", "since 1970"])
@pytest.mark.parametrize("rate_hz", [2.0, 5.0, 15.0, 30.0, 50.0, 90.0, 200.0])
@pytest.mark.parametrize("per_second", [1e3, 1e6, 1e9])
def test_units_are_reported_whatever_the_epoch(start_s: float, rate_hz: float, per_second: float) -> None:
    stamps = np.rint(per_second * (start_s + np.arange(100) / rate_hz))
    found = unit_of(stamps)
    assert found is not None
    assert (found.name, found.per_second) == (NAMES[per_second], per_second)
    assert found in UNITS


@pytest.mark.parametrize("start_s", [0.0, 4711.0, 1.6e9], ids=["of this run", "since boot", "since 1970"])
@pytest.mark.parametrize("rate_hz", [0.5, 1.0, 7.5, 30.0, 100.0, 1000.0])
def test_seconds_are_seconds(start_s: float, rate_hz: float) -> None:
    assert unit_of(start_s + 0.123 + np.arange(100) / rate_hz) is None


def test_jitter_and_pauses_hide_no_unit(rng: np.random.Generator) -> None:
    stamps_s = np.arange(100) / 30 + rng.normal(0, 0.005, 100)
    stamps_s[50:] += 60.0
    assert unit_of(stamps_s) is None
    found = unit_of(1e3 * stamps_s)
    assert found is not None
    assert found.name == "milliseconds"


@pytest.mark.parametrize("first", [0, 1, 15, 100_000])
def test_numbers_are_reported_some_of_them_missing_or_not(first: int) -> None:
    numbers = first + np.arange(200)
    assert unit_of(numbers) is NUMBERS
    assert unit_of(np.delete(numbers, [3, 4, 50])) is NUMBERS
    assert unit_of(numbers[::2]) is NUMBERS
    assert unit_of(numbers + 0.25) is None


def test_whole_seconds_since_1970_are_no_numbers() -> None:
    assert unit_of(1_600_000_000 + np.arange(50)) is None


def test_of_few_stamps_nothing_is_said() -> None:
    assert unit_of([]) is None
    assert unit_of([0.0, 33.0, 66.0]) is None
    assert unit_of([np.nan, np.inf, 1.0, 2.0, 3.0]) is None


MS, US, NS = UNITS


@pytest.mark.parametrize(
    ("text", "unit"),
    [
        ("timestamp_ns,filename", NS),
        ("Time [ms]", MS),
        ("time in milliseconds file", MS),
        ("time (in us) file", US),
        ("t/µs;x", US),
        ("'stamp [s]';x", SECONDS),
        ("t_nsec", NS),
        ("timestamp filename", None),
        ("times", None),
        ("time_ms_of_camera", None),
        ("time s.png", None),
        ("stamp [minutes]", None),
        ("filename,stamp_ms", None),
    ],
)
def test_a_column_shows_its_unit_where_it_names_one(text: str, unit: StampUnit | None) -> None:
    assert column_unit(text) is unit
