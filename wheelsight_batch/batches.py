"""Runs a batch: skips finished jobs, runs the others, stores each outcome and makes the table. `run_job` is the
function that every worker process calls.
"""

from __future__ import annotations

import json
import re
import tempfile
import time
from collections.abc import Callable, Generator, Iterable, Mapping, Sequence
from contextlib import closing, suppress
from dataclasses import asdict
from pathlib import Path
from typing import Any, NamedTuple

import cv2

from wheelsight.app.run import run_each
from wheelsight.config import Config
from wheelsight.core.errors import ConfigError, OutputError
from wheelsight.core.files import StrPath, make_output_folder, write_text
from wheelsight.core.inputs import Kind, read_text
from wheelsight.io.recordings import open_recording
from wheelsight_batch.jobs import BatchPlan, Job, Outcome, code_digest, main_track, problem_of
from wheelsight_batch.table import BatchRow, csv_text, markdown_text, rows_of

TABLE_FILE, PAGE_FILE = "table.csv", "table.md"


class Done(NamedTuple):
    """Progress of a batch.

    Attributes:
        jobs, of_jobs: number of finished jobs, with those of earlier calls, and their total.
        weight, of_weight: bytes of recordings that this call has finished, and their total.
        outcome, job: the last finished job, or None at the beginning.
    """

    jobs: int
    of_jobs: int
    weight: int
    of_weight: int
    outcome: Outcome | None
    job: Job | None


def run_batch(
    plan: BatchPlan,
    out: StrPath,
    runner: Callable[[Sequence[Job]], Generator[Outcome]],
    on_done: Callable[[Done], None] = lambda done: None,
) -> tuple[BatchRow, ...]:
    """Run all jobs that are not finished, store each outcome at once, and write table.csv and table.md at the end.

    After an interruption, finished jobs stay in `out`, and the next call runs the others.

    Args:
        plan: rows and jobs.
        out: folder of the batch; made if needed.
        runner: yields outcomes of jobs, such as `run_on_processes`.
        on_done: called once before the first job, and after each job.

    Raises:
        OutputError: `out` holds other files, or cannot be written.
    """
    kept = KeptOutcomes(out)
    outcomes = kept.found(plan.jobs)
    todo = [job for job in plan.jobs.values() if job.id not in outcomes]
    weight, count = sum(job.weight for job in todo), len(outcomes)
    left = weight
    on_done(Done(count, len(plan.jobs), 0, weight, None, None))
    with closing(runner(todo)) as answers:  # an exception here ends its processes, too
        for outcome in answers:
            job = plan.jobs[outcome.job]
            kept.keep(outcome, job)
            outcomes[job.id] = outcome
            left, count = left - job.weight, count + 1
            on_done(Done(count, len(plan.jobs), weight - left, weight, outcome, job))
    rows = rows_of(plan.cases, outcomes)
    write_text(Path(out) / TABLE_FILE, csv_text(rows))
    write_text(Path(out) / PAGE_FILE, markdown_text(rows))
    return rows


JOBS_FOLDER = "jobs"
_VERSION = 1
_FILE = Kind("the outcome of a job", most_mb=64)


class KeptOutcomes:
    """Stored outcomes of successful jobs, which are not run again."""

    def __init__(self, folder: StrPath) -> None:
        """Of a batch's folder; made if need be. Raises OutputError: it holds something that is no batch's."""
        folder = Path(folder)
        self._folder = folder / JOBS_FOLDER
        make_output_folder(folder, force=self._folder.is_dir())
        make_output_folder(self._folder, force=True)

    def keep(self, outcome: Outcome, job: Job) -> None:
        """Store an outcome atomically. Raises OutputError."""
        if outcome.problem is None:
            about = {"recording": job.recording, "seed": job.seed, "settings": job.settings}
            document = {"version": _VERSION, **about, "outcome": asdict(outcome)}
            write_text(self._path(job.id), json.dumps(document, indent=1) + "\n")

    def found(self, jobs: Iterable[str]) -> dict[str, Outcome]:
        """Stored outcomes of these jobs. An unreadable file counts as missing, so that its job runs again."""
        found = dict[str, Outcome]()
        for job in jobs:
            try:
                document = json.loads(read_text(self._path(job), _FILE, OutputError))
                # The outcome of a successful job
                outcome = Outcome(**document["outcome"])
                figures, numbers = outcome.figures, (int, float, type(None))
                is_sound = isinstance(figures, dict) and isinstance(outcome.metrics, dict) and outcome.problem is None
                if not is_sound or not all(
                    isinstance(value, numbers) for value in (*figures.values(), outcome.elapsed_s)
                ):
                    raise ValueError(outcome.job)
                if document["version"] == _VERSION and outcome.job == job:
                    found[job] = outcome
            except (OutputError, ValueError, KeyError, TypeError, RecursionError):
                continue
        return found

    def _path(self, job: str) -> Path:
        return self._folder / f"{job}.json"


_FORGET_PEAK = "5"  # as Linux's proc(5) has it


def run_job(job: Job) -> Outcome:
    """Run a recording. An error becomes an outcome with a problem, never an exception."""
    began_s = time.perf_counter()
    try:
        if job.code != code_digest():
            raise ConfigError("this computer has another wheelsight", fix="install the same on all of them")
        cv2.setNumThreads(1)
        with suppress(OSError):
            Path("/proc/self/clear_refs").write_text(_FORGET_PEAK)
        config = Config.model_validate(job.settings)
        recording = open_recording(job.recording, config.recording)
        with tempfile.TemporaryDirectory(prefix="wheelsight-") as folder:
            run_each(recording, config, folder)
            metrics = json.loads((Path(folder) / "metrics.json").read_text(encoding="utf-8"))
        with suppress(OSError):  # the peak since, where the system reports it
            status = Path("/proc/self/status").read_text()
            if (found := re.search(r"^VmHWM:\s*(\d+) kB", status, re.MULTILINE)) is not None:
                metrics["peak_memory_mb"] = int(found[1]) * 1024 / 1e6
        figures = figures_of(metrics, main_track(config))
        return Outcome(job.id, figures=figures, metrics=metrics, elapsed_s=time.perf_counter() - began_s)
    except Exception as error:  # the jobs after this one must be run
        return Outcome(job.id, problem_of(error), elapsed_s=time.perf_counter() - began_s)


def figures_of(metrics: Mapping[str, Any], track: str) -> dict[str, float | None]:
    """The figures of a table, from a metrics.json and its main track."""
    own = metrics["odometry"][track] if "odometry" in metrics else metrics
    counts = own["frames"] if "frames" in own else own["wheel_readings"]
    errors = own["evaluation"] or {}

    def rmse(name: str) -> float | None:
        return None if errors.get(name) is None else float(errors[name]["rmse"])

    return {
        "ate_m": rmse("ate_m"),
        "rpe_m": rmse("rpe_per_second_m"),
        "rpe_deg": rmse("rpe_per_second_deg"),
        "tracked": counts["with_pose_share"],
        "frame_ms": own["timing"]["frame_median_ms"],
        "memory_mb": metrics["peak_memory_mb"],
    }
