"""Quantiles of chi-square: what squares of errors stay below, where their covariance is right."""

from __future__ import annotations

from functools import cache

from scipy.special import gammaincinv


@cache
def quantile(share: float, degrees: int) -> float:
    """What the squares of so many standard normal numbers together stay below, in so large a share of cases."""
    # As scipy.stats.chi2.ppf; scipy.stats takes a third of a second to load.
    return float(2 * gammaincinv(degrees / 2, share))
