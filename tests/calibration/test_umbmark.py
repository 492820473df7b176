from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from wheelsight.core.calibration_parts import Wheels
from wheelsight.core.errors import CalibrationError
from wheelsight.core.geometry import FloatArray
from wheelsight_calibration.squares import closed_form, corrected, umbmark

NOMINAL = Wheels(left_radius_m=0.17, right_radius_m=0.17, track_width_m=0.6, ticks_per_turn=3200)
SIDE_M = 4.0


def drive_square(true: Wheels, sense: int, nominal: Wheels = NOMINAL, steps: int = 400) -> FloatArray:
    """Where a robot ends (2,) that believes in `nominal` wheels and drives a square; sense 1 is counter-clockwise.

    Followed in many small straight steps, unlike the arcs of the code under test.
    """
    side_rad = np.array([SIDE_M / nominal.left_radius_m, SIDE_M / nominal.right_radius_m])
    corner_m = sense * np.pi / 4 * nominal.track_width_m
    corner_rad = np.array([-corner_m / nominal.left_radius_m, corner_m / nominal.right_radius_m])
    x = y = yaw = 0.0
    for left_rad, right_rad in (side_rad, corner_rad) * 4:
        left_m, right_m = left_rad * true.left_radius_m / steps, right_rad * true.right_radius_m / steps
        for _ in range(steps):
            turn = (right_m - left_m) / true.track_width_m
            x += (left_m + right_m) / 2 * np.cos(yaw + turn / 2)
            y += (left_m + right_m) / 2 * np.sin(yaw + turn / 2)
            yaw += turn
    return np.array([x, y])


def errors_of(true: Wheels, nominal: Wheels = NOMINAL) -> tuple[FloatArray, FloatArray]:
    return drive_square(true, -1, nominal)[None], drive_square(true, 1, nominal)[None]


@given(ratio=st.floats(0.99, 1.01), factor=st.floats(0.97, 1.03))
def test_injected_errors_are_found_exactly(ratio: float, factor: float) -> None:
    true = corrected(NOMINAL, ratio, factor)
    result = umbmark(NOMINAL, *errors_of(true), SIDE_M)
    assert result.diameter_ratio == pytest.approx(ratio, abs=1e-6)
    assert result.track_factor == pytest.approx(factor, abs=1e-6)
    assert result.wheels.right_radius_m == pytest.approx(true.right_radius_m, rel=1e-6)
    assert result.largest_error_after_m < 1e-4


@given(ratio=st.floats(0.998, 1.002), factor=st.floats(0.99, 1.01))
def test_the_papers_formulas_hold_to_a_tenth_of_small_errors(ratio: float, factor: float) -> None:
    E_d, E_b = closed_form(NOMINAL, *errors_of(corrected(NOMINAL, ratio, factor)), SIDE_M)
    largest = max(abs(ratio - 1), abs(factor - 1))
    assert E_d == pytest.approx(ratio, abs=0.1 * largest + 1e-6)
    assert E_b == pytest.approx(factor, abs=0.1 * largest + 1e-6)


def test_a_wide_track_bends_both_squares_outward() -> None:
    """Type A errors of the paper: too small turns move both end points by -2Lα in x, against each other in y."""
    alpha = np.pi / 2 * (1 - 1 / 1.005)
    clockwise, counter = errors_of(corrected(NOMINAL, 1.0, 1.005))
    expected = 2 * SIDE_M * alpha
    np.testing.assert_allclose(clockwise[0], [-expected, -expected], rtol=0.03)
    np.testing.assert_allclose(counter[0], [-expected, expected], rtol=0.03)


def test_the_mean_radius_stays() -> None:
    uneven = Wheels(0.171, 0.168, 0.6, 3200)
    after = corrected(uneven, 1.004, 1.0)
    assert after.left_radius_m + after.right_radius_m == pytest.approx(0.339)
    assert after.right_radius_m / after.left_radius_m == pytest.approx(1.004 * 0.168 / 0.171)


def test_wheels_of_known_unequal_size_are_corrected_too() -> None:
    uneven = Wheels(0.171, 0.168, 0.6, 3200)
    true = corrected(uneven, 1.004, 0.98)
    result = umbmark(uneven, *errors_of(true, uneven), SIDE_M)
    assert result.wheels.left_radius_m == pytest.approx(true.left_radius_m, rel=1e-6)
    assert result.wheels.track_width_m == pytest.approx(true.track_width_m, rel=1e-6)


def test_standard_deviations_are_those_of_repeated_trials(rng: np.random.Generator) -> None:
    ends = errors_of(corrected(NOMINAL, 1.003, 1.01))
    results = []
    for _ in range(200):
        clockwise_m, counter_clockwise_m = (end + 0.03 * rng.standard_normal((5, 2)) for end in ends)
        results.append(umbmark(NOMINAL, clockwise_m, counter_clockwise_m, SIDE_M))
    for name in ("diameter_ratio", "track_factor"):
        scatter = np.std([getattr(result, name) for result in results])
        stated = np.sqrt(np.mean([getattr(result, f"{name}_sigma") ** 2 for result in results]))
        assert scatter == pytest.approx(stated, rel=0.15)


def test_one_run_each_has_no_standard_deviation() -> None:
    result = umbmark(NOMINAL, [[-0.1, -0.1]], [[-0.1, 0.1]], SIDE_M)
    assert result.diameter_ratio_sigma is None
    assert result.largest_error_m == pytest.approx(np.hypot(0.1, 0.1))


@pytest.mark.parametrize(
    ("clockwise", "counter", "side_m", "reported"),
    [
        ([], [[0.0, 0.0]], 4.0, "there is no clockwise run"),
        ([[0.0, 0.0]], [], 4.0, "there is no counter-clockwise run"),
        ([[np.nan, 0.0]], [[0.0, 0.0]], 4.0, "not a finite number"),
        ([[-310.0, 120.0]], [[100.0, 90.0]], 4.0, "more than a side of 4 m"),
        ([[0.0, 0.0]], [[0.0, 0.0]], 0.0, "the squares' side is 0.0 m"),
        ([[0.0, 0.0]], [[0.0, 0.0]], 1e300, r"the squares' side is 1e\+300 m"),
    ],
)
def test_what_is_no_square_is_refused(clockwise: object, counter: object, side_m: float, reported: str) -> None:
    with pytest.raises(CalibrationError, match=reported):
        umbmark(NOMINAL, clockwise, counter, side_m)  # type: ignore[arg-type]
