"""The recordings to run over, and what their truth says of an estimate."""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path

from wheelsight.core.errors import EvaluationError, RecordingError
from wheelsight.core.trajectory import Trajectory
from wheelsight.evaluation import ate, rpe
from wheelsight.io.recordings import express_for, find_recordings, open_recording

PROJECT = Path(__file__).resolve().parent.parent


def default_data_folder() -> Path:
    """Where the project's real recordings are kept: WHEELSIGHT_DATA, else ../shared/data from the project's root."""
    return Path(os.environ.get("WHEELSIGHT_DATA") or PROJECT.parent / "shared" / "data")


@dataclass(frozen=True, slots=True)
class Accuracy:
    """RMSE of the absolute error after rigid alignment, and of the drift in a second; None where undefined."""

    ate_m: float | None = None
    rpe_m: float | None = None
    rpe_deg: float | None = None


@dataclass(frozen=True, eq=False)
class Sequence:
    """A recording, its true T_odom_camera if it has one, and whether its depth is registered to its colour."""

    name: str
    path: Path
    truth: Trajectory | None
    is_registered: bool = True

    def accuracy(self, estimate: Trajectory) -> Accuracy:
        """How far T_odom_camera is from the truth, where they share enough to tell."""
        if self.truth is None:
            return Accuracy()
        try:
            ate_m = ate(estimate, self.truth).translation.rmse
        except EvaluationError:
            return Accuracy()
        try:
            drift = rpe(estimate, self.truth, 1, "seconds")
        except EvaluationError:
            return Accuracy(ate_m)
        return Accuracy(ate_m, drift.translation.rmse, drift.rotation.in_degrees().rmse)


def find_sequences(data: Path) -> list[Sequence]:
    """All recordings in the folder `rgbd` of `data`, by name.

    Raises:
        InputError: there are none, or one cannot be read.
    """
    folder = data / "rgbd"
    paths = find_recordings(folder)
    if not paths:
        raise RecordingError("holds no recordings", path=folder, fix="give --data, a folder with rgbd/RECORDING in it")
    return [_open(path) for path in paths]


def _open(path: Path) -> Sequence:
    recording = open_recording(path)
    truth = recording.ground_truth
    if truth is not None:
        truth = express_for("camera", truth, recording.calibration)
    return Sequence(path.name, path, truth, recording.calibration.is_registered)
