"""`python -m benchmarks.flat`: a simulated home. How exactly it is tracked, and how exactly it is modelled."""

from __future__ import annotations

import sys
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from rich.console import Console

from benchmarks import machine
from benchmarks.known_poses import VOXEL_M, KnownSurfels, KnownVolume, TruePoses, frame_pairs
from benchmarks.sequences import Sequence
from benchmarks.table import Sheet
from benchmarks.targets import Target
from benchmarks.true_surface import SurfaceBuilder, TrueSurface
from wheelsight.config import load_config
from wheelsight.core.geometry import FloatArray
from wheelsight.core.messages import RgbdFrame
from wheelsight.core.trajectory import Trajectory
from wheelsight.estimation import Localizer
from wheelsight.io.recordings import express_for
from wheelsight_sim import SimulatedRecording, SimulationSettings, simulate

ATE_M = 0.01
MEAN_M, COVERED_PERCENT = 0.008, 95.0
_SECONDS = 8.0
_SEED = 7
# Surfaces farther off are not counted as seen; Kinect v1 is meant for 3.5 m.
SEEN_M = 3.5


@dataclass(frozen=True, slots=True)
class ModelFigures:
    """How good a model is.

    Attributes:
        points: surfels, or points of the surface in a volume.
        mean_m: mean distance of the points to the true surface.
        p95_m: 95th percentile of that.
        covered: share of the true surface that was seen and has a point within 2 cm.
    """

    points: int
    mean_m: float
    p95_m: float
    covered: float


@dataclass(frozen=True, slots=True)
class FlatFigures:
    """What was measured in the flat, by 640×480 images at 30 Hz.

    Attributes:
        frames: of the drive.
        ideal_ate_m, kinect_ate_m: of tracking with the surfel map, by either camera; None where it has too few poses.
        stable, every: stable surfels of a map fed with Kinect v1's frames and true poses, and all of them.
        volume: Open3D's, fed with the same; None where Open3D cannot be loaded.
    """

    frames: int
    ideal_ate_m: float | None
    kinect_ate_m: float | None
    stable: ModelFigures
    every: ModelFigures
    volume: ModelFigures | None


def measure_flat(seconds: float = _SECONDS) -> FlatFigures:
    """Both cameras along one drive, each frame rendered once."""
    recordings = [_simulate(camera, seconds) for camera in ("ideal", "kinect-v1")]
    ideal, kinect = recordings
    poses = TruePoses(kinect)
    trackers = [_Tracker(recording) for recording in recordings]
    surfels, volume = KnownSurfels(kinect.calibration), volume_of(kinect)
    builder, count = SurfaceBuilder(ideal.calibration.cameras[1]), 0
    for exact, noisy in frame_pairs(ideal, kinect):
        for tracker, frame in zip(trackers, (exact, noisy), strict=True):
            tracker.track(frame)
        surfels.fuse(noisy, poses)
        if volume is not None:
            volume.fuse(noisy, poses)
        builder.add(exact.depth_m, poses.at(exact.stamp_s), (noisy.depth_m > 0) & (exact.depth_m < SEEN_M))
        count += 1
    surface = builder.surface()
    stable, every = (surfels.map.surfels(which).position.astype(float) for which in ("stable", "all"))
    return FlatFigures(
        frames=count,
        ideal_ate_m=trackers[0].ate_m(),
        kinect_ate_m=trackers[1].ate_m(),
        stable=model_figures(surface, stable),
        every=model_figures(surface, every),
        volume=None if volume is None else model_figures(surface, volume.points()),
    )


def model_figures(surface: TrueSurface, points: FloatArray) -> ModelFigures:
    """Points (n, 3) of a model against the true surface."""
    distance_m = surface.distances_m(points)
    return ModelFigures(
        len(points), float(distance_m.mean()), float(np.percentile(distance_m, 95)), surface.covered(points)
    )


def tracking_sheet(figures: FlatFigures) -> Sheet:
    """Errors of tracking."""
    rows = (("ideal", _metres(figures.ideal_ate_m)), ("kinect-v1", _metres(figures.kinect_ate_m)))
    title = f"The simulated flat: tracking with surfels, {figures.frames} frames of 640×480"
    return Sheet(title, ("camera", "ATE m"), rows)


def model_sheet(figures: FlatFigures) -> Sheet:
    """Errors of the models."""
    models = (
        ("stable surfels", figures.stable),
        ("all surfels", figures.every),
        (f"Open3D's volume, {1e3 * VOXEL_M:g} mm", figures.volume),
    )
    header = ("model", "points", "mean distance mm", "95 % below mm", "seen surface within 2 cm")
    rows = tuple((name, *_model(model)) for name, model in models)
    return Sheet("The simulated flat: models of Kinect v1's frames, given true poses", header, rows)


def judge_flat(figures: FlatFigures) -> list[Target]:
    """What tracking and the model must reach."""
    stable, every, volume = figures.stable, figures.every, figures.volume
    peer_m, peer_covered = (None, None) if volume is None else (volume.mean_m, 100 * volume.covered)
    covered = 100 * stable.covered
    return [
        Target("flat, ideal camera: with surfels, ATE", ATE_M, figures.ideal_ate_m, "m", 4),
        Target("flat, Kinect v1: with surfels, ATE", ATE_M, figures.kinect_ate_m, "m", 4),
        Target("flat, Kinect v1: stable surfels to the surface, mean", MEAN_M, stable.mean_m, "m", 4),
        Target("flat: the same, no more than of Open3D's volume", peer_m, stable.mean_m, "m", 4),
        Target("flat: seen surface within 2 cm of a surfel", COVERED_PERCENT, 100 * every.covered, "%", is_least=True),
        Target("flat: of a stable surfel, as of Open3D's volume", peer_covered, covered, "%", is_least=True),
    ]


class _Tracker:
    """Our tracking with the surfel map over one camera's frames."""

    def __init__(self, recording: SimulatedRecording) -> None:
        settings = load_config(overrides={"odometry": "dense", "map": "surfels"})
        self._localizer = Localizer(recording.calibration, settings)
        T_base_camera = recording.calibration.T_base_camera
        assert T_base_camera is not None
        self._T_base_camera = T_base_camera
        truth = express_for("camera", recording.ground_truth, recording.true_calibration)
        self._sequence = Sequence(recording.name, Path(recording.name), truth)
        self._stamps_s: list[float] = []
        self._poses: list[FloatArray] = []

    def track(self, frame: RgbdFrame) -> None:
        estimate = self._localizer.process(frame)
        if estimate is not None and estimate.T_odom_body is not None:
            self._stamps_s.append(frame.stamp_s)
            self._poses.append(estimate.T_odom_body @ self._T_base_camera)

    def ate_m(self) -> float | None:
        if not self._poses:
            return None
        return self._sequence.accuracy(Trajectory(np.array(self._stamps_s), np.array(self._poses))).ate_m


def _simulate(camera: str, seconds: float) -> SimulatedRecording:
    settings = SimulationSettings(world="flat", camera=camera, size=(640, 480), duration_s=seconds, seed=_SEED)
    return simulate(settings)


def volume_of(recording: SimulatedRecording) -> KnownVolume | None:
    """An empty volume for a recording's frames, or None where Open3D cannot be loaded."""
    try:
        return KnownVolume(recording.calibration, SEEN_M)
    except ImportError:
        return None


def _metres(value: float | None) -> str:
    return "—" if value is None else f"{value:.4f}"


def _model(model: ModelFigures | None) -> tuple[str, ...]:
    if model is None:
        return ("—",) * 4
    errors = (f"{1e3 * model.mean_m:.1f}", f"{1e3 * model.p95_m:.1f}")
    return (f"{model.points:,}", *errors, f"{100 * model.covered:.1f} %")


if __name__ == "__main__":
    if machine.is_busy():
        print("The machine is busy, which does not change these figures.", file=sys.stderr)
    seconds = float(sys.argv[1]) if sys.argv[1:] else _SECONDS
    measured = measure_flat(seconds)
    for sheet in (tracking_sheet(measured), model_sheet(measured)):
        Console(width=140).print(sheet.to_rich())
