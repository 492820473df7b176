"""`Aligner` aligns a frame with a reference by Gauss-Newton over point-to-plane and photometric residuals. `judge`
tests the result for degenerate directions; `SurfaceWeight` weighs it against keypoints.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np

from wheelsight.core.calibration import Calibration
from wheelsight.core.estimates import DEGENERATE_SCALE, Reason
from wheelsight.core.geometry import Float32Array, FloatArray, se3, so3
from wheelsight.core.threads import Rows
from wheelsight.vision.dense import alignment_kernels as kernels
from wheelsight.vision.dense.alignment_kernels import (
    COLOR_SIGMA,
    COMPARED,
    GAIN,
    GATE,
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
from wheelsight.vision.dense.pyramid import Gridder, GridFrame, Level, Reference, ReferenceMaker
from wheelsight.vision.dense.settings import DenseSettings, JointSettings
from wheelsight.vision.tracking_state import twist_between

# Dense alignment: point-to-plane and grey values together, by Gauss–Newton from coarse to fine.


# Of a twist (v, ω) in the base's frame, what wheels do not roll: sideways, up, roll and pitch. A holonomic base is held
# so too: where hardly anything shows a way to the side, a guess confirms itself and slides along a plain wall.
_NOT_ROLLED = [1, 2, 3, 4]
_FREE = (np.inf, np.inf)
_UPPER = np.triu_indices(6)
_DIVERGED_M = 1e3
_SMALL_STEP = 1e-4
# Grey levels that residuals of grey are taken to spread by at first; it is learned at once.
_GREY_SIGMA = 8.0


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
        grey_sigma: spread of the grey residuals, in grey levels.
        claimed: (6, 6) information of the left perturbation that residuals had at the end, as if they were independent.
        compared: (6, 6) the same, if the frame showed the slopes of grey that the reference does: alike where both lie
            on each other.
        hinted: (6, 6) what keypoints would add to that if each erred by itself: which directions are shown goes by it.
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
class Step:
    """Where the camera was when the frame before was taken (4, 4), and how long ago."""

    T_reference_previous: FloatArray
    seconds: float

    def twist_to(self, T_reference_frame: FloatArray) -> FloatArray:
        """Mean velocity (6,), (v, ω) a second in the camera's own frame, since then."""
        return twist_between(self.T_reference_previous, T_reference_frame, self.seconds)


class Aligner:
    """Aligns frames with references."""

    def __init__(
        self, calibration: Calibration, settings: DenseSettings, rows: Rows, gridder: Gridder, maker: ReferenceMaker
    ) -> None:
        noise = calibration.depth_noise
        self._noise = np.array([noise.constant_m, noise.quadratic_per_m, noise.near_m, noise.far_m], np.float32)
        self._settings, self._rows, self._late_s, self._maker = settings, rows, gridder.late_s, maker
        self._starts = settings.starts
        T_base_camera = calibration.T_base_camera
        self._T_base_camera = None if T_base_camera is None else se3.nearest(T_base_camera)
        self._Ad_base_camera = np.eye(6) if self._T_base_camera is None else se3.adjoint(self._T_base_camera)
        self._color_sigma_px = calibration.color_sigma_px / (1 << gridder.halvings)

    def turn(self, frame: GridFrame, reference: Reference, T_reference_frame: FloatArray) -> FloatArray:
        """T_reference_frame with its rotation bettered by grey values alone, at the two coarsest levels.

        Where planes then lie worse than before, it stays as it was: grey of a plain wall is mostly noise.
        """
        start = np.array(T_reference_frame, float)
        T, exposure = start.copy(), np.array([1.0, 0.0])
        for level, seen in zip(frame.levels[:-3:-1], reference.levels[:-3:-1], strict=True):
            find_turn(kernels.Images(level.depth_m, level.grey, seen.pixels, level.intrinsics), T, exposure)
        before, after = self._misfits(frame, reference, [start, T])
        return T if after <= self._starts.turn_misfit * max(before, 1.0) else start

    def start(self, frame: GridFrame, reference: Reference, guesses: Sequence[FloatArray]) -> FloatArray:
        """Where to begin, of some guesses (4, 4): the first, turned; another where planes clearly lie better there."""
        return self.nearest(frame, reference, [self.turn(frame, reference, guess) for guess in guesses])

    def nearest(self, frame: GridFrame, reference: Reference, guesses: Sequence[FloatArray]) -> FloatArray:
        """The first of some guesses (4, 4), or another where planes clearly lie better there."""
        if len(guesses) == 1:
            return guesses[0]
        misfits = self._misfits(frame, reference, guesses)
        best = int(np.argmin(misfits))
        return guesses[best] if self._starts.clearly_nearer * misfits[best] < misfits[0] else guesses[0]

    def _misfits(self, frame: GridFrame, reference: Reference, guesses: Sequence[FloatArray]) -> FloatArray:
        """How far (N,) points lie from planes in the mean, in standard deviations, if frames are where guesses say.

        Points count that have a plane near by the guess that gives most of them one; without one they are far away.
        """
        how = np.array([self._settings.gate, 1, _GREY_SIGMA, 1, 0, self._settings.huber, 0, 0, 0, 0], float)
        level, pixels = frame.levels[-1], reference.levels[-1].pixels
        sums, totals = np.empty((len(level.depth_m), kernels.SUMS)), []
        for T in guesses:
            T_rows = np.ascontiguousarray(np.broadcast_to(T[:3].astype(np.float32), (len(sums), 3, 4)))
            self._sum_up(level, pixels, T_rows, how, sums)
            totals.append(sums.sum(axis=0)[kernels.PLANE_COUNT : kernels.PLANE_COUNT + 2])
        planes, off = np.transpose(totals)
        most = max(planes.max(), 1.0)
        return np.asarray((off + self._starts.unpaired_sigmas * (most - planes)) / most)

    def align(
        self,
        frame: GridFrame,
        reference: Reference,
        T_reference_frame: FloatArray,
        step: Step | None = None,
        held_m: tuple[float, float] = _FREE,
        told: Told | None = None,
        factor: float = 1.0,
    ) -> DenseAlignment:
        """The motion of a frame against a reference, from a first guess (4, 4).

        The guess holds what hardly anything shows: else the noise of a plain wall would pull it along for decimetres.
        It is off by the first of `held_m`, turns as ways at 2 m; a base on wheels goes sideways, rises and tilts by the
        second since the frame before, whatever the guess says: one by grey values of a plain wall tilts by degrees.
        With `step` the speed by which the rolling shutter's rows were straightened is corrected on the way. What
        keypoints have `told` counts as their residuals would, near their own best motion: `factor` times as much, for
        so many times less than they claim surfaces tell.
        """
        settings = self._settings
        rules = settings.huber, settings.color_weight, 0, settings.min_gradient, reference.own_noise
        how = np.array([0, 1, _GREY_SIGMA, 1, 0, *rules], float)
        T, total = np.array(T_reference_frame, float), np.zeros(kernels.SUMS)
        T_held, hold = self._held(T, step, held_m, told, factor)
        for number in reversed(range(settings.levels)):
            how[GATE] = settings.gate * (1 + 0.5 * number)
            how[COLOR_SIGMA] = self._settings.color_error_left * self._color_sigma_px / (1 << number)
            place = self._placer(frame, number, step)
            stride = settings.row_stride if number == 0 else 1
            sums = np.empty((len(frame.levels[number].depth_m) // stride, kernels.SUMS))
            for _ in range(settings.iterations[min(number, len(settings.iterations) - 1)]):
                self._sum_up(frame.levels[number], reference.levels[number].pixels, place(T), how, sums, stride)
                if advance(sums, T, how, total, T_held, hold) < _SMALL_STEP * (1 << number):
                    break
                if not np.abs(T).max() < _DIVERGED_M:
                    return self._answer(frame, reference, np.array(T_reference_frame), np.zeros(kernels.SUMS), how)
        return self._answer(frame, reference, T, total, how)

    def _held(
        self, T: FloatArray, step: Step | None, held_m: tuple[float, float], told: Told | None, factor: float
    ) -> tuple[FloatArray, FloatArray]:
        """Where a guess (4, 4) is held, and how firmly: by what is expected, and by what keypoints have told."""
        T_held, hold = self._hold(T, step, held_m)
        if told is None:
            return T_held, hold
        return both(T_held, hold, told.T_reference_frame, factor * self._settings.correlation * told.information)

    def align_clearest(
        self,
        frame: GridFrame,
        reference: Reference,
        starts: Sequence[FloatArray],
        step: Step | None = None,
        held_m: tuple[float, float] = _FREE,
        told: Told | None = None,
        factor: float = 1.0,
    ) -> DenseAlignment:
        """The alignment from the first guess (4, 4), unless grey values fit clearly better from another one.

        Along a wall planes say nothing, and its few marks fit each other's places: what comes out is where one began.
        """
        limits = self._starts
        best, *others = (self.align(frame, reference, start, step, held_m, told, factor) for start in starts)
        for other in others:
            as_many = other.planes >= limits.as_many_planes * best.planes
            is_as_near = as_many and other.residual < limits.as_near_planes * best.residual
            if is_as_near and other.grey_sigma < limits.clearer_grey * best.grey_sigma:
                best = other
        return best

    def _rolled(self, T_reference_frame: FloatArray, step: Step | None) -> FloatArray:
        """A guess (4, 4) as it is if a base on wheels has but rolled ahead and turned since the frame before."""
        if step is None or self._T_base_camera is None:
            return T_reference_frame.copy()
        T_base_camera = self._T_base_camera
        twist = se3.log(se3.invert(step.T_reference_previous) @ T_reference_frame).reshape(2, 3)
        way, turn = twist @ T_base_camera[:3, :3].T
        # By the camera's own way: where the guess turns about the camera, the base's has what tilting moved it.
        ahead_m = way[0] + turn[2] * T_base_camera[1, 3]
        moved = se3.exp([ahead_m, 0.0, 0.0, 0.0, 0.0, turn[2]])
        return step.T_reference_previous @ se3.invert(T_base_camera) @ moved @ T_base_camera

    def _hold(
        self, T_reference_frame: FloatArray, step: Step | None, held_m: tuple[float, float]
    ) -> tuple[FloatArray, FloatArray]:
        """Where a guess (4, 4) is held, and how firmly: information (6, 6) in the left tangent.

        It weighs like residuals; turns of the frame are ways at 2 m.
        """
        T_held, sigmas = self._rolled(T_reference_frame, step), np.full(6, held_m[0])
        if self._T_base_camera is not None:
            sigmas[_NOT_ROLLED] = held_m[1]
        A = (DEGENERATE_SCALE / sigmas)[:, None] * (self._Ad_base_camera @ se3.adjoint(se3.invert(T_held)))
        return T_held, np.asarray(self._settings.correlation * A.T @ A)

    def _answer(
        self, frame: GridFrame, reference: Reference, T: FloatArray, total: FloatArray, how: FloatArray
    ) -> DenseAlignment:
        counted, stride = total[kernels.PLANE_COUNT], self._settings.row_stride
        planes, pairs = int(counted) * stride, int(total[kernels.PAIRS]) * stride
        mean_abs = total[kernels.PLANE_COUNT + 1] / counted if counted else np.inf
        points = int(np.count_nonzero(frame.levels[0].depth_m))
        information, compared = self._information(frame, reference, T, pairs, how)
        residual = float(how[PLANE_SCALE] * mean_abs / MEAN_ABS)
        T = se3.from_parts(so3.nearest(T[:3, :3]), T[:3, 3])
        claimed = _symmetric(total[:21] + total[kernels.GREY_SUMS : kernels.GREY_SUMS + 21])
        grey_sigma = float(how[GREY_SIGMA])
        return DenseAlignment(T, information, pairs, planes, points, residual, grey_sigma, claimed, compared)

    def _information(
        self, frame: GridFrame, reference: Reference, T: FloatArray, pairs: int, how: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """What so many pairs tell (6, 6), by normals of the coarsest level and slopes of grey of the second.

        And what they would tell if the frame's slopes were the reference's (6, 6). Only what both views show counts:
        else a plain wall's noise, or what a reference from a corridor's entrance shows and its middle does not, would
        tell what is not there. It may have negative eigenvalues where nothing is.
        """
        own = self._maker.shown_by(frame)
        rules = how[[GATE, PLANE_SCALE, GREY_SIGMA, GAIN, HUBER, GREY_WEIGHT]]
        given = (T, self._noise.astype(float), np.append(rules, how[COLOR_SIGMA]))
        coarsest, second = self._settings.levels - 1, min(1, self._settings.levels - 1)
        planes = (frame.levels[coarsest], own.planes.pixels, reference.steep.pixels)
        slopes = (frame.levels[second], own.slopes.pixels, reference.levels[second].pixels)
        information, compared = np.zeros((6, 6)), np.zeros((6, 6))
        for show, (level, here, there) in ((show_planes, planes), (show_slopes, slopes)):
            sums = np.empty((len(level.depth_m), COMPARED))
            both = BothViews(level.depth_m, here, there, level.intrinsics)
            self._rows.share(len(sums), partial(_in_rows, show, (both, *given), sums))
            total = sums.sum(axis=0)
            share = float(pairs / max(total[POINTS], 1.0))
            information += share * _symmetric(total)
            compared += share * _symmetric(total if show is show_planes else total[SHOWN:])
        return information, compared

    def _placer(self, frame: GridFrame, number: int, step: Step | None) -> Callable[[FloatArray], Float32Array]:
        """Gives T_reference_frame (h, 3, 4) of each row of a level, for T_reference_frame (4, 4) of the middle one."""
        height = len(frame.levels[number].depth_m)
        T_rows = np.empty((height, 3, 4), np.float32)
        late_s = self._late_s[: height << number].reshape(height, -1).mean(axis=1)
        T_previous_reference, seconds = np.eye(4), 1.0
        if step is None:
            late_s = np.zeros(height)
        else:
            T_previous_reference, seconds = se3.invert(step.T_reference_previous), step.seconds

        def place(T: FloatArray) -> Float32Array:
            place_rows(T, T_previous_reference, seconds, frame.twist, late_s, T_rows)
            return T_rows

        return place

    def _sum_up(
        self,
        level: Level,
        pixels: Float32Array,
        T_rows: Float32Array,
        how: FloatArray,
        sums: FloatArray,
        stride: int = 1,
    ) -> None:
        images = kernels.Images(level.depth_m, level.grey, pixels, level.intrinsics.astype(np.float32))
        given = (images, T_rows, self._noise, how.astype(np.float32), stride)
        self._rows.share(len(sums), lambda begin, end: kernels.accumulate(*given, begin, end, sums))


def both(
    T_first: FloatArray, first: FloatArray, T_second: FloatArray, second: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Where (4, 4) two pieces of information (6, 6) each, about left perturbations, meet, and their sum."""
    off, total = se3.log(T_second @ se3.invert(T_first)), first + second
    return se3.exp(np.linalg.solve(total, second @ off)) @ T_first, total


def _symmetric(sums: FloatArray) -> FloatArray:
    H = np.zeros((6, 6))
    H[_UPPER] = sums[:21]
    return H + np.triu(H, 1).T


def _in_rows(show: Callable[..., None], given: tuple[object, ...], sums: FloatArray, begin: int, end: int) -> None:
    show(*given, begin, end, sums)


# Whether an alignment is an answer, how certain it is, and which directions of motion it cannot tell.


@dataclass(frozen=True, slots=True, eq=False)
class Prior:
    """What is expected of a motion before the images are compared.

    Attributes:
        T_reference_frame: (4, 4).
        sigma_m: standard deviation in every direction, turns as ways at 2 m.
        others: each (4, 4), what else may be expected if the first turns out to be wrong.
    """

    T_reference_frame: FloatArray
    sigma_m: float
    others: tuple[FloatArray, ...] = ()


@dataclass(frozen=True, slots=True, eq=False)
class Judgement:
    """An alignment as an answer, or the reason why it is none.

    Attributes:
        T_reference_frame: (4, 4); along `degenerate` directions the prior's.
        covariance: (6, 6) of its left perturbation (v, ω); along `degenerate` directions the prior's.
        degenerate: (K, 6) unit vectors of (v, ω · 2 m) that the view does not show, 0 ≤ K ≤ 6.
        reason: None for an answer.
    """

    T_reference_frame: FloatArray
    covariance: FloatArray
    degenerate: FloatArray
    reason: Reason | None = None


def judge(found: DenseAlignment, prior: Prior, settings: DenseSettings) -> Judgement:
    """Judge an alignment; directions in which it is less certain than `degenerate_sigma_m` keep the prior's motion.

    Eigenvectors of the information tell them (Zhang, Kaess & Singh, ICRA 2016: solution remapping).
    """
    scale = np.outer(DEGENERATE_SCALE, DEGENERATE_SCALE) * settings.correlation
    information = found.information / scale
    shown = information if found.hinted is None else information + found.hinted / scale
    strength, directions = np.linalg.eigh(shown)
    weak = strength < settings.degenerate_sigma_m**-2
    compared = found.compared / scale + (shown - information)
    weak |= strength < settings.confirmed_share * (directions * (compared @ directions)).sum(axis=0)
    strength = np.maximum((directions * (information @ directions)).sum(axis=0), 0.0)
    variances = np.where(weak, prior.sigma_m**2, 1 / np.maximum(strength, 1e-12))
    covariance = (directions * variances) @ directions.T / np.outer(DEGENERATE_SCALE, DEGENERATE_SCALE)
    T = found.T_reference_frame
    if weak.any():
        seen = directions[:, ~weak]
        T_prior, shift = _nearest_prior(T, prior, seen, settings)
        T = se3.exp(seen @ shift / DEGENERATE_SCALE) @ T_prior
    return Judgement(T, covariance, directions[:, weak].T, _reason(found, int(weak.sum()), settings))


def _nearest_prior(
    T: FloatArray, prior: Prior, seen: FloatArray, settings: DenseSettings
) -> tuple[FloatArray, FloatArray]:
    """The prior (4, 4), and how far T is from it along what is `seen` (6, K): what is wrong there is nowhere right."""
    priors = (prior.T_reference_frame, *prior.others)
    shifts = [seen.T @ (DEGENERATE_SCALE * se3.log(T @ se3.invert(T_prior))) for T_prior in priors]
    off_m = np.array([np.linalg.norm(shift) for shift in shifts])
    best = int(np.argmin(off_m))
    if off_m[0] < settings.degenerate_sigma_m or off_m[best] > settings.other_prior_share * off_m[0]:
        best = 0
    return priors[best], shifts[best]


def _reason(found: DenseAlignment, unseen: int, settings: DenseSettings) -> Reason | None:
    if found.planes < settings.min_overlap * found.points:
        return Reason.TOO_LITTLE_OVERLAP
    if found.residual > settings.max_residual:
        return Reason.POOR_FIT
    return Reason.DEGENERATE if unseen == 6 else None


# SurfaceWeight: how much surfaces count beside keypoints, learned by how far both disagree.
#
# What an alignment of surfaces claims rests on the sensor's noise, which averages out over a hundred thousand pixels.
# What does not average out is far larger on real cameras: depth that is of another instant than colour, that is not
# quite registered, or bent. Keypoints show how large it is. Their motions differ from those of surfaces by both
# covariances, of which that of surfaces has an unknown factor: variance components tell it (Helmert; Förstner 1979).


@dataclass(frozen=True, slots=True, eq=False)
class Told:
    """What keypoints tell of a motion: where the frame is (4, 4), and information (6, 6) of its left perturbation."""

    T_reference_frame: FloatArray
    information: FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class Joint:
    """A motion by both.

    Attributes:
        T_reference_frame: (4, 4).
        ahead: (6,) how far keypoints lead beyond surfaces alone, as a left perturbation.
        factor: by which the covariance of surfaces was taken larger than they claim.
        seen_factor: what this frame alone says of that.
    """

    T_reference_frame: FloatArray
    ahead: FloatArray
    factor: float
    seen_factor: float


class SurfaceWeight:
    """Learns the factor on the covariance of what surfaces say, of one camera in one place.

    Attributes:
        factor: as learned so far, at least 1.
    """

    def __init__(self, settings: JointSettings) -> None:
        self._settings = settings
        self.factor = settings.first_factor

    def learn(self, joint: Joint) -> None:
        """Take a frame whose pose was accepted as an example."""
        self.factor *= (joint.seen_factor / self.factor) ** self._settings.learned

    def meet(self, T_reference_frame: FloatArray, surfaces: FloatArray, told: Told) -> Joint:
        """A motion (4, 4) found by both with the factor known before, or with its own where that is too small.

        Args:
            T_reference_frame: where keypoints and surfaces meet, the latter by the factor learned.
            surfaces: (6, 6) information of the left perturbation that surfaces claim.
            told: what keypoints say.
        """
        root = np.linalg.cholesky(told.information)
        whitened = np.linalg.solve(root, np.linalg.solve(root, surfaces).T)
        claimed, directions = np.linalg.eigh(0.5 * (whitened + whitened.T))
        claimed = np.maximum(claimed, 1e-9)
        # From where both meet to where keypoints lead, in their standard deviations.
        off = directions.T @ root.T @ se3.log(told.T_reference_frame @ se3.invert(T_reference_frame))
        apart = off * (1 + self.factor / claimed)
        seen = self._seen(apart, claimed)
        is_odd = (apart**2 / (1 + self.factor / claimed)).sum() > self._settings.odd_chi2
        factor = max(self.factor, seen) if is_odd else self.factor
        share = claimed / factor / (1 + claimed / factor)
        back = np.linalg.solve(root.T, directions @ (share * apart))
        ahead = np.linalg.solve(root.T, directions @ apart)
        return Joint(se3.exp(-back) @ told.T_reference_frame, ahead, factor, seen)

    def _seen(self, apart: FloatArray, claimed: FloatArray) -> float:
        """The factor by which disagreements (6,) exceed what is `claimed` (6,), along directions that surfaces show."""
        shown = claimed > self._settings.shown
        if not shown.any():
            return self.factor
        excess = float((apart[shown] ** 2 - 1).sum() / (1 / claimed[shown]).sum())
        return float(np.clip(excess, 1.0, self._settings.most))
