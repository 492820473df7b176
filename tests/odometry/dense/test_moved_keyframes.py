"""What dense odometry knows hangs on keyframes of the store: where these are moved, it goes on from there."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from narrowing import not_none
from odometry.dense.scenes import SMALL, apart, bench, dense
from odometry.views import covered_frame, from_start, room_frame, run
from synthetic import wobbling_trajectory

from wheelsight.core.calibration import Calibration
from wheelsight.core.estimates import Status
from wheelsight.core.geometry import FloatArray, PinholeCamera, se3
from wheelsight.core.keyframes import KeyframeStore, PredictedView
from wheelsight.core.messages import RgbdFrame
from wheelsight.vision.dense import DenseOdometry, DenseSettings
from wheelsight.vision.dense.alignment import Level
from wheelsight.vision.dense.tracking import KeypointTracker

TRUTH = wobbling_trajectory(24)
IN_MAP = from_start(np.array(TRUTH.T_frame_body))
MOVE = se3.exp([3.0, -2.0, 1.0, 0.4, -0.6, 0.8])
NUDGE = se3.exp([0.05, -0.02, 0.03, 0.01, -0.02, 0.01])
# So much in sight that keyframes are made all the time.
BUSY: dict[str, Any] = {"keyframe_overlap": 0.97}


@pytest.fixture(scope="module")
def frames() -> list[RgbdFrame]:
    return [room_frame(T, stamp_s, depth_noise=True) for stamp_s, T in TRUTH]


def move_all(store: KeyframeStore, T_new_old: FloatArray) -> None:
    store.move(list(store), T_new_old @ store.T_map_keyframe)


@pytest.mark.parametrize(
    "settings",
    [{}, pytest.param(BUSY, marks=pytest.mark.slow), {"reference": "previous"}],
    ids=["keyframes", "many", "previous"],
)
def test_where_all_keyframes_are_moved_alike_all_that_follows_is(
    frames: list[RgbdFrame], settings: dict[str, Any]
) -> None:
    still, subject = dense(**settings), dense(**settings)
    expected = run(still, frames)
    run(subject, frames[:12])
    move_all(subject.store, MOVE)
    for answer, as_before in zip(run(subject, frames[12:]), expected[12:], strict=True):
        assert answer.status is Status.TRACKING
        np.testing.assert_allclose(not_none(answer.T_odom_body), MOVE @ not_none(as_before.T_odom_body), atol=1e-5)
        Ad = se3.adjoint(MOVE)
        np.testing.assert_allclose(
            not_none(answer.covariance), Ad @ not_none(as_before.covariance) @ Ad.T, rtol=1e-2, atol=1e-8
        )
        assert answer.keyframe == as_before.keyframe
        np.testing.assert_allclose(not_none(answer.T_keyframe_body), not_none(as_before.T_keyframe_body), atol=1e-5)
        seen, expected_motion = answer.motion.T_reference_current, as_before.motion.T_reference_current
        np.testing.assert_allclose(not_none(seen), not_none(expected_motion), atol=1e-5)


def test_where_one_keyframe_is_moved_what_hangs_on_it_comes_along_and_nothing_else(
    frames: list[RgbdFrame], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Keypoints are left out: their landmarks hang on several keyframes, which a nudge of one sets at odds."""
    monkeypatch.setattr(KeypointTracker, "track", lambda *_: None)
    still, subject = dense(**BUSY), dense(**BUSY)
    expected, before = run(still, frames), run(subject, frames[:12])
    newest = before[-1].keyframe
    assert newest is not None
    assert newest >= 2
    subject.store.move([newest], [NUDGE @ subject.store.pose(newest)])
    answer = subject.process(frames[12])
    T_expected = NUDGE @ not_none(expected[12].T_odom_body)
    assert answer.status is Status.TRACKING
    assert apart(T_expected, not_none(answer.T_odom_body))[0] < 2e-3
    assert apart(subject.store.pose(newest), still.store.pose(newest))[0] > 0.05
    np.testing.assert_array_equal(subject.store.T_map_keyframe[:newest], still.store.T_map_keyframe[:newest])


def test_the_last_pose_moves_with_its_keyframe_where_nothing_else_shows_the_next(frames: list[RgbdFrame]) -> None:
    """Moved while the camera is covered: the place is found again where it lies by now."""
    subject = dense(lost_after=3)
    run(subject, [*frames[:5], *(covered_frame(f.stamp_s) for f in frames[5:7])])
    move_all(subject.store, MOVE)
    found = subject.process(frames[7])
    assert found.status is Status.TRACKING
    assert apart(MOVE @ IN_MAP[7], not_none(found.T_odom_body))[0] < 5e-3


def test_a_place_that_was_moved_while_the_camera_was_lost_is_recognised_there(frames: list[RgbdFrame]) -> None:
    subject = dense(lost_after=3, **BUSY)
    run(subject, [*frames[:8], *(covered_frame(f.stamp_s) for f in frames[8:13])])
    move_all(subject.store, MOVE)
    found = run(subject, [room_frame(np.array(TRUTH.T_frame_body[1]), frames[k].stamp_s) for k in range(13, 17)])
    assert found[-1].status is Status.TRACKING
    assert apart(MOVE @ IN_MAP[1], not_none(found[-1].T_odom_body))[0] < 5e-3


class MovableRoom:
    """A model that predicts the room, from where the map has it."""

    def __init__(self, T_room_map: FloatArray) -> None:
        self.T_room_map = T_room_map

    def predict(self, T_map_camera: FloatArray, intrinsics: FloatArray, shape: tuple[int, int]) -> PredictedView:
        camera = PinholeCamera(shape[1], shape[0], *intrinsics.tolist())
        frame = room_frame(self.T_room_map @ T_map_camera, 0.0, camera)
        grey = (frame.color @ [0.299, 0.587, 0.114]).astype(np.float32)
        normal = bench().maker.normals(Level(intrinsics, frame.depth_m, grey))
        return PredictedView(frame.depth_m, normal, grey)


def test_a_map_that_has_moved_with_its_keyframes_is_asked_again(frames: list[RgbdFrame]) -> None:
    model = MovableRoom(np.array(TRUTH.T_frame_body[0]))
    subject = DenseOdometry(Calibration.registered_camera(SMALL), DenseSettings(), model)
    run(subject, frames[:8])
    move_all(subject.store, MOVE)
    model.T_room_map = model.T_room_map @ se3.invert(MOVE)
    for answer, T in zip(run(subject, frames[8:12]), IN_MAP[8:12], strict=True):
        assert answer.status is Status.TRACKING
        assert apart(MOVE @ T, not_none(answer.T_odom_body))[0] < 5e-3


def test_each_answer_hangs_on_a_keyframe_of_the_store_that_is_given(frames: list[RgbdFrame]) -> None:
    store = KeyframeStore()
    subject = DenseOdometry(Calibration.registered_camera(SMALL), DenseSettings(**BUSY), store=store)
    answers = run(subject, frames[:12])
    assert subject.store is store
    assert len(store) >= 3
    stamps_s = [frame.stamp_s for frame in frames]
    for answer in answers:
        assert answer.keyframe is not None
        assert answer.keyframe < len(store)
        assert store[answer.keyframe].stamp_s <= answer.stamp_s
        T_map_camera = store.pose(answer.keyframe) @ not_none(answer.T_keyframe_body)
        np.testing.assert_allclose(T_map_camera, not_none(answer.T_odom_body), atol=1e-12)
    for number in store:
        keyframe = store[number]
        at = stamps_s.index(keyframe.stamp_s)
        np.testing.assert_allclose(keyframe.depth_m, frames[at].depth_m, atol=1.1e-4)
        np.testing.assert_array_equal(store.pose(number), answers[at].T_odom_body)
        assert keyframe.features is not None
        lifted = keyframe.features.points[:, 2] > 0
        px, is_inside = SMALL.project(keyframe.features.points[lifted])
        assert is_inside.all()
        np.testing.assert_allclose(px, keyframe.features.px[lifted], atol=1e-6)


def test_a_frame_without_a_pose_hangs_on_nothing(frames: list[RgbdFrame]) -> None:
    subject = dense()
    run(subject, frames[:3])
    for missed in (subject.miss(frames[3].stamp_s), subject.process(covered_frame(frames[4].stamp_s))):
        assert (missed.keyframe, missed.T_keyframe_body, missed.frame) == (None, None, None)
        assert missed.motion.reason is missed.reason


def test_where_each_frame_is_the_next_one_s_reference_the_store_gets_few(frames: list[RgbdFrame]) -> None:
    subject = dense(reference="previous", keyframe_way_m=0.1)
    run(subject, frames)
    T = subject.store.T_map_keyframe
    assert 2 <= len(T) < len(frames) / 2
    assert (se3.view_shift_m(se3.invert(T[:-1]) @ T[1:]) > 0.1).all()


def test_the_first_frame_of_a_rolling_shutter_is_kept_straightened_in_its_own_place(frames: list[RgbdFrame]) -> None:
    calibration = Calibration.registered_camera(SMALL, rolling_shutter_s=0.02)
    subject = dense(calibration)
    run(subject, frames[:1])
    bent = subject.store[next(iter(subject.store))]
    run(subject, frames[1:3])
    straight = subject.store[next(iter(subject.store))]
    assert straight.stamp_s == bent.stamp_s
    assert not np.array_equal(straight.depth_m, bent.depth_m)
