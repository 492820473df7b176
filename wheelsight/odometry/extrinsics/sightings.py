"""Sightings: all that one pass over a drive leaves for finding where its camera sits."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from wheelsight.calibration import Wheels
from wheelsight.events import RgbdFrame, SkippedFrame
from wheelsight.geometry import Float32Array, FloatArray, PinholeCamera
from wheelsight.odometry.dense import DenseOdometry
from wheelsight.odometry.extrinsics.floor import FloorViews
from wheelsight.odometry.extrinsics.settings import DEFAULTS, SightingSettings
from wheelsight.odometry.wheels import Drive, drive_of
from wheelsight.recordings import Recording
from wheelsight.recordings.repeats import Repeats
from wheelsight.trajectory import Trajectory


@dataclass(frozen=True, eq=False)
class Sightings:
    """What wheels and camera saw of one drive.

    Attributes:
        drive: the wheels' readings.
        camera: T_map_camera of the frames that were tracked in all directions, by dense odometry; its map is the
            first of them.
        frame_count: of all frames, lost ones included.
        span_s: stamps of the first and last of them; NaN without any.
        views: thinned depth images.
    """

    drive: Drive
    camera: Trajectory
    frame_count: int
    span_s: tuple[float, float]
    views: FloorViews


def watch(
    recording: Recording,
    wheels: Wheels,
    on_frame: Callable[[str], None] = lambda _: None,
    settings: SightingSettings = DEFAULTS.sightings,
) -> Sightings:
    """Read a recording once, wheels and images.

    Args:
        recording: with wheel readings and a camera.
        wheels: what its counters count.
        on_frame: told the camera's status after each frame.
        settings: what is kept of depth images.

    Raises:
        CalibrationError: fewer than two wheel readings, or no camera.
    """
    drive = drive_of(recording, wheels)
    _, depth_camera = recording.calibration.cameras
    odometry = DenseOdometry(recording.calibration)
    gatherer = _ViewGatherer(depth_camera, settings)
    poses, repeats = list[tuple[float, FloatArray]](), Repeats()
    frame_count, span_s = 0, (math.nan, math.nan)
    for event in recording.events():
        if isinstance(event, SkippedFrame):
            estimate = odometry.miss(event.stamp_s)
        elif isinstance(event, RgbdFrame):
            if repeats.lasting_s(event) > 0:
                continue
            estimate = odometry.process(event)
            gatherer.add(event)
        else:
            continue
        frame_count, span_s = frame_count + 1, (event.stamp_s if not frame_count else span_s[0], event.stamp_s)
        if estimate.T_odom_body is not None and estimate.motion.shows_all:
            poses.append((estimate.stamp_s, estimate.T_odom_body))
        on_frame(estimate.status)
    odometry.store.close()
    return Sightings(drive, _trajectory(poses), frame_count, span_s, gatherer.views)


def _trajectory(poses: list[tuple[float, FloatArray]]) -> Trajectory:
    return Trajectory(np.array([stamp_s for stamp_s, _ in poses]), np.array([T for _, T in poses]).reshape(-1, 4, 4))


class _ViewGatherer:
    """Keeps a coarse grid of depth now and then, less often in long drives, so that memory stays flat."""

    def __init__(self, camera: PinholeCamera, settings: SightingSettings) -> None:
        step = max(1, camera.height // settings.rows)
        self._grid = np.s_[step // 2 :: step, step // 2 :: step]
        self._rays = camera.rays()[self._grid].reshape(-1, 3)
        self._stamps_s: list[float] = []
        self._depths_m: list[Float32Array] = []
        self._period_s, self._most_views = settings.first_period_s, settings.most_views

    def add(self, frame: RgbdFrame) -> None:
        if self._stamps_s and frame.stamp_s < self._stamps_s[-1] + self._period_s:
            return
        self._stamps_s.append(frame.stamp_s)
        self._depths_m.append(frame.depth_m[self._grid].ravel())
        if len(self._stamps_s) > self._most_views:
            del self._stamps_s[1::2], self._depths_m[1::2]
            self._period_s *= 2

    @property
    def views(self) -> FloorViews:
        depth_m = np.array(self._depths_m, np.float64).reshape(len(self._stamps_s), len(self._rays))
        return FloorViews(np.array(self._stamps_s), self._rays, depth_m)
