"""fit_wheels: both radii, track width and clock delay by least squares against a reference trajectory.

The reference, ground truth or visual odometry, is cut into short pieces. What the wheels make of each is compared with
what the reference says, along and across the way and in yaw, and wheel sizes and delay are sought for which the
differences are least. The body that the reference follows, a marker or a camera, may sit off the middle of the axle and
look a little aside: its mount is fitted along with the rest. Pieces where a wheel slipped or the reference jumped lose
their weight (see `odometry._robust_fit`).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from wheelsight.calibration import Wheels
from wheelsight.errors import CalibrationError
from wheelsight.geometry import BoolArray, FloatArray
from wheelsight.odometry._robust_fit import UNKNOWN_SIGMA, robust_fit, spread
from wheelsight.odometry.wheels._observability import (
    chords_m,
    refuse_if_impossible,
    refuse_if_unlike,
    refuse_if_unobservable,
)
from wheelsight.odometry.wheels.drive import Drive
from wheelsight.odometry.wheels.reference_errors import covariance_by
from wheelsight.odometry.wheels.segments import Segments, cut
from wheelsight.odometry.wheels.sureness import stated
from wheelsight.trajectory import Trajectory

PARAMETERS = ("left_radius_m", "right_radius_m", "track_width_m", "delay_s")
LARGEST_DELAY_S = 0.5

_FEWEST_SEGMENTS = 12
_COARSE_STEP_S = 0.02
_MOUNT_SIGMAS = np.array([0.5, 0.5, 0.3])  # how far off a mount may well be; holds what a straight drive leaves open


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
        return spread(self.residuals)


def fit_wheels(
    wheels: Wheels,
    drive: Drive,
    reference: Trajectory,
    *,
    segment_m: float = 1.0,
    with_delay: bool = True,
    on_step: Callable[[str], None] = lambda _: None,
    camera_errors: FloatArray | None = None,
) -> WheelFit:
    """Wheels that explain `reference`, with standard deviations, or a refusal that says what drive would do.

    Args:
        wheels: nominal ones: radii and track width right to a factor of two, delay to half a second.
        drive: the readings of both wheels.
        reference: T_odom_base, right to decimetres and degrees (of the camera: `recordings.bodies.express_for`).
        segment_m: way between two poses that are compared: long for a noisy reference, short for frequent slips.
        with_delay: also fit `delay_s`; else the nominal one is kept.
        on_step: told in a word what is being done.
        camera_errors: (K, 3, 3) of the base, of a reference by a camera (`camera_errors.motion_errors`); σ holds them.

    Raises:
        CalibrationError: too short a drive, one that determines not all, a reference of another body, time or drive.
    """
    segments = _segments(wheels, drive, reference, segment_m)
    problem = _Problem(drive, segments, wheels, with_delay)
    on_step("searching the delay")
    start = problem.coarse()
    on_step("fitting")
    found = robust_fit(problem, start)
    values, fitted = found.values, problem.fitted(found.values)
    refuse_if_unlike(segments, found.residuals, drive, fitted.delay_s)
    refuse_if_unobservable(problem.sigmas(values, found.covariance), fitted, segments)
    refuse_if_impossible(wheels, fitted, LARGEST_DELAY_S)
    covariance = found.covariance + (0 if camera_errors is None else covariance_by(problem, found, camera_errors))
    sigmas, ratio_sigma = problem.sigmas(values, covariance), _ratio_sigma(fitted, covariance)
    known = stated(fitted, ratio_sigma, sigmas["track_width_m"] / fitted.track_width_m, _scale_sigma(covariance))
    explained = (found.residuals, found.weights, found.is_outlier)
    return WheelFit(wheels, known, sigmas, ratio_sigma, problem.mount(values), segments, *explained)


def _scale_sigma(covariance: FloatArray) -> float:
    """Of half the sum of both radii's logarithms: as a share, what both have in common adds up."""
    return float(np.sqrt(covariance[:2, :2].sum()) / 2)


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
        self.prior_sigmas = np.full(len(self.bounds), UNKNOWN_SIGMA)
        self.prior_sigmas[3:6] = _MOUNT_SIGMAS
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
    limit = 3 * max(float(spread(off[:, None])[0]), 1e-9)
    return float(np.log(np.mean(np.minimum(off**2, limit**2)) + 1e-12))
