"""FrameGate: which frames are worth a look beside wheels."""

from __future__ import annotations

import math

import numpy as np

from wheelsight.events import RgbdFrame
from wheelsight.geometry import FloatArray, so3

# Wheels are waited for so long at the start: they begin the clock.
_WAIT_S = 1.0
# A stamp so far ahead is believed only when others follow it.
_AHEAD_S, _FOLLOWERS = 10.0, 5
# Noise never repeats: a camera that gives the same images while the wheels have gone so far hangs.
_MOVED_M, _MOVED_RAD = 0.005, 0.005
_SAMPLE = slice(None, None, 8)
_FIRST_ROW = (0, _SAMPLE)


class FrameGate:
    """Refuses frames that are old, from another clock, or the one before once more.

    Attributes:
        wheels_are_heard: whether any reading has come.
    """

    def __init__(self) -> None:
        self.wheels_are_heard = False
        self._newest_s, self._first_s = -math.inf, math.inf
        self._ahead = 0
        self._last: RgbdFrame | None = None

    def why_not(self, frame: RgbdFrame, T_last_frame: FloatArray | None) -> str:
        """What is wrong with a frame, or nothing; `T_last_frame` (4, 4) is how the camera is expected to have moved."""
        if not self._newest_s < frame.stamp_s < math.inf:
            return f"its stamp does not come after {self._newest_s:.6f} s"
        if self._newest_s + _AHEAD_S < frame.stamp_s and self._newest_s > -math.inf:
            self._ahead += 1
            if self._ahead < _FOLLOWERS:
                return f"its stamp is {frame.stamp_s - self._newest_s:.1f} s ahead"
        self._ahead = 0
        before, self._last, self._newest_s = self._last, frame, frame.stamp_s
        if before is None or T_last_frame is None or not _repeats(before, frame):
            return ""
        moved = np.linalg.norm(T_last_frame[:3, 3]) > _MOVED_M or so3.angle(T_last_frame[:3, :3]) > _MOVED_RAD
        return "its images are those of the frame before, though the wheels have moved" if moved else ""

    def waits_for_wheels(self, frame: RgbdFrame) -> bool:
        """Whether it is too soon to go without them."""
        self._first_s = min(self._first_s, frame.stamp_s)
        return not self.wheels_are_heard and frame.stamp_s - self._first_s < _WAIT_S


def _repeats(before: RgbdFrame, frame: RgbdFrame) -> bool:
    """Whether the images are the same, by every eighth pixel of every eighth row."""
    pairs = ((before.color, frame.color), (before.depth_m, frame.depth_m))
    if any(a.shape == b.shape and (a[_FIRST_ROW] != b[_FIRST_ROW]).any() for a, b in pairs):
        return False  # as nearly always
    return all(np.array_equal(a[_SAMPLE, _SAMPLE], b[_SAMPLE, _SAMPLE]) for a, b in pairs)
