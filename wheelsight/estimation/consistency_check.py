"""BaseCheck: tests over the first metres whether wheels and camera agree, and decides which sensor to leave out.
SecondCheck repeats the test for a camera that was left out.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Collection, Iterator
from dataclasses import dataclass, replace
from heapq import nlargest

import numpy as np

from wheelsight.core.calibration import Calibration
from wheelsight.core.calibration_parts import HolonomicWheels, Wheels
from wheelsight.core.estimates import Estimate, FusedEstimate, Reason, WheelEstimate
from wheelsight.core.geometry import FloatArray, interpolate_at
from wheelsight.core.geometry import motion_kernels as motions
from wheelsight.core.messages import RgbdFrame
from wheelsight.core.settings import BaseCheckSettings, ColorCheckSettings
from wheelsight.estimation.camera_localizer import CameraOdometry
from wheelsight.estimation.color_delay import ColorCheck
from wheelsight.estimation.fault_detection import covering_pose
from wheelsight.estimation.filter import ErrorStateFilter
from wheelsight.vision.extrinsics import (
    Agreement,
    AgreementSettings,
    Culprit,
    Explanation,
    ExtrinsicsSettings,
    FloorSettings,
    depth_cause,
    height_below,
)

# BaseCheck: over the first metres of a joined run, whether wheels and camera tell of one drive; else who is left out.
#
# A calibration that is wrong, by a depth's factor, a mount, ticks a turn or wheels that are swapped, contradicts the
# other sensor all along, by far more than a filter may allow for errors of sensors. So both motions are compared as
# `calibrate base` does. Until something is found, the filter's answers stand as they are. Something that is likely
# makes the answer that of the other sensor, or one that covers both; something that is sure leaves the sensor out.


class BaseCheck:
    """Compares as frames and readings come.

    Args:
        calibration: with wheels and mount.
        T_base_camera: (4, 4), rigid.
        by_wheels: a filter that begins as the one that joins both; it hears the wheels alone.
        settings: how much must be compared; of None, the defaults.
        of_color: how late colour is told; of None, the defaults.
        of_mount: how both motions are compared, and the floor is told; of None, the defaults.

    Attributes:
        by_wheels: see above; None once both are known to tell of one drive, or who is left out has been.
    """

    def __init__(
        self,
        calibration: Calibration,
        T_base_camera: FloatArray,
        by_wheels: ErrorStateFilter,
        settings: BaseCheckSettings | None = None,
        of_color: ColorCheckSettings | None = None,
        of_mount: ExtrinsicsSettings | None = None,
    ) -> None:
        assert calibration.any_wheels is not None
        self.settings = of = settings or BaseCheckSettings()
        mount = of_mount or ExtrinsicsSettings()
        self.by_wheels: ErrorStateFilter | None = by_wheels
        self._sigmas = by_wheels.settings.covered_sigmas
        self._wheels = WheelPoses(of.kept_s, of.gyro_after_s)
        self._camera = CameraPoses(T_base_camera, of.waiting_frames)
        self._floor = FloorViews(calibration, T_base_camera, of, mount.floor)
        self._pieces = Pieces(calibration.any_wheels, T_base_camera, mount.agreement)
        self._colors = ColorCheck(of_color)
        self._verdict = Verdict(of)

    @property
    def left_out(self) -> Culprit | None:
        """Whose motions are left out from now on, or None."""
        return self._verdict.left_out

    @property
    def has_agreed(self) -> bool:
        """Whether both are known to tell of one drive, and colour goes with its depth as far as is known."""
        return self._verdict.has_agreed and self.left_out is None and not self._colors.late

    @property
    def suspects_wheels(self) -> bool:
        """Whether the wheels may be wrong so that the camera had better not expect what they tell."""
        return any(one.culprit is Culprit.WHEELS for one in self._verdict.found)

    @property
    def agreement(self) -> Agreement:
        """What all that was compared comes to."""
        return self._pieces.agreement

    @property
    def warnings(self) -> tuple[str, ...]:
        """What contradicts what, why, and what to do, as a sentence."""
        return self._verdict.warnings

    def hear(self, wheels: WheelEstimate) -> None:
        """Take what the wheels came to, which may be that a reading was refused."""
        if self.by_wheels is None:
            return
        self.by_wheels.predict_to(wheels)
        T, stamp_s = wheels.T_odom_body, wheels.stamp_s
        if T is None or wheels.reason is not None or not np.isfinite(T).all():
            self._pieces.interrupt()
            self._wheels.forget()
            return
        way_m = 0.0 if wheels.step is None else float(np.linalg.norm(wheels.step.T_before_now[:3, 3]))
        if not self._wheels.add(stamp_s, T, way_m):
            self._pieces.interrupt()
        self._colors.hear(stamp_s, float(np.arctan2(T[1, 0], T[0, 0])))
        for told_s, T_map_base in self._camera.until(stamp_s):
            self._compare(told_s, T_map_base)
        self._leave_out_blind()

    def turn(self, stamp_s: float, yaw_rate_rad_s: float) -> None:
        """Take a reading of a gyroscope, the mean since its last one."""
        if self.by_wheels is not None:
            self._wheels.turn(stamp_s, yaw_rate_rad_s)

    def begin(self, frame: RgbdFrame, seen: Estimate, T_odom_map: FloatArray) -> None:
        """The camera begins, or begins again, at a frame; its map lies at `T_odom_map` (4, 4)."""
        self._pieces.interrupt()
        self._camera.begin(T_odom_map)
        if self.by_wheels is not None:
            self._camera.add(frame.stamp_s, seen, shows_all=True)

    def moved(self, T_new_old: FloatArray) -> None:
        """Loops have moved the camera's map by (4, 4), from the left: what comes is no motion since what came."""
        self._pieces.interrupt()
        self._camera.moved(T_new_old)

    def see(self, frame: RgbdFrame, seen: Estimate, *, shows_all: bool) -> None:
        """Take a frame that was tracked, T_map_camera, and whether it shows all directions."""
        self._camera.tracked += 1
        if self.by_wheels is not None:
            self._camera.add(frame.stamp_s, seen, shows_all=shows_all)

    def look(self, frame: RgbdFrame) -> None:
        """See how colour and depth go together, and how far below the camera the floor lies."""
        if self.by_wheels is None:
            return
        self._camera.frames += 1
        self._colors.see(frame)
        if self._colors.is_sure and self.left_out is None:
            self._verdict.leave_out_late_color(self._colors.late)
        self._stop_if_sound()
        self._floor.look(frame)

    def answered(self, answer: FusedEstimate) -> FusedEstimate:
        """The answer as it stands, or as it must be while it is likely that a sensor is wrong."""
        if self.by_wheels is None:
            return answer
        by_wheels = self.by_wheels.estimate
        found = self._verdict.found or ([late_color(self._colors.late)] if self._colors.late else [])
        if by_wheels.T_odom_body is None or by_wheels.covariance is None:
            return answer
        if (not found and self._verdict.has_agreed) or answer.stamp_s - by_wheels.stamp_s > self.settings.silent_s:
            return answer
        if not found:
            return replace(by_wheels, reason=answer.reason) if self._is_floor_off else self._covered(answer)
        seen = self._camera.seen
        culprits = {one.culprit for one in found}
        return answer if seen is None else doubted(answer, by_wheels, seen, culprits, self._sigmas)

    @property
    def is_without_wheels(self) -> bool:
        """Whether the wheels are left out, and what goes on without them has been handed over."""
        return self.left_out is Culprit.WHEELS and self.by_wheels is None

    def hand_over(self, left_out: Culprit) -> ErrorStateFilter | None:
        """Once, what goes on without a sensor that has been left out; None before and after, and for the other one."""
        wheels = self.by_wheels
        if self.left_out is not left_out or wheels is None:
            return None
        self.by_wheels = None
        if left_out is Culprit.CAMERA:
            return wheels
        seen = self._camera.seen
        assert seen is not None
        return wheels.begun_at(seen.T, seen.covariance)

    def readmit(self) -> None:
        """Who has been left out, and handed over, agrees again: nobody is left out any more."""
        self._verdict = Verdict(self.settings)

    @property
    def _is_floor_off(self) -> bool:
        """Whether the floor that was seen is so far off that the camera waits until its ways are known to be right."""
        ratio, of = self._floor.ratio, self.settings
        is_off = ratio is not None and abs(np.log(ratio)) > np.log(of.floor_factor)
        return bool(is_off and self.agreement.way_m < of.agreed_m)

    def _compare(self, stamp_s: float, T_map_base: FloatArray | None) -> None:
        """What wheels and camera made of the time since the piece began, up to a frame; None if that hid directions."""
        if T_map_base is None:
            self._pieces.skip()
            return
        T_odom_base, verdict = self._wheels.at(stamp_s), self._verdict
        if T_odom_base is None or verdict.has_agreed or verdict.left_out is not None:
            return
        if self._pieces.add(stamp_s, T_odom_base, T_map_base, self._wheels.turned_between):
            if not verdict.judge(self.agreement, self._floor.ratio):
                self._pieces.agree()
            self._stop_if_sound()

    def _covered(self, answer: FusedEstimate) -> FusedEstimate:
        """The answer to a frame, less certain by what both have gone apart since they were last known to agree."""
        newest, T_odom_base = self._camera.newest, self._wheels.newest
        if newest is None or newest[0] != answer.stamp_s or T_odom_base is None:
            return answer
        told = self._wheels.at(answer.stamp_s)
        apart = self._pieces.apart(T_odom_base if told is None else told, newest[1])
        return answer if apart is None else covered(answer, apart, self._sigmas)

    def _leave_out_blind(self) -> None:
        """A camera that shows the floor elsewhere, and is hardly ever tracked, is left out."""
        of, camera = self.settings, self._camera
        is_blind = camera.tracked < of.blind_share * camera.frames and self._wheels.way_m > of.blind_m
        if is_blind and self.left_out is None and self._is_floor_off:
            ratio = self._floor.ratio
            assert ratio is not None
            self._verdict.leave_out_blind(ratio)

    def _stop_if_sound(self) -> None:
        """Nobody is left out once all that is compared goes together."""
        if self._verdict.has_agreed and self._colors.is_sound:
            self.by_wheels = None


def doubted(
    answer: FusedEstimate, by_wheels: FusedEstimate, seen: BasePose, culprits: Collection[Culprit], sigmas: float
) -> FusedEstimate:
    """The answer that covers wheels and camera; it is where those are who are not accused.

    Args:
        answer: of the filter that joins both.
        by_wheels: of the one that hears the wheels alone; it has a pose.
        seen: where the camera alone has the base.
        culprits: who may be wrong.
        sigmas: at how many standard deviations the other pose lies.
    """
    assert by_wheels.T_odom_body is not None
    assert by_wheels.covariance is not None
    reason = answer.reason or Reason.CONTRADICTION
    first, second = (by_wheels.T_odom_body, by_wheels.covariance), (seen.T, seen.covariance)
    if set(culprits) == {Culprit.WHEELS}:
        first, second = second, first
    T, C = covering_pose(*first, *second, sigmas)
    return replace(by_wheels, T_odom_body=T, covariance=C, doubtful=True, slip=False, reason=reason)


def covered(answer: FusedEstimate, T_wheels_camera: FloatArray, sigmas: float) -> FusedEstimate:
    """The answer to a frame, less certain by what wheels and camera have gone apart (4, 4)."""
    if answer.T_odom_body is None or answer.covariance is None:
        return answer
    other = motions.times(answer.T_odom_body, T_wheels_camera)
    _, C = covering_pose(answer.T_odom_body, answer.covariance, motions.mended(other), np.zeros((6, 6)), sigmas)
    return replace(answer, covariance=C)


# SecondCheck: a camera that was left out is compared with the wheels again, so that it is left out for no longer than
# they contradict each other.
#
# What looked like a wrong calibration over the first metres may have been people, slip, or a wall. The camera's
# motion is followed apart, without any help of the wheels and without a map, until it agrees with them as at the
# beginning.


class SecondCheck:
    """See the module.

    Args:
        new_check: makes a comparison that knows nothing yet.
        new_camera: makes odometry likewise.
        restart_after: so many frames in a row that cannot be tracked end it.
    """

    def __init__(
        self,
        new_check: Callable[[], BaseCheck],
        new_camera: Callable[[], CameraOdometry],
        restart_after: int,
    ) -> None:
        self._new_check, self._new_camera, self._restart_after = new_check, new_camera, restart_after
        self._check: BaseCheck | None = None
        self._camera: CameraOdometry | None = None
        self._begins, self._failed = True, 0

    def hear(self, wheels: WheelEstimate) -> None:
        """Take what the wheels came to; heard once a frame was looked at."""
        if self._check is not None:
            self._check.hear(wheels)

    def agrees(self, frame: RgbdFrame) -> bool:
        """Take a frame, newer than the one before; whether wheels and camera tell of one drive by now."""
        check = self._going_on()
        most = check.settings.again_keyframes
        if self._camera is None or self._failed >= self._restart_after or len(self._camera.store) > most:
            self._camera, self._begins, self._failed = self._new_camera(), True, 0
        seen = self._camera.process(frame)
        check.look(frame)
        if seen.T_odom_body is None:
            self._failed += 1
            return False
        self._failed = 0
        if self._begins:
            check.begin(frame, seen, np.eye(4))
            self._begins = False
        check.see(frame, seen, shows_all=seen.motion.shows_all)
        return check.has_agreed

    def _going_on(self) -> BaseCheck:
        """The comparison that goes on; another one after a verdict, or a long way without."""
        check = self._check
        if check is None or check.left_out is not None or self._is_old(check):
            check, self._begins = self._new_check(), True
            self._check = check
        return check

    def _is_old(self, check: BaseCheck) -> bool:
        of = check.settings
        return check.agreement.way_m > of.again_ways * of.enough_m


# Verdict: what contradicts what, how sure that is, and who is left out for it.


class Verdict:
    """Judges as pieces come.

    Args:
        settings: how much it takes.

    Attributes:
        found: what explains the contradiction, as far as that is likely.
        is_sure: whether one of these surely is so.
        left_out: whose motions are left out from now on, or None.
        has_agreed: whether both are known to tell of one drive.
    """

    def __init__(self, settings: BaseCheckSettings) -> None:
        self.found: list[Explanation] = []
        self.is_sure = self.has_agreed = False
        self.left_out: Culprit | None = None
        self._settings = settings

    @property
    def warnings(self) -> tuple[str, ...]:
        """What contradicts what, why, and what to do, as a sentence."""
        if not self.is_sure:
            return ()
        causes = [" or ".join(_causes(self.found, who)) for who in Culprit]
        if self.left_out is None:
            told = f"either the wheels' fault ({causes[0]}) or the camera's ({causes[1]})"
            return (f"Wheels and camera contradict each other all along: {told}. The answer covers both.",)
        whose = "the camera's: " if self.left_out is Culprit.CAMERA else "the wheels': "
        other = "the wheels" if self.left_out is Culprit.CAMERA else "the camera"
        cause = causes[list(Culprit).index(self.left_out)]
        return (
            f"Wheels and camera contradict each other all along, and the fault is {whose}{cause}. "
            f"The answer is by {other} alone.",
        )

    def judge(self, agreement: Agreement, floor_ratio: float | None) -> bool:
        """Weigh all pieces, and the floor; False where nothing contradicts anything."""
        told = agreement.explanations(floor_ratio, is_accused=bool(self.found))
        self.found = [one for one in told if self._is_likely(one, agreement)]
        self.is_sure = bool(self.found) and all(self._is_surely(one, agreement) for one in self.found)
        if self.is_sure and len({one.culprit for one in self.found}) == 1:
            self.left_out = self.found[0].culprit
        is_enough = agreement.way_m > self._settings.enough_m and agreement.turn_rad > self._settings.enough_rad
        if not self.found and is_enough and agreement.agrees():
            self.has_agreed = True
        return bool(told)

    def leave_out_late_color(self, late_frames: int) -> None:
        """Colour surely is later than its depth: the camera is left out."""
        self.found, self.is_sure, self.left_out = [late_color(late_frames)], True, Culprit.CAMERA

    def leave_out_blind(self, floor_ratio: float) -> None:
        """A camera that shows the floor elsewhere, and cannot be followed, is left out without its ways."""
        cause = f"{depth_cause(floor_ratio)}, or the height in T_base_camera"
        self.found = [Explanation(Culprit.CAMERA, cause, np.zeros((6, 2)), True, floor_ratio)]
        self.is_sure, self.left_out = True, Culprit.CAMERA

    def _is_likely(self, one: Explanation, agreement: Agreement) -> bool:
        if not one.is_scale:
            return True
        apart_m, apart_rad = np.ptp(agreement.ways_m), np.ptp(agreement.turns_rad)
        return bool(apart_m > self._settings.likely_m or apart_rad > self._settings.likely_rad)

    def _is_surely(self, one: Explanation, agreement: Agreement) -> bool:
        of, slips = self._settings, one.is_scale and one.culprit is Culprit.WHEELS
        way_m, turn_rad = (of.sure_slip_m, of.sure_slip_rad) if slips else (of.sure_m, of.sure_rad)
        return agreement.pieces >= of.sure_pieces and (agreement.way_m > way_m or agreement.turn_rad > turn_rad)


def late_color(late_frames: int) -> Explanation:
    """Colour that is later than its depth by so many frames."""
    frames = "a frame" if late_frames == 1 else f"{late_frames} frames"
    cause = f"its colour images are {frames} later than the depth that they come with: pair them by their stamps"
    return Explanation(Culprit.CAMERA, cause, np.zeros((6, 2)))


def _causes(found: list[Explanation], whose: Culprit) -> list[str]:
    return list(dict.fromkeys(one.cause for one in found if one.culprit is whose))


# Pieces: a drive by wheels and by camera, cut into pieces and summed up.


class Pieces:
    """Compares both motions from where a piece began.

    Args:
        wheels: of the robot.
        T_base_camera: (4, 4), rigid.
        settings: how long a piece is, and when both agree.

    Attributes:
        agreement: what all pieces come to.
    """

    def __init__(
        self, wheels: Wheels | HolonomicWheels, T_base_camera: FloatArray, settings: AgreementSettings
    ) -> None:
        self.agreement = Agreement(wheels, T_base_camera, settings)
        # Stamp, T_odom_base and T_map_base where a piece begins; and where both were last known to go together.
        self._begin: tuple[float, FloatArray, FloatArray] | None = None
        self._together: tuple[float, FloatArray, FloatArray] | None = None

    def interrupt(self) -> None:
        """What comes does not go on from what came."""
        self._begin = self._together = None

    def skip(self) -> None:
        """A view hid directions: there the camera tells what others expected, and no piece goes on across that."""
        self._begin = None

    def add(
        self,
        stamp_s: float,
        T_odom_base: FloatArray,
        T_map_base: FloatArray,
        turned_between: Callable[[float, float], float | None],
    ) -> bool:
        """Take where both have the base; True where a piece ends. The gyroscope is asked how it turned meanwhile."""
        now = (stamp_s, T_odom_base, T_map_base)
        self._together = self._together or now
        if self._begin is None:
            self._begin = now
            return False
        begin_s, T_odom_begin, T_map_begin = self._begin
        by_wheels = motions.times(motions.inverse(T_odom_begin), T_odom_base)
        by_camera = motions.times(motions.inverse(T_map_begin), T_map_base)
        if not self.agreement.add(by_wheels, motions.mended(by_camera), turned_between(begin_s, stamp_s)):
            return False
        self._begin = now
        return True

    def agree(self) -> None:
        """Nothing contradicts anything, up to where the last piece ended."""
        self._together = self._begin

    def apart(self, T_odom_base: FloatArray, T_map_base: FloatArray) -> FloatArray | None:
        """T_wheels_camera (4, 4): by what both have gone apart since they agreed; None where they never did."""
        if self._together is None:
            return None
        _, T_odom_begin, T_map_begin = self._together
        by_wheels = motions.times(motions.inverse(T_odom_begin), T_odom_base)
        by_camera = motions.times(motions.inverse(T_map_begin), T_map_base)
        return motions.times(motions.inverse(by_wheels), by_camera)


# CameraPoses: where the camera alone has the base, and frames that wait for the wheels to be compared.


@dataclass(frozen=True, slots=True, eq=False)
class BasePose:
    """Of the base, by the camera alone: T_odom_base (4, 4) and its covariance (6, 6)."""

    T: FloatArray
    covariance: FloatArray


class CameraPoses:
    """Poses of a camera as they come.

    Args:
        T_base_camera: (4, 4), rigid.
        most_waiting: frames, at most, that wait for wheels which are not heard.

    Attributes:
        seen: where the base is by the last frame that was tracked.
        newest: stamp and T_map_base (4, 4) of the last one that showed all directions.
        frames, tracked: how many came, and how many of these could be tracked.
    """

    def __init__(self, T_base_camera: FloatArray, most_waiting: int) -> None:
        self.seen: BasePose | None = None
        self.newest: tuple[float, FloatArray] | None = None
        self.frames = self.tracked = 0
        self._T_camera_base = motions.inverse(T_base_camera)
        self._T_odom_map: FloatArray | None = None
        # Those whose time no reading has come to yet; of wheels that are not heard, the last ones.
        self._waiting: deque[tuple[float, FloatArray | None]] = deque(maxlen=most_waiting)

    def begin(self, T_odom_map: FloatArray) -> None:
        """The camera begins, or begins again: frames before tell nothing of those after. Its first map counts."""
        self._waiting.clear()
        if self._T_odom_map is None:
            self._T_odom_map = T_odom_map.copy()

    def add(self, stamp_s: float, seen: Estimate, *, shows_all: bool) -> None:
        """Take where a frame shows the camera, T_map_camera, and whether it shows all directions."""
        if self._T_odom_map is None or seen.T_odom_body is None:
            return
        T_map_base = motions.times(seen.T_odom_body, self._T_camera_base)
        C = np.zeros((6, 6)) if seen.covariance is None else motions.carried(self._T_odom_map, seen.covariance)
        self.seen = BasePose(motions.mended(motions.times(self._T_odom_map, T_map_base)), C)
        if shows_all:
            self.newest = stamp_s, T_map_base
        self._waiting.append((stamp_s, T_map_base if shows_all else None))

    def moved(self, T_new_old: FloatArray) -> None:
        """The map has moved by (4, 4), from the left, where the camera is; frames that wait are of the one before."""
        self._waiting.clear()
        self.newest = None
        if self._T_odom_map is not None:
            self._T_odom_map = motions.times(self._T_odom_map, motions.inverse(T_new_old))

    def until(self, stamp_s: float) -> Iterator[tuple[float, FloatArray | None]]:
        """Stamp and T_map_base (4, 4) of the frames up to a stamp that waited, and wait no longer.

        None in place of the pose of one that did not show all directions.
        """
        while self._waiting and self._waiting[0][0] <= stamp_s:
            yield self._waiting.popleft()


# WheelPoses: where the wheels alone had the base in the last seconds, and how a gyroscope turned meanwhile.


class WheelPoses:
    """Poses T_odom_base (4, 4) as they come.

    Args:
        kept_s: how long they are kept.
        gyro_after_s: how old the gyroscope's last reading may be when a turn is asked for.

    Attributes:
        way_m: how far the wheels rolled until now.
    """

    def __init__(self, kept_s: float, gyro_after_s: float) -> None:
        self.way_m = 0.0
        self._kept_s, self._gyro_after_s = kept_s, gyro_after_s
        self._poses: deque[tuple[float, FloatArray]] = deque()
        self._turned: deque[tuple[float, float]] = deque()  # stamps and angles of the gyroscope

    @property
    def newest(self) -> FloatArray | None:
        """T_odom_base (4, 4) at the last reading."""
        return self._poses[-1][1] if self._poses else None

    def add(self, stamp_s: float, T_odom_base: FloatArray, way_m: float) -> bool:
        """Take a pose and the way since the last; False where it does not come after that, which is then forgotten."""
        goes_on = not self._poses or stamp_s > self._poses[-1][0]
        if not goes_on:
            self._poses.clear()
        if self._poses:
            self.way_m += way_m
        self._poses.append((stamp_s, T_odom_base))
        while self._poses[0][0] < stamp_s - self._kept_s:
            self._poses.popleft()
        return goes_on

    def forget(self) -> None:
        """The way does not go on from the last pose."""
        self._poses.clear()

    def at(self, stamp_s: float) -> FloatArray | None:
        """T_odom_base (4, 4) at a stamp that the wheels tell of."""
        (T,) = interpolate_at([told_s for told_s, _ in self._poses], [T for _, T in self._poses], stamp_s)
        return None if np.isnan(T).any() else np.asarray(T)

    def turn(self, stamp_s: float, yaw_rate_rad_s: float) -> None:
        """Take a reading of a gyroscope, the mean since its last one; one that does not come after it is left out."""
        if not np.isfinite([stamp_s, yaw_rate_rad_s]).all():
            return
        last_s, angle_rad = self._turned[-1] if self._turned else (stamp_s, 0.0)
        if stamp_s < last_s:
            return
        self._turned.append((stamp_s, angle_rad + yaw_rate_rad_s * (stamp_s - last_s)))
        while self._turned[0][0] < stamp_s - self._kept_s:
            self._turned.popleft()

    def turned_between(self, begin_s: float, end_s: float) -> float | None:
        """By what angle the gyroscope turned, in radians; None where it does not tell of all that time."""
        turned = self._turned
        if not turned or not (turned[0][0] <= begin_s and end_s <= turned[-1][0] + self._gyro_after_s):
            return None
        stamps_s, angles_rad = np.array(turned).T
        return float(np.interp(end_s, stamps_s, angles_rad) - np.interp(begin_s, stamps_s, angles_rad))


# FloorViews: how far below the camera its frames show the floor.


class FloorViews:
    """Looks for the floor in some rows of each frame.

    The floor is the lowest that lies level. A robot that begins before a table or a bed sees that first, and the floor
    when it has turned: so the lowest views count.

    Args:
        calibration: with the camera.
        T_base_camera: (4, 4), rigid.
        settings: how many of the lowest views, and of each how many rows.
        of_floor: how the floor is told in one view.
    """

    def __init__(
        self,
        calibration: Calibration,
        T_base_camera: FloatArray,
        settings: BaseCheckSettings,
        of_floor: FloorSettings,
    ) -> None:
        camera = calibration.cameras[1]
        step = max(1, camera.height // settings.floor_rows)
        self._grid = np.s_[step // 2 :: step, step // 2 :: step]
        self._rays = camera.rays()[self._grid].reshape(-1, 3)
        self._up, self._height_m = T_base_camera[2, :3], float(T_base_camera[2, 3])
        self._most_views, self._of_floor = settings.floor_views, of_floor
        self._ratios: list[float] = []

    @property
    def ratio(self) -> float | None:
        """The height over the floor that is seen, over that of the mount; None where none was seen yet."""
        return float(np.median(self._ratios)) if self._ratios else None

    def look(self, frame: RgbdFrame) -> None:
        """Take a frame."""
        if not self._height_m > 0:
            return
        depth_m = frame.depth_m[self._grid].ravel().astype(float)
        found_m = height_below(self._rays, depth_m, self._up, self._height_m, self._of_floor)
        if found_m is not None:
            self._ratios = nlargest(self._most_views, [*self._ratios, found_m / self._height_m])
