"""How much of a recording the estimate speaks about: an error says nothing of frames without a pose."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from wheelsight.association import associate
from wheelsight.errors import EvaluationError
from wheelsight.geometry import BoolArray, FloatArray
from wheelsight.trajectory import Trajectory

# Stamps of one frame in two files differ by no more than their last decimal.
_SAME_STAMP_S = 1e-3


def frame_coverage(estimate: Trajectory, frame_stamps_s: ArrayLike) -> float:
    """The share, 0 to 1, of listed frames at stamps (N,) seconds that have a pose.

    Raises EvaluationError when no frame is listed.
    """
    frames = np.asarray(frame_stamps_s, float)
    if not len(frames):
        raise EvaluationError("no frames are listed, so no share of them can have a pose")
    return len(associate(estimate.stamps_s, frames, _SAME_STAMP_S)) / len(frames)


def time_coverage(estimate: Trajectory, truth: Trajectory, max_step_s: float = 0.5) -> float:
    """The share, 0 to 1, of the truth's time that the estimate covers too.

    A trajectory covers the time between neighbouring stamps that are at most `max_step_s` seconds apart, or twice
    the truth's usual step where that is longer. Raises EvaluationError when the truth has fewer than two poses.
    """
    if len(truth) < 2:
        raise EvaluationError(f"a ground truth of {len(truth)} poses covers no time")
    max_step_s = max(max_step_s, 2 * float(np.median(np.diff(truth.stamps_s))))
    stamps_s = np.union1d(estimate.stamps_s, truth.stamps_s)
    middle_s, step_s = (stamps_s[1:] + stamps_s[:-1]) / 2, np.diff(stamps_s)
    in_truth = _covers(truth, middle_s, max_step_s)
    in_both = in_truth & _covers(estimate, middle_s, max_step_s)
    return float(step_s[in_both].sum() / step_s[in_truth].sum())


def pairing_warning(estimate: Trajectory, truth: Trajectory, pairs: int, max_gap_s: float) -> str | None:
    """A sentence where `pairs` are less than half of what both have in the time they share, else None.

    So it goes where two streams run at rates of their own: most poses of either then lie between two of the other.
    """
    if min(len(estimate), len(truth)) < 2:
        return None
    start_s, end_s = max(estimate.stamps_s[0], truth.stamps_s[0]), min(estimate.stamps_s[-1], truth.stamps_s[-1])
    there = min(len(trajectory.between(start_s, end_s)) for trajectory in (estimate, truth))
    if 2 * pairs >= there:
        return None
    step_s = min(float(np.median(np.diff(trajectory.stamps_s))) for trajectory in (estimate, truth))
    return (
        f"Only {pairs} of {there} poses have one of the ground truth within {max_gap_s:g} s, and errors are of these: "
        f"set evaluation.max_gap_s to {0.6 * step_s:.2g} to compare all that lie between."
    )


def _covers(trajectory: Trajectory, stamps_s: FloatArray, max_step_s: float) -> BoolArray:
    """Whether each of stamps (N,), none of them a pose's, lies in a step that is not too long."""
    if len(trajectory) < 2:
        return np.zeros(len(stamps_s), bool)
    after = np.searchsorted(trajectory.stamps_s, stamps_s)
    inside = (after > 0) & (after < len(trajectory))
    steps_s = np.diff(trajectory.stamps_s)[(after - 1).clip(0, len(trajectory) - 2)]
    return np.asarray(inside & (steps_s <= max_step_s))
