"""The report of a run: what it learned (RunRecord), its figures, and the page that shows them."""

from wheelsight.report.comparison import comparison_rows, write_comparison
from wheelsight.report.comparison_figures import bands_figure, errors_figure, overlay_figure
from wheelsight.report.figures import (
    certainty_figure,
    error_figure,
    matches_figure,
    stage_figure,
    status_figure,
    time_figure,
    time_histogram_figure,
    trajectory_figure,
)
from wheelsight.report.overlay import Overlay, overlay_of
from wheelsight.report.page import write_report
from wheelsight.report.pictures import draw_matches
from wheelsight.report.record import FrameRecord, MatchPicture, RunRecord
from wheelsight.report.rectification import Look, RectificationRecord, WorldErrors
from wheelsight.report.summary import Summary, summarise

__all__ = [
    "FrameRecord",
    "Look",
    "MatchPicture",
    "Overlay",
    "RectificationRecord",
    "RunRecord",
    "Summary",
    "WorldErrors",
    "bands_figure",
    "certainty_figure",
    "comparison_rows",
    "draw_matches",
    "error_figure",
    "errors_figure",
    "matches_figure",
    "overlay_figure",
    "overlay_of",
    "stage_figure",
    "status_figure",
    "summarise",
    "time_figure",
    "time_histogram_figure",
    "trajectory_figure",
    "write_comparison",
    "write_report",
]
