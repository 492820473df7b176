"""Drives of a base with wheels and a camera, as the default filter believes drives to be, with faults on demand."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import ArrayLike

from wheelsight.core.estimates import MotionEstimate, Reason
from wheelsight.core.geometry import FloatArray, se3
from wheelsight.core.geometry import motion_kernels as motions
from wheelsight.estimation import ErrorStateFilter, FusedEstimate
from wheelsight.estimation import filter_kernels as relative
from wheelsight.estimation.pose_belief import FilterParameters

T_BASE_CAMERA = se3.from_parts(np.array([[0.0, 0, 1], [-1, 0, 0], [0, -1, 0]]), [0.1, 0.05, 0.8])
PLANE = [0, 1, 5]
CAMERA_COVARIANCE = np.diag(np.square([1e-3] * 3 + [5e-4] * 3))
TRACK_M, SLIP_M_PER_SQRT_M = 0.52, 0.003


@dataclass(frozen=True)
class Step:
    """Of a drive: truth, and wheels and camera. `measurement` is against the frame before, every other step."""

    begin_s: float
    end_s: float
    T_truth: FloatArray
    wheels: FloatArray
    wheel_covariance: FloatArray
    measurement: MotionEstimate | None = None
    yaw_rate_rad_s: float | None = None


@dataclass(frozen=True)
class Drive:
    """What a drive is like; faults change steps (`wheel_fault`) or measurements (`camera_fault`), by their time."""

    seconds: float = 10.0
    step_s: float = 0.05
    steps_a_frame: int = 1
    speed_m_s: float = 0.8
    errors: tuple[float, float, float] = (0.0, 0.0, 0.0)
    camera_errors: tuple[float, ...] = (0.0, 0.0, 0.0)  # those that follow are 0
    lag_s: float = 0.0  # of the camera's stamps
    slip_m_per_sqrt_m: float = SLIP_M_PER_SQRT_M
    wheel_fault: Callable[[float, FloatArray, FloatArray], tuple[FloatArray, FloatArray]] = field(
        default=lambda t, truth, wheels: (truth, wheels)
    )
    camera_fault: Callable[[float, MotionEstimate], MotionEstimate] = field(default=lambda t, motion: motion)

    def twist(self, t: float) -> FloatArray:
        """True (vx, vy, ωz): starts smoothly, then bends to and fro."""
        return np.array([self.speed_m_s * min(t, 1.0), 0.0, 0.4 * np.sin(0.7 * t) * min(t, 1.0)])


def wheel_covariance(xi: FloatArray, slip_m_per_sqrt_m: float = SLIP_M_PER_SQRT_M) -> FloatArray:
    """Covariance (6, 6) of the left perturbation of a step: of way and turn, both wheels alike."""
    left, right = xi[0] - xi[5] * TRACK_M / 2, xi[0] + xi[5] * TRACK_M / 2
    way = slip_m_per_sqrt_m**2 * (abs(left) + abs(right)) / 4
    Q = np.zeros((6, 6))
    Q[0, 0], Q[5, 5] = way, 4 * way / TRACK_M**2
    return Q


def simulate(drive: Drive, rng: np.random.Generator, settings: FilterParameters) -> list[Step]:
    """A drive whose floor and sensors scatter as the settings and covariances say."""
    T, seen_from, steps = np.eye(4), np.eye(4), []
    for i in range(round(drive.seconds / drive.step_s)):
        begin_s, end_s = i * drive.step_s, (i + 1) * drive.step_s
        xi = np.zeros(6)
        xi[PLANE] = drive.twist(begin_s + drive.step_s / 2) * drive.step_s
        Q = wheel_covariance(xi, drive.slip_m_per_sqrt_m)
        measured = motions.log(motions.exp(-rng.normal(size=6) * np.sqrt(np.diag(Q))) @ motions.exp(xi))
        measured[0] /= 1 + drive.errors[0]
        measured[5] = (measured[5] - drive.errors[1] * measured[0]) / (1 + drive.errors[2])
        xi, measured = drive.wheel_fault(begin_s, xi, measured)
        way_m = abs(measured[0]) + settings.lever_m * abs(measured[5])
        tilt = settings.tilt_rad_per_sqrt_m
        if settings.level_sigma_rad is not None:  # a walk, unlike a floor, strays from level for ever
            tilt = settings.level_sigma_rad / 10
        unseen = np.array([0, settings.side_m_per_sqrt_m, settings.rise_m_per_sqrt_m, tilt, tilt, 0])
        T = T @ motions.exp(rng.normal(size=6) * unseen * np.sqrt(way_m)) @ motions.exp(xi)
        step = Step(begin_s, end_s, T, motions.exp(measured), Q)
        if (i + 1) % drive.steps_a_frame == 0:
            wrong, T_imaged = np.array(drive.camera_errors), T @ motions.exp(-drive.lag_s / drive.step_s * xi)
            Z = se3.invert(seen_from) @ T_imaged
            missed = relative.by_camera_errors(Z, by_ratios(Z))[:, : len(wrong)] @ wrong
            Z = motions.exp(-missed) @ Z
            step = replace(step, measurement=drive.camera_fault(end_s, looked(rng, Z)))
            seen_from = T_imaged
        steps.append(step)
    return steps


def by_ratios(Z: FloatArray) -> FloatArray:
    """How a motion (4, 4) changes with ways too short, a turn missed a metre, and turns too small: (6, 3)."""
    B, turn, (x, y, z) = np.zeros((6, 3)), motions.log(Z)[5], Z[:3, 3]
    way_m = np.linalg.norm(Z[:3, 3])
    B[:3, 0] = x, y, z
    B[:, 1] = way_m * y / 2, -way_m * x / 2, 0, 0, 0, way_m
    B[:, 2] = turn * y / 2, -turn * x / 2, 0, 0, 0, turn
    return B


def looked(rng: np.random.Generator, Z: FloatArray, covariance: FloatArray = CAMERA_COVARIANCE) -> MotionEstimate:
    """What the camera shows a motion (4, 4) of the base."""
    eta = rng.multivariate_normal(np.zeros(6), covariance)
    T = motions.exp(eta) @ se3.invert(T_BASE_CAMERA) @ Z @ T_BASE_CAMERA
    return MotionEstimate(T, covariance, matches=200, inliers=160)


def shifted(motion: MotionEstimate, twist: ArrayLike, seconds: float) -> MotionEstimate:
    """A measurement that is wrong by a velocity (vx, vy, ωz) of the base."""
    assert motion.T_reference_current is not None
    xi = np.zeros(6)
    xi[PLANE] = np.asarray(twist) * seconds
    T_camera_base = se3.invert(T_BASE_CAMERA)
    wrong = T_camera_base @ motions.exp(xi) @ T_BASE_CAMERA
    return replace(motion, T_reference_current=motion.T_reference_current @ wrong)


def blind(motion: MotionEstimate) -> MotionEstimate:
    """No measurement at all."""
    return MotionEstimate.failed(Reason.TOO_LITTLE_DEPTH)


def run(
    steps: list[Step], settings: FilterParameters | None = None, fusion: ErrorStateFilter | None = None
) -> list[FusedEstimate]:
    """The filter's answer after each step."""
    fusion = fusion or ErrorStateFilter(T_BASE_CAMERA, settings=settings)
    fusion.clone(steps[0].begin_s, "frame")
    answers = []
    for step in steps:
        answer = fusion.predict(step.end_s, step.wheels, step.wheel_covariance, step.begin_s)
        if step.yaw_rate_rad_s is not None:
            answer = fusion.update_yaw_rate(step.end_s, step.yaw_rate_rad_s)
        if step.measurement is not None:
            answer = fusion.update_relative(step.end_s, step.measurement, "frame")
            fusion.clone(step.end_s, "frame")
        answers.append(answer)
    return answers


def error_of(answer: FusedEstimate, T_truth: FloatArray) -> FloatArray:
    """Left perturbation (6,) from the answer to the truth."""
    assert answer.T_odom_body is not None
    return np.asarray(motions.log(T_truth @ se3.invert(answer.T_odom_body)))


def position_error(answer: FusedEstimate, T_truth: FloatArray) -> tuple[FloatArray, FloatArray]:
    """x, y off the truth (2,) and their covariance (2, 2)."""
    assert answer.T_odom_body is not None
    assert answer.covariance is not None
    x, y, z = answer.T_odom_body[:3, 3]
    J = np.array([[1.0, 0, 0, 0, z, -y], [0, 1.0, 0, -z, 0, x]])
    return T_truth[:2, 3] - answer.T_odom_body[:2, 3], J @ answer.covariance @ J.T


def within_three_sigma(answer: FusedEstimate, T_truth: FloatArray) -> bool:
    """Whether the position is within its stated 3σ, of two dimensions: as probable as 3σ of one."""
    off, C = position_error(answer, T_truth)
    return bool(off @ np.linalg.solve(C + 1e-12 * np.eye(2), off) <= 11.83)
