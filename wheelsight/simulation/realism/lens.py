"""The lens a colour camera truly has, and what its owner's calibration says of it."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from wheelsight.geometry import PinholeCamera


@dataclass(frozen=True, slots=True)
class LensSettings:
    """Brown's distortion of a small wide lens, and how well it was calibrated.

    Attributes:
        distortion: k1, k2, p1, p2, k3: Kinect v1's colour camera of TUM's freiburg1 (Sturm et al., "A benchmark for
            the evaluation of RGB-D SLAM systems", IROS 2012).
        unlike_sigma: how far a unit's k1, k2 and k3 are from these, as one factor for all three. Chosen.
        tangential_sigma: of a unit's p1 and p2; freiburg1's are 0.005 and 0.003.
        focal_sigma: error of the calibrated focal length, as a share. The maker's 525 px, which many take, is off
            freiburg1's calibrated 517 px by 1.5 %; a board does better, by how much is chosen.
        centre_sigma_px: error of the calibrated principal point, in pixels of an image 640 wide; 16 px is the
            maker's for freiburg1. Chosen.
        distortion_sigma: error of the calibrated k1, k2, k3, as one share. Chosen.
    """

    distortion: tuple[float, float, float, float, float] = (0.2624, -0.9531, -0.0054, 0.0026, 1.1633)
    unlike_sigma: float = 0.1
    tangential_sigma: float = 0.003
    focal_sigma: float = 0.003
    centre_sigma_px: float = 2.0
    distortion_sigma: float = 0.05


@dataclass(frozen=True, slots=True)
class Lens:
    """A camera as it is, and as its calibration has it."""

    true: PinholeCamera
    nominal: PinholeCamera


def ideal_lens(camera: PinholeCamera) -> Lens:
    """A lens without distortion, known exactly."""
    return Lens(camera, camera)


def lens_of(camera: PinholeCamera, settings: LensSettings, rng: np.random.Generator) -> Lens:
    """The lens of one unit of a camera, and one calibration of it.

    Args:
        camera: without distortion, in the size wanted.
        settings: how lenses are.
        rng: of the unit.
    """
    k1, k2, p1, p2, k3 = settings.distortion
    unlike = 1 + settings.unlike_sigma * rng.standard_normal()
    tangential = np.array([p1, p2]) + settings.tangential_sigma * rng.standard_normal(2)
    nominal = replace(camera, distortion=(unlike * k1, unlike * k2, *tangential, unlike * k3))
    focal = 1 + settings.focal_sigma * rng.standard_normal()
    centre_px = settings.centre_sigma_px * camera.width / 640 * rng.standard_normal(2)
    bent = 1 + settings.distortion_sigma * rng.standard_normal()
    true = replace(
        nominal,
        fx=camera.fx * focal,
        fy=camera.fy * focal,
        cx=camera.cx + centre_px[0],
        cy=camera.cy + centre_px[1],
        distortion=(bent * unlike * k1, bent * unlike * k2, *tangential, bent * unlike * k3),
    )
    return Lens(true, nominal)
