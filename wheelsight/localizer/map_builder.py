"""MapBuilder: the surfel map of a run, made of frames that an odometry has tracked."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from wheelsight.calibration import Calibration
from wheelsight.estimates import Estimate
from wheelsight.events import RgbdFrame
from wheelsight.geometry import FloatArray
from wheelsight.keyframes import KeyframeId, KeyframeStore
from wheelsight.mapping import FusedFrame, SurfelMap, SurfelSettings
from wheelsight.mapping.thinning import Thinning
from wheelsight.odometry.dense import DenseEstimate, DenseOdometry
from wheelsight.odometry.features import FeatureOdometry
from wheelsight.views import Surface


@dataclass(frozen=True, slots=True)
class Due:
    """That a frame is to be fused.

    Attributes:
        frames: as how many it counts, with those before it that were left out.
        with_color: whether colour is asked for.
    """

    frames: int
    with_color: bool


class MapBuilder:
    """Averages tracked frames into a surfel map; of frames that hardly move, one in a tenth of a second.

    It knows no odometry: who tracks frames tells what they show and where they are.

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

    def due(self, T_map_camera: FloatArray, stamp_s: float) -> Due | None:
        """How the frame tracked at a pose (4, 4) is to be fused; None where it is left out."""
        frames = self._thinning.count(T_map_camera, stamp_s)
        if not frames:
            return None
        return Due(frames, with_color=self.map.frames % self.map.settings.colored_every == 0)

    def fuse(
        self,
        surface: Surface,
        intrinsics: FloatArray,
        T_map_camera: FloatArray,
        stamp_s: float,
        due: Due,
        keyframe: KeyframeId | None = None,
    ) -> FusedFrame:
        """Average what a frame shows into the map, as `due` says; see `SurfelMap.fuse`."""
        how = (self._noise, due.frames, keyframe)
        return self.map.fuse(surface, intrinsics, T_map_camera, stamp_s, *how)

    def fuse_tracked(
        self, odometry: FeatureOdometry | DenseOdometry, frame: RgbdFrame, seen: Estimate
    ) -> FusedFrame | None:
        """Fuse a frame where an odometry has seen it, T_map_camera; None if it is left out."""
        assert isinstance(seen, DenseEstimate)
        assert seen.frame is not None
        assert seen.T_odom_body is not None
        T_map_camera = seen.T_odom_body
        due = self.due(T_map_camera, frame.stamp_s)
        if due is None:
            return None
        dense = _dense(odometry)
        with dense.watch.stage("fuse"):
            surface = dense.surface(seen.frame, frame, due.with_color)
            return self.fuse(surface, dense.intrinsics, T_map_camera, frame.stamp_s, due, seen.keyframe)

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
