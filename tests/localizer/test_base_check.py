"""Joined runs whose calibration or inputs are wrong: a warning says so, and the right sensor answers."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from drives import Leg
from grids import mostly_slow
from localizer.joined_drives import (
    CALIBRATION,
    T_BASE_CAMERA,
    WHEELS,
    Drive,
    Eye,
    Sight,
    answers_to,
    drive,
    joined,
    of_frames,
    off_m,
    spinning,
    spread_m,
    yaw_rates,
)

from wheelsight.core.calibration import Calibration
from wheelsight.core.estimates import CameraEstimate, Reason, Status
from wheelsight.core.geometry import FloatArray, so3
from wheelsight.core.messages import Event, RgbdFrame, WheelTicks
from wheelsight.estimation import ErrorStateFilter, FusedEstimate, Localizer
from wheelsight.estimation.consistency_check import BaseCheck
from wheelsight.wheels import WheelOdometry

LEGS: tuple[Leg, ...] = ((3.0, 0.6, 0.0), (1.5, 0.5, 0.6), (1.5, 0.5, -0.6), (2.0, 0.6, 0.0))
MIRROR = np.diag([-1.0, 1.0, 1.0, 1.0])


class WrongEye(Eye):
    """One whose depth is a factor wrong, or whose images are mirrored."""

    depth, mirrors = 1.0, False

    def T_odom_camera(self, stamp_s: float) -> FloatArray:
        T = super().T_odom_camera(stamp_s)
        T[:3, 3] *= self.depth
        return MIRROR @ T @ MIRROR if self.mirrors else T


def eye_of(made: Drive, depth: float = 1.0, *, mirrors: bool = False) -> Eye:
    eye = WrongEye(made.truth, lambda stamp_s: made.faults(stamp_s - made.begin_s))
    eye.depth, eye.mirrors = depth, mirrors
    return eye


def with_floor(events: Sequence[Event], depth: float = 1.0) -> list[Event]:
    """The frames see the floor as the mount of these drives has it, by depth that is a factor wrong."""
    camera = CALIBRATION.cameras[1]
    down = -(camera.rays() @ T_BASE_CAMERA[2, :3])
    depth_m = (np.where(down > 0.2, 1.0 / np.maximum(down, 0.2), 3.0) * depth).astype(np.float32)
    return [replace(event, depth_m=depth_m) if isinstance(event, RgbdFrame) else event for event in events]


def wheels_that(change: Callable[[int, int], tuple[int, int]], events: Sequence[Event]) -> list[Event]:
    reported = []
    for event in events:
        if isinstance(event, WheelTicks):
            left, right = change(event.left, event.right)
            event = replace(event, left=left, right=right)
        reported.append(event)
    return reported


def sized(**factors: float) -> Calibration:
    wheels = replace(WHEELS, **{name: getattr(WHEELS, name) * factor for name, factor in factors.items()})
    return replace(CALIBRATION, wheels=wheels)


def mounted(axis: int, degrees: float) -> Calibration:
    T = T_BASE_CAMERA.copy()
    T[:3, :3] = so3.exp(np.radians(degrees) * np.eye(3)[axis]) @ T[:3, :3]
    return replace(CALIBRATION, T_base_camera=T)


def nearby(answer: FusedEstimate, made: Drive) -> bool:
    """Whether the pose lies within three standard deviations of the truth, both in the plane."""
    return off_m(answer, made.truth) < 3 * max(spread_m(answer), 1e-3)


@pytest.fixture
def run(monkeypatch: pytest.MonkeyPatch) -> Callable[..., tuple[Localizer, list[FusedEstimate]]]:
    def started(eye: Eye, events: Sequence[Event], **settings: Any) -> tuple[Localizer, list[FusedEstimate]]:
        subject, _ = joined(monkeypatch, eye, **settings)
        return subject, of_frames(answers_to(subject, events))

    return started


Run = Callable[..., tuple[Localizer, list[FusedEstimate]]]


@pytest.mark.parametrize("depth", [0.2, 1.4])
def test_depth_of_a_wrong_factor_leaves_the_wheels_alone(run: Run, depth: float) -> None:
    made = drive(LEGS)
    subject, frames = run(eye_of(made, depth), with_floor(made.events(), depth))
    assert len(subject.warnings) == 1
    assert f"depth is {depth:.2g} times the true one: check depth_factor" in subject.warnings[0]
    assert {answer.status for answer in frames} == {Status.COASTING}
    assert max(off_m(answer, made.truth) for answer in frames) < 0.05


@pytest.mark.parametrize(
    ("axis", "degrees"),
    mostly_slow([(2, 90.0), (2, -30.0), (1, 30.0), (0, -90.0)], quick=[(2, -30.0), (0, -90.0)]),
)
def test_a_mount_that_looks_elsewhere_leaves_the_wheels_alone(run: Run, axis: int, degrees: float) -> None:
    made = drive(LEGS)
    subject, frames = run(eye_of(made), with_floor(made.events()), calibration=mounted(axis, degrees))
    assert "T_base_camera" in subject.warnings[0]
    assert frames[-1].status is Status.COASTING
    assert off_m(frames[-1], made.truth) < 0.05
    assert all(nearby(answer, made) for answer in frames if answer.status is Status.TRACKING)


@pytest.mark.parametrize("factor", [0.25, 1.4])
def test_ticks_a_turn_that_are_wrong_leave_the_camera_alone(run: Run, factor: float) -> None:
    made = drive(LEGS)
    subject, frames = run(eye_of(made), with_floor(made.events()), calibration=sized(ticks_per_turn=factor))
    assert "times the true ones: check ticks_per_turn" in subject.warnings[0]
    reported = float(subject.warnings[0].split(" are ")[1].split(" times")[0])
    assert reported == pytest.approx(1 / factor, rel=0.05)
    assert frames[-1].status is Status.TRACKING
    assert off_m(frames[-1], made.truth) < 0.05
    assert all(nearby(answer, made) for answer in frames if answer.status is Status.TRACKING)


@pytest.mark.parametrize(
    ("change", "cause"),
    [
        (lambda left, right: (-left, right), "the left wheel counts backwards"),
        (lambda left, right: (left, -right), "the right wheel counts backwards"),
        (lambda left, right: (-left, -right), "both wheels count backwards"),
    ],
)
def test_signs_of_wheels_leave_the_camera_alone(
    run: Run, change: Callable[[int, int], tuple[int, int]], cause: str
) -> None:
    made = drive(LEGS)
    subject, frames = run(eye_of(made), with_floor(wheels_that(change, made.events())))
    assert cause in subject.warnings[0]
    assert frames[-1].status is Status.TRACKING
    assert off_m(frames[-1], made.truth) < 0.05


@pytest.mark.slow
def test_what_swapped_wheels_and_mirrored_images_have_alike_is_covered(run: Run) -> None:
    made = drive(LEGS)
    swapped = with_floor(wheels_that(lambda left, right: (right, left), made.events()))
    for eye, events in ((eye_of(made), swapped), (eye_of(made, mirrors=True), with_floor(made.events()))):
        subject, frames = run(eye, events)
        assert "left and right wheel are swapped" in subject.warnings[0]
        assert "mirrored left to right" in subject.warnings[0]
        assert frames[-1].doubtful
        assert frames[-1].status is Status.COASTING
        assert all(nearby(answer, made) for answer in frames)


@pytest.mark.slow
def test_a_gyroscope_shows_which_it_is(run: Run) -> None:
    made = drive(LEGS)
    swapped = wheels_that(lambda left, right: (right, left), made.events())
    turns = yaw_rates(made, 0.01)
    for eye, events, cause in (
        (eye_of(made), swapped, "swapped"),
        (eye_of(made, mirrors=True), made.events(), "mirrored"),
    ):
        given = sorted([*with_floor(events), *turns], key=lambda event: (event.stamp_s, isinstance(event, RgbdFrame)))
        subject, frames = run(eye, given)
        assert cause in subject.warnings[-1]
        assert off_m(frames[-1], made.truth) < 0.1
        assert not frames[-1].doubtful


def test_a_sound_drive_is_answered_as_ever(run: Run) -> None:
    made = drive(LEGS)
    subject, frames = run(eye_of(made), with_floor(made.events()))
    assert subject.warnings == ()
    assert {answer.status for answer in frames[2:]} == {Status.TRACKING}
    assert not any(answer.doubtful for answer in frames)
    assert off_m(frames[-1], made.truth) < 0.02


@pytest.mark.parametrize("begin_s", [0.3, pytest.param(2.0, marks=pytest.mark.slow)])
def test_wheels_that_slip_for_a_while_are_no_calibration(run: Run, begin_s: float) -> None:
    made = spinning(drive(LEGS), begin_s, begin_s + 1.0, 0.5)
    subject, frames = run(eye_of(made), with_floor(made.events()))
    assert subject.warnings == ()
    assert off_m(frames[-1], made.truth) < 0.05


def test_a_floor_that_is_elsewhere_is_forgiven_once_ways_agree(run: Run) -> None:
    made = drive(LEGS)
    subject, frames = run(eye_of(made), with_floor(made.events(), 0.5))
    assert subject.warnings == ()
    assert frames[3].status is Status.COASTING
    assert frames[-1].status is Status.TRACKING


# On the spot, then ahead: as a robot looks for a place that it knows.
ROUND: tuple[Leg, ...] = ((0.2, 0.0, 0.0), (2.4, 0.0, 1.0), (0.4, 0.6, 0.0))


def before_a_wall(events: Sequence[Event], until_s: float, wall_m: float = 0.7) -> list[Event]:
    """Frames up to a stamp see nothing but a wall, which hides the floor; then they see the floor."""
    depth_m = np.full_like(next(e.depth_m for e in events if isinstance(e, RgbdFrame)), wall_m)
    return [
        replace(seen, depth_m=depth_m) if isinstance(seen, RgbdFrame) and seen.stamp_s < until_s else seen
        for seen in with_floor(events)
    ]


def test_a_robot_that_begins_before_a_wall_and_turns_has_its_camera(run: Run) -> None:
    made = drive(ROUND)
    subject, frames = run(eye_of(made), before_a_wall(made.events(), made.begin_s + 1.0))
    assert subject.warnings == ()
    assert {answer.status for answer in frames[2:]} == {Status.TRACKING}


def test_one_that_begins_before_a_table_has_its_camera_once_it_has_seen_the_floor(run: Run) -> None:
    made = drive(ROUND)
    seen_s = made.begin_s + 1.0
    events = [
        table if table.stamp_s < seen_s else floor
        for table, floor in zip(with_floor(made.events(), 0.5), with_floor(made.events()), strict=True)
    ]
    subject, frames = run(eye_of(made), events)
    assert subject.warnings == ()
    assert {answer.status for answer in frames if answer.stamp_s > seen_s + 0.3} == {Status.TRACKING}


@pytest.mark.parametrize("off_m", [(0.03, 0.0), (0.0, -0.06)])
def test_a_camera_some_centimetres_elsewhere_is_not_left_out_for_turns_on_the_spot(
    run: Run, off_m: tuple[float, float]
) -> None:
    made = drive(ROUND)
    T_base_camera = T_BASE_CAMERA.copy()
    T_base_camera[:2, 3] += off_m
    subject, frames = run(Eye(made.truth, T_base_camera=T_base_camera), before_a_wall(made.events(), np.inf))
    assert subject.warnings == ()
    assert not any(answer.doubtful for answer in frames)
    assert frames[-1].status is Status.TRACKING


@pytest.mark.parametrize("hides", [False, True])
def test_a_leap_while_the_view_hid_directions_is_held_against_no_one(*, hides: bool) -> None:
    """A camera goes a metre astray, as along a bare wall, and right on from there."""
    made, odometry = drive(((4.0, 0.6, 0.3),)), WheelOdometry(WHEELS)
    check = BaseCheck(CALIBRATION, T_BASE_CAMERA, ErrorStateFilter(T_BASE_CAMERA))
    for event in made.events():
        if isinstance(event, WheelTicks):
            check.add_wheels(odometry.process(event))
        elif isinstance(event, RgbdFrame):
            astray_m = float(np.clip(2 * (event.stamp_s - made.begin_s - 2.0), 0, 1))
            T = made.truth.at([event.stamp_s])[0] @ T_BASE_CAMERA
            T[1, 3] += astray_m
            seen = CameraEstimate(event.stamp_s, Status.TRACKING, T, 1e-6 * np.eye(6))
            if event.index == 0:
                check.begin(event, seen, np.eye(4))
            check.add_tracked(event, seen, shows_all=not (hides and 0 < astray_m < 1))
    assert check.comparison.agrees() == hides


def carried(made: Drive, begin_s: float, end_s: float) -> list[Event]:
    """Wheels that stand while the robot goes on."""
    events = made.events()
    then = [event for event in events if isinstance(event, WheelTicks) and event.stamp_s < made.begin_s + begin_s][-1]
    readings = (event for event in events if isinstance(event, WheelTicks))
    later = next(event for event in readings if event.stamp_s >= made.begin_s + end_s)

    def reported(event: Event) -> Event:
        if not isinstance(event, WheelTicks) or event.stamp_s < then.stamp_s:
            return event
        if event.stamp_s < later.stamp_s:
            return replace(event, left=then.left, right=then.right)
        return replace(event, left=event.left - later.left + then.left, right=event.right - later.right + then.right)

    return [reported(event) for event in events]


def test_a_robot_carried_in_the_dark_does_not_know_where_it_is(run: Run) -> None:
    def sight(seconds: float) -> Sight:
        return Sight(Reason.TOO_LITTLE_DEPTH) if 4.0 <= seconds < 6.5 else Sight(place=int(seconds >= 6.5))

    made = drive(((3.0, 0.6, 0.0), (5.0, 0.6, 0.3), (3.0, 0.6, 0.0)), sight)
    _, frames = run(made.eye(), carried(made, 4.0, 6.5))
    after = [answer for answer in frames if answer.stamp_s > made.begin_s + 6.55]
    assert all(answer.doubtful for answer in after)
    assert not any(answer.status is Status.TRACKING for answer in after)
    assert max(off_m(answer, made.truth) for answer in after) > 1.0
    assert all(nearby(answer, made) for answer in after)


@pytest.mark.slow
def test_one_that_drove_on_in_the_dark_does(run: Run) -> None:
    def sight(seconds: float) -> Sight:
        return Sight(Reason.TOO_LITTLE_DEPTH) if 4.0 <= seconds < 6.5 else Sight(place=int(seconds >= 6.5))

    made = drive(((3.0, 0.6, 0.0), (5.0, 0.6, 0.3), (3.0, 0.6, 0.0)), sight)
    _, frames = run(made.eye(), made.events())
    assert not any(answer.doubtful for answer in frames)
    assert frames[-1].status is Status.TRACKING


@pytest.mark.slow
def test_one_that_stood_in_the_dark_does_too(run: Run) -> None:
    def sight(seconds: float) -> Sight:
        return Sight(Reason.TOO_LITTLE_DEPTH if 4.0 <= seconds < 6.5 else None)

    made = drive(((3.0, 0.6, 0.0), (5.0, 0.0, 0.0), (3.0, 0.6, 0.0)), sight)
    _, frames = run(made.eye(), made.events())
    assert not any(answer.doubtful for answer in frames)
    assert frames[-1].status is Status.TRACKING


def test_a_camera_that_cannot_be_followed_is_left_out_for_its_floor(run: Run) -> None:
    made = drive(LEGS, lambda seconds: Sight(Reason.POOR_FIT) if seconds > 0.1 else Sight())
    subject, frames = run(eye_of(made), with_floor(made.events(), 5.0))
    assert "depth is 5 times the true one" in subject.warnings[0]
    assert {answer.status for answer in frames} == {Status.COASTING}
    assert off_m(frames[-1], made.truth) < 0.05


def test_wheels_that_are_silent_answer_nothing_for_a_camera_whose_floor_is_elsewhere(run: Run) -> None:
    made = drive(LEGS)
    heard = [e for e in with_floor(made.events(), 0.5) if isinstance(e, RgbdFrame) or e.stamp_s < made.begin_s + 0.2]
    _, frames = run(eye_of(made), heard)
    assert frames[-1].stamp_s == pytest.approx(heard[-1].stamp_s)
    assert frames[-1].status is Status.TRACKING
