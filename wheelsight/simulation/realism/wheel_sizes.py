"""Sizes of wheels as a calibration has them: not quite what they are on the day of the drive."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from wheelsight.calibration import Wheels


@dataclass(frozen=True, slots=True)
class WheelSizeSettings:
    """How far calibrated sizes are off; the calibration states the same.

    Attributes:
        scale_sigma: of both radii, as a share: air and warmth. Reckoned.
        drift_sigma_rad_per_m: turn a metre by radii that are not alike: two kilograms more on one side press that
            tyre in by 0.06 %, a milliradian a metre on wheels half a metre apart. Reckoned.
        turn_sigma: of the track width, as a share: where in its width a tyre touches the floor. Reckoned.
    """

    scale_sigma: float = 0.003
    drift_sigma_rad_per_m: float = 0.001
    turn_sigma: float = 0.003


def as_calibrated(true: Wheels, settings: WheelSizeSettings, rng: np.random.Generator) -> Wheels:
    """Wheels as `wheelsight calibrate wheels` would have left them some days ago."""
    scale, drift, turn = rng.standard_normal(3) * (
        settings.scale_sigma,
        settings.drift_sigma_rad_per_m * true.track_width_m,
        settings.turn_sigma,
    )
    return replace(
        true,
        left_radius_m=true.left_radius_m * (1 + scale - drift / 2),
        right_radius_m=true.right_radius_m * (1 + scale + drift / 2),
        track_width_m=true.track_width_m * (1 + turn),
        scale_sigma=settings.scale_sigma,
        drift_sigma_rad_per_m=settings.drift_sigma_rad_per_m,
        turn_sigma=settings.turn_sigma,
    )
