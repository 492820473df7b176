"""Which pose of the estimate stands beside which true pose."""

from __future__ import annotations

from wheelsight.association import associate
from wheelsight.errors import EvaluationError
from wheelsight.trajectory import Trajectory

_FEWEST_PAIRS = 3


def matched(estimate: Trajectory, truth: Trajectory, max_gap_s: float) -> tuple[Trajectory, Trajectory]:
    """The poses of both that belong together (M each), at most `max_gap_s` seconds apart, each used once.

    Raises:
        EvaluationError: the two describe different bodies, or share fewer than three pairs: says what they span.
    """
    if estimate.body != truth.body:
        raise EvaluationError(
            f"the estimate is T_{estimate.frame}_{estimate.body} but the ground truth T_{truth.frame}_{truth.body}: "
            f"the {estimate.body} and the {truth.body} move differently (convert one by T_base_camera; where a file's "
            "header does not name its frames, say --body)"
        )
    pairs = associate(estimate.stamps_s, truth.stamps_s, max_gap_s)
    if len(pairs) < _FEWEST_PAIRS:
        raise EvaluationError(_too_few(estimate, truth, len(pairs), max_gap_s))
    return estimate.select(pairs[:, 0]), truth.select(pairs[:, 1])


def _too_few(estimate: Trajectory, truth: Trajectory, pairs: int, max_gap_s: float) -> str:
    spans = f"the estimate spans {_span(estimate)}, the ground truth {_span(truth)}"
    shared_s = 0.0
    if len(estimate) and len(truth):
        start_s, end_s = max(estimate.stamps_s[0], truth.stamps_s[0]), min(estimate.stamps_s[-1], truth.stamps_s[-1])
        shared_s = end_s - start_s
    overlap = f"they share {shared_s:.3f} s" if shared_s > 0 else "they do not overlap in time"
    found = f"{pairs} of the estimate's poses within {max_gap_s:g} s of a true one, {_FEWEST_PAIRS} needed"
    return f"{found}: {spans}; {overlap}"


def _span(trajectory: Trajectory) -> str:
    if not len(trajectory):
        return "nothing (no poses)"
    return f"{trajectory.stamps_s[0]:.3f} to {trajectory.stamps_s[-1]:.3f} s"
