from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from narrowing import as_frame, not_none
from synthetic import make_tum_recording

from wheelsight.core.errors import CalibrationError, RecordingError
from wheelsight.core.geometry import se3
from wheelsight.core.messages import RgbdFrame
from wheelsight.io.recordings import open_recording

SENSORS = """%YAML:1.0
t265_fisheye1_optical_frame:
   fps: 30
d400_color_optical_frame:
   sensor_type: camera
   fps: 30
   width: 64
   height: 48
   intrinsics: !!opencv-matrix
      rows: 1
      cols: 4
      dt: d
      data: [ 5.2e+01, 3.15e+01,
          5.3e+01, 23.5 ]
   distortion_model: radial-tangential
   distortion_coefficients: !!opencv-matrix
      rows: 1
      cols: 4
      dt: f
      data: [ 0., 0., 0., 0. ]
"""
MATRICES = """%YAML:1.0
trans_matrix:
   -
      parent_frame: laser
      child_frame: d400_color_optical_frame
      matrix: !!opencv-matrix
         rows: 4
         cols: 4
         dt: d
         data: [ 0., 0., 1., 3.e-01, -1., 0., 0., 0., 0., -1., 0., 0.4, 0., 0., 0., 1. ]
   -
      parent_frame: laser
      child_frame: base_link
      matrix: !!opencv-matrix
         rows: 4
         cols: 4
         dt: d
         data: [ 1., 0., 0., -0.2, 0., 1., 0., 0., 0., 0., 1., -0.7, 0., 0., 0., 1. ]
"""
T_BASE_CAMERA = np.array([[0, 0, 1, 0.5], [-1, 0, 0, 0], [0, -1, 0, 1.1], [0, 0, 0, 1.0]])


@pytest.fixture
def folder(tmp_path, small_camera):
    truth = make_tum_recording(tmp_path, frames=5, camera=small_camera)
    for old, new in (("rgb", "color"), ("depth", "aligned_depth")):
        (tmp_path / old).rename(tmp_path / new)
        text = (tmp_path / f"{old}.txt").read_text().replace(f"{old}/", f"{new}/")
        (tmp_path / f"{new}.txt").write_text(text)
        (tmp_path / f"{old}.txt").unlink()
    (tmp_path / "calibration.yaml").unlink()
    (tmp_path / "sensors.yaml").write_text(SENSORS)
    (tmp_path / "trans_matrix.yaml").write_text(MATRICES)
    (tmp_path / "groundtruth.txt").write_text("#Time px py pz qx qy qz qw\n99 1 2 0 0 0 0 1\n101 2 2 0 0 0 0 1\n")
    odom = "".join(f"{s:.6f} {i} 0 0 0 0 0 1 0.2 0 0 0 0 0.1\n" for i, s in enumerate(truth.stamps_s))
    (tmp_path / "odom.txt").write_text("#Time px py pz qx qy qz qw vx vy vz wx wy wz\n" + odom)
    return tmp_path


def test_reads_calibration_frames_and_truth_of_the_base(folder):
    recording = open_recording(folder)
    assert (recording.format, recording.body, recording.frame_count) == ("openloris", "base", 5)
    camera = not_none(recording.calibration.color)
    assert (camera.width, camera.height, camera.fx, camera.fy, camera.cx, camera.cy) == (64, 48, 52, 53, 31.5, 23.5)
    np.testing.assert_allclose(not_none(recording.calibration.T_base_camera), T_BASE_CAMERA, atol=1e-12)
    assert not_none(recording.ground_truth).body == "base"
    np.testing.assert_allclose(not_none(recording.ground_truth).positions_m, [[1, 2, 0], [2, 2, 0]])
    assert all(isinstance(event, RgbdFrame) for event in recording.events())


def test_depth_is_in_millimetres(folder):
    frame = next(open_recording(folder).events())
    assert 5 * 1.0 < np.median(as_frame(frame).depth_m) < 5 * 6.0


def test_odometry_of_the_robot_is_said_to_be_no_ticks(folder):
    assert any("no encoder ticks; it is not used" in warning for warning in open_recording(folder).warnings)
    (folder / "odom.txt").unlink()
    assert not any("odom.txt" in warning for warning in open_recording(folder).warnings)


def test_without_the_camera_s_place_truth_of_the_base_is_not_used(folder):
    (folder / "trans_matrix.yaml").unlink()
    recording = open_recording(folder)
    assert (recording.body, recording.ground_truth) == ("camera", None)
    assert any("nothing says where the camera is" in warning for warning in recording.warnings)


def test_the_chain_of_frames_inverts_where_it_must(folder):
    T_camera_laser = se3.invert(np.array([[0, 0, 1, 0.3], [-1, 0, 0, 0], [0, -1, 0, 0.4], [0, 0, 0, 1.0]]))
    numbers = ", ".join(f"{x:.1f}" for x in T_camera_laser.ravel())
    turned = MATRICES.replace(
        "parent_frame: laser\n      child_frame: d400_color_optical_frame",
        "parent_frame: d400_color_optical_frame\n      child_frame: laser",
    ).replace("0., 0., 1., 3.e-01, -1., 0., 0., 0., 0., -1., 0., 0.4, 0., 0., 0., 1.", numbers)
    (folder / "trans_matrix.yaml").write_text(turned)
    np.testing.assert_allclose(not_none(open_recording(folder).calibration.T_base_camera), T_BASE_CAMERA, atol=1e-12)


@pytest.mark.parametrize(
    ("name", "old", "new", "problem"),
    [
        ("sensors.yaml", "d400_color_optical_frame", "other_camera", "does not describe d400_color_optical_frame"),
        ("sensors.yaml", ", 3.15e+01,", ",", "3 numbers where 4 are expected"),
        ("sensors.yaml", "width: 64", "width: wide", "does not describe"),
        ("sensors.yaml", "width: 64", "width: [", "is not YAML"),
        ("sensors.yaml", "5.2e+01", "-5.2e+01", "must be positive"),
        ("trans_matrix.yaml", "child_frame: base_link", "child_frame: base", "no chain of frames leads from base_link"),
        ("trans_matrix.yaml", "data:", "date:", "is not a list of parent_frame"),
        ("trans_matrix.yaml", "3.e-01", ".inf", "from d400_color_optical_frame to laser is no rigid motion"),
        ("trans_matrix.yaml", "3.e-01", ".nan", "is no rigid motion"),
        ("trans_matrix.yaml", "3.e-01", "1.e+100", "beyond every number"),
        ("trans_matrix.yaml", "3.e-01", "1" + "0" * 100, "beyond every number"),
        ("trans_matrix.yaml", "3.e-01", "1.e+6", "is no rigid motion"),
        ("trans_matrix.yaml", "[ 1., 0., 0., -0.2", "[ 0., 0., 0., -0.2", "from base_link to laser is no rigid motion"),
        ("trans_matrix.yaml", "0., 1., -0.7, 0., 0., 0., 1.", "0., 1., -0.7, 0., 0., 0., 0.", "is no rigid motion"),
        ("trans_matrix.yaml", "[ 1., 0., 0., -0.2", "[ 0.5, 0., 0., -0.2", "is no rigid motion"),
        ("sensors.yaml", "width: 64", "width: .inf", "does not describe"),
        ("sensors.yaml", "width: 64", "width: !!int ''", "is no int"),
        ("sensors.yaml", "width: 64", "width: 2024-05-02", "does not describe"),
    ],
)
def test_wrong_calibration_files_are_named(folder, name, old, new, problem):
    (folder / name).write_text((folder / name).read_text().replace(old, new))
    with pytest.raises(CalibrationError, match=rf"{name}(:\d+)?: .*{problem}.* \(.*\)$"):
        open_recording(folder)


def test_a_long_chain_of_frames_in_any_order_is_followed(folder):
    """So long that looking for the next link again and again would take minutes."""
    link = "   - {{parent_frame: {0}, child_frame: {1}, matrix: {{data: [1,0,0,1e-3, 0,1,0,0, 0,0,1,0, 0,0,0,1]}}}}\n"
    names = ["base_link", *(f"f{i}" for i in range(2000)), "d400_color_optical_frame"]
    links = [link.format(parent, child) for parent, child in pairwise(names)]
    (folder / "trans_matrix.yaml").write_text("trans_matrix:\n" + "".join(reversed(links)))
    T_base_camera = not_none(open_recording(folder).calibration.T_base_camera)
    np.testing.assert_allclose(T_base_camera[:3, 3], [2.001, 0, 0], atol=1e-9)


@pytest.mark.parametrize(
    ("name", "line", "where"),
    [
        ("color.txt", "noon a\n", "color.txt:7"),
    ],
)
def test_bad_lines_are_named(folder, name, line, where):
    with (folder / name).open("a") as stream:
        stream.write(line)
    with pytest.raises(RecordingError, match=where):
        open_recording(folder)


@pytest.mark.parametrize("name", ["color.txt", "aligned_depth.txt"])
def test_a_missing_list_is_named(folder, name):
    (folder / name).unlink()
    with pytest.raises(RecordingError, match=f"{name}: is missing"):
        open_recording(folder)
