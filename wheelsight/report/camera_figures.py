"""Figures of a camera calibration: where boards were seen, and what is left, by distance and by place in the image."""

from __future__ import annotations

import numpy as np

from wheelsight.camera_calibration.result import CameraCalibration
from wheelsight.depth_error import DepthError
from wheelsight.geometry import FloatArray, PinholeCamera
from wheelsight.report import _drawing as drawing
from wheelsight.report import _plotly as go
from wheelsight.report._drawing import BLUE, GREY, ORANGE, VERMILLION
from wheelsight.report._plotly import make_subplots
from wheelsight.report.camera_tables import bands

_MOST_POINTS, _ARROWS_TIMES = 4000, 60
_ACROSS, _DOWN = 16, 12


def coverage_figure(found: CameraCalibration) -> go.Figure:
    """The outlines of all boards in the colour image, and what each corner is off, times 60."""
    figure = drawing.style(go.Figure(), 460, hovermode="closest")
    columns, rows = found.board.columns, found.board.rows
    ring = [0, columns - 1, rows * columns - 1, (rows - 1) * columns, 0]
    for view in found.views:
        places = dict(zip(view.corners.ids.tolist(), view.corners.px.tolist(), strict=True))
        line = np.array([places[k] for k in ring if k in places]).reshape(-1, 2)
        figure.add_scatter(
            x=line[:, 0], y=line[:, 1], mode="lines", line={"color": GREY, "width": 1}, name=view.name,
            showlegend=False, hovertemplate=f"{view.name}: {view.distance_m:.2f} m<extra></extra>",
        )  # fmt: skip
    every = max(len(found.color_residuals.px) // _MOST_POINTS, 1)
    px, off = found.color_residuals.px[::every], found.color_residuals.off_px[::every]
    ends = np.stack([px, px + _ARROWS_TIMES * off, np.full_like(px, np.nan)], axis=1).reshape(-1, 2)
    figure.add_scatter(
        x=ends[:, 0], y=ends[:, 1], mode="lines", line={"color": BLUE, "width": 1},
        name=f"predicted less seen, × {_ARROWS_TIMES}", hoverinfo="skip",
    )  # fmt: skip
    _image_axes(figure, found.color)
    return figure


def distance_figure(found: CameraCalibration) -> go.Figure:
    """Depth less the plane's over distance, before and after, as means and scatter of bands."""
    figure = drawing.style(go.Figure(), 340, hovermode="closest")
    depth = found.depth_residuals
    every = max(len(depth.off_m) // _MOST_POINTS, 1)
    for name, off_m, color in (("before", depth.before_m, ORANGE), ("after", depth.off_m, BLUE)):
        figure.add_scatter(
            x=depth.depth_m[::every], y=1e3 * off_m[::every], mode="markers", name=name, legendgroup=name,
            marker={"size": 3, "color": color, "opacity": 0.35}, hovertemplate="%{x:.2f} m: %{y:.1f} mm<extra></extra>",
        )  # fmt: skip
        middles = [float(np.median(depth.depth_m[inside])) for _, _, inside in bands(depth)]
        means = [1e3 * float(off_m[inside].mean()) for _, _, inside in bands(depth)]
        figure.add_scatter(
            x=middles, y=means, mode="lines+markers", name=f"{name}, mean", legendgroup=name, showlegend=False,
            line={"color": color, "width": 2}, hovertemplate="%{x:.2f} m: mean %{y:.1f} mm<extra></extra>",
        )  # fmt: skip
    figure.add_hline(y=0, line=drawing.DASHED)
    figure.update_xaxes(title_text="distance of the board's plane, m")
    drawing.panel_title(figure, "depth less the plane's, mm")
    return figure


def region_figure(found: CameraCalibration) -> go.Figure:
    """Mean depth error over the image, before and after, mm, in cells that boards were seen in."""
    camera = found.depth or found.color
    figure = make_subplots(rows=1, cols=2, shared_yaxes=True, horizontal_spacing=0.04)
    drawing.style(figure, 360, hovermode="closest")
    depth = found.depth_residuals
    maps = [_means(depth.px, 1e3 * off_m, camera) for off_m in (depth.before_m, depth.off_m)]
    limit = max(float(np.nanmax(np.abs(maps))) if np.isfinite(maps).any() else 1.0, 0.1)
    for column, values in enumerate(maps, start=1):
        figure.add_heatmap(
            z=values, x=_middles(camera.width, _ACROSS), y=_middles(camera.height, _DOWN), zmin=-limit, zmax=limit,
            colorscale="RdBu", showscale=column == 2, colorbar={"title": "mm"},
            hovertemplate="%{x:.0f}, %{y:.0f} px: %{z:.1f} mm<extra></extra>", row=1, col=column,
        )  # fmt: skip
    figure.update_yaxes(autorange="reversed")
    for name, x in (("before", 0.0), ("after", 0.52)):
        figure.add_annotation(
            text=name, x=x, y=1, xref="paper", yref="paper", xanchor="left", yanchor="bottom", showarrow=False
        )
    return figure


def views_figure(found: CameraCalibration) -> go.Figure:
    """RMS of each view's corners over its distance."""
    figure = drawing.style(go.Figure(), 300, hovermode="closest")
    rms = found.color_residuals.of_views(len(found.views))
    usual = float(np.median(rms))
    figure.add_scatter(
        x=[view.distance_m for view in found.views], y=rms, mode="markers", text=[view.name for view in found.views],
        marker={"size": 8, "color": np.where(rms > 2 * usual, VERMILLION, BLUE)}, showlegend=False,
        hovertemplate="%{text}: %{x:.2f} m, %{y:.3f} px<extra></extra>",
    )  # fmt: skip
    figure.update_xaxes(title_text="distance of the board, m")
    figure.update_yaxes(rangemode="tozero")
    drawing.panel_title(figure, "corners' RMS, px")
    return figure


def correction_figure(error: DepthError, camera: PinholeCamera, near_m: float, far_m: float) -> go.Figure:
    """What is added to depth over distance: in the image's middle, and at a third of the way to two corners."""
    figure = drawing.style(go.Figure(), 320, hovermode="x unified")
    depth_m = np.linspace(near_m, far_m, 120)
    for name, share, color in (("middle", 0.5, BLUE), ("upper left", 0.17, ORANGE), ("lower right", 0.83, VERMILLION)):
        px = np.tile([share * (camera.width - 1), share * (camera.height - 1)], (len(depth_m), 1))
        added_mm = 1e3 * (error.of_readings(depth_m, px, camera) - depth_m)
        drawing.add_line(figure, depth_m, added_mm, name=name, line={"color": color, "width": 2}, hover="%{y:.1f} mm")
    figure.add_hline(y=0, line=drawing.DASHED)
    figure.update_xaxes(title_text="depth as read, m", hoverformat=".2f")
    drawing.panel_title(figure, "added to it, mm")
    return figure


def _image_axes(figure: go.Figure, camera: PinholeCamera) -> None:
    figure.update_xaxes(range=[0, camera.width], title_text="px")
    figure.update_yaxes(range=[camera.height, 0], scaleanchor="x", scaleratio=1)


def _means(px: FloatArray, values: FloatArray, camera: PinholeCamera) -> FloatArray:
    u = (px[:, 0] * _ACROSS / camera.width).astype(int).clip(0, _ACROSS - 1)
    v = (px[:, 1] * _DOWN / camera.height).astype(int).clip(0, _DOWN - 1)
    cell = v * _ACROSS + u
    count = np.bincount(cell, minlength=_ACROSS * _DOWN)
    total = np.bincount(cell, values, _ACROSS * _DOWN)
    with np.errstate(invalid="ignore"):
        return np.asarray(np.where(count > 0, total / count, np.nan).reshape(_DOWN, _ACROSS))


def _middles(length: int, count: int) -> FloatArray:
    return (np.arange(count) + 0.5) * length / count
