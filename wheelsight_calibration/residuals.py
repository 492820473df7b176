"""The figure of residuals over time, on the pages of wheels and of mounts."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from wheelsight.core.geometry import BoolArray, FloatArray
from wheelsight_report import drawing
from wheelsight_report import plotly as go
from wheelsight_report.drawing import BLUE, VERMILLION
from wheelsight_report.plotly import make_subplots


@dataclass(frozen=True, eq=False)
class ResidualPanel:
    """Residuals (N,) of one quantity over time, in their unit. Larger ones than the limit lie at the edge."""

    name: str
    unit: str
    values: FloatArray
    limit: float


def residual_panels(
    stamps_s: FloatArray, panels: Sequence[ResidualPanel], is_off: BoolArray, kinds: tuple[str, str], title: str
) -> go.Figure:
    """A panel for each quantity; `is_off` (N,) stand out, and `kinds` names the others and them."""
    figure = make_subplots(rows=len(panels), cols=1, shared_xaxes=True, vertical_spacing=0.1)
    drawing.style(figure, 170 * len(panels), hovermode="closest", margin_l=88)
    for row, panel in enumerate(panels, start=1):
        limit = panel.limit
        looks = zip(kinds, (~is_off, is_off), (BLUE, VERMILLION), ("circle", "x"), strict=True)
        for kind, which, color, symbol in looks:
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
        drawing.panel_title(figure, f"{panel.name}, {panel.unit}", row)
        figure.add_hline(y=0, line=drawing.DASHED, row=row, col=1)
    figure.update_xaxes(title_text=title, row=len(panels), col=1)
    return figure
