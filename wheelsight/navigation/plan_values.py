"""PathPlanner, and what it answers: Plan or PlanFailure."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from enum import StrEnum
from typing import Protocol

import numpy as np
from numpy.typing import ArrayLike

from wheelsight.checks import answer_of
from wheelsight.errors import ArgumentError, PartError
from wheelsight.geometry import FloatArray, IntArray
from wheelsight.geometry.se2 import wrap_angle
from wheelsight.navigation.costmap import Costmap

# Between two poses of a plan nothing moves farther: a cell of the usual map; and a turn in place by 6°.
_STEP_M, _STEP_RAD = 0.05, 0.1
# A path that ends farther beside its goal leads elsewhere: half of what counts as an arrival.
_AT_GOAL_M, _AT_GOAL_RAD = 0.05, 0.05


class PlanReason(StrEnum):
    """Why there is no plan."""

    INVALID = "start or goal is no pose"
    START_OUTSIDE = "the robot is outside the map"
    START_OCCUPIED = "the robot stands where something is, and finds no way out"
    START_UNKNOWN = "the floor about the robot is unknown, and it finds no way out"
    GOAL_OUTSIDE = "the goal is outside the map"
    GOAL_UNKNOWN = "nobody has seen the floor at the goal"
    GOAL_OCCUPIED = "the robot does not fit at the goal, nor near to it"
    GOAL_IN_WALL = "the map has no room for the robot at the goal, nor near to it"
    STANDS = "its limits let the robot neither forward nor backward"
    UNREACHABLE = "no way leads to the goal"
    NO_WAY_IN_MAP = "no way leads to the goal by the map itself"
    NO_ROOM_IN_MAP = "the map has no place that is wide enough for the robot"
    GAVE_UP = "no way was found within the bounds of the search"
    PART = "the planner failed"

    @property
    def is_for_good(self) -> bool:
        """Whether nothing that passes by itself makes a plan possible."""
        return self in (
            PlanReason.INVALID,
            PlanReason.GOAL_OUTSIDE,
            PlanReason.GOAL_IN_WALL,
            PlanReason.NO_WAY_IN_MAP,
            PlanReason.NO_ROOM_IN_MAP,
            PlanReason.STANDS,
            PlanReason.PART,
        )

    @property
    def is_of_goal(self) -> bool:
        """Whether another goal may have a plan."""
        return self in (
            PlanReason.GOAL_UNKNOWN,
            PlanReason.GOAL_OCCUPIED,
            PlanReason.GOAL_IN_WALL,
            PlanReason.UNREACHABLE,
            PlanReason.NO_WAY_IN_MAP,
            PlanReason.GAVE_UP,
        )


@dataclass(frozen=True, slots=True)
class PlanFailure:
    """That there is no plan: the robot is to stand.

    Attributes:
        reason: why.
        detail: the same for people, with figures.
    """

    reason: PlanReason
    detail: str

    def __bool__(self) -> bool:
        """False."""
        return False


@dataclass(frozen=True, slots=True, eq=False)
class Plan:
    """A way that the footprint can drive, from where the robot stands.

    Attributes:
        poses: (N, 3) x, y, yaw of `base`, dense: between two of them no point of the robot moves farther than twice the
            least margin. In a turn in place x and y stay as they are.
        directions: (N,) 1 where a pose is reached forward, -1 backward; in a turn in place as before it.
        length_m: of the way of the centre of rotation.
        least_clearance_m: of the footprint, over all poses, at most 0.5 m; 0 where it had to get out.
        goal: (3,) where it ends.
        goal_change: why that is not the goal that was asked for; empty where it is.
        frame: of the poses: `map` or `odom`.
        cost: in metres of free floor.
        states: how many places and headings were searched; 0 where the way over the cells did.
        goal_off_m, goal_off_rad: how far that is beside the goal that was asked for.
    """

    poses: FloatArray
    directions: IntArray
    length_m: float
    least_clearance_m: float
    goal: FloatArray
    goal_change: str
    frame: str
    cost: float
    states: int
    goal_off_m: float = 0.0
    goal_off_rad: float = 0.0

    def __bool__(self) -> bool:
        """True."""
        return True

    @classmethod
    def along(cls, places: ArrayLike, yaw: float | None = None, frame: str = "map") -> Plan:
        """A plan forward along places (N, 2) from the robot on, with a turn in place at each bend.

        Args:
            places: x, y, metres; N is 2 or more.
            yaw: heading at the end, radians; None: as the last piece leads.
            frame: of the places, as of the costmap.

        Raises:
            ArgumentError: other shapes, or numbers that are not finite.
        """
        xy = np.asarray(places, float)
        if xy.ndim != 2 or xy.shape[1] != 2 or not np.isfinite(xy).all():
            raise ArgumentError(f"places of shape {xy.shape}", fix="(N, 2) finite metres")
        steps = np.diff(xy, axis=0)
        xy = np.concatenate([xy[:1], xy[1:][np.hypot(*steps.T) > 1e-6]])
        if len(xy) < 2:
            raise ArgumentError("places that lead nowhere", fix="two places or more, apart")
        headings = np.arctan2(*np.diff(xy, axis=0).T[::-1])
        ends = np.stack([xy[:-1], xy[1:]], axis=1).reshape(-1, 2)
        poses = np.column_stack([ends, np.repeat(headings, 2)])
        if yaw is not None:
            poses = np.concatenate([poses, [[*xy[-1], float(yaw)]]])
        length_m = float(np.hypot(*np.diff(xy, axis=0).T).sum())
        return cls(poses, np.ones(len(poses), np.int64), length_m, math.nan, poses[-1].copy(), "", frame, length_m, 0)


class PathPlanner(Protocol):
    """Finds a way over a costmap; `Planner` is the built-in one, and `Navigator` takes another as `planner`.

    What it answers is driven as any plan is: the navigator looks at the way ahead and asks again where something
    stands there, and the collision monitor has the last word. A path through a wall ends before the wall.
    """

    def plan(self, costmap: Costmap, start: FloatArray, goal: FloatArray) -> Plan | PlanFailure:
        """A plan from where the robot stands to a goal, or why there is none; `Plan.along` makes one of places.

        It is called in another thread than the control of a real robot, and several times for one plan: for each
        goal on the way, and with obstacles added where no camera will have looked. An exception, another type, or
        numbers that are not finite end the task with the reason `PlanReason.PART`.

        Args:
            costmap: `state` and `is_lethal` (H, W), `distance_m` to what stands; not to be written to.
            start: (3,) x, y, yaw of `base` in the frame of the costmap.
            goal: (3,) in that frame; or (2,), where any heading will do.
        """
        ...


class OwnPlanner:
    """A `PathPlanner` whose answers are checked; a failure of the part is a `PlanFailure`."""

    def __init__(self, part: PathPlanner) -> None:
        self._part = part

    def plan(self, costmap: Costmap, start: FloatArray, goal: FloatArray) -> Plan | PlanFailure:
        """See `PathPlanner`; poses are as dense as the navigator needs, and an end beside the goal is called so."""
        name = f"{type(self._part).__name__}.plan"
        try:
            found = answer_of(self._part, "plan", costmap, start.copy(), goal.copy())
        except PartError as error:
            return PlanFailure(PlanReason.PART, error.problem)
        if isinstance(found, PlanFailure):
            return found
        if not isinstance(found, Plan):
            return PlanFailure(PlanReason.PART, f"{name} answered {type(found).__name__}, not a Plan or PlanFailure")
        try:
            poses, directions = np.asarray(found.poses, float), np.asarray(found.directions, np.int64)
        except (TypeError, ValueError) as error:
            return PlanFailure(PlanReason.PART, f"{name} answered a plan without numbers: {error}")
        if poses.ndim != 2 or poses.shape[1] != 3 or not len(poses) or directions.shape != (len(poses),):
            of = f"poses of shape {poses.shape} and directions of shape {directions.shape}"
            return PlanFailure(PlanReason.PART, f"{name} answered {of}, not (N, 3) and (N,)")
        if not np.isfinite(poses).all():
            return PlanFailure(PlanReason.PART, f"{name} answered poses that are not finite")
        poses, directions = _dense(poses, directions)
        end = poses[-1].copy()
        off_m = float(np.hypot(*(end[:2] - goal[:2])))
        off_rad = 0.0 if len(goal) < 3 else float(abs(wrap_angle(end[2] - goal[2])))
        change = found.goal_change
        if not change and (off_m > _AT_GOAL_M or off_rad > _AT_GOAL_RAD):
            change = f"{name} leads beside the goal: {off_m:.2f} m and {np.degrees(off_rad):.0f}° beside it"
        length_m = float(np.hypot(*np.diff(poses[:, :2], axis=0).T).sum())
        return replace(
            found,
            poses=poses,
            directions=directions,
            length_m=length_m,
            goal=end,
            goal_change=change,
            frame=costmap.frame,
            goal_off_m=off_m,
            goal_off_rad=off_rad,
        )


def _dense(poses: FloatArray, directions: IntArray) -> tuple[FloatArray, IntArray]:
    """Poses (N, 3) and directions (N,) with so many between that no step is long."""
    made, ways = [poses[:1]], [directions[:1]]
    for before, after, direction in zip(poses[:-1], poses[1:], directions[1:], strict=True):
        way, turn = after[:2] - before[:2], float(wrap_angle(after[2] - before[2]))
        steps = max(math.ceil(np.hypot(*way) / _STEP_M), math.ceil(abs(turn) / _STEP_RAD), 1)
        share = np.arange(1, steps + 1)[:, None] / steps
        made.append(np.column_stack([before[:2] + share * way, wrap_angle(before[2] + share[:, 0] * turn)]))
        ways.append(np.full(steps, direction))
    return np.concatenate(made), np.concatenate(ways)
