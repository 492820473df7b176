"""RPE in closed form, and against the definition spelt out pair by pair."""

from __future__ import annotations

import numpy as np
import pytest

from wheelsight.core.errors import EvaluationError
from wheelsight.core.geometry import se3, so3
from wheelsight.core.trajectory import Trajectory
from wheelsight.evaluation import rpe

RATE_HZ = 20.0


def constant_twist(xi: np.ndarray, n: int = 101) -> Trajectory:
    return Trajectory(np.arange(n) / RATE_HZ, se3.exp(np.arange(n)[:, None] / RATE_HZ * xi))


@pytest.mark.parametrize(("delta", "unit", "seconds"), [(1, "frames", 0.05), (5, "frames", 0.25), (1, "seconds", 1.0)])
def test_of_a_constant_drift_is_the_drift(delta: float, unit: str, seconds: float) -> None:
    """One drives straight at 0.5 m/s, the other believes 3 % more: each step is wrong by 15 mm a second."""
    truth, estimate = constant_twist(np.array([0.5, 0, 0, 0, 0, 0])), constant_twist(np.array([0.515, 0, 0, 0, 0, 0]))
    error = rpe(estimate, truth, delta, unit)  # type: ignore[arg-type]
    step_s = error.end_s - error.start_s
    np.testing.assert_allclose(error.errors_m, 0.015 * step_s, atol=1e-12)
    assert error.rotation.max < 1e-7
    assert np.median(step_s) == pytest.approx(seconds)
    assert np.abs(step_s / seconds - 1).max() < 0.1 + 1e-9


def test_of_a_drift_in_heading_is_the_drift() -> None:
    truth, estimate = constant_twist(np.array([0, 0, 0, 0, 0, 0.4])), constant_twist(np.array([0, 0, 0, 0, 0, 0.42]))
    error = rpe(estimate, truth, 1, "seconds")
    np.testing.assert_allclose(error.errors_rad, 0.02 * (error.end_s - error.start_s), atol=1e-9)
    assert error.translation.max < 1e-12


def test_over_a_metre_goes_by_the_way_of_the_truth() -> None:
    truth, estimate = constant_twist(np.array([0.5, 0, 0, 0, 0, 0])), constant_twist(np.array([0.55, 0, 0, 0, 0, 0]))
    error = rpe(estimate, truth, 1, "metres")
    np.testing.assert_allclose(error.end_s - error.start_s, 2.0, atol=0.2)
    np.testing.assert_allclose(error.errors_m, 0.1 * 0.5 * (error.end_s - error.start_s), atol=1e-9)


def test_is_blind_to_a_rigid_motion_of_either() -> None:
    truth, estimate = (
        constant_twist(np.array([0.5, 0, 0, 0, 0, 0.3])),
        constant_twist(np.array([0.5, 0, 0.1, 0, 0, 0.2])),
    )
    moved = estimate.moved(se3.exp([1, 2, 3, 1, 0, 0.5]))
    before, after = rpe(estimate, truth, 1, "seconds"), rpe(moved, truth, 1, "seconds")
    np.testing.assert_allclose(after.errors_m, before.errors_m, atol=1e-12)
    np.testing.assert_allclose(after.errors_rad, before.errors_rad, atol=1e-9)


@pytest.mark.parametrize("unit", ["seconds", "metres"])
def test_takes_the_nearest_pair_as_defined(unit: str, rng: np.random.Generator) -> None:
    """Against the definition in plain loops, on irregular stamps with gaps and standstills."""
    stamps_s = np.cumsum(rng.choice([0.02, 0.03, 0.05, 0.7], 200, p=[0.4, 0.4, 0.18, 0.02]))
    steps = rng.normal(0, 0.03, (200, 6)) * (rng.uniform(size=(200, 1)) < 0.7)
    T = [np.eye(4)]
    for step in steps[1:]:
        T.append(T[-1] @ se3.exp(step))
    truth = Trajectory(stamps_s, np.array(T))
    estimate = Trajectory(stamps_s, truth.T_frame_body @ se3.exp(rng.normal(0, 0.01, (200, 6))))

    along = stamps_s if unit == "seconds" else truth.distances_m
    errors = []
    for i in range(200):
        off = [abs(along[j] - along[i] - 1.0) if j > i else np.inf for j in range(200)]
        j = int(np.argmin(off))
        if off[j] <= 0.1:
            T_true = np.linalg.inv(truth.T_frame_body[i]) @ truth.T_frame_body[j]
            T_estimated = np.linalg.inv(estimate.T_frame_body[i]) @ estimate.T_frame_body[j]
            E = np.linalg.inv(T_true) @ T_estimated
            errors.append((stamps_s[i], stamps_s[j], np.linalg.norm(E[:3, 3]), so3.angle(E[:3, :3])))
    assert 50 < len(errors) < 200

    error = rpe(estimate, truth, 1.0, unit)  # type: ignore[arg-type]
    found = np.stack([error.start_s, error.end_s, error.errors_m, error.errors_rad], axis=1)
    np.testing.assert_allclose(found, np.array(errors), atol=1e-9)


def test_refuses_steps_longer_than_the_trajectory() -> None:
    path = constant_twist(np.array([0.5, 0, 0, 0, 0, 0]), n=10)
    for delta, unit in ((10, "frames"), (1, "seconds"), (1, "metres")):
        with pytest.raises(EvaluationError, match=f"too short for a step of {delta} {unit}"):
            rpe(path, path, delta, unit)  # type: ignore[arg-type]


@pytest.mark.parametrize("delta", [0, -1, 0.5, float("nan")])
def test_refuses_steps_that_are_none(delta: float) -> None:
    path = constant_twist(np.array([0.5, 0, 0, 0, 0, 0]), n=10)
    with pytest.raises(ValueError, match="step"):
        rpe(path, path, delta, "frames")
