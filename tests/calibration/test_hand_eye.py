from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from drives import MIXED
from sighted_drives import MOUNT, NOMINAL, USUAL, Blur, sighted

from wheelsight.core.calibration_parts import Wheels
from wheelsight.core.geometry import FloatArray, se2, se3
from wheelsight_calibration.base import Sightings
from wheelsight_calibration.mount import MountFit, closed_form, cut_level, fit_mount, level_rotation, levelled

TRUE = np.array([0.28, 0.08, 0.15])


def fitted(seen: Sightings, delay_s: float = 0.0) -> MountFit:
    segments = cut_level(seen.drive, NOMINAL, levelled(seen.camera, MOUNT[2, :3]))
    return fit_mount(seen.drive, NOMINAL, segments, delay_s)


def found(fit: MountFit) -> FloatArray:
    return np.append(fit.mount, fit.wheels.delay_s)


@pytest.mark.parametrize("scale", [1.0, 1.03])
def test_the_closed_form_is_exact(rng: np.random.Generator, scale: float) -> None:
    """Motions A, X⁻¹·A·X of base and camera for a known X, wheels a little too small."""
    base = rng.uniform(-1, 1, (20, 3))
    X = se2.from_parts(0.3, -0.2, 2.5)
    level = np.stack(se2.to_parts(se2.invert(X) @ se2.from_parts(*base.T) @ X), axis=-1)
    base[:, :2] /= scale
    expected = [0.3, -0.2, 2.5]
    np.testing.assert_allclose(closed_form(base, level), expected, atol=1e-9)


def test_a_level_frame_is_a_rotation_that_keeps_up() -> None:
    for up in (MOUNT[2, :3], np.array([0.0, 0.0, -1.0]), np.array([0.6, 0.0, -0.8])):
        R_camera_level = level_rotation(up)
        assert se3.is_valid(se3.from_parts(R_camera_level, np.zeros(3)))
        np.testing.assert_allclose(R_camera_level[:, 2], up)


def test_a_drive_without_noise_gives_the_mount() -> None:
    """What is left is counts in whole numbers."""
    np.testing.assert_allclose(found(fitted(sighted())), [*TRUE, 0.0], atol=5e-4)


@pytest.mark.parametrize(
    "wheels",
    [
        replace(NOMINAL, left_radius_m=0.1666, right_radius_m=0.1734),
        replace(NOMINAL, left_radius_m=0.1666, right_radius_m=0.1666, track_width_m=0.6),
        replace(NOMINAL, delay_s=0.035),
        replace(NOMINAL, delay_s=-0.2),
    ],
    ids=["unequal", "small", "late", "early"],
)
def test_wheels_that_are_wrong_do_not_spoil_the_mount(wheels: Wheels) -> None:
    fit = fitted(sighted(wheels), round(wheels.delay_s, 1))
    np.testing.assert_allclose(found(fit), [*TRUE, wheels.delay_s], atol=1e-3)
    for name in ("left_radius_m", "right_radius_m", "track_width_m"):
        assert getattr(fit.wheels, name) == pytest.approx(getattr(wheels, name), rel=2e-3)


def test_sliding_in_bends_is_not_taken_for_the_mount() -> None:
    """The more turns differ in speed, the better both are distinguished; at 0.5 m/s it looks like a centimetre of x."""
    fit = fitted(sighted(slide_s=0.02, legs=MIXED * 2))
    assert fit.slide_s == pytest.approx(0.02, abs=2e-3)
    np.testing.assert_allclose(found(fit), [*TRUE, 0.0], atol=1.5e-3)


def test_slips_lose_their_weight(rng: np.random.Generator) -> None:
    fit = fitted(sighted(rng=rng, slips=5, blur=USUAL, legs=MIXED * 2))
    assert 5 <= fit.is_slip.sum() < 0.3 * len(fit.segments)
    np.testing.assert_allclose(found(fit), [*TRUE, 0.0], atol=0.01)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("blur", "least"), [(USUAL, 0.05), (Blur(step_m=0.002, step_rad=0.001), 0.3)], ids=["each by itself", "adding up"]
)
def test_errors_are_at_most_as_large_as_stated(blur: Blur, least: float) -> None:
    """Normalised error squared over thirty drives with noisy wheels and poses.

    Errors of single poses cancel between neighbouring pieces, which σ does not count on.
    """
    nees, z = [], []
    for seed in range(30):
        wheels = replace(NOMINAL, right_radius_m=0.1717, delay_s=0.02)
        fit = fitted(sighted(wheels, rng=np.random.default_rng(seed), blur=blur))
        error = found(fit) - [*TRUE, 0.02]
        nees.append(error @ np.linalg.solve(fit.covariance[3:7, 3:7], error))
        z.append(error / fit.sigmas)
    rms = np.sqrt(np.mean(np.square(z), axis=0))
    assert least < np.mean(nees) / 4 < 1.5, rms
    assert (rms < 1.4).all(), rms
