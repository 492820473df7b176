"""How sure the sizes of calibrated wheels are: what a fit says, and what no fit knows of tomorrow."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from wheelsight.calibration import Wheels

# Reckoned: two kilograms more on one side press that tyre in by 0.06 % of its radius; air and warmth do the like to
# both. On wheels half a metre apart the first is a milliradian a metre.
DAILY_SCALE, DAILY_DRIFT_RAD_PER_M, DAILY_TURN = 0.003, 0.001, 0.003


def stated(wheels: Wheels, ratio_sigma: float, track_share: float, scale_share: float | None = None) -> Wheels:
    """Wheels that say how sure they are.

    Args:
        wheels: as fitted.
        ratio_sigma: standard deviation of right radius over left.
        track_share: of the track width, as a share of it.
        scale_share: of the mean radius, likewise; None where nothing was learned of it.
    """
    scale = wheels.scale_sigma if scale_share is None else float(np.hypot(scale_share, DAILY_SCALE))
    drift = float(np.hypot(ratio_sigma / wheels.track_width_m, DAILY_DRIFT_RAD_PER_M))
    turn = float(np.hypot(track_share, DAILY_TURN))
    return replace(
        wheels, scale_sigma=min(scale, 1.0), drift_sigma_rad_per_m=min(drift, 1.0), turn_sigma=min(turn, 1.0)
    )
