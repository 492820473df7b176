"""Quantiles of chi-square, against closed forms and scipy's distribution function."""

from __future__ import annotations

import math

import pytest
from scipy.special import chdtr

from wheelsight.core.geometry.chi_square import quantile


@pytest.mark.parametrize("share", [0.01, 0.5, 0.95, 0.9999])
def test_of_two_degrees_it_is_a_logarithm(share: float) -> None:
    assert quantile(share, 2) == pytest.approx(-2 * math.log(1 - share))


def test_of_one_degree_it_is_the_square_of_a_normal_number() -> None:
    assert quantile(math.erf(3 / math.sqrt(2)), 1) == pytest.approx(9.0)


@pytest.mark.parametrize("degrees", [1, 2, 3, 6])
def test_so_large_a_share_lies_below(degrees: int) -> None:
    assert chdtr(degrees, quantile(0.99, degrees)) == pytest.approx(0.99)
