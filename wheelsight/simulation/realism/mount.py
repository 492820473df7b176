"""Where a camera sits that was mounted by a drawing."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from wheelsight.geometry import FloatArray, se3


@dataclass(frozen=True, slots=True)
class MountSettings:
    """How far the mount is off what its calibration says.

    Attributes:
        sigma_m: of the position, along each axis: a few millimetres, by a ruler. Chosen.
        sigma_deg: of the direction, about each axis: tenths of a degree, by a good calibration. Chosen.
    """

    sigma_m: float = 0.003
    sigma_deg: float = 0.2


def mounted(T_base_camera: FloatArray, settings: MountSettings, rng: np.random.Generator) -> FloatArray:
    """T_base_camera (4, 4) as it truly is, of one the calibration has."""
    error = np.concatenate(
        [settings.sigma_m * rng.standard_normal(3), np.radians(settings.sigma_deg) * rng.standard_normal(3)]
    )
    return np.asarray(se3.compose(T_base_camera, se3.exp(error)))
