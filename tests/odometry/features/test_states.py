"""The state machine of Zhang's Fig. 3: start, track, fail, be lost, recover; never a pose while failing."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pytest
from narrowing import not_none
from odometry.views import FRAME_S, covered_frame, error_of, from_start, odometry, room_frame, room_frames, run
from synthetic import CAMERA, wobbling_trajectory

from wheelsight.core.estimates import Estimate, Reason, Status
from wheelsight.core.geometry import se3
from wheelsight.core.messages import RgbdFrame
from wheelsight.core.trajectory import Trajectory

TRUTH = wobbling_trajectory(40)
MODES = ["keyframes", "previous"]


@pytest.fixture(scope="module")
def frames() -> list[RgbdFrame]:
    return room_frames(TRUTH)


def covered(frames: list[RgbdFrame], first: int, last: int) -> list[RgbdFrame]:
    """The frames with those of a range covered."""
    return [covered_frame(f.stamp_s) if first <= i < last else f for i, f in enumerate(frames)]


def statuses(answers: Sequence[Estimate]) -> list[Status]:
    for answer in answers:
        has_pose = answer.T_odom_body is not None
        assert (
            has_pose == (answer.status is Status.TRACKING) == (answer.reason is None) == (answer.covariance is not None)
        )
    return [answer.status for answer in answers]


@pytest.mark.parametrize("reference", MODES)
def test_the_sequence_of_states(frames, reference):
    answers = run(odometry(reference=reference, lost_after=4), covered(covered(frames[:24], 0, 3), 8, 15))
    expected = [Status.INITIALIZING] * 3 + [Status.TRACKING] * 5 + [Status.FAILING] * 3 + [Status.LOST] * 4
    assert statuses(answers) == expected + [Status.TRACKING] * 9
    world = from_start(TRUTH.T_frame_body[3:])
    for answer, truth in zip(answers[3:], world, strict=False):
        if answer.T_odom_body is not None:
            assert error_of(answer, truth)[0] < 0.03
    assert {answer.reason for answer in answers[8:15]} == {Reason.TOO_FEW_KEYPOINTS}


def test_failures_before_the_start_do_not_count_against_it(frames):
    answers = run(odometry(lost_after=3), covered(covered(frames[:12], 0, 6), 7, 9))
    assert statuses(answers)[6:10] == [Status.TRACKING, Status.FAILING, Status.FAILING, Status.TRACKING]


def test_the_world_is_where_the_camera_started(frames):
    subject = odometry()
    first = subject.process(frames[0])
    np.testing.assert_array_equal(first.T_odom_body, np.eye(4))
    assert (np.linalg.eigvalsh(not_none(first.covariance)) > 0).all()
    assert first.matched is None
    assert first.motion.reason is None


@pytest.mark.parametrize("reference", MODES)
def test_a_bare_wall_after_the_start_gives_no_pose(frames, reference):
    subject = odometry(reference=reference)
    subject.process(frames[0])
    answer = subject.process(room_frame(TRUTH.T_frame_body[1], TRUTH.stamps_s[1], blank=True))
    assert (answer.status, answer.T_odom_body, answer.reason) == (Status.FAILING, None, Reason.TOO_FEW_KEYPOINTS)


def test_frames_of_another_place_give_no_pose_with_the_reason(frames):
    subject = odometry(lost_after=3)
    subject.process(frames[0])
    elsewhere = [room_frame(T, stamp, seed=77) for stamp, T in list(TRUTH)[1:5]]
    answers = run(subject, elsewhere)
    assert statuses(answers) == [Status.FAILING] * 2 + [Status.LOST] * 2
    assert {answer.reason for answer in answers} <= {Reason.TOO_FEW_MATCHES, Reason.TOO_FEW_INLIERS}


@pytest.mark.parametrize("reference", MODES)
def test_miss_counts_as_a_failed_frame(frames, reference):
    subject = odometry(reference=reference, lost_after=2)
    assert subject.miss(99.0).status is Status.INITIALIZING
    run(subject, frames[:3])
    first, second = subject.miss(200.0), subject.miss(201.0)
    assert [first.status, second.status] == [Status.FAILING, Status.LOST]
    assert (first.stamp_s, first.reason, first.T_odom_body) == (200.0, Reason.FRAME_UNUSABLE, None)
    assert second.matched is None
    assert second.motion.reason is Reason.FRAME_UNUSABLE
    assert subject.process(frames[3]).status is Status.TRACKING


def test_what_is_reported_of_the_last_frame(frames):
    subject = odometry()
    run(subject, frames[:10])
    answer = subject.process(frames[10])
    matches, motion = answer.matched, answer.motion
    assert not_none(matches).reference_stamp_s == frames[9].stamp_s
    assert not_none(matches).px.shape == not_none(matches).reference_px.shape == (len(not_none(matches).is_inlier), 2)
    assert (
        np.median(
            np.linalg.norm(not_none(matches).px - not_none(matches).reference_px, axis=1)[not_none(matches).is_inlier]
        )
        < 10
    )
    assert not_none(matches).is_inlier.sum() > 100
    assert (answer.matches, answer.inliers) == (motion.matches, motion.inliers)
    assert 100 < motion.inliers <= motion.matches
    assert set(subject.stage_seconds) == {"extract", "match", "align", "map"}
    assert all(seconds > 0 for seconds in subject.stage_seconds.values())
    covered_answer = subject.process(covered_frame(frames[11].stamp_s))
    assert covered_answer.matched is None
    assert covered_answer.motion.T_reference_current is None
    assert set(subject.stage_seconds) == {"extract"}


def test_the_previous_frame_is_the_reference_in_the_paper_s_mode(frames):
    subject = odometry(reference="previous")
    world = from_start(TRUTH.T_frame_body)
    for i in range(8):
        before = subject.process(frames[i])
    answer = subject.process(frames[8])
    motion = answer.motion
    np.testing.assert_allclose(
        not_none(before.T_odom_body) @ not_none(motion.T_reference_current), not_none(answer.T_odom_body), atol=1e-12
    )
    true_motion = se3.invert(world[7]) @ world[8]
    np.testing.assert_allclose(not_none(motion.T_reference_current), true_motion, atol=0.01)
    assert not_none(answer.matched).reference_stamp_s == frames[7].stamp_s


@pytest.mark.parametrize("reference", MODES)
def test_looking_away_and_back_recovers_the_place(reference):
    """The camera looks at another place for so long that it is lost, then back at where it was."""
    there = wobbling_trajectory(12)
    turned = se3.exp(np.array([0, 0, 0, 0, np.pi, 0]))
    stamps = 100 + FRAME_S * np.arange(36)
    views = [*there.T_frame_body, *(T @ turned for T in there.T_frame_body), *there.T_frame_body[::-1]]
    answers = run(odometry(reference=reference, lost_after=5), room_frames(zip(stamps, views, strict=True)))
    assert statuses(answers)[:12] == [Status.TRACKING] * 12
    assert statuses(answers)[12:24] == [Status.FAILING] * 4 + [Status.LOST] * 8
    assert statuses(answers)[24:] == [Status.TRACKING] * 12
    world = from_start(np.array(views))
    assert max(error_of(answer, truth)[0] for answer, truth in zip(answers[24:], world[24:], strict=True)) < 0.03


def test_once_lost_an_older_keyframe_is_recognised():
    """After a sweep over the room and a blackout, the camera is back where it began, out of the last view's sight."""
    sweep = wobbling_trajectory(70, speed=3.0).select(slice(0, 70, 2))
    stamps = 100 + FRAME_S * np.arange(35 + 20 + 30)
    frames = room_frames(zip(stamps[:35], sweep.T_frame_body, strict=True))
    frames += [covered_frame(stamp) for stamp in stamps[35:55]]
    frames += [room_frame(sweep.T_frame_body[0], stamp) for stamp in stamps[55:]]
    answers = run(odometry(), frames)
    assert statuses(answers)[35:45] == [Status.FAILING] * 9 + [Status.LOST]
    back = [answer for answer in answers[55:] if answer.T_odom_body is not None]
    assert len(back) > 15
    assert all(error_of(answer, np.eye(4))[0] < 0.05 for answer in back)


def teleported(metres: float, after_s: float) -> Estimate:
    """The answer to a frame as far aside, after tracking well; the jump keeps most of the view in sight."""
    start = TRUTH.T_frame_body[0]
    subject = odometry()
    aside = se3.from_parts(np.eye(3), [0, metres, 0]) @ start
    run(subject, room_frames(zip(100 + FRAME_S * np.arange(3), [start] * 3, strict=True)))
    return subject.process(room_frame(aside, 100 + 2 * FRAME_S + after_s))


def test_a_jump_no_camera_can_make_gives_no_pose():
    answer = teleported(0.5, FRAME_S)
    assert (answer.status, answer.T_odom_body, answer.reason) == (Status.FAILING, None, Reason.IMPLAUSIBLE_MOTION)
    far = teleported(2.0, FRAME_S)
    assert (far.status, far.T_odom_body) == (Status.FAILING, None)
    assert far.reason is not None


def test_the_same_jump_is_believed_where_there_was_time_for_it():
    answer = teleported(0.5, 0.5)
    assert answer.status is Status.TRACKING
    np.testing.assert_allclose(np.linalg.norm(not_none(answer.T_odom_body)[:3, 3]), 0.5, atol=0.02)


def test_a_slow_camera_may_not_jump_either():
    """At 4 Hz, 1 m to the side in a frame is allowed 5 m/s, but not a limit of 1 m/s."""
    start = TRUTH.T_frame_body[0]
    aside = se3.from_parts(np.eye(3), [0, 0.5, 0]) @ start
    frames = [room_frame(T, stamp) for stamp, T in [(0.0, start), (0.25, start), (0.5, aside)]]
    assert run(odometry(), frames)[-1].status is Status.TRACKING
    refused = run(odometry(max_speed_m_s=1.0), frames)[-1]
    assert (refused.status, refused.reason) == (Status.FAILING, Reason.IMPLAUSIBLE_MOTION)


@pytest.mark.parametrize("reference", MODES)
def test_keypoints_in_one_tiny_patch_never_give_a_wild_pose(reference, monkeypatch):
    u, v = np.meshgrid(np.arange(CAMERA.width), np.arange(CAMERA.height))
    outside = np.hypot(u - 160, v - 120) > 14
    answers = []
    for part in ("tracking", "odometry"):
        monkeypatch.setattr(f"wheelsight.vision.features.{part}.MIN_INLIERS", 4)
    subject = odometry(reference=reference)
    for i in range(8):
        frame = room_frame(TRUTH.T_frame_body[i], TRUTH.stamps_s[i], depth_noise=True)
        color = frame.color.copy()
        color[outside] = 128
        answers.append(subject.process(RgbdFrame(frame.stamp_s, color, frame.depth_m)))
    statuses(answers)
    world = from_start(TRUTH.T_frame_body)
    for answer, truth in zip(answers, world, strict=False):
        if answer.T_odom_body is not None:
            assert error_of(answer, truth)[0] < 0.3


@pytest.mark.parametrize("reference", MODES)
def test_a_camera_that_stands_still_stays_where_it_is(reference):
    still = Trajectory(100 + FRAME_S * np.arange(10.0), np.repeat(TRUTH.T_frame_body[:1], 10, axis=0))
    answers = run(odometry(reference=reference), room_frames(still))
    assert all(np.allclose(not_none(answer.T_odom_body), np.eye(4), atol=1e-6) for answer in answers)
