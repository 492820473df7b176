"""Figures of wheels and a camera joined: how far it was off beside what it said, its statuses and flags; ellipses."""

from __future__ import annotations

from typing import Any

import numpy as np

from wheelsight.evaluation import THREE_SIGMA_RADIUS, Consistency, covariances_ahead_m2, position_covariances_m2
from wheelsight.geometry import FloatArray, IntArray
from wheelsight.pipeline.joined import FLAGS
from wheelsight.pipeline.run_record import RunRecord
from wheelsight.report import _drawing as drawing
from wheelsight.report import _plotly as go
from wheelsight.report import _series as series
from wheelsight.report._drawing import INK, VERMILLION
from wheelsight.report._plotly import make_subplots
from wheelsight.report.figures import STATUS_COLOURS, add_band, status_labels
from wheelsight.trajectory import Trajectory

_MOST_ELLIPSES = 24
_CORNERS = 48
_STATUS, _LANE_PX = "status", 26
_SIGMA_FILL = "rgba(0, 114, 178, 0.18)"  # BLUE
_AXES = ("ahead", "to the left")


def trust_figure(record: RunRecord, found: Consistency | None) -> go.Figure:
    """Over time: errors ahead and to the left amid the stated ±3σ, below them statuses and flags on the same axis.

    Without a truth 3σ stands alone. Lanes of flags that were never up are left out.
    """
    flags = [flag for flag in FLAGS if any(flag in frame.flags for frame in record.frames)]
    lanes = [_STATUS, *flags]
    panels_px = [150, 150, 24 + _LANE_PX * len(lanes)]
    figure = make_subplots(rows=3, cols=1, shared_xaxes=True, vertical_spacing=0.09, row_heights=panels_px)
    drawing.style(figure, 150 + sum(panels_px), hovermode="closest")
    x, sigmas_m, errors_m = _errors_beside_sigmas(record, found)
    for axis, name in enumerate(_AXES):
        row, band_m = axis + 1, 3 * sigmas_m[:, axis]
        how = {"name": "±3σ as stated", "legendgroup": "3σ", "showlegend": axis == 0, "fillcolor": _SIGMA_FILL}
        drawing.add_area(figure, x, -band_m, band_m, hoverinfo="skip", row=row, col=1, **how)
        _add_errors(figure, x, errors_m[..., axis], row)
        title = f"{'±3σ' if found is None else 'error'} {name}, m"
        drawing.panel_title(figure, title, y=figure.layout[f"yaxis{row if row > 1 else ''}"].domain[1])
    _add_lanes(figure, record, lanes)
    drawing.time_axis(figure, record)
    return figure


def add_ellipses(figure: go.Figure, name: str, aligned: Trajectory, colour: str, **how: Any) -> None:
    """Where the body is in 3σ (of two dimensions) every so often along a path that has covariances, as one line."""
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
    chosen = _evenly_along(trajectory)
    if not len(chosen):
        return np.empty((0, 2))
    C = position_covariances_m2(trajectory.select(chosen))[:, :2, :2]
    variances, axes = np.linalg.eigh(C)
    roots = axes * np.sqrt(variances.clip(0))[:, None, :]
    turns = np.linspace(0, 2 * np.pi, _CORNERS + 1)
    circle = THREE_SIGMA_RADIUS * np.stack([np.cos(turns), np.sin(turns)])
    outlines = trajectory.positions_m[chosen, None, :2] + (roots @ circle).transpose(0, 2, 1)
    return np.concatenate([outlines, np.full((len(chosen), 1, 2), np.nan)], axis=1).reshape(-1, 2)


def _evenly_along(trajectory: Trajectory) -> IntArray:
    """Indices of poses at equal ways, of 1, 2 or 5 times a power of ten of metres, and of the last."""
    way_m = trajectory.distances_m
    if not len(way_m) or way_m[-1] <= 0:
        return np.arange(min(len(way_m), 1))
    least_m = way_m[-1] / _MOST_ELLIPSES
    power = 10.0 ** np.floor(np.log10(least_m))
    step_m = next(factor * power for factor in (1, 2, 5, 10) if factor * power >= least_m)
    return np.unique(np.append(np.searchsorted(way_m, np.arange(step_m, way_m[-1], step_m)), len(way_m) - 1))


def _errors_beside_sigmas(record: RunRecord, found: Consistency | None) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Seconds (M,), σ (M, 2) ahead and to the left, and errors (M, 2, 2), all of them and those beyond the stated 3σ.

    Broken where no pose is known; errors are NaN without a truth.
    """
    if found is None:
        stamps_s, C = record.estimate.stamps_s, covariances_ahead_m2(record.estimate)
        errors_m = np.full((len(C), 2, 2), np.nan)
    else:
        stamps_s, C = found.stamps_s, found.covariances_m2
        errors_m = np.stack([found.errors_m, np.where(found.is_within[:, None], np.nan, found.errors_m)], axis=1)
    sigmas_m = np.sqrt(np.diagonal(C, axis1=1, axis2=2).clip(0))
    every = np.concatenate([sigmas_m[:, None], errors_m], axis=1)
    stamps_s, every = series.with_gaps(stamps_s, every, series.poseless_stamps_s(record))
    return record.seconds_since_start(stamps_s), every[:, 0], every[:, 1:]


def _add_errors(figure: go.Figure, x: FloatArray, errors_m: FloatArray, row: int) -> None:
    """Errors (M, 2) along one axis: all of them, and over these the ones beyond 3σ."""
    names = (("error", {"color": INK, "width": 1.5}), ("beyond 3σ", {"color": VERMILLION, "width": 2.5}))
    for (name, line), errors in zip(names, errors_m.T, strict=True):
        if not np.isnan(errors).all():
            drawing.add_line(figure, x, errors, name=name, line=line, hover="%{y:.3f} m", row=row, in_legend=row == 1)


def _add_lanes(figure: go.Figure, record: RunRecord, lanes: list[str]) -> None:
    """Statuses as one band, and flags as thin ones beneath, in the lowest panel."""
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
