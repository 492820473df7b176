from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from sighted_drives import MOUNT, NOISE, room_views

from wheelsight.core.depth_errors import NOMINAL_ERRORS, PointErrors
from wheelsight.core.errors import CalibrationError
from wheelsight.core.geometry import FloatArray, se3, so3
from wheelsight_calibration.mount import FloorDepths, fit_floor, tilt_of
from wheelsight_sim import RobotModel

STAMPS_S = np.arange(0.0, 30.0, 0.5)
YAW_RAD = np.linspace(0, 9, len(STAMPS_S))
T_WORLD_BASE = se3.from_plane(2 * np.sin(STAMPS_S / 5), 2 * np.cos(STAMPS_S / 4), YAW_RAD)


def views_of(T_base_camera: FloatArray, rng: np.random.Generator | None = None) -> FloorDepths:
    return room_views(STAMPS_S, T_WORLD_BASE @ T_base_camera, rng)


def mount(**angles: float) -> FloatArray:
    named: dict[str, Any] = {f"camera_{name}": value for name, value in angles.items()}
    return RobotModel(**named).T_base_camera


@pytest.mark.parametrize(
    "angles",
    [
        {"pitch_rad": 0.1},
        {"pitch_rad": 0.9, "height_m": 1.4},
        {"pitch_rad": 0.3, "roll_rad": 0.4, "yaw_rad": 2.0, "height_m": 0.5},
        {"pitch_rad": 0.2, "roll_rad": np.pi, "height_m": 1.2},
    ],
    ids=["ahead", "down", "leaning", "upside-down"],
)
def test_a_floor_without_noise_is_found_exactly(angles: dict[str, float]) -> None:
    """Walls stand all around; the axis of turning that starts the search is 2° off."""
    T_base_camera = mount(**angles)
    up = T_base_camera[2, :3]
    floor = fit_floor(views_of(T_base_camera), so3.exp([0.03, 0.02, -0.02]) @ up, NOISE)
    np.testing.assert_allclose(floor.up_camera, up, atol=1e-6)
    assert floor.height_m == pytest.approx(T_base_camera[2, 3], abs=1e-6)
    assert len(floor.tilts) == len(floor.stamps_s) > 0.8 * floor.view_count


def test_tilt_is_that_of_the_robot() -> None:
    for roll, pitch in ((0.0, 0.1), (0.3, -0.2), (-2.0, 0.5)):
        up = mount(roll_rad=roll, pitch_rad=pitch, yaw_rad=1.0)[2, :3]
        np.testing.assert_allclose(tilt_of(up), (roll, pitch), atol=1e-12)


@pytest.mark.slow
def test_errors_are_as_large_as_stated() -> None:
    """Normalised error squared of three quantities over forty noisy drives; what no camera betters is added to σ."""
    truth = np.array([*tilt_of(MOUNT[2, :3]), MOUNT[2, 3]])
    nees = []
    for seed in range(40):
        floor = fit_floor(views_of(MOUNT, np.random.default_rng(seed)), MOUNT[2, :3], NOISE)
        error = np.array([*tilt_of(floor.up_camera), floor.height_m]) - truth
        assert np.abs(np.degrees(error[:2])).max() < 0.1
        assert abs(error[2]) < 0.003
        nees.append(error @ np.linalg.solve(floor.covariance, error))
    assert 0.1 < np.mean(nees) / 3 < 1.5


def test_a_table_is_not_the_floor() -> None:
    """A third of the views look at a table top 70 cm over the floor, which fills most of the image."""
    views = views_of(MOUNT)
    table = room_views(STAMPS_S, T_WORLD_BASE @ (se3.from_parts(np.eye(3), [0, 0, -0.5]) @ MOUNT), None)
    depth_m = views.depth_m.copy()
    depth_m[::3] = np.where(views.rays[:, 1] > -0.1, table.depth_m[::3], depth_m[::3])
    floor = fit_floor(replace(views, depth_m=depth_m), MOUNT[2, :3], NOISE)
    assert floor.height_m == pytest.approx(MOUNT[2, 3], abs=2e-3)
    assert len(floor.tilts) < 0.75 * floor.view_count


def test_a_table_without_a_floor_is_refused() -> None:
    """It is lowest of what lies flat, but walls reach below it."""
    views = views_of(MOUNT)
    below_m = -(views.rays @ MOUNT[2, :3]) * views.depth_m
    walls_alone = np.where(below_m > MOUNT[2, 3] - 1e-6, 0.0, views.depth_m)
    low = -(views.rays @ MOUNT[2, :3]) > 0.5
    top_m = 0.3 / -(views.rays @ MOUNT[2, :3])
    depth_m = np.where(low, top_m, walls_alone)
    with pytest.raises(CalibrationError, match=r"no floor is in view .tilt the camera down"):
        fit_floor(replace(views, depth_m=depth_m), MOUNT[2, :3], NOISE)


@pytest.mark.parametrize("pitch_rad", [-0.6, -1.2])
def test_a_camera_that_looks_up_is_refused(pitch_rad: float) -> None:
    T_base_camera = mount(pitch_rad=pitch_rad)
    with pytest.raises(CalibrationError, match="tilt the camera down"):
        fit_floor(views_of(T_base_camera), T_base_camera[2, :3], NOISE)


def test_depth_that_is_empty_is_refused() -> None:
    views = views_of(MOUNT)
    with pytest.raises(CalibrationError, match="no floor is in view"):
        fit_floor(replace(views, depth_m=np.zeros_like(views.depth_m)), MOUNT[2, :3], NOISE)


def test_a_camera_that_sways_is_refused(rng: np.random.Generator) -> None:
    sway = so3.exp(np.radians(2) * rng.standard_normal((len(STAMPS_S), 3)) * [0, 1, 0])
    T_map_camera = T_WORLD_BASE @ se3.from_parts(sway, np.zeros((len(STAMPS_S), 3))) @ MOUNT
    with pytest.raises(CalibrationError, match=r"the floor sways by .* .fix the camera to the robot"):
        fit_floor(room_views(STAMPS_S, T_map_camera, None), MOUNT[2, :3], NOISE)


def test_few_views_of_the_floor_are_too_few() -> None:
    views = views_of(MOUNT)
    few = FloorDepths(views.stamps_s[:5], views.rays, views.depth_m[:5])
    with pytest.raises(CalibrationError, match="only 5 of 5 views show enough floor"):
        fit_floor(few, MOUNT[2, :3], NOISE)


def test_what_moves_points_moves_the_floor_as_stated() -> None:
    """A fit to depth that is off by a mode of half a step of disparity, aslant, against the one to true depth."""
    views, errors = views_of(MOUNT), NOMINAL_ERRORS.modes[8]
    floor = fit_floor(views, MOUNT[2, :3], NOISE)
    mode = PointErrors((tuple(0.2 * c for c in errors),))
    seen = views.depth_m > 0
    points_m = (views.rays * views.depth_m[..., None])[seen]
    depth_m = views.depth_m.copy()
    depth_m[seen] += mode.moved_m(points_m)[0, :, 2]
    moved = fit_floor(replace(views, depth_m=depth_m), MOUNT[2, :3], NOISE)
    off = np.array([*tilt_of(moved.up_camera), moved.height_m]) - [*tilt_of(floor.up_camera), floor.height_m]
    stated = floor.by_camera(mode.moved_m(floor.points_m))
    assert np.abs(off).max() > 5e-4
    np.testing.assert_allclose(stated, np.outer(off, off), rtol=0.1, atol=0.02 * np.abs(off).max() ** 2)
