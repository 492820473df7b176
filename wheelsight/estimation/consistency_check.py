"""Consistency check of wheels and camera over the first metres, which decides whether to leave one of them out.

A wrong calibration (scale of depth, mount, ticks per turn, swapped wheels) contradicts the other sensor all along, by
more than a filter may allow for sensor noise. `BaseCheck` compares both motions as `calibrate base` does. Without a
finding, estimates are unchanged. A likely finding makes the estimate that of the other sensor, or one that covers both.
A certain finding leaves the sensor out. `ReadmissionCheck` repeats the test for a camera that was left out.
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


class BaseCheck:
    """Compares the motions of wheels and camera as readings and frames arrive.

    Args:
        calibration: with wheels and mount.
        T_base_camera: (4, 4), rigid.
        by_wheels: a filter that starts as the fused one and gets the wheels alone.
        settings: how much must be compared; None for the defaults.
        of_color: for the delay of colour; None for the defaults.
        of_mount: for comparing motions and detecting the floor; None for the defaults.

    Attributes:
        by_wheels: see above; None once both sensors agree, or once the filter without the faulty one took over.
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
        self._segments = MotionSegments(calibration.any_wheels, T_base_camera, mount.agreement)
        self._colors = ColorCheck(of_color)
        self._verdict = Verdict(of)

    def add_wheels(self, wheels: WheelEstimate) -> None:
        """Add an estimate of the wheels, which may be that of a refused reading."""
        if self.by_wheels is None:
            return
        self.by_wheels.predict_to(wheels)
        T, stamp_s = wheels.T_odom_body, wheels.stamp_s
        if T is None or wheels.reason is not None or not np.isfinite(T).all():
            self._segments.interrupt()
            self._wheels.forget()
            return
        way_m = 0.0 if wheels.step is None else float(np.linalg.norm(wheels.step.T_before_now[:3, 3]))
        if not self._wheels.add(stamp_s, T, way_m):
            self._segments.interrupt()
        self._colors.add_heading(stamp_s, float(np.arctan2(T[1, 0], T[0, 0])))
        for frame_s, T_map_base in self._camera.until(stamp_s):
            self._compare(frame_s, T_map_base)
        # A camera that sees the floor at a wrong distance, and is hardly ever tracked, is left out.
        of, camera = self.settings, self._camera
        is_blind = camera.tracked < of.blind_share * camera.frames and self._wheels.way_m > of.blind_m
        if is_blind and self.left_out is None and self._is_floor_off:
            ratio = self._floor.ratio
            assert ratio is not None
            self._verdict.leave_out_blind(ratio)

    def add_yaw_rate(self, stamp_s: float, yaw_rate_rad_s: float) -> None:
        """Add a reading of a gyroscope, the mean since its last one."""
        if self.by_wheels is not None:
            self._wheels.add_yaw_rate(stamp_s, yaw_rate_rad_s)

    def add_frame(self, frame: RgbdFrame) -> None:
        """Add a frame before it is aligned: check the delay of colour, and the height of the camera over the floor."""
        if self.by_wheels is None:
            return
        self._camera.frames += 1
        self._colors.add_frame(frame)
        if self._colors.is_sure and self.left_out is None:
            self._verdict.leave_out_late_color(self._colors.late)
        self._stop_if_sound()
        self._floor.add_frame(frame)

    def add_tracked(self, frame: RgbdFrame, seen: Estimate, *, shows_all: bool) -> None:
        """Add a tracked frame, T_map_camera, and whether it shows all directions."""
        self._camera.tracked += 1
        if self.by_wheels is not None:
            self._camera.add(frame.stamp_s, seen, shows_all=shows_all)

    def begin(self, frame: RgbdFrame, seen: Estimate, T_odom_map: FloatArray) -> None:
        """Note that the camera starts or restarts at a frame, with its map at `T_odom_map` (4, 4)."""
        self._segments.interrupt()
        self._camera.begin(T_odom_map)
        if self.by_wheels is not None:
            self._camera.add(frame.stamp_s, seen, shows_all=True)

    def moved(self, T_new_old: FloatArray) -> None:
        """Apply a correction (4, 4) of the map by loops, from the left. No comparison continues across it."""
        self._segments.interrupt()
        self._camera.moved(T_new_old)

    def apply(self, answer: FusedEstimate) -> FusedEstimate:
        """Return the estimate, changed if a sensor is likely to be wrong."""
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

    def hand_over(self, left_out: Culprit) -> ErrorStateFilter | None:
        """Return the filter that continues without `left_out`, once after that sensor was left out; else None."""
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
        """Use again the sensor that was left out."""
        self._verdict = Verdict(self.settings)

    @property
    def left_out(self) -> Culprit | None:
        """The sensor that is left out, or None."""
        return self._verdict.left_out

    @property
    def is_without_wheels(self) -> bool:
        """Whether the wheels are left out, and the filter without them has taken over."""
        return self.left_out is Culprit.WHEELS and self.by_wheels is None

    @property
    def has_agreed(self) -> bool:
        """Whether wheels and camera agree, and colour is not known to be late."""
        return self._verdict.has_agreed and self.left_out is None and not self._colors.late

    @property
    def suspects_wheels(self) -> bool:
        """Whether the wheels may be too wrong to predict the camera's motion."""
        return any(one.culprit is Culprit.WHEELS for one in self._verdict.found)

    @property
    def agreement(self) -> Agreement:
        """Sum of all comparisons so far."""
        return self._segments.agreement

    @property
    def warnings(self) -> tuple[str, ...]:
        """What contradicts what, why, and what to do, as a sentence."""
        return self._verdict.warnings

    @property
    def _is_floor_off(self) -> bool:
        """Whether the floor's distance is so wrong that the camera waits until its motions are known to be right."""
        ratio, of = self._floor.ratio, self.settings
        is_off = ratio is not None and abs(np.log(ratio)) > np.log(of.floor_factor)
        return bool(is_off and self.agreement.way_m < of.agreed_m)

    def _compare(self, stamp_s: float, T_map_base: FloatArray | None) -> None:
        """Compare both motions since the segment began, up to a frame; None if that does not show all directions."""
        if T_map_base is None:
            self._segments.skip()
            return
        T_odom_base, verdict = self._wheels.at(stamp_s), self._verdict
        if T_odom_base is None or verdict.has_agreed or verdict.left_out is not None:
            return
        if self._segments.add(stamp_s, T_odom_base, T_map_base, self._wheels.turned_between):
            if not verdict.judge(self.agreement, self._floor.ratio):
                self._segments.agree()
            self._stop_if_sound()

    def _covered(self, answer: FusedEstimate) -> FusedEstimate:
        """Return the estimate at a frame with a covariance for the difference since both sensors last agreed."""
        newest, T_odom_base = self._camera.newest, self._wheels.newest
        if newest is None or newest[0] != answer.stamp_s or T_odom_base is None:
            return answer
        T_frame = self._wheels.at(answer.stamp_s)
        apart = self._segments.apart(T_odom_base if T_frame is None else T_frame, newest[1])
        return answer if apart is None else covered(answer, apart, self._sigmas)

    def _stop_if_sound(self) -> None:
        """End the check once all comparisons agree."""
        if self._verdict.has_agreed and self._colors.is_sound:
            self.by_wheels = None


def doubted(
    answer: FusedEstimate, by_wheels: FusedEstimate, seen: BasePose, culprits: Collection[Culprit], sigmas: float
) -> FusedEstimate:
    """Return an estimate that covers wheels and camera, at the pose of the sensor that is not suspected.

    Args:
        answer: of the fused filter.
        by_wheels: of the filter with wheels alone; it has a pose.
        seen: pose of the base by the camera alone.
        culprits: sensors that may be wrong.
        sigmas: number of standard deviations at which the other pose lies.
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
    """Return the estimate at a frame with a covariance for the difference (4, 4) between wheels and camera."""
    if answer.T_odom_body is None or answer.covariance is None:
        return answer
    other = motions.times(answer.T_odom_body, T_wheels_camera)
    _, C = covering_pose(answer.T_odom_body, answer.covariance, motions.mended(other), np.zeros((6, 6)), sigmas)
    return replace(answer, covariance=C)


class ReadmissionCheck:
    """Compares a camera that was left out with the wheels again, so that it is not left out for longer than necessary.

    What looked like a wrong calibration may have been people, slip or a wall. A separate odometry tracks the camera,
    without the wheels and without a map, until a new `BaseCheck` finds that both agree.

    Args:
        new_check: makes a new comparison.
        new_camera: makes a new camera odometry.
        restart_after: number of frames in a row without tracking that restarts the odometry.
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

    def add_wheels(self, wheels: WheelEstimate) -> None:
        """Add an estimate of the wheels; ignored before the first frame."""
        if self._check is not None:
            self._check.add_wheels(wheels)

    def agrees(self, frame: RgbdFrame) -> bool:
        """Add a frame that is newer than the previous one; return whether wheels and camera agree by now."""
        check = self._check
        # A new comparison starts after a verdict, or after a long way without one.
        if (
            check is None
            or check.left_out is not None
            or check.agreement.way_m > check.settings.again_ways * check.settings.enough_m
        ):
            check, self._begins = self._new_check(), True
            self._check = check
        most = check.settings.again_keyframes
        if self._camera is None or self._failed >= self._restart_after or len(self._camera.store) > most:
            self._camera, self._begins, self._failed = self._new_camera(), True, 0
        seen = self._camera.process(frame)
        check.add_frame(frame)
        if seen.T_odom_body is None:
            self._failed += 1
            return False
        self._failed = 0
        if self._begins:
            check.begin(frame, seen, np.eye(4))
            self._begins = False
        check.add_tracked(frame, seen, shows_all=seen.motion.shows_all)
        return check.has_agreed


class Verdict:
    """Decides which sensor is wrong, and how certain that is.

    Args:
        settings: thresholds.

    Attributes:
        found: likely explanations of the contradiction.
        is_sure: whether one of them is certain.
        left_out: the sensor that is left out, or None.
        has_agreed: whether wheels and camera are known to agree.
    """

    def __init__(self, settings: BaseCheckSettings) -> None:
        self.found: list[Explanation] = []
        self.is_sure = self.has_agreed = False
        self.left_out: Culprit | None = None
        self._settings = settings

    def judge(self, agreement: Agreement, floor_ratio: float | None) -> bool:
        """Evaluate all segments and the floor; return False if nothing contradicts."""
        explanations = agreement.explanations(floor_ratio, is_accused=bool(self.found))
        self.found = [one for one in explanations if self._is_likely(one, agreement)]
        self.is_sure = bool(self.found) and all(self._is_certain(one, agreement) for one in self.found)
        if self.is_sure and len({one.culprit for one in self.found}) == 1:
            self.left_out = self.found[0].culprit
        is_enough = agreement.way_m > self._settings.enough_m and agreement.turn_rad > self._settings.enough_rad
        if not self.found and is_enough and agreement.agrees():
            self.has_agreed = True
        return bool(explanations)

    def _is_likely(self, one: Explanation, agreement: Agreement) -> bool:
        if not one.is_scale:
            return True
        apart_m, apart_rad = np.ptp(agreement.ways_m), np.ptp(agreement.turns_rad)
        return bool(apart_m > self._settings.likely_m or apart_rad > self._settings.likely_rad)

    def _is_certain(self, one: Explanation, agreement: Agreement) -> bool:
        of, slips = self._settings, one.is_scale and one.culprit is Culprit.WHEELS
        way_m, turn_rad = (of.sure_slip_m, of.sure_slip_rad) if slips else (of.sure_m, of.sure_rad)
        return agreement.pieces >= of.sure_pieces and (agreement.way_m > way_m or agreement.turn_rad > turn_rad)

    def leave_out_late_color(self, late_frames: int) -> None:
        """Leave the camera out: its colour is certainly later than its depth."""
        self.found, self.is_sure, self.left_out = [late_color(late_frames)], True, Culprit.CAMERA

    def leave_out_blind(self, floor_ratio: float) -> None:
        """Leave the camera out: it sees the floor at a wrong distance, and cannot be tracked."""
        cause = f"{depth_cause(floor_ratio)}, or the height in T_base_camera"
        self.found = [Explanation(Culprit.CAMERA, cause, np.zeros((6, 2)), True, floor_ratio)]
        self.is_sure, self.left_out = True, Culprit.CAMERA

    @property
    def warnings(self) -> tuple[str, ...]:
        """What contradicts what, why, and what to do, as a sentence."""
        if not self.is_sure:
            return ()
        causes = [" or ".join(dict.fromkeys(one.cause for one in self.found if one.culprit is who)) for who in Culprit]
        if self.left_out is None:
            faults = f"either the wheels' fault ({causes[0]}) or the camera's ({causes[1]})"
            return (f"Wheels and camera contradict each other all along: {faults}. The answer covers both.",)
        whose = "the camera's: " if self.left_out is Culprit.CAMERA else "the wheels': "
        other = "the wheels" if self.left_out is Culprit.CAMERA else "the camera"
        cause = causes[list(Culprit).index(self.left_out)]
        return (
            f"Wheels and camera contradict each other all along, and the fault is {whose}{cause}. "
            f"The answer is by {other} alone.",
        )


def late_color(late_frames: int) -> Explanation:
    """Return the explanation that colour is later than its depth by a number of frames."""
    frames = "a frame" if late_frames == 1 else f"{late_frames} frames"
    cause = f"its colour images are {frames} later than the depth that they come with: pair them by their stamps"
    return Explanation(Culprit.CAMERA, cause, np.zeros((6, 2)))


class MotionSegments:
    """Cuts a drive into segments, and compares the motions of wheels and camera over each.

    Args:
        wheels: of the robot.
        T_base_camera: (4, 4), rigid.
        settings: length of a segment, and when both agree.

    Attributes:
        agreement: sum over all segments.
    """

    def __init__(
        self, wheels: Wheels | HolonomicWheels, T_base_camera: FloatArray, settings: AgreementSettings
    ) -> None:
        self.agreement = Agreement(wheels, T_base_camera, settings)
        # Stamp, T_odom_base and T_map_base at the begin of the segment, and where both were last known to agree.
        self._begin: tuple[float, FloatArray, FloatArray] | None = None
        self._agreed: tuple[float, FloatArray, FloatArray] | None = None

    def interrupt(self) -> None:
        """Start over: the next poses do not continue the previous ones."""
        self._begin = self._agreed = None

    def skip(self) -> None:
        """End the segment at a view that hides directions, in which the camera only repeats the prediction."""
        self._begin = None

    def add(
        self,
        stamp_s: float,
        T_odom_base: FloatArray,
        T_map_base: FloatArray,
        turned_between: Callable[[float, float], float | None],
    ) -> bool:
        """Add both poses of the base; return whether a segment ends. `turned_between` gives the gyroscope's turn."""
        now = (stamp_s, T_odom_base, T_map_base)
        self._agreed = self._agreed or now
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
        """Note that both agree up to the end of the last segment."""
        self._agreed = self._begin

    def apart(self, T_odom_base: FloatArray, T_map_base: FloatArray) -> FloatArray | None:
        """Return T_wheels_camera (4, 4), the difference since both agreed; None if they never did."""
        if self._agreed is None:
            return None
        _, T_odom_begin, T_map_begin = self._agreed
        by_wheels = motions.times(motions.inverse(T_odom_begin), T_odom_base)
        by_camera = motions.times(motions.inverse(T_map_begin), T_map_base)
        return motions.times(motions.inverse(by_wheels), by_camera)


@dataclass(frozen=True, slots=True, eq=False)
class BasePose:
    """Pose of the base by the camera alone: T_odom_base (4, 4) and its covariance (6, 6)."""

    T: FloatArray
    covariance: FloatArray


class CameraPoses:
    """Poses of the base by the camera alone, and frames that wait for wheel readings.

    Args:
        T_base_camera: (4, 4), rigid.
        most_waiting: maximum number of frames that wait.

    Attributes:
        seen: pose of the base at the last tracked frame.
        newest: stamp and T_map_base (4, 4) of the last frame that showed all directions.
        frames, tracked: number of frames, and of tracked ones.
    """

    def __init__(self, T_base_camera: FloatArray, most_waiting: int) -> None:
        self.seen: BasePose | None = None
        self.newest: tuple[float, FloatArray] | None = None
        self.frames = self.tracked = 0
        self._T_camera_base = motions.inverse(T_base_camera)
        self._T_odom_map: FloatArray | None = None
        # Frames newer than all wheel readings; without readings, the last ones.
        self._waiting: deque[tuple[float, FloatArray | None]] = deque(maxlen=most_waiting)

    def begin(self, T_odom_map: FloatArray) -> None:
        """Start or restart: no motion continues from earlier frames. The first map defines odom."""
        self._waiting.clear()
        if self._T_odom_map is None:
            self._T_odom_map = T_odom_map.copy()

    def add(self, stamp_s: float, seen: Estimate, *, shows_all: bool) -> None:
        """Add the pose T_map_camera of a frame, and whether it shows all directions."""
        if self._T_odom_map is None or seen.T_odom_body is None:
            return
        T_map_base = motions.times(seen.T_odom_body, self._T_camera_base)
        C = np.zeros((6, 6)) if seen.covariance is None else motions.carried(self._T_odom_map, seen.covariance)
        self.seen = BasePose(motions.mended(motions.times(self._T_odom_map, T_map_base)), C)
        if shows_all:
            self.newest = stamp_s, T_map_base
        self._waiting.append((stamp_s, T_map_base if shows_all else None))

    def moved(self, T_new_old: FloatArray) -> None:
        """Apply a correction (4, 4) of the map, from the left, at the camera. Waiting frames are dropped."""
        self._waiting.clear()
        self.newest = None
        if self._T_odom_map is not None:
            self._T_odom_map = motions.times(self._T_odom_map, motions.inverse(T_new_old))

    def until(self, stamp_s: float) -> Iterator[tuple[float, FloatArray | None]]:
        """Remove and yield stamp and T_map_base (4, 4) of the waiting frames up to a stamp.

        The pose is None if the frame does not show all directions.
        """
        while self._waiting and self._waiting[0][0] <= stamp_s:
            yield self._waiting.popleft()


class WheelPoses:
    """Poses T_odom_base (4, 4) of the wheels, and angles of the gyroscope, over the last seconds.

    Args:
        kept_s: how long they are kept.
        gyro_after_s: maximum age of the gyroscope's last reading when a turn is requested.

    Attributes:
        way_m: distance that the wheels rolled so far.
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
        """Add a pose and the distance since the last one. If it is not newer, forget the others and return False."""
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
        """Forget all poses: no motion continues from them."""
        self._poses.clear()

    def at(self, stamp_s: float) -> FloatArray | None:
        """Return the interpolated T_odom_base (4, 4) at a stamp; None outside the poses."""
        (T,) = interpolate_at([pose_s for pose_s, _ in self._poses], [T for _, T in self._poses], stamp_s)
        return None if np.isnan(T).any() else np.asarray(T)

    def add_yaw_rate(self, stamp_s: float, yaw_rate_rad_s: float) -> None:
        """Add a reading of a gyroscope, the mean since its last one; ignored if it is older than that."""
        if not np.isfinite([stamp_s, yaw_rate_rad_s]).all():
            return
        last_s, angle_rad = self._turned[-1] if self._turned else (stamp_s, 0.0)
        if stamp_s < last_s:
            return
        self._turned.append((stamp_s, angle_rad + yaw_rate_rad_s * (stamp_s - last_s)))
        while self._turned[0][0] < stamp_s - self._kept_s:
            self._turned.popleft()

    def turned_between(self, begin_s: float, end_s: float) -> float | None:
        """Return the gyroscope's turn in radians; None if its readings do not cover the interval."""
        turned = self._turned
        if not turned or not (turned[0][0] <= begin_s and end_s <= turned[-1][0] + self._gyro_after_s):
            return None
        stamps_s, angles_rad = np.array(turned).T
        return float(np.interp(end_s, stamps_s, angles_rad) - np.interp(begin_s, stamps_s, angles_rad))


class FloorViews:
    """Measures the camera's height over the floor from some rows of each frame.

    The floor is the lowest level surface. A robot that starts in front of a table or a bed sees that first, and the
    floor once it has turned. Therefore only the lowest views count.

    Args:
        calibration: with the camera.
        T_base_camera: (4, 4), rigid.
        settings: number of views, and of rows of each.
        of_floor: how to detect the floor in one view.
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
        """Measured height over the floor, divided by that of the mount; None before the first view of the floor."""
        return float(np.median(self._ratios)) if self._ratios else None

    def add_frame(self, frame: RgbdFrame) -> None:
        """Add a frame."""
        if not self._height_m > 0:
            return
        depth_m = frame.depth_m[self._grid].ravel().astype(float)
        found_m = height_below(self._rays, depth_m, self._up, self._height_m, self._of_floor)
        if found_m is not None:
            self._ratios = nlargest(self._most_views, [*self._ratios, found_m / self._height_m])
