"""ErrorStateFilter.settled_motions: how frames lie to each other that were kept while two hypotheses went on."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from fusion.error_state.fused_drives import T_BASE_CAMERA, Drive, shifted, simulate
from narrowing import not_none
from scipy.stats import chi2

from wheelsight.core.geometry import motion_kernels as motions
from wheelsight.core.geometry import se3
from wheelsight.estimation import ErrorStateFilter
from wheelsight.estimation.pose_belief import FilterParameters

FLAT = replace(FilterParameters.of(), tilt_rad_per_sqrt_m=0.002, rise_m_per_sqrt_m=0.001)
FRAME_S, EVERY = 1 / 30, 5
UP = np.array([[0.0, 1.0, 0.0, 0.0, 0.0, 0.0]])


def before_a_wall(t, motion):
    """The camera turns too far for half a second, and does not see all directions: that speaks for neither sensor."""
    return replace(shifted(motion, (0.0, 0.0, 0.3), FRAME_S), degenerate=UP) if 2.0 <= t < 2.5 else motion


def kept(steps, settings=None):
    """Of frames that are kept: motions as first reported, as reported once settled, and true ones; how many waited."""
    fusion, then, settled, places, most = ErrorStateFilter(T_BASE_CAMERA, settings=settings), [], [], [], 0
    fusion.clone(steps[0].begin_s, "frame")
    for i, step in enumerate(steps):
        fusion.predict(step.end_s, step.wheels, step.wheel_covariance, step.begin_s)
        fusion.update_relative(step.end_s, step.measurement, "frame")
        fusion.clone(step.end_s, "frame")
        if i % EVERY == 0:
            then.append(fusion.keep_frame(step.end_s))
            places.append(step.T_truth @ T_BASE_CAMERA)
        settled += fusion.settled_motions() or []
        most = max(most, len(then) - 1 - len(settled))
    true = [se3.invert(one) @ other for one, other in pairwise(places)]
    assert then[0] is None
    assert len(settled) == len(true)
    return then[1:], [not_none(one) for one in settled], true, most


def driven(seed):
    drive = Drive(seconds=4.0, step_s=FRAME_S, errors=(0.02, 0.005, 0.01), camera_fault=before_a_wall)
    return simulate(drive, np.random.default_rng(seed), FLAT)


def off(reported, true):
    """(K, 6) how far off motions are."""
    return np.array([motions.log(T @ se3.invert(one[0])) for one, T in zip(reported, true, strict=True)])


@pytest.mark.parametrize("seed", range(2))
def test_frames_kept_in_doubt_lie_as_the_sensor_has_them_that_was_right(seed):
    """What lies between both hypotheses is where neither has it, and stays wrong once one is given up."""
    then, settled, true, most = kept(driven(seed))
    worst_then, worst = (np.abs(off(reported, true)[:, 4]).max() for reported in (then, settled))
    assert most >= 2
    assert worst_then > 0.02
    assert worst < 0.5 * worst_then
    nees = [
        e @ np.linalg.solve(one[1] + 1e-10 * np.eye(6), e) for e, one in zip(off(settled, true), settled, strict=True)
    ]
    assert np.mean(np.array(nees) < chi2.ppf(0.999, 6)) >= 0.95


def test_frames_wait_no_longer_than_there_is_room_to_remember_them():
    then, settled, _, most = kept(driven(0), replace(FilterParameters.of(), max_clones=5))
    assert most == 0
    # Where both hypotheses are one, a clone's linearisation is not that of the pose of now.
    for one, other in zip(then, settled, strict=True):
        np.testing.assert_allclose(one[0], other[0], atol=1e-8)
        np.testing.assert_allclose(one[1], other[1], atol=1e-6)
