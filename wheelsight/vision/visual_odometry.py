"""`CameraOdometry` is the base of all visual odometries.

`VisualOdometry` is the protocol of a user's visual odometry, with which `OwnOdometry` tracks a camera.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, Generic, Protocol, TypeVar

import numpy as np

from wheelsight.core.calibration import Calibration
from wheelsight.core.checks import answer_of, array_of, check_frame, need_calibration, need_method, need_motion
from wheelsight.core.errors import ArgumentError, PartError
from wheelsight.core.estimates import CameraEstimate, MotionEstimate, Reason, TrackingState
from wheelsight.core.geometry import FloatArray, se3
from wheelsight.core.geometry.motion_kernels import is_definite
from wheelsight.core.keyframes import KeyframeId, KeyframeStore
from wheelsight.core.messages import RgbdFrame
from wheelsight.core.stamps import StampCheck
from wheelsight.core.threads import OneCaller, Stopwatch, one_at_a_time
from wheelsight.vision.features.tracking import FeatureExtractor, FeatureSettings, KeyframeMaker

# Variance of the first pose. It is exact by definition of the map, but no covariance may be singular.
START_VARIANCE = 1e-12
# Distance between keyframes; a rotation by a radian counts as 1.5 m. Views of rooms then overlap by more than half.
_KEYFRAME_WAY_M = 0.4
# Number of reference frames in memory: the last keyframe, and older ones for relocalization.
_KEPT = 5
# Least share of pixels with depth of a first frame. A covered sensor still returns specks.
_LEAST_DEPTH = 0.01
# Largest asymmetry of a covariance by rounding, as a share of its largest entry.
_ASYMMETRY = 1e-6


Answer = TypeVar("Answer", bound=CameraEstimate)


class CameraOdometry(OneCaller, Generic[Answer]):
    """Base of the visual odometries: first pose, tracking state, failures and times.

    Args:
        calibration: of the cameras.
        estimate: the class of the estimates.
        lost_after: number of consecutive failed frames after which the state is lost.
        T_map_first: (4, 4) pose of the camera at the first tracked frame; default the map's origin.
        store: receives keyframes; default a new one.
    """

    def __init__(
        self,
        calibration: Calibration,
        estimate: type[Answer],
        lost_after: int,
        T_map_first: FloatArray | None,
        store: KeyframeStore | None,
    ) -> None:
        self._calibration, self._estimate = need_calibration(calibration), estimate
        self.store, self.watch = KeyframeStore() if store is None else store, Stopwatch()
        self._state, self._stamps = TrackingState(lost_after), StampCheck()
        self.begin_at(np.eye(4) if T_map_first is None else T_map_first)

    @property
    def stage_seconds(self) -> dict[str, float]:
        """Seconds the last frame spent in each stage."""
        return self.watch.seconds

    @one_at_a_time
    def begin_at(self, T_map_camera: FloatArray) -> None:
        """Set the pose (4, 4) of the camera at the first tracked frame. Raises ArgumentError for no rigid motion."""
        self._T_map_first = need_motion("T_map_first", T_map_camera)

    @one_at_a_time
    def miss(self, stamp_s: float) -> Answer:
        """Count a frame that is unusable, and so never reached `process`, as a failed one."""
        self._start_frame()
        return self._fail(stamp_s, MotionEstimate.failed(Reason.FRAME_UNUSABLE))

    def _start_frame(self) -> None:
        self.watch.restart()

    def _fail(self, stamp_s: float, failure: MotionEstimate, **more: Any) -> Answer:
        """The estimate of a failed frame."""
        self._state = self._state.failed()
        return self._estimate(
            stamp_s,
            self._state.status,
            reason=failure.reason,
            matches=failure.matches,
            inliers=failure.inliers,
            motion=failure,
            **more,
        )


class VisualOdometry(Protocol):
    """A user's method that estimates the motion of a depth camera between two frames.

    `Localizer` and `run` accept one as `visual_odometry` in place of dense or feature odometry. They choose reference
    frames, count failures, fuse the motion with wheels, and close loops.
    """

    def align(
        self, reference: RgbdFrame, current: RgbdFrame, T_reference_current_prior: FloatArray | None
    ) -> MotionEstimate:
        """T_reference_current (4, 4) of the camera with its covariance (6, 6), or `MotionEstimate.failed(reason)`.

        The covariance is of the left perturbation (v, ω), metres and radians; it must be positive definite.
        `degenerate` names directions that the images do not constrain. A frame may be compared with several references.

        A result with numbers that are not finite counts as a failed frame. An exception, another type or shape, a
        matrix that is no rigid motion, or a covariance that is not positive definite ends the run by a `PartError`.

        Args:
            reference: an earlier frame, for instance the last keyframe; read only.
            current: the newest frame.
            T_reference_current_prior: (4, 4) the motion predicted by wheels; None without prediction.
        """
        ...


@dataclass(frozen=True, slots=True, eq=False)
class _Reference:
    """A frame to align with: its keyframe, its pose relative to that, and its covariance in its own frame."""

    frame: RgbdFrame
    keyframe: KeyframeId
    T_keyframe_frame: FloatArray
    covariance: FloatArray

    def T_map_frame(self, store: KeyframeStore) -> FloatArray:
        return np.asarray(store.pose(self.keyframe) @ self.T_keyframe_frame)


class OwnOdometry(CameraOdometry[CameraEstimate]):
    """Tracks a camera by a user's `VisualOdometry`, as `FeatureOdometry` does by features.

    Args:
        part: aligns two frames.
        calibration: of the cameras.
        settings: `lost_after`, `max_speed_m_s`, `max_turn_rad_s`, and the settings of keypoints of keyframes.
        T_map_first: (4, 4) pose of the camera at the first frame; default the map's origin.
        store: receives keyframes; default a new one.

    Attributes:
        store: holds all keyframes and their poses.
    """

    def __init__(
        self,
        part: VisualOdometry,
        calibration: Calibration,
        settings: FeatureSettings | None = None,
        T_map_first: FloatArray | None = None,
        store: KeyframeStore | None = None,
    ) -> None:
        need_method("visual_odometry", part, "align")
        self._part, self._settings = part, settings or FeatureSettings()
        super().__init__(calibration, CameraEstimate, self._settings.lost_after, T_map_first, store)
        self._maker, self._extractor = KeyframeMaker(calibration), FeatureExtractor(calibration, self._settings)
        self._references: deque[_Reference] = deque(maxlen=_KEPT)  # keyframes, the newest last
        self._last: _Reference | None = None

    @one_at_a_time
    def process(
        self, frame: RgbdFrame, T_previous_current_prior: FloatArray | None = None, *, twist: FloatArray | None = None
    ) -> CameraEstimate:
        """The camera's pose at a frame, T_map_camera, or the reason of the failure.

        Args:
            frame: newer than the previous one.
            T_previous_current_prior: (4, 4) expected motion of the camera since the last tracked frame.
            twist: not used.

        Raises:
            ArgumentError: as `FeatureOdometry.process`.
            PartError: see `VisualOdometry.align`.
        """
        check_frame(frame, self._calibration, prior=T_previous_current_prior)
        if type(frame) not in self._stamps.settled:
            self._stamps.check(frame)
        self.watch.restart()
        last = self._last
        if last is None:
            return self._start(frame, self._T_map_first, START_VARIANCE * np.eye(6))
        failure: MotionEstimate | None = None
        # The last keyframe, the last tracked frame, and, once lost, older keyframes in turn.
        tried = [self._references[-1], last]
        if self._state.is_lost:
            tried.append(self._references[-1 - self._state.failures % len(self._references)])
        for at, reference in enumerate(tried):
            if any(reference.frame is before.frame for before in tried[:at]):
                continue
            prior = None
            if T_previous_current_prior is not None:
                T_map_expected = last.T_map_frame(self.store) @ T_previous_current_prior
                prior = se3.nearest(se3.invert(reference.T_map_frame(self.store)) @ T_map_expected)
            with self.watch.stage("align"):
                found = self._aligned(reference.frame, frame, prior)
            if found.reason is None and found.T_reference_current is not None:
                T_map_camera = reference.T_map_frame(self.store) @ found.T_reference_current
                seconds = frame.stamp_s - last.frame.stamp_s
                velocity = se3.twist_between(last.T_map_frame(self.store), T_map_camera, seconds)
                fast = np.linalg.norm(velocity[:3]) > self._settings.max_speed_m_s
                if not (fast or np.linalg.norm(velocity[3:]) > self._settings.max_turn_rad_s):
                    return self._succeed(frame, reference, found)
                found = MotionEstimate.failed(Reason.IMPLAUSIBLE_MOTION, found.matches, found.inliers)
            failure = failure or found
        assert failure is not None
        return self._fail(frame.stamp_s, failure)

    @one_at_a_time
    def restart(self, frame: RgbdFrame, T_map_camera: FloatArray, covariance: FloatArray) -> CameraEstimate:
        """Restart at a frame with a pose (4, 4) from other sensors, its covariance (6, 6); references are dropped."""
        check_frame(frame, self._calibration, T_map_camera=T_map_camera, covariance=covariance)
        self.watch.restart()
        return self._start(frame, T_map_camera, covariance)

    def _aligned(self, reference: RgbdFrame, frame: RgbdFrame, prior: FloatArray | None) -> MotionEstimate:
        """The validated result of the part. Raises PartError."""
        name = f"{type(self._part).__name__}.align"
        found = answer_of(self._part, "align", reference, frame, prior)
        if not isinstance(found, MotionEstimate):
            fix = "MotionEstimate(T_reference_current, covariance), or MotionEstimate.failed(Reason.TOO_FEW_MATCHES)"
            raise PartError(f"{name} returned {type(found).__name__}, not a MotionEstimate", fix=fix)
        if found.reason is not None or found.T_reference_current is None:
            return MotionEstimate.failed(found.reason or Reason.INVALID, found.matches, found.inliers)
        if found.covariance is None:
            raise PartError(f"{name} returned a motion without a covariance", fix="(6, 6), of the left perturbation")
        try:
            T = array_of("T_reference_current", found.T_reference_current, (4, 4))
            C = array_of("covariance", found.covariance, (6, 6))
            hidden: Any = np.zeros((0, 6)) if found.degenerate is None else found.degenerate
            hidden = array_of("degenerate", hidden, (len(hidden), 6))
            if not all(np.isfinite(numbers).all() for numbers in (T, C, hidden)):
                return MotionEstimate.failed(Reason.INVALID, found.matches, found.inliers)
            T = need_motion("T_reference_current", T)
        except ArgumentError as error:
            raise PartError(f"{name}: {error.problem}", fix=error.fix) from error
        if np.abs(C - C.T).max() > _ASYMMETRY * np.abs(C).max() or not is_definite((C + C.T) / 2):
            fix = "variances above 0 on the diagonal, large ones for what the images do not show"
            raise PartError(f"{name}: the covariance is not positive definite", fix=fix)
        degenerate = hidden if len(hidden) else None
        return replace(found, T_reference_current=se3.nearest(T), covariance=(C + C.T) / 2, degenerate=degenerate)

    def _succeed(self, frame: RgbdFrame, reference: _Reference, found: MotionEstimate) -> CameraEstimate:
        assert found.T_reference_current is not None
        assert found.covariance is not None
        Ad = se3.adjoint(se3.invert(found.T_reference_current))
        spread = Ad @ (reference.covariance + found.covariance) @ Ad.T
        T_keyframe_frame = se3.nearest(reference.T_keyframe_frame @ found.T_reference_current)
        self._last = _Reference(frame, reference.keyframe, T_keyframe_frame, spread)
        if reference is not self._references[-1]:  # this one is in view, the last keyframe is not
            if reference in self._references:
                self._references.remove(reference)
            self._references.append(reference)
        self._state = self._state.tracked()
        if se3.view_shift_m(T_keyframe_frame) > _KEYFRAME_WAY_M:
            self._keep(frame, self._last.T_map_frame(self.store), spread)
        return self._answer(found)

    def _start(self, frame: RgbdFrame, T_map_camera: FloatArray, covariance: FloatArray) -> CameraEstimate:
        """Start at a frame; `covariance` (6, 6) is of the left perturbation of its pose."""
        if np.count_nonzero(frame.depth_m > 0) < _LEAST_DEPTH * frame.depth_m.size:
            return self._fail(frame.stamp_s, MotionEstimate.failed(Reason.TOO_LITTLE_DEPTH))
        Ad = se3.adjoint(se3.invert(T_map_camera))
        self._references.clear()
        self._keep(frame, se3.nearest(T_map_camera), Ad @ covariance @ Ad.T)
        self._state = self._state.tracked()
        return self._answer(MotionEstimate(np.eye(4), START_VARIANCE * np.eye(6)))

    def _keep(self, frame: RgbdFrame, T_map_camera: FloatArray, spread: FloatArray) -> None:
        """Make a frame a keyframe and the next reference; its keypoints serve place recognition only."""
        with self.watch.stage("keyframe"):
            features = self._extractor.extract(frame)
            number = self.store.add(partial(self._maker.keyframe, frame, features), T_map_camera)
        self._last = _Reference(frame, number, np.eye(4), spread)
        self._references.append(self._last)

    def _answer(self, motion: MotionEstimate) -> CameraEstimate:
        last = self._last
        assert last is not None
        T_map_camera = last.T_map_frame(self.store)
        Ad = se3.adjoint(T_map_camera)
        return CameraEstimate(
            last.frame.stamp_s,
            self._state.status,
            se3.nearest(T_map_camera),
            Ad @ last.covariance @ Ad.T,
            matches=motion.matches,
            inliers=motion.inliers,
            keyframe=last.keyframe,
            T_keyframe_body=last.T_keyframe_frame,
            motion=motion,
            shows_all=motion.shows_all,
        )
