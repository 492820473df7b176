"""Segments: a path cut where the robot stands: where it turns in place, and where it changes its direction."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from wheelsight.geometry import FloatArray
from wheelsight.geometry.se2 import wrap_angle

_SAME_M, _SAME_RAD = 1e-3, 1e-3
_MOST_TURN_RAD = 3.0


@dataclass(frozen=True, slots=True, eq=False)
class Segment:
    """A piece of a path.

    Attributes:
        direction: 1 forward, -1 backward, 0 a turn in place.
        points: (M, 5) x, y, cosine and sine of the robot's heading, metres along; (0, 5) of a turn.
        end: (3,) x, y, yaw where it ends.
    """

    direction: int
    points: FloatArray
    end: FloatArray

    @property
    def length_m(self) -> float:
        """Of the way; 0 of a turn."""
        return float(self.points[-1, 4]) if len(self.points) else 0.0


def cut(poses: FloatArray, spacing_m: float, kink_rad: float) -> tuple[Segment, ...]:
    """Segments of a path of poses (N, 3).

    Args:
        poses: x, y, yaw, finite.
        spacing_m: between points of a segment, at most.
        kink_rad: a bend between two pieces beyond which the robot stands and turns.
    """
    made = _Cutter(poses[0], spacing_m)
    for before, after in pairwise(poses):
        way = after[:2] - before[:2]
        if np.hypot(*way) >= _SAME_M:
            made.drive(way, before, after, kink_rad)
        elif abs(wrap_angle(after[2] - before[2])) > _SAME_RAD:
            made.turn(after)
    made.turn(poses[-1])
    return tuple(made.segments)


class _Cutter:
    """Puts pieces together until the robot must stand."""

    def __init__(self, first: FloatArray, spacing_m: float) -> None:
        self.segments: list[Segment] = []
        self._spacing_m = spacing_m
        self._yaw = float(first[2])
        self._nodes = [first[:2]]
        self._headings: list[float] = []
        self._direction = 0
        self._turned = 0.0

    def drive(self, way: FloatArray, before: FloatArray, after: FloatArray, kink_rad: float) -> None:
        """A piece of a way; on with those before where it is as they are."""
        direction, heading = _driving(way, float(before[2]), float(after[2]))
        if self._direction and (direction != self._direction or abs(wrap_angle(heading - self._yaw)) > kink_rad):
            self.turn(np.array([*before[:2], heading]))
        self._nodes.append(after[:2])
        self._headings.append(heading)
        self._direction, self._yaw = direction, heading

    def turn(self, pose: FloatArray) -> None:
        """End what is driven; and a turn to a pose's yaw, where that is another."""
        if self._headings:
            self.segments.append(_driven(np.array(self._nodes), self._headings, self._direction, self._spacing_m))
        turn = float(wrap_angle(pose[2] - self._yaw))
        if abs(turn) > _SAME_RAD:
            self._turn(turn, np.array([*self._nodes[-1], pose[2]]))
        self._yaw, self._nodes = float(pose[2]), [pose[:2]]
        self._headings, self._direction = [], 0

    def _turn(self, turn: float, end: FloatArray) -> None:
        """A turn, or more of the one before: of half a turn and more nobody could tell to which side it goes."""
        goes_on = bool(self.segments) and not self.segments[-1].direction and not self._headings
        if goes_on and turn * self._turned > 0 and abs(turn + self._turned) < _MOST_TURN_RAD:
            self.segments.pop()
            turn += self._turned
        self._turned = turn
        self.segments.append(Segment(0, np.empty((0, 5)), end))


def _driving(way: FloatArray, yaw_before: float, yaw_after: float) -> tuple[int, float]:
    """Direction of a piece, and the robot's heading along it."""
    along = float(np.arctan2(way[1], way[0]))
    by_before, by_after = np.cos(along - yaw_before), np.cos(along - yaw_after)
    # One of both may be that of a robot or a goal, which looks anywhere.
    direction = 1 if (by_before if abs(by_before) > abs(by_after) else by_after) >= 0 else -1
    return direction, along if direction > 0 else float(wrap_angle(along + np.pi))


def _driven(nodes: FloatArray, headings: list[float], direction: int, spacing_m: float) -> Segment:
    """A segment with points close enough to each other."""
    rows = []
    along = 0.0
    for before, after, heading in zip(nodes[:-1], nodes[1:], headings, strict=True):
        length = float(np.hypot(*(after - before)))
        shares = np.arange(max(int(np.ceil(length / spacing_m)), 1)) / max(int(np.ceil(length / spacing_m)), 1)
        c, s = np.cos(heading), np.sin(heading)
        rows += [(*(before + share * (after - before)), c, s, along + share * length) for share in shares]
        along += length
    rows.append((*nodes[-1], np.cos(headings[-1]), np.sin(headings[-1]), along))
    return Segment(direction, np.array(rows), np.array([*nodes[-1], headings[-1]]))
