"""A URDF gives mounts, wheels and footprint, whatever its frames; hostile ones are refused in one line."""

from __future__ import annotations

import struct
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from typer.testing import CliRunner

from wheelsight.app.cli import app
from wheelsight.core.calibration import Calibration, load_calibration
from wheelsight.core.calibration_parts import Wheels
from wheelsight.core.errors import CalibrationError, ConfigError
from wheelsight.core.geometry import so3
from wheelsight_ros2.urdf import robot_of_urdf, urdf_of

# The base is behind the axle and above the floor; the camera hangs on a tilted mast.
TURTLE = """<?xml version="1.0"?>
<robot name="turtle">
  <link name="base_footprint"/>
  <link name="base_link">
    <collision><origin xyz="0.05 0 0.1"/><geometry><box size="0.5 0.4 0.2"/></geometry></collision>
  </link>
  <joint name="base_joint" type="fixed">
    <parent link="base_footprint"/><child link="base_link"/><origin xyz="0 0 0.03"/>
  </joint>
  <link name="wheel_left_link">
    <visual><origin rpy="1.5707963267948966 0 0"/><geometry><cylinder radius="0.07" length="0.03"/></geometry></visual>
  </link>
  <joint name="wheel_left_joint" type="continuous">
    <parent link="base_link"/><child link="wheel_left_link"/><origin xyz="0.1 0.16 0.04"/><axis xyz="0 1 0"/>
  </joint>
  <link name="wheel_right_link">
    <visual><geometry><sphere radius="0.07"/></geometry></visual>
  </link>
  <joint name="wheel_right_joint" type="continuous">
    <parent link="base_link"/><child link="wheel_right_link"/><origin xyz="0.1 -0.16 0.04"/><axis xyz="0 -2 0"/>
  </joint>
  <link name="caster_wheel"><visual><geometry><sphere radius="0.02"/></geometry></visual></link>
  <joint name="caster_wheel_joint" type="continuous">
    <parent link="base_link"/><child link="caster_wheel"/><origin xyz="-0.15 0.05 0"/><axis xyz="0 1 0"/>
  </joint>
  <link name="camera_link"/>
  <joint name="camera_joint" type="fixed">
    <parent link="base_link"/><child link="camera_link"/><origin xyz="0.2 0.02 0.5" rpy="0 0.3 0"/>
  </joint>
  <link name="camera_depth_optical_frame"/>
  <joint name="optical" type="fixed">
    <parent link="camera_link"/><child link="camera_depth_optical_frame"/>
    <origin rpy="-1.5707963267948966 0 -1.5707963267948966"/>
  </joint>
</robot>
"""
ENTITIES = '<!ENTITY a "ha"><!ENTITY b "&a;&a;&a;&a;"><!ENTITY c "&b;&b;&b;&b;">'
DIVERGENT = f'<!DOCTYPE r [{ENTITIES}]><robot name="r">&c;</robot>'


def written(folder: Path, text: str) -> Path:
    path = folder / "robot.urdf"
    path.write_text(text)
    return path


def test_the_frame_is_on_the_ground_between_the_wheels(tmp_path: Path) -> None:
    robot = robot_of_urdf(written(tmp_path, TURTLE))
    assert robot.radii_m == pytest.approx((0.07, 0.07))
    assert robot.track_m == pytest.approx(0.32)
    assert robot.wheels == ("wheel_left_joint", "wheel_right_joint")
    assert robot.camera == "camera_depth_optical_frame"
    # The axle is 0.1 m before base_link; base_link is 0.03 m above the frame, and its wheels touch at 0.0 m.
    assert robot.T_base_camera is not None
    assert robot.T_base_camera[:3, 3] == pytest.approx((0.1, 0.02, 0.53), abs=1e-12)
    forward = robot.T_base_camera[:3, :3] @ (0, 0, 1)
    assert forward == pytest.approx((np.cos(0.3), 0, -np.sin(0.3)))
    assert robot.T_base_camera[:3, :3] @ (1, 0, 0) == pytest.approx((0, -1, 0))  # the image's right
    assert robot.outline == pytest.approx((0.2, 0.3, 0.4))


def test_four_wheels_are_two_sides(tmp_path: Path) -> None:
    front = TURTLE.replace("</robot>", "")
    for side, y in (("left", 0.16), ("right", -0.16)):
        front += f"""<link name="front_{side}_wheel">
        <visual><geometry><sphere radius="0.07"/></geometry></visual></link>
        <joint name="front_{side}" type="continuous"><parent link="base_link"/><child link="front_{side}_wheel"/>
        <origin xyz="0.5 {y} 0.04"/><axis xyz="0 1 0"/></joint>"""
    robot = robot_of_urdf(written(tmp_path, front + "</robot>"))
    assert len(robot.wheels) == 4
    assert robot.track_m == pytest.approx(0.32)
    assert robot.T_base_camera is not None
    assert robot.T_base_camera[0, 3] == pytest.approx(0.2 - 0.3)


def test_a_wheel_has_the_radius_of_its_meshs_box(tmp_path: Path) -> None:
    angles = np.linspace(0, 2 * np.pi, 90, endpoint=False)
    ring = np.column_stack([0.09 * np.cos(angles), 0 * angles + 0.02, 0.09 * np.sin(angles)]).astype("<f4")
    triangles = b"".join(struct.pack("<3f", 0, 0, 0) + ring[[i, i - 1, i - 2]].tobytes() + b"\0\0" for i in range(90))
    (tmp_path / "meshes").mkdir()
    (tmp_path / "meshes" / "wheel.stl").write_bytes(bytes(80) + struct.pack("<I", 90) + triangles)
    shape = '<sphere radius="0.07"/>'
    mesh = '<mesh filename="package://turtle/meshes/wheel.stl" scale="1 1 1"/>'
    path = written(tmp_path, TURTLE.replace(shape, mesh))
    with pytest.raises(CalibrationError, match="the wheel wheel_right_link has no radius"):
        robot_of_urdf(path)
    robot = robot_of_urdf(path, packages={"turtle": tmp_path})
    assert robot.radii_m == pytest.approx((0.07, 0.09), abs=1e-4)
    (tmp_path / "meshes" / "wheel.stl").write_bytes(bytes(80) + struct.pack("<I", 91) + triangles)
    with pytest.raises(CalibrationError, match=r"wheel\.stl: has 4,584 bytes for 91 triangles"):
        robot_of_urdf(path, packages={"turtle": tmp_path})


@pytest.mark.parametrize(
    ("text", "problem"),
    [
        (DIVERGENT, "has a document type, which is not read"),
        ('<!DOCTYPE r SYSTEM "file:///etc/hostname"><robot name="r"/>', "has a document type"),
        ("<a>" * 70 + "</a>" * 70, "has more than 64 levels"),
        ("<robot name='r'><link", "robot.urdf:1: is no XML"),
        ("", "is no XML"),
        ("<model/>", "its first element is 'model'"),
        ("<robot name='r'/>", "has 0 links"),
        ("<robot name='r'><xacro:macro name='w'/></robot>", "is a xacro"),
        (
            TURTLE.replace('child link="camera_link"', 'child link="nowhere"'),
            "camera_joint has no child link",
        ),
        (TURTLE.replace('xyz="0.2 0.02 0.5"', 'xyz="0.2 nan 0.5"'), "origin xyz is '0.2 nan 0.5'"),
        (TURTLE.replace('xyz="0.2 0.02 0.5"', 'xyz="200 20 500"'), "m away"),
        (TURTLE.replace('<axis xyz="0 1 0"/>', '<axis xyz="0 0 0"/>'), "the axis of the joint wheel_left_joint is 0"),
        (TURTLE.replace('<parent link="base_footprint"/>', '<parent link="camera_link"/>'), "in a circle"),
        (TURTLE.replace('<child link="camera_link"/>', '<child link="base_link"/>'), "has two parents"),
    ],
)
def test_what_is_no_robot_is_refused_in_a_line(tmp_path: Path, text: str, problem: str) -> None:
    with pytest.raises(CalibrationError) as refused:
        robot_of_urdf(written(tmp_path, text))
    assert problem in str(refused.value)
    assert "robot.urdf" in str(refused.value)
    assert "\n" not in str(refused.value)


def test_a_link_that_is_not_there_is_said(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="--camera-link eye"):
        robot_of_urdf(written(tmp_path, TURTLE), camera="eye")


sizes = st.floats(0.02, 1.0)
angles = st.floats(-np.pi, np.pi)


turns = st.tuples(angles, st.floats(-np.pi / 2, np.pi / 2), angles)


@given(left_m=sizes, right_m=sizes, track_m=st.floats(0.1, 2.0), rpy=turns, body=st.tuples(sizes, sizes))
def test_a_calibration_comes_back(
    left_m: float,
    right_m: float,
    track_m: float,
    rpy: tuple[float, float, float],
    body: tuple[float, float],
    tmp_path_factory: pytest.TempPathFactory,
) -> None:
    T = np.eye(4)
    about_z, about_y, about_x = (so3.exp(np.eye(3)[axis] * rpy[axis]) for axis in (2, 1, 0))
    T[:3, :3] = about_z @ about_y @ about_x
    T[:3, 3] = 0.3, -0.1, 1.1
    known = Calibration(T_base_camera=T, wheels=Wheels(left_m, right_m, track_m, 1000.0))
    path = tmp_path_factory.mktemp("urdf") / "robot.urdf"
    path.write_text(urdf_of(known, "robot", (*body, track_m)))
    robot = robot_of_urdf(path)
    assert robot.radii_m == pytest.approx((left_m, right_m), rel=1e-12)
    assert robot.track_m == pytest.approx(track_m, rel=1e-12)
    assert robot.T_base_camera is not None
    np.testing.assert_allclose(robot.T_base_camera, T, atol=1e-9)
    assert robot.outline is not None
    assert robot.outline[:2] == pytest.approx([max(end_m, left_m, right_m) for end_m in body], rel=1e-9)
    assert robot.warnings == ()


def test_the_command_makes_and_updates_a_calibration(tmp_path: Path) -> None:
    path, out = written(tmp_path, TURTLE), tmp_path / "robot.yaml"
    old = tmp_path / "old.yaml"
    old.write_text("format: wheelsight-calibration-1\nwheels: {ticks_per_turn: 2048, track_width_m: 9.0}\n")
    done = CliRunner().invoke(app, ["urdf", str(path), "--calibration", str(old), "--out", str(out)])
    assert done.exit_code == 0, done.output
    assert "track 0.3200 m" in done.output
    assert "footprint: {front_m: 0.200, back_m: 0.300, width_m: 0.400}" in done.output
    found = load_calibration(out)
    assert found.wheels is not None
    assert found.wheels.ticks_per_turn == 2048
    assert found.wheels.track_width_m == pytest.approx(0.32)
    again = CliRunner().invoke(app, ["urdf", str(path), "--out", str(out)])
    assert again.exit_code == 2, "it is there"
    back = CliRunner().invoke(app, ["urdf", str(out), "--out", str(tmp_path / "back.urdf")])
    assert back.exit_code == 0, back.output
    robot = robot_of_urdf(tmp_path / "back.urdf")
    assert found.T_base_camera is not None
    assert robot.T_base_camera is not None
    np.testing.assert_allclose(robot.T_base_camera, found.T_base_camera, atol=1e-9)
    for asked in (["--out", "x.txt"], ["--package", "a", "--out", str(tmp_path / "new.yaml")]):
        assert CliRunner().invoke(app, ["urdf", str(path), *asked]).exit_code == 2
