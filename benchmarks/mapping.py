"""Tracking, fusion and prediction together: the surfel map beside Open3D's dense SLAM."""

from __future__ import annotations

from collections.abc import Sequence as Many

from benchmarks.contenders import MAPPERS, open3d_slam, wheelsight_dense
from benchmarks.run import Result, run
from benchmarks.sequences import Sequence
from benchmarks.table import Sheet
from benchmarks.targets import Target

FRAMES_HZ, TIMES_FASTER = 30.0, 4.0
ATE_M = 0.02
SUBJECT = wheelsight_dense.SURFELS
_PEER = open3d_slam.FINE
# The peers take minutes for whole recordings.
_FRAMES = 120


def measure_mapping(sequences: Many[Sequence], frames: int | None = None) -> list[Result]:
    """All that build a model, over the same first frames of each sequence."""
    limit = min(frames or _FRAMES, _FRAMES)
    return [run(contender, sequence, limit) for sequence in sequences for contender in MAPPERS]


def mapping_sheet(results: Many[Result]) -> Sheet:
    """Time, error and memory of all."""
    header = ("recording: contender", "frames", "poses", "median ms", "frames/s", "ATE m", "peak MB")
    return Sheet("Tracking, fusion and prediction, two threads", header, tuple(map(_cells, results)))


def judge_mapping(results: Many[Result]) -> list[Target]:
    """How much faster than Open3D's dense SLAM at 6 mm over the same frames."""
    targets = []
    for name in dict.fromkeys(result.sequence for result in results):
        ours, peer = (_frames_hz(results, name, contender.name) for contender in (SUBJECT, _PEER))
        limit = None if peer is None else TIMES_FASTER * peer
        what = f"{name}: with surfels, frames/s, {TIMES_FASTER:g} times Open3D's at 6 mm"
        targets.append(Target(what, limit, ours, "/s", is_least=True))
    return targets


def judge_whole(results: Many[Result]) -> list[Target]:
    """What the surfel map must reach over whole recordings, its view changing from nothing to all that was seen."""
    targets = []
    for result in (result for result in results if result.contender.name == SUBJECT.name):
        name, ate_m = result.sequence, None if result.figures is None else result.figures.accuracy.ate_m
        rate = _frames_hz(results, name, SUBJECT.name)
        targets.append(Target(f"{name}: with surfels, frames/s", FRAMES_HZ, rate, "/s", is_least=True))
        targets.append(Target(f"{name}: with surfels, ATE", ATE_M, ate_m, "m", 4))
    return targets


def _frames_hz(results: Many[Result], sequence: str, contender: str) -> float | None:
    here = (r.figures for r in results if (r.sequence, r.contender.name) == (sequence, contender))
    figures = next(here, None)
    return None if figures is None else 1e3 / figures.mean_ms


def _cells(result: Result) -> tuple[str, ...]:
    name, figures = f"{result.sequence}: {result.contender.name}", result.figures
    if figures is None:
        return (name, "failed", *("—",) * 5)
    poses = f"{100 * figures.with_pose / figures.frames:.1f} %"
    ate_m, peak_mb = figures.accuracy.ate_m, figures.peak_memory_mb
    return (
        name,
        str(figures.frames),
        poses,
        f"{figures.median_ms:.1f}",
        f"{1e3 / figures.mean_ms:.1f}",
        "—" if ate_m is None else f"{ate_m:.4f}",
        "—" if peak_mb is None else f"{peak_mb:.0f}",
    )
