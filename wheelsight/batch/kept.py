"""What is done of a batch: a file a job, so that one that was broken off goes on where it was."""

from __future__ import annotations

import json
from collections.abc import Iterable
from dataclasses import asdict
from pathlib import Path
from typing import Any

from wheelsight.batch.jobs import Job
from wheelsight.batch.outcome import Outcome
from wheelsight.errors import OutputError
from wheelsight.files import StrPath, make_output_folder, write_text
from wheelsight.inputs import Kind, read_text

JOBS_FOLDER = "jobs"
_VERSION = 1
_FILE = Kind("the outcome of a job", most_mb=64)


class KeptOutcomes:
    """Outcomes in a folder: those that ended well, which are not run again, and no others."""

    def __init__(self, folder: StrPath) -> None:
        """Of a batch's folder; made if need be. Raises OutputError: it holds something that is no batch's."""
        folder = Path(folder)
        self._folder = folder / JOBS_FOLDER
        make_output_folder(folder, force=self._folder.is_dir())
        make_output_folder(self._folder, force=True)

    def keep(self, outcome: Outcome, job: Job) -> None:
        """Write it, whole or not at all. Raises OutputError."""
        if outcome.problem is None:
            about = {"recording": job.recording, "seed": job.seed, "settings": job.settings}
            document = {"version": _VERSION, **about, "outcome": asdict(outcome)}
            write_text(self._path(job.id), json.dumps(document, indent=1) + "\n")

    def found(self, jobs: Iterable[str]) -> dict[str, Outcome]:
        """Those of these jobs that are done; a file that cannot be read is none, and its job is run again."""
        found = dict[str, Outcome]()
        for job in jobs:
            try:
                document = json.loads(read_text(self._path(job), _FILE, OutputError))
                outcome = _outcome(document["outcome"])
                if document["version"] == _VERSION and outcome.job == job:
                    found[job] = outcome
            except (OutputError, ValueError, KeyError, TypeError, RecursionError):
                continue
        return found

    def _path(self, job: str) -> Path:
        return self._folder / f"{job}.json"


def _outcome(told: Any) -> Outcome:
    """One of a job that ended well. Raises TypeError or ValueError for what is none."""
    outcome = Outcome(**told)
    figures, numbers = outcome.figures, (int, float, type(None))
    is_sound = isinstance(figures, dict) and isinstance(outcome.metrics, dict) and outcome.problem is None
    if not is_sound or not all(isinstance(value, numbers) for value in (*figures.values(), outcome.elapsed_s)):
        raise ValueError(outcome.job)
    return outcome
