"""LayoutDescriber: what is where, known from scenes that are known; indifferent to light, size and single holes."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from odometry.plain_kernels import plain
from places.made import frame_of

from wheelsight.core.messages import RgbdFrame
from wheelsight.places import LayoutDescriber, LayoutSettings, describer_from
from wheelsight.places import describer_kernels as compiled

FOCAL = 0.9


def reported(frame: RgbdFrame, s: LayoutSettings | None = None) -> dict[str, float]:
    describer = LayoutDescriber(s)
    return dict(zip(describer.names, describer.describe(frame).tolist(), strict=True))


def plane(normal: tuple[float, float, float], distance_m: float, size: tuple[int, int] = (240, 320)) -> np.ndarray:
    """Depth (H, W) of the plane with a unit `normal` towards the camera, `distance_m` from it; focal length 0.9 W."""
    height, width = size
    x = ((np.arange(width) + 0.5) / width - 0.5) / FOCAL
    y = ((np.arange(height) + 0.5) / height - 0.5) * height / width / FOCAL
    facing = normal[0] * x[None, :] + normal[1] * y[:, None] + normal[2]
    return (-distance_m / facing).astype(np.float32)


def grey(size: tuple[int, int] = (240, 320)) -> np.ndarray:
    return np.full((*size, 3), 128, np.uint8)


@pytest.mark.parametrize("normal", [(0.0, 0.0, -1.0), (0.6, 0.0, -0.8), (0.0, -0.28, -0.96), (-0.36, 0.48, -0.8)])
def test_normals_of_a_plane_are_the_planes(normal):
    depth_m = plane(normal, 2.0)
    values = reported(RgbdFrame(0.0, grey(), depth_m), LayoutSettings(far_m=50.0))
    # A ray through the middle of a sample is read at a whole pixel, up to half a pixel away: not exact.
    for cell in ("cell 1 2", "cell 2 3", "cell 3 4"):
        np.testing.assert_allclose(
            (values[f"{cell} normal x"], values[f"{cell} normal y"]), normal[:2], atol=0.03, err_msg=cell
        )


def test_depths_are_quantiles_of_their_cell():
    depth_m = np.full((240, 320), 6.0, np.float32)
    depth_m[:, :160] = 2.0
    values = reported(RgbdFrame(0.0, grey(), depth_m))
    for row in range(4):
        assert values[f"cell {row} 0 depth 0.5"] == pytest.approx(2.0, abs=8 / 64)
        assert values[f"cell {row} 5 depth 0.5"] == pytest.approx(6.0, abs=8 / 64)
    assert values["profile 0.5 0"] == pytest.approx(2.0, abs=8 / 64)
    assert values["profile 0.5 15"] == pytest.approx(6.0, abs=8 / 64)


def test_quantiles_are_those_of_numpy(rng):
    depth_m = rng.uniform(0.5, 7.5, (240, 320)).astype(np.float32)
    samples = np.empty((120, 162), np.float32)
    compiled.sample_depth(depth_m, 8.0, samples)
    out = np.empty((4, 6, 6), np.float32)
    compiled.describe_depth(samples, np.full((2, 120, 162), np.nan, np.float32), 8.0, out)
    for row, column in ((0, 0), (2, 3), (3, 5)):
        cell = samples[30 * row : 30 * row + 30, 27 * column : 27 * column + 27]
        np.testing.assert_allclose(out[row, column, :3], np.quantile(cell, compiled.QUANTILES), atol=8 / 64)


def test_holes_are_reported_where_they_are():
    depth_m = np.full((240, 320), 3.0, np.float32)
    depth_m[:60, 160:] = 0
    values = reported(RgbdFrame(0.0, grey(), depth_m))
    # The last row of the hole borders on depth, which fills it.
    assert values["cell 0 5 holes"] == pytest.approx(1.0, abs=0.04)
    assert values["cell 0 0 holes"] == 0.0
    assert values["cell 1 5 holes"] == 0.0
    assert values["cell 1 5 depth 0.5"] == pytest.approx(3.0, abs=8 / 64)


def test_single_holes_change_nothing(rng):
    depth_m = plane((0.3, 0.0, -np.sqrt(0.91)), 2.0)
    holed = depth_m.copy()
    holed[::3, ::4] = 0
    whole, with_holes = (LayoutDescriber().describe(RgbdFrame(0.0, grey(), z)) for z in (depth_m, holed))
    np.testing.assert_allclose(with_holes, whole, atol=0.05)


def test_dimmer_light_changes_little(rng):
    base = np.kron(rng.integers(60, 220, (24, 32, 3)), np.ones((10, 10, 1)))
    bright = base.astype(np.uint8)
    dim = (0.5 * base).astype(np.uint8)
    z = np.full((240, 320), 3.0, np.float32)
    one, other = (LayoutDescriber().describe(RgbdFrame(0.0, color, z)) for color in (bright, dim))
    np.testing.assert_allclose(other, one, atol=0.05)
    assert np.abs(one).max() > 0.5


def test_another_resolution_changes_little():
    color = np.kron(np.random.default_rng(3).integers(0, 256, (12, 16, 3)), np.ones((20, 20, 1))).astype(np.uint8)
    z = plane((0.0, 0.28, -0.96), 2.5)
    coarse = LayoutDescriber().describe(RgbdFrame(0.0, color, z))
    fine_color, fine_z = color.repeat(2, 0).repeat(2, 1), plane((0.0, 0.28, -0.96), 2.5, (480, 640))
    fine = LayoutDescriber().describe(RgbdFrame(0.0, fine_color, fine_z))
    np.testing.assert_allclose(fine, coarse, atol=0.1)


def test_turning_the_image_over_swaps_sides(rng):
    frame = frame_of(1, rng, size=(240, 320))
    values = reported(frame)
    mirrored = reported(RgbdFrame(0.0, frame.color[:, ::-1], frame.depth_m[:, ::-1]))
    for row in range(4):
        for column in range(6):
            here, there = f"cell {row} {column}", f"cell {row} {5 - column}"
            assert mirrored[f"{here} grey"] == pytest.approx(values[f"{there} grey"], abs=0.2)
            assert mirrored[f"{here} depth 0.5"] == pytest.approx(values[f"{there} depth 0.5"], abs=0.2)


@settings(max_examples=40)
@given(
    st.tuples(st.integers(1, 40), st.integers(1, 40)),
    st.tuples(st.integers(1, 40), st.integers(1, 40)),
    st.integers(0, 2**32 - 1),
)
def test_any_images_give_finite_numbers(color_size, depth_size, seed):
    rng = np.random.default_rng(seed)
    odd = np.array([0, np.nan, np.inf, -np.inf, -2, 1e-30, 3e38, 0.5, 2.0, 7.9], np.float32)
    frame = RgbdFrame(0.0, rng.integers(0, 256, (*color_size, 3), dtype=np.uint8), rng.choice(odd, depth_size))
    describer = LayoutDescriber(LayoutSettings(samples_down=24, samples_across=32))
    numbers = describer.describe(frame)
    assert numbers.shape == (describer.size,)
    assert np.isfinite(numbers).all()


@pytest.mark.parametrize(
    "s",
    [
        LayoutSettings(),
        LayoutSettings(rows=1, columns=1, profile=1, bins=2, sides=2, samples_down=16, samples_across=16),
        LayoutSettings(rows=7, columns=11, profile=64, samples_down=16, samples_across=16),
    ],
)
def test_as_many_numbers_as_names_whatever_the_settings(rng, s):
    describer = LayoutDescriber(s)
    numbers = describer.describe(frame_of(0, rng))
    assert numbers.shape == (describer.size,) == (len(describer.names),)
    assert len(set(describer.names)) == describer.size
    assert describer_from(describer.settings).settings == describer.settings


def test_compiled_kernels_tell_what_plain_python_shows(rng):
    frame = frame_of(1, rng, size=(48, 64))
    results = []
    for kernels in (compiled, plain(compiled)):
        color, depth_m, normals = (np.empty(shape, np.float32) for shape in ((3, 16, 24), (16, 24), (2, 16, 24)))
        kernels.sample_color(frame.color, color)
        found = kernels.sample_depth(frame.depth_m, 8.0, depth_m)
        kernels.normals_of(depth_m, 0.9, 0.75, normals)
        of_color, of_depth = np.empty((2, 3, 6), np.float32), np.empty((2, 3, 6), np.float32)
        profile, grey_shares, depth_shares, sides = (np.zeros(s, np.float32) for s in ((4, 2), 5, 5, (3, 3)))
        kernels.describe_color(color, of_color)
        kernels.describe_depth(depth_m, normals, 8.0, of_depth)
        kernels.describe_profile(depth_m, 8.0, profile)
        kernels.describe_whole(color, depth_m, normals, 8.0, grey_shares, depth_shares, sides)
        parts = (color, depth_m, normals, of_color, of_depth, profile, grey_shares, depth_shares, sides)
        results.append((found, *parts))
    for one, other in zip(*results, strict=True):
        np.testing.assert_allclose(one, other, rtol=1e-4, atol=1e-5)
