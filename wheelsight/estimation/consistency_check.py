"""Checks of the filter's estimate. Each gives `PoseEvidence`, from which `decide` makes the status of the estimate.

`BaseCheck` compares the motions of wheels and camera over the first metres, as `calibrate base` does. A wrong
calibration (scale of depth, mount, ticks per turn, swapped wheels) contradicts the other sensor all along, by more than
a filter may allow for sensor noise. A certain finding leaves the sensor out. `ColorCheck` detects colour images that
are older than the depth of the same frame. These end with their verdict.

`KidnapDetection` and `UncertainRestart` watch the whole drive, for a pose that is no longer known.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable, Sized
from heapq import nlargest

import cv2
import numpy as np

from wheelsight.core.calibration import Calibration
from wheelsight.core.calibration_parts import HolonomicWheels, Wheels
from wheelsight.core.estimates import Estimate, FusedEstimate, PoseEvidence, PoseFinding, WheelEstimate
from wheelsight.core.geometry import Float32Array, FloatArray, interpolate_at, se3
from wheelsight.core.geometry import motion_kernels as motions
from wheelsight.core.messages import RgbdFrame
from wheelsight.estimation.agreement import Explanation, MotionComparison, RobotSensor, depth_cause, height_below
from wheelsight.estimation.camera_localizer import RESTART_AFTER, CameraOdometry
from wheelsight.estimation.fault_detection import COVERED_SIGMAS, covering_pose
from wheelsight.estimation.filter import ErrorStateFilter

# Comparison after which wheels and camera agree; later disagreements are slip, which the filter detects.
ENOUGH_M, _ENOUGH_RAD = 3.0, 1.5  # found on the simulator
_COMPARED = (RobotSensor.WHEELS, RobotSensor.CAMERA)
# Difference that makes a factor likely. Clocks that are 0.1 s apart look like one, at 0.5 m/s and 1 rad/s.
_LIKELY_M, _LIKELY_RAD = 0.05, 0.1
# Segments, and way or turns, after which a finding is certain (simulator). Wheels also slip by a factor.
_SURE_PIECES, _SURE_M, _SURE_RAD, _SURE_SLIP_M, _SURE_SLIP_RAD = 8, 0.5, 0.6, 1.5, 1.5
# Way of the wheels after which a camera is left out if the floor is elsewhere and fewer frames are tracked (simulator).
_BLIND_M, _BLIND_SHARE = 1.0, 0.2
# The floor: median of the lowest views, rows of each, and the factor of the camera's height that is wrong. It no longer
# counts once the sensors agree over a way. Mount, tilt and objects on the floor make less than the factor (simulator).
_FLOOR_VIEWS, _FLOOR_ROWS, _FLOOR_FACTOR, _FLOOR_AGREED_M = 5, 30, 1.2, 0.3
_KEPT_S = 3.0  # history of wheel poses for frames that arrive late
_WAITING_FRAMES = 100  # frames that wait for silent wheels: 3 s of most cameras
_SILENT_S = 0.5  # older poses of the wheels count no more, as a calibration's `max_gap_s`
_GYRO_AFTER_S = 0.1  # age of the gyroscope's last reading at the end of a segment
# A camera that has moved less, by the wheels, still sees the same view; a turn by a radian counts as 1.5 m. After the
# dark it recognises the last view within the second distance: 43 of 44 views in three recordings.
_SAME_VIEW_M, _RECOGNISED_M = 0.3, 0.7
# A comparison of a camera that was left out starts over after a multiple of `ENOUGH_M`, and after some keyframes.
_AGAIN_WAYS, _AGAIN_KEYFRAMES = 3.0, 20
DARK_S = 1.0  # without a known view; wheels alone hardly drift in less
# A base that stays within this distance stands. After so long it may stand in an elevator, whose doors take as long.
_STANDS_M, _STANDS_S = 0.02, 2.0
_CARRIED_M_S, _FLOOR_M = 0.7, 3.0  # σ of the speed at which people carry a robot, and of the height between floors
UNSURE_M = 0.25  # σ of a position at which a robot misses a door
_KNOWN_TURN_RAD = 0.5  # σ of a heading that is known again
# Standard deviation of a heading that may have any value (uniform over a circle), radians.
_TURNED_RAD = np.pi / np.sqrt(3)
# With an unknown heading, a way of r ends within 2 r of its estimated end: three standard deviations.
_ASTRAY = 2 / 3


class BaseCheck:
    """Compares the motions of wheels and camera as readings and frames arrive.

    Args:
        calibration: with wheels and mount.
        T_base_camera: (4, 4), rigid.
        by_wheels: a filter that starts as the fused one and gets the wheels alone.

    Attributes:
        by_wheels: see above; None once both sensors agree, or once the filter without the faulty one took over.
        verdict: which sensor is wrong.
    """

    def __init__(self, calibration: Calibration, T_base_camera: FloatArray, by_wheels: ErrorStateFilter) -> None:
        assert calibration.any_wheels is not None
        self.by_wheels: ErrorStateFilter | None = by_wheels
        self.verdict = Verdict()
        self._wheels = WheelPoses()
        self._camera = CameraPoses(T_base_camera)
        self._floor = FloorViews(calibration, T_base_camera)
        self._segments = MotionSegments(calibration.any_wheels, T_base_camera)
        self._colors = ColorCheck()

    def add_wheels(self, wheels: WheelEstimate) -> None:
        """Add an estimate of the wheels, which may be that of a refused reading."""
        if self.by_wheels is None:
            return
        self.by_wheels.predict_to(wheels)
        T, stamp_s, verdict = wheels.T_odom_body, wheels.stamp_s, self.verdict
        if T is None or wheels.reason is not None or not np.isfinite(T).all():
            self._segments.interrupt()
            self._wheels.forget()
            return
        self._colors.add_heading(stamp_s, float(np.arctan2(T[1, 0], T[0, 0])))
        if verdict.has_agreed:
            return  # only the delay of colour is still unknown
        way_m = 0.0 if wheels.step is None else float(np.linalg.norm(wheels.step.T_before_now[:3, 3]))
        if not self._wheels.add(stamp_s, T, way_m):
            self._segments.interrupt()
        waiting = self._camera.waiting
        while waiting and waiting[0][0] <= stamp_s:
            self._compare(*waiting.popleft())
        # A camera that sees the floor at a wrong distance, and is hardly ever tracked, is left out.
        camera = self._camera
        is_blind = camera.tracked < _BLIND_SHARE * camera.frames and self._wheels.way_m > _BLIND_M
        if is_blind and verdict.left_out is None and self._is_floor_off:
            ratio = self._floor.ratio
            assert ratio is not None
            verdict.leave_out_blind(ratio)

    def add_yaw_rate(self, stamp_s: float, yaw_rate_rad_s: float) -> None:
        """Add a reading of a gyroscope, the mean since its last one."""
        if self.by_wheels is not None and not self.verdict.has_agreed:
            self._wheels.add_yaw_rate(stamp_s, yaw_rate_rad_s)

    def add_frame(self, frame: RgbdFrame) -> None:
        """Add a frame before it is aligned: check the delay of colour, and the height of the camera over the floor."""
        if self.by_wheels is None:
            return
        self._camera.frames += 1
        self._colors.add_frame(frame)
        if self._colors.is_sure and self.verdict.left_out is None:
            self.verdict.leave_out_late_color(self._colors.late)
        if not self.verdict.has_agreed:
            self._floor.add_frame(frame)
        self._stop_if_sound()

    def add_tracked(self, frame: RgbdFrame, seen: Estimate, *, shows_all: bool) -> None:
        """Add a tracked frame, T_map_camera, and whether it shows all directions."""
        self._camera.tracked += 1
        if self.by_wheels is not None:
            self._camera.add(frame.stamp_s, seen, shows_all=shows_all)

    def begin(self, frame: RgbdFrame, seen: Estimate, T_filter_map: FloatArray) -> None:
        """Note that the camera starts or restarts at a frame, with its map at `T_filter_map` (4, 4)."""
        self._segments.interrupt()
        self._camera.begin(T_filter_map)
        if self.by_wheels is not None:
            self._camera.add(frame.stamp_s, seen, shows_all=True)

    def moved(self, T_new_old: FloatArray) -> None:
        """Apply a correction (4, 4) of the map by loops, from the left. No comparison continues across it."""
        self._segments.interrupt()
        self._camera.moved(T_new_old)

    def evidence(self, fused: FusedEstimate) -> PoseEvidence | None:
        """Return what is known of the sensors of an estimate; None if both may be right."""
        if self.by_wheels is None:
            return None
        found = self.verdict.found or ([late_color(self._colors.late)] if self._colors.late else [])
        if not found and self.verdict.has_agreed:
            return None
        wheels = self.by_wheels.estimate
        if wheels.T_odom_body is None or wheels.covariance is None or fused.stamp_s - wheels.stamp_s > _SILENT_S:
            return None
        if found:
            seen = self._camera.seen
            if seen is None:
                return None
            contradicted = {one.sensor for one in found}
            first, second = (wheels.T_odom_body, wheels.covariance), seen
            if contradicted == {RobotSensor.WHEELS}:
                first, second = second, first
            covers_both = covering_pose(*first, *second, COVERED_SIGMAS)
            return PoseEvidence(PoseFinding.SENSOR_WRONG, wheels, *covers_both)
        if self._is_floor_off:
            return PoseEvidence(PoseFinding.FLOOR_ELSEWHERE, wheels)
        newest, T_odom_base = self._camera.newest, self._wheels.newest
        T, C = fused.T_odom_body, fused.covariance
        if newest is None or newest[0] != fused.stamp_s or T_odom_base is None or T is None or C is None:
            return None
        T_frame = self._wheels.at(fused.stamp_s)
        apart = self._segments.apart(T_odom_base if T_frame is None else T_frame, newest[1])
        if apart is None:
            return None
        other = motions.renormalized(motions.times(T, apart))
        _, C = covering_pose(T, C, other, np.zeros((6, 6)), COVERED_SIGMAS)
        return PoseEvidence(PoseFinding.UNCOMPARED, covariance=C)

    def hand_over(self, left_out: RobotSensor) -> ErrorStateFilter | None:
        """Return the filter that continues without `left_out`, once after that sensor was left out; else None."""
        wheels = self.by_wheels
        if self.verdict.left_out is not left_out or wheels is None:
            return None
        self.by_wheels = None
        if left_out is RobotSensor.CAMERA:
            return wheels
        seen = self._camera.seen
        assert seen is not None
        return wheels.begun_at(*seen)

    def readmit(self) -> None:
        """Use again the sensor that was left out."""
        self.verdict = Verdict()

    @property
    def is_without_wheels(self) -> bool:
        """Whether the wheels are left out, and the filter without them has taken over."""
        return self.verdict.left_out is RobotSensor.WHEELS and self.by_wheels is None

    @property
    def is_over(self) -> bool:
        """Whether all sensors are in use after the check, so that a later contradiction is a fault."""
        return self.verdict.left_out is None and (self.verdict.has_agreed or self.by_wheels is None)

    @property
    def has_agreed_ahead(self) -> bool:
        """Whether wheels and camera agreed over enough way, so that a later contradiction is a fault, but for turns."""
        return self.verdict.has_agreed_ahead and self.verdict.left_out is None

    def end(self) -> None:
        """End the check: a sensor has failed since wheels and camera agreed over enough way."""
        self.by_wheels, self.verdict = None, Verdict()

    @property
    def has_agreed(self) -> bool:
        """Whether wheels and camera agree, and colour is not known to be late."""
        return self.verdict.has_agreed and self.verdict.left_out is None and not self._colors.late

    @property
    def comparison(self) -> MotionComparison:
        """Sum of all comparisons so far."""
        return self._segments.comparison

    @property
    def _is_floor_off(self) -> bool:
        """Whether the floor's distance is so wrong that the camera waits until its motions are known to be right."""
        ratio = self._floor.ratio
        is_off = ratio is not None and abs(np.log(ratio)) > np.log(_FLOOR_FACTOR)
        return bool(is_off and self.comparison.way_m < _FLOOR_AGREED_M)

    def _compare(self, stamp_s: float, T_map_base: FloatArray | None) -> None:
        """Compare both motions since the segment began, up to a frame; None if that does not show all directions."""
        if T_map_base is None:
            self._segments.skip()
            return
        T_odom_base, verdict = self._wheels.at(stamp_s), self.verdict
        if T_odom_base is None or verdict.has_agreed or verdict.left_out is not None:
            return
        if self._segments.add(stamp_s, T_odom_base, T_map_base, self._wheels.turned_between):
            if not verdict.judge(self.comparison, self._floor.ratio):
                self._segments.agree()
            self._stop_if_sound()

    def _stop_if_sound(self) -> None:
        """End the check once all comparisons agree."""
        if self.verdict.has_agreed and self._colors.is_sound:
            self.by_wheels = None


class ReadmissionCheck:
    """Compares a camera that was left out with the wheels again, so that it is not left out for longer than necessary.

    What looked like a wrong calibration may have been people, slip or a wall. A separate odometry tracks the camera,
    without the wheels and without a map, until a new `BaseCheck` finds that both agree.

    Args:
        new_check: makes a new comparison.
        new_camera: makes a new camera odometry.

    Attributes:
        check: the current comparison, which needs the wheels as well; None before the first frame.
    """

    def __init__(self, new_check: Callable[[], BaseCheck], new_camera: Callable[[], CameraOdometry]) -> None:
        self._new_check, self._new_camera = new_check, new_camera
        self.check: BaseCheck | None = None
        self._camera: CameraOdometry | None = None
        self._begins, self._failed = True, 0

    def agrees(self, frame: RgbdFrame) -> bool:
        """Add a frame that is newer than the previous one; return whether wheels and camera agree by now."""
        check = self.check
        # A new comparison starts after a verdict, or after a long way without one.
        if check is None or check.verdict.left_out is not None or check.comparison.way_m > _AGAIN_WAYS * ENOUGH_M:
            check, self._begins = self._new_check(), True
            self.check = check
        if self._camera is None or self._failed >= RESTART_AFTER or len(self._camera.store) > _AGAIN_KEYFRAMES:
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

    Attributes:
        found: likely explanations of the contradiction.
        is_sure: whether one of them is certain.
        left_out: the sensor that is left out, or None.
        has_agreed: whether wheels and camera are known to agree.
        has_agreed_ahead: the same, but for turns, which a straight drive does not show.
    """

    def __init__(self) -> None:
        self.found: list[Explanation] = []
        self.is_sure = self.has_agreed = self.has_agreed_ahead = False
        self.left_out: RobotSensor | None = None

    def judge(self, comparison: MotionComparison, floor_ratio: float | None) -> bool:
        """Evaluate all segments and the floor; return False if nothing contradicts."""
        explanations = comparison.explanations(floor_ratio, was_contradicted=bool(self.found))
        is_apart = np.ptp(comparison.distances_m) > _LIKELY_M or np.ptp(comparison.turns_rad) > _LIKELY_RAD
        self.found = [one for one in explanations if is_apart or not one.is_scale]
        self.is_sure = bool(self.found) and all(_is_certain(one, comparison) for one in self.found)
        if self.is_sure and len({one.sensor for one in self.found}) == 1:
            self.left_out = self.found[0].sensor
        if not self.found and comparison.way_m > ENOUGH_M and comparison.agrees():
            self.has_agreed_ahead = True
            self.has_agreed = self.has_agreed or comparison.turn_rad > _ENOUGH_RAD
        return bool(explanations)

    def leave_out_late_color(self, late_frames: int) -> None:
        """Leave the camera out: its colour is certainly later than its depth."""
        self.found, self.is_sure, self.left_out = [late_color(late_frames)], True, RobotSensor.CAMERA

    def leave_out_blind(self, floor_ratio: float) -> None:
        """Leave the camera out: it sees the floor at a wrong distance, and cannot be tracked."""
        cause = f"{depth_cause(floor_ratio)}, or the height in T_base_camera"
        self.found = [Explanation(RobotSensor.CAMERA, cause, np.zeros((6, 2)), True, floor_ratio)]
        self.is_sure, self.left_out = True, RobotSensor.CAMERA

    @property
    def warnings(self) -> tuple[str, ...]:
        """What contradicts what, why, and what to do, as a sentence."""
        if not self.is_sure:
            return ()
        causes = [" or ".join(dict.fromkeys(one.cause for one in self.found if one.sensor is who)) for who in _COMPARED]
        if self.left_out is None:
            faults = f"either the wheels' fault ({causes[0]}) or the camera's ({causes[1]})"
            return (f"Wheels and camera contradict each other all along: {faults}. The answer covers both.",)
        whose = "the camera's: " if self.left_out is RobotSensor.CAMERA else "the wheels': "
        other = "the wheels" if self.left_out is RobotSensor.CAMERA else "the camera"
        cause = causes[_COMPARED.index(self.left_out)]
        return (
            f"Wheels and camera contradict each other all along, and the fault is {whose}{cause}. "
            f"The answer is by {other} alone.",
        )


def _is_certain(one: Explanation, comparison: MotionComparison) -> bool:
    slips = one.is_scale and one.sensor is RobotSensor.WHEELS
    way_m, turn_rad = (_SURE_SLIP_M, _SURE_SLIP_RAD) if slips else (_SURE_M, _SURE_RAD)
    return comparison.pieces >= _SURE_PIECES and (comparison.way_m > way_m or comparison.turn_rad > turn_rad)


def late_color(late_frames: int) -> Explanation:
    """Return the explanation that colour is later than its depth by a number of frames."""
    frames = "a frame" if late_frames == 1 else f"{late_frames} frames"
    cause = f"its colour images are {frames} later than the depth that they come with: pair them by their stamps"
    return Explanation(RobotSensor.CAMERA, cause, np.zeros((6, 2)))


class MotionSegments:
    """Cuts a drive into segments, and compares the motions of wheels and camera over each.

    Args:
        wheels: of the robot.
        T_base_camera: (4, 4), rigid.

    Attributes:
        comparison: sum over all segments.
    """

    def __init__(self, wheels: Wheels | HolonomicWheels, T_base_camera: FloatArray) -> None:
        self.comparison = MotionComparison(wheels, T_base_camera)
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
        if not self.comparison.add(by_wheels, motions.renormalized(by_camera), turned_between(begin_s, stamp_s)):
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


class CameraPoses:
    """Poses of the base by the camera alone, and frames that wait for wheel readings.

    Args:
        T_base_camera: (4, 4), rigid.

    Attributes:
        newest: stamp and T_map_base (4, 4) of the last frame that showed all directions.
        frames, tracked: number of frames, and of tracked ones.
        waiting: stamp and T_map_base (4, 4) of frames that are newer than all wheel readings; without readings, of the
            last ones. The pose is None if the frame does not show all directions.
    """

    def __init__(self, T_base_camera: FloatArray) -> None:
        self.newest: tuple[float, FloatArray] | None = None
        self.frames = self.tracked = 0
        self.waiting: deque[tuple[float, FloatArray | None]] = deque(maxlen=_WAITING_FRAMES)
        self._T_camera_base = motions.inverse(T_base_camera)
        self._T_filter_map: FloatArray | None = None
        self._seen: tuple[Estimate, FloatArray, FloatArray] | None = None  # the last one, T_filter_map, T_map_base

    def begin(self, T_filter_map: FloatArray) -> None:
        """Start or restart: no motion continues from earlier frames. The first map defines the filter's frame."""
        self.waiting.clear()
        if self._T_filter_map is None:
            self._T_filter_map = T_filter_map.copy()

    def add(self, stamp_s: float, seen: Estimate, *, shows_all: bool) -> None:
        """Add the pose T_map_camera of a frame, and whether it shows all directions."""
        if self._T_filter_map is None or seen.T_odom_body is None:
            return
        T_map_base = motions.times(seen.T_odom_body, self._T_camera_base)
        self._seen = seen, self._T_filter_map, T_map_base
        if shows_all:
            self.newest = stamp_s, T_map_base
        self.waiting.append((stamp_s, T_map_base if shows_all else None))

    def moved(self, T_new_old: FloatArray) -> None:
        """Apply a correction (4, 4) of the map, from the left, at the camera. Waiting frames are dropped."""
        self.waiting.clear()
        self.newest = None
        if self._T_filter_map is not None:
            self._T_filter_map = motions.times(self._T_filter_map, motions.inverse(T_new_old))

    @property
    def seen(self) -> tuple[FloatArray, FloatArray] | None:
        """T_filter_base (4, 4) at the last tracked frame, by the camera alone, and its covariance (6, 6)."""
        if self._seen is None:
            return None
        seen, T_filter_map, T_map_base = self._seen
        C = np.zeros((6, 6)) if seen.covariance is None else motions.carried(T_filter_map, seen.covariance)
        return motions.renormalized(motions.times(T_filter_map, T_map_base)), C


class WheelPoses:
    """Poses T_odom_base (4, 4) of wheel odometry, in its own frame, and angles of the gyroscope, over the last seconds.

    Attributes:
        way_m: distance that the wheels rolled so far.
    """

    def __init__(self) -> None:
        self.way_m = 0.0
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
        while self._poses[0][0] < stamp_s - _KEPT_S:
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
        while self._turned[0][0] < stamp_s - _KEPT_S:
            self._turned.popleft()

    def turned_between(self, begin_s: float, end_s: float) -> float | None:
        """Return the gyroscope's turn in radians; None if its readings do not cover the interval."""
        turned = self._turned
        if not turned or not (turned[0][0] <= begin_s and end_s <= turned[-1][0] + _GYRO_AFTER_S):
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
    """

    def __init__(self, calibration: Calibration, T_base_camera: FloatArray) -> None:
        camera = calibration.cameras[1]
        step = max(1, camera.height // _FLOOR_ROWS)
        self._grid = np.s_[step // 2 :: step, step // 2 :: step]
        self._rays = camera.rays()[self._grid].reshape(-1, 3)
        self._up, self._height_m = T_base_camera[2, :3], float(T_base_camera[2, 3])
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
        found_m = height_below(self._rays, depth_m, self._up, self._height_m)
        if found_m is not None:
            self._ratios = nlargest(_FLOOR_VIEWS, [*self._ratios, found_m / self._height_m])


# Detection of late colour. Images are reduced to this width; nearer depth counts as this (data sheets).
_WIDTH_PX, _NEAREST_M = 80, 0.3
_MOST_PX = 12  # largest shift between two frames: 70°/s at 10 frames/s
_ALIKE, _SHIFT_PX = 0.45, 0.5  # least response of a shift, and the scale of outliers, pixels (simulator)
_CLOCK_S = 0.03  # σ of the difference between the clocks of camera and wheels
# Lags of the camera's clock: up to three frames at 10 frames/s and 0.1 s. Beyond the last one against rounding.
_LAGS_S: FloatArray = np.arange(-0.2, 0.4 + 0.02 / 20, 0.02)
_LATEST_FRAMES, _LEAST_LAG_S = 3, 0.05  # longest delay of colour, and the least one that matters
# Shifts before a result, shifts kept (a minute of turning), headings kept, and turns before a result.
_FEWEST_SHIFTS, _MOST_SHIFTS, _MOST_HEADINGS, _LEAST_TURN_RAD = 20, 600, 20_000, 0.5
# Twice the log-likelihood ratio of a likely and of a certain delay: certain after 14 to 22 s in flats (simulator).
_LIKELY, _SURE = 6.0, 20.0
_FOLLOWED_SHARE = 0.7  # of the shifts that turns explain: 86 % and more, under a half for wheels that spin (simulator)
_EVERY_FRAMES = 5  # between two evaluations
# Time after a turn in which a late image may still show it, and the least turn within it (simulator).
_TURNING_S, _TURNING_RAD = 0.6, 0.01


class ColorCheck:
    """Compares the shifts of colour and depth with the turns of the wheels, until the result is certain.

    When the robot turns, both images shift sideways in proportion to the turn of the wheels. The shift lags by the
    delay of the camera's clock, which both share, and for colour by its delay in frames. If colour lags by whole frames
    more than depth, surfaces and grey values contradict each other at the begin and end of a turn.

    Attributes:
        late: likely delay of colour in frames; else 0.
        is_sure: whether the delay is certain.
        is_sound: whether it is certain that colour is not late.
    """

    def __init__(self) -> None:
        self.late, self.is_sure, self.is_sound = 0, False, False
        self._last: tuple[float, Float32Array, Float32Array] | None = None
        # For each pair of frames: both stamps, and the shifts of colour and depth in pixels.
        self._shifts: deque[tuple[float, float, float, float]] = deque(maxlen=_MOST_SHIFTS)
        self._hanning: Float32Array | None = None
        self._headings: deque[tuple[float, float]] = deque(maxlen=_MOST_HEADINGS)

    def add_heading(self, stamp_s: float, heading_rad: float) -> None:
        """Add the robot's heading by the wheels."""
        if self._headings:
            before_s, before_rad = self._headings[-1]
            if not stamp_s > before_s:
                return
            heading_rad = before_rad + float(np.remainder(heading_rad - before_rad + np.pi, 2 * np.pi) - np.pi)
        self._headings.append((stamp_s, heading_rad))
        first_s = min(self._shifts[0][0] if self._shifts else stamp_s, stamp_s)
        while self._headings[0][0] < first_s - _TURNING_S:
            self._headings.popleft()

    def add_frame(self, frame: RgbdFrame) -> None:
        """Add a frame, in order of time."""
        if self.is_sound or self.is_sure:
            return
        whole = np.asarray(cv2.cvtColor(frame.color, cv2.COLOR_RGB2GRAY))
        size = (_WIDTH_PX, max(1, round(_WIDTH_PX * whole.shape[0] / whole.shape[1])))
        grey = np.asarray(cv2.resize(whole, size, interpolation=cv2.INTER_AREA), np.float32)
        height_px, width_px = frame.depth_m.shape
        size = (_WIDTH_PX, max(1, round(_WIDTH_PX * height_px / width_px)))
        thin = np.asarray(cv2.resize(frame.depth_m, size, interpolation=cv2.INTER_NEAREST))
        near = np.where(thin > 0, 1 / np.maximum(thin, np.float32(_NEAREST_M)), np.float32(0)).astype(np.float32)
        last, self._last = self._last, (frame.stamp_s, grey, near)
        now_s = self._headings[-1][0] if self._headings else 0.0
        recent: list[float] = []
        for stamp_s, heading_rad in reversed(self._headings):
            if stamp_s <= now_s - _TURNING_S:
                break
            recent.append(heading_rad)
        is_turning = bool(recent) and max(recent) - min(recent) > _TURNING_RAD
        if not is_turning or last is None or last[1].shape != grey.shape or last[2].shape != near.shape:
            return
        if self._hanning is None or self._hanning.shape != grey.shape:
            self._hanning = np.asarray(cv2.createHanningWindow(grey.shape[::-1], cv2.CV_32F), np.float32)
        (shift_px, _), alike = cv2.phaseCorrelate(last[1], grey, self._hanning)
        by_depth_px = _shift_of(last[2], near)
        self._shifts.append((last[0], frame.stamp_s, shift_px if alike > _ALIKE else np.nan, by_depth_px))
        if len(self._shifts) % _EVERY_FRAMES == 0:
            self._judge()

    def _judge(self) -> None:
        """Compare the likelihoods of all delays in frames, each at the best lag of the clock."""
        lags_s = _LAGS_S
        begin_s, end_s, color, depth = np.array(self._shifts).T
        period_s = float(np.median(end_s - begin_s))
        if not self._headings:
            return
        is_known = end_s < self._headings[-1][0] + lags_s[0]
        stamps_s, headings_rad = np.array(self._headings).T
        begin_s, end_s = begin_s[is_known], end_s[is_known]
        turned = np.array(  # (L, N) by the wheels, at each lag
            [
                np.interp(end_s - lag_s, stamps_s, headings_rad) - np.interp(begin_s - lag_s, stamps_s, headings_rad)
                for lag_s in lags_s
            ]
        )
        if not turned.size or np.abs(turned).sum(axis=1).min() < _LEAST_TURN_RAD:
            return
        (by_color, color_share), (by_depth, depth_share) = (_misfits(x[is_known], turned) for x in (color, depth))
        if min(color_share, depth_share) < _FOLLOWED_SHARE:
            self.late, self.is_sure = 0, False
            return
        clock = (lags_s / _CLOCK_S) ** 2
        best = [np.inf] * (_LATEST_FRAMES + 1)
        for late in range(_LATEST_FRAMES + 1):
            at = np.interp(lags_s + late * period_s, lags_s, by_color, right=np.inf)
            best[late] = float(np.min(at + by_depth + clock))
        likeliest = int(np.argmin(best))
        more = best[0] - best[likeliest]
        self.is_sound = likeliest == 0 and min(best[1:]) - best[0] > _SURE
        is_late = likeliest * period_s > _LEAST_LAG_S and more > (0.0 if self.late else _LIKELY)
        self.late, self.is_sure = (likeliest, more > _SURE) if is_late else (0, False)


def _shift_of(before: Float32Array, now: Float32Array) -> float:
    """Return the shift to the right of an image of inverse depth, in pixels; NaN if none fits."""
    costs = np.full(2 * _MOST_PX + 1, 0.1)
    width = before.shape[1]
    known_before, known_now = before > 0, now > 0
    for place, shift in enumerate(range(-_MOST_PX, _MOST_PX + 1)):
        first, then = slice(max(0, -shift), width - max(0, shift)), slice(max(0, shift), width - max(0, -shift))
        both = known_before[:, first] & known_now[:, then]
        if np.count_nonzero(both) > 0.05 * both.size:
            costs[place] = np.minimum(np.abs(before[:, first] - now[:, then])[both], 0.1).mean()
    i = int(costs.argmin())
    if not 0 < i < len(costs) - 1 or 1 - costs[i] / np.median(costs) < _ALIKE:
        return np.nan
    left, middle, right = costs[i - 1 : i + 2]
    return float(i - _MOST_PX + (left - right) / (2 * max(left - 2 * middle + right, 1e-9)))


def _misfits(shifts_px: FloatArray, turned_rad: FloatArray) -> tuple[FloatArray, float]:
    """Return χ² (L,) of shifts (N,) as multiples of turns (L, N) at each lag, and the share that turns explain.

    χ² is relative to the scatter at the best lag. The share is that at the best lag; 1 if there are too few shifts.
    """
    known = np.isfinite(shifts_px)
    if np.count_nonzero(known) < _FEWEST_SHIFTS:
        return np.zeros(len(turned_rad)), 1.0
    x, w = shifts_px[known], turned_rad[:, known]
    weights = np.ones_like(w)
    for _ in range(4):
        gain = np.sum(weights * w * x, axis=1) / np.maximum(np.sum(weights * w * w, axis=1), 1e-12)
        off = np.abs(x - gain[:, None] * w)
        weights = np.minimum(1.0, _SHIFT_PX / np.maximum(off, 1e-9))
    cost = np.sum(weights * off**2, axis=1)
    unexplained = np.sum(np.minimum(np.abs(x), _SHIFT_PX) * np.abs(x))
    share = 1 - float(cost.min() / max(unexplained, 1e-12))
    return np.asarray((cost / max(cost.min(), 1e-12) - 1) * len(x)), share


class KidnapDetection:
    """Detects that the robot was moved: the view changed although the wheels stood.

    It may have been carried while the camera was dark, or by an elevator, whose cabin looks the same while its doors
    are closed. A person who steps in front of a standing robot also changes the view. While the wheels stand, the
    camera therefore waits for the known view to return.
    """

    def __init__(self) -> None:
        self._away_s = self._up_m = 0.0
        self._known_s = -np.inf  # stamp of the last frame that showed a known view, accepted by the filter or not
        self._stands: tuple[float, FloatArray] | None = None  # since when the wheels stand, and where
        self._stood_s = 0.0  # how long they had stood at the last known view
        self._from: FloatArray | None = None  # x, y of the wheels at the kidnapping
        self._was_dark = self._is_inflated = self._is_apart = False

    @property
    def is_kidnapped(self) -> bool:
        """Whether the last frames show a kidnapping, or the pose after one is still unknown."""
        return self._from is not None

    @property
    def is_suspected(self) -> bool:
        """Whether the view changed and the camera has not restarted yet."""
        return self._from is not None and not self._is_inflated

    @property
    def is_in_dark(self) -> bool:
        """Whether the view changed in the dark.

        Rooms look alike: after the dark, a view that matches a known one but contradicts the wheels confirms a
        kidnapping. In the light it may as well be a person who walks past.
        """
        return self.is_suspected and self._was_dark

    def add_wheels(self, stamp_s: float, T_odom_base: FloatArray) -> None:
        """Add the pose (4, 4) of the base by the wheels alone."""
        if self._stands is not None and stamp_s >= self._stands[0]:
            T_stand_base = motions.times(motions.inverse(self._stands[1]), T_odom_base)
            if motions.view_shift_m(T_stand_base) <= _STANDS_M:
                return
        self._stands = stamp_s, T_odom_base

    def add_known_view(self, stamp_s: float) -> None:
        """Add a frame that shows a known view: the robot was not moved."""
        self._known_s = stamp_s
        self._stood_s = 0.0 if self._stands is None else stamp_s - self._stands[0]
        if not self._is_inflated:
            self._from = None

    def add_unknown_view(self, stamp_s: float, T_last_now: FloatArray | None, T_filter_base: FloatArray) -> None:
        """Add the first frame that shows nothing known.

        Args:
            stamp_s: of the frame.
            T_last_now: (4, 4) motion of the camera, by the wheels, since the last frame with a known view; None if the
                filter no longer remembers that.
            T_filter_base: (4, 4) pose of the base by the wheels.
        """
        stood_s = self._stood_s if self._stood_s > _STANDS_S else 0.0
        dark_s = stamp_s - self._known_s
        was_dark = dark_s > DARK_S
        if self.is_kidnapped or not (was_dark or stood_s):
            return
        if not _is_within(_RECOGNISED_M if was_dark else _SAME_VIEW_M, T_last_now):
            return
        self._away_s, self._up_m = dark_s + stood_s, _FLOOR_M if stood_s else 0.0
        self._was_dark = was_dark
        self._from = T_filter_base[:2, 3].copy()

    def waits(self, T_last_now: FloatArray | None) -> bool:
        """Whether the known view may return: by the wheels (4, 4), the camera has not moved away from it."""
        return self.is_suspected and _is_within(_SAME_VIEW_M, T_last_now)

    def inflate(self, T_filter_base: FloatArray, covariance: FloatArray) -> FloatArray:
        """Return the covariance (6, 6) at a restart of the camera, for any motion that is possible meanwhile."""
        self._is_inflated = True
        return covariance + self._spread(T_filter_base)

    def restart(self) -> None:
        """Forget how long the wheels stood: the camera restarts, so its view is not that of an elevator's cabin."""
        self._stands, self._stood_s = None, 0.0

    def begin_submap(self) -> None:
        """Note that a submap begins, which loops are to join."""
        self._is_apart = True

    def relocalized(self) -> None:
        """Note that loops have placed the submap that began after the kidnapping, so the pose is known."""
        if self._is_apart:
            self._from, self._is_inflated, self._is_apart = None, False, False

    def update_evidence(self, T_filter_base: FloatArray, covariance: FloatArray) -> PoseEvidence | None:
        """Return a larger covariance for a pose (4, 4) with its own (6, 6), until its heading is known again."""
        if self._from is None:
            return None
        C = covariance
        if not self._is_inflated:
            C = C + self._spread(T_filter_base)
        elif C[5, 5] < _KNOWN_TURN_RAD**2:
            self._from, self._is_inflated, self._is_apart = None, False, False
            return None
        astray_m = _ASTRAY * float(np.linalg.norm(T_filter_base[:2, 3] - self._from))
        C = C + np.diag(np.square([astray_m, astray_m, 0, 0, 0, 0]))
        return PoseEvidence(PoseFinding.KIDNAPPED, covariance=C)

    def _spread(self, T_filter_base: FloatArray) -> FloatArray:
        """Return the covariance (6, 6) of a base that was carried and turned by any angle, perhaps to another floor."""
        carried_m = _CARRIED_M_S * self._away_s
        Ad = motions.adjoint(T_filter_base)
        return np.asarray(Ad @ np.diag(np.square([carried_m, carried_m, self._up_m, 0, 0, _TURNED_RAD])) @ Ad.T)


class UncertainRestart:
    """Marks estimates as doubtful after the camera restarts at a pose that the wheels know poorly.

    After a gap of all sensors, or a long way in the dark, the error may be half a metre, however well the camera tracks
    from there. The same holds when the filter accepts a camera again that it took for failing. Camera measurements are
    relative motions, so they do not reduce this error. Places, known views and loops do.

    Attributes:
        since: number of the first keyframe after the restart; None if the pose is known.
    """

    def __init__(self) -> None:
        self._known: tuple[FloatArray, FloatArray] | None = None  # pose and covariance at the last accepted frame
        self.since: int | None = None
        self._enough_m2 = 0.0  # variance below which the pose counts as known again

    def add_accepted(self, fused: FusedEstimate, keyframes: Sized = ()) -> None:
        """Add the estimate at a frame that the filter accepted, and all keyframes.

        With slip, that camera may have failed for long.
        """
        assert fused.T_odom_body is not None
        assert fused.covariance is not None
        now = fused.T_odom_body, fused.covariance
        if self._known is not None and fused.slip:
            self.begin(math.sqrt(max(_variance_m2(*now) - _variance_m2(*self._known), 0.0)), len(keyframes))
        self._known = now

    def begin(self, spread_m: float | None, keyframe: int) -> None:
        """Note a restart at a keyframe, `spread_m` (σ, in the plane) after the last accepted frame."""
        if spread_m is None or spread_m <= UNSURE_M or self.since is not None:
            return
        before_m2 = 0.0 if self._known is None else _variance_m2(*self._known)
        self._enough_m2, self.since = before_m2 + UNSURE_M**2, keyframe

    def relocalized(self) -> None:
        """Note that loops connect keyframes since the restart to older ones."""
        self.since = None

    def update_evidence(self, T_filter_base: FloatArray, covariance: FloatArray) -> PoseEvidence | None:
        """Return the finding for a pose (4, 4) with its covariance (6, 6); end it once the position is known again."""
        if self.since is None:
            return None
        if _variance_m2(T_filter_base, covariance) < self._enough_m2:
            self.since = None
            return None
        return PoseEvidence(PoseFinding.UNCERTAIN_RESTART)


def _is_within(way_m: float, T_last_now: FloatArray | None) -> bool:
    return T_last_now is not None and motions.view_shift_m(T_last_now) <= way_m


def _variance_m2(T: FloatArray, covariance: FloatArray) -> float:
    return float(np.trace(se3.position_covariance(T, covariance)[:2, :2]))
