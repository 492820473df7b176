from __future__ import annotations

import json
import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from wheelsight.core.errors import EvaluationError
from wheelsight.evaluation import Statistics


def test_of_three_errors_by_hand() -> None:
    s = Statistics.of([1.0, 2.0, 6.0])
    assert (s.mean, s.median, s.min, s.max, s.count) == (3.0, 2.0, 1.0, 6.0, 3)
    assert s.rmse == pytest.approx(math.sqrt(41 / 3))
    assert s.std == pytest.approx(math.sqrt(14 / 3))


@given(st.lists(st.floats(0, 1e3), min_size=1))
def test_mean_square_is_mean_squared_and_variance(errors: list[float]) -> None:
    s = Statistics.of(errors)
    assert s.rmse**2 == pytest.approx(s.mean**2 + s.std**2, rel=1e-9, abs=1e-12)
    assert s.min <= s.median <= s.max


def test_in_degrees_keeps_the_count() -> None:
    s = Statistics.of([math.pi, math.pi / 2]).in_degrees()
    assert (s.max, s.min, s.mean, s.median, s.count) == pytest.approx((180, 90, 135, 135, 2))


def test_goes_into_json() -> None:
    assert json.loads(json.dumps(Statistics.of([3]).to_dict()))["rmse"] == 3


@pytest.mark.parametrize("errors", [[], [1.0, math.nan], [math.inf]])
def test_refuses_errors_that_are_none(errors: list[float]) -> None:
    with pytest.raises(EvaluationError, match="finite"):
        Statistics.of(errors)
