"""DriveRecorder: keeps of a drive what its record tells, while it goes on."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import cv2
import numpy as np

from wheelsight.events import Event, RgbdFrame
from wheelsight.geometry import FloatArray
from wheelsight.navigation import CellState, Costmap, Feedback, Footprint, MonitorState, Plan
from wheelsight.navigation.costmap import distances_m
from wheelsight.navigation.people import Person
from wheelsight.navigation.senses import Senses
from wheelsight.pipeline.drive_record import FilmImage, PeriodRows, StopRecord
from wheelsight.trajectory import Trajectory

_FILM_WIDTH_PX, _MOST_IMAGES = 240, 24
# A stop that begins so soon after one for the same reason is the same stop.
_SAME_STOP_S = 1.0
_OUTLINE_STEP_M = 0.04


@dataclass
class _Rows:
    """As `PeriodRows` has them, growing."""

    stamps_s: list[float] = field(default_factory=list)
    poses: list[FloatArray] = field(default_factory=list)
    speeds: list[tuple[float, float]] = field(default_factory=list)
    words: list[tuple[str, str, str, str]] = field(default_factory=list)


class DriveRecorder:
    """Told of each period and of each event.

    Args:
        footprint: of the robot.

    Attributes:
        plans: stamp and poses (N, 3) of each plan so far.
        stops: so far.
        clearance_m: the least so far.
    """

    def __init__(self, footprint: Footprint) -> None:
        self._rows = _Rows()
        self._footprint = footprint
        self._people: list[tuple[float, float, float, float]] = []
        self._way: list[tuple[float, FloatArray]] = []
        self._film = _Film()
        self._clearance = _Clearance(footprint)
        self._plan: Plan | None = None
        self.plans: list[tuple[float, FloatArray]] = []
        self.stops: list[StopRecord] = []
        self.clearance_m = np.inf

    def hear(self, events: Sequence[Event]) -> None:
        """What the robot's sensors said."""
        for event in events:
            if isinstance(event, RgbdFrame):
                self._film.take(event)

    def step(self, feedback: Feedback, senses: Senses) -> None:
        """A period is over."""
        pose = np.full(3, np.nan) if feedback.pose is None else feedback.pose
        rows, monitor = self._rows, feedback.monitor
        state = MonitorState.FREE if monitor is None else monitor.state
        reason = "" if monitor is None or monitor.reason is None else str(monitor.reason)
        rows.stamps_s.append(feedback.stamp_s)
        rows.poses.append(pose)
        rows.speeds.append((feedback.forward_m_s, feedback.turn_rad_s))
        rows.words.append((str(feedback.state), str(feedback.status), str(state), reason))
        if state is MonitorState.STOPPED:
            self._stopped(feedback, reason)
        if feedback.robot_stop:
            self._stopped(feedback, f"the robot stopped by itself: {feedback.robot_stop}")
        if feedback.plan is not None and feedback.plan is not self._plan:
            self.plans.append((feedback.stamp_s, feedback.plan.poses))
        self._plan = feedback.plan
        self._keep_way(senses)
        if feedback.pose is not None:
            self._look_about(feedback.pose, feedback.stamp_s, senses)

    @property
    def people(self) -> FloatArray:
        """As `DriveRecord` has them, so far."""
        return np.array(self._people, float).reshape(-1, 4)

    @property
    def rows(self) -> PeriodRows:
        """All so far."""
        rows = self._rows
        words = tuple(zip(*rows.words, strict=True)) or ((), (), (), ())
        speeds = np.array(rows.speeds, float).reshape(-1, 2)
        return PeriodRows(
            np.array(rows.stamps_s, float),
            np.array(rows.poses, float).reshape(-1, 3),
            speeds[:, 0],
            speeds[:, 1],
            *words,
        )

    @property
    def way(self) -> Trajectory:
        """Of the base in the map, so far."""
        stamps_s = np.array([stamp_s for stamp_s, _ in self._way], float)
        poses = np.array([T for _, T in self._way], float).reshape(-1, 4, 4)
        return Trajectory(stamps_s, poses, body="base", frame="map")

    @property
    def images(self) -> tuple[FilmImage, ...]:
        """Some of those so far, evenly."""
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

    def _look_about(self, pose: FloatArray, stamp_s: float, senses: Senses) -> None:
        """What and who is near."""
        local = senses.local()
        if local is not None:
            self.clearance_m = min(self.clearance_m, self._clearance.of(local, pose))
        outline = self._footprint.at(pose)
        self._people += [_met(one, outline, stamp_s) for one in senses.people(stamp_s)]

    def _keep_way(self, senses: Senses) -> None:
        estimate = senses.where.estimate
        if estimate is None or estimate.T_map_body is None:
            return
        if not self._way or estimate.stamp_s > self._way[-1][0]:
            self._way.append((estimate.stamp_s, estimate.T_map_body))


class _Film:
    """So many images at most, evenly over the time so far."""

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
    """Distance of an outline from what is occupied; of one costmap it is made once."""

    def __init__(self, footprint: Footprint) -> None:
        self._outline = _points_on(footprint)
        self._of: Costmap | None = None
        self._distance_m: FloatArray = np.empty((0, 0))

    def of(self, costmap: Costmap, pose: FloatArray) -> float:
        """To the nearest edge of an occupied cell, less than a cell too long; infinite where none is."""
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


def _met(person: Person, outline: FloatArray, stamp_s: float) -> tuple[float, float, float, float]:
    """Stamp, place, and how far his circle is from an outline (N, 2); 0 where they overlap."""
    x, y = map(float, person.position)
    inside_m = cv2.pointPolygonTest(outline.astype(np.float32), (x, y), measureDist=True)
    return stamp_s, x, y, max(-inside_m - person.radius_m, 0.0)


def _points_on(footprint: Footprint) -> FloatArray:
    """(N, 2) along an outline."""
    corners = footprint.corners
    sides = []
    for begin, end in zip(corners, np.roll(corners, -1, axis=0), strict=True):
        count = max(int(np.ceil(np.hypot(*(end - begin)) / _OUTLINE_STEP_M)), 1)
        sides.append(begin + (end - begin) * (np.arange(count) / count)[:, None])
    return np.concatenate(sides)
