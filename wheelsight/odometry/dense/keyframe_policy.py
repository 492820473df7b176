"""KeyframePolicy: which frames are kept as keyframes, and where they are put."""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import numpy as np

from wheelsight.estimates import MotionEstimate
from wheelsight.events import RgbdFrame
from wheelsight.geometry import FloatArray, se3
from wheelsight.keyframes import Keyframe, KeyframeId, KeyframeStore
from wheelsight.odometry.dense.gone_views import GoneViews
from wheelsight.odometry.dense.grid import Gridder, GridFrame
from wheelsight.odometry.dense.keypoints import KeypointTracker
from wheelsight.odometry.dense.locating import Locator
from wheelsight.odometry.dense.prediction import Prediction
from wheelsight.odometry.dense.settings import DenseSettings
from wheelsight.odometry.dense.tracked import Tracked
from wheelsight.odometry.dense.two_references import joined
from wheelsight.odometry.dense.views import KnownView, Views
from wheelsight.odometry.dense.vignetting import Vignetting
from wheelsight.odometry.features.extraction import Features
from wheelsight.odometry.state import START_VARIANCE


class KeyframePolicy:
    """Keeps frames that show much that is not known yet.

    Args:
        settings: how much that is.
        gridder: straightens frames.
        locator: aligns a frame with another keyframe.
        keypoints: verify that a keyframe is where it seems to be.
        views: keep what frames are aligned with.
        store: holds all keyframes and where they are.
        gone: those that views have no room for.
    """

    def __init__(
        self,
        settings: DenseSettings,
        gridder: Gridder,
        locator: Locator,
        keypoints: KeypointTracker,
        views: Views,
        store: KeyframeStore,
        gone: GoneViews,
    ) -> None:
        self._settings, self._gridder, self._store = settings, gridder, store
        self._locator, self._keypoints, self._views, self._gone = locator, keypoints, views, gone
        self.vignetting = Vignetting(gridder, settings)

    def begin(self, features: Features, grid: GridFrame, T_map_camera: FloatArray, covariance: FloatArray) -> Tracked:
        """Keep a frame at a pose (4, 4) with its covariance (6, 6), from which all begins anew."""
        motion = MotionEstimate(np.eye(4), START_VARIANCE * np.eye(6))
        start = Tracked(grid, T_map_camera, covariance, motion, KeyframeId(-1))
        start, view = self._stored(start, features)
        self._views.expect_nothing()
        self._keep(view)
        return start

    def begin_again(self, features: Features, first: Tracked) -> KnownView:
        """Put the first frame, whose speed is known by now, in its own place, straightened."""
        self._keypoints.forget()
        self._keypoints.remember(first, features)
        features = self._keypoints.straightened(features, first.twist)
        self._store.replace(first.keyframe, partial(self._kept, first.frame, features))
        view = replace(self._views.of_frame(first), features=features)
        self._views.keyframes[:] = [view]
        return view

    def update(self, frame: RgbdFrame, features: Features, found: Tracked, ahead: Prediction) -> Tracked:
        """Remember a frame, and keep one that shows much that the last keyframe did not.

        Returns it with its rows straightened by the speed that was found.
        """
        if self._settings.reference == "previous" and not self._views.has_model:
            return self._follow(frame, features, found)
        if not self._views.lack(found, is_helped=ahead.is_helped):
            return self._remembered(self._straightened(frame, found, is_kept=False), features)
        seen = self._seen_from_before(found, ahead)
        if seen is not None:
            return self._remembered(replace(seen, told=found.told), features)
        straight = self._straightened(frame, self._by_two(found, ahead))
        self.vignetting.learn(straight.frame, straight.T_map_camera, self._views.keyframes[-1].reference)
        straight, view = self._stored(straight, features)
        self._keep(view)
        return straight

    def _remembered(self, tracked: Tracked, features: Features) -> Tracked:
        tracked = tracked.doubted()
        self._keypoints.remember(tracked, features)
        return tracked

    def _follow(self, frame: RgbdFrame, features: Features, found: Tracked) -> Tracked:
        """The frame as the only view to align with; the store gets one wherever the last one there is far."""
        straight = self._straightened(frame, found).doubted()
        T_keyframe_camera = se3.invert(self._store.pose(found.keyframe)) @ straight.T_map_camera
        if float(se3.view_shift_m(T_keyframe_camera)) > self._settings.keyframe_way_m:
            straight, view = self._stored(straight, features)
        else:
            straightened = self._keypoints.straightened(features, straight.twist)
            view = replace(self._views.of_frame(straight), features=straightened)
            self._keypoints.remember(straight, features)
        self._views.keyframes[:] = [view]
        return straight

    def _seen_from_before(self, found: Tracked, ahead: Prediction) -> Tracked | None:
        """The frame by an older keyframe that is nearer and shows the same, which ends the drift, if there is one."""
        if self._views.has_model:
            return None
        here, nearest = ahead.at(found.T_map_camera), self._views.nearest(found.T_map_camera)
        for view in (self._gone_nearer(found.T_map_camera, nearest), nearest):
            if view is None or view is self._views.keyframes[-1]:
                continue
            seen = self._locator.by_view(found.frame, view, here, here.T_map_camera)
            if isinstance(seen, Tracked) and seen.overlap > self._settings.keyframe_overlap:
                self._keep(view)
                return seen
        return None

    def _gone_nearer(self, T_map_camera: FloatArray, nearest: KnownView) -> KnownView | None:
        """An older keyframe nearer than those held, while loops tie one of those that the camera goes by."""
        newest = self._views.keyframes[-self._settings.keyframes.tied_views :]
        if not any(self._gone.is_tied(view.keyframe) for view in newest):
            return None
        return self._gone.nearer(T_map_camera, nearest.distance_m(T_map_camera))

    def _keep(self, view: KnownView) -> None:
        """A view that counts as the newest; those that there is no room for go."""
        self._gone.take(view)
        for one in self._views.keep(view):
            self._gone.put(one)

    def _by_two(self, found: Tracked, ahead: Prediction) -> Tracked:
        """The frame by the keyframe before the last one, too, where no map ties keyframes together."""
        before = self._views.keyframes[-2:-1]
        if not before or self._views.has_model or not found.is_by_keyframe:
            return found
        here = ahead.at(found.T_map_camera)
        seen = self._locator.by_view(found.frame, before[0], here, here.T_map_camera)
        if not isinstance(seen, Tracked):
            return found
        poses = (found.T_map_camera, found.motion, seen.T_map_camera, seen.motion)
        return replace(found, T_map_camera=joined(*poses, self._settings.keyframes, self._locator.of_frame))

    def _straightened(self, frame: RgbdFrame, found: Tracked, *, is_kept: bool = True) -> Tracked:
        """The same frame, its rows straightened by the speed that was found rather than the one expected."""
        wrong = np.abs(found.twist - found.frame.twist)[3:].max() * np.abs(self._gridder.late_s).max()
        limits = self._settings.keyframes
        limit_px = limits.kept_straight_px if is_kept else limits.straight_px
        if wrong * self._gridder.intrinsics[0] < limit_px:
            return found
        return replace(found, frame=self._gridder.on_grid(frame, found.twist))

    def _stored(self, tracked: Tracked, features: Features) -> tuple[Tracked, KnownView]:
        """A frame as a keyframe of the store, and as a view to align with."""
        tracked = tracked.doubted()
        straight = self._keypoints.straightened(features, tracked.twist)
        number = self._store.add(partial(self._kept, tracked.frame, straight), tracked.T_map_camera)
        tracked = replace(tracked, keyframe=number)
        self._keypoints.remember(tracked, features)
        return tracked, replace(self._views.of_frame(tracked), features=straight)

    def _kept(self, grid: GridFrame, features: Features) -> Keyframe:
        finest = grid.levels[0]
        images = (grid.stamp_s, finest.intrinsics, finest.depth_m, finest.grey)
        return Keyframe.of_images(*images, self._keypoints.kept(features))
