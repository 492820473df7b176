"""Odometer: what wheels and gyroscope alone tell, whoever is believed."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from wheelsight.fusion.error_state import _step_kernels as steps
from wheelsight.fusion.error_state._changed import changed
from wheelsight.fusion.error_state._measurements import WheelStep
from wheelsight.geometry import FloatArray
from wheelsight.geometry import motion_kernels as motions


@dataclass(frozen=True, eq=False)
class Odometer:
    """Sums since the filter began, or, by `since`, between two instants.

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
        T, covariance = steps.odometer(self.T, self.covariance, step.xi, step.covariance, share)
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
