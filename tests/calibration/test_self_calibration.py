"""Self-calibration: known errors of a known room come back, σ is honest, and what is not shown is kept."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from self_rooms import LENS, drawn_room, nominal, readings_m
from typer.testing import CliRunner

from wheelsight.app.cli import app
from wheelsight.core.calibration import DepthError, load_calibration, save_calibration
from wheelsight.core.errors import CalibrationError, MapError
from wheelsight.core.geometry import se3
from wheelsight.core.keyframes import Keyframe
from wheelsight.slam.maps import MapFolder
from wheelsight_calibration.cli_self import refuse_if_other
from wheelsight_calibration.self_calibration import calibrate_self, calibrated_by, not_shown
from wheelsight_calibration.self_model import RobotModel, sensor_of
from wheelsight_calibration.self_solver import JointProblem
from wheelsight_calibration.self_views import matched, patches_of

SENSORS_TESTED = ("structured-light", "tof")


def _views(sensor: str, places: list[tuple[float, float, float]]) -> tuple[RobotModel, list[Keyframe], np.ndarray]:
    model = RobotModel.of(nominal(sensor), has_wheels=True, has_gyro=False)
    T = se3.from_plane(*np.array(places).T) @ model.mount(np.zeros(len(model)))
    intrinsics = np.array([LENS.fx, LENS.fy, LENS.cx, LENS.cy])
    exact, grey = np.zeros(len(model)), np.zeros((LENS.height, LENS.width), np.float32)
    depths = [readings_m(model, exact, one).astype(np.float32) for one in T]
    keyframes = [Keyframe.of_images(0.0, intrinsics, depth, grey) for depth in depths]
    return model, keyframes, T


def test_patches_lie_on_the_walls_that_they_show():
    model, keyframes, T = _views("tof", [(2.0, 2.5, 0.3)])
    view = patches_of(keyframes[0], model.calibration)
    in_map, normals = se3.apply(T[0], view.points_m), view.normals @ T[0, :3, :3].T
    off = np.abs(np.concatenate([in_map, in_map - [6.0, 5.0, 2.5]], axis=1)).min(axis=1)
    assert len(view) > 100
    # Depth is kept in steps of 0.2 mm; a cell across a corner may pass for flat.
    assert np.percentile(off, 90) < 5e-4
    assert off.max() < 0.012
    assert np.percentile(1 - np.abs(normals).max(axis=1), 90) < 1e-3


def test_a_depth_error_shows_between_near_and_far_views():
    """A wall seen from two places 2.5 m apart by a camera that reads 1 % long is 25 mm from itself."""
    model, keyframes, T = _views("tof", [(2.0, 2.5, 0.0), (4.5, 2.5, 0.0)])
    far, near = (patches_of(one, model.calibration) for one in keyframes)
    pair = matched((far, near), 1, 0, se3.invert(T[1]) @ T[0], 0.05)
    wall = near.normals[pair.of_first] @ T[1, :3, :3].T @ [-1, 0, 0] > 0.99
    assert np.count_nonzero(wall) > 50
    room = drawn_room("tof", 0, views=12)
    data = replace(room.data, views=(far, near), T_map_camera=T, floors=(), steps=np.zeros((0, 2), np.int64))
    problem, values = JointProblem(model, data, np.ones(len(model), bool)), np.zeros(len(model))
    assert np.median(np.abs(problem.off_m(pair, values, T))[wall]) < 1e-3
    values[model.index("depth_scale")] = 0.01
    off = problem.off_m(pair, values, T)[wall]
    assert np.median(np.abs(off)) == pytest.approx(0.01 * 2.5, rel=0.1)  # 1 % of the 2.5 m between both views


@pytest.mark.parametrize("sensor", SENSORS_TESTED)
def test_displacements_are_those_of_the_file(sensor, rng):
    """First-order displacements equal what the written lens and depth error do to a reading."""
    model = RobotModel.of(nominal(sensor), has_wheels=False, has_gyro=False)
    values = np.zeros(len(model))
    values[: model.camera_count] = 0.02 * np.sqrt(np.diag(model.prior))[: model.camera_count]
    values[: model.camera_count] *= rng.standard_normal(model.camera_count)
    px = rng.uniform((5, 5), (74, 54), (40, 2))
    z = rng.uniform(0.8, 4.0, 40)
    rays = np.concatenate([LENS.normalise(px), np.ones((40, 1))], axis=1)
    found = model.calibrated(values, model.prior)
    _, camera = found.cameras
    written = camera.back_project(px, found.depth_error.of_readings(z, px, camera))
    moved = rays * z[:, None] + model.displacements(rays, z) @ values[: model.camera_count]
    change = np.linalg.norm(written - rays * z[:, None], axis=1)
    # A file's pattern is linear between its knots, and lens and depth are of first order.
    assert np.linalg.norm(written - moved, axis=1).max() < 0.05 * change.max() + 2e-5


def test_depth_error_of_the_file_stands_before_the_change():
    model = RobotModel.of(nominal("structured-light"), has_wheels=False, has_gyro=False)
    rows = ((0.001, 0.002), (0.003, -0.001))
    old = DepthError(scale=1.02, inverse_per_m=0.001, lasting_per_m=rows)
    known = replace(model, calibration=replace(model.calibration, depth_error=old))
    values = np.zeros(len(model))
    values[3], values[4:10] = 0.003, 0.0004
    px, z = np.array([[20.0, 20.0], [60.0, 45.0]]), np.array([1.5, 3.0])
    once = old.of_readings(z, px, LENS)
    rays = np.concatenate([LENS.normalise(px), np.ones((2, 1))], axis=1)
    twice = once + model.depth_changes(rays, once) @ values[: model.camera_count]
    assert known.depth_error(values).of_readings(z, px, LENS) == pytest.approx(twice, abs=3e-4)


@pytest.mark.slow
@pytest.mark.parametrize("sensor", SENSORS_TESTED)
def test_known_errors_come_back_within_sigma(sensor):
    """Values drawn from the prior: errors over σ have about unit size, and depth is nearer to the truth."""
    ratios, before, after = list[float](), list[float](), list[float]()
    distances = np.array([1.0, 2.0, 3.0])
    for seed in range(2):
        room = drawn_room(sensor, seed)
        found = JointProblem(room.model, room.data, np.ones(len(room.model), bool)).fit(room.data.pairs)
        sigmas = np.sqrt(np.diag(found.covariance))
        at = [k for k, name in enumerate(room.model.names) if name in ("roll", "pitch", "height", "centre_y")]
        ratios += np.abs((found.values - room.truth)[at] / sigmas[at]).tolist()
        J, count = room.model.depth_at(distances), room.model.camera_count
        off, C = J @ (found.values - room.truth)[:count], J @ found.covariance[:count, :count] @ J.T
        ratios += np.abs(off / np.sqrt(np.diag(C))).tolist()
        before.append(float(np.abs(J @ room.truth[:count]).max()))
        after.append(float(np.abs(off).max()))
    assert np.mean(np.array(ratios) < 2) > 0.8
    assert max(ratios) < 4
    assert sum(after) < sum(before)


@pytest.mark.slow
def test_turning_alone_shows_neither_scale_nor_where_it_looks():
    room = drawn_room("structured-light", 3, views=24, turns_only=True)
    found = calibrated_by(room.data, room.model)
    kept = {name for names in not_shown(found).values() for name in names} if found.is_better else set(room.model.names)
    assert {"left_radius", "right_radius"} <= kept
    assert found.values[room.model.index("left_radius")] == 0


@pytest.mark.slow
def test_a_camera_moved_on_the_robot_is_refused_with_its_time():
    room = drawn_room("tof", 4, views=24)
    turned = room.truth.copy()
    turned[room.model.index("pitch")] += np.radians(1.5)
    other = drawn_room("tof", 4, views=24, truth=turned)
    half = len(room.data.views) // 2
    mixed = replace(
        room.data,
        views=(*room.data.views[:half], *other.data.views[half:]),
        floors=(*room.data.floors[:half], *other.data.floors[half:]),
    )
    with pytest.raises(CalibrationError, match="camera was moved") as refused:
        calibrated_by(mixed, room.model)
    assert " s after the start" in str(refused.value)


def test_few_pairs_are_refused():
    room = drawn_room("tof", 0, views=6)
    with pytest.raises(CalibrationError, match="pairs of views share surfaces"):
        calibrated_by(replace(room.data, pairs=room.data.pairs[:10]), room.model)


def test_sensor_is_read_from_noise_and_known_errors():
    assert sensor_of(nominal("structured-light")) == "structured-light"
    assert sensor_of(nominal("tof")) == "tof"
    mixed = replace(nominal("tof"), depth_error=DepthError(offset_m=0.01, inverse_per_m=0.001))
    with pytest.raises(CalibrationError, match="mixes"):
        sensor_of(mixed)


def test_a_map_without_keyframes_and_a_missing_one_are_refused(tmp_path):
    MapFolder.create(tmp_path / "map", nominal("tof")).close()
    with pytest.raises(MapError, match="has no keyframes"):
        calibrate_self(tmp_path / "map")
    with pytest.raises(MapError, match="no such folder"):
        calibrate_self(tmp_path / "missing")


def test_a_map_of_another_robot_is_refused():
    ours = nominal("tof")
    other = replace(ours, color=replace(LENS, fx=80.0), depth=replace(LENS, fx=80.0))
    refuse_if_other(ours, ours, Path("robot.yaml"))
    with pytest.raises(CalibrationError, match="has another camera"):
        refuse_if_other(ours, other, Path("robot.yaml"))


def test_options_of_from_alone_are_refused(tmp_path):
    file = tmp_path / "robot.yaml"
    save_calibration(nominal("tof"), file)
    before = file.read_bytes()
    result = CliRunner().invoke(app, ["calibrate", "robot", str(file), "--force"])
    assert result.exit_code != 0
    assert file.read_bytes() == before
    assert load_calibration(file).wheels is not None
