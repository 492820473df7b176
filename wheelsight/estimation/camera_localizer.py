"""Localization by the camera alone (`ByFrames`), and the choice of its odometry."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from wheelsight.config import Config
from wheelsight.core.calibration import Calibration
from wheelsight.core.checks import FrameGate, Untimed
from wheelsight.core.errors import CalibrationError
from wheelsight.core.estimates import (
    CameraEstimate,
    Estimate,
    MotionEstimate,
    PoseDecision,
    PoseEvidence,
    PoseFinding,
    Reason,
    Status,
    decide,
)
from wheelsight.core.geometry import FloatArray, se3
from wheelsight.core.keyframes import KeyframeId
from wheelsight.core.messages import Event, RgbdFrame, SkippedFrame
from wheelsight.estimation.loop_updates import LoopClosureClient, begin_in, loop_closure_client
from wheelsight.estimation.odometry_choice import NO_PARTS, OwnParts
from wheelsight.mapping.surfels import MapBuilder
from wheelsight.slam.place_recognition import KnownMap
from wheelsight.vision.dense import DenseEstimate, DenseOdometry
from wheelsight.vision.features import FeatureEstimate, FeatureOdometry, MatchedPixels
from wheelsight.vision.visual_odometry import OwnOdometry

CameraOdometry = FeatureOdometry | DenseOdometry | OwnOdometry

# Frames in a row that show nothing known, after which the camera continues from the pose of the wheels.
RESTART_AFTER = 5
# Reasons of frames that show nothing at all, rather than something unknown.
BLIND = (Reason.TOO_LITTLE_DEPTH, Reason.FRAME_UNUSABLE, Reason.TOO_FEW_KEYPOINTS)
# Standard deviations of the speed and turn rate of a camera that sees nothing, as when carried; chosen. The largest one
# of a heading, radians; that of any heading is 1.8.
_CARRIED_M_S, _CARRIED_RAD_S, _MOST_RAD = 1.0, 1.0, 2.0


class ByFrames:
    """Answers frames by the odometry that the settings name. Poses are of the base if `T_base_camera` is known.

    Attributes:
        keyframes: of the odometry.
        last_matches: pixels by which the last frame was aligned; None if there are none.
        loops: closes loops while driving, if the settings ask for it.
        T_odom_map: (4, 4) pose of the map, in which loops move the camera.
    """

    answers = (RgbdFrame, SkippedFrame)
    last_place = None

    def __init__(
        self,
        calibration: Calibration,
        settings: Config,
        known: KnownMap | None = None,
        *,
        waits: bool = False,
        parts: OwnParts = NO_PARTS,
    ) -> None:
        self.frame = "map" if known is None else "odom"  # with an existing map, odom starts anywhere in it
        self.body = "camera" if calibration.T_base_camera is None else "base"
        self.odometry, self.mapper = camera_odometry(calibration, settings, known, parts)
        self.keyframes, self.watch = self.odometry.store, self.odometry.watch
        T_base_camera = calibration.T_base_camera
        self._T_camera_base = None if T_base_camera is None else se3.invert(T_base_camera)
        self._gate = FrameGate()
        self.hears: tuple[type[Event], ...] = self.answers
        self._status = Status.INITIALIZING
        self.last_matches: MatchedPixels | None = None
        store, detector = self.odometry.store, parts.loop_detector
        self.loops = loop_closure_client(store, calibration, settings, known, waits=waits, detector=detector)
        self.T_odom_map: FloatArray = np.eye(4)
        if known is not None:
            T_odom_camera = np.eye(4) if T_base_camera is None else T_base_camera
            self.T_odom_map = se3.nearest(T_odom_camera @ se3.invert(begin_in(known, calibration)))
        self._keyframe: KeyframeId | None = None
        self._last: CameraEstimate | None = None  # the last one with a pose, in odom

    @property
    def warnings(self) -> tuple[str, ...]:
        """A sentence for a camera that hung."""
        return self._gate.warnings

    def process(self, event: Event) -> tuple[Estimate | None, str]:
        """Return the estimate at a frame, None at any other event, and why a frame cannot be used."""
        if isinstance(event, SkippedFrame):
            return self._failed(event.stamp_s, event.reason)
        if not isinstance(event, RgbdFrame):
            return None, ""
        why_not = self._gate.why_not(event)
        self.watch.lap("check")
        if why_not is None:
            return self._of_body(self._track(event)), ""
        if why_not.is_repeat:  # no pose, and no failure of odometry
            evidence = [PoseEvidence(PoseFinding.FRAME_FAILED)] if self._status is Status.TRACKING else []
            status = decide(evidence, PoseDecision(self._status)).status
            return Estimate(event.stamp_s, status, reason=Reason.REPEATED, body=self.body), why_not.note
        return self._failed(event.stamp_s, why_not.note)

    def refuse(self, event: Event, why: Untimed) -> tuple[Estimate, str]:
        """Return the estimate at a frame with an invalid stamp."""
        return self._failed(event.stamp_s, why.note)

    def _failed(self, stamp_s: float, why: str) -> tuple[Estimate, str]:
        return self._of_body(self.odometry.miss(stamp_s)), why

    def _track(self, frame: RgbdFrame) -> CameraEstimate:
        """Return the camera's pose at a frame. The map grows if the frame shows all directions."""
        T_new_old = None if self.loops is None else self.loops.move_keyframes(frame.stamp_s, self._keyframe)
        if T_new_old is not None:
            self.T_odom_map = se3.nearest(self.T_odom_map @ se3.invert(T_new_old))
        if self.loops is not None:
            self.watch.lap("loops")
        with self.watch.stage("track"):
            estimate: CameraEstimate = self.odometry.process(frame)
        if self.loops is not None and estimate.status is Status.LOST and estimate.reason not in BLIND:
            estimate = self._begin_submap(self.loops, frame, estimate)
        self._keyframe = self._keyframe if estimate.keyframe is None else estimate.keyframe
        if self.mapper is not None and isinstance(estimate, DenseEstimate) and estimate.shows_all:
            self.mapper.fuse_tracked(frame, estimate)
        if self.loops is None:
            return estimate
        in_odom = framed(estimate, self.T_odom_map)
        if in_odom.covariance is not None:
            self.loops.add_tracked(estimate, self.T_odom_map, in_odom.covariance)
            self.loops.add_keyframes(frame.stamp_s, self.T_odom_map, in_odom.covariance)
            self.loops.hand_over()
            self.watch.lap("loops")
        self._last = self._last if in_odom.T_odom_body is None else in_odom
        T_map_odom = in_odom.T_map_odom
        at = in_odom.stamp_s, in_odom.status, in_odom.T_odom_body, in_odom.covariance
        in_map = self.loops.update_evidence(*at, T_map_odom)
        decided = decide([in_map], PoseDecision(in_odom.status))
        is_known = in_odom.status in (Status.TRACKING, Status.COASTING)
        status = decided.status if is_known else in_odom.status
        return replace(in_odom, status=status, covariance_map=decided.covariance_map)

    def _begin_submap(self, loops: LoopClosureClient, frame: RgbdFrame, lost: CameraEstimate) -> CameraEstimate:
        """Begin a submap at a frame that shows nothing known.

        In odom the camera stays at its last pose. The covariance grows by the motion that is possible meanwhile.
        """
        last = self._last
        if last is None or last.T_odom_body is None or last.covariance is None:
            return lost
        seconds = frame.stamp_s - last.stamp_s
        sigma_m, sigma_rad = _CARRIED_M_S * seconds, min(_CARRIED_RAD_S * seconds, _MOST_RAD)
        Ad = se3.adjoint(last.T_odom_body)
        C_odom = last.covariance + np.asarray(Ad @ np.diag(np.square([sigma_m] * 3 + [sigma_rad] * 3)) @ Ad.T)
        T_map_camera = loops.camera_in_new_submap(se3.invert(self.T_odom_map) @ last.T_odom_body)
        T_odom_map = se3.nearest(last.T_odom_body @ se3.invert(T_map_camera))
        Ad = se3.adjoint(se3.invert(T_odom_map))
        found = self.odometry.restart(frame, T_map_camera, Ad @ C_odom @ Ad.T)
        if found.keyframe is None:
            return lost
        loops.begin_submap(found.keyframe)
        self.T_odom_map = T_odom_map
        return found

    def _of_body(self, estimate: Estimate) -> Estimate:
        """Return the camera's estimate as the base's. The left perturbation in the map has the same covariance."""
        self._status = estimate.status
        self.last_matches = estimate.matched if isinstance(estimate, FeatureEstimate) else None
        if isinstance(estimate, DenseEstimate):
            estimate = replace(estimate, frame=None)  # a caller may keep all estimates, but not all frames
        if self._T_camera_base is None:
            return estimate
        if estimate.T_odom_body is None:
            return replace(estimate, body="base")
        T_keyframe_camera, T_camera_base = estimate.T_keyframe_body, self._T_camera_base
        T_keyframe_base = None if T_keyframe_camera is None else T_keyframe_camera @ T_camera_base
        T_odom_base = estimate.T_odom_body @ T_camera_base
        return replace(estimate, T_odom_body=T_odom_base, T_keyframe_body=T_keyframe_base, body="base")


def framed(seen: CameraEstimate, T_odom_map: FloatArray) -> CameraEstimate:
    """Return odometry's estimate in the map, T_map_camera and its covariance, in odom; `T_odom_map` is (4, 4)."""
    T_map_odom = se3.invert(T_odom_map)
    if seen.T_odom_body is None or seen.covariance is None:
        return replace(seen, T_map_odom=T_map_odom)
    Ad = se3.adjoint(T_odom_map)
    T_odom_camera = se3.nearest(T_odom_map @ seen.T_odom_body)
    return replace(seen, T_odom_body=T_odom_camera, covariance=Ad @ seen.covariance @ Ad.T, T_map_odom=T_map_odom)


def is_drift(
    seen: CameraEstimate, motion: MotionEstimate | None, expected: tuple[FloatArray, FloatArray] | None
) -> bool:
    """Return whether `seen.relocation` is drift of the map that ends, rather than an error of the last frames.

    It is drift if the pose before the relocation contradicts the expected motion since an anchor less than the pose
    after it: `motion` since the anchor, and `expected` (4, 4) with its covariance (6, 6). Without one of both, nothing
    contradicts drift.
    """
    if expected is None or motion is None or seen.relocation is None or seen.T_odom_body is None:
        return True
    T_anchor_after, covariance = motion.T_reference_current, motion.covariance
    assert T_anchor_after is not None
    assert covariance is not None
    W = np.linalg.pinv(expected[1] + covariance)
    T_anchor_before = T_anchor_after @ se3.invert(seen.relocation @ seen.T_odom_body) @ seen.T_odom_body
    after, before = (se3.log(T @ se3.invert(expected[0])) for T in (T_anchor_after, T_anchor_before))
    return bool(before @ W @ before <= after @ W @ after)


def mount_of(calibration: Calibration) -> FloatArray:
    """Return T_base_camera (4, 4), made rigid since files round it. Raises CalibrationError if it is not known."""
    if calibration.T_base_camera is None:
        problem = f"the calibration ({calibration.source}) does not say where the camera sits on the base"
        raise CalibrationError(problem, fix="wheelsight calibrate base finds T_base_camera; or --fusion none")
    return se3.nearest(calibration.T_base_camera)


def camera_odometry(
    calibration: Calibration, settings: Config, known: KnownMap | None = None, parts: OwnParts = NO_PARTS
) -> tuple[CameraOdometry, MapBuilder | None]:
    """Return the camera odometry that the settings name, and the builder of a map, if any.

    The map starts at the base if `T_base_camera` is known. A custom visual odometry replaces dense and feature
    odometry. In an existing map the camera starts at the given prior, or apart from the map without one. With wheels,
    frames are aligned with keyframes only (docs/decisions/filter.md).
    """
    store, T_map_first = (
        (None, calibration.T_base_camera) if known is None else (known.store, begin_in(known, calibration))
    )
    if parts.visual_odometry is not None:
        own = (parts.visual_odometry, calibration, settings.features)
        return OwnOdometry(*own, T_map_first=T_map_first, store=store), None
    if settings.map == "surfels":
        dense = DenseOdometry(calibration, settings.dense, T_map_first=T_map_first, store=store)
        mapper = MapBuilder(dense, calibration, settings.surfels)
        mapper.track_map(settings.fusion.filter != "default")
        return dense, mapper
    if "dense" in settings.odometry:
        return DenseOdometry(calibration, settings.dense, T_map_first=T_map_first, store=store), None
    return FeatureOdometry(calibration, settings.features, T_map_first=T_map_first, store=store), None
