"""Footprint: outlines against closed forms."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose

from wheelsight.core.errors import ArgumentError
from wheelsight.navigation import Footprint

CHAIR = Footprint.rectangle(0.85, 0.25, 0.6)


def test_a_rectangle_turns_about_its_axle() -> None:
    assert CHAIR.inscribed_m == pytest.approx(0.25)
    assert CHAIR.circumscribed_m == pytest.approx(np.hypot(0.85, 0.3))
    turned = CHAIR.at([1.0, 2.0, np.pi / 2])
    assert_allclose(sorted(map(tuple, turned.round(9))), [(0.7, 1.75), (0.7, 2.85), (1.3, 1.75), (1.3, 2.85)])


@given(st.floats(0.05, 2.0), st.floats(0.05, 2.0), st.floats(0.1, 2.0), st.floats(0.0, 0.5))
def test_padding_moves_each_side_out(front: float, back: float, width: float, margin: float) -> None:
    padded = Footprint.rectangle(front, back, width).padded(margin)
    same = Footprint.rectangle(front + margin, back + margin, width + 2 * margin)
    assert_allclose(
        padded.corners[np.lexsort(padded.corners.T.round(9))],
        same.corners[np.lexsort(same.corners.T.round(9))],
        atol=1e-9,
    )


def test_a_circle_is_covered_by_its_polygon() -> None:
    circle = Footprint.circle(0.3)
    assert circle.inscribed_m == pytest.approx(0.3)
    assert circle.circumscribed_m < 0.31


@given(st.floats(-1.5, 1.5), st.floats(-1.5, 1.5))
def test_inside_is_what_the_rectangle_says(x: float, y: float) -> None:
    assert CHAIR.contains([x, y]) == (-0.25 - 1e-12 <= x <= 0.85 + 1e-12 and abs(y) <= 0.3 + 1e-12)


def test_either_order_of_corners_is_the_same_outline() -> None:
    other = Footprint.of(CHAIR.corners[::-1])
    assert_allclose(other.corners[np.lexsort(other.corners.T)], CHAIR.corners[np.lexsort(CHAIR.corners.T)])


@pytest.mark.parametrize(
    ("corners", "problem"),
    [
        ([(0, 0), (1, 1)], "of shape"),
        ([(0, 0), (1, np.nan), (1, 1)], "of shape"),
        ([(-1, -1), (1, -1), (0, 0), (1, 1), (-1, 1)], "not convex"),
        ([(0.1, -1), (1, -1), (1, 1), (0.1, 1)], "outside"),
    ],
)
def test_what_is_no_footprint_is_refused(corners: list[tuple[float, float]], problem: str) -> None:
    with pytest.raises(ArgumentError, match=problem):
        Footprint.of(corners)
