"""ByFusion: wheels lead, the camera corrects them, and each is told what the other expects."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from wheelsight.calibration import Calibration
from wheelsight.clocks import Untimed
from wheelsight.config import Config
from wheelsight.estimates import CameraEstimate, Estimate, MotionEstimate, Reason, Status
from wheelsight.events import Event, RgbdFrame, SkippedFrame, WheelSpeeds, WheelTicks, YawRate
from wheelsight.fusion import ErrorStateFilter, ErrorStateSettings, FusedEstimate
from wheelsight.geometry import FloatArray
from wheelsight.geometry import motion_kernels as motions
from wheelsight.localizer._anchor import Anchor, is_far
from wheelsight.localizer._base_check import BaseCheck
from wheelsight.localizer._camera import blurred, camera_odometry, mount_of
from wheelsight.localizer._carried import Carried
from wheelsight.localizer._frame_gate import FrameGate
from wheelsight.localizer._pace import Pace
from wheelsight.localizer._place_sense import PlaceSense
from wheelsight.localizer.by_places import Places
from wheelsight.localizer.by_wheels import ByWheels
from wheelsight.odometry.dense import DenseEstimate, DenseOdometry
from wheelsight.odometry.extrinsics import Culprit
from wheelsight.odometry.features import MatchedPixels
from wheelsight.odometry.wheels.reading_times import ReadingTimes
from wheelsight.places import PlaceMatch

# What the filter remembers: the last frame tracked, the anchor of the camera's motions, where it started again.
_FRAME, _ANCHOR, _AGAIN = "frame", "anchor", "again"
# After so many frames in a row that show nothing known, the camera goes on from where the wheels have it.
_RESTART_AFTER = 5
# After so long in the dark a look is believed only where it shows all directions: one that slides along a wall may have
# taken one place for another, and wheels alone do not go astray so soon.
_DARK_S = 1.0
# From here on a base turns: a camera then turns 0.08 % too far against its map, 0.01 % against keyframes (five flats).
_TURNS_RAD_S = 0.1
# So long after a look that was not believed, people may go on to mislead.
_UNCALM_S = 5.0
_BLIND = (Reason.TOO_LITTLE_DEPTH, Reason.FRAME_UNUSABLE, Reason.TOO_FEW_KEYPOINTS)


class ByFusion:
    """Wheel readings and frames answered by the default filter; dense odometry builds its map where all agree.

    With places, the map is that of the areas, and the area that a frame shows is one more measurement.

    Attributes:
        odometry: the camera's.
        filter: what joins it with the wheels.
        mapper: builds a map, where one is asked for.
        T_odom_map: (4, 4) where the map, of the camera and its surfels, lies by now. What the filter knows
            better moves the pose but no surfel, which would tear the map.
    """

    body, frame, answers = "base", "map", (WheelTicks, WheelSpeeds, RgbdFrame, SkippedFrame)

    def __init__(self, calibration: Calibration, settings: Config, places: Places | None = None) -> None:
        self._T_base_camera = mount_of(calibration)
        # The filter knows the gyroscope's bias; had the wheels used it too, it would count twice. Dead reckoning that
        # does goes on beside it: it tells whether the gyroscope is to be believed, and what that shows at rest.
        self._wheels = ByWheels(calibration, settings.wheels.model_copy(update={"gyro": False}))
        self._uses_gyro = settings.wheels.gyro
        self._with_gyro, self._hears_gyro, self._was_trusted = ByWheels(calibration, settings.wheels), False, False
        self.hears: tuple[type[Event], ...] = (*self._with_gyro.hears, RgbdFrame, SkippedFrame)
        self.odometry, self.mapper = camera_odometry(calibration, settings)
        self._places = None if places is None else PlaceSense(places)
        T_start, spread = (None, None) if self._places is None else self._places.start
        begin = (self._T_base_camera, T_start, spread, _settings_of(calibration))
        self.filter = ErrorStateFilter(*begin)
        self._check = BaseCheck(calibration, self._T_base_camera, ErrorStateFilter(*begin))
        self.T_odom_map: FloatArray = np.eye(4)
        self._T_map_camera: FloatArray | None = None  # at the last frame, where that was believed
        self._anchor: Anchor | None = None
        self._carried = Carried()
        self._gate = FrameGate()
        assert calibration.wheels is not None  # ByWheels has refused it
        self._times = ReadingTimes(calibration.wheels)
        self._pace = Pace()
        self._unknown, self._deaf, self._slips = 0, "", False
        self._seen_s = self._unbelieved_s = -np.inf

    @property
    def last_matches(self) -> MatchedPixels | None:
        """What the last frame was aligned by; dense odometry matches no pixels."""
        return None if isinstance(self.odometry, DenseOdometry) else self.odometry.last_matches

    @property
    def stage_seconds(self) -> dict[str, float]:
        """How long each stage of the last frame took."""
        return self.odometry.stage_seconds | ({} if self._places is None else self._places.stage_seconds)

    @property
    def warnings(self) -> tuple[str, ...]:
        """What is wrong with the gyroscope, or with what the calibration says, as a sentence each."""
        return (*self._with_gyro.warnings, *self._check.warnings)

    @property
    def last_place(self) -> PlaceMatch | None:
        """What the model of places said of the last frame, where there is one and it was asked."""
        return None if self._places is None else self._places.last_place

    def process(self, event: Event) -> tuple[Estimate | None, str]:
        """The estimate right after a reading or frame, None at any other event, and what was wrong with a frame."""
        if self.mapper is not None:
            self.mapper.last_fused = None
        if isinstance(event, YawRate) and self._uses_gyro:
            self._turn(event)
        if isinstance(event, WheelTicks | WheelSpeeds):
            return self._reading(event)
        if not isinstance(event, RgbdFrame | SkippedFrame):
            return None, ""
        if self._places is not None:
            self._places.forget()
        if self._is_early(event.stamp_s):
            note = event.reason if isinstance(event, SkippedFrame) else ""
            return Estimate(event.stamp_s, Status.INITIALIZING, body=self.body), note
        if isinstance(event, SkippedFrame):
            return self._miss(event.stamp_s), event.reason
        if self._check.left_out is Culprit.CAMERA:
            return self._overlook(event), ""
        expected = self.filter.expect(event.stamp_s, _FRAME)
        why_not = self._gate.why_not(event, None if expected is None else expected[0])
        if why_not is not None:
            return self._repeated() if why_not.is_repeat else self._miss(event.stamp_s), why_not.note
        if self._gate.waits_for_wheels(event):
            return Estimate(event.stamp_s, Status.INITIALIZING, body=self.body), ""
        self._check.look(event)
        answer = self._frame(event, self._expected(event.stamp_s, expected and expected[0]))
        self._lead(answer)
        return self._checked(self._placed(event, answer)), self._deaf

    def refuse(self, event: Event, why: Untimed) -> tuple[Estimate | None, str]:
        """What is known, at an event whose stamp means nothing; None at a yaw rate."""
        if self.mapper is not None:
            self.mapper.last_fused = None
        if isinstance(event, YawRate):
            return None, ""
        if isinstance(event, WheelTicks | WheelSpeeds) and why.reason is Reason.CLOCKS_APART:
            self._deaf = f"the wheels are not heard: {why.note}"
        known, reason = self.filter.estimate, why.reason
        if reason is Reason.CLOCKS_APART and known.status is Status.TRACKING:
            # Until it is settled whose clock leapt, the base moves on unseen.
            return replace(known, reason=reason, status=Status.COASTING), why.note
        if isinstance(event, RgbdFrame | SkippedFrame) and reason is not Reason.CLOCKS_APART:
            reason = Reason.FRAME_UNUSABLE
        return replace(known, reason=reason), why.note

    def _lead(self, answer: FusedEstimate) -> None:
        """Who is asked what to expect of the next frame: the wheels or, where these slip, the last motion; and the map.

        What slips expects what is not so. The map shows it best wherever hardly anything lies beyond its end, while
        the base goes straight; else keyframes do. They reach as far as the camera sees, and in a turn they have whole
        what the map has learned from a frame or two; but whom they show may walk on, so for a while after a look was
        not believed the map leads in turns too, unless it turns out that the wheels slip.
        """
        self._slips = answer.slip
        if answer.slip:
            self._unbelieved_s = -np.inf
        elif answer.reason is not None or answer.doubtful:
            self._unbelieved_s = answer.stamp_s
        if self.mapper is not None:
            turns = answer.twist is None or abs(answer.twist[2]) > _TURNS_RAD_S
            is_calm = answer.stamp_s - self._unbelieved_s > _UNCALM_S
            self.mapper.track_map(self.mapper.shows_most and not (turns and is_calm))

    def _expected(self, stamp_s: float, by_wheels: FloatArray | None) -> tuple[FloatArray | None, ...]:
        """The camera's motion since the last frame; and what it may be instead, for wheels that slip may grip again."""
        if self._check.doubts_wheels:
            return (None,)
        if not self._slips:
            return (by_wheels,)
        by_pace = self._pace.expect(stamp_s)
        return (by_pace, by_wheels) if isinstance(self.odometry, DenseOdometry) else (by_pace,)

    def _reading(self, reading: WheelTicks | WheelSpeeds) -> tuple[Estimate | None, str]:
        if isinstance(reading, WheelTicks):  # speeds have no ways of their own to tell the time by
            reading = replace(reading, stamp_s=self._times.time_of(reading))
        wheels, note = self._wheels.process(reading)
        note = self._with_gyro.process(reading)[1] if self._hears_gyro else note
        if wheels is not None and self._is_early(wheels.stamp_s):
            return Estimate(wheels.stamp_s, Status.INITIALIZING, body=self.body), note
        self._gate.wheels_are_heard = True
        if wheels is None:
            return None, note
        self._check.hear(wheels)
        if self._check.left_out is Culprit.CAMERA and self._check.by_wheels is not None:
            self._go_on_by(self._check.wheels_alone())
            return self.filter.estimate, note
        if self._check.left_out is Culprit.WHEELS and self._check.by_wheels is None:
            return self.filter.drop(wheels.stamp_s, ""), note  # the camera's speed carries the pose on
        answer = self.filter.predict_to(wheels)
        self._deaf = f"the wheels are not heard: {answer.reason}" if answer.reason is Reason.TOO_LATE else ""
        return self._checked(answer), note

    def _go_on_by(self, other: ErrorStateFilter) -> None:
        """Another filter from now on; it has not been told of the gyroscope's bias yet."""
        self.filter, self._was_trusted = other, False

    def _checked(self, answer: FusedEstimate) -> FusedEstimate:
        """What the filter answers, by what it cannot know."""
        return self._carried.answered(self._check.answered(answer))

    def _turn(self, rate: YawRate) -> None:
        """A gyroscope counts once it has agreed with the wheels, and then with the bias it was found to have."""
        self._hears_gyro = True
        self._with_gyro.process(rate)
        self._check.turn(rate.stamp_s, rate.yaw_rate_rad_s)
        if not self._with_gyro.trusts_gyro or self._is_early(rate.stamp_s):
            return
        if not self._was_trusted:
            found = self._with_gyro.odometry
            self.filter.update_gyro_bias(rate.stamp_s, found.gyro_bias_rad_s, found.gyro_bias_sigma_rad_s)
        self._was_trusted = True
        self.filter.update_yaw_rate(rate.stamp_s, rate.yaw_rate_rad_s)

    def _is_early(self, stamp_s: float) -> bool:
        """Whether it is not known yet where the base starts in the map of the areas."""
        return self._places is not None and stamp_s < self._places.begin_s

    def _placed(self, frame: RgbdFrame, answer: FusedEstimate) -> FusedEstimate:
        """The answer after the area that the frame shows; where the camera was believed, its map comes along."""
        if self._places is None:
            return answer
        placed = self._places.tell(frame, answer, self.filter)
        self._lay_map()
        return placed

    def _frame(self, frame: RgbdFrame, expected: tuple[FloatArray | None, ...]) -> FusedEstimate:
        """Look, judge, and remember what was believed."""
        self._T_map_camera = None
        twist = self._camera_twist()
        seen = self._seen(self.odometry.process(frame, *expected, twist=twist))
        if seen.T_odom_body is None:
            return self._unseen(frame, seen)
        self._pace.tell(frame.stamp_s, seen.T_odom_body)
        if self._anchor is None:
            return self._begun(frame, seen)
        self._check.see(frame, seen, shows_all=self._motion(seen).shows_all)
        if self._check.left_out is Culprit.WHEELS and self._check.by_wheels is not None:
            self._go_on_by(self._check.camera_alone())
            return self._begun(frame, seen)
        motion = self._anchor.motion_to(seen.T_odom_body, self._motion(seen))
        motion = blurred(motion, twist, self._times.noise_s)
        if frame.stamp_s - self._seen_s > _DARK_S and not motion.shows_all:
            return self._unseen(frame, replace(seen, reason=Reason.DEGENERATE), restarts=True)
        answer = self.filter.update_relative(frame.stamp_s, motion, _ANCHOR, remember=_FRAME)
        self._unknown = 0
        self._carried.known()
        is_believed = answer.reason is None and not answer.doubtful
        if is_believed:
            self._believe(frame, answer, seen.T_odom_body)
        # One mistake of the camera is none of the next frame's, and slip is told by contradicting again and again.
        if not is_believed or is_far(motion):
            self._anchor_at(frame, seen, seen.T_odom_body)
        return answer

    def _seen(self, seen: Estimate) -> Estimate:
        """What the camera came to; who builds the map is told of the frame."""
        if self.mapper is not None and isinstance(seen, DenseEstimate):
            self.mapper.tracked = seen.frame
        return seen

    def _motion(self, seen: Estimate) -> MotionEstimate:
        """The camera's, against its reference; feature odometry tells it beside its answer."""
        return seen.motion if isinstance(seen, CameraEstimate) else self.odometry.last_motion  # type: ignore[union-attr]

    def _camera_twist(self) -> FloatArray | None:
        """The camera's velocity (6,) in its own frame by the wheels; None where they slip or tell nothing."""
        twist = None if self._slips else self.filter.estimate.twist
        if twist is None:
            return None
        of_base = np.array([*twist[:2], 0.0, 0.0, 0.0, twist[2]])
        return np.asarray(motions.inverse_adjoint(self._T_base_camera) @ of_base)

    def _believe(self, frame: RgbdFrame, answer: FusedEstimate, T_map_camera: FloatArray) -> None:
        """Camera odometry goes on in the map, of which the filter knows where it lies."""
        if answer.T_odom_body is None or answer.status is not Status.TRACKING:
            return
        self._T_map_camera, self._seen_s = T_map_camera, frame.stamp_s
        self._lay_map()
        if self.mapper is not None:
            self.mapper.fuse(frame, T_map_camera)

    def _lay_map(self) -> None:
        """To where the camera's pose in it is the one that is known of its frame by now."""
        T_odom_base = self.filter.remembered(_FRAME)
        if self._T_map_camera is not None and T_odom_base is not None:
            T_odom_camera = motions.times(T_odom_base, self._T_base_camera)
            self.T_odom_map = motions.mended(motions.times(T_odom_camera, motions.inverse(self._T_map_camera)))

    def _anchor_at(self, frame: RgbdFrame, seen: Estimate, T_map_camera: FloatArray) -> None:
        """From here on the camera's motions are told against this frame."""
        self._anchor = Anchor.at(T_map_camera, self._motion(seen))
        self.filter.clone(frame.stamp_s, _ANCHOR, self._anchor.covariance)

    def _begun(self, frame: RgbdFrame, seen: Estimate, reason: Reason | None = None) -> FusedEstimate:
        """The answer at a frame at which the camera starts, where the wheels have it."""
        assert seen.T_odom_body is not None
        answer = self.filter.clone(frame.stamp_s, _FRAME)
        self._T_map_camera, self._seen_s = seen.T_odom_body, frame.stamp_s
        self._lay_map()
        self._check.begin(frame, seen, self.T_odom_map)
        self._anchor_at(frame, seen, seen.T_odom_body)
        return replace(answer, reason=reason or answer.reason, matches=seen.matches, inliers=seen.inliers)

    def _in_map(self, T_odom_base: FloatArray) -> FloatArray:
        T_map_base = motions.times(motions.inverse(self.T_odom_map), T_odom_base)
        return np.asarray(motions.mended(motions.times(T_map_base, self._T_base_camera)))

    def _unseen(self, frame: RgbdFrame, seen: Estimate, *, restarts: bool = False) -> FusedEstimate:
        """The wheels' pose; if it `restarts`, or after some frames that show nothing known, the camera starts there."""
        nothing = MotionEstimate.failed(seen.reason or Reason.INVALID, seen.matches, seen.inliers)
        answer = self.filter.update_relative(frame.stamp_s, nothing, _ANCHOR)
        if seen.reason not in _BLIND:
            self._unknown += 1
            self._suspect(frame.stamp_s, answer)
        if (restarts or self._unknown >= _RESTART_AFTER) and answer.covariance is not None:
            self._unknown = 0
            # Where the frame was taken: it may have come late, by its stamp and beside it.
            self.filter.clone(frame.stamp_s, _AGAIN)
            T_odom_base = self.filter.remembered(_AGAIN)
            assert T_odom_base is not None
            if self._carried.is_so:
                spread = self._carried.scatter(T_odom_base, answer.covariance)
                begin = (self._T_base_camera, T_odom_base, spread, self.filter.settings)
                self._go_on_by(ErrorStateFilter(*begin))
            again = self._seen(self.odometry.restart(frame, self._in_map(T_odom_base), answer.covariance))
            if again.T_odom_body is not None:
                return self._begun(frame, again, seen.reason)
        return answer

    def _suspect(self, stamp_s: float, wheels: FusedEstimate) -> None:
        """An unknown view right after the dark: wheels that stood meanwhile do not know whether they were carried."""
        dark_s, expected = stamp_s - self._seen_s, self.filter.expect(stamp_s, _FRAME)
        if self._unknown == 1 and dark_s > _DARK_S and wheels.T_odom_body is not None:
            self._carried.unknown(dark_s, None if expected is None else expected[0], wheels.T_odom_body)

    def _repeated(self) -> Estimate:
        """What is known, at an image that has come before: neither a look nor a failure of the camera."""
        return replace(self.filter.estimate, reason=Reason.REPEATED)

    def _overlook(self, frame: RgbdFrame) -> Estimate:
        """The wheels' answer at a frame of a camera whose motions are known to be wrong; it may show an area."""
        self._T_map_camera = None
        nothing = MotionEstimate.failed(Reason.CONTRADICTION)
        return self._placed(frame, self.filter.update_relative(frame.stamp_s, nothing, _ANCHOR))

    def _miss(self, stamp_s: float) -> Estimate:
        """The answer at a frame that came to nothing before anyone could look at it."""
        seen = self._seen(self.odometry.miss(stamp_s))
        nothing = MotionEstimate.failed(Reason.FRAME_UNUSABLE, seen.matches, seen.inliers)
        return self.filter.update_relative(stamp_s, nothing, _ANCHOR)


def _settings_of(calibration: Calibration) -> ErrorStateSettings:
    """The filter's own, with what the calibration tells of the gyroscope."""
    gyro = calibration.gyro
    return ErrorStateSettings(
        gyro_noise_rad_per_sqrt_s=gyro.noise_rad_per_sqrt_s,
        gyro_bias_rad_s=gyro.bias_rad_s,
        gyro_bias_sigma_rad_s=gyro.bias_sigma_rad_s,
        gyro_bias_walk_rad_s=gyro.bias_walk_rad_s_per_sqrt_s,
    )
