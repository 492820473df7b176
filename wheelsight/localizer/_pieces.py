"""Pieces: a drive by wheels and by camera, cut into pieces and summed up."""

from __future__ import annotations

from collections.abc import Callable

from wheelsight.calibration import HolonomicWheels, Wheels
from wheelsight.geometry import FloatArray
from wheelsight.geometry import motion_kernels as motions
from wheelsight.odometry.extrinsics import Agreement, AgreementSettings


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
