from __future__ import annotations

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from odometry.views import covered_frame, room_frame
from synthetic import CAMERA, wobbling_trajectory

from wheelsight.core.calibration import Calibration
from wheelsight.core.calibration_parts import DepthNoise
from wheelsight.core.geometry import PinholeCamera
from wheelsight.core.messages import RgbdFrame
from wheelsight.vision.features.tracking import FeatureExtractor, Features, FeatureSettings, spread

T_WORLD_CAMERA = wobbling_trajectory(1).T_frame_body[0]


def extract(frame: RgbdFrame, calibration: Calibration | None = None, **settings: object) -> Features:
    calibration = calibration or Calibration.registered_camera(CAMERA)
    return FeatureExtractor(calibration, FeatureSettings(**settings)).extract(frame)


@pytest.fixture(scope="module")
def view() -> RgbdFrame:
    return room_frame(T_WORLD_CAMERA, 5.0)


def test_what_a_frame_s_features_are(view):
    features = extract(view, keypoints=400)
    assert features.stamp_s == 5.0
    assert len(features) == 400
    assert features.descriptors.shape == (400, 4)
    assert features.descriptors.dtype == np.uint64
    np.testing.assert_allclose(features.xy, CAMERA.normalise(features.px))
    assert (features.px >= 0).all()
    assert (features.px < (CAMERA.width, CAMERA.height)).all()


def test_descriptors_are_opencv_s_at_those_keypoints(view, monkeypatch):
    monkeypatch.setattr("wheelsight.vision.features.tracking.PYRAMID_LEVELS", 1)
    features = extract(view)
    orb = cv2.ORB.create(nlevels=1)
    keypoints = orb.detect(cv2.cvtColor(view.color, cv2.COLOR_RGB2GRAY), None)
    keypoints, words = orb.compute(cv2.cvtColor(view.color, cv2.COLOR_RGB2GRAY), keypoints)
    ours = {tuple(px): word.tobytes() for px, word in zip(features.px, features.descriptors, strict=True)}
    theirs = {keypoint.pt: word.tobytes() for keypoint, word in zip(keypoints, words, strict=True)}
    common = ours.keys() & theirs.keys()
    assert len(common) > 100
    assert all(ours[px] == theirs[px] for px in common)


def test_depth_is_the_surface_s_at_the_keypoint(view):
    features = extract(view)
    assert 0.6 < features.has_depth.mean() < 1
    np.testing.assert_array_equal(features.has_depth, features.depth_m > 0)
    u, v = np.rint(features.px[features.has_depth]).astype(int).T
    np.testing.assert_allclose(features.depth_m[features.has_depth], view.depth_m[v, u], rtol=0.03)
    p = features.points
    np.testing.assert_array_equal(p[:, 2], features.depth_m)
    assert (p[~features.has_depth] == 0).all()
    lifted = CAMERA.back_project(features.px, features.depth_m)
    np.testing.assert_allclose(p, lifted, atol=1e-12)


def test_lens_distortion_is_taken_out():
    bent = PinholeCamera(320, 240, 262.0, 260.0, 161.3, 118.4, (0.2, -0.4, 0.002, -0.003, 0.1))
    features = extract(room_frame(T_WORLD_CAMERA, 0.0), Calibration.registered_camera(bent))
    np.testing.assert_allclose(bent.denormalise(features.xy), features.px, atol=1e-6)
    assert np.abs(features.xy - CAMERA.normalise(features.px)).max() > 0.01


def test_coarser_keypoints_are_less_certain(view):
    features = extract(view)
    levels = np.unique(features.level)
    assert levels.tolist() == list(range(8))
    sigma = np.array([features.sigma_px[features.level == level].max() for level in levels])
    least = np.array([features.sigma_px[features.level == level].min() for level in levels])
    np.testing.assert_array_equal(sigma, least)
    assert (np.diff(sigma) > 0).all()


def test_the_camera_s_own_uncertainty_adds_to_the_keypoints(view):
    exact = extract(view)
    nominal = extract(view, Calibration.registered_camera(CAMERA, color_sigma_px=0.8))
    np.testing.assert_allclose(nominal.sigma_px**2, exact.sigma_px**2 + 0.64)


def test_depth_is_as_uncertain_as_the_sensor_says(view):
    noise = DepthNoise(constant_m=0.002, quadratic_per_m=0.003, near_m=1.5, far_m=3.0)
    features = extract(view, Calibration.registered_camera(CAMERA, depth_noise=noise))
    z = features.depth_m[features.has_depth]
    np.testing.assert_allclose(features.sigma_m[features.has_depth], 0.002 + 0.003 * z**2)
    assert z.min() >= 1.5
    assert z.max() <= 3.0


@pytest.mark.parametrize("camera", [CAMERA, PinholeCamera(640, 480, 520.0, 520.0, 319.5, 239.5)])
@pytest.mark.parametrize("axis", [0, 1])
def test_a_mirrored_image_has_mirrored_keypoints_on_every_level(camera, axis):
    """OpenCV's pyramid places them by powers of 1.2 from the first pixel's corner, which is neither half a level's
    pixel right nor, since a level has a whole number of pixels, right at the far edge: up to 2.5 px and 1.4 px."""
    view = room_frame(T_WORLD_CAMERA, 0.0, camera)
    color, depth_m = np.flip(view.color, 1 - axis), np.flip(view.depth_m, 1 - axis)
    mirrored = RgbdFrame(0.0, np.ascontiguousarray(color), np.ascontiguousarray(depth_m))
    calibration = Calibration.registered_camera(camera)
    here, there = (extract(f, calibration, keypoints=5000, candidates=5000) for f in (view, mirrored))
    px = there.px.copy()
    px[:, axis] = view.color.shape[1 - axis] - 1 - px[:, axis]
    for level in range(6):
        ours, theirs = here.px[here.level == level], px[there.level == level]
        nearest = np.linalg.norm(ours[:, None] - theirs[None], axis=2).min(axis=1)
        assert len(ours) > 50
        assert np.median(nearest) < 1e-3, f"level {level}"


@pytest.mark.parametrize("scale", [2.0, 3.5])
def test_the_corners_of_squares_lie_around_their_centres_on_every_level(scale):
    """Whole level pixels leave some noise; half a level's pixel of bias would be 0.74 px at the coarsest."""
    rng = np.random.default_rng(4)
    side = 14 * scale
    centres = np.array([(u, v) for u in np.arange(90, 560, 90) for v in np.arange(90, 400, 90)]) + rng.random((24, 2))
    grey = np.full((480, 640), 100, np.uint8)
    for u, v in centres:
        corners = np.array([(-1, -1), (1, -1), (1, 1), (-1, 1)]) * side / 2 + (u, v)
        cv2.fillConvexPoly(grey, np.rint(corners * 1024).astype(int), 220, cv2.LINE_AA, 10)
    frame = RgbdFrame(0.0, np.repeat(grey[..., None], 3, axis=2), np.full(grey.shape, 2, np.float32))
    camera = PinholeCamera(640, 480, 525.0, 525.0, 320.0, 240.0)
    features = extract(frame, Calibration.registered_camera(camera), keypoints=5000, candidates=5000)
    for level in range(6):
        px = features.px[features.level == level]
        off = []
        for centre in centres:
            around = px[np.abs(px - centre).max(axis=1) < 0.75 * side]
            corner = ((around > centre) @ (1, 2)).astype(int)
            if len(set(corner.tolist())) == 4:
                off.append(np.mean([around[corner == c].mean(axis=0) for c in range(4)], axis=0) - centre)
        assert len(off) > 10, f"level {level}"
        assert np.abs(np.mean(off, axis=0)).max() < 0.45, f"level {level}"


def test_keypoints_are_spread_over_the_image(view, monkeypatch):
    monkeypatch.setattr("wheelsight.vision.features.tracking._SPREAD_CELL_PX", 40)
    features = extract(view, keypoints=300, candidates=3000)
    grey = cv2.cvtColor(view.color, cv2.COLOR_RGB2GRAY)
    strongest = sorted(cv2.ORB.create(3000, fastThreshold=20).detect(grey, None), key=lambda k: -k.response)[:300]

    def cells(px: np.ndarray) -> int:
        return len({tuple(cell) for cell in (px // 40).astype(int).tolist()})

    inside = (320 // 40 - 2) * (240 // 40 - 2)
    assert cells(features.px) >= inside
    assert cells(features.px) > 1.15 * cells(np.array([k.pt for k in strongest]))


@given(seed=st.integers(0, 1000), wanted=st.integers(1, 120))
def test_spread_takes_the_strongest_of_each_cell_in_turn(seed, wanted):
    rng = np.random.default_rng(seed)
    px, strength = rng.uniform(0, (150, 100), (90, 2)), rng.permutation(90).astype(float)
    chosen = spread(px, strength, 50, wanted)
    assert len(chosen) == len(set(chosen.tolist())) == min(wanted, 90)
    rank = np.empty(90, int)
    cell = (px // 50).astype(int)
    for i in range(90):
        rank[i] = np.count_nonzero((cell == cell[i]).all(axis=1) & (strength > strength[i]))
    left = np.setdiff1d(np.arange(90), chosen)
    if len(left):
        kept, lost = rank[chosen].max(), rank[left].min()
        assert kept <= lost
        tied_kept, tied_left = (strength[which[rank[which] == kept]] for which in (chosen, left))
        assert not len(tied_left) or tied_kept.min() > tied_left.max()


def test_a_dull_image_falls_back_to_faint_corners(view, monkeypatch):
    dull = RgbdFrame(0.0, (110 + 0.12 * (view.color.astype(float) - 128)).astype(np.uint8), view.depth_m)
    features = extract(dull)
    monkeypatch.setattr("wheelsight.vision.features.tracking._FAINT_THRESHOLD", 20)
    without = extract(dull)
    assert len(features) > 1.5 * len(without)
    assert len(features) >= 100


@pytest.mark.parametrize("grey", [0, 128, 255])
def test_a_bare_wall_has_no_features(grey):
    frame = RgbdFrame(1.0, np.full((240, 320, 3), grey, np.uint8), np.full((240, 320), 2, np.float32))
    features = extract(frame)
    assert len(features) == 0
    assert features.points.shape == (0, 3)
    assert features.descriptors.shape == (0, 4)
    assert features.sigma_px.shape == (0,)


def test_without_depth_there_are_keypoints_but_no_points(view):
    features = extract(RgbdFrame(0.0, view.color, covered_frame(0.0).depth_m))
    assert len(features) > 300
    assert not features.has_depth.any()
    assert np.isfinite(features.sigma_m).all()


@pytest.mark.parametrize("size", [(24, 32), (60, 80), (97, 131)])
def test_a_small_image_is_no_error(size, rng):
    camera = PinholeCamera(size[1], size[0], 100.0, 100.0, size[1] / 2, size[0] / 2)
    color = rng.integers(0, 255, (*size, 3), np.uint8)
    features = extract(RgbdFrame(0.0, color, np.full(size, 2, np.float32)), Calibration.registered_camera(camera))
    assert len(features.px) == len(features.descriptors) == len(features.depth_m)
