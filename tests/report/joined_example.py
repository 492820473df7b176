"""A drive by wheels, by a camera, and by both joined, whose errors, statuses and flags are known."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from run_example import START_S, example_run, wheel_run

from wheelsight.app.run import FrameRecord, RunRecord
from wheelsight.core.estimates import Reason, Status
from wheelsight.core.geometry import se3
from wheelsight.core.trajectory import Trajectory
from wheelsight.evaluation import evaluate

RATE_HZ, FRAMES = 10.0, 160
COASTING, SLIPPING, DOUBTFUL = slice(40, 56), slice(80, 88), slice(77, 80)
_SIGMAS = np.array([0.002, 0.001, 0.0005, 1e-5, 1e-5, 4e-4])


def joined_run(with_truth: bool = True, boldness: float = 1.0, **others: Any) -> RunRecord:
    """16 s at 10 frames/s with readings between: it coasts for 1.6 s, the wheels slip for 0.8 s, 0.3 s are doubtful.

    Its errors wander, and it states how far, or less by `boldness`.
    """
    truth = _truth()
    stamps_s = truth.stamps_s
    errors = np.cumsum(_SIGMAS * np.random.default_rng(5).standard_normal((len(stamps_s), 6)), axis=0)
    T_start = truth.T_frame_body[0]
    T = se3.invert(se3.exp(errors - errors[0])) @ se3.invert(T_start) @ truth.T_frame_body
    covariances = np.arange(float(len(stamps_s)))[:, None, None] * np.diag((_SIGMAS / boldness) ** 2)
    estimate = Trajectory(stamps_s, T, covariances, body="base")
    frames_s = START_S + np.arange(FRAMES) / RATE_HZ
    evaluation = evaluate(estimate, truth, frame_stamps_s=frames_s) if with_truth else None
    plain = replace(
        example_run(3, with_truth=False),
        frames=tuple(_frame(i, stamp_s) for i, stamp_s in enumerate(frames_s.tolist())),
        estimate=estimate,
        ground_truth=truth if with_truth else None,
        evaluation=evaluation,
        evaluation_problem=None if with_truth else "the recording has no ground truth",
        config={"odometry": ["wheels", "dense"], "fusion": {"filter": "default"}},
        odometry="joined",
    )
    return replace(plain, **others)


def joined_runs(with_truth: bool = True, **others: Any) -> tuple[RunRecord, RunRecord, RunRecord]:
    """Wheels, camera, and both joined, in the order of a run."""
    joined = joined_run(with_truth, **others)
    wheels = replace(wheel_run(800, with_truth), odometry="wheels")
    at_frames = np.arange(0, len(joined.estimate), 5)
    jitter = se3.exp(np.random.default_rng(6).normal(0, 0.02, (len(at_frames), 6)))
    seen = joined.estimate.select(at_frames)
    camera = Trajectory(seen.stamps_s, seen.T_frame_body @ jitter, body="base")
    frames = tuple(replace(f, status=Status.TRACKING, reason=None, flags=()) for f in joined.frames)
    evaluation = evaluate(camera, joined.ground_truth) if joined.ground_truth is not None else None
    return wheels, replace(joined, estimate=camera, frames=frames, evaluation=evaluation, odometry="dense"), joined


def _truth() -> Trajectory:
    truth = wheel_run(800).ground_truth
    assert truth is not None
    return truth


def _frame(i: int, stamp_s: float) -> FrameRecord:
    if i in range(FRAMES)[COASTING]:
        return FrameRecord(i, stamp_s, Status.COASTING, Reason.TOO_LITTLE_DEPTH, 0, 0, 0.02)
    flags = [name for name, when in (("slip", SLIPPING), ("doubtful", DOUBTFUL)) if i in range(FRAMES)[when]]
    return FrameRecord(i, stamp_s, Status.TRACKING, None, 50_000, 45_000, 0.03, flags=tuple(flags))
