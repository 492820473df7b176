"""A small building whose corridors make a loop, drives round it on wheels of the wrong size, and a made-up forest."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from wheelsight.core.areas import Area, AreaMap
from wheelsight.core.geometry import FloatArray, IntArray, se2, se3
from wheelsight.estimation import AreaRectifier, AreaRectifierSettings

PERIOD_S, SPEED_M_S = 0.2, 0.8
PLANE = np.ix_([0, 1, 5], [0, 1, 5])


def box(name: str, left: float, bottom: float, right: float, top: float, shows: str) -> Area:
    corners = np.array([(left, bottom), (right, bottom), (right, top), (left, top)])
    x_m, y_m = (left + right) / 2, (bottom + top) / 2
    return Area(name, corners, x_m if "x" in shows else None, y_m if "y" in shows else None)


def loop() -> AreaMap:
    """Four corners and four corridors, 14 m by 10 m."""
    return AreaMap(
        (
            box("south", 2, 0, 12, 2, "y"),
            box("southeast", 12, 0, 14, 2, "xy"),
            box("east", 12, 2, 14, 8, "x"),
            box("northeast", 12, 8, 14, 10, "xy"),
            box("north", 2, 8, 12, 10, "y"),
            box("northwest", 0, 8, 2, 10, "xy"),
            box("west", 0, 2, 2, 8, "x"),
            box("southwest", 0, 0, 2, 2, "xy"),
        )
    )


@dataclass(frozen=True)
class LoopDrive:
    """Truth and the wheels' poses (N, 3), x, y, yaw in the world; the wheels' steps (N - 1, 4, 4), one covariance."""

    truth: FloatArray
    wheels: FloatArray
    steps: FloatArray
    covariance: FloatArray

    @property
    def wheels_error_m(self) -> float:
        return error_m(self.wheels, self.truth)


def drive_round(rng: np.random.Generator, laps: int = 3, drift: float = 0.03, slip: float = 0.002) -> LoopDrive:
    """Round the loop counter-clockwise along the corridors' middle; the wheels' heading drifts by `drift` rad/m."""
    step_m = PERIOD_S * SPEED_M_S
    corner = [(step_m, np.pi / 2 / 10)] * 10  # a quarter of a circle of 1 m, about
    radius = step_m / (np.pi / 2 / 10)
    legs = [12 - 2 * radius, 8 - 2 * radius] * 2
    start = (1 + radius, 1.0, 0.0)
    moves = [move for leg in legs for move in [(leg / round(leg / step_m), 0.0)] * round(leg / step_m) + corner] * laps
    xi = np.array([(m, 0.0, turn) for m, turn in moves])
    noise = rng.normal(0, slip, (len(xi), 3)) * np.sqrt(step_m) * (1.0, 0.1, 1.0)
    reported = xi + noise
    reported[:, 2] += drift * xi[:, 0]
    covariance = np.zeros((6, 6))
    covariance[PLANE] = np.diag(np.square(slip * np.array([1.0, 0.1, 1.0]))) * step_m
    steps = se2.exp(reported)
    in_space = se3.from_plane(*se2.to_parts(steps))
    return LoopDrive(_poses(start, se2.exp(xi)), _poses(start, steps), in_space, covariance)


def _poses(start: tuple[float, float, float], steps: FloatArray) -> FloatArray:
    T = [se2.from_parts(*start)]
    for step in steps:
        T.append(T[-1] @ step)
    return np.stack(se2.to_parts(np.array(T)), axis=-1)


def error_m(found: FloatArray, truth: FloatArray) -> float:
    """The mean distance, as the paper measures."""
    return float(np.linalg.norm(found[:, :2] - truth[:, :2], axis=1).mean())


def looks(rng: np.random.Generator, areas: AreaMap, truth: FloatArray, accuracy: float, run_m: float) -> IntArray:
    """What a forest takes each frame for (N,): right or wrong for a run of about `run_m`, or until the area ends."""
    true_index = areas.index_at(truth[:, :2])
    renewed = rng.random(len(truth)) < PERIOD_S * SPEED_M_S / run_m
    found = true_index.copy()
    for t in range(len(truth)):
        if t and not renewed[t] and true_index[t] == true_index[t - 1]:
            found[t] = found[t - 1]
        elif rng.random() > accuracy:
            found[t] = rng.choice(np.delete(np.arange(len(areas)), true_index[t]))
    return found


def answers(found: IntArray, n_areas: int, confidence: float = 0.9) -> FloatArray:
    """Probabilities (N, A) that name the areas found."""
    rest = (1 - confidence) / (n_areas - 1)
    return np.where(np.arange(n_areas) == np.asarray(found)[:, None], confidence, rest)


@dataclass(frozen=True)
class Rectified:
    """Poses (N, 3), covariances (N, 3, 3) of x, y, yaw, and trust (N,)."""

    poses: FloatArray
    covariances: FloatArray
    trust: FloatArray


def rectify(
    drive: LoopDrive, probabilities: FloatArray | None, settings: AreaRectifierSettings | None = None
) -> Rectified:
    rectifier = AreaRectifier(loop(), se3.from_plane(*drive.truth[0]), settings)
    poses, covariances, trust = [], [], []
    for t in range(len(drive.truth)):
        if t:
            rectifier.predict(drive.steps[t - 1], drive.covariance)
        estimate = rectifier.update(t * PERIOD_S, None if probabilities is None else probabilities[t])
        T = estimate.T_odom_body
        assert T is not None
        assert estimate.covariance is not None
        x, y, yaw = T[0, 3], T[1, 3], np.arctan2(T[1, 0], T[0, 0])
        J = np.array([[1.0, 0.0, -y], [0.0, 1.0, x], [0.0, 0.0, 1.0]])
        poses.append((x, y, yaw))
        covariances.append(J @ estimate.covariance[PLANE] @ J.T)
        trust.append(estimate.trust)
    return Rectified(np.array(poses), np.array(covariances), np.array(trust))
