"""The figures of several odometries together: each has its own colour, and all share one frame and one time axis."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from wheelsight.estimates import Status
from wheelsight.geometry import FloatArray
from wheelsight.pipeline.joined import JOINED
from wheelsight.pipeline.run_record import RunRecord
from wheelsight.report import _drawing as drawing
from wheelsight.report import _plotly as go
from wheelsight.report import _series as series
from wheelsight.report._drawing import GREY
from wheelsight.report._plotly import make_subplots
from wheelsight.report.figures import STATUS_COLOURS, add_band, status_labels
from wheelsight.report.joined_figures import add_ellipses
from wheelsight.report.overlay import Overlay

_TIME = "seconds since the first event"


def overlay_figure(paths: Overlay) -> go.Figure:
    """All paths and the truth from above, metres, equal aspect; a ring at the start, a square at each end.

    Joined sensors stand out, with ellipses of the 3σ that they state; those of the others the legend turns on.
    """
    figure = drawing.style(go.Figure(), 560, hovermode="closest", margin={"l": 58, "r": 12, "t": 34, "b": 46})
    lines = {name: (path, colour_of(name), _width_of(name)) for name, path in paths.paths_m.items()}
    if paths.truth_m is not None:
        lines = {"ground truth": (paths.truth_m, GREY, 5), **lines}
    drawn, start = np.empty((0, 2)), None
    for name, (positions_m, colour, width) in lines.items():
        path = positions_m[series.keep_shape(positions_m[:, :2]), :2]
        drawing.add_path(
            figure, path, name=name, line={"color": colour, "width": width}, hover="x %{x:.3f}, y %{y:.3f} m"
        )
        known = path[~np.isnan(path).any(axis=1)]
        drawn = np.concatenate([drawn, known])
        start = known[0] if start is None and len(known) else start
        if name != "ground truth" and len(known):
            _mark(figure, known[-1], f"end, {name}", "square", colour)
        if name in paths.trajectories and JOINED in paths.paths_m:
            how = {} if name == JOINED else {"visible": "legendonly"}
            add_ellipses(figure, name, paths.trajectories[name], colour, **how)
    if start is not None:
        _mark(figure, start, "start", "circle-open", GREY)
    x_range, y_range = drawing.room_around(drawn)
    figure.update_xaxes(title_text="x, m", range=x_range)
    figure.update_yaxes(title_text="y, m", range=y_range, scaleanchor="x", scaleratio=1)
    return figure


def errors_figure(records: Sequence[RunRecord]) -> go.Figure:
    """Over time, for each record that was evaluated: distance to the true position, and the RPE over a second."""
    panels = [panel for panel in _error_panels(records) if panel[2]]
    figure = make_subplots(rows=len(panels), cols=1, shared_xaxes=True, vertical_spacing=0.11)
    drawing.style(figure, 80 + 170 * len(panels), hovermode="x")
    start_s, end_s = _span_s(records)
    for row, (title, unit, lines) in enumerate(panels, start=1):
        for record, stamps_s, errors in lines:
            x, y = series.with_gaps(stamps_s, errors, series.poseless_stamps_s(record))
            name = record.odometry
            line = {"color": colour_of(name), "width": 0.75 * _width_of(name)}
            where = {"row": row, "in_legend": row == 1}
            drawing.add_line(figure, x - start_s, y, name=name, line=line, hover=f"%{{y:.4f}} {unit}", **where)
        drawing.panel_title(figure, f"{title}, {unit}", y=figure.layout[f"yaxis{row if row > 1 else ''}"].domain[1])
    figure.update_yaxes(rangemode="tozero")
    drawing.time_axis_until(figure, end_s - start_s, _TIME)
    return figure


def bands_figure(records: Sequence[RunRecord]) -> go.Figure:
    """One lane an odometry: in its own colour while its pose was known, in the status' colour while it was not."""
    figure = drawing.style(go.Figure(), 96 + 34 * len(records), hovermode="closest")
    start_s, end_s = _span_s(records)
    in_legend = {Status.TRACKING.value}
    for record in records:
        labels = status_labels(record)
        offset_s = record.frames[0].stamp_s - start_s if record.frames else 0.0
        starts_s, ends_s = (offset_s + edge for edge in record.frame_spans_s())
        for label in STATUS_COLOURS:
            if label not in labels:
                continue
            colour = colour_of(record.odometry) if label == Status.TRACKING else STATUS_COLOURS[label]
            line, how = {"color": colour}, {"showlegend": label not in in_legend, "legendgroup": label}
            add_band(figure, record, label, labels, starts_s, ends_s, y=record.odometry, line=line, **how)
            in_legend.add(label)
    lanes = [record.odometry for record in records][::-1]
    order = {"categoryorder": "array", "categoryarray": lanes, "range": [-0.6, len(lanes) - 0.4]}
    figure.update_yaxes(showgrid=False, **order)
    drawing.time_axis_until(figure, end_s - start_s, _TIME)
    return figure


def colour_of(odometry: str) -> str:
    """The colour an odometry keeps through the page."""
    return drawing.ODOMETRY_COLOURS.get(odometry, GREY)


def _width_of(odometry: str) -> float:
    return 3 if odometry == JOINED else 2


def _error_panels(
    records: Sequence[RunRecord],
) -> Iterator[tuple[str, str, list[tuple[RunRecord, FloatArray, FloatArray]]]]:
    """Title, unit, and each record's stamps (M,) and errors (M,) of each panel."""
    evaluated = [(record, record.evaluation) for record in records if record.evaluation is not None]
    yield "ATE", "m", [(record, found.ate.stamps_s, found.ate.errors_m) for record, found in evaluated]
    steps = [(record, found.rpe_per_second) for record, found in evaluated if found.rpe_per_second is not None]
    yield "RPE a second, translation", "m", [(record, rpe.end_s, rpe.errors_m) for record, rpe in steps]
    yield "RPE a second, rotation", "°", [(record, rpe.end_s, np.degrees(rpe.errors_rad)) for record, rpe in steps]


def _span_s(records: Sequence[RunRecord]) -> tuple[float, float]:
    """Stamps of the first and the last event that any odometry answered."""
    stamps_s = [record.frames[i].stamp_s for record in records if record.frames for i in (0, -1)]
    return min(stamps_s, default=0.0), max(stamps_s, default=0.0)


def _mark(figure: go.Figure, point: FloatArray, name: str, symbol: str, colour: str) -> None:
    """A mark that the legend does not list; the start bears its word."""
    is_start = name == "start"
    figure.add_scatter(
        x=point[:1],
        y=point[1:],
        mode="markers+text" if is_start else "markers",
        name=name,
        text=[name],
        marker={"symbol": symbol, "size": 13 if is_start else 10, "color": colour, "line": {"width": 3 * is_start}},
        textposition="bottom center",
        showlegend=False,
        hovertemplate=f"{name}<extra></extra>",
    )
