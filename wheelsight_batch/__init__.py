"""Runs many recordings on the cores of this computer or on many computers, and makes one table of the results.

Each name is loaded at its first use.
"""

from typing import TYPE_CHECKING, Any

from wheelsight.core.runtime import public_name

if TYPE_CHECKING:
    from wheelsight_batch.batches import PAGE_FILE, TABLE_FILE, Done, run_batch, run_job
    from wheelsight_batch.jobs import BatchPlan, Case, Job, Outcome, named_recordings, plan_of
    from wheelsight_batch.pool import run_on_fleet, run_on_processes
    from wheelsight_batch.table import BatchRow, Comparison, Spread, compare, read_rows

__all__ = [
    "PAGE_FILE",
    "TABLE_FILE",
    "BatchPlan",
    "BatchRow",
    "Case",
    "Comparison",
    "Done",
    "Job",
    "Outcome",
    "Spread",
    "compare",
    "named_recordings",
    "plan_of",
    "read_rows",
    "run_batch",
    "run_job",
    "run_on_fleet",
    "run_on_processes",
]


def __getattr__(name: str) -> Any:
    return public_name(__name__, name, __all__, ("batches", "jobs", "pool", "table"))
