"""`Locator` estimates the pose of a frame from known views and excludes moving regions. `Verifier` checks the pose
by keypoints where the alignment may be wrong.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
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
    CORRELATION,
    Aligner,
    DenseAlignment,
    Joint,
    KeypointMotion,
    MotionPrior,
    PreviousPose,
    SurfaceWeight,
    judge,
)
from wheelsight.vision.dense.pyramid import LEVELS, GridFrame, Reference
from wheelsight.vision.dense.settings import DenseSettings
from wheelsight.vision.dense.views import (
    KEYPOINT_CORRELATION,
    KeypointPose,
    KeypointTracker,
    KnownView,
    Prediction,
    Tracked,
    ViewCache,
)
from wheelsight.vision.features.tracking import Features
from wheelsight.vision.tracking_state import LONGEST_STEP_S, Stopwatch, TrackingState

# Uncertainty of the predicted speed, m/s, which unseen directions get; its share for a base on wheels to move sideways,
# rise or tilt (simulator: docs/decisions/dense-alignment.md).
PRIOR_SIGMA_M_S, _NONHOLONOMIC_SHARE = 0.5, 0.15
# Share of a frame's resolution that a keyframe must have to show it. Along a corridor a frame errs by 3 mm with half of
# it, and by 1 mm with this share, where keypoints are recognised (simulator: docs/decisions/dense-alignment.md).
_FINENESS = 0.8


class Locator:
    """Estimates the pose of a frame by alignment with known views.

    Args:
        calibration: of the cameras; gives the error that all pixels of a frame share.
        settings: the uncertainty of predictions and the limits on speed.
        aligner: aligns a frame with one view.
        views: the known views.
        watch: counts the time of "align".

    Attributes:
        of_frame: covariance (6, 6) in the camera's frame of the error that all pixels of a frame share.
        weight: the weight of surfaces relative to keypoints.
    """

    def __init__(
        self, calibration: Calibration, settings: DenseSettings, aligner: Aligner, views: ViewCache, watch: Stopwatch
    ) -> None:
        self._settings, self._aligner, self._views, self._watch = settings, aligner, views, watch
        self.of_frame, self._noise = frame_covariance(calibration), calibration.depth_noise
        self.weight = SurfaceWeight()

    def locate(self, grid: GridFrame, ahead: Prediction, state: TrackingState) -> Tracked | MotionEstimate:
        """The frame by the first view that fits, together with keypoints, or the reason why none does.

        The alignment starts at the pose by keypoints, or at the best of the predicted poses.
        """
        failure: MotionEstimate | None = None
        for place, view in enumerate(self._views.around(ahead.T_map_camera[0], ahead.last, state)):
            is_elsewhere = place > 0 and state.is_lost
            begun = (view.reference.T_map_reference,) if is_elsewhere else ahead.T_map_camera
            found = self.by_view(grid, view, ahead, begun)
            if isinstance(found, Tracked):
                return self._refined(found, view, ahead, state)
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
        """The frame aligned with one view from the best of some poses T_map_camera, or the reason of the failure.

        Args:
            grid: the frame.
            view: to align with.
            ahead: the prediction; its poses are the prior of directions that the view does not constrain.
            begun: initial poses, each (4, 4).
            is_held: whether constant velocity counts as a prior of the alignment too.
        """
        reference, seconds = view.reference, ahead.seconds
        T_reference_map = se3.invert(reference.T_map_reference)
        is_near = seconds <= LONGEST_STEP_S
        previous = PreviousPose(T_reference_map @ ahead.last.T_map_camera, seconds) if is_near else None
        sigma_m = PRIOR_SIGMA_M_S * max(seconds, 1e-3)
        # Constant velocity is no prior by default: a pose that noise pulls away must show as a leap.
        held_m = sigma_m if ahead.is_helped or is_held else np.inf, _NONHOLONOMIC_SHARE * sigma_m
        with self._watch.stage("align"):
            keypoints, pose = None, ahead.keypoint_pose
            if pose is not None and pose.is_usable:
                information = pose.information_from(reference.T_map_reference)
                keypoints = KeypointMotion(T_reference_map @ pose.T_map_camera, information)
            used, start = self._start(grid, reference, [T_reference_map @ T for T in begun], keypoints)
            starts = [start]
            if ahead.T_map_other is not None:
                starts.append(self._aligner.turn(grid, reference, T_reference_map @ ahead.T_map_other))
            found = self._aligner.align_clearest(
                used, reference, starts, previous, held_m, keypoints, self.weight.factor
            )
        joint = None
        if keypoints is not None:
            found, joint = self._joined(found, keypoints)
        first, *others = [T_reference_map @ T for T in ahead.T_map_camera]
        judged = judge(found, MotionPrior(first, sigma_m, tuple(others)))
        T_map_camera = se3.nearest(reference.T_map_reference @ judged.T_reference_frame)
        reason = judged.reason or implausible(ahead.last, T_map_camera, seconds, self._settings)
        if reason is not None:
            return MotionEstimate.failed(reason, found.pairs, found.planes)
        twist = previous.twist_to(judged.T_reference_frame) if previous else grid.twist
        turning = judged.T_reference_frame[:3, :3] @ twist[3:] - view.turning_rad_s
        counts = (None, found.pairs, found.planes, judged.degenerate)
        spread = with_frame_error(judged.covariance, judged.T_reference_frame, self.of_frame)
        frame_error, fitting = self.by_regions(grid, view.reference, judged.T_reference_frame)
        motion = MotionEstimate(judged.T_reference_frame, spread, *counts, fitting)
        fine = fine_share(grid, judged.T_reference_frame, _FINENESS)
        fit = (found.planes / max(found.points, 1) * fine, view in self._views.keyframes, found.residual)
        covariance = view.with_motion(spread)
        tracked = Tracked(grid, T_map_camera, covariance, motion, view.keyframe, twist, *fit, frame_error=frame_error)
        return replace(tracked, joint=joint, turning_rad_s=turning)

    def by_regions(
        self, grid: GridFrame, reference: Reference, T_reference_frame: FloatArray
    ) -> tuple[FloatArray, float | None]:
        """The pose error T_reference_frame (4, 4) by the regions of a frame.

        Returns:
            Covariance (6, 6) of the error in the frame's own axes, with rotations as distances at 2 m; 0 if most
            regions agree with the pose. Then the share of regions that agree, or None if too few are compared.
        """
        error_m, fitting = misfits(grid, reference, T_reference_frame, self._noise).pose_error()
        return np.diag((error_m / DEGENERATE_SCALE) ** 2), fitting

    def _start(
        self, grid: GridFrame, reference: Reference, expected: list[FloatArray], keypoints: KeypointMotion | None
    ) -> tuple[GridFrame, FloatArray]:
        """The frame without moving regions, and the initial pose (4, 4): by keypoints, or the best predicted one."""
        if keypoints is None:
            return grid, self._aligner.start(grid, reference, expected)
        start = self._aligner.nearest(grid, reference, [keypoints.T_reference_frame, *expected])
        moving = misfits(grid, reference, start, self._noise).moving
        return without(grid, moving) if moving.any() else grid, start

    def _joined(self, found: DenseAlignment, keypoints: KeypointMotion) -> tuple[DenseAlignment, Joint]:
        """An alignment combined with keypoints; their difference gives the covariance of surfaces."""
        joint = self.weight.meet(found.T_reference_frame, found.claimed / CORRELATION, keypoints)
        combined = replace(
            found,
            T_reference_frame=joint.T_reference_frame,
            information=found.information / joint.factor + CORRELATION * keypoints.information,
            compared=found.compared / joint.factor + CORRELATION * keypoints.information,
            hinted=(KEYPOINT_CORRELATION - 1) * CORRELATION * keypoints.information,
        )
        return combined, joint

    def _refined(self, found: Tracked, by: KnownView, ahead: Prediction, state: TrackingState) -> Tracked:
        """A pose by the map, replaced by one against the previous frame if only that constrains all directions.

        The texture of a bare wall fades in a map. If neither constrains all directions, constant velocity becomes a
        prior, because marks that match each other's places pull the pose along the wall.
        """
        if not self._views.has_model or state.failures or found.motion.shows_all:
            return found
        for view, is_held in [(self._views.of_frame(ahead.last), False), (by, True)][: 1 if ahead.is_helped else 2]:
            again = self.by_view(found.frame, view, ahead, ahead.T_map_camera, is_held=is_held)
            if isinstance(again, Tracked) and (is_held or again.motion.shows_all):
                return again
        return found


def fine_share(frame: GridFrame, T_reference_frame: FloatArray, least: float) -> float:
    """The share of a frame's points that its reference saw at `least` times the frame's resolution."""
    points, _, _ = frame.levels[-1].points()
    there = points @ T_reference_frame[2, :3] + T_reference_frame[2, 3]
    return float(np.count_nonzero(points[:, 2] >= least * there) / max(len(points), 1))


def implausible(last: Tracked, T_map_camera: FloatArray, seconds: float, settings: DenseSettings) -> Reason | None:
    """`Reason.IMPLAUSIBLE_MOTION` if the pose (4, 4) exceeds the limits on speed, else None."""
    T = se3.invert(last.T_map_camera) @ T_map_camera
    fast = np.linalg.norm(T[:3, 3]) > settings.max_speed_m_s * seconds
    turning = so3.angle(T[:3, :3]) > settings.max_turn_rad_s * seconds
    return Reason.IMPLAUSIBLE_MOTION if fast or turning else None


# Moving regions. Robust weights of single pixels fail if a person fills a fifth of the view: each pixel has a vote, and
# a person has much texture. Here each region has one vote. A region is excluded if its points lie clearly farther from
# known surfaces than those of the median region (cf. Scona et al., StaticFusion, ICRA 2018, who weigh clusters).

REGION_ROWS, REGION_COLUMNS = 6, 8  # regions of a view; chosen
# A region moves if it lies this many times as far from known surfaces as the median region, and at least this many
# standard deviations of depth; chosen.
_ODD_FACTOR, _ODD_SIGMAS = 2.5, 3.0
_MOST_SIGMAS = 8.0  # limit of one point's distance
# A point is on another surface beyond this distance per metre of depth; chosen.
_OTHER_SURFACE = 0.03
_MOST_MOVING = 0.4  # share of the regions; if more would be excluded, the pose is wrong
_MIN_POINTS, _MIN_REGIONS = 20, 12  # points that a region needs at the coarsest level, and regions to judge any


@dataclass(frozen=True, slots=True, eq=False)
class Misfits:
    """The distance of each region (rows, columns) of a frame from known surfaces, at one pose.

    Attributes:
        sigmas: mean distance of its points, in standard deviations of depth.
        metres: mean distance of its points along the surfaces' normals.
        is_compared: whether enough of its points lie on a known surface.
    """

    sigmas: FloatArray
    metres: FloatArray
    is_compared: BoolArray

    @property
    def moving(self) -> BoolArray:
        """(rows, columns) whether a region moves; none if many would, because then the pose is wrong."""
        compared = int(np.count_nonzero(self.is_compared))
        if compared < _MIN_REGIONS:
            return np.zeros(self.sigmas.shape, bool)
        usual = float(np.median(self.sigmas[self.is_compared]))
        moves = self.is_compared & (self.sigmas > max(_ODD_FACTOR * usual, _ODD_SIGMAS))
        return np.zeros_like(moves) if int(np.count_nonzero(moves)) > _MOST_MOVING * compared else moves

    def pose_error(self) -> tuple[float, float | None]:
        """The error of the pose in metres, and the share of compared regions that agree with it.

        The error is the median region's distance if many regions contradict the pose, else 0. Agreement of most pixels
        and keypoints does not prove a pose: a person close by has most of both. The share is None if too few regions
        are compared.
        """
        compared = int(np.count_nonzero(self.is_compared))
        if compared < _MIN_REGIONS:
            return 0.0, None
        off = int(np.count_nonzero(self.is_compared & (self.sigmas > _ODD_SIGMAS)))
        error_m = float(np.median(self.metres[self.is_compared])) if off > _MOST_MOVING * compared else 0.0
        return error_m, 1 - off / compared


def without(frame: GridFrame, regions: BoolArray) -> GridFrame:
    """The frame without the depth of some regions (rows, columns), so that alignment ignores them."""
    levels = []
    for level in frame.levels:
        height, width = level.depth_m.shape
        is_out = cv2.resize(regions.astype(np.uint8), (width, height), interpolation=cv2.INTER_NEAREST) > 0
        levels.append(replace(level, depth_m=np.where(is_out, np.float32(0), level.depth_m)))
    return replace(frame, levels=tuple(levels))


def misfits(frame: GridFrame, reference: Reference, T_reference_frame: FloatArray, noise: DepthNoise) -> Misfits:
    """The distance of regions from known planes for a frame at T_reference_frame (4, 4), at the coarsest level.

    A point whose depth differs from the known surface counts as `_MOST_SIGMAS` away. A point without a known surface
    does not count.
    """
    level, seen = frame.levels[LEVELS - 1], reference.scales.levels[LEVELS - 1]
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
    sigmas = np.hypot(*noise.sigma_m(np.stack([points[:, 2], depth])))
    along = (planes[:, kernels.NX : kernels.NZ + 1] * there).sum(axis=1)
    off = np.abs(along - planes[:, kernels.OFFSET]) / sigmas
    elsewhere = np.abs(planes[:, kernels.DEPTH] - depth) > _MOST_SIGMAS * sigmas + _OTHER_SURFACE * depth
    off = np.minimum(np.where(elsewhere, _MOST_SIGMAS, off), _MOST_SIGMAS)
    is_known = is_inside & np.isfinite(off)
    region = (rows * REGION_ROWS // height) * REGION_COLUMNS + columns * REGION_COLUMNS // width
    shape, size, region = (REGION_ROWS, REGION_COLUMNS), REGION_ROWS * REGION_COLUMNS, region[is_known]
    count = np.bincount(region, minlength=size)
    mean_sigmas = np.bincount(region, off[is_known], minlength=size) / np.maximum(count, 1)
    mean_m = np.bincount(region, (off * sigmas)[is_known], minlength=size) / np.maximum(count, 1)
    return Misfits(mean_sigmas.reshape(shape), mean_m.reshape(shape), count.reshape(shape) >= _MIN_POINTS)


# Time in seconds without a pose and prior after which the camera may be anywhere, so that a pose must be likely; after
# one second less suffices to recognise the right place in a corridor (simulator: docs/decisions/features.md).
_ANYWHERE_S = 2.0


class Verifier:
    """Estimates the pose of a frame by its keypoints, and decides between that and the pose by surfaces.

    Args:
        settings: thresholds of fault detection, and of agreement with keypoints.
        keypoints: estimates the pose of a frame by its keypoints.
        views: keyframes that the frame may show.
        by_regions: the pose error by regions: see `Locator.by_regions`.
        watch: counts the time of "recognise".

    Attributes:
        faults: decides which poses need verification.
    """

    def __init__(
        self,
        settings: DenseSettings,
        keypoints: KeypointTracker,
        views: ViewCache,
        by_regions: Callable[[GridFrame, Reference, FloatArray], tuple[FloatArray, float | None]],
        watch: Stopwatch,
    ) -> None:
        self._settings, self._watch = settings, watch
        self._keypoints, self._views, self._by_regions = keypoints, views, by_regions
        self.faults = FaultDetector(settings.max_unseen_s)

    def ask(self, features: Features, twist: FloatArray, ahead: Prediction, state: TrackingState) -> Prediction:
        """The prediction with the pose by keypoints, against the previous frame or against known keyframes."""
        with self._watch.stage("recognise"):
            pose = self._plausible(self._keypoints.track(features, twist), ahead)
            if pose is not None and (state.failures == 0 or pose.is_likely):
                return replace(ahead, keypoint_pose=pose)
            candidates = self._views.candidates(ahead.T_map_camera[0], state)
            seen_again = self._keypoints.recognise(features, candidates, twist)
            seen_again = self._plausible(seen_again, ahead)
        if seen_again is None:
            return replace(ahead, keypoint_pose=pose)
        is_elsewhere = not ahead.is_helped and not seen_again.agrees_with(ahead.T_map_camera[0])
        return replace(ahead.at(seen_again.T_map_camera) if is_elsewhere else ahead, keypoint_pose=seen_again)

    def _plausible(self, pose: KeypointPose | None, ahead: Prediction) -> KeypointPose | None:
        """The pose by keypoints; None if it exceeds the limit on turning, however well keypoints agree.

        A repeated texture may look the same upside down. A leap of the position is allowed: it corrects surfaces that
        slid along a wall before.
        """
        if pose is None or ahead.seconds <= 0:
            return pose
        R_last_now = ahead.last.T_map_camera[:3, :3].T @ pose.T_map_camera[:3, :3]
        return pose if so3.angle(R_last_now) <= self._settings.max_turn_rad_s * ahead.seconds else None

    def verify(
        self, grid: GridFrame, found: Tracked | MotionEstimate, ahead: Prediction, state: TrackingState
    ) -> Tracked | MotionEstimate:
        """The verified pose, or the reason why none is accepted.

        It is the pose by surfaces if keypoints agree, and the one by keypoints if these contradict it clearly. Without
        keypoints the pose by surfaces stands while it fits as usual, constrains all directions and makes no leap. A
        prior replaces directions that surfaces do not constrain, and keypoints over a short gap.
        """
        pose, seconds = ahead.keypoint_pose, ahead.seconds
        if not isinstance(found, Tracked):
            return self._fall_back(grid, found, ahead)
        if not ahead.is_helped and state.failures == 0:
            self.faults.count(seconds, shows_all=found.motion.shows_all)
        if pose is not None and pose.agrees_with(found.T_map_camera) and self._is_unambiguous(pose, ahead):
            self.faults.unseen_s = 0.0  # keypoints show all motion
            return replace(found, keypoint_pose=pose)
        if pose is not None and pose.is_clear:
            return self._by_keypoints(grid, pose)
        if ahead.is_helped and found.motion.shows_all and self.faults.is_bridged(found, ahead):
            return found
        is_steady = ahead.is_helped or bool(ahead.last.twist.any())
        suspected = self.faults.suspects(found, seconds, is_alone=not ahead.is_helped, is_steady=is_steady)
        if not suspected and (state.failures == 0 or (ahead.is_helped and not self.faults.is_off_prior(found))):
            return found  # by surfaces alone, or by surfaces and a prior
        unseen = self.faults.is_blind and not ahead.is_helped
        if pose is not None and self._is_unambiguous(pose, ahead):
            reason = Reason.SURFACES_CONTRADICTED
        else:
            reason = Reason.DEGENERATE if unseen else Reason.NOT_RECOGNISED
        return self._fall_back(grid, MotionEstimate.failed(reason), ahead)

    def _is_unambiguous(self, pose: KeypointPose, ahead: Prediction) -> bool:
        """Whether keypoints identify the place: after a gap without prior the camera may be at one that looks alike."""
        return pose.is_likely or ahead.is_helped or ahead.seconds <= _ANYWHERE_S

    def _fall_back(self, grid: GridFrame, failure: MotionEstimate, ahead: Prediction) -> Tracked | MotionEstimate:
        """The pose by keypoints, or `failure` if that is not accepted either."""
        pose = ahead.keypoint_pose
        if pose is None or not self._is_unambiguous(pose, ahead):
            return failure
        if not pose.is_clear and implausible(ahead.last, pose.T_map_camera, ahead.seconds, self._settings):
            return failure
        if ahead.is_helped and not pose.is_clear and not pose.agrees_with(ahead.T_map_camera[0]):
            return failure
        return self._by_keypoints(grid, pose)

    def _by_keypoints(self, grid: GridFrame, pose: KeypointPose) -> Tracked:
        """The pose by keypoints, relative to the nearest keyframe and with the pose error by regions."""
        self.faults.unseen_s = 0.0
        nearest = self._views.nearest(pose.T_map_camera)
        T_map_camera, T_map_reference = se3.nearest(pose.T_map_camera), nearest.reference.T_map_reference
        T_reference_camera = se3.invert(T_map_reference) @ T_map_camera
        frame_error, fitting = self._by_regions(grid, nearest.reference, T_reference_camera)
        motion = replace(pose.motion_from(T_map_reference), fitting=fitting)
        known = (grid, T_map_camera, pose.covariance, motion, nearest.keyframe, grid.twist)
        is_near = nearest.distance_m(pose.T_map_camera) < self._settings.keyframe_way_m
        return Tracked(*known, overlap=float(is_near), keypoint_pose=pose, frame_error=frame_error)


# The mean residual of a perfect fit, in standard deviations of the sensor.
_PERFECT_FIT = 1.0
# Change of speed (m/s, rad/s) at once beyond which a pose is a leap, and its growth per second since the last frame;
# hand-held cameras change less. Chosen.
_LEAP, _LEAP_PER_S = (0.5, 1.5), (10.0, 30.0)
# Difference of speed (m/s, rad/s) from a prior by other sensors beyond which one of both is wrong: wheels without slip
# err by a tenth and a quarter of it (simulator: docs/decisions/features.md).
_OFF_PRIOR = np.array([0.2, 0.2])
# Longest gap in seconds that such a prior bridges, and the distance from it, in metres and radians, within which a pose
# after a gap needs no keypoints (simulator: docs/decisions/features.md).
_BRIDGED_S, _BRIDGED_OFF_M, _BRIDGED_OFF_RAD = 10.0, 0.05, 0.03
# Without prior, a residual this many times the usual one needs verification: wrong poses had 4 to 5 times in eight
# simulated flats. On a real hand-held recording as much is usual, and learned (docs/decisions/features.md).
_POOR_FIT = 2.0
# Share of a frame's residual that updates the usual one; chosen.
_FIT_LEARNED = 0.1


class FaultDetector:
    """Decides which poses by surfaces need verification by keypoints.

    Args:
        max_unseen_s: how long a direction of motion may stay unconstrained.

    Attributes:
        unseen_s: how long some direction of motion has been unconstrained.
    """

    def __init__(self, max_unseen_s: float) -> None:
        self._max_unseen_s, self._usual, self.unseen_s = max_unseen_s, _PERFECT_FIT, 0.0

    @property
    def is_blind(self) -> bool:
        """Whether a direction of motion has been unconstrained for more than `max_unseen_s`."""
        return self.unseen_s > self._max_unseen_s

    def count(self, seconds: float, *, shows_all: bool) -> None:
        """Update `unseen_s` by a frame. One that constrains all directions counts half, because noise does so too."""
        self.unseen_s = max(self.unseen_s - 0.5 * seconds, 0.0) if shows_all else self.unseen_s + seconds

    def learn(self, found: Tracked) -> None:
        """Update the usual residual by an accepted pose."""
        better = min(found.residual, _POOR_FIT * self._usual)
        self._usual = max(self._usual + _FIT_LEARNED * (better - self._usual), _PERFECT_FIT)

    def fits(self, found: Tracked) -> bool:
        """Whether the residual of surfaces is about as usual."""
        return found.residual <= _POOR_FIT * self._usual

    def is_bridged(self, found: Tracked, ahead: Prediction) -> bool:
        """Whether a pose after a gap fits and lies near the prior, within the drift of wheels over the gap.

        Surfaces may fit at a wrong place, but hardly at the predicted one.
        """
        T = se3.invert(ahead.T_map_camera[0]) @ found.T_map_camera
        is_near = float(np.linalg.norm(T[:3, 3])) < _BRIDGED_OFF_M and float(so3.angle(T[:3, :3])) < _BRIDGED_OFF_RAD
        return LONGEST_STEP_S < ahead.seconds <= _BRIDGED_S and is_near and self.fits(found)

    def suspects(self, found: Tracked, seconds: float, *, is_alone: bool, is_steady: bool) -> bool:
        """Whether a pose needs verification by keypoints.

        Args:
            found: the pose.
            seconds: since the previous one.
            is_alone: whether there is no prior, which would replace directions that surfaces do not constrain.
            is_steady: whether the previous speed is known, so that a leap can be detected.
        """
        if seconds > LONGEST_STEP_S or (is_alone and (self.is_blind or not self.fits(found))):
            return True
        limits = np.array(_LEAP) + np.array(_LEAP_PER_S) * seconds  # beyond, no real camera moves
        return is_steady and bool((_speed_change(found) > limits).any())

    def is_off_prior(self, found: Tracked) -> bool:
        """Whether a pose lies so far from the prior that one of both is wrong."""
        return bool((_speed_change(found) > _OFF_PRIOR).any())


def _speed_change(found: Tracked) -> FloatArray:
    """The change (2,) of speed and angular speed, m/s and rad/s, between prediction and pose."""
    change = found.twist - found.frame.twist
    return np.array([np.linalg.norm(change[:3]), np.linalg.norm(change[3:])])
