"""`python -m benchmarks.likeness`: whether odometry errs on simulated recordings as it does on real ones.

The simulated camera is carried along the true way of each real recording, through a room with a desk full of things.
"""

from __future__ import annotations

import argparse
import itertools
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from rich.console import Console

from benchmarks.likeness_desk import desk_world
from benchmarks.likeness_residuals import Residuals, residuals
from benchmarks.likeness_ways import QUANTILES, placed, upright
from benchmarks.sequences import Accuracy, Sequence, default_data_folder, find_sequences
from benchmarks.table import Sheet
from wheelsight.core.calibration import Calibration
from wheelsight.core.estimates import CameraEstimate
from wheelsight.core.geometry import FloatArray
from wheelsight.core.messages import RgbdFrame
from wheelsight.core.trajectory import Trajectory
from wheelsight.io.recordings import express_for, open_recording
from wheelsight.vision.dense import DenseOdometry
from wheelsight.vision.features import FeatureOdometry
from wheelsight_sim import RealismName, SimulationSettings, replay

_SEED = 7
_KINECT = SimulationSettings(size=(640, 480), rate_hz=30.0, seed=_SEED)
_REALISMS: tuple[RealismName, ...] = ("real", "ideal")
_EVERY = 20  # of which frames depths are looked at, to find a place like theirs
# Height of the camera on average, and what is up in the frame of the truth. The motion capture's z is; the kitchen's
# truth begins with the first camera, which looks down by about 25°.
_HELD = {
    "rgbd_dataset_freiburg1_desk": (1.47, (0.0, 0.0, 1.0)),
    "freiburg1_rpy_part": (1.54, (0.0, 0.0, 1.0)),
    "red_kitchen": (1.45, (-0.089, -0.868, -0.488)),
}


@dataclass(frozen=True, slots=True)
class Tracked:
    """What one odometry made of a recording: the share of the frames it tracked, its errors, and mean inlier share."""

    share: float
    accuracy: Accuracy
    inliers: float


@dataclass(frozen=True, slots=True)
class Likeness:
    """What a recording is to odometry.

    Attributes:
        name: of the recording, and which camera it is by.
        valid: share of pixels with depth.
        residuals: under the true motion, or None where colour and depth have no common pixels.
        features, dense: the two odometries.
    """

    name: str
    valid: float
    residuals: Residuals | None
    features: Tracked
    dense: Tracked


def measure_real(sequence: Sequence, seconds: float) -> Likeness:
    """Of a recording on the disk."""
    recording = open_recording(sequence.path)
    return _measure(f"{sequence.name}, recorded", sequence, recording.calibration, list(_first(sequence, seconds)))


def measure_replayed(sequence: Sequence, realism: RealismName, seconds: float) -> Likeness:
    """Of the simulated camera that moves as the recording's did."""
    assert sequence.truth is not None
    height_m, up = _HELD[sequence.name]
    world = desk_world(_SEED)
    way = upright(sequence.truth, np.array(up) / np.linalg.norm(up), height_m)
    way = placed(way, world, _quantiles_m(sequence)).way
    settings = replace(_KINECT, realism=realism, duration_s=seconds)
    recording = replay(settings, way, world)
    truth = express_for("camera", recording.ground_truth, recording.true_calibration)
    simulated = replace(sequence, truth=truth, is_registered=True)
    frames = list(recording.renderer.frames())
    return _measure(f"{sequence.name}, simulated {realism}", simulated, recording.calibration, frames)


def likeness_sheet(results: Iterable[Likeness]) -> Sheet:
    """One row a recording."""
    odometry = ("tracked", "inliers", "RPE/s mm", "RPE/s °")
    header = ("recording", "valid", "depth /z² ‰", "grey", *odometry, *("dense: " + odometry[0], *odometry[2:]))
    return Sheet("Odometry on real recordings, and replayed by the simulator", header, tuple(map(_cells, results)))


def _measure(name: str, sequence: Sequence, calibration: Calibration, frames: list[RgbdFrame]) -> Likeness:
    assert sequence.truth is not None
    return Likeness(
        name,
        float(np.mean([np.count_nonzero(frame.depth_m) / frame.depth_m.size for frame in frames])),
        residuals(frames, sequence.truth, calibration),
        _track(FeatureOdometry(calibration), sequence, frames),
        _track(DenseOdometry(calibration), sequence, frames),
    )


def _track(odometry: FeatureOdometry | DenseOdometry, sequence: Sequence, frames: list[RgbdFrame]) -> Tracked:
    estimates: list[CameraEstimate] = [odometry.process(frame) for frame in frames]
    known = [estimate for estimate in estimates if estimate.T_odom_body is not None]
    poses = [estimate.T_odom_body for estimate in known if estimate.T_odom_body is not None]
    path = Trajectory(np.array([estimate.stamp_s for estimate in known]), np.array(poses), body="camera")
    shares = [estimate.inliers / estimate.matches for estimate in known if estimate.matches]
    return Tracked(len(known) / len(frames), sequence.accuracy(path), float(np.mean(shares)) if shares else np.nan)


def _first(sequence: Sequence, seconds: float) -> Iterator[RgbdFrame]:
    frames = (event for event in open_recording(sequence.path).events() if isinstance(event, RgbdFrame))
    first = next(frames)
    yield first
    yield from itertools.takewhile(lambda frame: frame.stamp_s - first.stamp_s <= seconds, frames)


def _quantiles_m(sequence: Sequence) -> FloatArray:
    depths = [frame.depth_m for frame in itertools.islice(_first(sequence, np.inf), 0, None, _EVERY)]
    return np.asarray(np.mean([np.quantile(depth_m[depth_m > 0], QUANTILES) for depth_m in depths], axis=0))


def _cells(result: Likeness) -> tuple[str, ...]:
    r, f, d = result.residuals, result.features, result.dense
    fit = ("—", "—") if r is None else (f"{1000 * r.depth_per_m:.1f}", f"{r.grey:.1f}")
    features = (f"{100 * f.share:.0f} %", f"{f.inliers:.2f}", *_drift(f.accuracy))
    return (result.name, f"{100 * result.valid:.0f} %", *fit, *features, f"{100 * d.share:.0f} %", *_drift(d.accuracy))


def _drift(accuracy: Accuracy) -> tuple[str, str]:
    mm = "—" if accuracy.rpe_m is None else f"{1000 * accuracy.rpe_m:.1f}"
    return mm, "—" if accuracy.rpe_deg is None else f"{accuracy.rpe_deg:.2f}"


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.likeness", description=__doc__)
    parser.add_argument("--data", type=Path, default=default_data_folder(), help="folder with rgbd/RECORDING in it")
    parser.add_argument("--seconds", type=float, default=8.0, help="of each recording")
    parser.add_argument("--only", default="", help="part of a recording's name")
    arguments = parser.parse_args()
    sequences = [s for s in find_sequences(arguments.data) if s.name in _HELD and arguments.only in s.name]
    rows = []
    for sequence in sequences:
        rows.append(measure_real(sequence, arguments.seconds))
        rows += [measure_replayed(sequence, realism, arguments.seconds) for realism in _REALISMS]
    Console(width=150).print(likeness_sheet(rows).to_rich())


if __name__ == "__main__":
    main()
