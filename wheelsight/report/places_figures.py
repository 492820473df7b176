"""Figures of a model of places on trial: what it takes for what, how sure it is, and its answers along time."""

from __future__ import annotations

from collections.abc import Sequence
from html import escape
from typing import Any

import numpy as np

from wheelsight.places import PlaceTrial
from wheelsight.report import _drawing as drawing
from wheelsight.report import _plotly as go
from wheelsight.report._drawing import BLUE, GREY, VERMILLION

_CELL_PX, _LEAST_PX = 52, 320
# Never so strong that the page's ink, dark or light, could not be read upon it.
_BLUES = [[0, "rgba(0,114,178,0.04)"], [1, "rgba(0,114,178,0.6)"]]


def confusion_figure(trial: PlaceTrial) -> go.Figure:
    """True areas in rows, most probable areas in columns; colour is the share of the row, figures are frames."""
    counts, names = trial.confusion, trial.area_names
    columns = (*names, "no depth") if counts[:, -1].any() else names
    counts = counts[:, : len(columns)]
    shares = counts / np.maximum(counts.sum(axis=1, keepdims=True), 1)
    figure = drawing.style(
        go.Figure(), max(_LEAST_PX, _CELL_PX * len(counts) + 100), margin={"r": 14, "t": 14, "b": 56}
    )
    pairs = [[f"in {true}, taken for {best}" for best in columns] for true in names]
    figure.add_heatmap(
        z=shares,
        text=[[f"{count:,}" if count else "" for count in row] for row in counts.tolist()],
        customdata=pairs,
        texttemplate="%{text}",
        textfont={"size": 14},
        colorscale=_BLUES,
        zmin=0,
        zmax=1,
        showscale=False,
        xgap=2,
        ygap=2,
        hovertemplate="%{customdata}: %{z:.1%} of its frames<extra></extra>",
    )
    figure.update_xaxes(title_text="most probable area", **_names_at_ticks(columns))
    figure.update_yaxes(title_text="true area", autorange="reversed", **_names_at_ticks(names))
    figure.update_layout(margin_l=_room_for(names))
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
    figure.update_yaxes(range=[areas - 0.4, -0.6], **_names_at_ticks(trial.area_names))
    drawing.time_axis_until(figure, float(seconds[-1]), "seconds since the first frame")
    figure.update_layout(margin_l=_room_for(trial.area_names))
    return figure


def _names_at_ticks(names: Sequence[str]) -> dict[str, Any]:
    """Places 0, 1, … of an axis by their names: given as text, names such as 1 would be taken for places."""
    ticks = {"tickmode": "array", "tickvals": list(range(len(names))), "ticktext": [escape(name) for name in names]}
    return {**ticks, "showgrid": False}


def _room_for(names: Sequence[str]) -> int:
    """Left margin in px that the longest name needs, and the axis' title beside it."""
    return 62 + 7 * min(max(map(len, names)), 24)
