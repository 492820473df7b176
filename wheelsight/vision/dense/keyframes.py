"""`KeyframePolicy` decides which frames become keyframes and estimates their poses. `EvictedViews` returns keyframes
that left the cache, and `Vignetting` estimates the lens's vignetting from keyframes.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from wheelsight.core.errors import MapError
from wheelsight.core.estimates import MotionEstimate
from wheelsight.core.geometry import BoolArray, Float32Array, FloatArray, PinholeCamera, se3
from wheelsight.core.geometry import motion_kernels as motions
from wheelsight.core.keyframes import Keyframe, KeyframeId, KeyframeStore
from wheelsight.core.messages import RgbdFrame
from wheelsight.vision.dense.alignment_kernels import ALONG_U, ALONG_V, DEPTH, GREY
from wheelsight.vision.dense.pyramid import Gridder, GridFrame, Reference, ReferenceMaker, vignetting_of
from wheelsight.vision.dense.settings import DenseSettings, KeyframeSettings
from wheelsight.vision.dense.tracking import Locator
from wheelsight.vision.dense.views import KeypointTracker, KnownView, Prediction, Tracked, Views
from wheelsight.vision.features.extraction import Features
from wheelsight.vision.tracking_state import START_VARIANCE


class KeyframePolicy:
    """Makes keyframes of frames that show much that is new.

    Args:
        settings: thresholds.
        gridder: corrects the rolling shutter of frames.
        locator: aligns a frame with another keyframe.
        keypoints: holds the landmarks of keyframes.
        views: the cache of keyframes.
        store: holds all keyframes and their poses.
        evicted: keyframes that left the cache.
    """

    def __init__(
        self,
        settings: DenseSettings,
        gridder: Gridder,
        locator: Locator,
        keypoints: KeypointTracker,
        views: Views,
        store: KeyframeStore,
        evicted: EvictedViews,
    ) -> None:
        self._settings, self._gridder, self._store = settings, gridder, store
        self._locator, self._keypoints, self._views, self._evicted = locator, keypoints, views, evicted
        self.vignetting = Vignetting(gridder, settings)

    def begin(self, features: Features, grid: GridFrame, T_map_camera: FloatArray, covariance: FloatArray) -> Tracked:
        """Start, or restart, with a keyframe at a pose (4, 4) with its covariance (6, 6)."""
        motion = MotionEstimate(np.eye(4), START_VARIANCE * np.eye(6))
        start = Tracked(grid, T_map_camera, covariance, motion, KeyframeId(-1))
        start, view = self._stored(start, features)
        self._views.drop_prediction()
        self._keep(view)
        return start

    def begin_again(self, features: Features, first: Tracked) -> KnownView:
        """Replace the first keyframe by the same frame with its rolling shutter corrected."""
        self._keypoints.forget()
        self._keypoints.remember(first, features)
        features = self._keypoints.straightened(features, first.twist)
        self._store.replace(first.keyframe, partial(self._kept, first.frame, features))
        view = replace(self._views.of_frame(first), features=features)
        self._views.keyframes[:] = [view]
        return view

    def update(self, frame: RgbdFrame, features: Features, found: Tracked, ahead: Prediction) -> Tracked:
        """Update landmarks by a frame, and make it a keyframe if it shows much that the last one did not.

        Returns the frame with its rolling shutter corrected by the estimated speed.
        """
        if self._settings.reference == "previous" and not self._views.has_model:
            return self._follow(frame, features, found)
        if not self._views.lack(found, is_helped=ahead.is_helped):
            return self._remembered(self._straightened(frame, found, is_kept=False), features)
        seen = self._revisited(found, ahead)
        if seen is not None:
            return self._remembered(replace(seen, keypoint_pose=found.keypoint_pose), features)
        straight = self._straightened(frame, self._refined(found, ahead))
        self.vignetting.learn(straight.frame, straight.T_map_camera, self._views.keyframes[-1].reference)
        straight, view = self._stored(straight, features)
        self._keep(view)
        return straight

    def _remembered(self, tracked: Tracked, features: Features) -> Tracked:
        tracked = tracked.with_pose_error()
        self._keypoints.remember(tracked, features)
        return tracked

    def _follow(self, frame: RgbdFrame, features: Features, found: Tracked) -> Tracked:
        """Make the frame the only known view, and a keyframe of the store if the last one there is far."""
        straight = self._straightened(frame, found).with_pose_error()
        T_keyframe_camera = se3.invert(self._store.pose(found.keyframe)) @ straight.T_map_camera
        if float(se3.view_shift_m(T_keyframe_camera)) > self._settings.keyframe_way_m:
            straight, view = self._stored(straight, features)
        else:
            straightened = self._keypoints.straightened(features, straight.twist)
            view = replace(self._views.of_frame(straight), features=straightened)
            self._keypoints.remember(straight, features)
        self._views.keyframes[:] = [view]
        return straight

    def _revisited(self, found: Tracked, ahead: Prediction) -> Tracked | None:
        """The frame located by a nearer, older keyframe with enough overlap, which ends the drift; else None."""
        if self._views.has_model:
            return None
        here, nearest = ahead.at(found.T_map_camera), self._views.nearest(found.T_map_camera)
        for view in (self._evicted_nearer(found.T_map_camera, nearest), nearest):
            if view is None or view is self._views.keyframes[-1]:
                continue
            seen = self._locator.by_view(found.frame, view, here, here.T_map_camera)
            if isinstance(seen, Tracked) and seen.overlap > self._settings.keyframe_overlap:
                self._keep(view)
                return seen
        return None

    def _evicted_nearer(self, T_map_camera: FloatArray, nearest: KnownView) -> KnownView | None:
        """An evicted keyframe nearer than the cached ones, if loops tie a recent keyframe to older ones; else None."""
        newest = self._views.keyframes[-self._settings.keyframes.tied_views :]
        if not any(self._evicted.is_tied(view.keyframe) for view in newest):
            return None
        return self._evicted.nearer(T_map_camera, nearest.distance_m(T_map_camera))

    def _keep(self, view: KnownView) -> None:
        """Mark a view as the most recently used keyframe."""
        self._evicted.take(view)
        for evicted in self._views.keep(view):
            self._evicted.put(evicted)

    def _refined(self, found: Tracked, ahead: Prediction) -> Tracked:
        """The frame located by the last two keyframes together; without a map, this reduces drift."""
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
        """The frame with its rolling shutter corrected by the estimated speed instead of the predicted one."""
        wrong = np.abs(found.twist - found.frame.twist)[3:].max() * np.abs(self._gridder.late_s).max()
        limits = self._settings.keyframes
        limit_px = limits.kept_straight_px if is_kept else limits.straight_px
        if wrong * self._gridder.intrinsics[0] < limit_px:
            return found
        return replace(found, frame=self._gridder.on_grid(frame, found.twist))

    def _stored(self, tracked: Tracked, features: Features) -> tuple[Tracked, KnownView]:
        """Add a frame to the store as a keyframe, and return it with its view."""
        tracked = tracked.with_pose_error()
        straight = self._keypoints.straightened(features, tracked.twist)
        number = self._store.add(partial(self._kept, tracked.frame, straight), tracked.T_map_camera)
        tracked = replace(tracked, keyframe=number)
        self._keypoints.remember(tracked, features)
        return tracked, replace(self._views.of_frame(tracked), features=straight)

    def _kept(self, grid: GridFrame, features: Features) -> Keyframe:
        finest = grid.levels[0]
        images = (grid.stamp_s, finest.intrinsics, finest.depth_m, finest.grey)
        return Keyframe.of_images(*images, self._keypoints.kept(features))


def joined(
    T_map_short: FloatArray,
    short: MotionEstimate,
    T_map_long: FloatArray,
    long: MotionEstimate,
    settings: KeyframeSettings,
    shared: FloatArray,
) -> FloatArray:
    """T_map_camera (4, 4) by the motions against the last two keyframes, weighted by their covariances.

    It is the pose by the last keyframe if both contradict each other, or if one is degenerate. The covariance of the
    short motion counts `short_motions` times, because the pose of its keyframe relative to the other one has the same
    error. `shared` (6, 6) is the covariance of the error common to both, as a right perturbation; it is subtracted.
    """
    if not (short.shows_all and long.shows_all):
        return T_map_short
    C_short, C_long = settings.short_motions * (_right_covariance(short) - shared), _right_covariance(long) - shared
    off = se3.log(se3.invert(T_map_short) @ T_map_long)
    C = np.ascontiguousarray(C_short + C_long)
    if not (np.isfinite(C).all() and motions.is_definite(C)):  # singular up to rounding
        return T_map_short
    innovation = np.linalg.solve(C, off)
    if not off @ innovation < settings.joined_chi2:
        return T_map_short
    return np.asarray(se3.nearest(T_map_short @ se3.exp(C_short @ innovation)))


def _right_covariance(motion: MotionEstimate) -> FloatArray:
    """Covariance (6, 6) of a motion's right perturbation, in the frame of the moved camera."""
    assert motion.T_reference_current is not None
    assert motion.covariance is not None
    return np.asarray(motions.carried(motions.inverse(motion.T_reference_current), motion.covariance))


@dataclass(frozen=True, slots=True, eq=False)
class _Evicted:
    """The attributes of a view that the store does not hold, about 0.5 kB.

    Attributes:
        covariance: (6, 6) of the right perturbation of its pose, which is invariant to motions of the map.
        turning_rad_s, vignetting: see `KnownView` and `Reference`.
    """

    covariance: FloatArray
    turning_rad_s: FloatArray
    vignetting: float


class EvictedViews:
    """Keyframes that left the cache, and return from the store when the camera comes back.

    Only those return that loop closures tie to keyframes of another visit. The poses of the others drift by odometry
    alone, and loop closures need new keyframes to correct that.

    Args:
        store: holds the keyframes and their poses.
        gridder, maker, keypoints: compute views of them.
        room: size of the cache; keyframes at least this many apart belong to different visits.
    """

    def __init__(
        self, store: KeyframeStore, gridder: Gridder, maker: ReferenceMaker, keypoints: KeypointTracker, room: int
    ) -> None:
        self._store, self._gridder, self._maker, self._keypoints = store, gridder, maker, keypoints
        self._room = room
        self._views: dict[KeyframeId, _Evicted] = {}

    def __len__(self) -> int:
        return len(self._views)

    def put(self, view: KnownView) -> None:
        """Add a view that left the cache; it is a keyframe of the store."""
        Ad = se3.adjoint(se3.invert(view.reference.T_map_reference))
        covariance = Ad @ view.covariance @ Ad.T
        self._views[view.keyframe] = _Evicted(covariance, view.turning_rad_s, view.reference.vignetting)

    def nearer(self, T_map_camera: FloatArray, limit_m: float) -> KnownView | None:
        """The nearest tied keyframe within `limit_m` of a pose (4, 4), where a rotation by a radian counts as 1.5 m.

        None if there is none, if the store cannot read it, or if its size differs from that of frames. It stays here
        until `take`.
        """
        numbers = [number for number in self._views if self.is_tied(number)]
        if not numbers:
            return None
        apart_m = se3.view_shift_m(se3.invert(self._store.T_map_keyframe[numbers]) @ T_map_camera)
        nearest = int(np.argmin(apart_m))
        return self._recalled(numbers[nearest]) if apart_m[nearest] < limit_m else None

    def is_tied(self, number: KeyframeId) -> bool:
        """Whether a loop closure ties a keyframe to one of another visit."""
        return self._store.tied_over(number) >= self._room

    def take(self, view: KnownView) -> None:
        """Remove a view that is in the cache again."""
        self._views.pop(view.keyframe, None)

    def _recalled(self, number: KeyframeId) -> KnownView | None:
        try:
            keyframe = self._store.recalled(number, KeyframeId(len(self._store) - 1))
        except MapError:  # the file is missing or damaged; odometry continues without it
            return None
        evicted, T_map_keyframe = self._views[number], self._store.pose(number)
        grid = self._on_grid(keyframe, evicted.vignetting)
        if grid is None:
            return None
        reference, Ad = self._maker.of_frame(grid, T_map_keyframe), se3.adjoint(T_map_keyframe)
        features = None if keyframe.features is None else self._keypoints.recalled(keyframe.stamp_s, keyframe.features)
        return KnownView(number, reference, Ad @ evicted.covariance @ Ad.T, features, evicted.turning_rad_s)

    def _on_grid(self, keyframe: Keyframe, vignetting: float) -> GridFrame | None:
        """The keyframe as a frame on the ideal grid, or None if its size differs."""
        depth_m, grey = keyframe.depth_m, keyframe.grey
        if depth_m.shape != self._gridder.shape:
            return None
        grey[grey == 0] = -1  # keyframes store unknown grey as 0
        return GridFrame(keyframe.stamp_s, self._gridder.pyramid(depth_m, grey), np.zeros(6), vignetting)


# Stride, in pixels, of the points compared for vignetting.
_STRIDE_PX = 2
# Iteratively reweighted least squares: Huber's limit in standard deviations, and the number of iterations.
_HUBER, _ROUNDS = 1.5, 3
# Least variance of vignetting over the compared points, so that the slope stays finite.
_FLAT = 1e-9


class Vignetting:
    """Estimates the vignetting of one camera from plain surfaces at two image positions, and corrects later frames.

    A wall seen ahead, and later at the image border, looks darker there, and the keyframe then seems tilted. Lenses
    darken about as cos⁴ of the angle to the axis; gamma reduces its exponent in grey values. The estimate is this
    exponent, updated by pairs of views.

    Args:
        gridder: makes the frames.
        settings: thresholds of plain surfaces, and the prior of the exponent.

    Attributes:
        exponent: of cos⁴, in grey values; 0 for an even image.
    """

    def __init__(self, gridder: Gridder, settings: DenseSettings) -> None:
        self._gridder, self._settings = gridder, settings
        self._lens = settings.vignetting
        self.exponent, self._variance = 0.0, self._lens.sigma**2

    def learn(self, frame: GridFrame, T_map_camera: FloatArray, reference: Reference) -> None:
        """Update the estimate by plain surfaces that a frame at a pose (4, 4) and an earlier reference both show."""
        here, there, known = self._pairs(frame, reference, se3.invert(reference.T_map_reference) @ T_map_camera)
        if np.count_nonzero(known) < self._lens.min_pixels:
            return
        (grey, dark), (grey_then, dark_then) = here[:, known], there[:, known]
        # Undo the correction of each view, which used the estimate at its time.
        brighter = np.log(grey / grey_then) + frame.vignetting * dark - reference.vignetting * dark_then
        information, pull = self._slope(dark - dark_then, brighter)
        total = 1 / self._variance + information
        self.exponent = float(np.clip((self.exponent / self._variance + pull) / total, 0.0, self._lens.max_exponent))
        self._variance = 1 / total
        self._gridder.even(self.exponent)

    def _pairs(self, frame: GridFrame, reference: Reference, T: FloatArray) -> tuple[FloatArray, FloatArray, BoolArray]:
        """Grey and vignetting (2, N) of points in frame and in reference, and a mask (N,) of plain surfaces."""
        number = min(1, self._settings.levels - 1)
        level, pixels = frame.levels[number], reference.levels[number].pixels
        (h, w), some = level.depth_m.shape, (slice(None, None, _STRIDE_PX),) * 2
        camera = PinholeCamera(w, h, *level.intrinsics.tolist())
        px = np.stack([index[some].ravel() for index in np.mgrid[:h, :w][::-1]], axis=-1)
        z, grey = level.depth_m[some].ravel(), level.grey[some].ravel()
        p_then = se3.apply(T, camera.back_project(px, z))
        px_then, is_inside = camera.project(p_then)
        column, row = np.where(is_inside[:, None], np.rint(px_then), 0).astype(int).T
        met = pixels[row, column]
        is_one = np.abs(met[:, DEPTH] - p_then[:, 2]) < self._settings.gate * (1 + p_then[:, 2])
        is_plain = met[:, ALONG_U] ** 2 + met[:, ALONG_V] ** 2 < self._settings.min_gradient**2
        known = (z > 0) & is_inside & is_one & is_plain & self._is_exposed(grey) & self._is_exposed(met[:, GREY])
        dark, dark_then = (vignetting_of((camera.normalise(seen) ** 2).sum(axis=-1)) for seen in (px, px_then))
        return np.stack([grey, dark]), np.stack([met[:, GREY], dark_then]), known

    def _is_exposed(self, grey: Float32Array) -> BoolArray:
        return np.asarray((grey > self._lens.darkest) & (grey < self._lens.brightest))

    def _slope(self, x: FloatArray, y: FloatArray) -> tuple[float, float]:
        """The information on the slope of y (N,) over x (N,) by Huber's weights, and that information times the slope.

        The offset is free. Both are 0 if x is constant.
        """
        weight = np.ones(len(x))
        for _ in range(_ROUNDS):
            total = weight.sum()
            dx, dy = x - weight @ x / total, y - weight @ y / total
            spread, common = weight @ dx**2 / total, weight @ (dx * dy) / total
            off = np.abs(dy - common / max(spread, _FLAT) * dx)
            sigma = max(1.4826 * float(np.median(off)), 1e-6)
            weight = _HUBER / np.maximum(off / sigma, _HUBER)
        variance = sigma**2 * self._lens.correlation / len(x) + self._lens.uneven**2
        return float(spread / variance), float(common / variance)
