"""Wheels and errors before and after a calibration, as rows of text: for the page and for the terminal."""

from __future__ import annotations

from wheelsight.calibration import Wheels
from wheelsight.odometry.wheels.fit import WheelFit
from wheelsight.odometry.wheels.trial import WheelTrial
from wheelsight.odometry.wheels.umbmark import Umbmark
from wheelsight.pipeline import words

HEAD = ("", "nominal", "calibrated", "± σ", "change")
_LENGTHS = {"left_radius_m": "left radius", "right_radius_m": "right radius", "track_width_m": "track width"}


def fit_rows(fit: WheelFit) -> list[tuple[str, ...]]:
    """One row a parameter, as `HEAD` names the columns."""
    ratio_before, ratio_after = (w.right_radius_m / w.left_radius_m for w in (fit.nominal, fit.wheels))
    ratios = (f"{ratio_before:.5f}", f"{ratio_after:.5f}", f"{fit.ratio_sigma:.5f}")
    ratio = ("right over left", *ratios, _change(ratio_before, ratio_after))
    delay_ms = [f"{1e3 * wheels.delay_s:.1f} ms" for wheels in (fit.nominal, fit.wheels)]
    change_ms = 1e3 * (fit.wheels.delay_s - fit.nominal.delay_s)
    delay_sigma = f"{1e3 * fit.sigmas['delay_s']:.1f} ms" if "delay_s" in fit.sigmas else "kept"
    delay = ("delay", *delay_ms, delay_sigma, f"{change_ms:+.1f} ms")
    return [*_length_rows(fit.nominal, fit.wheels, fit.sigmas), ratio, delay]


def square_rows(result: Umbmark) -> list[tuple[str, ...]]:
    """The same for UMBmark, which tells of no size and no delay."""

    def row(name: str, value: float, sigma: float | None) -> tuple[str, ...]:
        return name, "1", f"{value:.5f}", "unknown" if sigma is None else f"{sigma:.5f}", _change(1.0, value)

    return [
        *_length_rows(result.nominal, result.wheels, {}),
        row("E_d, right over left", result.diameter_ratio, result.diameter_ratio_sigma),
        row("E_b, track factor", result.track_factor, result.track_factor_sigma),
    ]


def error_rows(trial: WheelTrial) -> list[tuple[str, ...]]:
    """Errors of nominal and of calibrated wheels on the part not calibrated on, one row each kind."""
    both = (trial.before, trial.after)
    found: list[tuple[str, str, list[float]]] = [
        ("ATE, position", "m", [x.evaluation.ate.translation.rmse for x in both])
    ]
    for name in ("second", "metre"):
        errors = [getattr(x.evaluation, f"rpe_per_{name}") for x in both]
        if None not in errors:
            found.append((f"RPE a {name}, position", "m", [e.translation.rmse for e in errors]))
            found.append((f"RPE a {name}, heading", "°", [e.rotation.in_degrees().rmse for e in errors]))
    found.append(("off at the end", "m", [x.end_error_m for x in both]))
    return [(head, *cells) for head, cells in (words.column(name, values, unit) for name, unit, values in found)]


def _length_rows(nominal: Wheels, wheels: Wheels, sigmas: dict[str, float]) -> list[tuple[str, ...]]:
    rows: list[tuple[str, ...]] = []
    for field, name in _LENGTHS.items():
        before, after = float(getattr(nominal, field)), float(getattr(wheels, field))
        sigma = f"{1e3 * sigmas[field]:.2f} mm" if field in sigmas else ""
        rows.append((name, f"{1e3 * before:.2f} mm", f"{1e3 * after:.2f} mm", sigma, _change(before, after)))
    return rows


def _change(before: float, after: float) -> str:
    return f"{100 * (after / before - 1):+.2f} %"
