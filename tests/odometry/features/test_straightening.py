"""Rolling shutters: rows exposed one after another while the camera moves."""

from __future__ import annotations

import numpy as np
import pytest
from odometry.views import error_of, from_start
from synthetic import CAMERA, render_room

from wheelsight.core.calibration import Calibration
from wheelsight.core.geometry import se3, so3
from wheelsight.core.messages import RgbdFrame
from wheelsight.core.trajectory import Trajectory
from wheelsight.vision.features import FeatureOdometry, FeatureSettings
from wheelsight.vision.features.tracking import Features, straighten

SHUTTER_S = 0.03
TWIST = np.array([0.4, -0.2, 0.3, 0.5, 1.2, -0.4])


def features_of(px: np.ndarray, depth_m: np.ndarray) -> Features:
    n = len(px)
    words, level = np.zeros((n, 4), np.uint64), np.zeros(n, int)
    return Features(0.0, px, level, words, CAMERA.normalise(px), depth_m, np.ones(n), np.full(n, 0.01))


def rolling(points: np.ndarray, twist: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Pixels (N, 2) and depths (N,) of points (N, 3), of the middle row's time, each seen when its row was exposed."""
    p = points
    for _ in range(30):
        px, _ = CAMERA.project(p)
        late_s = (px[:, 1] / CAMERA.height - 0.5) * SHUTTER_S
        T_late_middle = se3.invert(se3.exp(late_s[:, None] * twist))
        p = se3.apply(T_late_middle, points[:, None])[:, 0]
    return CAMERA.project(p)[0], p[:, 2]


@pytest.fixture
def points(rng) -> np.ndarray:
    px = rng.uniform(20, (300, 220), (200, 2))
    return CAMERA.back_project(px, rng.uniform(0.8, 4, 200))


def test_straightened_keypoints_lie_where_a_global_shutter_sees_them(points):
    expected = CAMERA.normalise(CAMERA.project(points)[0])
    raw = features_of(*rolling(points, TWIST))
    straight = straighten(raw, TWIST, SHUTTER_S, CAMERA.height)
    before, after = (np.linalg.norm(f.xy - expected, axis=1) * CAMERA.fx for f in (raw, straight))
    assert before.max() > 4
    assert after.max() < 0.02 * before.max()
    assert after.max() < 0.15
    np.testing.assert_allclose(straight.depth_m, points[:, 2], atol=1e-3)
    np.testing.assert_array_equal(straight.px, raw.px)


def test_the_wrong_way_round_would_be_worse(points):
    expected = CAMERA.normalise(CAMERA.project(points)[0])
    raw = features_of(*rolling(points, TWIST))
    wrong = straighten(raw, -TWIST, SHUTTER_S, CAMERA.height)
    before, after = (np.linalg.norm(f.xy - expected, axis=1) for f in (raw, wrong))
    assert (after > 1.8 * before).mean() > 0.9


def test_keypoints_without_depth_turn_with_the_camera(points):
    turn = np.concatenate([np.zeros(3), TWIST[3:]])
    px, _ = rolling(points, turn)
    straight = straighten(features_of(px, np.zeros(len(px))), turn, SHUTTER_S, CAMERA.height)
    assert not straight.has_depth.any()
    off_px = np.linalg.norm(straight.xy - CAMERA.normalise(CAMERA.project(points)[0]), axis=1) * CAMERA.fx
    assert off_px.max() < 0.15


@pytest.mark.parametrize(("twist", "shutter_s"), [(np.zeros(6), SHUTTER_S), (TWIST, 0.0)])
def test_nothing_is_straightened_where_nothing_is_bent(points, twist, shutter_s):
    raw = features_of(*CAMERA.project(points)[:1], points[:, 2])
    assert straighten(raw, twist, shutter_s, CAMERA.height) is raw


def test_the_middle_row_is_the_stamp_s():
    raw = features_of(np.array([[40.0, 120.0], [300.0, 120.0]]), np.array([1.0, 2.0]))
    np.testing.assert_allclose(straighten(raw, TWIST, SHUTTER_S, CAMERA.height).xy, raw.xy, atol=1e-12)


def test_twist_between_is_the_velocity_of_a_small_step(rng):
    T = se3.exp(rng.standard_normal(6))
    now = T @ se3.exp(0.001 * TWIST)
    np.testing.assert_allclose(se3.twist_between(T, now, 0.001), TWIST, rtol=2e-3, atol=1e-3)


def test_twist_between_is_exact_where_the_camera_does_not_turn_or_does_not_move(rng):
    T = se3.exp(rng.standard_normal(6))
    for part in (slice(0, 3), slice(3, 6)):
        twist = np.zeros(6)
        twist[part] = TWIST[part]
        np.testing.assert_allclose(se3.twist_between(T, T @ se3.exp(0.1 * twist), 0.1), twist, atol=1e-9)


def rolling_frame(truth: Trajectory, stamp_s: float, bands: int = 24) -> RgbdFrame:
    """The room by a rolling shutter: each band of rows from where the camera is at the band's own time."""
    color, depth_m = np.zeros((240, 320, 3), np.uint8), np.zeros((240, 320), np.float32)
    rows = 240 // bands
    for first in range(0, 240, rows):
        band = slice(first, first + rows)
        late_s = ((first + (rows - 1) / 2) / 240 - 0.5) * SHUTTER_S
        color[band], depth_m[band] = render_room(truth.at([stamp_s + late_s])[0], rows=(first, first + rows))
    return RgbdFrame(stamp_s, color, depth_m)


@pytest.fixture(scope="module", params=[0, 3], ids=["from a standstill", "already turning"])
def swing(request: pytest.FixtureRequest) -> tuple[list[RgbdFrame], np.ndarray]:
    """Frames of a camera that swings to and fro at up to 2 rad/s, and its poses (N, 4, 4) from the first."""
    stamps = 10 + np.arange(-6, 78) / 180
    turn = 0.35 * (1 - np.cos(6 * (stamps - 10)))
    zero = np.zeros_like(turn)
    R = so3.exp(np.stack([zero, zero, turn], axis=-1)) @ np.array([[0.0, 0, 1], [-1, 0, 0], [0, -1, 0]])
    truth = Trajectory(stamps, se3.from_parts(R, np.array([-1.2, 0.0, 1.2]) + 0 * zero[:, None]))
    frames = [rolling_frame(truth, stamp) for stamp in stamps[6:-6:6][request.param :]]
    return frames, from_start(truth.at([frame.stamp_s for frame in frames]))


@pytest.mark.parametrize("reference", ["keyframes", "previous"])
def test_fast_turns_are_followed_better_with_the_shutter_known(swing, reference):
    frames, world = swing
    rms = []
    for shutter_s in (SHUTTER_S, 0.0):
        calibration = Calibration.registered_camera(CAMERA, rolling_shutter_s=shutter_s)
        subject = FeatureOdometry(calibration, FeatureSettings(reference=reference))
        apart = [error_of(subject.process(frame), truth) for frame, truth in zip(frames, world, strict=True)]
        rms.append(np.sqrt(np.mean(np.square(apart), axis=0)))
    assert (rms[0] < 0.5 * rms[1]).all()
