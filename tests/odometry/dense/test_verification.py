"""Geometric verification: where surfaces alone would mislead, keypoints must say the same, or no pose is given."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from narrowing import not_none
from odometry.dense.scenes import SMALL, Plane, apart, bench, dense, frame_of
from odometry.views import covered_frame, from_start, room_frame, run
from synthetic import CAMERA, wobbling_trajectory

from wheelsight.core.calibration import Calibration
from wheelsight.core.estimates import Reason, Status
from wheelsight.core.geometry import FloatArray, se3
from wheelsight.core.keyframes import KeyframeId
from wheelsight.core.messages import RgbdFrame
from wheelsight.vision.dense.odometry import FaultDetector
from wheelsight.vision.dense.tracking import KeypointPose, KeypointTracker, KnownView
from wheelsight_sim import RobotModel

TRUTH = wobbling_trajectory(24)
IN_WORLD = from_start(np.array(TRUTH.T_frame_body))
WALL = [Plane((0, 0, 1), 1.5)]
# A corner whose three planes show all motion, and nothing is painted on them.
CORNER = [Plane((0, 0, 1), 2.0), Plane((1, 0, 0), 0.7), Plane((0, 1, 0), 0.6)]


@pytest.fixture(scope="module")
def frames() -> list[RgbdFrame]:
    return [room_frame(T, stamp_s, depth_noise=True) for stamp_s, T in TRUTH]


def still(planes: list[Plane], count: int, begin_s: float = 0.0) -> list[RgbdFrame]:
    return [frame_of(planes, np.eye(4), begin_s + k / 30, noise_seed=k) for k in range(count)]


def keypoint_tracker() -> KeypointTracker:
    return KeypointTracker(Calibration.registered_camera(SMALL))


def tell(monkeypatch: pytest.MonkeyPatch, reported: KeypointPose | None) -> None:
    """Let keypoints say that, whatever is seen."""
    monkeypatch.setattr(KeypointTracker, "track", lambda *_: reported)
    monkeypatch.setattr(KeypointTracker, "recognise", lambda *_: None)


def test_keypoints_tell_where_a_frame_is_and_nothing_of_another_place(frames: list[RgbdFrame]) -> None:
    keypoints = keypoint_tracker()
    features = keypoints.straightened(keypoints.extract(frames[0]), np.zeros(6))
    keyframes = [KnownView(KeyframeId(0), bench().reference(frames[0]), 1e-12 * np.eye(6), features)]
    found = keypoints.recognise(keypoints.extract(frames[6]), keyframes, np.zeros(6))
    assert found is not None
    assert apart(IN_WORLD[6], found.T_map_camera)[0] < 0.02
    assert 20 < found.inliers <= found.matches
    elsewhere = frame_of(CORNER, np.eye(4), 1.0, noise_seed=1)
    assert keypoints.recognise(keypoints.extract(elsewhere), keyframes, np.zeros(6)) is None


def test_keypoints_agree_with_what_they_cannot_tell_from_their_own() -> None:
    """Far keypoints hardly tell a way aside from a turn: where both may be so, they do not contradict surfaces."""
    vague = KeypointPose(np.eye(4), np.diag(np.square([0.06, 0.005, 0.005, 0.002, 0.01, 0.002])), 90, 80)
    clear = KeypointPose(np.eye(4), 2.5e-5 * np.eye(6), 90, 80)
    for way, is_like_vague, is_like_clear in (
        ([0.01, 0, 0, 0, 0, 0], True, True),
        ([0.1, 0, 0, 0, 0.02, 0], True, False),
        ([0, 0.1, 0, 0, 0, 0], False, False),
        ([0.17, 0, 0, 0, 0, 0], True, False),
        ([0.3, 0, 0, 0, 0, 0], False, False),
    ):
        assert vague.agrees_with(se3.exp(way)) == is_like_vague
        assert clear.agrees_with(se3.exp(way)) == is_like_clear


def test_a_plain_wall_is_no_pose_for_long(frames: list[RgbdFrame]) -> None:
    answers = run(dense(), still(WALL, 40))
    said = [a for a in answers if a.status is Status.TRACKING]
    assert len(said) < 0.7 * 30 + 2
    assert Reason.DEGENERATE in {a.reason for a in answers}
    assert all(a.T_odom_body is None for a in answers[25:])


def test_a_plain_wall_is_a_pose_where_somebody_else_shows_the_motion() -> None:
    subject, missed = dense(), 0
    way = se3.exp([0.01, 0, 0, 0, 0, 0])
    T = np.eye(4)
    for k in range(40):
        answer = subject.process(frame_of(WALL, T, k / 30, noise_seed=k), way if k else None)
        missed += answer.status is not Status.TRACKING  # where noise would make a leap
        assert answer.T_odom_body is None or apart(T, answer.T_odom_body)[0] < 0.02
        T = T @ way
    assert missed <= 2


def test_what_was_unseen_for_too_long_is_forgotten_where_keypoints_tell_the_place(
    frames: list[RgbdFrame], monkeypatch: pytest.MonkeyPatch
) -> None:
    """A view that shows no motion for long ends tracking, but not for good: what comes after is a known place again."""
    subject = dense(max_unseen_s=0.1)
    run(subject, frames[:4])

    def unseen(faults: FaultDetector, seconds: float, *, shows_all: bool) -> None:
        faults.unseen_s = 0.2

    with monkeypatch.context() as blind:
        tell(blind, None)
        blind.setattr(FaultDetector, "count", unseen)
        assert subject.process(frames[4]).reason is Reason.DEGENERATE
    again = run(subject, frames[5:8])
    assert [a.status for a in again] == [Status.TRACKING] * 3
    assert again[-1].shows_all
    assert max(apart(IN_WORLD[5 + k], not_none(a.T_odom_body))[0] for k, a in enumerate(again)) < 5e-3


def test_after_a_gap_like_surfaces_are_no_place() -> None:
    """A corner shows all motion, so it is tracked; but one that is met again after a while may be any corner."""
    before, after = still(CORNER, 6), still(CORNER, 6, begin_s=2.0)
    answers = run(dense(), [*before, *(covered_frame(0.2 + k / 10) for k in range(18)), *after])
    assert all(a.status is Status.TRACKING for a in answers[:6])
    assert [a.reason for a in answers[-6:]] == [Reason.NOT_RECOGNISED] * 6


def test_after_a_gap_a_place_is_recognised_by_its_keypoints(frames: list[RgbdFrame]) -> None:
    later = [room_frame(TRUTH.T_frame_body[k], frames[k].stamp_s + 2.0, depth_noise=True) for k in range(8, 12)]
    answers = run(dense(), [*frames[:10], *later])
    assert [a.status for a in answers[-4:]] == [Status.TRACKING] * 4
    assert max(apart(IN_WORLD[k], not_none(answers[k + 2].T_odom_body))[0] for k in range(8, 12)) < 5e-3


@pytest.mark.parametrize("is_helped", [True, False])
def test_few_keypoints_that_agree_do_not_outweigh_surfaces(
    frames: list[RgbdFrame], monkeypatch: pytest.MonkeyPatch, is_helped: bool
) -> None:
    subject = dense()
    run(subject, frames[:7])
    tell(monkeypatch, reported_at(se3.from_parts(np.eye(3), [0.2, 0, 0]) @ IN_WORLD[7], 36))
    answer = subject.process(frames[7], se3.invert(IN_WORLD[6]) @ IN_WORLD[7] if is_helped else None)
    assert answer.status is Status.TRACKING
    assert apart(IN_WORLD[7], not_none(answer.T_odom_body))[0] < 5e-3


@pytest.mark.parametrize("off_m", [0.2, 1.0])
def test_keypoints_that_clearly_contradict_surfaces_are_the_pose(
    frames: list[RgbdFrame], monkeypatch: pytest.MonkeyPatch, off_m: float
) -> None:
    """Surfaces that look alike fit anywhere; most of a hundred keypoints agree at one place alone."""
    subject = dense()
    run(subject, frames[:7])
    reported = reported_at(se3.from_parts(np.eye(3), [off_m, 0, 0]) @ IN_WORLD[7])
    tell(monkeypatch, reported)
    answer = subject.process(frames[7])
    assert answer.status is Status.TRACKING
    np.testing.assert_allclose(not_none(answer.T_odom_body), reported.T_map_camera, atol=1e-9)
    # What surfaces have against it makes it less certain.
    assert (np.linalg.eigvalsh(not_none(answer.covariance) - reported.covariance) > -1e-12).all()


def test_what_keypoints_track_is_tracked_where_surfaces_show_nothing(
    frames: list[RgbdFrame], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Depth of a tenth of the image, around what is textured: too little for surfaces."""
    monkeypatch.setattr("wheelsight.vision.dense.odometry._MIN_DEPTH_SHARE", 0.9)
    subject = dense()
    blind = [
        replace(f, depth_m=np.where(np.arange(f.depth_m.shape[1]) < 0.7 * f.depth_m.shape[1], f.depth_m, 0))
        for f in frames
    ]
    run(subject, frames[:3])
    answers = run(subject, [replace(f, depth_m=f.depth_m.astype(np.float32)) for f in blind[3:9]])
    assert [a.status for a in answers] == [Status.TRACKING] * 6
    assert max(apart(IN_WORLD[3 + k], not_none(a.T_odom_body))[0] for k, a in enumerate(answers)) < 0.02


SLIP = se3.exp([0.02, 0, 0, 0, 0, 0])  # in a thirtieth of a second


def reported_at(T_map_camera: FloatArray, inliers: int = 80) -> KeypointPose:
    return KeypointPose(np.asarray(T_map_camera), 1e-4 * np.eye(6), 90, inliers)


@pytest.mark.parametrize(
    "reported", [None, reported_at(IN_WORLD[7] @ se3.exp([0.2, 0, 0, 0, 0, 0]), 30), reported_at(IN_WORLD[7])]
)
def test_a_pose_that_wheels_do_not_expect_stays_where_keypoints_do_not_contradict_it(
    frames: list[RgbdFrame], monkeypatch: pytest.MonkeyPatch, reported: KeypointPose | None
) -> None:
    """Wheels slip. Keypoints that know nothing, or of which few agree, contradict nothing."""
    subject = dense()
    run(subject, frames[:7])
    tell(monkeypatch, reported)
    answer = subject.process(frames[7], se3.invert(IN_WORLD[6]) @ IN_WORLD[7] @ SLIP)
    assert answer.status is Status.TRACKING
    assert apart(IN_WORLD[7], not_none(answer.T_odom_body))[0] < 5e-3


def test_a_pose_that_neither_wheels_nor_keypoints_expect_is_not_taken(
    frames: list[RgbdFrame], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Somebody who walks by carries the surfaces along: what keypoints clearly say is the pose."""
    monkeypatch.setattr("wheelsight.vision.dense.odometry._LEAP", (9.0, 9.0))  # as smooth as any
    subject = dense()
    run(subject, frames[:7])
    by_wheels = IN_WORLD[7] @ se3.exp([0.06, 0, 0, 0, 0, 0])
    tell(monkeypatch, reported_at(by_wheels))
    answer = subject.process(frames[7], se3.invert(IN_WORLD[6]) @ by_wheels)
    assert answer.status is Status.TRACKING
    assert apart(by_wheels, not_none(answer.T_odom_body))[0] < 0.02  # surfaces are 0.06 off, keypoints know it to 0.01


@pytest.mark.parametrize("is_off", [True, False])
def test_after_a_failure_a_pose_that_wheels_do_not_expect_needs_keypoints(
    frames: list[RgbdFrame], monkeypatch: pytest.MonkeyPatch, is_off: bool
) -> None:
    subject = dense()
    run(subject, frames[:7])
    subject.miss(frames[7].stamp_s)
    tell(monkeypatch, None)
    prior = se3.invert(IN_WORLD[6]) @ IN_WORLD[8]
    answer = subject.process(frames[8], prior @ SLIP if is_off else prior)
    assert answer.status is (Status.FAILING if is_off else Status.TRACKING)


def test_a_leap_is_believed_only_with_keypoints(frames: list[RgbdFrame], monkeypatch: pytest.MonkeyPatch) -> None:
    leap = np.array(TRUTH.T_frame_body[6]) @ se3.exp([0.06, 0, 0, 0, 0.02, 0])
    leapt = room_frame(leap, frames[7].stamp_s, depth_noise=True)
    seen, blind = dense(), dense()
    run(seen, frames[:7]), run(blind, frames[:7])
    assert seen.process(leapt).status is Status.TRACKING
    tell(monkeypatch, None)
    assert blind.process(leapt).reason is Reason.NOT_RECOGNISED


@pytest.mark.parametrize("degrees", [-25, -20, -16, 16, 20, 25])
def test_a_turn_too_wide_to_follow_is_no_wrong_pose(degrees: float) -> None:
    """On a slow camera: surfaces slide to where something fits, and only how badly it does shows."""
    start = np.array(TRUTH.T_frame_body[0])
    turned = start @ se3.exp([0, 0, 0, 0, np.deg2rad(degrees), 0])
    calibration = replace(Calibration.registered_camera(CAMERA), T_base_camera=RobotModel().T_base_camera)
    subject = dense(calibration)
    run(subject, [room_frame(start, k / 5, depth_noise=True) for k in range(3)])
    answer = subject.process(room_frame(turned, 0.6, depth_noise=True))
    assert answer.T_odom_body is None or apart(se3.invert(start) @ turned, answer.T_odom_body)[0] < 0.01


@pytest.mark.parametrize("inliers", [30, 50, 90])
def test_after_a_while_most_keypoints_must_agree(
    frames: list[RgbdFrame], monkeypatch: pytest.MonkeyPatch, inliers: int
) -> None:
    """Another corridor with the same door: a fifth of 100 keypoints agreed on a place 7 m away, and surfaces too."""
    subject, last_s = dense(), frames[6].stamp_s
    run(subject, [*frames[:7], *(covered_frame(last_s + 0.1 * k) for k in range(1, 24))])
    reported = KeypointPose(IN_WORLD[7], 1e-4 * np.eye(6), 100, inliers)
    tell(monkeypatch, reported)
    answer = subject.process(room_frame(TRUTH.T_frame_body[7], last_s + 2.4, depth_noise=True))
    assert (answer.T_odom_body is not None) == (inliers >= 50)
    assert inliers >= 50 or answer.reason is Reason.NOT_RECOGNISED
