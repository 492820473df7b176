"""MapBuilder: the surfel map of a run, made of frames that an odometry has tracked."""

from __future__ import annotations

import numpy as np

from wheelsight.calibration import Calibration
from wheelsight.events import RgbdFrame
from wheelsight.geometry import FloatArray, se3
from wheelsight.mapping import FusedFrame, SurfelMap, SurfelSettings
from wheelsight.odometry.dense import DenseEstimate, DenseOdometry


class MapBuilder:
    """Averages tracked frames into a surfel map; of frames that hardly move, one in a tenth of a second.

    Args:
        odometry: tracks the frames, sees surfaces, and keeps the keyframes that surfels hang on.
        calibration: tells the noise of depth.
        settings: of the map.

    Attributes:
        map: what was seen so far.
    """

    def __init__(
        self, odometry: DenseOdometry, calibration: Calibration, settings: SurfelSettings | None = None
    ) -> None:
        self.map = SurfelMap(settings, odometry.store)
        self._odometry = odometry
        self._thinning = Thinning(self.map.settings)
        self._noise = calibration.depth_noise

    def fuse_tracked(self, frame: RgbdFrame, seen: DenseEstimate) -> FusedFrame | None:
        """Fuse a frame where odometry has seen it, T_map_camera; None if it is left out, or has no pose."""
        T_map_camera, odometry = seen.T_odom_body, self._odometry
        if seen.frame is None or T_map_camera is None:
            return None
        frames = self._thinning.count(T_map_camera, frame.stamp_s)  # with those before it that were left out
        if not frames:
            return None
        with odometry.watch.stage("fuse"):
            with_color = self.map.frames % self.map.settings.colored_every == 0
            surface = odometry.surface(seen.frame, frame, with_color)
            how = (self._noise, frames, seen.keyframe)
            return self.map.fuse(surface, odometry.intrinsics, T_map_camera, frame.stamp_s, *how)

    def track_map(self, tracks: bool) -> None:
        """From now on odometry aligns frames with what the map predicts, or with keyframes."""
        self._odometry.refer_to(self.map if tracks else None)


class Thinning:
    """Remembers the last frame that was fused, and counts those left out since.

    A frame from the same place shows the same pixels with the same errors of the sensor: it costs as much as one from
    elsewhere, and teaches less.
    """

    def __init__(self, settings: SurfelSettings) -> None:
        self._settings = settings
        self._T_map_last: FloatArray | None = None
        self._last_s, self._left_out = -np.inf, 0

    def count(self, T_map_camera: FloatArray, stamp_s: float) -> int:
        """As how many frames one at a pose (4, 4) is to be fused, with those left out before; 0 to leave it out too."""
        if self._T_map_last is not None and stamp_s - self._last_s < self._settings.fused_after_s:
            shift_m = se3.view_shift_m(se3.invert(self._T_map_last) @ T_map_camera)
            if shift_m < self._settings.fused_way_m:
                self._left_out += 1
                return 0
        frames, self._left_out = self._left_out + 1, 0
        self._T_map_last, self._last_s = T_map_camera, stamp_s
        return frames
