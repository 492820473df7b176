"""run_job: what every process does with a job, on this computer and on others."""

from __future__ import annotations

import json
import re
import tempfile
import time
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any

import cv2

from wheelsight.batch.inputs import code_digest
from wheelsight.batch.jobs import Job, main_track
from wheelsight.batch.outcome import Outcome, problem_of
from wheelsight.config import Config
from wheelsight.errors import ConfigError
from wheelsight.pipeline import run_each
from wheelsight.recordings import open_recording

_FORGET_PEAK = "5"  # as Linux's proc(5) has it


def run_job(job: Job) -> Outcome:
    """Run a recording; what breaks is an outcome with a problem, never an exception."""
    began_s = time.perf_counter()
    try:
        return _found(job, began_s)
    except Exception as error:  # the jobs after this one must be run
        return Outcome(job.id, problem_of(error), elapsed_s=time.perf_counter() - began_s)


def _found(job: Job, began_s: float) -> Outcome:
    if job.code != code_digest():
        raise ConfigError("this computer has another wheelsight", fix="install the same on all of them")
    cv2.setNumThreads(1)
    _forget_peak()
    config = Config.model_validate(job.settings)
    recording = open_recording(job.recording, config.recording.open_options())
    with tempfile.TemporaryDirectory(prefix="wheelsight-") as folder:
        run_each(recording, config, folder)
        metrics = json.loads((Path(folder) / "metrics.json").read_text(encoding="utf-8"))
    peak_mb = _peak_mb()
    metrics["peak_memory_mb"] = metrics["peak_memory_mb"] if peak_mb is None else peak_mb
    figures = figures_of(metrics, main_track(config))
    return Outcome(job.id, figures=figures, metrics=metrics, elapsed_s=time.perf_counter() - began_s)


def figures_of(metrics: Mapping[str, Any], track: str) -> dict[str, float | None]:
    """The figures of a table, of a metrics.json and the track in it that counts."""
    own = metrics["odometry"][track] if "odometry" in metrics else metrics
    counts = own["frames"] if "frames" in own else own["wheel_readings"]
    return {
        "ate_m": _error(own, "ate_m"),
        "rpe_m": _error(own, "rpe_per_second_m"),
        "rpe_deg": _error(own, "rpe_per_second_deg"),
        "tracked": counts["with_pose_share"],
        "frame_ms": own["timing"]["frame_median_ms"],
        "memory_mb": metrics["peak_memory_mb"],
    }


def _error(own: Mapping[str, Any], name: str) -> float | None:
    found = (own["evaluation"] or {}).get(name)
    return None if found is None else float(found["rmse"])


def _forget_peak() -> None:
    """A process runs many jobs: from here on its peak of memory is that of the next one, where Linux runs."""
    with suppress(OSError):
        Path("/proc/self/clear_refs").write_text(_FORGET_PEAK)


def _peak_mb() -> float | None:
    """The most memory held since; None where the system does not tell."""
    with suppress(OSError):
        found = re.search(r"^VmHWM:\s*(\d+) kB", Path("/proc/self/status").read_text(), re.MULTILINE)
        return None if found is None else int(found[1]) * 1024 / 1e6
    return None
