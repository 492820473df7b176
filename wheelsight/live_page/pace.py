"""Pace: holds a robot whose time stands still between steps to the clock on the wall."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable

# A step that renders a frame takes longer than others; what is later than so much is not made up for.
_MOST_LATE_S = 0.5
_SPAN_S = 3.0


class Pace:
    """`wait` after each step.

    Args:
        robot_s: the robot's clock, seconds.
        wall_s, sleep: the wall's.
    """

    def __init__(
        self,
        robot_s: Callable[[], float],
        wall_s: Callable[[], float] = time.monotonic,
        sleep: Callable[[float], None] = time.sleep,
    ) -> None:
        self._robot_s, self._wall_s, self._sleep = robot_s, wall_s, sleep
        self._ahead_s = robot_s() - wall_s()
        self._seen: deque[tuple[float, float]] = deque()

    @property
    def share(self) -> float:
        """Of real time at which the robot's went lately; 1 where the computer keeps up."""
        if len(self._seen) < 2:
            return 1.0
        (wall_s, robot_s), (wall_now_s, robot_now_s) = self._seen[0], self._seen[-1]
        return (robot_now_s - robot_s) / max(wall_now_s - wall_s, 1e-6)

    def wait(self) -> None:
        """Until the wall's clock is where the robot's is; a robot that is late goes on at once."""
        robot_s, wall_s = self._robot_s(), self._wall_s()
        early_s = robot_s - wall_s - self._ahead_s
        if early_s > 0:
            self._sleep(early_s)
        elif early_s < -_MOST_LATE_S:
            self._ahead_s = robot_s - wall_s + _MOST_LATE_S
        self._seen.append((self._wall_s(), robot_s))
        while self._seen[-1][0] - self._seen[0][0] > _SPAN_S and len(self._seen) > 2:
            self._seen.popleft()
