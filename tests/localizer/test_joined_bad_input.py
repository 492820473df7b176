"""What joined localizers refuse, and what they say of events that cannot be used."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from localizer.joined_drives import (
    CALIBRATION,
    T_BASE_CAMERA,
    WHEELS,
    Drive,
    Eye,
    answers_to,
    drive,
    joined,
    of_frames,
    off_m,
    spread_m,
)
from narrowing import not_none
from stand_ins import CAMERA, frame

from wheelsight.config import load_config
from wheelsight.core.calibration import Calibration
from wheelsight.core.errors import CalibrationError
from wheelsight.core.estimates import Reason, Status
from wheelsight.core.geometry import FloatArray, se3
from wheelsight.core.messages import Event, RgbdFrame, SkippedFrame, WheelSpeeds, YawRate
from wheelsight.core.trajectory import Trajectory
from wheelsight.estimation import Localizer

SHORT = ((2.0, 0.6, 0.2),)
FUSIONS = pytest.mark.parametrize("fusion", ["default", "ligocki"])


def joined_by(fusion: str, calibration: Calibration) -> Localizer:
    return Localizer(calibration, load_config(overrides={"odometry": "wheels,features", "fusion": fusion}))


@FUSIONS
def test_a_calibration_without_wheels_is_refused(fusion: str) -> None:
    with pytest.raises(CalibrationError, match=r"has no wheels .*--calibration"):
        joined_by(fusion, replace(CALIBRATION, wheels=None))


@FUSIONS
def test_a_calibration_without_the_cameras_place_is_refused(fusion: str) -> None:
    with pytest.raises(CalibrationError, match=r"drive.* where the camera sits .*wheelsight calibrate base .*none"):
        joined_by(fusion, replace(CALIBRATION, T_base_camera=None))


@FUSIONS
def test_a_calibration_without_a_camera_is_refused(fusion: str) -> None:
    with pytest.raises(CalibrationError, match="camera"):
        joined_by(fusion, replace(CALIBRATION, color=None, depth=None))


def test_a_mount_that_was_written_with_five_digits_will_do(monkeypatch: pytest.MonkeyPatch) -> None:
    """A calibration is taken with a rotation that is one to four digits; a filter is stricter."""
    T = T_BASE_CAMERA.copy()
    T[:3, :3] += 2e-5
    made, rough = drive(SHORT), replace(CALIBRATION, T_base_camera=T)
    answers = of_frames(answers_to(joined(monkeypatch, made.eye(), calibration=rough)[0], made.events()))
    assert {answer.status for answer in answers[1:]} == {Status.TRACKING}
    assert off_m(answers[-1], made.truth) < 0.01


def with_clock(made: Drive, ahead_s: float, *, frames_first: bool) -> list[Event]:
    """The drive's events in the order in which they happen, its frames stamped by another clock."""
    events = [replace(e, stamp_s=e.stamp_s + ahead_s) if isinstance(e, RgbdFrame) else e for e in made.events()]
    return [e for i, e in enumerate(events) if i > 5 or isinstance(e, RgbdFrame) == frames_first]


class EyeOfAnotherClock(Eye):
    """Reported stamps that are ahead of the truth's by so much."""

    def __init__(self, truth: Trajectory, ahead_s: float) -> None:
        super().__init__(truth)
        self._ahead_s = ahead_s

    def T_odom_camera(self, stamp_s: float) -> FloatArray:
        return super().T_odom_camera(stamp_s - self._ahead_s)


@pytest.mark.parametrize("kind", ["dense", "features"])
@pytest.mark.parametrize("ahead_s", [1e9, -1e9])
def test_a_camera_whose_clock_is_in_another_epoch_is_never_called_tracking(
    monkeypatch: pytest.MonkeyPatch, kind: str, ahead_s: float
) -> None:
    made = drive(SHORT)
    eye = EyeOfAnotherClock(made.truth, ahead_s)
    subject, kept = joined(monkeypatch, eye, kind)
    answers = answers_to(subject, with_clock(made, ahead_s, frames_first=False))[1:]
    assert not any(answer.status is Status.TRACKING for _, answer in answers)
    reported = of_frames(answers)
    assert {answer.reason for answer in reported[1:]} == {Reason.CLOCKS_APART}
    assert "clock of the camera" in subject.warnings[0]
    moving = [answer for answer in reported if answer.T_odom_body is not None]
    assert len(moving) > 40
    assert max(off_m(answer, made.truth) for answer in moving) < 0.05
    assert spread_m(moving[-1]) > 1.8 * spread_m(moving[len(moving) // 2])
    assert not kept.fused


def test_of_two_clocks_that_of_the_sensor_heard_first_counts(monkeypatch: pytest.MonkeyPatch) -> None:
    made, ahead_s = drive(SHORT), -1e9
    eye = EyeOfAnotherClock(made.truth, ahead_s)
    subject, _ = joined(monkeypatch, eye)
    answers = answers_to(subject, with_clock(made, ahead_s, frames_first=True))
    readings = [answer for event, answer in answers if not isinstance(event, RgbdFrame)]
    assert {answer.reason for answer in readings} == {Reason.CLOCKS_APART}
    assert "clock of the wheels" in subject.warnings[0]
    seen = [answer for answer in of_frames(answers) if answer.T_odom_body is not None]
    assert {answer.status for answer in seen[1:]} == {Status.TRACKING}
    first_s = seen[0].stamp_s - ahead_s
    T = se3.invert(made.truth.at([first_s])[0]) @ made.truth.at([min(seen[-1].stamp_s - ahead_s, first_s + 10)])[0]
    np.testing.assert_allclose(not_none(seen[-1].T_filter_body), T, atol=0.05)


@pytest.mark.parametrize(
    "make", [lambda s: frame(0, s), lambda s: SkippedFrame(s, "cut off")], ids=["frame", "skipped"]
)
def test_a_frame_whose_stamp_is_no_number_moves_nothing(
    monkeypatch: pytest.MonkeyPatch, make: Callable[[float], Event]
) -> None:
    """Three of them in one drive, which goes on after each as if it had not been."""
    made = drive(SHORT)
    subject, kept = joined(monkeypatch, made.eye())
    events = made.events()
    parts = [events[begin:end] for begin, end in pairwise([0, 60, 120, 180, len(events)])]
    *_, (_, before) = answers_to(subject, parts[0])
    for part, stamp_s in zip(parts[1:], [np.nan, np.inf, -np.inf], strict=True):
        fused = len(kept.fused)
        ((_, odd),) = answers_to(subject, [make(stamp_s)])
        assert odd.reason in (Reason.INVALID, Reason.CLOCKS_APART, Reason.TOO_LATE, Reason.FRAME_UNUSABLE)
        assert subject.note
        np.testing.assert_array_equal(odd.T_odom_body, before.T_odom_body)
        np.testing.assert_array_equal(odd.covariance, before.covariance)
        assert len(kept.fused) == fused
        after = answers_to(subject, part)
        assert {answer.status for _, answer in after} == {Status.TRACKING}
        before = after[-1][1]
    assert off_m(before, made.truth) < 0.01


def test_a_frame_whose_stamp_is_no_number_may_be_the_first_event(monkeypatch: pytest.MonkeyPatch) -> None:
    made = drive(SHORT)
    ((_, odd),) = answers_to(joined(monkeypatch, made.eye())[0], [frame(0, np.nan)])
    assert (odd.status, odd.T_odom_body) == (Status.INITIALIZING, None)


def test_one_frame_from_the_far_future_does_not_end_the_camera(monkeypatch: pytest.MonkeyPatch) -> None:
    made = drive(SHORT)
    subject, _ = joined(monkeypatch, made.eye())
    events = made.events()
    events.insert(61, frame(0, made.begin_s + 1e6))
    answers = answers_to(subject, events)
    assert {answer.status for answer in of_frames(answers)[-10:]} == {Status.TRACKING}


def test_a_skipped_frame_is_answered_by_the_wheels_with_what_was_wrong(monkeypatch: pytest.MonkeyPatch) -> None:
    made = drive(SHORT)
    subject, kept = joined(monkeypatch, made.eye())
    for event in made.events():
        is_cut = isinstance(event, RgbdFrame) and event.stamp_s > made.begin_s + 1.0
        answer = not_none(subject.process(SkippedFrame(event.stamp_s, "depth image is cut off") if is_cut else event))
        assert subject.note == ("depth image is cut off" if is_cut else "")
        if is_cut:
            assert answer.reason is Reason.FRAME_UNUSABLE
            assert (answer.stamp_s, answer.matches, answer.inliers) == (event.stamp_s, 0, 0)
            assert off_m(answer, made.truth) < 3 * spread_m(answer)
    assert answer.status is Status.COASTING
    assert max(kept.fused) < made.begin_s + 1.0


@pytest.mark.parametrize("late_s", [0.0, 0.1, 5.0])
def test_a_frame_that_is_not_newer_is_refused_with_the_reason_said(
    monkeypatch: pytest.MonkeyPatch, late_s: float
) -> None:
    made = drive(SHORT)
    subject, kept = joined(monkeypatch, made.eye())
    events = made.events()[:102]
    answers_to(subject, events)
    newest_s = max(event.stamp_s for event in events if isinstance(event, RgbdFrame))
    fused = len(kept.fused)
    ((_, late),) = answers_to(subject, [frame(9, newest_s - late_s)])
    if late_s < 1:
        assert late.reason is Reason.FRAME_UNUSABLE
        assert f"does not come after {newest_s:.6f} s" in subject.note
    else:  # or its clock was set back
        assert (late.reason, late.status) == (Reason.CLOCKS_APART, Status.COASTING)
        assert "clock of the camera leaps by -5" in subject.note
    assert len(kept.fused) == fused
    assert off_m(late, made.truth) < 0.01


def test_wheels_that_tell_no_number_are_left_out_and_the_camera_leads(monkeypatch: pytest.MonkeyPatch) -> None:
    made = drive(SHORT)
    turn = 2 * np.pi / WHEELS.ticks_per_turn * 50  # of a tick between readings, rad/s
    speeds = np.diff(np.stack([made.readings.left, made.readings.right]), append=0) * turn
    of_reading = dict(zip(made.readings.stamps_s, speeds.T, strict=True))

    def odd(event: Event) -> Event:
        if isinstance(event, RgbdFrame):
            return event
        is_odd = 1.0 < event.stamp_s - made.begin_s < 1.2
        return WheelSpeeds(event.stamp_s, *(of_reading[event.stamp_s].tolist() if not is_odd else (np.nan, 1.0)))

    answers = answers_to(joined(monkeypatch, made.eye())[0], map(odd, made.events()[:-1]))
    reported = of_frames(answers)[1:]
    assert {answer.status for answer in reported} == {Status.TRACKING}
    assert max(off_m(answer, made.truth) for answer in reported) < 0.01
    assert all(off_m(answer, made.truth) < 3 * spread_m(answer) + 1e-3 for _, answer in answers[1:])


def test_a_yaw_rate_that_is_no_number_changes_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    made = drive(SHORT)
    odd = [event for e in made.events() for event in (e, YawRate(e.stamp_s, float("nan")))]
    with_odd, without = (answers_to(joined(monkeypatch, made.eye())[0], e)[-1][1] for e in (odd, made.events()))
    np.testing.assert_array_equal(with_odd.covariance, without.covariance)


def test_a_camera_alone_shows_no_wheels_to_join() -> None:
    with pytest.raises(CalibrationError):
        joined_by("default", Calibration.registered_camera(CAMERA))
