"""Wheels from odometry and from joints, and the gyroscope's axis."""

from __future__ import annotations

import math

import numpy as np
import pytest
from narrowing import not_none
from written_bags import START_S, Drive, Messages, camera_drive, circle, odometry_drive

from wheelsight.core.calibration import Calibration, save_calibration
from wheelsight.core.calibration_parts import Wheels
from wheelsight.core.errors import CalibrationError, ConfigError, RecordingError
from wheelsight.core.messages import WheelSpeeds, YawRate
from wheelsight.io.recordings.bags.wheel_readings import Joints, joint_speeds, wheel_joints
from wheelsight.wheels import WheelOdometry

LEFT, RIGHT = "left_wheel_joint", "right_wheel_joint"
OWN = Wheels(0.1, 0.1, 0.4, 1000.0)


def end_of(recording) -> tuple[float, float, float]:
    """x, y, yaw where our own integration of a recording's wheels ends."""
    odometry = WheelOdometry(not_none(recording.calibration.wheels))
    estimates = [odometry.process(event) for event in recording.events() if isinstance(event, WheelSpeeds)]
    T = not_none(estimates[-1].T_odom_body)
    return float(T[0, 3]), float(T[1, 3]), math.atan2(T[1, 0], T[0, 0])


@pytest.mark.parametrize("is_ros1", [True, False])
def test_increments_of_odometry_lead_where_its_poses_do(opened, is_ros1: bool) -> None:
    recording = opened(odometry_drive(is_ros1))
    assert (recording.frame_count, recording.wheel_count, recording.body) == (0, 60, "base")
    events = list(recording.events())
    assert len(events) == 60
    assert events[0].stamp_s == START_S
    assert end_of(recording) == pytest.approx(circle(2.95), abs=1e-6)
    assert any("no truth" in warning for warning in recording.warnings)


def test_a_message_that_was_dropped_loses_nothing(opened) -> None:
    drive = odometry_drive()
    drive.messages = [item for number, item in enumerate(drive.messages) if number % 7 != 2]
    # Half a second is what the library bridges; here 0.1 s.
    assert end_of(opened(drive)) == pytest.approx(circle(2.95), abs=1e-5)


def test_a_driver_that_shows_only_speeds(opened) -> None:
    drive = Drive()
    for at_s in np.arange(0, 3, 0.05).tolist():
        drive.add(at_s, "/odom", drive.make.odometry(at_s, (0, 0, 0), (0.5, 0.3)))
    recording = opened(drive)
    assert any("its poses stay at zero" in warning for warning in recording.warnings)
    assert end_of(recording) == pytest.approx(circle(2.95), abs=1e-6)


def test_its_covariance_is_what_it_states_of_its_errors(opened) -> None:
    stated = opened(odometry_drive()).speed_variances
    np.testing.assert_allclose(stated.variances, [[1e-3, 1e-3, 0.03]])


def test_the_wheels_own_odometry_is_preferred_to_a_filters(opened) -> None:
    drive = odometry_drive()
    drive.messages = [(at_s, topic, m) for at_s, name, m in drive.messages for topic in (name, "/odometry/filtered")]
    recording = opened(drive)
    assert {topic.name for topic in recording.topics if topic.used_as == "wheels"} == {"/odom"}
    assert any("/odometry/filtered" in warning for warning in recording.warnings)
    chosen = opened(drive, topics=("wheels=/odometry/filtered",))
    assert {topic.name for topic in chosen.topics if topic.used_as == "wheels"} == {"/odometry/filtered"}


def joint_drive(names=(LEFT, RIGHT), **how) -> Drive:
    """Wheels of 0.1 m, 0.4 m apart, on the circle; an arm's joint takes turns with them."""
    drive = Drive()
    left, right = ((0.5 + side * 0.3 * 0.2) / 0.1 for side in (-1, 1))
    for at_s in np.arange(0, 3, 0.05).tolist():
        angles = [left * at_s, right * at_s] * (len(names) // 2)
        angles = [math.remainder(a, 2 * math.pi) for a in angles] if how.get("wrapped") else angles
        speeds = [left, right] * (len(names) // 2)
        of = ([], speeds) if how.get("by_speed") else (angles, speeds)
        drive.add(at_s, "/joint_states", drive.make.joints(at_s, names, *of))
        drive.add(at_s + 0.01, "/joint_states", drive.make.joints(at_s + 0.01, ["elbow"], [0.3]))
    return drive


@pytest.fixture
def own_wheels(tmp_path_factory) -> str:
    path = tmp_path_factory.mktemp("robot") / "wheels.yaml"
    save_calibration(Calibration(wheels=OWN), path)
    return str(path)


FOUR = ("fl_wheel", "fr_wheel", "rl_wheel", "rr_wheel")


@pytest.mark.parametrize("how", [{}, {"wrapped": True}, {"by_speed": True}, {"names": FOUR}])
def test_joints_of_wheels(opened, own_wheels: str, how) -> None:
    recording = opened(joint_drive(**how), calibration=own_wheels)
    assert end_of(recording) == pytest.approx(circle(2.95), abs=1e-5)
    assert recording.calibration.wheels.track_width_m == 0.4


def test_joints_need_the_wheels_sizes(opened) -> None:
    with pytest.raises(CalibrationError, match="how far wheels turn, but not how large they are"):
        opened(joint_drive())


def test_joints_of_other_names_can_be_chosen(opened, own_wheels: str) -> None:
    drive = joint_drive(("motor_a", "motor_b"))
    with pytest.raises(RecordingError, match="no two joints of /joint_states are called a left and a right wheel"):
        opened(drive, calibration=own_wheels, topics=("wheels=/joint_states",))
    recording = opened(drive, calibration=own_wheels, topics=("wheels=/joint_states:motor_a,motor_b",))
    assert end_of(recording) == pytest.approx(circle(2.95), abs=1e-5)


@pytest.mark.parametrize(
    ("names", "left", "right"),
    [
        ((LEFT, RIGHT, "elbow"), (LEFT,), (RIGHT,)),
        (("wheel_left_joint", "wheel_right_joint"), ("wheel_left_joint",), ("wheel_right_joint",)),
        (("drivewhl_l_joint", "drivewhl_r_joint"), ("drivewhl_l_joint",), ("drivewhl_r_joint",)),
        (("left_caster_wheel", "right_caster_wheel", LEFT, RIGHT), (LEFT,), (RIGHT,)),
        (
            ("front_left_wheel", "front_right_wheel", "rear_left_wheel", "rear_right_wheel"),
            ("front_left_wheel", "rear_left_wheel"),
            ("front_right_wheel", "rear_right_wheel"),
        ),
    ],
)
def test_wheels_are_known_by_their_names(names, left, right) -> None:
    assert wheel_joints(names) == Joints(left, right)


def test_joints_that_are_no_wheels() -> None:
    assert wheel_joints(("shoulder_joint", "elbow_joint")) is None
    assert wheel_joints((LEFT,)) is None
    assert wheel_joints(("left_arm_joint", "right_arm_joint")) is None


def test_a_wheel_that_turned_past_one_turn_does_not_wrap() -> None:
    speeds = joint_speeds(Joints((LEFT,), (RIGHT,)))
    make = Messages(is_ros1=False)
    assert speeds.add(0.0, make.joints(0.0, [LEFT, RIGHT], [8.0, 8.0])) is None
    found = not_none(speeds.add(1.0, make.joints(1.0, [LEFT, RIGHT], [12.0, 12.0])))
    assert (found.left_rad_s, found.right_rad_s) == (4.0, 4.0)


UP_IS_Y = ((0, 0.3, 0), (0, 9.81, 0))


def with_imu(rate, acceleration, frame: str = "imu_link", drive: Drive | None = None) -> Drive:
    drive = drive or odometry_drive()
    for at_s in np.arange(0, 3, 0.02).tolist():
        drive.add(at_s + 0.004, "/imu", drive.make.imu(at_s, frame, rate, acceleration))
    return drive


def rates(recording) -> np.ndarray:
    return np.array([event.yaw_rate_rad_s for event in recording.events() if isinstance(event, YawRate)])


@pytest.mark.parametrize(
    ("rate", "acceleration"),
    [((9, 9, 0.3), (0, 0, 0)), UP_IS_Y, ((0, 0, -0.3), (0, 0, -9.81))],
    ids=["no acceleration", "on its side", "upside down"],
)
def test_up_is_where_gravity_says(opened, rate, acceleration) -> None:
    recording = opened(with_imu(rate, acceleration))
    np.testing.assert_allclose(rates(recording), 0.3)
    assert len(rates(recording)) == 150
    assert any(warning.startswith("/imu") for warning in recording.warnings)


def test_the_mount_of_tf_shows_which_way_is_up(opened) -> None:
    drive = with_imu(*UP_IS_Y)
    on_its_side = (math.sin(math.pi / 4), 0, 0, math.cos(math.pi / 4))
    drive.add(0.0, "/tf_static", drive.make.tf(("base_link", "imu_link", (0, 0, 0), on_its_side)))
    recording = opened(drive)
    np.testing.assert_allclose(rates(recording), 0.3)
    assert not any(warning.startswith("/imu") for warning in recording.warnings)


def test_an_acceleration_of_no_sensor_is_no_gravity(opened) -> None:
    recording = opened(with_imu((0, 0, 0.3), (1e200, 0, 9.81)))
    assert not any("up is where gravity says" in warning for warning in recording.warnings)


def test_gravity_is_believed_rather_than_tf(opened) -> None:
    drive = with_imu(*UP_IS_Y)
    drive.add(0.0, "/tf_static", drive.make.tf(("base_link", "imu_link", (0, 0, 0), (0, 0, 0, 1))))
    recording = opened(drive)
    np.testing.assert_allclose(rates(recording), 0.3)
    assert any("disagree by 90°" in warning for warning in recording.warnings)


def test_camera_wheels_and_gyroscope_come_in_order_of_time(opened) -> None:
    drive = with_imu((0, 0, 0.3), (0, 0, 9.81), "base_link", camera_drive(late_s=0.2))
    drive.messages += odometry_drive().messages
    recording = opened(drive)
    events = list(recording.events())
    stamps_s = [event.stamp_s for event in events]
    assert stamps_s == sorted(stamps_s)
    assert {type(event).__name__ for event in events} == {"RgbdFrame", "WheelSpeeds", "YawRate"}
    assert len(events) == 6 + 60 + 150
    assert recording.calibration.wheels is not None
    assert recording.calibration.T_base_camera is not None
    without = list(recording.events(images=False))
    assert len(without) == 60 + 150
    no_gyro = list(opened(drive, topics=("gyro=none", "color=none")).events())
    assert {type(event).__name__ for event in no_gyro} == {"WheelSpeeds"}


@pytest.mark.parametrize(
    ("text", "problem"),
    [
        ("wheels", "ROLE=TOPIC is expected"),
        ("legs=/odom", "with one of color, depth"),
        ("wheels=/nowhere", "has no messages of it"),
        ("color=/odom", "is of nav_msgs/msg/Odometry"),
        ("wheels=/odom:left", "joints of a left and a right side"),
        ("gyro=/odom:left,right", "joints of a left and a right side"),
    ],
)
def test_a_choice_that_is_none(opened, text: str, problem: str) -> None:
    with pytest.raises(ConfigError, match=problem):
        opened(odometry_drive(), topics=(text,))
