"""What `wheelsight drive` shows meanwhile: on a terminal a plan and what goes on; else a line a second."""

from __future__ import annotations

import math
import time
from collections import deque
from collections.abc import Iterator
from types import TracebackType

import numpy as np
from rich.console import Group
from rich.live import Live
from rich.table import Table
from rich.text import Text

from wheelsight.cli._console import console, facts_table
from wheelsight.cli._drive_plan import as_text, plan_signs
from wheelsight.cli._progress import left_text
from wheelsight.cli._record_view import clock_of
from wheelsight.navigation import Feedback, Footprint, Navigator, Transition
from wheelsight.navigation.words import STATUS_WORDS, monitor_words

_VIEWS_A_S, _LINES_A_S = 5, 1
_ACROSS_M = 8.0
_FACTS_WIDTH, _MOST_COLUMNS, _LEAST_COLUMNS, _LINES_BELOW = 44, 64, 20, 9
_TRANSITIONS = 5
# A mean speed of less is none.
_MOVED_M = 0.5


class DriveView:
    """Shows a drive on stderr; use it in a `with` block.

    Args:
        footprint: of the robot.
    """

    def __init__(self, footprint: Footprint) -> None:
        self._footprint, self._console = footprint, console(stderr=True)
        self._live = Live(console=self._console, auto_refresh=False) if self._console.is_terminal else None
        self._transitions: deque[Transition] = deque(maxlen=_TRANSITIONS)
        self._shown_s = -math.inf
        self._so_far = SoFar()

    def __enter__(self) -> DriveView:
        if self._live is not None:
            self._live.__enter__()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._live is not None:
            self._live.__exit__(kind, error, trace)

    def note(self, transition: Transition) -> None:
        """A change of state: kept for the terminal, or a line of its own."""
        self._transitions.append(transition)
        if self._live is None:
            self._console.print(f"{transition.stamp_s:.1f} s {transition}")

    def show(self, feedback: Feedback, navigator: Navigator) -> None:
        """A period is over; shown only so many times a second."""
        self._so_far.add(feedback)
        now_s = time.monotonic()
        if now_s - self._shown_s < 1 / (_LINES_A_S if self._live is None else _VIEWS_A_S):
            return
        self._shown_s = now_s
        if self._live is None:
            self._console.print(line_of(feedback, self._so_far, floor_m2(navigator)))
        else:
            self._live.update(self._screen(feedback, navigator), refresh=True)

    def _screen(self, feedback: Feedback, navigator: Navigator) -> Group:
        """Plan and facts beside each other; on a narrow terminal one below the other."""
        width, height = self._console.size
        facts = facts_table("", facts_of(feedback, self._so_far, floor_m2(navigator)))
        is_narrow = width < _LEAST_COLUMNS + _FACTS_WIDTH
        columns = max(min(width if is_narrow else width - _FACTS_WIDTH, _MOST_COLUMNS), _LEAST_COLUMNS)
        below = _LINES_BELOW + facts.row_count if is_narrow else _LINES_BELOW
        rows = max(min(columns, 2 * (height - below)), _LEAST_COLUMNS) // 2 * 2
        floor = navigator.senses.local() or navigator.senses.floor.layer
        signs = plan_signs(floor, feedback, self._footprint, (rows, columns), _ACROSS_M / columns)
        plan = as_text(signs, in_colour=not self._console.no_color)
        changes = (Text(f"{one.stamp_s:7.1f} s  {one}", overflow="ellipsis", no_wrap=True) for one in self._transitions)
        if is_narrow:
            return Group(plan, facts, Text(""), *changes)
        above = Table.grid(padding=(0, 2))
        above.add_row(plan, facts)
        return Group(above, Text(""), *changes)


class SoFar:
    """How long a drive has taken, how far it came, and how fast its time goes by."""

    def __init__(self) -> None:
        self.seconds = self.way_m = 0.0
        self._began_s = time.monotonic()
        self._last_s: float | None = None

    def add(self, feedback: Feedback) -> None:
        """A period more."""
        lasted_s = 0.0 if self._last_s is None else feedback.stamp_s - self._last_s
        self.seconds, self.way_m = self.seconds + lasted_s, self.way_m + abs(feedback.forward_m_s) * lasted_s
        self._last_s = feedback.stamp_s

    def times_real_time(self) -> float:
        """Of a simulated drive; about 1 of a real one."""
        return self.seconds / max(time.monotonic() - self._began_s, 1e-3)

    def left_s(self, to_go_m: float) -> float | None:
        """How long the rest takes as fast as it went; None before it has moved."""
        return to_go_m * self.seconds / self.way_m if self.way_m > _MOVED_M else None


def floor_m2(navigator: Navigator) -> float:
    """How much floor has been seen, free or not."""
    layer = navigator.senses.floor.layer
    return float(np.count_nonzero(~layer.is_unseen)) * layer.resolution_m**2


def line_of(feedback: Feedback, so_far: SoFar, seen_m2: float) -> str:
    """All facts in one line."""
    facts = facts_of(feedback, so_far, seen_m2)
    return f"{feedback.stamp_s:.1f} s " + "; ".join(f"{name}: {value}" for name, value in facts)


def facts_of(feedback: Feedback, so_far: SoFar, seen_m2: float) -> Iterator[tuple[str, str]]:
    """Names and values."""
    yield "state", f"{feedback.state}, {feedback.doing}" if feedback.doing else str(feedback.state)
    yield "status", STATUS_WORDS[feedback.status]
    if feedback.pose is not None:
        x_m, y_m, yaw = feedback.pose
        yield "place", f"{x_m:.2f}, {y_m:.2f} m, {math.degrees(yaw):.0f}°"
    turn = f", {math.degrees(feedback.turn_rad_s):+.0f}°/s" if abs(feedback.turn_rad_s) > 0.02 else ""
    yield "speed", f"{feedback.forward_m_s:.2f} m/s{turn}"
    yield "so far", f"{clock_of(so_far.seconds)}, {so_far.way_m:.1f} m, {seen_m2:.0f} m² seen"
    yield "rate", f"{so_far.times_real_time():.1f} times real time"
    if feedback.to_go_m is not None:
        left_s = so_far.left_s(feedback.to_go_m)
        yield "to go", f"{feedback.to_go_m:.1f} m" + ("" if left_s is None else f", {left_text(left_s)}")
    yield "monitor", monitor_words(feedback)
