"""A simulated drive is a recording like any other, but for the disk."""

from __future__ import annotations

import threading
from dataclasses import replace

import numpy as np
import pytest

from wheelsight import Config, run
from wheelsight.core.errors import ConfigError
from wheelsight.core.messages import RgbdFrame, WheelTicks, YawRate
from wheelsight.io.recordings import Recording, express_for
from wheelsight_sim import RobotModel, SimulationSettings, simulate

ROBOT = RobotModel(left_radius_m=0.168, right_radius_m=0.171, track_width_m=0.53, has_gyro=True)
SETTINGS = SimulationSettings(world="floor4", size=(64, 48), rate_hz=10.0, duration_s=1.5, seed=2, robot=ROBOT)


@pytest.fixture(scope="module")
def recording():
    return simulate(SETTINGS)


def test_it_is_a_recording(recording):
    assert isinstance(recording, Recording)
    assert (recording.name, recording.format, recording.body) == ("floor4-2", "simulation", "base")
    assert recording.association.pairs == recording.frame_count
    assert recording.association.dropped_color == recording.association.dropped_depth == 0


def test_events_come_in_order_of_time_and_as_many_as_promised(recording):
    events = list(recording.events())
    stamps_s = [event.stamp_s for event in events]
    assert stamps_s == sorted(stamps_s)
    counts = [sum(isinstance(event, kind) for event in events) for kind in (RgbdFrame, WheelTicks, YawRate)]
    assert counts == [recording.frame_count, recording.wheel_count, len(recording.drive.yaw_rates)]
    assert counts[:2] == [15, 76]
    assert counts[2] > 0


def test_events_can_be_asked_for_again(recording):
    for a, b in zip(recording.events(), recording.events(), strict=True):
        if isinstance(a, RgbdFrame):
            np.testing.assert_array_equal(a.color, b.color)
        else:
            assert a == b


def test_leaving_the_events_stops_the_threads(recording):
    events = recording.events()
    assert next(event for event in events if isinstance(event, RgbdFrame)).index == 0
    events.close()
    assert not [thread for thread in threading.enumerate() if thread.name.startswith("wheelsight-render")]


def test_calibration_is_what_a_user_would_measure_and_truth_what_is(recording):
    nominal, true = recording.calibration, recording.true_calibration
    assert nominal.wheels == RobotModel().wheels
    assert true.wheels == ROBOT.wheels
    assert nominal.color == true.color
    assert (nominal.color.width, nominal.color.height) == (64, 48)
    np.testing.assert_array_equal(nominal.T_base_camera, RobotModel().T_base_camera)


def test_truth_of_the_camera_follows_from_that_of_the_base(recording):
    camera = express_for("camera", recording.ground_truth, recording.calibration)
    middle_row = recording.renderer.moment(0.7).T_world_camera[23:25]
    np.testing.assert_allclose(camera.at(0.7)[0, :3, 3], middle_row[:, :3, 3].mean(axis=0), atol=1e-4)


def test_the_area_is_where_the_base_is(recording):
    assert recording.area_at(0.5) == recording.world.areas.name_at(*recording.world.route[0])
    assert recording.area_at(-1.0) == recording.area_at(0.0)
    outside = replace(recording, world=replace(recording.world, areas=type(recording.world.areas)()))
    assert outside.area_at(0.5) is None


def test_a_drive_that_ends_early_says_why_unless_that_was_wanted(recording):
    assert recording.warnings == ()
    stuck = replace(recording, drive=replace(recording.drive, reason="stuck"), settings=replace(SETTINGS, duration_s=9))
    assert stuck.warnings == ("The drive ended early: stuck.",)


def test_a_run_needs_no_disk_but_for_its_results(recording, tmp_path):
    record = run(recording, Config(odometry="wheels"), tmp_path / "out")
    assert len(record.frames) == recording.wheel_count
    assert record.evaluation is not None
    assert record.ground_truth is not None
    assert record.ground_truth.body == "base"
    assert (tmp_path / "out" / "report.html").is_file()


def test_a_seed_makes_the_drive(recording):
    again = simulate(SETTINGS)
    assert again.drive.ticks == recording.drive.ticks
    np.testing.assert_array_equal(again.ground_truth.T_frame_body, recording.ground_truth.T_frame_body)
    other = simulate(replace(SETTINGS, seed=5))
    assert (other.ground_truth.T_frame_body != recording.ground_truth.T_frame_body).any()


def test_another_day_has_the_same_building_robot_and_camera_in_another_light(recording):
    real = replace(SETTINGS, realism="real", size=(160, 120), duration_s=0.3)
    first, other = (simulate(replace(real, day=day)) for day in (0, 1))
    assert (first.name, other.name) == ("floor4-2", "floor4-2-day1")
    for one, same in ((first.calibration, other.calibration), (first.true_calibration, other.true_calibration)):
        assert (one.color, one.depth, one.wheels) == (same.color, same.depth, same.wheels)
        np.testing.assert_array_equal(one.T_base_camera, same.T_base_camera)
    assert first.drive.ticks != other.drive.ticks
    views = [next(event for event in one.events() if isinstance(event, RgbdFrame)) for one in (first, other)]
    is_measured = np.logical_and(*(view.depth_m > 0 for view in views))
    off_m = abs(views[0].depth_m - views[1].depth_m)[is_measured]
    assert off_m.mean() > 0
    assert np.median(off_m) < 0.02
    brighter = views[1].color.astype(float) - views[0].color
    by_parts = brighter.reshape(4, 30, 4, 40, 3).mean(axis=(1, 3, 4))  # the exposure evens out the mean of all
    assert np.ptp(by_parts) > 2


@pytest.mark.parametrize(
    ("change", "problem"),
    [
        ({"world": "florr4"}, r"no world florr4 \(did you mean floor4\? choose from floor4, "),
        (
            {"camera": "kinect"},
            r"camera 'kinect' is not known \(did you mean kinect-v\d\? choose from ideal, kinect-v1, ",
        ),
    ],
)
def test_what_is_not_known_is_answered_with_what_is(change, problem):
    with pytest.raises(ConfigError, match=problem):
        simulate(replace(SETTINGS, **change))
