"""The recorder: what it is given is on the disk in order; a slow or full disk is reported, and holds no one up."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from hand_fed_camera import CALIBRATION, live_frame
from narrowing import not_none

from wheelsight.core.calibration import Calibration, save_calibration
from wheelsight.core.errors import OutputError
from wheelsight.core.messages import AngularVelocity, RgbdFrame, WheelTicks, YawRate
from wheelsight.core.settings import RecorderSettings
from wheelsight.io.devices.recorder import LiveRecorder
from wheelsight.io.recordings import RecordingWriter, open_recording
from wheelsight.io.recordings.images import write_color
from wheelsight.io.recordings.native import FrameClock, read_frame_clocks

BEGIN_S = 1_700_000_000.0


def wait(is_so: Callable[[], bool]) -> None:
    ends_s = time.monotonic() + 60
    while not is_so():
        assert time.monotonic() < ends_s, "it did not come"
        time.sleep(0.005)


def frames_in(folder: Path) -> list[RgbdFrame]:
    return [event for event in open_recording(folder).events() if isinstance(event, RgbdFrame)]


def test_frames_and_readings_are_read_again_with_how_sure_their_stamps_are(tmp_path: Path) -> None:
    with LiveRecorder(RecordingWriter(tmp_path / "r", CALIBRATION)) as recorder:
        for number in range(8):
            recorder.add_reading(WheelTicks(BEGIN_S + number / 30, 5 * number, 6 * number))
            recorder.add_reading(YawRate(BEGIN_S + number / 30, 0.25))
            recorder.add_frame(live_frame(number, BEGIN_S + number / 30, infrared=True, sigma_s=0.001 * (number + 1)))
        wait(lambda: recorder.report().frames == 8)
        report = recorder.report()
    assert (report.readings, report.dropped, report.refused, report.problem, report.waiting) == (16, 0, 0, None, 0)
    recording = open_recording(tmp_path / "r")
    assert (recording.frame_count, recording.wheel_count) == (8, 8)
    for number, frame in enumerate(frames_in(tmp_path / "r")):
        assert frame.stamp_s == BEGIN_S + number / 30
        assert frame.depth_late_s == pytest.approx(0.004, abs=1e-6)
        assert (frame.color == number).all()
        np.testing.assert_allclose(frame.depth_m, 1 + number / 100, atol=1e-4)
    assert read_frame_clocks(tmp_path / "r") == tuple(
        FrameClock(BEGIN_S + n / 30, 0.001 * (n + 1), BEGIN_S + n / 30 + 0.02, 100 + n / 30, n) for n in range(8)
    )
    infrared = [line.split()[1] for line in (tmp_path / "r" / "infrared.txt").read_text().splitlines()[2:]]
    found = [not_none(cv2.imread(str(tmp_path / "r" / name), cv2.IMREAD_UNCHANGED)) for name in infrared]
    assert [(image.dtype.name, int(image.min()), int(image.max())) for image in found] == [
        ("uint16", 300 + number, 300 + number) for number in range(8)
    ]
    assert report.size_bytes == sum(path.stat().st_size for path in (tmp_path / "r").glob("*/*.png"))


def test_what_the_camera_does_not_know_of_a_stamp_is_left_empty(tmp_path: Path) -> None:
    with RecordingWriter(tmp_path / "r", CALIBRATION) as writer:
        frame = live_frame(0, BEGIN_S).frame
        writer.check(frame)
        writer.list_frame(writer.write_frame(frame), FrameClock(BEGIN_S, 0.02, BEGIN_S + 0.05))
    assert read_frame_clocks(tmp_path / "r") == (FrameClock(BEGIN_S, 0.02, BEGIN_S + 0.05, None, None),)


def test_jpeg_keeps_colour_nearly_and_depth_as_before(tmp_path: Path) -> None:
    with LiveRecorder(RecordingWriter(tmp_path / "r", CALIBRATION, color="jpeg")) as recorder:
        recorder.add_frame(live_frame(77, BEGIN_S))
    (frame,) = frames_in(tmp_path / "r")
    assert [path.suffix for path in (tmp_path / "r" / "rgb").iterdir()] == [".jpg"]
    assert np.abs(frame.color.astype(int) - 77).max() <= 2
    np.testing.assert_allclose(frame.depth_m, 1.77, atol=1e-4)


class SlowDisk:
    """Images wait until the disk goes on."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.goes_on = threading.Event()

        def slowly(*given: object) -> int:
            assert self.goes_on.wait(60)
            return write_color(*given)  # type: ignore[arg-type]

        monkeypatch.setattr("wheelsight.io.recordings.native.write_color", slowly)


def test_a_slow_disk_drops_frames_counts_them_and_holds_no_one_up(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    disk = SlowDisk(monkeypatch)
    settings = RecorderSettings(most_waiting=5, longest_wait_s=30)
    with LiveRecorder(RecordingWriter(tmp_path / "r", CALIBRATION), settings) as recorder:
        for number in range(12):
            recorder.add_frame(live_frame(number, BEGIN_S + number / 30))
            recorder.add_reading(WheelTicks(BEGIN_S + number / 30, number, number))
        report = recorder.report()
        assert (report.waiting, report.dropped, report.readings, report.frames) == (5, 7, 12, 0)
        disk.goes_on.set()
    assert [frame.color[0, 0, 0] for frame in frames_in(tmp_path / "r")] == [0, 1, 2, 3, 4]


def test_no_frame_waits_longer_than_is_lost_when_the_program_is_killed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    disk = SlowDisk(monkeypatch)
    settings = RecorderSettings(longest_wait_s=0.05)
    with LiveRecorder(RecordingWriter(tmp_path / "r", CALIBRATION), settings) as recorder:
        recorder.add_frame(live_frame(0, BEGIN_S))
        time.sleep(0.06)
        recorder.add_frame(live_frame(1, BEGIN_S + 1))
        assert recorder.report().dropped == 1
        disk.goes_on.set()
        wait(lambda: recorder.report().waiting == 0)
        recorder.add_frame(live_frame(2, BEGIN_S + 2))
    assert [frame.color[0, 0, 0] for frame in frames_in(tmp_path / "r")] == [0, 2]


def test_a_full_disk_ends_the_writing_and_leaves_what_was_written(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with LiveRecorder(RecordingWriter(tmp_path / "r", CALIBRATION)) as recorder:
        recorder.add_frame(live_frame(0, BEGIN_S))
        wait(lambda: recorder.report().frames == 1)

        def full(*_: object) -> int:
            raise OutputError("no space left on the disk")

        monkeypatch.setattr("wheelsight.io.recordings.native.write_units", full)
        for number in range(1, 6):
            recorder.add_frame(live_frame(number, BEGIN_S + number))
        wait(lambda: recorder.report().problem is not None)
        recorder.add_reading(WheelTicks(BEGIN_S + 9, 1, 1))
        report = recorder.report()
    assert "no space left on the disk" in str(report.problem)
    assert (report.frames, report.readings, report.waiting) == (1, 0, 0)
    assert len(frames_in(tmp_path / "r")) == 1


def test_a_fault_that_no_one_thought_of_is_reported_too(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def broken(*_: object) -> int:
        raise MemoryError("no memory")

    monkeypatch.setattr("wheelsight.io.recordings.native.write_units", broken)
    with LiveRecorder(RecordingWriter(tmp_path / "r", CALIBRATION)) as recorder:
        recorder.add_frame(live_frame(0, BEGIN_S))
        wait(lambda: recorder.report().problem is not None)
    assert "images cannot be written: no memory" in str(recorder.report().problem)


def test_what_could_not_be_read_again_is_refused_and_the_rest_goes_on(tmp_path: Path) -> None:
    with LiveRecorder(RecordingWriter(tmp_path / "r", CALIBRATION)) as recorder:
        for stamp_s in (0.0, 1.0, 0.5, 1.0, 2.0):
            recorder.add_frame(live_frame(int(2 * stamp_s), BEGIN_S + stamp_s))
        wait(lambda: recorder.report().waiting == 0)
        report = recorder.report()
    assert (report.frames, report.refused) == (3, 2)
    assert "does not come after" in report.refusal
    assert [frame.stamp_s - BEGIN_S for frame in frames_in(tmp_path / "r")] == [0, 1, 2]


MOUNT = np.array([[0.0, 0, 1, 0.2], [-1, 0, 0, 0], [0, -1, 0, 1.2], [0, 0, 0, 1]])


def turns(begin: int, count: int = 4) -> list[AngularVelocity]:
    return [AngularVelocity(BEGIN_S + n / 200, 0.01, -0.5 - n / 10, 0.02) for n in range(begin, begin + count)]


def test_the_cameras_gyroscope_is_kept_and_read_once_it_is_known_how_the_camera_sits(tmp_path: Path) -> None:
    folder = tmp_path / "r"
    with LiveRecorder(RecordingWriter(folder, CALIBRATION)) as recorder:
        for turn in turns(0):
            recorder.add_reading(turn)
        recorder.add_frame(live_frame(0, BEGIN_S))
        wait(lambda: recorder.report().frames == 1)
        assert (recorder.report().turns, recorder.report().readings) == (4, 0)
    recording = open_recording(folder)
    assert not any(isinstance(event, YawRate) for event in recording.events())
    assert any("4 readings in imu.csv are not used: T_base_camera" in warning for warning in recording.warnings)
    with LiveRecorder(RecordingWriter(folder, CALIBRATION, resume=True)) as recorder:
        for turn in turns(3):  # the first was there before
            recorder.add_reading(turn)
        assert (recorder.report().turns, recorder.report().refused) == (3, 1)
    save_calibration(replace(CALIBRATION, T_base_camera=MOUNT), folder / "calibration.yaml")
    rates = [event for event in open_recording(folder).events() if isinstance(event, YawRate)]
    assert [rate.stamp_s for rate in rates] == [BEGIN_S + n / 200 for n in range(7)]
    assert [rate.yaw_rate_rad_s for rate in rates] == pytest.approx([0.5 + n / 10 for n in range(7)])
    RecordingWriter(folder, Calibration(), force=True).close()
    assert not (folder / "imu.csv").exists()
