"""SeenView: a frame or a keyframe as places are recognised by it: depth and grey at all scales, and keypoints."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from wheelsight.calibration import Calibration
from wheelsight.events import RgbdFrame
from wheelsight.geometry import FloatArray
from wheelsight.keyframes import Keyframe, KeyframeFeatures
from wheelsight.odometry.dense.grid import Gridder, GridFrame, Level, coarser
from wheelsight.odometry.dense.keypoints import KeypointTracker
from wheelsight.odometry.dense.settings import DenseSettings
from wheelsight.threads import Rows

# Halving brings no two widths nearer than this factor.
_ALIKE = np.sqrt(2)
NO_FEATURES = KeyframeFeatures(np.zeros((0, 2)), np.zeros((0, 3)), np.zeros((0, 4), np.uint64))


@dataclass(frozen=True, slots=True, eq=False)
class SeenView:
    """What was seen from one place.

    Attributes:
        grid: depth and grey of the ideal camera, at all scales.
        features: keypoints with their points in the camera's frame; none where there are none.
    """

    grid: GridFrame
    features: KeyframeFeatures


class ViewMaker:
    """Makes views of frames, and of keyframes that odometry of the same camera has kept.

    Args:
        calibration: of the cameras. Raises CalibrationError as `FeatureExtractor` does.
        settings: of dense odometry, whose grid it is.
    """

    def __init__(self, calibration: Calibration, settings: DenseSettings | None = None) -> None:
        self.settings = settings or DenseSettings()
        self.rows = Rows(self.settings.threads)
        self.gridder = Gridder(calibration, self.settings, self.rows)
        self._keypoints = KeypointTracker(calibration, self.settings.verification, has_landmarks=False)

    def of_frame(self, frame: RgbdFrame, twist: FloatArray | None = None) -> SeenView:
        """A frame of a camera that moves at `twist` (6,) in its own frame, or stands."""
        twist = np.zeros(6) if twist is None else twist
        raw = self._keypoints.look(frame).result()
        features = self._keypoints.kept(self._keypoints.straightened(raw, twist))
        return SeenView(self.gridder.on_grid(frame, twist), features)

    def of_tracked(self, grid: GridFrame, features: KeyframeFeatures | None) -> SeenView:
        """A frame that odometry has brought onto the grid already."""
        return SeenView(grid, features or NO_FEATURES)

    def of_keyframe(self, keyframe: Keyframe) -> SeenView:
        """A keyframe; feature odometry keeps them as large as the camera has them, so that they are halved here."""
        finest = Level(keyframe.intrinsics, keyframe.depth_m, known_grey(keyframe))
        levels = coarser(finest, self.settings, self.rows)
        while levels[0].depth_m.shape[1] > self.settings.finest_width_px:
            levels = coarser(levels[1], self.settings, self.rows)
        return SeenView(GridFrame(keyframe.stamp_s, levels, np.zeros(6)), keyframe.features or NO_FEATURES)

    def of_one_size(self, first: SeenView, second: SeenView) -> tuple[SeenView, SeenView]:
        """Both on grids that are about as wide, for surfaces are aligned level by level; the wider one is halved.

        Keyframes of a known map may come of a run with other settings, such as those of a profile.
        """
        while _width(first) > _ALIKE * _width(second):
            first = self._halved(first)
        while _width(second) > _ALIKE * _width(first):
            second = self._halved(second)
        return first, second

    def _halved(self, view: SeenView) -> SeenView:
        levels = coarser(view.grid.levels[1], self.settings, self.rows)
        return replace(view, grid=replace(view.grid, levels=levels))


def _width(view: SeenView) -> int:
    return int(view.grid.levels[0].depth_m.shape[1])


def known_grey(keyframe: Keyframe) -> np.ndarray:
    """Grey (h, w) float32 of a keyframe, -1 where it is unknown: it is kept as 0 there."""
    grey = keyframe.grey
    grey[grey == 0] = -1
    return grey
