"""What others tell of the motion: a prior that is right, one that is wrong, and a start where nothing is known."""

from __future__ import annotations

import numpy as np
import pytest
from narrowing import not_none
from odometry.dense.scenes import SMALL, Plane, apart, bench, dense, frame_of
from odometry.views import covered_frame, from_start, room_frame, run
from synthetic import wobbling_trajectory

from wheelsight.core.calibration import Calibration
from wheelsight.core.estimates import Estimate, MotionEstimate, Reason, Status
from wheelsight.core.geometry import FloatArray, se3
from wheelsight.core.messages import RgbdFrame
from wheelsight.vision.dense import DenseOdometry, alignment
from wheelsight.vision.dense.tracking import KeypointTracker

TRUTH = wobbling_trajectory(24)
IN_WORLD = from_start(np.array(TRUTH.T_frame_body))
# A corner whose three planes show all motion, and nothing is painted on them.
CORNER = [Plane((0, 0, 1), 2.0), Plane((1, 0, 0), 0.7), Plane((0, 1, 0), 0.6)]
WAY = se3.exp([0.005, 0.0, 0.008, 0.0, 0.004, 0.0])


@pytest.fixture(scope="module")
def frames() -> list[RgbdFrame]:
    return [room_frame(T, stamp_s, depth_noise=True) for stamp_s, T in TRUTH]


@pytest.fixture(scope="module")
def corner() -> list[RgbdFrame]:
    """Seen on the way, `WAY` from frame to frame."""
    return [frame_of(CORNER, on_the_way(k), k / 30, noise_seed=k) for k in range(12)]


def on_the_way(steps: int) -> FloatArray:
    return np.asarray(np.linalg.matrix_power(WAY, steps))


def with_priors(subject: DenseOdometry, frames: list[RgbdFrame], prior: FloatArray) -> list[Estimate]:
    return [subject.process(frame, prior if index else None) for index, frame in enumerate(frames)]


def test_a_prior_stands_in_for_keypoints_after_a_failure(corner: list[RgbdFrame]) -> None:
    with_prior, alone = dense(), dense()
    with_priors(with_prior, corner[:5], WAY)
    run(alone, corner[:5])
    for subject in (with_prior, alone):
        assert subject.process(covered_frame(corner[5].stamp_s)).reason is Reason.TOO_LITTLE_DEPTH
    reported = with_prior.process(corner[6], on_the_way(2))
    assert reported.status is Status.TRACKING
    assert apart(on_the_way(6), not_none(reported.T_odom_body))[0] < 0.01
    assert alone.process(corner[6]).reason is Reason.NOT_RECOGNISED


def test_a_leap_against_a_prior_is_believed_only_with_keypoints(
    frames: list[RgbdFrame], monkeypatch: pytest.MonkeyPatch
) -> None:
    """A camera that was still, and wheels that say so: whatever moves the view is no motion but with keypoints."""
    still = [room_frame(TRUTH.T_frame_body[0], k / 30, depth_noise=True) for k in range(3)]
    leapt = room_frame(TRUTH.T_frame_body[0] @ se3.exp([0.06, 0, 0, 0, 0.02, 0]), 3 / 30, depth_noise=True)
    seen, blind = dense(), dense()
    for subject in (seen, blind):
        with_priors(subject, still, np.eye(4))
    assert seen.process(leapt, np.eye(4)).status is Status.TRACKING
    monkeypatch.setattr(KeypointTracker, "track", lambda *_: None)
    monkeypatch.setattr(KeypointTracker, "recognise", lambda *_: None)
    assert blind.process(leapt, np.eye(4)).reason is Reason.NOT_RECOGNISED


@pytest.mark.parametrize("place", ["room", "corner"])
def test_wheels_that_spin_do_not_lead_the_camera_astray(
    frames: list[RgbdFrame], corner: list[RgbdFrame], place: str
) -> None:
    """They expect 2 m/s more than is true; what shows all motion is not to follow."""
    spun = se3.exp([0.0, 0.0, 2.0 / 30, 0.0, 0.0, 0.0])
    shown, T_true = (frames, IN_WORLD) if place == "room" else (corner, [on_the_way(k) for k in range(12)])
    subject = dense()
    run(subject, shown[:5])
    for k in range(5, 11):
        answer = subject.process(shown[k], se3.invert(T_true[k - 1]) @ T_true[k] @ spun)
        assert answer.status is Status.TRACKING
        assert apart(T_true[k], not_none(answer.T_odom_body))[0] < 0.01


def test_it_goes_on_where_others_tell_it_to(frames: list[RgbdFrame]) -> None:
    subject = dense()
    run(subject, frames[:3])
    T_reported, covariance = se3.exp([0.5, -0.3, 0.2, 0.1, 0.4, 0.0]), np.diag([1e-4] * 3 + [1e-5] * 3)
    again = subject.restart(frames[6], T_reported, covariance)
    assert again.status is Status.TRACKING
    np.testing.assert_array_equal(again.T_odom_body, T_reported)
    np.testing.assert_array_equal(again.covariance, covariance)
    np.testing.assert_array_equal(again.motion.T_reference_current, np.eye(4))
    assert again.frame is not None
    assert subject.surface(again.frame, frames[6]).depth_m.any()
    for k in (7, 8, 9):
        answer = subject.process(frames[k])
        T_expected = T_reported @ se3.invert(IN_WORLD[6]) @ IN_WORLD[k]
        assert answer.status is Status.TRACKING
        assert apart(T_expected, not_none(answer.T_odom_body))[0] < 5e-3
        # What was reported stays uncertain.
        assert np.linalg.eigvalsh(not_none(answer.covariance) - 0.99 * covariance)[0] > 0


def test_what_was_known_before_a_restart_is_recognised_after_it(
    frames: list[RgbdFrame], corner: list[RgbdFrame]
) -> None:
    subject = dense(lost_after=3)
    run(subject, frames[:6])
    later_s = frames[5].stamp_s + 1.0
    elsewhere = [frame_of(CORNER, on_the_way(k), later_s + k / 30, noise_seed=k) for k in range(4)]
    assert subject.process(elsewhere[0]).T_odom_body is None
    assert subject.restart(elsewhere[1], se3.exp([5.0, 0, 0, 0, 0, 0]), 1e-4 * np.eye(6)).status is Status.TRACKING
    for frame in elsewhere[2:]:
        assert subject.process(frame).status is Status.TRACKING
    run(subject, [covered_frame(later_s + 0.2 + k / 30) for k in range(4)])
    back = [room_frame(TRUTH.T_frame_body[0], later_s + 1.0 + k / 30, depth_noise=True) for k in range(4)]
    answers = run(subject, back)
    assert answers[-1].status is Status.TRACKING
    assert apart(IN_WORLD[0], not_none(answers[-1].T_odom_body))[0] < 0.01


def test_without_depth_there_is_no_restart(frames: list[RgbdFrame]) -> None:
    subject = dense()
    run(subject, frames[:3])
    none = subject.restart(covered_frame(frames[3].stamp_s), np.eye(4), np.eye(6))
    assert (none.T_odom_body, none.reason) == (None, Reason.TOO_LITTLE_DEPTH)
    assert apart(IN_WORLD[4], not_none(subject.process(frames[4]).T_odom_body))[0] < 5e-3


@pytest.mark.parametrize("far", [1e9, np.nan, np.inf])
def test_an_alignment_that_runs_away_ends_where_it_began_and_shows_nothing(
    frames: list[RgbdFrame], corner: list[RgbdFrame], monkeypatch: pytest.MonkeyPatch, far: float
) -> None:
    def run_away(sums: FloatArray, T: FloatArray, *_: FloatArray) -> float:
        T[:3, 3] = far
        return 1.0

    monkeypatch.setattr(alignment, "advance", run_away)
    guess = se3.exp([0.01, 0.0, 0.0, 0.0, 0.02, 0.0])
    found = bench().align(frames[0], frames[1], guess)
    np.testing.assert_allclose(found.T_reference_frame, guess, atol=1e-12)
    assert (found.planes, found.pairs, found.residual) == (0, 0, np.inf)
    np.testing.assert_array_equal(found.information, np.zeros((6, 6)))
    subject = dense()
    answers = run(subject, corner[:3])  # which has no keypoints either
    assert [answer.T_odom_body is None for answer in answers] == [False, True, True]
    assert {answer.reason for answer in answers[1:]} == {Reason.TOO_LITTLE_OVERLAP}


def test_a_restart_right_after_the_first_frame_forgets_to_straighten_that(frames: list[RgbdFrame]) -> None:
    """A rolling shutter's first frame is straightened once the second shows the speed; that is not one far away."""
    calibration = Calibration.registered_camera(SMALL, rolling_shutter_s=0.02)
    subject = dense(calibration)
    elsewhere = [frame_of(CORNER, on_the_way(k), frames[0].stamp_s + 0.1 * k, noise_seed=k) for k in range(1, 5)]
    run(subject, [frames[0]])
    T_reported = se3.exp([2.0, 0.0, 0.0, 0.0, 0.0, 0.0])
    subject.restart(elsewhere[0], T_reported, 1e-4 * np.eye(6))
    for k, frame in enumerate(elsewhere[1:], 1):
        answer = subject.process(frame, WAY)
        assert answer.status is Status.TRACKING
        assert apart(T_reported @ on_the_way(k), not_none(answer.T_odom_body))[0] < 0.02


def test_a_second_frame_that_keypoints_alone_found_leaves_the_first_in_its_place(
    frames: list[RgbdFrame], monkeypatch: pytest.MonkeyPatch
) -> None:
    """The third put the first one's image where the second was, and looked for landmarks that had been forgotten."""
    subject = dense(Calibration.registered_camera(SMALL, rolling_shutter_s=0.02))
    run(subject, frames[:1])
    with monkeypatch.context() as patched:
        fail = lambda *_: MotionEstimate.failed(Reason.POOR_FIT)  # noqa: E731
        patched.setattr(subject._locator, "locate", fail)  # noqa: SLF001
        assert subject.process(frames[1]).status is Status.TRACKING
    for k, answer in enumerate(run(subject, frames[2:5]), 2):
        assert answer.status is Status.TRACKING
        assert apart(IN_WORLD[k], not_none(answer.T_odom_body))[0] < 0.02
