"""Localization by the camera alone (`ByFrames`), and the camera of a filter (`FusedCamera`).

`FrameGate` rejects frames that need no alignment. `MapBuilder` fuses tracked frames into a surfel map.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from wheelsight.config import Config
from wheelsight.core.calibration import Calibration
from wheelsight.core.checks import Repeats, Untimed
from wheelsight.core.errors import CalibrationError
from wheelsight.core.estimates import CameraEstimate, Estimate, FusedEstimate, Reason, Status
from wheelsight.core.geometry import FloatArray, se3, so3
from wheelsight.core.geometry import motion_kernels as motions
from wheelsight.core.keyframes import KeyframeId
from wheelsight.core.messages import Event, RgbdFrame, SkippedFrame
from wheelsight.estimation.loop_updates import LoopsBeside, begin_in, loops_beside
from wheelsight.estimation.odometry_choice import NO_PARTS, OwnParts
from wheelsight.mapping import FusedFrame, SurfelMap, SurfelSettings
from wheelsight.slam.place_recognition import KnownMap
from wheelsight.vision.dense import DenseEstimate, DenseOdometry
from wheelsight.vision.features import FeatureEstimate, FeatureOdometry, MatchedPixels
from wheelsight.vision.visual_odometry import OwnOdometry

CameraOdometry = FeatureOdometry | DenseOdometry | OwnOdometry

# Frames in a row that show nothing known, after which the camera continues from the pose of the wheels.
RESTART_AFTER = 5
# Over a longer gap the mean velocity says little of that at the frame (simulator).
_LONGEST_STEP_S = 0.35
_WAIT_S = 1.0  # at the start, for wheels: their first reading begins the filter
_HANGS_S = 1.0  # of one image; some cameras are logged at a multiple of their rate
# A robot that moves less from frame to frame stands: one that creeps at 2 cm/s moves more.
_MOVED_M, _MOVED_RAD = 0.0005, 0.0005
# Reasons of frames that show nothing at all, rather than something unknown.
BLIND = (Reason.TOO_LITTLE_DEPTH, Reason.FRAME_UNUSABLE, Reason.TOO_FEW_KEYPOINTS)
# Standard deviations of the speed and turn rate of a camera that sees nothing, as when carried; chosen. The largest one
# of a heading, radians; that of any heading is 1.8.
_CARRIED_M_S, _CARRIED_RAD_S, _MOST_RAD = 1.0, 1.0, 2.0


class ByFrames:
    """Answers frames by the odometry that the settings name. Poses are of the base if `T_base_camera` is known.

    Attributes:
        last_matches: pixels by which the last frame was aligned; None if there are none.
        loops: closes loops while driving, if the settings ask for it.
        T_odom_map: (4, 4) pose of the map, in which loops move the camera.
    """

    answers = (RgbdFrame, SkippedFrame)

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
        T_base_camera = calibration.T_base_camera
        self._T_camera_base = None if T_base_camera is None else se3.invert(T_base_camera)
        self._gate = FrameGate()
        self.hears: tuple[type[Event], ...] = self.answers
        self._status = Status.INITIALIZING
        self.last_matches: MatchedPixels | None = None
        detector = parts.loop_detector
        self.loops = loops_beside(self.odometry.store, calibration, settings, known, waits=waits, detector=detector)
        self.T_odom_map: FloatArray = np.eye(4)
        if known is not None:
            T_odom_camera = np.eye(4) if T_base_camera is None else T_base_camera
            self.T_odom_map = se3.nearest(T_odom_camera @ se3.invert(begin_in(known, calibration)))
        self._keyframe: KeyframeId | None = None
        self._last: CameraEstimate | None = None  # the last one with a pose, in odom

    def process(self, event: Event) -> tuple[Estimate | None, str]:
        """Return the estimate at a frame, None at any other event, and why a frame cannot be used."""
        if isinstance(event, SkippedFrame):
            return self._failed(event.stamp_s, event.reason)
        if not isinstance(event, RgbdFrame):
            return None, ""
        why_not = self._gate.why_not(event)
        if why_not is None:
            return self._of_body(self._track(event)), ""
        if why_not.is_repeat:  # no pose, and no failure of odometry
            status = Status.FAILING if self._status is Status.TRACKING else self._status
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
        estimate: CameraEstimate = self.odometry.process(frame)
        if self.loops is not None and estimate.status is Status.LOST and estimate.reason not in BLIND:
            estimate = self._begin_piece(self.loops, frame, estimate)
        self._keyframe = self._keyframe if estimate.keyframe is None else estimate.keyframe
        if self.mapper is not None and isinstance(estimate, DenseEstimate) and estimate.shows_all:
            self.mapper.fuse_tracked(frame, estimate)
        if self.loops is None:
            return estimate
        in_odom = framed(estimate, self.T_odom_map)
        if in_odom.covariance is not None:
            self.loops.add_tracked(estimate, self.T_odom_map, in_odom.covariance)
            self.loops.keep(frame.stamp_s, self.T_odom_map, in_odom.covariance)
            self.loops.hand_over()
        self._last = self._last if in_odom.T_odom_body is None else in_odom
        T_map_odom = in_odom.T_map_odom
        in_map, C = self.loops.evidence(in_odom.status, in_odom.T_odom_body, in_odom.covariance, T_map_odom)
        is_known = in_odom.status in (Status.TRACKING, Status.COASTING)
        status = in_odom.status if in_map.value is None or not is_known else in_map.value
        return replace(in_odom, status=status, covariance_map=C)

    def _begin_piece(self, loops: LoopsBeside, frame: RgbdFrame, lost: CameraEstimate) -> CameraEstimate:
        """Begin a separate piece of map at a frame that shows nothing known.

        In odom the camera stays at its last pose. The covariance grows by the motion that is possible meanwhile.
        """
        last = self._last
        if last is None or last.T_odom_body is None or last.covariance is None:
            return lost
        seconds = frame.stamp_s - last.stamp_s
        sigma_m, sigma_rad = _CARRIED_M_S * seconds, min(_CARRIED_RAD_S * seconds, _MOST_RAD)
        Ad = se3.adjoint(last.T_odom_body)
        C_odom = last.covariance + np.asarray(Ad @ np.diag(np.square([sigma_m] * 3 + [sigma_rad] * 3)) @ Ad.T)
        T_map_camera = loops.apart(se3.invert(self.T_odom_map) @ last.T_odom_body)
        T_odom_map = se3.nearest(last.T_odom_body @ se3.invert(T_map_camera))
        Ad = se3.adjoint(se3.invert(T_odom_map))
        found = self.odometry.restart(frame, T_map_camera, Ad @ C_odom @ Ad.T)
        if found.keyframe is None:
            return lost
        loops.begin_piece(found.keyframe)
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

    @property
    def stage_seconds(self) -> dict[str, float]:
        """Duration of each stage of the last frame."""
        return self.odometry.stage_seconds


def framed(seen: CameraEstimate, T_odom_map: FloatArray) -> CameraEstimate:
    """Return odometry's estimate in the map, T_map_camera and its covariance, in odom; `T_odom_map` is (4, 4)."""
    T_map_odom = se3.invert(T_odom_map)
    if seen.T_odom_body is None or seen.covariance is None:
        return replace(seen, T_map_odom=T_map_odom)
    Ad = se3.adjoint(T_odom_map)
    T_odom_camera = se3.nearest(T_odom_map @ seen.T_odom_body)
    return replace(seen, T_odom_body=T_odom_camera, covariance=Ad @ seen.covariance @ Ad.T, T_map_odom=T_map_odom)


class FusedCamera:
    """Camera odometry of a filter, which predicts the camera's motion.

    Attributes:
        odometry: of the camera.
        mapper: builds a surfel map, if the settings ask for one.
        gate: rejects frames that need no alignment.
        unknown: number of frames in a row that showed nothing known.
        last_matches: pixels by which the last frame was aligned; None for dense odometry.
        slips: whether the wheels slip. Then the camera's last motion predicts the next frame, else the wheels do.
        pace: the camera's last motion.
    """

    def __init__(
        self,
        calibration: Calibration,
        settings: Config,
        T_base_camera: FloatArray,
        known: KnownMap | None = None,
        parts: OwnParts = NO_PARTS,
    ) -> None:
        self.odometry, self.mapper = camera_odometry(calibration, settings, known, parts)
        self._of = calibration, settings, None, parts
        self.gate = FrameGate()
        self.unknown = 0
        self.last_matches: MatchedPixels | None = None
        self._Ad_camera_base = motions.inverse_adjoint(T_base_camera)
        self.pace, self.slips = Pace(), False

    def process(
        self, frame: RgbdFrame, by_wheels: FloatArray | None, twist: FloatArray | None, *, ask_wheels: bool
    ) -> CameraEstimate:
        """Return T_map_camera at a frame.

        Args:
            frame: to align.
            by_wheels: (4, 4) motion of the camera since the last frame, by the wheels.
            twist: (6,) velocity of the camera in its own frame; see `twist`.
            ask_wheels: whether `by_wheels` may be the initial estimate.
        """
        expected: tuple[FloatArray | None, ...] = (None,)
        if ask_wheels:
            expected = (by_wheels,)
            if self.slips:  # the camera may go on as before, or the wheels may grip again
                by_pace = self.pace.expect(frame.stamp_s)
                expected = (by_pace, by_wheels) if isinstance(self.odometry, DenseOdometry) else (by_pace,)
        seen = self.odometry.process(frame, *expected, twist=twist)
        self.last_matches = seen.matched if isinstance(seen, FeatureEstimate) else None
        if seen.T_odom_body is not None:
            self.pace.add(frame.stamp_s, seen.T_odom_body)
        return seen

    def twist(self, answer: FusedEstimate) -> FloatArray | None:
        """Return the camera's velocity (6,) in its own frame, by the wheels; None if they slip or give none."""
        if self.slips or answer.twist is None:
            return None
        return np.asarray(self._Ad_camera_base @ np.array([*answer.twist[:2], 0.0, 0.0, 0.0, answer.twist[2]]))

    def restart(self, frame: RgbdFrame, T_map_camera: FloatArray, covariance: FloatArray) -> CameraEstimate:
        """Restart odometry at a frame that shows nothing known, at a given pose (4, 4); return T_map_camera."""
        self.unknown = 0
        return self.odometry.restart(frame, T_map_camera, covariance)

    def miss(self, seen: Estimate) -> bool:
        """Add a frame without a pose; return whether it showed anything, which then is unknown."""
        if seen.reason in BLIND:
            return False
        self.unknown += 1
        return True

    def another(self) -> CameraOdometry:
        """Return new odometry of the same camera, without keyframes."""
        return camera_odometry(*self._of)[0]


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


class Pace:
    """Predicts the camera's motion at constant velocity, for when the wheels slip."""

    def __init__(self) -> None:
        self._before: tuple[float, FloatArray] | None = None
        self._last: tuple[float, FloatArray] | None = None

    def add(self, stamp_s: float, T_map_camera: FloatArray) -> None:
        """Add the pose (4, 4) of a tracked frame."""
        self._before, self._last = self._last, (stamp_s, T_map_camera)

    def moved(self, T_new_old: FloatArray) -> None:
        """Apply a correction (4, 4) of the map, from the left."""
        self._before, self._last = (pose and (pose[0], T_new_old @ pose[1]) for pose in (self._before, self._last))

    def expect(self, stamp_s: float) -> FloatArray | None:
        """Return T_last_current (4, 4) at constant velocity; None if the velocity is unknown or too old."""
        if self._before is None or self._last is None:
            return None
        seconds, since_s = self._last[0] - self._before[0], stamp_s - self._last[0]
        if not (0 < seconds <= _LONGEST_STEP_S and 0 < since_s <= _LONGEST_STEP_S):
            return None
        return se3.exp(se3.log(se3.invert(self._before[1]) @ self._last[1]) * (since_s / seconds))


@dataclass(frozen=True, slots=True)
class FrameRefusal:
    """Why a frame is not aligned.

    Attributes:
        note: for a user.
        is_repeat: whether the image only repeats a previous one: neither a measurement nor a failure.
    """

    note: str
    is_repeat: bool = False


class FrameGate:
    """Rejects frames that repeat an image, and delays the first frames until wheel readings arrive.

    Attributes:
        has_wheels: whether any wheel reading has arrived.
    """

    def __init__(self) -> None:
        self.has_wheels = False
        self._first_s = math.inf
        self._repeats = Repeats()

    def why_not(self, frame: RgbdFrame, T_last_frame: FloatArray | None = None) -> FrameRefusal | None:
        """Return why a frame is rejected, or None.

        Args:
            frame: to check.
            T_last_frame: (4, 4) motion of the camera since the last tracked frame, by the wheels.
        """
        lasting_s = self._repeats.lasting_s(frame)
        if lasting_s == 0:
            return None
        if T_last_frame is not None:
            way_m, turn_rad = np.linalg.norm(T_last_frame[:3, 3]), so3.angle(T_last_frame[:3, :3])
            if not (way_m > _MOVED_M or turn_rad > _MOVED_RAD):
                return None  # the robot stands: a camera without noise repeats its image
        if lasting_s <= _HANGS_S:
            return FrameRefusal("the same image as before", is_repeat=True)
        return FrameRefusal(f"the camera hangs: the same image for over {_HANGS_S:g} s")

    def waits_for_wheels(self, frame: RgbdFrame) -> bool:
        """Whether a frame is too early to go without wheel readings."""
        self._first_s = min(self._first_s, frame.stamp_s)
        return not self.has_wheels and frame.stamp_s - self._first_s < _WAIT_S


_COLORED_EVERY = 3  # one fused frame in this many gives colour, for display only, which takes time to load; chosen


class MapBuilder:
    """Fuses tracked frames into a surfel map; at most one in a tenth of a second while the camera hardly moves.

    Args:
        odometry: tracks the frames, extracts surfaces, and keeps the keyframes to which surfels are attached.
        calibration: has the noise of depth.
        settings: of the map.

    Attributes:
        map: the surfel map.
    """

    def __init__(
        self, odometry: DenseOdometry, calibration: Calibration, settings: SurfelSettings | None = None
    ) -> None:
        self.map = SurfelMap(settings, odometry.store)
        self._odometry = odometry
        self._thinning = Thinning(self.map.settings)
        self._noise = calibration.depth_noise

    def fuse_tracked(self, frame: RgbdFrame, seen: DenseEstimate) -> FusedFrame | None:
        """Fuse a frame that odometry has tracked, T_map_camera; return None if it is skipped or has no pose."""
        T_map_camera, odometry = seen.T_odom_body, self._odometry
        if seen.frame is None or T_map_camera is None:
            return None
        frames = self._thinning.count(T_map_camera, frame.stamp_s)  # with the skipped ones before it
        if not frames:
            return None
        with odometry.watch.stage("fuse"):
            with_color = self.map.frames % _COLORED_EVERY == 0
            surface = odometry.surface(seen.frame, frame, with_color)
            how = (self._noise, frames, seen.keyframe)
            return self.map.fuse(surface, odometry.intrinsics, T_map_camera, frame.stamp_s, *how)

    def track_map(self, tracks: bool) -> None:
        """Align further frames with the map's prediction, or with keyframes."""
        self._odometry.refer_to(self.map if tracks else None)


class Thinning:
    """Remembers the last fused frame, and counts the frames skipped since.

    A frame from the same place shows the same pixels with the same sensor errors. It costs as much as one from
    elsewhere and adds less information.
    """

    def __init__(self, settings: SurfelSettings) -> None:
        self._settings = settings
        self._T_map_last: FloatArray | None = None
        self._last_s, self._skipped = -np.inf, 0

    def count(self, T_map_camera: FloatArray, stamp_s: float) -> int:
        """Return the weight, in frames, of one at a pose (4, 4), with those skipped before; 0 to skip it too."""
        if self._T_map_last is not None and stamp_s - self._last_s < self._settings.fused_after_s:
            shift_m = se3.view_shift_m(se3.invert(self._T_map_last) @ T_map_camera)
            if shift_m < self._settings.fused_way_m:
                self._skipped += 1
                return 0
        frames, self._skipped = self._skipped + 1, 0
        self._T_map_last, self._last_s = T_map_camera, stamp_s
        return frames
