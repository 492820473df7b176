"""Colour on the ideal grid lies where grey lies, and what is dark says nothing."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from narrowing import not_none
from odometry.dense.scenes import apart, bench, dense
from odometry.plain_kernels import plain
from odometry.views import from_start, room_frame, run
from synthetic import wobbling_trajectory

from wheelsight.core.calibration import Calibration
from wheelsight.core.estimates import Status
from wheelsight.core.geometry import PinholeCamera, se3
from wheelsight.core.messages import RgbdFrame
from wheelsight.vision import image_kernels as _grid_kernels

WIDE = PinholeCamera(640, 480, 525.0, 524.0, 318.3, 241.6)
LENS = replace(WIDE, distortion=(0.1, -0.2, 0.002, -0.001, 0.05))
T_COLOR_DEPTH = se3.exp(np.array([-0.05, 0.02, 0.01, 0.02, -0.04, 0.03]))
TWIST = np.array([0.3, -0.2, 0.4, 0.4, 1.2, -0.5])
CALIBRATIONS = {
    "registered": Calibration.registered_camera(WIDE),
    "distorted": Calibration.registered_camera(LENS),
    "rolling": Calibration.registered_camera(LENS, rolling_shutter_s=0.03),
    "unregistered": Calibration(LENS, WIDE, T_COLOR_DEPTH),
    "unregistered and rolling": Calibration(LENS, WIDE, T_COLOR_DEPTH, rolling_shutter_s=0.03),
}


def colourful(seed: int) -> RgbdFrame:
    """Soft blots, each channel its own, before steps and holes of depth."""
    rng = np.random.default_rng(seed)
    blots = cv2.resize(rng.uniform(0, 255, (48, 64, 3)).astype(np.float32), (640, 480), interpolation=cv2.INTER_LINEAR)
    depth_m = cv2.resize(rng.uniform(0.8, 4.0, (6, 8)), (640, 480), interpolation=cv2.INTER_NEAREST)
    depth_m[rng.random(depth_m.shape) < 0.1] = 0
    return RgbdFrame(0.0, np.rint(blots).astype(np.uint8), depth_m.astype(np.float32))


@settings(max_examples=5)
@given(seed=st.integers(0, 2**32 - 1), speed=st.floats(-1, 1))
@pytest.mark.parametrize("name", CALIBRATIONS)
def test_luma_is_grey(name: str, seed: int, speed: float) -> None:
    frame, gridder = colourful(seed), bench(CALIBRATIONS[name]).gridder
    grid = gridder.on_grid(frame, speed * TWIST)
    color, grey = gridder.color_on_grid(frame, grid), grid.levels[0].grey
    assert (color.dtype, color.shape) == (np.dtype(np.float32), (*grey.shape, 3))
    known = grey >= 0
    assert known.mean() > 0.5
    np.testing.assert_array_equal((color >= 0).all(axis=2), known)
    assert (color[~known] == -1).all()
    error = np.abs(color @ np.array([0.299, 0.587, 0.114]) - grey)[known]
    # Grey is rounded before and after it is halved, colour after: by 1.5 at most, and seldom all one way.
    assert error.max() <= 1.5
    assert np.mean(error <= 1) > 0.99


def test_colour_of_an_image_not_halved_is_the_image() -> None:
    small = PinholeCamera(320, 240, 262.0, 260.0, 161.3, 118.4)
    frame = RgbdFrame(0.0, colourful(1).color[:240, :320], colourful(1).depth_m[:240, :320].copy())
    gridder = bench(Calibration.registered_camera(small)).gridder
    np.testing.assert_array_equal(gridder.color_on_grid(frame, gridder.on_grid(frame, TWIST)), frame.color)


@pytest.mark.parametrize("name", ["straighten_color", "sample_color"])
def test_kernels_are_plain_python(rng: np.random.Generator, name: str) -> None:
    depth_m = rng.uniform(0.9, 1.1, (20, 24)).astype(np.float32)
    depth_m[rng.random((20, 24)) < 0.2] = 0
    image = rng.integers(0, 255, (20, 24, 3)).astype(np.uint8)
    grid, twist = (tuple(np.array(values, np.float32)) for values in ([22.0, 21.0, 11.3, 9.8], TWIST))
    exposure, outs = _grid_kernels.Exposure(grid, twist, np.float32(0.03)), []
    for module in (_grid_kernels, plain(_grid_kernels)):
        out = np.zeros((20, 24, 3), np.float32)
        if name == "straighten_color":
            v, u = np.mgrid[:20, :24].astype(np.float32)
            source_px = np.stack([u + 0.3, v - 0.2], axis=-1)
            module.straighten_color(image, depth_m, source_px, exposure, (0, 20), out)
        else:
            T, lens = (tuple(np.array(v, np.float32)) for v in (T_COLOR_DEPTH[:3].ravel(), [*grid, *LENS.distortion]))
            module.sample_color(image, depth_m, exposure, T, lens, (0, 20), out)
        outs.append(out)
    assert np.mean(outs[0] >= 0) > 0.4
    np.testing.assert_allclose(outs[0], outs[1], atol=0.02)


def noise_about(level: float, frame: RgbdFrame) -> RgbdFrame:
    """The frame with the lights off: a sensor's noise about its black level."""
    noise = np.random.default_rng(frame.index).normal(level, 2.0, frame.color.shape)
    return replace(frame, color=np.rint(noise).clip(0, 255).astype(np.uint8))


@pytest.mark.parametrize("name", CALIBRATIONS)
def test_of_a_dark_frame_depth_alone_is_known(name: str) -> None:
    lit, gridder = colourful(7), bench(CALIBRATIONS[name]).gridder
    dark = noise_about(4.0, lit)
    grid = gridder.on_grid(dark, TWIST)
    assert all((level.grey == -1).all() for level in grid.levels)
    assert (gridder.color_on_grid(dark, grid) == -1).all()
    np.testing.assert_array_equal(grid.levels[0].depth_m, gridder.on_grid(lit, TWIST).levels[0].depth_m)


def test_a_dim_frame_is_not_dark() -> None:
    frame, gridder = colourful(7), bench(CALIBRATIONS["registered"]).gridder
    dim = replace(frame, color=frame.color // 10)
    assert (gridder.on_grid(dim, TWIST).levels[0].grey >= 0).all()


def test_dark_frames_are_tracked_by_depth() -> None:
    truth = wobbling_trajectory(12)
    frames = [room_frame(T, stamp_s, depth_noise=True) for stamp_s, T in truth]
    answers = run(dense(), [noise_about(4.0, f) if 4 <= k < 9 else f for k, f in enumerate(frames)])
    assert all(answer.status is Status.TRACKING for answer in answers)
    world = from_start(np.array(truth.T_frame_body))
    assert max(apart(T, not_none(a.T_odom_body))[0] for T, a in zip(world, answers, strict=True)) < 5e-3
