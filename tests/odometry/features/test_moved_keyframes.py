"""Keyframes are moved in the store in the middle of a drive: what hangs on them goes along, and tracking goes on."""

from __future__ import annotations

import numpy as np
import pytest
from narrowing import not_none
from odometry.views import error_of, from_start, odometry, room_frames, run
from synthetic import CAMERA, wobbling_trajectory

from wheelsight.core.calibration import Calibration
from wheelsight.core.estimates import Status
from wheelsight.core.geometry import PinholeCamera, se3
from wheelsight.core.keyframes import KeyframeStore
from wheelsight.core.messages import RgbdFrame
from wheelsight.vision.features import FeatureEstimate, FeatureOdometry, FeatureSettings

TRUTH = wobbling_trajectory(60, speed=3.0).select(slice(0, 60, 2))
TRUE = from_start(TRUTH.T_frame_body)
T_FAR = se3.exp([40.0, -25.0, 3.0, 0.4, -0.8, 2.0])
MODES = ["keyframes", "previous"]
MIDDLE = 20


@pytest.fixture(scope="module")
def frames() -> list[RgbdFrame]:
    return room_frames(TRUTH)


def move_all(store: KeyframeStore, T_new_old: np.ndarray) -> None:
    store.move(list(store), T_new_old @ store.T_map_keyframe)


def rest(subject: FeatureOdometry, frames: list[RgbdFrame]) -> list[FeatureEstimate]:
    return [subject.process(frame) for frame in frames[MIDDLE:]]


def test_keyframes_are_kept_with_what_was_seen(frames: list[RgbdFrame]) -> None:
    store = KeyframeStore()
    subject = FeatureOdometry(Calibration.registered_camera(CAMERA), FeatureSettings(), store=store)
    answers = [subject.process(frame) for frame in frames]
    assert subject.store is store
    assert len(store) > 3
    by_stamp = {frame.stamp_s: (frame, answer) for frame, answer in zip(frames, answers, strict=True)}
    for number in store:
        keyframe = store[number]
        frame, answer = by_stamp[keyframe.stamp_s]
        assert answer.keyframe == number
        np.testing.assert_allclose(store.pose(number), not_none(answer.T_odom_body), atol=1e-12)
        np.testing.assert_allclose(keyframe.depth_m, frame.depth_m, atol=1.01e-4)
        np.testing.assert_array_equal(keyframe.intrinsics, [CAMERA.fx, CAMERA.fy, CAMERA.cx, CAMERA.cy])
        has_depth = not_none(keyframe.features).points[:, 2] > 0
        px, _ = CAMERA.project(not_none(keyframe.features).points[has_depth])
        np.testing.assert_allclose(px, not_none(keyframe.features).px[has_depth], atol=1e-9)


@pytest.mark.parametrize("reference", MODES)
def test_each_pose_is_reported_relative_to_a_keyframe(frames: list[RgbdFrame], reference: str) -> None:
    subject = odometry(reference=reference)
    for frame in frames:
        answer = subject.process(frame)
        T_map_keyframe = subject.store.pose(not_none(answer.keyframe))
        np.testing.assert_allclose(
            T_map_keyframe @ not_none(answer.T_keyframe_body), not_none(answer.T_odom_body), atol=1e-12
        )
    failed = subject.miss(1e3)
    assert (failed.keyframe, failed.T_keyframe_body) == (None, None)


@pytest.mark.parametrize("reference", MODES)
def test_when_all_keyframes_move_all_moves_along(frames: list[RgbdFrame], reference: str) -> None:
    subject, untouched = odometry(reference=reference), odometry(reference=reference)
    run(subject, frames[:MIDDLE])
    run(untouched, frames[:MIDDLE])
    move_all(subject.store, T_FAR)
    for answer, expected in zip(rest(subject, frames), rest(untouched, frames), strict=True):
        assert answer.status is Status.TRACKING
        apart = se3.log(se3.invert(T_FAR @ not_none(expected.T_odom_body)) @ not_none(answer.T_odom_body))
        np.testing.assert_allclose(apart, 0, atol=1e-6)
        Ad = se3.adjoint(T_FAR)
        np.testing.assert_allclose(
            not_none(answer.covariance),
            Ad @ not_none(expected.covariance) @ Ad.T,
            rtol=1e-4,
            atol=1e-6 * np.abs(not_none(answer.covariance)).max(),
        )
        assert (answer.keyframe, answer.matches, answer.inliers) == (
            expected.keyframe,
            expected.matches,
            expected.inliers,
        )


def test_a_move_between_the_first_two_frames_holds_too(frames: list[RgbdFrame]) -> None:
    """With a rolling shutter the second frame begins the map again, where the first one is by then."""
    subject = odometry(Calibration.registered_camera(CAMERA, rolling_shutter_s=0.03))
    subject.process(frames[0])
    move_all(subject.store, T_FAR)
    answer = subject.process(frames[1])
    assert error_of(answer, T_FAR @ TRUE[1])[0] < 0.05
    assert len(subject.store) == 1


def test_tracking_goes_on_after_one_keyframe_moved_a_little(frames: list[RgbdFrame]) -> None:
    subject, untouched = odometry(), odometry()
    last = [one.process(frame) for frame in frames[:MIDDLE] for one in (subject, untouched)][-1]
    T_LITTLE = se3.exp([0.01, -0.005, 0.0, 0.0, 0.004, 0.0])
    keyframe = not_none(last.keyframe)
    subject.store.move([keyframe], T_LITTLE @ subject.store.pose(keyframe))
    for k, answer in enumerate(rest(subject, frames), MIDDLE):
        assert answer.status is Status.TRACKING
        assert error_of(answer, TRUE[k])[0] < 0.05


def test_a_keyframe_alone_takes_its_frames_along(frames: list[RgbdFrame]) -> None:
    """Against the previous frame, nothing but the keyframe that it hangs on shows where that is."""
    subject = odometry(reference="previous")
    run(subject, frames[:MIDDLE])
    T_new_old = se3.exp([0.3, 0.1, -0.2, 0.1, 0.2, 0.0])
    move_all(subject.store, T_new_old)
    assert error_of(subject.process(frames[MIDDLE]), T_new_old @ TRUE[MIDDLE])[0] < 0.05


def test_those_who_share_a_store_move_only_with_their_own(frames: list[RgbdFrame]) -> None:
    store = KeyframeStore()
    calibration = Calibration.registered_camera(CAMERA)
    one, other = (FeatureOdometry(calibration, store=store) for _ in range(2))
    for frame in frames[:MIDDLE]:
        mine, others = one.process(frame), other.process(frame)
    assert mine.keyframe != others.keyframe
    own = [number for number in store if number % 2]  # they take turns to add
    store.move(own, T_FAR @ store.T_map_keyframe[own])
    assert error_of(one.process(frames[MIDDLE]), TRUE[MIDDLE])[0] < 0.05
    assert error_of(other.process(frames[MIDDLE]), T_FAR @ TRUE[MIDDLE])[0] < 0.05


def test_images_of_two_lenses_are_kept_on_the_depth_cameras_grid(frames: list[RgbdFrame]) -> None:
    """Grey is taken from where the colour camera, aside, sees the same points."""
    color = PinholeCamera(CAMERA.width, CAMERA.height, CAMERA.fx, CAMERA.fy, CAMERA.cx, CAMERA.cy)
    T_color_depth = se3.from_parts(np.eye(3), [0.04, 0.0, 0.0])
    depth_m = np.full((CAMERA.height, CAMERA.width), 2.0, np.float32)
    depth_m[:50] = 0
    shade = np.tile(np.arange(CAMERA.width) // 2, (CAMERA.height, 1)).astype(np.uint8)
    rng = np.random.default_rng(0)
    shade[::7, ::5] = rng.integers(0, 255, shade[::7, ::5].shape)  # corners to be found
    subject = odometry(Calibration(color=color, depth=CAMERA, T_color_depth=T_color_depth))
    answer = subject.process(RgbdFrame(0.0, np.repeat(shade[..., None], 3, axis=2), depth_m))
    grey = subject.store[not_none(answer.keyframe)].grey
    shift_px = CAMERA.fx * 0.04 / 2.0
    u = np.arange(20, 280)
    row = 51 + 7 - (51 % 7) + 1  # without corners
    np.testing.assert_allclose(grey[row, u], (u + shift_px) / 2, atol=1.0)
    assert (grey[:49] == 0).all()


def test_a_lens_is_taken_out_of_what_is_kept() -> None:
    camera = PinholeCamera(320, 240, 262.0, 260.0, 161.3, 118.4, (0.2, -0.3, 0.001, -0.002, 0.1))
    subject = odometry(Calibration.registered_camera(camera))
    v, u = np.mgrid[:240, :320]
    color = np.repeat(((u // 16 + v // 16) % 2 * 200 + 20)[..., None], 3, axis=2).astype(np.uint8)
    # Depth that shows in which direction a pixel looks.
    x = camera.normalise(np.stack([u, v], axis=-1))[..., 0]
    answer = subject.process(RgbdFrame(0.0, color, (2 + 0.5 * x).astype(np.float32)))
    keyframe = subject.store[not_none(answer.keyframe)]
    depth_m = keyframe.depth_m[20:-20, 20:-20]
    expected = (2 + 0.5 * (u - camera.cx) / camera.fx)[20:-20, 20:-20]
    np.testing.assert_allclose(depth_m, expected, atol=0.5 * 0.75 / camera.fx + 2e-4)
