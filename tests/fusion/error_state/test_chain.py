"""Anchors of the camera, one seen from the other: errors of single measurements do not add up along a way."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from fusion.error_state.fused_drives import T_BASE_CAMERA, Drive, Step, looked, simulate
from fusion.error_state.test_pose_belief import SETTINGS, belief_somewhere, look_at, numeric

from wheelsight.fusion import ErrorStateFilter, ErrorStateSettings
from wheelsight.fusion.error_state._measurements import RelativePose
from wheelsight.fusion.error_state._pose_belief import PLANE, PoseBelief
from wheelsight.geometry import FloatArray, se3

COARSE = np.diag(np.square([0.01] * 3 + [0.005] * 3))  # of a single measurement
SURE = np.diag(np.square([1e-5] * 6))  # of what camera odometry gains by error from anchor to anchor


def seen_from(belief: PoseBelief, name: str, Z: FloatArray) -> RelativePose:
    return RelativePose(name, Z, np.eye(6), COARSE, COARSE)


def in_plane(T: FloatArray) -> FloatArray:
    """x, y, yaw of a pose."""
    return np.array([T[0, 3], T[1, 3], np.arctan2(T[1, 0], T[0, 0])])


def test_an_anchor_lies_where_the_camera_saw_it_from_the_last_one(rng: np.random.Generator) -> None:
    """In the plane; height, roll and pitch are those of the pose now."""
    level = PoseBelief.begin(se3.from_plane(1.0, 2.0, 0.5), np.diag([1e-2] * 6), SETTINGS).cloned("anchor", 0.0, 4)
    Z = se3.from_plane(0.3, 0.1, 0.2)
    wheels_say = se3.from_plane(1.1, 2.4, 0.9) @ se3.exp(np.array([0, 0, 0.05, 0.02, -0.03, 0]))
    belief = replace(level, T=np.stack([wheels_say, level.T[1]]))
    there = belief.chained(seen_from(belief, "anchor", Z), 1.0, SURE, SETTINGS).T[1]
    np.testing.assert_allclose(in_plane(there), in_plane(level.T[1] @ Z), atol=2e-2)  # tilted, its plane is another
    np.testing.assert_allclose(there[2, 3], wheels_say[2, 3], atol=2e-2)
    np.testing.assert_allclose(there[2, :2], wheels_say[2, :2], atol=1e-2)
    flat = replace(level, T=np.stack([se3.from_plane(1.1, 2.4, 0.9), level.T[1]]))
    exactly = flat.chained(seen_from(flat, "anchor", Z), 1.0, SURE, SETTINGS).T[1]
    np.testing.assert_allclose(exactly, level.T[1] @ Z, atol=1e-9)


def test_what_it_is_known_by_follows_from_the_numeric_jacobian(rng: np.random.Generator) -> None:
    belief = belief_somewhere(rng)
    measurement = replace(look_at(belief, "clone 1", rng), Z=se3.invert(belief.T[2]) @ belief.T[0])

    def chained(b: PoseBelief) -> PoseBelief:
        return b.chained(measurement, 3.0, np.zeros((6, 6)), SETTINGS)

    F = numeric(chained, belief, len(belief.covariance))
    found = chained(belief)
    assert found.names == belief.names
    assert found.remembered[1].stamp_s == 3.0
    np.testing.assert_allclose(found.covariance, F @ belief.covariance @ F.T, atol=1e-6)


def drifting(steps: list[Step], settings: ErrorStateSettings, spread: FloatArray | None) -> tuple[float, float]:
    """How far off the way in x, y is after a drive by measurements against anchors a metre apart, and its σ."""
    rng = np.random.default_rng(5)
    fusion = ErrorStateFilter(T_BASE_CAMERA, settings=settings)
    fusion.clone(0.0, "anchor", spread)
    T_seen = np.eye(4)
    for i, step in enumerate(steps):
        answer = fusion.predict(step.end_s, step.wheels, step.wheel_covariance, step.begin_s)
        # The camera's own world: each measurement errs by itself, what it takes for the anchor's place does not.
        measurement = looked(rng, se3.invert(T_seen) @ step.T_truth, COARSE)
        assert measurement.T_reference_current is not None
        answer = fusion.update_relative(step.end_s, measurement, "anchor")
        if i % 10 == 9:
            seen = T_BASE_CAMERA @ measurement.T_reference_current @ se3.invert(T_BASE_CAMERA)
            T_seen = T_seen @ seen
            fusion.clone(step.end_s, "anchor", spread)
    assert answer.T_odom_body is not None
    assert answer.covariance is not None
    off = answer.T_odom_body[:2, 3] - steps[-1].T_truth[:2, 3]
    C = answer.covariance
    x, y = answer.T_odom_body[:2, 3]
    J = np.array([[1.0, 0, 0, 0, 0, -y], [0, 1.0, 0, 0, 0, x]])
    return float(np.linalg.norm(off)), float(np.sqrt(np.trace(J @ C @ J.T)))


def test_errors_of_single_looks_do_not_add_up() -> None:
    """Two hundred measurements, twenty anchors: what one measurement errs by, the next one, from there, makes good."""
    errors = ("scale_{}", "drift_{}_rad_per_m", "turn_{}")
    right = {f"camera_{name.format(of)}": 0.0 for name in errors for of in ("sigma", "walk")}
    settings = ErrorStateSettings().model_copy(update={"mount_sigma_rad": 0.0, "camera_lag_sigma_s": 0.0, **right})
    chained, single = [], []
    for seed in range(4):
        steps = simulate(Drive(20.0, step_s=0.1), np.random.default_rng(seed), settings)
        chained.append(drifting(steps, settings, SURE))
        single.append(drifting(steps, settings, None))
    far, near = np.mean(single, axis=0), np.mean(chained, axis=0)
    assert near[0] < 0.5 * far[0]
    assert near[1] < 0.5 * far[1]
    assert all(off < 3 * sigma for off, sigma in chained)


def test_a_look_against_another_pose_makes_no_chain(rng: np.random.Generator) -> None:
    """Only what was seen just so from the anchor itself lies in the anchor's world."""
    fusion = ErrorStateFilter(T_BASE_CAMERA, settings=ErrorStateSettings(camera_lag_sigma_s=0.0))
    fusion.predict(0.1, se3.from_plane(0.1, 0, 0), 1e-4 * np.eye(6), 0.0)
    fusion.clone(0.1, "anchor", SURE)
    fusion.clone(0.1, "other")
    fusion.predict(0.2, se3.from_plane(0.1, 0, 0), 1e-4 * np.eye(6), 0.1)
    fusion.update_relative(0.2, looked(rng, se3.from_plane(0.1, 0, 0)), "other")
    fusion.clone(0.2, "anchor", SURE)
    belief = fusion.state.detection.primary
    at = belief.reference("anchor")
    np.testing.assert_allclose(belief.T[at], belief.T[0], atol=1e-3)
    between = belief.covariance[:6, :6] - belief.covariance[6 * at : 6 * at + 6, 6 * at : 6 * at + 6]
    assert np.abs(between[np.ix_(PLANE, PLANE)]).max() < 1e-5
