"""Joined sensors that were carried off in the dark are doubted until loops have laid the piece that began there."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from localizer.joined_drives import Drive, Eye, Sight, answers_to, drive, joined, of_frames

from wheelsight.core.estimates import Reason, Status
from wheelsight.core.geometry import FloatArray
from wheelsight.core.keyframes import Keyframe
from wheelsight.slam.drive_graph import KeyframePlace, OdometryKeyframe, PoseUpdate
from wheelsight.slam.loop_closing import LiveLoops

STOPS_S, DARK_S, LIGHT_S, LAID_S = 0.5, 1.5, 4.5, 6.0
BLANK = np.ones((24, 32), np.float32)


class Keeper(Eye):
    """An eye that keeps the keyframes at which it begins."""

    def _begin(self, stamp_s: float, T_odom_camera: FloatArray) -> Any:
        keyframe = Keyframe.of_images(stamp_s, np.array([30.0, 30.0, 16.0, 12.0]), BLANK, BLANK)
        number = self.store.add(keyframe, T_odom_camera)
        return replace(super()._begin(stamp_s, T_odom_camera), keyframe=number, T_keyframe_body=np.eye(4))


def carried() -> Drive:
    """It drives, stands, in the dark too, and drives on where it knows nothing."""

    def sight(seconds: float) -> Sight:
        is_dark = DARK_S <= seconds < LIGHT_S
        return Sight(blind=Reason.TOO_LITTLE_DEPTH if is_dark else None, place=int(seconds >= LIGHT_S))

    return drive([(STOPS_S, 0.6, 0.2), (LIGHT_S - STOPS_S, 0.0, 0.0), (2.5, 0.5, 0.3)], sight)


class Loops:
    """Stand in for the thread: from a time on they lay the newest piece where it is, and are as sure as reported."""

    def __init__(self, eye: Eye, laid_s: float, sigma: float) -> None:
        self.eye, self.laid_s, self.C = eye, laid_s, sigma**2 * np.eye(6)
        self.lived: list[OdometryKeyframe] = []

    def due(self, live: LiveLoops, stamp_s: float) -> PoseUpdate | None:
        if stamp_s < self.laid_s or len(self.eye.store) < 2:
            return None
        newest, T = self.lived[-1], np.array(self.eye.store.T_map_keyframe)
        lived = newest.number, newest.T_odom_keyframe, newest.covariance
        live.place = KeyframePlace(*lived, T[-1], self.C, newest.number)
        return PoseUpdate(T, np.zeros(len(T), np.int64), np.zeros((0, 2), np.int64))


@pytest.mark.parametrize(("sigma", "is_found"), [(1e-5, True), (1.0, False)])
def test_it_is_tracked_again_once_loops_have_laid_the_piece_and_are_sure(
    monkeypatch: pytest.MonkeyPatch, sigma: float, is_found: bool
) -> None:
    """Its doubt ends where the piece is laid, not at the first sure answer: a doubtful one is never sure."""
    run = carried()
    eye = Keeper(run.truth, lambda stamp_s: run.faults(stamp_s - run.begin_s))
    settings: dict[str, Any] = {"loops.source": "keyframes"}
    subject, _ = joined(monkeypatch, eye, **settings)
    loops = Loops(eye, run.begin_s + LAID_S, sigma)
    monkeypatch.setattr(LiveLoops, "add", lambda live, keyframe: loops.lived.append(keyframe))
    monkeypatch.setattr(LiveLoops, "due", lambda live, stamp_s: loops.due(live, stamp_s))
    found = of_frames(answers_to(subject, run.events()))
    subject.close()
    assert len(eye.store) == 2
    lit = [answer for answer in found if answer.stamp_s >= run.begin_s + LIGHT_S]
    before = {answer.status for answer in lit if answer.stamp_s < loops.laid_s}
    after = {answer.status for answer in lit if answer.stamp_s >= loops.laid_s}
    assert before == {Status.COASTING}
    assert after == {Status.TRACKING if is_found else Status.COASTING}
