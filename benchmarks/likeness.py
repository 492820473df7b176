"""`python -m benchmarks.likeness`: whether feature odometry errs on simulated recordings as it does on real ones."""

from __future__ import annotations

import argparse
import itertools
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from rich.console import Console

from benchmarks.sequences import Accuracy, Sequence, default_data_folder, find_sequences
from benchmarks.table import Sheet
from wheelsight.calibration import Calibration
from wheelsight.estimates import Status
from wheelsight.events import Event, RgbdFrame
from wheelsight.odometry.features import FeatureOdometry, FeatureSettings
from wheelsight.odometry.features.extraction import FeatureExtractor
from wheelsight.recordings import express_for, open_recording
from wheelsight.simulation import SimulationSettings, simulate
from wheelsight.trajectory import Trajectory

_EVERY = 10  # of which frames keypoints are counted
_NEAR_M = 4.0
_KINECT = {"camera": "kinect-v1", "size": (640, 480), "rate_hz": 30.0, "seed": 7}
# What is driven before is skipped: corridor 1 and its chair, corridor 3 and its carpet, corridor 7 and its end.
_PARTS = (("flat", 0.0), ("floor4", 8.0), ("floor4", 52.0), ("floor4", 112.0))


@dataclass(frozen=True, slots=True)
class Likeness:
    """What feature odometry makes of a recording.

    Attributes:
        name: of the recording.
        frames, tracked: frames after the first, and how many of them were tracked.
        accuracy: ATE, and RPE over a second.
        keypoints: mean of some frames.
        with_depth, near: share of keypoints that have depth, and that have one below 4 m.
    """

    name: str
    frames: int
    tracked: int
    accuracy: Accuracy
    keypoints: float
    with_depth: float
    near: float


def measure_real(sequence: Sequence) -> Likeness:
    """Of a recording on the disk."""
    recording = open_recording(sequence.path)
    return _measure(sequence, recording.calibration, _frames_of(recording.events()))


def measure_simulated(world: str, begin_s: float, length_s: float) -> Likeness:
    """Of a part of a drive by Kinect v1, 640×480, 30 frames a second, 0.8 m/s."""
    settings = SimulationSettings(world=world, duration_s=begin_s + length_s, **_KINECT)  # type: ignore[arg-type]
    recording = simulate(settings)
    renderer = recording.renderer
    first = round(begin_s * renderer.rate_hz)
    truth = express_for("camera", recording.ground_truth, recording.true_calibration)
    sequence = Sequence(f"{world}, {begin_s:g} to {begin_s + length_s:g} s", Path(world), truth)
    return _measure(sequence, recording.calibration, map(renderer.frame, range(first, renderer.frame_count)))


def likeness_sheet(results: Iterable[Likeness]) -> Sheet:
    """One row a recording."""
    header = ("recording", "tracked", "ATE m", "RPE/s m", "RPE/s °", "keypoints", "with depth", "below 4 m")
    return Sheet("Feature odometry on real and simulated recordings", header, tuple(map(_cells, results)))


def _measure(sequence: Sequence, calibration: Calibration, frames: Iterator[RgbdFrame]) -> Likeness:
    odometry, extractor = FeatureOdometry(calibration), FeatureExtractor(calibration, FeatureSettings())
    stamps_s, poses, counted, frame_count = [], [], [], 0
    for number, frame in enumerate(frames):
        frame_count += 1
        estimate = odometry.process(frame)
        if estimate.status is Status.TRACKING and estimate.T_odom_body is not None:
            stamps_s.append(frame.stamp_s)
            poses.append(estimate.T_odom_body)
        if number % _EVERY == 0:
            features = extractor.extract(frame)
            near = features.has_depth & (features.depth_m < _NEAR_M)
            counted.append((len(features), features.has_depth.mean(), near.mean()))
    path = Trajectory(np.array(stamps_s), np.array(poses), body="camera")
    keypoints, with_depth, near_share = np.mean(counted, axis=0).tolist()
    tracked = sum(stamp_s > stamps_s[0] for stamp_s in stamps_s)
    accuracy = sequence.accuracy(path)
    return Likeness(sequence.name, frame_count - 1, tracked, accuracy, keypoints, with_depth, near_share)


def _frames_of(events: Iterable[Event]) -> Iterator[RgbdFrame]:
    return (event for event in events if isinstance(event, RgbdFrame))


def _cells(result: Likeness) -> tuple[str, ...]:
    a = result.accuracy
    errors = ["—" if e is None else f"{e:.{n}f}" for e, n in ((a.ate_m, 4), (a.rpe_m, 4), (a.rpe_deg, 2))]
    shares = (f"{100 * share:.0f} %" for share in (result.with_depth, result.near))
    return (result.name, f"{result.tracked} of {result.frames}", *errors, f"{result.keypoints:.0f}", *shares)


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.likeness", description=__doc__)
    parser.add_argument("--data", type=Path, default=default_data_folder(), help="folder with rgbd/RECORDING in it")
    parser.add_argument("--seconds", type=float, default=6.0, help="of each simulated part")
    arguments = parser.parse_args()
    real = map(measure_real, find_sequences(arguments.data))
    simulated = (measure_simulated(world, begin_s, arguments.seconds) for world, begin_s in _PARTS)
    Console(width=130).print(likeness_sheet(itertools.chain(real, simulated)).to_rich())


if __name__ == "__main__":
    main()
