"""The exportable parts of a path: of a run's folder, a map or a recording. Holds the thinned points of a map, and poses
in ROS's conventions.
"""

from __future__ import annotations

import csv
import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from wheelsight.app.run import CORRECTED_FILE, MAP_FILE
from wheelsight.app.run.runs import (
    COVARIANCES_FILE,
    METRICS_FILE,
    ODOM_FILE,
    STATUS_FILE,
    TRAJECTORY_FILE,
    with_covariances,
)
from wheelsight.config import load_config
from wheelsight.core.calibration import Calibration
from wheelsight.core.errors import ConfigError, InputError, MapError, OutputError, RecordingError
from wheelsight.core.files import StrPath
from wheelsight.core.geometry import ByteArray, FloatArray, se3, so3
from wheelsight.core.inputs import Kind, is_there, lines_of, parse_json, read_text
from wheelsight.core.trajectory import Trajectory, read_tum
from wheelsight.io.recordings import Recording, open_recording
from wheelsight.mapping import colors_of, load_map
from wheelsight.slam.maps import MAP_FOLDER, MapFolder, find_map, is_map
from wheelsight_export.bag_writing import T_LINK_OPTICAL
from wheelsight_export.topics import BASE, LINK

# Where a run of several odometries has its best trajectory, first the one that knows most.
_TRACKS = ("", "joined", "dense", "features", "own", "rectified", "wheels")
_SETTINGS_FILE = "config.yaml"
_DETAILS = ("matches", "inliers", "time_ms", "flags", "note")
_STATUS = Kind("a run's status", most_mb=192)
_METRICS = Kind("a run's figures", most_mb=64)


@dataclass(frozen=True, slots=True)
class StatusRow:
    """One row of a run's status.csv."""

    stamp_s: float
    status: str
    reason: str
    details: tuple[tuple[str, str], ...]


@dataclass(frozen=True)
class Exported:
    """A path and its contents.

    Attributes:
        path: as given.
        track: folder of a run's trajectory, or None if the path is no run.
    """

    path: Path
    track: Path | None

    @cached_property
    def trajectory(self) -> Trajectory | None:
        """The trajectory during the run, with covariances if there are any. Raises TrajectoryError."""
        if self.track is None:
            return None
        found = read_tum(self.track / TRAJECTORY_FILE)
        table = self.track / COVARIANCES_FILE
        return with_covariances(found, table) if is_there(table) else found

    @cached_property
    def odom(self) -> Trajectory | None:
        """The continuous trajectory in odom, or None if `trajectory` is continuous. Raises TrajectoryError."""
        if self.track is None or not is_there(self.track / ODOM_FILE):
            return None
        return read_tum(self.track / ODOM_FILE)

    @cached_property
    def corrected(self) -> Trajectory | None:
        """The final trajectory in the map, or None without loops. Raises TrajectoryError."""
        if self.track is None or not is_there(self.track / CORRECTED_FILE):
            return None
        return read_tum(self.track / CORRECTED_FILE)

    @cached_property
    def recording(self) -> Recording | None:
        """The recording itself, or that of the run; None for a live run.

        Raises RecordingError if it was moved or cannot be read.
        """
        if self.track is None:
            return None if self.map is not None else open_recording(self.path)
        path = self.path / METRICS_FILE
        try:
            given: Any = parse_json(read_text(path, _METRICS, OutputError))["recording"]["path"]
        except (KeyError, TypeError, ValueError) as error:
            raise OutputError("does not name the run's recording", path=path, fix="run again") from error
        if given is None:
            return None
        if not isinstance(given, str) or "\0" in given:
            raise OutputError("does not name the run's recording", path=path, fix="run again")
        # A relative path starts at the working folder of the run, which is mostly a parent of its results.
        found = next(
            (path for path in (Path(given), *(up / given for up in self.path.absolute().parents)) if is_there(path)),
            None,
        )
        if found is None:
            raise RecordingError("the run's recording is not there any more", path=given, fix="put it where it was")
        # Of several odometries each has figures of its own, and the run's settings lie beside their folders.
        own = self.path / _SETTINGS_FILE
        settings = own if is_there(own) else self.path.parent / _SETTINGS_FILE
        return open_recording(found, load_config(settings, drop_removed=True).recording)

    @cached_property
    def map(self) -> MapFolder | None:
        """The map folder, or None. Raises MapError if it is damaged."""
        for folder in (self.path, *((self.track / MAP_FOLDER,) if self.track is not None else ())):
            if is_map(folder):
                return MapFolder.open(folder)
        return None

    @property
    def surfels_file(self) -> Path | None:
        """The file of a run's surfels."""
        path = None if self.track is None else self.track / MAP_FILE
        return path if path is not None and is_there(path) else None

    @property
    def calibration(self) -> Calibration | None:
        """The robot's calibration, from the map, else from the recording; None without both."""
        if self.map is not None:
            return self.map.calibration
        try:
            return None if self.recording is None else self.recording.calibration
        except InputError:
            return None

    def status(self) -> Iterator[StatusRow]:
        """The status rows of a run; none for other sources. Raises OutputError."""
        if self.track is None:
            return
        path = self.track / STATUS_FILE
        try:
            for row in csv.DictReader(lines_of(read_text(path, _STATUS, OutputError))):
                # An invalid row raises KeyError, TypeError or ValueError: csv gives None for missing cells.
                stamp, status, reason, *cells = (row[name] for name in ("stamp_s", "status", "reason", *_DETAILS))
                details = tuple((name, cell) for name, cell in zip(_DETAILS, cells, strict=True) if cell is not None)
                if stamp is None or status is None or reason is None or len(details) < len(_DETAILS):
                    raise ValueError("a short line")
                stamp_s = float(stamp)
                if not math.isfinite(stamp_s):
                    raise ValueError(stamp)
                status_row = StatusRow(stamp_s, status, reason, details)
                yield status_row
        except (KeyError, TypeError, ValueError, csv.Error) as error:
            raise OutputError("is no status of a run", path=path, fix="run again") from error

    def need_map(self) -> MapFolder:
        """The map. Raises MapError, with the command that makes one."""
        return self.map if self.map is not None else MapFolder.open(find_map(self.path))


def exported_at(path: StrPath) -> Exported:
    """The contents of a path; files are read later. Raises ConfigError if there are none."""
    path = Path(path)
    if not is_there(path):
        raise ConfigError(f"there is no such folder or file: {path}", fix="check the path")
    if not is_there(path / METRICS_FILE):
        return Exported(path, None)
    found = next((path / track for track in _TRACKS if is_there(path / track / TRAJECTORY_FILE)), None)
    if found is None:
        raise MapError(f"holds no {TRAJECTORY_FILE}", path=path, fix="run again: wheelsight run RECORDING --out DIR")
    return Exported(path, found)


@dataclass(frozen=True, slots=True, eq=False)
class ColoredPoints:
    """Points (N, 3) in the map, metres, and their colours (N, 3), red green blue."""

    p_map: FloatArray
    colors: ByteArray


def points_of(source: Exported, voxel_m: float) -> ColoredPoints | None:
    """Thinned stable surfels of a map, or all if none is stable; None without surfels. Raises MapError."""
    surfel_map = None if source.map is None else source.map.surfels()
    if surfel_map is None and source.surfels_file is not None:
        surfel_map = load_map(source.surfels_file)
    if surfel_map is None:
        return None
    surfels = surfel_map.surfels("stable")
    surfels = surfels if len(surfels.grey) else surfel_map.surfels("all")
    if not len(surfels.grey):
        return None
    return thinned(ColoredPoints(surfels.position.astype(float), colors_of(surfels)), voxel_m)


def thinned(points: ColoredPoints, voxel_m: float) -> ColoredPoints:
    """Mean point and colour of each occupied voxel of `voxel_m`. Raises MapError."""
    if not (np.isfinite(voxel_m) and voxel_m > 0):
        raise MapError(f"voxel_m is {voxel_m}, not a positive length")
    cells = np.floor(points.p_map / voxel_m).astype(np.int64)
    _, number, count = np.unique(cells, axis=0, return_inverse=True, return_counts=True)
    sums = np.zeros((len(count), 6))
    np.add.at(sums, number.reshape(-1), np.concatenate([points.p_map, points.colors], axis=1))
    means = sums / count[:, None]
    return ColoredPoints(means[:, :3], np.rint(means[:, 3:]).astype(np.uint8))


# ROS's conventions (REP 103, REP 105)


def body_frame(body: str) -> str:
    """ROS's name of a trajectory's body."""
    return BASE if body == "base" else LINK


def upright(trajectory: Trajectory) -> Trajectory:
    """A trajectory in frames with z up and of a body with x forward, as REP 103 asks.

    A base has such frames. A camera's trajectory is in optical axes: its frame and its body are rotated.
    """
    if trajectory.body == "base":
        return trajectory
    turned = trajectory.moved(T_LINK_OPTICAL)
    # From the right: what perturbs from the left stays as it is.
    return replace(turned, T_frame_body=turned.T_frame_body @ se3.invert(T_LINK_OPTICAL))


def upright_points(p: FloatArray, body: str) -> FloatArray:
    """Points (N, 3) of a map with trajectories of `body`, in the axes of `upright`."""
    return p if body == "base" else se3.apply(T_LINK_OPTICAL, p)


def pose_covariances(trajectory: Trajectory) -> FloatArray | None:
    """Covariances (N, 6, 6) as of PoseWithCovariance: of x, y, z and of rotations about the fixed axes of the parent.

    wheelsight's are of left perturbations (v, ω), which rotate about the parent's origin and move the position p by v +
    ω × p.
    """
    if trajectory.covariances is None:
        return None
    J = np.tile(np.eye(6), (len(trajectory), 1, 1))
    J[:, :3, 3:] = -so3.hat(trajectory.positions_m)
    return np.asarray(J @ trajectory.covariances @ np.swapaxes(J, 1, 2))


def twists(trajectory: Trajectory) -> FloatArray:
    """Twists (v, ω) (N, 6) of the body in its own axes, m/s and rad/s: means from the previous to the next pose.

    At both ends it is the twist of the only step; for a single pose it is zero.
    """
    count, T = len(trajectory), trajectory.T_frame_body
    if count < 2:
        return np.zeros((count, 6))
    before, after = np.arange(count) - 1, np.arange(count) + 1
    before[0], after[-1] = 0, count - 1
    lasted_s = trajectory.stamps_s[after] - trajectory.stamps_s[before]
    T_before_after = se3.compose(se3.invert(T[before]), T[after])
    # Of a motion that is even this is the twist at any of its moments, in the body's axes.
    return np.asarray(se3.log(T_before_after) / lasted_s[:, None])


def in_odom(lived: Trajectory, odom: Trajectory | None) -> Trajectory:
    """A trajectory in `odom`, where it is continuous, at the same stamps and with its covariances."""
    if odom is None:
        return lived
    _, rows, found = np.intersect1d(lived.stamps_s, odom.stamps_s, return_indices=True)
    T, C = odom.T_frame_body[found], lived.covariances
    if C is not None:
        Ad = se3.adjoint(se3.compose(T, se3.invert(lived.T_frame_body[rows])))
        C = Ad @ C[rows] @ np.swapaxes(Ad, 1, 2)
    return Trajectory(odom.stamps_s[found], T, C, body=odom.body, frame=odom.frame)


def map_to_odom(lived: Trajectory, corrected: Trajectory | None) -> tuple[FloatArray, FloatArray]:
    """Stamps (N,), and T_map_odom (N, 4, 4) at them: the identity without a correction.

    Poses that the correction lacks are left out: their place in the map is unknown.
    """
    if corrected is None:
        return lived.stamps_s, np.tile(np.eye(4), (len(lived), 1, 1))
    shared, rows, found = np.intersect1d(lived.stamps_s, corrected.stamps_s, return_indices=True)
    return shared, se3.compose(corrected.T_frame_body[found], se3.invert(lived.T_frame_body[rows]))
