"""The report of a run: figures of its records, and the page that shows them."""

from wheelsight.app.report.comparison import write_page
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
from wheelsight.app.report.page import why_no_page, write_report
from wheelsight.app.report.pictures import draw_matches
from wheelsight.app.report.sections import plan_figure
from wheelsight.app.run.verdict import summarise

__all__ = [
    "certainty_figure",
    "draw_matches",
    "error_figure",
    "matches_figure",
    "plan_figure",
    "stage_figure",
    "status_figure",
    "summarise",
    "time_figure",
    "time_histogram_figure",
    "trajectory_figure",
    "why_no_page",
    "write_drive_page",
    "write_drive_picture",
    "write_page",
    "write_report",
]
