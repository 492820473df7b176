"""Pace: where a camera would be that goes on as it went last, for when the wheels cannot be asked."""

from __future__ import annotations

from wheelsight.geometry import FloatArray, se3
from wheelsight.odometry._velocity import LONGEST_STEP_S


class Pace:
    """Remembers the last frame that was tracked and the velocity there."""

    def __init__(self) -> None:
        self._last: tuple[float, FloatArray] | None = None
        self._twist: FloatArray | None = None

    def tell(self, stamp_s: float, T_world_camera: FloatArray) -> None:
        """A tracked frame's pose (4, 4)."""
        seconds = None if self._last is None else stamp_s - self._last[0]
        self._twist = None
        if self._last is not None and seconds is not None and 0 < seconds <= LONGEST_STEP_S:
            self._twist = se3.log(se3.invert(self._last[1]) @ T_world_camera) / seconds
        self._last = stamp_s, T_world_camera

    def expect(self, stamp_s: float) -> FloatArray | None:
        """T_last_current (4, 4) at constant velocity; None where that is unknown or too long ago."""
        if self._last is None or self._twist is None or not 0 < stamp_s - self._last[0] <= LONGEST_STEP_S:
            return None
        return se3.exp(self._twist * (stamp_s - self._last[0]))
