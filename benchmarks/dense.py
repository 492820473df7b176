"""Dense tracking alone: with two threads over whole recordings beside all others, and here once more with one."""

from __future__ import annotations

from collections.abc import Sequence as Many

from benchmarks.contenders import Contender, open3d_odometry, opencv_odometry, wheelsight_dense
from benchmarks.measure import THREADS, Feed
from benchmarks.run import Figures, Result, run
from benchmarks.sequences import Sequence
from benchmarks.table import Sheet
from benchmarks.targets import Target

OPENCV_SHARE, OPEN3D_SHARE = 0.25, 0.4
ATE_M = 0.02
SUBJECT = wheelsight_dense.KEYFRAMES
ON_ONE_THREAD: tuple[Contender, ...] = (SUBJECT, opencv_odometry.RGB_DEPTH, open3d_odometry.HYBRID)
_FRAMES = 100


def measure_one_thread(sequences: Many[Sequence], frames: int | None = None) -> list[Result]:
    """Ours and both peers over the first frames of each sequence, everything held to one thread on one core."""
    limit = min(frames or _FRAMES, _FRAMES)
    return [
        run(contender, sequence, limit, threads=1, feeds=(Feed.DECODED,))
        for sequence in sequences
        for contender in ON_ONE_THREAD
    ]


def one_thread_sheet(results: Many[Result]) -> Sheet:
    """What a frame took."""
    header = ("recording: contender", "frames", "poses", "median ms", "p95 ms")
    return Sheet("Dense tracking alone, on one thread and one core", header, tuple(map(_cells, results)))


def judge_dense(results: Many[Result], threads: int = THREADS) -> list[Target]:
    """Our time as a share of both peers', and the error where whole recordings were tracked with two threads."""
    return [
        target
        for name in dict.fromkeys(result.sequence for result in results)
        for target in _of_sequence(name, {r.contender.name: r.figures for r in results if r.sequence == name}, threads)
    ]


def _of_sequence(name: str, here: dict[str, Figures | None], threads: int) -> list[Target]:
    ours = here.get(SUBJECT.name)
    what = f"{name}: dense tracking, {threads} thread{'s' * (threads > 1)}"
    median_ms = None if ours is None else ours.median_ms
    targets = []
    for share, contender in ((OPENCV_SHARE, opencv_odometry.RGB_DEPTH), (OPEN3D_SHARE, open3d_odometry.HYBRID)):
        peer = here.get(contender.name)
        limit_ms = None if peer is None else share * peer.median_ms
        library = contender.name.split()[0]
        targets.append(Target(f"{what}, median, {share:g} of {library}'s", limit_ms, median_ms, "ms"))
    if threads == THREADS:
        ate_m = None if ours is None else ours.accuracy.ate_m
        targets.append(Target(f"{name}: dense tracking, ATE", ATE_M, ate_m, "m", 4))
    return targets


def _cells(result: Result) -> tuple[str, ...]:
    name, figures = f"{result.sequence}: {result.contender.name}", result.figures
    if figures is None:
        return (name, "failed", "—", "—", "—")
    poses = f"{100 * figures.with_pose / figures.frames:.1f} %"
    return (name, str(figures.frames), poses, f"{figures.median_ms:.1f}", f"{figures.p95_ms:.1f}")
