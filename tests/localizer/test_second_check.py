"""A camera that was left out has its place again once it goes with the wheels, and no sooner."""

from __future__ import annotations

import numpy as np
import pytest
from drives import Leg
from localizer.joined_drives import Drive, Eye, answers_to, drive, joined, of_frames, off_m, spread_m
from localizer.test_base_check import with_floor

from wheelsight.core.estimates import Reason, Status
from wheelsight.core.geometry import FloatArray
from wheelsight.estimation import consistency_check

BEND: tuple[Leg, ...] = ((4.5, 0.6, 0.4),)
# So much less than by default that the drive is short.
ENOUGH = {"ENOUGH_M": 0.5, "_ENOUGH_RAD": 0.25}


@pytest.fixture(autouse=True)
def _short(monkeypatch: pytest.MonkeyPatch) -> None:
    for name, value in ENOUGH.items():
        monkeypatch.setattr(consistency_check, name, value)


class MendedEye(Eye):
    """One whose depth is a factor wrong up to a stamp."""

    until_s, depth = np.inf, 0.4

    def T_odom_camera(self, stamp_s: float) -> FloatArray:
        T = super().T_odom_camera(stamp_s)
        if stamp_s < self.until_s:
            T[:3, 3] *= self.depth
        return T


def eye_of(made: Drive, mended_s: float) -> Eye:
    eye = MendedEye(made.truth)
    eye.until_s = mended_s
    return eye


def test_a_camera_that_goes_with_the_wheels_again_is_left_out_no_longer(monkeypatch: pytest.MonkeyPatch) -> None:
    made = drive(BEND)
    mended_s = made.begin_s + 2.4
    subject, _ = joined(monkeypatch, eye_of(made, mended_s))
    events = [
        wrong if wrong.stamp_s < mended_s else right
        for wrong, right in zip(with_floor(made.events(), 0.4), with_floor(made.events()), strict=True)
    ]
    frames = of_frames(answers_to(subject, [event for event in events if event.stamp_s < mended_s]))
    assert "the fault is the camera's: depth is 0.4" in subject.warnings[0]
    assert (frames[-1].status, frames[-1].reason) == (Status.COASTING, Reason.CONTRADICTION)
    frames = of_frames(answers_to(subject, [event for event in events if event.stamp_s >= mended_s]))
    assert subject.warnings == ()
    assert (frames[-1].status, frames[-1].reason, frames[-1].doubtful) == (Status.TRACKING, None, False)
    assert off_m(frames[-1], made.truth) < 3 * spread_m(frames[-1])


def test_one_that_stays_wrong_stays_left_out(monkeypatch: pytest.MonkeyPatch) -> None:
    made = drive(BEND)
    subject, _ = joined(monkeypatch, eye_of(made, np.inf))
    frames = of_frames(answers_to(subject, with_floor(made.events(), 0.4)))
    assert "the fault is the camera's: depth is 0.4" in subject.warnings[0]
    assert {answer.status for answer in frames} == {Status.COASTING}
