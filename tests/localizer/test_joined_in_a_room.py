"""Wheels and real odometry, dense and by features, joined on a drive through a room that is rendered."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from grids import mostly_slow
from localizer.joined_drives import off_m, spread_m
from room_drive import T_BASE_CAMERA, make_room_drive
from synthetic import render_room

from wheelsight.config import load_config
from wheelsight.core.calibration import Calibration
from wheelsight.core.estimates import Reason, Status
from wheelsight.core.geometry import se3
from wheelsight.core.messages import Event, RgbdFrame, WheelTicks
from wheelsight.core.trajectory import Trajectory
from wheelsight.estimation import FusedEstimate, Localizer
from wheelsight.io.recordings import open_recording

DARK_S = (1.2, 2.2)  # since the begin; it drives from 1.0 to 2.6 s
Answers = list[tuple[RgbdFrame, FusedEstimate, int]]


Room = tuple[Calibration, list[Event], Trajectory]


@pytest.fixture(scope="module")
def room(tmp_path_factory: pytest.TempPathFactory) -> Room:
    """A drive of 20 frames between two halts, by calibration, events, and the way in the room."""
    folder = tmp_path_factory.mktemp("recordings") / "room"
    truth = make_room_drive(folder, frames=20)
    recording = open_recording(folder)
    return recording.calibration, list(recording.events()), truth


def since_begin(truth: Trajectory) -> Trajectory:
    return Trajectory(truth.stamps_s, se3.invert(truth.T_frame_body[0]) @ truth.T_frame_body, body="base")


def seen_as(change: Callable[[RgbdFrame], RgbdFrame], events: list[Event], when_s: tuple[float, float]) -> list[Event]:
    begin_s = events[0].stamp_s
    return [
        change(event) if isinstance(event, RgbdFrame) and when_s[0] < event.stamp_s - begin_s < when_s[1] else event
        for event in events
    ]


def covered(frame: RgbdFrame) -> RgbdFrame:
    return replace(frame, color=np.zeros_like(frame.color), depth_m=np.zeros_like(frame.depth_m))


def answers_of(subject: Localizer, events: list[Event]) -> Answers:
    """Each frame, its answer, and how large the map was after it."""
    answers = []
    for event in events:
        answer = subject.process(event)
        if isinstance(event, RgbdFrame) and isinstance(answer, FusedEstimate):
            answers.append((event, answer, 0 if subject.map is None else len(subject.map)))
    return answers


@pytest.mark.parametrize("camera", mostly_slow(["dense", "features", "map"], quick=["features", "map"]))
def test_a_blackout_on_a_drive(room: Room, camera: str) -> None:
    calibration, events, truth = room
    way = since_begin(truth)
    mapped = {"map": "surfels", "surfels.stable_confidence": 2.0} if camera == "map" else {}
    kind = "features" if camera == "features" else "dense"
    settings = load_config(overrides={"odometry": f"wheels,{kind}", **mapped})
    answers = answers_of(Localizer(calibration, settings), seen_as(covered, events, DARK_S))
    begin_s = events[0].stamp_s
    dark = [a for a in answers if DARK_S[0] < a[0].stamp_s - begin_s < DARK_S[1]]
    bright = [a for a in answers[1:] if not DARK_S[0] < a[0].stamp_s - begin_s < DARK_S[1]]
    assert len(dark) > 10
    assert {a.status for _, a, _ in dark[5:]} == {Status.COASTING}
    assert {a.reason for _, a, _ in dark} <= {
        Reason.TOO_LITTLE_DEPTH,
        Reason.TOO_FEW_KEYPOINTS,
        Reason.FRAME_UNUSABLE,
    }
    assert {a.status for _, a, _ in bright} == {Status.TRACKING}
    assert max(off_m(a, way, frame.stamp_s) for frame, a, _ in answers) < 0.02
    assert all(off_m(a, way, frame.stamp_s) < 3 * spread_m(a) + 2e-3 for frame, a, _ in answers)
    assert spread_m(dark[-1][1]) > spread_m(dark[0][1])
    assert way.T_frame_body[-1][0, 3] > 0.5
    if camera == "map":
        sizes = [size for _, _, size in dark]
        assert sizes[0] == sizes[-1] > 0
        assert answers[-1][2] > sizes[-1]


def test_wheels_that_spin_before_a_room(room: Room) -> None:
    calibration, events, truth = room
    way = since_begin(truth)
    begin_s = events[0].stamp_s

    def spun(event: Event) -> Event:
        if not isinstance(event, WheelTicks):
            return event
        extra = round(np.clip(event.stamp_s - begin_s - 1.4, 0, 0.8) * 3000)  # about 1 m/s
        return WheelTicks(event.stamp_s, event.left + extra, event.right + extra)

    settings = load_config(overrides={"odometry": "wheels,dense"})
    answers = answers_of(Localizer(calibration, settings), [spun(event) for event in events])
    reported = [a for frame, a, _ in answers if 1.5 < frame.stamp_s - begin_s < 2.2]
    assert all(a.slip or a.doubtful for a in reported)
    assert off_m(answers[-1][1], way, answers[-1][0].stamp_s) < 0.05  # the wheels are 0.8 m off
    assert not answers[-1][1].slip


def test_after_a_blackout_the_map_goes_on_where_nothing_is_known(room: Room) -> None:
    """The robot is covered for a moment, and then sees another part of the room than it should: a map has to begin."""
    calibration, events, truth = room
    way, T_other_here = since_begin(truth), se3.exp([0.3, 0.2, 0, 0, 0, 0]) @ se3.exp([0, 0, 0, 0, 0, np.pi])

    def elsewhere(frame: RgbdFrame) -> RgbdFrame:
        T_odom_base = truth.at([min(frame.stamp_s - 0.001, truth.stamps_s[-1])])[0]
        color, depth_m = render_room(T_other_here @ T_odom_base @ T_BASE_CAMERA)
        return replace(frame, color=color, depth_m=depth_m)

    settings = load_config(overrides={"odometry": "wheels,dense", "map": "surfels", "surfels.stable_confidence": 2.0})
    given = seen_as(elsewhere, seen_as(covered, events, (1.2, 1.6)), (1.6, 99.0))
    answers = answers_of(Localizer(calibration, settings), given)
    begin_s = events[0].stamp_s
    strange = [a for a in answers if a[0].stamp_s - begin_s > 1.6]
    unseen = [a.reason is not None for _, a, _ in strange]
    assert unseen == [True] * 5 + [False] * (len(unseen) - 5)
    assert {a.status for _, a, _ in strange[5:]} == {Status.TRACKING}
    assert strange[3][2] == answers[len(answers) - len(strange) - 5][2]
    assert strange[-1][2] > 1.3 * strange[3][2]
    assert max(off_m(a, way, frame.stamp_s) for frame, a, _ in answers) < 0.03
