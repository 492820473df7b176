"""What can be exported from a path: a run's folder, a map's, or a recording; each part is read when it is asked for."""

from __future__ import annotations

import csv
import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

from wheelsight.calibration import Calibration
from wheelsight.config import load_config
from wheelsight.errors import ConfigError, InputError, MapError, OutputError, RecordingError
from wheelsight.files import StrPath
from wheelsight.inputs import Kind, is_there, lines_of, parse_json, read_text
from wheelsight.pipeline import CORRECTED_FILE, MAP_FILE
from wheelsight.pipeline.covariances import COVARIANCES_FILE, with_covariances
from wheelsight.pipeline.outputs import METRICS_FILE, ODOM_FILE, STATUS_FILE, TRAJECTORY_FILE
from wheelsight.recordings import Recording, open_recording
from wheelsight.slam.sessions import MAP_FOLDER, MapFolder, find_map, is_map
from wheelsight.trajectory import Trajectory, read_tum

# Where a run of several odometries has its best trajectory, first the one that knows most.
_TRACKS = ("", "joined", "dense", "features", "own", "rectified", "wheels")
_SETTINGS_FILE = "config.yaml"
_DETAILS = ("matches", "inliers", "time_ms", "flags", "note")
_STATUS = Kind("a run's status", most_mb=192)
_METRICS = Kind("a run's figures", most_mb=64)


@dataclass(frozen=True, slots=True)
class StatusRow:
    """What a run said of one frame or reading, as its status.csv has it."""

    stamp_s: float
    status: str
    reason: str
    details: tuple[tuple[str, str], ...]


@dataclass(frozen=True)
class Exported:
    """A path and what it holds.

    Attributes:
        path: as it was given.
        track: folder of a run's trajectory, or None where the path is no run.
    """

    path: Path
    track: Path | None

    @cached_property
    def trajectory(self) -> Trajectory | None:
        """As known on the way, with covariances where the run knew them. Raises TrajectoryError."""
        if self.track is None:
            return None
        found = read_tum(self.track / TRAJECTORY_FILE)
        table = self.track / COVARIANCES_FILE
        return with_covariances(found, table) if is_there(table) else found

    @cached_property
    def odom(self) -> Trajectory | None:
        """The way without the leaps of `trajectory`, in odom, or None where that has none. Raises TrajectoryError."""
        if self.track is None or not is_there(self.track / ODOM_FILE):
            return None
        return read_tum(self.track / ODOM_FILE)

    @cached_property
    def corrected(self) -> Trajectory | None:
        """As known at the end, in the map, or None where no loops corrected it. Raises TrajectoryError."""
        if self.track is None or not is_there(self.track / CORRECTED_FILE):
            return None
        return read_tum(self.track / CORRECTED_FILE)

    @cached_property
    def recording(self) -> Recording | None:
        """The recording itself, or that of the run; None where a run's was live.

        Raises RecordingError where it is not where it was, or cannot be read.
        """
        if self.track is None:
            return None if self.map is not None else open_recording(self.path)
        path = self.path / METRICS_FILE
        try:
            told: Any = parse_json(read_text(path, _METRICS, OutputError))["recording"]["path"]
        except (KeyError, TypeError, ValueError) as error:
            raise OutputError("does not tell of a run's recording", path=path, fix="run again") from error
        if told is None:
            return None
        if not isinstance(told, str) or "\0" in told:
            raise OutputError("does not tell of a run's recording", path=path, fix="run again")
        # A run in another folder told it from there, which is mostly a folder that the run lies in, too.
        found = next(
            (path for path in (Path(told), *(up / told for up in self.path.absolute().parents)) if is_there(path)), None
        )
        if found is None:
            raise RecordingError("the run's recording is not there any more", path=told, fix="put it where it was")
        return open_recording(found, load_config(self._settings_file).recording.open_options())

    @property
    def _settings_file(self) -> Path:
        # Of several odometries each has figures of its own, and the run's settings lie beside their folders.
        own = self.path / _SETTINGS_FILE
        return own if is_there(own) else self.path.parent / _SETTINGS_FILE

    @cached_property
    def map(self) -> MapFolder | None:
        """The map folder, or None where there is none. Raises MapError where it is damaged."""
        for folder in (self.path, *((self.track / MAP_FOLDER,) if self.track is not None else ())):
            if is_map(folder):
                return MapFolder.open(folder)
        return None

    @property
    def surfels_file(self) -> Path | None:
        """A run's surfels."""
        path = None if self.track is None else self.track / MAP_FILE
        return path if path is not None and is_there(path) else None

    @property
    def calibration(self) -> Calibration | None:
        """Of the robot, by the map, else by the recording; None where neither tells or is there."""
        if self.map is not None:
            return self.map.calibration
        try:
            return None if self.recording is None else self.recording.calibration
        except InputError:
            return None

    def status(self) -> Iterator[StatusRow]:
        """What a run said of each frame; nothing of what is no run. Raises OutputError."""
        if self.track is None:
            return
        path = self.track / STATUS_FILE
        try:
            for row in csv.DictReader(lines_of(read_text(path, _STATUS, OutputError))):
                yield _status_row(row)
        except (KeyError, TypeError, ValueError, csv.Error) as error:
            raise OutputError("is no status of a run", path=path, fix="run again") from error

    def need_map(self) -> MapFolder:
        """The map. Raises MapError, with how to make one."""
        return self.map if self.map is not None else MapFolder.open(find_map(self.path))


def _status_row(row: Mapping[str, str | None]) -> StatusRow:
    """Raises KeyError, TypeError or ValueError for what is none: csv leaves None where a line is short."""
    stamp, status, reason, *cells = (row[name] for name in ("stamp_s", "status", "reason", *_DETAILS))
    details = tuple((name, cell) for name, cell in zip(_DETAILS, cells, strict=True) if cell is not None)
    if stamp is None or status is None or reason is None or len(details) < len(_DETAILS):
        raise ValueError("a short line")
    stamp_s = float(stamp)
    if not math.isfinite(stamp_s):
        raise ValueError(stamp)
    return StatusRow(stamp_s, status, reason, details)


def exported_at(path: StrPath) -> Exported:
    """What a path holds: nothing is read yet but names. Raises ConfigError where there is nothing."""
    path = Path(path)
    if not is_there(path):
        raise ConfigError(f"there is no such folder or file: {path}", fix="check the path")
    if not is_there(path / METRICS_FILE):
        return Exported(path, None)
    found = next((path / track for track in _TRACKS if is_there(path / track / TRAJECTORY_FILE)), None)
    if found is None:
        raise MapError(f"holds no {TRAJECTORY_FILE}", path=path, fix="run again: wheelsight run RECORDING --out DIR")
    return Exported(path, found)
