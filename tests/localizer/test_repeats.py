"""Images listed twice, as of a camera of 15 Hz that is logged at 30, and a camera that hangs; and what is no event."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from narrowing import not_none
from room_drive import make_room_drive
from stand_ins import MemoryRecording
from synthetic import make_tum_recording

from wheelsight.config import load_config
from wheelsight.core.errors import ArgumentError
from wheelsight.core.estimates import Estimate, Reason, Status
from wheelsight.core.messages import Event, RgbdFrame, SkippedFrame, WheelSpeeds, WheelTicks, YawRate
from wheelsight.estimation import Localizer
from wheelsight.io.recordings import Recording, open_recording
from wheelsight_calibration.base import watch

CAMERAS: tuple[dict[str, Any], ...] = (
    {"odometry": "features"},
    {"odometry": "dense"},
    {"odometry": "dense", "map": "surfels", "surfels.stable_confidence": 2.0},
)


@pytest.fixture(scope="module")
def room(tmp_path_factory: pytest.TempPathFactory) -> Recording:
    folder = tmp_path_factory.mktemp("recordings") / "room"
    make_tum_recording(folder, frames=6)
    return open_recording(folder)


@pytest.fixture(scope="module")
def drive(tmp_path_factory: pytest.TempPathFactory) -> Recording:
    """Wheels and a camera, for 20 frames between two halts of a second."""
    folder = tmp_path_factory.mktemp("recordings") / "drive"
    make_room_drive(folder, frames=20)
    return open_recording(folder)


def twice(events: Iterable[Event], later_s: float) -> Iterator[Event]:
    """Each image under a stamp of its own once more, from which no reading is reported away."""
    waiting: RgbdFrame | None = None
    for event in events:
        if waiting is not None and waiting.stamp_s <= event.stamp_s:
            yield waiting
            waiting = None
        yield event
        if isinstance(event, RgbdFrame):
            waiting = replace(event, stamp_s=event.stamp_s + later_s)
    if waiting is not None:
        yield waiting


def answers(recording: Recording, events: Iterable[Event], settings: dict[str, Any]) -> dict[float, Estimate]:
    """Those to frames, by their stamps."""
    localizer = Localizer(recording.calibration, load_config(overrides=settings))
    given = ((event, localizer.process(event)) for event in events)
    return {event.stamp_s: answer for event, answer in given if isinstance(event, RgbdFrame) and answer is not None}


@pytest.mark.parametrize("settings", CAMERAS, ids=["features", "dense", "map"])
def test_images_listed_twice_are_tracked_as_if_listed_once(room: Recording, settings: dict[str, Any]) -> None:
    once = answers(room, room.events(), settings)
    both = answers(room, twice(room.events(), 0.01), settings)
    assert len(both) == 2 * len(once) == 12
    for stamp_s, answer in once.items():
        again = both[stamp_s + 0.01]
        assert (again.status, again.reason, again.T_odom_body) == (Status.FAILING, Reason.REPEATED, None)
        assert both[stamp_s].status is answer.status is Status.TRACKING
        np.testing.assert_array_equal(both[stamp_s].T_odom_body, answer.T_odom_body)


def test_beside_wheels_an_image_listed_twice_is_no_look(drive: Recording) -> None:
    settings = {"odometry": "wheels,features"}
    once = answers(drive, drive.events(), settings)
    both = answers(drive, twice(drive.events(), 0.02), settings)
    again = [answer for stamp_s, answer in both.items() if stamp_s not in once]
    repeated = [answer for answer in again if answer.reason is Reason.REPEATED]
    assert len(repeated) >= 15  # but for the halts, in which a camera without noise sees the same anyway
    assert {answer.status for answer in repeated} == {Status.TRACKING}
    for stamp_s, answer in once.items():
        assert both[stamp_s].status is answer.status
        assert answer.T_odom_body is not None
        np.testing.assert_allclose(not_none(both[stamp_s].T_odom_body), answer.T_odom_body, atol=1e-3)


def test_by_the_papers_filter_an_image_listed_twice_changes_nothing(drive: Recording) -> None:
    settings = {"odometry": "wheels,features", "fusion": "ligocki"}
    given = list(drive.events())
    moving = [event for event in given if 1.0 < event.stamp_s - given[0].stamp_s < 2.6]  # at a halt no image is new
    once, both = answers(drive, moving, settings), answers(drive, twice(moving, 0.02), settings)
    assert len(once) > 10
    assert {answer.reason for stamp_s, answer in both.items() if stamp_s not in once} == {Reason.REPEATED}
    for stamp_s, answer in once.items():
        assert both[stamp_s].status is answer.status
        assert answer.T_odom_body is not None
        np.testing.assert_array_equal(both[stamp_s].T_odom_body, answer.T_odom_body)


def test_a_mount_is_found_by_images_listed_twice_as_by_images_listed_once(drive: Recording) -> None:
    assert drive.calibration.wheels is not None
    given = MemoryRecording(list(twice(drive.events(), 0.02)), calibration=drive.calibration)
    once, both = watch(drive, drive.calibration.wheels), watch(given, drive.calibration.wheels)
    np.testing.assert_array_equal(both.camera.stamps_s, once.camera.stamps_s)
    np.testing.assert_array_equal(both.camera.T_frame_body, once.camera.T_frame_body)
    assert both.frame_count == once.frame_count == len(once.camera) < given.frame_count / 2 + 1


@pytest.mark.parametrize("settings", CAMERAS, ids=["features", "dense", "map"])
def test_of_a_camera_that_hangs_no_pose_is_reported_and_soon_that_it_hangs(
    room: Recording, settings: dict[str, Any]
) -> None:
    localizer = Localizer(room.calibration, load_config(overrides=settings))
    first = next(event for event in room.events() if isinstance(event, RgbdFrame))
    reported = []
    for number in range(45):
        answer = localizer.process(replace(first, stamp_s=first.stamp_s + number / 30))
        assert answer is not None
        reported.append((answer.status, answer.reason, localizer.note))
    assert reported[0] == (Status.TRACKING, None, "")
    assert set(reported[1:31]) == {(Status.FAILING, Reason.REPEATED, "the same image as before")}
    assert {reason for _, reason, _ in reported[32:]} == {Reason.FRAME_UNUSABLE}
    assert {note for *_, note in reported[32:]} == {"the camera hangs: the same image for over 1 s"}
    assert reported[-1][0] is Status.LOST


IMAGE, DEPTH = np.zeros((240, 320, 3), np.uint8), np.zeros((240, 320), np.float32)


@pytest.mark.parametrize(
    ("event", "why"),
    [
        (None, "^None is no event"),
        ((0.0, IMAGE, DEPTH), "tuple is no event"),
        ("stop", "str is no event"),
        (RgbdFrame(None, IMAGE, DEPTH), "stamp_s of RgbdFrame is None, not a number"),  # type: ignore[arg-type]
        (RgbdFrame("0.1", IMAGE, DEPTH), "stamp_s of RgbdFrame is a str"),  # type: ignore[arg-type]
        (RgbdFrame(0.0, None, DEPTH), "color is None, not an array"),  # type: ignore[arg-type]
        (RgbdFrame(0.0, IMAGE[..., 0], DEPTH), r"color is of shape \(240, 320\), not \(240, 320, 3\)"),
        (RgbdFrame(0.0, IMAGE / 255, DEPTH), "color is of float64, not uint8"),  # type: ignore[arg-type]
        (RgbdFrame(0.0, IMAGE, DEPTH.astype(np.uint16)), "depth_m is of uint16, not float32"),
        (RgbdFrame(0.0, IMAGE[:120], DEPTH), r"color is of shape \(120, 320, 3\), not \(240, 320, 3\)"),
        (RgbdFrame(0.0, IMAGE, DEPTH[:, :160]), r"depth_m is of shape \(240, 160\), not \(240, 320\)"),
        (WheelTicks(0.0, None, 1), "left of WheelTicks is None"),  # type: ignore[arg-type]
        (WheelSpeeds(0.0, 0.1, "2"), "right_rad_s of WheelSpeeds is a str"),  # type: ignore[arg-type]
        (YawRate(0.0, np.zeros(3)), "yaw_rate_rad_s of YawRate is a ndarray"),  # type: ignore[arg-type]
        (SkippedFrame(True, "no"), "stamp_s of SkippedFrame is a bool"),
    ],
)
def test_what_is_no_event_is_refused_by_name_and_changes_nothing(room: Recording, event: Any, why: str) -> None:
    localizer = Localizer(room.calibration)
    with pytest.raises(ArgumentError, match=why):
        localizer.process(event)
    first = next(event for event in room.events() if isinstance(event, RgbdFrame))
    answer = localizer.process(first)
    assert answer is not None
    assert answer.status is Status.TRACKING
