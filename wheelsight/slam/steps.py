"""What odometry says between two keyframes, as an edge of the graph; and what holds the first one."""

from __future__ import annotations

import numpy as np

from wheelsight.geometry import FloatArray
from wheelsight.geometry import motion_kernels as motions
from wheelsight.keyframes import KeyframeId
from wheelsight.slam.graph import Prior, RelativePose
from wheelsight.slam.settings import MatchSettings

# The first keyframe holds the map where it began; so little, in metres and radians, is as good as exact.
ANCHOR_SIGMA = 1e-4


def anchor(keyframe: KeyframeId, T_map_keyframe: FloatArray) -> Prior:
    """A keyframe (4, 4) that stays where it is."""
    return Prior(keyframe, T_map_keyframe, ANCHOR_SIGMA**2 * np.eye(6))


def step_edge(
    second: KeyframeId,
    before: tuple[FloatArray, FloatArray],
    now: tuple[FloatArray, FloatArray],
    settings: MatchSettings,
) -> RelativePose:
    """From the keyframe before `second` to it, by poses (4, 4) with covariances (6, 6) that grow along the way."""
    T_step, _ = motions.between(*before, *now)
    _, grown = motions.step_between(*before, *now)
    least = np.diag(np.square([settings.plane_sigma_m] * 3 + [settings.plane_sigma_rad] * 3))
    return RelativePose(KeyframeId(second - 1), second, T_step, grown + least)
