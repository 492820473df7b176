"""The report of a run: figures of its records, and the page that shows them."""

from wheelsight.pipeline.summary import Summary, summarise
from wheelsight.report._rectification import error_rows
from wheelsight.report.comparison import comparison_rows, write_comparison
from wheelsight.report.comparison_figures import bands_figure, errors_figure, overlay_figure
from wheelsight.report.drive_page import write_drive_page, write_drive_picture
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
from wheelsight.report.joined_figures import trust_figure
from wheelsight.report.map_figures import plan_figure
from wheelsight.report.overlay import Overlay, overlay_of
from wheelsight.report.page import write_report
from wheelsight.report.pages import why_no_page, write_page
from wheelsight.report.pictures import draw_matches
from wheelsight.report.rectification_figures import area_map_figure, area_time_figure, map_error_figure

__all__ = [
    "Overlay",
    "Summary",
    "area_map_figure",
    "area_time_figure",
    "bands_figure",
    "certainty_figure",
    "comparison_rows",
    "draw_matches",
    "error_figure",
    "error_rows",
    "errors_figure",
    "map_error_figure",
    "matches_figure",
    "overlay_figure",
    "overlay_of",
    "plan_figure",
    "stage_figure",
    "status_figure",
    "summarise",
    "time_figure",
    "time_histogram_figure",
    "trajectory_figure",
    "trust_figure",
    "why_no_page",
    "write_comparison",
    "write_drive_page",
    "write_drive_picture",
    "write_page",
    "write_report",
]
