from __future__ import annotations

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from wheelsight.app.run import words


@pytest.mark.parametrize(
    ("value", "text"),
    [(0.0, "0"), (0.0173, "0.0173"), (437.2, "437"), (1234.5, "1,234"), (-2.5, "-2.50"), (3e-12, "3.00e-12")],
)
def test_number(value: float, text: str) -> None:
    assert words.number(value) == text


@pytest.mark.parametrize(
    ("values", "unit", "head", "cells"),
    [
        ([0.00372, 0.253, None], "m", "error [cm]", ["0.372", "25.300", "–"]),
        ([0.00372, 0.00352], "m", "error [mm]", ["3.72", "3.52"]),
        ([12.3, 0.0042, math.nan], "m", "error [m]", ["12.3000", "0.0042", "unknown"]),
        ([0.0000605, 0.0129], "s", "error [ms]", ["0.0605", "12.9000"]),
        ([0.41, 12.0], "°", "error [°]", ["0.410", "12.000"]),
        ([0.0, 0.0], "m", "error [mm]", ["0.00", "0.00"]),
        ([None, None], "m", "error", ["–", "–"]),
        ([], "m", "error", []),
    ],
)
def test_a_column_has_one_unit(values: list[float | None], unit: str, head: str, cells: list[str]) -> None:
    assert words.column("error", values, unit) == (head, cells)


@given(st.lists(st.floats(1e-3, 1e4), min_size=1, max_size=9))
def test_cells_of_a_column_are_its_values_in_that_unit(values: list[float]) -> None:
    head, cells = words.column("way", values, "m")
    factor = {"mm": 1e3, "cm": 1e2, "m": 1.0, "km": 1e-3}[head.removeprefix("way [").removesuffix("]")]
    shown = [float(cell.replace(",", "")) / factor for cell in cells]
    assert shown == pytest.approx(values, rel=6e-3, abs=0.6e-4 / factor)


@given(st.floats(1e-9, 1e9))
def test_numbers_keep_three_digits(value: float) -> None:
    assert float(words.number(value).replace(",", "")) == pytest.approx(value, rel=5.1e-3)


@pytest.mark.parametrize("say", [words.number, words.length, words.duration, words.angle, words.percent])
@pytest.mark.parametrize("value", [None, math.nan, math.inf, -math.inf])
def test_what_is_not_known_says_so(say, value) -> None:
    assert say(value) == words.UNKNOWN


@pytest.mark.parametrize(
    ("metres", "text"),
    [
        (0.0, "0 m"),
        (0.00042, "0.420 mm"),
        (0.0173, "1.73 cm"),
        (5.26, "5.26 m"),
        (864.0, "864 m"),
        (12345.0, "12.3 km"),
    ],
)
def test_length(metres: float, text: str) -> None:
    assert words.length(metres) == text


@pytest.mark.parametrize(
    ("seconds", "text"),
    [(0.0, "0 s"), (0.0102, "10.2 ms"), (16.6, "16.6 s"), (133.0, "2 min 13 s"), (2269, "37 min 49 s")],
)
def test_duration(seconds: float, text: str) -> None:
    assert words.duration(seconds) == text


def test_only_the_whole_is_100_percent_and_only_nothing_is_0() -> None:
    shares = (0, 1e-5, 0.5, 0.874, 0.99999, 1)
    assert [words.percent(s) for s in shares] == ["0 %", "under 0.1 %", "50 %", "87.4 %", "over 99.9 %", "100 %"]


def test_count() -> None:
    said = [words.count(1, "frame"), words.count(1200, "frame"), words.count(0, "match", "matches")]
    assert said == ["1 frame", "1,200 frames", "0 matches"]
