"""The live view of `wheelsight drive`: a plan on a terminal, otherwise one line a second; and Rerun."""

from __future__ import annotations

import math
import time
from collections import deque
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from enum import IntEnum
from types import TracebackType
from typing import TYPE_CHECKING

import numpy as np
from rich.console import Group
from rich.live import Live
from rich.style import Style
from rich.table import Table
from rich.text import Text

from wheelsight.app.cli.console import console, facts_table
from wheelsight.app.cli.progress import left_text
from wheelsight.app.cli.record import clock_of
from wheelsight.app.run.drive_record import STATUS_WORDS, monitor_words
from wheelsight.core.geometry import ByteArray, FloatArray
from wheelsight.navigation import CellState, Costmap, Feedback, Footprint, Navigator, StaticLayer, Transition

if TYPE_CHECKING:
    from wheelsight.app.page import Watch
    from wheelsight.config import Config
    from wheelsight.core.messages import Event
    from wheelsight.core.robots import Robot
    from wheelsight_ros2 import Bridge


_VIEWS_A_S, _LINES_A_S = 5, 1
_ACROSS_M = 8.0
_FACTS_WIDTH, _MOST_COLUMNS, _LEAST_COLUMNS, _LINES_BELOW = 44, 64, 20, 9
_TRANSITIONS = 5
# A mean speed of less is none.
_MOVED_M = 0.5


class DriveView:
    """Shows a drive on stderr; use it in a `with` block."""

    def __init__(self, footprint: Footprint) -> None:
        self._footprint, self._console = footprint, console(stderr=True)
        self._live = Live(console=self._console, auto_refresh=False) if self._console.is_terminal else None
        self._transitions: deque[Transition] = deque(maxlen=_TRANSITIONS)
        self._shown_s = -math.inf
        self._so_far = SoFar()
        self._warned: tuple[str, ...] = ()

    def __enter__(self) -> DriveView:
        if self._live is not None:
            self._live.__enter__()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._live is not None:
            self._live.__exit__(kind, error, trace)

    @contextmanager
    def paused(self) -> Iterator[None]:
        """Leave the terminal to a question within the block."""
        if self._live is not None:
            self._live.stop()
        try:
            yield
        finally:
            if self._live is not None:
                self._live.start()

    def note(self, transition: Transition) -> None:
        """Show a change of state, on a terminal among the last ones, else as a line."""
        self._transitions.append(transition)
        if self._live is None:
            self._console.print(f"{transition.stamp_s:.1f} s {transition}")

    def show(self, feedback: Feedback, navigator: Navigator) -> None:
        """Show a period, at a limited rate."""
        self._so_far.add(feedback)
        for warning in feedback.warnings:
            if warning not in self._warned:
                self._console.print(f"{feedback.stamp_s:.1f} s warning: {warning}")
        self._warned = feedback.warnings
        now_s = time.monotonic()
        if now_s - self._shown_s < 1 / (_LINES_A_S if self._live is None else _VIEWS_A_S):
            return
        self._shown_s = now_s
        if self._live is None:
            self._console.print(line_of(feedback, self._so_far, floor_m2(navigator)))
        else:
            # Plan and facts side by side, or stacked on a narrow terminal
            width, height = self._console.size
            facts = facts_table("", facts_of(feedback, self._so_far, floor_m2(navigator)))
            is_narrow = width < _LEAST_COLUMNS + _FACTS_WIDTH
            columns = max(min(width if is_narrow else width - _FACTS_WIDTH, _MOST_COLUMNS), _LEAST_COLUMNS)
            below = _LINES_BELOW + facts.row_count if is_narrow else _LINES_BELOW
            rows = max(min(columns, 2 * (height - below)), _LEAST_COLUMNS) // 2 * 2
            floor = navigator.senses.local() or navigator.senses.floor.layer
            signs = plan_signs(floor, feedback, self._footprint, (rows, columns), _ACROSS_M / columns)
            plan = as_text(signs, in_colour=not self._console.no_color)
            changes = (
                Text(f"{one.stamp_s:7.1f} s  {one}", overflow="ellipsis", no_wrap=True) for one in self._transitions
            )
            if is_narrow:
                screen = Group(plan, facts, Text(""), *changes)
            else:
                above = Table.grid(padding=(0, 2))
                above.add_row(plan, facts)
                screen = Group(above, Text(""), *changes)
            self._live.update(screen, refresh=True)


class SoFar:
    """Duration, distance and speed of a drive so far."""

    def __init__(self) -> None:
        self.seconds = self.way_m = 0.0
        self._began_s = time.monotonic()
        self._last_s: float | None = None

    def add(self, feedback: Feedback) -> None:
        """Add a period."""
        lasted_s = 0.0 if self._last_s is None else feedback.stamp_s - self._last_s
        self.seconds, self.way_m = self.seconds + lasted_s, self.way_m + abs(feedback.forward_m_s) * lasted_s
        self._last_s = feedback.stamp_s

    def times_real_time(self) -> float:
        """Speed of the drive relative to real time."""
        return self.seconds / max(time.monotonic() - self._began_s, 1e-3)

    def left_s(self, to_go_m: float) -> float | None:
        """Time left at the mean speed so far, seconds; None before it has moved."""
        return to_go_m * self.seconds / self.way_m if self.way_m > _MOVED_M else None


def floor_m2(navigator: Navigator) -> float:
    """Area of the seen floor, free or occupied, square metres."""
    layer = navigator.senses.floor.layer
    return float(np.count_nonzero(~layer.is_unseen)) * layer.resolution_m**2


def line_of(feedback: Feedback, so_far: SoFar, seen_m2: float) -> str:
    """All facts of a period in one line."""
    facts = facts_of(feedback, so_far, seen_m2)
    return f"{feedback.stamp_s:.1f} s " + "; ".join(f"{name}: {value}" for name, value in facts)


def facts_of(feedback: Feedback, so_far: SoFar, seen_m2: float) -> Iterator[tuple[str, str]]:
    """Names and values of the facts of a period."""
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


class DriveWatch:
    """Passes a drive to the terminal, to Rerun and to other programs.

    Attributes:
        view: of the terminal. Lines that are printed before it is entered stay above it.
    """

    def __init__(self, view: DriveView, *logs: Watch) -> None:
        self.view, self._logs = view, logs

    def on_events(self, events: Sequence[Event]) -> None:
        """Pass on events of the robot's sensors."""
        for log in self._logs:
            log.on_events(events)

    def note(self, transition: Transition) -> None:
        """Pass on a change of the navigator's state."""
        self.view.note(transition)
        for log in self._logs:
            log.note(transition)

    def step(self, feedback: Feedback, navigator: Navigator) -> None:
        """Pass on a period."""
        self.view.show(feedback, navigator)
        for log in self._logs:
            log.step(feedback, navigator)


@contextmanager
def watching(rerun: str | None, robot: Robot, config: Config, bridge: Bridge | None = None) -> Iterator[DriveWatch]:
    """Open the views of a drive. Raises as `open_drive_log`."""
    view, bridges = DriveView(config.navigation.footprint.outline), () if bridge is None else (bridge,)
    if rerun is None:
        yield DriveWatch(view, *bridges)
        return
    from wheelsight_export import open_drive_log

    with open_drive_log(rerun, robot.calibration, config.viewer) as log:
        yield DriveWatch(view, log, *bridges)


class Sign(IntEnum):
    """The content of a cell of the plan; the highest counts."""

    FREE = 0
    UNKNOWN = 1
    WALL = 2
    WAY = 3
    GOAL = 4
    ROBOT = 5
    FRONT = 6


# Distinguishable with red-green colour blindness (Okabe & Ito 2008).
_COLOURS = {
    Sign.FREE: "#e9e9e9",
    Sign.UNKNOWN: "#9a9a9a",
    Sign.WALL: "#202020",
    Sign.WAY: "#0072b2",
    Sign.GOAL: "#cc79a7",
    Sign.ROBOT: "#009e73",
    Sign.FRONT: "#d55e00",
}
_LETTERS = {
    Sign.FREE: ".",
    Sign.UNKNOWN: " ",
    Sign.WALL: "#",
    Sign.WAY: "+",
    Sign.GOAL: "X",
    Sign.ROBOT: "o",
    Sign.FRONT: "^",
}
# Points of a cell of the plan that are looked up: a wall between two of them is not missed.
_LOOKS = 3
_GOAL_CELLS = 1


def plan_signs(
    floor: StaticLayer | Costmap, feedback: Feedback, footprint: Footprint, shape: tuple[int, int], cell_m: float
) -> ByteArray:
    """(H, W) of `Sign`, y up, around the robot, or around the middle of the map if its pose is unknown.

    Args:
        floor: what is known of it.
        feedback: of now.
        footprint: of the robot.
        shape: rows and columns.
        cell_m: side of a cell.
    """
    middle = (
        (np.array(floor.origin) + np.array(floor.state.shape[::-1]) * floor.resolution_m / 2)
        if feedback.pose is None
        else feedback.pose[:2]
    )
    rows, columns = shape
    x = (np.arange(columns) + 0.5 - columns / 2) * cell_m + middle[0]
    y = (rows / 2 - np.arange(rows) - 0.5) * cell_m + middle[1]
    # A sign is a wall if any of its samples is occupied; else it shows its centre.
    offsets = (np.arange(_LOOKS) - (_LOOKS - 1) / 2) * cell_m / _LOOKS
    cell_columns = np.floor((x[:, None] + offsets - floor.origin[0]) / floor.resolution_m).astype(int)
    cell_rows = np.floor((y[:, None] - offsets - floor.origin[1]) / floor.resolution_m).astype(int)
    height, width = floor.state.shape
    looked = floor.state[np.clip(cell_rows, 0, height - 1).ravel()][:, np.clip(cell_columns, 0, width - 1).ravel()]
    inside = ((cell_rows >= 0) & (cell_rows < height)).ravel()[:, None] & (
        (cell_columns >= 0) & (cell_columns < width)
    ).ravel()
    states = np.where(inside, looked, CellState.UNKNOWN).reshape(len(y), _LOOKS, len(x), _LOOKS)
    is_wall = (states == CellState.OCCUPIED).any(axis=(1, 3))
    middle_states = states[:, _LOOKS // 2, :, _LOOKS // 2]
    open_signs = np.where(middle_states == CellState.FREE, Sign.FREE, Sign.UNKNOWN)
    signs = np.where(is_wall, Sign.WALL, open_signs).astype(np.uint8)
    if feedback.plan is not None:
        _mark(signs, feedback.plan.poses[:, :2], x, y, Sign.WAY)
    if feedback.goal is not None:
        around = np.arange(-_GOAL_CELLS, _GOAL_CELLS + 1) * cell_m
        spots = feedback.goal[:2] + np.stack(np.meshgrid(around, around), axis=-1).reshape(-1, 2)
        _mark(signs, spots, x, y, Sign.GOAL)
    if feedback.pose is not None:
        # The robot's outline, filled; the front quarter shows its heading
        c, s = np.cos(feedback.pose[2]), np.sin(feedback.pose[2])
        away = np.stack(np.meshgrid(x, y), axis=-1) - feedback.pose[:2]
        in_base = away @ np.array([[c, -s], [s, c]])
        under = footprint.contains(in_base)
        low, high = footprint.corners[:, 0].min(), footprint.corners[:, 0].max()
        signs[under] = Sign.ROBOT
        signs[under & (in_base[..., 0] > high - (high - low) / 4)] = Sign.FRONT
    return signs


def as_text(signs: ByteArray, *, in_colour: bool = True) -> Text:
    """Signs (H, W), H even, as H / 2 lines; without colours as letters, of two cells the higher one."""
    text = Text(no_wrap=True)
    for upper, lower in zip(signs[::2], signs[1::2], strict=True):
        for above, below in zip(upper.tolist(), lower.tolist(), strict=True):
            if in_colour:
                text.append("▀", Style(color=_COLOURS[Sign(above)], bgcolor=_COLOURS[Sign(below)]))
            else:
                text.append(_LETTERS[Sign(max(above, below))])
        text.append("\n")
    text.right_crop(1)
    return text


def _mark(signs: ByteArray, points: FloatArray, x: FloatArray, y: FloatArray, sign: Sign) -> None:
    """Set the cells of points (N, 2)."""
    cell_m = x[1] - x[0]
    columns = np.floor((points[:, 0] - x[0]) / cell_m + 0.5).astype(int)
    rows = np.floor((y[0] - points[:, 1]) / cell_m + 0.5).astype(int)
    inside = (columns >= 0) & (columns < len(x)) & (rows >= 0) & (rows < len(y))
    at = rows[inside], columns[inside]
    signs[at] = np.maximum(signs[at], sign)
