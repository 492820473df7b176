"""Figures of several odometries in one frame and on one time axis, of joined sensors, and of areas that rectify
wheels.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from html import escape
from typing import Any, Literal

import numpy as np

from wheelsight.app.run.run_record import RectificationRecord, RunRecord
from wheelsight.app.run.verdict import FLAGS, JOINED, joined_of, runs
from wheelsight.core.errors import EvaluationError
from wheelsight.core.estimates import Status
from wheelsight.core.geometry import FloatArray, se3
from wheelsight.core.trajectory import Trajectory
from wheelsight.evaluation import (
    THREE_SIGMA_RADIUS,
    Consistency,
    covariances_ahead_m2,
    position_covariances_m2,
    start_alignment,
)
from wheelsight_report import drawing
from wheelsight_report import plotly as go
from wheelsight_report.drawing import GREY, INK, VERMILLION, area_colour, keep_shape, poseless_stamps_s, with_gaps
from wheelsight_report.figures import STATUS_COLOURS, add_band, estimated_path_m, status_labels, truth_path_m
from wheelsight_report.plotly import make_subplots

_TIME = "seconds since the first event"


def overlay_figure(paths: Overlay) -> go.Figure:
    """All paths and the truth from above, metres, equal aspect; a ring at the start, a square at each end.

    Joined sensors stand out, with ellipses of their stated 3σ. The legend switches the ellipses of the others on.
    """
    figure = drawing.map_figure(560)
    lines = {name: (path, colour_of(name), _width_of(name)) for name, path in paths.paths_m.items()}
    if paths.truth_m is not None:
        lines = {"ground truth": (paths.truth_m, GREY, 5), **lines}
    drawn, start = np.empty((0, 2)), None
    for name, (positions_m, colour, width) in lines.items():
        path = positions_m[keep_shape(positions_m[:, :2]), :2]
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
    figure.update_xaxes(range=x_range)
    figure.update_yaxes(range=y_range)
    return figure


def errors_figure(records: Sequence[RunRecord]) -> go.Figure:
    """Distance to the true position and RPE over a second, over time, for each evaluated record."""
    evaluated = [(record, record.evaluation) for record in records if record.evaluation is not None]
    steps = [(record, found.rpe_per_second) for record, found in evaluated if found.rpe_per_second is not None]
    # Title, unit, and each record's stamps (M,) and errors (M,) of each panel
    kinds = (
        ("ATE", "m", [(record, found.ate.stamps_s, found.ate.errors_m) for record, found in evaluated]),
        ("RPE a second, translation", "m", [(record, rpe.end_s, rpe.errors_m) for record, rpe in steps]),
        ("RPE a second, rotation", "°", [(record, rpe.end_s, np.degrees(rpe.errors_rad)) for record, rpe in steps]),
    )
    panels = [kind for kind in kinds if kind[2]]
    figure = make_subplots(rows=len(panels), cols=1, shared_xaxes=True, vertical_spacing=0.11)
    drawing.style(figure, 80 + 170 * len(panels), hovermode="x")
    start_s, end_s = _span_s(records)
    for row, (title, unit, lines) in enumerate(panels, start=1):
        for record, stamps_s, errors in lines:
            x, y = with_gaps(stamps_s, errors, poseless_stamps_s(record))
            name = record.odometry
            line = {"color": colour_of(name), "width": 0.75 * _width_of(name)}
            where = {"row": row, "in_legend": row == 1}
            drawing.add_line(figure, x - start_s, y, name=name, line=line, hover=f"%{{y:.4f}} {unit}", **where)
        drawing.panel_title(figure, f"{title}, {unit}", row)
    figure.update_yaxes(rangemode="tozero")
    drawing.time_axis_until(figure, end_s - start_s, _TIME)
    return figure


def bands_figure(records: Sequence[RunRecord]) -> go.Figure:
    """One lane for each odometry: in its own colour with a pose, else in the colour of the status."""
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
    """The colour of an odometry on the whole page."""
    return drawing.ODOMETRY_COLOURS.get(odometry, GREY)


def _width_of(odometry: str) -> float:
    return 3 if odometry == JOINED else 2


def _span_s(records: Sequence[RunRecord]) -> tuple[float, float]:
    """Stamps of the first and the last answered event."""
    stamps_s = [record.frames[i].stamp_s for record in records if record.frames for i in (0, -1)]
    return min(stamps_s, default=0.0), max(stamps_s, default=0.0)


def _mark(figure: go.Figure, point: FloatArray, name: str, symbol: str, colour: str) -> None:
    """A marker outside the legend; the start has a label."""
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


@dataclass(frozen=True, slots=True, eq=False)
class Overlay:
    """Paths in one frame.

    Attributes:
        paths_m: (N, 3) positions of each odometry by its name, metres, rows of NaN at gaps.
        truth_m: (M, 3) true positions, likewise, or None.
        by: the alignment: "truth" as for the ATE, or by first poses to the "true start" or to a common "start".
        left_out: reason for each missing odometry, by its name.
        trajectories: the same estimates in the same frame, with covariances, of those that have some.
    """

    paths_m: dict[str, FloatArray]
    truth_m: FloatArray | None
    by: Literal["truth", "true start", "start"]
    left_out: dict[str, str]
    trajectories: dict[str, Trajectory] = field(default_factory=dict)


def overlay_of(records: Sequence[RunRecord]) -> Overlay:
    """The paths of `records` in one frame: of the truth if any is evaluated, else of their common start.

    With joined sensors all paths begin at the true start, where their stated uncertainty begins, too.
    """
    evaluated = [record for record in records if record.evaluation is not None]
    if evaluated and joined_of(evaluated) is not None:
        left_out = {r.odometry: r.evaluation_problem or "" for r in records if r.evaluation is None}
        moved = {}
        for record in evaluated:
            assert record.ground_truth is not None
            assert record.evaluation is not None
            try:
                start = start_alignment(record.estimate, record.ground_truth)
                moved[record.odometry] = record.estimate.moved(start)
            except EvaluationError:  # the truth has a gap there: as for the ATE
                moved[record.odometry] = record.evaluation.ate.aligned
        return _overlay(evaluated, moved, truth_path_m(evaluated[0]), "true start", left_out)
    if evaluated:
        left_out = {r.odometry: r.evaluation_problem or "" for r in records if r.evaluation is None}
        paths_m = {record.odometry: estimated_path_m(record) for record in evaluated}
        return Overlay(paths_m, truth_path_m(evaluated[0]), "truth", left_out)
    body = "base" if any(record.estimate.body == "base" for record in records) else "camera"
    left_out = {}
    for record in records:
        if not len(record.estimate):
            left_out[record.odometry] = "no pose was found"
        elif record.estimate.body != body:
            left_out[record.odometry] = f"its poses are of the {record.estimate.body}, the others of the {body}"
    drawn = [record for record in records if record.odometry not in left_out]
    # Each estimate relative to its pose at the first common time, or else to its first pose
    begin_s = max((each.estimate.stamps_s[0] for each in drawn), default=0.0)
    from_start = {}
    for each in drawn:
        T_odom_start = each.estimate.at([begin_s])[0]
        if not np.isfinite(T_odom_start).all():
            T_odom_start = each.estimate.T_frame_body[0]
        from_start[each.odometry] = each.estimate.moved(se3.invert(T_odom_start))
    return _overlay(drawn, from_start, None, "start", left_out)


def _overlay(
    records: Sequence[RunRecord],
    moved: dict[str, Trajectory],
    truth_m: FloatArray | None,
    by: Literal["true start", "start"],
    left_out: dict[str, str],
) -> Overlay:
    paths_m = {}
    for record in records:
        stamps_s, positions_m = moved[record.odometry].stamps_s, moved[record.odometry].positions_m
        paths_m[record.odometry] = with_gaps(stamps_s, positions_m, poseless_stamps_s(record))[1]
    stated = {name: trajectory for name, trajectory in moved.items() if trajectory.covariances is not None}
    return Overlay(paths_m, truth_m, by, left_out, stated)


_MOST_ELLIPSES = 24
_CORNERS = 48
_STATUS, _LANE_PX = "status", 26
_SIGMA_FILL = "rgba(0, 114, 178, 0.18)"  # BLUE
_AXES = ("ahead", "to the left")


def trust_figure(record: RunRecord, found: Consistency | None) -> go.Figure:
    """Errors ahead and to the left within the stated ±3σ over time; below, statuses and flags on the same axis.

    Without a truth it shows 3σ only. Flags that never occur have no lane.
    """
    flags = [flag for flag in FLAGS if any(flag in frame.flags for frame in record.frames)]
    lanes = [_STATUS, *flags]
    panels_px = [150, 150, 24 + _LANE_PX * len(lanes)]
    figure = make_subplots(rows=3, cols=1, shared_xaxes=True, vertical_spacing=0.09, row_heights=panels_px)
    drawing.style(figure, 150 + sum(panels_px), hovermode="closest")
    # Seconds (M,), σ (M, 2) ahead and to the left, and errors (M, 2, 2), all of them and those beyond the stated
    # 3σ. Broken where no pose is known; errors are NaN without a truth.
    if found is None:
        stamps_s, C = record.estimate.stamps_s, covariances_ahead_m2(record.estimate)
        off_m = np.full((len(C), 2, 2), np.nan)
    else:
        stamps_s, C = found.stamps_s, found.covariances_m2
        off_m = np.stack([found.errors_m, np.where(found.is_within[:, None], np.nan, found.errors_m)], axis=1)
    stated_m = np.sqrt(np.diagonal(C, axis1=1, axis2=2).clip(0))
    every = np.concatenate([stated_m[:, None], off_m], axis=1)
    stamps_s, every = with_gaps(stamps_s, every, poseless_stamps_s(record))
    x, sigmas_m, errors_m = record.seconds_since_start(stamps_s), every[:, 0], every[:, 1:]
    for axis, name in enumerate(_AXES):
        row, band_m = axis + 1, 3 * sigmas_m[:, axis]
        how = {"name": "±3σ as stated", "legendgroup": "3σ", "showlegend": axis == 0, "fillcolor": _SIGMA_FILL}
        _add_area(figure, x, -band_m, band_m, hoverinfo="skip", row=row, col=1, **how)
        named = (("error", {"color": INK, "width": 1.5}), ("beyond 3σ", {"color": VERMILLION, "width": 2.5}))
        for (called, line), errors in zip(named, errors_m[..., axis].T, strict=True):
            if not np.isnan(errors).all():
                looks = {"name": called, "line": line, "hover": "%{y:.3f} m"}
                drawing.add_line(figure, x, errors, **looks, row=row, in_legend=row == 1)
        title = f"{'±3σ' if found is None else 'error'} {name}, m"
        drawing.panel_title(figure, title, row)
    # Statuses as one band, and flags as thin ones beneath, in the lowest panel
    starts_s, ends_s = record.frame_spans_s()
    labels = status_labels(record)
    where: dict[str, Any] = {"row": 3, "col": 1}
    for label in (label for label in STATUS_COLOURS if label in labels):
        line = {"color": STATUS_COLOURS[label]}
        add_band(figure, record, label, labels, starts_s, ends_s, y=_STATUS, line=line, **where)
    thin: dict[str, Any] = {"color": INK, "width": 7}
    for flag in lanes[1:]:
        up = [flag if flag in frame.flags else "" for frame in record.frames]
        add_band(figure, record, flag, up, starts_s, ends_s, y=flag, line=thin, showlegend=False, **where)
    order = {"categoryorder": "array", "categoryarray": lanes[::-1], "range": [-0.6, len(lanes) - 0.4]}
    figure.update_yaxes(showgrid=False, row=3, col=1, **order)
    drawing.time_axis(figure, record)
    return figure


def add_ellipses(figure: go.Figure, name: str, aligned: Trajectory, colour: str, **how: Any) -> None:
    """Add 3σ ellipses (of two dimensions) along a path with covariances, as one line."""
    outlines = ellipses_m(aligned)
    if len(outlines):
        line, rgb = {"color": colour, "width": 1}, [int(colour[i : i + 2], 16) for i in (1, 3, 5)]
        fill = {"fill": "toself", "fillcolor": "rgba({}, {}, {}, 0.1)".format(*rgb)}
        text = f"3σ of {name}"
        figure.add_scatter(
            x=outlines[:, 0], y=outlines[:, 1], mode="lines", name=text, line=line, hoverinfo="skip", **fill, **how
        )


def ellipses_m(trajectory: Trajectory) -> FloatArray:
    """Outlines (N, 2) in x and y of 3σ of two dimensions, at most some 24 of them, a row of NaN after each."""
    # Poses at equal distances of 1, 2 or 5 times a power of ten of metres, and the last
    way_m = trajectory.distances_m
    if not len(way_m) or way_m[-1] <= 0:
        chosen = np.arange(min(len(way_m), 1))
    else:
        least_m = way_m[-1] / _MOST_ELLIPSES
        power = 10.0 ** np.floor(np.log10(least_m))
        step_m = next(factor * power for factor in (1, 2, 5, 10) if factor * power >= least_m)
        chosen = np.unique(np.append(np.searchsorted(way_m, np.arange(step_m, way_m[-1], step_m)), len(way_m) - 1))
    if not len(chosen):
        return np.empty((0, 2))
    C = position_covariances_m2(trajectory.select(chosen))[:, :2, :2]
    variances, axes = np.linalg.eigh(C)
    roots = axes * np.sqrt(variances.clip(0))[:, None, :]
    turns = np.linspace(0, 2 * np.pi, _CORNERS + 1)
    circle = THREE_SIGMA_RADIUS * np.stack([np.cos(turns), np.sin(turns)])
    outlines = trajectory.positions_m[chosen, None, :2] + (roots @ circle).transpose(0, 2, 1)
    return np.concatenate([outlines, np.full((len(chosen), 1, 2), np.nan)], axis=1).reshape(-1, 2)


_MOST_COLUMNS = 1200
_ROW_PX, _TRUST_PX, _GAP_PX = 24, 84, 54
_FULL = 0.999  # of a row's span of colours, so that certainty in one area is not taken for the next one's nothing
_NAME_PX = 11


def area_map_figure(record: RunRecord) -> go.Figure:
    """Areas with their names, the true path, the wheels alone and the rectified wheels, in the map without alignment.

    A ring marks the start, squares the ends. `record` has a rectification.
    """
    found = _of(record)
    figure = drawing.map_figure(620)
    for index, area in enumerate(found.areas):
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
    estimate = record.estimate
    _, rectified_m = with_gaps(estimate.stamps_s, estimate.positions_m, poseless_stamps_s(record))
    lines = {
        "wheels": (found.wheels.positions_m, drawing.ODOMETRY_COLOURS["wheels"], 2),
        "rectified": (rectified_m, drawing.ODOMETRY_COLOURS["rectified"], 2),
    }
    if record.ground_truth is not None and len(record.ground_truth) and len(found.looks):
        truth = record.ground_truth.between(found.stamps_s[0], found.stamps_s[-1])
        lines = {"ground truth": (truth.positions_m, GREY, 5), **lines}
    drawn = np.concatenate([area.polygon for area in found.areas])
    for name, (positions_m, colour, width) in lines.items():
        path = positions_m[keep_shape(positions_m[:, :2]), :2]
        line = {"color": colour, "width": width}
        drawing.add_path(figure, path, name=name, line=line, hover="x %{x:.2f}, y %{y:.2f} m")
        known = path[~np.isnan(path).any(axis=1)]
        drawn = np.concatenate([drawn, known])
        if len(known):
            _mark(figure, known[-1], f"end, {name}", "square", colour)
            if name == "rectified":
                _mark(figure, known[0], "start", "circle-open", GREY)
    x_range, y_range = drawing.room_around(drawn)
    figure.update_xaxes(range=x_range, showgrid=False)
    figure.update_yaxes(range=y_range, showgrid=False)
    return figure


def area_time_figure(record: RunRecord) -> go.Figure:
    """Area probabilities over time, one row an area in its colour; the true area is a line through its row.

    The upper panel shows the model's probabilities of each frame; the lower one the filter's belief and its trust in
    the model. The paper's way has no filter and only the first panel. `record` has a rectification with at least one
    look.
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
        drawing.panel_title(figure, title, row)
    if found.belief is not None:
        row = len(heights)
        line = {"color": drawing.ODOMETRY_COLOURS["rectified"], "width": 1.5}
        how = {"hover": "%{y:.2f}", "row": row, "in_legend": False}
        drawing.add_line(figure, seconds, found.trust, name="trust in the model", line=line, **how)
        figure.update_yaxes(range=[-0.04, 1.04], tickvals=[0, 0.5, 1], row=row, col=1)
        drawing.panel_title(figure, "trust in the model: how probable it is that it works here at all", row)
    drawing.time_axis(figure, record)
    figure.update_layout(margin_l=62 + 7 * min(max(map(len, found.areas.names)), 24))
    return figure


def map_error_figure(record: RunRecord) -> go.Figure:
    """Distance of the wheels alone and of the rectified wheels from the true base over time, metres, without alignment.

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


def _add_rows(
    figure: go.Figure, found: RectificationRecord, seconds: FloatArray, probabilities: FloatArray, row: int
) -> None:
    n = len(found.areas)
    # Times (M,) and means (M, A), at most one a column of the screen; NaN where no frame of a column has
    # probabilities.
    if len(seconds) <= _MOST_COLUMNS:
        x, shown = seconds, probabilities
    else:
        column = np.arange(len(seconds)) * _MOST_COLUMNS // len(seconds)
        known = ~np.isnan(probabilities).any(axis=1)
        sums, counts = np.zeros((_MOST_COLUMNS, probabilities.shape[1])), np.zeros(_MOST_COLUMNS)
        np.add.at(sums, column[known], probabilities[known])
        np.add.at(counts, column[known], 1)
        times = np.bincount(column, seconds) / np.bincount(column)
        means = np.full_like(sums, np.nan)
        np.divide(sums, counts[:, None], out=means, where=counts[:, None] > 0)
        x, shown = times, means
    # A colour scale over 0 … n in which row i goes from nothing to its area's colour between i and i + 1
    scale: list[list[float | str]] = []
    for index in range(n):
        scale.append([index / n, _faded(area_colour(index), 0.05)])
        scale.append([(index + _FULL) / n, area_colour(index)])
    figure.add_heatmap(
        x=x,
        y=list(range(n)),
        z=(np.arange(n) + _FULL * shown).T,
        customdata=shown.T,
        zmin=0,
        zmax=n,
        colorscale=[*scale, [1.0, area_colour(n - 1)]],
        showscale=False,
        ygap=2,
        name="",
        hoverongaps=False,
        hovertemplate="%{x:.1f} s: %{customdata:.0%}",
        row=row,
        col=1,
    )
    if found.true_areas is not None:
        truth = np.where(found.true_areas >= 0, found.true_areas, np.nan).astype(float)
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
    ticks = {"tickmode": "array", "tickvals": list(range(n)), "ticktext": [escape(name) for name in found.areas.names]}
    figure.update_yaxes(range=[n - 0.5, -0.5], showgrid=False, row=row, col=1, **ticks)
    figure.update_xaxes(showgrid=False, row=row, col=1)


def _faded(colour: str, opacity: float) -> str:
    red, green, blue = (int(colour[i : i + 2], 16) for i in (1, 3, 5))
    return f"rgba({red},{green},{blue},{opacity})"


def _add_area(figure: go.Figure, x: FloatArray, low: FloatArray, high: FloatArray, **how: Any) -> None:
    """Fill the area between two lines over time (N,); open where either is NaN."""
    known = ~np.isnan(low + high)
    kept = np.union1d(drawing.keep_peaks(low), drawing.keep_peaks(high))
    outline = []
    for i, j, is_known in runs([str(found) for found in known[kept]]):
        part = kept[i:j]
        if is_known == "True":
            there_and_back = np.concatenate([x[part], x[part][::-1]]), np.concatenate([low[part], high[part][::-1]])
            outline += [np.stack(there_and_back, axis=-1), np.full((1, 2), np.nan)]
    closed = np.concatenate(outline) if outline else np.empty((0, 2))
    figure.add_scatter(x=closed[:, 0], y=closed[:, 1], mode="lines", line={"width": 0}, fill="toself", **how)
