"""FaultDetection: what is believed after doubt that no one has settled."""

from __future__ import annotations

import numpy as np
import pytest

from wheelsight.core.estimates import Reason
from wheelsight.core.geometry import se3
from wheelsight.estimation.fault_detection import Fault, FaultDetection, updated
from wheelsight.estimation.pose_belief import FilterParameters, PoseBelief, RelativeMotion, WheelStep

SETTINGS = FilterParameters.of()
BEGUN_S, FRAME_S = 8.0, 0.1
APART = np.array([0.02, -0.03, 0.0, 0.0, 0.0, np.radians(2.4)])


def apart(T, other):
    """Metres and degrees."""
    xi = se3.log(se3.invert(T) @ other)
    return np.array([np.linalg.norm(xi[:3]), np.degrees(np.linalg.norm(xi[3:]))])


def undecided(log_ratio):
    """At 10 s, when both agree again for the last time that is asked for: 2.4 degrees apart, nearly so a frame ago."""
    begun = PoseBelief.begin(se3.exp([1.0, 2.0, 0, 0, 0, 0.3]), np.diag(np.square([0.05] * 3 + [0.01] * 3)), SETTINGS)
    step = WheelStep(10.0 - FRAME_S, 10.0, np.array([0.08, 0, 0, 0, 0, 0.02]), np.diag([1e-6, 0, 0, 0, 0, 1e-6]))
    belief = begun.cloned("frame", 10.0 - FRAME_S, 4).moved_by_wheels(step, 1.0, SETTINGS, False)
    off = np.zeros(len(belief.covariance))
    off[:6], off[6:12] = APART, 0.99 * APART
    alternative = belief.retracted(off, belief.covariance)
    return FaultDetection(
        belief, alternative, Fault.UNDECIDED, log_ratio, agreed=SETTINGS.agreements - 1, since_s=BEGUN_S
    )


def looked(detection, wrong):
    """What the alternative expects to be seen, wrong by a tangent (6,)."""
    assert detection.alternative is not None
    Z = se3.exp(wrong) @ se3.invert(detection.alternative.T[1]) @ detection.alternative.T[0]
    return RelativeMotion("frame", Z, np.eye(6), 1e-7 * np.eye(6), 1e-7 * np.eye(6))


@pytest.mark.parametrize(("log_ratio", "by_camera"), [(1.5, True), (-2.0, False), (0.0, False)])
def test_where_both_agree_again_the_likelier_goes_on_and_covers_the_other(log_ratio, by_camera):
    detection = undecided(log_ratio)
    detection_after, reason = updated(detection, 10.0, looked(detection, np.zeros(6)), SETTINGS)
    assert (detection_after.fault, detection_after.alternative, reason) == (Fault.NONE, None, None)
    likelier, other = (
        (detection.alternative, detection.primary) if by_camera else (detection.primary, detection.alternative)
    )
    now = detection_after.primary
    assert (apart(now.T[0], likelier.T[0]) < [0.01, 0.1]).all()
    off = se3.log(other.T[0] @ se3.invert(now.T[0]))
    assert off @ np.linalg.solve(now.covariance[:6, :6], off) < 9


@pytest.mark.parametrize("seed", range(5))
def test_noise_of_the_looks_after_doubt_does_not_decide_who_was_right(seed):
    detection, rng = undecided(1.5), np.random.default_rng(seed)
    assert detection.alternative is not None
    measurements = [looked(undecided(1.5), rng.normal(size=6) * 3e-4) for _ in range(3)]
    detection, _ = updated(detection, 10.0, measurements[0], SETTINGS)  # which ends the doubt
    for k, measurement in enumerate(measurements[1:], 1):
        reported, reason = updated(detection, 10.0 + k * 1e-3, measurement, SETTINGS)
        assert reason is None
        assert (apart(detection.primary.T[0], reported.primary.T[0]) < [0.005, 0.1]).all()
        detection = reported


def test_a_look_that_is_farther_off_than_slipping_wheels_get_is_refused_and_splits_nothing():
    detection = FaultDetection(undecided(0.0).primary)
    Z = se3.exp([3.0, 0, 0, 0, 0, 0]) @ se3.invert(detection.primary.T[1]) @ detection.primary.T[0]
    measurement = RelativeMotion("frame", Z, np.eye(6), 1e-7 * np.eye(6), 1e-7 * np.eye(6))
    after, reason = updated(detection, 10.0, measurement, SETTINGS)
    assert (after.fault, after.alternative, reason) == (Fault.NONE, None, Reason.CONTRADICTION)
    assert after.primary is detection.primary
