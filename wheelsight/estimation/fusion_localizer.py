"""ByFusion: localization by wheels, gyroscope and camera with the error-state filter. The wheels lead and the camera
corrects them.
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
from wheelsight.estimation.consistency_check import BaseCheck, SecondCheck
from wheelsight.estimation.filter import ErrorStateFilter
from wheelsight.estimation.kidnap_detection import Carried, UnsureStart
from wheelsight.estimation.loop_updates import LoopsBeside, begin_in, loops_beside
from wheelsight.estimation.odometry_choice import NO_PARTS, OwnParts
from wheelsight.estimation.wheel_localizer import ByWheels, FusedOdom
from wheelsight.places import PlaceMatch
from wheelsight.slam.place_recognition import KnownMap
from wheelsight.vision.dense import DenseEstimate
from wheelsight.vision.extrinsics import Culprit
from wheelsight.vision.features import MatchedPixels
from wheelsight.wheels import ReadingTimes, WheelSettings

# ByFusion: wheels lead, the camera corrects them, and each is told what the other expects.


class ByFusion:
    """Wheel readings and frames answered by the default filter; dense odometry builds its map where all agree.

    With places, the map is that of the areas, and the area that a frame shows is one more measurement.

    Attributes:
        filter: what joins the camera with the wheels.
        loops: closes loops while driving, where that is asked for.
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
        self.frame = "map" if known is None else "odom"  # in a map of before, odom begins anywhere
        self._settings, of, T_base_camera = settings.fusion.joining, settings.localizer, mount_of(calibration)
        self._base = BaseSensors(calibration, settings.wheels)
        self.hears: tuple[type[Event], ...] = (*self._base.hears, RgbdFrame, SkippedFrame)
        self._camera = FusedCamera(calibration, settings, T_base_camera, known, parts)
        begins = None if known is None else begin_in(known, calibration, settings.loops.pieces)
        self._map, self._of_frame = CameraMap(T_base_camera, begins), frame_covariance(calibration)
        self._start_is_said = known is not None and known.start is not None
        self._places = None if places is None else PlaceSense(places, settings.fusion.areas)
        T_start, spread = (None, None) if self._places is None else self._places.start
        filter_settings = settings.fusion.error_state.with_wheels(calibration.any_wheels)
        begin = (T_base_camera, T_start, spread, filter_settings, calibration.gyro)
        self.filter = ErrorStateFilter(*begin)
        checks = (of.base_check, of.color_check, settings.extrinsics)
        self._check = BaseCheck(calibration, T_base_camera, ErrorStateFilter(*begin), *checks)
        self._second = SecondCheck(
            lambda: BaseCheck(calibration, T_base_camera, ErrorStateFilter(*begin), *checks),
            self._camera.another,
            self._settings.restart_after,
        )
        detector = parts.loop_detector
        self.loops = loops_beside(self.odometry.store, calibration, settings, known, waits=waits, detector=detector)
        self._carried, self._unsure = Carried(self._settings), UnsureStart(self._settings)
        self._odom = FusedOdom(filter_settings.coast_after_s)

    @property
    def odometry(self) -> CameraOdometry:
        """The camera's."""
        return self._camera.odometry

    @property
    def mapper(self) -> MapBuilder | None:
        """Builds a map, where one is asked for."""
        return self._camera.mapper

    @property
    def T_odom_map(self) -> FloatArray:
        """(4, 4) where the map, of the camera and its surfels, lies by now."""
        return motions.times(self._odom.answered.T_odom_filter, self._map.T_odom_map)

    @property
    def last_matches(self) -> MatchedPixels | None:
        """What the last frame was aligned by; dense odometry matches no pixels."""
        return self._camera.last_matches

    @property
    def stage_seconds(self) -> dict[str, float]:
        """How long each stage of the last frame took."""
        return self.odometry.stage_seconds | ({} if self._places is None else self._places.stage_seconds)

    @property
    def warnings(self) -> tuple[str, ...]:
        """What is wrong with the gyroscope, or with what the calibration says, as a sentence each."""
        return (*self._base.warnings, *self._check.warnings)

    @property
    def last_place(self) -> PlaceMatch | None:
        """What the model of places said of the last frame, where there is one and it was asked."""
        return None if self._places is None else self._places.last_place

    def process(self, event: Event) -> tuple[Estimate | None, str]:
        """The estimate right after a reading or frame, None at any other event, and what was wrong with a frame."""
        self._camera.forget_frame()
        if isinstance(event, YawRate):
            self._turn(event)
        if isinstance(event, WheelReading):
            answer, note = self._reading(event)
        elif isinstance(event, RgbdFrame | SkippedFrame):
            answer, note = self._any_frame(event)
        else:
            return None, ""
        if isinstance(answer, FusedEstimate):
            answer = self._map.framed(answer)
        if answer is None:
            return None, note
        answer = answer if self.loops is None else self.loops.called(answer)
        return self._odom.framed(answer, self.filter, event), note

    def refuse(self, event: Event, why: Untimed) -> tuple[Estimate | None, str]:
        """What is known, at an event whose stamp means nothing; None at a yaw rate."""
        self._camera.forget_frame()
        if isinstance(event, YawRate):
            return None, ""
        if isinstance(event, WheelReading) and why.reason is Reason.CLOCKS_APART:
            self._base.deaf = f"the wheels are not heard: {why.note}"
            self._base.refuse(event)
        known, reason = self._odom.framed(self._map.framed(self.filter.estimate), self.filter), why.reason
        if reason is Reason.CLOCKS_APART and known.status is Status.TRACKING:
            # Until it is settled whose clock leapt, the base moves on unseen.
            return replace(known, reason=reason, status=Status.COASTING), why.note
        if isinstance(event, RgbdFrame | SkippedFrame) and reason is not Reason.CLOCKS_APART:
            reason = Reason.FRAME_UNUSABLE
        return replace(known, reason=reason), why.note

    def _turn(self, rate: YawRate) -> None:
        """A gyroscope counts once it has agreed with the wheels, and then with the bias it was found to have."""
        counts = self._base.hear(rate)
        if self._base.uses_gyro:
            self._check.turn(rate.stamp_s, rate.yaw_rate_rad_s)
        if counts and not self._is_early(rate.stamp_s):
            self._base.tell(rate, self.filter)

    def _reading(self, reading: WheelReading) -> tuple[Estimate | None, str]:
        wheels, note = self._base.process(reading)
        if wheels is not None and self._is_early(wheels.stamp_s):
            return Estimate(wheels.stamp_s, Status.INITIALIZING, body=self.body), note
        self._camera.gate.wheels_are_heard = True
        if wheels is None:
            return None, note
        self._check.hear(wheels)
        if wheels.T_odom_body is not None:
            self._carried.roll(wheels.stamp_s, wheels.T_odom_body)
        self._second.hear(wheels)
        if self._goes_on_without(Culprit.CAMERA):
            return self.filter.estimate, note
        if self._check.is_without_wheels:
            return self.filter.drop(wheels.stamp_s, ""), note  # the camera's speed carries the pose on
        answer = self.filter.predict_to(wheels)
        self._base.deaf = f"the wheels are not heard: {answer.reason}" if answer.reason is Reason.TOO_LATE else ""
        return self._checked(answer), note

    def _any_frame(self, event: RgbdFrame | SkippedFrame) -> tuple[Estimate, str]:
        """The answer to a frame, whatever is wrong with it."""
        if self._places is not None:
            self._places.forget()
        if self._is_early(event.stamp_s):
            note = event.reason if isinstance(event, SkippedFrame) else ""
            return Estimate(event.stamp_s, Status.INITIALIZING, body=self.body), note
        if isinstance(event, SkippedFrame):
            return self._miss(event.stamp_s), event.reason
        if self._check.left_out is Culprit.CAMERA:
            return self._overlook(event), ""
        expected = self.filter.expect_frame(event.stamp_s)
        why_not = self._camera.gate.why_not(event, expected)
        if why_not is not None:
            return self._repeated() if why_not.is_repeat else self._miss(event.stamp_s), why_not.note
        if self._camera.gate.waits_for_wheels(event):
            return Estimate(event.stamp_s, Status.INITIALIZING, body=self.body), ""
        self._check.look(event)
        answer = self._frame(event, expected)
        if self.loops is not None and self.loops.hung_s != event.stamp_s:
            self.loops.let_go()
        self._camera.lead(answer)
        if self.loops is not None:
            self._keep(self.loops, event.stamp_s, answer.covariance)
        return self._checked(self._placed(event, answer)), self._base.deaf

    def _keep(self, loops: LoopsBeside, stamp_s: float, covariance: FloatArray | None) -> None:
        """Have new keyframes looked at, once it is known which sensor was right on the way to them."""
        if loops.has_new and covariance is not None:
            loops.keep(stamp_s, self._map.T_odom_map, covariance, self.filter.keep_frame(stamp_s))
        motions_there = self.filter.settled_motions() if loops.is_waiting else None
        if motions_there is not None:
            self._moved(loops.hand_over(motions_there, self._map.keyframe))

    def _frame(self, frame: RgbdFrame, expected: FloatArray | None) -> FusedEstimate:
        """Track, judge, and remember what was believed."""
        self._map.forget_frame()
        self._close_loops(frame.stamp_s)
        if self._start_is_said and self._map.anchor is None:  # said of the robot at first, which may have moved since
            self._camera.begin_at(self._map.camera_at(self.filter.when_imaged(frame.stamp_s)))
        twist = self._camera.twist(self.filter.estimate)
        seen = self._camera.process(frame, expected, twist, ask_wheels=not self._check.suspects_wheels)
        if seen.T_odom_body is None:
            return self._unseen(frame, seen)
        anchor = self._map.anchor
        if anchor is None:
            return self._begun(frame, seen)
        self._check.see(frame, seen, shows_all=seen.motion.shows_all)
        if self._goes_on_without(Culprit.WHEELS):
            return self._begun(frame, seen)
        motion = anchor.motion_to(seen.T_odom_body, seen.motion)
        motion = blurred(motion, twist, self._base.noise_s)
        motion = strayed(motion, self._of_frame, self._settings.frame_walk_per_m)
        if frame.stamp_s - self._map.seen_s > self._settings.dark_s and not motion.shows_all:
            return self._unseen(frame, replace(seen, reason=Reason.DEGENERATE), restarts=True)
        return self._measured(frame, seen, motion)

    def _close_loops(self, stamp_s: float) -> None:
        """Put keyframes to where loops have them by now; the pose in odom stays."""
        self._moved(None if self.loops is None else self.loops.move_keyframes(stamp_s, self._map.keyframe))
        since = self._unsure.since
        if self.loops is not None and since is not None and self.loops.tie(since):
            self._unsure.found()
        if self.loops is not None and self.loops.is_laid:  # not `is_joined`: no doubtful answer makes it so
            self._carried.found()

    def _moved(self, T_new_old: FloatArray | None) -> None:
        """The keyframe on which the camera's pose hangs was put elsewhere in its map, by (4, 4) from the left."""
        if T_new_old is not None:
            self._map.moved(T_new_old)
            self._camera.moved(T_new_old)
            self._check.moved(T_new_old)

    def _measured(self, frame: RgbdFrame, seen: CameraEstimate, motion: MotionEstimate) -> FusedEstimate:
        """The answer to a frame that was tracked, by its motion against the anchor; the map grows if it is believed."""
        assert seen.T_odom_body is not None
        here = Anchor.at(seen.T_odom_body, seen.motion)
        update = self.filter.update_frame(
            frame.stamp_s, motion, here.covariance, is_far=is_far(motion, self._settings.anchor_way_m)
        )
        answer = update.answer
        if not update.is_believed and self._carried.is_by_dark and answer.covariance is not None:
            return self._again(frame, seen, answer)
        self._camera.unknown = 0
        self._carried.known(frame.stamp_s)
        is_believed = update.is_believed and answer.T_odom_body is not None and answer.status is Status.TRACKING
        self._map.track(frame.stamp_s, is_believed=is_believed)
        if is_believed and self._map.is_left(seen.T_odom_body, update.T_odom_base):
            return self._back_in_map(frame, answer, update.T_odom_base)
        if is_believed:
            self._map.believe(frame.stamp_s, seen.T_odom_body, update.T_odom_base)
            self._map.refer(seen)
            if self.loops is not None and answer.covariance is not None:
                against = strayed(seen.motion, self._of_frame, self._settings.frame_walk_per_m)
                self.loops.hang_on(replace(seen, motion=against), self._map.T_odom_map, answer.covariance)
            self._unsure.known(answer, len(self.odometry.store))
            if self.mapper is not None and isinstance(seen, DenseEstimate):
                self.mapper.fuse_tracked(frame, seen)
        if update.is_reference:
            self._map.anchor = here
        return answer

    def _begun(self, frame: RgbdFrame, seen: CameraEstimate, reason: Reason | None = None) -> FusedEstimate:
        """The answer at a frame at which the camera starts, where the wheels have it."""
        assert seen.T_odom_body is not None
        self._map.anchor = Anchor.at(seen.T_odom_body, seen.motion)
        update = self.filter.begin_frame(frame.stamp_s, self._map.anchor.covariance)
        self._map.believe(frame.stamp_s, seen.T_odom_body, update.T_odom_base)
        self._map.refer(seen)
        self._carried.known(frame.stamp_s)
        self._check.begin(frame, seen, self._map.T_odom_map)
        reason = reason or update.answer.reason
        return replace(update.answer, reason=reason, matches=seen.matches, inliers=seen.inliers)

    def _unseen(self, frame: RgbdFrame, seen: CameraEstimate, *, restarts: bool = False) -> FusedEstimate:
        """The wheels' pose; if it `restarts`, or after some frames that show nothing known, the camera starts there."""
        nothing = MotionEstimate.failed(seen.reason or Reason.INVALID, seen.matches, seen.inliers)
        answer = self.filter.miss_frame(frame.stamp_s, nothing)
        expected = self.filter.expect_frame(frame.stamp_s)
        if self._camera.miss(seen) and self._camera.unknown == 1 and answer.T_odom_body is not None:
            # Wheels that stood while the view became another do not know whether they were carried.
            self._carried.unknown(frame.stamp_s, expected, answer.T_odom_body)
        is_lost = self._camera.is_lost and not self._carried.waits(expected)
        return self._again(frame, seen, answer) if (restarts or is_lost) and answer.covariance is not None else answer

    def _again(self, frame: RgbdFrame, seen: CameraEstimate, wheels: FusedEstimate) -> FusedEstimate:
        """The answer at a frame that shows nothing known, at which the camera starts where the wheels have it."""
        assert wheels.covariance is not None
        T_odom_base = self.filter.when_imaged(frame.stamp_s)
        spread_m = self.filter.spread_since_frame_m(frame.stamp_s)
        if self._carried.is_so:
            spread = self._carried.scatter(T_odom_base, wheels.covariance)
            self._go_on_by(self.filter.begun_at(T_odom_base, spread))
        first = len(self.odometry.store)
        again = self._restarted(frame, self._map.camera_at(T_odom_base), wheels.covariance)
        if again.T_odom_body is None:
            return wheels
        self._unsure.begin(spread_m, first)
        self._carried.begin()
        return self._begun(frame, again, seen.reason)

    def _back_in_map(self, frame: RgbdFrame, answer: FusedEstimate, T_odom_base: FloatArray | None) -> FusedEstimate:
        """The answer at a frame at which a camera that leapt starts again, at the pose in its map that wheels tell."""
        assert T_odom_base is not None
        assert answer.covariance is not None
        again = self._camera.restart(frame, self._map.camera_at(T_odom_base), answer.covariance)
        return answer if again.T_odom_body is None else self._begun(frame, again)

    def _restarted(self, frame: RgbdFrame, T_map_camera: FloatArray, covariance: FloatArray) -> CameraEstimate:
        """The camera's answer at a frame at which it starts, where it is believed to be.

        Of a robot that was carried off nobody knows where it was put: it begins a piece of map that loops have to join.
        """
        if self.loops is None or not self._carried.is_so:
            return self._camera.restart(frame, T_map_camera, covariance)
        again = self._camera.restart(frame, self.loops.apart(T_map_camera), covariance)
        if again.keyframe is not None:
            self.loops.begin_piece(again.keyframe)
            self._carried.begin_piece()
        return again

    def _repeated(self) -> Estimate:
        """What is known, at an image that has come before: no measurement, and no failure of the camera."""
        return replace(self.filter.estimate, reason=Reason.REPEATED)

    def _overlook(self, frame: RgbdFrame) -> Estimate:
        """The wheels' answer at a frame of a camera whose motions are known to be wrong; it may show an area."""
        self._map.forget_frame()
        if self._check.by_wheels is None and self._camera.gate.why_not(frame) is None and self._second.agrees(frame):
            self._check.readmit()  # at the next frames the camera starts again, where the wheels have it
        nothing = MotionEstimate.failed(Reason.CONTRADICTION)
        return self._placed(frame, self.filter.miss_frame(frame.stamp_s, nothing))

    def _miss(self, stamp_s: float) -> Estimate:
        """The answer at a frame that came to nothing before it was aligned."""
        seen = self.odometry.miss(stamp_s)
        nothing = MotionEstimate.failed(Reason.FRAME_UNUSABLE, seen.matches, seen.inliers)
        return self.filter.miss_frame(stamp_s, nothing)

    def _placed(self, frame: RgbdFrame, answer: FusedEstimate) -> FusedEstimate:
        """The answer after the area that the frame shows; where the camera was believed, its map comes along."""
        if self._places is None:
            return answer
        placed = self._places.tell(frame, answer, self.filter)
        self._map.lay(self.filter.last_frame())
        return placed

    def _checked(self, answer: FusedEstimate) -> FusedEstimate:
        """What the filter answers, by what it cannot know."""
        return self._carried.answered(self._unsure.answered(self._check.answered(answer)))

    def _goes_on_without(self, sensor: Culprit) -> bool:
        """Whether a sensor was just found to be wrong all along: what goes on without it takes over."""
        other = self._check.hand_over(sensor)
        if other is not None:
            self._go_on_by(other)
        return other is not None

    def _go_on_by(self, other: ErrorStateFilter) -> None:
        """Another filter from now on; it has not been told of the gyroscope's bias yet."""
        self.filter = other
        self._base.begin_again()

    def _is_early(self, stamp_s: float) -> bool:
        """Whether it is not known yet where the base starts in the map of the areas."""
        return self._places is not None and stamp_s < self._places.begin_s


# BaseSensors: wheels and gyroscope, as the default filter hears them.


class BaseSensors:
    """Wheels by themselves; and beside them dead reckoning that joins the gyroscope.

    The filter knows the gyroscope's bias; had the wheels used it too, it would count twice. What dead reckoning with it
    tells is whether the gyroscope is to be believed, and what it shows at rest.

    Attributes:
        deaf: why the wheels are not heard, or "".
    """

    def __init__(self, calibration: Calibration, settings: WheelSettings) -> None:
        self._wheels = ByWheels(calibration, settings.model_copy(update={"gyro": False}))
        self._with_gyro = ByWheels(calibration, settings)
        assert calibration.any_wheels is not None  # ByWheels has refused it
        self._times = ReadingTimes(calibration.any_wheels, settings.reading_times)
        self._uses_gyro, self._hears_gyro, self._was_trusted = settings.gyro, False, False
        self.deaf = ""
        self._last_s = -math.inf

    @property
    def hears(self) -> tuple[type[Event], ...]:
        """The types of events that tell anything."""
        return self._with_gyro.hears

    @property
    def warnings(self) -> tuple[str, ...]:
        """What is wrong with the gyroscope, as a sentence."""
        return self._with_gyro.warnings

    @property
    def noise_s(self) -> float:
        """By which the times of readings are uncertain."""
        return self._times.noise_s

    def process(self, reading: WheelReading) -> tuple[WheelEstimate | None, str]:
        """What the wheels tell by themselves, stamped by when they did it, and a note of the gyroscope."""
        self._last_s = reading.stamp_s
        if not isinstance(reading, WheelSpeeds):  # speeds have no ways of their own to find the time by
            reading = replace(reading, stamp_s=self._times.time_of(reading))
        wheels, note = self._wheels.process(reading)
        return wheels, self._with_gyro.process(reading)[1] if self._hears_gyro else note

    def refuse(self, reading: WheelReading) -> None:
        """Take a reading whose stamp is far from all others: its clock leapt, or so long nothing was heard."""
        paused_s = reading.stamp_s - self._last_s
        if 0 < paused_s < math.inf:
            self._wheels.pause(paused_s)
            self._with_gyro.pause(paused_s)

    def hear(self, rate: YawRate) -> bool:
        """Take a yaw rate; whether it counts: the gyroscope is wanted, and has agreed with the wheels."""
        if self._uses_gyro:
            self._hears_gyro = True
            self._with_gyro.process(rate)
        return self._uses_gyro and self._with_gyro.trusts_gyro

    @property
    def uses_gyro(self) -> bool:
        """Whether a gyroscope is wanted."""
        return self._uses_gyro

    def tell(self, rate: YawRate, fusion: ErrorStateFilter) -> None:
        """Tell the filter a yaw rate that counts; before the first, the bias that was found."""
        if not self._was_trusted:
            found = self._with_gyro.odometry
            fusion.update_gyro_bias(rate.stamp_s, found.gyro_bias_rad_s, found.gyro_bias_sigma_rad_s)
        self._was_trusted = True
        fusion.update_yaw_rate(rate.stamp_s, rate.yaw_rate_rad_s)

    def begin_again(self) -> None:
        """Another filter is told from now on: it does not know the bias."""
        self._was_trusted = False
