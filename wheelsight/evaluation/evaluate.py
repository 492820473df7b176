"""`evaluate` returns ATE, RPE and coverage of an estimate, with warnings about units of stamps, pairing and the
order of quaternions.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from wheelsight.core.errors import EvaluationError
from wheelsight.core.geometry import BoolArray, FloatArray, so3
from wheelsight.core.stamps import NUMBERS, UNITS, StampUnit, associate, unit_of
from wheelsight.core.trajectory import Trajectory
from wheelsight.evaluation.ate import AbsoluteError, ate
from wheelsight.evaluation.rpe import RelativeError, Unit, rpe

# evaluate: all that is asked of an estimate, at once.


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


# How much of a recording the estimate speaks about: an error says nothing of frames without a pose.


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


# What two trajectories say of a mistake in one of their files: units of stamps, the order of quaternions.


ESTIMATE, TRUTH = "estimate", "ground truth"
# Two files of one drive reach over the same time, within such a factor.
_SAME_SPAN = 1.5
# Turns between compared poses, where they are large enough to tell axes: radians, and how many.
_LEAST_TURN_RAD, _FEWEST_TURNS = 0.15, 5
# Turns are told wrongly by so much of themselves, and by so little once the order of four numbers is changed.
_WRONG_SHARE, _RIGHT_SHARE = 0.6, 0.2
_FIRST_W_OF_XYZW = [1, 2, 3, 0]


def doubts_of(estimate: Trajectory, truth: Trajectory, max_gap_s: float) -> tuple[str, ...]:
    """A sentence for each mistake that the two seem to hold; few if any."""
    if estimate.body != truth.body or not len(estimate) or not len(truth):
        return ()
    pairs = associate(estimate.stamps_s, truth.stamps_s, max_gap_s)
    of_units = _unit_doubts(estimate, truth, are_paired=2 * len(pairs) >= min(len(estimate), len(truth)))
    few = _pairing_doubt(estimate, truth, len(pairs), max_gap_s, is_explained=bool(of_units))
    order = None if of_units else _order_doubt(estimate.select(pairs[:, 0]), truth.select(pairs[:, 1]))
    return tuple(filter(None, (*of_units, few, order)))


def _unit_doubts(estimate: Trajectory, truth: Trajectory, *, are_paired: bool) -> list[str]:
    """By how much longer one is than the other, unless most poses are paired; else by the stamps of each alone."""
    given = {ESTIMATE: estimate.stamps_s, TRUTH: truth.stamps_s}
    units = {name: unit for name, stamps in given.items() if (unit := unit_of(stamps)) is not None}
    if len(units) == 2 and len(set(units.values())) == 1:
        return [f"The stamps of both look like {_kind(units[TRUTH])}, not seconds: a second in these figures is none."]
    if not are_paired:
        units = _unit_by_span(given) or units
    return [_unit_sentence(name, units[name], given[name]) for name in units]


def _unit_by_span(given: dict[str, FloatArray]) -> dict[str, StampUnit]:
    spans = {name: float(np.ptp(stamps)) for name, stamps in given.items()}
    (short, long) = sorted(spans, key=lambda name: spans[name])
    for unit in UNITS:
        assert unit.per_second is not None
        if spans[short] > 0 and 1 / _SAME_SPAN < spans[long] / spans[short] / unit.per_second < _SAME_SPAN:
            return {long: unit}
    return {}


def _unit_sentence(name: str, unit: StampUnit, stamps: FloatArray) -> str:
    by = "the poses a second" if unit.per_second is None else f"{unit.per_second:.0f}"
    span = f"{stamps[0]:.15g} to {stamps[-1]:.15g}"
    return f"The {name}'s stamps ({span}) look like {_kind(unit)}, not seconds: divide them by {by}."


def _kind(unit: StampUnit) -> str:
    return "numbers of poses" if unit is NUMBERS else unit.name


def _pairing_doubt(
    estimate: Trajectory, truth: Trajectory, pairs: int, max_gap_s: float, *, is_explained: bool
) -> str | None:
    """That few poses are compared, though both tell of them; another unit explains it, and no gap mends it then."""
    if is_explained:
        count = min(len(estimate), len(truth))
        few = f"Only {pairs} of {len(estimate)} poses have a true one within {max_gap_s:g} s, and errors are of these."
        return few if 2 * pairs < count else None
    return pairing_warning(estimate, truth, pairs, max_gap_s)


def _order_doubt(estimate: Trajectory, truth: Trajectory) -> str | None:
    """That turns, told about wrong axes, would be right if the four numbers of one file began with w, not x.

    Angles between poses do not change with the order, axes do. `estimate` and `truth` are M pairs.
    """
    R_estimate, R_truth = (t.T_frame_body[:, :3, :3] for t in (estimate, truth))
    first, second = _turns(R_truth)
    if len(first) < _FEWEST_TURNS:
        return None
    turn_rad = float(np.median(so3.angle(_between(R_truth, first, second))))

    def off(R_a: FloatArray, R_b: FloatArray) -> float:
        a, b = _between(R_a, first, second), _between(R_b, first, second)
        return float(np.median(so3.angle(np.swapaxes(a, 1, 2) @ b))) / turn_rad

    if off(R_estimate, R_truth) < _WRONG_SHARE:
        return None
    mended = {ESTIMATE: off(_reordered(R_estimate), R_truth), TRUTH: off(R_estimate, _reordered(R_truth))}
    likely = [name for name, share in mended.items() if share < _RIGHT_SHARE]
    if not likely:
        return None
    return f"Quaternions of the {' or of the '.join(likely)} seem to be written qw qx qy qz: write qx qy qz qw."


def _turns(R: FloatArray) -> tuple[np.ndarray, np.ndarray]:
    """Pairs (K,), (K,) of places in R (M, 3, 3), as near as each other as shows a turn at some of them."""
    count = len(R)
    step = 1
    while step < count:
        first = np.arange(count - step)
        enough = so3.angle(_between(R, first, first + step)) > _LEAST_TURN_RAD
        if np.count_nonzero(enough) >= _FEWEST_TURNS:
            return first[enough], first[enough] + step
        step *= 2
    return np.empty(0, int), np.empty(0, int)


def _between(R: FloatArray, first: np.ndarray, second: np.ndarray) -> FloatArray:
    return np.asarray(np.swapaxes(R[first], 1, 2) @ R[second])


def _reordered(R: FloatArray) -> FloatArray:
    """Rotations (M, 3, 3) by quaternions whose first number, read as x, is w."""
    return so3.from_quaternion(so3.to_quaternion(R)[:, _FIRST_W_OF_XYZW])
