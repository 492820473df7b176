"""Figures of a model of places on trial: what it takes for what, how sure it is, and its answers along time."""

from __future__ import annotations

import numpy as np
import plotly.graph_objects as go

from wheelsight.places import PlaceTrial
from wheelsight.report import _drawing as drawing
from wheelsight.report._drawing import BLUE, GREY, VERMILLION

_CELL_PX, _LEAST_PX = 52, 320
_INK_FROM = 0.5  # share of a row from which its cell is dark enough for white figures
_BLUES = [[0, "rgba(0,114,178,0.04)"], [1, "rgba(0,114,178,1)"]]


def confusion_figure(trial: PlaceTrial) -> go.Figure:
    """True areas in rows, most probable areas in columns; colour is the share of the row, figures are frames."""
    counts = trial.confusion
    columns = list(trial.area_names)
    if counts[:, -1].any():
        columns.append("no depth")
    else:
        counts = counts[:, :-1]
    shares = counts / np.maximum(counts.sum(axis=1, keepdims=True), 1)
    height = max(_LEAST_PX, _CELL_PX * len(counts) + 100)
    figure = drawing.style(go.Figure(), height, margin={"l": 96, "r": 14, "t": 34, "b": 56})
    x, y = [f" {name}" for name in columns], [f" {name}" for name in trial.area_names]
    hover = "true%{y}, taken for%{x}: %{customdata} frames, %{z:.1%} of the area<extra></extra>"
    figure.add_heatmap(
        z=shares, x=x, y=y, customdata=counts, colorscale=_BLUES, zmin=0, zmax=1, showscale=False, xgap=2, ygap=2,
        hovertemplate=hover,
    )  # fmt: skip
    for row, column in zip(*np.nonzero(counts), strict=True):
        is_dark = shares[row, column] >= _INK_FROM
        figure.add_annotation(
            x=x[column],
            y=y[row],
            text=f"<b>{counts[row, column]}</b>" if is_dark else str(counts[row, column]),
            showarrow=False,
            font={"size": 13, **({"color": "#ffffff"} if is_dark else {})},
        )
    figure.update_xaxes(title_text="most probable area", type="category", showgrid=False, constrain="domain")
    figure.update_yaxes(
        title_text="true area", type="category", autorange="reversed", showgrid=False, title_standoff=10
    )
    return figure


def reliability_figure(trial: PlaceTrial) -> go.Figure:
    """How often answers are right over how sure they are; the diagonal is what they promise."""
    curve = trial.curve
    figure = drawing.style(go.Figure(), 380, hovermode="closest", margin={"l": 58, "r": 14, "t": 34, "b": 56})
    line = {"color": GREY, "width": 1.5, "dash": "dash"}
    figure.add_scatter(x=[0, 1], y=[0, 1], mode="lines", line=line, name="as promised", hoverinfo="skip")
    sizes = 7 + 27 * np.sqrt(curve.count / curve.count.max())
    figure.add_scatter(
        x=curve.confidence,
        y=curve.accuracy,
        customdata=curve.count,
        mode="lines+markers",
        line={"color": BLUE, "width": 2},
        marker={"size": sizes, "color": BLUE, "opacity": 0.75, "line": {"width": 1, "color": "#ffffff"}},
        name="the model; larger: more frames",
        hovertemplate="says %{x:.1%}, is right %{y:.1%} of %{customdata} frames<extra></extra>",
    )
    figure.update_xaxes(title_text="probability of the most probable area", range=[-0.04, 1.06], tickformat=".0%")
    figure.update_yaxes(title_text="share that is right", range=[-0.06, 1.08], tickformat=".0%")
    return figure


def time_figure(trial: PlaceTrial) -> go.Figure:
    """The true area along time, and the most probable one: as sure as it is large, red where it is wrong."""
    answers = trial.answers
    seconds = answers.stamps_s - answers.stamps_s[0]
    height = max(_LEAST_PX, 34 * len(trial.area_names) + 110)
    figure = drawing.style(go.Figure(), height, hovermode="closest")
    truth = np.where(trial.is_judged, trial.labels, np.nan).astype(float)
    figure.add_scatter(
        x=seconds,
        y=truth,
        mode="lines",
        line={"color": GREY, "width": 11, "shape": "hv"},
        opacity=0.45,
        name="true area",
        hoverinfo="skip",
        connectgaps=False,
    )
    best, confidence = answers.probabilities.argmax(axis=1), answers.probabilities.max(axis=1)
    wrong = trial.is_judged & ~trial.is_right & answers.has_depth
    for name, which, color in (
        ("most probable area", answers.has_depth & ~wrong, BLUE),
        ("wrong", wrong, VERMILLION),
    ):
        figure.add_scatter(
            x=seconds[which],
            y=best[which],
            customdata=confidence[which],
            mode="markers",
            marker={"size": 2 + 6 * confidence[which], "color": color},
            name=name,
            hovertemplate="%{x:.2f} s: %{customdata:.0%} sure<extra>" + name + "</extra>",
            showlegend=bool(which.any()),
        )
    areas = len(trial.area_names)
    ticks = {"tickmode": "array", "tickvals": list(range(areas)), "ticktext": list(trial.area_names)}
    figure.update_yaxes(range=[areas - 0.4, -0.6], **ticks)
    drawing.time_axis_until(figure, float(seconds[-1]), "seconds since the first frame")
    return figure
