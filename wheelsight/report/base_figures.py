"""Figures of a camera's mount: from above, the turns that told of it, the floor, and what stayed unexplained."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from wheelsight.geometry import BoolArray, FloatArray
from wheelsight.odometry.extrinsics import BaseCalibration
from wheelsight.odometry.wheels import drive_path
from wheelsight.report import _drawing as drawing
from wheelsight.report import _plotly as go
from wheelsight.report._drawing import BLUE, GREY, ORANGE, PURPLE, VERMILLION
from wheelsight.report._plotly import make_subplots

_RATE_STEP_S = 0.2
_LOOK_M = 0.3
_DEGREES = 180 / np.pi


@dataclass(frozen=True, eq=False)
class _Panel:
    """Values (N,) over time, in their unit."""

    name: str
    unit: str
    values: FloatArray


def mount_figure(found: BaseCalibration) -> go.Figure:
    """Axle, wheels and the camera as it was believed to sit and as it does, from above; x is drawn upwards."""
    figure = drawing.style(go.Figure(), 420, hovermode="closest", margin={"l": 88, "r": 12, "t": 34, "b": 46})
    half_m, radius_m = found.wheels.track_width_m / 2, found.wheels.left_radius_m
    for side_m in (half_m, -half_m):
        wheel = np.array([[-side_m, -radius_m], [-side_m, radius_m]])
        _line(figure, wheel, "wheel", {"color": GREY, "width": 9})
    _line(figure, np.array([[-half_m, 0.0], [half_m, 0.0]]), "axle", {"color": GREY, "width": 2})
    if found.nominal.T_base_camera is not None:
        _camera(figure, found.nominal.T_base_camera, "nominal", ORANGE)
    _camera(figure, found.T_base_camera, "calibrated", BLUE)
    figure.update_xaxes(title_text="left and right of the middle", tickvals=[])
    figure.update_yaxes(title_text="x, m: ahead of the axle", scaleanchor="x", scaleratio=1)
    return figure


def turning_figure(found: BaseCalibration) -> go.Figure:
    """Turn rates by the wheels, their delay taken off, and by the camera about the axis found, degrees a second."""
    camera = found.sightings.camera
    marks = np.arange(camera.stamps_s[0], camera.stamps_s[-1], _RATE_STEP_S)
    cuts = np.unique(np.searchsorted(camera.stamps_s, marks))
    stamps_s, T_odom_camera = camera.stamps_s[cuts], camera.T_frame_body[cuts]
    yaw_camera = _heading(T_odom_camera[:, :3, :3] @ _heading_frame(found))
    path = drive_path(found.sightings.drive, found.fit.wheels, stamps_s).T_frame_body
    figure = drawing.style(go.Figure(), 300, hovermode="x unified")
    middle_s = (stamps_s[1:] + stamps_s[:-1]) / 2 - found.sightings.span_s[0]
    for name, yaw, line in (
        ("wheels", _heading(path[:, :3, :3]), {"color": PURPLE, "width": 4}),
        ("camera", yaw_camera, {"color": BLUE, "width": 1.5}),
    ):
        rates = _DEGREES * np.diff(yaw) / np.diff(stamps_s)
        rates[np.diff(stamps_s) > 3 * _RATE_STEP_S] = np.nan
        drawing.add_line(figure, middle_s, rates, name=name, line=line, hover="%{y:.1f}°/s")
    drawing.time_axis_until(figure, float(middle_s[-1]), "seconds since the first frame")
    drawing.panel_title(figure, "turn rate, °/s, left is positive")
    return figure


def floor_figure(found: BaseCalibration) -> go.Figure:
    """Roll, pitch and height by the floor of each view alone, less those of all together."""
    off = found.floor.tilts - [found.values[name] for name in ("roll", "pitch", "height")]
    panels = (
        _Panel("roll", "°", _DEGREES * off[:, 0]),
        _Panel("pitch", "°", _DEGREES * off[:, 1]),
        _Panel("height", "mm", 1e3 * off[:, 2]),
    )
    stamps_s = found.floor.stamps_s - found.sightings.span_s[0]
    return _dots(stamps_s, panels, np.zeros(len(stamps_s), bool), ("a view", ""))


def residual_figure(found: BaseCalibration) -> go.Figure:
    """What wheels and mount left of each piece of the camera's way; slips stand out."""
    fit = found.fit
    along, across, turn = fit.residuals.T
    panels = (
        _Panel("along the way", "mm", 1e3 * along),
        _Panel("across", "mm", 1e3 * across),
        _Panel("turn", "°", _DEGREES * turn),
    )
    middle_s = (fit.segments.start_s + fit.segments.end_s) / 2 - found.sightings.span_s[0]
    return _dots(middle_s, panels, fit.is_slip, ("a piece", "slip or jump, hardly counted"))


def _dots(stamps_s: FloatArray, panels: Sequence[_Panel], is_off: BoolArray, kinds: tuple[str, str]) -> go.Figure:
    figure = make_subplots(rows=len(panels), cols=1, shared_xaxes=True, vertical_spacing=0.1)
    drawing.style(figure, 170 * len(panels), hovermode="closest", margin_l=88)
    for row, panel in enumerate(panels, start=1):
        limit = 1.15 * max(float(np.abs(panel.values[~is_off]).max(initial=0.0)), 1e-3)
        for kind, which, color, symbol in zip(
            kinds, (~is_off, is_off), (BLUE, VERMILLION), ("circle", "x"), strict=True
        ):
            figure.add_scatter(
                x=stamps_s[which],
                y=panel.values[which].clip(-limit, limit),
                customdata=panel.values[which],
                mode="markers",
                marker={"size": 6, "color": color, "symbol": symbol},
                name=kind,
                legendgroup=kind,
                showlegend=row == 1 and bool(which.any()),
                hovertemplate=f"%{{x:.1f}} s: %{{customdata:.2f}} {panel.unit}<extra>{kind}</extra>",
                row=row,
                col=1,
            )
        figure.update_yaxes(range=[-1.08 * limit, 1.08 * limit], row=row, col=1)
        top = figure.layout[f"yaxis{row if row > 1 else ''}"].domain[1]
        drawing.panel_title(figure, f"{panel.name}, {panel.unit}", y=top)
        figure.add_hline(y=0, line=drawing.DASHED, row=row, col=1)
    figure.update_xaxes(title_text="seconds since the first frame", row=len(panels), col=1)
    return figure


def _camera(figure: go.Figure, T_base_camera: FloatArray, name: str, color: str) -> None:
    """A wedge at the camera's place that opens to where it looks."""
    x, y = T_base_camera[:2, 3]
    ahead = T_base_camera[:2, 2]
    yaw = np.arctan2(ahead[1], ahead[0])
    corners = [(x, y)]
    corners += [(x + _LOOK_M * np.cos(yaw + side), y + _LOOK_M * np.sin(yaw + side)) for side in (0.35, -0.35)]
    outline = np.array([(-left, forward) for forward, left in [*corners, corners[0]]])
    figure.add_scatter(
        x=outline[:, 0],
        y=outline[:, 1],
        mode="lines",
        fill="toself",
        line={"color": color, "width": 2},
        opacity=0.55,
        name=name,
        hoveron="fills",
        text=f"{name}: x {x:.3f} m, y {y:.3f} m, yaw {np.degrees(yaw):.2f}°",
        hoverinfo="text",
    )


def _line(figure: go.Figure, points: FloatArray, name: str, line: dict[str, object]) -> None:
    figure.add_scatter(
        x=points[:, 0], y=points[:, 1], mode="lines", line=line, name=name, showlegend=False, hoverinfo="name"
    )


def _heading_frame(found: BaseCalibration) -> FloatArray:
    """R_camera_base (3, 3)."""
    return np.asarray(found.T_base_camera[:3, :3].T)


def _heading(R_odom_base: FloatArray) -> FloatArray:
    """Unwrapped yaw (N,) of rotations (N, 3, 3), about the first one's z axis."""
    R = R_odom_base[0].T @ R_odom_base
    return np.unwrap(np.arctan2(R[:, 1, 0], R[:, 0, 0]))
