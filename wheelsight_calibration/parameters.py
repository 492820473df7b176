"""The parameters that drives calibrate, with bounds and priors, and their residuals.

`solver` fits them. A further parameter is a row here and its effect in `DriveProblem.residuals`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from wheelsight.core.calibration_parts import Wheels
from wheelsight.core.geometry import FloatArray
from wheelsight_calibration.motion_errors import with_error
from wheelsight_calibration.solver import UNKNOWN_SIGMA, RobustFit, response
from wheelsight_calibration.wheel_drive import Segments, WheelDrive, sizes_m

LARGEST_DELAY_S = 0.5  # between the clocks, that a fit finds; chosen


class Parameter(NamedTuple):
    """A parameter: its largest absolute value, and the standard deviation of its prior, which is 0.

    Sizes are logarithms over nominal ones; mount and delay are changes of initial values.
    """

    name: str
    bound: float
    prior_sigma: float = UNKNOWN_SIGMA


# Wheels by a reference. The priors of the mount are for drives that do not determine it.
WHEELS_BY_REFERENCE = (
    Parameter("left_radius", np.log(8.0)),
    Parameter("right_radius", np.log(8.0)),
    Parameter("track_width", np.log(8.0)),
    Parameter("x_m", 3.0, 0.5),
    Parameter("y_m", 3.0, 0.5),
    Parameter("yaw_rad", 1.5, 0.3),
    Parameter("delay_s", 2 * LARGEST_DELAY_S),
)
# The mount of a camera. No robot exceeds the bounds. Slide is how far tyres creep outwards in bends: the outward speed
# over the inward acceleration; its prior is chosen.
MOUNT_BY_DRIVE = (
    Parameter("left_radius", np.log(2.0)),
    Parameter("right_radius", np.log(2.0)),
    Parameter("track_width", np.log(2.0)),
    Parameter("x_m", 3.0),
    Parameter("y_m", 3.0),
    Parameter("yaw_rad", 1.0),
    Parameter("delay_s", 2 * LARGEST_DELAY_S),
    Parameter("slide_s", 0.2, 0.02),
)


class DriveProblem:
    """Residuals of the pieces of a drive by these parameters, a `solver.Problem`.

    Args:
        parameters: the first six or more of a list above.
        drive: the wheels' readings.
        segments: motions of the reference or the camera.
        wheels: nominal ones.
        delay_s, mount: initial delay and mount (3,), x, y and yaw.
        sideways: (M,) outward motion of each piece for a slide of 1 s, complex, in the axes of the base.
    """

    def __init__(
        self,
        parameters: Sequence[Parameter],
        drive: WheelDrive,
        segments: Segments,
        wheels: Wheels,
        delay_s: float,
        mount: FloatArray,
        sideways: np.ndarray | None = None,
    ) -> None:
        self.drive, self.segments, self.nominal, self.sideways = drive, segments, wheels, sideways
        self.start_delay_s, self.start_mount = delay_s, mount
        self.bounds = np.array([parameter.bound for parameter in parameters])
        self.prior_sigmas = np.array([parameter.prior_sigma for parameter in parameters])

    def sizes_m(self, values: FloatArray) -> FloatArray:
        """Left radius, right radius and track width (3,)."""
        return np.asarray(sizes_m(self.nominal) * np.exp(values[:3]))

    def mount(self, values: FloatArray) -> FloatArray:
        """X, y, yaw (3,)."""
        return np.asarray(self.start_mount + values[3:6])

    def delay_s(self, values: FloatArray) -> float:
        """The delay of the wheels' stamps."""
        return self.start_delay_s + (float(values[6]) if len(values) > 6 else 0.0)

    def fitted(self, values: FloatArray) -> Wheels:
        """The wheels with these sizes and this delay."""
        left_m, right_m, track_m = self.sizes_m(values).tolist()
        sizes = {"left_radius_m": left_m, "right_radius_m": right_m, "track_width_m": track_m}
        return replace(self.nominal, **sizes, delay_s=self.delay_s(values))

    def residuals(self, values: FloatArray) -> FloatArray:
        """(M, 3) in metres, metres, radians."""
        mount = self.mount(values)
        motions = self.segments.predicted(self.drive, self.sizes_m(values), self.delay_s(values), mount)
        if self.sideways is not None:
            slid = values[7] * self.sideways * np.exp(-1j * mount[2])
            motions[:, :2] += np.stack([slid.real, slid.imag], axis=-1)
        return self.segments.residuals(motions)

    def covariance_by(self, found: RobustFit, errors: FloatArray) -> FloatArray:
        """Covariance (P, P) of the fitted values by independent errors (K, 3, 3) of the motions, of one σ each.

        Errors are as in `motion_errors`.
        """
        segments, moved = self.segments, []
        for error in errors:
            self.segments = replace(segments, motions=with_error(segments.motions, error))
            moved.append(self.residuals(found.values) - found.residuals)
        self.segments = segments
        shifts = response(self, found, np.reshape(moved, (-1, *found.residuals.shape)))
        return np.asarray(shifts.T @ shifts)


# σ of changes of tyres from day to day, which a fit does not show. Computed: two kilograms more on one side compress
# its tyre by 0.06 % of the radius, a milliradian per metre for wheels half a metre apart. Air pressure and temperature
# have similar effects on both; the point of contact within the width of a tyre changes the track width.
DAILY_SCALE, DAILY_DRIFT_RAD_PER_M, DAILY_TURN = 0.003, 0.001, 0.003


def stated(wheels: Wheels, ratio_sigma: float, track_share: float, scale_share: float | None = None) -> Wheels:
    """Return wheels with standard deviations.

    Args:
        wheels: as fitted.
        ratio_sigma: standard deviation of right radius over left.
        track_share: of the track width, relative.
        scale_share: of the mean radius, relative; None to keep that of `wheels`.
    """
    scale = wheels.scale_sigma if scale_share is None else float(np.hypot(scale_share, DAILY_SCALE))
    drift = float(np.hypot(ratio_sigma / wheels.track_width_m, DAILY_DRIFT_RAD_PER_M))
    turn = float(np.hypot(track_share, DAILY_TURN))
    return replace(
        wheels, scale_sigma=min(scale, 1.0), drift_sigma_rad_per_m=min(drift, 1.0), turn_sigma=min(turn, 1.0)
    )
