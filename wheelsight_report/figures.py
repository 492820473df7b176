"""The plotly figures of a run, for the page, a paper or a notebook. Backgrounds are transparent. Time is in seconds
since the first frame. Unknown values are left out.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from wheelsight.app.run import words
from wheelsight.app.run.run_record import RunRecord
from wheelsight.app.run.verdict import SKIPPED, runs, summarise
from wheelsight.core.errors import EvaluationError
from wheelsight.core.estimates import Status
from wheelsight.core.geometry import FloatArray
from wheelsight.core.trajectory import Trajectory
from wheelsight.evaluation import position_covariances_m2
from wheelsight_report import drawing
from wheelsight_report import plotly as go
from wheelsight_report.drawing import (
    BLUE,
    GREEN,
    GREY,
    LAVENDER,
    ORANGE,
    SKY,
    VERMILLION,
    YELLOW,
    keep_shape,
    poseless_stamps_s,
    with_gaps,
)
from wheelsight_report.plotly import make_subplots

STATUS_COLOURS = {
    Status.TRACKING.value: GREEN,
    Status.COASTING.value: YELLOW,
    Status.INITIALIZING.value: SKY,
    Status.UNCONFIRMED.value: LAVENDER,
    Status.FAILING.value: ORANGE,
    Status.LOST.value: VERMILLION,
    SKIPPED: GREY,
}
VIEWS = {"xy": (0, 1), "xz": (0, 2), "yz": (1, 2)}
_LEAST_WIDTH = 0.006  # of the time axis: shorter spans are drawn this wide, so that a single frame can be seen
_TIME_HEADROOM = 1.3  # times the 99th percentile: slower frames are marked at the upper edge


def trajectory_figure(record: RunRecord, view: str = "xy") -> go.Figure:
    """The path in one view ("xy", "xz" or "yz"), metres, equal aspect, over the ground truth.

    With an evaluation the estimate is aligned to the truth. Without one it is alone in its own frame, since a
    comparison of paths in different frames is meaningless. Gaps have no known pose.
    """
    height = 520 if record.is_planar else 380
    figure = drawing.map_figure(height, (f"{view[0]}, m", f"{view[1]}, m"))
    hover = f"{view[0]} %{{x:.3f}}, {view[1]} %{{y:.3f}} m"
    paths = {"estimate": (estimated_path_m(record), {"color": BLUE, "width": 2})}
    if record.evaluation is not None and record.ground_truth is not None:
        paths = {"ground truth": (truth_path_m(record), {"color": GREY, "width": 4}), **paths}
    drawn = np.empty((0, 2))
    for name, (positions_m, line) in paths.items():
        path = positions_m[:, VIEWS[view]]
        path = path[keep_shape(path)]
        drawing.add_path(figure, path, name=name, line=line, hover=hover)
        known = path[~np.isnan(path).any(axis=1)]
        drawn = np.concatenate([drawn, known])
    # A ring at the start and a square at the end, with labels on opposite sides
    if len(known):
        places = ("top", "bottom") if known[0, 1] >= known[-1, 1] else ("bottom", "top")
        ends = (("start", known[0], "circle-open"), ("end", known[-1], "square"))
        for (name, point, symbol), place in zip(ends, places, strict=True):
            marker = {"symbol": symbol, "size": 11, "color": VERMILLION, "line": {"width": 3 if name == "start" else 0}}
            figure.add_scatter(
                x=point[:1],
                y=point[1:],
                mode="markers+text",
                name=name,
                text=[name],
                marker=marker,
                textposition=f"{place} center",
                showlegend=False,
                hoverinfo="skip",
            )
    x_range, y_range = drawing.room_around(drawn)
    figure.update_xaxes(range=x_range)
    figure.update_yaxes(range=y_range)
    return figure


def error_figure(record: RunRecord) -> go.Figure:
    """Over time: ATE of each pose, and translation and rotation of the RPE of each frame.

    Raises:
        EvaluationError: the run has no evaluation.
    """
    if record.evaluation is None:
        raise EvaluationError(record.evaluation_problem or "the run was not evaluated")
    evaluation = record.evaluation
    # Name, unit, stamps (M,) and errors (M,) of each panel
    panels = [("ATE", "m", evaluation.ate.stamps_s, evaluation.ate.errors_m)]
    per_frame = evaluation.rpe_per_frame
    if per_frame is None:
        lines = panels
    else:
        lines = [
            *panels,
            (f"RPE a {record.unit}, translation", "m", per_frame.end_s, per_frame.errors_m),
            (f"RPE a {record.unit}, rotation", "°", per_frame.end_s, np.degrees(per_frame.errors_rad)),
        ]
    breaks_s = poseless_stamps_s(record)
    figure = make_subplots(rows=len(lines), cols=1, shared_xaxes=True, vertical_spacing=0.11)
    drawing.style(figure, 80 + 160 * len(lines), hovermode="x unified", showlegend=False)
    for row, (name, unit, stamps_s, errors) in enumerate(lines, start=1):
        x, y = with_gaps(stamps_s, errors, breaks_s)
        x = record.seconds_since_start(x)
        line = {"color": VERMILLION if row == 1 else BLUE, "width": 1.5}
        drawing.add_line(figure, x, y, name=name, line=line, hover=f"%{{y:.4f}} {unit}", row=row)
        drawing.panel_title(figure, f"{name}, {unit}", row)
    figure.update_yaxes(rangemode="tozero")
    drawing.time_axis(figure, record)
    return figure


def certainty_figure(record: RunRecord, colour: str | None = None) -> go.Figure:
    """Standard deviations of position and yaw over time, of a planar estimate with covariances."""
    figure = make_subplots(rows=2, cols=1, shared_xaxes=True, vertical_spacing=0.11)
    drawing.style(figure, 360, hovermode="x unified", showlegend=False)
    x = record.seconds_since_start(record.estimate.stamps_s)
    panels = zip(("σ of position, m", "σ of yaw, °"), standard_deviations(record.estimate), strict=True)
    for row, (name, sigmas) in enumerate(panels, start=1):
        line = {"color": colour or (VERMILLION if row == 1 else BLUE), "width": 1.5}
        drawing.add_line(figure, x, sigmas, name=name, line=line, hover="%{y:.4f}", row=row)
        drawing.panel_title(figure, name, row)
    figure.update_yaxes(rangemode="tozero")
    drawing.time_axis(figure, record)
    return figure


def standard_deviations(estimate: Trajectory) -> tuple[FloatArray, FloatArray]:
    """σ (N,) of the position along its worst direction in the plane, metres, and of the yaw, degrees."""
    assert estimate.covariances is not None
    position = np.linalg.eigvalsh(position_covariances_m2(estimate)[:, :2, :2])[:, -1]
    return np.sqrt(position.clip(0)), np.degrees(np.sqrt(estimate.covariances[:, 5, 5].clip(0)))


def status_figure(record: RunRecord) -> go.Figure:
    """The status of each frame over time, one lane a status; skipped frames have a lane unless lost."""
    labels = status_labels(record)
    starts_s, ends_s = record.frame_spans_s()
    lanes = [lane for lane in STATUS_COLOURS if lane in labels or lane == Status.TRACKING]
    figure = drawing.style(go.Figure(), 84 + 26 * len(lanes), hovermode="closest", showlegend=False)
    for lane in lanes:
        add_band(figure, record, lane, labels, starts_s, ends_s, y=lane, line={"color": STATUS_COLOURS[lane]})
    order = {"categoryorder": "array", "categoryarray": lanes[::-1], "range": [-0.6, len(lanes) - 0.4]}
    figure.update_yaxes(showgrid=False, **order)
    figure.update_layout(margin_t=12)
    drawing.time_axis(figure, record)
    return figure


def status_labels(record: RunRecord) -> list[str]:
    """The status of each frame, or that it was skipped, unless it was lost anyway, or other sensors gave the pose."""
    return [
        SKIPPED if frame.is_skipped and not (record.is_joined or frame.status == Status.LOST) else str(frame.status)
        for frame in record.frames
    ]


def add_band(
    figure: go.Figure,
    record: RunRecord,
    label: str,
    labels: list[str],
    starts_s: FloatArray,
    ends_s: FloatArray,
    *,
    y: str,
    line: dict[str, Any],
    **how: Any,
) -> None:
    """A band at height `y` for the time in which frames have `label`; short spans are widened to be visible."""
    least_s = _LEAST_WIDTH * float(ends_s[-1]) if labels else 0.0
    spans = [(starts_s[i], ends_s[j - 1], j - i) for i, j, found in runs(labels) if found == label]
    x = [value for a, b, _ in spans for value in (a, max(b, a + least_s), None)]
    text = [t for a, b, n in spans for t in (f"{a:.2f} to {b:.2f} s, {words.count(n, record.unit)}",) * 2 + ("",)]
    figure.add_scatter(
        x=x,
        y=[y] * len(x),
        mode="lines",
        name=label,
        line={"width": 16, **line},
        text=text,
        hovertemplate=f"{label}: %{{text}}<extra></extra>",
        **how,
    )


def matches_figure(record: RunRecord) -> go.Figure:
    """Number of matches of each frame with its reference, and number of inliers."""
    figure = drawing.style(go.Figure(), 270, hovermode="x unified")
    x = record.seconds_since_start([frame.stamp_s for frame in record.frames])
    for name, colour in (("matches", GREY), ("inliers", GREEN)):
        counts = np.array([np.nan if frame.is_skipped else getattr(frame, name) for frame in record.frames], float)
        line = {"color": colour, "width": 1.5}
        drawing.add_line(figure, x, counts, name=name, line=line, hover="%{y:.0f}")
    figure.update_yaxes(rangemode="tozero")
    drawing.panel_title(figure, "points")
    drawing.time_axis(figure, record)
    return figure


def time_figure(record: RunRecord, colour: str = BLUE) -> go.Figure:
    """Processing time of each frame, ms; frames far slower than the rest are marked at the upper edge.

    First frames that compile kernels are left out.
    """
    figure = drawing.style(go.Figure(), 270, hovermode="closest", showlegend=False)
    frames = drawing.warm_frames(record)
    x = record.seconds_since_start([frame.stamp_s for frame in frames])
    ms = np.array([1e3 * frame.seconds for frame in frames], float)
    top = _time_ceiling_ms(ms)
    above, line = ms > top, {"color": colour, "width": 1.5}
    drawing.add_line(figure, x, np.where(above, top, ms), name="time a frame", line=line, hover="%{y:.1f} ms")
    if above.any():
        marker = {"symbol": "triangle-up", "size": 9, "color": VERMILLION}
        figure.add_scatter(
            x=x[above],
            y=np.full(above.sum(), 0.97 * top),
            mode="markers",
            name="slower than shown",
            marker=marker,
            customdata=ms[above],
            hovertemplate="%{customdata:.0f} ms<extra></extra>",
        )
    period_ms = 1e3 * summarise(record).frame_period_s
    if 0 < period_ms < 0.95 * top:
        drawing.horizontal(figure, period_ms, f"a new frame every {period_ms:.0f} ms")
    figure.update_yaxes(range=[0, top])
    drawing.panel_title(figure, "time a frame, ms")
    drawing.time_axis(figure, record)
    return figure


def time_histogram_figure(record: RunRecord, colour: str = BLUE) -> go.Figure:
    """Histogram of the processing times, ms, with the median and the 95th percentile; as in `time_figure`."""
    figure = drawing.style(go.Figure(), 270, hovermode="closest", showlegend=False, bargap=0.08)
    all_ms, ms = (
        np.array([1e3 * frame.seconds for frame in frames if np.isfinite(frame.seconds)], float)
        for frames in (drawing.used_frames(record), drawing.warm_frames(record))
    )
    top = _time_ceiling_ms(ms)
    counts, edges = np.histogram(ms, bins=40, range=(0, top))
    figure.add_bar(
        x=(edges[:-1] + edges[1:]) / 2,
        y=counts,
        marker_color=colour,
        name="frames",
        hovertemplate="%{y} frames at %{x:.1f} ms<extra></extra>",
    )
    for percent, name, height in ((50, "median", 1.0), (95, "95 %", 0.88)) if len(ms) else ():
        at = float(np.percentile(all_ms, percent))
        side = "right" if at > 0.7 * top else "left"
        figure.add_shape(type="line", x0=at, x1=at, y0=0, y1=height, yref="paper", line=drawing.DASHED)
        figure.add_annotation(
            text=f"{name} {words.number(at)}",
            x=at,
            y=height,
            yref="paper",
            xanchor=side,
            yanchor="bottom",
            showarrow=False,
            font={"size": 12},
        )
    figure.update_xaxes(title_text="time a frame, ms", range=[0, top], showgrid=False)
    figure.update_yaxes(title_text="frames")
    return figure


def stage_figure(record: RunRecord, colour: str = BLUE) -> go.Figure:
    """The median time of each stage of a frame, ms, in the order they run."""
    names = list(record.stage_seconds)
    ms = np.array([1e3 * seconds for seconds in record.stage_seconds.values()], float)
    figure = drawing.style(go.Figure(), 90 + 32 * len(names), hovermode="closest", showlegend=False, bargap=0.35)
    figure.add_bar(
        x=ms,
        y=names,
        orientation="h",
        marker_color=colour,
        text=[words.number(value) for value in ms],
        textposition="outside",
        cliponaxis=False,
        name="median time",
        hovertemplate="%{y}: %{x:.2f} ms<extra></extra>",
    )
    figure.update_xaxes(title_text="median time a frame, ms", rangemode="tozero")
    figure.update_yaxes(categoryorder="array", categoryarray=names[::-1], showgrid=False, automargin=True)
    figure.update_layout(margin={"r": 56, "t": 12})
    return figure


def estimated_path_m(record: RunRecord) -> FloatArray:
    """The estimate's positions (N, 3), aligned to the truth if evaluated, with rows of NaN at gaps."""
    path = record.estimate if record.evaluation is None else record.evaluation.ate.aligned
    return with_gaps(path.stamps_s, path.positions_m, poseless_stamps_s(record))[1]


def truth_path_m(record: RunRecord) -> FloatArray:
    """True positions (N, 3) during the run, with rows of NaN at gaps."""
    assert record.ground_truth is not None
    stamps_s = [frame.stamp_s for frame in record.frames]
    truth = record.ground_truth.between(min(stamps_s), max(stamps_s)) if stamps_s else record.ground_truth
    steps_s = np.diff(truth.stamps_s)
    holes = np.flatnonzero(steps_s > max(1.0, 10 * float(np.median(steps_s)))) if len(steps_s) else np.arange(0)
    return with_gaps(truth.stamps_s, truth.positions_m, truth.stamps_s[holes] + 1e-3)[1]


def _time_ceiling_ms(ms: FloatArray) -> float:
    """Upper limit of drawn times: the maximum, unless a few are far above the rest."""
    known = ms[np.isfinite(ms)]
    if not len(known) or known.max() <= 0:
        return 1.0
    return float(min(1.15 * known.max(), _TIME_HEADROOM * np.percentile(known, 99)))
