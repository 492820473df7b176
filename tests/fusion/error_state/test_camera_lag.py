"""A camera whose stamps are late: what it sees then, when that is learned, and that noise never teaches it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from fusion.error_state.fused_drives import T_BASE_CAMERA, Drive, Step, run, simulate
from hypothesis import given
from hypothesis import strategies as st

from wheelsight.core.geometry import se3
from wheelsight.estimation import ErrorStateFilter
from wheelsight.estimation.pose_belief import (
    AUX_SIZE,
    LAG,
    PLANE,
    FilterParameters,
    Innovation,
    PoseBelief,
    RelativeMotion,
)

SETTINGS = FilterParameters.of()
twists = st.lists(st.floats(-1.0, 1.0), min_size=3, max_size=3).map(np.array)
tangents = st.lists(st.floats(-1.2, 1.2), min_size=6, max_size=6).map(np.array)


def moving(T: np.ndarray, twist: np.ndarray, lag_s: float) -> PoseBelief:
    """At a pose, with a twist (3,), and stamps that are known to be late."""
    aux = np.zeros(AUX_SIZE)
    aux[:3], aux[LAG] = twist, lag_s
    return replace(PoseBelief.begin(T, 1e-6 * np.eye(6), SETTINGS), aux=aux)


def gone_on(twist: np.ndarray, seconds: float) -> np.ndarray:
    """The motion (4, 4) of a twist (3,) in the plane."""
    xi = np.zeros(6)
    xi[PLANE] = twist * seconds
    return np.asarray(se3.exp(xi))


@given(tangents, tangents, twists, twists, st.floats(-0.1, 0.1))
def test_a_camera_that_is_late_sees_the_motion_between_two_instants_before(
    begin: np.ndarray, way: np.ndarray, before: np.ndarray, now: np.ndarray, lag_s: float
) -> None:
    T_reference = se3.exp(begin)
    T_now = T_reference @ se3.exp(way)
    belief = moving(T_reference, before, lag_s).cloned("anchor", 0.0, 4)
    belief = replace(belief, T=np.stack([T_now, belief.T[1]]), aux=moving(T_now, now, lag_s).aux)
    Z = se3.invert(T_reference @ gone_on(before, -lag_s)) @ T_now @ gone_on(now, -lag_s)
    measurement = RelativeMotion("anchor", Z, np.eye(6), 1e-6 * np.eye(6), 1e-6 * np.eye(6))
    np.testing.assert_allclose(belief.residual(measurement), 0, atol=1e-9)


def learned(steps: list[Step], settings: FilterParameters = SETTINGS) -> tuple[float, float]:
    """The lag as a filter has it after a drive, and its standard deviation; seconds."""
    fusion = ErrorStateFilter(T_BASE_CAMERA, settings=settings)
    run(steps, fusion=fusion)
    belief = fusion.state.detection.primary
    place = len(belief.covariance) - AUX_SIZE + LAG
    return float(belief.aux[LAG]), float(np.sqrt(belief.covariance[place, place]))


@pytest.mark.parametrize("lag_s", [-0.02, 0.0, 0.03])
def test_a_lag_is_learned_from_turns_that_begin_and_end(lag_s: float) -> None:
    drive = Drive(seconds=20, step_s=0.1, steps_a_frame=3, lag_s=lag_s, slip_m_per_sqrt_m=0.0005)
    found, sigma_s = learned(simulate(drive, np.random.default_rng(0), SETTINGS))
    assert sigma_s < 0.004
    assert abs(found - lag_s) < 3 * sigma_s


@pytest.mark.parametrize("seed", range(4))
def test_the_noise_of_wheels_is_no_lag(seed: int) -> None:
    """The twist changes by less between frames than wheels that slip tell it to."""
    drive = Drive(seconds=20, slip_m_per_sqrt_m=0.01)
    found, sigma_s = learned(simulate(drive, np.random.default_rng(seed), SETTINGS))
    assert sigma_s > SETTINGS.camera_lag_sigma_s / 3
    assert abs(found) < 2 * sigma_s


def test_what_a_look_must_not_tell_stays_and_is_reckoned_with(rng: np.random.Generator) -> None:
    """The update of Schmidt: by the best gain for all else, in the form that holds for whatever gain."""
    belief = PoseBelief.begin(np.eye(4), 1e-2 * np.eye(6), SETTINGS)
    n, at = len(belief.covariance), len(belief.covariance) - AUX_SIZE + LAG
    A, H, R = rng.normal(size=(n, n)) * 1e-2, rng.normal(size=(3, n)), 1e-4 * np.eye(3)
    belief = replace(belief, covariance=A @ A.T)
    S, PHt = H @ belief.covariance @ H.T + R, belief.covariance @ H.T
    gain = PHt @ np.linalg.inv(S)
    gain[at] = 0.0
    after = belief.updated(Innovation(np.full(3, 1e-3), S, PHt, 0.0, np.array([LAG])))
    kept = np.eye(n) - gain @ H
    np.testing.assert_allclose(after.covariance, kept @ belief.covariance @ kept.T + gain @ R @ gain.T, atol=1e-10)
    assert after.aux[LAG] == belief.aux[LAG]
