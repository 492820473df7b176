"""Edges between successive keyframes, from estimates whose covariances grow along the way."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Self

from wheelsight.estimates import Estimate
from wheelsight.geometry import FloatArray, se3
from wheelsight.keyframes import KeyframeId
from wheelsight.slam.graph import RelativePose
from wheelsight.slam.sessions.settings import SessionSettings
from wheelsight.slam.steps import step_edge


@dataclass(frozen=True, slots=True, eq=False)
class SeenKeyframe:
    """A keyframe as the estimate at its own frame has it.

    Attributes:
        number: of the keyframe.
        T_odom_keyframe: (4, 4), or None where that estimate tells none.
        covariance: (6, 6) of its left perturbation (v, ω), or None.
    """

    number: KeyframeId
    T_odom_keyframe: FloatArray | None = None
    covariance: FloatArray | None = None

    @classmethod
    def of(cls, number: KeyframeId, estimate: Estimate | None) -> Self:
        """By the estimate at the frame of which the keyframe was made."""
        if estimate is None or estimate.keyframe != number or estimate.T_filter_body is None:
            return cls(number)
        if estimate.T_keyframe_body is None:
            return cls(number)
        T_odom_keyframe = se3.nearest(estimate.T_filter_body @ se3.invert(estimate.T_keyframe_body))
        return cls(number, T_odom_keyframe, estimate.filter_covariance)


def odometry_edge(before: SeenKeyframe, now: SeenKeyframe, settings: SessionSettings) -> RelativePose | None:
    """The way from a keyframe to the next, as uncertain as covariances grew on it; None where odometry tells none."""
    T_before, C_before, T_now, C_now = before.T_odom_keyframe, before.covariance, now.T_odom_keyframe, now.covariance
    if T_before is None or C_before is None or T_now is None or C_now is None:
        return None
    return step_edge((before.number, now.number), (T_before, C_before), (T_now, C_now), settings)
