"""Court: what is believed after doubt that nobody has settled."""

from __future__ import annotations

import numpy as np
import pytest

from wheelsight.estimates import Reason
from wheelsight.fusion.error_state._changed import changed
from wheelsight.fusion.error_state._measurements import Look, WheelStep
from wheelsight.fusion.error_state._pose_belief import PoseBelief
from wheelsight.fusion.error_state._trust import Court, Trust, see
from wheelsight.fusion.error_state.settings import FilterParameters
from wheelsight.geometry import se3

SETTINGS = FilterParameters()
BEGUN_S, FRAME_S = 8.0, 0.1
APART = np.array([0.02, -0.03, 0.0, 0.0, 0.0, np.radians(2.4)])


def apart(T, other):
    """Metres and degrees."""
    xi = se3.log(se3.invert(T) @ other)
    return np.array([np.linalg.norm(xi[:3]), np.degrees(np.linalg.norm(xi[3:]))])


def in_doubt(evidence):
    """At 10 s, when both agree again for the last time that is asked for: 2.4 degrees apart, nearly so a frame ago."""
    begun = PoseBelief.begin(se3.exp([1.0, 2.0, 0, 0, 0, 0.3]), np.diag(np.square([0.05] * 3 + [0.01] * 3)), SETTINGS)
    step = WheelStep(10.0 - FRAME_S, 10.0, np.array([0.08, 0, 0, 0, 0, 0.02]), np.diag([1e-6, 0, 0, 0, 0, 1e-6]))
    belief = begun.cloned("frame", 10.0 - FRAME_S, 4).rolled(step, 1.0, SETTINGS, False)
    off = np.zeros(len(belief.covariance))
    off[:6], off[6:12] = APART, 0.99 * APART
    rival = belief.moved(off, belief.covariance)
    return Court(belief, rival, Trust.DOUBT, evidence, agreed=SETTINGS.agreements - 1, since_s=BEGUN_S)


def looked(court, wrong):
    """What the rival expects to be seen, wrong by a tangent (6,)."""
    assert court.rival is not None
    Z = se3.exp(wrong) @ se3.invert(court.rival.T[1]) @ court.rival.T[0]
    return Look("frame", Z, np.eye(6), 1e-7 * np.eye(6), 1e-7 * np.eye(6))


@pytest.mark.parametrize(("evidence", "by_camera"), [(1.5, True), (-2.0, False), (0.0, False)])
def test_where_both_agree_again_the_likelier_goes_on_and_covers_the_other(evidence, by_camera):
    court = in_doubt(evidence)
    court_after, reason = see(court, 10.0, looked(court, np.zeros(6)), SETTINGS)
    assert (court_after.trust, court_after.rival, reason) == (Trust.BOTH, None, None)
    likelier, other = (court.rival, court.belief) if by_camera else (court.belief, court.rival)
    now = court_after.belief
    assert (apart(now.T[0], likelier.T[0]) < [0.01, 0.1]).all()
    off = se3.log(other.T[0] @ se3.invert(now.T[0]))
    assert off @ np.linalg.solve(now.covariance[:6, :6], off) < 9


@pytest.mark.parametrize("seed", range(5))
def test_noise_of_the_looks_after_doubt_does_not_decide_who_was_right(seed):
    court, rng = in_doubt(1.5), np.random.default_rng(seed)
    assert court.rival is not None
    looks = [looked(in_doubt(1.5), rng.normal(size=6) * 3e-4) for _ in range(3)]
    court, _ = see(court, 10.0, looks[0], SETTINGS)  # which ends the doubt
    for k, look in enumerate(looks[1:], 1):
        told, reason = see(court, 10.0 + k * 1e-3, look, SETTINGS)
        assert reason is None
        assert (apart(court.belief.T[0], told.belief.T[0]) < [0.005, 0.1]).all()
        court = told


def contradicted(slipped_s):
    """Both believed at 10 s, where wheels last slipped at a stamp, and the camera sees them 2.4 degrees off."""
    court = changed(in_doubt(0.0), rival=None, trust=Trust.BOTH, agreed=0, slipped_s=slipped_s)
    Z = se3.invert(court.belief.T[1]) @ se3.exp(APART) @ court.belief.T[0]
    return see(court, 10.0, Look("frame", Z, np.eye(6), 1e-7 * np.eye(6), 1e-7 * np.eye(6)), SETTINGS)


@pytest.mark.parametrize(("ago_s", "by_camera"), [(1.0, True), (30.0, False)])
def test_wheels_that_slipped_a_moment_ago_are_taken_to_slip_again(ago_s, by_camera):
    """One frame contradicts the wheels, and all that follow agree."""
    court, reason = contradicted(10.0 - ago_s)
    assert (court.trust, reason) == (Trust.DOUBT, Reason.CONTRADICTION)
    wheels_say, camera_says = court.belief.T[0], court.rival.T[0]
    assert apart(wheels_say, camera_says)[1] > 2
    now = court.likelier(SETTINGS).T[0]
    assert (apart(now, camera_says if by_camera else wheels_say) < [0.005, 0.1]).all()


def test_when_wheels_last_slipped_is_kept_once_they_are_believed_again():
    court = changed(in_doubt(0.0), rival=None, trust=Trust.CAMERA, slipped_s=-np.inf)
    Z = se3.invert(court.belief.T[1]) @ court.belief.T[0]
    agrees = Look("frame", Z, np.eye(6), 1e-7 * np.eye(6), 1e-7 * np.eye(6))
    court, _ = see(court, 10.0, agrees, SETTINGS)
    assert (court.trust, court.slipped_s) == (Trust.BOTH, 10.0)


def test_a_look_that_is_farther_off_than_slipping_wheels_get_is_refused_and_splits_nothing():
    court = Court(in_doubt(0.0).belief)
    Z = se3.exp([3.0, 0, 0, 0, 0, 0]) @ se3.invert(court.belief.T[1]) @ court.belief.T[0]
    look = Look("frame", Z, np.eye(6), 1e-7 * np.eye(6), 1e-7 * np.eye(6))
    after, reason = see(court, 10.0, look, SETTINGS)
    assert (after.trust, after.rival, reason) == (Trust.BOTH, None, Reason.CONTRADICTION)
    assert after.belief is court.belief
