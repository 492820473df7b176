"""A camera and wheels as they are just now, as a source of events."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from hand_fed_camera import CALIBRATION, HandFedCamera, live_frame

from wheelsight.app.run import Choice, InRealTime, LiveSensors, LiveSource, default_odometry
from wheelsight.app.run.kernels import DrawnDrive
from wheelsight.config import Config
from wheelsight.core.calibration import Calibration
from wheelsight.core.calibration_parts import Wheels
from wheelsight.core.errors import ConfigError
from wheelsight.core.messages import AngularVelocity, Event, RgbdFrame, WheelTicks, YawRate
from wheelsight.io.devices import WheelLink, host_clock
from wheelsight.io.devices.live_camera import CameraStatus
from wheelsight.io.devices.recorder import LiveRecorder
from wheelsight.io.devices.simulated_controller import SimulatedController
from wheelsight.io.recordings import Recording, RecordingWriter, open_recording

WHEELS = Wheels(0.17, 0.17, 0.52, 3200.0, counter_bits=16)
MOUNT = np.array([[0.0, 0, 1, 0.2], [-1, 0, 0, 0], [0, -1, 0, 1.2], [0, 0, 0, 1]])
ROBOT = replace(CALIBRATION, wheels=WHEELS, T_base_camera=MOUNT)
Until = Callable[[], bool]


def followed(source: LiveSource, count: int, on_event: Callable[[Event], None] = lambda event: None) -> list[Event]:
    """So many events."""
    found: list[Event] = []
    events = source.events()
    ends_s = time.monotonic() + 60
    for event in events:
        assert time.monotonic() < ends_s
        found.append(event)
        on_event(event)
        if len(found) == count:
            break
    events.close()
    return found


def stops_after(count: int) -> Callable[[], AbstractContextManager[Until]]:
    """Over at the so manieth look."""

    @contextmanager
    def until() -> Iterator[Until]:
        looks = iter(range(count))
        yield lambda: next(looks, None) is None

    return until


def test_of_frames_that_came_meanwhile_only_the_newest_is_answered() -> None:
    camera = HandFedCamera()
    now_s = host_clock.now_s()

    def begin() -> None:
        for number in (2, 3, 4):
            camera.put(live_frame(number, now_s + number / 30))

    source = LiveSource(LiveSensors(CALIBRATION, camera), on_begin=begin)
    events = source.events()
    camera.put(live_frame(0, now_s))  # of before it began
    camera.put(live_frame(1, now_s))
    first = next(events)
    camera.put(live_frame(5, now_s + 0.2))
    second = next(events)
    assert isinstance(first, RgbdFrame)
    assert isinstance(second, RgbdFrame)
    assert (first.index, second.index) == (4, 5)
    camera.tell(device_drops=3, host_drops=1)
    assert source.frames_so_far == (8, 6)
    events.close()
    report = source.report()
    assert (report.frames, report.dropped, report.unread, report.is_live, report.camera) == (8, 6, 4, True, "fake 1")
    assert report.sentence.startswith("live: ")


def test_readings_come_all_beside_frames_by_one_clock(tmp_path: Path) -> None:
    camera = HandFedCamera()
    with SimulatedController(tmp_path) as controller, WheelLink(str(controller.port)) as link:
        controller.speeds = (6, 5)
        source = LiveSource(LiveSensors(ROBOT, camera, link))

        def see(event: Event) -> None:
            if isinstance(event, WheelTicks):
                camera.put(live_frame(event.left // 6, host_clock.now_s()))

        found = followed(source, 40, see)
        assert not source.is_missing_wheels
    ticks = [event for event in found if isinstance(event, WheelTicks)]
    frames = [event for event in found if isinstance(event, RgbdFrame)]
    assert len(ticks) > 5
    assert len(frames) > 5
    for before, after in pairwise(ticks):
        assert after.stamp_s > before.stamp_s
        assert (after.left - before.left) * 5 == (after.right - before.right) * 6
    assert abs(frames[-1].stamp_s - ticks[-1].stamp_s) < 2
    assert source.report().readings == len(ticks)
    assert source.report().wheels_from == str(controller.port)


def test_it_ends_when_reported_or_with_a_played_recording() -> None:
    camera = HandFedCamera()
    assert list(LiveSource(LiveSensors(CALIBRATION, camera), stops_after(3)).events()) == []
    notes: list[str] = []
    sensors = LiveSensors(CALIBRATION, camera)
    source = LiveSource(sensors, note=notes.append, on_begin=lambda: camera.tell(CameraStatus.ENDED))
    assert list(source.events()) == []
    assert source.warnings[-1] == "No frame came from fake 1: the recording it plays has ended."


def test_a_camera_that_goes_away_is_reported_and_the_wheels_go_on(tmp_path: Path) -> None:
    camera, notes = HandFedCamera(), list[str]()
    with SimulatedController(tmp_path) as controller, WheelLink(str(controller.port)) as link:
        source = LiveSource(LiveSensors(ROBOT, camera, link), note=notes.append)
        found = followed(source, 10, lambda _: camera.tell(CameraStatus.UNPLUGGED))
    assert all(isinstance(event, WheelTicks) for event in found)
    assert notes == ["fake 1: unplugged: waiting for it"]


def test_what_is_heard_is_recorded_frames_that_were_dropped_too(tmp_path: Path) -> None:
    camera = HandFedCamera()
    now_s = host_clock.now_s()

    def begin() -> None:
        for number in range(5):
            camera.put(live_frame(number, now_s + number))

    with LiveRecorder(RecordingWriter(tmp_path / "r", CALIBRATION)) as recorder:
        source = LiveSource(LiveSensors(CALIBRATION, camera, recorder=recorder), on_begin=begin)
        (answered,) = followed(source, 1)
    recorded = [event for event in open_recording(tmp_path / "r").events() if isinstance(event, RgbdFrame)]
    assert isinstance(answered, RgbdFrame)
    assert answered.index == 4
    assert [frame.stamp_s - now_s for frame in recorded] == pytest.approx([0, 1, 2, 3, 4])


def test_the_calibration_shows_what_is_listened_to_alone(tmp_path: Path) -> None:
    camera = HandFedCamera()
    without = LiveSource(LiveSensors(ROBOT, camera))
    assert without.calibration.wheels is None
    assert default_odometry(without, Config()).odometry == ("dense",)
    assert isinstance(without, InRealTime)
    assert not isinstance(without, Recording)
    with SimulatedController(tmp_path) as controller, WheelLink(str(controller.port)) as link:
        both = LiveSource(LiveSensors(ROBOT, camera, link))
        assert default_odometry(both, Config()) == Choice(("wheels", "dense"))
        assert both.calibration.wheels == WHEELS.never_rolling_over
        alone = LiveSource(LiveSensors(ROBOT, None, link))
        assert default_odometry(alone, Config()).odometry == ("wheels",)
        with pytest.raises(ConfigError, match="give no motion without their sizes"):
            LiveSource(LiveSensors(CALIBRATION, camera, link))
    with pytest.raises(ConfigError, match=r"there is no sensor to listen to \(--camera NAME"):
        LiveSource(LiveSensors(ROBOT))
    with pytest.raises(ConfigError, match="fake 1 has no calibration"):
        LiveSource(LiveSensors(Calibration(wheels=WHEELS), camera))


def test_what_is_rehearsed_is_drawn_first_and_then_seen() -> None:
    camera = HandFedCamera()
    for number in range(5):
        camera.put(live_frame(number, host_clock.now_s()))
    drawn, own = LiveSource(LiveSensors(CALIBRATION, camera)).rehearsals()
    assert isinstance(drawn, DrawnDrive)
    kinds = {type(event) for event in drawn.rehearsal()}
    assert kinds == {RgbdFrame}
    assert [event.index for event in own.rehearsal() if isinstance(event, RgbdFrame)] == [0, 1, 2]
    assert {type(event) for event in DrawnDrive(ROBOT).rehearsal()} == {RgbdFrame, WheelTicks, YawRate}
    by_wheels = DrawnDrive(Calibration(wheels=WHEELS))
    assert {type(event) for event in by_wheels.rehearsal()} == {WheelTicks, YawRate}


def test_the_cameras_gyroscope_turns_the_base_by_how_the_camera_sits(tmp_path: Path) -> None:
    """MOUNT looks ahead: the camera's y is down, the base's z up."""
    camera = HandFedCamera(ROBOT)
    camera.turn(AngularVelocity(0.5, 9.0, 9.0, 9.0))  # before it began

    def begin() -> None:
        camera.turn(*(AngularVelocity(1.0 + n / 200, 0.1, -0.4, 0.2) for n in range(3)))
        camera.put(live_frame(0, 1.01))

    with LiveRecorder(RecordingWriter(tmp_path / "kept", ROBOT)) as recorder:
        source = LiveSource(LiveSensors(ROBOT, camera, recorder=recorder), on_begin=begin)
        events = followed(source, 4)
    rates = [event for event in events if isinstance(event, YawRate)]
    assert [rate.stamp_s for rate in rates] == [1.0 + n / 200 for n in range(3)]
    assert [rate.yaw_rate_rad_s for rate in rates] == pytest.approx([0.4] * 3)
    kept = [event for event in open_recording(tmp_path / "kept").events() if isinstance(event, YawRate)]
    assert kept == rates


def test_without_a_mount_the_gyroscope_is_only_recorded(tmp_path: Path) -> None:
    camera = HandFedCamera()

    def begin() -> None:
        camera.turn(AngularVelocity(1.0, 0.1, -0.4, 0.2))
        camera.put(live_frame(0, 1.01))

    with LiveRecorder(RecordingWriter(tmp_path / "kept", CALIBRATION)) as recorder:
        events = followed(LiveSource(LiveSensors(CALIBRATION, camera, recorder=recorder), on_begin=begin), 1)
    assert [type(event) for event in events] == [RgbdFrame]
    assert (tmp_path / "kept" / "imu.csv").read_text().splitlines()[1:] == ["1.000000,0.100000,-0.400000,0.200000"]
