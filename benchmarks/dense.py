"""`python -m benchmarks.dense RECORDING …`: dense tracking beside OpenCV's and Open3D's, one thread and two."""

from __future__ import annotations

import json
import os
import statistics
import subprocess
import sys
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path

from benchmarks import machine
from benchmarks.contenders import Contender, open3d_odometry, opencv_odometry
from benchmarks.measure import Feed, measure
from benchmarks.table import Sheet
from benchmarks.targets import Target
from wheelsight.calibration import Calibration
from wheelsight.evaluation import evaluate
from wheelsight.events import RgbdFrame
from wheelsight.geometry import FloatArray
from wheelsight.recordings import express_for, open_recording

OPENCV_SHARE, OPEN3D_SHARE = 0.25, 0.4
ATE_LIMIT_M = 0.02
THREADS = (2, 1)


class WheelsightDense:
    """`DenseOdometry` as a user gets it, against keyframes."""

    def __init__(self, calibration: Calibration, threads: int) -> None:
        from wheelsight.odometry.dense import DenseOdometry, DenseSettings

        self._odometry = DenseOdometry(calibration, DenseSettings(threads=threads))

    def prepare(self, frame: RgbdFrame) -> RgbdFrame:
        """The frame as the recording gives it, distortion and all."""
        return frame

    def track(self, prepared: RgbdFrame) -> FloatArray | None:
        """T_world_camera (4, 4), or None."""
        return self._odometry.process(prepared).T_world_body


def contenders(threads: int) -> tuple[Contender, ...]:
    """Ours first; all with so many threads."""
    settings = f"`DenseOdometry` with default settings, {threads} thread{'s' * (threads > 1)}"
    ours = Contender("wheelsight dense", partial(WheelsightDense, threads=threads), settings)
    return ours, opencv_odometry.RGB_DEPTH, open3d_odometry.HYBRID


@dataclass(frozen=True, slots=True)
class DenseFigures:
    """One contender over one recording.

    Attributes:
        recording: name.
        contender: name.
        threads: that it was given.
        median_ms: a frame, images decoded before.
        least_ms: of any frame but the first ten; less disturbed by what else the machine does.
        share: of the frames that got a pose.
        ate_m: RMSE after rigid alignment, or None where the recording has no truth.
    """

    recording: str
    contender: str
    threads: int
    median_ms: float
    least_ms: float
    share: float
    ate_m: float | None


def measure_dense(recordings: Sequence[Path], limit: int | None = None) -> list[DenseFigures]:
    """Each contender over each recording in a process of its own, which alone fixes how many threads libraries take."""
    return [
        _in_own_process(recording, number, threads, limit)
        for recording in recordings
        for threads in THREADS
        for number in range(len(contenders(threads)))
    ]


def measure_one(path: Path, number: int, threads: int, limit: int | None) -> DenseFigures:
    """Contender `number` over the first `limit` frames of a recording, in this process."""
    import cv2

    cv2.setNumThreads(threads)
    recording, contender = open_recording(path), contenders(threads)[number]
    passage, trajectory = measure(contender.start, recording, Feed.DECODED, limit)
    ate_m = None
    if recording.ground_truth is not None and len(trajectory):
        truth = express_for("camera", recording.ground_truth, recording.calibration)
        ate_m = evaluate(trajectory, truth).ate.translation.rmse
    median_ms, least_ms = 1e3 * statistics.median(passage.seconds), 1e3 * min(passage.seconds[10:])
    share = len(trajectory) / len(passage.stamps_s)
    return DenseFigures(recording.name, contender.name, threads, median_ms, least_ms, share, ate_m)


def dense_sheet(figures: Sequence[DenseFigures]) -> Sheet:
    """What each took and how far off it was."""
    heads = ("recording", "contender", "threads", "median", "least", "frames with a pose", "ATE")
    rows = tuple(
        (
            f.recording,
            f.contender,
            str(f.threads),
            f"{f.median_ms:.1f} ms",
            f"{f.least_ms:.1f} ms",
            f"{100 * f.share:.0f} %",
            "—" if f.ate_m is None else f"{f.ate_m:.4f} m",
        )
        for f in figures
    )
    return Sheet("Dense tracking alone, frame by frame", heads, rows)


def judge_dense(figures: Sequence[DenseFigures]) -> list[Target]:
    """Time against both peers with as many threads, and the error, recording by recording."""
    targets = []
    for ours, opencv, open3d in zip(figures[::3], figures[1::3], figures[2::3], strict=True):
        what = f"{ours.recording}, {ours.threads} thread{'s' * (ours.threads > 1)}: dense tracking, median"
        for share, peer in ((OPENCV_SHARE, opencv), (OPEN3D_SHARE, open3d)):
            targets.append(
                Target(f"{what}, {share:g} of {peer.contender}", share * peer.median_ms, ours.median_ms, "ms")
            )
        if ours.ate_m is not None and ours.threads == THREADS[0]:
            targets.append(Target(f"{ours.recording}: dense tracking, ATE", ATE_LIMIT_M, ours.ate_m, "m", decimals=4))
    return targets


def _in_own_process(recording: Path, number: int, threads: int, limit: int | None) -> DenseFigures:
    command = [sys.executable, "-m", "benchmarks.dense", "--one", str(number), str(threads), str(limit or 0)]
    environment = os.environ | {"OMP_NUM_THREADS": str(threads)}
    answer = subprocess.run([*command, str(recording)], env=environment, check=True, capture_output=True, text=True)
    return DenseFigures(**json.loads(answer.stdout.splitlines()[-1]))


def main() -> None:
    """Measure the recordings named; or, for a process of its own, one contender over one."""
    arguments = sys.argv[1:]
    if arguments[:1] == ["--one"]:
        number, threads, limit = (int(word) for word in arguments[1:4])
        print(json.dumps(asdict(measure_one(Path(arguments[4]), number, threads, limit or None))))
        return
    if not arguments:
        raise SystemExit("usage: python -m benchmarks.dense RECORDING …")
    if machine.is_busy():
        print("The machine is busy: times will be too long.", file=sys.stderr)
    figures = measure_dense([Path(word) for word in arguments])
    print(dense_sheet(figures).to_markdown())
    for target in judge_dense(figures):
        print(f"{target.what}: {target.verdict}")


if __name__ == "__main__":
    main()
