"""How sure the sizes of calibrated wheels are: what a fit says, and what no fit knows of tomorrow."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from wheelsight.calibration import Wheels


@dataclass(frozen=True, slots=True)
class FromDayToDay:
    """What tyres change, which no fit knows of: standard deviations as a calibration states them.

    Reckoned: two kilograms more on one side press that tyre in by 0.06 % of its radius, on wheels half a metre apart a
    milliradian a metre; air and warmth do the like to both; where in its width a tyre touches the floor is the track's.
    """

    scale: float = 0.003
    drift_rad_per_m: float = 0.001
    turn: float = 0.003


def stated(
    wheels: Wheels,
    ratio_sigma: float,
    track_share: float,
    scale_share: float | None = None,
    daily: FromDayToDay | None = None,
) -> Wheels:
    """Wheels that say how sure they are.

    Args:
        wheels: as fitted.
        ratio_sigma: standard deviation of right radius over left.
        track_share: of the track width, as a share of it.
        scale_share: of the mean radius, likewise; None where nothing was learned of it.
        daily: or the default.
    """
    daily = daily or FromDayToDay()
    scale = wheels.scale_sigma if scale_share is None else float(np.hypot(scale_share, daily.scale))
    drift = float(np.hypot(ratio_sigma / wheels.track_width_m, daily.drift_rad_per_m))
    turn = float(np.hypot(track_share, daily.turn))
    return replace(
        wheels, scale_sigma=min(scale, 1.0), drift_sigma_rad_per_m=min(drift, 1.0), turn_sigma=min(turn, 1.0)
    )
