"""The colour sensor against closed forms: tone curve, noise, vignetting, metering, blur along the motion."""

from __future__ import annotations

from dataclasses import replace
from types import ModuleType
from typing import Any

import numpy as np
import pytest
from odometry.plain_kernels import plain
from simulation.boxes import boxes, heading, see

from wheelsight.core.errors import ConfigError
from wheelsight.core.geometry import ByteArray, Float32Array, FloatArray, se3
from wheelsight_sim import sensor_kernels as _blur_kernels
from wheelsight_sim import texture_kernels as _texture_kernels
from wheelsight_sim.color_sensor import ColorSensor, ExposureSetting, image_flow
from wheelsight_sim.scene import View

WALL = boxes(("wall", "blank", (2.0, 0, 1), (0.5, 9, 9)))
# So many electrons that noise is far below a byte; radiance 1 fills the sensor.
QUIET = ColorSensor(
    fixed=ExposureSetting(1.0), electrons_per_s=1e12, full_well=1e12, read_noise=0, vignetting=0, lens_sigma_px=0
)


def wall_view(size: tuple[int, int] = (64, 48), focal_px: float = 50.0) -> View:
    return see(WALL, heading(0, 0, 1), size, focal_px)


def grey(levels: object, size: tuple[int, int] = (48, 64)) -> Float32Array:
    return np.ascontiguousarray(np.broadcast_to(np.asarray(levels, np.float32)[..., None], (*size, 3)))


def linear(image: np.ndarray) -> FloatArray:
    """sRGB undone (IEC 61966-2-1)."""
    x = np.asarray(image, float) / 255
    return np.where(x <= 0.04045, x / 12.92, ((x + 0.055) / 1.055) ** 2.4)


def shot(sensor: ColorSensor, radiance: Float32Array, seed: int = 0, **how: Any) -> ByteArray:
    view = how.pop("view", None) or wall_view((radiance.shape[1], radiance.shape[0]))
    return sensor.expose(radiance, view, sensor.meter(radiance), np.random.default_rng(seed), **how)


def test_bytes_are_srgb() -> None:
    levels = linear(np.arange(256)).reshape(16, 16)
    np.testing.assert_array_equal(shot(QUIET, grey(levels, (16, 16)))[..., 1].ravel(), np.arange(256))


def test_what_is_brighter_than_the_sensor_holds_is_white() -> None:
    assert (shot(QUIET, grey(7.0)) == 255).all()


@pytest.mark.parametrize("gain", [1.0, 3.0])
def test_variance_grows_with_the_mean_as_shot_noise_does(gain: float) -> None:
    full_well, read_noise = 1000.0, 12.0
    sensor = ColorSensor(ExposureSetting(1.0, gain), electrons_per_s=1000, full_well=full_well, read_noise=read_noise)
    sensor = replace(sensor, vignetting=0, lens_sigma_px=0)
    means, variances = [], []
    for level in (0.15, 0.25, 0.35, 0.45, 0.55):
        image = linear(shot(sensor, grey(level / gain, (200, 200)), seed=int(100 * level)))
        means.append(image.mean())
        variances.append(image.var())
    slope, offset = np.polyfit(means, variances, 1)
    np.testing.assert_allclose(means, [0.15, 0.25, 0.35, 0.45, 0.55], rtol=0.01)
    assert slope == pytest.approx(gain / full_well, rel=0.05)
    assert offset == pytest.approx((gain * read_noise / full_well) ** 2, rel=0.5)


def test_noise_is_white_over_pixels_and_colours() -> None:
    noise = linear(shot(replace(QUIET, electrons_per_s=500, full_well=1000), grey(0.5, (200, 200))))
    noise = (noise - noise.mean()) / noise.std()
    for a, b in ((noise[1:], noise[:-1]), (noise[:, 1:], noise[:, :-1]), (noise[..., 1:], noise[..., :-1])):
        assert abs((a * b).mean()) < 0.015


def test_the_same_seed_gives_the_same_bytes() -> None:
    radiance = grey(0.3)
    assert shot(ColorSensor(), radiance, 4).tobytes() == shot(ColorSensor(), radiance, 4).tobytes()
    assert shot(ColorSensor(), radiance, 4).tobytes() != shot(ColorSensor(), radiance, 5).tobytes()


def test_vignetting_is_symmetric_and_follows_the_cosine() -> None:
    image = shot(replace(QUIET, vignetting=1.0), grey(0.8))[..., 0]
    np.testing.assert_array_equal(image, image[::-1])
    np.testing.assert_array_equal(image, image[:, ::-1])
    cosine = 1 / np.linalg.norm(wall_view().rays, axis=-1)
    np.testing.assert_allclose(linear(image), 0.8 * cosine**4, atol=0.005)


def test_the_lens_spreads_light_and_keeps_it() -> None:
    radiance = grey(0.0)
    radiance[20, 30] = 1.0
    image = linear(shot(replace(QUIET, lens_sigma_px=0.5), radiance)[..., 0])
    assert image.sum() == pytest.approx(1, abs=0.01)
    assert 0.3 < image[20, 30] < 0.9


def test_metering_reaches_its_target_at_once_without_inertia() -> None:
    sensor = ColorSensor(inertia=0, vignetting=0)
    for level in (0.1, 0.3, 1.0):
        assert linear(shot(sensor, grey(level))).mean() == pytest.approx(sensor.target, rel=0.02)


def test_metering_approaches_its_target_step_by_step() -> None:
    sensor, bright = ColorSensor(inertia=0.8), grey(0.8)
    wanted = sensor.meter(bright)
    exposure = sensor.meter(grey(0.2))
    errors = []
    for _ in range(10):
        exposure = sensor.meter(bright, exposure)
        errors.append(np.log(exposure.product_s / wanted.product_s))
    np.testing.assert_allclose(errors, np.log(4) * 0.8 ** np.arange(1, 11), atol=1e-3)


def test_metering_ends_at_the_longest_time_and_the_highest_gain() -> None:
    sensor = ColorSensor()
    assert sensor.meter(grey(0.0)) == ExposureSetting(sensor.longest_s, sensor.highest_gain)
    assert sensor.meter(grey(1.0)).gain == 1
    assert replace(sensor, fixed=ExposureSetting(0.01, 2.0)).meter(grey(0.0)) == ExposureSetting(0.01, 2.0)


def test_image_flow_is_the_difference_of_projections() -> None:
    view, twist, dt = (
        see(WALL, heading(0, 0.3, 1, 0.3, 0.2), (64, 48), 50),
        np.array([0.4, -0.2, 0.9, 0.3, -0.5, 0.2]),
        1e-5,
    )
    p = view.depth_m[..., None] * view.rays
    moved = se3.apply(se3.invert(se3.exp(twist * dt)), p)
    expected = 50 * (moved[..., :2] / moved[..., 2:] - view.rays[..., :2]) / dt
    np.testing.assert_allclose(image_flow(view, twist), expected, atol=0.01)


def test_motion_blur_smears_along_the_motion_only() -> None:
    sensor = replace(QUIET, motion_blur=True, fixed=ExposureSetting(0.1), electrons_per_s=1e13)
    upright = grey(np.arange(64) // 4 % 2 * 0.8)
    lying = grey((np.arange(48) // 4 % 2 * 0.8)[:, None])
    sideways = np.array([0.04 * 1.5 / 0.05, 0, 0, 0, 0, 0])  # 4 px in 0.1 s at 1.5 m
    for radiance, stays in ((upright, False), (lying, True)):
        still = shot(replace(sensor, motion_blur=False), radiance)
        blurred = shot(sensor, radiance, twist_camera=sideways)
        assert np.array_equal(blurred, still) is stays
    inside = linear(shot(sensor, upright, twist_camera=2 * sideways))[:, 8:-8]
    np.testing.assert_allclose(inside, 0.4, atol=0.08)
    np.testing.assert_array_equal(shot(sensor, upright, twist_camera=np.zeros(6)), shot(QUIET, upright))


def test_a_smear_keeps_the_light() -> None:
    image = np.zeros((21, 41, 3), np.float32)
    image[10, 20] = 1
    moved = np.zeros((21, 41, 2), np.float32)
    moved[..., 0] = 8
    smeared = _blur_kernels.smear(image, moved)
    assert smeared[10, :, 0].sum() == pytest.approx(1, rel=0.05)
    assert np.count_nonzero(smeared[10, :, 0]) in range(7, 11)
    assert not smeared[:10].any()
    assert not smeared[11:].any()


def test_compiled_kernels_are_plain_kernels(rng: np.random.Generator) -> None:
    everything = ModuleType("everything")
    for module in (_texture_kernels, _blur_kernels):
        vars(everything).update({k: v for k, v in vars(module).items() if not k.startswith("__")})
    plainly = plain(everything)
    view = wall_view((9, 7), 6)
    twist = np.array([0.4, -0.2, 0.9, 0.3, -0.5, 0.2])
    flows = [np.empty((7, 9, 2), np.float32) for _ in range(2)]
    image = rng.uniform(0, 1, (7, 9, 3)).astype(np.float32)
    normals, curve = rng.normal(size=64).astype(np.float32), np.arange(256, dtype=np.uint8)
    outs = [np.empty((7, 9, 3), np.uint8) for _ in range(2)]
    ways: tuple[Any, Any] = (_blur_kernels, plainly)
    for kernels, flow, out in zip(ways, flows, outs, strict=True):
        kernels.flow_kernel(view.depth_m, view.rays, twist, flow)
        smeared = kernels.smear(image, flow)
        exposed = _blur_kernels.Exposed(900.0, 1000.0, 5.0, 1e-3)
        kernels.develop(smeared, np.ones((7, 9), np.float32), exposed, normals, curve, 3, out)
    np.testing.assert_allclose(flows[0], flows[1], rtol=1e-6)
    np.testing.assert_array_equal(outs[0], outs[1])


def test_motion_blur_without_motion_is_refused() -> None:
    with pytest.raises(ConfigError, match="twist"):
        shot(replace(QUIET, motion_blur=True), grey(0.5))


@pytest.mark.parametrize(
    "wrong",
    [{"full_well": 0.0}, {"read_noise": -1.0}, {"inertia": 1.0}, {"vignetting": 1.5}, {"longest_s": float("nan")}],
)
def test_impossible_sensors_are_refused(wrong: dict[str, Any]) -> None:
    with pytest.raises(ConfigError):
        ColorSensor(**wrong)
