"""The page of a wheel calibration: changes, uncertainty, and the error on the part of the drive that the fit did not
use.
"""

from __future__ import annotations

import numpy as np

from wheelsight.app.run import words
from wheelsight.core.calibration_parts import Wheels
from wheelsight.core.files import StrPath
from wheelsight.core.geometry import FloatArray
from wheelsight_calibration.residuals import ResidualPanel, residual_panels
from wheelsight_calibration.squares import Umbmark
from wheelsight_calibration.wheels import WheelFit, WheelTrial
from wheelsight_report import drawing, html
from wheelsight_report import plotly as go
from wheelsight_report.drawing import BLUE, GREY, ORANGE, SKY, VERMILLION, keep_shape

_BETTER, _WORSE = 0.9, 1.1
_FOOTER = "Lengths are in metres, stamps in seconds, σ is one standard deviation. This page needs no network."


def write_wheel_page(trial: WheelTrial, path: StrPath) -> None:
    """Write the page about a calibration against a reference, atomically. Raises OutputError."""
    before, after = trial.before.evaluation, trial.after.evaluation
    old, new = before.rpe_per_metre, after.rpe_per_metre
    # Error after over error before: of the whole path, and of a metre of it
    path_ratio = drift_ratio = after.ate.translation.rmse / max(before.ate.translation.rmse, 1e-9)
    if old is not None and new is not None:
        drift_ratio = new.translation.rmse / max(old.translation.rmse, 1e-9)
    if path_ratio < _BETTER and drift_ratio < _WORSE:
        phrase, tone = f"{1 / path_ratio:.1f} times nearer to the reference where it was not fitted", "green"
    elif path_ratio > _WORSE and drift_ratio > _BETTER:
        phrase, tone = "No better than the nominal wheels where it was not fitted", "red"
    else:
        phrase, tone = "Little changes where it was not fitted", "amber"
    ate = (words.length(evaluation.ate.translation.rmse) for evaluation in (after, before))
    length = words.length(trial.held_out.length_m)
    sentence = "Over the {} that the fit did not see, the path's error (ATE) is {} after {}".format(length, *ate)
    if old is not None and new is not None:
        turns = (words.angle(error.rotation.in_degrees().rmse) for error in (new, old))
        sentence += ", and heading drifts by {} a metre after {}".format(*turns)
    x_m, y_m, yaw_rad = trial.fit.mount.tolist()
    ahead, aside, turned = ("ahead", "behind")[x_m < 0], ("left", "right")[y_m < 0], ("left", "right")[yaw_rad < 0]
    mount = (
        f"By the fit, what the reference follows sits {words.length(abs(x_m))} {ahead} and {words.length(abs(y_m))} "
        f"{aside} of the axle's middle and looks {words.angle(abs(np.degrees(yaw_rad)))} to the {turned}; "
        "the comparison allows for that."
    )
    plot = html.plot(
        "residuals",
        residual_figure(trial),
        "Residuals",
        "Wheels minus reference over each segment; slips, or jumps of the reference, may lie at the edge.",
        "Residuals of the segments over time, along, across and in turn",
    )
    residuals = html.section("segments", "On the part it was fitted to", "", plot)
    fit = trial.fit
    tiles = [_tile("ATE, RMSE", before.ate.translation.rmse, after.ate.translation.rmse)]
    if old is not None and new is not None:
        tiles.append(_tile("RPE a metre, RMSE", old.translation.rmse, new.translation.rmse))
    slips = words.count(int(fit.is_slip.sum()), "of them a slip or jump", "of them slips or jumps")
    along, turn_text = fit.spread[0], words.angle(float(np.degrees(fit.spread[2])))
    page = html.page(
        kicker="wheelsight wheel calibration",
        title=trial.recording,
        facts=html.facts_now("least squares against a reference trajectory"),
        tone=tone,
        phrase=phrase,
        sentences=[f"{sentence}."],
        tiles=[
            *tiles,
            _tile("Off at the end", trial.before.end_error_m, trial.after.end_error_m),
            ("Segments fitted", str(len(fit.segments)), slips),
            ("Left in a segment", words.length(float(along)), f"and {turn_text}; median spread"),
        ],
        notes=[*trial.warnings, mount, "All errors hold the reference's own, and those of slips."],
        sections=(_wheels_section(fit_rows(trial.fit)), _proof(trial), residuals),
        footer=_FOOTER,
    )
    html.save(page, path)


def write_squares_page(result: Umbmark, after_m: tuple[FloatArray, FloatArray], name: str, path: StrPath) -> None:
    """Write the page about a calibration by squares, atomically. Raises OutputError.

    `after_m` are the errors (n, 2) and (m, 2) that corrected wheels leave of clockwise and counter-clockwise runs.
    """
    before_m, left_m = result.largest_error_m, result.largest_error_after_m
    runs = f"{len(result.clockwise_m)} clockwise and {len(result.counter_clockwise_m)} counter-clockwise"
    tiles = [
        ("E max,syst, nominal", words.length(before_m), "the worse direction's mean error"),
        ("E max,syst, corrected", words.length(left_m), "that the model leaves of these runs"),
        ("E_d", f"{result.diameter_ratio:.5f}", "right wheel over left wheel"),
        ("E_b", f"{result.track_factor:.5f}", "actual track width over nominal"),
    ]
    figure = squares_figure(result, after_m)
    sentence = "Where each run truly ended, seen from where the robot believed to be; crosses are the means."
    alt = "Return position errors before and after correction"
    plot = html.plot("squares", figure, "Return position errors", sentence, alt)
    page = html.page(
        kicker="wheelsight wheel calibration",
        title=name,
        facts=html.facts_now("UMBmark, Borenstein & Feng 1996"),
        tone="green" if left_m < _BETTER * before_m else "amber",
        phrase=f"Systematic error {words.length(before_m)} before, {words.length(left_m)} after",
        sentences=[f"From {runs} squares of {result.side_m:.3g} m. The mean wheel radius cannot be seen from it."],
        tiles=tiles,
        sections=(_wheels_section(square_rows(result)), html.section("runs", "The runs", "", plot)),
        footer=_FOOTER,
    )
    html.save(page, path)


def _tile(name: str, before: float, after: float) -> tuple[str, str, str]:
    return name, words.length(after), f"nominal wheels {words.length(before)}"


def _wheels_section(rows: list[tuple[str, ...]]) -> str:
    return html.section("wheels", "The wheels", "", html.table("Before and after", HEAD, rows))


def _proof(trial: WheelTrial) -> str:
    before_s = trial.split_s - trial.reference.stamps_s[0]
    intro = f"Fitted on the {words.duration(float(before_s))} before; what follows was not used."
    errors = html.table("Errors against the reference, RMSE", ("", "nominal", "calibrated"), error_rows(trial))
    drive = html.plot(
        "drive",
        drive_figure(trial),
        "From above",
        "Both paths begin on the reference; nothing corrects them afterwards.",
        "Reference path with the dead-reckoned paths of nominal and calibrated wheels",
    )
    drift = html.plot(
        "drift",
        drift_figure(trial),
        "Drift",
        "How far each path is from the reference as the robot drives on.",
        "Distance from the reference over distance gone",
    )
    return html.section("proof", "On the part it did not use", intro, errors, drive, drift)


_LOOKS = {"nominal": {"color": ORANGE, "width": 2}, "calibrated": {"color": BLUE, "width": 2}}
_PANELS = (("along the way", "mm", 1e3), ("across", "mm", 1e3), ("turn", "°", 180 / np.pi))


def drive_figure(trial: WheelTrial) -> go.Figure:
    """The test part of the drive from above, metres: reference, nominal and calibrated wheels from one start."""
    figure = drawing.map_figure(520)
    paths = {"nominal": trial.before.path, "calibrated": trial.after.path}
    hover = "x %{x:.2f}, y %{y:.2f} m"
    truth = trial.held_out.positions_m[:, :2]
    drawing.add_path(figure, truth[keep_shape(truth)], name="reference", line={"color": GREY, "width": 5}, hover=hover)
    for name, path in paths.items():
        points = path.positions_m[:, :2]
        drawing.add_path(figure, points[keep_shape(points)], name=name, line=_LOOKS[name], hover=hover)
    _mark(figure, truth[:1], "start", GREY, "circle-open")
    for name, path in paths.items():
        _mark(figure, path.positions_m[-1:, :2], "", str(_LOOKS[name]["color"]), "square")
    _mark(figure, truth[-1:], "end", GREY, "square")
    return figure


def drift_figure(trial: WheelTrial) -> go.Figure:
    """Distance from the reference over travelled distance, from the start of the test part, metres."""
    figure = drawing.style(go.Figure(), 300, hovermode="x unified")
    gone_m = trial.held_out.distances_m
    for name, attempt in (("nominal", trial.before), ("calibrated", trial.after)):
        off_m = np.linalg.norm(attempt.path.positions_m - trial.held_out.positions_m, axis=1)
        drawing.add_line(figure, gone_m, off_m, name=name, line=_LOOKS[name], hover="%{y:.3f} m")
    figure.update_yaxes(rangemode="tozero")
    figure.update_xaxes(title_text="metres gone since both were laid upon the reference", hoverformat=".1f")
    drawing.panel_title(figure, "distance from the reference, m")
    return figure


def residual_figure(trial: WheelTrial) -> go.Figure:
    """Residuals of the calibrated wheels for each fitted segment; slips stand out."""
    fit = trial.fit
    panels = []
    for (name, unit, factor), residuals, spread in zip(_PANELS, fit.residuals.T, fit.spread, strict=True):
        values = factor * residuals
        largest = float(np.abs(values[~fit.is_slip]).max(initial=0.0))
        panels.append(ResidualPanel(name, unit, values, max(1.1 * largest, 5 * factor * spread, 1e-3)))
    middle_s = (fit.segments.start_s + fit.segments.end_s) / 2 - trial.reference.stamps_s[0]
    kinds = ("segment", "slip or jump, hardly counted")
    return residual_panels(middle_s, panels, fit.is_slip, kinds, "seconds since the reference begins")


def squares_figure(result: Umbmark, after_m: tuple[FloatArray, FloatArray]) -> go.Figure:
    """Return position errors of all runs, before and after, metres: the figure of Borenstein & Feng.

    `after_m` are the errors (n, 2) and (m, 2) that corrected wheels leave of clockwise and counter-clockwise runs.
    """
    figure = drawing.map_figure(520, ("x, true minus computed, m", "y, true minus computed, m"), left=78)
    given = (
        ("clockwise", result.clockwise_m, after_m[0]),
        ("counter-clockwise", result.counter_clockwise_m, after_m[1]),
    )
    for (direction, before, after), color, late in zip(given, (ORANGE, VERMILLION), (SKY, BLUE), strict=True):
        for name, errors, shade, symbol in (
            (f"{direction}, nominal", before, color, "circle"),
            (f"{direction}, corrected", after, late, "diamond"),
        ):
            figure.add_scatter(
                x=errors[:, 0],
                y=errors[:, 1],
                mode="markers",
                name=name,
                marker={
                    "size": 9,
                    "color": shade,
                    "symbol": symbol,
                    "line": {"width": 1, "color": "rgba(255,255,255,.7)"},
                },
                hovertemplate=f"{name}: x %{{x:.3f}}, y %{{y:.3f}} m<extra></extra>",
            )
            _mark(figure, errors.mean(axis=0)[None], "", shade, "cross-thin-open", 18)
    figure.add_hline(y=0, line=drawing.DASHED)
    figure.add_vline(x=0, line=drawing.DASHED)
    return figure


def _mark(figure: go.Figure, point: FloatArray, word: str, color: str, symbol: str, size: int = 11) -> None:
    figure.add_scatter(
        x=point[:, 0],
        y=point[:, 1],
        mode="markers+text",
        text=[word],
        textposition="top center",
        marker={"symbol": symbol, "size": size, "color": color, "line": {"width": 3 if "open" in symbol else 0}},
        showlegend=False,
        hoverinfo="skip",
    )


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
    """The same for UMBmark, which gives no wheel size and no delay."""

    def row(name: str, value: float, sigma: float | None) -> tuple[str, ...]:
        return name, "1", f"{value:.5f}", "unknown" if sigma is None else f"{sigma:.5f}", _change(1.0, value)

    return [
        *_length_rows(result.nominal, result.wheels, {}),
        row("E_d, right over left", result.diameter_ratio, result.diameter_ratio_sigma),
        row("E_b, track factor", result.track_factor, result.track_factor_sigma),
    ]


def error_rows(trial: WheelTrial) -> list[tuple[str, ...]]:
    """Errors of nominal and of calibrated wheels on the test part, one row each kind."""
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
