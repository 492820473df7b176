"""Runs many recordings on the cores of this computer or on many computers, and makes one table of the results."""

from wheelsight.app.batch.batches import PAGE_FILE, TABLE_FILE, Done, run_batch, run_job
from wheelsight.app.batch.jobs import BatchPlan, Case, Job, Outcome, named_recordings, plan_of
from wheelsight.app.batch.pool import run_on_fleet, run_on_processes
from wheelsight.app.batch.table import BatchRow, Comparison, Spread, compare, read_rows

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
