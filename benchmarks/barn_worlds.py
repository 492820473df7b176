"""The real fields of the BARN challenge (Perille et al. 2020), as worlds of the simulator, for two robots.

A field is a CSV file of the centres of cylinders (`cylinder`) and of the published reference path (`path`), in metres
of the challenge's world. There a Jackal begins at (-2.25, 3) and heads along y, to a goal 10 m on. Here the robot
begins at the origin and heads along x. Cylinders of 0.075 m radius stand on three sides of the corridor and in the
field itself; the end is open. Walls of a hall, 1 m beyond, give the camera something to see there.
"""

from __future__ import annotations

import csv
import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np

from benchmarks.box_worlds import hall, with_pillars
from wheelsight.core.errors import InputError
from wheelsight.core.geometry import FloatArray
from wheelsight.core.robots import RobotLimits
from wheelsight.navigation import CostmapSettings, NavigationSettings
from wheelsight.navigation.settings import FollowSettings, FootprintSettings, MonitorSettings, PlannerSettings
from wheelsight_sim import RobotModel, World

WAY_M, RADIUS_M, HEIGHT_M = 10.0, 0.075, 1.0
_START_M = (-2.25, 3.0)
_HALL_M, _BEYOND_M = 1.0, 2.5


@dataclass(frozen=True, eq=False)
class FieldRobot:
    """A robot that crosses fields.

    Attributes:
        name: as `ROBOTS` has it.
        scale: of the field; robots are as they are.
        model: its true sizes and its camera's mount.
        camera: of the simulator's.
        settings: of its navigation.
    """

    name: str
    scale: float
    model: RobotModel
    camera: str
    settings: NavigationSettings

    @property
    def longest_s(self) -> float:
        """The time within which it must cross: the challenge's 100 s, longer as the field is."""
        return 100.0 * self.scale


# Clearpath's data sheet: 0.508 × 0.43 m and 2 m/s. The simulator gives it the chair's wheels and their controller,
# which ramps a rim by 1.5 m/s²: forward and turn together do not exceed that. Margins are those of the chair in
# proportion to the widths, but for errors of depth. The camera sees the floor from 0.3 m on, within the circle of the
# corners.
_JACKAL = FieldRobot(
    "jackal",
    1.0,
    RobotModel(
        length_m=0.508,
        width_m=0.43,
        tail_m=0.254,
        camera_height_m=0.45,
        camera_forward_m=0.0,
        camera_pitch_rad=0.5,
        height_m=0.6,
    ),
    "realsense-d455",
    NavigationSettings(
        footprint=FootprintSettings(front_m=0.254, back_m=0.254, width_m=0.43),
        limits=RobotLimits(
            forward_m_s=2.0,
            backward_m_s=0.3,
            turn_rad_s=2.0,
            acceleration_m_s2=1.0,
            braking_m_s2=1.0,
            turn_acceleration_rad_s2=1.9,
            jerk_m_s3=10.0,
        ),
        costmap=CostmapSettings(unknown="costly", inflation_m=0.35),
        planner=PlannerSettings(wanted_margin_m=0.07),
        follow=FollowSettings(margin_m=0.03),
        monitor=MonitorSettings(margin_m=0.03, slow_zone_m=0.1, slow_m_s=0.5, slow_rad_s=1.0),
    ),
)
_CHAIR = NavigationSettings(costmap=CostmapSettings(unknown="costly"))
# The same camera looks down far enough to see the floor from 0.93 m before the axle on, which is 0.08 m beyond the
# circle of the corners.
_WHEELCHAIR = FieldRobot("wheelchair", 1.75, RobotModel(camera_pitch_rad=0.5), "realsense-d455", _CHAIR)
# Its usual camera sees 57°, and the floor from 2.3 m on.
_KINECT = FieldRobot("wheelchair-kinect", 1.75, RobotModel(), "kinect-v1", _CHAIR)
ROBOTS = {robot.name: robot for robot in (_JACKAL, _WHEELCHAIR, _KINECT)}


@dataclass(frozen=True, eq=False)
class Field:
    """One field, scaled. The robot begins at the origin and heads along x.

    Attributes:
        number: of it, 0 to 299.
        scale: of lengths against the challenge's.
        pillars_m: (N, 2) centres of cylinders.
        path_m: (M, 2) the published reference path, from start to goal.
    """

    number: int
    scale: float
    pillars_m: FloatArray
    path_m: FloatArray

    @property
    def goal_m(self) -> FloatArray:
        """(2,) of the goal."""
        return np.array([WAY_M * self.scale, 0.0])

    @property
    def best_m(self) -> float:
        """Length of the reference path with the ways to its begin and from its end, as the challenge has it."""
        return float(np.hypot(*np.diff(self.path_m, axis=0).T).sum())

    @cached_property
    def world(self) -> World:
        """With walls round it."""
        low, high = self.pillars_m.min(axis=0), self.pillars_m.max(axis=0)
        out, end_m = _HALL_M * self.scale, (WAY_M + _BEYOND_M) * self.scale
        size = float(low[0] - out), float(low[1] - out), end_m, float(high[1] + out)
        empty = hall(f"BARN field {self.number}", size, [], self.number)
        return with_pillars(empty, self.pillars_m, RADIUS_M * self.scale, HEIGHT_M, self.number)


def read_field(folder: Path, number: int, scale: float) -> Field:
    """A field of a folder of `world_NNN.csv`. Raises InputError, with the line, for a file that is none."""
    path = folder / f"world_{number:03d}.csv"
    found: dict[str, list[FloatArray]] = {"cylinder": [], "path": []}
    try:
        rows = list(csv.reader(path.read_text(encoding="utf-8").splitlines()))
    except (OSError, UnicodeDecodeError) as error:
        raise InputError(
            f"cannot be read: {error}", path=path, fix="give the folder of the fields by --data"
        ) from error
    for line, row in enumerate(rows[1:], 2):
        if len(row) != 3 or row[0] not in found:
            raise InputError(f"line {line} is no cylinder or path", path=path, fix="what,x_m,y_m")
        x, y = (float(cell) if _is_number(cell) else math.nan for cell in row[1:])
        if not (math.isfinite(x) and math.isfinite(y)):
            raise InputError(f"line {line}: x_m, y_m are {row[1]}, {row[2]}", path=path, fix="give metres")
        # Ahead of the challenge's start is y, and left of it is -x.
        found[row[0]].append(scale * np.array([y - _START_M[1], _START_M[0] - x]))
    if not found["cylinder"] or not found["path"]:
        raise InputError("has no cylinders or no path", path=path, fix="give a whole file of the data set")
    ends = np.zeros((1, 2)), np.array([[WAY_M * scale, 0.0]])
    return Field(number, scale, np.array(found["cylinder"]), np.concatenate([ends[0], found["path"], ends[1]]))


def _is_number(cell: str) -> bool:
    try:
        float(cell)
    except ValueError:
        return False
    return True


def numbers_in(folder: Path) -> Sequence[int]:
    """Numbers of the fields in a folder, in order. Raises InputError if there are none."""
    names = sorted(path.stem.removeprefix("world_") for path in folder.glob("world_*.csv"))
    numbers = [int(name) for name in names if name.isdecimal()]
    if not numbers:
        raise InputError("has no world_NNN.csv", path=folder, fix="give the folder of the BARN fields by --data")
    return numbers
