"""Lens, control, pixels and stamps of a real camera, against closed forms and their own numbers."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from wheelsight.core.errors import ConfigError
from wheelsight.core.geometry import PinholeCamera
from wheelsight.core.messages import WheelTicks
from wheelsight_sim import Realism, realism_of, stream, unit_of
from wheelsight_sim.cameras import camera_model
from wheelsight_sim.color_sensor import (
    ControlSettings,
    LensSettings,
    PixelSettings,
    as_delivered,
    balance_of,
    exposure_of,
    lens_of,
    response,
)
from wheelsight_sim.readings import StampSettings, as_stamped, exact_times, frame_times

CAMERA = PinholeCamera(320, 240, 293, 293, 159.5, 119.5)


def test_presets_are_two_and_another_is_refused():
    assert realism_of("ideal") is None
    assert realism_of("real") == Realism()
    with pytest.raises(ConfigError, match=r"--realism is idael \(did you mean ideal"):
        realism_of("idael")


def test_a_part_has_numbers_of_its_own():
    assert stream(3, "lens").random() == stream(3, "lens").random()
    assert len({stream(seed, part).random() for seed in (3, 4) for part in ("lens", "mount")}) == 4


def test_a_camera_without_noise_has_no_errors():
    unit = unit_of(camera_model("ideal"), Realism(), 1)
    assert (unit.realism, unit.registration) == (None, None)
    assert unit.lens.true == unit.lens.nominal == camera_model("ideal").camera
    real = unit_of(camera_model("kinect-v1"), Realism(), 1)
    assert real.lens.true != real.lens.nominal


def test_a_lens_calibrated_exactly_is_the_published_one():
    exact = LensSettings(unlike_sigma=0, tangential_sigma=0, focal_sigma=0, centre_sigma_px=0, distortion_sigma=0)
    lens = lens_of(CAMERA, exact, np.random.default_rng(0))
    assert lens.true == lens.nominal == replace(CAMERA, distortion=exact.distortion)


def test_calibrations_err_as_far_as_they_say():
    settings = LensSettings()
    lenses = [lens_of(CAMERA, settings, np.random.default_rng(seed)) for seed in range(400)]
    focal = np.array([lens.true.fx / lens.nominal.fx - 1 for lens in lenses])
    centre_px = np.array([lens.true.cx - lens.nominal.cx for lens in lenses])
    assert focal.std() == pytest.approx(settings.focal_sigma, rel=0.12)
    assert centre_px.std() == pytest.approx(settings.centre_sigma_px / 2, rel=0.12)  # half of 640 pixels


def test_a_control_comes_late_and_goes_beyond():
    settings = ControlSettings(delay_s=0.1, overshoot=0.25)
    weights = response(settings, 1 / 30, 60)
    assert weights.sum() == pytest.approx(1)
    np.testing.assert_allclose(weights[:2], 0, atol=1e-12)
    risen = np.cumsum(weights)
    assert risen.max() == pytest.approx(1.25, abs=0.02)
    np.testing.assert_allclose(risen[-10:], 1, atol=0.01)


@pytest.mark.parametrize(("wanted_s", "time_s"), [(0.004, 0.004), (0.025, 0.02), (0.2, 0.03)])
def test_an_exposure_is_as_bright_as_wanted_and_does_not_flicker(wanted_s, time_s):
    settings = ControlSettings()
    exposure = exposure_of(settings, [wanted_s] * 5, response(settings, 1 / 30, 12), 8.0)
    assert exposure.product_s == pytest.approx(wanted_s, rel=0.6 * settings.step)
    assert exposure.time_s == pytest.approx(time_s, rel=0.02)
    assert exposure_of(settings, [9.0], response(settings, 1 / 30, 12), 8.0).gain == 8.0


def test_a_balance_takes_out_its_share_of_a_cast():
    whole, half = ControlSettings(balance_strength=1.0), ControlSettings(balance_strength=0.5)
    cast = np.array([[0.5, 0.4, 0.32]])
    np.testing.assert_allclose(balance_of(whole, cast, 0.1) * cast[0], 0.4)
    np.testing.assert_allclose(balance_of(half, cast, 0.1), np.sqrt([0.8, 1, 1.25]))
    changing = np.array([[0.5, 0.4, 0.4], [0.4, 0.4, 0.4]])
    assert 0.8 < balance_of(whole, changing, 0.1)[0] < 1  # the frame before counts, too


def test_pixels_keep_their_own_colour(rng):
    color = rng.integers(0, 256, (16, 24, 3), np.uint8)
    got = as_delivered(color, PixelSettings(has_bayer=True, jpeg_quality=0))
    inner = (slice(2, -2), slice(2, -2))
    for channel, row, column in ((0, 0, 0), (1, 0, 1), (1, 1, 0), (2, 1, 1)):
        own = (slice(row, None, 2), slice(column, None, 2))
        np.testing.assert_array_equal(got[inner][own][..., channel], color[inner][own][..., channel])
    expected = (color[4, 5, 0].astype(int) * 0 + color[4, 4, 0].astype(int) + color[4, 6, 0]) / 2
    assert abs(int(got[4, 5, 0]) - expected) <= 1


def test_jpeg_loses_little_and_no_colour_of_a_plain_image(rng):
    plain = np.full((32, 48, 3), (200, 90, 40), np.uint8)
    assert np.abs(as_delivered(plain, PixelSettings()).astype(int) - plain).max() <= 3
    noisy = rng.integers(0, 256, (32, 48, 3), np.uint8)
    assert (as_delivered(noisy, PixelSettings()) != noisy).mean() > 0.5
    np.testing.assert_array_equal(as_delivered(noisy, PixelSettings(has_bayer=False, jpeg_quality=0)), noisy)


def test_frames_are_lost_and_stamped_as_often_and_as_far_as_said():
    settings = StampSettings(camera_late_s=(0.01, 0.01))
    times = frame_times(20_000, 30.0, settings, np.random.default_rng(5))
    assert 1 - len(times) / 20_000 == pytest.approx(settings.dropped, rel=0.2)
    assert times.taken_s[0] == 0
    late_s = times.reported_s - times.taken_s
    assert late_s.mean() == pytest.approx(0.01, abs=1e-4)
    assert late_s.std() == pytest.approx(settings.camera_jitter_s, rel=0.05)
    assert np.diff(times.reported_s).min() > 0
    np.testing.assert_array_equal(exact_times(4, 10.0).reported_s, [0, 0.1, 0.2, 0.3])


def test_readings_keep_their_order_and_counts():
    readings = [WheelTicks(round(0.02 * k, 6), k, -k) for k in range(3000)]
    reported = as_stamped(readings, StampSettings(burst_share=0.05), np.random.default_rng(2))
    assert [(tick.left, tick.right) for tick in reported] == [(tick.left, tick.right) for tick in readings]
    stamps_s = np.array([tick.stamp_s for tick in reported])
    steps_s = np.diff(stamps_s)
    assert steps_s.min() > 0
    assert steps_s.min() < 0.005  # those behind a reading that was held arrive with it
    assert steps_s.max() > 0.03
    late_s = stamps_s - 0.02 * np.arange(3000)
    assert late_s.min() > -1e-5
    assert late_s.max() < 0.025 + 0.01
    assert as_stamped((), StampSettings(), np.random.default_rng(2)) == ()
