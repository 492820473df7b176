"""What odometry says between two keyframes, as an edge of the graph; and what holds the first one."""

from __future__ import annotations

import numpy as np

from wheelsight.geometry import FloatArray
from wheelsight.geometry import motion_kernels as motions
from wheelsight.keyframes import KeyframeId
from wheelsight.slam.graph import Prior, RelativePose
from wheelsight.slam.settings import StepSettings

# The first keyframe holds the map where it began; so little, in metres and radians, is as good as exact.
ANCHOR_SIGMA = 1e-4
# Variances (m² or rad²) above the one tell nothing any more; those below that share of the largest are its rounding.
_UNKNOWN, _ROUNDING = 1e6, 1e-15


def anchor(keyframe: KeyframeId, T_map_keyframe: FloatArray) -> Prior:
    """A keyframe (4, 4) that stays where it is."""
    return Prior(keyframe, T_map_keyframe, ANCHOR_SIGMA**2 * np.eye(6))


def step_edge(
    ends: tuple[KeyframeId, KeyframeId],
    before: tuple[FloatArray, FloatArray],
    now: tuple[FloatArray, FloatArray],
    settings: StepSettings,
) -> RelativePose:
    """From one keyframe to the next, by poses (4, 4) with covariances (6, 6) that grow along the way."""
    T_step, _ = motions.between(*before, *now)
    _, grown = motions.step_between(*before, *now)
    return RelativePose(*ends, motions.mended(T_step), _with_least(grown, settings))


def along_floor(edge: RelativePose, motion: tuple[FloatArray, FloatArray], up: FloatArray) -> RelativePose:
    """An edge by poses that takes from a motion (4, 4), with its covariance (6, 6), what is in the floor's plane.

    `up` (3,) is the plane's normal as the first keyframe has it. Height and tilt are those of the poses: that a floor
    is level is known of each pose, and no motion between two tells it.
    """
    T, C = motion
    floor, turn = np.eye(3) - np.outer(up, up), np.outer(up, up)
    in_plane = np.zeros((6, 6))
    in_plane[:3, :3], in_plane[3:, 3:] = floor, turn
    out_of_plane = np.eye(6) - in_plane
    ahead = in_plane @ motions.log(motions.times(T, motions.inverse(edge.T_first_second)))
    covariance = in_plane @ C @ in_plane + out_of_plane @ edge.covariance @ out_of_plane
    T_first_second = motions.mended(motions.times(motions.exp(ahead), edge.T_first_second))
    return RelativePose(edge.first, edge.second, T_first_second, covariance + ANCHOR_SIGMA**2 * np.eye(6))


def aligned_edge(
    ends: tuple[KeyframeId, KeyframeId], T_first_second: FloatArray, covariance: FloatArray, settings: StepSettings
) -> RelativePose:
    """Between a keyframe and an older one that odometry has come back to: a loop, since neither is the other's next."""
    return RelativePose(*ends, motions.mended(T_first_second), _with_least(covariance, settings), is_loop=True)


def _with_least(C: FloatArray, settings: StepSettings) -> FloatArray:
    """C (6, 6) with what no step is surer than."""
    return _definite(C + np.diag(np.square([settings.plane_sigma_m] * 3 + [settings.plane_sigma_rad] * 3)))


def _definite(C: FloatArray) -> FloatArray:
    """C (6, 6), positive definite by more than rounding.

    A camera before a bare wall was unsure by 10⁶ m along it, and rounding of that variance made others negative.
    """
    variances, axes = np.linalg.eigh((C + C.T) / 2)
    bounded = (axes * np.clip(variances, _ROUNDING * variances[-1], _UNKNOWN)) @ axes.T
    return np.asarray((bounded + bounded.T) / 2)
