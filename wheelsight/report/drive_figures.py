"""Figures of a drive: the map with its ways, and a time line of states and speeds."""

from __future__ import annotations

import base64

import cv2
import numpy as np

from wheelsight.geometry import FloatArray
from wheelsight.mapping import CellKind, OccupancyGrid
from wheelsight.mapping.occupancy_picture import COLOURS
from wheelsight.pipeline.drive_record import DriveRecord
from wheelsight.pipeline.label_runs import runs
from wheelsight.report import _drawing as drawing
from wheelsight.report import _plotly as go
from wheelsight.report import _series as series
from wheelsight.report._drawing import BLUE, GREEN, GREY, ORANGE, PURPLE, SKY, VERMILLION
from wheelsight.report._plotly import make_subplots

_PLAN_PX, _TIME_PX = 640, 460
_AROUND_M = 0.5
# Of who was followed without a break there is a row each 0.05 s; nobody walks farther in the longer time.
_SAME_WALKER_S, _SAME_WALKER_M = 0.5, 0.8
_BANDS = ("navigator", "localization", "monitor")
_BAND_COLOURS = {
    **{"idle": GREY, "planning": ORANGE, "driving": GREEN, "recovering": VERMILLION, "arrived": BLUE, "failed": PURPLE},
    **{"tracking": GREEN, "coasting": ORANGE, "initializing": SKY, "failing": VERMILLION, "lost": PURPLE},
    **{"free": GREEN, "slowed": ORANGE, "stopped": VERMILLION},
}


def plan_figure(record: DriveRecord) -> go.Figure:
    """The map from above, metres, equal aspect, with all plans, the way driven, stops, start and goals."""
    figure = drawing.style(go.Figure(), _PLAN_PX, hovermode="closest", showlegend=True)
    _add_map(figure, record.grid)
    hover = "%{x:.2f}, %{y:.2f} m"
    for number, (_, plan) in enumerate(record.plans):
        line = {"color": ORANGE, "width": 2}
        path = plan[series.keep_shape(plan[:, :2]), :2]
        drawing.add_path(figure, path, name="planned", line=line, hover=hover, in_legend=not number)
    path = record.rows.poses[:, :2]
    path = path[series.keep_shape(path)]
    if len(path):
        drawing.add_path(figure, path, name="driven", line={"color": BLUE, "width": 3}, hover=hover)
    for number, way in enumerate(walked(record.people)):
        line = {"color": SKY, "width": 2, "dash": "dot"}
        drawing.add_path(figure, way, name="somebody walked", line=line, hover=hover, in_legend=not number)
    known = record.rows.poses[np.isfinite(record.rows.poses).all(axis=1)]
    if len(known):
        _add_marks(figure, known[:1, :2], ["start"], "start", {"symbol": "circle", "color": GREEN})
    aims = [goal for goal in record.goals if goal.is_place]
    goals = np.array([goal.goal[:2] for goal in aims]).reshape(-1, 2)
    _add_marks(figure, goals, [goal.name for goal in aims], "goal", {"symbol": "square", "color": PURPLE})
    held = [stop for stop in record.stops if stop.pose is not None]
    places = np.array([stop.pose[:2] for stop in held if stop.pose is not None]).reshape(-1, 2)
    _add_marks(figure, places, [stop.reason for stop in held], "held", {"symbol": "x", "color": VERMILLION})
    figure.update_layout(plot_bgcolor="#ffffff")
    return figure


def time_line_figure(record: DriveRecord) -> go.Figure:
    """Bands of states, and speeds below; seconds since the begin."""
    rows, figure = record.rows, make_subplots(rows=3, cols=1, shared_xaxes=True, row_heights=[0.34, 0.36, 0.3])
    drawing.style(figure, _TIME_PX, hovermode="closest", showlegend=False)
    seconds = rows.stamps_s - record.begin_s
    for name, labels in zip(_BANDS, (rows.states, rows.status, rows.monitor), strict=True):
        reasons = rows.reasons if name == "monitor" else ("",) * len(labels)
        _add_band(figure, name, [*zip(labels, reasons, strict=True)], seconds)
    _add_speeds(figure, record, seconds)
    figure.update_layout(barmode="overlay")
    figure.update_yaxes(autorange="reversed", showgrid=False, row=1, col=1)
    drawing.time_axis_until(figure, record.time_s, "seconds since the begin")
    return figure


def walked(people: FloatArray) -> list[FloatArray]:
    """Ways (M, 2) of who walked near, of people (N, 4) as `DriveRecord` has them: each joins the way it is next to."""
    ways: list[list[FloatArray]] = []
    for row in people:
        lately = [way for way in ways if 0 < row[0] - way[-1][0] < _SAME_WALKER_S]
        way = min(lately, key=lambda way: np.hypot(*(row - way[-1])[1:3]), default=None)
        if way is not None and np.hypot(*(row - way[-1])[1:3]) < _SAME_WALKER_M:
            way.append(row)
        else:
            ways.append([row])
    return [np.array(way)[:, 1:3] for way in ways if len(way) > 1]


def apart(poses: FloatArray, apart_m: float) -> FloatArray:
    """(M, 3) of poses (N, 3): the first, and each that is so far from the last one kept, and the last."""
    kept: list[FloatArray] = []
    for pose in poses:
        if not kept or np.hypot(*(pose - kept[-1])[:2]) >= apart_m:
            kept.append(pose)
    if len(poses):
        kept.append(poses[-1])
    return np.array(kept).reshape(-1, 3)


def _add_band(figure: go.Figure, name: str, told: list[tuple[str, str]], seconds: FloatArray) -> None:
    """A bar a stretch of one label and reason; a trace a label."""
    words = [f"{label}: {reason}" if reason else label for label, reason in told]
    stretches = runs(words)
    for label in dict.fromkeys(label for label, _ in told):
        own = [(begin, end) for begin, end, _ in stretches if told[begin][0] == label]
        begin_s = np.array([seconds[begin] for begin, _ in own])
        for_s = np.array([seconds[min(end, len(seconds) - 1)] for _, end in own]) - begin_s
        figure.add_bar(
            x=for_s,
            y=[name] * len(own),
            base=begin_s,
            orientation="h",
            marker={"color": _BAND_COLOURS.get(label, GREY), "line": {"width": 0}},
            text=[label if length_s > 0.08 * seconds[-1] else "" for length_s in for_s],
            textposition="inside",
            insidetextanchor="middle",
            customdata=[words[begin] for begin, _ in own],
            hovertemplate="%{customdata}, from %{base:.1f} s for %{x:.1f} s<extra></extra>",
            row=1,
            col=1,
        )


def _add_speeds(figure: go.Figure, record: DriveRecord, seconds: FloatArray) -> None:
    rows = record.rows
    degrees = np.degrees(rows.turn_rad_s)
    for row, name, values, colour in (
        (2, "speed, m/s", rows.forward_m_s, BLUE),
        (3, "turn, °/s", degrees, PURPLE),
    ):
        line = {"color": colour, "width": 1.6}
        drawing.add_line(figure, seconds, values, name=name, line=line, hover="%{y:.2f}", row=row)
        figure.update_yaxes(range=_usual(values), row=row, col=1)
        axis = figure.layout[f"yaxis{row}"]
        drawing.panel_title(figure, name, y=axis.domain[1])


def _usual(values: FloatArray) -> list[float] | None:
    """Bounds of all values but the strangest hundredth, with 0 and some air: single readings would flatten the rest."""
    known = values[np.isfinite(values)]
    if not len(known):
        return None
    low, high = np.minimum(np.percentile(known, 0.5), 0.0), np.maximum(np.percentile(known, 99.5), 0.0)
    air = 0.1 * max(float(high - low), 0.1)
    return [float(low) - air, float(high) + air]


def _add_map(figure: go.Figure, grid: OccupancyGrid) -> None:
    """As an image below all lines; the axes show what of it is known."""
    colours = np.array([COLOURS[kind] for kind in CellKind], np.uint8)
    _, png = cv2.imencode(".png", np.ascontiguousarray(colours[grid.kind[::-1]][..., ::-1]))
    uri = "data:image/png;base64," + base64.b64encode(png.tobytes()).decode("ascii")
    (height, width), (left, bottom) = np.array(grid.kind.shape) * grid.resolution_m, grid.origin
    place = {"x": left, "y": bottom + height, "sizex": width, "sizey": height, "xref": "x", "yref": "y"}
    figure.add_layout_image(source=uri, layer="below", sizing="stretch", **place)
    cells = np.argwhere(grid.kind != CellKind.UNKNOWN)
    known = grid.middle_of(cells) if len(cells) else np.array([[left, bottom], [left + width, bottom + height]])
    (x0, y0), (x1, y1) = known.min(axis=0) - _AROUND_M, known.max(axis=0) + _AROUND_M
    figure.update_xaxes(range=[x0, x1], title_text="m", constrain="domain", showgrid=False)
    figure.update_yaxes(range=[y0, y1], scaleanchor="x", scaleratio=1, constrain="domain", showgrid=False)


def _add_marks(figure: go.Figure, points: FloatArray, texts: list[str], name: str, marker: dict[str, str]) -> None:
    if not len(points):
        return
    rim = {"size": 12, "line": {"color": "#ffffff", "width": 2}}
    figure.add_scatter(
        x=points[:, 0],
        y=points[:, 1],
        text=texts,
        mode="markers",
        name=name,
        marker={**marker, **rim},
        hovertemplate="%{text}: %{x:.2f}, %{y:.2f} m<extra></extra>",
    )
