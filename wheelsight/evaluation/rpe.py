"""RPE: how much the estimate drifts over a frame, a second, a metre."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal

import numpy as np

from wheelsight.core.errors import EvaluationError
from wheelsight.core.geometry import FloatArray, IntArray, se3, so3
from wheelsight.core.trajectory import Trajectory
from wheelsight.evaluation.statistics import Statistics, matched, steps_along

Unit = Literal["frames", "seconds", "metres"]

# How far the length of a step over seconds or metres may differ from the one asked for.
_STEP_TOLERANCE = 0.1


@dataclass(frozen=True, eq=False)
class RelativeError:
    """The relative pose error over M steps.

    Attributes:
        delta: how long a step is, in `unit`.
        unit: frames, seconds or metres.
        start_s: (M,) stamps at which each step begins, seconds.
        end_s: (M,) stamps at which it ends.
        errors_m: (M,) translation of the error of each step.
        errors_rad: (M,) rotation angle of the error of each step.
        translation: statistics of `errors_m`.
        rotation: statistics of `errors_rad`.
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
    """The relative pose error (Sturm et al., IROS 2012, section V-A) over all steps of length `delta`.

    Poses are paired one to one within `max_gap_s` seconds. From every pair a step goes to the pair whose distance in
    frames (pairs), seconds or metres (travelled by the truth) is nearest to `delta`; in seconds and metres within
    10 % of it, else there is none. Steps overlap. This is evo's `all_pairs` with `pairs_from_reference`. Where the
    estimate has a gap, a step of frames goes across it. The error of a step is E = (Qᵢ⁻¹ Qⱼ)⁻¹ (Pᵢ⁻¹ Pⱼ) with true
    poses Q and estimated poses P.

    Raises:
        EvaluationError: different bodies, fewer than three pairs, or no step of that length.
        ValueError: a delta that is not positive, or a broken number of frames.
    """
    if not delta > 0 or (unit == "frames" and delta != int(delta)):
        raise ValueError(f"no step can be {delta} {unit} long")
    near, true = matched(estimate, truth, max_gap_s)
    start, end = _steps(true, delta, unit)
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


def _steps(truth: Trajectory, delta: float, unit: Unit) -> tuple[IntArray, IntArray]:
    """Indices (M,) and (M,) of the poses between which steps of length `delta` go."""
    if unit == "frames":
        start = np.arange(len(truth) - int(delta))
        return start, start + int(delta)
    along = truth.stamps_s if unit == "seconds" else truth.distances_m
    start, end = steps_along(along, delta)
    fits = np.abs(along[end] - along[start] - delta) <= _STEP_TOLERANCE * delta
    return start[fits], end[fits]
