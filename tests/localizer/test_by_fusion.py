"""ByFusion: wheels and a camera that sees the truth, but for what each test does to one of them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from localizer.joined_drives import (
    WHEELS,
    Drive,
    Eye,
    Sight,
    answers_to,
    drive,
    eye_by_index,
    joined,
    of_frames,
    off_m,
    pushed,
    spinning,
    spread_m,
)
from narrowing import not_none

from wheelsight.core.estimates import CameraEstimate, Estimate, Reason, Status
from wheelsight.core.geometry import FloatArray, se3, so3
from wheelsight.core.keyframes import KeyframeId
from wheelsight.core.messages import Event, RgbdFrame, WheelTicks
from wheelsight.estimation import FusedEstimate, fusion_localizer

SHORT = ((2.0, 0.6, 0.2),)
Run = tuple[Drive, Eye, list[tuple[Event, FusedEstimate]], dict[float, Any]]


@pytest.fixture
def ran(monkeypatch: pytest.MonkeyPatch) -> Callable[..., Run]:
    """Runs a drive, and gives it with what saw it, the answers, and what got into the map at which second."""

    def run(made: Drive, kind: str = "dense") -> Run:
        eye = made.eye()
        subject, kept = joined(monkeypatch, eye, kind)
        answers = answers_to(subject, made.events())
        return made, eye, answers, {stamp_s - made.begin_s: T for stamp_s, T in kept.fused.items()}

    return run


def between(run: Run, begin_s: float, end_s: float) -> list[FusedEstimate]:
    """Answers to frames of these seconds."""
    return [a for a in of_frames(run[2]) if begin_s < a.stamp_s - run[0].begin_s < end_s]


def fused_between(run: Run, begin_s: float, end_s: float) -> list[float]:
    return [second for second in run[3] if begin_s < second < end_s]


def only(when: tuple[float, float], sight: Sight) -> Callable[[float], Sight]:
    """Some seconds of a drive show this, all others the truth."""
    return lambda seconds: sight if when[0] < seconds < when[1] else Sight()


HIDING = only((2.0, 3.5), Sight(hidden=np.array([[0.0, 0, 1, 0, 0, 0]])))  # where the camera looks, which is forward


@pytest.mark.parametrize("kind", ["dense", "features"])
def test_readings_and_frames_are_answered_with_the_bases_pose(ran: Callable[..., Run], kind: str) -> None:
    run = ran(drive(), kind)
    made, _, answers, _ = run
    assert [type(event) for event, _ in answers] == [type(event) for event in made.events()]
    assert all(answer.body == "base" for _, answer in answers)
    reported = [answer for event, answer in answers[1:] if answer.stamp_s == event.stamp_s]
    assert len(reported) == len(answers) - 1
    assert max(off_m(answer, made.truth) for answer in reported) < 0.03
    assert all(off_m(answer, made.truth) < 3 * spread_m(answer) + 1e-3 for answer in reported)
    assert {a.status for a in between(run, 0.1, 99)} == {Status.TRACKING}
    assert not any(a.slip or a.doubtful or a.degenerate or a.reason for a in between(run, 0.1, 99))
    assert {(a.matches, a.inliers) for a in between(run, 0.1, 99)} == {(200, 160)}


def test_there_is_no_pose_before_wheels_begin_the_clock(monkeypatch: pytest.MonkeyPatch) -> None:
    made = drive(SHORT)
    subject, kept = joined(monkeypatch, made.eye())
    assert (subject.body, subject.frame) == ("base", "map")
    assert {WheelTicks, RgbdFrame} <= set(subject.answers)
    begin, first_frame, *rest = made.events()
    waiting = subject.process(first_frame)
    assert waiting is not None
    assert (waiting.status, waiting.body, waiting.T_odom_body) == (Status.INITIALIZING, "base", None)
    (_, reported), *_ = answers_to(subject, [begin])
    assert (reported.status, reported.stamp_s) == (Status.COASTING, begin.stamp_s)
    np.testing.assert_allclose(not_none(reported.T_odom_body), np.eye(4), atol=1e-12)
    assert not kept.fused
    assert of_frames(answers_to(subject, rest))[-1].status is Status.TRACKING


class Remembering(Eye):
    """Names a keyframe, which lies somewhere in its map, with each pose."""

    T_map_keyframe = se3.exp([0.4, -0.2, 0.1, 0.1, 0.2, -0.3])

    def process(self, frame: RgbdFrame, *expected: FloatArray | None, twist: FloatArray | None = None) -> Estimate:
        seen = super().process(frame, *expected, twist=twist)
        if seen.T_odom_body is None:
            return seen
        T_keyframe_camera = se3.invert(self.T_map_keyframe) @ seen.T_odom_body
        return replace(seen, keyframe=KeyframeId(7), T_keyframe_body=T_keyframe_camera)


def test_answers_say_where_the_base_is_in_the_map_and_by_which_keyframe(monkeypatch: pytest.MonkeyPatch) -> None:
    """The map lies where the camera's frames have it; on the way between frames, too."""
    made = drive(SHORT)
    subject, _ = joined(monkeypatch, Remembering(made.truth))
    for event in made.events():
        answer = subject.process(event)
        if not isinstance(answer, FusedEstimate) or answer.T_odom_body is None:
            continue
        np.testing.assert_allclose(answer.T_map_odom @ subject.T_odom_map, np.eye(4), atol=1e-12)
        if answer.keyframe is not None:
            assert answer.keyframe == 7
            np.testing.assert_allclose(
                Remembering.T_map_keyframe @ not_none(answer.T_keyframe_body), not_none(answer.T_map_body), atol=1e-12
            )
    assert answer is not None
    assert answer.keyframe == 7


def test_the_camera_is_handed_the_motion_that_wheels_expect(ran: Callable[..., Run]) -> None:
    _, eye, _, _ = ran(drive(faults=only((3.0, 3.5), Sight(Reason.TOO_LITTLE_DEPTH))))
    assert len(eye.priors) > 100
    for stamp_s, (last_s, prior) in eye.priors.items():
        assert prior is not None
        T = se3.invert(eye.T_odom_camera(last_s)) @ eye.T_odom_camera(stamp_s)
        off = se3.invert(T) @ prior
        sigma_m = WHEELS.slip_m_per_sqrt_m * np.sqrt(np.linalg.norm(T[:3, 3])) + 2 * WHEELS.left_m_per_tick
        assert np.linalg.norm(off[:3, 3]) < 5 * sigma_m
        assert so3.angle(off[:3, :3]) < 5 * sigma_m / WHEELS.track_width_m
    steps_m = [np.linalg.norm(prior[:3, 3]) for _, prior in eye.priors.values() if prior is not None]
    assert max(steps_m) > 0.2  # over the gap


@pytest.mark.parametrize("kind", ["dense", pytest.param("features", marks=pytest.mark.slow)])
def test_a_blackout_is_coasted_and_the_map_waits(ran: Callable[..., Run], kind: str) -> None:
    run = ran(drive(faults=only((2.0, 3.5), Sight(Reason.TOO_LITTLE_DEPTH))), kind)
    dark = between(run, 2.0, 3.5)
    assert {a.reason for a in dark} == {Reason.TOO_LITTLE_DEPTH}
    assert {a.status for a in between(run, 2.4, 3.5)} == {Status.COASTING}
    spreads = np.array([spread_m(a) for a in dark])
    assert (spreads[5:] > spreads[:-5]).all()
    assert spreads[-1] > 1.8 * spreads[0]
    assert all(off_m(a, run[0].truth) < 3 * spread_m(a) for a in dark)
    assert {a.status for a in between(run, 3.5, 99)} == {Status.TRACKING}
    assert spread_m(between(run, 3.5, 3.6)[0]) < spreads[-1]
    assert off_m(between(run, 3.5, 4.0)[-1], run[0].truth) < 0.01
    if kind == "dense":
        assert not fused_between(run, 2.0, 3.5)
        assert len(fused_between(run, 3.5, 99)) > 50
    assert not run[1].restarts


@pytest.mark.parametrize("kind", ["dense", pytest.param("features", marks=pytest.mark.slow)])
def test_where_nothing_known_is_in_sight_the_camera_starts_again_where_wheels_have_it(
    ran: Callable[..., Run], kind: str
) -> None:
    def faults(seconds: float) -> Sight:
        return Sight(Reason.TOO_LITTLE_DEPTH) if 2 < seconds < 3 else Sight(place=int(seconds >= 3))

    run = ran(drive(faults=faults), kind)
    made, eye, _, _ = run
    ((restart_s, T_map_camera),) = eye.restarts.items()
    assert restart_s - made.begin_s == pytest.approx(3.0 + 4 * 0.04, abs=0.01)  # five frames in a row
    assert np.linalg.norm((T_map_camera - eye.T_odom_camera(restart_s))[:3, 3]) < 0.03
    assert {a.status for a in between(run, 2.4, 3.14)} == {Status.COASTING}
    assert {a.reason for a in between(run, 3.0, 3.17)} == {Reason.NOT_RECOGNISED}
    assert {a.status for a in between(run, 3.2, 99)} == {Status.TRACKING}
    last = between(run, 0, 99)[-1]
    assert off_m(last, made.truth) < min(0.05, 3 * spread_m(last))
    if kind == "dense":
        assert not fused_between(run, 2.0, 3.17)
        assert len(fused_between(run, 3.17, 4.0)) > 15


@pytest.mark.parametrize(("dark_s", "starts_again"), [(0.5, False), (1.5, True)])
def test_after_the_dark_a_look_that_slides_along_a_wall_is_not_believed(
    ran: Callable[..., Run], dark_s: float, starts_again: bool
) -> None:
    along = np.array([[0.0, 0, 1, 0, 0, 0]])

    def faults(seconds: float) -> Sight:
        if 2 < seconds < 2 + dark_s:
            return Sight(Reason.TOO_LITTLE_DEPTH)
        return Sight(hidden=along) if 2 + dark_s <= seconds < 4.5 else Sight()

    run = ran(drive(faults=faults))
    first = between(run, 2.0 + dark_s, 99)[0]
    assert (first.reason is Reason.DEGENERATE) == starts_again
    assert bool(run[1].restarts) == starts_again
    assert {a.status for a in between(run, 2.1 + dark_s, 99)} == {Status.TRACKING}
    last = between(run, 0, 99)[-1]
    assert off_m(last, run[0].truth) < min(0.05, 3 * spread_m(last))


def test_blind_frames_alone_never_start_the_camera_again(ran: Callable[..., Run]) -> None:
    run = ran(drive(SHORT, only((0.5, 2.0), Sight(Reason.FRAME_UNUSABLE))))
    assert not run[1].restarts
    assert {a.status for a in between(run, 2.1, 99)} == {Status.TRACKING}


@pytest.mark.parametrize("kind", ["dense", pytest.param("features", marks=pytest.mark.slow)])
def test_a_camera_that_leaps_away_is_not_believed_nor_mapped(ran: Callable[..., Run], kind: str) -> None:
    run = ran(drive(faults=only((2.0, 3.5), Sight(wrong=(0.0, 0.5, 0.3)))), kind)
    reported = between(run, 2.0, 3.5)
    assert {a.reason for a in reported} == {Reason.CONTRADICTION}
    assert max(off_m(a, run[0].truth) for a in reported if not a.doubtful) < 0.03  # the camera's would be 0.75 m
    assert all(off_m(a, run[0].truth) < 3 * spread_m(a) for a in reported)
    assert not any(a.slip for a in reported)
    assert {a.status for a in between(run, 2.4, 3.5)} == {Status.COASTING}
    assert not fused_between(run, 2.0, 3.5)
    assert {a.status for a in between(run, 5.4, 99)} == {Status.TRACKING}
    if kind == "dense":
        assert fused_between(run, 5.4, 99)


def test_a_camera_that_creeps_away_with_the_wheels_is_doubted_first(ran: Callable[..., Run]) -> None:
    run = ran(drive(faults=only((2.0, 3.5), Sight(wrong=(0.15, 0.0, 0.0)))))
    doubted = [a for a in between(run, 2.0, 3.5) if a.doubtful]
    assert doubted
    assert all(a.reason is Reason.CONTRADICTION for a in doubted)
    assert not {round(a.stamp_s - run[0].begin_s, 6) for a in doubted} & {round(second, 6) for second in run[3]}


@pytest.mark.parametrize("kind", ["dense", "features"])
def test_wheels_that_spin_are_reported_and_the_camera_leads(ran: Callable[..., Run], kind: str) -> None:
    run = ran(spinning(drive(), 2.0, 3.5, 0.6), kind)
    reported = between(run, 2.04, 3.5)
    assert all(a.slip or a.doubtful for a in reported)
    assert sum(a.slip for a in reported) > 0.8 * len(reported)
    assert max(off_m(a, run[0].truth) for a in reported if not a.doubtful) < 0.02  # the wheels are 0.9 m ahead
    assert all(off_m(a, run[0].truth) < 3 * spread_m(a) for a in reported)
    after = between(run, 4.0, 99)
    assert not any(a.slip or a.doubtful for a in after)
    assert off_m(after[-1], run[0].truth) < 0.03


def test_while_wheels_slip_the_camera_is_reported_that_it_goes_on_as_it_went(monkeypatch: pytest.MonkeyPatch) -> None:
    """And with the motion by the wheels second; both only until these are used again."""
    made = spinning(drive(), 2.0, 3.5, 0.6)
    eye = made.eye()
    subject, _ = joined(monkeypatch, eye)
    off_by_slip: dict[bool, list[float]] = {True: [], False: []}
    slips = False
    for event in made.events():
        answer = subject.process(event)
        if not isinstance(event, RgbdFrame) or not isinstance(answer, FusedEstimate):
            continue
        last_s, prior = eye.priors.get(event.stamp_s, (0.0, None))
        assert len(eye.others.get(event.stamp_s, ())) == (slips and event.stamp_s in eye.priors)
        if prior is not None and 2.1 < event.stamp_s - made.begin_s < 3.4:
            T = se3.invert(eye.T_odom_camera(last_s)) @ eye.T_odom_camera(event.stamp_s)
            off_by_slip[slips].append(float(np.linalg.norm((se3.invert(T) @ prior)[:3, 3])))
        slips = answer.slip
    assert len(off_by_slip[True]) > 30
    assert np.median(off_by_slip[True]) < 0.005  # a spinning wheel says 2 cm a frame


@pytest.mark.parametrize("kind", ["dense", "features"])
def test_a_robot_that_is_pushed_aside_soon_believes_its_camera_again(ran: Callable[..., Run], kind: str) -> None:
    """Who was right then no one shows, and both are covered; a camera that goes on well is not left out for it."""
    run = ran(pushed(drive(), 2.0, 0.25), kind)
    assert all(off_m(a, run[0].truth) < 3 * spread_m(a) for a in between(run, 2.2, 99))
    after = between(run, 2.7, 99)
    assert np.mean([a.status is Status.TRACKING for a in after]) > 0.9
    assert after[-1].status is Status.TRACKING
    if kind == "dense":
        assert len(fused_between(run, 2.7, 4.0)) > 10


def test_directions_that_the_camera_does_not_show_are_the_wheels(ran: Callable[..., Run]) -> None:
    """Wheels that are a tenth too quick for a while are followed where the view does not tell, and only there."""
    hidden, seen = (ran(spinning(drive(faults=f), 2.0, 3.5, 0.05)) for f in (HIDING, only((0, 0), Sight())))
    reported = between(hidden, 2.02, 3.5)
    assert all(a.degenerate and a.status is Status.TRACKING and a.reason is None for a in reported)
    assert not any(a.degenerate for a in [*between(hidden, 3.5, 99), *between(seen, 0.0, 99)])
    T_truth = hidden[0].truth.at([reported[-1].stamp_s])[0]
    assert reported[-1].T_filter_body is not None
    off = se3.invert(T_truth) @ reported[-1].T_filter_body
    assert 0.05 < np.linalg.norm(off[:2, 3]) < 0.08
    assert so3.angle(off[:3, :3]) < 0.01
    assert off_m(between(seen, 2.02, 3.5)[-1], seen[0].truth) < 0.015
    assert len(fused_between(hidden, 2.02, 3.5)) == len(reported)  # filled by the wheels, it is a pose as any other


def test_a_pause_of_all_sensors_is_bridged_by_a_view_that_is_known(monkeypatch: pytest.MonkeyPatch) -> None:
    made = drive()
    subject, _ = joined(monkeypatch, eye_by_index(made))
    pause = (made.begin_s + 2.0, made.begin_s + 4.5)
    answers = answers_to(subject, [event for event in made.events() if not pause[0] < event.stamp_s < pause[1]])
    after = [(event, answer) for event, answer in answers if event.stamp_s >= pause[1]]
    first = after[0][1]
    assert first.status in (Status.COASTING, Status.LOST)
    assert first.T_odom_body is None or off_m(first, made.truth) < 3 * spread_m(first)
    assert {answer.status for answer in of_frames(after)[3:]} == {Status.TRACKING}
    assert max(off_m(answer, made.truth) for answer in of_frames(after)) < 0.05


def test_the_camera_goes_on_when_wheels_fall_silent(monkeypatch: pytest.MonkeyPatch) -> None:
    made = drive()
    silent_s = made.begin_s + 2.0
    events = [event for event in made.events() if isinstance(event, RgbdFrame) or event.stamp_s < silent_s]
    answers = of_frames(answers_to(joined(monkeypatch, made.eye())[0], events))
    alone = [answer for answer in answers if answer.stamp_s > silent_s]
    assert {answer.status for answer in alone} == {Status.TRACKING}
    assert max(off_m(answer, made.truth) for answer in alone) < 0.05


def _delayed(made: Drive, late_s: float) -> list[Event]:
    """Events as they come where frames come late."""
    return sorted(made.events(), key=lambda e: e.stamp_s + (late_s if isinstance(e, RgbdFrame) else 0.0))


def test_a_camera_starts_again_where_its_frame_was_taken_however_late_it_comes(monkeypatch: pytest.MonkeyPatch) -> None:
    def faults(seconds: float) -> Sight:
        return Sight(Reason.TOO_LITTLE_DEPTH) if 2 < seconds < 3 else Sight(place=int(seconds >= 3))

    made, poses = drive(faults=faults), []
    for late_s in (0.0, 0.13):
        eye = made.eye()
        answers_to(joined(monkeypatch, eye)[0], _delayed(made, late_s))
        ((_, T_map_camera),) = eye.restarts.items()
        poses.append(T_map_camera)
    # In 0.13 s it went 0.06 m.
    assert np.linalg.norm((poses[1] - poses[0])[:3, 3]) < 0.005


@pytest.mark.slow
def test_frames_that_come_late_end_where_those_in_time_do(monkeypatch: pytest.MonkeyPatch) -> None:
    """Of a live robot readings come at once, and frames when they are decoded."""
    made = drive()
    ends = []
    for late_s in (0.0, 0.065):
        events = _delayed(made, late_s)
        answers = of_frames(answers_to(joined(monkeypatch, made.eye())[0], events))
        assert {answer.status for answer in answers[5:]} == {Status.TRACKING}
        assert all((answer.reason, answer.doubtful, answer.slip) == (None, False, False) for answer in answers[5:])
        assert off_m(answers[-1], made.truth) < 0.015
        ends.append(spread_m(answers[-1]))
    assert ends[1] == pytest.approx(ends[0], rel=0.05)


def test_the_same_events_give_the_same_bits(monkeypatch: pytest.MonkeyPatch) -> None:
    made = drive(SHORT)
    one, other = (answers_to(joined(monkeypatch, made.eye())[0], made.events())[-1][1] for _ in range(2))
    np.testing.assert_array_equal(one.T_odom_body, other.T_odom_body)
    np.testing.assert_array_equal(one.covariance, other.covariance)


def test_the_camera_restarts_after_frames_that_show_nothing_known(monkeypatch: pytest.MonkeyPatch) -> None:
    made = drive(faults=only((3.0, 4.0), Sight(Reason.NOT_RECOGNISED)))
    stamps_s = [event.stamp_s for event in made.events() if isinstance(event, RgbdFrame)]
    first = []
    for restart_after in (2, 5):
        eye = made.eye()
        monkeypatch.setattr(fusion_localizer, "RESTART_AFTER", restart_after)
        subject, _ = joined(monkeypatch, eye)
        answers_to(subject, made.events())
        first.append(stamps_s.index(min(eye.restarts)))
    assert first[1] - first[0] == 3


RELOCATED = se3.from_plane(0.1, 0.3, 0.05)


class Relocating(Eye):
    """An older keyframe corrects its pose at 2 s.

    If that ends drift, its poses in the map are others from there on; else the frame was aligned wrongly, and they are
    right by that keyframe.
    """

    ends_drift = True

    def process(self, frame: RgbdFrame, *given: FloatArray | None, twist: FloatArray | None = None) -> Estimate:
        is_due = self._last is not None and self._last[0] < self._truth.stamps_s[0] + 2.0 <= frame.stamp_s
        seen = super().process(frame, *given, twist=twist)
        assert isinstance(seen, CameraEstimate)
        if not is_due:
            return seen
        if not self.ends_drift:
            return replace(seen, relocation=RELOCATED)
        assert self._key is not None
        assert self._last is not None
        self._key, self._last = ((stamp_s, RELOCATED @ T) for stamp_s, T in (self._key, self._last))
        return replace(seen, T_odom_body=self._last[1], relocation=RELOCATED)


@pytest.mark.parametrize("ends_drift", [True, False])
def test_a_relocation_moves_the_pose_in_the_map_unless_it_corrects_the_last_frame(
    monkeypatch: pytest.MonkeyPatch, ends_drift: bool
) -> None:
    made = drive()
    eye = Relocating(made.truth)
    eye.ends_drift = ends_drift
    subject, _ = joined(monkeypatch, eye)
    answers = of_frames(answers_to(subject, made.events()))
    assert not any(answer.reason for answer in answers[1:])
    assert max(off_m(answer, made.truth) for answer in answers) < 0.03
    for answer in answers[1:]:
        moved = RELOCATED if ends_drift and answer.stamp_s >= made.begin_s + 2.0 else np.eye(4)
        assert answer.T_filter_body is not None
        np.testing.assert_allclose(not_none(answer.T_map_body), moved @ answer.T_filter_body, atol=0.02)


def test_a_camera_that_returns_after_its_fault_is_where_it_was_in_the_map(ran: Callable[..., Run]) -> None:
    weaving = ((3.0, 0.6, 0.5), (3.0, 0.6, -0.5)) * 8
    run = ran(drive(weaving, only((12.0, 18.0), Sight(wrong=(0.0, 0.5, 0.0)))))
    assert {a.status for a in between(run, 13.0, 18.0)} == {Status.COASTING}
    back = between(run, 40.0, 99.0)
    assert {a.status for a in back} == {Status.TRACKING}
    for answer in back:  # its own poses are 3 m off
        assert answer.T_map_body is not None
        assert answer.T_filter_body is not None
        assert np.linalg.norm((answer.T_map_body - answer.T_filter_body)[:3, 3]) < 0.5
    # The return does not end the correction of odom, which was 1.6 m off.
    assert np.linalg.norm((not_none(back[-1].T_odom_body) - not_none(back[-1].T_filter_body))[:2, 3]) < 0.9


def test_a_camera_that_returns_when_the_filter_is_lost_begins_with_it(ran: Callable[..., Run]) -> None:
    """A wheel is dead, then the camera is left out, too: for seconds nothing gives a pose."""
    weaving = ((3.0, 0.6, 0.5), (3.0, 0.6, -0.5)) * 8
    made = drive(weaving, only((14.0, 20.0), Sight(wrong=(0.0, 0.5, 0.0))))
    left, dead = made.readings.left.copy(), np.searchsorted(made.readings.stamps_s, made.begin_s + 8.0)
    left[dead:] = left[dead]
    run = ran(replace(made, readings=replace(made.readings, left=left)))
    assert Status.LOST in {a.status for a in between(run, 14.0, 30.0)}
    back = between(run, 30.0, 99.0)
    assert all(a.T_odom_body is not None and a.covariance is not None for a in back)
    # It moves on from there, and says that it does not know where that is.
    assert {a.status for a in back} <= {Status.TRACKING, Status.COASTING}
    for answer in back:
        assert 3 * np.sqrt(np.linalg.eigvalsh(not_none(answer.covariance)[:2, :2])[-1]) > off_m(answer, made.truth)
