"""Splines as weights: lines stay lines, scipy's own values, and finer straight pieces of them."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.interpolate import CubicSpline

from wheelsight.core.geometry import PinholeCamera
from wheelsight_calibration.camera_model import cubic_grid_weights, cubic_weights, finer

KNOTS = np.linspace(0.5, 4.5, 9)


def test_weights_are_of_the_natural_spline_and_its_slope() -> None:
    values, at = np.sin(KNOTS), np.linspace(0.5, 4.5, 50)
    spline = CubicSpline(KNOTS, values, bc_type="natural")
    assert cubic_weights(at, KNOTS) @ values == pytest.approx(spline(at))
    assert cubic_weights(at, KNOTS, derivative=1) @ values == pytest.approx(spline(at, 1))
    assert cubic_weights(at, KNOTS) @ (3 * KNOTS - 1) == pytest.approx(3 * at - 1)


def test_beyond_the_last_knots_it_is_constant() -> None:
    values, beyond = np.sin(KNOTS), np.array([0.1, 6.0])
    assert cubic_weights(beyond, KNOTS) @ values == pytest.approx([values[0], values[-1]])
    assert cubic_weights(beyond, KNOTS, derivative=1) @ values == pytest.approx([0, 0])


def test_a_grid_of_weights_is_a_product_of_splines() -> None:
    camera = PinholeCamera(101, 81, 80.0, 80.0, 50.0, 40.0)
    px = np.array([[0.0, 0.0], [50.0, 40.0], [100.0, 80.0], [25.0, 20.0]])
    rows, columns = np.mgrid[0:5, 0:6]
    plane = (2.0 * rows + 3.0 * columns).ravel()
    expected = 2.0 * px[:, 1] / 20 + 3.0 * px[:, 0] / 20
    assert cubic_grid_weights(px, camera, (5, 6)) @ plane == pytest.approx(expected)


@pytest.mark.parametrize(("count", "most", "length"), [(9, 64, 25), (30, 64, 59), (64, 64, 64)])
def test_finer_values_go_through_the_knots_and_are_no_more_than_asked(count: int, most: int, length: int) -> None:
    values = np.sin(np.linspace(0, 5, count))
    found = finer(values, most)
    assert len(found) == length
    assert found[:: (length - 1) // (count - 1)] == pytest.approx(values)
    rows = finer(np.stack([values, 2 * values]), most, 1)
    assert rows == pytest.approx(np.stack([found, 2 * found]))
