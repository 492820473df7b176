"""`Aligner` aligns a frame with a reference by Gauss-Newton over point-to-plane and photometric residuals. `judge`
tests the result for degenerate directions; `SurfaceWeight` weighs it against keypoints.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from wheelsight.core.calibration import Calibration
from wheelsight.core.estimates import DEGENERATE_SCALE, Reason
from wheelsight.core.geometry import Float32Array, FloatArray, se3
from wheelsight.core.threads import Rows
from wheelsight.vision.dense import alignment_kernels as kernels
from wheelsight.vision.dense.alignment_kernels import (
    COLOR_SIGMA,
    COMPARED,
    GAIN,
    GREY_SIGMA,
    GREY_WEIGHT,
    HUBER,
    MEAN_ABS,
    PLANE_SCALE,
    POINTS,
    SHOWN,
    BothViews,
    advance,
    find_turn,
    place_rows,
    show_planes,
    show_slopes,
)
from wheelsight.vision.dense.pyramid import LEVELS, SECOND, Gridder, GridFrame, Level, Reference, ReferenceMaker
from wheelsight.vision.dense.settings import DenseSettings
from wheelsight.vision.tracking_state import twist_between

# Components of a twist (v, ω) in the base's frame that wheels cannot roll: sideways, up, roll and pitch. They count for
# a holonomic base too: where a view hardly constrains sideways motion, the estimate else slides along a plain wall.
_NOT_ROLLED = [1, 2, 3, 4]
_FREE = (np.inf, np.inf)
_UPPER = np.triu_indices(6)
_DIVERGED_M = 1e3
_SMALL_STEP = 1e-4
# Initial spread of grey residuals, in grey levels; the first iteration replaces it.
_GREY_SIGMA = 8.0

# Most iterations, from the finest level to the coarsest, and the stride of the rows aligned at the finest; chosen.
_ITERATIONS = (4, 6, 8)
_ROW_STRIDE = 2
# Points farther apart are no pair, in metres and in metres per metre of depth; chosen.
GATE = 0.06
_HUBER_SIGMAS = 1.5  # beyond, a residual counts linearly
# Least grey gradient at the second level, grey levels per pixel; a flatter surface may show nothing but noise.
MIN_GRADIENT = 3.0
# Share of `color_sigma_px` left between two images of a colour camera with the same error in both; chosen.
_COLOR_ERROR_LEFT = 0.25
# Number of neighbouring residuals with the same error; variances are larger by this factor. Chosen.
CORRELATION = 20.0

# A rotation by grey is rejected if points then lie this many times as far from planes. Depth and colour of a frame are
# rarely simultaneous, so grey may be right where planes fit worse (real recordings).
_TURN_MISFIT = 3.0
_UNPAIRED_SIGMAS = 5.0  # distance of a point without a plane nearby, in standard deviations
# Another initial guess replaces the first if points lie this many times nearer to planes (simulator, as below).
_CLEARLY_NEARER = 1.5
# Another result replaces the first if it finds this share of the first one's planes, with a residual of at most this
# multiple, and grey residuals spread by less than this share (simulator: docs/decisions/dense-alignment.md).
_AS_MANY_PLANES, _AS_NEAR_PLANES, _CLEARER_GREY = 0.7, 1.1, 0.85

# Share of a frame's points that must find a partner, and the largest mean residual in standard deviations; chosen.
MIN_OVERLAP, MAX_RESIDUAL = 0.25, 5.0
# The prior replaces a direction less certain than this after one frame, metres; chosen.
_DEGENERATE_SIGMA_M = 0.01
# Share of a reference's information along a direction that the frame must show too. Where the views coincide, gradients
# of grey are similar; where an alignment has slipped along a wall, they are not (simulator).
_CONFIRMED_SHARE = 0.4
# Another prior than the first fills unseen directions if its difference from the rest is below this share (simulator).
_OTHER_PRIOR_SHARE = 0.5


@dataclass(frozen=True, slots=True, eq=False)
class DenseAlignment:
    """The result of an alignment; `judge` decides whether it is accepted.

    Attributes:
        T_reference_frame: (4, 4).
        information: (6, 6) of the left perturbation (v, ω) by what both views show, for independent residuals.
        pairs: number of points that project into the reference's image.
        planes: number of those pairs that have a plane nearby.
        points: number of points with depth at the frame's finest level.
        residual: mean absolute plane residual in standard deviations of the sensor, 1 for a perfect fit.
        grey_sigma: spread of the grey residuals, in grey levels.
        claimed: (6, 6) information of the left perturbation by the final residuals, for independent residuals.
        compared: (6, 6) `information` with the grey gradients of the reference in place of the frame's. Both are
            similar if the two views coincide.
        hinted: (6, 6) additional information if keypoints erred independently; it only decides which directions
            are constrained.
    """

    T_reference_frame: FloatArray
    information: FloatArray
    pairs: int
    planes: int
    points: int
    residual: float
    grey_sigma: float
    claimed: FloatArray
    compared: FloatArray
    hinted: FloatArray | None = None


@dataclass(frozen=True, slots=True, eq=False)
class PreviousPose:
    """The camera's pose at the previous frame (4, 4), and the time since then in seconds."""

    T_reference_previous: FloatArray
    seconds: float

    def twist_to(self, T_reference_frame: FloatArray) -> FloatArray:
        """Mean velocity (6,) since then, (v, ω) per second in the camera's own frame."""
        return twist_between(self.T_reference_previous, T_reference_frame, self.seconds)


class Aligner:
    """Aligns frames with references by Gauss-Newton from coarse to fine, on depth and grey values together."""

    def __init__(
        self, calibration: Calibration, settings: DenseSettings, rows: Rows, gridder: Gridder, maker: ReferenceMaker
    ) -> None:
        noise = calibration.depth_noise
        self._noise = np.array([noise.constant_m, noise.quadratic_per_m, noise.near_m, noise.far_m], np.float32)
        self._color_weight, self._rows, self._late_s, self._maker = settings.color_weight, rows, gridder.late_s, maker
        T_base_camera = calibration.T_base_camera
        self._T_base_camera = None if T_base_camera is None else se3.nearest(T_base_camera)
        self._Ad_base_camera = np.eye(6) if self._T_base_camera is None else se3.adjoint(self._T_base_camera)
        self._color_sigma_px = calibration.color_sigma_px / (1 << gridder.halvings)

    def turn(self, frame: GridFrame, reference: Reference, T_reference_frame: FloatArray) -> FloatArray:
        """T_reference_frame with its rotation refined by grey values alone, at the two coarsest levels.

        It stays unchanged if planes fit worse after that, because grey of a plain wall is mostly noise.
        """
        start = np.array(T_reference_frame, float)
        T, exposure = start.copy(), np.array([1.0, 0.0])
        for level, seen in zip(frame.levels[:-3:-1], reference.scales.levels[:-3:-1], strict=True):
            find_turn(kernels.Images(level.depth_m, level.grey, seen.pixels, level.intrinsics), T, exposure)
        before, after = self._misfits(frame, reference, [start, T])
        return T if after <= _TURN_MISFIT * max(before, 1.0) else start

    def start(self, frame: GridFrame, reference: Reference, guesses: Sequence[FloatArray]) -> FloatArray:
        """The initial pose: the first guess (4, 4), its rotation refined, or another one that fits clearly better."""
        return self.nearest(frame, reference, [self.turn(frame, reference, guess) for guess in guesses])

    def nearest(self, frame: GridFrame, reference: Reference, guesses: Sequence[FloatArray]) -> FloatArray:
        """The first of some guesses (4, 4), or another one if planes fit clearly better there."""
        if len(guesses) == 1:
            return guesses[0]
        misfits = self._misfits(frame, reference, guesses)
        best = int(np.argmin(misfits))
        return guesses[best] if _CLEARLY_NEARER * misfits[best] < misfits[0] else guesses[0]

    def _misfits(self, frame: GridFrame, reference: Reference, guesses: Sequence[FloatArray]) -> FloatArray:
        """The mean distance (N,) of points from planes for each guess, in standard deviations.

        The number of points is that of the guess with the most pairs; a point without pair counts `_UNPAIRED_SIGMAS`.
        """
        how = np.array([GATE, 1, _GREY_SIGMA, 1, 0, _HUBER_SIGMAS, 0, 0, 0, 0], float)
        images = _images(frame.levels[-1], reference.scales.levels[-1].pixels)
        sums, totals = np.empty((len(frame.levels[-1].depth_m), kernels.SUMS)), []
        for T in guesses:
            T_rows = np.ascontiguousarray(np.broadcast_to(T[:3].astype(np.float32), (len(sums), 3, 4)))
            given = (images, T_rows, self._noise, how.astype(np.float32), 1)
            self._rows.share(len(sums), kernels.accumulate, *given, after=(sums,))
            totals.append(sums.sum(axis=0)[kernels.PLANE_COUNT : kernels.PLANE_COUNT + 2])
        planes, off = np.transpose(totals)
        most = max(planes.max(), 1.0)
        return np.asarray((off + _UNPAIRED_SIGMAS * (most - planes)) / most)

    def align(
        self,
        frame: GridFrame,
        reference: Reference,
        T_reference_frame: FloatArray,
        previous: PreviousPose | None = None,
        held_m: tuple[float, float] = _FREE,
        keypoints: KeypointMotion | None = None,
        factor: float = 1.0,
    ) -> DenseAlignment:
        """The motion of a frame against a reference.

        Args:
            frame: the frame.
            reference: the reference.
            T_reference_frame: (4, 4) initial guess. It is a prior too, because else noise of a plain wall pulls weakly
                constrained directions along by decimetres.
            previous: the previous pose; with it each iteration updates the speed of the rolling-shutter correction.
            held_m: standard deviations of the guess, with rotations as distances at 2 m. The second one is for a base
                on wheels: its motion sideways, upwards and in tilt since the previous frame, whatever the guess.
            keypoints: the motion by keypoints, which counts like their residuals near the optimum.
            factor: weight of `keypoints`: the covariance of surfaces is larger than they claim by this factor.
        """
        rules = _HUBER_SIGMAS, self._color_weight, 0, MIN_GRADIENT, reference.own_noise
        how = np.array([0, 1, _GREY_SIGMA, 1, 0, *rules], float)
        T, total = np.array(T_reference_frame, float), np.zeros(kernels.SUMS)
        T_prior, information = self._prior_of(T, previous, held_m, keypoints, factor)
        scales, T_previous_reference, seconds = reference.scales.levels, np.eye(4), 1.0
        if previous is not None:
            T_previous_reference, seconds = se3.invert(previous.T_reference_previous), previous.seconds
        for number in reversed(range(LEVELS)):
            how[kernels.GATE] = GATE * (1 + 0.5 * number)
            how[COLOR_SIGMA] = _COLOR_ERROR_LEFT * self._color_sigma_px / (1 << number)
            images, height = _images(frame.levels[number], scales[number].pixels), len(frame.levels[number].depth_m)
            late_s, T_rows = np.zeros(height), np.empty((height, 3, 4), np.float32)
            if previous is not None:
                late_s = self._late_s[: height << number].reshape(height, -1).mean(axis=1)
            stride = _ROW_STRIDE if number == 0 else 1
            sums = np.empty((height // stride, kernels.SUMS))
            for _ in range(_ITERATIONS[number]):
                place_rows(T, T_previous_reference, seconds, frame.twist, late_s, T_rows)
                given = (images, T_rows, self._noise, how.astype(np.float32), stride)
                self._rows.share(len(sums), kernels.accumulate, *given, after=(sums,))
                if advance(sums, T, how, total, T_prior, information) < _SMALL_STEP * (1 << number):
                    break
                if not np.abs(T).max() < _DIVERGED_M:
                    return self._answer(frame, reference, np.array(T_reference_frame), np.zeros(kernels.SUMS), how)
        return self._answer(frame, reference, T, total, how)

    def _prior_of(
        self,
        T: FloatArray,
        previous: PreviousPose | None,
        held_m: tuple[float, float],
        keypoints: KeypointMotion | None,
        factor: float,
    ) -> tuple[FloatArray, FloatArray]:
        """The prior (4, 4) of an alignment with its information (6, 6) in the left tangent: guess and keypoints.

        It weighs like residuals, with rotations as distances at 2 m.
        """
        T_prior, sigmas, T_base_camera = T.copy(), np.full(6, held_m[0]), self._T_base_camera
        if T_base_camera is not None:
            sigmas[_NOT_ROLLED] = held_m[1]
        if T_base_camera is not None and previous is not None:
            # A base on wheels can only roll and turn since the previous frame.
            twist = se3.log(se3.invert(previous.T_reference_previous) @ T).reshape(2, 3)
            way, turn = twist @ T_base_camera[:3, :3].T
            # The camera's own translation: that of the base includes what a tilt about the camera adds to it.
            ahead_m = way[0] + turn[2] * T_base_camera[1, 3]
            moved = se3.exp([ahead_m, 0.0, 0.0, 0.0, 0.0, turn[2]])
            T_prior = previous.T_reference_previous @ se3.invert(T_base_camera) @ moved @ T_base_camera
        A = (DEGENERATE_SCALE / sigmas)[:, None] * (self._Ad_base_camera @ se3.adjoint(se3.invert(T_prior)))
        information = np.asarray(CORRELATION * A.T @ A)
        if keypoints is None:
            return T_prior, information
        # The mean of guess and keypoints by their information.
        by_keypoints = factor * CORRELATION * keypoints.information
        off, total = se3.log(keypoints.T_reference_frame @ se3.invert(T_prior)), information + by_keypoints
        return se3.exp(np.linalg.solve(total, by_keypoints @ off)) @ T_prior, total

    def align_clearest(
        self,
        frame: GridFrame,
        reference: Reference,
        starts: Sequence[FloatArray],
        previous: PreviousPose | None = None,
        held_m: tuple[float, float] = _FREE,
        keypoints: KeypointMotion | None = None,
        factor: float = 1.0,
    ) -> DenseAlignment:
        """The alignment from the first guess (4, 4), or from another one if grey values fit clearly better there.

        Along a wall planes constrain nothing, and its few marks match each other, so the result depends on the guess.
        """
        given = (previous, held_m, keypoints, factor)
        best = self.align(frame, reference, starts[0], *given)
        for start in starts[1:]:
            other = self.align(frame, reference, start, *given)
            as_many = other.planes >= _AS_MANY_PLANES * best.planes
            is_as_near = as_many and other.residual < _AS_NEAR_PLANES * best.residual
            if is_as_near and other.grey_sigma < _CLEARER_GREY * best.grey_sigma:
                best = other
        return best

    def _answer(
        self, frame: GridFrame, reference: Reference, T: FloatArray, total: FloatArray, how: FloatArray
    ) -> DenseAlignment:
        counted, stride = total[kernels.PLANE_COUNT], _ROW_STRIDE
        planes, pairs = int(counted) * stride, int(total[kernels.PAIRS]) * stride
        mean_abs = total[kernels.PLANE_COUNT + 1] / counted if counted else np.inf
        points = int(np.count_nonzero(frame.levels[0].depth_m))
        information, compared = self._information(frame, reference, T, pairs, how)
        residual = float(how[PLANE_SCALE] * mean_abs / MEAN_ABS)
        T = se3.nearest(T)
        claimed = symmetric(total[:21] + total[kernels.GREY_SUMS : kernels.GREY_SUMS + 21])
        grey_sigma = float(how[GREY_SIGMA])
        return DenseAlignment(T, information, pairs, planes, points, residual, grey_sigma, claimed, compared)

    def _information(
        self, frame: GridFrame, reference: Reference, T: FloatArray, pairs: int, how: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """Information (6, 6) of `pairs`, by normals of the coarsest level and grey gradients of the second.

        The second result is the same with the reference's gradients in place of the frame's (6, 6). Only structure that
        both views show counts: it excludes noise of a plain wall, and what one end of a corridor shows but its middle
        does not. Unconstrained directions may have negative eigenvalues.
        """
        own = self._maker.shown_by(frame)
        rules = how[[kernels.GATE, PLANE_SCALE, GREY_SIGMA, GAIN, HUBER, GREY_WEIGHT]]
        given = (T, self._noise.astype(float), np.append(rules, how[COLOR_SIGMA]))
        scales, information, compared = reference.scales, np.zeros((6, 6)), np.zeros((6, 6))
        planes = (frame.levels[LEVELS - 1], own.planes.pixels, scales.steep.pixels)
        slopes = (frame.levels[SECOND], own.slopes.pixels, scales.levels[SECOND].pixels)
        for show, (level, here, there) in ((show_planes, planes), (show_slopes, slopes)):
            sums = np.empty((len(level.depth_m), COMPARED))
            both = BothViews(level.depth_m, here, there, level.intrinsics)
            self._rows.share(len(sums), show, both, *given, after=(sums,))
            total = sums.sum(axis=0)
            share = float(pairs / max(total[POINTS], 1.0))
            here_shown = share * symmetric(total)
            information += here_shown
            compared += here_shown if show is show_planes else share * symmetric(total[SHOWN:])
        return information, compared


def _images(level: Level, pixels: Float32Array) -> kernels.Images:
    """A frame's level and the reference's `pixels` for kernels."""
    return kernels.Images(level.depth_m, level.grey, pixels, level.intrinsics.astype(np.float32))


def symmetric(sums: FloatArray) -> FloatArray:
    """The symmetric matrix (6, 6) of 21 sums, its upper triangle row by row."""
    H = np.zeros((6, 6))
    H[_UPPER] = sums[:21]
    return H + np.triu(H, 1).T


@dataclass(frozen=True, slots=True, eq=False)
class MotionPrior:
    """The predicted motion, before images are compared.

    Attributes:
        T_reference_frame: (4, 4).
        sigma_m: standard deviation in every direction, with rotations as distances at 2 m.
        others: alternatives, each (4, 4), in case the first one is wrong.
    """

    T_reference_frame: FloatArray
    sigma_m: float
    others: tuple[FloatArray, ...] = ()


@dataclass(frozen=True, slots=True, eq=False)
class Judgement:
    """An accepted alignment, or the reason of its rejection.

    Attributes:
        T_reference_frame: (4, 4); the prior's along `degenerate` directions.
        covariance: (6, 6) of its left perturbation (v, ω); the prior's along `degenerate` directions.
        degenerate: (K, 6) unit vectors of (v, ω · 2 m) that the view does not constrain, 0 ≤ K ≤ 6.
        reason: None if the alignment is accepted.
    """

    T_reference_frame: FloatArray
    covariance: FloatArray
    degenerate: FloatArray
    reason: Reason | None = None


def judge(
    found: DenseAlignment, prior: MotionPrior, min_overlap: float = MIN_OVERLAP, max_residual: float = MAX_RESIDUAL
) -> Judgement:
    """The alignment with the prior's motion along directions less certain than `_DEGENERATE_SIGMA_M`, or a rejection.

    The directions are eigenvectors of the information (Zhang, Kaess & Singh, ICRA 2016: solution remapping).
    """
    scale = np.outer(DEGENERATE_SCALE, DEGENERATE_SCALE) * CORRELATION
    information = found.information / scale
    shown = information if found.hinted is None else information + found.hinted / scale
    strength, directions = np.linalg.eigh(shown)
    weak = strength < _DEGENERATE_SIGMA_M**-2
    compared = found.compared / scale + (shown - information)
    weak |= strength < _CONFIRMED_SHARE * (directions * (compared @ directions)).sum(axis=0)
    strength = np.maximum((directions * (information @ directions)).sum(axis=0), 0.0)
    variances = np.where(weak, prior.sigma_m**2, 1 / np.maximum(strength, 1e-12))
    covariance = (directions * variances) @ directions.T / np.outer(DEGENERATE_SCALE, DEGENERATE_SCALE)
    T = found.T_reference_frame
    if weak.any():
        seen = directions[:, ~weak]
        priors = (prior.T_reference_frame, *prior.others)
        shifts = [seen.T @ (DEGENERATE_SCALE * se3.log(T @ se3.invert(T_prior))) for T_prior in priors]
        off_m = np.array([np.linalg.norm(shift) for shift in shifts])
        best = int(np.argmin(off_m))
        if off_m[0] < _DEGENERATE_SIGMA_M or off_m[best] > _OTHER_PRIOR_SHARE * off_m[0]:
            best = 0
        T_prior, shift = priors[best], shifts[best]
        T = se3.exp(seen @ shift / DEGENERATE_SCALE) @ T_prior
    reason = Reason.DEGENERATE if weak.all() else None
    if found.planes < min_overlap * found.points:
        reason = Reason.TOO_LITTLE_OVERLAP
    elif found.residual > max_residual:
        reason = Reason.POOR_FIT
    return Judgement(T, covariance, directions[:, weak].T, reason)


# The weight of surfaces relative to keypoints. An alignment of surfaces claims a covariance by sensor noise, which
# averages out over a hundred thousand pixels. Systematic errors of real cameras are far larger: depth is delayed,
# misregistered, or bent. Motions by keypoints and by surfaces differ by both covariances, where that of surfaces has an
# unknown factor. Variance components estimate it (Helmert; Förstner 1979).

# The factor before the first frame, the share of a frame's logarithm that updates it, and its largest value; chosen.
_FIRST_FACTOR, _LEARNED, _MOST_FACTOR = 1.0, 0.1, 1e4
# Beyond this difference of keypoints and surfaces the frame's own factor counts: χ² of 6, 99.9 %. In a quick turn
# colour and depth that are not simultaneous differ.
_ODD_CHI2 = 22.5
# Times the information of keypoints that surfaces must claim along a direction to be judged by it; chosen.
_LEAST_CLAIM = 1.0


@dataclass(frozen=True, slots=True, eq=False)
class KeypointMotion:
    """The motion of a frame by its keypoints (4, 4), and the information (6, 6) of its left perturbation."""

    T_reference_frame: FloatArray
    information: FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class Joint:
    """A motion by keypoints and surfaces together.

    Attributes:
        T_reference_frame: (4, 4).
        ahead: (6,) the left perturbation from the motion by surfaces alone to that by keypoints.
        factor: on the covariance that surfaces claim.
        seen_factor: the factor by this frame alone.
    """

    T_reference_frame: FloatArray
    ahead: FloatArray
    factor: float
    seen_factor: float


class SurfaceWeight:
    """Estimates the factor on the covariance that surfaces claim, for one camera.

    Attributes:
        factor: the present estimate, at least 1.
    """

    def __init__(self) -> None:
        self.factor = _FIRST_FACTOR

    def learn(self, joint: Joint) -> None:
        """Update the factor by a frame whose pose was accepted."""
        self.factor *= (joint.seen_factor / self.factor) ** _LEARNED

    def meet(self, T_reference_frame: FloatArray, surfaces: FloatArray, keypoints: KeypointMotion) -> Joint:
        """The motion by keypoints and surfaces, with the estimated factor or the frame's own if that is too small.

        Args:
            T_reference_frame: (4, 4) the optimum of keypoints and surfaces with the estimated factor.
            surfaces: (6, 6) information of the left perturbation that surfaces claim.
            keypoints: the motion by keypoints.
        """
        root = np.linalg.cholesky(keypoints.information)
        whitened = np.linalg.solve(root, np.linalg.solve(root, surfaces).T)
        claimed, directions = np.linalg.eigh(0.5 * (whitened + whitened.T))
        claimed = np.maximum(claimed, 1e-9)
        # From the joint optimum to the motion by keypoints, in standard deviations of the latter.
        off = directions.T @ root.T @ se3.log(keypoints.T_reference_frame @ se3.invert(T_reference_frame))
        apart = off * (1 + self.factor / claimed)
        seen, shown = self.factor, claimed > _LEAST_CLAIM
        if shown.any():  # differences relative to those that surfaces claim, along constrained directions
            excess = float((apart[shown] ** 2 - 1).sum() / (1 / claimed[shown]).sum())
            seen = float(np.clip(excess, 1.0, _MOST_FACTOR))
        is_odd = (apart**2 / (1 + self.factor / claimed)).sum() > _ODD_CHI2
        factor = max(self.factor, seen) if is_odd else self.factor
        share = claimed / factor / (1 + claimed / factor)
        back = np.linalg.solve(root.T, directions @ (share * apart))
        ahead = np.linalg.solve(root.T, directions @ apart)
        return Joint(se3.exp(-back) @ keypoints.T_reference_frame, ahead, factor, seen)
