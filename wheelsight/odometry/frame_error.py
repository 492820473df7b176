"""What a frame's pose is off by beyond the noise of its pixels: what all of them share does not average out."""

from __future__ import annotations

import numpy as np

from wheelsight.calibration import Calibration
from wheelsight.geometry import FloatArray, se3


def frame_covariance(calibration: Calibration) -> FloatArray:
    """Covariance (6, 6) of (v, ω) in the camera's own frame, of what all pixels of a frame share."""
    return np.diag(np.square([*[calibration.frame_sigma_m] * 3, *[calibration.frame_sigma_rad] * 3]))


def with_frame_error(covariance: FloatArray, T_reference_frame: FloatArray, of_frame: FloatArray) -> FloatArray:
    """Covariance (6, 6) of a pose's (4, 4) left perturbation, with what is off about the frame (6, 6) itself."""
    Ad = se3.adjoint(T_reference_frame)
    return np.asarray(covariance + Ad @ of_frame @ Ad.T)
