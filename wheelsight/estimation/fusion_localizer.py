"""ByFusion: localization by wheels, gyroscope and camera with the error-state filter.

The wheels predict the pose and the camera corrects it. `filter.CurrentPose.of` makes pose, covariance, status and flags
of the filter's estimate. `ByFusion._decide` then applies the evidence of checks and loops by `decide`, and sets the
frames. With `SENSOR_WRONG` or `FLOOR_ELSEWHERE` it starts from the estimate of the wheels alone.

`FusedCamera` and `BaseSensors` prepare the sensors for the filter. `CameraMap` is the map frame of camera odometry, and
its pose in odom. `FusedOdom` is the frame `odom`.
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass, replace

import numpy as np

from wheelsight.config import Config
from wheelsight.core.calibration import Calibration
from wheelsight.core.camera_errors import frame_covariance
from wheelsight.core.checks import FrameGate, Untimed
from wheelsight.core.estimates import (
    DEGENERATE_SCALE,
    NO_DECISION,
    STEP_BEGIN,
    CameraEstimate,
    Estimate,
    FusedEstimate,
    MotionEstimate,
    OdomFrame,
    PoseDecision,
    PoseEvidence,
    PoseFinding,
    Reason,
    Status,
    WheelEstimate,
    decide,
    with_stamp_noise,
    with_view_noise,
)
from wheelsight.core.geometry import FloatArray, se3
from wheelsight.core.geometry import motion_kernels as motions
from wheelsight.core.keyframes import KeyframeId
from wheelsight.core.messages import WHEEL_READINGS, Event, RgbdFrame, SkippedFrame, WheelReading, WheelSpeeds, YawRate
from wheelsight.estimation import camera_localizer as cameras
from wheelsight.estimation.agreement import RobotSensor
from wheelsight.estimation.area_localizer import Places, PlaceSense
from wheelsight.estimation.camera_localizer import RESTART_AFTER, CameraOdometry, mount_of
from wheelsight.estimation.consistency_check import (
    DARK_S,
    BaseCheck,
    KidnapDetection,
    ReadmissionCheck,
    UncertainRestart,
)
from wheelsight.estimation.fault_detection import SensorHealth
from wheelsight.estimation.filter import REFERENCE, ErrorStateFilter, StepBegin
from wheelsight.estimation.loop_updates import LoopClosureClient, SubmapState, begin_in, loop_closure_client
from wheelsight.estimation.odometry_choice import NO_PARTS, OwnParts
from wheelsight.estimation.pose_belief import COAST_AFTER_S, FilterParameters
from wheelsight.estimation.wheel_localizer import ByWheels, slip_note
from wheelsight.mapping.surfels import MapBuilder
from wheelsight.places import PlaceMatch
from wheelsight.slam.place_recognition import KnownMap
from wheelsight.vision.dense import DenseEstimate, DenseOdometry
from wheelsight.vision.features import FeatureEstimate, MatchedPixels
from wheelsight.vision.features.tracking import Pace
from wheelsight.wheels import HolonomicOdometry, ReadingTimes, WheelOdometry, WheelSettings, odometry_of

# Distance from an anchor to the next one; a turn by a radian counts as 1.5 m. Errors of single frames do not add up
# against a reference that is held for a while.
_ANCHOR_WAY_M = 0.3
# Growth of the variance of a frame's systematic error per metre of the camera's way: it adds up as the view changes
# (freiburg1_desk against motion capture: docs/decisions/filter.md).
_FRAME_WALK_PER_M = 25.0
_LONGEST_READING_GAP = 256  # stamps kept: frames are hardly ever delayed by more readings
# Distance between the filter's pose and the camera's in its map, m, from which on the camera has jumped; a radian is
# 1.5 m. Wheels err by less in the second of a contradiction; images mirrored in a corridor jump by 0.1 (simulator).
_JUMPED_M = 0.05
# Speeds of the pose in odom to a corrected one, slow enough for a controller; a wrong heading adds to the other error.
_CORRECTION_M_S, _CORRECTION_RAD_S = 0.1, math.radians(10.0)
_REMEMBERED_POSES = 600  # of the map in odom, one a frame: as long as the filter remembers, at 30 frames a second
_SUSPICION, _SLIP = PoseEvidence(PoseFinding.SENSOR_SUSPECTED), PoseEvidence(PoseFinding.SLIP)
# After a longer gap without frames, seconds, the camera may be right, and the wheels may have drifted.
_LONGEST_GAP_S = 0.5


class ByFusion:
    """Answers wheel readings and frames by the default filter. Dense odometry builds its map where all sensors agree.

    With places, the map is that of the areas, and the area that a frame shows is one more measurement.

    Attributes:
        filter: fuses the camera with the wheels.
        odometry: of the camera.
        keyframes: of the camera.
        mapper: builds the surfel map, if the settings ask for one.
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
        T_base_camera = mount_of(calibration)
        self._base = BaseSensors(calibration, settings.wheels)
        self.hears: tuple[type[Event], ...] = (*self._base.hears, RgbdFrame, SkippedFrame)
        self._camera = FusedCamera(calibration, settings, T_base_camera, known, parts)
        self.odometry: CameraOdometry = self._camera.odometry
        self.keyframes, self.watch = self.odometry.store, self.odometry.watch
        self.mapper: MapBuilder | None = self._camera.mapper
        begins = None if known is None else begin_in(known, calibration)
        self._map, self._of_frame = CameraMap(T_base_camera, begins), frame_covariance(calibration)
        self._has_prior = known is not None and known.start is not None
        self._places = None if places is None else PlaceSense(places, settings.fusion.areas, self.watch)
        T_start, spread = (None, None) if self._places is None else self._places.start
        of_robot = FilterParameters.of(settings.fusion.error_state, calibration.gyro, calibration.any_wheels)
        begin = (T_base_camera, T_start, spread, of_robot)
        self.filter = ErrorStateFilter(*begin)

        def new_check() -> BaseCheck:
            return BaseCheck(calibration, T_base_camera, ErrorStateFilter(*begin))

        self._check, self._readmission = new_check(), ReadmissionCheck(new_check, self._camera.another)
        store, detector = self.odometry.store, parts.loop_detector
        self.loops = loop_closure_client(store, calibration, settings, known, waits=waits, detector=detector)
        wheels = calibration.wheels
        self._health = None if wheels is None else SensorHealth(wheels.track_width_m, T_base_camera)
        self._kidnap, self._restart, self._odom = KidnapDetection(), UncertainRestart(), FusedOdom()

    def process(self, event: Event) -> tuple[Estimate | None, str]:
        """Return the estimate after a wheel reading or frame, None for any other event, and a note on the event."""
        self._camera.last_matches = None
        if isinstance(event, YawRate):  # it counts once the gyroscope agrees with the wheels
            counts = self._base.add_yaw_rate(event, is_watched=self._health is not None and self._health.is_armed)
            if self._health is not None and (counts or RobotSensor.GYRO in self._health.faults):
                self._health.rates.append((event.stamp_s, event.yaw_rate_rad_s))
            if self._base.uses_gyro:
                self._check.add_yaw_rate(event.stamp_s, event.yaw_rate_rad_s)
            if counts and not self._is_early(event.stamp_s):
                self._base.update_filter(event, self.filter)
            return None, ""
        fused, note = self._update_wheels(event) if isinstance(event, WheelReading) else self._update_frame(event)
        return (self._decide(fused, event) if isinstance(fused, FusedEstimate) else fused), note

    def refuse(self, event: Event, why: Untimed) -> tuple[Estimate | None, str]:
        """Return the current estimate for an event with an invalid stamp; None for a yaw rate."""
        self._camera.last_matches = None
        if isinstance(event, YawRate):
            return None, ""
        if why.reason is Reason.CLOCKS_APART:
            if isinstance(event, WheelReading):
                self._base.problem = f"the wheels are not used: {why.note}"
                self._base.refuse(event)
            fused = replace(self.filter.estimate, reason=why.reason)
            return self._decide(fused, None, PoseEvidence(PoseFinding.CLOCKS_APART)), why.note
        reason = Reason.FRAME_UNUSABLE if isinstance(event, RgbdFrame | SkippedFrame) else why.reason
        return self._decide(replace(self.filter.estimate, reason=reason), None), why.note

    def _decide(self, fused: FusedEstimate, event: Event | None, *more_evidence: PoseEvidence) -> FusedEstimate:
        """Return the estimate of an event, by `decide`, from the filter's estimate and all evidence.

        Args:
            fused: estimate of the filter.
            event: None if its stamp is invalid.
            more_evidence: evidence beside that of the checks.
        """
        check_evidence = self._check.evidence(fused)
        source = fused if check_evidence is None else check_evidence.by_wheels or fused
        flags = source.slip, source.degenerate, source.doubtful
        pose = source.T_odom_body, source.covariance
        decided = PoseDecision(source.status, *flags, fused.reason, *pose)
        if check_evidence is not None:
            decided = decide([check_evidence], decided)
        T, C, T_map_filter = decided.T_odom_body, decided.covariance, self._map.T_map_filter
        if T is not None and C is not None:  # without a pose, the status of the sensors stays
            evidence = [self._restart.update_evidence(T, C), self._kidnap.update_evidence(T, C), *more_evidence]
            if self._health is not None and self._health.is_suspicious:
                evidence.append(_SUSPICION)
            if self._health is not None and self._health.is_without_wheels:
                evidence.append(_SLIP)
            decided = decide(evidence, decided) if any(evidence) else decided
            if self.loops is not None:
                in_map = self.loops.update_evidence(fused.stamp_s, decided.status, T, decided.covariance, T_map_filter)
                decided = decide([in_map], decided)
        T_keyframe_map, T_keyframe_base = self._map.T_keyframe_map, None
        if T_keyframe_map is not None and T is not None:
            T_keyframe_base = motions.times(T_keyframe_map, motions.times(T_map_filter, T))
        odom = self._odom.last_output_frame if T is None else self._odom.frame_at(T, self.filter, event)
        estimate = replace(  # with poses in the filter's frame; `framed` below converts them to odom
            source,
            **decided._asdict(),
            keyframe=None if T_keyframe_base is None else self._map.keyframe,
            T_keyframe_body=T_keyframe_base,
            T_map_odom=T_map_filter,
        )
        return odom.framed(estimate)

    def _update_wheels(self, reading: WheelReading) -> tuple[Estimate | None, str]:
        wheels, note = self._base.process(reading)
        if self._places is not None and self._is_early(wheels.stamp_s):
            return Estimate(wheels.stamp_s, NO_DECISION.status, body=self.body), note
        self._camera.gate.has_wheels = True
        check = self._check
        if check.by_wheels is not None:
            check.add_wheels(wheels)
        if wheels.T_odom_body is not None:
            self._kidnap.add_wheels(wheels.stamp_s, wheels.T_odom_body)
        if self._readmission.check is not None:
            self._readmission.check.add_wheels(wheels)
        if check.verdict.left_out is not None:
            if self._switch_filter_without(RobotSensor.CAMERA):
                return self.filter.estimate, note
            if check.is_without_wheels:
                return self.filter.drop(wheels.stamp_s, ""), note  # the camera's velocity predicts the pose
        if self._health is not None and wheels.step is not None and wheels.reason is None:
            T = wheels.step.T_before_now
            self._health.steps.append((wheels.step.end_s, float(T[0, 3]), math.atan2(T[1, 0], T[0, 0])))
        fused = self.filter.predict_to(wheels)
        self._base.problem = f"the wheels are not used: {fused.reason}" if fused.reason is Reason.TOO_LATE else ""
        return fused, note

    def _update_frame(self, event: RgbdFrame | SkippedFrame) -> tuple[Estimate, str]:
        """Return the estimate after a frame, usable or not, and a note on the frame."""
        if self._places is not None:
            self._places.forget()
            if self._is_early(event.stamp_s):
                note = event.reason if isinstance(event, SkippedFrame) else ""
                return Estimate(event.stamp_s, NO_DECISION.status, body=self.body), note
        if isinstance(event, SkippedFrame):
            return self._miss(event.stamp_s), event.reason
        if self._check.verdict.left_out is RobotSensor.CAMERA:
            return self._without_camera(event), ""
        expected = self.filter.expect_frame(event.stamp_s)
        gate = self._camera.gate
        why_not = gate.why_not(event, expected)
        if why_not is not None and why_not.is_repeat:  # neither measurement nor failure
            return replace(self.filter.estimate, reason=Reason.REPEATED), why_not.note
        if why_not is not None:
            return self._miss(event.stamp_s), why_not.note
        if not gate.has_wheels and gate.waits_for_wheels(event):
            return Estimate(event.stamp_s, NO_DECISION.status, body=self.body), ""
        if self._check.by_wheels is not None:
            self._check.add_frame(event)
        self.watch.lap("check")
        fused = self._track(event, expected)
        self._camera.slips = fused.slip
        self.watch.lap("filter")
        if self.loops is not None:
            self._update_loops(self.loops, event.stamp_s, fused.covariance)
            self.watch.lap("loops")
        return (fused if self._places is None else self._with_area(self._places, event, fused)), self._base.problem

    def _track(self, frame: RgbdFrame, expected: FloatArray | None) -> FusedEstimate:
        """Align a frame, then update the filter by the camera's motion since the anchor."""
        self._map.T_map_camera = None
        if self.loops is not None:
            self._apply_loops(self.loops, frame.stamp_s)
            self.watch.lap("loops")
        if self._has_prior and self._map.anchor is None:  # the prior is of the first event; the robot may have moved
            self.odometry.begin_at(self._map.camera_at(self.filter.when_imaged(frame.stamp_s)))
        twist = self._camera.twist(self.filter.estimate)
        found = self._check.verdict.found
        ask_wheels = not found or RobotSensor.WHEELS not in [one.sensor for one in found]
        seen = self._camera.process(frame, expected, twist, ask_wheels=ask_wheels)
        if seen.T_odom_body is None:
            return self._lose(frame, seen)
        anchor = self._map.anchor
        if seen.relocation is not None and cameras.is_drift(
            seen,
            None if anchor is None else anchor.motion_to(seen.T_odom_body, seen.motion),
            self.filter.expect(frame.stamp_s, REFERENCE),
        ):
            self._move_map(seen.relocation)
            anchor = self._map.anchor
        if anchor is None:
            return self._begin(frame, seen)
        if self.loops is not None and self.loops.confirmation.is_refuted:
            return self._lose(frame, seen, restarts=True)
        shows_all = seen.motion.shows_all
        self._check.add_tracked(frame, seen, shows_all=shows_all)
        if self._check.verdict.left_out is not None and self._switch_filter_without(RobotSensor.WHEELS):
            return self._begin(frame, seen)
        begun = None if self._health is None else self._update_health(self._health, frame, seen, shows_all=shows_all)
        if begun is not None:
            return begun
        self.watch.lap("faults")
        motion = anchor.motion_to(seen.T_odom_body, seen.motion)
        motion = with_stamp_noise(motion, twist, self._base.noise_s)
        motion = with_view_noise(motion, self._of_frame, _FRAME_WALK_PER_M)
        if not shows_all and frame.stamp_s - self._map.seen_s > DARK_S:
            return self._lose(frame, replace(seen, reason=Reason.DEGENERATE), restarts=True)
        return self._measure(frame, seen, motion)

    def _update_health(
        self, health: SensorHealth, frame: RgbdFrame, seen: CameraEstimate, *, shows_all: bool
    ) -> FusedEstimate | None:
        """Exclude sensors that are faulty by a frame; return the estimate if the camera begins here, else None."""
        assert seen.T_odom_body is not None
        health.knows_turns = self._check.is_over
        health.is_armed = health.knows_turns or self._check.has_agreed_ahead
        health.add_frame(frame.stamp_s, seen.T_odom_body, shows_all=shows_all)
        before, since_s = health.exclusions, health.update(frame.stamp_s)
        if health.faults and not self._check.is_over:
            self._check.end()
        if since_s is None:
            return None
        now = health.exclusions
        returns = any(one.sensor is RobotSensor.CAMERA and one.is_sure and one not in now for one in before)
        if self.filter.exclude(now, since_s):
            is_camera_out = returns or any(one.sensor is RobotSensor.CAMERA and one.end_s == math.inf for one in now)
            self._map.correct(since_s, None if is_camera_out else self.filter.last_frame())
            self._odom.correct(since_s)
        scales = health.take_new_scales()
        if (scales != 1.0).any():
            self._base.rescale(*scales)
            self._replace_filter(self.filter.with_unknown_wheels())
            return self._begin(frame, seen)
        if returns:  # its own pose includes the motions for which it was excluded
            nothing = MotionEstimate.failed(Reason.CONTRADICTION)
            return self._restart_camera(frame, seen, self.filter.miss_frame(frame.stamp_s, nothing))
        return None

    def _apply_loops(self, loops: LoopClosureClient, stamp_s: float) -> None:
        """Move keyframes by the loops found so far. The pose in odom does not change."""
        self._move_map(loops.move_keyframes(stamp_s, self._map.keyframe))
        if self._restart.since is not None and loops.has_loop_across(self._restart.since):
            self._restart.relocalized()
        if loops.submap is not SubmapState.APART:  # not only JOINED, which no doubtful estimate reaches
            self._kidnap.relocalized()

    def _move_map(self, T_new_old: FloatArray | None) -> None:
        """Apply a correction (4, 4), from the left, of the camera's pose in the map: the robot has not moved by it."""
        if T_new_old is not None:
            self._map.moved(T_new_old)
            self._camera.pace.moved(T_new_old)
            self._check.moved(T_new_old)
            if self._health is not None:
                self._health.move(T_new_old)

    def _measure(self, frame: RgbdFrame, seen: CameraEstimate, motion: MotionEstimate) -> FusedEstimate:
        """Update the filter by the motion of a tracked frame since the anchor. Accepted frames extend the map."""
        assert seen.T_odom_body is not None
        assert motion.T_reference_current is not None
        here = Anchor.at(seen.T_odom_body, seen.motion)
        is_far = bool(motions.view_shift_m(motion.T_reference_current) > _ANCHOR_WAY_M)
        update = self.filter.update_frame(frame.stamp_s, motion, here.covariance, is_far=is_far)
        answer = update.answer
        agrees = answer.reason is None and not answer.doubtful
        if not agrees and self._kidnap.is_in_dark and answer.covariance is not None:
            return self._restart_camera(frame, seen, answer)
        self._camera.unknown = 0
        self._kidnap.add_known_view(frame.stamp_s)
        is_accepted = agrees and answer.T_odom_body is not None and answer.status is Status.TRACKING
        self._map.track(frame.stamp_s, seen.T_odom_body, is_accepted=is_accepted)
        # While another sensor is suspected, it is the filter that has left the camera's map.
        is_camera = self._health is None or self._health.suspected in (None, RobotSensor.CAMERA)
        may_have_jumped = is_accepted and is_camera and self._map.is_contradicted
        if may_have_jumped and self._map.has_camera_jumped(seen.T_odom_body, update.T_filter_base):
            # The camera jumped: restart it at the pose in its map that the filter has.
            assert update.T_filter_base is not None
            assert answer.covariance is not None
            again = self._camera.restart(frame, self._map.camera_at(update.T_filter_base), answer.covariance)
            return answer if again.T_odom_body is None else self._begin(frame, again)
        if is_accepted:
            self._map.accept(frame.stamp_s, seen, update.T_filter_base)
            if self.loops is not None and answer.covariance is not None:
                against = with_view_noise(seen.motion, self._of_frame, _FRAME_WALK_PER_M)
                self.loops.add_tracked(replace(seen, motion=against), self._map.T_filter_map, answer.covariance)
            self._restart.add_accepted(answer, self.odometry.store)
            self.watch.lap("filter")
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
        self._map.accept(frame.stamp_s, seen, update.T_filter_base)
        self._kidnap.add_known_view(frame.stamp_s)
        if self._health is not None:
            self._health.interrupt()
            self._health.add_frame(frame.stamp_s, seen.T_odom_body)
        self._check.begin(frame, seen, self._map.T_filter_map)
        reason = reason or update.answer.reason
        return replace(update.answer, reason=reason, matches=seen.matches, inliers=seen.inliers)

    def _lose(self, frame: RgbdFrame, seen: CameraEstimate, *, restarts: bool = False) -> FusedEstimate:
        """Return the wheels' pose at a frame that was not tracked; with `restarts` the camera restarts there, or after
        several frames that show nothing known.
        """
        nothing = MotionEstimate.failed(seen.reason or Reason.INVALID, seen.matches, seen.inliers)
        answer = self.filter.miss_frame(frame.stamp_s, nothing)
        expected = self.filter.expect_frame(frame.stamp_s)
        if self._camera.miss(seen) and self._camera.unknown == 1 and answer.T_odom_body is not None:
            # The view changed: if the wheels stood meanwhile, the robot may have been moved.
            self._kidnap.add_unknown_view(frame.stamp_s, expected, answer.T_odom_body)
        is_lost = self._camera.unknown >= RESTART_AFTER and not self._kidnap.waits(expected)
        if (restarts or is_lost) and answer.covariance is not None:
            return self._restart_camera(frame, seen, answer)
        return answer

    def _restart_camera(self, frame: RgbdFrame, seen: CameraEstimate, wheels: FusedEstimate) -> FusedEstimate:
        """Restart the camera, at a frame that shows nothing known, at the pose that the wheels predict.

        After a kidnapping, or at a wrong place in a known map, the pose is unknown: the camera begins a submap
        that loops have to join to the rest.
        """
        if wheels.covariance is None:  # the filter is lost, too, and begins with the camera
            return wheels if seen.T_odom_body is None else self._begin(frame, seen)
        T_filter_base = self.filter.when_imaged(frame.stamp_s)
        spread_m = self.filter.spread_since_frame_m(frame.stamp_s)
        if self._kidnap.is_kidnapped:
            spread = self._kidnap.inflate(T_filter_base, wheels.covariance)
            self._replace_filter(self.filter.begun_at(T_filter_base, spread))
        first = len(self.odometry.store)
        if self.loops is not None:  # the restart does not continue the last keyframes
            self._add_keyframes(self.loops, frame.stamp_s, wheels.covariance)
        T_map_camera = self._map.camera_at(T_filter_base)
        if self.loops is None or not (self._kidnap.is_kidnapped or self.loops.confirmation.is_refuted):
            again = self._camera.restart(frame, T_map_camera, wheels.covariance)
        else:
            again = self._camera.restart(frame, self.loops.camera_in_new_submap(T_map_camera), wheels.covariance)
            if again.keyframe is not None:
                self.loops.begin_submap(again.keyframe)
                self._kidnap.begin_submap()
        if again.T_odom_body is None:
            return wheels
        self._restart.begin(spread_m, first)
        self._kidnap.restart()
        if self._health is not None:
            self._health.interrupt(frame.stamp_s)
        return self._begin(frame, again, seen.reason)

    def _update_loops(self, loops: LoopClosureClient, stamp_s: float, covariance: FloatArray | None) -> None:
        """Pass new keyframes on to loop closing once the filter knows which sensor was right on the way to them."""
        if loops.tracked_s != stamp_s:
            loops.forget_tracked()
        if covariance is not None:
            self._add_keyframes(loops, stamp_s, covariance)
        is_suspected = self._health is not None and self._health.suspected is not None
        motions_there = self.filter.settled_motions(waits=is_suspected) if loops.has_pending else None
        if motions_there is not None:
            self._move_map(loops.hand_over(motions_there, self._map.keyframe))

    def _add_keyframes(self, loops: LoopClosureClient, stamp_s: float, covariance: FloatArray) -> None:
        """Add the keyframes that odometry has made since the last call, at a frame with its covariance (6, 6)."""
        if loops.has_new:
            loops.add_keyframes(stamp_s, self._map.T_filter_map, covariance, self.filter.keep_frame(stamp_s))

    def _without_camera(self, frame: RgbdFrame) -> FusedEstimate:
        """Return the wheels' pose at a frame of a camera that is left out. The frame may still show an area."""
        self._map.T_map_camera = None
        is_usable = self._check.by_wheels is None and self._camera.gate.why_not(frame) is None
        if is_usable and self._readmission.agrees(frame):
            self._check.readmit()  # at the next frames the camera restarts at the wheels' pose
        nothing = MotionEstimate.failed(Reason.CONTRADICTION)
        fused = self.filter.miss_frame(frame.stamp_s, nothing)
        return fused if self._places is None else self._with_area(self._places, frame, fused)

    def _miss(self, stamp_s: float) -> FusedEstimate:
        """Return the estimate at a frame that cannot be aligned."""
        seen = self.odometry.miss(stamp_s)
        nothing = MotionEstimate.failed(Reason.FRAME_UNUSABLE, seen.matches, seen.inliers)
        return self.filter.miss_frame(stamp_s, nothing)

    def _with_area(self, places: PlaceSense, frame: RgbdFrame, fused: FusedEstimate) -> FusedEstimate:
        """Return the estimate after the area that the frame shows. The camera's map follows the correction."""
        placed = places.update(frame, fused, self.filter)
        self._map.align_last_frame(self.filter.last_frame())
        return placed

    def _switch_filter_without(self, sensor: RobotSensor) -> bool:
        """Continue with a filter without a sensor that was just found wrong; return whether it was."""
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
    def T_odom_map(self) -> FloatArray:
        """(4, 4) current pose of the map of camera and surfels."""
        return motions.times(self._odom.last_output_frame.T_odom_filter, self._map.T_filter_map)

    @property
    def last_matches(self) -> MatchedPixels | None:
        """Pixels by which the last frame was aligned; None for dense odometry."""
        return self._camera.last_matches

    @property
    def warnings(self) -> tuple[str, ...]:
        """One sentence for each fault of a sensor or of the calibration, and for a wrong place in a known map."""
        found = self._camera.gate.warnings + (self._base.warnings if self._base.has_gyro else ())
        found += () if self._health is None else self._health.warnings
        found += () if self.loops is None else self.loops.confirmation.warnings
        return found + self._check.verdict.warnings if self._check.verdict.is_sure else found

    @property
    def last_place(self) -> PlaceMatch | None:
        """Result of the model of places for the last frame; None if it was not asked."""
        return None if self._places is None else self._places.last_place


class FusedCamera:
    """Camera odometry of a filter, which predicts the camera's motion.

    Attributes:
        odometry: of the camera.
        mapper: builds a surfel map, if the settings ask for one.
        gate: rejects frames that need no alignment.
        unknown: number of frames in a row that showed nothing known.
        last_matches: pixels that aligned the last frame; None for dense odometry.
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
        self.odometry, self.mapper = cameras.camera_odometry(calibration, settings, known, parts)
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
        with self.odometry.watch.stage("track"):
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
        if seen.reason in cameras.BLIND:
            return False
        self.unknown += 1
        return True

    def another(self) -> CameraOdometry:
        """Return new odometry of the same camera, without keyframes."""
        return cameras.camera_odometry(*self._of)[0]


class BaseSensors:
    """Wheels alone, and a second dead reckoning that fuses the gyroscope.

    The filter estimates the gyroscope's bias itself. If the wheels used the gyroscope too, it would count twice. The
    second dead reckoning decides whether the gyroscope is reliable, and finds its bias at rest.

    Attributes:
        problem: why the wheels are not used, or "".
        noise_s: uncertainty of the times of readings.
    """

    def __init__(self, calibration: Calibration, settings: WheelSettings) -> None:
        self._wheels = odometry_of(calibration, settings.integration)
        self._with_gyro = ByWheels(calibration, settings)
        assert calibration.any_wheels is not None  # odometry_of has refused it
        self._times = ReadingTimes(calibration.any_wheels)
        self.hears = self._with_gyro.hears
        self.uses_gyro, self.has_gyro, self._was_trusted = settings.gyro, False, False
        self.problem, self.noise_s = "", self._times.noise_s
        self._last_s = -math.inf

    @property
    def warnings(self) -> tuple[str, ...]:
        """Fault of the gyroscope, as a sentence."""
        return self._with_gyro.warnings

    def process(self, reading: WheelReading) -> tuple[WheelEstimate, str]:
        """Return the estimate of the wheels alone, stamped by the time of the motion, and a note on the gyroscope."""
        self._last_s = reading.stamp_s
        if not isinstance(reading, WheelSpeeds):  # speeds have no distances by which to find the time
            reading = replace(reading, stamp_s=self._times.time_of(reading))
            self.noise_s = self._times.noise_s
        wheels = self._wheels.process(reading)
        if self.has_gyro:
            return wheels, self._with_gyro.process(reading)[1]
        return wheels, slip_note(self._wheels) if isinstance(self._wheels, HolonomicOdometry) else ""

    def refuse(self, reading: WheelReading) -> None:
        """Take a reading whose stamp is far from all others, as after a jump of its clock or a long gap."""
        paused_s = reading.stamp_s - self._last_s
        if 0 < paused_s < math.inf:
            self._wheels.pause(paused_s)
            self._with_gyro.pause(paused_s)

    def add_yaw_rate(self, rate: YawRate, *, is_watched: bool) -> bool:
        """Add a yaw rate, which sensor health may watch, too; return whether the filter may use it."""
        if self.uses_gyro:
            self.has_gyro, self._with_gyro.gyro_check.is_final = True, is_watched
            self._with_gyro.process(rate)
        return self.uses_gyro and self._with_gyro.trusts_gyro

    def update_filter(self, rate: YawRate, fusion: ErrorStateFilter) -> None:
        """Update the filter by a yaw rate; before the first one, by the bias that was found."""
        if not self._was_trusted:
            found = self._with_gyro.odometry
            fusion.update_gyro_bias(rate.stamp_s, found.gyro_bias_rad_s, found.gyro_bias_sigma_rad_s)
        self._was_trusted = True
        fusion.update_yaw_rate(rate.stamp_s, rate.yaw_rate_rad_s)

    def rescale(self, left: float, right: float) -> None:
        """Divide the ways of both wheels by new scales."""
        for odometry in (self._wheels, *self._with_gyro.odometries):
            if isinstance(odometry, WheelOdometry):
                odometry.rescale(left, right)

    def forget_bias(self) -> None:
        """Pass the bias on again: the next filter does not know it."""
        self._was_trusted = False


class FusedOdom:
    """`odom` of the default filter, in which the base moves by its motion since a pose that the filter remembers.

    A correction that moves the remembered pose as well is no part of that motion. The remembered pose is that of the
    last frame, if it was accepted. Else it is that of the last wheel reading before it: up to there wheel steps are
    complete. Without a frame for `COAST_AFTER_S`, the next pose is remembered.

    Attributes:
        last_output_frame: `odom` of the last estimate.
    """

    def __init__(self) -> None:
        self._frame = self.last_output_frame = OdomFrame()
        self._past: deque[tuple[float, FloatArray]] = deque(maxlen=_REMEMBERED_POSES)  # stamp, T_odom_filter
        self._target: FloatArray | None = None  # T_odom_filter to which a correction moves
        self._begin: StepBegin | None = None
        self._last: tuple[float, FloatArray] | None = None  # stamp and pose in odom of the last estimate
        self._readings_s: deque[float] = deque(maxlen=_LONGEST_READING_GAP)

    def frame_at(self, T_filter_body: FloatArray, fusion: ErrorStateFilter, event: Event | None) -> OdomFrame:
        """Return odom for an estimate's pose (4, 4), after an event; None for one with an invalid stamp."""
        current, frame, begin = fusion.current, self._frame, self._begin
        if current is None or current.decision.status is Status.LOST:
            return self.last_output_frame
        T_current, stamp_s = current.T, current.stamp_s
        T_begin = fusion.remembered(STEP_BEGIN)
        if begin is not None and T_begin is not None and begin.fusion is fusion:
            if (begin.T_filter_base != T_begin).any():  # the filter revised the past: odom does not follow
                frame.align(T_begin, motions.times(frame.T_odom_filter, begin.T_filter_base))
            self._begin = StepBegin(begin.stamp_s, T_begin, fusion)
        elif self._last is not None:  # another filter continues at the last twist
            vx, vy, turn = current.twist[0] * max(stamp_s - self._last[0], 0.0)
            T_before_now = motions.exp(np.array([vx, vy, 0.0, 0.0, 0.0, turn]))
            frame.align(T_current, motions.times(self._last[1], T_before_now))
        T_odom_body = motions.times(frame.T_odom_filter, T_current)
        if self._target is not None and self._last is not None:
            T_odom_body = self._move_to_target(T_current, T_odom_body, max(stamp_s - self._last[0], 0.0))
        if isinstance(event, RgbdFrame):
            self._past.append((stamp_s, frame.T_odom_filter if self._target is None else self._target))
        self._last = stamp_s, T_odom_body
        self._remember(stamp_s, fusion, event)
        # While sensors are being checked, the estimate may not be that of the filter.
        self.last_output_frame = frame
        if T_filter_body is not T_current and not np.array_equal(T_filter_body, T_current):
            self.last_output_frame = OdomFrame()
            self.last_output_frame.align(T_filter_body, T_odom_body)
        return self.last_output_frame

    def correct(self, since_s: float) -> None:
        """Move to where the robot would be in odom if the filter had known since a stamp what it knows now."""
        self._target = next((T for stamp_s, T in reversed(self._past) if stamp_s <= since_s), None)

    def _move_to_target(self, T_filter_body: FloatArray, T_odom_body: FloatArray, seconds: float) -> FloatArray:
        """Return the pose (4, 4) in odom, closer to the target by what the speed of a correction allows."""
        assert self._target is not None
        T_here_there = motions.times(motions.inverse(T_odom_body), motions.times(self._target, T_filter_body))
        error = motions.log(motions.renormalized(T_here_there))
        takes_s = np.array([np.linalg.norm(error[:2]) / _CORRECTION_M_S, abs(error[5]) / _CORRECTION_RAD_S])
        shares = np.minimum(1.0, seconds / np.maximum(takes_s, 1e-9))
        T_odom_body = motions.times(T_odom_body, se3.exp(shares.repeat(3) * error))  # rare: no kernel compiled
        self._frame.align(T_filter_body, T_odom_body)
        if shares.min() == 1.0:
            self._target = None
        return np.asarray(motions.times(self._frame.T_odom_filter, T_filter_body))

    def _remember(self, stamp_s: float, fusion: ErrorStateFilter, event: Event | None) -> None:
        """Remember the pose at an accepted frame, or at the last reading up to another; or the current one."""
        begin_s = -math.inf if self._begin is None or self._begin.fusion is not fusion else self._begin.stamp_s
        due_s = stamp_s if stamp_s - begin_s > COAST_AFTER_S else -math.inf
        if isinstance(event, WheelReading):
            self._readings_s.append(stamp_s)
        if isinstance(event, RgbdFrame) and fusion.state.vision_s == event.stamp_s:
            due_s = event.stamp_s  # known better than at a reading of wheels that may slip
        elif isinstance(event, RgbdFrame | SkippedFrame):
            past_s = [s for s in self._readings_s if event.stamp_s - COAST_AFTER_S < s <= event.stamp_s]
            due_s = max(past_s, default=min(event.stamp_s, stamp_s))
        if due_s > begin_s:
            fusion.clone(due_s, STEP_BEGIN)
            T_begin = fusion.remembered(STEP_BEGIN)
            self._begin = None if T_begin is None else StepBegin(due_s, T_begin, fusion)


@dataclass(frozen=True, slots=True, eq=False)
class Anchor:
    """Reference frame of the camera's motions in the filter.

    Attributes:
        T_map_camera: (4, 4) its pose by odometry.
        covariance: (6, 6) of its alignment, in its own frame. All motions against it share this error.
    """

    T_map_camera: FloatArray
    covariance: FloatArray

    @classmethod
    def at(cls, T_map_camera: FloatArray, motion: MotionEstimate) -> Anchor:
        """Return the anchor of a frame at a pose that was aligned by `motion`."""
        assert motion.T_reference_current is not None
        assert motion.covariance is not None
        return cls(T_map_camera, motions.carried(motions.inverse(motion.T_reference_current), motion.covariance))

    def motion_to(self, T_map_camera: FloatArray, motion: MotionEstimate) -> MotionEstimate:
        """Return the motion to a pose that `motion` aligned against another reference; its covariance is that one's."""
        assert motion.T_reference_current is not None
        assert motion.covariance is not None
        T_anchor_camera = motions.renormalized(motions.times(motions.inverse(self.T_map_camera), T_map_camera))
        T_anchor_reference = motions.times(T_anchor_camera, motions.inverse(motion.T_reference_current))
        covariance, hidden = motions.carried(T_anchor_reference, motion.covariance), None
        if motion.degenerate is not None and not motion.shows_all:
            Ad = motions.adjoint(T_anchor_reference)
            hidden = np.linalg.qr(((motion.degenerate / DEGENERATE_SCALE) @ Ad.T * DEGENERATE_SCALE).T)[0].T
        return MotionEstimate(T_anchor_camera, covariance, None, motion.matches, motion.inliers, hidden, motion.fitting)


class CameraMap:
    """Pose of the camera's map in the filter's frame.

    Corrections of the filter move the pose but no single surfel, which would tear the map apart. Instead the whole map
    moves, so that the camera's last accepted pose in it is the filter's pose of that frame.

    Attributes:
        T_filter_map, T_map_filter: (4, 4) current pose of the map of camera and surfels, and its inverse. `FusedOdom`
            relates the filter's frame to odom.
        T_map_camera: (4, 4) of the last frame, if it was accepted; else None.
        anchor: reference frame of the camera's motions in the filter; None before the camera starts.
        seen_s: stamp of the last accepted frame.
        keyframe: of the last accepted frame, and `T_keyframe_map` (4, 4), the map in its frame; or None.
        is_contradicted: whether the filter rejected consecutive frames since the last accepted one.

    Args:
        T_base_camera: (4, 4).
        T_map_camera: (4, 4) initial pose of the camera, with the base at the origin of the filter's frame; None if the
            map starts there.
    """

    def __init__(self, T_base_camera: FloatArray, T_map_camera: FloatArray | None = None) -> None:
        self.T_filter_map: FloatArray = np.eye(4)
        self.anchor: Anchor | None = None
        self.seen_s = -np.inf
        self._T_base_camera = T_base_camera
        self.T_map_filter: FloatArray = np.eye(4)
        if T_map_camera is not None:
            self._align(T_base_camera, T_map_camera)
        self.T_map_camera: FloatArray | None = None
        self.keyframe: KeyframeId | None = None
        self.T_keyframe_map: FloatArray | None = None
        self._tracked_s, self.is_contradicted = -np.inf, False
        self._T_tracked: FloatArray | None = None  # T_map_camera at the last frame that the filter remembers
        self._past: deque[tuple[float, FloatArray]] = deque(maxlen=_REMEMBERED_POSES)  # stamp, T_filter_map

    def track(self, stamp_s: float, T_map_camera: FloatArray, *, is_accepted: bool) -> None:
        """Note that a frame was tracked at a pose (4, 4), and whether the filter accepted it."""
        self._T_tracked = T_map_camera
        if not is_accepted and stamp_s - self._tracked_s <= _LONGEST_GAP_S:
            self.is_contradicted = True
        self._tracked_s = stamp_s

    def has_camera_jumped(self, T_map_camera: FloatArray, T_filter_base: FloatArray | None) -> bool:
        """Whether a camera at a pose (4, 4) in its map is elsewhere by the filter's pose of the base.

        If the filter accepts it after rejected frames, it has jumped, for instance by the period of a pattern. The map,
        aligned with the camera's pose, would jump as well.
        """
        if T_filter_base is None:
            return False
        T_map_filter_camera = motions.times(self.T_map_filter, motions.times(T_filter_base, self._T_base_camera))
        return bool(motions.view_shift_m(motions.times(motions.inverse(T_map_camera), T_map_filter_camera)) > _JUMPED_M)

    def accept(self, stamp_s: float, seen: Estimate, T_filter_base: FloatArray | None) -> None:
        """Accept the camera's pose in the map at a frame; `T_filter_base` is the base's when its image was taken."""
        self.T_map_camera, self.seen_s = seen.T_odom_body, stamp_s
        self._T_tracked = seen.T_odom_body
        self._tracked_s, self.is_contradicted = stamp_s, False
        if self.T_map_camera is not None and T_filter_base is not None:
            self._align(motions.times(T_filter_base, self._T_base_camera), self.T_map_camera)
            self._past.append((stamp_s, self.T_filter_map))
        if seen.keyframe is not None and seen.T_keyframe_body is not None and seen.T_odom_body is not None:
            self.keyframe = seen.keyframe
            self.T_keyframe_map = motions.times(seen.T_keyframe_body, motions.inverse(seen.T_odom_body))

    def align_last_frame(self, T_filter_base: FloatArray | None) -> None:
        """Align the map so that the last frame, if it was accepted, is at the filter's current estimate of its pose."""
        if self.T_map_camera is not None and T_filter_base is not None:
            self._align(motions.times(T_filter_base, self._T_base_camera), self.T_map_camera)

    def correct(self, since_s: float, T_filter_base: FloatArray | None) -> None:
        """Align the map after the filter corrected its poses since a stamp.

        `T_filter_base` (4, 4) is the corrected pose of the base at the last frame. None leaves the map where it was
        before, for a camera whose poses since then are not used.
        """
        if T_filter_base is not None and self._T_tracked is not None:
            self._align(motions.times(T_filter_base, self._T_base_camera), self._T_tracked)
            self.is_contradicted = False
        elif T_filter_base is None:
            while len(self._past) > 1 and self._past[-1][0] >= since_s:
                self._past.pop()
            if self._past:
                self._align(self._past[-1][1], np.eye(4))

    def _align(self, T_filter_camera: FloatArray, T_map_camera: FloatArray) -> None:
        self.T_filter_map = motions.renormalized(motions.times(T_filter_camera, motions.inverse(T_map_camera)))
        self.T_map_filter = motions.inverse(self.T_filter_map)

    def moved(self, T_new_old: FloatArray) -> None:
        """Apply a correction (4, 4) of the map by loops, from the left. The camera stays in the filter's frame."""
        T_old_new = motions.inverse(T_new_old)
        self._align(self.T_filter_map, T_new_old)
        if self.anchor is not None:
            self.anchor = replace(self.anchor, T_map_camera=motions.times(T_new_old, self.anchor.T_map_camera))
        if self.T_map_camera is not None:
            self.T_map_camera = motions.times(T_new_old, self.T_map_camera)
        if self._T_tracked is not None:
            self._T_tracked = motions.times(T_new_old, self._T_tracked)
        self._past = deque(
            ((stamp_s, motions.times(T, T_old_new)) for stamp_s, T in self._past), maxlen=_REMEMBERED_POSES
        )
        if self.T_keyframe_map is not None:
            self.T_keyframe_map = motions.times(self.T_keyframe_map, T_old_new)

    def camera_at(self, T_filter_base: FloatArray) -> FloatArray:
        """Return T_map_camera (4, 4) for a pose of the base in the filter's frame."""
        T_map_base = motions.times(motions.inverse(self.T_filter_map), T_filter_base)
        return np.asarray(motions.renormalized(motions.times(T_map_base, self._T_base_camera)))
