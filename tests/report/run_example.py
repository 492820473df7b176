"""Runs that never happened, but could have: what the report is tested on. All seeded, none recorded."""

from __future__ import annotations

from dataclasses import replace
from datetime import UTC, datetime
from functools import cache
from typing import Any

import numpy as np

from wheelsight.app.run import FrameRecord, MapPicture, MapRecord, MatchPicture, RunRecord
from wheelsight.core.calibration_parts import Wheels
from wheelsight.core.errors import EvaluationError
from wheelsight.core.estimates import Reason, Status
from wheelsight.core.geometry import ByteArray, se3
from wheelsight.core.trajectory import Trajectory
from wheelsight.evaluation import evaluate
from wheelsight.io.recordings import AssociationReport
from wheelsight.mapping import MapStatus
from wheelsight.mapping.plan import MapCloud, MapPlan
from wheelsight.wheels import integrate_log

START_S = 1305031102.17
_RATE_HZ = 30.0


def example_run(frames: int = 500, seed: int = 1, with_truth: bool = True, **others: Any) -> RunRecord:
    """A hand-held camera's run: it fails, is lost a tenth of the time, recovers; two frames were unreadable."""
    return replace(_run(frames, seed, with_truth), **others)


@cache
def _run(frames: int, seed: int, with_truth: bool) -> RunRecord:
    rng = np.random.default_rng(seed)
    stamps_s = START_S + np.arange(frames) / _RATE_HZ
    records = tuple(_frame(i, stamp, frames, rng) for i, stamp in enumerate(stamps_s))
    posed = np.array([f.status is Status.TRACKING and not f.is_skipped for f in records], bool)
    estimate = _drifting(stamps_s, rng).select(np.flatnonzero(posed))
    truth = _path(np.arange(START_S - 0.1, stamps_s[-1] + 0.1, 0.01)) if with_truth else None
    evaluation, problem = None, None if truth is None else "the estimate has no poses"
    if truth is not None:
        try:
            evaluation, problem = evaluate(estimate, truth, frame_stamps_s=stamps_s), None
        except EvaluationError as error:
            problem = str(error)
    return RunRecord(
        recording="corridor with a lost while",
        format="tum",
        frames=records,
        estimate=estimate,
        ground_truth=truth,
        evaluation=evaluation,
        evaluation_problem=problem,
        association=AssociationReport(frames + 12, frames + 3, frames, max_gap_s=0.02, largest_gap_s=0.0187),
        warnings=("Colour and depth are not registered: edges lie about 14 px apart.",),
        stage_seconds={"extract": 0.0048, "match": 0.0013, "align": 0.0009, "refine": 0.0004, "map": 0.0021},
        config={"odometry": {"kind": "features", "features": {"keypoints": 1000, "levels": 8}}, "seed": 0},
        peak_memory_mb=312.4,
        finished_at=datetime(2024, 8, 17, 14, 3, tzinfo=UTC),
    )


def empty_run(frames: int = 30) -> RunRecord:
    """A blank wall: every frame was used, none gave a pose."""
    records = tuple(
        FrameRecord(i, START_S + i / _RATE_HZ, Status.INITIALIZING, Reason.TOO_FEW_KEYPOINTS, 0, 0, 0.004)
        for i in range(frames)
    )
    nothing = Trajectory(np.zeros(0), np.zeros((0, 4, 4)))
    return replace(example_run(3, with_truth=False), frames=records, estimate=nothing, stage_seconds={}, warnings=())


def wheel_run(readings: int = 400, with_truth: bool = True) -> RunRecord:
    """A robot's drive by its wheels alone; two readings were refused."""
    wheels = Wheels(0.17, 0.17, 0.52, 3200.0)
    stamps_s = START_S + 0.02 * np.arange(readings)
    left, right = 30 * np.arange(readings), 38 * np.arange(readings)
    refused = {readings // 2: Reason.IMPLAUSIBLE_MOTION, readings // 2 + 1: Reason.IMPLAUSIBLE_MOTION}
    left[readings // 2] += 10**6
    estimate = integrate_log(wheels, stamps_s, left, right).trajectory()
    records = tuple(
        FrameRecord(i, stamp, Status.FAILING if i in refused else Status.TRACKING, refused.get(i), 0, 0, 3e-6)
        for i, stamp in enumerate(stamps_s.tolist())
    )
    true = integrate_log(replace(wheels, track_width_m=0.55), stamps_s, 30 * np.arange(readings), right).trajectory()
    truth = Trajectory(true.stamps_s, true.T_frame_body, body="base") if with_truth else None
    return replace(
        example_run(3, with_truth=False),
        frames=records,
        estimate=estimate,
        ground_truth=truth,
        evaluation=None if truth is None else evaluate(estimate, truth, frame_stamps_s=stamps_s),
        association=AssociationReport(0, 0, 0, 0.0),
        warnings=(),
        stage_seconds={},
        recording="yard",
        unit="reading",
    )


def example_picture(color: ByteArray | None = None, matches: int = 300, seed: int = 2) -> MatchPicture:
    """Two images, one shifted against the other, four in five matches right."""
    rng = np.random.default_rng(seed)
    if color is None:
        color = rng.integers(0, 255, (60, 80, 3), np.uint8).repeat(8, axis=0).repeat(8, axis=1)
    height, width = color.shape[:2]
    px = rng.uniform((20, 20), (width - 40, height - 40), (matches, 2))
    is_inlier = rng.random(matches) < 0.8
    reference_px = np.where(is_inlier[:, None], px + (12.0, 3.0), px + rng.uniform(-60, 60, (matches, 2)))
    reference = np.roll(color, (3, 12), axis=(0, 1))
    return MatchPicture(START_S + 2.0, START_S + 1.9, color, reference, px, reference_px, is_inlier)


def example_map(pictures: int = 2, **others: Any) -> MapRecord:
    """Of the same camera: a red floor of 8 m by 6 m round its path, in a plan whose axes are those of the world."""
    image = np.full((600, 800, 3), (170, 40, 30), np.uint8)
    is_known = np.ones((600, 800), bool)
    is_known[:, 700:] = False
    image[~is_known] = 255
    rng = np.random.default_rng(4)
    shots = [rng.integers(0, 255, (60, 80, 3), np.uint8) for _ in range(2 * pictures)]
    views = tuple(MapPicture(START_S + k, shots[2 * k], shots[2 * k + 1]) for k in range(pictures))
    plan = MapPlan(image, is_known, 0.01, np.eye(3), np.array([-4.0, 3.0]))
    status = MapStatus(412_345, 300_000, 412_345, 0, 72_000_000)
    plain = MapRecord(status, 480, "map.surfels", plan, views, cloud=example_cloud())
    return replace(plain, **others)


def example_cloud() -> MapCloud:
    """The same floor, and a green wall behind it that is seen from the room."""
    x, y = (axis.ravel() for axis in np.meshgrid(np.arange(-4, 4, 0.1), np.arange(-3, 3, 0.1)))
    u, v = (axis.ravel() for axis in np.meshgrid(np.arange(-4, 4, 0.1), np.arange(0, 2, 0.1)))
    floor, wall = np.column_stack([x, y, 0 * x]), np.column_stack([u, 0 * u + 3, v])
    normal = np.concatenate([np.tile([0.0, 0, 1], (len(floor), 1)), np.tile([0.0, -1, 0], (len(wall), 1))])
    color = np.concatenate([np.tile([170, 40, 30], (len(floor), 1)), np.tile([20, 160, 60], (len(wall), 1))])
    position = np.concatenate([floor, wall]).astype(np.float32)
    return MapCloud(position, normal.astype(np.float32), color.astype(np.uint8), 0.1, 300_000)


def _frame(i: int, stamp_s: float, frames: int, rng: np.random.Generator) -> FrameRecord:
    share = i / frames
    seconds = 1.31 if i == 0 else float(0.0085 + rng.gamma(3, 0.0006) + 0.004 * (i % 15 == 0))
    matches = int(320 + 90 * np.sin(9 * share) + rng.normal(0, 18))
    inliers = int(matches * (0.72 + 0.08 * np.sin(21 * share)))
    if i == 0 and frames > 1:
        return FrameRecord(i, stamp_s, Status.INITIALIZING, None, 0, 0, seconds)
    if 0.15 < share < 0.155:
        note = "depth image is truncated"
        return FrameRecord(i, stamp_s, Status.TRACKING, Reason.FRAME_UNUSABLE, 0, 0, 0.0, note)
    if 0.43 < share <= 0.45 or 0.71 < share < 0.713:
        return FrameRecord(i, stamp_s, Status.FAILING, Reason.TOO_FEW_INLIERS, matches // 5, 7, seconds)
    if 0.45 < share < 0.55:
        return FrameRecord(i, stamp_s, Status.LOST, Reason.TOO_FEW_MATCHES, matches // 12, 0, seconds)
    return FrameRecord(i, stamp_s, Status.TRACKING, None, matches, inliers, seconds)


def _path(stamps_s: np.ndarray) -> Trajectory:
    """A loop through two rooms, looking ahead."""
    t = (stamps_s - START_S) / 16.7 * 2 * np.pi
    p = np.stack([2.4 * np.sin(t), 1.5 * np.sin(2 * t), 1.2 + 0.15 * np.sin(3 * t)], axis=-1)
    turn = np.stack([0.1 * np.sin(5 * t), 0.1 * np.cos(4 * t), t], axis=-1)
    T = se3.exp(np.concatenate([np.zeros_like(p), turn], axis=-1))
    T[:, :3, 3] = p
    return Trajectory(stamps_s, T)


def _drifting(stamps_s: np.ndarray, rng: np.random.Generator) -> Trajectory:
    """The path as odometry finds it, in the frame of its first pose: errors add up."""
    true = _path(stamps_s)
    noise = rng.normal(0, (0.0012, 0.0012, 0.0012, 0.0004, 0.0004, 0.0004), (len(stamps_s), 6))
    T = [np.eye(4)]
    for i in range(1, len(stamps_s)):
        step = se3.invert(true.T_frame_body[i - 1]) @ true.T_frame_body[i]
        T.append(T[-1] @ step @ se3.exp(noise[i]))
    return Trajectory(stamps_s, np.array(T))
