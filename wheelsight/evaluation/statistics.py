"""Statistics of errors and of sequences (Zhang's Table 2), the pairing of estimated and true poses, and steps along
time or distance.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from wheelsight.core.errors import EvaluationError
from wheelsight.core.geometry import FloatArray, IntArray, so3
from wheelsight.core.stamps import associate
from wheelsight.core.trajectory import Trajectory


@dataclass(frozen=True, slots=True)
class Statistics:
    """Statistics of `count` errors, in their unit; `std` is of the population (divided by `count`)."""

    rmse: float
    mean: float
    median: float
    max: float
    min: float
    std: float
    count: int

    @classmethod
    def of(cls, errors: ArrayLike) -> Statistics:
        """Return the statistics of errors (N,). Raises EvaluationError if there are none, or one is not finite."""
        e = np.asarray(errors, float).ravel()
        if not len(e) or not np.isfinite(e).all():
            raise EvaluationError("statistics need at least one error, all of them finite")
        return cls(
            rmse=float(np.sqrt(np.mean(e**2))),
            mean=float(e.mean()),
            median=float(np.median(e)),
            max=float(e.max()),
            min=float(e.min()),
            std=float(e.std()),
            count=len(e),
        )

    def in_degrees(self) -> Statistics:
        """Return the statistics of angles in radians in degrees."""
        degrees: dict[str, Any] = {name: float(np.degrees(value)) for name, value in asdict(self).items()}
        return Statistics(**{**degrees, "count": self.count})

    def to_dict(self) -> dict[str, float]:
        """Return the fields by name, for metrics.json."""
        return asdict(self)


_STAMP_ROUNDING_S = 1e-6  # seconds since 1970 as float64 are exact to a quarter of it


@dataclass(frozen=True, slots=True)
class SequenceStatistics:
    """Figures of a trajectory.

    Attributes:
        duration_s: from the first stamp to the last.
        posed_duration_s: number of poses times their usual period.
        length_m: of the path through all poses, including noise.
        windowed_length_m: of the path in whole steps of `window_s`, averaged over the start of the first step; shorter,
            since it cuts corners and leaves out the last, incomplete step.
        mean_speed_m_per_s, mean_angular_speed_rad_per_s: means over all windows of `window_s`.
        extent_m: along the map's x, y and z.
        window_s: at most the duration.
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
    """Return duration, length, speeds and extent of a trajectory (Zhang, Table 2).

    Zhang's figures are those of the TUM benchmark's page, which does not define them. Speeds over a window from each
    pose to the one nearest to `window_s` later reproduce all digits for fr1/desk (0.413 m/s, 23.327 °/s). Its length of
    9.263 m is not that of the path through all poses (10.599 m), but within 4 mm the windowed length (9.260 m). The
    motion in all windows, divided by the mean number of poses in one, has all digits (9.2635 m), but is no length for
    short trajectories.

    Raises:
        EvaluationError: fewer than two poses.
    """
    if len(trajectory) < 2:
        raise EvaluationError(f"a motion needs two poses; the trajectory has {len(trajectory)}")
    duration_s = trajectory.duration_s
    window_s = min(window_s, duration_s)
    # Over all windows that end within the trajectory.
    stamps_s, R = trajectory.stamps_s, trajectory.T_frame_body[:, :3, :3]
    start, end = steps_along(stamps_s, window_s)
    whole = stamps_s[start] + window_s <= stamps_s[-1] + _STAMP_ROUNDING_S
    start, end = start[whole], end[whole]
    elapsed_s = stamps_s[end] - stamps_s[start]
    moved_m = np.linalg.norm(trajectory.positions_m[end] - trajectory.positions_m[start], axis=1)
    turned_rad = so3.angle(np.swapaxes(R[start], 1, 2) @ R[end])
    speed, angular_speed = float(np.mean(moved_m / elapsed_s)), float(np.mean(turned_rad / elapsed_s))
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


_FEWEST_PAIRS = 3


def matched(estimate: Trajectory, truth: Trajectory, max_gap_s: float) -> tuple[Trajectory, Trajectory]:
    """Return the matching poses of both (M each), at most `max_gap_s` seconds apart, each used once.

    Raises:
        EvaluationError: different bodies, or fewer than three pairs.
    """
    if estimate.body != truth.body:
        raise EvaluationError(
            f"the estimate is T_{estimate.frame}_{estimate.body} but the ground truth T_{truth.frame}_{truth.body}: "
            f"the {estimate.body} and the {truth.body} move differently (convert one by T_base_camera; where a file's "
            "header does not name its frames, say --body)"
        )
    pairs = associate(estimate.stamps_s, truth.stamps_s, max_gap_s)
    if len(pairs) < _FEWEST_PAIRS:
        spans = f"the estimate spans {_span(estimate)}, the ground truth {_span(truth)}"
        shared_s = 0.0
        if len(estimate) and len(truth):
            start_s, end_s = (
                max(estimate.stamps_s[0], truth.stamps_s[0]),
                min(estimate.stamps_s[-1], truth.stamps_s[-1]),
            )
            shared_s = end_s - start_s
        overlap = f"they share {shared_s:.3f} s" if shared_s > 0 else "they do not overlap in time"
        found = f"{len(pairs)} of the estimate's poses within {max_gap_s:g} s of a true one, {_FEWEST_PAIRS} needed"
        raise EvaluationError(f"{found}: {spans}; {overlap}")
    return estimate.select(pairs[:, 0]), truth.select(pairs[:, 1])


def _span(trajectory: Trajectory) -> str:
    if not len(trajectory):
        return "nothing (no poses)"
    return f"{trajectory.stamps_s[0]:.3f} to {trajectory.stamps_s[-1]:.3f} s"


def steps_along(along: FloatArray, delta: float) -> tuple[IntArray, IntArray]:
    """Return indices (N-1,) of each of non-decreasing values (N,), and of the later one nearest to `delta` further on.

    The first of equally near ones; the caller checks the distance.
    """
    start = np.arange(len(along) - 1)
    wanted = along[:-1] + delta
    after = np.searchsorted(along, wanted).clip(1, len(along) - 1)
    end = np.where(wanted - along[after - 1] <= along[after] - wanted, after - 1, after)
    end = np.searchsorted(along, along[end])
    return start, np.maximum(end, start + 1)
