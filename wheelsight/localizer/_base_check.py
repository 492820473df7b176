"""BaseCheck: over the first metres of a joined run, whether wheels and camera tell of one drive; else who is left out.

A calibration that is wrong, by a depth's factor, a mount, ticks a turn or wheels that are swapped, contradicts
the other sensor all along, by far more than a filter may allow for errors of sensors. So both motions are compared as
`calibrate base` does. Until something is found, the filter's answers stand as they are. Something that is likely
makes the answer that of the other sensor, or one that covers both; something that is sure leaves the sensor out.
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import replace

import numpy as np

from wheelsight.calibration import Calibration
from wheelsight.estimates import Estimate, Reason, WheelEstimate
from wheelsight.events import RgbdFrame
from wheelsight.fusion import ErrorStateFilter, FusedEstimate, covering_pose
from wheelsight.geometry import FloatArray
from wheelsight.geometry import motion_kernels as motions
from wheelsight.localizer._camera_poses import BasePose, CameraPoses
from wheelsight.localizer._color_check import ColorCheck
from wheelsight.localizer._floor_views import FloorViews
from wheelsight.localizer._pieces import Pieces
from wheelsight.localizer._verdict import Verdict, late_color
from wheelsight.localizer._wheel_poses import WheelPoses
from wheelsight.odometry.extrinsics import Agreement, Culprit, ExtrinsicsSettings
from wheelsight.settings import BaseCheckSettings, ColorCheckSettings


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
