"""Recordings for the pipeline whose outcome is known, and its results read back."""

from __future__ import annotations

import csv
import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from stand_ins import MemoryRecording, frame

from wheelsight.config import load_config
from wheelsight.core.calibration import Calibration
from wheelsight.core.calibration_parts import Wheels
from wheelsight.core.geometry import se3
from wheelsight.core.messages import Event, WheelTicks
from wheelsight.core.trajectory import Trajectory
from wheelsight.wheels import integrate_log

FILES = {"trajectory.txt", "covariances.csv", "status.csv", "metrics.json", "config.yaml", "report.html"}
OF_ONE = {"trajectory.txt", "covariances.csv", "status.csv", "metrics.json"}
OF_JOINED = {*OF_ONE, "odom.txt"}
WHEELS = Wheels(0.17, 0.17, 0.52, 3200.0)
BY_FEATURES = load_config(overrides={"odometry": "features"})
BY_WHEELS = load_config(overrides={"odometry": "wheels"})
BOTH = load_config(overrides={"odometry": "wheels,features", "fusion": "none"})


def frames_at(truth: Trajectory, dark: tuple[int, ...] = ()) -> list[Event | BaseException]:
    return [frame(index, stamp_s, dark=index in dark) for index, (stamp_s, _) in enumerate(truth)]


def metrics_in(folder: Path) -> dict[str, Any]:
    return json.loads((folder / "metrics.json").read_text())


def status_in(folder: Path) -> list[dict[str, str]]:
    with (folder / "status.csv").open() as stream:
        return list(csv.DictReader(stream))


def wheel_recording(readings: int = 300, start_s: float = 0.0, **others: Any) -> MemoryRecording:
    """A drive through a bend, with its truth: the same path."""
    stamps_s = start_s + 0.02 * np.arange(readings)
    left, right = 30 * np.arange(readings), 40 * np.arange(readings)
    events = [WheelTicks(*reading) for reading in zip(stamps_s.tolist(), left.tolist(), right.tolist(), strict=True)]
    truth = integrate_log(WHEELS, stamps_s, left, right).trajectory()
    truth = Trajectory(truth.stamps_s, se3.exp([1, 2, 0, 0, 0, 0.5]) @ truth.T_frame_body, body="base")
    return MemoryRecording(events, truth, **{"calibration": Calibration(wheels=WHEELS), **others})


def names_in(folder: Path) -> set[str]:
    return {path.name for path in folder.iterdir()}


def mixed_recording(truth: Trajectory, stop_after: int | None = None) -> MemoryRecording:
    """Frames of a camera that is nowhere on the base, and readings of wheels, in order of time."""
    given = [*frames_at(truth), *wheel_recording(30, start_s=float(truth.stamps_s[0])).given]
    events: list[Event | BaseException] = sorted(given, key=lambda event: event.stamp_s)  # type: ignore[union-attr]
    if stop_after is not None:
        events.insert(stop_after, KeyboardInterrupt())
    return MemoryRecording(events, truth, calibration=replace(MemoryRecording([]).calibration, wheels=WHEELS))
