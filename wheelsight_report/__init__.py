"""The report of a run: figures of its records, and the page that shows them."""

from wheelsight.app.run.verdict import summarise
from wheelsight_report.comparison import write_page
from wheelsight_report.drive_files import drive_dict, write_drive
from wheelsight_report.drive_page import write_drive_page, write_drive_picture
from wheelsight_report.figures import (
    certainty_figure,
    error_figure,
    matches_figure,
    stage_figure,
    status_figure,
    time_figure,
    time_histogram_figure,
    trajectory_figure,
)
from wheelsight_report.page import why_no_page, write_report
from wheelsight_report.pictures import draw_matches
from wheelsight_report.sections import plan_figure

__all__ = [
    "certainty_figure",
    "draw_matches",
    "drive_dict",
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
    "write_drive",
    "write_drive_page",
    "write_drive_picture",
    "write_page",
    "write_report",
]
