"""The common style of all figures: colours, one time axis. Lines over time have gaps where values are unknown, and long
lines are thinned.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from wheelsight.app.run.run_record import FrameRecord, RunRecord
from wheelsight.app.run.verdict import cold_frames
from wheelsight.core.geometry import BoolArray, FloatArray, IntArray
from wheelsight_report import plotly as go

# Okabe and Ito's colours; these four also stand out from white and from near black.
BLUE, GREEN, VERMILLION, GREY = "#0072B2", "#009E73", "#D55E00", "#808080"
ORANGE, SKY, PURPLE = "#E69F00", "#56B4E9", "#CC79A7"
LAVENDER = "#9F8FD6"
BROWN = "#7A4B1E"
OLIVE = "#8F8300"  # Okabe and Ito's yellow, dark enough to be a line on white
YELLOW = "#F0E442"  # the same as it is, for bands
INK = "#1D2126"  # the page's; where the page is dark, its style sheet turns it light
# Each odometry keeps its colour wherever several are drawn together.
ODOMETRY_COLOURS = {"wheels": PURPLE, "features": BLUE, "dense": OLIVE, "own": BROWN, "rectified": GREEN, "joined": INK}
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
    kept = keep_peaks(y)
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
    lone = alone(path.sum(axis=1))
    if lone.any():
        x, y = path[lone].T
        marker = {"size": line["width"] + 4, "color": line["color"]}
        figure.add_scatter(x=x, y=y, mode="markers", marker=marker, showlegend=False, **text, **where)


def room_around(points: FloatArray) -> tuple[list[float] | None, list[float] | None]:
    """Ranges of x and y that hold all points (N, 2) with a margin; None without points."""
    if not len(points):
        return None, None
    low, high = points.min(axis=0), points.max(axis=0)
    air = _AIR * max(float((high - low).max()), _LEAST_EXTENT_M)
    return [low[0] - air, high[0] + air], [low[1] - air, high[1] + air]


def map_figure(height: int, axes: tuple[str, str] = ("x, m", "y, m"), left: int = 58) -> go.Figure:
    """An empty figure of a plane with equal aspect; `left` is its margin in px."""
    figure = style(go.Figure(), height, hovermode="closest", margin={"l": left, "r": 12, "t": 34, "b": 46})
    figure.update_xaxes(title_text=axes[0])
    figure.update_yaxes(title_text=axes[1], scaleanchor="x", scaleratio=1)
    return figure


def panel_title(figure: go.Figure, text: str, row: int | None = None) -> None:
    """A title at the upper left of the panel in `row`, from 1, or of a figure with one panel."""
    y = 1.0 if row is None else figure.layout[f"yaxis{row if row > 1 else ''}"].domain[1]
    place = {"x": 0, "y": y, "xref": "paper", "yref": "paper", "xanchor": "left", "yanchor": "bottom"}
    figure.add_annotation(text=text, showarrow=False, yshift=3, **place)


def horizontal(figure: go.Figure, y: float, text: str) -> None:
    """A dashed line across the figure at `y`, labelled above its right end."""
    figure.add_shape(type="line", x0=0, x1=1, xref="paper", y0=y, y1=y, line=DASHED)
    figure.add_annotation(
        text=text, x=1, xref="paper", y=y, xanchor="right", yanchor="bottom", showarrow=False, font={"size": 11}
    )


def time_axis(figure: go.Figure, record: RunRecord) -> None:
    """The common time axis of all figures of a run."""
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
    """The frames that odometry processed."""
    return [frame for frame in record.frames if not frame.is_skipped]


def warm_frames(record: RunRecord) -> list[FrameRecord]:
    """`used_frames` without the first ones, where kernels were still compiled or loaded."""
    cold = {frame.index for frame in cold_frames(record)}
    return [frame for frame in used_frames(record) if frame.index not in cold]


DRAWN_POINTS = 4000
_SAME_STAMP_S = 1e-3  # stamps of one frame in two files differ by no more than their last decimal


def poseless_stamps_s(record: RunRecord) -> FloatArray:
    """Ascending stamps (K,) of frames without a pose, which leave gaps in the trajectory.

    Repeated images do not count.
    """
    frames = [frame for frame in record.frames if not frame.is_repeat]
    stamps_s = np.array([frame.stamp_s for frame in frames], float)
    pose_s = np.array([frame.pose_s for frame in frames], float)
    known_s = record.estimate.stamps_s
    if len(known_s) == 0:
        return np.sort(stamps_s)
    after = np.searchsorted(known_s, pose_s).clip(0, len(known_s) - 1)
    nearest_s = np.minimum(abs(known_s[after] - pose_s), abs(known_s[(after - 1).clip(0)] - pose_s))
    return np.sort(stamps_s[nearest_s > _SAME_STAMP_S])


def with_gaps(stamps_s: FloatArray, values: FloatArray, breaks_s: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Stamps (N,) and values (N, ...) with a row of NaN wherever one of `breaks_s` (K,) lies between two stamps."""
    stamps_s, values = np.asarray(stamps_s, float), np.asarray(values, float)
    if len(stamps_s) < 2:
        return stamps_s, values
    broken = np.flatnonzero(np.diff(np.searchsorted(breaks_s, stamps_s)) > 0)
    middle_s = (stamps_s[broken] + stamps_s[broken + 1]) / 2
    return np.insert(stamps_s, broken + 1, middle_s), np.insert(values, broken + 1, np.nan, axis=0)


def keep_peaks(values: FloatArray, limit: int = DRAWN_POINTS) -> IntArray:
    """Indices of at most about `limit` of (N,) values: the least, the greatest and a gap of each bucket in time."""
    n = len(values)
    if n <= limit:
        return np.arange(n)
    bucket = np.arange(n) * (limit // 3) // n
    order = np.lexsort((values, bucket))  # NaN sorts last
    first = np.flatnonzero(np.diff(bucket, prepend=-1))
    known = np.bincount(bucket, weights=~np.isnan(values)).astype(int)
    lowest = order[first]
    highest = order[first + np.maximum(known, 1) - 1]
    last = order[np.append(first[1:], n) - 1]
    return np.unique(np.concatenate([[0, n - 1], lowest, highest, last]))


def keep_shape(path: FloatArray, limit: int = DRAWN_POINTS) -> IntArray:
    """Indices of at most about `limit` points of a path (N, D): the extremes of each stretch, and the ends of gaps."""
    n, coordinates = path.shape
    if n <= limit:
        return np.arange(n)
    gap = np.flatnonzero(np.isnan(path).any(axis=1))
    if len(gap) > limit:
        gap = gap[:: len(gap) // limit + 1]
    extremes = [keep_peaks(column, limit // coordinates) for column in path.T]
    return np.unique(np.concatenate([*extremes, gap, (gap - 1).clip(0), (gap + 1).clip(0, n - 1)]))


def alone(values: FloatArray) -> BoolArray:
    """Which of (N,) values have no known neighbour, so that a line would not show them."""
    known = ~np.isnan(values)
    before, after = np.roll(known, 1), np.roll(known, -1)
    before[:1], after[-1:] = False, False
    return known & ~before & ~after


# Areas are labelled by number and name too. Neighbours among the first eight differ as much as possible.
AREA_COLOURS = (
    "#0072B2",
    "#E69F00",
    "#009E73",
    "#CC79A7",
    "#56B4E9",
    "#D55E00",
    "#8E63B5",
    "#B8A800",
    "#6B4F3A",
    "#2F9E9E",
    "#C25B5B",
    "#7A869A",
)


def area_colour(index: int) -> str:
    """The colour of an area by its index; after twelve they begin again."""
    return AREA_COLOURS[index % len(AREA_COLOURS)]
