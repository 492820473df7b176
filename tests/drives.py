"""Simulated drives of a robot on two wheels: the true way, and what encoders of known wheels counted of it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from wheelsight.core.calibration import Calibration, save_calibration
from wheelsight.core.calibration_parts import Wheels
from wheelsight.core.geometry import FloatArray, IntArray, se3, so3
from wheelsight.core.trajectory import Trajectory, write_tum

RATE_HZ = 50
Leg = tuple[float, float, float]  # seconds, m/s, rad/s
MIXED: tuple[Leg, ...] = (
    (6.0, 0.8, 0.0),
    (4.0, 0.5, 0.7),
    (1.0, 0.0, 0.0),
    (5.0, 1.0, -0.2),
    (3.0, 0.0, 1.0),
    (6.0, 0.7, 0.1),
    (4.0, 0.4, -0.9),
    (1.0, 0.0, 0.0),
    (3.0, 0.2, -0.8),
    (5.0, 1.1, 0.05),
    (3.0, -0.3, 0.2),
)


@dataclass(frozen=True)
class SimulatedDrive:
    """Readings (N,) of the encoders, and the true T_odom_base at the same moments, noise and all."""

    stamps_s: FloatArray
    left: IntArray
    right: IntArray
    truth: Trajectory


def simulate(
    wheels: Wheels,
    legs: Sequence[Leg] = MIXED * 4,
    *,
    rng: np.random.Generator | None = None,
    slips: int = 0,
    reference_sigma_m: float = 0.0,
    reference_sigma_rad: float = 0.0,
    start_s: float = 1000.0,
) -> SimulatedDrive:
    """Drive `legs` in succession, speeds ramped over 0.4 s, with wheels that are truly so.

    With `rng`, each wheel's travel varies by `wheels.slip_m_per_sqrt_m`, and `slips` times one of them spins by half a
    metre more than the robot moves, within 0.3 s. Stamps of the readings come `wheels.delay_s` late.
    """
    v, omega = (np.repeat([leg[i] for leg in legs], [round(leg[0] * RATE_HZ) for leg in legs]) for i in (1, 2))
    ramp = np.ones(RATE_HZ * 2 // 5) / (RATE_HZ * 2 // 5)
    step_m, step_rad = (np.convolve(np.pad(speed, 50), ramp, mode="same") / RATE_HZ for speed in (v, omega))
    stamps_s = start_s + np.arange(len(step_m) + 1) / RATE_HZ
    left_m, right_m = step_m - step_rad * wheels.track_width_m / 2, step_m + step_rad * wheels.track_width_m / 2
    if rng is not None:
        for wheel_m in (left_m, right_m):
            wheel_m += wheels.slip_m_per_sqrt_m * np.sqrt(np.abs(wheel_m)) * rng.standard_normal(len(wheel_m))
        for _ in range(slips):
            where = int(rng.integers(100, len(step_m) - 100))
            (left_m if rng.random() < 0.5 else right_m)[where : where + 15] += 0.5 / 15
    return SimulatedDrive(
        stamps_s + wheels.delay_s,
        _ticks(left_m, wheels.left_m_per_tick),
        _ticks(right_m, wheels.right_m_per_tick),
        _truth(stamps_s, step_m, step_rad, rng, reference_sigma_m, reference_sigma_rad),
    )


def _ticks(travel_m: FloatArray, m_per_tick: float) -> IntArray:
    return np.floor(np.concatenate([[0.0], np.cumsum(travel_m)]) / m_per_tick).astype(np.int64)


def _truth(
    stamps_s: FloatArray,
    step_m: FloatArray,
    step_rad: FloatArray,
    rng: np.random.Generator | None,
    sigma_m: float,
    sigma_rad: float,
) -> Trajectory:
    """By chords of arcs, in plain numpy; the wheels' code has no part in it."""
    yaw_rad = np.concatenate([[0.0], np.cumsum(step_rad)])
    heading = yaw_rad[:-1] + step_rad / 2
    chord_m = step_m * np.sinc(step_rad / (2 * np.pi))
    steps = np.stack([chord_m * np.cos(heading), chord_m * np.sin(heading), np.zeros_like(heading)], axis=-1)
    positions = np.concatenate([np.zeros((1, 3)), np.cumsum(steps, axis=0)])
    if rng is not None:
        positions[:, :2] += sigma_m * rng.standard_normal((len(yaw_rad), 2))
        yaw_rad = yaw_rad + sigma_rad * rng.standard_normal(len(yaw_rad))
    R = so3.exp(np.stack([np.zeros_like(yaw_rad), np.zeros_like(yaw_rad), yaw_rad], axis=-1))
    return Trajectory(stamps_s, se3.from_parts(R, positions), body="base")


def square_legs(nominal: Wheels, true: Wheels, sense: int, side_m: float = 4.0) -> list[Leg]:
    """How a robot truly moves that believes in `nominal` wheels and drives a square; sense 1 is counter-clockwise."""
    legs = []
    for seconds, v, omega in ((side_m / 0.5, 0.5, 0.0), (3.0, 0.0, sense * np.pi / 6)) * 4:
        across = omega * nominal.track_width_m / 2
        left = (v - across) * true.left_radius_m / nominal.left_radius_m
        right = (v + across) * true.right_radius_m / nominal.right_radius_m
        legs.append((seconds, (left + right) / 2, (right - left) / true.track_width_m))
    return [*legs, (2.0, 0.0, 0.0)]


def write_recording(folder: Path, nominal: Wheels, drive: SimulatedDrive, truth: Trajectory | None = None) -> None:
    """A recording of wheels in wheelsight's own layout; `truth` stands in place of the drive's own."""
    folder.mkdir(parents=True)
    rows = zip(drive.stamps_s.tolist(), drive.left.tolist(), drive.right.tolist(), strict=True)
    lines = [f"{stamp_s:.6f},{left},{right}\n" for stamp_s, left, right in rows]
    (folder / "wheels.csv").write_text("stamp_s,left,right\n" + "".join(lines))
    save_calibration(Calibration(wheels=nominal, source="nominal"), folder / "calibration.yaml")
    write_tum(truth or drive.truth, folder / "groundtruth_base.txt")
