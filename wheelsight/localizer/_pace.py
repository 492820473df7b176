"""Pace: where a camera would be that goes on as it went last, for when the wheels cannot be asked."""

from __future__ import annotations

from wheelsight.geometry import FloatArray, se3


class Pace:
    """Remembers the last two frames that were tracked.

    Args:
        longest_step_s: over a longer gap the velocity is unknown.
    """

    def __init__(self, longest_step_s: float) -> None:
        self.longest_step_s = longest_step_s
        self._before: tuple[float, FloatArray] | None = None
        self._last: tuple[float, FloatArray] | None = None

    def tell(self, stamp_s: float, T_map_camera: FloatArray) -> None:
        """A tracked frame's pose (4, 4)."""
        self._before, self._last = self._last, (stamp_s, T_map_camera)

    def expect(self, stamp_s: float) -> FloatArray | None:
        """T_last_current (4, 4) at constant velocity; None where that is unknown or too long ago."""
        if self._before is None or self._last is None:
            return None
        seconds, since_s = self._last[0] - self._before[0], stamp_s - self._last[0]
        if not (0 < seconds <= self.longest_step_s and 0 < since_s <= self.longest_step_s):
            return None
        return se3.exp(se3.log(se3.invert(self._before[1]) @ self._last[1]) * (since_s / seconds))
