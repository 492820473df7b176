"""Figures of a run's map: its plan with the path on it, and views along the way."""

from __future__ import annotations

import math

import cv2
import numpy as np

from wheelsight.geometry import ByteArray
from wheelsight.mapping.plan import Plan
from wheelsight.pipeline.map_record import MapPicture
from wheelsight.pipeline.run_record import RunRecord
from wheelsight.report import _drawing as drawing
from wheelsight.report import _plotly as go
from wheelsight.report import _series as series
from wheelsight.report._drawing import BLUE
from wheelsight.report.pictures import webp_uri

_HEIGHT_PX = 640
_GUTTER_PX = 6
_PANEL_WIDTH_PX = 640


def plan_figure(record: RunRecord, colour: str = BLUE) -> go.Figure:
    """The map from above, metres, equal aspect, with the path of the body over it and a bar of round length.

    Of a record whose map has a plan.
    """
    assert record.map is not None
    assert record.map.plan is not None
    plan = record.map.plan
    figure = drawing.style(go.Figure(), _HEIGHT_PX, hovermode="closest", showlegend=False)
    (left, bottom), (right, top) = _corners(plan)
    place = {"x": left, "y": top, "sizex": right - left, "sizey": top - bottom, "xref": "x", "yref": "y"}
    figure.add_layout_image(source=webp_uri(plan.image), layer="below", sizing="stretch", **place)
    _, positions_m = series.with_gaps(
        record.estimate.stamps_s, record.estimate.positions_m, series.poseless_stamps_s(record)
    )
    path = positions_m @ plan.R_plan_map[:2].T
    path = path[series.keep_shape(path)]
    hover = "%{x:.2f}, %{y:.2f} m"
    drawing.add_path(figure, path, name="halo", line={"color": "#ffffff", "width": 5}, hover=hover)
    drawing.add_path(figure, path, name="path", line={"color": colour, "width": 2.5}, hover=hover)
    _mark_ends(figure, path[~np.isnan(path).any(axis=1)], colour)
    _add_bar(figure, left, right)
    figure.update_xaxes(range=[left, right], title_text="m", constrain="domain", showgrid=False)
    figure.update_yaxes(range=[bottom, top], scaleanchor="x", scaleratio=1, constrain="domain", showgrid=False)
    figure.update_layout(plot_bgcolor="#ffffff")
    return figure


def bar_length_m(extent_m: float) -> float:
    """The longest of 1, 2, 5 times a power of ten that is no longer than a quarter of `extent_m`."""
    power = 10.0 ** math.floor(math.log10(extent_m / 4))
    return max(factor * power for factor in (1, 2, 5) if factor * power <= extent_m / 4)


def draw_view(picture: MapPicture) -> ByteArray:
    """The frame (left) and the map from where it was taken (right), (H, W, 3) uint8, red green blue."""
    panels = [_panel(picture.color), _panel(picture.rendered)]
    height = max(len(panel) for panel in panels)
    canvas = np.full((height, 2 * _PANEL_WIDTH_PX + _GUTTER_PX, 3), 255, np.uint8)
    for panel, left in zip(panels, (0, _PANEL_WIDTH_PX + _GUTTER_PX), strict=True):
        canvas[: len(panel), left : left + _PANEL_WIDTH_PX] = panel
    return canvas


def view_uri(picture: MapPicture) -> str:
    """`draw_view` in a data URI."""
    return webp_uri(draw_view(picture))


def _corners(plan: Plan) -> tuple[tuple[float, float], tuple[float, float]]:
    """Lower left and upper right of the plan's image, at the outer edges of its pixels."""
    (height, width), half_px = plan.is_known.shape, 0.5 * plan.m_per_px
    left, top = plan.corner_m[0] - half_px, plan.corner_m[1] + half_px
    return (left, top - height * plan.m_per_px), (left + width * plan.m_per_px, top)


def _mark_ends(figure: go.Figure, path: np.ndarray, colour: str) -> None:
    marker = {"size": 11, "color": "#ffffff", "line": {"color": colour, "width": 3}}
    for name, symbol, points in (("start", "circle", path[:1]), ("end", "square", path[-1:])):
        hover = f"{name}: %{{x:.2f}}, %{{y:.2f}} m<extra></extra>"
        figure.add_scatter(
            x=points[:, 0], y=points[:, 1], mode="markers", marker={**marker, "symbol": symbol}, hovertemplate=hover
        )


def _add_bar(figure: go.Figure, left: float, right: float) -> None:
    """Above the plan, at its right end."""
    length_m = bar_length_m(right - left)
    line = {"color": drawing.GREY, "width": 4}
    figure.add_shape(type="line", x0=right - length_m, x1=right, yref="paper", y0=1.015, y1=1.015, line=line)
    place = {"x": right - length_m / 2, "y": 1.02, "yref": "paper", "yanchor": "bottom", "xanchor": "center"}
    figure.add_annotation(text=f"{length_m:g} m", showarrow=False, **place)


def _panel(image: ByteArray) -> ByteArray:
    size = (_PANEL_WIDTH_PX, max(1, round(image.shape[0] * _PANEL_WIDTH_PX / image.shape[1])))
    how = cv2.INTER_AREA if image.shape[1] > _PANEL_WIDTH_PX else cv2.INTER_LINEAR
    return np.asarray(cv2.resize(image, size, interpolation=how), np.uint8)
