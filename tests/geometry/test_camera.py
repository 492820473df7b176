"""The pinhole camera with Brown distortion, against OpenCV and its own inverse."""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from synthetic import undistorted_by_opencv

from wheelsight.core.errors import CalibrationError
from wheelsight.core.geometry import PinholeCamera

PLAIN = PinholeCamera(640, 480, 525.0, 524.0, 319.5, 239.5)
FREIBURG1 = PinholeCamera(640, 480, 517.3, 516.5, 318.6, 255.3, (0.2624, -0.9531, -0.0054, 0.0026, 1.1633))
FREIBURG2 = PinholeCamera(640, 480, 520.9, 521.0, 325.1, 249.7, (0.2312, -0.7849, -0.0033, -0.0001, 0.9172))
BARREL = PinholeCamera(1280, 720, 700.0, 700.0, 640.0, 360.0, (-0.28, 0.07, 0.001, 0.001, 0.0))
CAMERAS = [PLAIN, FREIBURG1, FREIBURG2, BARREL]
NAMES = ["plain", "freiburg1", "freiburg2", "barrel"]

each_camera = pytest.mark.parametrize("camera", CAMERAS, ids=NAMES)


def image_grid(camera: PinholeCamera, step: float = 16.0) -> np.ndarray:
    """Pixels (N, 2) all over the image, with its outermost edges and corners."""
    u = np.append(np.arange(-0.5, camera.width - 0.5, step), camera.width - 0.5 - 1e-9)
    v = np.append(np.arange(-0.5, camera.height - 0.5, step), camera.height - 0.5 - 1e-9)
    return np.stack(np.meshgrid(u, v), axis=-1).reshape(-1, 2)


@each_camera
def test_projection_is_opencvs(camera: PinholeCamera, rng: np.random.Generator) -> None:
    p = camera.back_project(image_grid(camera), rng.uniform(0.3, 8.0, len(image_grid(camera))))
    expected, _ = cv2.projectPoints(p, np.zeros(3), np.zeros(3), camera.K, np.array(camera.distortion))
    np.testing.assert_allclose(camera.project(p)[0], expected[:, 0], atol=1e-9)


@each_camera
def test_undistortion_is_opencvs(camera: PinholeCamera) -> None:
    px = image_grid(camera)
    expected = undistorted_by_opencv(px, camera.K, np.array(camera.distortion))
    np.testing.assert_allclose(camera.normalise(px), expected[:, 0], atol=1e-9)


@each_camera
def test_projection_undoes_back_projection_up_to_the_corners(camera: PinholeCamera, rng: np.random.Generator) -> None:
    px = image_grid(camera)
    seen_px, is_visible = camera.project(camera.back_project(px, rng.uniform(0.3, 8.0, len(px))))
    np.testing.assert_allclose(seen_px, px, atol=1e-6)
    assert is_visible[(px > -0.4).all(axis=1) & (px < [camera.width - 0.6, camera.height - 0.6]).all(axis=1)].all()


@given(st.floats(-0.4, 0.4), st.floats(-0.3, 0.3), st.floats(0.01, 100))
def test_back_projection_undoes_projection(x: float, y: float, z: float) -> None:
    p_camera = np.array([x * z, y * z, z])
    for camera in CAMERAS:
        px, is_visible = camera.project(p_camera)
        assert is_visible
        np.testing.assert_allclose(camera.back_project(px, z), p_camera, rtol=1e-9, atol=1e-9 * z)


def test_a_known_pixel() -> None:
    camera = PinholeCamera(640, 480, 500.0, 400.0, 320.0, 240.0)
    np.testing.assert_allclose(camera.back_project([370.0, 200.0], 2.0), [0.2, -0.2, 2.0], atol=1e-15)
    np.testing.assert_allclose(camera.project([0.2, -0.2, 2.0])[0], [370.0, 200.0], atol=1e-12)


def test_what_is_not_in_front_has_no_pixel() -> None:
    px, is_visible = FREIBURG1.project([[0, 0, -1.0], [0, 0, 0.0], [0.1, 0.1, np.nan], [0, 0, 1.0]])
    assert np.isnan(px[:3]).all()
    assert is_visible.tolist() == [False, False, False, True]


def test_the_image_ends_half_a_pixel_beyond_the_outermost_centres() -> None:
    edges_px = np.array([[-0.49, 100], [-0.51, 100], [639.49, 100], [639.51, 100], [100, -0.51], [100, 479.49]])
    _, is_visible = PLAIN.project(PLAIN.back_project(edges_px, np.ones(6)))
    assert is_visible.tolist() == [True, False, True, False, False, True]


@each_camera
def test_rays_times_depth_are_points(camera: PinholeCamera) -> None:
    rays = camera.rays()
    assert rays.shape == (camera.height, camera.width, 3)
    np.testing.assert_allclose(2.5 * rays[7, 11], camera.back_project([11.0, 7.0], 2.5), atol=1e-15)


@pytest.mark.parametrize("shape", [(), (0,), (5,), (2, 3)])
def test_batches_are_loops(shape: tuple[int, ...], rng: np.random.Generator) -> None:
    px, depth_m = rng.uniform(0, 400, (*shape, 2)), rng.uniform(0.5, 4, shape)
    p = FREIBURG1.back_project(px, depth_m)
    seen_px, is_visible = FREIBURG1.project(p)
    assert p.shape == (*shape, 3)
    assert seen_px.shape == px.shape
    assert is_visible.shape == shape
    for index in np.ndindex(*shape):
        np.testing.assert_allclose(p[index], FREIBURG1.back_project(px[index], depth_m[index]), atol=1e-15)
        np.testing.assert_allclose(seen_px[index], FREIBURG1.project(p[index])[0], atol=1e-12)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"fx": 0.0}, "must be positive"),
        ({"fy": -500.0}, "must be positive"),
        ({"width": 0}, "must be positive"),
        ({"cx": np.nan}, "finite"),
        ({"cx": 5000.0}, "far outside the image"),
        ({"distortion": (0.1, 0.2)}, "five numbers"),
        ({"distortion": (0.1, np.inf, 0, 0, 0)}, "finite"),
    ],
)
def test_no_camera_has_such_values(changes: dict[str, Any], message: str) -> None:
    values: dict[str, Any] = {"width": 640, "height": 480, "fx": 525.0, "fy": 525.0, "cx": 319.5, "cy": 239.5}
    with pytest.raises(CalibrationError, match=message):
        PinholeCamera(**(values | changes))


def test_equal_cameras_are_equal_however_their_distortion_was_given() -> None:
    in_a_list: Any = list(FREIBURG1.distortion)
    lists = PinholeCamera(640, 480, 517.3, 516.5, 318.6, 255.3, in_a_list)
    assert lists == FREIBURG1
    assert hash(lists) == hash(FREIBURG1)


@pytest.mark.parametrize(
    ("focal_px", "distortion", "fault"),
    [
        (517.0, (0.2624, -0.9531, -0.0054, 0.0026, 1.1633), None),  # freiburg1, the strongest that is known to be right
        (450.0, (-0.4, 0.15, 0, 0, 0), None),
        (6400.0, (-5, 200, 0, 0, 0), None),  # a long lens
        (500.0, (-0.6, 0, 0, 0, 0), "folds"),
        (586.0, (1389, -512, 103, 1420, -480), "folds"),
        (586.0, (1389, -512, 0, 0, 0), "stretches"),
    ],
)
def test_a_lens_that_folds_or_stretches_within_its_image_has_a_fault(focal_px, distortion, fault) -> None:
    found = PinholeCamera(640, 480, focal_px, focal_px, 319.5, 239.5, distortion).lens_fault()
    assert (found is None) == (fault is None)
    assert fault is None or fault in str(found)


def test_a_lens_folds_where_its_radius_no_longer_grows() -> None:
    """r (1 - 0.6 r²) is largest at r² = 1 / 1.8, where it is 2/3 r = 0.497: beyond that circle nothing is shown."""
    camera = PinholeCamera(1000, 1000, 500.0, 500.0, 499.5, 499.5, (-0.6, 0, 0, 0, 0))
    border = np.linspace(0, 2 * np.pi, 3600, endpoint=False)
    far = 1 / np.maximum(np.abs(np.cos(border)), np.abs(np.sin(border)))
    lost = np.mean(1 - (0.4969 / far) ** 2)
    assert f"{100 * lost:.0f} %" in str(camera.lens_fault())
