"""Goals: where a task leads to, one after another; known beforehand, or found on the way."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol

import numpy as np
from numpy.typing import ArrayLike

from wheelsight.core.errors import ArgumentError
from wheelsight.core.geometry import FloatArray
from wheelsight.navigation.costmap import Costmap, StaticLayer

_DIMENSIONS = (2, 3)
# A pose of a recorded way is passed that is nearer than this.
_PASSED_M = 0.7


class Goals(Protocol):
    """Of one task."""

    @property
    def name(self) -> str:
        """In words."""

    @property
    def left(self) -> int:
        """How many are left, as far as is known."""

    @property
    def is_asked_for(self) -> bool:
        """Whether somebody asked for that very place: then it is not the same to come to stand beside it."""

    def upcoming(self, pose: FloatArray, costmap: Costmap) -> tuple[FloatArray, ...]:
        """The poses (3,) that the next plan leads through, without a stop but at the last; none: all is done.

        Asked each time a plan is made, also for the same goal again, and maybe by another thread; nothing else is
        asked until it answers. A yaw of NaN is any heading.
        """

    def is_met(self, pose: FloatArray, layer: StaticLayer) -> bool:
        """Whether the next one asks for no more driving, wherever the robot is by now."""

    def taken(self) -> None:
        """The robot goes by what was made for them: a plan, or that no way leads there."""

    def reached(self) -> None:
        """The last of those that were taken was reached."""

    def missed(self) -> bool:
        """No way led there; whether the task goes on without it."""


class Poses:
    """Poses one after another, with a stop at each.

    Args:
        goals: each (3,) x, y, yaw in the map, or (2,) for any heading.
        name: in words.

    Raises:
        ArgumentError: none, or one that is not finite.
    """

    def __init__(self, goals: Sequence[ArrayLike], name: str = "") -> None:
        self._left = [checked_goal(goal) for goal in goals]
        if not self._left:
            raise ArgumentError("no goal", fix="give one pose at least")
        self.name = name or (words_of(self._left[0]) if len(self._left) == 1 else f"{len(self._left)} goals")

    @property
    def left(self) -> int:
        """See `Goals`."""
        return len(self._left)

    @property
    def is_asked_for(self) -> bool:
        """See `Goals`."""
        return True

    def upcoming(self, pose: FloatArray, costmap: Costmap) -> tuple[FloatArray, ...]:
        """See `Goals`."""
        return tuple(self._left[:1])

    def is_met(self, pose: FloatArray, layer: StaticLayer) -> bool:
        """See `Goals`: a pose is driven to."""
        return False

    def taken(self) -> None:
        """See `Goals`: they are the same each time."""

    def reached(self) -> None:
        """See `Goals`."""
        self._left.pop(0)

    def missed(self) -> bool:
        """See `Goals`: whoever asks for several wants them all."""
        return False


class Way:
    """Along a way that was driven before, without a stop but at its end.

    Args:
        way: (N, 3) x, y, yaw in the map.
        apart_m: distance between the poses that are kept of it.
        name: in words.

    Raises:
        ArgumentError: no poses, or one that is not finite.
    """

    def __init__(self, way: ArrayLike, apart_m: float, name: str = "a recorded way") -> None:
        poses = np.asarray(way, float)
        if poses.ndim != 2 or poses.shape[1] != 3 or not len(poses) or not np.isfinite(poses).all():
            raise ArgumentError(f"a way of shape {poses.shape}", fix="give (N, 3) of x, y, yaw, finite")
        self._left = [poses[0]]
        for pose in poses[1:-1]:
            if np.hypot(*(pose[:2] - self._left[-1][:2])) >= apart_m:
                self._left.append(pose)
        if len(poses) > 1:
            self._left.append(poses[-1])
        self.name = name

    @property
    def left(self) -> int:
        """See `Goals`."""
        return len(self._left)

    @property
    def is_asked_for(self) -> bool:
        """See `Goals`."""
        return True

    def upcoming(self, pose: FloatArray, costmap: Costmap) -> tuple[FloatArray, ...]:
        """See `Goals`: all that was not passed yet."""
        self._pass(pose)
        return tuple(self._left)

    def is_met(self, pose: FloatArray, layer: StaticLayer) -> bool:
        """See `Goals`: its end is driven to. What was passed is in no later plan, however late that is made."""
        self._pass(pose)
        return False

    def _pass(self, pose: FloatArray) -> None:
        """In order: where the way crosses itself, what comes later is not passed."""
        # As one step: a plan may be in the making beside it.
        left = self._left
        while len(left) > 1 and np.hypot(*(left[0][:2] - pose[:2])) < _PASSED_M:
            left = left[1:]
        self._left = left

    def taken(self) -> None:
        """See `Goals`: its end is the same each time."""

    def reached(self) -> None:
        """See `Goals`."""
        self._left.clear()

    def missed(self) -> bool:
        """See `Goals`: what is in the way is left out, but for the end."""
        if len(self._left) > 1:
            self._left.pop(0)
            return True
        return False


def words_of(pose: FloatArray) -> str:
    """A pose for people."""
    yaw = "" if np.isnan(pose[2]) else f", {np.degrees(pose[2]):.0f}°"
    return f"({pose[0]:.2f}, {pose[1]:.2f}) m{yaw}"


def checked_goal(goal: ArrayLike) -> FloatArray:
    """(3,) of a pose (3,) or place (2,), its yaw NaN. Raises ArgumentError for what is none."""
    pose = np.array(goal, float).ravel()
    if len(pose) not in _DIMENSIONS or not np.isfinite(pose).all():
        raise ArgumentError(f"a goal of {pose}", fix="give x, y and yaw in the map, metres and radians, or x and y")
    return np.array([*pose, np.nan][:3])
