"""CameraPoses: where the camera alone has the base, and frames that wait for the wheels to be compared."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from wheelsight.estimates import Estimate
from wheelsight.geometry import FloatArray
from wheelsight.geometry import motion_kernels as motions


@dataclass(frozen=True, slots=True, eq=False)
class BasePose:
    """Of the base, by the camera alone: T_odom_base (4, 4) and its covariance (6, 6)."""

    T: FloatArray
    covariance: FloatArray


class CameraPoses:
    """Poses of a camera as they come.

    Args:
        T_base_camera: (4, 4), rigid.
        most_waiting: frames, at most, that wait for wheels which are not heard.

    Attributes:
        seen: where the base is by the last frame that was tracked.
        newest: stamp and T_map_base (4, 4) of the last one that showed all directions.
        frames, tracked: how many came, and how many of these could be tracked.
    """

    def __init__(self, T_base_camera: FloatArray, most_waiting: int) -> None:
        self.seen: BasePose | None = None
        self.newest: tuple[float, FloatArray] | None = None
        self.frames = self.tracked = 0
        self._T_camera_base = motions.inverse(T_base_camera)
        self._T_odom_map: FloatArray | None = None
        # Those whose time no reading has come to yet; of wheels that are not heard, the last ones.
        self._waiting: deque[tuple[float, FloatArray | None]] = deque(maxlen=most_waiting)

    def begin(self, T_odom_map: FloatArray) -> None:
        """The camera begins, or begins again: frames before tell nothing of those after. Its first map counts."""
        self._waiting.clear()
        if self._T_odom_map is None:
            self._T_odom_map = T_odom_map.copy()

    def add(self, stamp_s: float, seen: Estimate, *, shows_all: bool) -> None:
        """Take where a frame shows the camera, T_map_camera, and whether it shows all directions."""
        if self._T_odom_map is None or seen.T_odom_body is None:
            return
        T_map_base = motions.times(seen.T_odom_body, self._T_camera_base)
        C = np.zeros((6, 6)) if seen.covariance is None else motions.carried(self._T_odom_map, seen.covariance)
        self.seen = BasePose(motions.mended(motions.times(self._T_odom_map, T_map_base)), C)
        if shows_all:
            self.newest = stamp_s, T_map_base
        self._waiting.append((stamp_s, T_map_base if shows_all else None))

    def moved(self, T_new_old: FloatArray) -> None:
        """The map has moved by (4, 4), from the left, where the camera is; frames that wait are of the one before."""
        self._waiting.clear()
        self.newest = None
        if self._T_odom_map is not None:
            self._T_odom_map = motions.times(self._T_odom_map, motions.inverse(T_new_old))

    def until(self, stamp_s: float) -> Iterator[tuple[float, FloatArray | None]]:
        """Stamp and T_map_base (4, 4) of the frames up to a stamp that waited, and wait no longer.

        None in place of the pose of one that did not show all directions.
        """
        while self._waiting and self._waiting[0][0] <= stamp_s:
            yield self._waiting.popleft()
