"""Pace: constant velocity, as long as it says something."""

from __future__ import annotations

import numpy as np
import pytest
from narrowing import not_none
from numpy.testing import assert_allclose

from wheelsight.core.geometry import se3
from wheelsight.vision.features.tracking import Pace

TWIST = np.array([0.4, -0.1, 0.05, 0.1, -0.3, 1.2])


def reported(*stamps_s: float) -> Pace:
    """Poses of a steady motion."""
    pace = Pace()
    for stamp_s in stamps_s:
        pace.add(stamp_s, se3.exp([1.0, 2.0, 3.0, 0.5, 0.0, -0.5]) @ se3.exp(TWIST * (stamp_s - 100.0)))
    return pace


@pytest.mark.parametrize("ahead_s", [0.01, 0.1, 0.3])
def test_it_goes_on_as_it_went(ahead_s: float) -> None:
    assert_allclose(not_none(reported(100.0, 100.1).expect(100.1 + ahead_s)), se3.exp(TWIST * ahead_s), atol=1e-12)


def test_nothing_is_expected_of_one_frame_nor_long_after_nor_before_the_last() -> None:
    assert Pace().expect(100.0) is None
    assert reported(100.0).expect(100.1) is None
    assert reported(100.0, 100.1).expect(100.6) is None
    assert reported(100.0, 100.1).expect(100.1) is None


def test_a_gap_shows_no_velocity() -> None:
    pace = reported(100.0, 100.1, 101.0)
    assert pace.expect(101.1) is None
    pace.add(101.1, se3.exp([1.0, 2.0, 3.0, 0.5, 0.0, -0.5]) @ se3.exp(TWIST * 1.1))
    assert_allclose(not_none(pace.expect(101.2)), se3.exp(TWIST * 0.1), atol=1e-12)
