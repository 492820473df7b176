"""A drive in a map of before whose start is said: what is answered before the camera has seen anything."""

from __future__ import annotations

import numpy as np
import pytest
from localizer.joined_drives import CALIBRATION, T_BASE_CAMERA, Drive, Sight, answers_to, drive
from narrowing import not_none

from wheelsight.config import load_config
from wheelsight.core.estimates import Reason, Status
from wheelsight.core.geometry import FloatArray, se3
from wheelsight.core.keyframes import Keyframe, KeyframeId, KeyframeStore
from wheelsight.core.messages import RgbdFrame
from wheelsight.estimation import Localizer
from wheelsight.places.recognition import Recognizer
from wheelsight.slam.drive_graph import DriveGraph, OdometryKeyframe
from wheelsight.slam.place_recognition import KnownMap

T_START = se3.from_plane(3.0, -1.5, 2.0)
SPREAD = np.diag(np.square([0.5, 0.5, 0.02, 0.02, 0.02, 0.25]))
DARK_S = 2.0


def known(T_map_base: FloatArray | None) -> KnownMap:
    said = () if T_map_base is None else (T_map_base @ T_BASE_CAMERA, SPREAD)
    return KnownMap(KeyframeStore(), Recognizer(), (), *said)


def localizer(monkeypatch: pytest.MonkeyPatch, made: Drive, given: KnownMap) -> Localizer:
    eye = made.eye()
    eye.store = given.store
    monkeypatch.setattr("wheelsight.estimation.camera_localizer.camera_odometry", lambda *_: (eye, None))
    config = load_config(overrides={"odometry": "wheels,dense", "loops.source": "keyframes"})
    return Localizer(CALIBRATION, config, known=given, waits=True)


def dark_at_first(seconds: float) -> Sight:
    return Sight(blind=Reason.TOO_LITTLE_DEPTH) if seconds < DARK_S else Sight()


def test_every_answer_stands_where_the_start_and_the_wheels_say(monkeypatch: pytest.MonkeyPatch) -> None:
    """Readings come before the first frame, and the first frames are dark, while the robot drives on."""
    made = drive(faults=dark_at_first)
    subject = localizer(monkeypatch, made, known(T_START))
    answers = answers_to(subject, made.events())
    subject.close()
    begin_s = made.begin_s
    before = [answer for event, answer in answers if event.stamp_s < begin_s + DARK_S]
    after = [answer for event, answer in answers if event.stamp_s > begin_s + DARK_S + 0.1]
    assert len(before) > 20
    assert np.linalg.norm(made.truth.at([begin_s + DARK_S])[0][:3, 3]) > 0.4  # it has gone on meanwhile
    assert {answer.status for answer in before} == {Status.COASTING}
    assert {answer.status for answer in after} == {Status.TRACKING}
    for answer in (*before, *after):
        truth = T_START @ made.truth.at([min(answer.stamp_s, made.truth.stamps_s[-1])])[0]
        assert np.linalg.norm((not_none(answer.T_map_body) - truth)[:3, 3]) < 0.06
        assert answer.covariance is not None
    np.testing.assert_allclose(not_none(before[0].T_map_body), T_START, atol=1e-9)


def test_where_no_start_is_said_nothing_is_answered_in_the_map(monkeypatch: pytest.MonkeyPatch) -> None:
    made = drive()
    given = known(None)
    depth_m, grey = np.full((12, 16), 2.0, np.float32), np.full((12, 16), 90.0, np.float32)
    given.store.add(Keyframe.of_images(0.0, np.array([14.0, 14.0, 7.5, 5.5]), depth_m, grey, None), np.eye(4))
    subject = localizer(monkeypatch, made, given)
    first = [answer for event, answer in answers_to(subject, made.events()[:40]) if not isinstance(event, RgbdFrame)]
    subject.close()
    assert first
    assert all(answer.T_odom_body is not None and answer.T_map_body is None for answer in first)


def test_a_first_keyframe_is_held_where_the_robot_had_driven_from_its_start() -> None:
    T_said, T_moved = T_START @ T_BASE_CAMERA, T_START @ se3.from_plane(0.5, 0, 0.1) @ T_BASE_CAMERA
    for laid, expected in ((T_moved, T_moved), (None, T_said)):
        graph = DriveGraph(known(T_START))
        graph.add(OdometryKeyframe(KeyframeId(0), 1.0, np.eye(4), 1e-6 * np.eye(6), T_map_keyframe=laid))
        np.testing.assert_allclose(graph.poses[0], expected, atol=1e-9)
