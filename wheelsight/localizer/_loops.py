"""LoopsBeside: hands an odometry's new keyframes to the thread that closes loops, and moves them where it says."""

from __future__ import annotations

import numpy as np

from wheelsight.calibration import Calibration
from wheelsight.config import Config
from wheelsight.geometry import FloatArray, se3
from wheelsight.keyframes import KeyframeId, KeyframeStore
from wheelsight.slam.live import ClosedLoops, LivedKeyframe, LiveLoops
from wheelsight.slam.settings import FROM_KEYFRAMES


class LoopsBeside:
    """See the module.

    Args:
        store: of the odometry.
        calibration, settings: of the run.
        waits: see `LiveLoops`.
    """

    def __init__(self, store: KeyframeStore, calibration: Calibration, settings: Config, *, waits: bool) -> None:
        self._store = store
        self._live = LiveLoops(store, calibration, settings.loops, settings.recognition, waits=waits)
        self._told = 0

    def move_keyframes(self, stamp_s: float, keyframe: KeyframeId | None) -> FloatArray | None:
        """Put keyframes to where loops have them; T_new_old (4, 4) of one of them, or None where none has moved.

        Those that are newer than what the thread knows go with the last one that it does.
        """
        T_known = self._live.due(stamp_s)
        if T_known is None:
            return None
        T_old = np.array(self._store.T_map_keyframe)
        T_last = T_known[-1] @ se3.invert(T_old[len(T_known) - 1])
        T_new = np.concatenate([T_known, T_last @ T_old[len(T_known) :]])
        self._store.move(list(self._store), T_new)
        at = len(T_known) - 1 if keyframe is None else keyframe
        return np.asarray(se3.nearest(T_new[at] @ se3.invert(T_old[at])))

    def hand_over(self, stamp_s: float, T_odom_map: FloatArray, covariance: FloatArray | None) -> None:
        """Keyframes that odometry has kept at a frame, where the camera's pose in odom is as uncertain as (6, 6)."""
        if covariance is None:
            return
        for number in range(self._told, len(self._store)):
            T_odom_keyframe = se3.nearest(T_odom_map @ self._store.pose(KeyframeId(number)))
            self._live.add(LivedKeyframe(KeyframeId(number), stamp_s, T_odom_keyframe, covariance))
        self._told = len(self._store)

    def finish(self) -> ClosedLoops:
        """All loops, once the drive is over; keyframes are put to where they are known to be."""
        found = self._live.finish()
        if len(found.T_map_keyframe) == len(self._store):
            self._store.move(list(self._store), found.T_map_keyframe)
        return found

    def close(self) -> None:
        """End the thread."""
        self._live.close()


def loops_beside(
    store: KeyframeStore, calibration: Calibration, settings: Config, *, waits: bool
) -> LoopsBeside | None:
    """Where the settings ask for loops that the camera finds; Ligocki's filter, as its paper has it, knows none."""
    is_asked = settings.loops.source == FROM_KEYFRAMES and settings.fusion.filter != "ligocki"
    return LoopsBeside(store, calibration, settings, waits=waits) if is_asked else None
