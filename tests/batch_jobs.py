"""Jobs for batches, and what processes do with them: functions of a module, which another process can import."""

from __future__ import annotations

import os
import signal
import time
from pathlib import Path

import numpy as np

from wheelsight.core.calibration import Calibration
from wheelsight.core.calibration_parts import Wheels
from wheelsight.core.messages import WheelTicks
from wheelsight.core.trajectory import Trajectory
from wheelsight.io.recordings import RecordingWriter
from wheelsight.wheels import integrate_log
from wheelsight_batch import Job, Outcome

ROBOT = Wheels(0.17, 0.17, 0.52, 3200.0)
FIGURES = {"ate_m": 0.01, "rpe_m": 0.02, "rpe_deg": 0.3, "tracked": 1.0, "frame_ms": 2.0, "memory_mb": 300.0}


def job(name: str, *, marks: Path | str = "", weight: int = 1) -> Job:
    """A job that the functions below take; `marks` is a folder in which they leave marks."""
    return Job(name, str(marks), {}, 0, "", weight)


def quick(job: Job) -> Outcome:
    return Outcome(job.id, figures=FIGURES)


def dies_once(job: Job) -> Outcome:
    """Leaves the number of its process at each try; the first try of "fatal" ends by SIGKILL."""
    if _try(job) == 0 and job.id.startswith("fatal"):
        os.kill(os.getpid(), signal.SIGKILL)
    return quick(job)


def dies_always(job: Job) -> Outcome:
    _try(job)
    if job.id.startswith("fatal"):
        os.kill(os.getpid(), signal.SIGKILL)
    return quick(job)


def ends_itself(job: Job) -> Outcome:
    raise SystemExit("no more")


def waits(job: Job) -> Outcome:
    """Until the file "go" is there; a mark shows that it has begun."""
    _try(job)
    while not (Path(job.recording) / "go").exists():
        time.sleep(0.02)
    return quick(job)


def hears(job: Job) -> Outcome:
    """Ctrl-C, as a terminal sends it to all its processes: it must go on."""
    os.kill(os.getpid(), signal.SIGINT)
    time.sleep(0.05)
    return quick(job)


def _try(job: Job) -> int:
    """Which one it is, from 0."""
    before = tries(Path(job.recording), job.id)
    (Path(job.recording) / f"{job.id}.{len(before)}").write_text(str(os.getpid()))
    return len(before)


def tries(folder: Path, name: str) -> list[int]:
    """The processes that have tried a job, in order."""
    return [int(path.read_text() or 0) for path in sorted(folder.glob(f"{name}.*"))]


def until(found: object, seconds: float = 60.0) -> None:
    """Wait until a question is answered with yes."""
    ends_s = time.monotonic() + seconds
    while not found():  # type: ignore[operator]
        assert time.monotonic() < ends_s, "it did not come"
        time.sleep(0.02)


def write_wheels(folder: Path, readings: int = 200, *, has_truth: bool = True, left: int = 30) -> Path:
    """A recording of wheels alone: a bend, with its truth."""
    stamps_s, counts = 0.02 * np.arange(readings), np.arange(readings)
    with RecordingWriter(folder, Calibration(wheels=ROBOT, source="our robot")) as writer:
        if has_truth:
            path = integrate_log(ROBOT, stamps_s, left * counts, 40 * counts).trajectory()
            writer.add_ground_truth(Trajectory(path.stamps_s, path.T_frame_body, body="base"))
        for reading in zip(stamps_s.tolist(), (left * counts).tolist(), (40 * counts).tolist(), strict=True):
            writer.add(WheelTicks(*reading))
    return folder
