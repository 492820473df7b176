"""How noisy the wheels are: Odometer and Preintegration, what they tell, and WheelNoise, which is learned of it.

It is learned from how that fits a camera that is believed.

A calibration tells of wheels how far they slip in a metre on whatever floor (`slip_m_per_sqrt_m`); on the one that is
driven they may hold ten times as well. What a filter thinks of them decides what it believes of the camera after the
dark, and in a crowd. So the ratio ρ of their variance to the calibration's is part of what it knows, as a distribution
over a few values (multiple models: Magill 1965): from one remembered pose to the next, camera and wheels differ in way
and turn by d ~ N(0, R + ρ N), with N the wheels' covariance by the calibration and R all else that is uncertain.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from wheelsight.fusion.error_state import _pose_kernels as kernels
from wheelsight.fusion.error_state import _relative_pose_kernels as relative
from wheelsight.fusion.error_state._changed import changed
from wheelsight.fusion.error_state._measurements import RelativePose, WheelStep
from wheelsight.fusion.error_state._pose_belief import ERRORS, LAG, PLANE, TWIST, PoseBelief
from wheelsight.fusion.error_state.settings import FilterParameters
from wheelsight.geometry import FloatArray
from wheelsight.geometry import motion_kernels as motions

_VALUES = 21
_WAY_AND_TURN = np.array([0, 5])
_IN_THESE = np.ix_(_WAY_AND_TURN, _WAY_AND_TURN)
_ERRORS = slice(ERRORS.start, LAG + 1)


@dataclass(frozen=True, eq=False)
class Odometer:
    """What wheels and gyroscope alone tell, whoever is believed: sums since the filter began, or between two instants.

    Attributes:
        T: (4, 4) the wheels' motion, and its covariance (6, 6) by their calibration, as a left perturbation.
        way_m: of both wheels' middle.
        heard_s: for how long they told anything.
        turn_rad: by the gyroscope, and for how long it told anything: turned_s.
    """

    T: FloatArray = field(default_factory=lambda: np.eye(4))
    covariance: FloatArray = field(default_factory=lambda: np.zeros((6, 6)))
    way_m: float = 0.0
    heard_s: float = 0.0
    turn_rad: float = 0.0
    turned_s: float = 0.0

    def moved_by_wheels(self, step: WheelStep, share: float) -> Odometer:
        """After a share of a wheel step."""
        T, covariance = kernels.odometer(self.T, self.covariance, step.xi, step.covariance, share)
        way_m, heard_s = abs(step.xi[0]) * share, (step.end_s - step.begin_s) * share
        return changed(self, T=T, covariance=covariance, way_m=self.way_m + way_m, heard_s=self.heard_s + heard_s)

    def turned(self, turn_rad: float, seconds: float) -> Odometer:
        """After a turn that the gyroscope told."""
        return changed(self, turn_rad=self.turn_rad + turn_rad, turned_s=self.turned_s + seconds)

    def since(self, before: Odometer) -> Odometer:
        """What was told since it stood as `before`."""
        moved = motions.between(before.T, before.covariance, self.T, self.covariance)
        turn = self.turn_rad - before.turn_rad, self.turned_s - before.turned_s
        return Odometer(*moved, self.way_m - before.way_m, self.heard_s - before.heard_s, *turn)


@dataclass(frozen=True, eq=False)
class Preintegration:
    """Of the wheels alone, since a pose was remembered.

    Attributes:
        name, begin_s: of that pose.
        begin: the odometer then.
        spread: (6, 6) by which the camera may have that pose elsewhere, in its frame.
        errors, unsure: (13,) of wheels and camera as known then, and their covariance (13, 13).
        twist: (3,) of the base then.
    """

    name: str
    begin_s: float
    begin: Odometer
    spread: FloatArray
    errors: FloatArray
    unsure: FloatArray
    twist: FloatArray

    @classmethod
    def of(
        cls, name: str, stamp_s: float, odometer: Odometer, spread: FloatArray | None, belief: PoseBelief
    ) -> Preintegration:
        """From a pose that is about to be remembered."""
        rows, none = belief.place(_ERRORS), np.zeros((6, 6))
        known = belief.rest[_ERRORS].copy(), belief.covariance[rows, rows].copy(), belief.rest[TWIST].copy()
        return cls(name, stamp_s, odometer, none if spread is None else spread, *known)

    def is_told(self, told: Odometer, stamp_s: float, share: float) -> bool:
        """Whether the wheels moved since, and told of such a share of the time up to a stamp."""
        return told.heard_s > share * (stamp_s - self.begin_s) and bool(told.covariance[5, 5] > 0)

    def against(
        self, measurement: RelativePose, told: Odometer, belief: PoseBelief
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        """D (2,), by what way and turn a measurement against that pose differs from the wheels; R and N (2, 2)."""
        at = belief.reference(measurement.name)
        since = belief.since(at)
        _, B, Ad = relative.expected(*since)
        late = motions.adjoint(measurement.Z)[:, PLANE] @ belief.rest[TWIST]
        late[PLANE] -= self.twist
        J = np.column_stack([Ad @ since[2], -B, -late])[_WAY_AND_TURN]
        off = motions.log(motions.times(measurement.Z, motions.inverse(told.T)))[_WAY_AND_TURN]
        # By the errors as known before: what the measurement itself has taught of them would make it fit too well.
        R = (measurement.spread + self.spread)[_IN_THESE] + J @ self.unsure @ J.T
        return off - J @ self.errors, R, told.covariance[_IN_THESE]


@dataclass(frozen=True, eq=False)
class WheelNoise:
    """The ratio of the wheels' variance to the calibration's.

    Attributes:
        nats: (21,) log of how likely each of `ratios` is, up to a constant; None before the first.
        ratio: its mean.
    """

    nats: FloatArray | None = None
    ratio: float = 1.0

    def after(
        self,
        preintegration: Preintegration,
        told: Odometer,
        measurement: RelativePose,
        belief: PoseBelief,
        settings: FilterParameters,
    ) -> WheelNoise:
        """After a measurement against the pose where it began; what was known fades along the way."""
        d, R, N = preintegration.against(measurement, told, belief)
        ratios = np.geomspace(settings.wheel_noise_least, settings.wheel_noise_most, _VALUES)
        before = -0.5 * np.abs(np.log2(ratios))  # a calibration may be wrong by a factor of four as well as by two
        S = R + ratios[:, None, None] * N
        if not (np.linalg.eigvalsh(S)[:, 0] > 0).all():  # rounding has left nothing of so small a difference
            return self
        chi2 = (np.linalg.solve(S, np.broadcast_to(d[:, None], (len(S), 2, 1)))[..., 0] * d).sum(axis=1)
        likely = -0.5 * (chi2 + np.log(np.linalg.det(S)))
        known = before if self.nats is None else self.nats
        kept = before + np.exp(-told.way_m / settings.wheel_noise_memory_m) * (known - before)
        nats = kept + np.maximum(likely - likely.max(), -settings.wheel_noise_cap_nats)
        weights = np.exp(nats - nats.max())
        return WheelNoise(nats, float(weights @ ratios / weights.sum()))
