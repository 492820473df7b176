"""What errors of the motions that wheels are held against make of what is fitted to them."""

from __future__ import annotations

from dataclasses import replace
from typing import Protocol

import numpy as np

from wheelsight.geometry import FloatArray
from wheelsight.odometry._robust_fit import DEFAULTS, Problem, RobustFit, RobustFitSettings, response
from wheelsight.odometry.camera_errors import with_error
from wheelsight.odometry.wheels.segments import Segments


class SegmentsProblem(Problem, Protocol):
    """A fit to pieces of a reference; `segments` are those."""

    segments: Segments


def covariance_by(
    problem: SegmentsProblem, found: RobustFit, errors: FloatArray, settings: RobustFitSettings = DEFAULTS
) -> FloatArray:
    """Covariance (P, P) of what independent errors (K, 3, 3) of the motions, of one σ each, make of the values found.

    Errors are as `camera_errors.motion_errors` tells them.
    """
    segments, moved = problem.segments, []
    for error in errors:
        problem.segments = replace(segments, motions=with_error(segments.motions, error))
        moved.append(problem.residuals(found.values) - found.residuals)
    problem.segments = segments
    shifts = response(problem, found, np.reshape(moved, (-1, *found.residuals.shape)), settings)
    return np.asarray(shifts.T @ shifts)
