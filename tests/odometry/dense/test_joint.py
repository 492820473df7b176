"""How much surfaces count beside keypoints: by closed form, and by draws whose true factor is known."""

from __future__ import annotations

import numpy as np
import pytest

from wheelsight.core.geometry import FloatArray, se3
from wheelsight.vision.dense.alignment import Joint, KeypointMotion, SurfaceWeight

KEYPOINTS = np.diag([4.0, 9.0, 2.0, 30.0, 20.0, 50.0]) * 1e4
SURFACES = np.diag([40.0, 5.0, 60.0, 90.0, 300.0, 80.0]) * 1e4


def meeting(T_keypoints: FloatArray, T_surfaces: FloatArray, factor: float) -> FloatArray:
    """Where both meet, of information that is diagonal: small motions add."""
    surfaces = SURFACES / factor
    off = surfaces @ se3.log(T_surfaces) + KEYPOINTS @ se3.log(T_keypoints)
    return np.asarray(se3.exp(np.linalg.solve(surfaces + KEYPOINTS, off)))


def met(weight: SurfaceWeight, keypoints: FloatArray, surfaces: FloatArray) -> Joint:
    T_keypoints, T_surfaces = se3.exp(keypoints), se3.exp(surfaces)
    return weight.meet(
        meeting(T_keypoints, T_surfaces, weight.factor), SURFACES, KeypointMotion(T_keypoints, KEYPOINTS)
    )


def test_what_agrees_meets_by_the_inverse_covariances() -> None:
    rng = np.random.default_rng(0)
    keypoints, surfaces = 1e-4 * rng.standard_normal((2, 6))
    joint = met(SurfaceWeight(), keypoints, surfaces)
    expected = meeting(se3.exp(keypoints), se3.exp(surfaces), 1.0)
    np.testing.assert_allclose(joint.T_reference_frame, expected, atol=1e-8)
    np.testing.assert_allclose(joint.ahead, keypoints - surfaces, atol=1e-7)
    assert joint.factor == 1.0


def test_a_frame_at_odds_counts_less_at_once_and_is_led_by_keypoints() -> None:
    surfaces = np.array([0.05, 0, 0, 0, 0.03, 0])
    joint = met(SurfaceWeight(), np.zeros(6), surfaces)
    assert joint.factor > 5
    off = np.abs(se3.log(joint.T_reference_frame))
    assert off.max() < 0.5 * np.abs(surfaces).max()
    ahead = -surfaces
    np.testing.assert_allclose(joint.ahead, ahead, atol=1e-3)


@pytest.mark.parametrize("factor", [1.0, 20.0, 150.0])
def test_the_factor_of_drawn_errors_is_learned(factor: float) -> None:
    """Within a factor of two: keypoints' own errors are known, those of surfaces are `factor` times what they claim."""
    rng, weight, seen = np.random.default_rng(1), SurfaceWeight(), []
    for _ in range(400):
        keypoints = rng.multivariate_normal(np.zeros(6), np.linalg.inv(KEYPOINTS))
        surfaces = rng.multivariate_normal(np.zeros(6), factor * np.linalg.inv(SURFACES))
        weight.learn(met(weight, keypoints, surfaces))
        seen.append(weight.factor)
    assert factor / 2 < np.median(seen[100:]) < 2 * factor


def test_one_frame_at_odds_does_not_spoil_those_that_follow() -> None:
    weight = SurfaceWeight()
    weight.learn(met(weight, np.zeros(6), np.array([1.0, 0, 0, 0, 0, 0])))
    assert weight.factor < 3.0


def test_directions_that_surfaces_do_not_show_say_nothing_of_them() -> None:
    weight, blind = SurfaceWeight(), np.diag([0.0, 5, 60, 90, 300, 80]) * 1e4
    T_keypoints = se3.exp([0.3, 0, 0, 0, 0, 0])  # only along what they do not show
    joint = weight.meet(T_keypoints, blind, KeypointMotion(T_keypoints, KEYPOINTS))
    assert joint.seen_factor == 1.0
    np.testing.assert_allclose(joint.T_reference_frame, T_keypoints, atol=1e-6)
