"""DriveRecord: the results of a drive to goals, period by period, which DriveRecorder fills.

`time_cause` says what a period is spent on. `wheelsight_report.write_drive` writes the files of a record.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from datetime import UTC, datetime
from enum import StrEnum
from typing import Any

import cv2
import numpy as np

from wheelsight.core.estimates import Status
from wheelsight.core.geometry import ByteArray, FloatArray
from wheelsight.core.geometry.se2 import wrap_angle
from wheelsight.core.messages import Event, RgbdFrame
from wheelsight.core.robots import CONTROL_PERIOD_S, RobotLimits
from wheelsight.core.trajectory import Trajectory
from wheelsight.mapping import OccupancyGrid
from wheelsight.navigation import (
    CellState,
    Costmap,
    Exploration,
    Feedback,
    Footprint,
    MonitorReason,
    MonitorState,
    NavigationResult,
    NavigationState,
    Plan,
)
from wheelsight.navigation.costmap import distances_m
from wheelsight.navigation.senses import Senses

# Of what a period is to take: longer ones are late.
_LATE = 1.2


# Words for pages and the command line.
STATUS_WORDS = {
    Status.INITIALIZING: "looks for its place in the map",
    Status.UNCONFIRMED: "has not confirmed its place in the map yet",
    Status.TRACKING: "knows where it is",
    Status.COASTING: "by its wheels alone",
    Status.FAILING: "does not trust where it is",
    Status.LOST: "lost",
}


def status_words(feedback: Feedback) -> str:
    """Return what the robot knows of its place, and the last warning about its sensors."""
    return "; ".join((STATUS_WORDS[feedback.status], *feedback.warnings[-1:]))


def monitor_words(feedback: Feedback) -> str:
    """Return what the collision monitor does and why, and which obstacle stays without depth behind it."""
    found, stays = feedback.monitor, f"; {feedback.stays}" if feedback.stays else ""
    if found is None or found.state is MonitorState.FREE:
        return f"lets it drive{stays}"
    does = "slows it down" if found.state is MonitorState.SLOWED else "holds it"
    return f"{does}: {found.reason}{stays}" if found.reason is not None else f"{does}{stays}"


# Share of the limit that is full speed; lower measured speeds than this are a turn in place or a start; and the lead of
# a command over the measured speed while the robot gains speed.
_FULL_SHARE, _SLOW_M_S, _GAINS_M_S = 0.85, 0.05, 0.02
# Rest of a plan on which the robot brakes: from 0.7 m/s at the 0.3 m/s² of the controllers.
_BRAKING_M = 0.8


class TimeCause(StrEnum):
    """What a robot's time is spent on; each control period has one cause."""

    FULL_SPEED = "drives at full speed"
    GAINS_SPEED = "gains speed"
    BRAKES = "brakes before the end of its plan"
    CAREFUL = "drives slowly for curves, walls and people"
    TURNS = "turns in place"
    NOT_SEEN_LATELY = "is slow over floor not seen lately"
    NEVER_SEEN = "is held before floor never seen"
    OBSTACLE = "is held or slowed by something near"
    SENSORS = "waits for a sensor or a part of the program"
    LOCALIZATION = "waits for its place in the map, or is slow as it is not sure"
    PLANNING = "stands to plan"
    EXPLORING = "stands to choose what to explore"
    RECOVERY = "recovers: waits, looks about, backs up"
    STANDS = "stands at a goal or without a task"


_CAUSE_OF_STATUS = (MonitorReason.STATUS, MonitorReason.COASTING, MonitorReason.UNCONFIRMED)
_CAUSES_OF_MONITOR = {
    MonitorReason.NOT_SEEN_LATELY: TimeCause.NOT_SEEN_LATELY,
    MonitorReason.NEVER_SEEN: TimeCause.NEVER_SEEN,
    **dict.fromkeys(_CAUSE_OF_STATUS, TimeCause.LOCALIZATION),
    **dict.fromkeys(
        (MonitorReason.OBSTACLE, MonitorReason.IN_ZONE, MonitorReason.NEAR, MonitorReason.INSIDE), TimeCause.OBSTACLE
    ),
}


def time_cause(feedback: Feedback, limits: RobotLimits) -> TimeCause:
    """Return what a control period is spent on: the first that applies of stop, monitor, state and speed."""
    monitor, state = feedback.monitor, feedback.state
    command = None if monitor is None else monitor.command
    turns = command is not None and abs(command.forward_m_s) < _SLOW_M_S and abs(command.turn_rad_s) > 0
    if feedback.robot_stop:
        return TimeCause.SENSORS
    if monitor is not None and monitor.reason is not None and (monitor.state is MonitorState.STOPPED or not turns):
        return _CAUSES_OF_MONITOR.get(monitor.reason, TimeCause.SENSORS)
    if state is NavigationState.RECOVERING:
        is_sure = feedback.status is Status.TRACKING
        return TimeCause.RECOVERY if is_sure else TimeCause.LOCALIZATION
    if state is NavigationState.PLANNING:
        return TimeCause.EXPLORING if feedback.doing == Exploration.name else TimeCause.PLANNING
    if state is not NavigationState.DRIVING or command is None:
        return TimeCause.STANDS
    if turns:
        return TimeCause.TURNS
    most_m_s = limits.backward_m_s if command.forward_m_s < 0 else limits.forward_m_s
    if abs(feedback.forward_m_s) >= _FULL_SHARE * most_m_s:
        return TimeCause.FULL_SPEED
    if abs(command.forward_m_s) > abs(feedback.forward_m_s) + _GAINS_M_S:
        return TimeCause.GAINS_SPEED
    brakes = feedback.to_go_m is not None and feedback.to_go_m < _BRAKING_M
    return TimeCause.BRAKES if brakes else TimeCause.CAREFUL


@dataclass(frozen=True, slots=True, eq=False)
class GoalRecord:
    """A goal and its result.

    Attributes:
        name: of the goal.
        goal: (3,) x, y, yaw in the map as asked; a yaw of NaN is any heading.
        result: of the navigator.
        end: (3,) estimated pose at the end, or None if unknown.
        begin_s, end_s: stamps.
    """

    name: str
    goal: FloatArray
    result: NavigationResult
    end: FloatArray | None
    begin_s: float
    end_s: float

    @property
    def is_place(self) -> bool:
        """Whether the goal is a pose; an exploration has none."""
        return bool(np.isfinite(self.goal[:2]).all())

    @property
    def off_m(self) -> float:
        """Distance from the goal by the robot's localization, metres; NaN if unknown."""
        return np.nan if self.end is None else float(np.hypot(*(self.end - self.goal)[:2]))

    @property
    def off_deg(self) -> float:
        """Heading error, degrees; NaN if unknown or if any heading was allowed."""
        return np.nan if self.end is None else float(np.degrees(abs(wrap_angle((self.end - self.goal)[2]))))


@dataclass(frozen=True, slots=True, eq=False)
class StopRecord:
    """A stop by the collision monitor, or by the robot itself.

    Attributes:
        begin_s, end_s: stamps.
        reason: a sentence.
        pose: (3,) in the map, or None.
    """

    begin_s: float
    end_s: float
    reason: str
    pose: FloatArray | None


@dataclass(frozen=True, slots=True, eq=False)
class FilmImage:
    """A small image of the camera during the drive."""

    stamp_s: float
    color: ByteArray


@dataclass(frozen=True, slots=True, eq=False)
class PeriodRows:
    """One row a control period.

    Attributes:
        stamps_s: (N,).
        poses: (N, 3) in the map; NaN if unknown.
        forward_m_s, turn_rad_s: (N,) speeds by the wheels.
        states: state of the navigator.
        status: status of the localization.
        monitor: (N,) state of the collision monitor: "free", "slowed", "stopped".
        reasons: of the monitor; empty if free.
        causes: `TimeCause` of each period.
    """

    stamps_s: FloatArray
    poses: FloatArray
    forward_m_s: FloatArray
    turn_rad_s: FloatArray
    states: tuple[str, ...]
    status: tuple[str, ...]
    monitor: tuple[str, ...]
    reasons: tuple[str, ...]
    causes: tuple[str, ...]

    def __len__(self) -> int:
        return len(self.stamps_s)


@dataclass(frozen=True, slots=True)
class PeriodLengths:
    """Statistics of the lengths of control periods.

    Attributes:
        count: number of periods.
        late: number of periods that took over a fifth longer than their nominal length.
        longest_s: the longest; 0 without any.
    """

    count: int
    late: int
    longest_s: float

    @classmethod
    def of(cls, stamps_s: FloatArray, period_s: float) -> PeriodLengths:
        """Statistics of periods that begin at (N,) ascending seconds and have a nominal length."""
        took_s = np.diff(stamps_s)
        return cls(len(took_s), int((took_s > _LATE * period_s).sum()), float(took_s.max(initial=0.0)))


@dataclass(frozen=True, slots=True, eq=False)
class DriveRecord:
    """The results of a drive.

    Attributes:
        map_name: of the map.
        robot: description of the robot.
        goals: those that were begun, in order.
        asked: number of goals of the drive.
        rows: one row a control period.
        way: path of the base in the map, by the localization.
        plans: stamp and poses (N, 3) of each plan.
        stops: by the collision monitor and by the robot itself.
        clearance_m: least distance of the outline from obstacles in map and camera; infinite without obstacles.
        images: a few, in order.
        people: (N, 4) stamp, x and y in the map of walking people near the robot, and their distance from its outline.
        grid: of the map.
        footprint: of the robot.
        config: all settings.
        recognised: number of recognitions in a known map; None in a new map.
        warnings: sentences of the localization about faults of sensors.
        truth: figures of a simulator: contacts by the robot, least true clearance; empty for a real robot.
        loops: number of loops in the new map; None in a known map.
        is_interrupted: whether the user ended the drive.
        finished_at: time of its end.
    """

    map_name: str
    robot: str
    goals: tuple[GoalRecord, ...]
    asked: int
    rows: PeriodRows
    way: Trajectory
    plans: tuple[tuple[float, FloatArray], ...]
    stops: tuple[StopRecord, ...]
    clearance_m: float
    images: tuple[FilmImage, ...]
    grid: OccupancyGrid
    footprint: Footprint
    config: dict[str, Any]
    people: FloatArray = field(default_factory=lambda: np.empty((0, 4)))
    recognised: int | None = None
    warnings: tuple[str, ...] = ()
    truth: dict[str, Any] = field(default_factory=dict)
    loops: int | None = None
    is_interrupted: bool = False
    finished_at: datetime = field(default_factory=lambda: datetime.now(UTC))

    @property
    def has_arrived(self) -> bool:
        """Whether all goals were reached."""
        return len(self.goals) == self.asked and all(one.result.has_arrived for one in self.goals)

    @property
    def contacts(self) -> tuple[str, ...]:
        """Contacts of a simulated robot with their times, one sentence each; empty for a real robot."""
        all_of = self.truth.get("contacts", ())
        return tuple(f"{one['with']} at {one['stamp_s']:.1f} s" for one in all_of if one["by_the_robot"])

    @property
    def rests_on_start(self) -> bool:
        """Whether the pose in the map rests on the given start alone."""
        return self.config["known_map"]["start"] is not None and self.recognised == 0

    @property
    def begin_s(self) -> float:
        """Stamp of the first period; 0 without any."""
        return float(self.rows.stamps_s[0]) if len(self.rows) else 0.0

    @property
    def time_s(self) -> float:
        """Duration from the first period to the last."""
        return float(self.rows.stamps_s[-1]) - self.begin_s if len(self.rows) else 0.0

    @property
    def periods(self) -> PeriodLengths:
        """Statistics of the lengths of the control periods."""
        return PeriodLengths.of(self.rows.stamps_s, CONTROL_PERIOD_S)

    @property
    def spent_s(self) -> dict[str, float]:
        """Seconds by `TimeCause`, the longest first. A period counts from the one before, so the sum is `time_s`."""
        lasted_s, spent_s = np.diff(self.rows.stamps_s, prepend=self.begin_s), dict[str, float]()
        for cause, seconds in zip(self.rows.causes, lasted_s.tolist(), strict=True):
            spent_s[cause] = spent_s.get(cause, 0.0) + seconds
        return dict(sorted(spent_s.items(), key=lambda one: -one[1]))

    @property
    def spent_words(self) -> str:
        """Shares of the drive's time by cause, from a hundredth on: "41 % turns in place, 20 % stands to plan"."""
        shares = ((cause, 100 * seconds / max(self.time_s, 1e-9)) for cause, seconds in self.spent_s.items())
        return ", ".join(f"{percent:.0f} % {cause}" for cause, percent in shares if percent >= 1)

    @property
    def way_m(self) -> float:
        """Driven distance by the wheels, metres."""
        return sum(one.result.way_m for one in self.goals)

    @property
    def planned_m(self) -> float:
        """Total length of the first plan to each goal, metres."""
        return sum(one.result.planned_m for one in self.goals)


_FILM_WIDTH_PX, _MOST_IMAGES = 240, 24
# A stop that begins so soon after one for the same reason is the same stop.
_SAME_STOP_S = 1.0
_OUTLINE_STEP_M = 0.04


class DriveRecorder:
    """Collects each period and each event of a drive.

    Attributes:
        plans: stamp and poses (N, 3) of each plan so far.
        stops: so far.
        clearance_m: least clearance so far.
    """

    def __init__(self, footprint: Footprint, limits: RobotLimits | None = None) -> None:
        # Stamp, pose and speeds of each period, and its words.
        self._rows: list[FloatArray] = []
        self._words: list[tuple[str, str, str, str, str]] = []
        self._limits = limits or RobotLimits()
        self._footprint = footprint
        self._people: list[tuple[float, float, float, float]] = []
        self._way: list[tuple[float, FloatArray]] = []
        self._film = _Film()
        self._clearance = _Clearance(footprint)
        self._plan: Plan | None = None
        self.plans: list[tuple[float, FloatArray]] = []
        self.stops: list[StopRecord] = []
        self.clearance_m = np.inf

    def add(self, events: Sequence[Event]) -> None:
        """Add events of the robot's sensors."""
        for event in events:
            if isinstance(event, RgbdFrame):
                self._film.take(event)

    def step(self, feedback: Feedback, senses: Senses) -> None:
        """Add a control period."""
        pose = np.full(3, np.nan) if feedback.pose is None else feedback.pose
        monitor = feedback.monitor
        state = MonitorState.FREE if monitor is None else monitor.state
        reason = "" if monitor is None or monitor.reason is None else str(monitor.reason)
        self._rows.append(np.array([feedback.stamp_s, *pose, feedback.forward_m_s, feedback.turn_rad_s], float))
        cause = str(time_cause(feedback, self._limits))
        self._words.append((str(feedback.state), str(feedback.status), str(state), reason, cause))
        if state is MonitorState.STOPPED:
            self._stopped(feedback, reason)
        if feedback.robot_stop:
            self._stopped(feedback, f"the robot stopped by itself: {feedback.robot_stop}")
        if feedback.plan is not None and feedback.plan is not self._plan:
            self.plans.append((feedback.stamp_s, feedback.plan.poses))
        self._plan = feedback.plan
        estimate = senses.where.estimate
        is_new = estimate is not None and (not self._way or estimate.stamp_s > self._way[-1][0])
        if estimate is not None and estimate.T_map_body is not None and is_new:
            self._way.append((estimate.stamp_s, estimate.T_map_body))
        if feedback.pose is not None:
            # Clearance and people
            local = senses.local()
            if local is not None:
                self.clearance_m = min(self.clearance_m, self._clearance.of(local, feedback.pose))
            outline = self._footprint.at(feedback.pose)
            for person in senses.people(feedback.stamp_s):
                # Distance of his circle from the outline; 0 where they overlap
                x, y = map(float, person.position)
                inside_m = cv2.pointPolygonTest(outline.astype(np.float32), (x, y), measureDist=True)
                self._people.append((feedback.stamp_s, x, y, max(-inside_m - person.radius_m, 0.0)))

    @property
    def people(self) -> FloatArray:
        """As `DriveRecord.people`, so far."""
        return np.array(self._people, float).reshape(-1, 4)

    @property
    def rows(self) -> PeriodRows:
        """All rows so far."""
        rows = np.array(self._rows, float).reshape(-1, 6)
        words = tuple(zip(*self._words, strict=True)) or ((), (), (), (), ())
        return PeriodRows(rows[:, 0], rows[:, 1:4], rows[:, 4], rows[:, 5], *words)

    @property
    def way(self) -> Trajectory:
        """Path of the base in the map, so far."""
        stamps_s = np.array([stamp_s for stamp_s, _ in self._way], float)
        poses = np.array([T for _, T in self._way], float).reshape(-1, 4, 4)
        return Trajectory(stamps_s, poses, body="base", frame="map")

    @property
    def images(self) -> tuple[FilmImage, ...]:
        """Images so far, evenly over the time."""
        return tuple(self._film.images)

    def _stopped(self, feedback: Feedback, reason: str) -> None:
        now_s, count = feedback.stamp_s, len(self.stops)
        # One by the robot itself goes on beside those by the monitor, whose reasons follow each other.
        for number in range(max(count - 3, 0), count):
            last = self.stops[number]
            if last.reason == reason and now_s - last.end_s < _SAME_STOP_S:
                self.stops[number] = replace(last, end_s=now_s)
                return
        self.stops.append(StopRecord(now_s, now_s, reason, feedback.pose))


class _Film:
    """A limited number of images, evenly over the time so far."""

    def __init__(self) -> None:
        self.images: list[FilmImage] = []
        self._every_s = 1.0

    def take(self, frame: RgbdFrame) -> None:
        if self.images and frame.stamp_s - self.images[-1].stamp_s < self._every_s:
            return
        height, width = frame.color.shape[:2]
        size = (_FILM_WIDTH_PX, max(1, round(height * _FILM_WIDTH_PX / width)))
        small = np.asarray(cv2.resize(frame.color, size, interpolation=cv2.INTER_AREA), np.uint8)
        self.images.append(FilmImage(frame.stamp_s, small))
        if len(self.images) > _MOST_IMAGES:
            self.images = self.images[::2]
            self._every_s *= 2


class _Clearance:
    """Distance of an outline from occupied cells; the distance transform is kept for the current costmap."""

    def __init__(self, footprint: Footprint) -> None:
        # Points (N, 2) along the outline
        corners = footprint.corners
        sides = []
        for begin, end in zip(corners, np.roll(corners, -1, axis=0), strict=True):
            count = max(int(np.ceil(np.hypot(*(end - begin)) / _OUTLINE_STEP_M)), 1)
            sides.append(begin + (end - begin) * (np.arange(count) / count)[:, None])
        self._outline = np.concatenate(sides)
        self._of: Costmap | None = None
        self._distance_m: FloatArray = np.empty((0, 0))

    def of(self, costmap: Costmap, pose: FloatArray) -> float:
        """Distance to the nearest edge of an occupied cell, up to one cell too long; infinite without one."""
        if costmap is not self._of:
            occupied = costmap.state == CellState.OCCUPIED
            self._of, self._distance_m = costmap, np.asarray(distances_m(occupied, costmap.resolution_m), float)
            if not occupied.any():
                self._distance_m = np.full(occupied.shape, np.inf)
        c, s = np.cos(pose[2]), np.sin(pose[2])
        cells = costmap.cells_at(self._outline @ np.array([[c, s], [-s, c]]) + pose[:2])
        inside = ((cells >= 0) & (cells < self._distance_m.shape)).all(axis=1)
        if not inside.any():
            return np.inf
        nearest_m = float(self._distance_m[tuple(cells[inside].T)].min())
        return max(nearest_m - costmap.resolution_m / 2, 0.0)
