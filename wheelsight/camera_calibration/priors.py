"""What is known of the parameters beforehand, as rows of a least squares."""

from __future__ import annotations

import numpy as np

from wheelsight.camera_calibration.model import BARE_LENS, BEFORE_KNOTS, Model, lens_parameters
from wheelsight.geometry import FloatArray, PinholeCamera

_HELD = 1e-6  # of what is not sought
_OF_FADE = 0.5  # of Herrera et al.'s: exp(-0.0018 d) is exp(0.6 m / z)


def prior_rows(model: Model) -> tuple[FloatArray, FloatArray]:
    """What is known beforehand, as rows (P, n) and values (P,) in σ: rows @ x is about the values."""
    priors = _Priors(model.slices()["poses"].stop)
    at = model.slices()
    if model.keeps_color:
        _held(priors, at["color"], model.color_start)
    else:
        _of_lens(priors, model, at["color"], model.color_start)
    _of_lens(priors, model, at["depth"], model.depth_start, is_nominal=not len(model.infrared.px))
    for k in range(at["apart"].start, min(at["apart"].start + 3, at["apart"].stop)):
        priors.add([k], [1], 0.0, model.settings.prior.apart_m)
    if at["error"].stop > at["error"].start:
        _of_error(priors, model, at["error"].start)
    return np.array(priors.rows).reshape(-1, priors.size), np.array(priors.values)


class _Priors:
    """Rows and values, one by one."""

    def __init__(self, size: int) -> None:
        self.size = size
        self.rows: list[FloatArray] = []
        self.values: list[float] = []

    def add(self, columns: list[int], weights: list[float], value: float, sigma: float) -> None:
        """A weighted sum of parameters that is about a value, to a σ."""
        row = np.zeros(self.size)
        row[columns] = np.array(weights) / sigma
        self.rows.append(row)
        self.values.append(value / sigma)


def _held(priors: _Priors, place: slice, start: PinholeCamera) -> None:
    """A lens that stays as it is."""
    for k, value in enumerate(lens_parameters(start, start)):
        priors.add([place.start + k], [1], float(value), _HELD)


def _of_lens(priors: _Priors, model: Model, place: slice, start: PinholeCamera, *, is_nominal: bool = False) -> None:
    """What is known of a lens: of lenses as such, and of one without corners of its own, `is_nominal`, by `start`."""
    first, length, prior = place.start, place.stop - place.start, model.settings.prior
    if not length:
        return
    known = lens_parameters(start, start)
    if is_nominal:
        priors.add([first], [1], 0.0, prior.depth_focal)
    priors.add([first + 1], [1], float(np.log(start.fy / start.fx)), prior.aspect)
    centre = (1.0 if is_nominal else 2.0) * prior.depth_centre_px * start.width / 640 / start.fx
    for k in (2, 3):
        priors.add([first + k], [1], float(known[k]), centre)
    bent = [*prior.radial[:2], prior.tangential, prior.tangential, prior.radial[2]]
    for k in range(BARE_LENS, length):
        priors.add([first + k], [1], float(known[k]) if is_nominal else 0.0, bent[k - BARE_LENS])


def _of_error(priors: _Priors, model: Model, first: int) -> None:
    prior, knots = model.settings.prior, first + BEFORE_KNOTS
    if not model.is_scale_free:
        priors.add([first], [1], 0.0, _HELD)
    if model.sensor == "tof":
        priors.add([first], [1], 0.0, prior.tof_scale)
        for k in range(len(model.knots_m)):
            priors.add([knots + k], [1], 0.0, prior.curve_m)
        for k in range(len(model.knots_m) - 2):
            priors.add([knots + k, knots + k + 1, knots + k + 2], [1, -2, 1], 0.0, prior.curve_bend_m)
    if not model.has_pattern:
        return
    priors.add([first + 2], [1], _OF_FADE, prior.fade_m)
    rows, columns = model.grid
    for number in knots + np.arange(2 * rows * columns).reshape(2, rows, columns):
        for knot in number.ravel().tolist():
            priors.add([knot], [1], 0.0, prior.pattern_per_m)
        for line in [*number.tolist(), *number.T.tolist()]:
            for three in zip(line, line[1:], line[2:], strict=False):
                priors.add(list(three), [1, -2, 1], 0.0, prior.pattern_bend_per_m)
