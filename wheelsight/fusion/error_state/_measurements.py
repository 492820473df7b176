"""What sensors tell, as a PoseBelief takes it: WheelStep, RelativePose; and what it makes of it, Innovation."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from wheelsight.geometry import FloatArray, IntArray


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
    """

    name: str
    Z: FloatArray
    seen: FloatArray
    covariance: FloatArray
    spread: FloatArray
    inlier_share: float | None = None


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
