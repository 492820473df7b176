"""DriveRecord: what became of a drive to goals, period by period, as files and pages tell it."""

from __future__ import annotations

from dataclasses import dataclass, field
from datetime import UTC, datetime
from typing import Any

import numpy as np

from wheelsight.geometry import ByteArray, FloatArray
from wheelsight.geometry.se2 import wrap_angle
from wheelsight.mapping import OccupancyGrid
from wheelsight.navigation import Footprint, NavigationResult
from wheelsight.trajectory import Trajectory

# Of what a period is to take: longer ones are late.
_LATE = 1.2


@dataclass(frozen=True, slots=True, eq=False)
class GoalRecord:
    """A goal, and what became of it.

    Attributes:
        name: in words.
        goal: (3,) x, y, yaw in the map as asked; a yaw of NaN is any heading.
        result: of it.
        end: (3,) where the robot then believed to be, or None where it did not know.
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
        """Whether it is one: an exploration is none."""
        return bool(np.isfinite(self.goal[:2]).all())

    @property
    def off_m(self) -> float:
        """From the goal, by its own localization; NaN where it did not know."""
        return np.nan if self.end is None else float(np.hypot(*(self.end - self.goal)[:2]))

    @property
    def off_deg(self) -> float:
        """Likewise of the heading; NaN where any was wanted."""
        return np.nan if self.end is None else float(np.degrees(abs(wrap_angle((self.end - self.goal)[2]))))


@dataclass(frozen=True, slots=True, eq=False)
class StopRecord:
    """The collision monitor held the robot, or it stopped by itself.

    Attributes:
        begin_s, end_s: stamps.
        reason: in words.
        pose: (3,) where that was, or None.
    """

    begin_s: float
    end_s: float
    reason: str
    pose: FloatArray | None


@dataclass(frozen=True, slots=True, eq=False)
class FilmImage:
    """A small image of what the camera saw on the way."""

    stamp_s: float
    color: ByteArray


@dataclass(frozen=True, slots=True, eq=False)
class PeriodRows:
    """One row a control period.

    Attributes:
        stamps_s: (N,).
        poses: (N, 3) in the map; NaN where not known.
        forward_m_s, turn_rad_s: (N,) by the wheels.
        states: of the navigator, in words.
        status: of the localization, in words.
        monitor: (N,) what the collision monitor made of it: "free", "slowed", "stopped".
        reasons: why, in words; empty where it is free.
    """

    stamps_s: FloatArray
    poses: FloatArray
    forward_m_s: FloatArray
    turn_rad_s: FloatArray
    states: tuple[str, ...]
    status: tuple[str, ...]
    monitor: tuple[str, ...]
    reasons: tuple[str, ...]

    def __len__(self) -> int:
        return len(self.stamps_s)


@dataclass(frozen=True, slots=True)
class PeriodLengths:
    """How regularly a robot was led.

    Attributes:
        count: periods that went by.
        late: of these, how many took over a fifth longer than they were to.
        longest_s: of all; 0 without any.
    """

    count: int
    late: int
    longest_s: float

    @classmethod
    def of(cls, stamps_s: FloatArray, period_s: float) -> PeriodLengths:
        """Of when each began, (N,) seconds in order, and how long each was to be."""
        took_s = np.diff(stamps_s)
        return cls(len(took_s), int((took_s > _LATE * period_s).sum()), float(took_s.max(initial=0.0)))


@dataclass(frozen=True, slots=True, eq=False)
class DriveRecord:
    """Everything about a drive.

    Attributes:
        map_name: of the map that it was in.
        robot: in words.
        goals: those that were begun, in order.
        asked: how many there were to be.
        rows: period by period.
        way: as the localization told it, of the base in the map.
        plans: stamp and poses (N, 3) of each plan.
        stops: by the collision monitor, and by the robot itself.
        clearance_m: least distance of the outline from what map and camera showed; infinite where nothing was near.
        images: a few, in order.
        people: (N, 4) stamp, x and y in the map of who was known to walk near it, and how far from its outline he was.
        grid: of the map.
        footprint: of the robot.
        config: all settings.
        recognised: how often something of a map of before was recognised; None where it made the map.
        truth: what a simulator knows: contacts by the robot, least true clearance; empty of a real one.
        loops: closed in the map that it made; None where it made none.
        is_interrupted: whether somebody ended it.
        finished_at: when it ended.
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
    truth: dict[str, Any] = field(default_factory=dict)
    loops: int | None = None
    is_interrupted: bool = False
    finished_at: datetime = field(default_factory=lambda: datetime.now(UTC))

    @property
    def has_arrived(self) -> bool:
        """At all goals."""
        return len(self.goals) == self.asked and all(one.result.has_arrived for one in self.goals)

    @property
    def contacts(self) -> tuple[str, ...]:
        """What a simulated robot touched and when, each time, in words; empty of a real one, which nothing says."""
        all_of = self.truth.get("contacts", ())
        return tuple(f"{one['with']} at {one['stamp_s']:.1f} s" for one in all_of if one["by_the_robot"])

    @property
    def rests_on_start(self) -> bool:
        """Whether nothing but what somebody said of the start tells where in the map it was."""
        return self.config["known_map"]["start"] is not None and self.recognised == 0

    @property
    def begin_s(self) -> float:
        """Stamp of the first period; 0 without any."""
        return float(self.rows.stamps_s[0]) if len(self.rows) else 0.0

    @property
    def time_s(self) -> float:
        """From the first period to the last."""
        return float(self.rows.stamps_s[-1]) - self.begin_s if len(self.rows) else 0.0

    @property
    def periods(self) -> PeriodLengths:
        """How regularly the robot was led: what is reckoned in a period may take longer than that."""
        return PeriodLengths.of(self.rows.stamps_s, self.config["navigation"]["follow"]["period_s"])

    @property
    def way_m(self) -> float:
        """Driven, by the wheels."""
        return sum(one.result.way_m for one in self.goals)

    @property
    def planned_m(self) -> float:
        """Of the first plan to each goal."""
        return sum(one.result.planned_m for one in self.goals)
