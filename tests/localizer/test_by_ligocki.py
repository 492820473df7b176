"""ByLigocki: the paper's filter over wheels and a camera, each alone."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from localizer.joined_drives import CALIBRATION, T_BASE_CAMERA, WHEELS, Drive, Eye, Sight, drive, off_m
from narrowing import as_frame, not_none
from stand_ins import frame

from wheelsight.config import load_config
from wheelsight.core.calibration import Calibration
from wheelsight.core.estimates import Estimate, Reason, Status
from wheelsight.core.geometry import se3
from wheelsight.core.messages import Event, RgbdFrame, SkippedFrame, WheelTicks, YawRate
from wheelsight.estimation import Localizer
from wheelsight_papers import LigockiFilter

CONFIG = load_config(overrides={"odometry": "wheels,features", "fusion": "ligocki"})
DARK = Sight(Reason.TOO_FEW_KEYPOINTS)


@pytest.fixture
def paper(monkeypatch: pytest.MonkeyPatch) -> Callable[[Eye], Localizer]:
    """A localizer by the paper's filter, and by this eye."""

    def make(eye: Eye, calibration: Calibration = CALIBRATION) -> Localizer:
        monkeypatch.setattr("wheelsight.estimation.camera_localizer.camera_odometry", lambda *_: (eye, None))
        return Localizer(calibration, CONFIG)

    return make


def answered(subject: Localizer, events: list[Event]) -> list[tuple[Event, Estimate]]:
    return [(event, answer) for event in events if (answer := subject.process(event)) is not None]


def seconds_of(made: Drive, answer: Estimate) -> float:
    return answer.stamp_s - made.begin_s


def test_only_frames_are_answered_with_the_bases_pose(paper: Callable[..., Localizer]) -> None:
    made = drive()
    subject = paper(made.eye())
    assert (subject.body, subject.frame, subject.map) == ("base", "map", None)
    assert set(subject.answers) == {RgbdFrame, SkippedFrame}
    answers = answered(subject, made.events())
    assert all(isinstance(event, RgbdFrame) and event.stamp_s == answer.stamp_s for event, answer in answers)
    assert {(a.status, a.body, a.reason, a.matches, a.inliers) for _, a in answers} == {
        (Status.TRACKING, "base", None, 200, 160)
    }
    assert max(off_m(answer, made.truth) for _, answer in answers) < 0.02
    assert subject.process(YawRate(1.0, 0.1)) is None


def test_it_is_eq_2_over_both_alone(paper: Callable[..., Localizer]) -> None:
    made = drive()
    joined = [answer for _, answer in answered(paper(made.eye()), made.events())]
    camera, by_hand = made.eye(), LigockiFilter()
    wheels = Localizer(CALIBRATION, CONFIG.alone("wheels"))
    T_begin_odom, rolled = None, None
    expected = []
    for event in made.events():
        if isinstance(event, WheelTicks):
            rolled = wheels.process(event)
            continue
        T = not_none(camera.process(as_frame(event)).T_odom_body) @ se3.invert(not_none(CALIBRATION.T_base_camera))
        # A millisecond later the wheels have gone on by less than one.
        T_odom_base = not_none(not_none(rolled).T_odom_body)
        T_begin_odom = T @ se3.invert(T_odom_base) if T_begin_odom is None else T_begin_odom
        expected.append(by_hand.update(event.stamp_s, se3.nearest(T_begin_odom @ T_odom_base), se3.nearest(T)))
    for answer, wanted in zip(joined, expected, strict=True):
        np.testing.assert_allclose(not_none(answer.T_odom_body), not_none(wanted.T_odom_body), atol=2e-3)
        np.testing.assert_allclose(not_none(answer.covariance), not_none(wanted.covariance), rtol=0.05, atol=1e-6)


def test_both_begin_where_the_first_frame_is_tracked(paper: Callable[..., Localizer]) -> None:
    """What the wheels rolled until then is no part of the way."""
    made = drive(faults=lambda seconds: DARK if seconds < 2.0 else Sight())
    begin_s = made.begin_s + 2.0
    answers = [answer for _, answer in answered(paper(made.eye()), made.events())]
    before = [answer for answer in answers if answer.stamp_s < begin_s]
    assert len(before) == 50
    assert all((a.T_odom_body, a.status) == (None, Status.INITIALIZING) for a in before)
    assert {answer.reason for answer in before} == {Reason.TOO_FEW_KEYPOINTS}
    first, *rest = answers[50:]
    np.testing.assert_allclose(not_none(first.T_odom_body), np.eye(4), atol=1e-9)
    T_first_truth = se3.invert(made.truth.at([first.stamp_s])[0]) @ made.truth.at([answers[-1].stamp_s])[0]
    assert {answer.status for answer in rest} == {Status.TRACKING}
    np.testing.assert_allclose(not_none(answers[-1].T_odom_body), T_first_truth, atol=0.03)


def test_before_any_reading_there_is_no_pose(paper: Callable[..., Localizer]) -> None:
    made = drive()
    frames: list[Event] = [event for event in made.events() if isinstance(event, RgbdFrame)]
    answers = [answer for _, answer in answered(paper(made.eye()), frames[:5])]
    assert all((a.T_odom_body, a.covariance, a.status) == (None, None, Status.INITIALIZING) for a in answers)


def test_without_the_camera_it_coasts_by_the_wheels(paper: Callable[..., Localizer]) -> None:
    made = drive(faults=lambda seconds: DARK if 2.0 < seconds < 3.5 else Sight())
    answers = [answer for _, answer in answered(paper(made.eye()), made.events())]
    dark = [answer for answer in answers if 2.0 < seconds_of(made, answer) < 3.5]
    assert {(answer.status, answer.reason) for answer in dark} == {(Status.COASTING, Reason.TOO_FEW_KEYPOINTS)}
    assert max(off_m(answer, made.truth) for answer in dark) < 0.03
    way_m = np.linalg.norm(not_none(dark[-1].T_odom_body)[:3, 3] - not_none(dark[0].T_odom_body)[:3, 3])
    assert way_m > 0.6
    after = [answer for answer in answers if seconds_of(made, answer) > 3.5]
    assert {answer.status for answer in after} == {Status.TRACKING}


def test_a_skipped_frame_coasts_and_says_why(paper: Callable[..., Localizer]) -> None:
    made = drive()
    subject = paper(made.eye())
    answered(subject, made.events()[:90])
    cut = subject.process(SkippedFrame(made.begin_s + 1.2, "depth image is cut off"))
    assert cut is not None
    assert (cut.status, cut.reason, subject.note) == (Status.COASTING, Reason.FRAME_UNUSABLE, "depth image is cut off")


@pytest.mark.parametrize("delay_s", [0.0, 0.03])
def test_wheels_are_carried_on_to_the_frames_stamp(paper: Callable[..., Localizer], delay_s: float) -> None:
    """Readings that are reported late tell of an earlier moment; until the frame's their speed goes on."""
    made = drive(((6.0, 0.8, 0.0),), faults=lambda seconds: DARK if seconds > 3.0 else Sight())
    late = replace(CALIBRATION, wheels=replace(WHEELS, delay_s=delay_s))
    events = [replace(e, stamp_s=e.stamp_s + delay_s) if isinstance(e, WheelTicks) else e for e in made.events()]
    events.sort(key=lambda event: event.stamp_s)
    answers = [answer for _, answer in answered(paper(made.eye(), late), events)]
    coasting = [a for a in answers if 3.0 < seconds_of(made, a) < 5.5]
    assert {answer.status for answer in coasting} == {Status.COASTING}
    assert max(off_m(answer, made.truth) for answer in coasting) < 0.01  # 0.03 s would be 0.024 m


def test_wheels_that_fall_silent_are_carried_no_farther_than_a_gap_may_be(paper: Callable[..., Localizer]) -> None:
    made = drive(((6.0, 0.8, 0.0),), faults=lambda seconds: DARK if seconds > 3.0 else Sight())
    events = [e for e in made.events() if isinstance(e, RgbdFrame) or e.stamp_s < made.begin_s + 3.0]
    answers = [answer for _, answer in answered(paper(made.eye()), events)]
    silent = [answer for answer in answers if seconds_of(made, answer) > 3.0]
    x_m = np.array([not_none(answer.T_odom_body)[0, 3] for answer in silent])
    at_end = made.truth.at([made.begin_s + 3.0])[0][0, 3]
    assert x_m.max() < at_end + 0.8 * WHEELS.max_gap_s + 0.03
    assert x_m.max() > at_end + 0.8 * WHEELS.max_gap_s - 0.03
    assert np.ptp(x_m[-30:]) < 1e-3
    assert {answer.status for answer in silent} == {Status.COASTING}


def test_frames_out_of_order_are_refused_and_move_nothing(paper: Callable[..., Localizer]) -> None:
    made = drive()
    subject = paper(made.eye())
    *_, (_, before) = answered(subject, made.events()[:91])
    late = subject.process(frame(1, before.stamp_s - 0.04))
    assert late is not None
    assert late.reason is not None
    assert "does not come after" in subject.note
    np.testing.assert_allclose(not_none(late.T_odom_body), not_none(before.T_odom_body), atol=0.02)
    *_, (_, after) = answered(subject, made.events()[91:])
    assert after.status is Status.TRACKING
    assert off_m(after, made.truth) < 0.02


@pytest.mark.parametrize("stamp_s", [np.nan, np.inf])
@pytest.mark.parametrize(
    "make", [lambda s: frame(0, s), lambda s: SkippedFrame(s, "cut off")], ids=["frame", "skipped"]
)
def test_a_frame_whose_stamp_is_no_number_has_no_pose_and_moves_nothing(
    paper: Callable[..., Localizer], stamp_s: float, make: Callable[[float], Event]
) -> None:
    made = drive()
    subject = paper(made.eye())
    answered(subject, made.events()[:91])
    odd = subject.process(make(stamp_s))
    assert odd is not None
    assert (odd.T_odom_body, odd.reason) == (None, Reason.FRAME_UNUSABLE)
    assert subject.note
    *_, (_, after) = answered(subject, made.events()[91:])
    assert after.status is Status.TRACKING
    assert off_m(after, made.truth) < 0.02


def test_a_mount_that_was_written_with_five_digits_will_do(paper: Callable[..., Localizer]) -> None:
    T_base_camera = T_BASE_CAMERA.copy()
    T_base_camera[:3, :3] += 2e-5
    made = drive()
    answers = answered(paper(made.eye(), replace(CALIBRATION, T_base_camera=T_base_camera)), made.events())
    assert off_m(answers[-1][1], made.truth) < 0.02
