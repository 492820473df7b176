"""One process after another: each contender over each sequence, twice, and the figures that come of it."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from benchmarks.contenders import Contender
from benchmarks.measure import THREADS, Feed, Passage
from benchmarks.sequences import PROJECT, Accuracy, Sequence
from wheelsight.trajectory import Trajectory, read_tum

_THREAD_VARIABLES = ("OMP_NUM_THREADS", "NUMBA_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")
_TIME_LIMIT_S = 3600


@dataclass(frozen=True, slots=True)
class Figures:
    """What one contender reached on one sequence.

    Attributes:
        accuracy: against the truth.
        frames, with_pose: frames handed over, and how many were answered with a pose.
        median_ms, p95_ms: tracking alone, all frames decoded before.
        streamed_ms: median of waiting for the next frame and tracking it, decoding going on meanwhile.
        peak_memory_mb: of the whole process when streamed.
        differing_poses: how many lines of the two runs' trajectory files differ.
    """

    accuracy: Accuracy
    frames: int
    with_pose: int
    median_ms: float
    p95_ms: float
    streamed_ms: float
    peak_memory_mb: float
    differing_poses: int


@dataclass(frozen=True, slots=True)
class Result:
    """A cell of the benchmark: figures, or the problem that prevented them."""

    contender: Contender
    sequence: str
    figures: Figures | None = None
    problem: str | None = None


class ContenderError(Exception):
    """A contender's process ended badly; the message is the last line it left."""


def run(contender: Contender, sequence: Sequence, limit: int | None = None) -> Result:
    """Measure one contender on one sequence, in two fresh processes: decoded frames, then streamed ones."""
    with tempfile.TemporaryDirectory() as scratch:
        folders = {feed: Path(scratch) / feed for feed in Feed}
        try:
            for feed, folder in folders.items():
                folder.mkdir()
                _run_process(contender, sequence, feed, folder, limit)
        except ContenderError as error:
            return Result(contender, sequence.name, problem=str(error))
        return Result(contender, sequence.name, figures_of(sequence, folders[Feed.DECODED], folders[Feed.STREAMED]))


def figures_of(sequence: Sequence, decoded: Path, streamed: Path) -> Figures:
    """The figures of two runs that each left passage.json and trajectory.txt in a folder."""
    timed, streaming = (Passage(**json.loads((folder / "passage.json").read_text())) for folder in (decoded, streamed))
    first, second = ((folder / "trajectory.txt").read_text().splitlines() for folder in (decoded, streamed))
    estimate = _read_trajectory(decoded / "trajectory.txt")
    milliseconds = 1e3 * np.array(timed.seconds)
    return Figures(
        accuracy=Accuracy() if estimate is None else sequence.accuracy(estimate),
        frames=len(timed.stamps_s),
        with_pose=0 if estimate is None else len(estimate),
        median_ms=float(np.median(milliseconds)),
        p95_ms=float(np.percentile(milliseconds, 95)),
        streamed_ms=1e3 * float(np.median(streaming.seconds)),
        peak_memory_mb=streaming.peak_memory_mb,
        differing_poses=_differing(first, second),
    )


def child_environment() -> dict[str, str]:
    """This process's environment, with every library held to the same number of threads."""
    return {**os.environ, **dict.fromkeys(_THREAD_VARIABLES, str(THREADS))}


def _run_process(contender: Contender, sequence: Sequence, feed: Feed, folder: Path, limit: int | None) -> None:
    command = [sys.executable, "-m", "benchmarks.measure", contender.name, str(sequence.path), feed, str(folder)]
    if limit is not None:
        command += ["--frames", str(limit)]
    try:
        ended = subprocess.run(
            command, cwd=PROJECT, env=child_environment(), capture_output=True, text=True, timeout=_TIME_LIMIT_S
        )
    except subprocess.TimeoutExpired as error:
        raise ContenderError(f"took longer than {_TIME_LIMIT_S} s") from error
    if ended.returncode != 0:
        lines = ended.stderr.replace(str(PROJECT), ".").strip().splitlines()
        raise ContenderError(lines[-1] if lines else f"ended with code {ended.returncode}")


def _read_trajectory(path: Path) -> Trajectory | None:
    """The trajectory, or None where it holds no pose."""
    if all(line.startswith("#") for line in path.read_text().splitlines()):
        return None
    return read_tum(path)


def _differing(first: list[str], second: list[str]) -> int:
    differing = sum(a != b for a, b in zip(first, second, strict=False))
    return differing + abs(len(first) - len(second))
