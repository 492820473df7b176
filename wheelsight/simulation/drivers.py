"""Who drives: along a route with rounded corners, with a stop at each corner, or by speeds from a file.

A driver sees the true pose, as a person with eyes does (or goes by the wheels alone), and asks for a forward speed and
a yaw rate. That these change no faster than a rider can bear is the drivers' own care; `ManualVelocities` leaves it to
the motors' controller, which ramps less gently.
"""

from __future__ import annotations

import math
from bisect import bisect_right
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

import numpy as np
from numpy.typing import ArrayLike

from wheelsight.errors import ConfigError
from wheelsight.files import StrPath
from wheelsight.geometry import FloatArray, se2, se3
from wheelsight.inputs import lines_of
from wheelsight.recordings.tables import Row, read_table
from wheelsight.recordings.text import read_list
from wheelsight.simulation._paths import Path2d, laps_of, smooth_path

MAX_SPEED_M_S = 1.2
MAX_YAW_RATE_RAD_S = 2.0
COMMAND_PERIOD_S = 0.02

_ACCELERATION_M_S2, _YAW_ACCELERATION_RAD_S2 = 0.5, 1.5
_CORNER_YAW_RATE_RAD_S, _TURN_RATE_RAD_S = 0.6, 0.8
_ARRIVED_M, _ALIGNED_RAD = 0.005, 0.002
_CREEPING = 0.02
_PULL_PER_M, _PULL_PER_RAD = 4.0, 3.0


@dataclass(frozen=True, slots=True)
class Command:
    """What the driver asks of the motors: forward speed, and yaw rate counter-clockwise seen from above."""

    v_m_s: float = 0.0
    yaw_rate_rad_s: float = 0.0


class Driver(Protocol):
    """Whoever holds the joystick; one drive each."""

    @property
    def T_world_start(self) -> FloatArray | None:
        """(4, 4) where the base has to stand at the start, or None where any place will do."""
        ...

    @property
    def is_blind(self) -> bool:
        """Whether the pose this driver is given is that of the wheelchair's own dead reckoning, not the true one."""
        ...

    def command(self, stamp_s: float, T_world_base: FloatArray) -> Command | None:
        """Called every `COMMAND_PERIOD_S`; None once the drive is over."""
        ...


class RouteFollower:
    """Follows a smooth path: its speed by the path's bends, its yaw rate by the bend ahead and by how far it is off.

    Legs that turn back too sharply to be rounded are parted by a turn on the spot; see `_paths.smooth_path`.
    """

    def __init__(self, paths: list[Path2d], speed_m_s: float) -> None:
        self._paths = paths
        self._speeds = [_speed_profile(path, speed_m_s) for path in paths]
        self._part = 0
        self._along_m = 0.0
        self._ramp = _Ramp()
        self.T_world_start: FloatArray | None = se3.from_plane(*paths[0].at(0.0))
        self.is_blind = False

    def command(self, stamp_s: float, T_world_base: FloatArray) -> Command | None:
        """The next command, or None at the end of the last path."""
        x_m, y_m, yaw_rad = _plane(T_world_base)
        path = self._paths[self._part]
        self._along_m = path.nearest(x_m, y_m, self._along_m)
        if self._along_m >= path.length_m - _ARRIVED_M and self._ramp.v_m_s < 0.02:
            if self._part + 1 == len(self._paths):
                return None
            return self._turn_to_next(yaw_rad)
        return self._ramp.towards(*self._wanted(path, x_m, y_m, yaw_rad))

    def _turn_to_next(self, yaw_rad: float) -> Command:
        error_rad = float(se2.wrap_angle(self._paths[self._part + 1].at(0.0)[2] - yaw_rad))
        if abs(error_rad) < _ALIGNED_RAD and abs(self._ramp.yaw_rate_rad_s) < 0.02:
            self._part, self._along_m = self._part + 1, 0.0
        return self._ramp.towards(0.0, _turning_rate(error_rad))

    def _wanted(self, path: Path2d, x_m: float, y_m: float, yaw_rad: float) -> tuple[float, float]:
        v_m_s = float(np.interp(self._along_m, path.along_m, self._speeds[self._part]))
        on_x, on_y, on_yaw = path.at(self._along_m)
        off_m = math.cos(on_yaw) * (y_m - on_y) - math.sin(on_yaw) * (x_m - on_x)
        off_rad = float(se2.wrap_angle(yaw_rad - on_yaw))
        # The wheelchair answers late; the bend is read a little ahead of it.
        bend_per_m = path.bend_at(self._along_m + 0.1 * v_m_s)
        yaw_rate = v_m_s * (bend_per_m - _PULL_PER_M * off_m - _PULL_PER_RAD * off_rad)
        return v_m_s, float(np.clip(yaw_rate, -1.5, 1.5))


class StopAndTurn:
    """Drives straight to each waypoint, stops, turns on the spot to the next: UMBmark's way round a square."""

    def __init__(
        self, waypoints: ArrayLike, speed_m_s: float = 0.5, *, final_turn: bool = True, is_blind: bool = False
    ) -> None:
        """Waypoints (N, 2) in metres; with `final_turn` it ends in the direction of the first leg.

        Blind, it steers by the wheels as their owner believes them to be, as UMBmark's robots do: its own odometry
        says that it went round the square, and truth shows where it went.

        Raises:
            ConfigError: fewer than two waypoints, two alike in succession, or a speed no wheelchair has.
        """
        points = laps_of(waypoints, is_loop=False, laps=1, clockwise=None)
        steps = np.diff(points, axis=0)
        yaws_rad = np.arctan2(steps[:, 1], steps[:, 0])
        self._speed_m_s = _checked_speed(speed_m_s)
        self._goals = points[1:]
        self._yaws_rad = [*yaws_rad.tolist(), float(yaws_rad[0] if final_turn else yaws_rad[-1])]
        self._leg, self._is_driving = 0, True
        self.is_blind = is_blind
        self._ramp = _Ramp()
        self.T_world_start: FloatArray | None = se3.from_plane(points[0, 0], points[0, 1], yaws_rad[0])

    def command(self, stamp_s: float, T_world_base: FloatArray) -> Command | None:
        """The next command, or None once the last waypoint's turn is done."""
        x_m, y_m, yaw_rad = _plane(T_world_base)
        if self._is_driving:
            return self._drive(x_m, y_m, yaw_rad)
        error_rad = float(se2.wrap_angle(self._yaws_rad[self._leg] - yaw_rad))
        if abs(error_rad) < _ALIGNED_RAD and abs(self._ramp.yaw_rate_rad_s) < 0.02:
            if self._leg == len(self._goals):
                return None
            self._is_driving = True
        return self._ramp.towards(0.0, _turning_rate(error_rad))

    def _drive(self, x_m: float, y_m: float, yaw_rad: float) -> Command:
        leg_yaw = self._yaws_rad[self._leg]
        away = self._goals[self._leg] - (x_m, y_m)
        left_m = float(away @ (math.cos(leg_yaw), math.sin(leg_yaw)))
        off_m = float(away @ (math.sin(leg_yaw), -math.cos(leg_yaw)))
        off_rad = float(se2.wrap_angle(yaw_rad - leg_yaw))
        if left_m < _ARRIVED_M and self._ramp.v_m_s < 0.02:
            self._leg, self._is_driving = self._leg + 1, False
            return self._ramp.towards(0.0, 0.0)
        v_m_s = min(self._speed_m_s, _braking_speed(left_m, _ACCELERATION_M_S2))
        return self._ramp.towards(v_m_s, v_m_s * (-_PULL_PER_M * off_m - _PULL_PER_RAD * off_rad))


class ManualVelocities:
    """Speeds given for times: each holds until the next one, and the last one ends the drive."""

    T_world_start: FloatArray | None = None
    is_blind = False

    def __init__(self, stamps_s: ArrayLike, v_m_s: ArrayLike, yaw_rates_rad_s: ArrayLike) -> None:
        """Arrays (N,); stamps from 0 s on. Raises ConfigError for arrays that do not fit, or speeds over the limit."""
        self._stamps_s = np.asarray(stamps_s, float).tolist()
        pairs = zip(np.asarray(v_m_s, float).tolist(), np.asarray(yaw_rates_rad_s, float).tolist(), strict=True)
        self._commands = [Command(v, omega) for v, omega in pairs]
        if len(self._commands) != len(self._stamps_s) or len(self._stamps_s) < 2:
            raise ConfigError("manual velocities need at least two lines, the last of which ends the drive")
        if not all(a < b for a, b in zip(self._stamps_s, self._stamps_s[1:], strict=False)):
            raise ConfigError("the stamps of manual velocities must grow")
        for command in self._commands:
            _check_limit("v_m_s", command.v_m_s, MAX_SPEED_M_S)
            _check_limit("yaw_rate_rad_s", command.yaw_rate_rad_s, MAX_YAW_RATE_RAD_S)

    def command(self, stamp_s: float, T_world_base: FloatArray) -> Command | None:
        """The velocities at `stamp_s`, standing still before the first; None from the last stamp on."""
        index = bisect_right(self._stamps_s, stamp_s + 1e-9) - 1
        if index == len(self._stamps_s) - 1:
            return None
        return self._commands[index] if index >= 0 else Command()


def follow_route(
    route: ArrayLike, *, is_loop: bool, laps: int = 1, speed_m_s: float = 1.0, clockwise: bool | None = None
) -> RouteFollower:
    """A driver along waypoints (N, 2) in metres, who stays within about 10 cm of the legs and rounds the corners.

    A loop is driven `laps` times and ends where it began; `clockwise` turns it round where it runs the other way, with
    the same first waypoint. What is no loop is driven to its end, and back for every second lap.

    Raises:
        ConfigError: a speed over 1.2 m/s or not positive, no lap, fewer than two waypoints, two alike in succession, or
            a direction asked of what is no loop.
    """
    return RouteFollower(smooth_path(laps_of(route, is_loop, laps, clockwise)), _checked_speed(speed_m_s))


def read_manual_velocities(path: StrPath) -> ManualVelocities:
    """Velocities from a table with commas whose first line names the columns stamp_s, v_m_s and yaw_rate_rad_s.

    Raises:
        InputError: naming file, line and column.
    """
    path = Path(path)
    rows, warnings = read_table(path, ("stamp_s", "v_m_s", "yaw_rate_rad_s"))
    if warnings:
        raise ConfigError("the last line does not end", path=path, line=_lines_of(path), fix="end it with a new line")
    _check_stamps(rows, path)
    v_m_s = [_limited(row, "v_m_s", MAX_SPEED_M_S) for row in rows]
    yaw_rates = [_limited(row, "yaw_rate_rad_s", MAX_YAW_RATE_RAD_S) for row in rows]
    if len(rows) < 2:
        raise ConfigError("has fewer than two rows", path=path, fix="the last row ends the drive")
    return ManualVelocities([row.stamp_s for row in rows], v_m_s, yaw_rates)


class _Ramp:
    """Holds commands to what a rider can bear: speed and yaw rate change at a limited rate."""

    def __init__(self) -> None:
        self.v_m_s = 0.0
        self.yaw_rate_rad_s = 0.0

    def towards(self, v_m_s: float, yaw_rate_rad_s: float) -> Command:
        """The command nearest to the one wanted that can follow the last."""
        # Braking is planned at the same rate; a little more is left to make up for what it lags.
        step, turn_step = 1.5 * _ACCELERATION_M_S2 * COMMAND_PERIOD_S, _YAW_ACCELERATION_RAD_S2 * COMMAND_PERIOD_S
        up = step / 1.5
        self.v_m_s += min(max(v_m_s - self.v_m_s, -step), up)
        self.yaw_rate_rad_s += min(max(yaw_rate_rad_s - self.yaw_rate_rad_s, -turn_step), turn_step)
        return Command(self.v_m_s, self.yaw_rate_rad_s)


def _speed_profile(path: Path2d, speed_m_s: float) -> FloatArray:
    """The fastest speeds (N,) along the path within its bends' yaw rate, from and to a stand, at bearable rates."""
    bends = np.abs(path.bends_per_m)
    fastest = np.minimum(speed_m_s, _CORNER_YAW_RATE_RAD_S / np.maximum(bends, 1e-9))
    fastest[-1] = 0.0
    steps = 2 * _ACCELERATION_M_S2 * np.diff(path.along_m)
    for i in range(len(steps) - 1, -1, -1):
        fastest[i] = min(fastest[i], math.sqrt(fastest[i + 1] ** 2 + steps[i]))
    # Creeping on to the very end, where the profile itself would never arrive.
    return np.maximum(fastest, np.where(path.along_m < path.length_m - _ARRIVED_M, 0.03, 0.0))


def _braking_speed(left: float, rate: float) -> float:
    """From which a braking at `rate` ends after `left`, in m and m/s or in rad and rad/s."""
    return max(math.sqrt(2 * rate * left), _CREEPING) if left > 0 else 0.0


def _turning_rate(error_rad: float) -> float:
    """The yaw rate of a turn on the spot that has `error_rad` left: quick, then gently to the end."""
    rate = min(_TURN_RATE_RAD_S, 0.7 * _braking_speed(abs(error_rad), _YAW_ACCELERATION_RAD_S2), 3.0 * abs(error_rad))
    rate = max(rate, _CREEPING) if abs(error_rad) > _ALIGNED_RAD else 0.0
    return math.copysign(rate, error_rad)


def _plane(T_world_base: FloatArray) -> tuple[float, float, float]:
    return (
        float(T_world_base[0, 3]),
        float(T_world_base[1, 3]),
        math.atan2(T_world_base[1, 0], T_world_base[0, 0]),
    )


def _checked_speed(speed_m_s: float) -> float:
    if not 0 < speed_m_s <= MAX_SPEED_M_S:
        raise ConfigError(f"speed is {speed_m_s:g} m/s", fix=f"above 0 and up to {MAX_SPEED_M_S} m/s")
    return float(speed_m_s)


def _check_limit(name: str, value: float, limit: float, path: Path | None = None, line: int | None = None) -> None:
    if not abs(value) <= limit:
        raise ConfigError(f"{name} is {value:g}", path=path, line=line, fix=f"-{limit} to {limit}")


def _check_stamps(rows: list[Row], path: Path) -> None:
    last_s = -math.inf
    for row in rows:
        if row.stamp_s < 0 or row.stamp_s <= last_s:
            raise ConfigError(f"stamp_s is {row.stamp_s:g}", path=path, line=row.number, fix="stamps grow from 0 on")
        last_s = row.stamp_s


def _lines_of(path: Path) -> int:
    return len(lines_of(read_list(path)))


def _limited(row: Row, column: str, limit: float) -> float:
    value = row[column]
    _check_limit(column, value, limit, row.path, row.number)
    return value
