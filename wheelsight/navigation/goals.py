"""Goals: destinations of a task, given in advance or found on the way."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol

import numpy as np
from numpy.typing import ArrayLike

from wheelsight.core.errors import ArgumentError
from wheelsight.core.geometry import FloatArray
from wheelsight.navigation.costmap import Costmap, StaticLayer

_DIMENSIONS = (2, 3)
# Distance at which a pose of a recorded path counts as passed.
_PASSED_M = 0.7


class Goals(Protocol):
    """Destinations of one task."""

    @property
    def name(self) -> str:
        """Name in words."""

    @property
    def left(self) -> int:
        """Number of goals left, as far as is known."""

    @property
    def is_asked_for(self) -> bool:
        """Whether the user requested these places, so that stopping beside them is not an arrival."""

    def upcoming(self, pose: FloatArray, costmap: Costmap) -> tuple[FloatArray, ...]:
        """Return the poses (3,) of the next plan, with a stop at the last one only; empty if the task is complete.

        The call comes for each plan, even to the same goal, and maybe from another thread. No other method is called
        until it returns. A yaw of NaN is any heading.
        """

    def is_met(self, pose: FloatArray, layer: StaticLayer) -> bool:
        """Return whether the next goal is complete, wherever the robot is now."""

    def taken(self) -> None:
        """Record that the robot uses the answer for these goals: a plan, or a failure."""

    def reached(self) -> None:
        """Record that the last of the used goals is reached."""

    def missed(self) -> bool:
        """Record that no path leads there; return whether the task continues without it."""


class Poses:
    """Poses one after another, with a stop at each.

    Args:
        goals: each (3,) x, y, yaw in the map, or (2,) for any heading.
        name: in words.

    Raises:
        ArgumentError: there is no goal, or one is not finite.
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
        """Return False: the robot must drive to each pose."""
        return False

    def taken(self) -> None:
        """Do nothing: the goals are the same for each plan."""

    def reached(self) -> None:
        """See `Goals`."""
        self._left.pop(0)

    def missed(self) -> bool:
        """Return False: all poses are required."""
        return False


class Way:
    """A path that was driven before, without a stop but at its end.

    Args:
        way: (N, 3) x, y, yaw in the map.
        apart_m: distance between the poses of it that are kept.
        name: in words.

    Raises:
        ArgumentError: there are no poses, or one is not finite.
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
        """Return all poses that are not passed yet; see `Goals`."""
        self._pass(pose)
        return tuple(self._left)

    def is_met(self, pose: FloatArray, layer: StaticLayer) -> bool:
        """Drop passed poses, and return False: the robot must drive to the end. Later plans do not return to them."""
        self._pass(pose)
        return False

    def _pass(self, pose: FloatArray) -> None:
        """Drop passed poses in order, so that a later pose at a crossing stays."""
        # One assignment at the end, as another thread may plan.
        left = self._left
        while len(left) > 1 and np.hypot(*(left[0][:2] - pose[:2])) < _PASSED_M:
            left = left[1:]
        self._left = left

    def taken(self) -> None:
        """Do nothing: the end is the same for each plan."""

    def reached(self) -> None:
        """See `Goals`."""
        self._left.clear()

    def missed(self) -> bool:
        """Skip a pose that is blocked, but not the end; see `Goals`."""
        if len(self._left) > 1:
            self._left.pop(0)
            return True
        return False


def words_of(pose: FloatArray) -> str:
    """Return a pose in words."""
    yaw = "" if np.isnan(pose[2]) else f", {np.degrees(pose[2]):.0f}°"
    return f"({pose[0]:.2f}, {pose[1]:.2f}) m{yaw}"


def checked_goal(goal: ArrayLike) -> FloatArray:
    """Return (3,) of a pose (3,) or place (2,), with a yaw of NaN. Raises ArgumentError if it is neither."""
    pose = np.array(goal, float).ravel()
    if len(pose) not in _DIMENSIONS or not np.isfinite(pose).all():
        raise ArgumentError(f"a goal of {pose}", fix="give x, y and yaw in the map, metres and radians, or x and y")
    return np.array([*pose, np.nan][:3])
