"""Locator: where a frame is by the views that are known, from where it is expected."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from wheelsight.calibration import Calibration
from wheelsight.estimates import DEGENERATE_SCALE, MotionEstimate, Reason
from wheelsight.geometry import FloatArray, se3, so3
from wheelsight.odometry.dense.alignment import Aligner, DenseAlignment, Step
from wheelsight.odometry.dense.grid import GridFrame
from wheelsight.odometry.dense.joint import Joint, SurfaceWeight, Told
from wheelsight.odometry.dense.keypoint_pose import KeypointPose
from wheelsight.odometry.dense.observability import Judgement, Prior, judge
from wheelsight.odometry.dense.prediction import Prediction
from wheelsight.odometry.dense.reference import Reference
from wheelsight.odometry.dense.regions import Misfits, misfits, without
from wheelsight.odometry.dense.settings import DenseSettings
from wheelsight.odometry.dense.tracked import Tracked
from wheelsight.odometry.dense.views import KnownView, Views
from wheelsight.odometry.frame_error import frame_covariance, with_frame_error
from wheelsight.odometry.state import TrackingState
from wheelsight.odometry.stopwatch import Stopwatch
from wheelsight.odometry.velocity import LONGEST_STEP_S


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
