from __future__ import annotations

import errno
import itertools
import os
import signal
import subprocess
import sys
import textwrap
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from full_disk import FullDisk
from narrowing import as_frame, not_none, of_type
from synthetic import make_tum_recording, render_room, wobbling_trajectory

from wheelsight.core.calibration import Calibration
from wheelsight.core.errors import ArgumentError, CalibrationError, OutputError, RecordingError
from wheelsight.core.geometry import PinholeCamera, se3
from wheelsight.core.messages import Event, RgbdFrame, SkippedFrame, WheelTicks
from wheelsight.core.trajectory import Trajectory, read_tum
from wheelsight.io.recordings import RecordingWriter, open_recording, write_recording
from wheelsight.io.recordings.image_recording import ImageRecording
from wheelsight.io.recordings.recording import OpenOptions
from wheelsight.io.recordings.tables import GrowingText
from wheelsight.io.recordings.tum_datasets import TumReader

T_BASE_CAMERA = np.array([[0, 0, 1, 0.2], [-1, 0, 0, 0], [0, -1, 0, 1.1], [0, 0, 0, 1.0]])
TRUTH = wobbling_trajectory(6, start_s=1305031229.123456)


@pytest.fixture
def calibration(small_camera):
    return Calibration.registered_camera(small_camera, T_base_camera=T_BASE_CAMERA, source="test")


@pytest.fixture
def events(small_camera):
    """Six frames with two wheel readings before each."""
    result: list[Event] = []
    for index, (stamp_s, T_map_camera) in enumerate(TRUTH):
        for delay_s in (0.02, 0.01):
            ticks = WheelTicks(stamp_s - delay_s, 100 * index - int(1000 * delay_s), -7 * index)
            result.append(ticks)
        result.append(RgbdFrame(stamp_s, *render_room(T_map_camera, small_camera), index))
    return result


def write(folder, calibration, events, truth=None):
    with RecordingWriter(folder, calibration) as writer:
        if truth is not None:
            writer.add_ground_truth(truth)
        for event in events:
            writer.add(event)
    return writer


def check_alike(read, written):
    for got, wanted in zip(read, written, strict=True):
        assert type(got) is type(wanted)
        if isinstance(wanted, WheelTicks):
            assert got == wanted
        else:
            assert (got.stamp_s, got.index) == (wanted.stamp_s, wanted.index)
            np.testing.assert_array_equal(got.color, wanted.color)
            np.testing.assert_allclose(got.depth_m, wanted.depth_m, atol=0.5001 / 5000)


def test_what_was_written_is_read_again(tmp_path, calibration, events):
    writer = write(tmp_path / "new", calibration, events, TRUTH)
    assert (writer.frames, writer.readings, writer.depths_too_far) == (6, 12, 0)
    recording = open_recording(tmp_path / "new")
    assert (recording.format, recording.body, recording.frame_count) == ("wheelsight", "base", 6)
    assert recording.warnings == ()
    check_alike(list(recording.events()), events)
    T_frame_base = TRUTH.T_frame_body @ se3.invert(T_BASE_CAMERA)
    np.testing.assert_allclose(not_none(recording.ground_truth).T_frame_body, T_frame_base, atol=1e-8)


def test_any_tum_tool_can_read_it(tmp_path, calibration, events):
    write(tmp_path / "new", calibration, events, TRUTH)
    as_tum = TumReader().open(tmp_path / "new", OpenOptions())
    check_alike(list(as_tum.events()), [event for event in events if isinstance(event, RgbdFrame)])
    camera = read_tum(tmp_path / "new" / "groundtruth.txt")
    assert camera.body == "camera"
    np.testing.assert_allclose(camera.T_frame_body, TRUTH.T_frame_body, atol=1e-8)
    assert "# frames: T_map_camera" in (tmp_path / "new" / "groundtruth.txt").read_text()


def test_truth_of_the_base_is_kept_and_reported_for_the_camera(tmp_path, calibration, events):
    base = Trajectory(TRUTH.stamps_s, TRUTH.T_frame_body @ se3.invert(T_BASE_CAMERA), body="base")
    write(tmp_path / "new", calibration, events, base)
    recording = open_recording(tmp_path / "new")
    np.testing.assert_allclose(not_none(recording.ground_truth).T_frame_body, base.T_frame_body, atol=1e-8)
    camera = read_tum(tmp_path / "new" / "groundtruth.txt")
    np.testing.assert_allclose(camera.T_frame_body, TRUTH.T_frame_body, atol=1e-8)


def test_a_camera_without_a_robot(tmp_path, calibration, events):
    calibration = replace(calibration, T_base_camera=None)
    frames = [event for event in events if isinstance(event, RgbdFrame)]
    write(tmp_path / "new", calibration, frames, TRUTH)
    recording = open_recording(tmp_path / "new")
    assert (recording.format, recording.body) == ("wheelsight", "camera")
    assert not_none(recording.ground_truth).body == "camera"
    check_alike(list(recording.events()), frames)
    with pytest.raises(CalibrationError, match="T_base_camera"):
        write(tmp_path / "other", calibration, [], Trajectory(np.array([0.0]), np.eye(4)[None], body="base"))


def test_images_that_are_not_registered_keep_their_sizes(tmp_path, small_camera):
    color = PinholeCamera(80, 60, 70.0, 70.0, 40.0, 30.0)
    T_color_depth = se3.exp([0.03, 0, 0, 0, 0.01, 0])
    calibration = Calibration(color, small_camera, T_color_depth)
    frame = RgbdFrame(
        1.5, render_room(TRUTH.T_frame_body[0], color)[0], render_room(TRUTH.T_frame_body[0], small_camera)[1]
    )
    write(tmp_path / "new", calibration, [frame])
    recording = open_recording(tmp_path / "new")
    np.testing.assert_array_equal(recording.calibration.T_color_depth, T_color_depth)
    check_alike(list(recording.events()), [frame])


def test_depth_beyond_sixteen_bits_becomes_not_measured_and_is_counted(tmp_path, calibration, small_camera):
    depth_m = np.full((48, 64), 2.0, np.float32)
    depth_m[0, :4] = [13.106, 13.2, 80.0, 65.535]
    depth_m[1, :3] = 0.0
    writer = write(tmp_path / "new", calibration, [RgbdFrame(1.0, np.zeros((48, 64, 3), np.uint8), depth_m)])
    assert writer.depths_too_far == 3
    read = as_frame(next(open_recording(tmp_path / "new").events())).depth_m
    np.testing.assert_allclose(read[0, :4], [13.106, 0, 0, 0], atol=1e-4)
    np.testing.assert_array_equal(read[1, :3], 0)


@pytest.mark.parametrize("after", [1, 5, 12])
def test_an_exception_leaves_a_valid_shorter_recording(tmp_path, calibration, events, after):
    def broken_off():
        yield from itertools.islice(events, 3 * after if after < 6 else None)
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        write(tmp_path / "new", calibration, broken_off(), TRUTH)
    check_alike(list(open_recording(tmp_path / "new").events()), events[: 3 * after])


def test_a_killed_process_leaves_a_valid_shorter_recording(tmp_path):
    program = textwrap.dedent("""
        import itertools, sys
        from pathlib import Path
        import numpy as np
        from wheelsight.core.calibration import Calibration
        from wheelsight.core.messages import RgbdFrame, WheelTicks
        from wheelsight.core.geometry import PinholeCamera
        from wheelsight.io.recordings import RecordingWriter
        camera = PinholeCamera(64, 48, 50, 50, 32, 24)
        writer = RecordingWriter(Path(sys.argv[1]), Calibration.registered_camera(camera))
        for i in itertools.count():
            writer.add(WheelTicks(i / 30, i, i))
            writer.add(RgbdFrame(i / 30, np.full((48, 64, 3), i % 256, np.uint8), np.full((48, 64), 2, np.float32)))
            print(i, flush=True)
    """)
    with subprocess.Popen([sys.executable, "-c", program, str(tmp_path / "new")], stdout=subprocess.PIPE) as process:
        for _ in range(7):
            assert not_none(process.stdout).readline()
        os.kill(process.pid, signal.SIGKILL)
    recording = open_recording(tmp_path / "new")
    frames = [event for event in recording.events() if not isinstance(event, WheelTicks)]
    assert len(frames) >= 7
    assert all(isinstance(frame, RgbdFrame) for frame in frames)
    assert len(of_type(ImageRecording, recording).wheels) >= len(frames)


def test_writes_into_a_used_folder_only_when_forced(tmp_path, calibration, events):
    write(tmp_path / "new", calibration, events, TRUTH)
    with pytest.raises(OutputError, match="--force"):
        RecordingWriter(tmp_path / "new", calibration)
    with RecordingWriter(tmp_path / "new", calibration, force=True) as writer:
        writer.add(events[2])
    recording = open_recording(tmp_path / "new")
    assert (recording.frame_count, recording.ground_truth, recording.wheel_count) == (1, None, 0)


def test_refuses_stamps_that_do_not_grow_and_images_of_another_size(tmp_path, calibration, events):
    with RecordingWriter(tmp_path / "new", calibration) as writer:
        writer.add(events[5])
        with pytest.raises(RecordingError, match="does not come after"):
            writer.add(events[2])
        with pytest.raises(ArgumentError, match=r"stamp_s of RgbdFrame is nan"):
            writer.add(replace(events[2], stamp_s=np.nan))
        with pytest.raises(ArgumentError, match=r"color is of shape \(48, 32, 3\), not \(48, 64, 3\)"):
            writer.add(replace(events[8], color=events[8].color[:, :32]))
        writer.add(events[11])
    assert open_recording(tmp_path / "new").frame_count == 2


def test_a_full_disk_is_one_clear_error(tmp_path, calibration, events, monkeypatch):
    writer = RecordingWriter(tmp_path / "new", calibration)
    writer.add(events[2])

    def full(*_):
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(os, "fsync", full)
    with pytest.raises(OutputError, match="no space left on the disk"):
        writer.add(events[5])
    monkeypatch.undo()
    writer.close()
    check_alike(list(open_recording(tmp_path / "new").events()), [events[2]])


def test_any_recording_can_be_written_as_our_own(tmp_path, small_camera):
    make_tum_recording(tmp_path / "old", frames=4, camera=small_camera, covered=[2])
    old = open_recording(tmp_path / "old")
    writer = write_recording(tmp_path / "new", old)
    assert writer.frames == 3
    new = open_recording(tmp_path / "new")
    usable = [event for event in old.events() if not isinstance(event, SkippedFrame)]
    for got, wanted in zip(new.events(), usable, strict=True):
        np.testing.assert_array_equal(as_frame(got).depth_m, as_frame(wanted).depth_m)
        np.testing.assert_array_equal(as_frame(got).color, as_frame(wanted).color)
    np.testing.assert_allclose(
        not_none(new.ground_truth).T_frame_body, not_none(old.ground_truth).T_frame_body, atol=1e-8
    )


@pytest.mark.parametrize(
    ("text", "problem"),
    [
        (
            "stamp,l,r\n",
            "wheels.csv:1: has no column stamp_s .the first line must name the columns stamp_s, left, right",
        ),
        ("", "wheels.csv:1: has no column stamp_s"),
        ("stamp_s,left,right\n1.0,2\n", "wheels.csv:2: 2 values where 3 are expected"),
        ("stamp_s,left,right\n1.0,2,3\n2.0,2.5,3\n", "wheels.csv:3: left is '2.5', not a whole number"),
        ("stamp_s,left,right\nnan,2,3\n", "wheels.csv:2: 'nan' is not a stamp"),
        ("stamp_s,left,right\n2.0,2,3\n3.0,2,3\n1.0,2,3\n", "wheels.csv:4: stamp"),
    ],
)
def test_bad_wheel_readings_are_named(tmp_path, calibration, events, text, problem):
    write(tmp_path / "new", calibration, events)
    (tmp_path / "new" / "wheels.csv").write_text(text)
    with pytest.raises(RecordingError, match=problem):
        open_recording(tmp_path / "new")


def test_a_reading_cut_off_in_its_digits_is_left_out(tmp_path, calibration, events):
    write(tmp_path / "new", calibration, events)
    path = tmp_path / "new" / "wheels.csv"
    path.write_text(path.read_text()[:-1])
    recording = open_recording(tmp_path / "new")
    assert len(of_type(ImageRecording, recording).wheels) == 11
    assert recording.warnings == ("wheels.csv:13: the last line is cut off and was left out",)


def test_wheels_without_calibration_say_what_is_missing(tmp_path, calibration, events):
    write(tmp_path / "new", calibration, events)
    (tmp_path / "new" / "calibration.yaml").unlink()
    with pytest.raises(CalibrationError, match=r"calibration.yaml: is missing \(say which with --camera"):
        open_recording(tmp_path / "new")


def test_cannot_write_below_a_file(tmp_path, calibration):
    (tmp_path / "file").write_text("")
    with pytest.raises(OutputError):
        RecordingWriter(Path(tmp_path / "file"), calibration)


def test_truth_and_labels_may_come_as_they_become_known(tmp_path, calibration, events):
    base = Trajectory(TRUTH.stamps_s, TRUTH.T_frame_body @ se3.invert(T_BASE_CAMERA), body="base")
    with RecordingWriter(tmp_path / "new", calibration) as writer:
        for index, event in enumerate(event for event in events if isinstance(event, RgbdFrame)):
            for truth in (TRUTH, base):
                writer.append_ground_truth(truth.select([index]))
            writer.add_label(event.stamp_s, [None, "hall"][index % 2])
            writer.add(event)
    write(tmp_path / "at_once", calibration, events, base)
    for name in ("groundtruth.txt", "groundtruth_base.txt"):
        assert (tmp_path / "new" / name).read_text() == (tmp_path / "at_once" / name).read_text()
    lines = (tmp_path / "new" / "labels.csv").read_text().splitlines()
    assert lines[:3] == ["stamp_s,area", "1305031229.123456,", f"{TRUTH.stamps_s[1]},hall"]
    assert len(lines) == 7


def test_truth_and_labels_refuse_what_no_reader_would_take(tmp_path, calibration):
    with RecordingWriter(tmp_path / "new", calibration) as writer:
        writer.append_ground_truth(TRUTH.select(slice(2, 4)))
        with pytest.raises(RecordingError, match="does not come after"):
            writer.append_ground_truth(TRUTH.select([3]))
        with pytest.raises(RecordingError, match="truth of 'head' has no place"):
            writer.append_ground_truth(Trajectory(np.array([5.0]), np.eye(4)[None], body="head"))
        writer.add_label(1.0, "hall")
        with pytest.raises(RecordingError, match="does not come after"):
            writer.add_label(1.0, "hall")
        with pytest.raises(RecordingError, match="cannot be called 'a,b'"):
            writer.add_label(2.0, "a,b")
    assert len(read_tum(tmp_path / "new" / "groundtruth.txt")) == 2


def test_a_disk_that_fills_up_within_a_line_keeps_whole_lines(tmp_path, monkeypatch):
    disk = FullDisk("list.txt", room=len("header\none\na lo"))
    disk.take_over(monkeypatch)
    text = GrowingText(tmp_path / "list.txt", "header\n")
    text.append("one\n")
    with pytest.raises(OutputError, match=r"list.txt: no space left on the disk"):
        text.append("a longer line\n")
    disk.room = 1000
    assert (tmp_path / "list.txt").read_text() == "header\none\n"
    text.append("two\n")
    text.close()
    assert (tmp_path / "list.txt").read_text() == "header\none\ntwo\n"
