"""Frames that are halved before a localizer looks at them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from narrowing import not_none
from synthetic import CAMERA, render_room, wobbling_trajectory

from wheelsight.config import load_config
from wheelsight.core.calibration import Calibration
from wheelsight.core.geometry import FloatArray, PinholeCamera, se3
from wheelsight.core.messages import RgbdFrame
from wheelsight.estimation import Localizer
from wheelsight.estimation.localizer import SmallerImages
from wheelsight.vision.features import MatchedPixels

LENS = replace(CAMERA, distortion=(0.1, -0.05, 0.001, -0.002, 0.01))
ROBOT = Calibration.registered_camera(CAMERA, color_sigma_px=0.4)
JUMP = 0.03


def frame_of(camera: PinholeCamera, depth_m: FloatArray, stamp_s: float = 1.0) -> RgbdFrame:
    color = np.zeros((camera.height, camera.width, 3), np.uint8)
    return RgbdFrame(stamp_s, color, depth_m.astype(np.float32))


@pytest.mark.parametrize("times", [1, 2])
def test_a_point_is_seen_where_its_block_of_pixels_is(times: int) -> None:
    points = np.array([[0.3, -0.2, 1.5], [-0.4, 0.3, 2.0], [0.0, 0.0, 1.0]])
    full, _ = LENS.project(points)
    small, _ = LENS.halved(times).project(points)
    # A block's middle lies between its pixels' centres, which are at integers.
    np.testing.assert_allclose((small + 0.5) * 2**times, full + 0.5)


@pytest.mark.parametrize(("most_px", "width"), [(None, 320), (320, 320), (319, 160), (160, 160), (100, 80)])
def test_images_are_halved_until_they_are_no_wider(most_px: int | None, width: int) -> None:
    smaller = SmallerImages(ROBOT, most_px, JUMP)
    frame = smaller.frame(frame_of(CAMERA, np.ones((240, 320))))
    color, depth = smaller.calibration.cameras
    shape = (width * 3 // 4, width)
    assert frame.color.shape[:2] == frame.depth_m.shape == (color.height, color.width) == shape
    assert depth == color
    assert smaller.calibration.color_sigma_px == pytest.approx(0.4 * width / 320)


def test_depth_of_a_slanted_plane_stays_on_it() -> None:
    camera = replace(CAMERA, distortion=(0.0,) * 5)
    normal, off_m = np.array([0.3, 0.1, 1.0]), 2.0
    depth_m = off_m / (camera.rays() @ normal)
    smaller = SmallerImages(Calibration.registered_camera(camera), 160, JUMP)
    half = smaller.frame(frame_of(camera, depth_m)).depth_m
    points = not_none(smaller.calibration.depth).rays() * half[..., None]
    np.testing.assert_allclose(points @ normal, off_m, atol=2e-5)


def test_depth_is_never_between_two_surfaces_and_a_hole_is_not_averaged() -> None:
    rng = np.random.default_rng(3)
    depth_m = rng.choice([0.0, 1.0, 2.0], (240, 320))
    half = SmallerImages(ROBOT, 160, JUMP).frame(frame_of(CAMERA, depth_m)).depth_m
    assert set(np.unique(half)) == {0.0, 1.0, 2.0}
    blocks = depth_m.reshape(120, 2, 160, 2).swapaxes(1, 2).reshape(120, 160, 4)
    nearest = np.where(blocks > 0, blocks, np.inf).min(axis=-1)
    np.testing.assert_array_equal(half, np.where(np.isfinite(nearest), nearest, 0))


def test_a_row_and_a_column_left_over_are_cut_off() -> None:
    camera = PinholeCamera(321, 241, 262.0, 260.0, 161.3, 118.4)
    smaller = SmallerImages(Calibration.registered_camera(camera), 200, JUMP)
    color = np.zeros((241, 321, 3), np.uint8)
    color[:240, :320] = np.repeat(np.arange(120), 2)[:, None, None]
    small = smaller.frame(RgbdFrame(1.0, color, np.ones((241, 321), np.float32)))
    assert small.color.shape == (120, 160, 3)
    np.testing.assert_array_equal(small.color, np.broadcast_to(np.arange(120)[:, None, None], small.color.shape))


def test_two_cameras_are_halved_each_for_itself() -> None:
    color = PinholeCamera(1280, 720, 900.0, 900.0, 640.0, 360.0)
    calibration = Calibration(color=color, depth=CAMERA, T_color_depth=np.eye(4))
    smaller = SmallerImages(calibration, 320, JUMP)
    assert [(camera.width, camera.height) for camera in smaller.calibration.cameras] == [(320, 180), (320, 240)]
    given = RgbdFrame(1.0, np.zeros((720, 1280, 3), np.uint8), np.ones((240, 320), np.float32))
    frame = smaller.frame(given)
    assert frame.color.shape == (180, 320, 3)
    assert frame.depth_m is given.depth_m


@pytest.mark.parametrize("odometry", ["features", "dense"])
def test_a_known_motion_is_found_by_smaller_images(odometry: str) -> None:
    truth = wobbling_trajectory(6)
    config = load_config(overrides={"odometry": odometry, "localizer.most_width_px": 160})
    localizer, answer = Localizer(ROBOT, config), None
    for stamp_s, T in zip(truth.stamps_s, truth.T_frame_body, strict=True):
        answer = localizer.process(RgbdFrame(float(stamp_s), *render_room(T)))
    localizer.close()
    moved = se3.invert(truth.T_frame_body[0]) @ truth.T_frame_body[-1]
    assert np.linalg.norm(moved[:3, 3]) > 0.02
    found = not_none(not_none(answer).T_odom_body)
    assert np.linalg.norm((se3.invert(moved) @ found)[:3, 3]) < 0.006


def test_matched_pixels_are_those_of_the_frames_that_came() -> None:
    truth = wobbling_trajectory(2)
    config = load_config(overrides={"odometry": "features", "localizer.most_width_px": 160})
    localizer = Localizer(ROBOT, config)
    frames = [RgbdFrame(float(s), *render_room(T)) for s, T in zip(truth.stamps_s, truth.T_frame_body, strict=True)]
    for frame in frames:
        localizer.process(frame)
    localizer.close()
    matches = not_none(localizer.last_matches)
    px, reference_px = matches.px[matches.is_inlier], matches.reference_px[matches.is_inlier]
    rows, columns = np.rint(reference_px).astype(int).T[::-1]
    points = CAMERA.back_project(reference_px, frames[0].depth_m[rows, columns])
    T_second_first = se3.invert(truth.T_frame_body[1]) @ truth.T_frame_body[0]
    seen, _ = CAMERA.project(points @ T_second_first[:3, :3].T + T_second_first[:3, 3])
    assert px[:, 0].max() > 200
    assert np.median(np.linalg.norm(seen - px, axis=1)) < 2.0  # a pixel of the smaller image


def test_pixels_of_a_smaller_image_are_those_of_the_full_one() -> None:
    smaller = SmallerImages(ROBOT, 80, JUMP)
    points = np.array([[0.3, -0.2, 1.5], [-0.4, 0.3, 2.0], [0.0, 0.0, 1.0]])
    full, _ = CAMERA.project(points)
    small, _ = not_none(smaller.calibration.color).project(points)
    reported = not_none(smaller.in_full(MatchedPixels(1.0, small, small[::-1], np.ones(3, bool))))
    np.testing.assert_allclose(reported.px, full)
    np.testing.assert_allclose(reported.reference_px, full[::-1])
