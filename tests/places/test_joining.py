from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from wheelsight.core.geometry import se3
from wheelsight.core.keyframes import KeyframeId
from wheelsight.core.settings import PlaceVerificationSettings
from wheelsight.places.place_finder import distance_chi2, joined
from wheelsight.places.verification import VerifiedPlace

SETTINGS, CERTAIN = PlaceVerificationSettings(), np.zeros((6, 6))
T_FIRST_SECOND = se3.exp([0.4, -0.1, 0.2, 0.05, 0.3, -0.02])


def place(T: np.ndarray, own: np.ndarray, shared: np.ndarray, number: int = 0) -> VerifiedPlace:
    return VerifiedPlace(KeyframeId(number), T, own + shared, shared, np.zeros((0, 6)), 100, 30, 0.01)


def spread(rng: np.random.Generator, sigma: float) -> np.ndarray:
    A = sigma * rng.standard_normal((6, 6))
    return A @ A.T + 1e-3 * sigma**2 * np.eye(6)


def two(seed: int) -> tuple[VerifiedPlace, VerifiedPlace, np.ndarray]:
    """Two answers about one view that err as they say, and where it is by the first keyframe."""
    rng = np.random.default_rng(seed)
    T = se3.exp(0.3 * rng.standard_normal(6))
    C_first, C_second = spread(rng, 0.003), spread(rng, 0.004)
    e_first, e_second = (rng.multivariate_normal(np.zeros(6), C) for C in (C_first, C_second))
    T_second = se3.invert(T_FIRST_SECOND) @ T
    first = place(se3.exp(e_first) @ T, C_first, CERTAIN)
    second = place(se3.exp(e_second) @ T_second, C_second, CERTAIN, 1)
    return first, second, T


def test_the_distance_of_honest_answers_is_chi_square_of_six():
    chi2 = [distance_chi2(*two(seed)[:2], T_FIRST_SECOND, CERTAIN) for seed in range(400)]
    assert np.mean(chi2) == pytest.approx(6, abs=0.6)


def test_both_together_err_as_they_say():
    chi2 = []
    for seed in range(400):
        first, second, T = two(seed)
        both = joined(first, second, T_FIRST_SECOND, CERTAIN, SETTINGS)
        if both is not None:
            off = se3.log(both.T_keyframe_camera @ se3.invert(T))
            chi2.append(off @ np.linalg.solve(both.covariance, off))
    assert len(chi2) > 390
    assert np.mean(chi2) == pytest.approx(6, abs=0.6)


@given(st.integers(0, 10_000))
def test_both_know_no_less_than_each(seed):
    first, second, _ = two(seed)
    both = joined(first, second, T_FIRST_SECOND, CERTAIN, SETTINGS.model_copy(update={"agree_chi2": 1e6}))
    assert both is not None
    assert np.linalg.eigvalsh(first.covariance - both.covariance).min() > -1e-9
    assert (both.keyframe, both.matches, both.inliers) == (0, 200, 60)


def test_answers_that_contradict_each_other_are_not_joined():
    first, second, _ = two(1)
    elsewhere = replace(second, T_keyframe_camera=se3.exp([0.3, 0, 0, 0, 0, 0]) @ second.T_keyframe_camera)
    assert joined(first, elsewhere, T_FIRST_SECOND, CERTAIN, SETTINGS) is None
    # Where the map itself does not know how far both keyframes are apart, it is no contradiction.
    assert joined(first, elsewhere, T_FIRST_SECOND, 0.1 * np.eye(6), SETTINGS) is not None


def test_what_the_view_itself_is_off_by_stays():
    own, shared = 1e-4 * np.eye(6), 4e-4 * np.eye(6)
    both = joined(place(np.eye(4), own, shared), place(np.eye(4), own, shared, 1), np.eye(4), CERTAIN, SETTINGS)
    assert both is not None
    assert both.covariance == pytest.approx(own / 2 + shared)


def test_a_direction_is_unknown_where_neither_knows_it():
    along = np.diag([1e-4, 1e-4, 100.0, 1e-4, 1e-4, 1e-4])
    known = 1e-4 * np.eye(6)
    unsure, sure = (place(np.eye(4), C, CERTAIN) for C in (along, known))
    both = joined(unsure, unsure, np.eye(4), CERTAIN, SETTINGS)
    assert both is not None
    assert np.abs(both.degenerate) == pytest.approx(np.eye(6)[2:3])
    filled = joined(unsure, sure, np.eye(4), CERTAIN, SETTINGS)
    assert filled is not None
    assert filled.shows_all
