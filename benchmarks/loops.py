"""`python -m benchmarks.loops`: graphs with false loops, by both solvers; and TU Chemnitz's corridor.

Synthetic graphs are rounds on a square in space, a metre a step, with an odometry that states its errors honestly.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from benchmarks.sequences import default_data_folder
from wheelsight.config import load_config
from wheelsight.core.geometry import FloatArray, se3
from wheelsight.core.keyframes import KeyframeId
from wheelsight.core.trajectory import Trajectory
from wheelsight.estimation import Localizer
from wheelsight.evaluation import ate
from wheelsight.io.recordings import HasMatches, OpenOptions, matches_of, open_recording
from wheelsight.slam.graph import PoseGraph, Prior, RelativePose
from wheelsight.slam.loop_closing import correct
from wheelsight.slam.loop_gate import LoopCloser, LoopReport
from wheelsight.slam.solvers import GtsamPoseGraph, OwnPoseGraph

SOLVERS: dict[str, Callable[[], PoseGraph]] = {"gtsam": GtsamPoseGraph, "own": OwnPoseGraph}
_STEP_SIGMAS = np.array([0.02, 0.01, 0.005, 0.002, 0.002, 0.01])
_LOOP_SIGMAS = np.array([0.05, 0.05, 0.05, 0.02, 0.02, 0.02])
_SIDE, _LAPS, _TRUE = 12, 4, 60
_CASES = {"0 % false": (0, 0), "30 % false": (26, 0), "80 % false": (240, 0), "6 false clusters of 8": (0, 6)}
_NEAR_M, _FAR_M, _LEAST_APART = 0.5, 3.0, 12
_CORRIDOR = Path("wheels") / "corridor_864m"
_TRUTH_GAP_S = 0.06


@dataclass(frozen=True, slots=True, eq=False)
class Drive:
    """True poses, measured steps, true and false loops."""

    T: FloatArray
    steps: list[RelativePose]
    true: list[RelativePose]
    false: list[RelativePose]

    @property
    def dead_reckoned(self) -> FloatArray:
        """(N, 4, 4) by steps alone."""
        T = [self.T[0]]
        for step in self.steps:
            T.append(T[-1] @ step.T_first_second)
        return np.array(T)


def made(case: str, seed: int) -> Drive:
    """A drive with the loops of a case."""
    rng = np.random.default_rng(seed)
    T, (single, clusters) = _rounds(), _CASES[case]
    steps = [_measured(rng, i, i + 1, se3.invert(T[i]) @ T[i + 1], _STEP_SIGMAS, False) for i in range(len(T) - 1)]
    apart_m = np.linalg.norm(T[:, None, :3, 3] - T[None, :, :3, 3], axis=-1)
    gap = np.arange(len(T))[None] - np.arange(len(T))[:, None]
    near = np.argwhere((apart_m < _NEAR_M) & (gap > _LEAST_APART))
    chosen = near[rng.choice(len(near), _TRUE, replace=False)]
    true = [_measured(rng, i, j, se3.invert(T[i]) @ T[j], _LOOP_SIGMAS, True) for i, j in chosen.tolist()]
    far = np.argwhere((apart_m > _FAR_M) & (gap > _LEAST_APART + 8))
    false = [_measured(rng, i, j, np.eye(4), _LOOP_SIGMAS, True) for i, j in rng.permutation(far)[:single].tolist()]
    for i, j in rng.permutation(far[far.max(axis=1) < len(T) - 8])[:clusters].tolist():
        T_stretches = T[i] @ se3.invert(T[j])
        for k in range(8):
            T_false = se3.invert(T[i + k]) @ T_stretches @ T[j + k]
            false.append(_measured(rng, i + k, j + k, T_false, _LOOP_SIGMAS, True))
    return Drive(T, steps, true, false)


def _rounds() -> FloatArray:
    T = [np.eye(4)]
    for i in range(4 * _SIDE * _LAPS):
        T.append(T[-1] @ se3.from_plane(1.0, 0, np.pi / 2 if i % _SIDE == _SIDE - 1 else 0.0))
    return np.array(T)


def _measured(
    rng: np.random.Generator, i: int, j: int, T: FloatArray, sigmas: FloatArray, is_loop: bool
) -> RelativePose:
    noisy = se3.exp(rng.normal(0, sigmas)) @ T
    return RelativePose(KeyframeId(i), KeyframeId(j), noisy, np.diag(sigmas**2), is_loop)


def live(drive: Drive, graph: PoseGraph) -> tuple[LoopReport, float]:
    """Loops judged as the drive comes to them; and the longest time of one step, seconds."""
    graph.add(drive.T[0])
    graph.add_prior(Prior(KeyframeId(0), drive.T[0], 1e-8 * np.eye(6)))
    closer, worst_s, T = LoopCloser(graph), 0.0, drive.T[0]
    loops = [*drive.true, *drive.false]
    for step in drive.steps:
        started = time.perf_counter()
        T = graph.poses[-1] @ step.T_first_second
        graph.add(T)
        graph.add_edges([step])
        new = [loop for loop in loops if loop.second == step.second]
        if new:
            closer.offer(new)
        worst_s = max(worst_s, time.perf_counter() - started)
    graph.optimise()
    return closer.report(), worst_s


def at_once(drive: Drive, graph: PoseGraph) -> tuple[LoopReport, float]:
    """Loops judged all together; and how long that takes, seconds."""
    started = time.perf_counter()
    for T in drive.dead_reckoned:
        graph.add(T)
    graph.add_prior(Prior(KeyframeId(0), drive.T[0], 1e-8 * np.eye(6)))
    graph.add_edges(drive.steps)
    report = LoopCloser(graph).offer_all([*drive.true, *drive.false])
    return report, time.perf_counter() - started


def rmse_m(T: FloatArray, T_true: FloatArray) -> float:
    """Of positions; both begin at one pose, nothing is aligned."""
    return float(np.sqrt(np.mean(np.sum((T[:, :3, 3] - T_true[:, :3, 3]) ** 2, axis=1))))


def rows(seeds: Sequence[int]) -> Iterator[str]:
    """A line for each case, solver and way."""
    for case in _CASES:
        for solver in SOLVERS:
            for name, way in (("live", live), ("at once", at_once)):
                found = []
                for seed in seeds:
                    drive, graph = made(case, seed), SOLVERS[solver]()
                    report, seconds = way(drive, graph)
                    kept = {id(loop) for loop in report.kept}
                    counts = [sum(id(loop) in kept for loop in loops) for loops in (drive.true, drive.false)]
                    found.append([rmse_m(drive.dead_reckoned, drive.T), rmse_m(graph.poses, drive.T), *counts, seconds])
                before, after, _, _, seconds = np.mean(found, axis=0)
                true, false = np.sum(found, axis=0)[2:4].astype(int)
                of_true, of_false = len(seeds) * _TRUE, len(seeds) * len(made(case, 0).false)
                yield (
                    f"| {case} | {solver}, {name} | {before:.2f} | {after:.3f} | {true} of {of_true} "
                    f"| {false} of {of_false} | {seconds:.2f} |"
                )


def corridor(folder: Path, solver: str) -> str:
    """TU Chemnitz's corridor by one solver."""
    recording = open_recording(folder, OpenOptions())
    localizer = Localizer(recording.calibration, load_config(overrides={"odometry": "wheels"}))
    answers = [localizer.process(event) for event in recording.events()]
    posed = [a for a in answers if a is not None and a.T_odom_body is not None and a.reason is None]
    stamps_s, T, C = ([getattr(a, name) for a in posed] for name in ("stamp_s", "T_filter_body", "filter_covariance"))
    lived = Trajectory(np.array(stamps_s), np.array(T), np.array(C), "base", "odom")
    stated = recording.speed_variances if isinstance(recording, HasMatches) else None
    started = time.perf_counter()
    found = correct(lived, matches_of(recording)[0], stated=stated, graph=SOLVERS[solver]())
    seconds, truth = time.perf_counter() - started, recording.ground_truth
    assert truth is not None
    before, after = (ate(way, truth, max_gap_s=_TRUTH_GAP_S).translation.rmse for way in (lived, found.corrected))
    counts = f"{len(found.loops.kept)} | {len(found.loops.refused)}"
    return f"| corridor_864m | {solver}, at once | {before:.2f} | {after:.3f} | {counts} | {seconds:.2f} |"


def main() -> None:
    """Print tables in Markdown."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, default=3)
    parser.add_argument("--data", type=Path, default=default_data_folder())
    arguments = parser.parse_args()
    print("| loops | solver | odometry, m | corrected, m | true kept | false kept | worst step or whole, s |")
    print("|---|---|---:|---:|---:|---:|---:|")
    for row in rows(range(arguments.seeds)):
        print(row, flush=True)
    folder = arguments.data / _CORRIDOR
    if not folder.is_dir():
        print(f"{folder} is not there: no corridor")
        return
    print("\n| recording | solver | odometry, m | corrected, m | kept | refused | s |")
    print("|---|---|---:|---:|---:|---:|---:|")
    for solver in SOLVERS:
        print(corridor(folder, solver), flush=True)


if __name__ == "__main__":
    main()
