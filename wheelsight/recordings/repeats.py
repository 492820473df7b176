"""Repeats: whether a camera gives the image of the frame before once more."""

from __future__ import annotations

import numpy as np

from wheelsight.events import RgbdFrame

# Noise never repeats, so some rows decide; the first one nearly always.
_SOME = slice(None, None, 4)


class Repeats:
    """How long one and the same image has been coming, as of a camera of 15 Hz that is logged at 30, or that hangs.

    The rows that are compared are copied: a driver may write each frame where it wrote the last one. Images without
    any contrast, as of a covered camera, show nothing that could come again.
    """

    def __init__(self) -> None:
        self._first_s = np.nan
        self._color, self._depth_m = np.empty((0, 0, 3), np.uint8), np.empty((0, 0), np.float32)

    def lasting_s(self, frame: RgbdFrame) -> float:
        """How long before this frame its image came first; 0 for a new one. To be asked once of each frame."""
        color, depth_m = frame.color[_SOME], frame.depth_m[_SOME]
        if _are_the_same(color, self._color) and _are_the_same(depth_m, self._depth_m) and _shows(color, depth_m):
            return frame.stamp_s - self._first_s
        self._first_s, self._color, self._depth_m = frame.stamp_s, color.copy(), depth_m.copy()
        return 0.0


def _are_the_same(a: np.ndarray, b: np.ndarray) -> bool:
    return a.shape == b.shape and len(a) > 0 and np.array_equal(a[0], b[0]) and np.array_equal(a, b)


def _shows(color: np.ndarray, depth_m: np.ndarray) -> bool:
    """Whether there is depth at all, and any contrast."""
    return bool(depth_m.any() and (np.ptp(color) > 0 or np.ptp(depth_m) > 0))
