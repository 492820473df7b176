"""SurfelMapper: dense odometry against the surfel map that it builds on the way."""

from __future__ import annotations

import numpy as np

from wheelsight.calibration import Calibration
from wheelsight.estimates import Status
from wheelsight.events import RgbdFrame
from wheelsight.geometry import FloatArray
from wheelsight.mapping._thinning import Thinning
from wheelsight.mapping.settings import SurfelSettings
from wheelsight.mapping.surfels import SurfelMap
from wheelsight.mapping.values import FusedFrame
from wheelsight.odometry.dense import DenseEstimate, DenseOdometry, DenseSettings, GridFrame

# Tracking takes grey from each frame; colour, which is only looked at, is brought onto the grid for one of so many. A
# surfel is stable after more.
_COLORED_EVERY = 3
# Where more of a frame's depths than this lie beyond the map's end, keyframes show more than the map does.
_BEYOND_SHARE = 0.05


class SurfelMapper:
    """Aligns each frame with what the map predicts, then averages it into the map; a frame that fails never gets there.

    Of frames that hardly move, one in a tenth of a second is averaged in.

    Without `tracks` frames are aligned with keyframes, and the map is only built.

    The camera that a robot's base carries starts at `T_base_camera`, so that the map begins where the base was,
    z up; a camera alone starts at identity.

    Attributes:
        map: what was seen so far.
        odometry: what finds the poses; it knows the last motion and how long each stage took, fusing included.
        last_fused: what fusing the last frame did; None where it was not fused.
        tracked: the last frame, if it has a pose; who calls odometry itself sets it.
    """

    def __init__(
        self,
        calibration: Calibration,
        dense: DenseSettings | None = None,
        surfels: SurfelSettings | None = None,
        *,
        tracks: bool = True,
    ) -> None:
        self.map = SurfelMap(surfels)
        self._thinning = Thinning(self.map.settings)
        self.odometry = DenseOdometry(calibration, dense, self.map if tracks else None, calibration.T_base_camera)
        self._noise = calibration.depth_noise
        self.last_fused: FusedFrame | None = None
        self.tracked: GridFrame | None = None
        self._fused = 0

    def process(self, frame: RgbdFrame, T_previous_current_prior: FloatArray | None = None) -> DenseEstimate:
        """The camera's pose at a frame, as `DenseOdometry` answers; the map learns where all of it was seen."""
        estimate = self.odometry.process(frame, T_previous_current_prior)
        self.last_fused, self.tracked = None, estimate.frame
        is_known = estimate.status is Status.TRACKING and estimate.shows_all
        if is_known and estimate.T_odom_body is not None:
            self.fuse(frame, estimate.T_odom_body)
        return estimate

    def track_map(self, tracks: bool) -> None:
        """From now on align frames with what the map predicts, or with keyframes."""
        self.odometry.refer_to(self.map if tracks else None)

    @property
    def shows_most(self) -> bool:
        """Whether hardly anything of what the last frame saw lies beyond where the map ends; False if it failed."""
        if self.tracked is None:
            return False
        depth_m = self.tracked.levels[-1].depth_m
        beyond = np.count_nonzero(depth_m > self.map.settings.far_m)
        return bool(beyond <= _BEYOND_SHARE * np.count_nonzero(depth_m))

    def miss(self, stamp_s: float) -> DenseEstimate:
        """Count a frame that came to nothing before it reached odometry, as a failed one."""
        self.last_fused = self.tracked = None
        return self.odometry.miss(stamp_s)

    def fuse(self, frame: RgbdFrame, T_map_camera: FloatArray) -> None:
        """Average the frame that odometry tracked last into the map, at a pose (4, 4) that may be another's.

        A frame that hardly moved since the last one fused is left out.
        """
        frames = self._thinning.count(T_map_camera, frame.stamp_s)
        if not frames:
            return
        with self.odometry.watch.stage("fuse"):
            assert self.tracked is not None, "the last frame has no pose"
            with_color = self._fused % _COLORED_EVERY == 0
            surface = self.odometry.surface(self.tracked, frame, with_color)
            self._fused += 1
            where = (self.odometry.intrinsics, T_map_camera, frame.stamp_s, self._noise, frames)
            self.last_fused = self.map.fuse(surface.depth_m, surface.normal, surface.grey, surface.color, *where)
