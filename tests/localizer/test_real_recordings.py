"""Real recordings: through Localizer they come out no worse than by the odometry that it goes by."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from itertools import islice
from pathlib import Path

import numpy as np
import pytest
from grids import mostly_slow

from wheelsight.config import load_config
from wheelsight.core.calibration import Calibration
from wheelsight.core.checks import Repeats
from wheelsight.core.estimates import Estimate, Reason, Status
from wheelsight.core.messages import Event, RgbdFrame, WheelSpeeds, WheelTicks
from wheelsight.core.trajectory import Trajectory
from wheelsight.estimation import Localizer
from wheelsight.evaluation import ate
from wheelsight.io.recordings import Recording, open_recording
from wheelsight.vision.dense import DenseOdometry
from wheelsight.wheels import WheelOdometry

pytestmark = pytest.mark.data
# Looking ahead from 1 m above the floor.
T_BASE_CAMERA = np.array([[0.0, 0, 1, 0], [-1, 0, 0, 0], [0, -1, 0, 1], [0, 0, 0, 1]])


def with_a_dark_camera(wheels: Calibration, camera: Calibration) -> Localizer:
    """Wheels of a real drive joined with a camera that never sees anything."""
    calibration = replace(camera, wheels=wheels.wheels, gyro=wheels.gyro, T_base_camera=T_BASE_CAMERA)
    return Localizer(calibration, load_config(overrides={"odometry": ["wheels", "dense"]}))


def answers_to(localizer: Localizer, events: Iterable[Event]) -> list[Estimate]:
    return [found for event in events if (found := localizer.process(event)) is not None]


def rmse_m(answers: list[Estimate], recording: Recording) -> float:
    assert recording.ground_truth is not None
    newest = {answer.stamp_s: answer.T_filter_body for answer in answers}  # one that came late is answered as of that
    stamps, poses = zip(*sorted(newest.items()), strict=True)
    return ate(Trajectory(np.array(stamps), np.array(poses), body="base"), recording.ground_truth).translation.rmse


@pytest.mark.parametrize(
    ("name", "has_gyro", "first"),
    mostly_slow(
        [("skid_steer_run20", True, None), ("mocap_floor", False, 1000), ("corridor_864m", False, 1000)],
        quick=[("mocap_floor", False, 1000)],
    ),
)
def test_wheels_are_no_worse_joined_with_a_dark_camera_than_alone(
    data_folder: Path, name: str, has_gyro: bool, first: int | None
) -> None:
    recording = open_recording(data_folder / "wheels" / name)
    camera = open_recording(data_folder / "rgbd" / "red_kitchen").calibration
    events = list(islice(recording.events(), first))
    alone = answers_to(Localizer(recording.calibration, load_config(overrides={"odometry": "wheels"})), events)
    joined = answers_to(with_a_dark_camera(recording.calibration, camera), events)
    assert {answer.status for answer in joined} == {Status.COASTING}
    assert len(joined) == len(alone)
    if has_gyro:  # the filter learns its bias on the way, dead reckoning does not
        assert rmse_m(joined, recording) < rmse_m(alone, recording)
        return
    for ours, theirs in zip(joined, alone, strict=True):
        assert ours.T_odom_body is not None
        assert theirs.T_odom_body is not None
        np.testing.assert_allclose(ours.T_odom_body, theirs.T_odom_body, atol=1e-9)


@pytest.mark.parametrize("name", ["skid_steer_run20", "mocap_floor"])
def test_wheels_through_a_localizer_are_wheel_odometry(data_folder: Path, name: str) -> None:
    recording = open_recording(data_folder / "wheels" / name)
    assert recording.calibration.wheels is not None
    plain = WheelOdometry(recording.calibration.wheels)
    settings = load_config(overrides={"odometry": "wheels", "wheels.gyro": False})
    events = list(islice(recording.events(), 2000))
    through = answers_to(Localizer(recording.calibration, settings), events)
    readings = [event for event in events if isinstance(event, WheelTicks | WheelSpeeds)]
    assert len(readings) > 500
    for ours, reading in zip(through, readings, strict=True):
        np.testing.assert_array_equal(ours.T_odom_body, plain.process(reading).T_odom_body)


@pytest.mark.parametrize("name", mostly_slow(["freiburg1_rpy_part", "red_kitchen"], quick=["freiburg1_rpy_part"]))
def test_a_camera_through_a_localizer_is_dense_odometry(data_folder: Path, name: str) -> None:
    recording = open_recording(data_folder / "rgbd" / name)
    plain = DenseOdometry(recording.calibration)
    through = Localizer(recording.calibration, load_config(overrides={"odometry": "dense"}))
    frames = (event for event in recording.events() if isinstance(event, RgbdFrame))
    for frame in islice(frames, 15):
        ours, theirs = through.process(frame), plain.process(frame)
        assert ours is not None
        np.testing.assert_array_equal(ours.T_odom_body, theirs.T_odom_body)
        np.testing.assert_array_equal(ours.covariance, theirs.covariance)


@pytest.mark.parametrize("odometry", mostly_slow(["features", "dense"], quick=["features"]))
def test_real_images_listed_twice_are_tracked_as_if_listed_once(data_folder: Path, odometry: str) -> None:
    recording = open_recording(data_folder / "rgbd" / "freiburg1_rpy_part")
    frames = [event for event in islice(recording.events(), 30) if isinstance(event, RgbdFrame)]
    settings = load_config(overrides={"odometry": odometry})
    once, twice = (Localizer(recording.calibration, settings) for _ in range(2))
    for frame in frames:
        expected, answer = once.process(frame), twice.process(frame)
        again = twice.process(replace(frame, stamp_s=frame.stamp_s + 0.01))
        assert expected is not None
        assert answer is not None
        assert again is not None
        assert (expected.reason, again.reason, again.T_odom_body) == (None, Reason.REPEATED, None)
        np.testing.assert_array_equal(answer.T_odom_body, expected.T_odom_body)


@pytest.mark.parametrize(
    ("name", "repeated"),
    mostly_slow([("freiburg1_rpy_part", 0), ("red_kitchen", 31)], quick=[("freiburg1_rpy_part", 0)]),
)
def test_real_images_repeat_where_files_do_and_nowhere_else(data_folder: Path, name: str, repeated: int) -> None:
    """Those of the red kitchen were recorded with 31 of 500 frames twice, bit for bit."""
    repeats, events = Repeats(), open_recording(data_folder / "rgbd" / name).events()
    lasting_s = [repeats.lasting_s(event) for event in events if isinstance(event, RgbdFrame)]
    assert len(lasting_s) > 200
    assert np.count_nonzero(lasting_s) == repeated
    assert max(lasting_s) < 0.04


def test_of_wheels_that_slip_and_a_wrong_gyroscope_neither_is_believed(data_folder: Path) -> None:
    """A robot that is held while it turns: its wheels count -717°, its gyroscope 225°, and tags on it show -515°."""
    recording = open_recording(data_folder / "bags" / "lifted_robot.bag")
    with Localizer(recording.calibration, load_config(overrides={"odometry": "wheels"})) as localizer:
        poses = [answer for answer in answers_to(localizer, recording.events()) if answer.T_odom_body is not None]
        assert any("gyroscope" in warning and "wheels" in warning for warning in localizer.warnings)
    yaw_rad = np.unwrap([np.arctan2(*pose.T_odom_body[1::-1, 0]) for pose in poses if pose.T_odom_body is not None])
    assert poses[-1].covariance is not None
    sigma_rad = np.sqrt(poses[-1].covariance[5, 5])
    assert abs(yaw_rad[-1] - yaw_rad[0] - np.radians(-515)) < 3 * sigma_rad < 3 * np.radians(300)
    assert np.mean([pose.status is Status.COASTING for pose in poses]) > 0.7
