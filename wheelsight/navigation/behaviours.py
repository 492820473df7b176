"""Recovery behaviours: wait, turn, drive straight, and the choice between them.

`open_way` finds the direction for a search of the pose. `keeps_clear` checks commands against the map.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import TypeAlias

import cv2
import numpy as np

from wheelsight.core.estimates import Status
from wheelsight.core.geometry import FloatArray
from wheelsight.core.geometry.se2 import wrap_angle
from wheelsight.core.messages import STOP, VelocityCommand
from wheelsight.navigation.clearance_kernels import CostField, Outline, clearance_at, free_arc, moved
from wheelsight.navigation.costmap import CellState, Costmap
from wheelsight.navigation.settings import BehaviourSettings, checked

# Least progress, radians and metres; and the time that the collision monitor may hold a behaviour before it ends.
_LEAST_RAD, _LEAST_M, _REFUSED_S = 0.02, 0.01, 2.0
# Turn rate of turns to look around or to search; images blur beyond.
_TURN_RAD_S = 0.4
# Turn to either side to look around, as the view of a Kinect is 1 rad wide; and of a lost robot, once around.
_LOOK_RAD, _SEARCH_RAD = 1.0, 6.4
# Speed of the way to the next place of a search, and the least such way; less shows nothing new.
_SEARCH_M_S, _LEAST_SEARCH_M = 0.2, 0.5
# Way back, without a camera; and way back from unseen floor: a chair's camera, 0.35 m ahead of the axle, observes floor
# from 0.5 m on, where the front was. Both at this speed.
_BACK_M, _UNSEEN_BACK_M, _BACK_M_S = 0.3, 0.8, 0.1


@dataclass
class Wait:
    """Stand for some seconds."""

    seconds: float
    name: str = "wait"
    _until_s: float = field(default=math.nan, init=False)

    def command(self, now_s: float, odom_pose: FloatArray | None) -> VelocityCommand | None:
        """Return the command of a period; None once the behaviour is complete, or makes no more progress.

        Args:
            now_s: current time, by the clock of the stamps.
            odom_pose: (3,) x, y, yaw in `odom`, or None if unknown.
        """
        if math.isnan(self._until_s):
            self._until_s = now_s + self.seconds
        return STOP if now_s < self._until_s else None


@dataclass
class Turn:
    """Turn in place by angles, one after another; counter-clockwise if positive."""

    angles_rad: tuple[float, ...]
    name: str = "look about"
    _progress: _Progress = field(init=False)
    _left: list[float] = field(init=False)
    _yaw: float | None = field(default=None, init=False)

    def __post_init__(self) -> None:
        self._progress, self._left = _Progress(_LEAST_RAD), list(self.angles_rad)

    def command(self, now_s: float, odom_pose: FloatArray | None) -> VelocityCommand | None:
        """See `Wait.command`."""
        if odom_pose is None or not self._left:
            return None
        yaw = float(odom_pose[2])
        turned = 0.0 if self._yaw is None else float(wrap_angle(yaw - self._yaw))
        self._yaw = yaw
        sign = math.copysign(1.0, self._left[0])
        self._left[0] -= turned
        if self._left[0] * sign <= 0 or self._progress.is_held(now_s, abs(self._left[0])):
            self._left.pop(0)
            self._progress = _Progress(_LEAST_RAD)
            return STOP if self._left else None
        return VelocityCommand(0.0, sign * _TURN_RAD_S)


@dataclass
class Straight:
    """Drive straight on, or backward if the way is negative."""

    way_m: float
    speed_m_s: float
    name: str
    _progress: _Progress = field(init=False)
    _from: FloatArray | None = field(default=None, init=False)

    def __post_init__(self) -> None:
        self._progress = _Progress(_LEAST_M)

    def command(self, now_s: float, odom_pose: FloatArray | None) -> VelocityCommand | None:
        """See `Wait.command`."""
        if odom_pose is None:
            return None
        if self._from is None:
            self._from = odom_pose
        left_m = abs(self.way_m) - float(np.hypot(*(odom_pose[:2] - self._from[:2])))
        if left_m <= 0 or self._progress.is_held(now_s, left_m):
            return None
        return VelocityCommand(math.copysign(self.speed_m_s, self.way_m), 0.0)


@dataclass
class Series:
    """Several behaviours one after another."""

    parts: tuple[Behaviour, ...]
    name: str

    def command(self, now_s: float, odom_pose: FloatArray | None) -> VelocityCommand | None:
        """See `Wait.command`."""
        while self.parts:
            command = self.parts[0].command(now_s, odom_pose)
            if command is not None:
                return command
            self.parts = self.parts[1:]
        return None


Behaviour: TypeAlias = Wait | Turn | Straight | Series
"""A motion until it is complete; its command is requested once per period."""


class _Progress:
    """Detects that the rest of a motion has not decreased for too long."""

    def __init__(self, least: float) -> None:
        self._least = least
        self._best, self._since_s = math.inf, math.nan

    def is_held(self, now_s: float, left: float) -> bool:
        """Update by the rest of the motion; return whether it is stuck."""
        if left < self._best - self._least or math.isnan(self._since_s):
            self._best, self._since_s = left, now_s
        return now_s - self._since_s > _REFUSED_S


_LOOK = (_LOOK_RAD, -2 * _LOOK_RAD, _LOOK_RAD)


def when_blocked(attempt: int, wait_s: float) -> Behaviour:
    """Return the behaviour of an attempt to get free, the gentlest first."""
    ways: tuple[Behaviour, ...] = (Wait(wait_s), Turn(_LOOK), Straight(-_BACK_M, _BACK_M_S, "back up"))
    return ways[attempt % len(ways)]


def beside_goal(wait_s: float) -> Behaviour:
    """Return the behaviour beside a goal that is occupied: wait, then look around.

    The camera does not see what is beside the robot, so it must look there to see that a person has left.
    """
    return Series((Wait(wait_s), Turn(_LOOK)), "wait until there is room at its goal")


def unsure_at_goal() -> Behaviour:
    """Return the behaviour at a goal where the pose is too uncertain: look around, for what the map shows there."""
    return Turn(_LOOK, "look for what the map shows at its goal")


def when_unseen(attempt: int, *, was_backward: bool) -> Behaviour:
    """Return the behaviour in front of unseen floor, where waiting does not help.

    The robot first backs up until its camera sees the floor that was under its front. After a backward motion it drives
    forward instead, as no camera looks behind it.
    """
    if attempt % 2:
        return Turn(_LOOK)
    if was_backward:
        return Straight(_UNSEEN_BACK_M, _BACK_M_S, "drive on, away from what is behind")
    return Straight(-_UNSEEN_BACK_M, _BACK_M_S, "back up, to see where its front was")


def when_lost(
    attempt: int, settings: BehaviourSettings, status: Status, open_way: OpenWay | None, *, is_held: bool, sees: bool
) -> Behaviour:
    """Return the behaviour that searches for the pose: wait, turn once around, then turn at another place.

    At the start in a map the robot does not wait, as one view is not enough to recognize a place. If it may turn to
    neither side, or its camera shows nothing, it backs up from what is too near. It does not drive on before a whole
    turn has shown its surroundings: the floor ahead of a robot at the start is trusted, but not seen, and it has driven
    into the frame of a bed there.

    Args:
        open_way: where to drive; None to stay.
        is_held: whether the collision monitor or the map stopped the last attempt.
        sees: whether the camera has depth.
    """
    begins = status is Status.INITIALIZING
    if attempt == 0 and not begins:
        return Wait(settings.wait_s / 2, "wait to see where it is")
    if is_held and (attempt % 3 == 2 or (attempt > 0 and not sees)):
        return Straight(-_BACK_M, _BACK_M_S, "back up, to see where it is")
    is_second = (attempt + begins) % 2 == 0
    if is_second and not is_held and open_way is not None and open_way.way_m >= _LEAST_SEARCH_M:
        way_m = min(open_way.way_m, settings.search_m)
        parts = Turn((open_way.turn_rad,)), Straight(way_m, _SEARCH_M_S, "drive on")
        return Series(parts, f"look for a known place {way_m:.1f} m from here")
    sign = -1.0 if is_second else 1.0
    return Turn((sign * _SEARCH_RAD,), "look for a known place")


_DIRECTIONS = 24
_STEP_M = 0.05
# A way is not measured farther than this.
_FAR_M = 3.0


@dataclass(frozen=True, slots=True)
class OpenWay:
    """A turn in place, then a way straight on."""

    turn_rad: float
    way_m: float


def open_way(costmap: Costmap, outline: Outline, pose: FloatArray, margin_m: float) -> OpenWay:
    """Return the longest straight way, after the least turn; it does not check the turn itself.

    Args:
        pose: (3,) x, y, yaw in the costmap's frame.
    """
    field, no_people = checked(costmap.field), np.empty((0, 5))
    turns = 2 * np.pi / _DIRECTIONS * np.arange(-(_DIRECTIONS // 2), _DIRECTIONS // 2)
    x, y, yaw = map(float, pose)
    arc = (_STEP_M, 0.0, 0.0, round(_FAR_M / _STEP_M))
    steps = [
        int(free_arc(field, outline, no_people, (x, y, float(np.cos(a)), float(np.sin(a))), arc, margin_m))
        for a in yaw + turns
    ]
    best = min(range(_DIRECTIONS), key=lambda n: (-steps[n], abs(turns[n])))
    return OpenWay(float(turns[best]), steps[best] * _STEP_M)


# Of `keeps_clear`: the least distance to obstacles of the map, a cell, which is the error of maps; the time ahead that
# is checked, as the robot has stopped by then; and its steps.
_CLEAR_M, _CLEAR_S, _STEP_S = 0.05, 0.8, 0.1


def keeps_clear(
    costmap: Costmap, outline: Outline, pose: FloatArray, command: VelocityCommand, *, minds_unknown: bool = False
) -> bool:
    """Return whether a command, driven for `_CLEAR_S`, keeps a distance of `_CLEAR_M` from obstacles of the map.

    Behaviours follow no plan, the camera does not see all around, and the monitor forgets obstacles out of view. A
    robot that looked around beside a kitchen counter turned into it, 40 s after it had seen it. A robot that is nearer
    already may only move away.

    Args:
        pose: (3,) x, y, yaw in the map.
        minds_unknown: whether unknown floor counts as an obstacle.
    """
    is_obstacle = costmap.state == CellState.OCCUPIED
    if minds_unknown:
        is_obstacle |= costmap.state == CellState.UNKNOWN
    is_free = (~is_obstacle).astype(np.uint8)
    distance_m = cv2.distanceTransform(is_free, cv2.DIST_L2, cv2.DIST_MASK_PRECISE) * np.float32(costmap.resolution_m)
    field = CostField(distance_m, np.zeros_like(distance_m), costmap.resolution_m, costmap.origin)
    at = (float(pose[0]), float(pose[1]), float(np.cos(pose[2])), float(np.sin(pose[2])))
    least_m = float(clearance_at(field, outline, at, _CLEAR_M))
    for _ in range(round(_CLEAR_S / _STEP_S)):
        at = moved(at, command.forward_m_s * _STEP_S, command.turn_rad_s * _STEP_S)
        clearance_m = float(clearance_at(field, outline, at, _CLEAR_M))
        if clearance_m < min(_CLEAR_M, least_m):
            return False
    return True
