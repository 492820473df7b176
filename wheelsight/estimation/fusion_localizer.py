"""ByFusion: localization by wheels, gyroscope and camera with the error-state filter.

The wheels predict the pose and the camera corrects it. `BaseSensors` prepares wheels and gyroscope for the filter.
"""

from __future__ import annotations

import math
from dataclasses import replace

from wheelsight.config import Config
from wheelsight.core.calibration import Calibration
from wheelsight.core.camera_errors import frame_covariance
from wheelsight.core.clocks import Untimed
from wheelsight.core.estimates import (
    CameraEstimate,
    Estimate,
    FusedEstimate,
    MotionEstimate,
    Reason,
    Status,
    WheelEstimate,
)
from wheelsight.core.geometry import FloatArray
from wheelsight.core.geometry import motion_kernels as motions
from wheelsight.core.messages import WHEEL_READINGS, Event, RgbdFrame, SkippedFrame, WheelReading, WheelSpeeds, YawRate
from wheelsight.estimation.area_localizer import Places, PlaceSense
from wheelsight.estimation.camera_localizer import CameraOdometry, FusedCamera, MapBuilder, mount_of
from wheelsight.estimation.camera_map import Anchor, CameraMap, blurred, is_far, strayed
from wheelsight.estimation.consistency_check import BaseCheck, ReadmissionCheck
from wheelsight.estimation.filter import ErrorStateFilter
from wheelsight.estimation.kidnap_detection import KidnapDetection, UncertainRestart
from wheelsight.estimation.loop_updates import LoopsBeside, begin_in, loops_beside
from wheelsight.estimation.odometry_choice import NO_PARTS, OwnParts
from wheelsight.estimation.wheel_localizer import ByWheels, FusedOdom
from wheelsight.places import PlaceMatch
from wheelsight.slam.place_recognition import KnownMap
from wheelsight.vision.dense import DenseEstimate
from wheelsight.vision.extrinsics import Culprit
from wheelsight.vision.features import MatchedPixels
from wheelsight.wheels import ReadingTimes, WheelSettings


class ByFusion:
    """Answers wheel readings and frames by the default filter. Dense odometry builds its map where all sensors agree.

    With places, the map is that of the areas, and the area that a frame shows is one more measurement.

    Attributes:
        filter: fuses the camera with the wheels.
        loops: closes loops while driving, if the settings ask for it.
    """

    body, answers = "base", (*WHEEL_READINGS, RgbdFrame, SkippedFrame)

    def __init__(
        self,
        calibration: Calibration,
        settings: Config,
        places: Places | None = None,
        known: KnownMap | None = None,
        *,
        waits: bool = False,
        parts: OwnParts = NO_PARTS,
    ) -> None:
        self.frame = "map" if known is None else "odom"  # with an existing map, odom starts anywhere in it
        self._settings, of, T_base_camera = settings.fusion.joining, settings.localizer, mount_of(calibration)
        self._base = BaseSensors(calibration, settings.wheels)
        self.hears: tuple[type[Event], ...] = (*self._base.hears, RgbdFrame, SkippedFrame)
        self._camera = FusedCamera(calibration, settings, T_base_camera, known, parts)
        begins = None if known is None else begin_in(known, calibration, settings.loops.pieces)
        self._map, self._of_frame = CameraMap(T_base_camera, begins), frame_covariance(calibration)
        self._has_prior = known is not None and known.start is not None
        self._places = None if places is None else PlaceSense(places, settings.fusion.areas)
        T_start, spread = (None, None) if self._places is None else self._places.start
        filter_settings = settings.fusion.error_state.with_wheels(calibration.any_wheels)
        begin = (T_base_camera, T_start, spread, filter_settings, calibration.gyro)
        self.filter = ErrorStateFilter(*begin)
        checks = (of.base_check, of.color_check, settings.extrinsics)
        self._check = BaseCheck(calibration, T_base_camera, ErrorStateFilter(*begin), *checks)
        self._readmission = ReadmissionCheck(
            lambda: BaseCheck(calibration, T_base_camera, ErrorStateFilter(*begin), *checks),
            self._camera.another,
            self._settings.restart_after,
        )
        detector = parts.loop_detector
        self.loops = loops_beside(self.odometry.store, calibration, settings, known, waits=waits, detector=detector)
        self._kidnap, self._restart = KidnapDetection(self._settings), UncertainRestart(self._settings)
        self._odom = FusedOdom(filter_settings.coast_after_s)

    def process(self, event: Event) -> tuple[Estimate | None, str]:
        """Return the estimate after a wheel reading or frame, None for any other event, and a note on the event."""
        self._camera.forget_frame()
        if isinstance(event, YawRate):  # it counts once the gyroscope agrees with the wheels
            counts = self._base.add_yaw_rate(event)
            if self._base.uses_gyro:
                self._check.add_yaw_rate(event.stamp_s, event.yaw_rate_rad_s)
            if counts and not self._is_early(event.stamp_s):
                self._base.update_filter(event, self.filter)
            return None, ""
        if isinstance(event, WheelReading):
            answer, note = self._update_wheels(event)
        else:
            answer, note = self._update_frame(event)
        if isinstance(answer, FusedEstimate):
            answer = self._map.framed(answer)
        if answer is None:
            return None, note
        answer = answer if self.loops is None else self.loops.with_map_status(answer)
        return self._odom.framed(answer, self.filter, event), note

    def refuse(self, event: Event, why: Untimed) -> tuple[Estimate | None, str]:
        """Return the current estimate for an event with an invalid stamp; None for a yaw rate."""
        self._camera.forget_frame()
        if isinstance(event, YawRate):
            return None, ""
        if isinstance(event, WheelReading) and why.reason is Reason.CLOCKS_APART:
            self._base.problem = f"the wheels are not used: {why.note}"
            self._base.refuse(event)
        known, reason = self._odom.framed(self._map.framed(self.filter.estimate), self.filter), why.reason
        if reason is Reason.CLOCKS_APART and known.status is Status.TRACKING:
            # The base moves unobserved until it is known which clock jumped.
            return replace(known, reason=reason, status=Status.COASTING), why.note
        if isinstance(event, RgbdFrame | SkippedFrame) and reason is not Reason.CLOCKS_APART:
            reason = Reason.FRAME_UNUSABLE
        return replace(known, reason=reason), why.note

    def _update_wheels(self, reading: WheelReading) -> tuple[Estimate | None, str]:
        wheels, note = self._base.process(reading)
        if wheels is not None and self._is_early(wheels.stamp_s):
            return Estimate(wheels.stamp_s, Status.INITIALIZING, body=self.body), note
        self._camera.gate.has_wheels = True
        if wheels is None:
            return None, note
        self._check.add_wheels(wheels)
        if wheels.T_odom_body is not None:
            self._kidnap.add_wheels(wheels.stamp_s, wheels.T_odom_body)
        self._readmission.add_wheels(wheels)
        if self._excludes(Culprit.CAMERA):
            return self.filter.estimate, note
        if self._check.is_without_wheels:
            return self.filter.drop(wheels.stamp_s, ""), note  # the camera's velocity predicts the pose
        answer = self.filter.predict_to(wheels)
        self._base.problem = f"the wheels are not used: {answer.reason}" if answer.reason is Reason.TOO_LATE else ""
        return self._with_checks(answer), note

    def _update_frame(self, event: RgbdFrame | SkippedFrame) -> tuple[Estimate, str]:
        """Return the estimate after a frame, usable or not, and a note on the frame."""
        if self._places is not None:
            self._places.forget()
        if self._is_early(event.stamp_s):
            note = event.reason if isinstance(event, SkippedFrame) else ""
            return Estimate(event.stamp_s, Status.INITIALIZING, body=self.body), note
        if isinstance(event, SkippedFrame):
            return self._miss(event.stamp_s), event.reason
        if self._check.left_out is Culprit.CAMERA:
            return self._without_camera(event), ""
        expected = self.filter.expect_frame(event.stamp_s)
        why_not = self._camera.gate.why_not(event, expected)
        if why_not is not None and why_not.is_repeat:
            return replace(
                self.filter.estimate, reason=Reason.REPEATED
            ), why_not.note  # neither measurement nor failure
        if why_not is not None:
            return self._miss(event.stamp_s), why_not.note
        if self._camera.gate.waits_for_wheels(event):
            return Estimate(event.stamp_s, Status.INITIALIZING, body=self.body), ""
        self._check.add_frame(event)
        answer = self._track(event, expected)
        self._camera.set_slip(answer)
        if self.loops is not None:
            self._update_loops(self.loops, event.stamp_s, answer.covariance)
        return self._with_checks(self._with_area(event, answer)), self._base.problem

    def _track(self, frame: RgbdFrame, expected: FloatArray | None) -> FusedEstimate:
        """Align a frame, then update the filter by the camera's motion since the anchor."""
        self._map.forget_frame()
        self._apply_loops(frame.stamp_s)
        if self._has_prior and self._map.anchor is None:  # the prior is of the first event; the robot may have moved
            self._camera.begin_at(self._map.camera_at(self.filter.when_imaged(frame.stamp_s)))
        twist = self._camera.twist(self.filter.estimate)
        seen = self._camera.process(frame, expected, twist, ask_wheels=not self._check.suspects_wheels)
        if seen.T_odom_body is None:
            return self._lose(frame, seen)
        anchor = self._map.anchor
        if anchor is None:
            return self._begin(frame, seen)
        self._check.add_tracked(frame, seen, shows_all=seen.motion.shows_all)
        if self._excludes(Culprit.WHEELS):
            return self._begin(frame, seen)
        motion = anchor.motion_to(seen.T_odom_body, seen.motion)
        motion = blurred(motion, twist, self._base.noise_s)
        motion = strayed(motion, self._of_frame, self._settings.frame_walk_per_m)
        if frame.stamp_s - self._map.seen_s > self._settings.dark_s and not motion.shows_all:
            return self._lose(frame, replace(seen, reason=Reason.DEGENERATE), restarts=True)
        return self._measure(frame, seen, motion)

    def _apply_loops(self, stamp_s: float) -> None:
        """Move keyframes by the loops found so far. The pose in odom does not change."""
        if self.loops is None:
            return
        self._move_map(self.loops.move_keyframes(stamp_s, self._map.keyframe))
        if self._restart.since is not None and self.loops.tie(self._restart.since):
            self._restart.relocalized()
        if self.loops.is_laid:  # not `is_joined`, which no doubtful answer makes true
            self._kidnap.relocalized()

    def _move_map(self, T_new_old: FloatArray | None) -> None:
        """Apply a correction (4, 4), from the left, of the keyframe by which the camera has its pose in the map."""
        if T_new_old is not None:
            self._map.moved(T_new_old)
            self._camera.moved(T_new_old)
            self._check.moved(T_new_old)

    def _measure(self, frame: RgbdFrame, seen: CameraEstimate, motion: MotionEstimate) -> FusedEstimate:
        """Update the filter by the motion of a tracked frame since the anchor. Accepted frames extend the map."""
        assert seen.T_odom_body is not None
        here = Anchor.at(seen.T_odom_body, seen.motion)
        update = self.filter.update_frame(
            frame.stamp_s, motion, here.covariance, is_far=is_far(motion, self._settings.anchor_way_m)
        )
        answer = update.answer
        if not update.is_believed and self._kidnap.is_in_dark and answer.covariance is not None:
            return self._restart_camera(frame, seen, answer)
        self._camera.unknown = 0
        self._kidnap.add_known_view(frame.stamp_s)
        is_believed = update.is_believed and answer.T_odom_body is not None and answer.status is Status.TRACKING
        self._map.track(frame.stamp_s, is_believed=is_believed)
        if is_believed and self._map.is_left(seen.T_odom_body, update.T_odom_base):
            # The camera jumped: restart it at the pose in its map that the filter has.
            assert update.T_odom_base is not None
            assert answer.covariance is not None
            again = self._camera.restart(frame, self._map.camera_at(update.T_odom_base), answer.covariance)
            return answer if again.T_odom_body is None else self._begin(frame, again)
        if is_believed:
            self._map.accept(frame.stamp_s, seen.T_odom_body, update.T_odom_base)
            self._map.refer(seen)
            if self.loops is not None and answer.covariance is not None:
                against = strayed(seen.motion, self._of_frame, self._settings.frame_walk_per_m)
                self.loops.add_tracked(replace(seen, motion=against), self._map.T_odom_map, answer.covariance)
            self._restart.add_believed(answer, len(self.odometry.store))
            if self.mapper is not None and isinstance(seen, DenseEstimate):
                self.mapper.fuse_tracked(frame, seen)
        if update.is_reference:
            self._map.anchor = here
        return answer

    def _begin(self, frame: RgbdFrame, seen: CameraEstimate, reason: Reason | None = None) -> FusedEstimate:
        """Start the camera at a frame, at the pose that the wheels predict."""
        assert seen.T_odom_body is not None
        self._map.anchor = Anchor.at(seen.T_odom_body, seen.motion)
        update = self.filter.begin_frame(frame.stamp_s, self._map.anchor.covariance)
        self._map.accept(frame.stamp_s, seen.T_odom_body, update.T_odom_base)
        self._map.refer(seen)
        self._kidnap.add_known_view(frame.stamp_s)
        self._check.begin(frame, seen, self._map.T_odom_map)
        reason = reason or update.answer.reason
        return replace(update.answer, reason=reason, matches=seen.matches, inliers=seen.inliers)

    def _lose(self, frame: RgbdFrame, seen: CameraEstimate, *, restarts: bool = False) -> FusedEstimate:
        """Return the wheels' pose at a frame that was not tracked.

        The camera restarts there with `restarts`, or after several frames that show nothing known.
        """
        nothing = MotionEstimate.failed(seen.reason or Reason.INVALID, seen.matches, seen.inliers)
        answer = self.filter.miss_frame(frame.stamp_s, nothing)
        expected = self.filter.expect_frame(frame.stamp_s)
        if self._camera.miss(seen) and self._camera.unknown == 1 and answer.T_odom_body is not None:
            # The view changed: if the wheels stood meanwhile, the robot may have been moved.
            self._kidnap.add_unknown_view(frame.stamp_s, expected, answer.T_odom_body)
        is_lost = self._camera.is_lost and not self._kidnap.waits(expected)
        if (restarts or is_lost) and answer.covariance is not None:
            return self._restart_camera(frame, seen, answer)
        return answer

    def _restart_camera(self, frame: RgbdFrame, seen: CameraEstimate, wheels: FusedEstimate) -> FusedEstimate:
        """Restart the camera, at a frame that shows nothing known, at the pose that the wheels predict.

        After a kidnapping the pose is unknown: the camera begins a piece of map that loops have to join to the rest.
        """
        assert wheels.covariance is not None
        T_odom_base = self.filter.when_imaged(frame.stamp_s)
        spread_m = self.filter.spread_since_frame_m(frame.stamp_s)
        if self._kidnap.is_kidnapped:
            spread = self._kidnap.inflate(T_odom_base, wheels.covariance)
            self._replace_filter(self.filter.begun_at(T_odom_base, spread))
        first = len(self.odometry.store)
        T_map_camera = self._map.camera_at(T_odom_base)
        if self.loops is None or not self._kidnap.is_kidnapped:
            again = self._camera.restart(frame, T_map_camera, wheels.covariance)
        else:
            again = self._camera.restart(frame, self.loops.apart(T_map_camera), wheels.covariance)
            if again.keyframe is not None:
                self.loops.begin_piece(again.keyframe)
                self._kidnap.begin_piece()
        if again.T_odom_body is None:
            return wheels
        self._restart.begin(spread_m, first)
        self._kidnap.restart()
        return self._begin(frame, again, seen.reason)

    def _update_loops(self, loops: LoopsBeside, stamp_s: float, covariance: FloatArray | None) -> None:
        """Pass new keyframes on to loop closing once the filter knows which sensor was right on the way to them."""
        if loops.tracked_s != stamp_s:
            loops.forget_tracked()
        if loops.has_new and covariance is not None:
            loops.keep(stamp_s, self._map.T_odom_map, covariance, self.filter.keep_frame(stamp_s))
        motions_there = self.filter.settled_motions() if loops.is_waiting else None
        if motions_there is not None:
            self._move_map(loops.hand_over(motions_there, self._map.keyframe))

    def _without_camera(self, frame: RgbdFrame) -> Estimate:
        """Return the wheels' pose at a frame of a camera that is left out. The frame may still show an area."""
        self._map.forget_frame()
        is_usable = self._check.by_wheels is None and self._camera.gate.why_not(frame) is None
        if is_usable and self._readmission.agrees(frame):
            self._check.readmit()  # at the next frames the camera restarts at the wheels' pose
        nothing = MotionEstimate.failed(Reason.CONTRADICTION)
        return self._with_area(frame, self.filter.miss_frame(frame.stamp_s, nothing))

    def _miss(self, stamp_s: float) -> Estimate:
        """Return the estimate at a frame that cannot be aligned."""
        seen = self.odometry.miss(stamp_s)
        nothing = MotionEstimate.failed(Reason.FRAME_UNUSABLE, seen.matches, seen.inliers)
        return self.filter.miss_frame(stamp_s, nothing)

    def _with_area(self, frame: RgbdFrame, answer: FusedEstimate) -> FusedEstimate:
        """Return the estimate after the area that the frame shows. The camera's map follows the correction."""
        if self._places is None:
            return answer
        placed = self._places.update(frame, answer, self.filter)
        self._map.lay(self.filter.last_frame())
        return placed

    def _with_checks(self, answer: FusedEstimate) -> FusedEstimate:
        """Return the filter's estimate with the status and covariance that the checks require."""
        return self._kidnap.apply(self._restart.apply(self._check.apply(answer)))

    def _excludes(self, sensor: Culprit) -> bool:
        """Whether a sensor was just found wrong; a filter without it takes over."""
        other = self._check.hand_over(sensor)
        if other is not None:
            self._replace_filter(other)
        return other is not None

    def _replace_filter(self, other: ErrorStateFilter) -> None:
        """Continue with another filter, which does not know the gyroscope's bias yet."""
        self.filter = other
        self._base.forget_bias()

    def _is_early(self, stamp_s: float) -> bool:
        """Whether a stamp is before the start that is known in the map of the areas."""
        return self._places is not None and stamp_s < self._places.begin_s

    @property
    def odometry(self) -> CameraOdometry:
        """Odometry of the camera."""
        return self._camera.odometry

    @property
    def mapper(self) -> MapBuilder | None:
        """Builder of the surfel map, if the settings ask for one."""
        return self._camera.mapper

    @property
    def T_odom_map(self) -> FloatArray:
        """(4, 4) current pose of the map of camera and surfels."""
        return motions.times(self._odom.answered.T_odom_filter, self._map.T_odom_map)

    @property
    def last_matches(self) -> MatchedPixels | None:
        """Pixels by which the last frame was aligned; None for dense odometry."""
        return self._camera.last_matches

    @property
    def stage_seconds(self) -> dict[str, float]:
        """Duration of each stage of the last frame."""
        return self.odometry.stage_seconds | ({} if self._places is None else self._places.stage_seconds)

    @property
    def warnings(self) -> tuple[str, ...]:
        """One sentence for each fault of the gyroscope or of the calibration."""
        return (*self._base.warnings, *self._check.warnings)

    @property
    def last_place(self) -> PlaceMatch | None:
        """Result of the model of places for the last frame; None if it was not asked."""
        return None if self._places is None else self._places.last_place


class BaseSensors:
    """Wheels alone, and a second dead reckoning that fuses the gyroscope.

    The filter estimates the gyroscope's bias itself. If the wheels used the gyroscope too, it would count twice. The
    second dead reckoning decides whether the gyroscope is reliable, and finds its bias at rest.

    Attributes:
        problem: why the wheels are not used, or "".
    """

    def __init__(self, calibration: Calibration, settings: WheelSettings) -> None:
        self._wheels = ByWheels(calibration, settings.model_copy(update={"gyro": False}))
        self._with_gyro = ByWheels(calibration, settings)
        assert calibration.any_wheels is not None  # ByWheels has refused it
        self._times = ReadingTimes(calibration.any_wheels)
        self.uses_gyro, self._has_gyro, self._was_trusted = settings.gyro, False, False
        self.problem = ""
        self._last_s = -math.inf

    @property
    def hears(self) -> tuple[type[Event], ...]:
        """Types of the events that it uses."""
        return self._with_gyro.hears

    @property
    def warnings(self) -> tuple[str, ...]:
        """Fault of the gyroscope, as a sentence."""
        return self._with_gyro.warnings

    @property
    def noise_s(self) -> float:
        """Uncertainty of the times of readings, seconds."""
        return self._times.noise_s

    def process(self, reading: WheelReading) -> tuple[WheelEstimate | None, str]:
        """Return the estimate of the wheels alone, stamped by the time of the motion, and a note on the gyroscope."""
        self._last_s = reading.stamp_s
        if not isinstance(reading, WheelSpeeds):  # speeds have no distances by which to find the time
            reading = replace(reading, stamp_s=self._times.time_of(reading))
        wheels, note = self._wheels.process(reading)
        return wheels, self._with_gyro.process(reading)[1] if self._has_gyro else note

    def refuse(self, reading: WheelReading) -> None:
        """Take a reading whose stamp is far from all others, as after a jump of its clock or a long gap."""
        paused_s = reading.stamp_s - self._last_s
        if 0 < paused_s < math.inf:
            self._wheels.pause(paused_s)
            self._with_gyro.pause(paused_s)

    def add_yaw_rate(self, rate: YawRate) -> bool:
        """Add a yaw rate; return whether the filter may use it: the gyroscope is enabled and agrees with the wheels."""
        if self.uses_gyro:
            self._has_gyro = True
            self._with_gyro.process(rate)
        return self.uses_gyro and self._with_gyro.trusts_gyro

    def update_filter(self, rate: YawRate, fusion: ErrorStateFilter) -> None:
        """Update the filter by a yaw rate; before the first one, by the bias that was found."""
        if not self._was_trusted:
            found = self._with_gyro.odometry
            fusion.update_gyro_bias(rate.stamp_s, found.gyro_bias_rad_s, found.gyro_bias_sigma_rad_s)
        self._was_trusted = True
        fusion.update_yaw_rate(rate.stamp_s, rate.yaw_rate_rad_s)

    def forget_bias(self) -> None:
        """Pass the bias on again: the next filter does not know it."""
        self._was_trusted = False
