from __future__ import annotations

from itertools import combinations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.optimize import linear_sum_assignment

from wheelsight.core.errors import InputError
from wheelsight.core.stamps import associate


def stamps(largest: int, max_size: int):
    """Sorted stamps on a grid of 1/64 s, so that sums of gaps are exact."""
    return st.lists(st.integers(0, largest), max_size=max_size).map(lambda ks: np.array(sorted(ks), float) / 64)


def brute_force(a, b, max_gap_s):
    """(pairs, sum of gaps) of the best pairing, by trying all."""
    for count in range(min(len(a), len(b)), 0, -1):
        sums = [
            np.abs(a[list(i)] - b[list(j)]).sum()
            for i in combinations(range(len(a)), count)
            for j in combinations(range(len(b)), count)
            if (np.abs(a[list(i)] - b[list(j)]) <= max_gap_s).all()
        ]
        if sums:
            return count, min(sums)
    return 0, 0.0


def check_valid(pairs, a, b, max_gap_s):
    assert pairs.shape == (len(pairs), 2)
    assert pairs.dtype == np.int64
    assert (np.diff(pairs, axis=0) > 0).all()
    assert (np.abs(a[pairs[:, 0]] - b[pairs[:, 1]]) <= max_gap_s).all()


@given(stamps(60, 5), stamps(60, 5), st.integers(0, 40))
def test_is_the_best_of_all_pairings(a, b, gap):
    pairs = associate(a, b, gap / 64)
    check_valid(pairs, a, b, gap / 64)
    assert (len(pairs), np.abs(a[pairs[:, 0]] - b[pairs[:, 1]]).sum()) == brute_force(a, b, gap / 64)


@given(stamps(300, 40), stamps(300, 40), st.integers(0, 60))
def test_agrees_with_the_assignment_of_scipy(a, b, gap):
    pairs = associate(a, b, gap / 64)
    check_valid(pairs, a, b, gap / 64)
    gaps = np.abs(a[:, None] - b)
    forbidden = 1e6
    cost = np.where(gaps <= gap / 64, gaps, forbidden)
    rows, columns = linear_sum_assignment(cost)
    kept = cost[rows, columns] < forbidden
    assert len(pairs) == kept.sum()
    assert np.abs(a[pairs[:, 0]] - b[pairs[:, 1]]).sum() == cost[rows, columns][kept].sum()


def test_prefers_two_pairs_to_one_nearer_pair():
    pairs = associate([0.0, 1.0], [0.9, 1.9], 1.0)
    np.testing.assert_array_equal(pairs, [[0, 0], [1, 1]])


def test_uses_each_stamp_once():
    np.testing.assert_array_equal(associate([1.0, 1.01, 1.02], [1.012], 0.1), [[1, 0]])


def test_a_gap_of_exactly_the_largest_counts():
    assert len(associate([0.0], [0.5], 0.5)) == 1
    assert len(associate([0.0], [0.5 + 1e-12], 0.5)) == 0


def test_large_epoch_stamps_lose_nothing_at_the_limit():
    a = 1305031229.0 + np.arange(50) / 32
    np.testing.assert_array_equal(associate(a, a + 1 / 64, 1 / 64), np.repeat(np.arange(50)[:, None], 2, axis=1))


@pytest.mark.parametrize(("a", "b"), [([], []), ([1.0], []), ([], [1.0])])
def test_nothing_to_pair(a, b):
    assert associate(a, b, 1.0).shape == (0, 2)


@pytest.mark.parametrize(
    ("a", "b", "gap"),
    [
        ([2.0, 1.0], [1.0], 1.0),
        ([1.0], [2.0, 1.0], 1.0),
        ([np.nan], [1.0], 1.0),
        ([1.0], [1.0], -1.0),
        ([1.0], [1.0], np.inf),
    ],
)
def test_refuses_what_it_cannot_pair(a, b, gap):
    with pytest.raises(InputError):
        associate(a, b, gap)


@pytest.mark.slow
@pytest.mark.timeout(100)
@pytest.mark.parametrize("offset_s", [0.001, 0.0166])
def test_a_hundred_thousand_stamps_with_jitter_and_drops_take_seconds_not_minutes(offset_s):
    rng = np.random.default_rng(0)
    clock = np.arange(100_000) / 30
    a = np.sort(clock + rng.normal(0, 0.002, clock.shape))[rng.random(clock.shape) > 0.01]
    b = np.sort(clock + offset_s + rng.normal(0, 0.002, clock.shape))[rng.random(clock.shape) > 0.01]
    pairs = associate(a, b, 0.02)
    check_valid(pairs, a, b, 0.02)
    assert len(pairs) > 90_000
