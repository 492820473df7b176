"""Dense alignment: point-to-plane and grey values together, by Gauss–Newton from coarse to fine."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from wheelsight.calibration import Calibration
from wheelsight.geometry import Float32Array, FloatArray, se3, so3
from wheelsight.odometry.dense import _alignment_kernels as kernels
from wheelsight.odometry.dense.grid import GridFrame, Rows
from wheelsight.odometry.dense.reference import Reference
from wheelsight.odometry.dense.settings import DenseSettings

_UPPER = np.triu_indices(6)
_SMALL_STEP = 1e-5
# Mean absolute value of a standard normal variable.
_MEAN_ABS = np.sqrt(2 / np.pi)
_GREY_SIGMA = 8.0
_GREY_SIGMA_RANGE = (3.0, 30.0)
_PLANE_SCALE_RANGE = (1.0, 4.0)
_GAIN_RANGE = (0.3, 3.0)
_TURN_STEPS, _TURN_LIMIT = 6, 20.0


@dataclass(frozen=True, slots=True, eq=False)
class DenseAlignment:
    """A motion found, or as far as it came.

    Attributes:
        T_reference_frame: (4, 4).
        information: (6, 6) of the left perturbation (v, ω), as if residuals were independent.
        pairs: points that fell into the reference's image.
        planes: of these, how many found a plane near them.
        points: of the frame's finest level, with depth.
        residual: mean absolute plane residual in standard deviations of the sensor, 1 for a perfect fit.
    """

    T_reference_frame: FloatArray
    information: FloatArray
    pairs: int
    planes: int
    points: int
    residual: float


@dataclass(frozen=True, slots=True, eq=False)
class Step:
    """Where the camera was when the frame before was taken (4, 4), and how long ago."""

    T_reference_previous: FloatArray
    seconds: float

    def twist_to(self, T_reference_frame: FloatArray) -> FloatArray:
        """Mean velocity (6,), (v, ω) a second in the camera's own frame, since then."""
        T = se3.invert(self.T_reference_previous) @ T_reference_frame
        return np.asarray(np.concatenate([T[:3, 3], so3.log(T[:3, :3])]) / self.seconds)


class Aligner:
    """Aligns frames with references."""

    def __init__(self, calibration: Calibration, settings: DenseSettings, rows: Rows, late_s: FloatArray) -> None:
        noise = calibration.depth_noise
        self._noise = np.array([noise.constant_m, noise.quadratic_per_m, noise.near_m, noise.far_m], np.float32)
        self._settings, self._rows, self._late_s = settings, rows, late_s

    def turn(self, frame: GridFrame, reference: Reference, T_reference_frame: FloatArray) -> FloatArray:
        """T_reference_frame with its rotation bettered by grey values alone, at the coarsest level."""
        level, seen = frame.levels[-1], reference.levels[-1]
        R, sums = T_reference_frame[:3, :3].copy(), np.empty(11)
        best = np.inf
        kept = R
        for _ in range(_TURN_STEPS):
            given = (level.grey, seen.level.grey, seen.along_u, seen.along_v, level.intrinsics, R)
            kernels.accumulate_turn(*given, _TURN_LIMIT, sums)
            if sums[9] < 0.3 * level.grey.size:
                break
            error = sums[10] / sums[9]
            if error > best:
                break
            best, kept = error, R
            H = np.array([[sums[0], sums[1], sums[2]], [sums[1], sums[3], sums[4]], [sums[2], sums[4], sums[5]]])
            step = -np.linalg.solve(H + 1e-6 * np.trace(H) * np.eye(3) + 1e-9 * np.eye(3), sums[6:9])
            R = so3.exp(step) @ R
        T = T_reference_frame.copy()
        T[:3, :3] = kept
        return T

    def align(
        self, frame: GridFrame, reference: Reference, T_reference_frame: FloatArray, step: Step | None = None
    ) -> DenseAlignment:
        """The motion of a frame against a reference, from a first guess (4, 4).

        With `step` the speed by which the rolling shutter's rows were straightened is corrected on the way.
        """
        scales = np.array(
            [self._settings.gate, 1.0, _GREY_SIGMA, 1.0, 0.0, self._settings.huber, self._settings.color_weight]
        )
        T, total = T_reference_frame, np.zeros(kernels.SUMS)
        for number in reversed(range(len(frame.levels))):
            scales[0] = self._settings.gate * (1 + 0.5 * number)
            for _ in range(self._settings.iterations[min(number, len(self._settings.iterations) - 1)]):
                total = self._sums(frame, reference, number, self._rows_of(frame, number, T, step), scales)
                H, b = _normal_equations(total)
                change = _solve(H, b)
                T = se3.exp(change) @ T
                self._rescale(scales, total)
                if np.abs(change).max() < _SMALL_STEP * (1 << number):
                    break
        return self._answer(frame, T, total, scales[1])

    def _rows_of(self, frame: GridFrame, number: int, T: FloatArray, step: Step | None) -> Float32Array:
        """T_reference_frame (h, 3, 4) of each row of a level, whose points the frame's own twist may have misplaced."""
        T = T.astype(np.float32)
        height = len(frame.levels[number].depth_m)
        if step is None or not self._late_s.any():
            return np.ascontiguousarray(np.broadcast_to(T[:3], (height, 3, 4)))
        wrong = step.twist_to(T) - frame.twist
        late_s = self._late_s[: height << number].reshape(height, -1).mean(axis=1)
        M = np.zeros((4, 4))
        M[:3, :3], M[:3, 3] = so3.hat(wrong[3:]), wrong[:3]
        return np.ascontiguousarray((T + late_s[:, None, None] * (T @ M))[:, :3], np.float32)

    def _sums(
        self, frame: GridFrame, reference: Reference, number: int, T_rows: Float32Array, scales: FloatArray
    ) -> FloatArray:
        level, seen = frame.levels[number], reference.levels[number]
        height = len(level.depth_m)
        sums = np.empty((height, kernels.SUMS))
        given = (level.depth_m, level.grey, seen.level.depth_m, seen.normal, seen.level.grey, seen.along_u)
        more = (seen.along_v, level.intrinsics.astype(np.float32), T_rows, self._noise, scales.astype(np.float32))
        self._rows.share(height, lambda a, b: kernels.accumulate(*given, *more, a, b, sums))
        return np.asarray(sums.sum(axis=0))

    def _rescale(self, scales: FloatArray, total: FloatArray) -> None:
        """Learn from the residuals how large they are, and how the exposure has changed."""
        if total[kernels.PLANE_COUNT] > 100:
            mean_abs = scales[1] * total[kernels.PLANE_COUNT + 1] / total[kernels.PLANE_COUNT]
            scales[1] = np.clip(mean_abs / _MEAN_ABS, *_PLANE_SCALE_RANGE)
        if total[kernels.GREY_COUNT] > 100:
            mean_abs = total[kernels.GREY_COUNT + 1] / total[kernels.GREY_COUNT]
            scales[2] = np.clip(scales[2] / scales[6] * mean_abs / _MEAN_ABS, *_GREY_SIGMA_RANGE)
            n, x, y, xx, xy = total[[kernels.FIT_N, kernels.FIT_X, kernels.FIT_Y, kernels.FIT_XX, kernels.FIT_XY]]
            spread = n * xx - x * x
            if spread > 1e-3 * n * n:
                scales[3] = np.clip((n * xy - x * y) / spread, *_GAIN_RANGE)
            scales[4] = (y - scales[3] * x) / n

    def _answer(self, frame: GridFrame, T: FloatArray, total: FloatArray, scale: float) -> DenseAlignment:
        H, _ = _normal_equations(total)
        T = se3.from_parts(so3.nearest(T[:3, :3]), T[:3, 3])
        planes = int(total[kernels.PLANE_COUNT])
        residual = scale * total[kernels.PLANE_COUNT + 1] / planes / _MEAN_ABS if planes else np.inf
        points = int(np.count_nonzero(frame.levels[0].depth_m))
        return DenseAlignment(T, H, int(total[kernels.PAIRS]), planes, points, float(residual))


def _normal_equations(total: FloatArray) -> tuple[FloatArray, FloatArray]:
    H = np.zeros((6, 6))
    H[_UPPER] = total[:21]
    return H + np.triu(H, 1).T, total[21:27]


def _solve(H: FloatArray, b: FloatArray) -> FloatArray:
    return -np.linalg.solve(H + 1e-9 * np.trace(H) * np.eye(6) + 1e-12 * np.eye(6), b)
