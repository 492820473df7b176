"""MapBuilder: the surfel map of a run, made of frames that an odometry has tracked."""

from __future__ import annotations

import numpy as np

from wheelsight.calibration import Calibration
from wheelsight.estimates import Estimate
from wheelsight.events import RgbdFrame
from wheelsight.keyframes import KeyframeStore
from wheelsight.mapping import FusedFrame, SurfelMap, SurfelSettings
from wheelsight.mapping.thinning import Thinning
from wheelsight.odometry.dense import DenseEstimate, DenseOdometry
from wheelsight.odometry.features import FeatureOdometry


class MapBuilder:
    """Averages tracked frames into a surfel map; of frames that hardly move, one in a tenth of a second.

    Args:
        calibration: tells the noise of depth.
        settings: of the map.
        store: of the keyframes that surfels hang on.

    Attributes:
        map: what was seen so far.
    """

    def __init__(
        self, calibration: Calibration, settings: SurfelSettings | None = None, store: KeyframeStore | None = None
    ) -> None:
        self.map = SurfelMap(settings, store)
        self._thinning = Thinning(self.map.settings)
        self._noise = calibration.depth_noise

    def fuse_tracked(
        self, odometry: FeatureOdometry | DenseOdometry, frame: RgbdFrame, seen: Estimate
    ) -> FusedFrame | None:
        """Fuse a frame where an odometry has seen it, T_map_camera; None if it is left out."""
        assert isinstance(seen, DenseEstimate)
        assert seen.frame is not None
        assert seen.T_odom_body is not None
        T_map_camera, dense = seen.T_odom_body, _dense(odometry)
        frames = self._thinning.count(T_map_camera, frame.stamp_s)  # with those before it that were left out
        if not frames:
            return None
        with dense.watch.stage("fuse"):
            with_color = self.map.frames % self.map.settings.colored_every == 0
            surface = dense.surface(seen.frame, frame, with_color)
            how = (self._noise, frames, seen.keyframe)
            return self.map.fuse(surface, dense.intrinsics, T_map_camera, frame.stamp_s, *how)

    def track_map(self, odometry: FeatureOdometry | DenseOdometry, tracks: bool) -> None:
        """From now on an odometry aligns frames with what the map predicts, or with keyframes."""
        _dense(odometry).refer_to(self.map if tracks else None)

    def shows_most(self, seen: Estimate | None) -> bool:
        """Whether hardly anything of what a frame shows lies beyond where the map ends; False if it has no pose."""
        if not isinstance(seen, DenseEstimate) or seen.frame is None:
            return False
        depth_m, settings = seen.frame.levels[-1].depth_m, self.map.settings
        beyond = np.count_nonzero(depth_m > settings.far_m)
        return bool(beyond <= settings.beyond_share * np.count_nonzero(depth_m))


def _dense(odometry: FeatureOdometry | DenseOdometry) -> DenseOdometry:
    """Only dense odometry sees surfaces."""
    assert not isinstance(odometry, FeatureOdometry), "the configuration lets no map be made of keypoints"
    return odometry
