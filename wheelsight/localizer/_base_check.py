"""BaseCheck: over the first metres of a joined run, whether wheels and camera tell of one drive; else who is left out.

A calibration that is wrong, by a depth's factor, a mount, ticks a turn or wheels that are swapped, contradicts
the other sensor all along, by far more than a filter may allow for errors of sensors. So both motions are compared as
`calibrate base` does. Until something is found, the filter's answers stand as they are. Something that is likely
makes the answer that of the other sensor, or one that covers both; something that is sure leaves the sensor out.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, replace

import numpy as np

from wheelsight.calibration import Calibration
from wheelsight.estimates import Estimate, Reason, WheelEstimate
from wheelsight.events import RgbdFrame
from wheelsight.fusion import ErrorStateFilter, FusedEstimate, covering_pose
from wheelsight.geometry import FloatArray, interpolate_at
from wheelsight.geometry import motion_kernels as motions
from wheelsight.localizer._color_check import ColorCheck
from wheelsight.odometry.extrinsics import Agreement, Culprit, Explanation, depth_cause, height_below

# So much must have been compared until both are known to tell of one drive; what comes later is slip, and is the
# filter's to tell.
_ENOUGH_M, _ENOUGH_RAD = 3.0, 1.5
# Whoever looks or turns elsewhere shows it in any piece. A factor may be the work of clocks that are apart: by 0.1 s,
# at half a metre and a radian a second.
_LIKELY_M, _LIKELY_RAD = 0.05, 0.1
_SURE_PIECES, _SURE_M, _SURE_RAD = 8, 0.5, 0.6
# Wheels slip by a factor, too; where the camera leads then anyway, it is no haste.
_SURE_SLIP_M, _SURE_SLIP_RAD = 1.5, 1.5
# Metres by the wheels, after which a camera that is followed in so few frames is left out if its floor is elsewhere.
_BLIND_M, _BLIND_SHARE = 1.0, 0.2
_AGREED_M = 0.3  # after which a floor that is not where the mount has it is held against nobody
_VIEWS, _ROWS = 5, 30
_MOST_OFF = np.log(1.2)  # of the floor's height
_KEPT_S, _MOST_WAITING = 3.0, 100
_DEAF_S = 0.5  # wheels that have been silent for longer answer nothing


@dataclass(frozen=True, slots=True, eq=False)
class _Pose:
    """Of the base, by the camera alone: T_odom_base (4, 4), its covariance (6, 6), and the stamp."""

    stamp_s: float
    T: FloatArray
    covariance: FloatArray


class BaseCheck:
    """Compares as frames and readings come.

    Args:
        calibration: with wheels and mount.
        T_base_camera: (4, 4), rigid.
        by_wheels: a filter that begins as the one that joins both; it hears the wheels alone.

    Attributes:
        left_out: whose motions are left out from now on, or None.
        by_wheels: see above; None once both are known to tell of one drive, or who is left out has been.
    """

    def __init__(self, calibration: Calibration, T_base_camera: FloatArray, by_wheels: ErrorStateFilter) -> None:
        assert calibration.wheels is not None
        self.left_out: Culprit | None = None
        self.by_wheels: ErrorStateFilter | None = by_wheels
        self._mount = T_base_camera
        camera = calibration.cameras[1]
        step = max(1, camera.height // _ROWS)
        self._grid = np.s_[step // 2 :: step, step // 2 :: step]
        self._rays = camera.rays()[self._grid].reshape(-1, 3)
        self._agreement = Agreement(calibration.wheels, T_base_camera)
        self._floors: list[float] = []
        self._wheels: deque[tuple[float, FloatArray]] = deque()
        # Frames whose time no reading has come to yet; of wheels that are not heard, the last ones.
        self._frames: deque[tuple[float, FloatArray]] = deque(maxlen=_MOST_WAITING)
        self._turned: deque[tuple[float, float]] = deque()  # stamps and angles of the gyroscope
        # Stamp, T_odom_base and T_map_base where a piece begins; and where both were last known to go together.
        self._begin: tuple[float, FloatArray, FloatArray] | None = None
        self._together: tuple[float, FloatArray, FloatArray] | None = None
        self._newest: tuple[float, FloatArray] | None = None
        self._T_odom_map: FloatArray | None = None
        self._seen: _Pose | None = None
        self._found: list[Explanation] = []
        self._is_sure = self._has_agreed = False
        self._colors = ColorCheck()
        self._rolled_m = 0.0
        self._looks = self._tracked = 0

    @property
    def suspects_wheels(self) -> bool:
        """Whether the wheels may be wrong so that the camera had better not expect what they tell."""
        return any(one.culprit is Culprit.WHEELS for one in self._found)

    @property
    def warnings(self) -> tuple[str, ...]:
        """What contradicts what, why, and what to do, as a sentence."""
        if not self._is_sure:
            return ()
        causes = [" or ".join(_causes(self._found, who)) for who in Culprit]
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

    def hear(self, wheels: WheelEstimate) -> None:
        """Take what the wheels came to, which may be that a reading was refused."""
        if self.by_wheels is None:
            return
        self.by_wheels.predict_to(wheels)
        if wheels.T_odom_body is None or wheels.reason is not None or not np.isfinite(wheels.T_odom_body).all():
            self._begin = self._together = None
            self._wheels.clear()
            return
        if self._wheels and not wheels.stamp_s > self._wheels[-1][0]:
            self._wheels.clear()
            self._begin = self._together = None
        if self._wheels and wheels.step is not None:
            self._rolled_m += float(np.linalg.norm(wheels.step.T_before_now[:3, 3]))
        self._wheels.append((wheels.stamp_s, wheels.T_odom_body))
        self._colors.hear(wheels.stamp_s, float(np.arctan2(wheels.T_odom_body[1, 0], wheels.T_odom_body[0, 0])))
        while self._wheels[0][0] < wheels.stamp_s - _KEPT_S:
            self._wheels.popleft()
        while self._frames and self._frames[0][0] <= wheels.stamp_s:
            self._compare(*self._frames.popleft())
        is_blind = self._tracked < _BLIND_SHARE * self._looks
        if is_blind and self._is_floor_off and self._rolled_m > _BLIND_M and self.left_out is None:
            self._leave_out_blind()

    def turn(self, stamp_s: float, yaw_rate_rad_s: float) -> None:
        """Take a reading of a gyroscope, the mean since its last one."""
        if self.by_wheels is None or not np.isfinite([stamp_s, yaw_rate_rad_s]).all():
            return
        last_s, angle_rad = self._turned[-1] if self._turned else (stamp_s, 0.0)
        if stamp_s < last_s:
            return
        self._turned.append((stamp_s, angle_rad + yaw_rate_rad_s * (stamp_s - last_s)))
        while self._turned[0][0] < stamp_s - _KEPT_S:
            self._turned.popleft()

    def begin(self, frame: RgbdFrame, seen: Estimate, T_odom_map: FloatArray) -> None:
        """The camera begins, or begins again, at a frame; its map lies at `T_odom_map` (4, 4)."""
        self._begin = self._together = None
        self._frames.clear()
        if self._T_odom_map is None:
            self._T_odom_map = T_odom_map.copy()
        self._tell(frame, seen, shows_all=True)

    def see(self, frame: RgbdFrame, seen: Estimate, *, shows_all: bool) -> None:
        """Take a frame that was tracked, T_map_camera, and whether it shows all directions."""
        self._tracked += 1
        self._tell(frame, seen, shows_all=shows_all)

    def _tell(self, frame: RgbdFrame, seen: Estimate, *, shows_all: bool) -> None:
        if self.by_wheels is None or self._T_odom_map is None or seen.T_odom_body is None:
            return
        T_map_base = motions.times(seen.T_odom_body, motions.inverse(self._mount))
        C = np.zeros((6, 6)) if seen.covariance is None else motions.carried(self._T_odom_map, seen.covariance)
        self._seen = _Pose(frame.stamp_s, motions.mended(motions.times(self._T_odom_map, T_map_base)), C)
        if shows_all:
            self._newest = frame.stamp_s, T_map_base
            self._frames.append(self._newest)

    def answered(self, answer: FusedEstimate) -> FusedEstimate:
        """The answer as it stands, or as it must be while it is likely that a sensor is wrong."""
        wheels = self.by_wheels
        if wheels is None:
            return answer
        found = self._found or ([self._late_color()] if self._colors.late else [])
        by_wheels, seen = wheels.estimate, self._seen
        if by_wheels.T_odom_body is None or by_wheels.covariance is None:
            return answer
        if (not found and self._has_agreed) or answer.stamp_s - by_wheels.stamp_s > _DEAF_S:
            return answer
        if not found:
            return replace(by_wheels, reason=answer.reason) if self._is_floor_off else self._covered(answer)
        if seen is None:
            return answer
        whose = {one.culprit for one in found}
        reason = answer.reason or Reason.CONTRADICTION
        first, second = (by_wheels.T_odom_body, by_wheels.covariance), (seen.T, seen.covariance)
        if whose == {Culprit.WHEELS}:
            first, second = second, first
        T, C = covering_pose(*first, *second)
        return replace(by_wheels, T_odom_body=T, covariance=C, doubtful=True, slip=False, reason=reason)

    def _covered(self, answer: FusedEstimate) -> FusedEstimate:
        """The answer to a frame, less certain by what both have gone apart since they were last known to agree."""
        if self._together is None or self._newest is None or self._newest[0] != answer.stamp_s:
            return answer
        if answer.T_odom_body is None or answer.covariance is None or not self._wheels:
            return answer
        _, T_odom_begin, T_map_begin = self._together
        T_odom_base = self._at(answer.stamp_s)
        by_wheels = motions.times(
            motions.inverse(T_odom_begin), self._wheels[-1][1] if T_odom_base is None else T_odom_base
        )
        by_camera = motions.times(motions.inverse(T_map_begin), self._newest[1])
        other = motions.times(answer.T_odom_body, motions.times(motions.inverse(by_wheels), by_camera))
        _, C = covering_pose(answer.T_odom_body, answer.covariance, motions.mended(other), np.zeros((6, 6)))
        return replace(answer, covariance=C)

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
        assert self._seen is not None
        return wheels.begun_at(self._seen.T, self._seen.covariance)

    @property
    def _floor_ratio(self) -> float | None:
        """The height over the floor that is seen, over that of the mount."""
        return float(np.median(self._floors)) if self._floors else None

    @property
    def _is_floor_off(self) -> bool:
        """Whether the first views' floor is so far off that the camera waits until its ways are known to be right."""
        ratio = self._floor_ratio
        return ratio is not None and abs(np.log(ratio)) > _MOST_OFF and self._agreement.way_m < _AGREED_M

    def look(self, frame: RgbdFrame) -> None:
        """See how colour and depth go together, and in the first frames how far below the camera the floor lies."""
        if self.by_wheels is None:
            return
        self._looks += 1
        self._colors.see(frame)
        if self._colors.is_sure and self.left_out is None:
            self._found, self._is_sure, self.left_out = [self._late_color()], True, Culprit.CAMERA
        self._stop_if_sound()
        height_m = float(self._mount[2, 3])
        if len(self._floors) >= _VIEWS or not height_m > 0:
            return
        depth_m = frame.depth_m[self._grid].ravel().astype(float)
        found_m = height_below(self._rays, depth_m, self._mount[2, :3], height_m)
        if found_m is not None:
            self._floors.append(found_m / height_m)

    def _compare(self, stamp_s: float, T_map_base: FloatArray) -> None:
        """What wheels and camera made of the time since the piece began, up to a frame."""
        T_odom_base = self._at(stamp_s)
        if T_odom_base is None or self._has_agreed or self.left_out is not None:
            return
        now = (stamp_s, T_odom_base, T_map_base)
        if self._begin is None or self._together is None:
            self._begin = self._together = now
            return
        begin_s, T_odom_begin, T_map_begin = self._begin
        by_wheels = motions.times(motions.inverse(T_odom_begin), T_odom_base)
        by_camera = motions.times(motions.inverse(T_map_begin), T_map_base)
        if self._agreement.add(by_wheels, motions.mended(by_camera), self._turned_between(begin_s, stamp_s)):
            self._begin = now
            self._judge()

    def _at(self, stamp_s: float) -> FloatArray | None:
        """T_odom_base (4, 4) by the wheels at a stamp that they tell of."""
        (T,) = interpolate_at([told_s for told_s, _ in self._wheels], [T for _, T in self._wheels], stamp_s)
        return None if np.isnan(T).any() else np.asarray(T)

    def _turned_between(self, begin_s: float, end_s: float) -> float | None:
        if not self._turned or not (self._turned[0][0] <= begin_s and end_s <= self._turned[-1][0] + 0.1):
            return None
        stamps_s, angles_rad = np.array(self._turned).T
        return float(np.interp(end_s, stamps_s, angles_rad) - np.interp(begin_s, stamps_s, angles_rad))

    def _judge(self) -> None:
        agreement = self._agreement
        told = agreement.explanations(self._floor_ratio, is_accused=bool(self._found))
        if not told:
            self._together = self._begin
        self._found = [one for one in told if self._is_likely(one)]
        if self._found:
            self._is_sure = all(self._is_surely(one) for one in self._found)
            whose = {one.culprit for one in self._found}
            if self._is_sure and len(whose) == 1:
                self.left_out = self._found[0].culprit
            return
        self._is_sure = False
        is_enough = agreement.way_m > _ENOUGH_M and agreement.turn_rad > _ENOUGH_RAD
        if is_enough and agreement.agrees():
            self._has_agreed = True
            self._stop_if_sound()

    def _stop_if_sound(self) -> None:
        """Nobody is left out once all that is compared goes together."""
        if self._has_agreed and self._colors.is_sound:
            self.by_wheels = None

    def _late_color(self) -> Explanation:
        frames = "a frame" if self._colors.late == 1 else f"{self._colors.late} frames"
        cause = f"its colour images are {frames} later than the depth that they come with: pair them by their stamps"
        return Explanation(Culprit.CAMERA, cause, np.zeros((6, 2)))

    def _leave_out_blind(self) -> None:
        """A camera that shows the floor elsewhere, and cannot be followed, is left out without its ways."""
        ratio = self._floor_ratio
        assert ratio is not None
        cause = f"{depth_cause(ratio)}, or the height in T_base_camera"
        self._found = [Explanation(Culprit.CAMERA, cause, np.zeros((6, 2)), True, ratio)]
        self._is_sure, self.left_out = True, Culprit.CAMERA

    def _is_likely(self, one: Explanation) -> bool:
        agreement = self._agreement
        if not one.is_scale:
            return True
        apart_m, apart_rad = np.ptp(agreement.ways_m), np.ptp(agreement.turns_rad)
        return bool(apart_m > _LIKELY_M or apart_rad > _LIKELY_RAD)

    def _is_surely(self, one: Explanation) -> bool:
        agreement, slips = self._agreement, one.is_scale and one.culprit is Culprit.WHEELS
        way_m, turn_rad = (_SURE_SLIP_M, _SURE_SLIP_RAD) if slips else (_SURE_M, _SURE_RAD)
        return agreement.pieces >= _SURE_PIECES and (agreement.way_m > way_m or agreement.turn_rad > turn_rad)


def _causes(found: list[Explanation], whose: Culprit) -> list[str]:
    return list(dict.fromkeys(one.cause for one in found if one.culprit is whose))
