from __future__ import annotations

import numpy as np
import pytest
from odometry.plain_kernels import plain

from wheelsight.core.geometry import PinholeCamera, se3
from wheelsight.vision import image_kernels as compiled

DEPTH = PinholeCamera(160, 120, 140.0, 142.0, 81.3, 58.4)
COLOR = PinholeCamera(200, 150, 190.0, 188.0, 98.2, 76.1)
T_COLOR_DEPTH = se3.exp(np.array([-0.03, 0.005, 0.002, 0.01, -0.02, 0.015]))
NEAR_M, FAR_M, JUMP = 0.3, 5.0, 0.05
in_python = plain(compiled)


def plane_depth(camera: PinholeCamera, normal: np.ndarray, distance_m: float) -> np.ndarray:
    """Depth image (H, W) of the plane n·p = d in the camera's frame."""
    return (distance_m / (camera.rays() @ normal)).astype(np.float32)


def depth_at(depth_m, px, camera=DEPTH, T_color_depth=None, kernels=compiled):
    T = np.eye(4) if T_color_depth is None else T_color_depth
    px = np.asarray(px, float).reshape(-1, 2)
    intrinsics = np.array([DEPTH.fx, DEPTH.fy, DEPTH.cx, DEPTH.cy])
    R, t = np.ascontiguousarray(T[:3, :3]), T[:3, 3].copy()
    xy = camera.normalise(px)
    image = compiled.DepthImage(depth_m, R, t, intrinsics, T_color_depth is None, NEAR_M, FAR_M, JUMP)
    return kernels.depth_at_keypoints(image, px, xy)


def pixels(rng: np.random.Generator, camera: PinholeCamera, margin: float, n: int = 300) -> np.ndarray:
    return rng.uniform(margin, (camera.width - margin, camera.height - margin), (n, 2))


def test_registered_depth_is_read_between_pixels(rng):
    normal, distance_m = np.array([0.15, -0.1, 1.0]), 2.0
    px = pixels(rng, DEPTH, 3)
    expected = distance_m / (np.column_stack([DEPTH.normalise(px), np.ones(len(px))]) @ normal)
    # Inverse depth is linear over a plane's image, depth nearly: within a thousandth over one pixel.
    np.testing.assert_allclose(depth_at(plane_depth(DEPTH, normal, distance_m), px), expected, atol=1e-4)


def test_a_ramp_is_read_exactly(rng):
    u, v = np.meshgrid(np.arange(160.0), np.arange(120.0))
    px = pixels(rng, DEPTH, 3)
    depth_m = 2 + 0.001 * u - 0.0005 * v
    np.testing.assert_allclose(depth_at(depth_m, px), 2 + px @ (0.001, -0.0005), atol=1e-12)


def test_unregistered_depth_is_where_the_colour_ray_meets_the_surface(rng):
    normal, distance_m = np.array([0.2, -0.15, 1.0]), 1.8
    px = pixels(rng, COLOR, 25)
    R, t = T_COLOR_DEPTH[:3, :3], T_COLOR_DEPTH[:3, 3]
    normal_color = R @ normal
    rays = np.column_stack([COLOR.normalise(px), np.ones(len(px))])
    expected = (distance_m + normal_color @ t) / (rays @ normal_color)
    got = depth_at(plane_depth(DEPTH, normal, distance_m), px, COLOR, T_COLOR_DEPTH)
    assert (got > 0).all()
    np.testing.assert_allclose(got, expected, atol=2e-4)


@pytest.mark.parametrize("T_color_depth", [None, T_COLOR_DEPTH])
def test_depth_at_keypoints_in_plain_python(rng, T_color_depth):
    depth_m = plane_depth(DEPTH, np.array([0.2, -0.15, 1.0]), 1.8)
    depth_m[rng.random(depth_m.shape) < 0.01] = 0
    px = pixels(rng, COLOR, 1, 100)
    got = depth_at(depth_m, px, COLOR, T_color_depth)
    assert 0.1 < np.mean(got > 0) < 0.95
    np.testing.assert_allclose(depth_at(depth_m, px, COLOR, T_color_depth, in_python), got, rtol=1e-6)


def test_holes_beside_a_keypoint_refuse_it():
    depth_m = np.full((120, 160), 2.0, np.float32)
    depth_m[60, 80] = 0
    around = np.array([(u, v) for u in np.arange(77.5, 84) for v in np.arange(57.5, 64)])
    beside = (np.abs(around - (80, 60)) < 2).all(axis=1)
    got = depth_at(depth_m, around)
    assert (got[beside] == 0).all()
    np.testing.assert_allclose(got[~beside], 2.0)
    assert np.count_nonzero(~beside) > 10


def test_keypoints_on_an_object_s_edge_are_refused():
    depth_m = np.full((120, 160), 2.0, np.float32)
    depth_m[:, 80:] = 1.5
    u = np.arange(70, 90) + 0.25
    got = depth_at(depth_m, np.column_stack([u, np.full(20, 60.5)]))
    np.testing.assert_array_equal(got, np.where(u < 78, 2.0, np.where(u > 81, 1.5, 0.0)))


def test_a_step_within_the_jump_is_a_surface():
    depth_m = np.full((120, 160), 2.0, np.float32)
    depth_m[:, 80:] = 2.0 * (1 + 0.9 * JUMP)
    assert depth_at(depth_m, (79.5, 60.5))[0] == pytest.approx(2.0 * (1 + 0.45 * JUMP), rel=1e-6)


@pytest.mark.parametrize("px", [(0.9, 50), (50, 0.9), (158, 50), (50, 118), (-5, 50), (1e6, 50), (50, -1e6)])
def test_the_image_s_border_and_what_lies_beyond_have_no_depth(px):
    depth_m = np.full((120, 160), 2.0, np.float32)
    assert depth_at(depth_m, px)[0] == 0
    assert depth_at(depth_m, (1, 1))[0] == 2
    assert depth_at(depth_m, (157.9, 117.9))[0] == pytest.approx(2)


@pytest.mark.parametrize(("metres", "expected"), [(0.25, 0.0), (0.35, 0.35), (4.9, 4.9), (5.2, 0.0)])
@pytest.mark.parametrize("T_color_depth", [None, np.eye(4)])
def test_depth_out_of_the_sensor_s_range_is_not_trusted(metres, expected, T_color_depth):
    depth_m = np.full((120, 160), metres, np.float32)
    assert depth_at(depth_m, (80.5, 60.5), DEPTH, T_color_depth)[0] == pytest.approx(expected)


def box_before_a_wall(camera: PinholeCamera, T_camera_depth: np.ndarray) -> np.ndarray:
    """Depth (H, W) of a square board at 1 m, 0.4 m wide, before a wall at 2.5 m; both upright in the depth frame."""
    origin = se3.invert(T_camera_depth)[:3, 3]
    rays = camera.rays() @ T_camera_depth[:3, :3]
    to_board, to_wall = ((z - origin[2]) / rays[..., 2] for z in (1.0, 2.5))
    at = origin + rays * to_board[..., None]
    return np.where((np.abs(at[..., :2]) < 0.2).all(axis=-1), to_board, to_wall).astype(np.float32)


# A ray that grazes the board crosses the wall behind a second time, where the depth camera sees it; beside the edge,
# where the board's own depth is refused, that is found instead. It is rare, and RANSAC casts such pairs out.
@pytest.mark.parametrize("apart_m", [0.025, -0.025, -0.06, 0.12, -0.2])
def test_unregistered_depth_at_edges_is_right_or_refused(apart_m):
    T_color_depth = se3.exp(np.array([apart_m, 0.0, 0.0, 0.0, 0.0, 0.0]))
    seen = box_before_a_wall(COLOR, T_color_depth)
    depth_m = box_before_a_wall(DEPTH, np.eye(4))
    u, v = np.meshgrid(np.arange(30, 170), np.arange(30, 120))
    got = depth_at(depth_m, np.column_stack([u.ravel(), v.ravel()]), COLOR, T_color_depth).reshape(u.shape)
    answered = got > 0
    wrong = answered & (np.abs(got - seen[v, u]) > 0.02)
    assert answered.mean() > 0.75
    assert wrong.mean() < 0.02


def test_points_behind_the_depth_camera_have_no_depth(rng):
    turned_back = se3.exp(np.array([0, 0, 0, 0, np.pi, 0]))
    depth_m = np.full((120, 160), 2.0, np.float32)
    assert (depth_at(depth_m, pixels(rng, COLOR, 10), COLOR, turned_back) == 0).all()
