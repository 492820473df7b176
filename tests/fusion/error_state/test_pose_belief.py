"""PoseBelief: Jacobians against numeric ones, updates against least squares."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import strategies as st
from scipy.optimize import least_squares

from wheelsight.core.calibration_parts import Gyro
from wheelsight.core.geometry import se3
from wheelsight.estimation.pose_belief import (
    AUX_SIZE,
    CAMERA_ERRORS,
    ERRORS,
    LAG,
    PLANE,
    TWIST,
    FilterParameters,
    PoseBelief,
    RelativeMotion,
    WheelStep,
)

SETTINGS = replace(FilterParameters.of(), level_sigma_rad=None)
tangents = st.lists(st.floats(-1.7, 1.7), min_size=6, max_size=6).map(np.array)


def belief_somewhere(rng, clones=2):
    here = PoseBelief.begin(se3.exp(rng.normal(size=6) * 0.4), np.diag(rng.uniform(0.01, 0.02, 6)), SETTINGS)
    for i in range(clones):
        step = WheelStep(i, i + 0.5, rng.normal(size=6) * 0.2, np.diag(rng.uniform(1e-4, 2e-4, 6)))
        here = here.cloned(f"clone {i}", float(i), 4).moved_by_wheels(step, 1.0, SETTINGS, False)
    return here


def perturbed(belief, x):
    return belief.retracted(x, belief.covariance)


def difference(belief, other):
    poses = [se3.log(T @ se3.invert(S)) for T, S in zip(belief.T, other.T, strict=True)]
    return np.concatenate([*poses, belief.aux - other.aux])


def numeric(step, belief, n):
    """Jacobian of a step of the belief by its state."""
    h, mean = 1e-6, step(belief)
    pairs = ((step(perturbed(belief, d)), step(perturbed(belief, -d))) for d in h * np.eye(n))
    return np.transpose([(difference(a, mean) - difference(b, mean)) / (2 * h) for a, b in pairs])


@pytest.mark.parametrize("kind", ["wheels", "part of wheels", "glide"])
def test_the_covariance_goes_on_by_the_numeric_jacobian(rng, kind):
    belief = belief_somewhere(rng)
    belief = replace(belief, aux=rng.normal(size=AUX_SIZE) * 0.1)
    wheels = WheelStep(2.0, 2.1, rng.normal(size=6) * 0.1, np.zeros((6, 6)))
    quiet: dict[str, Any] = {
        name: 0.0
        for name in type(SETTINGS).__dataclass_fields__
        if name.endswith(("_walk", "_per_m", "_sqrt_m", "rad_s", "_s2", "walk_rad", "walk_m"))
    }
    settings = replace(SETTINGS, **{**quiet, "gyro": Gyro(bias_walk_rad_s_per_sqrt_s=0.0)})

    def step(b):
        if kind == "glide":
            return b.predicted_at_constant_twist(0.1, settings)
        return b.moved_by_wheels(wheels, 0.4 if kind == "part of wheels" else 1.0, settings, False)

    F = numeric(step, belief, len(belief.covariance))
    np.testing.assert_allclose(step(belief).covariance, F @ belief.covariance @ F.T, atol=1e-8)


def look_at(belief, name, rng, size=6):
    Z = se3.exp(rng.normal(size=6) * 1e-3) @ se3.invert(belief.T[belief.index_of(name)]) @ belief.T[0]
    return RelativeMotion(name, Z, rng.normal(size=(size, 6)), np.eye(size) * 1e-6, np.eye(6) * 1e-6)


@pytest.mark.parametrize("kind", ["measurement", "part of a measurement", "position", "yaw rate"])
def test_measurements_by_the_numeric_jacobian(rng, kind):
    belief = belief_somewhere(rng)
    measurement = look_at(belief, "clone 1", rng, 4 if kind == "part of a measurement" else 6)
    if "measurement" in kind:  # the Jacobian is that at the expected motion
        measurement = replace(measurement, Z=se3.invert(belief.T[2]) @ belief.T[0])

    def measured(b):
        if "measurement" in kind:
            return b.innovation(measurement, SETTINGS)
        return b.position(np.zeros(2), np.eye(2)) if kind == "position" else b.yaw_rate(0.0, 1.0)

    h = 1e-6
    pairs = (
        (measured(perturbed(belief, d)), measured(perturbed(belief, -d))) for d in h * np.eye(len(belief.covariance))
    )
    H = -np.transpose([(a.residual - b.residual) / (2 * h) for a, b in pairs])
    R = measurement.covariance if "measurement" in kind else np.eye(len(H))
    found = measured(belief)
    np.testing.assert_allclose(found.cross_covariance, belief.covariance @ H.T, atol=1e-7)
    together = H[:, :6] @ lag_and_twist(belief) @ H[:, :6].T if "measurement" in kind else 0.0
    np.testing.assert_allclose(found.covariance, H @ belief.covariance @ H.T + R + together, atol=1e-7)


def lag_and_twist(belief):
    """Covariance (6, 6) of the pose by what lag and twist do together, of second order."""
    lag, twist = np.diag(belief.covariance)[-2], belief.aux_slice(TWIST)
    A = se3.adjoint(belief.T[0])[:, PLANE]
    return lag * A @ belief.covariance[twist, twist] @ A.T


def test_a_pose_is_remembered_as_of_when_its_image_was_taken(rng):
    belief = belief_somewhere(rng)
    belief = replace(belief, aux=rng.normal(size=AUX_SIZE) * 0.1)

    def remembered(b):
        return b.cloned("new", 9.0, 4)

    xi = np.zeros(6)
    xi[PLANE] = belief.aux[TWIST]
    now = remembered(belief)
    np.testing.assert_allclose(now.T[-1], belief.T[0] @ se3.exp(-belief.aux[LAG] * xi), atol=1e-12)
    F, at = numeric(remembered, belief, len(belief.covariance)), slice(18, 24)
    expected = F @ belief.covariance @ F.T
    expected[at, at] += lag_and_twist(now)
    # The pose then is some centimetres from now's: the Jacobian of its exponential is taken for one.
    np.testing.assert_allclose(now.covariance, expected, atol=2e-5)


@pytest.mark.parametrize("updates_errors", [True, False])
def test_a_measurement_updates_the_errors_of_sensors_only_if_asked_to(rng, updates_errors):
    """Else they stay as they are, and as uncertain; all other states move."""
    belief = belief_somewhere(rng)
    after = belief.updated(belief.innovation(look_at(belief, "clone 0", rng), SETTINGS, updates_errors=updates_errors))
    kept = [] if updates_errors else [*range(ERRORS.start, LAG)]
    updated = sorted({*range(LAG)} - {*kept})
    rows = belief.aux_offset + np.array(kept, int)
    np.testing.assert_array_equal(after.aux[kept], belief.aux[kept])
    np.testing.assert_allclose(after.covariance[np.ix_(rows, rows)], belief.covariance[np.ix_(rows, rows)], rtol=1e-12)
    assert (after.aux[updated] != belief.aux[updated]).all()
    assert np.linalg.eigvalsh(after.covariance)[0] > -1e-12


def test_perturbing_all_poses_alike_changes_no_look(rng):
    belief = belief_somewhere(rng)
    measurement = look_at(belief, "clone 0", rng)
    x = np.concatenate([np.tile(rng.normal(size=6), 3), np.zeros_like(belief.aux)])
    np.testing.assert_allclose(perturbed(belief, x).residual(measurement), belief.residual(measurement), atol=1e-12)


def test_an_error_that_nothing_measures_stays_as_uncertain_as_it_was(rng):
    """And what was learned of it fades, each by its own length, as a Gauss–Markov process."""
    settings = replace(SETTINGS, camera_drift_sigma_rad_per_m=3e-4, camera_drift_walk_rad_per_m=1e-4, lever_m=0.0)
    belief, drift = PoseBelief.begin(np.eye(4), np.zeros((6, 6)), settings), CAMERA_ERRORS.start + 1
    aux = belief.aux.copy()
    aux[drift] = 2e-4
    belief, start = replace(belief, aux=aux), np.diag(belief.covariance)[belief.aux_slice(CAMERA_ERRORS)]
    for k in range(500):
        step = WheelStep(0.1 * k, 0.1 * (k + 1), np.array([0.1, 0, 0, 0, 0, 0]), 1e-9 * np.eye(6))
        belief = belief.moved_by_wheels(step, 1.0, settings, is_slipping=False)
    np.testing.assert_allclose(np.diag(belief.covariance)[belief.aux_slice(CAMERA_ERRORS)], start, rtol=0.02)
    length_m = 2 * 3e-4**2 / 1e-4**2
    assert belief.aux[drift] == pytest.approx(2e-4 * np.exp(-50 / length_m), rel=1e-6)


def test_an_error_that_was_certain_only_walks(rng):
    settings = replace(SETTINGS, camera_scale_sigma=0.0, camera_scale_walk=1e-3)
    belief = PoseBelief.begin(np.eye(4), np.zeros((6, 6)), settings)
    belief = belief.moved_by_wheels(
        WheelStep(0, 1, np.array([1.0, 0, 0, 0, 0, 0]), 1e-9 * np.eye(6)), 1.0, settings, False
    )
    assert belief.covariance[belief.aux_offset + CAMERA_ERRORS.start][belief.aux_offset + CAMERA_ERRORS.start] == 1e-6


def test_a_shift_of_another_size_is_refused(rng):
    belief = belief_somewhere(rng)
    with pytest.raises(ValueError, match=r"25.*35"):
        perturbed(belief, np.zeros(25))


def test_many_looks_are_one_least_squares_fit(rng):
    """Poses joined by wheels, and measured between each and the last three: all at once, by scipy, and one by one."""
    steps = [WheelStep(i, i + 1.0, rng.normal(size=6) * 0.05, np.diag(rng.uniform(1, 2, 6) * 1e-6)) for i in range(4)]
    still = replace(SETTINGS, scale_sigma=0.0, drift_sigma_rad_per_m=0.0, turn_sigma=0.0, scale_walk=0.0)
    none = ("drift_walk_rad_per_m", "turn_walk", "side_m_per_sqrt_m", "rise_m_per_sqrt_m", "tilt_rad_per_sqrt_m")
    of_camera = (name for name in type(SETTINGS).__dataclass_fields__ if name.startswith(("camera_", "mount_")))
    nothing: dict[str, Any] = dict.fromkeys((*none, *of_camera), 0.0)
    settings = replace(still, **nothing)
    belief = PoseBelief.begin(np.eye(4), np.zeros((6, 6)), settings).cloned("0", 0.0, 9)
    prior, measurements = [np.eye(4)], []
    for i, step in enumerate(steps, 1):
        belief = belief.moved_by_wheels(step, 1.0, settings, False)
        prior.append(prior[-1] @ se3.exp(step.xi))
        for j in range(max(i - 3, 0), i):
            Z = se3.exp(rng.normal(size=6) * 1e-3) @ se3.invert(prior[j]) @ prior[i]
            measurement = RelativeMotion(str(j), Z, np.eye(6), np.diag(rng.uniform(1, 2, 6) * 1e-6), np.eye(6))
            measurements.append((i, j, measurement))
            belief = belief.updated(belief.innovation(measurement, SETTINGS))
        belief = belief.cloned(str(i), float(i), 9)

    def residuals(x):
        T = [np.eye(4), *(se3.exp(d) @ T for d, T in zip(x.reshape(-1, 6), prior[1:], strict=True))]
        wheels = [
            se3.log(se3.invert(T[i]) @ T[i + 1] @ se3.exp(-s.xi)) / np.sqrt(np.diag(s.covariance))
            for i, s in enumerate(steps)
        ]
        seen = [
            se3.log(k.Z @ se3.invert(se3.invert(T[j]) @ T[i])) / np.sqrt(np.diag(k.covariance))
            for i, j, k in measurements
        ]
        return np.concatenate(wheels + seen)

    fit = least_squares(residuals, np.zeros(24), xtol=1e-15, ftol=1e-15, gtol=1e-15)
    best = se3.exp(fit.x[-6:]) @ prior[-1]
    sigmas = np.sqrt(np.diag(belief.covariance)[:6])
    np.testing.assert_allclose(se3.log(best @ se3.invert(belief.T[0])) / sigmas, 0, atol=2e-2)
    batch = np.linalg.inv(fit.jac.T @ fit.jac)[-6:, -6:]
    np.testing.assert_allclose(belief.covariance[:6, :6], batch, rtol=0.02, atol=0.02 * batch.diagonal().min())


def test_a_clone_that_is_dropped_leaves_the_rest_as_it_was(rng):
    belief = belief_somewhere(rng, 3)
    without = belief.dropped("clone 1")
    assert without.names == ("clone 0", "clone 2")
    np.testing.assert_array_equal(without.covariance[:6, :6], belief.covariance[:6, :6])
    kept = belief.innovation(look_at(belief, "clone 2", np.random.default_rng(0)), SETTINGS).nis
    np.testing.assert_allclose(
        without.innovation(look_at(belief, "clone 2", np.random.default_rng(0)), SETTINGS).nis, kept
    )


def test_of_too_many_clones_the_oldest_goes(rng):
    belief = belief_somewhere(rng, 2).cloned("a", 3.0, 3).cloned("b", 4.0, 3)
    assert belief.names == ("clone 1", "a", "b")


def test_what_was_doubted_before_a_clone_is_no_doubt_about_motion_since(rng):
    certain = belief_somewhere(rng)
    doubting = certain.slipped(1.0, SETTINGS)
    step = WheelStep(9.0, 9.1, rng.normal(size=6) * 0.02, 1e-6 * np.eye(6))
    now = [b.cloned("late", 9.0, 4).moved_by_wheels(step, 1.0, SETTINGS, False) for b in (certain, doubting)]
    measurement = look_at(now[0], "late", rng)
    usual = [b.innovation(measurement, SETTINGS, without_slip=True) for b in now]
    np.testing.assert_allclose(usual[1].covariance, usual[0].covariance, rtol=1e-6, atol=1e-12)
    assert usual[1].nis == pytest.approx(usual[0].nis, rel=1e-4)
    earlier = doubting.innovation(look_at(doubting, "clone 0", rng), SETTINGS, without_slip=True)
    assert np.linalg.eigvalsh(earlier.covariance)[0] > 0
