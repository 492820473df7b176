"""One process after another: each contender over each sequence, twice, and the figures that come of it."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from benchmarks.contenders import Contender
from benchmarks.measure import THREADS, Feed, Passage
from benchmarks.sequences import PROJECT, Accuracy, Sequence
from wheelsight.core.trajectory import Trajectory, read_tum

_THREAD_VARIABLES = ("OMP_NUM_THREADS", "NUMBA_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")
_TIME_LIMIT_S = 3600


@dataclass(frozen=True, slots=True)
class Figures:
    """What one contender reached on one sequence.

    Attributes:
        accuracy: against the truth.
        frames, with_pose: frames handed over, and how many were answered with a pose.
        median_ms, p95_ms, mean_ms: tracking alone, all frames decoded before.
        streamed_ms: median of waiting for the next frame and tracking it, decoding going on meanwhile.
        peak_memory_mb: of the whole process when streamed.
        differing_poses: how many lines of the two runs' trajectory files differ.

    The last three are None where frames were not streamed.
    """

    accuracy: Accuracy
    frames: int
    with_pose: int
    median_ms: float
    p95_ms: float
    mean_ms: float
    streamed_ms: float | None = None
    peak_memory_mb: float | None = None
    differing_poses: int | None = None


@dataclass(frozen=True, slots=True)
class Result:
    """A cell of the benchmark: figures, or the problem that prevented them."""

    contender: Contender
    sequence: str
    figures: Figures | None = None
    problem: str | None = None


class ContenderError(Exception):
    """A contender's process ended badly; the message is the last line it left."""


def run(
    contender: Contender,
    sequence: Sequence,
    limit: int | None = None,
    threads: int = THREADS,
    feeds: tuple[Feed, ...] = tuple(Feed),
) -> Result:
    """Measure one contender on one sequence, each feed in a fresh process: decoded frames, then streamed ones."""
    with tempfile.TemporaryDirectory() as scratch:
        folders = {feed: Path(scratch) / feed for feed in feeds}
        try:
            for feed, folder in folders.items():
                run_process(contender, sequence.path, feed, folder, limit, threads)
        except ContenderError as error:
            return Result(contender, sequence.name, problem=str(error))
        figures = figures_of(sequence, folders[Feed.DECODED], folders.get(Feed.STREAMED))
        return Result(contender, sequence.name, figures)


def figures_of(sequence: Sequence, decoded: Path, streamed: Path | None) -> Figures:
    """The figures of one or two runs that each left passage.json and trajectory.txt in a folder."""
    timed, estimate = read_passage(decoded), _read_trajectory(decoded / "trajectory.txt")
    milliseconds = 1e3 * np.array(timed.seconds)
    figures = Figures(
        accuracy=Accuracy() if estimate is None else sequence.accuracy(estimate),
        frames=len(timed.stamps_s),
        with_pose=0 if estimate is None else len(estimate),
        median_ms=float(np.median(milliseconds)),
        p95_ms=float(np.percentile(milliseconds, 95)),
        mean_ms=float(np.mean(milliseconds)),
    )
    if streamed is None:
        return figures
    streaming = read_passage(streamed)
    first, second = ((folder / "trajectory.txt").read_text().splitlines() for folder in (decoded, streamed))
    return replace(
        figures,
        streamed_ms=1e3 * float(np.median(streaming.seconds)),
        peak_memory_mb=streaming.peak_memory_mb,
        differing_poses=_differing(first, second),
    )


def read_passage(folder: Path) -> Passage:
    """What a process of `measure` left in a folder."""
    return Passage(**json.loads((folder / "passage.json").read_text()))


def child_environment(threads: int = THREADS) -> dict[str, str]:
    """This process's environment, with every library held to the same number of threads."""
    return {**os.environ, **dict.fromkeys(_THREAD_VARIABLES, str(threads))}


def run_process(
    contender: Contender,
    recording: Path,
    feed: Feed,
    folder: Path,
    limit: int | None = None,
    threads: int = THREADS,
    extra: tuple[str, ...] = (),
) -> None:
    """Measure in a fresh process, which leaves passage.json and trajectory.txt in a new folder.

    Raises ContenderError where it ends badly or takes too long.
    """
    folder.mkdir()
    command = [sys.executable, "-m", "benchmarks.measure", contender.name, str(recording), feed, str(folder), *extra]
    command += ["--threads", str(threads)] + ([] if limit is None else ["--frames", str(limit)])
    environment = child_environment(threads)
    try:
        ended = subprocess.run(
            command, cwd=PROJECT, env=environment, capture_output=True, text=True, timeout=_TIME_LIMIT_S
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
