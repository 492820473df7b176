"""`KeyframePolicy` decides which frames become keyframes and optimizes their poses. Also the keyframe cache and the
vignetting model, which keyframes teach.
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

# KeyframePolicy: which frames are kept as keyframes, and where they are put.


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


# One pose by two references: where both meet, for chains of keyframe-to-keyframe motions drift less so.


def joined(
    T_map_short: FloatArray,
    short: MotionEstimate,
    T_map_long: FloatArray,
    long: MotionEstimate,
    settings: KeyframeSettings,
    shared: FloatArray,
) -> FloatArray:
    """T_map_camera (4, 4) by the motions against the last keyframe and the one before, each as sure as it says.

    Where they contradict each other, or one does not show all directions, it is the short one's. That one's covariance
    counts several times, since where its keyframe is against the other's was found by a motion like it. What both have
    wrong of the frame is `shared` (6, 6), a right perturbation: it speaks for neither.
    """
    if not (short.shows_all and long.shows_all):
        return T_map_short
    C_short, C_long = settings.short_motions * (_at_its_end(short) - shared), _at_its_end(long) - shared
    off = se3.log(se3.invert(T_map_short) @ T_map_long)
    C = np.ascontiguousarray(C_short + C_long)
    if not (np.isfinite(C).all() and motions.is_definite(C)):  # what is left of both is less than rounding
        return T_map_short
    innovation = np.linalg.solve(C, off)
    if not off @ innovation < settings.joined_chi2:
        return T_map_short
    return np.asarray(se3.nearest(T_map_short @ se3.exp(C_short @ innovation)))


def _at_its_end(motion: MotionEstimate) -> FloatArray:
    """Covariance (6, 6) of a motion's right perturbation, in the frame of the camera that moved."""
    assert motion.T_reference_current is not None
    assert motion.covariance is not None
    return np.asarray(motions.carried(motions.inverse(motion.T_reference_current), motion.covariance))


# GoneViews: keyframes that there is no room for as views, and that come back from the store where the camera does.


@dataclass(frozen=True, slots=True, eq=False)
class _Gone:
    """What the store does not have of a view, some 0.5 kB.

    Attributes:
        covariance: (6, 6) of the right perturbation of its pose: no motion of the map changes that.
        turning_rad_s, vignetting: as the view and its reference have them.
    """

    covariance: FloatArray
    turning_rad_s: FloatArray
    vignetting: float


class GoneViews:
    """See the module.

    Only those come back that loops tie to keyframes of another time: how far off the others are from where the camera
    has come to, odometry alone would say, and that loops can mend it new keyframes are needed.

    Args:
        store: has the keyframes, and where they are.
        gridder, maker, keypoints: make views of them.
        room: of another time is a keyframe that so many others follow, for which there is room.
    """

    def __init__(
        self, store: KeyframeStore, gridder: Gridder, maker: ReferenceMaker, keypoints: KeypointTracker, room: int
    ) -> None:
        self._store, self._gridder, self._maker, self._keypoints = store, gridder, maker, keypoints
        self._room = room
        self._gone: dict[KeyframeId, _Gone] = {}

    def __len__(self) -> int:
        return len(self._gone)

    def put(self, view: KnownView) -> None:
        """A view that is a keyframe of the store."""
        Ad = se3.adjoint(se3.invert(view.reference.T_map_reference))
        covariance = Ad @ view.covariance @ Ad.T
        self._gone[view.keyframe] = _Gone(covariance, view.turning_rad_s, view.reference.vignetting)

    def nearer(self, T_map_camera: FloatArray, limit_m: float) -> KnownView | None:
        """The tied one whose view is nearest to one from there (4, 4), a turn by a radian as 1.5 m, if that is nearer.

        None, too, where the disk has lost it, or has it in another size than frames are aligned in. It stays here: see
        `take`.
        """
        numbers = [number for number in self._gone if self.is_tied(number)]
        if not numbers:
            return None
        apart_m = se3.view_shift_m(se3.invert(self._store.T_map_keyframe[numbers]) @ T_map_camera)
        nearest = int(np.argmin(apart_m))
        return self._recalled(numbers[nearest]) if apart_m[nearest] < limit_m else None

    def is_tied(self, number: KeyframeId) -> bool:
        """Whether loops tie a keyframe to one of another time."""
        return self._store.tied_over(number) >= self._room

    def take(self, view: KnownView) -> None:
        """One that is held from now on."""
        self._gone.pop(view.keyframe, None)

    def _recalled(self, number: KeyframeId) -> KnownView | None:
        try:
            keyframe = self._store.recalled(number, KeyframeId(len(self._store) - 1))
        except MapError:  # the disk is gone, or damaged there: the camera goes on without
            return None
        gone, T_map_keyframe = self._gone[number], self._store.pose(number)
        grid = self._on_grid(keyframe, gone.vignetting)
        if grid is None:
            return None
        reference, Ad = self._maker.of_frame(grid, T_map_keyframe), se3.adjoint(T_map_keyframe)
        features = None if keyframe.features is None else self._keypoints.recalled(keyframe.stamp_s, keyframe.features)
        return KnownView(number, reference, Ad @ gone.covariance @ Ad.T, features, gone.turning_rad_s)

    def _on_grid(self, keyframe: Keyframe, vignetting: float) -> GridFrame | None:
        """None for one of another size."""
        depth_m, grey = keyframe.depth_m, keyframe.grey
        if depth_m.shape != self._gridder.shape:
            return None
        grey[grey == 0] = -1  # as which unknown grey is kept
        return GridFrame(keyframe.stamp_s, self._gridder.pyramid(depth_m, grey), np.zeros(6), vignetting)


# Vignetting: by how much a lens darkens an image towards its rim, learned from plain surfaces at two places of it.
#
# A wall that is seen ahead, and later aside, seems darker than it was; a keyframe then seems tilted against the
# frame. What lenses do differs, but falls about as the fourth power of the cosine to the axis; bytes follow by an
# exponent that the camera's gamma makes smaller. That exponent is what is learned, a pair of views at a time.


# Of both images every so many pixels are compared.
_STRIDE_PX = 2
# Reweighted least squares: Huber's limit in standard deviations, and how often it is solved.
_HUBER, _ROUNDS = 1.5, 3
# Where vignetting hardly differs, there is no slope.
_FLAT = 1e-9


class Vignetting:
    """Learns one camera's vignetting, and has its frames evened by it.

    Args:
        gridder: makes the frames.
        settings: which places are plain, and what lenses do.

    Attributes:
        exponent: of the cosine's fourth power, in grey values; 0 for an even image.
    """

    def __init__(self, gridder: Gridder, settings: DenseSettings) -> None:
        self._gridder, self._settings = gridder, settings
        self._lens = settings.vignetting
        self.exponent, self._variance = 0.0, self._lens.sigma**2

    def learn(self, frame: GridFrame, T_map_camera: FloatArray, reference: Reference) -> None:
        """Take how plain surfaces look in a frame at a pose (4, 4) and in a reference, a frame before."""
        here, there, known = self._pairs(frame, reference, se3.invert(reference.T_map_reference) @ T_map_camera)
        if np.count_nonzero(known) < self._lens.min_pixels:
            return
        (grey, dark), (grey_then, dark_then) = here[:, known], there[:, known]
        # As the sensor had it: both views were evened by what was known of the lens when they were made.
        brighter = np.log(grey / grey_then) + frame.vignetting * dark - reference.vignetting * dark_then
        information, pull = self._slope(dark - dark_then, brighter)
        total = 1 / self._variance + information
        self.exponent = float(np.clip((self.exponent / self._variance + pull) / total, 0.0, self._lens.max_exponent))
        self._variance = 1 / total
        self._gridder.even(self.exponent)

    def _pairs(self, frame: GridFrame, reference: Reference, T: FloatArray) -> tuple[FloatArray, FloatArray, BoolArray]:
        """Grey and vignetting (2, N) of points in frame and reference, and which (N,) are of one plain surface."""
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
        """The information on the slope of y (N,) over x (N,), by Huber's weights, and it times the slope.

        Whatever the offset is. Where x is the same everywhere both are 0.
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
