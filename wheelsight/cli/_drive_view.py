"""What `wheelsight drive` shows meanwhile: on a terminal a plan and what goes on; else a line a second."""

from __future__ import annotations

import math
import time
from collections import deque
from collections.abc import Iterator
from types import TracebackType

from rich.console import Console, Group
from rich.live import Live
from rich.table import Table
from rich.text import Text

from wheelsight.cli._console import console, facts_table
from wheelsight.cli._drive_plan import as_text, plan_signs
from wheelsight.geometry import ByteArray
from wheelsight.navigation import Feedback, Footprint, Navigator, Transition
from wheelsight.navigation.words import STATUS_WORDS, monitor_words

_VIEWS_A_S, _LINES_A_S = 5, 1
_ACROSS_M = 8.0
_FACTS_WIDTH, _MOST_COLUMNS, _LEAST_COLUMNS, _LINES_BELOW = 44, 64, 20, 9
_TRANSITIONS = 5


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
        now_s = time.monotonic()
        if now_s - self._shown_s < 1 / (_LINES_A_S if self._live is None else _VIEWS_A_S):
            return
        self._shown_s = now_s
        if self._live is None:
            self._console.print(line_of(feedback))
        else:
            self._live.update(self._screen(feedback, navigator), refresh=True)

    def _screen(self, feedback: Feedback, navigator: Navigator) -> Group:
        signs = self._signs(feedback, navigator, self._console)
        above = Table.grid(padding=(0, 2))
        above.add_row(as_text(signs, in_colour=not self._console.no_color), facts_table("", facts_of(feedback)))
        changes = (Text(f"{one.stamp_s:7.1f} s  {one}", overflow="ellipsis", no_wrap=True) for one in self._transitions)
        return Group(above, Text(""), *changes)

    def _signs(self, feedback: Feedback, navigator: Navigator, on: Console) -> ByteArray:
        columns = max(min(on.width - _FACTS_WIDTH, _MOST_COLUMNS), _LEAST_COLUMNS)
        rows = max(min(columns, 2 * (on.height - _LINES_BELOW)), _LEAST_COLUMNS) // 2 * 2
        floor = navigator.senses.local() or navigator.senses.floor.layer
        return plan_signs(floor, feedback, self._footprint, (rows, columns), _ACROSS_M / columns)


def line_of(feedback: Feedback) -> str:
    """All facts in one line."""
    return f"{feedback.stamp_s:.1f} s " + "; ".join(f"{name}: {value}" for name, value in facts_of(feedback))


def facts_of(feedback: Feedback) -> Iterator[tuple[str, str]]:
    """Names and values."""
    yield "state", f"{feedback.state}, {feedback.doing}" if feedback.doing else str(feedback.state)
    yield "status", STATUS_WORDS[feedback.status]
    if feedback.pose is not None:
        x_m, y_m, yaw = feedback.pose
        yield "place", f"{x_m:.2f}, {y_m:.2f} m, {math.degrees(yaw):.0f}°"
    turn = f", {math.degrees(feedback.turn_rad_s):+.0f}°/s" if abs(feedback.turn_rad_s) > 0.02 else ""
    yield "speed", f"{feedback.forward_m_s:.2f} m/s{turn}"
    if feedback.to_go_m is not None:
        yield "to go", f"{feedback.to_go_m:.1f} m"
    yield "monitor", monitor_words(feedback)
