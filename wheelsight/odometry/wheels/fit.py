"""fit_wheels: both radii, track width and clock delay by least squares against a reference trajectory.

The reference, ground truth or visual odometry, is cut into short pieces. What the wheels make of each is compared with
what the reference says, along and across the way and in yaw, and wheel sizes and delay are sought for which the
differences are least. The body that the reference follows, a marker or a camera, may sit off the middle of the axle and
look a little aside: its mount is fitted along with the rest. Pieces where a wheel slipped or the reference jumped lose
their weight (Geman & McClure 1985; graduated as in Yang et al., RA-L 2020): what counts as a slip is narrowed from
generous to the spread found.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from wheelsight.calibration import Wheels
from wheelsight.errors import CalibrationError
from wheelsight.geometry import BoolArray, FloatArray
from wheelsight.odometry.wheels._observability import (
    chords_m,
    refuse_if_impossible,
    refuse_if_unlike,
    refuse_if_unobservable,
)
from wheelsight.odometry.wheels.drive import Drive
from wheelsight.odometry.wheels.segments import Segments, cut
from wheelsight.trajectory import Trajectory

PARAMETERS = ("left_radius_m", "right_radius_m", "track_width_m", "delay_s")
LARGEST_DELAY_S = 0.5

_FEWEST_SEGMENTS = 12
_COARSE_STEP_S = 0.02
_STEP = 0.01
_FIRST_SCALES = np.array([0.02, 0.02, 0.02])
_LEAST_SCALES = np.array([5e-4, 5e-4, 5e-4])  # no reference is better than half a millimetre and half a milliradian
_NARROWING = (32.0, 8.0, 4.0, 2.0, 1.0, 1.0, 1.0)
_MOUNT_SIGMAS = np.array([0.5, 0.5, 0.3])  # how far off a mount may well be; holds what a straight drive leaves open
_SLIP_CHI2 = 16.0  # three normal residuals exceed it once in a thousand
_MOST_CLUSTERS = 25


@dataclass(frozen=True, eq=False)
class WheelFit:
    """Wheels fitted to a reference.

    Attributes:
        nominal, wheels: before and after.
        sigmas: standard deviation of each of PARAMETERS that was fitted, by name, in its unit.
        ratio_sigma: standard deviation of right radius over left, far smaller than what each radius alone allows.
        mount: (3,) x, y in metres and yaw in radians of T_axle_body: how the reference's body was found to sit.
        segments: what the wheels had to explain.
        residuals: (M, 3) of the fitted wheels, along and across each segment in metres, yaw in radians.
        weights: (M,) 0 to 1 of the segments; a slip has about 0.
        is_slip: (M,) segments whose residual is beyond what one in a thousand would show without a slip.
    """

    nominal: Wheels
    wheels: Wheels
    sigmas: dict[str, float]
    ratio_sigma: float
    mount: FloatArray
    segments: Segments
    residuals: FloatArray
    weights: FloatArray
    is_slip: BoolArray

    @property
    def spread(self) -> FloatArray:
        """Robust standard deviation (3,) of the residuals of a segment: along, across in metres, yaw in radians."""
        return _spread(self.residuals)


def fit_wheels(
    wheels: Wheels,
    drive: Drive,
    reference: Trajectory,
    *,
    segment_m: float = 1.0,
    with_delay: bool = True,
    on_step: Callable[[str], None] = lambda _: None,
) -> WheelFit:
    """Wheels that explain `reference`, with standard deviations, or a refusal that says what drive would do.

    Args:
        wheels: nominal ones: radii and track width right to a factor of two, delay to half a second.
        drive: the readings of both wheels.
        reference: T_world_base, with a base that is right to a few decimetres and degrees (see
            `recordings.bodies.express_for` for one of the camera).
        segment_m: way between two poses that are compared: long for a noisy reference, short for frequent slips.
        with_delay: also fit `delay_s`; else the nominal one is kept.
        on_step: told in a word what is being done, a few times.

    Raises:
        CalibrationError: a drive that leaves a parameter undetermined, too short a one, a reference of another body,
            of another time or of another drive.
    """
    segments = _segments(wheels, drive, reference, segment_m)
    problem = _Problem(drive, segments, wheels, with_delay)
    on_step("searching the delay")
    start = problem.coarse()
    on_step("fitting")
    values, scales, weights = _robust(problem, start)
    fitted, residuals = problem.fitted(values), problem.residuals(values)
    refuse_if_unlike(segments, residuals, drive, fitted.delay_s)
    covariance = _covariance(problem, values, scales)
    sigmas = problem.sigmas(values, covariance)
    refuse_if_unobservable(sigmas, fitted, segments)
    refuse_if_impossible(wheels, fitted, LARGEST_DELAY_S)
    slips = ((residuals / scales) ** 2).sum(axis=1) > _SLIP_CHI2
    ratio_sigma = _ratio_sigma(fitted, covariance)
    return WheelFit(wheels, fitted, sigmas, ratio_sigma, problem.mount(values), segments, residuals, weights, slips)


def _segments(wheels: Wheels, drive: Drive, reference: Trajectory, segment_m: float) -> Segments:
    """What the wheels have to explain, if there is enough of it."""
    if reference.body != "base":
        raise CalibrationError(
            f"the reference is of the {reference.body}, but wheels move the base", fix="give T_base_camera to join them"
        )
    segments = cut(drive, reference, wheels, segment_m, LARGEST_DELAY_S + abs(wheels.delay_s))
    if len(segments) < _FEWEST_SEGMENTS:
        raise CalibrationError(
            f"the drive holds {len(segments)} pieces of {segment_m:g} m or a radian with readings and reference, "
            f"{_FEWEST_SEGMENTS} are needed",
            fix="drive further, turning both ways, or choose a larger part of the recording",
        )
    return segments


def _ratio_sigma(fitted: Wheels, covariance: FloatArray) -> float:
    """Standard deviation of right radius over left, from the covariance (P, P) of what was sought."""
    difference = np.array([-1, 1]) @ covariance[:2, :2] @ np.array([-1, 1])
    return float(fitted.right_radius_m / fitted.left_radius_m * np.sqrt(difference))


class _Problem:
    """Residuals as a function of what is sought: logarithms of sizes over nominal, mount, change of delay."""

    def __init__(self, drive: Drive, segments: Segments, nominal: Wheels, with_delay: bool) -> None:
        self.drive, self.segments, self.nominal = drive, segments, nominal
        self.nominal_sizes = np.array([nominal.left_radius_m, nominal.right_radius_m, nominal.track_width_m])
        self.bounds = np.array([np.log(8.0)] * 3 + [3.0, 3.0, 1.5] + [2 * LARGEST_DELAY_S] * with_delay)
        self.with_delay = with_delay

    def sizes(self, values: FloatArray) -> FloatArray:
        return np.asarray(self.nominal_sizes * np.exp(values[:3]))

    def mount(self, values: FloatArray) -> FloatArray:
        return np.asarray(values[3:6])

    def delay_s(self, values: FloatArray) -> float:
        return self.nominal.delay_s + (float(values[6]) if self.with_delay else 0.0)

    def residuals(self, values: FloatArray) -> FloatArray:
        """(M, 3) in metres, metres, radians."""
        robot = (self.sizes(values), self.delay_s(values), self.mount(values))
        return self.segments.residuals(self.segments.predicted(self.drive, *robot))

    def coarse(self) -> FloatArray:
        """Nominal sizes with the delay for which wheel angles best go along with the reference, linearly."""
        values = np.zeros(len(self.bounds))
        if self.with_delay:
            steps = round(LARGEST_DELAY_S / _COARSE_STEP_S)
            delays_s = _COARSE_STEP_S * np.arange(-steps, steps + 1)
            values[6] = delays_s[np.argmin([self._linear_misfit(delay_s) for delay_s in delays_s])]
        return values

    def _linear_misfit(self, delay_s: float) -> float:
        """How badly any radii and track width explain chords and turns with this change of delay."""
        clock_s = self.nominal.delay_s + delay_s
        start, end = (self.drive.angles_at(s + clock_s) for s in (self.segments.start_s, self.segments.end_s))
        turned = np.stack([end[0] - start[0], end[1] - start[1]], axis=-1)
        yaw_rad = self.segments.motions[:, 2]
        along_m = chords_m(self.segments) / np.sinc(yaw_rad / (2 * np.pi))
        return sum(_misfit(turned, wanted) for wanted in (along_m, yaw_rad))

    def fitted(self, values: FloatArray) -> Wheels:
        left_m, right_m, track_m = (float(size) for size in self.sizes(values))
        return replace(
            self.nominal,
            left_radius_m=left_m,
            right_radius_m=right_m,
            track_width_m=track_m,
            delay_s=self.delay_s(values),
        )

    def sigmas(self, values: FloatArray, covariance: FloatArray) -> dict[str, float]:
        deviations = np.sqrt(np.diag(covariance))
        found = dict(zip(PARAMETERS, (self.sizes(values) * deviations[:3]).tolist(), strict=False))
        return found | ({"delay_s": float(deviations[6])} if self.with_delay else {})


def _misfit(regressors: FloatArray, wanted: FloatArray) -> float:
    """Logarithm of the mean squared residual of a linear fit, with slips cut off at three spreads."""
    off = wanted - regressors @ np.linalg.lstsq(regressors, wanted)[0]
    limit = 3 * max(float(_spread(off[:, None])[0]), 1e-9)
    return float(np.log(np.mean(np.minimum(off**2, limit**2)) + 1e-12))


def _robust(problem: _Problem, start: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Values (P,), scales of the residuals (3,) and weights (M,) of the segments."""
    values, scales, weights = start, _FIRST_SCALES, np.ones(len(problem.segments))
    for factor in _NARROWING:
        residuals = problem.residuals(values)
        if values is not start:
            scales = np.maximum(_spread(residuals), _LEAST_SCALES)
        weights = _weights(((residuals / (factor * scales)) ** 2).sum(axis=1))
        values = _solve(problem, values, scales, weights)
    return values, scales, weights


def _solve(problem: _Problem, start: FloatArray, scales: FloatArray, weights: FloatArray) -> FloatArray:
    from scipy.optimize import least_squares

    root = np.sqrt(weights)[:, None] / scales

    def misfit(values: FloatArray) -> FloatArray:
        prior = problem.mount(values) / _MOUNT_SIGMAS
        return np.concatenate([(root * problem.residuals(values)).ravel(), prior])

    bounds = problem.bounds
    within = start.clip(-0.99 * bounds, 0.99 * bounds)
    return np.asarray(least_squares(misfit, within, jac="3-point", bounds=(-bounds, bounds), x_scale=_STEP * bounds).x)


def _weights(chi2: FloatArray) -> FloatArray:
    """Geman and McClure's weights (M,) of squared residuals (M,) in units of their scale."""
    return (_SLIP_CHI2 / (_SLIP_CHI2 + chi2)) ** 2


def _spread(residuals: FloatArray) -> FloatArray:
    """Standard deviations (K,) of (M, K) by the median, which slips do not move."""
    return np.asarray(1.4826 * np.median(np.abs(residuals), axis=0))


def _covariance(problem: _Problem, values: FloatArray, scales: FloatArray) -> FloatArray:
    """Covariance (P, P): the robust cost's inverse Hessian on both sides of its gradient's spread (Huber 1967).

    The gradient is summed over runs of neighbouring segments, for neighbours share a pose and so that pose's error.
    What residuals of the least credible size would leave is added, so that data without noise hide no open direction.
    """
    r = problem.residuals(values) / scales
    J = _jacobian(problem, values) / scales[None, :, None]
    chi2 = (r**2).sum(axis=1)
    w = _weights(chi2)
    slope = -4 * _SLIP_CHI2**2 / (_SLIP_CHI2 + chi2) ** 3
    H = np.einsum("mip,m,miq->pq", J, w, J)
    along = np.einsum("mip,mi->mp", J, r)
    robust = H + np.einsum("mp,m,mq->pq", along, slope, along)
    known = np.diag(np.full(len(values), 1e-6))  # what nothing determines has a standard deviation of a thousand
    known[range(3, 6), range(3, 6)] = _MOUNT_SIGMAS**-2
    if np.linalg.eigvalsh(robust + known)[0] < 0.1 * np.linalg.eigvalsh(H + known)[0]:
        robust = H
    inverse = np.linalg.inv(robust + known)
    size = -(-len(r) // _MOST_CLUSTERS)
    gradients = np.add.reduceat(w[:, None] * along, np.arange(0, len(r), size))
    groups = len(gradients)
    spread = gradients.T @ gradients * groups / (groups - len(values))
    return np.asarray(inverse @ spread @ inverse + _floor(J, scales, known))


def _floor(J: FloatArray, scales: FloatArray, known: FloatArray) -> FloatArray:
    """The covariance (P, P) that residuals of the least credible size would leave."""
    whole = J * (scales / _LEAST_SCALES)[None, :, None]
    return np.asarray(np.linalg.inv(np.einsum("mip,miq->pq", whole, whole) + known))


def _jacobian(problem: _Problem, values: FloatArray) -> FloatArray:
    """Derivatives (M, 3, P) of the residuals, by central differences."""
    steps = 1e-6 * np.eye(len(values))
    columns = [(problem.residuals(values + h) - problem.residuals(values - h)) / 2e-6 for h in steps]
    return np.stack(columns, axis=-1)
