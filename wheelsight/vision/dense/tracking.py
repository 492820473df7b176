"""`Locator` estimates the pose of a frame from known views and excludes moving regions. `Verifier` checks the pose
by keypoints where the alignment may be wrong.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np

from wheelsight.core.calibration import Calibration
from wheelsight.core.calibration_parts import DepthNoise
from wheelsight.core.camera_errors import frame_covariance, with_frame_error
from wheelsight.core.estimates import DEGENERATE_SCALE, MotionEstimate, Reason
from wheelsight.core.geometry import BoolArray, FloatArray, se3, so3
from wheelsight.vision.dense import alignment_kernels as kernels
from wheelsight.vision.dense.alignment import (
    Aligner,
    DenseAlignment,
    Joint,
    Judgement,
    Prior,
    Step,
    SurfaceWeight,
    Told,
    judge,
)
from wheelsight.vision.dense.pyramid import GridFrame, Level, Reference, ReferenceLevel
from wheelsight.vision.dense.settings import DenseSettings, FaultSettings, RegionSettings
from wheelsight.vision.dense.views import KeypointPose, KeypointTracker, KnownView, Prediction, Tracked, Views
from wheelsight.vision.features.extraction import Features
from wheelsight.vision.tracking_state import LONGEST_STEP_S, Stopwatch, TrackingState

# Locator: where a frame is by the views that are known, from where it is expected.


class Locator:
    """Aligns a frame with what is known.

    Args:
        calibration: of the cameras: how far off all of a frame may be.
        settings: how far off a prediction may be, and how fast a camera goes.
        aligner: aligns a frame with one view.
        views: what is known.
        watch: counts the time of "align".

    Attributes:
        of_frame: covariance (6, 6) in the camera's frame of what is off about all of a frame.
        weight: how much surfaces count beside keypoints.
    """

    def __init__(
        self, calibration: Calibration, settings: DenseSettings, aligner: Aligner, views: Views, watch: Stopwatch
    ) -> None:
        self._settings, self._aligner, self._views, self._watch = settings, aligner, views, watch
        self.of_frame, self._noise = frame_covariance(calibration), calibration.depth_noise
        self.weight = SurfaceWeight(settings.joint)

    def locate(self, grid: GridFrame, ahead: Prediction, state: TrackingState) -> Tracked | MotionEstimate:
        """Align with the first view that fits, together with keypoints; or why none does.

        It begins where keypoints say, or at the best of the expected poses.
        """
        failure: MotionEstimate | None = None
        for place, view in enumerate(self._references(ahead, state)):
            is_elsewhere = place > 0 and state.is_lost
            begun = (view.reference.T_map_reference,) if is_elsewhere else ahead.T_map_camera
            found = self.by_view(grid, view, ahead, begun)
            if isinstance(found, Tracked):
                return self._seen_sharper(found, view, ahead, state)
            failure = failure or found
        assert failure is not None
        return failure

    def by_view(
        self,
        grid: GridFrame,
        view: KnownView,
        ahead: Prediction,
        begun: Sequence[FloatArray],
        *,
        is_held: bool = False,
    ) -> Tracked | MotionEstimate:
        """Where a frame is by one view, begun at the best of some poses T_map_camera; or why that is not known."""
        reference, seconds = view.reference, ahead.seconds_to(grid.stamp_s)
        T_reference_map = se3.invert(reference.T_map_reference)
        step = Step(T_reference_map @ ahead.last.T_map_camera, seconds) if seconds <= LONGEST_STEP_S else None
        sigma_m = self._settings.prior_sigma_m_s * max(seconds, 1e-3)
        # One's own guess is held only where nothing tells more: what noise pulls off is to betray itself by a leap.
        held_m = sigma_m if ahead.is_helped or is_held else np.inf, self._settings.nonholonomic_share * sigma_m
        with self._watch.stage("align"):
            told = _told(ahead.told, reference.T_map_reference)
            used, start = self._begun(grid, reference, [T_reference_map @ T for T in begun], told)
            starts = [start]
            if ahead.T_map_other is not None:
                starts.append(self._aligner.turn(grid, reference, T_reference_map @ ahead.T_map_other))
            found = self._aligner.align_clearest(used, reference, starts, step, held_m, told, self.weight.factor)
        joint = None
        if told is not None:
            found, joint = self._met(found, told)
        first, *others = (T_reference_map @ T for T in ahead.T_map_camera)
        judged = judge(found, Prior(first, sigma_m, tuple(others)), self._settings)
        T_map_camera = se3.nearest(reference.T_map_reference @ judged.T_reference_frame)
        reason = judged.reason or implausible(ahead.last, T_map_camera, seconds, self._settings)
        if reason is not None:
            return MotionEstimate.failed(reason, found.pairs, found.planes)
        twist = step.twist_to(judged.T_reference_frame) if step else grid.twist
        turning = judged.T_reference_frame[:3, :3] @ twist[3:] - view.turning_rad_s
        tracked = self._tracked(grid, view, found, judged, T_map_camera, twist)
        return replace(tracked, joint=joint, turning_rad_s=turning)

    def by_regions(
        self, grid: GridFrame, reference: Reference, T_reference_frame: FloatArray
    ) -> tuple[FloatArray, float | None]:
        """What the regions of a frame say of its pose T_reference_frame (4, 4).

        Returns:
            Covariance (6, 6) in the frame's own axes of how far off it may be, as most of what it shows says: turns
            are ways at 2 m, and nothing where regions agree with the pose. And the share of them that does; or None.
        """
        if not self._settings.regions.columns:
            return np.zeros((6, 6)), None
        found = self._misfits(grid, reference, T_reference_frame)
        return np.diag((found.doubt_m / DEGENERATE_SCALE) ** 2), found.fitting

    def _begun(
        self, grid: GridFrame, reference: Reference, expected: list[FloatArray], told: Told | None
    ) -> tuple[GridFrame, FloatArray]:
        """What of a frame is aligned, and from where (4, 4): where keypoints say, or at the best expected pose."""
        if told is None:
            return grid, self._aligner.start(grid, reference, expected)
        start = self._aligner.nearest(grid, reference, [told.T_reference_frame, *expected])
        return self._still(grid, reference, start), start

    def _still(self, grid: GridFrame, reference: Reference, T_reference_frame: FloatArray) -> GridFrame:
        """A frame, located by keypoints at (4, 4), without the regions that move by themselves."""
        if not self._settings.regions.columns:
            return grid
        moving = self._misfits(grid, reference, T_reference_frame).moving
        return without(grid, moving) if moving.any() else grid

    def _misfits(self, grid: GridFrame, reference: Reference, T_reference_frame: FloatArray) -> Misfits:
        coarsest = self._settings.levels - 1
        levels = grid.levels[coarsest], reference.levels[coarsest]
        return misfits(*levels, T_reference_frame, self._noise, self._settings.regions)

    def _met(self, found: DenseAlignment, told: Told) -> tuple[DenseAlignment, Joint]:
        """An alignment, with keypoints by what their disagreement says of surfaces."""
        correlation = self._settings.correlation
        joint = self.weight.meet(found.T_reference_frame, found.claimed / correlation, told)
        information = found.information / joint.factor + correlation * told.information
        compared = found.compared / joint.factor + correlation * told.information
        hinted = (self._settings.verification.correlation - 1) * correlation * told.information
        T = joint.T_reference_frame
        return replace(found, T_reference_frame=T, information=information, compared=compared, hinted=hinted), joint

    def _tracked(
        self,
        grid: GridFrame,
        view: KnownView,
        found: DenseAlignment,
        judged: Judgement,
        T_map_camera: FloatArray,
        twist: FloatArray,
    ) -> Tracked:
        counts = (None, found.pairs, found.planes, judged.degenerate)
        spread = with_frame_error(judged.covariance, judged.T_reference_frame, self.of_frame)
        doubt, fitting = self.by_regions(grid, view.reference, judged.T_reference_frame)
        motion = MotionEstimate(judged.T_reference_frame, spread, *counts, fitting)
        fine = fine_share(grid, judged.T_reference_frame, self._settings.keyframes.fineness)
        fit = (found.planes / max(found.points, 1) * fine, view in self._views.keyframes, found.residual)
        covariance = view.with_motion(spread)
        return Tracked(grid, T_map_camera, covariance, motion, view.keyframe, twist, *fit, doubt=doubt)

    def _references(self, ahead: Prediction, state: TrackingState) -> Iterator[KnownView]:
        """Views from about there; while no frame has failed, the frame before too."""
        yield from self._views.around(ahead.T_map_camera[0], state)
        if state.failures == 0:
            yield self._views.of_frame(ahead.last)

    def _seen_sharper(self, found: Tracked, by: KnownView, ahead: Prediction, state: TrackingState) -> Tracked:
        """A pose by the map; by the frame before if only that shows all motion: a bare wall's marks fade in a map.

        Where neither does, constant velocity is held: a mark that fits another's place would pull along the wall.
        """
        if not self._views.has_model or state.failures or found.motion.shows_all:
            return found
        for view, is_held in [(self._views.of_frame(ahead.last), False), (by, True)][: 1 if ahead.is_helped else 2]:
            again = self.by_view(found.frame, view, ahead, ahead.T_map_camera, is_held=is_held)
            if isinstance(again, Tracked) and (is_held or again.motion.shows_all):
                return again
        return found


def _told(pose: KeypointPose | None, T_map_reference: FloatArray) -> Told | None:
    """What keypoints tell of the motion against a reference at (4, 4), where enough of them agree."""
    if pose is None or not pose.is_usable:
        return None
    return Told(se3.invert(T_map_reference) @ pose.T_map_camera, pose.information_from(T_map_reference))


def fine_share(frame: GridFrame, T_reference_frame: FloatArray, least: float) -> float:
    """The share of a frame's points that its reference saw at `least` so many times as finely."""
    points, _, _ = frame.levels[-1].points()
    there = points @ T_reference_frame[2, :3] + T_reference_frame[2, 3]
    return float(np.count_nonzero(points[:, 2] >= least * there) / max(len(points), 1))


def implausible(last: Tracked, T_map_camera: FloatArray, seconds: float, settings: DenseSettings) -> Reason | None:
    """The reason against a pose (4, 4) that no camera comes to in so short a time, or None."""
    T = se3.invert(last.T_map_camera) @ T_map_camera
    fast = np.linalg.norm(T[:3, 3]) > settings.max_speed_m_s * seconds
    turning = so3.angle(T[:3, :3]) > settings.max_turn_rad_s * seconds
    return Reason.IMPLAUSIBLE_MOTION if fast or turning else None


# Regions of a view that move by themselves, told by how far all of a region lies from what is known.
#
# Robust weights of pixels are outvoted where a person fills a fifth of the view: each pixel counts, and a person's
# have much texture. Here each region has one vote, however much it shows: a region is left out of an alignment where
# its points lie clearly farther from the surfaces known than those of the median region (cf. Scona et al.,
# StaticFusion, ICRA 2018, who weigh clusters).


@dataclass(frozen=True, slots=True, eq=False)
class Misfits:
    """How far each region (rows, columns) of a frame lies from the surfaces known, at one pose.

    Attributes:
        sigmas: in the mean of its points, in standard deviations of depth.
        metres: likewise, along the surfaces' normals.
        is_told: whether enough of its points lie where something is known.
        settings: which of them count as off.
    """

    sigmas: FloatArray
    metres: FloatArray
    is_told: BoolArray
    settings: RegionSettings

    @property
    def moving(self) -> BoolArray:
        """(rows, columns) which move by themselves; none where many would: then it is the pose that is wrong."""
        if not self._is_judged:
            return np.zeros(self.sigmas.shape, bool)
        usual = float(np.median(self.sigmas[self.is_told]))
        moves = self.is_told & (self.sigmas > max(self.settings.odd_factor * usual, self.settings.odd_sigmas))
        return np.zeros_like(moves) if self._are_many(moves) else moves

    @property
    def doubt_m(self) -> float:
        """How far off the pose itself may be, in metres: the median region's misfit where many regions contradict it.

        Else 0. All that follow a pose do not make it right: somebody close by has most pixels and most keypoints.
        """
        return float(np.median(self.metres[self.is_told])) if self._is_judged and self._are_many(self._is_off) else 0.0

    @property
    def fitting(self) -> float | None:
        """Share of the regions that have a say which do not lie off; None where they are too few."""
        return 1 - np.count_nonzero(self._is_off) / np.count_nonzero(self.is_told) if self._is_judged else None

    @property
    def _is_off(self) -> BoolArray:
        return np.asarray(self.is_told & (self.sigmas > self.settings.odd_sigmas))

    @property
    def _is_judged(self) -> bool:
        return int(np.count_nonzero(self.is_told)) >= self.settings.min_regions

    def _are_many(self, regions: BoolArray) -> bool:
        return int(np.count_nonzero(regions)) > self.settings.most_share * int(np.count_nonzero(self.is_told))


def without(frame: GridFrame, regions: BoolArray) -> GridFrame:
    """A frame of which some regions (rows, columns) have no depth, so that nothing is aligned there."""
    return replace(frame, levels=tuple(_without(level, regions) for level in frame.levels))


def _without(level: Level, regions: BoolArray) -> Level:
    height, width = level.depth_m.shape
    is_out = cv2.resize(regions.astype(np.uint8), (width, height), interpolation=cv2.INTER_NEAREST) > 0
    return replace(level, depth_m=np.where(is_out, np.float32(0), level.depth_m))


def misfits(
    level: Level, seen: ReferenceLevel, T_reference_frame: FloatArray, noise: DepthNoise, settings: RegionSettings
) -> Misfits:
    """How far regions lie from known planes, if the frame is at T_reference_frame (4, 4).

    A point that has another depth than the surface known there counts as `most_sigmas` off; one where nothing is
    known does not count.
    """
    fx, fy, cx, cy = level.intrinsics
    points, rows, columns = level.points()
    there = points @ T_reference_frame[:3, :3].T + T_reference_frame[:3, 3]
    is_ahead = there[:, 2] > noise.near_m
    depth = np.where(is_ahead, there[:, 2], 1.0)
    u, v = np.rint(fx * there[:, 0] / depth + cx), np.rint(fy * there[:, 1] / depth + cy)
    height, width = level.depth_m.shape
    is_inside = is_ahead & (u >= 0) & (u < width) & (v >= 0) & (v < height)
    at = np.where(is_inside, v * width + u, 0).astype(np.int64)
    planes = seen.pixels.reshape(-1, kernels.CHANNELS)[at]
    sigmas = np.hypot(noise.sigma_m(points[:, 2]), noise.sigma_m(depth))
    along = (planes[:, kernels.NX : kernels.NZ + 1] * there).sum(axis=1)
    off = np.abs(along - planes[:, kernels.OFFSET]) / sigmas
    elsewhere = np.abs(planes[:, kernels.DEPTH] - depth) > settings.most_sigmas * sigmas + settings.gate * depth
    off = np.minimum(np.where(elsewhere, settings.most_sigmas, off), settings.most_sigmas)
    is_known = is_inside & np.isfinite(off)
    region = (rows * settings.rows // height) * settings.columns + columns * settings.columns // width
    size = settings.rows * settings.columns
    count = np.bincount(region[is_known], minlength=size)
    shape = settings.rows, settings.columns
    means = [
        (np.bincount(region[is_known], of[is_known], minlength=size) / np.maximum(count, 1)).reshape(shape)
        for of in (off, off * sigmas)
    ]
    return Misfits(means[0], means[1], count.reshape(shape) >= settings.min_points, settings)


# Verifier: whether keypoints say the same as surfaces, wherever surfaces alone may be wrong.


class Verifier:
    """Asks keypoints where a frame is, and decides between them and surfaces where these say otherwise.

    Args:
        settings: which poses are suspected, and when keypoints count.
        keypoints: find a frame by its keypoints.
        views: the keyframes that it may show.
        by_regions: what a frame's regions say of its pose against a reference: see `Locator.by_regions`.
        watch: counts the time of "recognise".

    Attributes:
        faults: which poses are suspected.
    """

    def __init__(
        self,
        settings: DenseSettings,
        keypoints: KeypointTracker,
        views: Views,
        by_regions: Callable[[GridFrame, Reference, FloatArray], tuple[FloatArray, float | None]],
        watch: Stopwatch,
    ) -> None:
        self._all, self._settings, self._watch = settings, settings.verification, watch
        self._keypoints, self._views, self._by_regions = keypoints, views, by_regions
        self.faults = FaultDetector(settings.faults, settings.max_unseen_s)

    def ask(self, features: Features, twist: FloatArray, ahead: Prediction, state: TrackingState) -> Prediction:
        """What is expected of a frame, with what its keypoints say: by the frame before, or by keyframes known."""
        seconds = ahead.seconds_to(features.stamp_s)
        with self._watch.stage("recognise"):
            told = self._possible(self._keypoints.track(features, twist), ahead, seconds)
            if told is not None and (state.failures == 0 or told.is_likely):
                return replace(ahead, told=told)
            familiar = self._views.familiar(ahead.T_map_camera[0], state)
            seen_again = self._keypoints.recognise(features, familiar, twist)
            seen_again = self._possible(seen_again, ahead, seconds)
        if seen_again is None:
            return replace(ahead, told=told)
        is_elsewhere = not ahead.is_helped and not seen_again.agrees_with(ahead.T_map_camera[0])
        return replace(ahead.at(seen_again.T_map_camera) if is_elsewhere else ahead, told=seen_again)

    def _possible(self, told: KeypointPose | None, ahead: Prediction, seconds: float) -> KeypointPose | None:
        """The pose by keypoints; None where no camera turns that fast, however well they agree.

        Paint that repeats may look the same upside down, and all keypoints agree on it. Surfaces may have slid along a
        wall before, so that keypoints put that right by a leap; they have not turned over.
        """
        if told is None or seconds <= 0:
            return told
        R_last_now = ahead.last.T_map_camera[:3, :3].T @ told.T_map_camera[:3, :3]
        return told if so3.angle(R_last_now) <= self._all.max_turn_rad_s * seconds else None

    def verify(
        self, grid: GridFrame, found: Tracked | MotionEstimate, ahead: Prediction, state: TrackingState
    ) -> Tracked | MotionEstimate:
        """A pose that both agree with; theirs where they know better; that of surfaces where keypoints tell nothing.

        By surfaces alone it is kept while they show all motion and fit as usual, and without a leap. A prior stands in
        for what surfaces do not show, and for keypoints over a gap that it bridges.
        """
        told, seconds = ahead.told, ahead.seconds_to(grid.stamp_s)
        if not isinstance(found, Tracked):
            return self._instead(grid, found, ahead)
        if not ahead.is_helped and state.failures == 0:
            self.faults.count(seconds, shows_all=found.motion.shows_all)
        if told is not None and told.agrees_with(found.T_map_camera) and self._may_count(told, ahead, seconds):
            self.faults.unseen_s = 0.0  # keypoints show all motion
            return replace(found, told=told)
        if told is not None and told.is_clear:
            return self._taken(grid, told)
        if self._stands_alone(found, ahead, state, seconds):
            return found
        unseen = self.faults.is_blind and not ahead.is_helped
        if told is not None and self._may_count(told, ahead, seconds):
            reason = Reason.SURFACES_CONTRADICTED
        else:
            reason = Reason.DEGENERATE if unseen else Reason.NOT_RECOGNISED
        return self._instead(grid, MotionEstimate.failed(reason), ahead)

    def _stands_alone(self, found: Tracked, ahead: Prediction, state: TrackingState, seconds: float) -> bool:
        """Whether a pose counts that only surfaces tell, and perhaps a prior."""
        if ahead.is_helped and found.motion.shows_all and self.faults.is_bridged(found, ahead, seconds):
            return True
        is_steady = ahead.is_helped or bool(ahead.last.twist.any())
        if self.faults.suspects(found, seconds, is_alone=not ahead.is_helped, is_steady=is_steady):
            return False
        return state.failures == 0 or (ahead.is_helped and not self.faults.is_off_prior(found))

    def _may_count(self, told: KeypointPose, ahead: Prediction, seconds: float) -> bool:
        """Whether keypoints tell the place: after a while, and alone, the camera may be anywhere that looks alike."""
        return told.is_likely or ahead.is_helped or seconds <= self._settings.anywhere_s

    def _instead(self, grid: GridFrame, failure: MotionEstimate, ahead: Prediction) -> Tracked | MotionEstimate:
        """The pose by keypoints in place of one that surfaces do not tell, or why there is none."""
        told, seconds = ahead.told, ahead.seconds_to(grid.stamp_s)
        if told is None or not self._may_count(told, ahead, seconds):
            return failure
        if not told.is_clear and implausible(ahead.last, told.T_map_camera, seconds, self._all):
            return failure
        if ahead.is_helped and not told.is_clear and not told.agrees_with(ahead.T_map_camera[0]):
            return failure
        return self._taken(grid, told)

    def _taken(self, grid: GridFrame, told: KeypointPose) -> Tracked:
        """The pose by keypoints, as it lies off the nearest keyframe; somebody close by has many of them too."""
        self.faults.unseen_s = 0.0
        nearest = self._views.nearest(told.T_map_camera)
        T_map_camera, T_map_reference = se3.nearest(told.T_map_camera), nearest.reference.T_map_reference
        T_reference_camera = se3.invert(T_map_reference) @ T_map_camera
        doubt, fitting = self._by_regions(grid, nearest.reference, T_reference_camera)
        motion = replace(told.motion_from(T_map_reference), fitting=fitting)
        known = (grid, T_map_camera, told.covariance, motion, nearest.keyframe, grid.twist)
        is_near = nearest.distance_m(told.T_map_camera) < self._all.keyframe_way_m
        return Tracked(*known, overlap=float(is_near), told=told, doubt=doubt)


# Fault detection: which poses keypoints must verify, because surfaces alone may be wrong about them.


# The mean residual of a perfect fit, in standard deviations of the sensor.
_PERFECT = 1.0


class FaultDetector:
    """Suspects poses that nothing but surfaces speak for.

    Args:
        settings: what is suspected.
        max_unseen_s: for how long part of the motion may go unseen.

    Attributes:
        unseen_s: for how long some direction of motion has not been seen.
    """

    def __init__(self, settings: FaultSettings, max_unseen_s: float) -> None:
        self._settings, self._max_unseen_s = settings, max_unseen_s
        self._usual = _PERFECT
        self.unseen_s = 0.0

    @property
    def is_blind(self) -> bool:
        """Whether part of the motion has gone unseen for so long that the pose is a guess."""
        return self.unseen_s > self._max_unseen_s

    def count(self, seconds: float, *, shows_all: bool) -> None:
        """Count a frame that showed all motion or not; noise shows a direction now and then, which counts half."""
        self.unseen_s = max(self.unseen_s - 0.5 * seconds, 0.0) if shows_all else self.unseen_s + seconds

    def learn(self, found: Tracked) -> None:
        """Take a pose that was accepted as an example of how well surfaces fit here."""
        better = min(found.residual, self._settings.poor_fit * self._usual)
        self._usual = max(self._usual + self._settings.fit_learned * (better - self._usual), _PERFECT)

    def fits(self, found: Tracked) -> bool:
        """Whether surfaces fit about as well as usual."""
        return found.residual <= self._settings.poor_fit * self._usual

    def is_bridged(self, found: Tracked, ahead: Prediction, seconds: float) -> bool:
        """Whether a pose after a gap fits, just where another sensor expects it, as near as wheels know after so long.

        Surfaces alone may fit in another place, but hardly there.
        """
        T = se3.invert(ahead.T_map_camera[0]) @ found.T_map_camera
        near_m, near_rad = self._settings.bridged_off_m, self._settings.bridged_off_rad
        is_near = float(np.linalg.norm(T[:3, 3])) < near_m and float(so3.angle(T[:3, :3])) < near_rad
        return LONGEST_STEP_S < seconds <= self._settings.bridged_s and is_near and self.fits(found)

    def suspects(self, found: Tracked, seconds: float, *, is_alone: bool, is_steady: bool) -> bool:
        """Whether keypoints are to verify a pose so long after the one before.

        Args:
            found: the pose.
            seconds: since the one before.
            is_alone: no other sensor tells the motion; else it stands in for what surfaces do not show or fit.
            is_steady: the speed before is known, so that a leap can be told.
        """
        is_unsure = is_alone and (self.is_blind or not self.fits(found))
        return seconds > LONGEST_STEP_S or is_unsure or (is_steady and self._is_leap(found, seconds))

    def is_off_prior(self, found: Tracked) -> bool:
        """Whether a pose is so far off the one expected that the sensor that expects it, or the surfaces, are wrong."""
        limits = np.array([self._settings.off_prior_m_s, self._settings.off_prior_rad_s])
        return bool((_gained(found) > limits).any())

    def _is_leap(self, found: Tracked, seconds: float) -> bool:
        """Whether the camera would have had to gain more speed or turning, against what was expected, than one does."""
        at_once = np.array([self._settings.leap_m_s, self._settings.leap_rad_s])
        a_second = np.array([self._settings.leap_m_s2, self._settings.leap_rad_s2])
        return bool((_gained(found) > at_once + a_second * seconds).any())


def _gained(found: Tracked) -> FloatArray:
    change = found.twist - found.frame.twist
    return np.array([np.linalg.norm(change[:3]), np.linalg.norm(change[3:])])
