from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from run_example import START_S, empty_run, example_run

from wheelsight.core.estimates import Status
from wheelsight_report import drawing as series

lines = arrays(float, st.integers(1, 400), elements=st.one_of(st.floats(-1e6, 1e6), st.just(np.nan)))


@given(lines, st.integers(30, 90))
def test_thinning_keeps_ends_and_peaks(values: np.ndarray, limit: int) -> None:
    kept = series.keep_peaks(values, limit)
    assert (np.diff(kept) > 0).all()
    assert len(kept) <= max(limit + 2, 0) or len(values) <= limit
    assert {0, len(values) - 1} <= set(kept.tolist())
    if not np.isnan(values).all():
        assert np.nanmax(values[kept]) == np.nanmax(values)
        assert np.nanmin(values[kept]) == np.nanmin(values)
    assert np.isnan(values[kept]).any() == np.isnan(values).any()


def test_thinning_keeps_every_long_gap() -> None:
    values = np.arange(20_000.0)
    values[5_000:5_100] = values[12_000:12_050] = np.nan
    gaps = np.isnan(values[series.keep_peaks(values)])
    assert np.count_nonzero(np.diff(gaps.astype(int)) == 1) == 2


def test_a_thinned_path_keeps_its_gaps_and_ends() -> None:
    path = np.random.default_rng(0).normal(size=(20_000, 2)).cumsum(axis=0)
    path[7_777] = path[15_000:15_003] = np.nan
    kept = series.keep_shape(path, 1000)
    assert len(kept) <= 1000 + 3 * 4
    assert {0, 7_776, 7_777, 7_778, 14_999, 15_000, 15_003, 19_999} <= set(kept.tolist())


def test_gaps_are_put_where_a_break_lies_between() -> None:
    x, y = series.with_gaps(np.array([0.0, 1, 2, 3]), np.array([10.0, 11, 12, 13]), np.array([-1.0, 1.4, 1.6, 9]))
    np.testing.assert_array_equal(y, [10, 11, np.nan, 12, 13])
    assert x[2] == 1.5


@pytest.mark.parametrize("n", [0, 1])
def test_nothing_to_break(n: int) -> None:
    x, y = series.with_gaps(np.zeros(n), np.zeros((n, 3)), np.array([0.5]))
    assert x.shape == (n,)
    assert y.shape == (n, 3)


def test_lone_values_are_those_a_line_would_not_show() -> None:
    nan = np.nan
    assert series.alone(np.array([1, nan, 2, 3, nan, 4])).tolist() == [True, False, False, False, False, True]
    assert series.alone(np.array([5.0])).tolist() == [True]
    assert series.alone(np.zeros(0)).tolist() == []


def test_frames_without_a_pose() -> None:
    run = example_run(200)
    expected = [f.stamp_s for f in run.frames if f.status is not Status.TRACKING or f.is_skipped]
    np.testing.assert_array_equal(series.poseless_stamps_s(run), expected)
    assert len(series.poseless_stamps_s(empty_run(7))) == 7
    assert series.poseless_stamps_s(empty_run(1))[0] == START_S
