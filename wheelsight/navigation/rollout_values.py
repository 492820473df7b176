"""What rollouts are made of, as kernels take it."""

from __future__ import annotations

from typing import NamedTuple

from wheelsight.geometry import FloatArray
from wheelsight.navigation.fields import Outline


class Begin(NamedTuple):
    """Where rollouts begin: pose, measured speeds, the way's point there, and how far obstacles and people are."""

    x: float
    y: float
    yaw: float
    forward_m_s: float
    turn_rad_s: float
    point: int
    clearance_m: float
    apart_m: float


class Way(NamedTuple):
    """A piece of a path that is driven in one direction.

    Attributes:
        points: (M, 6) x, y, cosine and sine of the robot's heading, metres along, and the fastest speed there.
        direction: 1 forward, -1 backward.
    """

    points: FloatArray
    direction: float


class Dynamics(NamedTuple):
    """How a base follows commands.

    Attributes:
        outline: what must touch nothing.
        forward_m_s, backward_m_s, turn_rad_s: the fastest.
        speed_up, slow_down, turn_change: by how much speeds change in one step, at most.
        share: of what is left to a command, a step's part by its lag.
        step_s: seconds a step.
        reach_m: from the axle to the farthest corner.
    """

    outline: Outline
    forward_m_s: float
    backward_m_s: float
    turn_rad_s: float
    speed_up: float
    slow_down: float
    turn_change: float
    share: float
    step_s: float
    reach_m: float


class Weights(NamedTuple):
    """What counts how much, for a second of a rollout where nothing else is said.

    Attributes:
        aside: half a square metre beside the way; beyond `aside_m` it grows as the distance.
        heading: heading against the way's, 1 - cosine.
        progress: a metre less along the way, at the end.
        beyond: a square metre beyond the way's end.
        wrong_way: a metre a second against the way's direction.
        too_fast: a metre a second above a zone's limit.
        cost: the field's cost.
        near: of an obstacle, from 0 at `near_m` to all at `margin_m`, as a square.
        change_forward, change_turn: the square of a command's change in one step.
        contact: of coming nearer than `margin_m`, once.
        people: as `near`, of people, within `people_m`.
    """

    aside: float
    aside_m: float
    heading: float
    progress: float
    beyond: float
    wrong_way: float
    too_fast: float
    cost: float
    near: float
    change_forward: float
    change_turn: float
    contact: float
    people: float
    margin_m: float
    near_m: float
    people_margin_m: float
    people_m: float
