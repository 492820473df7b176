"""Keyframes of a camera led astray lie where the wheels went; those of one that was not stay where they are."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import synthetic
from narrowing import not_none

from wheelsight.config import load_config
from wheelsight.core.calibration import Calibration
from wheelsight.core.estimates import CameraEstimate, MotionEstimate, Status
from wheelsight.core.geometry import FloatArray, se3
from wheelsight.core.keyframes import Keyframe, KeyframeId, KeyframeStore
from wheelsight.estimation.loop_updates import LoopClosureClient, corrected_keyframes
from wheelsight.slam.drive_graph import OdometryKeyframe
from wheelsight.slam.graph import RelativePose
from wheelsight.slam.loop_closing import LiveLoops

PROBABILITY = 0.999
C = np.diag(np.square([0.01, 0.01, 0.01, 0.005, 0.005, 0.005]))
STEP, ASTRAY = se3.from_plane(0.05, 0.0, 0.05), se3.from_plane(0.25, -0.1, 0.15)


def kept_at(*poses: FloatArray) -> KeyframeStore:
    store, blank = KeyframeStore(), np.ones((24, 32), np.float32)
    for number, T in enumerate(poses):
        store.add(Keyframe.of_images(float(number), np.array([30.0, 30.0, 16.0, 12.0]), blank, blank), T)
    return store


def lived(store: KeyframeStore, number: int, motion: FloatArray | None, *, begins: bool = False) -> OdometryKeyframe:
    T_before_now = None
    if number:
        T_before_now = se3.invert(store.pose(KeyframeId(number - 1))) @ store.pose(KeyframeId(number))
    reported = None if motion is None else (motion, C)
    edge = RelativePose(KeyframeId(0), KeyframeId(number), np.eye(4), C, is_loop=True)
    where = (KeyframeId(number), float(number), np.eye(4), C, begins)
    return OdometryKeyframe(*where, T_before_now=T_before_now, motion=reported, seen_from=edge)


def test_those_that_were_led_astray_lie_one_after_the_other_as_the_motions_say() -> None:
    begin = se3.from_plane(1.0, 2.0, 0.5)
    store = kept_at(begin, begin @ ASTRAY, begin @ ASTRAY @ STEP)
    waiting = [[lived(store, 1, STEP)], [lived(store, 2, STEP)]]
    laid, T = not_none(corrected_keyframes(store, waiting, PROBABILITY))
    np.testing.assert_allclose(T, [begin @ STEP, begin @ STEP @ STEP], atol=1e-9)
    for (one,) in laid:
        np.testing.assert_allclose(not_none(one.T_before_now), STEP, atol=1e-9)
        assert one.seen_from is None


def test_two_of_one_frame_go_together() -> None:
    store = kept_at(np.eye(4), ASTRAY, ASTRAY @ se3.from_plane(0.0, 0.0, 0.3))
    laid, T = not_none(corrected_keyframes(store, [[lived(store, 1, STEP), lived(store, 2, None)]], PROBABILITY))
    np.testing.assert_allclose(T, [STEP, STEP @ se3.from_plane(0.0, 0.0, 0.3)], atol=1e-9)
    assert [one.number for one in laid[0]] == [1, 2]


@pytest.mark.parametrize("off_m", [0.0, 0.01, 0.02])
def test_within_what_the_motions_allow_they_stay(off_m: float) -> None:
    store = kept_at(np.eye(4), STEP @ se3.from_plane(off_m, 0.0, 0.0))
    assert corrected_keyframes(store, [[lived(store, 1, STEP)]], PROBABILITY) is None


def test_height_and_tilt_stay_and_a_motion_may_be_sure_of_them() -> None:
    tilted = se3.exp([0.0, 0.0, 0.02, 0.03, -0.02, 0.0])
    store = kept_at(np.eye(4), ASTRAY @ tilted)
    flat = np.diag([1e-4, 1e-4, 0.0, 0.0, 0.0, 2.5e-5])
    one = replace(lived(store, 1, STEP), motion=(STEP, flat))
    _, (T,) = not_none(corrected_keyframes(store, [[one]], PROBABILITY))
    np.testing.assert_allclose(se3.log(T @ se3.invert(STEP))[[0, 1, 5]], 0.0, atol=2e-3)
    np.testing.assert_allclose(T[2, [3, 0, 1]], (ASTRAY @ tilted)[2, [3, 0, 1]], atol=5e-3)
    assert np.abs(T[2, :2]).max() > 0.01


def test_where_no_one_knows_the_way_they_stay() -> None:
    store = kept_at(np.eye(4), ASTRAY, ASTRAY @ ASTRAY)
    assert corrected_keyframes(store, [], PROBABILITY) is None
    assert corrected_keyframes(store, [[lived(store, 0, STEP)], [lived(store, 1, STEP)]], PROBABILITY) is None
    assert (
        corrected_keyframes(store, [[lived(store, 1, STEP)], [lived(store, 2, STEP, begins=True)]], PROBABILITY) is None
    )
    assert corrected_keyframes(store, [[lived(store, 1, None)], [lived(store, 2, STEP)]], PROBABILITY) is None


@pytest.fixture
def handed(monkeypatch: pytest.MonkeyPatch) -> list[OdometryKeyframe]:
    found: list[OdometryKeyframe] = []
    monkeypatch.setattr(LiveLoops, "add", lambda live, one: found.append(one))
    return found


def beside_of(store: KeyframeStore) -> LoopClosureClient:
    settings = load_config(overrides={"loops.source": "keyframes"})
    return LoopClosureClient(store, Calibration.registered_camera(synthetic.CAMERA), settings, waits=True)


def add(store: KeyframeStore, stamp_s: float, T: FloatArray) -> None:
    blank = np.ones((24, 32), np.float32)
    store.add(Keyframe.of_images(stamp_s, np.array([30.0, 30.0, 16.0, 12.0]), blank, blank), T)


def test_the_camera_goes_with_the_keyframe_on_which_it_hangs(handed: list[OdometryKeyframe]) -> None:
    store = KeyframeStore()
    beside = beside_of(store)
    moved = []
    for number, T in enumerate((np.eye(4), ASTRAY)):
        add(store, float(number), T)
        beside.add_keyframes(float(number), np.eye(4), C, None if number == 0 else (STEP, C))
        moved.append(beside.hand_over([(STEP, C)] if number else (), KeyframeId(number)))
    assert moved[0] is None
    np.testing.assert_allclose(not_none(moved[1]) @ ASTRAY, STEP, atol=1e-9)
    np.testing.assert_allclose(store.pose(KeyframeId(1)), STEP, atol=1e-9)
    np.testing.assert_allclose(not_none(handed[1].T_before_now), STEP, atol=1e-9)
    beside.close()


@pytest.mark.parametrize("is_forgotten", [False, True])
def test_what_is_seen_after_a_frame_that_was_not_believed_ties_nothing(
    is_forgotten: bool, handed: list[OdometryKeyframe]
) -> None:
    store = KeyframeStore()
    beside = beside_of(store)
    for number in (0, 1, 2):
        add(store, float(number), se3.from_plane(0.1 * number, 0.0, 0.0))
        beside.add_keyframes(float(number), np.eye(4), C)
    beside.hand_over()
    T, motion = np.eye(4), MotionEstimate(np.eye(4), C)
    for stamp_s, number in ((3.0, 0), (4.0, 3)):
        if number == 3:
            add(store, stamp_s, se3.from_plane(0.3, 0.0, 0.0))
            if is_forgotten:
                beside.forget_tracked()
        by = KeyframeId(number)
        seen = CameraEstimate(stamp_s, Status.TRACKING, T, C, keyframe=by, T_keyframe_body=T, motion=motion)
        beside.add_tracked(seen, np.eye(4), C)
        assert beside.tracked_s == stamp_s
        beside.add_keyframes(stamp_s, np.eye(4), C)
    beside.hand_over()
    assert (handed[-1].seen_from is None) == is_forgotten
    beside.close()
