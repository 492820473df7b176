"""Bags of other authors: read where they hold data, and refused with what they lack where they do not."""

from __future__ import annotations

import numpy as np
import pytest

from wheelsight.core.errors import RecordingError
from wheelsight.core.messages import WheelSpeeds, YawRate
from wheelsight.io.recordings import open_recording

pytestmark = pytest.mark.data


@pytest.fixture
def bags(data_folder):
    folder = data_folder / "bags"
    if not folder.is_dir():
        pytest.skip(f"real bags are not at {folder}")
    return folder


def test_husky(bags):
    recording = open_recording(bags / "husky_outdoor_395s.bag")
    assert (recording.frame_count, recording.wheel_count, recording.ground_truth) == (0, 3952, None)
    events = list(recording.events())
    speeds = [event for event in events if isinstance(event, WheelSpeeds)]
    rates = [event for event in events if isinstance(event, YawRate)]
    assert (len(speeds), len(rates)) == (3952, 11865)
    stamps_s = np.array([event.stamp_s for event in speeds])
    forward_m_s, turning_rad_s = forward_and_turning(recording, speeds)
    # The length of its own poses' way.
    assert np.abs(forward_m_s[:-1] * np.diff(stamps_s)).sum() == pytest.approx(358.80, abs=0.01)
    # The gyroscope lies on its side, and nothing but gravity says so: by its z axis it would know of no turn.
    at_wheels = np.interp(stamps_s, [event.stamp_s for event in rates], [event.yaw_rate_rad_s for event in rates])
    assert np.corrcoef(at_wheels, turning_rad_s)[0, 1] > 0.9
    assert any("up is where gravity says, 91° off its z axis" in warning for warning in recording.warnings)


def test_jackal(bags):
    recording = open_recording(bags / "jackal_61s.bag")
    speeds = [event for event in recording.events() if isinstance(event, WheelSpeeds)]
    assert len(speeds) == recording.wheel_count == 3060
    assert 47 < speeds[0].stamp_s < 48  # a simulator's clock
    forward_m_s, turning_rad_s = forward_and_turning(recording, speeds)
    steps_s = np.diff([event.stamp_s for event in speeds])
    assert (np.abs(forward_m_s[:-1]) * steps_s).sum() == pytest.approx(84.18, abs=0.01)
    assert (turning_rad_s[:-1] * steps_s).sum() == pytest.approx(35.647, abs=0.001)


def forward_and_turning(recording, speeds):
    """Speeds (N,) ahead and yaw rates (N,) of wheels that stand for them."""
    wheels = recording.calibration.wheels
    left, right = np.array([(event.left_rad_s, event.right_rad_s) for event in speeds]).T * wheels.left_radius_m
    return (left + right) / 2, (right - left) / wheels.track_width_m


@pytest.mark.parametrize(
    ("name", "problem"),
    [
        ("one_image.bag", "since no depth images match them: /compressedimage, /image"),
        ("rosbag2_2025_09_10-13_03_56_0.mcap", "/joint_state is not used: no two of its joints"),
        ("example-bz2.bag", "no Odometry, no JointState of wheels. Its topics: /rosout"),
        ("example-lz4.bag", "/turtle1/pose .Pose, 1,344."),
        ("no-messages.bag", "holds no messages"),
        ("rosbag2/empty_bag_0.db3", "holds no messages"),
        ("rosbag2/cdr_test_0.db3", "/test_topic .BasicTypes, 3."),
        ("rosbag2/cdr_test_0.mcap", "/test_topic .BasicTypes, 3."),
        ("rosbag2/split", "AAA .String, 804."),
        ("rosbag2/compressed", "/topic .String, 369."),
        ("rosbag2/bag_with_topics_and_service_events.mcap", "BasicTypes_Event"),
        ("foxglove_log.mcap", "is an MCAP file, but not of ROS 2"),
        ("simple-protobuf.mcap", "is an MCAP file, but not of ROS 2"),
    ],
)
def test_what_others_lack(bags, name, problem):
    with pytest.raises(RecordingError, match=problem):
        open_recording(bags / name)
