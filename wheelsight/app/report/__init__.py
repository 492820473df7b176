"""The report of a run: figures of its records, and the page that shows them."""

from wheelsight.app.report.comparison import comparison_rows, error_rows, why_no_page, write_comparison, write_page
from wheelsight.app.report.comparison_figures import (
    Overlay,
    area_map_figure,
    area_time_figure,
    bands_figure,
    errors_figure,
    map_error_figure,
    overlay_figure,
    overlay_of,
    trust_figure,
)
from wheelsight.app.report.drive_page import write_drive_page, write_drive_picture
from wheelsight.app.report.figures import (
    certainty_figure,
    error_figure,
    matches_figure,
    stage_figure,
    status_figure,
    time_figure,
    time_histogram_figure,
    trajectory_figure,
)
from wheelsight.app.report.page import write_report
from wheelsight.app.report.pictures import draw_matches
from wheelsight.app.report.sections import plan_figure
from wheelsight.app.run.verdict import Summary, summarise

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
