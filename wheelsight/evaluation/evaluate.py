"""evaluate: all that is asked of an estimate, at once."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from numpy.typing import ArrayLike

from wheelsight.errors import EvaluationError
from wheelsight.evaluation.ate import AbsoluteError, ate
from wheelsight.evaluation.coverage import frame_coverage, time_coverage
from wheelsight.evaluation.doubts import doubts_of
from wheelsight.evaluation.rpe import RelativeError, Unit, rpe
from wheelsight.trajectory import Trajectory


@dataclass(frozen=True, slots=True, eq=False)
class Evaluation:
    """An estimate against the truth.

    Attributes:
        ate: the absolute error after rigid alignment.
        rpe_per_frame: the relative error over a frame, None where no step is so long.
        rpe_per_second: the same over a second.
        rpe_per_metre: the same over a metre of the truth.
        pairs: how many poses had a true one within `max_gap_s` seconds.
        max_gap_s: see `pairs`.
        frames_with_pose: share of the listed frames, 0 to 1, or None where none were listed.
        truth_time_covered: share of the truth's time, 0 to 1.
        scale: by which the estimate was multiplied, or None unless asked for.
        warnings: one sentence each, of what one of the two files seems to hold wrongly.
    """

    ate: AbsoluteError
    rpe_per_frame: RelativeError | None
    rpe_per_second: RelativeError | None
    rpe_per_metre: RelativeError | None
    pairs: int
    max_gap_s: float
    frames_with_pose: float | None
    truth_time_covered: float
    scale: float | None = None
    warnings: tuple[str, ...] = ()

    def to_dict(self) -> dict[str, Any]:
        """Nested plain values with units in their names, for metrics.json."""
        figures: dict[str, Any] = {
            "pairs": self.pairs,
            "max_gap_s": self.max_gap_s,
            "frames_with_pose": self.frames_with_pose,
            "truth_time_covered": self.truth_time_covered,
            "scale": self.scale,
            "T_truth_estimate": self.ate.T_truth_estimate.tolist(),
        }
        errors = {"ate": self.ate, **{name: getattr(self, name) for name in _STEPS}}
        for name, error in errors.items():
            figures[f"{name}_m"] = None if error is None else error.translation.to_dict()
            figures[f"{name}_deg"] = None if error is None else error.rotation.in_degrees().to_dict()
        return figures


_STEPS: dict[str, Unit] = {"rpe_per_frame": "frames", "rpe_per_second": "seconds", "rpe_per_metre": "metres"}


def evaluate(
    estimate: Trajectory,
    truth: Trajectory,
    *,
    frame_stamps_s: ArrayLike | None = None,
    max_gap_s: float = 0.02,
    with_scale: bool = False,
) -> Evaluation:
    """ATE, RPE over a frame, a second and a metre, and coverage of an estimate.

    Args:
        frame_stamps_s: (N,) of all frames that could have had a pose, seconds.
        max_gap_s: a pose is compared with the true one nearest in time, at most so far away.
        with_scale: also fit the estimate's scale, as for a camera without depth; the RPE is then of the scaled one.

    Raises:
        EvaluationError: different bodies, or too little in common: the message says what each spans.
    """
    doubts = doubts_of(estimate, truth, max_gap_s)
    try:
        absolute = ate(estimate, truth, max_gap_s=max_gap_s, with_scale=with_scale)
    except EvaluationError as error:
        raise EvaluationError(" ".join((f"{error}.", *doubts)) if doubts else str(error)) from error
    relative = {name: _rpe_or_none(absolute.aligned, truth, unit, max_gap_s) for name, unit in _STEPS.items()}
    return Evaluation(
        ate=absolute,
        **relative,
        pairs=len(absolute.stamps_s),
        max_gap_s=max_gap_s,
        frames_with_pose=None if frame_stamps_s is None else frame_coverage(estimate, frame_stamps_s),
        truth_time_covered=time_coverage(estimate, truth),
        scale=absolute.scale if with_scale else None,
        warnings=doubts,
    )


def _rpe_or_none(estimate: Trajectory, truth: Trajectory, unit: Unit, max_gap_s: float) -> RelativeError | None:
    try:
        return rpe(estimate, truth, 1, unit, max_gap_s=max_gap_s)
    except EvaluationError:
        return None
