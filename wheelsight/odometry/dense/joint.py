"""SurfaceWeight: how much surfaces count beside keypoints, learned by how far both disagree.

What an alignment of surfaces claims rests on the sensor's noise, which averages out over a hundred thousand pixels.
What does not average out is far larger on real cameras: depth that is of another instant than colour, that is not quite
registered, or bent. Keypoints show how large it is. Their motions differ from those of surfaces by both covariances, of
which that of surfaces has an unknown factor: variance components tell it (Helmert; Förstner 1979).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from wheelsight.geometry import FloatArray, se3
from wheelsight.odometry.dense.settings_parts import JointSettings


@dataclass(frozen=True, slots=True, eq=False)
class Told:
    """What keypoints tell of a motion: where the frame is (4, 4), and information (6, 6) of its left perturbation."""

    T_reference_frame: FloatArray
    information: FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class Joint:
    """A motion by both.

    Attributes:
        T_reference_frame: (4, 4).
        ahead: (6,) how far keypoints lead beyond surfaces alone, as a left perturbation.
        factor: by which the covariance of surfaces was taken larger than they claim.
        seen_factor: what this frame alone says of that.
    """

    T_reference_frame: FloatArray
    ahead: FloatArray
    factor: float
    seen_factor: float


class SurfaceWeight:
    """Learns the factor on the covariance of what surfaces say, of one camera in one place.

    Attributes:
        factor: as learned so far, at least 1.
    """

    def __init__(self, settings: JointSettings) -> None:
        self._settings = settings
        self.factor = settings.first_factor

    def learn(self, joint: Joint) -> None:
        """Take a frame whose pose was accepted as an example."""
        self.factor *= (joint.seen_factor / self.factor) ** self._settings.learned

    def meet(self, T_reference_frame: FloatArray, surfaces: FloatArray, told: Told) -> Joint:
        """A motion (4, 4) found by both with the factor known before, or with its own where that is too small.

        Args:
            T_reference_frame: where keypoints and surfaces meet, the latter by the factor learned.
            surfaces: (6, 6) information of the left perturbation that surfaces claim.
            told: what keypoints say.
        """
        root = np.linalg.cholesky(told.information)
        whitened = np.linalg.solve(root, np.linalg.solve(root, surfaces).T)
        claimed, directions = np.linalg.eigh(0.5 * (whitened + whitened.T))
        claimed = np.maximum(claimed, 1e-9)
        # From where both meet to where keypoints lead, in their standard deviations.
        off = directions.T @ root.T @ se3.log(told.T_reference_frame @ se3.invert(T_reference_frame))
        apart = off * (1 + self.factor / claimed)
        seen = self._seen(apart, claimed)
        is_odd = (apart**2 / (1 + self.factor / claimed)).sum() > self._settings.odd_chi2
        factor = max(self.factor, seen) if is_odd else self.factor
        share = claimed / factor / (1 + claimed / factor)
        back = np.linalg.solve(root.T, directions @ (share * apart))
        ahead = np.linalg.solve(root.T, directions @ apart)
        return Joint(se3.exp(-back) @ told.T_reference_frame, ahead, factor, seen)

    def _seen(self, apart: FloatArray, claimed: FloatArray) -> float:
        """The factor by which disagreements (6,) exceed what is `claimed` (6,), along directions that surfaces show."""
        shown = claimed > self._settings.shown
        if not shown.any():
            return self.factor
        excess = float((apart[shown] ** 2 - 1).sum() / (1 / claimed[shown]).sum())
        return float(np.clip(excess, 1.0, self._settings.most))
