from __future__ import annotations

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from wheelsight.pipeline import words


@pytest.mark.parametrize(
    ("value", "text"),
    [(0.0, "0"), (0.0173, "0.0173"), (437.2, "437"), (1234.5, "1,234"), (-2.5, "-2.50"), (3e-12, "3.00e-12")],
)
def test_number(value: float, text: str) -> None:
    assert words.number(value) == text


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
