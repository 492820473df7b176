"""What a sequence is like: Zhang's Table 2."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from wheelsight.errors import EvaluationError
from wheelsight.evaluation._steps import steps_along
from wheelsight.geometry import so3
from wheelsight.trajectory import Trajectory

# Seconds since 1970 as float64 are exact to a quarter of this.
_STAMP_ROUNDING_S = 1e-6


@dataclass(frozen=True, slots=True)
class SequenceStatistics:
    """A trajectory in a few figures.

    Attributes:
        duration_s: from the first stamp to the last.
        posed_duration_s: how long poses were known: their number times their usual period.
        length_m: of the path through all poses, shaking and measurement noise included.
        windowed_length_m: of the path in whole steps of `window_s`, averaged over where the first step starts;
            shorter, since it cuts corners and leaves out the last, broken step.
        mean_speed_m_per_s: over windows of `window_s`, averaged over all of them.
        mean_angular_speed_rad_per_s: likewise.
        extent_m: along the map's x, y and z.
        window_s: of the windows; the duration, where that is shorter than what was asked for.
    """

    duration_s: float
    posed_duration_s: float
    length_m: float
    windowed_length_m: float
    mean_speed_m_per_s: float
    mean_angular_speed_rad_per_s: float
    extent_m: tuple[float, float, float]
    window_s: float


def sequence_statistics(trajectory: Trajectory, window_s: float = 1.0) -> SequenceStatistics:
    """Duration, length, speeds and extent of a trajectory (Zhang, Table 2).

    Zhang's figures are those of the TUM benchmark's page, which does not define them. The speeds defined here, over
    a window from each pose to the one nearest to `window_s` later, give every digit of them for fr1/desk
    (0.413 m/s, 23.327 °/s). Its length of 9.263 m is no path through all poses, which is 10.599 m long, but
    within 4 mm the windowed length, 9.260 m. Every digit has the sum of what was moved in each of these windows,
    divided by the mean number of poses that one goes on for (9.2635 m), which is no length of shorter trajectories.

    Raises:
        EvaluationError: fewer than two poses.
    """
    if len(trajectory) < 2:
        raise EvaluationError(f"a motion needs two poses; the trajectory has {len(trajectory)}")
    duration_s = trajectory.duration_s
    window_s = min(window_s, duration_s)
    speed, angular_speed = _mean_speeds(trajectory, window_s)
    whole_steps_s = duration_s - window_s if duration_s > window_s else window_s
    x, y, z = np.ptp(trajectory.positions_m, axis=0).tolist()
    return SequenceStatistics(
        duration_s=duration_s,
        posed_duration_s=float(len(trajectory) * np.median(np.diff(trajectory.stamps_s))),
        length_m=trajectory.length_m,
        windowed_length_m=speed * whole_steps_s,
        mean_speed_m_per_s=speed,
        mean_angular_speed_rad_per_s=angular_speed,
        extent_m=(x, y, z),
        window_s=window_s,
    )


def _mean_speeds(trajectory: Trajectory, window_s: float) -> tuple[float, float]:
    """Mean speed (m/s) and angular speed (rad/s) over all windows that end within the trajectory."""
    stamps_s, R = trajectory.stamps_s, trajectory.T_frame_body[:, :3, :3]
    start, end = steps_along(stamps_s, window_s)
    whole = stamps_s[start] + window_s <= stamps_s[-1] + _STAMP_ROUNDING_S
    start, end = start[whole], end[whole]
    elapsed_s = stamps_s[end] - stamps_s[start]
    moved_m = np.linalg.norm(trajectory.positions_m[end] - trajectory.positions_m[start], axis=1)
    turned_rad = so3.angle(np.swapaxes(R[start], 1, 2) @ R[end])
    return float(np.mean(moved_m / elapsed_s)), float(np.mean(turned_rad / elapsed_s))
