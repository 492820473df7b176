"""The report of a run: what it learned (RunRecord), its figures, and the page that shows them."""

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
from wheelsight.report.page import write_report
from wheelsight.report.pictures import draw_matches
from wheelsight.report.record import FrameRecord, MatchPicture, RunRecord
from wheelsight.report.summary import Summary, summarise

__all__ = [
    "FrameRecord",
    "MatchPicture",
    "RunRecord",
    "Summary",
    "certainty_figure",
    "draw_matches",
    "error_figure",
    "matches_figure",
    "stage_figure",
    "status_figure",
    "summarise",
    "time_figure",
    "time_histogram_figure",
    "trajectory_figure",
    "write_report",
]
