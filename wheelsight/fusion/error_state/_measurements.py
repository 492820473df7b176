"""What sensors tell, as a PoseBelief takes it: WheelStep, RelativePose; and what it makes of it, Innovation."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from wheelsight.geometry import FloatArray, IntArray
from wheelsight.geometry import motion_kernels as motions


@dataclass(frozen=True, slots=True, eq=False)
class WheelStep:
    """What the wheels tell of an interval: ξ (6,), and the covariance (6, 6) of the left perturbation of exp(ξ)."""

    begin_s: float
    end_s: float
    xi: FloatArray
    covariance: FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class RelativePose:
    """A motion of the base as the camera saw it against the remembered pose `name`.

    Attributes:
        Z: (4, 4) T_reference_now of the base.
        seen: (m, 6) rows that take a left perturbation of Z to the directions that the camera shows.
        covariance: (m, m) in these.
        spread: (6, 6) of the left perturbation of Z, very wide where nothing is shown.
        inlier_share: of the matches, or None.
        fitting: share of the regions of the view, each with one vote, or None.
    """

    name: str
    Z: FloatArray
    seen: FloatArray
    covariance: FloatArray
    spread: FloatArray
    inlier_share: float | None = None
    fitting: float | None = None


@dataclass(frozen=True, slots=True, eq=False)
class Innovation:
    """A measurement against the belief: residual (m,), its covariance (m, m), that with the state (n, m), its NIS.

    `unlearned` (k,): what of a belief's `rest` it cannot tell from noise. That stays as uncertain as it is, and is
    reckoned with (Schmidt 1966).
    """

    residual: FloatArray
    covariance: FloatArray
    with_state: FloatArray
    nis: float
    unlearned: IntArray = field(default_factory=lambda: np.zeros(0, int))


def is_pose(T: FloatArray | None, covariance: FloatArray | None) -> bool:
    """Whether a pose is there, with its covariance, and both are what they should be."""
    if T is None or covariance is None:
        return False
    return T.shape == (4, 4) and covariance.shape == (6, 6) and bool(motions.is_pose(T, covariance))


def of_unknown_path(xi: FloatArray, swing_rad: float) -> FloatArray:
    """Covariance (6, 6) of a step whose ends are told and whose path is not: anywhere between an early and a late turn.

    An arc with the same ends lies aside of the farthest of them by half of way times turn; unseen, a base may swing.
    """
    way_m, turn_rad = float(np.hypot(xi[0], xi[1])), abs(float(xi[5]))
    aside_m = way_m * (turn_rad / 4 + swing_rad)
    short_m = way_m * (turn_rad / 4 + swing_rad) ** 2
    return np.diag(np.square([short_m, aside_m, 0.0, 0.0, 0.0, 0.0]))
