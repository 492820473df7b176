"""What the report's figures share: colours, a calm style, lines with gaps, one time axis for all."""

from __future__ import annotations

from typing import Any

import numpy as np

from wheelsight.geometry import FloatArray
from wheelsight.pipeline.label_runs import runs
from wheelsight.pipeline.run_record import FrameRecord, RunRecord
from wheelsight.pipeline.summary import cold_frames
from wheelsight.report import _plotly as go
from wheelsight.report import _series as series

# Okabe and Ito's colours; these four also stand out from white and from near black.
BLUE, GREEN, VERMILLION, GREY = "#0072B2", "#009E73", "#D55E00", "#808080"
ORANGE, SKY, PURPLE = "#E69F00", "#56B4E9", "#CC79A7"
OLIVE = "#8F8300"  # Okabe and Ito's yellow, dark enough to be a line on white
YELLOW = "#F0E442"  # the same as it is, for bands
INK = "#1D2126"  # the page's; where the page is dark, its style sheet turns it light
# Each odometry keeps its colour wherever several are drawn together.
ODOMETRY_COLOURS = {"wheels": PURPLE, "features": BLUE, "dense": OLIVE, "own": OLIVE, "rectified": GREEN, "joined": INK}
DASHED = {"color": GREY, "width": 1.5, "dash": "dash"}
_AIR = 0.08  # of the longer side, around a path: enough for the words at its ends
_LEAST_EXTENT_M = 0.01
_GRID = "rgba(128,128,128,0.22)"
_AXIS = {
    "gridcolor": _GRID,
    "zeroline": False,
    "linecolor": _GRID,
    "showline": True,
    "ticks": "outside",
    "tickcolor": _GRID,
    "automargin": False,
    "title": {"font": {"size": 13}},
    "spikecolor": GREY,
    "spikethickness": 1,
    "spikedash": "solid",
}
_LAYOUT = {
    "font": {"family": "system-ui, sans-serif", "size": 13, "color": "#333333"},
    "paper_bgcolor": "rgba(0,0,0,0)",
    "plot_bgcolor": "rgba(0,0,0,0)",
    "hoverlabel": {"bgcolor": "#2b2f36", "bordercolor": "#2b2f36", "font": {"color": "#ffffff"}},
    "legend": {"orientation": "h", "x": 1, "xanchor": "right", "y": 1.0, "yanchor": "bottom"},
    "margin": {"l": 62, "r": 14, "t": 36, "b": 46},
    "xaxis": _AXIS,
    "yaxis": _AXIS,
}


def style(figure: go.Figure, height: int, **layout: Any) -> go.Figure:
    """`figure` in the report's style, `height` in px; its width is that of its place."""
    figure.update_layout(template=go.layout.Template(layout=_LAYOUT), height=height, **layout)
    return figure


def add_line(figure: go.Figure, x: FloatArray, y: FloatArray, **how: Any) -> None:
    """A line over time (N,) that keeps gaps and peaks however long it is, drawn as by `add_path`."""
    kept = series.keep_peaks(y)
    add_path(figure, np.stack([x[kept], y[kept]], axis=-1), **how)


def add_path(
    figure: go.Figure,
    path: FloatArray,
    *,
    name: str,
    line: dict[str, Any],
    hover: str,
    row: int | None = None,
    in_legend: bool = True,
) -> None:
    """A line through points (N, 2), broken at NaN; points without neighbours show as dots."""
    where = {} if row is None else {"row": row, "col": 1}
    text = {"name": name, "legendgroup": name, "hovertemplate": f"{name}: {hover}<extra></extra>"}
    figure.add_scatter(x=path[:, 0], y=path[:, 1], mode="lines", line=line, showlegend=in_legend, **text, **where)
    lone = series.alone(path.sum(axis=1))
    if lone.any():
        x, y = path[lone].T
        marker = {"size": line["width"] + 4, "color": line["color"]}
        figure.add_scatter(x=x, y=y, mode="markers", marker=marker, showlegend=False, **text, **where)


def add_area(figure: go.Figure, x: FloatArray, low: FloatArray, high: FloatArray, **how: Any) -> None:
    """What lies between two lines over time (N,), filled; open where either is NaN."""
    known = ~np.isnan(low + high)
    kept = np.union1d(series.keep_peaks(low), series.keep_peaks(high))
    outline = []
    for i, j, is_known in runs([str(found) for found in known[kept]]):
        part = kept[i:j]
        if is_known == "True":
            there_and_back = np.concatenate([x[part], x[part][::-1]]), np.concatenate([low[part], high[part][::-1]])
            outline += [np.stack(there_and_back, axis=-1), np.full((1, 2), np.nan)]
    closed = np.concatenate(outline) if outline else np.empty((0, 2))
    figure.add_scatter(x=closed[:, 0], y=closed[:, 1], mode="lines", line={"width": 0}, fill="toself", **how)


def room_around(points: FloatArray) -> tuple[list[float] | None, list[float] | None]:
    """Ranges of x and y that hold all points (N, 2) with some air, so that no line is cut; None without points."""
    if not len(points):
        return None, None
    low, high = points.min(axis=0), points.max(axis=0)
    air = _AIR * max(float((high - low).max()), _LEAST_EXTENT_M)
    return [low[0] - air, high[0] + air], [low[1] - air, high[1] + air]


def panel_title(figure: go.Figure, text: str, y: float = 1.0) -> None:
    """A panel's title at its upper left, `y` as a share of the figure's plotting height."""
    place = {"x": 0, "y": y, "xref": "paper", "yref": "paper", "xanchor": "left", "yanchor": "bottom"}
    figure.add_annotation(text=text, showarrow=False, yshift=3, **place)


def horizontal(figure: go.Figure, y: float, text: str) -> None:
    """A dashed line across the figure at `y`, labelled above its right end."""
    figure.add_shape(type="line", x0=0, x1=1, xref="paper", y0=y, y1=y, line=DASHED)
    figure.add_annotation(
        text=text, x=1, xref="paper", y=y, xanchor="right", yanchor="bottom", showarrow=False, font={"size": 11}
    )


def time_axis(figure: go.Figure, record: RunRecord) -> None:
    """The same time axis for every figure of a run, so that they can be compared by eye."""
    end_s = max(record.seconds_since_start([frame.stamp_s for frame in record.frames]), default=0.0)
    time_axis_until(figure, end_s, f"seconds since the first {record.unit}")


def time_axis_until(figure: go.Figure, end_s: float, title: str) -> None:
    """A time axis from 0 to `end_s` under all panels, its title below the lowest."""
    margin_s = 0.01 * end_s if end_s > 0 else 0.5
    figure.update_xaxes(range=[-margin_s, end_s + margin_s], hoverformat=".2f")
    figure.update_layout(margin_l=88)
    lowest = min(figure.select_xaxes(), key=lambda axis: 0 if axis.showticklabels is not False else 1)
    lowest.title.text = title


def used_frames(record: RunRecord) -> list[FrameRecord]:
    """The frames that odometry judged."""
    return [frame for frame in record.frames if not frame.is_skipped]


def warm_frames(record: RunRecord) -> list[FrameRecord]:
    """`used_frames` without the first ones, where kernels were still compiled or loaded."""
    cold = {frame.index for frame in cold_frames(record)}
    return [frame for frame in used_frames(record) if frame.index not in cold]
