"""Wheels by counts, speeds, fields and tf; which is preferred; sideways motion; and truth."""

from __future__ import annotations

import math
import sqlite3
from collections.abc import Callable
from contextlib import closing
from pathlib import Path

import numpy as np
import pytest
from narrowing import not_none
from written_bags import LOOKS_AHEAD, OPTICAL, Drive, camera_drive, circle, odometry_drive, write_bag

from wheelsight.app.run import Tone, run_each, verdict_of_run
from wheelsight.config import Config
from wheelsight.core.calibration import Calibration, save_calibration
from wheelsight.core.calibration_parts import HolonomicWheels, Wheels
from wheelsight.core.errors import CalibrationError, ConfigError, RecordingError
from wheelsight.core.geometry import se2
from wheelsight.core.messages import OdometryReading, WheelCounts, WheelSpeeds, WheelTicks, YawRate
from wheelsight.evaluation import evaluate
from wheelsight.io.recordings import OpenOptions, open_recording
from wheelsight.wheels import HolonomicOdometry, WheelOdometry

OWN = Wheels(0.1, 0.1, 0.4, 1000.0)
V, W = 0.5, 0.3
STAMPS_S = np.arange(0, 3, 0.05).tolist()
# A wheel's speed on the circle, rad/s, and its counts a second.
SPEEDS = tuple((V + side * W * 0.2) / 0.1 for side in (-1, 1))
RATES = tuple(speed * 1000 / (2 * math.pi) for speed in SPEEDS)


def end_of(recording) -> tuple[float, float, float]:
    """x, y, yaw where our own integration of a recording's wheels ends."""
    odometry = WheelOdometry(not_none(recording.calibration.wheels))
    readings = [event for event in recording.events() if isinstance(event, WheelSpeeds | WheelTicks)]
    T = not_none([odometry.process(event) for event in readings][-1].T_odom_body)
    return float(T[0, 3]), float(T[1, 3]), math.atan2(T[1, 0], T[0, 0])


def wheels_of(recording) -> set[str]:
    return {topic.name for topic in recording.topics if topic.used_as == "wheels"}


@pytest.fixture
def own_wheels(tmp_path_factory) -> str:
    path = tmp_path_factory.mktemp("robot") / "wheels.yaml"
    save_calibration(Calibration(wheels=OWN), path)
    return str(path)


def apart(names: tuple[str, str] = ("/lwheel", "/rwheel"), bits: int = 16) -> Drive:
    """Counts that begin near the end of what 16 bits hold; the right wheel is reported 5 ms later."""
    drive, first = Drive(), 32_700
    for at_s in STAMPS_S:
        for name, rate, late_s in zip(names, RATES, (0, 0.005), strict=True):
            count = round(first + rate * (at_s + late_s))
            drive.add(at_s + late_s, name, drive.make.counts(bits, (count + (1 << 15)) % (1 << 16) - (1 << 15)))
    return drive


def in_array(places: tuple[int, int] = (2, 3)) -> Drive:
    drive = Drive()
    for at_s in STAMPS_S:
        numbers = [0, 0, 0, 0]
        for place, rate in zip(places, RATES, strict=True):
            numbers[place] = round(rate * at_s)
        drive.add(at_s, "/robot/encoder_status", drive.make.counts(32, *numbers))
    return drive


def own_message(type_: str, fields: str, of: Callable[[float], tuple[float, float]]) -> Drive:
    drive = Drive()
    for at_s in STAMPS_S:
        drive.add(at_s, "/mobile_base/sensors", drive.make.defined(at_s, type_, fields, *of(at_s)))
    return drive


def kobuki() -> Drive:
    def of(at_s: float) -> tuple[int, int]:
        left, right = (round(65_500 + rate * at_s) % (1 << 16) for rate in RATES)
        return left, right

    return own_message("kobuki_msgs/msg/SensorState", "uint16 left_encoder\nuint16 right_encoder", of)


def create() -> Drive:
    fields = "float64 velocity_left\nfloat64 velocity_right"
    return own_message("irobot_create_msgs/msg/WheelVels", fields, lambda _: (SPEEDS[0], SPEEDS[1]))


def neato() -> Drive:
    def of(at_s: float) -> tuple[int, int]:
        left, right = (round(1000 * 0.1 * speed * at_s) for speed in SPEEDS)
        return left, right

    fields = "int32 leftwheel_positioninmm\nint32 rightwheel_positioninmm"
    return own_message("neato_driver/msg/Motors", fields, of)


@pytest.mark.parametrize(
    "drive", [apart(), apart(("/left_ticks", "/right_ticks")), in_array(), kobuki(), create(), neato()]
)
def test_counts_and_speeds_of_wheels_lead_where_they_rolled(opened, own_wheels: str, drive: Drive) -> None:
    recording = opened(drive, calibration=own_wheels)
    # Of wheels that have a topic each, the left one's first message comes before the right one's.
    seconds = 2.9 if recording.topics[0].type.endswith("Int16") else 2.95
    assert end_of(recording) == pytest.approx(circle(seconds), abs=5e-3)
    assert recording.wheel_count == 60


def test_places_of_an_array_can_be_named(opened, own_wheels: str) -> None:
    recording = opened(in_array((3, 1)), calibration=own_wheels, topics=("wheels=/robot/encoder_status:3,1",))
    assert end_of(recording) == pytest.approx(circle(2.95), abs=5e-3)


@pytest.mark.parametrize("places", ["3,4", "3,-1", "left,right"])
def test_a_place_that_an_array_does_not_have_is_refused(opened, own_wheels: str, places: str) -> None:
    with pytest.raises(ConfigError, match=r"its array has 4 numbers, and no place '(4|-1|left)'"):
        opened(in_array(), calibration=own_wheels, topics=(f"wheels=/robot/encoder_status:{places}",))


@pytest.mark.parametrize("chosen", [(), ("wheels=/mobile_base/sensors",)])
def test_a_type_that_an_old_bag_does_not_define_is_named_with_what_to_do(
    tmp_path: Path, own_wheels: str, chosen: tuple[str, ...]
) -> None:
    """sqlite3 bags had no definitions before ROS 2 Iron."""
    bag = write_bag(tmp_path / "old", kobuki(), storage="sqlite3")
    (file,) = bag.glob("*.db3")
    with closing(sqlite3.connect(file)) as tables:
        tables.execute("DELETE FROM message_definitions")
        tables.commit()
    said = r"the bag does not define its type kobuki_msgs/msg/SensorState \(.* ros2 bag convert into mcap"
    with pytest.raises(RecordingError, match=said):
        open_recording(bag, OpenOptions(calibration=own_wheels, topics=chosen))


def test_two_topics_can_be_named(opened, own_wheels: str) -> None:
    drive = apart(("/a/counts", "/b/counts"))
    with pytest.raises(RecordingError, match="holds nothing to localize by"):
        opened(drive, calibration=own_wheels)
    recording = opened(drive, calibration=own_wheels, topics=("wheels=/a/counts,/b/counts",))
    assert end_of(recording) == pytest.approx(circle(2.9), abs=5e-3)


@pytest.mark.parametrize("drive", [apart(), in_array(), kobuki()])
def test_counts_without_the_wheels_sizes_are_refused_by_name_and_left_out_beside_a_camera(opened, drive) -> None:
    topic = drive.messages[0][1]
    with pytest.raises(CalibrationError, match=rf"{topic} .*how far wheels turn, but not how large they are"):
        opened(drive)
    drive.messages += camera_drive().messages
    recording = opened(drive)
    assert recording.wheel_count == 0
    assert any(topic in warning and "their sizes are not known" in warning for warning in recording.warnings)


def twists(name: str = "/robot/velocity") -> Drive:
    drive = Drive()
    for at_s in STAMPS_S:
        drive.add(at_s, name, drive.make.twist(at_s, V, W))
    return drive


def in_tf(parent: str = "odom", child: str = "base_footprint") -> Drive:
    """The odometry among transforms of others, stamped half a second ahead as localization does."""
    drive = Drive()
    for at_s in STAMPS_S:
        drive.add(at_s, "/tf", drive.make.moving_tf(at_s, parent, child, circle(at_s)))
        drive.add(at_s + 0.001, "/tf", drive.make.moving_tf(at_s + 0.5, "map", parent, (1, 2, 0.1 * at_s)))
    return drive


@pytest.mark.parametrize("drive", [twists(), in_tf(), in_tf("robot/odom", "robot/base_link")])
def test_measured_speeds_and_odometry_in_tf_alone(opened, drive: Drive) -> None:
    recording = opened(drive)
    assert end_of(recording) == pytest.approx(circle(2.95), abs=1e-6)
    assert recording.wheel_count == 60
    assert any("no truth" in warning for warning in recording.warnings)


def test_frames_of_tf_can_be_named(opened) -> None:
    recording = opened(in_tf("start", "robot"), topics=("wheels=/tf:start,robot",))
    assert end_of(recording) == pytest.approx(circle(2.95), abs=1e-6)
    with pytest.raises(ConfigError, match="/tf has no transform from start to wheel"):
        opened(in_tf("start", "robot"), topics=("wheels=/tf:start,wheel",))


def test_commanded_speeds_are_no_wheels(opened) -> None:
    with pytest.raises(RecordingError, match="holds nothing to localize by"):
        opened(twists("/cmd_vel_stamped"))


@pytest.mark.parametrize("name", ["/combined_odom", "/odometry/filtered", "/robot_pose_ekf/odom"])
def test_raw_wheels_are_preferred_to_a_filters_output(opened, own_wheels: str, name: str) -> None:
    drive = kobuki()
    drive.messages += [(at_s, name, message) for at_s, _, message in odometry_drive().messages]
    recording = opened(drive, calibration=own_wheels)
    assert wheels_of(recording) == {"/mobile_base/sensors"}
    assert any(name in warning and "a filter joined it" in warning for warning in recording.warnings)


def test_of_a_filters_output_no_gyroscope_counts_twice(opened) -> None:
    drive = Drive(messages=[(at_s, "/odometry/filtered", m) for at_s, _, m in odometry_drive().messages])
    for at_s in STAMPS_S:
        drive.add(at_s, "/imu", drive.make.imu(at_s, "base_link", (0, 0, W), (0, 0, 9.81)))
    recording = opened(drive)
    assert not [event for event in recording.events() if isinstance(event, YawRate)]
    assert any("/imu is left out: /odometry/filtered has it" in warning for warning in recording.warnings)
    asked = opened(drive, topics=("gyro=/imu",))
    assert [event for event in asked.events() if isinstance(event, YawRate)]


def aside(share: float) -> Drive:
    """Straight on, looking aside by a share of the way."""
    drive = Drive()
    for at_s in STAMPS_S:
        drive.add(at_s, "/odom", drive.make.odometry(at_s, (V * at_s, 0, -math.asin(share)), (V, 0.0)))
    return drive


def on_a_lever(lever_m: float) -> Drive:
    """On the circle, of a frame so far before the axle."""
    drive = Drive()
    for at_s in STAMPS_S:
        x, y, yaw = circle(at_s)
        pose = (x + lever_m * math.cos(yaw), y + lever_m * math.sin(yaw), yaw)
        drive.add(at_s, "/odom", drive.make.odometry(at_s, pose, (V, W)))
    return drive


@pytest.mark.parametrize("share", [0.1, 1.0])
def test_sideways_motion_of_two_wheels_is_said_with_its_share_and_the_camera_leads(
    opened, own_wheels: str, share: float
) -> None:
    reported = f"m that were checked ({100 * share:.0f} %) are sideways, which two wheels cannot show"
    alone = opened(aside(share), calibration=own_wheels)
    assert len(alone.wheel_faults) == 1
    assert reported in alone.wheel_faults[0]
    assert alone.wheel_faults[0] in alone.warnings
    drive = aside(share)
    drive.messages += camera_drive().messages
    recording = opened(drive, calibration=own_wheels)
    assert (recording.wheel_count, recording.frame_count) == (0, 6)
    assert any("/odom is left out" in warning and reported in warning for warning in recording.warnings)
    assert recording.wheel_faults == ()
    assert opened(drive, calibration=own_wheels, topics=("wheels=/odom",)).wheel_count == 60


def test_a_run_by_two_wheels_that_went_sideways_is_not_green(opened, own_wheels: str, tmp_path_factory) -> None:
    recording = opened(aside(1.0), calibration=own_wheels)
    records = run_each(recording, Config(odometry=("wheels",)), tmp_path_factory.mktemp("run"))
    assert "goes sideways" in records[0].faults[0]
    assert verdict_of_run(records).tone is not Tone.GREEN


def test_measured_speeds_across_are_sideways_too(opened) -> None:
    drive = Drive()
    for at_s in STAMPS_S:
        drive.add(at_s, "/robot/velocity", drive.make.twist(at_s, 0.0, 0.0, V))
    assert any("(100 %) are sideways" in warning for warning in opened(drive).warnings)
    assert holonomic_end_of(opened(drive)) == pytest.approx((0.0, 2.95 * V, 0.0), abs=1e-6)


@pytest.mark.parametrize("drive", [odometry_drive(), on_a_lever(0.3), aside(0.02)])
def test_two_wheels_show_a_frame_before_the_axle_and_small_errors(opened, drive: Drive) -> None:
    assert not any("sideways" in warning for warning in opened(drive).warnings)


# Ahead, to the left and turning, all at once.
TWIST = np.array([0.2, 0.4, 0.3])


def moved(at_s: float) -> tuple[float, float, float]:
    """x, y and yaw of a holonomic base after so long at that twist."""
    x, y, yaw = (float(part) for part in se2.to_parts(se2.exp(at_s * TWIST)))
    return x, y, yaw


def holonomic_end_of(recording) -> tuple[float, float, float]:
    odometry = HolonomicOdometry(not_none(recording.calibration.holonomic))
    readings = [event for event in recording.events() if isinstance(event, WheelCounts | OdometryReading)]
    T = not_none([odometry.process(event) for event in readings][-1].T_odom_body)
    return float(T[0, 3]), float(T[1, 3]), math.atan2(T[1, 0], T[0, 0])


def by_poses() -> Drive:
    drive = Drive()
    for at_s in STAMPS_S:
        drive.add(at_s, "/odom", drive.make.odometry(at_s, moved(at_s), (TWIST[0], TWIST[2])))
    return drive


def by_tf() -> Drive:
    drive = Drive()
    for at_s in STAMPS_S:
        drive.add(at_s, "/tf", drive.make.moving_tf(at_s, "odom", "base_link", moved(at_s)))
    return drive


def by_speeds() -> Drive:
    drive = Drive()
    for at_s in STAMPS_S:
        drive.add(at_s, "/robot/velocity", drive.make.twist(at_s, TWIST[0], TWIST[2], TWIST[1]))
    return drive


@pytest.mark.parametrize("made", [by_poses, by_tf, by_speeds])
@pytest.mark.parametrize("has_camera", [False, True])
def test_an_odometry_that_goes_sideways_is_that_of_a_holonomic_base(
    opened, made: Callable[[], Drive], has_camera: bool
) -> None:
    drive = made()
    drive.messages += camera_drive().messages if has_camera else []
    recording = opened(drive)
    assert holonomic_end_of(recording) == pytest.approx(moved(2.95), abs=1e-5)
    assert recording.calibration.wheels is None
    assert recording.wheel_count == 60
    assert recording.wheel_faults == ()
    assert any("is used as that of a holonomic base" in warning for warning in recording.warnings)


def test_a_run_by_a_holonomic_base_goes_its_way(opened, tmp_path_factory) -> None:
    (record,) = run_each(opened(aside(1.0)), Config(odometry=("wheels",)), tmp_path_factory.mktemp("run"))
    positions_m = record.estimate.positions_m
    assert np.linalg.norm(np.diff(positions_m, axis=0), axis=1).sum() == pytest.approx(V * 2.95, abs=1e-6)
    assert record.faults == ()


MECANUM = HolonomicWheels("mecanum", radius_m=0.05, half_length_m=0.2, half_width_m=0.15, ticks_per_turn=4096)
OMNI = HolonomicWheels("omni", radius_m=0.05, distance_m=0.2, angles_rad=(1.0472, 3.1416, 5.236), ticks_per_turn=4096)


@pytest.fixture
def holonomic(tmp_path_factory) -> Callable[[HolonomicWheels], str]:
    def of(wheels: HolonomicWheels) -> str:
        path = tmp_path_factory.mktemp("robot") / "wheels.yaml"
        save_calibration(Calibration(holonomic=wheels), path)
        return str(path)

    return of


def angles_at(wheels: HolonomicWheels, at_s: float) -> list[float]:
    return (wheels.jacobian @ TWIST * at_s / 0.05).tolist()


@pytest.mark.parametrize(
    "names",
    [
        ("front_left_wheel_joint", "front_right_wheel_joint", "rear_left_wheel_joint", "rear_right_wheel_joint"),
        ("fl_joint", "fr_joint", "bl_joint", "br_joint"),
        ("wheel_left_front", "wheel_right_front", "wheel_left_back", "wheel_right_back"),
    ],
)
@pytest.mark.parametrize("by", ["angles", "speeds"])
def test_joints_of_four_mecanum_wheels_are_known_by_their_names(opened, holonomic, names, by: str) -> None:
    drive, order = Drive(), [2, 0, 3, 1]
    for at_s in STAMPS_S:
        angles = np.array(angles_at(MECANUM, at_s))[order]
        speeds = np.array(angles_at(MECANUM, 1.0))[order]
        reported = (angles.tolist(), []) if by == "angles" else ([], speeds.tolist())
        with_arm = [[0.0, *one] if one else [] for one in reported]
        drive.add(at_s, "/joint_states", drive.make.joints(at_s, ["arm", *(names[i] for i in order)], *with_arm))
    recording = opened(drive, calibration=holonomic(MECANUM))
    assert holonomic_end_of(recording) == pytest.approx(moved(2.95), abs=3e-3)
    assert any(", ".join(names) in warning for warning in recording.warnings)


@pytest.mark.parametrize("wheels", [MECANUM, OMNI], ids=["mecanum", "omni"])
def test_an_array_of_all_wheels_counts_in_the_calibrations_order(opened, holonomic, wheels: HolonomicWheels) -> None:
    drive = Drive()
    for at_s in STAMPS_S:
        counts = [round(angle * 4096 / (2 * math.pi)) for angle in angles_at(wheels, at_s)]
        drive.add(at_s, "/encoder_ticks", drive.make.counts(32, *counts))
    assert holonomic_end_of(opened(drive, calibration=holonomic(wheels))) == pytest.approx(moved(2.95), abs=3e-3)


def test_wheels_of_a_holonomic_base_can_be_named(opened, holonomic) -> None:
    drive = Drive()
    for at_s in STAMPS_S:
        drive.add(at_s, "/joint_states", drive.make.joints(at_s, ["a", "b", "c"], angles_at(OMNI, at_s)[::-1], []))
    calibration = holonomic(OMNI)
    with pytest.raises(RecordingError, match=r"not 3 numbers that are known .*:WHEEL_1,WHEEL_2,WHEEL_3"):
        opened(drive, calibration=calibration, topics=("wheels=/joint_states",))
    recording = opened(drive, calibration=calibration, topics=("wheels=/joint_states:c,b,a",))
    assert holonomic_end_of(recording) == pytest.approx(moved(2.95), abs=3e-3)


def test_two_wheels_are_no_holonomic_base(opened, holonomic) -> None:
    with pytest.raises(ConfigError, match="/mobile_base/sensors is of two wheels"):
        opened(kobuki(), calibration=holonomic(MECANUM), topics=("wheels=/mobile_base/sensors",))


def test_a_stated_base_takes_its_odometry_where_no_wheels_count(opened, holonomic) -> None:
    recording = opened(odometry_drive(), calibration=holonomic(MECANUM))
    assert holonomic_end_of(recording) == pytest.approx(circle(2.95), abs=1e-6)


TRUTH = "/mocap/robot"
KINDS = ("PoseStamped", "PoseWithCovarianceStamped", "TransformStamped", "Odometry")


def with_truth(kind: str, child: str = "base_link") -> Drive:
    drive = odometry_drive()
    for at_s in STAMPS_S:
        drive.add(at_s, TRUTH, drive.make.posed(at_s, kind, circle(at_s), child))
    return drive


@pytest.mark.parametrize("kind", KINDS)
def test_truth_in_a_bag_is_what_a_user_names(opened, kind: str) -> None:
    drive = with_truth(kind)
    assert opened(drive, topics=("wheels=/odom",)).ground_truth is None
    recording = opened(drive, topics=(f"truth={TRUTH}",))
    assert wheels_of(recording) == {"/odom"}
    truth = not_none(recording.ground_truth)
    assert (len(truth), truth.body) == (60, "base")
    assert truth.T_frame_body[-1, :2, 3] == pytest.approx(circle(2.95)[:2])
    assert any("are used as those of the base" in w for w in recording.warnings) == kind.startswith("Pose")
    odometry = WheelOdometry(not_none(recording.calibration.wheels))
    speeds = [event for event in recording.events() if isinstance(event, WheelSpeeds)]
    way = [not_none(odometry.process(event).T_odom_body) for event in speeds]
    estimate = type(truth)(np.array([event.stamp_s for event in speeds]), np.array(way), body="base")
    assert evaluate(estimate, truth).ate.translation.rmse < 1e-6


def test_truth_of_a_marker_is_moved_to_the_base_by_tf(opened) -> None:
    drive = with_truth("TransformStamped", "marker")
    drive.add(0.0, "/tf_static", drive.make.tf(("base_link", "marker", (0.1, 0, 0.5), (0, 0, 0, 1))))
    truth = not_none(opened(drive, topics=(f"truth={TRUTH}",)).ground_truth)
    x, y, yaw = circle(2.95)
    expected = (x - 0.1 * math.cos(yaw), y - 0.1 * math.sin(yaw), -0.5)
    assert truth.T_frame_body[-1, :3, 3] == pytest.approx(expected)


def test_truth_in_tf_and_of_a_camera(opened) -> None:
    drive = camera_drive().without("/tf_static")
    for at_s in STAMPS_S:
        drive.add(at_s, "/tf", drive.make.moving_tf(at_s, "world", "kinect", circle(at_s)))
    with pytest.raises(ConfigError, match="tf has many transforms"):
        opened(drive, topics=("truth=/tf",))
    drive.add(0.0, "/tf_static", drive.make.tf(("kinect", OPTICAL, (0, 0.02, 0), LOOKS_AHEAD)))
    truth = not_none(opened(drive, topics=("truth=/tf:world,kinect",)).ground_truth)
    assert (len(truth), truth.body) == (60, "camera")
    assert truth.T_frame_body[0, :3, 3] == pytest.approx((0, 0.02, 0))
