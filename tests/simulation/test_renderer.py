"""Frames along drives that are known in closed form: each by itself, at its time, of what stands there."""

from __future__ import annotations

import time
from dataclasses import replace

import numpy as np
import pytest
from narrowing import not_none

from wheelsight.core.errors import ConfigError
from wheelsight.core.geometry import se3
from wheelsight.core.trajectory import Trajectory
from wheelsight_sim import Drive, Renderer, SimulationSettings, build_world, camera_model
from wheelsight_sim.frames import in_order

SETTINGS = SimulationSettings(world="square", size=(64, 48), rate_hz=10.0, seed=3)
WORLD = build_world("square", 3)
COVERING_M = 0.003  # what covers the ground where a floor is more than one colour


def drive(duration_s: float = 1.0, v_m_s: float = 0.5, yaw_rate_rad_s: float = 0.4) -> Drive:
    """An arc from the route's start, at 200 Hz."""
    stamps_s = np.arange(0, duration_s + 1e-9, 0.005)
    x, y = WORLD.route[0]
    start = se3.from_plane(x, y, 0.3)
    arc = se3.exp(stamps_s[:, None] * [v_m_s, 0, 0, 0, 0, yaw_rate_rad_s])
    return Drive(Trajectory(stamps_s, start @ arc, body="base"), ())


def renderer(settings: SimulationSettings = SETTINGS, driven: Drive | None = None) -> Renderer:
    return Renderer(WORLD, driven or drive(), settings, camera_model(settings.camera, settings.size))


def check_same(a, b):
    assert (a.stamp_s, a.index) == (b.stamp_s, b.index)
    np.testing.assert_array_equal(a.color, b.color)
    np.testing.assert_array_equal(a.depth_m, b.depth_m)


@pytest.mark.parametrize(
    "others",
    [{}, {"passersby": 1, "has_motion_blur": True}, {"realism": "real"}, {"realism": "real", "camera": "kinect-v2"}],
    ids=["plain", "people and blur", "real", "real by time of flight"],
)
def test_a_frame_depends_on_no_other(others):
    settings = replace(SETTINGS, **others)
    in_turn = list(renderer(settings).frames())
    assert [frame.index for frame in in_turn] == list(range(11 if others.get("camera") == "kinect-v2" else 10))
    backwards = renderer(settings)
    for index in (9, 4, 0):
        check_same(backwards.frame(index), in_turn[index])
    assert (in_turn[0].color != in_turn[9].color).any()


def test_other_seeds_look_and_measure_otherwise():
    a, b = renderer().frame(2), renderer(replace(SETTINGS, seed=4)).frame(2)
    assert (a.color != b.color).mean() > 0.5
    assert (a.depth_m != b.depth_m).any()


def test_frames_come_at_their_rate_and_end_with_the_drive():
    frames = renderer()
    assert (frames.rate_hz, frames.frame_count) == (10.0, 10)  # one more would have rows after the drive's end
    assert frames.stamp_s(3) == 0.3
    assert renderer(replace(SETTINGS, camera="ideal")).frame_count == 11
    assert renderer(replace(SETTINGS, rate_hz=None)).rate_hz == camera_model("kinect-v1").rate_hz


def test_rows_are_read_one_after_the_other():
    driven = drive()
    frames = renderer(driven=driven)
    shutter_s = camera_model("kinect-v1").rolling_shutter_s
    assert frames.calibration.rolling_shutter_s == shutter_s > 0
    T_world_camera = frames.moment(0.5).T_world_camera
    ends_s = 0.5 + shutter_s * np.array([-0.5, 0.5])
    ends = driven.truth.at(ends_s) @ SETTINGS.robot.T_base_camera
    np.testing.assert_allclose(T_world_camera[[0, -1]], ends, atol=1e-12)
    middle = se3.interpolate(T_world_camera[23], T_world_camera[24], 0.5)
    np.testing.assert_allclose(middle, driven.truth.at(0.5)[0] @ SETTINGS.robot.T_base_camera, atol=1e-9)


def test_a_robot_stands_before_it_starts():
    driven = drive()
    before = renderer(driven=driven).moment(0.0).T_world_camera[:24]
    np.testing.assert_allclose(before, np.broadcast_to(before[0], before.shape))
    np.testing.assert_allclose(before[0], driven.truth.T_frame_body[0] @ SETTINGS.robot.T_base_camera)


def test_the_floor_is_seen_where_it_is():
    settings = replace(SETTINGS, camera="ideal")
    frames = renderer(settings)
    rays = not_none(frames.calibration.color).rays()[-8:]
    for index in (0, 5, 10):
        p_camera = rays * frames.frame(index).depth_m[-8:, :, None]
        p_world = se3.apply(frames.moment(frames.stamp_s(index)).T_world_camera[0], p_camera.reshape(-1, 3))
        above_m = np.abs(p_world[:, 2, None] - [0, COVERING_M]).min(axis=1)
        np.testing.assert_allclose(above_m, 0, atol=1e-5)


def test_motion_blur_smears_a_turn_and_nothing_at_rest():
    def sharpness(yaw_rate_rad_s: float, has_motion_blur: bool) -> float:
        settings = replace(SETTINGS, has_motion_blur=has_motion_blur, size=(160, 120))
        color = renderer(settings, drive(0.3, 0.0, yaw_rate_rad_s)).frame(1).color
        return float(np.abs(np.diff(color.astype(float).mean(axis=2), axis=1)).max(axis=0).mean())

    assert sharpness(0.0, True) == sharpness(0.0, False)
    assert sharpness(1.5, True) < 0.9 * sharpness(1.5, False)


def test_a_real_frame_is_taken_before_it_is_stamped():
    settings = replace(SETTINGS, realism="real", rate_hz=30.0)
    frames = renderer(settings, drive(10.0))
    taken_s, reported_s = (
        np.array([of(k) for k in range(frames.frame_count)]) for of in (frames.taken_s, frames.stamp_s)
    )
    assert frames.frame_count < 300  # some are lost
    assert -0.008 < (reported_s - taken_s).min() < (reported_s - taken_s).max() < 0.03
    assert [frames.frame(k).stamp_s for k in (0, 250)] == [reported_s[0], reported_s[250]]


def test_a_real_camera_is_another_than_its_calibration_says():
    ideal, real = renderer(), renderer(replace(SETTINGS, realism="real"))
    assert ideal.true_calibration.color == ideal.calibration.color
    assert real.true_calibration.color != real.calibration.color
    assert real.calibration.color is not None
    assert real.calibration.color.has_distortion
    exact = renderer(replace(SETTINGS, realism="real", camera="ideal"))
    assert exact.true_calibration.color == exact.calibration.color == camera_model("ideal", (64, 48)).camera


def test_a_drive_too_short_for_a_frame_is_refused():
    with pytest.raises(ConfigError, match=r"a drive of 0.000 s is too short for a frame"):
        renderer(driven=drive(0.0))


def test_results_come_in_order_though_they_are_not_made_so():
    def make(index: int) -> int:
        time.sleep(0.01 * (index % 3 == 0))
        return index

    assert list(in_order(make, 20, 3)) == list(range(20))


def test_an_error_comes_at_its_place():
    def make(index: int) -> int:
        if index == 7:
            raise ValueError("seven")
        return index

    results = in_order(make, 20, 2)
    assert [next(results) for _ in range(7)] == list(range(7))
    with pytest.raises(ValueError, match="seven"):
        next(results)


def test_what_no_one_waits_for_is_not_made():
    made = []
    results = in_order(lambda index: made.append(index), 1000, 2)
    next(results)
    results.close()
    assert len(made) < 10
