"""The page of a run, whatever it followed."""

from __future__ import annotations

from collections.abc import Sequence

from wheelsight.extras import why_missing
from wheelsight.files import StrPath
from wheelsight.pipeline.run_record import RunRecord
from wheelsight.report.comparison import write_comparison
from wheelsight.report.page import write_report


def why_no_page() -> str | None:
    """Why no page can be written: plotly, which draws the figures, is not installed. None where one can."""
    return why_missing("plotly")


def write_page(records: Sequence[RunRecord], path: StrPath) -> None:
    """Write the page of one odometry, or that of several side by side.

    Raises:
        OutputError: it cannot be written.
        ConfigError: plotly is not installed.
    """
    if len(records) == 1:
        write_report(records[0], path)
    else:
        write_comparison(records, path)
