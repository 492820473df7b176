"""Figures of a wheel calibration: the path before and after, its error, and what each segment left unexplained."""

from __future__ import annotations

import numpy as np

from wheelsight.geometry import FloatArray
from wheelsight.odometry.wheels.trial import WheelTrial
from wheelsight.odometry.wheels.umbmark import Umbmark
from wheelsight.report import _drawing as drawing
from wheelsight.report import _plotly as go
from wheelsight.report import _series as series
from wheelsight.report._drawing import BLUE, GREY, ORANGE, SKY, VERMILLION
from wheelsight.report._plotly import make_subplots

_LOOKS = {"nominal": {"color": ORANGE, "width": 2}, "calibrated": {"color": BLUE, "width": 2}}
_PANELS = (("along the way", "mm", 1e3), ("across", "mm", 1e3), ("turn", "°", 180 / np.pi))


def drive_figure(trial: WheelTrial) -> go.Figure:
    """The part not calibrated on, from above, metres: reference, nominal wheels and calibrated ones from one start."""
    figure = drawing.style(go.Figure(), 520, hovermode="closest", margin={"l": 58, "r": 12, "t": 34, "b": 46})
    paths = {"nominal": trial.before.path, "calibrated": trial.after.path}
    hover = "x %{x:.2f}, y %{y:.2f} m"
    truth = trial.held_out.positions_m[:, :2]
    drawing.add_path(
        figure, truth[series.keep_shape(truth)], name="reference", line={"color": GREY, "width": 5}, hover=hover
    )
    for name, path in paths.items():
        points = path.positions_m[:, :2]
        drawing.add_path(figure, points[series.keep_shape(points)], name=name, line=_LOOKS[name], hover=hover)
    _mark(figure, truth[:1], "start", GREY, "circle-open")
    for name, path in paths.items():
        _mark(figure, path.positions_m[-1:, :2], "", str(_LOOKS[name]["color"]), "square")
    _mark(figure, truth[-1:], "end", GREY, "square")
    figure.update_xaxes(title_text="x, m")
    figure.update_yaxes(title_text="y, m", scaleanchor="x", scaleratio=1)
    return figure


def drift_figure(trial: WheelTrial) -> go.Figure:
    """Distance from the reference since the start of the part not calibrated on, metres over distance gone."""
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
    """What the calibrated wheels leave of each segment they were fitted to; slips stand out."""
    fit = trial.fit
    middle_s = (fit.segments.start_s + fit.segments.end_s) / 2 - trial.reference.stamps_s[0]
    figure = make_subplots(rows=3, cols=1, shared_xaxes=True, vertical_spacing=0.1)
    drawing.style(figure, 520, hovermode="closest", margin_l=88)
    for row, (name, unit, factor) in enumerate(_PANELS, start=1):
        values = factor * fit.residuals[:, row - 1]
        limit = _limit(values[~fit.is_slip], factor * fit.spread[row - 1])
        for kind, which, color, symbol in (
            ("segment", ~fit.is_slip, BLUE, "circle"),
            ("slip or jump, hardly counted", fit.is_slip, VERMILLION, "x"),
        ):
            figure.add_scatter(
                x=middle_s[which],
                y=values[which].clip(-limit, limit),
                customdata=values[which],
                mode="markers",
                marker={"size": 7, "color": color, "symbol": symbol},
                name=kind,
                legendgroup=kind,
                showlegend=row == 1 and bool(which.any()),
                hovertemplate=f"%{{x:.1f}} s: %{{customdata:.1f}} {unit}<extra>{kind}</extra>",
                row=row,
                col=1,
            )
        figure.update_yaxes(range=[-1.08 * limit, 1.08 * limit], row=row, col=1)
        axis = figure.layout[f"yaxis{row if row > 1 else ''}"]
        drawing.panel_title(figure, f"{name}, {unit}", y=axis.domain[1])
        figure.add_hline(y=0, line=drawing.DASHED, row=row, col=1)
    figure.update_xaxes(title_text="seconds since the reference begins", row=3, col=1)
    return figure


def squares_figure(result: Umbmark, after_m: tuple[FloatArray, FloatArray]) -> go.Figure:
    """Return position errors of all runs, before and after, metres: the figure of Borenstein & Feng.

    `after_m` are the errors (n, 2) and (m, 2) that corrected wheels leave of clockwise and counter-clockwise runs.
    """
    figure = drawing.style(go.Figure(), 520, hovermode="closest", margin={"l": 78, "r": 12, "t": 34, "b": 46})
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
    figure.update_xaxes(title_text="x, true minus computed, m")
    figure.update_yaxes(title_text="y, true minus computed, m", scaleanchor="x", scaleratio=1)
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


def _limit(values: FloatArray, spread: float) -> float:
    """Up to where residuals are drawn: all that are no slips, and five spreads at least; slips lie at the edge."""
    largest = float(np.abs(values).max()) if len(values) else 0.0
    return max(1.1 * largest, 5 * spread, 1e-3)
