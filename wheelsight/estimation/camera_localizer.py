"""Localization by the camera: odometry alone or beside a filter, the gate for frames, and the surfel map of the run."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from wheelsight.config import Config
from wheelsight.core.calibration import Calibration
from wheelsight.core.checks import Repeats
from wheelsight.core.clocks import Untimed
from wheelsight.core.errors import CalibrationError
from wheelsight.core.estimates import CameraEstimate, Estimate, FusedEstimate, Reason, Status
from wheelsight.core.geometry import FloatArray, se3, so3
from wheelsight.core.geometry import motion_kernels as motions
from wheelsight.core.keyframes import KeyframeId
from wheelsight.core.messages import Event, RgbdFrame, SkippedFrame
from wheelsight.core.settings import FrameGateSettings
from wheelsight.estimation.loop_updates import LoopsBeside, begin_in, loops_beside
from wheelsight.estimation.odometry_choice import NO_PARTS, OwnParts
from wheelsight.mapping import FusedFrame, SurfelMap, SurfelSettings
from wheelsight.slam.place_recognition import KnownMap
from wheelsight.slam.settings import PieceSettings
from wheelsight.vision.dense import DenseEstimate, DenseOdometry
from wheelsight.vision.features import FeatureEstimate, FeatureOdometry, MatchedPixels
from wheelsight.vision.visual_odometry import OwnOdometry

# ByFrames: frames answered by feature odometry, or by dense odometry.


class ByFrames:
    """Frames answered by the odometry that the settings name, told of the base where it is known.

    Attributes:
        last_matches: the pixels that the last frame was found by; None where there are none.
        loops: closes loops while driving, where that is asked for.
        T_odom_map: (4, 4) where the map lies, which loops have moved the camera in.
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
        self.frame = "map" if known is None else "odom"  # in a map of before, odom begins anywhere
        self.body = "camera" if calibration.T_base_camera is None else "base"
        self.odometry, self.mapper = camera_odometry(calibration, settings, known, parts)
        T_base_camera = calibration.T_base_camera
        self._T_camera_base = None if T_base_camera is None else se3.invert(T_base_camera)
        self._gate = FrameGate(settings.localizer.frame_gate)
        self.hears: tuple[type[Event], ...] = self.answers
        self._status = Status.INITIALIZING
        self.last_matches: MatchedPixels | None = None
        detector = parts.loop_detector
        self.loops = loops_beside(self.odometry.store, calibration, settings, known, waits=waits, detector=detector)
        self.T_odom_map: FloatArray = np.eye(4)
        if known is not None:
            T_odom_camera = np.eye(4) if T_base_camera is None else T_base_camera
            self.T_odom_map = se3.nearest(
                T_odom_camera @ se3.invert(begin_in(known, calibration, settings.loops.pieces))
            )
        self._keyframe: KeyframeId | None = None
        self._last: CameraEstimate | None = None  # that had a pose, in odom
        self._pieces = settings.loops.pieces

    @property
    def stage_seconds(self) -> dict[str, float]:
        """How long each stage of the last frame took."""
        return self.odometry.stage_seconds

    def process(self, event: Event) -> tuple[Estimate | None, str]:
        """The estimate at a frame, None at any other event, and what was wrong with a frame that cannot be used."""
        if isinstance(event, SkippedFrame):
            return self._failed(event.stamp_s, event.reason)
        if not isinstance(event, RgbdFrame):
            return None, ""
        why_not = self._gate.why_not(event)
        if why_not is None:
            return self._of_body(self._tracked(event)), ""
        if why_not.is_repeat:
            return self._repeated(event.stamp_s), why_not.note
        return self._failed(event.stamp_s, why_not.note)

    def refuse(self, event: Event, why: Untimed) -> tuple[Estimate, str]:
        """The answer to a frame whose stamp means nothing."""
        return self._failed(event.stamp_s, why.note)

    def _failed(self, stamp_s: float, why: str) -> tuple[Estimate, str]:
        return self._of_body(self.odometry.miss(stamp_s)), why

    def _tracked(self, frame: RgbdFrame) -> CameraEstimate:
        """The camera's pose at a frame; the map learns where all of its motion was seen."""
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
            self.loops.hang_on(estimate, self.T_odom_map, in_odom.covariance)
            self.loops.keep(frame.stamp_s, self.T_odom_map, in_odom.covariance)
            self.loops.hand_over()
        self._last = self._last if in_odom.T_odom_body is None else in_odom
        return self.loops.called(in_odom)

    def _begin_piece(self, loops: LoopsBeside, frame: RgbdFrame, lost: CameraEstimate) -> CameraEstimate:
        """The answer at a frame that shows nothing known, at which another piece of map begins.

        In odom the camera stays where it was seen last, less certain by where it may be by now.
        """
        last = self._last
        if last is None or last.T_odom_body is None or last.covariance is None:
            return lost
        C_odom = last.covariance + carried_off(last.T_odom_body, frame.stamp_s - last.stamp_s, self._pieces)
        T_map_camera = loops.apart(se3.invert(self.T_odom_map) @ last.T_odom_body)
        T_odom_map = se3.nearest(last.T_odom_body @ se3.invert(T_map_camera))
        Ad = se3.adjoint(se3.invert(T_odom_map))
        found = self.odometry.restart(frame, T_map_camera, Ad @ C_odom @ Ad.T)
        if found.keyframe is None:
            return lost
        loops.begin_piece(found.keyframe)
        self.T_odom_map = T_odom_map
        return found

    def _repeated(self, stamp_s: float) -> Estimate:
        """The answer to an image that has come before: no pose, and odometry goes on as if it had not come."""
        status = Status.FAILING if self._status is Status.TRACKING else self._status
        return Estimate(stamp_s, status, reason=Reason.REPEATED, body=self.body)

    def _of_body(self, estimate: Estimate) -> Estimate:
        """The camera's estimate as the base's; the covariance, of a perturbation in the map, is that of both."""
        self._status = estimate.status
        self.last_matches = estimate.matched if isinstance(estimate, FeatureEstimate) else None
        if isinstance(estimate, DenseEstimate):
            estimate = replace(estimate, frame=None)  # whoever gets it may keep all estimates, but not all frames
        if self._T_camera_base is None:
            return estimate
        if estimate.T_odom_body is None:
            return replace(estimate, body="base")
        T_keyframe_camera, T_camera_base = estimate.T_keyframe_body, self._T_camera_base
        T_keyframe_base = None if T_keyframe_camera is None else T_keyframe_camera @ T_camera_base
        T_odom_base = estimate.T_odom_body @ T_camera_base
        return replace(estimate, T_odom_body=T_odom_base, T_keyframe_body=T_keyframe_base, body="base")


def carried_off(T_odom_camera: FloatArray, seconds: float, settings: PieceSettings) -> FloatArray:
    """Covariance (6, 6) that a pose gains while nobody saw where the camera was carried."""
    sigma_m = settings.speed_m_s * seconds
    sigma_rad = min(settings.turn_rad_s * seconds, settings.most_rad)
    Ad = se3.adjoint(T_odom_camera)
    return np.asarray(Ad @ np.diag(np.square([sigma_m] * 3 + [sigma_rad] * 3)) @ Ad.T)


def framed(seen: CameraEstimate, T_odom_map: FloatArray) -> CameraEstimate:
    """What odometry answers in the map, T_map_camera and its covariance, in odom, from where the map lies (4, 4)."""
    T_map_odom = se3.invert(T_odom_map)
    if seen.T_odom_body is None or seen.covariance is None:
        return replace(seen, T_map_odom=T_map_odom)
    Ad = se3.adjoint(T_odom_map)
    T_odom_camera = se3.nearest(T_odom_map @ seen.T_odom_body)
    return replace(seen, T_odom_body=T_odom_camera, covariance=Ad @ seen.covariance @ Ad.T, T_map_odom=T_map_odom)


# The camera odometry that the settings name, and where the camera sits.


CameraOdometry = FeatureOdometry | DenseOdometry | OwnOdometry


def mount_of(calibration: Calibration) -> FloatArray:
    """T_base_camera (4, 4), made rigid, since files have few digits. Raises CalibrationError where it is not known."""
    if calibration.T_base_camera is None:
        problem = f"the calibration ({calibration.source}) does not say where the camera sits on the base"
        raise CalibrationError(problem, fix="wheelsight calibrate base finds T_base_camera; or --fusion none")
    return se3.nearest(calibration.T_base_camera)


def camera_odometry(
    calibration: Calibration, settings: Config, known: KnownMap | None = None, parts: OwnParts = NO_PARTS
) -> tuple[CameraOdometry, MapBuilder | None]:
    """The camera's odometry, whose map begins where the base was where that is known; and what builds a map.

    A user's own takes the place of dense and feature odometry. In a map of before it begins where somebody says, or
    apart from it where nobody does. Beside wheels, frames are aligned with keyframes alone: docs/decisions/0061.
    """
    store, T_map_first = (
        (None, calibration.T_base_camera)
        if known is None
        else (known.store, begin_in(known, calibration, settings.loops.pieces))
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


# FusedCamera: camera odometry beside a filter, which tells it what to expect.


BLIND = (Reason.TOO_LITTLE_DEPTH, Reason.FRAME_UNUSABLE, Reason.TOO_FEW_KEYPOINTS)


class FusedCamera:
    """See the module.

    Attributes:
        odometry: the camera's.
        mapper: builds a map, where one is asked for.
        gate: which frames are worth being aligned.
        unknown: so many frames in a row showed nothing known.
        last_matches: what the last frame was aligned by; dense odometry matches no pixels.
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
        self._settings = settings.fusion.joining
        self.gate = FrameGate(settings.localizer.frame_gate)
        self.unknown = 0
        self.last_matches: MatchedPixels | None = None
        self._Ad_camera_base = motions.inverse_adjoint(T_base_camera)
        self._pace = Pace(settings.localizer.pace_s)
        self._slips = False

    @property
    def is_lost(self) -> bool:
        """Whether so many frames showed nothing known that the camera had better start again."""
        return self.unknown >= self._settings.restart_after

    def another(self) -> CameraOdometry:
        """Odometry of the same camera that knows nothing yet."""
        return camera_odometry(*self._of)[0]

    def forget_frame(self) -> None:
        """The last frame is over."""
        self.last_matches = None

    def twist(self, answer: FusedEstimate) -> FloatArray | None:
        """The camera's velocity (6,) in its own frame, by the wheels; None where they slip or tell nothing."""
        if self._slips or answer.twist is None:
            return None
        return np.asarray(self._Ad_camera_base @ np.array([*answer.twist[:2], 0.0, 0.0, 0.0, answer.twist[2]]))

    def process(
        self, frame: RgbdFrame, by_wheels: FloatArray | None, twist: FloatArray | None, *, ask_wheels: bool
    ) -> CameraEstimate:
        """T_map_camera at a frame, where `by_wheels` (4, 4) is its motion since the last one, if they may be asked."""
        expected = self._expected(frame.stamp_s, by_wheels) if ask_wheels else (None,)
        seen = self.odometry.process(frame, *expected, twist=twist)
        self.last_matches = seen.matched if isinstance(seen, FeatureEstimate) else None
        if seen.T_odom_body is not None:
            self._pace.tell(frame.stamp_s, seen.T_odom_body)
        return seen

    def begin_at(self, T_map_camera: FloatArray) -> None:
        """Where the camera is (4, 4), if the next frame is the first one that shows enough."""
        self.odometry.begin_at(T_map_camera)

    def moved(self, T_new_old: FloatArray) -> None:
        """Loops have moved the map by (4, 4), from the left, where the camera is."""
        self._pace.moved(T_new_old)

    def restart(self, frame: RgbdFrame, T_map_camera: FloatArray, covariance: FloatArray) -> CameraEstimate:
        """T_map_camera at a frame that shows nothing known, from which the camera goes on where others have it."""
        self.unknown = 0
        return self.odometry.restart(frame, T_map_camera, covariance)

    def miss(self, seen: Estimate) -> bool:
        """Take a frame that gave no pose; whether it showed anything, which then is nothing known."""
        if seen.reason in BLIND:
            return False
        self.unknown += 1
        return True

    def lead(self, answer: FusedEstimate) -> None:
        """Who is asked what to expect of the next frame: the wheels or, where these slip, the last motion.

        What slips expects what is not so.
        """
        self._slips = answer.slip

    def _expected(self, stamp_s: float, by_wheels: FloatArray | None) -> tuple[FloatArray | None, ...]:
        """The camera's motion since the last frame; and what it may be instead, for wheels that slip may grip again."""
        if not self._slips:
            return (by_wheels,)
        by_pace = self._pace.expect(stamp_s)
        return (by_pace, by_wheels) if isinstance(self.odometry, DenseOdometry) else (by_pace,)


class Pace:
    """Where a camera would be that goes on as it went last, for when the wheels cannot be asked.

    Args:
        longest_step_s: over a longer gap the velocity is unknown.
    """

    def __init__(self, longest_step_s: float) -> None:
        self.longest_step_s = longest_step_s
        self._before: tuple[float, FloatArray] | None = None
        self._last: tuple[float, FloatArray] | None = None

    def tell(self, stamp_s: float, T_map_camera: FloatArray) -> None:
        """A tracked frame's pose (4, 4)."""
        self._before, self._last = self._last, (stamp_s, T_map_camera)

    def moved(self, T_new_old: FloatArray) -> None:
        """The map has moved by (4, 4), from the left."""
        self._before, self._last = (told and (told[0], T_new_old @ told[1]) for told in (self._before, self._last))

    def expect(self, stamp_s: float) -> FloatArray | None:
        """T_last_current (4, 4) at constant velocity; None where that is unknown or too long ago."""
        if self._before is None or self._last is None:
            return None
        seconds, since_s = self._last[0] - self._before[0], stamp_s - self._last[0]
        if not (0 < seconds <= self.longest_step_s and 0 < since_s <= self.longest_step_s):
            return None
        return se3.exp(se3.log(se3.invert(self._before[1]) @ self._last[1]) * (since_s / seconds))


# FrameGate: which frames are worth being aligned.


@dataclass(frozen=True, slots=True)
class Refusal:
    """Why a frame need not be aligned.

    Attributes:
        note: for a user.
        is_repeat: whether all that is wrong is that its image has come before: no measurement, but no failure either.
    """

    note: str
    is_repeat: bool = False


class FrameGate:
    """Refuses frames whose image came before, and has them wait for the wheels.

    Args:
        settings: of None, the defaults.

    Attributes:
        wheels_are_heard: whether any reading has come.
    """

    def __init__(self, settings: FrameGateSettings | None = None) -> None:
        self.settings = settings or FrameGateSettings()
        self.wheels_are_heard = False
        self._first_s = math.inf
        self._repeats = Repeats()

    def why_not(self, frame: RgbdFrame, T_last_frame: FloatArray | None = None) -> Refusal | None:
        """What is wrong with a frame, if anything.

        Args:
            T_last_frame: (4, 4) how wheels say that the camera has moved since the last frame that was tracked.
        """
        lasting_s, hangs_s = self._repeats.lasting_s(frame), self.settings.hangs_s
        if lasting_s == 0 or (T_last_frame is not None and not self._has_moved(T_last_frame)):
            return None  # of a robot that stands, by its wheels, a camera without noise gives the same for as long
        if lasting_s <= hangs_s:
            return Refusal("the same image as before", is_repeat=True)
        return Refusal(f"the camera hangs: the same image for over {hangs_s:g} s")

    def waits_for_wheels(self, frame: RgbdFrame) -> bool:
        """Whether it is too soon to go without them."""
        self._first_s = min(self._first_s, frame.stamp_s)
        return not self.wheels_are_heard and frame.stamp_s - self._first_s < self.settings.wait_s

    def _has_moved(self, T_last_frame: FloatArray) -> bool:
        way_m, turn_rad = np.linalg.norm(T_last_frame[:3, 3]), so3.angle(T_last_frame[:3, :3])
        return bool(way_m > self.settings.moved_m or turn_rad > self.settings.moved_rad)


# MapBuilder: the surfel map of a run, made of frames that an odometry has tracked.


class MapBuilder:
    """Averages tracked frames into a surfel map; of frames that hardly move, one in a tenth of a second.

    Args:
        odometry: tracks the frames, sees surfaces, and keeps the keyframes that surfels hang on.
        calibration: tells the noise of depth.
        settings: of the map.

    Attributes:
        map: what was seen so far.
    """

    def __init__(
        self, odometry: DenseOdometry, calibration: Calibration, settings: SurfelSettings | None = None
    ) -> None:
        self.map = SurfelMap(settings, odometry.store)
        self._odometry = odometry
        self._thinning = Thinning(self.map.settings)
        self._noise = calibration.depth_noise

    def fuse_tracked(self, frame: RgbdFrame, seen: DenseEstimate) -> FusedFrame | None:
        """Fuse a frame where odometry has seen it, T_map_camera; None if it is left out, or has no pose."""
        T_map_camera, odometry = seen.T_odom_body, self._odometry
        if seen.frame is None or T_map_camera is None:
            return None
        frames = self._thinning.count(T_map_camera, frame.stamp_s)  # with those before it that were left out
        if not frames:
            return None
        with odometry.watch.stage("fuse"):
            with_color = self.map.frames % self.map.settings.colored_every == 0
            surface = odometry.surface(seen.frame, frame, with_color)
            how = (self._noise, frames, seen.keyframe)
            return self.map.fuse(surface, odometry.intrinsics, T_map_camera, frame.stamp_s, *how)

    def track_map(self, tracks: bool) -> None:
        """From now on odometry aligns frames with what the map predicts, or with keyframes."""
        self._odometry.refer_to(self.map if tracks else None)


class Thinning:
    """Remembers the last frame that was fused, and counts those left out since.

    A frame from the same place shows the same pixels with the same errors of the sensor: it costs as much as one from
    elsewhere, and teaches less.
    """

    def __init__(self, settings: SurfelSettings) -> None:
        self._settings = settings
        self._T_map_last: FloatArray | None = None
        self._last_s, self._left_out = -np.inf, 0

    def count(self, T_map_camera: FloatArray, stamp_s: float) -> int:
        """As how many frames one at a pose (4, 4) is to be fused, with those left out before; 0 to leave it out too."""
        if self._T_map_last is not None and stamp_s - self._last_s < self._settings.fused_after_s:
            shift_m = se3.view_shift_m(se3.invert(self._T_map_last) @ T_map_camera)
            if shift_m < self._settings.fused_way_m:
                self._left_out += 1
                return 0
        frames, self._left_out = self._left_out + 1, 0
        self._T_map_last, self._last_s = T_map_camera, stamp_s
        return frames
