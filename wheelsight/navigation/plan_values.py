"""Plan and PlanFailure: what a planner answers."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum

from wheelsight.geometry import FloatArray, IntArray


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
