"""Recordings of wheels: what each reader makes of its files, and what it refuses."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
from narrowing import not_none

from wheelsight.core.calibration import Calibration, save_calibration
from wheelsight.core.calibration_parts import Wheels
from wheelsight.core.errors import CalibrationError, InputError, RecordingError
from wheelsight.core.messages import WheelSpeeds, WheelTicks, YawRate
from wheelsight.core.trajectory import Trajectory
from wheelsight.io.recordings import OpenOptions, RecordingWriter, open_recording, write_recording
from wheelsight.io.recordings.recording import left_out_of

OWN = Calibration(wheels=Wheels(0.17, 0.17, 0.52, 3200.0), source="our robot")


def make(folder: Path, **files: str) -> Path:
    folder.mkdir(exist_ok=True)
    for name, text in files.items():
        (folder / name.replace("__", ".")).write_text(text)
    return folder


ENCODERS = "stamp_s,front_right,front_left,rear_right,rear_left\n1.0,0,0,0,0\n1.1,5,3,7,2\n1.2,-1,4,0,6\n"
IMU = "stamp_s,wx_radps,wy_radps,wz_radps,ax_g,ay_g,az_g\n1.05,9,9,0.25,0,0,1\n1.15,9,9,-0.5,0,0,1\n"
REFERENCE = "# by another\n1.0 0 0 0 0 0 0 1\n1.1 0.1 0 0 0 0 0 1\n1.2 0.2 0 0 0 0 0 1\n"


@pytest.fixture
def skid(tmp_path: Path) -> Path:
    return make(tmp_path / "skid", encoders__csv=ENCODERS, imu__csv=IMU, reference__txt=REFERENCE)


def test_ticks_that_start_again_are_summed_up_side_by_side(skid: Path) -> None:
    recording = open_recording(skid)
    assert (recording.format, recording.body, recording.frame_count, recording.wheel_count) == (
        "skid_steer",
        "base",
        0,
        3,
    )
    assert list(recording.events()) == [
        WheelTicks(1.0, 0, 0),
        YawRate(1.05, 0.25),
        WheelTicks(1.1, 5, 12),
        YawRate(1.15, -0.5),
        WheelTicks(1.2, 15, 11),
    ]
    wheels = recording.calibration.wheels
    assert wheels is not None
    assert wheels.left_m_per_tick == pytest.approx(math.pi * 0.254 / 360 / 2)
    assert recording.ground_truth is not None
    assert recording.ground_truth.body == "base"
    assert any("another system's estimate" in warning for warning in recording.warnings)


def test_columns_may_come_in_any_order_and_the_reference_may_be_absent(tmp_path: Path) -> None:
    encoders = "rear_left,front_left,stamp_s,front_right,rear_right\n1,2,1.0,3,4\n"
    recording = open_recording(make(tmp_path / "skid", encoders__csv=encoders, imu__csv=IMU))
    assert recording.ground_truth is None
    assert WheelTicks(1.0, 3, 7) in list(recording.events())


def test_a_row_out_of_order_keeps_its_ticks(tmp_path: Path) -> None:
    rows = [f"{i / 10:.1f},1,1,1,1" for i in range(200)]
    rows[50] = "4.9,1,1,1,1"
    text = "stamp_s,front_right,front_left,rear_right,rear_left\n" + "\n".join(rows) + "\n"
    recording = open_recording(make(tmp_path / "skid", encoders__csv=text, imu__csv=IMU))
    ticks = [event for event in recording.events() if isinstance(event, WheelTicks)]
    assert (len(ticks), ticks[-1].left) == (199, 400)
    assert any("encoders.csv:52: stamp 4.900000 repeats" in warning for warning in recording.warnings)


SPEEDS = "stamp_s,v_mps,w_radps\n0.0,0.5,0.2\n0.1,-0.1,0.0\n"
POSES = "stamp_s,x_m,y_m,yaw_rad,valid\n0.0,1.0,2.0,0.5,1\n0.1,9.0,9.0,9.0,0\n0.2,1.1,2.0,0.6,1\n"


def test_speeds_of_a_robot_come_as_those_of_its_wheels(tmp_path: Path) -> None:
    recording = open_recording(make(tmp_path / "mocap", odometry__csv=SPEEDS, ground_truth__csv=POSES))
    wheels = recording.calibration.wheels
    assert wheels is not None
    first, second = recording.events()
    assert isinstance(first, WheelSpeeds)
    assert isinstance(second, WheelSpeeds)
    left, right = first.left_rad_s * wheels.left_radius_m, first.right_rad_s * wheels.right_radius_m
    assert ((left + right) / 2, (right - left) / wheels.track_width_m) == pytest.approx((0.5, 0.2))
    assert second.left_rad_s * wheels.left_radius_m == pytest.approx(-0.1)
    truth = recording.ground_truth
    assert truth is not None
    np.testing.assert_array_equal(truth.stamps_s, [0.0, 0.2])
    np.testing.assert_allclose(truth.positions_m, [[1.0, 2, 0], [1.1, 2, 0]])


def test_a_robot_whose_wheels_are_calibrated_drives_by_them(tmp_path: Path) -> None:
    folder = make(tmp_path / "mocap", odometry__csv=SPEEDS, ground_truth__csv=POSES)
    save_calibration(OWN, tmp_path / "own.yaml")
    recording = open_recording(folder, OpenOptions(calibration=str(tmp_path / "own.yaml")))
    assert recording.calibration.wheels == OWN.wheels
    assert list(recording.events()) == list(open_recording(folder).events())


LINES = "odom2 0.0 0.5 0.01 0.2 0.1 0.1 0.1   \nodom2 0.1 0.4 0 0 0.1 0.1 0.1\nloop 0.1 0.0 0.9\n"
TRUTH = "point2 0.0 1 2 0 0 0 0\npoint2 0.1 1.1 2 0 0 0 0\nangle 0.0 0.5 0\nangle 0.1 0.6 0\n"


def test_measurement_lines(tmp_path: Path) -> None:
    recording = open_recording(make(tmp_path / "lines", Hall_Input__txt=LINES, Hall_GT__txt=TRUTH))
    assert (recording.format, recording.wheel_count) == ("measurement_lines", 2)
    truth = recording.ground_truth
    assert truth is not None
    np.testing.assert_allclose(truth.positions_m, [[1.0, 2, 0], [1.1, 2, 0]])
    np.testing.assert_allclose(np.arctan2(truth.T_frame_body[:, 1, 0], truth.T_frame_body[:, 0, 0]), [0.5, 0.6])
    assert recording.warnings == ("Speeds across, up to 0.01 m/s, are left out: two wheels cannot measure them.",)


def test_points_without_angles_are_no_poses(tmp_path: Path) -> None:
    some = TRUTH.replace("angle 0.1 0.6 0\n", "")
    recording = open_recording(make(tmp_path / "a", Hall_Input__txt=LINES, Hall_GT__txt=some))
    assert recording.ground_truth is not None
    assert len(recording.ground_truth) == 1
    assert any("1 lines point2 have no angle" in warning for warning in recording.warnings)
    assert left_out_of(recording.warnings) == {"Hall_GT.txt: lines point2 have no angle": (1, 2)}
    lone = TRUTH.replace("point2 0.1 1.1 2 0 0 0 0\n", "")
    recording = open_recording(make(tmp_path / "c", Hall_Input__txt=LINES, Hall_GT__txt=lone))
    assert left_out_of(recording.warnings) == {"Hall_GT.txt: lines angle have no point2": (1, 2)}
    none = "point2 0.0 1 2 0 0 0 0\n"
    recording = open_recording(make(tmp_path / "b", Hall_Input__txt=LINES, Hall_GT__txt=none))
    assert recording.ground_truth is None
    assert any("no true poses" in warning for warning in recording.warnings)
    assert left_out_of(recording.warnings) == {"Hall_GT.txt: lines point2 have no angle": (1, 1)}


@pytest.mark.parametrize(
    ("files", "problem"),
    [
        (
            {"encoders.csv": "a,b\n1,2\n", "imu.csv": IMU},
            r"encoders\.csv:1: has no column stamp_s \(the first line must",
        ),
        ({"encoders.csv": "", "imu.csv": IMU}, r"encoders\.csv:1: has no column"),
        ({"encoders.csv": ENCODERS + "1.3,1,1,1\n", "imu.csv": IMU}, r"encoders\.csv:5: 4 values where 5 are expected"),
        (
            {"encoders.csv": ENCODERS + "1.3,1,1,1,x\n", "imu.csv": IMU},
            r"encoders\.csv:5: rear_left is 'x', not a whole",
        ),
        ({"encoders.csv": ENCODERS + "1.3,1,1,1.5,1\n", "imu.csv": IMU}, r"encoders\.csv:5: rear_right is '1\.5'"),
        ({"encoders.csv": ENCODERS + "now,1,1,1,1\n", "imu.csv": IMU}, r"encoders\.csv:5: 'now' is not a stamp"),
        ({"encoders.csv": ENCODERS + "1.1,1,1,1,1\n", "imu.csv": IMU}, r"encoders\.csv:5: stamp 1\.100000 repeats"),
        ({"encoders.csv": ENCODERS, "imu.csv": IMU + "1.2,1,1,nan,1,1,1\n"}, r"imu\.csv:4: wz_radps is 'nan'"),
        ({"encoders.csv": ENCODERS, "imu.csv": "\0\xff"}, r"imu\.csv"),
        ({"odometry.csv": SPEEDS + "0.2,inf,0\n", "ground_truth.csv": POSES}, r"odometry\.csv:4: v_mps is 'inf'"),
        ({"odometry.csv": SPEEDS, "ground_truth.csv": "stamp_s,x_m\n"}, r"ground_truth\.csv:1: has no column y_m"),
        ({"A_Input.txt": "odom2 0.0 1\n", "A_GT.txt": TRUTH}, r"A_Input\.txt:1: odom2 has 2 numbers, not 7"),
        ({"A_Input.txt": LINES + "lidar 1 2\n", "A_GT.txt": TRUTH}, r"A_Input\.txt:4: unknown measurement 'lidar'"),
        ({"A_Input.txt": "loop 0 1 0.5\n", "A_GT.txt": TRUTH}, r"A_Input\.txt: holds no line odom2"),
        ({"A_Input.txt": LINES, "A_GT.txt": "angle 0 x 0\n"}, r"A_GT\.txt:1: could not convert"),
        ({"A_Input.txt": LINES, "A_GT.txt": "angle 0 nan 0\n"}, r"A_GT\.txt:1: a value is not finite"),
        ({"A_Input.txt": LINES, "B_Input.txt": LINES, "A_GT.txt": TRUTH}, r"holds 2 files \*_Input\.txt"),
        (
            {"wheels.csv": "stamp_s,left,right\n0,0,0\n"},
            r"calibration\.yaml: is missing \(say how large the wheels are",
        ),
    ],
)
def test_bad_files_are_named_with_line_and_problem(tmp_path: Path, files: dict[str, str], problem: str) -> None:
    for name, text in files.items():
        (tmp_path / name).write_text(text)
    with pytest.raises(InputError, match=problem) as caught:
        open_recording(tmp_path)
    assert "\n" not in str(caught.value)


def test_a_last_row_that_was_cut_off_is_left_out(skid: Path) -> None:
    with (skid / "encoders.csv").open("a") as stream:
        stream.write("1.3,1,1,1,1")
    recording = open_recording(skid)
    assert recording.wheel_count == 3
    assert "encoders.csv:5: the last line is cut off and was left out" in recording.warnings


def test_wheels_alone_are_written_and_read_again(skid: Path, tmp_path: Path) -> None:
    first = open_recording(skid)
    write_recording(tmp_path / "copy", first)
    assert {path.name for path in (tmp_path / "copy").iterdir()} == {
        "calibration.yaml",
        "groundtruth_base.txt",
        "gyro.csv",
        "wheels.csv",
    }
    copy = open_recording(tmp_path / "copy")
    assert (copy.format, copy.body, copy.wheel_count) == ("wheelsight", "base", 3)
    assert list(copy.events()) == list(first.events())
    assert copy.calibration.wheels == first.calibration.wheels
    assert isinstance(copy.ground_truth, Trajectory)
    np.testing.assert_allclose(copy.ground_truth.T_frame_body, not_none(first.ground_truth).T_frame_body)


def test_a_file_of_wheels_alone_takes_the_calibration_that_is_given(tmp_path: Path) -> None:
    folder = make(tmp_path / "bare", wheels__csv="stamp_s,left,right\n0,0,0\n0.02,1,2\n")
    save_calibration(OWN, tmp_path / "own.yaml")
    recording = open_recording(folder, OpenOptions(calibration=str(tmp_path / "own.yaml")))
    assert recording.calibration.source == "our robot"
    assert list(recording.events()) == [WheelTicks(0.0, 0, 0), WheelTicks(0.02, 1, 2)]
    with pytest.raises(CalibrationError, match="cannot be read"):
        open_recording(folder, OpenOptions(calibration=str(tmp_path / "none.yaml")))


def test_speeds_have_no_place_in_our_own_layout(tmp_path: Path) -> None:
    with RecordingWriter(tmp_path / "new", OWN) as writer, pytest.raises(RecordingError, match="holds ticks"):
        writer.add(WheelSpeeds(0.0, 1.0, 1.0))


@pytest.mark.data
@pytest.mark.parametrize(
    ("name", "form", "readings", "truth_m"),
    [
        ("skid_steer_run20", "skid_steer", 4956, 89.5),
        ("mocap_floor", "velocities", 6000, 170.8),
        ("corridor_864m", "measurement_lines", 22692, 864.4),
    ],
)
def test_real_recordings_of_wheels(data_folder: Path, name: str, form: str, readings: int, truth_m: float) -> None:
    recording = open_recording(data_folder / "wheels" / name)
    assert (recording.format, recording.wheel_count) == (form, readings)
    stamps = [event.stamp_s for event in recording.events()]
    assert (np.diff(stamps) >= 0).all()
    assert recording.ground_truth is not None
    assert recording.ground_truth.length_m == pytest.approx(truth_m, abs=0.1)
