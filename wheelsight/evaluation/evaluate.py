"""`evaluate` returns ATE, RPE and coverage of an estimate, with warnings about units of stamps, pairing and the
order of quaternions.
"""

from __future__ import annotations

from contextlib import suppress
from dataclasses import dataclass, field
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike

from wheelsight.core.errors import DegenerateGeometryError, EvaluationError
from wheelsight.core.geometry import BoolArray, FloatArray, align_points, align_points_with_scale, se3, so3
from wheelsight.core.stamps import NUMBERS, UNITS, StampUnit, associate, unit_of
from wheelsight.core.trajectory import Trajectory
from wheelsight.evaluation.statistics import Statistics, matched, steps_along

Unit = Literal["frames", "seconds", "metres"]


@dataclass(frozen=True, slots=True, eq=False)
class Evaluation:
    """An estimate compared with the truth.

    Attributes:
        ate: absolute error after rigid alignment.
        rpe_per_frame, rpe_per_second, rpe_per_metre: relative error over a frame, a second, and a metre of the truth;
            None without such steps.
        pairs: number of poses with a true one within `max_gap_s` seconds.
        frames_with_pose: share of the listed frames, 0 to 1, or None.
        truth_time_covered: share of the truth's time, 0 to 1.
        scale: factor of the estimate, or None unless fitted.
        warnings: one sentence for each probable mistake in a file.
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
    """Return ATE, RPE over a frame, a second and a metre, and coverage of an estimate.

    Args:
        estimate, truth: of one body.
        frame_stamps_s: (N,) of all frames that could have a pose, seconds.
        max_gap_s: largest time between an estimated and a true pose.
        with_scale: also fit the estimate's scale, as for a camera without depth; RPE is then of the scaled one.

    Raises:
        EvaluationError: different bodies, or too little in common.
    """
    doubts = doubts_of(estimate, truth, max_gap_s)
    try:
        absolute = ate(estimate, truth, max_gap_s=max_gap_s, with_scale=with_scale)
    except EvaluationError as error:
        raise EvaluationError(" ".join((f"{error}.", *doubts)) if doubts else str(error)) from error
    relative: dict[str, RelativeError | None] = dict.fromkeys(_STEPS)
    for name, unit in _STEPS.items():
        with suppress(EvaluationError):
            relative[name] = rpe(absolute.aligned, truth, 1, unit, max_gap_s=max_gap_s)
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


# Distance from a pose of points that determine the roll about a straight path, relative to the path's extent: visible
# to the alignment, and too short to move positions, since their part of the cost is its square.
_ARM_SHARE = 1e-3


@dataclass(frozen=True, eq=False)
class AbsoluteError:
    """The absolute trajectory error of M pairs of poses.

    Attributes:
        stamps_s: (M,) of the estimate, seconds.
        errors_m, errors_rad: (M,) distances and angles between estimated and true poses, after alignment.
        T_truth_estimate: (4, 4) that aligns the estimate's frame with the truth's, after scaling.
        scale: factor of the estimate's positions; 1 unless fitted.
        aligned: the whole estimate, scaled, in the truth's frame.
        truth: the true poses of the pairs.
        translation, rotation: statistics of `errors_m` and `errors_rad`.
    """

    stamps_s: FloatArray
    errors_m: FloatArray
    errors_rad: FloatArray
    T_truth_estimate: FloatArray
    scale: float
    aligned: Trajectory
    truth: Trajectory
    translation: Statistics = field(init=False)
    rotation: Statistics = field(init=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "translation", Statistics.of(self.errors_m))
        object.__setattr__(self, "rotation", Statistics.of(self.errors_rad))


def ate(estimate: Trajectory, truth: Trajectory, *, max_gap_s: float = 0.02, with_scale: bool = False) -> AbsoluteError:
    """Return the absolute trajectory error (Sturm et al., IROS 2012, section V-B; alignment by Umeyama 1991).

    Poses are paired one to one within `max_gap_s` seconds. A rigid motion (with `with_scale`, also a scale) aligns the
    estimate's positions with the true ones, and the remaining distances are the error. If positions lie on one line or
    in one place, orientations determine the free rotation. They also decide which side of a flat path is up, so that it
    is never mirrored.

    Raises:
        EvaluationError: different bodies, fewer than three pairs, positions that determine no scale, or that are of
            another size than the truth's.
    """
    near, true = matched(estimate, truth, max_gap_s)
    T_truth_estimate, scale = _alignment(near, true, with_scale)
    moved = _scaled(near, scale).moved(T_truth_estimate)
    R_error = np.swapaxes(true.T_frame_body[:, :3, :3], 1, 2) @ moved.T_frame_body[:, :3, :3]
    return AbsoluteError(
        stamps_s=near.stamps_s,
        errors_m=np.linalg.norm(moved.positions_m - true.positions_m, axis=1),
        errors_rad=so3.angle(R_error),
        T_truth_estimate=T_truth_estimate,
        scale=scale,
        aligned=_scaled(estimate, scale).moved(T_truth_estimate),
        truth=true,
    )


def _alignment(estimate: Trajectory, truth: Trajectory, with_scale: bool) -> tuple[FloatArray, float]:
    """Return T_truth_estimate (4, 4) and scale that align M estimated positions with M true ones."""
    R_truth, R_estimate = (t.T_frame_body[:, :3, :3] for t in (truth, estimate))
    like = np.mean(R_truth @ np.swapaxes(R_estimate, 1, 2), axis=0)
    try:
        given = (truth.positions_m, estimate.positions_m)
        return align_points_with_scale(*given, with_scale=with_scale, like=like)
    except DegenerateGeometryError as error:
        if with_scale:
            raise EvaluationError(f"no scale can be found: {error}") from error
    extent_m = np.linalg.norm(np.ptp(truth.positions_m, axis=0))
    arms = (_ARM_SHARE * extent_m if extent_m > 0 else 1.0) * np.vstack([np.eye(3), -np.eye(3)])
    p_truth, p_estimate = (se3.apply(t.T_frame_body, arms).reshape(-1, 3) for t in (truth, estimate))
    try:
        return align_points(p_truth, p_estimate), 1.0
    except DegenerateGeometryError as error:
        reach_m = np.linalg.norm(np.ptp(estimate.positions_m, axis=0))
        raise EvaluationError(
            f"the estimate cannot be laid upon the truth: its {len(estimate)} poses reach over {reach_m:.3g} m, the "
            f"true ones of the same time over {extent_m:.3g} m"
        ) from error


def _scaled(trajectory: Trajectory, scale: float) -> Trajectory:
    if scale == 1.0:
        return trajectory
    T = trajectory.T_frame_body.copy()
    T[:, :3, 3] *= scale
    S = np.diag([scale] * 3 + [1.0] * 3)
    covariances = None if trajectory.covariances is None else S @ trajectory.covariances @ S
    return Trajectory(trajectory.stamps_s, T, covariances, trajectory.body, trajectory.frame)


_STEP_TOLERANCE = 0.1  # relative, of the length of a step over seconds or metres


@dataclass(frozen=True, eq=False)
class RelativeError:
    """The relative pose error over M steps of `delta` frames, seconds or metres.

    Attributes:
        start_s, end_s: (M,) stamps at the begin and end of each step, seconds.
        errors_m, errors_rad: (M,) translation and rotation angle of the error of each step.
        translation, rotation: statistics of these.
    """

    delta: float
    unit: Unit
    start_s: FloatArray
    end_s: FloatArray
    errors_m: FloatArray
    errors_rad: FloatArray
    translation: Statistics = field(init=False)
    rotation: Statistics = field(init=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "translation", Statistics.of(self.errors_m))
        object.__setattr__(self, "rotation", Statistics.of(self.errors_rad))


def rpe(estimate: Trajectory, truth: Trajectory, delta: float, unit: Unit, *, max_gap_s: float = 0.02) -> RelativeError:
    """Return the relative pose error (Sturm et al., IROS 2012, section V-A) over all steps of length `delta`.

    Poses are paired one to one within `max_gap_s` seconds. From each pair a step goes to the pair whose distance in
    frames (pairs), seconds or metres (of the truth) is nearest to `delta`; in seconds and metres within 10 %. Steps
    overlap. This is evo's `all_pairs` with `pairs_from_reference`. A step of frames crosses gaps of the estimate. The
    error of a step is E = (Qᵢ⁻¹ Qⱼ)⁻¹ (Pᵢ⁻¹ Pⱼ) with true poses Q and estimated poses P.

    Raises:
        EvaluationError: different bodies, fewer than three pairs, or no step of that length.
        ValueError: a delta that is not positive, or a fraction of a frame.
    """
    if not delta > 0 or (unit == "frames" and delta != int(delta)):
        raise ValueError(f"no step can be {delta} {unit} long")
    near, true = matched(estimate, truth, max_gap_s)
    if unit == "frames":
        start = np.arange(len(true) - int(delta))
        end = start + int(delta)
    else:
        along = true.stamps_s if unit == "seconds" else true.distances_m
        start, end = steps_along(along, delta)
        fits = np.abs(along[end] - along[start] - delta) <= _STEP_TOLERANCE * delta
        start, end = start[fits], end[fits]
    if not len(start):
        raise EvaluationError(f"the trajectories are too short for a step of {delta:g} {unit}")
    P, Q = near.T_frame_body, true.T_frame_body
    T_error = se3.invert(se3.invert(Q[start]) @ Q[end]) @ (se3.invert(P[start]) @ P[end])
    return RelativeError(
        delta=delta,
        unit=unit,
        start_s=near.stamps_s[start],
        end_s=near.stamps_s[end],
        errors_m=np.linalg.norm(T_error[:, :3, 3], axis=1),
        errors_rad=so3.angle(T_error[:, :3, :3]),
    )


_SAME_STAMP_S = 1e-3  # stamps of one frame in two files differ only by rounding


def frame_coverage(estimate: Trajectory, frame_stamps_s: ArrayLike) -> float:
    """Return the share, 0 to 1, of listed frames at stamps (N,) seconds that have a pose.

    Raises EvaluationError if no frame is listed.
    """
    frames = np.asarray(frame_stamps_s, float)
    if not len(frames):
        raise EvaluationError("no frames are listed, so no share of them can have a pose")
    return len(associate(estimate.stamps_s, frames, _SAME_STAMP_S)) / len(frames)


def time_coverage(estimate: Trajectory, truth: Trajectory, max_step_s: float = 0.5) -> float:
    """Return the share, 0 to 1, of the truth's time that the estimate covers too.

    A trajectory covers the time between neighbouring stamps that are at most `max_step_s` seconds apart, or twice the
    truth's usual step if that is longer. Raises EvaluationError if the truth has fewer than two poses.
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
    """Return a sentence if `pairs` are less than half of the poses in the common time, else None.

    The cause is mostly two streams of different rates.
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
    """Return whether each of stamps (N,), none of them a pose's, lies in a step that is not too long."""
    if len(trajectory) < 2:
        return np.zeros(len(stamps_s), bool)
    after = np.searchsorted(trajectory.stamps_s, stamps_s)
    inside = (after > 0) & (after < len(trajectory))
    steps_s = np.diff(trajectory.stamps_s)[(after - 1).clip(0, len(trajectory) - 2)]
    return np.asarray(inside & (steps_s <= max_step_s))


ESTIMATE, TRUTH = "estimate", "ground truth"
_SAME_SPAN = 1.5  # largest ratio of the durations of two files of one drive
_LEAST_TURN_RAD, _FEWEST_TURNS = 0.15, 5  # turns between compared poses that show their axes
_WRONG_SHARE, _RIGHT_SHARE = 0.6, 0.2  # relative error of turns in the wrong and in the right order of quaternions
_FIRST_W_OF_XYZW = [1, 2, 3, 0]


def doubts_of(estimate: Trajectory, truth: Trajectory, max_gap_s: float) -> tuple[str, ...]:
    """Return a sentence for each probable mistake in a file: units of stamps, pairing, order of quaternions."""
    if estimate.body != truth.body or not len(estimate) or not len(truth):
        return ()
    pairs = associate(estimate.stamps_s, truth.stamps_s, max_gap_s)
    are_paired = 2 * len(pairs) >= min(len(estimate), len(truth))
    of_units = _unit_doubts(estimate, truth, are_paired=are_paired)
    if not of_units:
        few = pairing_warning(estimate, truth, len(pairs), max_gap_s)
        order = _order_doubt(estimate.select(pairs[:, 0]), truth.select(pairs[:, 1]))
        return tuple(filter(None, (few, order)))
    if are_paired:
        return tuple(of_units)
    few = f"Only {len(pairs)} of {len(estimate)} poses have a true one within {max_gap_s:g} s, and errors are of these."
    return (*of_units, few)


def _unit_doubts(estimate: Trajectory, truth: Trajectory, *, are_paired: bool) -> list[str]:
    """Sentences on units, by the ratio of both durations, or by the stamps of each alone if most poses are paired."""
    given = {ESTIMATE: estimate.stamps_s, TRUTH: truth.stamps_s}
    units = {name: unit for name, stamps in given.items() if (unit := unit_of(stamps)) is not None}
    if len(units) == 2 and len(set(units.values())) == 1:
        return [f"The stamps of both look like {_kind(units[TRUTH])}, not seconds: a second in these figures is none."]
    spans = {name: float(np.ptp(stamps)) for name, stamps in given.items()}
    short, long = sorted(spans, key=lambda name: spans[name])
    for unit in UNITS if not are_paired and spans[short] > 0 else ():
        assert unit.per_second is not None
        if 1 / _SAME_SPAN < spans[long] / spans[short] / unit.per_second < _SAME_SPAN:
            units = {long: unit}
            break
    sentences = []
    for name, unit in units.items():
        by = "the poses a second" if unit.per_second is None else f"{unit.per_second:.0f}"
        span = f"{given[name][0]:.15g} to {given[name][-1]:.15g}"
        sentences.append(f"The {name}'s stamps ({span}) look like {_kind(unit)}, not seconds: divide them by {by}.")
    return sentences


def _kind(unit: StampUnit) -> str:
    return "numbers of poses" if unit is NUMBERS else unit.name


def _order_doubt(estimate: Trajectory, truth: Trajectory) -> str | None:
    """A sentence if turns about wrong axes become right with w, not x, as the first number of one file's quaternions.

    The order changes axes, not angles between poses. `estimate` and `truth` are M pairs.
    """
    R_estimate, R_truth = (t.T_frame_body[:, :3, :3] for t in (estimate, truth))
    step = 1  # the smallest distance of poses with enough turns between them
    while step < len(R_truth):
        first = np.arange(len(R_truth) - step)
        enough = so3.angle(_between(R_truth, first, first + step)) > _LEAST_TURN_RAD
        if np.count_nonzero(enough) >= _FEWEST_TURNS:
            break
        step *= 2
    else:
        return None
    first = first[enough]
    second = first + step
    turn_rad = float(np.median(so3.angle(_between(R_truth, first, second))))

    def off(R_a: FloatArray, R_b: FloatArray) -> float:
        a, b = _between(R_a, first, second), _between(R_b, first, second)
        return float(np.median(so3.angle(np.swapaxes(a, 1, 2) @ b))) / turn_rad

    if off(R_estimate, R_truth) < _WRONG_SHARE:
        return None
    reordered = {ESTIMATE: off(_reordered(R_estimate), R_truth), TRUTH: off(R_estimate, _reordered(R_truth))}
    likely = [name for name, share in reordered.items() if share < _RIGHT_SHARE]
    if not likely:
        return None
    return f"Quaternions of the {' or of the '.join(likely)} seem to be written qw qx qy qz: write qx qy qz qw."


def _between(R: FloatArray, first: np.ndarray, second: np.ndarray) -> FloatArray:
    return np.asarray(np.swapaxes(R[first], 1, 2) @ R[second])


def _reordered(R: FloatArray) -> FloatArray:
    """Return rotations (M, 3, 3) of quaternions whose first number, read as x, is w."""
    return so3.from_quaternion(so3.to_quaternion(R)[:, _FIRST_W_OF_XYZW])
