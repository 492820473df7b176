"""Many recordings at once: on the cores of this computer, or on many computers; one table of it all."""

from wheelsight.batch.baseline import Comparison, compare
from wheelsight.batch.batch import PAGE_FILE, TABLE_FILE, Done, run_batch
from wheelsight.batch.fleet import run_on_fleet
from wheelsight.batch.inputs import named_recordings
from wheelsight.batch.jobs import Case, Job, Plan, plan_of
from wheelsight.batch.outcome import Outcome
from wheelsight.batch.pool import run_on_processes
from wheelsight.batch.settings import BatchSettings
from wheelsight.batch.table import Row, Spread, read_rows
from wheelsight.batch.work import run_job

__all__ = [
    "PAGE_FILE",
    "TABLE_FILE",
    "BatchSettings",
    "Case",
    "Comparison",
    "Done",
    "Job",
    "Outcome",
    "Plan",
    "Row",
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
