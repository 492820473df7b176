"""The figures of areas that rectify wheels: the paths on the map of areas, and the areas' probabilities along time."""

from __future__ import annotations

from html import escape
from typing import Any

import numpy as np

from wheelsight.areas import AreaMap
from wheelsight.geometry import FloatArray, IntArray
from wheelsight.pipeline.rectification_record import RectificationRecord
from wheelsight.pipeline.run_record import RunRecord
from wheelsight.report import _drawing as drawing
from wheelsight.report import _plotly as go
from wheelsight.report import _series as series
from wheelsight.report._drawing import GREY
from wheelsight.report._plotly import make_subplots
from wheelsight.report.places_sheet import area_colour

_MOST_COLUMNS = 1200
_ROW_PX, _TRUST_PX, _GAP_PX = 24, 84, 54
_FULL = 0.999  # of a row's span of colours, so that certainty in one area is not taken for the next one's nothing
_NAME_PX = 11


def area_map_figure(record: RunRecord) -> go.Figure:
    """Areas with their names, the true path, the wheels alone and the rectified wheels, in the map, nothing aligned.

    A ring marks the start, squares the ends. `record` has a rectification.
    """
    found = _of(record)
    figure = drawing.style(go.Figure(), 620, hovermode="closest", margin={"l": 58, "r": 12, "t": 34, "b": 46})
    _add_areas(figure, found.areas)
    lines = {
        "wheels": (found.wheels.positions_m, drawing.ODOMETRY_COLOURS["wheels"], 2),
        "rectified": (_with_gaps(record), drawing.ODOMETRY_COLOURS["rectified"], 2),
    }
    if record.ground_truth is not None and len(record.ground_truth) and len(found.looks):
        truth = record.ground_truth.between(found.stamps_s[0], found.stamps_s[-1])
        lines = {"ground truth": (truth.positions_m, GREY, 5), **lines}
    drawn = np.concatenate([area.polygon for area in found.areas])
    for name, (positions_m, colour, width) in lines.items():
        path = positions_m[series.keep_shape(positions_m[:, :2]), :2]
        line = {"color": colour, "width": width}
        drawing.add_path(figure, path, name=name, line=line, hover="x %{x:.2f}, y %{y:.2f} m")
        known = path[~np.isnan(path).any(axis=1)]
        drawn = np.concatenate([drawn, known])
        if len(known):
            _add_end(figure, name, known, colour)
    x_range, y_range = drawing.room_around(drawn)
    figure.update_xaxes(title_text="x, m", range=x_range, showgrid=False)
    figure.update_yaxes(title_text="y, m", range=y_range, scaleanchor="x", scaleratio=1, showgrid=False)
    return figure


def area_time_figure(record: RunRecord) -> go.Figure:
    """Over time, one row an area in its colour, the fuller the more probable; the true area is a line through its row.

    Above what the model says of each frame alone; below what the filter believes, and how far it trusts the model. Of
    the paper's way, which has no filter, the first panel alone. `record` has a rectification with a look at least.
    """
    found = _of(record)
    panels = {"what each frame says by itself": found.forest}
    if found.belief is not None:
        panels["what is believed, all frames and the wheels taken together"] = found.belief
    heights = [_ROW_PX * len(found.areas)] * len(panels) + ([_TRUST_PX] if found.belief is not None else [])
    figure = make_subplots(
        rows=len(heights),
        cols=1,
        shared_xaxes=True,
        row_heights=heights,
        vertical_spacing=_GAP_PX / (sum(heights) + _GAP_PX * (len(heights) - 1)) if len(heights) > 1 else 0,
    )
    drawing.style(figure, 90 + sum(heights) + _GAP_PX * (len(heights) - 1), hovermode="closest")
    seconds = record.seconds_since_start(found.stamps_s)
    for row, (title, probabilities) in enumerate(panels.items(), start=1):
        _add_rows(figure, found, seconds, probabilities, row)
        _panel_title(figure, title, row)
    if found.belief is not None:
        row = len(heights)
        line = {"color": drawing.ODOMETRY_COLOURS["rectified"], "width": 1.5}
        how = {"hover": "%{y:.2f}", "row": row, "in_legend": False}
        drawing.add_line(figure, seconds, found.trust, name="trust in the model", line=line, **how)
        figure.update_yaxes(range=[-0.04, 1.04], tickvals=[0, 0.5, 1], row=row, col=1)
        _panel_title(figure, "trust in the model: how probable it is that it works here at all", row)
    drawing.time_axis(figure, record)
    figure.update_layout(margin_l=62 + 7 * min(max(map(len, found.areas.names)), 24))
    return figure


def map_error_figure(record: RunRecord) -> go.Figure:
    """Over time, how far the wheels alone and the rectified ones are from the true base, metres, nothing aligned.

    `record` has a rectification with errors.
    """
    found = _of(record)
    assert found.errors is not None
    figure = drawing.style(go.Figure(), 270, hovermode="x")
    x = record.seconds_since_start(found.errors.stamps_s)
    for name, errors_m in (("wheels", found.errors.wheels_m), ("rectified", found.errors.rectified_m)):
        line = {"color": drawing.ODOMETRY_COLOURS[name], "width": 1.5}
        drawing.add_line(figure, x, errors_m, name=name, line=line, hover="%{y:.2f} m")
    figure.update_yaxes(rangemode="tozero")
    drawing.panel_title(figure, "distance from the truth, m")
    drawing.time_axis(figure, record)
    return figure


def _of(record: RunRecord) -> RectificationRecord:
    assert record.rectification is not None, "the record has no rectification"
    return record.rectification


def _with_gaps(record: RunRecord) -> FloatArray:
    breaks_s = series.poseless_stamps_s(record)
    return series.with_gaps(record.estimate.stamps_s, record.estimate.positions_m, breaks_s)[1]


def _add_areas(figure: go.Figure, areas: AreaMap) -> None:
    for index, area in enumerate(areas):
        corners = np.concatenate([area.polygon, area.polygon[:1]])
        colour = area_colour(index)
        figure.add_scatter(
            x=corners[:, 0],
            y=corners[:, 1],
            mode="lines",
            fill="toself",
            fillcolor=_faded(colour, 0.16),
            line={"color": _faded(colour, 0.7), "width": 1},
            name=f"area {area.name}",
            showlegend=False,
            hoverinfo="skip",
        )
        # Names stand in a corner, where paths seldom pass.
        low = area.polygon.min(axis=0)
        x_m, y_m = area.polygon[int(np.argmin((area.polygon - low).sum(axis=1)))]
        figure.add_annotation(
            x=x_m,
            y=y_m,
            text=f"<b>{escape(area.name)}</b>",
            showarrow=False,
            xanchor="left",
            yanchor="bottom",
            font={"size": _NAME_PX + 3, "color": colour},
        )


def _add_end(figure: go.Figure, name: str, path: FloatArray, colour: str) -> None:
    """A square where a path ends; a ring, with its word, where the truth, or else the wheels, begin."""
    marker: dict[str, Any] = {"symbol": "square", "size": 10, "color": colour}
    hover = f"end, {name}<extra></extra>"
    figure.add_scatter(
        x=path[-1:, 0], y=path[-1:, 1], mode="markers", marker=marker, name=hover, showlegend=False, hovertemplate=hover
    )
    if name == "rectified":
        ring = {"symbol": "circle-open", "size": 13, "color": GREY, "line": {"width": 3}}
        figure.add_scatter(
            x=path[:1, 0],
            y=path[:1, 1],
            mode="markers+text",
            text=["start"],
            textposition="top center",
            marker=ring,
            name="start",
            showlegend=False,
            hovertemplate="start<extra></extra>",
        )


def _add_rows(
    figure: go.Figure, found: RectificationRecord, seconds: FloatArray, probabilities: FloatArray, row: int
) -> None:
    n = len(found.areas)
    x, shown = _thinned(seconds, probabilities)
    figure.add_heatmap(
        x=x,
        y=list(range(n)),
        z=(np.arange(n) + _FULL * shown).T,
        customdata=shown.T,
        zmin=0,
        zmax=n,
        colorscale=_rows_of_colours(n),
        showscale=False,
        ygap=2,
        name="",
        hoverongaps=False,
        hovertemplate="%{x:.1f} s: %{customdata:.0%}",
        row=row,
        col=1,
    )
    if found.true_areas is not None:
        _add_true_areas(figure, found.true_areas, seconds, row)
    ticks = {"tickmode": "array", "tickvals": list(range(n)), "ticktext": [escape(name) for name in found.areas.names]}
    figure.update_yaxes(range=[n - 0.5, -0.5], showgrid=False, row=row, col=1, **ticks)
    figure.update_xaxes(showgrid=False, row=row, col=1)


def _add_true_areas(figure: go.Figure, true_areas: IntArray, seconds: FloatArray, row: int) -> None:
    truth = np.where(true_areas >= 0, true_areas, np.nan).astype(float)
    kept = np.flatnonzero(np.diff(truth, prepend=np.inf, append=np.inf)[:-1] != 0)  # where it changes, and NaN
    kept = np.union1d(kept, np.append((kept - 1).clip(0), len(truth) - 1))
    figure.add_scatter(
        x=seconds[kept],
        y=truth[kept],
        mode="lines",
        line={"color": GREY, "width": 2, "shape": "hv"},
        name="true area",
        legendgroup="true area",
        showlegend=row == 1,
        hoverinfo="skip",
        row=row,
        col=1,
    )


def _rows_of_colours(n: int) -> list[list[float | str]]:
    """A colour scale over 0 … n in which row i goes from nothing to its area's colour between i and i + 1."""
    scale: list[list[float | str]] = []
    for index in range(n):
        scale.append([index / n, _faded(area_colour(index), 0.05)])
        scale.append([(index + _FULL) / n, area_colour(index)])
    return [*scale, [1.0, area_colour(n - 1)]]


def _thinned(seconds: FloatArray, probabilities: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Times (M,) and means (M, A) of at most so many columns as a screen has; NaN where no frame of a column tells."""
    if len(seconds) <= _MOST_COLUMNS:
        return seconds, probabilities
    column = np.arange(len(seconds)) * _MOST_COLUMNS // len(seconds)
    known = ~np.isnan(probabilities).any(axis=1)
    sums, counts = np.zeros((_MOST_COLUMNS, probabilities.shape[1])), np.zeros(_MOST_COLUMNS)
    np.add.at(sums, column[known], probabilities[known])
    np.add.at(counts, column[known], 1)
    times = np.bincount(column, seconds) / np.bincount(column)
    means = np.full_like(sums, np.nan)
    np.divide(sums, counts[:, None], out=means, where=counts[:, None] > 0)
    return times, means


def _panel_title(figure: go.Figure, text: str, row: int) -> None:
    drawing.panel_title(figure, text, y=figure.layout[f"yaxis{row if row > 1 else ''}"].domain[1])


def _faded(colour: str, opacity: float) -> str:
    red, green, blue = (int(colour[i : i + 2], 16) for i in (1, 3, 5))
    return f"rgba({red},{green},{blue},{opacity})"
