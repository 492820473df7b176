"""What frame and reference both show: against products written out, and of noise that shows nothing."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose
from odometry.dense.scenes import Plane, bench, frame_of

from wheelsight.core.geometry import se3
from wheelsight.vision.dense import alignment_kernels as shown
from wheelsight.vision.dense.alignment import symmetric
from wheelsight.vision.image_kernels import ALONG_U, ALONG_V, DEPTH, GREY, NX, OFFSET

NOISE = np.array([1e-3, 2e-3, 0.1, 9.0])
# Gate, scale of plane residuals, σ of grey, gain, Huber's limit, weight of grey, σ of the colour camera's place.
HOW = np.array([0.06, 1.3, 8.0, 1.1, 1.5, 0.7, 0.2])
GRID = np.array([50.0, 52.0, 15.5, 11.5])
DEPTH_M = 2.0
T = se3.exp([0.01, -0.02, 0.015, 0.004, -0.003, 0.006])


def pixels(rng: np.random.Generator) -> np.ndarray:
    """A wall at two metres whose normals and slopes of grey are any."""
    made = np.zeros((24, 32, 8), np.float32)
    normal = rng.normal([0, 0, -3], 1, (24, 32, 3))
    made[..., NX : NX + 3] = normal / np.linalg.norm(normal, axis=-1, keepdims=True)
    rays = np.dstack([*np.meshgrid((np.arange(32) - GRID[2]) / GRID[0], (np.arange(24) - GRID[3]) / GRID[1])])
    points = DEPTH_M * np.dstack([rays, np.ones((24, 32))])
    made[..., OFFSET] = (made[..., NX : NX + 3] * points).sum(axis=-1)
    made[..., DEPTH], made[..., GREY] = DEPTH_M, 100.0
    made[..., [ALONG_U, ALONG_V]] = rng.normal(0, 10, (24, 32, 2))
    return made


def jacobian(p: np.ndarray, g: np.ndarray) -> np.ndarray:
    return np.concatenate([g, np.cross(p, g)])


def by_hand(own: np.ndarray, reference: np.ndarray, of_planes: bool) -> np.ndarray:
    """Pixel by pixel, as the formulas stand in the documentation."""
    total = np.zeros((6, 6))
    for v in range(24):
        for u in range(32):
            x = DEPTH_M * np.array([(u - GRID[2]) / GRID[0], (v - GRID[3]) / GRID[1], 1])
            p = T[:3, :3] @ x + T[:3, 3]
            at = GRID[:2] * p[:2] / p[2] + GRID[2:]
            if not (1 <= at[0] < 30 and 1 <= at[1] < 22):
                continue
            there, here = reference[int(at[1] + 0.5), int(at[0] + 0.5)].astype(float), own[v, u].astype(float)
            if of_planes:
                g, h = there[:3], T[:3, :3] @ here[:3]
                error, sigma2 = g @ p - there[OFFSET], 2 * (1e-3 + 2e-3 * DEPTH_M**2) ** 2
                root = 1 / (1.3 * np.sqrt(sigma2 * max((g @ p) ** 2 / (p @ p), 0.04)))
                weight = root**2 * min(1, 1.5 / (abs(error) * root))
            else:
                du, dv = (between(reference[..., channel], at) for channel in (ALONG_U, ALONG_V))
                g = np.array([[50 / p[2], 0, -50 * p[0] / p[2] ** 2], [0, 52 / p[2], -52 * p[1] / p[2] ** 2]])
                g = 1.1 * np.array([du, dv]) @ g
                z = DEPTH_M
                h = np.array([[50 / z, 0, -50 * x[0] / z**2], [0, 52 / z, -52 * x[1] / z**2]])
                h = T[:3, :3] @ (here[[ALONG_U, ALONG_V]] @ h)
                weight = 0.7**2 / (8.0**2 + 0.2**2 * (du**2 + dv**2))
            product = np.outer(jacobian(p, g), jacobian(p, h))
            total += weight * (product + product.T) / 2
    return total


def between(channel: np.ndarray, at: np.ndarray) -> float:
    (u, v), (s, t) = at.astype(int), at % 1
    corners = channel[v : v + 2, u : u + 2].astype(float)
    return float([1 - t, t] @ corners @ [1 - s, s])


@pytest.mark.parametrize(("show", "of_planes"), [(shown.show_planes, True), (shown.show_slopes, False)])
def test_information_is_the_sum_of_products(show: object, of_planes: bool) -> None:
    rng = np.random.default_rng(3)
    own, reference = pixels(rng), pixels(rng)
    sums = np.empty((24, shown.SHOWN))
    depth_m = np.full((24, 32), DEPTH_M, np.float32)
    for begin in (0, 10):
        both = shown.BothViews(depth_m, own, reference, GRID)
        show(both, T, NOISE, HOW, begin, (10, 24)[begin > 0], sums)  # type: ignore[operator]
    expected = by_hand(own, reference, of_planes)
    scale = np.abs(expected).max()
    assert_allclose(symmetric(sums.sum(axis=0)) / scale, expected / scale, atol=1e-5)


@pytest.mark.parametrize("hole", ["depth", "normal", "grey"])
def test_what_is_unknown_in_one_of_both_counts_nothing(hole: str) -> None:
    rng = np.random.default_rng(3)
    own, reference = pixels(rng), pixels(rng)
    depth_m = np.full((24, 32), DEPTH_M, np.float32)
    if hole == "depth":
        depth_m[:] = 0
    own[..., OFFSET if hole == "normal" else ALONG_U] = np.nan
    for show, is_empty in ((shown.show_planes, hole != "grey"), (shown.show_slopes, hole != "normal")):
        sums = np.empty((24, shown.SHOWN))
        show(shown.BothViews(depth_m, own, reference, GRID), T, NOISE, HOW, 0, 24, sums)
        assert (np.abs(sums[:, : shown.POINTS]).max() == 0) == is_empty


def test_noise_on_a_plain_wall_shows_a_hundredth_of_what_paint_shows() -> None:
    """Weakest directions of a wall that is painted, and of one whose grey and normals are noise alone."""
    weakest = {}
    for is_painted in (True, False):
        wall = [Plane((0.0, 0.0, -1.0), -1.6, is_painted)]
        subject = bench()
        reference = subject.reference(frame_of(wall, np.eye(4), 0.0, noise_seed=1))
        found = subject.aligner.align(subject.grid(frame_of(wall, np.eye(4), 0.1, noise_seed=2)), reference, np.eye(4))
        weakest[is_painted] = np.linalg.eigvalsh(found.information)[0]
    assert weakest[False] < 0.01 * weakest[True]
