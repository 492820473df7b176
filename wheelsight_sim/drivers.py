"""Who drives: along a route with rounded corners, with a stop at each corner, or by speeds from a file."""

from __future__ import annotations

import math
from bisect import bisect_right
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Protocol

import numpy as np
from numpy.typing import ArrayLike

from wheelsight.core.errors import ConfigError
from wheelsight.core.files import StrPath
from wheelsight.core.geometry import FloatArray, se2, se3
from wheelsight.core.inputs import lines_of
from wheelsight.io.recordings.tables import read_list, read_table

# A driver sees the true pose, as a person with eyes does (or goes by the wheels alone), and asks for a forward speed
# and a yaw rate. That these change no faster than a rider can bear is the drivers' own care; `ManualVelocities`
# leaves it to the motors' controller, which ramps less gently.

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
    """The driver of one drive."""

    @property
    def T_world_start(self) -> FloatArray | None:
        """(4, 4) where the base has to stand at the start, or None where any place will do."""
        ...

    @property
    def is_blind(self) -> bool:
        """Whether this driver gets the pose of the wheelchair's own odometry, not the true one."""
        ...

    def command(self, stamp_s: float, T_world_base: FloatArray) -> Command | None:
        """Called every `COMMAND_PERIOD_S`; None once the drive is over."""
        ...


class RouteFollower:
    """Follows a smooth path: its speed by the path's bends, its yaw rate by the bend ahead and by how far it is off.

    Legs that turn back too sharply to be rounded are parted by a turn on the spot; see `smooth_path`.
    """

    def __init__(self, paths: list[Path2d], speed_m_s: float) -> None:
        self._paths = paths
        self._speeds = [speed_profile(path, speed_m_s) for path in paths]
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
            error_rad = float(se2.wrap_angle(self._paths[self._part + 1].at(0.0)[2] - yaw_rad))
            if abs(error_rad) < _ALIGNED_RAD and abs(self._ramp.yaw_rate_rad_s) < 0.02:
                self._part, self._along_m = self._part + 1, 0.0
            return self._ramp.towards(0.0, _turning_rate(error_rad))
        v_m_s = float(np.interp(self._along_m, path.along_m, self._speeds[self._part]))
        on_x, on_y, on_yaw = path.at(self._along_m)
        off_m = math.cos(on_yaw) * (y_m - on_y) - math.sin(on_yaw) * (x_m - on_x)
        off_rad = float(se2.wrap_angle(yaw_rad - on_yaw))
        # The wheelchair answers late; the bend is read a little ahead of it.
        bend_per_m = path.bend_at(self._along_m + 0.1 * v_m_s)
        yaw_rate = v_m_s * (bend_per_m - _PULL_PER_M * off_m - _PULL_PER_RAD * off_rad)
        return self._ramp.towards(v_m_s, float(np.clip(yaw_rate, -1.5, 1.5)))


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
        points = laps_of(waypoints, is_loop=False, laps=1)
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
        error_rad = float(se2.wrap_angle(self._yaws_rad[self._leg] - yaw_rad))
        if abs(error_rad) < _ALIGNED_RAD and abs(self._ramp.yaw_rate_rad_s) < 0.02:
            if self._leg == len(self._goals):
                return None
            self._is_driving = True
        return self._ramp.towards(0.0, _turning_rate(error_rad))


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
            raise ConfigError("manual velocities need at least two lines; the last one ends the drive")
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


def follow_route(route: ArrayLike, *, is_loop: bool, laps: int = 1, speed_m_s: float = 1.0) -> RouteFollower:
    """A driver along waypoints (N, 2) in metres, who stays within about 10 cm of the legs and rounds the corners.

    A loop is driven `laps` times and ends where it began. What is no loop is driven to its end, and back for every
    second lap.

    Raises:
        ConfigError: a speed over 1.2 m/s or not positive, no lap, fewer than two waypoints, or two alike in succession.
    """
    return RouteFollower(smooth_path(laps_of(route, is_loop, laps)), _checked_speed(speed_m_s))


def read_manual_velocities(path: StrPath) -> ManualVelocities:
    """Velocities from a table with commas whose first line names the columns stamp_s, v_m_s and yaw_rate_rad_s.

    Raises:
        InputError: naming file, line and column.
    """
    path = Path(path)
    rows, warnings = read_table(path, ("stamp_s", "v_m_s", "yaw_rate_rad_s"))
    if warnings:
        last = len(lines_of(read_list(path)))
        raise ConfigError("the last line does not end", path=path, line=last, fix="end it with a new line")
    last_s = -math.inf
    for row in rows:
        if row.stamp_s < 0 or row.stamp_s <= last_s:
            raise ConfigError(f"stamp_s is {row.stamp_s:g}", path=path, line=row.number, fix="stamps grow from 0 on")
        last_s = row.stamp_s
    for name, limit in (("v_m_s", MAX_SPEED_M_S), ("yaw_rate_rad_s", MAX_YAW_RATE_RAD_S)):
        for row in rows:
            _check_limit(name, row[name], limit, row.path, row.number)
    if len(rows) < 2:
        raise ConfigError("has fewer than two rows", path=path, fix="the last row ends the drive")
    columns = ([row[name] for row in rows] for name in ("stamp_s", "v_m_s", "yaw_rate_rad_s"))
    return ManualVelocities(*columns)


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


def speed_profile(path: Path2d, speed_m_s: float) -> FloatArray:
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
    return (float(T_world_base[0, 3]), float(T_world_base[1, 3]), math.atan2(T_world_base[1, 0], T_world_base[0, 0]))


def _checked_speed(speed_m_s: float) -> float:
    if not 0 < speed_m_s <= MAX_SPEED_M_S:
        raise ConfigError(f"speed is {speed_m_s:g} m/s", fix=f"above 0 and up to {MAX_SPEED_M_S} m/s")
    return float(speed_m_s)


def _check_limit(name: str, value: float, limit: float, path: Path | None = None, line: int | None = None) -> None:
    if not abs(value) <= limit:
        raise ConfigError(f"{name} is {value:g}", path=path, line=line, fix=f"-{limit} to {limit}")


_SPACING_M = 0.02
_OFF_LEGS_M, _WIDEST_RADIUS_M = 0.1, 1.0
_SHARPEST_ROUNDED_RAD = np.radians(135)
_SEARCH_AHEAD_M = 0.5
_EASED_M = 0.16


@dataclass(frozen=True, eq=False)
class Path2d:
    """Points every 2 cm or so.

    Attributes:
        xy_m: (N, 2).
        along_m: (N,) way from the start, growing.
        yaws_rad: (N,) directions, without jumps of a whole turn.
        bends_per_m: (N,) curvatures, positive to the left, eased over a few points as a driver steers.
    """

    xy_m: FloatArray
    along_m: FloatArray
    yaws_rad: FloatArray
    bends_per_m: FloatArray

    @property
    def length_m(self) -> float:
        """Of the whole path."""
        return float(self.along_m[-1])

    def at(self, along_m: float) -> tuple[float, float, float]:
        """x, y and direction at a way from the start."""
        columns = (*self.xy_m.T, self.yaws_rad)
        x_m, y_m, yaw_rad = (float(np.interp(along_m, self.along_m, column)) for column in columns)
        return x_m, y_m, yaw_rad

    def bend_at(self, along_m: float) -> float:
        """The curvature there; that of the end beyond it."""
        return float(np.interp(along_m, self.along_m, self.bends_per_m))

    def nearest(self, x_m: float, y_m: float, after_m: float) -> float:
        """The way to the place nearest to a point, looked for from `after_m` half a metre on, never back."""
        first = max(int(np.searchsorted(self.along_m, after_m)) - 1, 0)
        last = int(np.searchsorted(self.along_m, after_m + _SEARCH_AHEAD_M)) + 1
        xy, along_m = self.xy_m[first:last], self.along_m[first:last]
        steps, lengths = np.diff(xy, axis=0), np.diff(along_m)
        if not len(steps):
            return after_m
        share = np.einsum("ij,ij->i", (x_m, y_m) - xy[:-1], steps) / np.einsum("ij,ij->i", steps, steps)
        share = share.clip(0, 1)
        feet = xy[:-1] + share[:, None] * steps
        best = int(np.argmin(np.hypot(feet[:, 0] - x_m, feet[:, 1] - y_m)))
        return max(after_m, float(along_m[best] + share[best] * lengths[best]))


def laps_of(route: ArrayLike, is_loop: bool, laps: int) -> FloatArray:
    """The waypoints (M, 2) of all laps, one after the other; see `drivers.follow_route`. Raises ConfigError."""
    points = np.array(route, float)
    if points.ndim != 2 or points.shape[1:] != (2,) or len(points) < 2 + is_loop or not np.isfinite(points).all():
        raise ConfigError(f"a route needs at least {2 + is_loop} waypoints of x and y, not {points.shape}")
    if laps < 1:
        raise ConfigError(f"laps is {laps}", fix="1 or more")
    if is_loop:
        points = np.concatenate([np.tile(points, (laps, 1)), points[:1]])
    else:
        points = np.concatenate([points, *((points[-2::-1], points[1:])[lap % 2] for lap in range(laps - 1))])
    if (np.hypot(*np.diff(points, axis=0).T) < _SPACING_M).any():
        raise ConfigError("two waypoints in succession are the same", fix="a loop does not repeat its first waypoint")
    return points


def smooth_path(points: FloatArray) -> list[Path2d]:
    """Waypoints (N, 2) as paths with rounded corners, parted where a corner is too sharp to be rounded."""
    yaws = np.arctan2(*np.diff(points, axis=0).T[::-1])
    turns = np.abs((np.diff(yaws) + np.pi) % (2 * np.pi) - np.pi)
    cuts = [0, *(np.flatnonzero(turns > _SHARPEST_ROUNDED_RAD) + 1).tolist(), len(points) - 1]
    paths = []
    for first, last in pairwise(cuts):
        # Legs and arcs, sampled.
        part = points[first : last + 1]
        arcs = [_arc(*corner) for corner in zip(part, part[1:], part[2:], strict=False)]
        corners = np.concatenate([part[:1], *arcs, part[-1:]])
        corners = corners[np.concatenate([[True], np.hypot(*np.diff(corners, axis=0).T) > 1e-6])]
        along = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(corners, axis=0).T))])
        samples = np.linspace(0, along[-1], max(int(np.ceil(along[-1] / _SPACING_M)), 2) + 1)
        xy = np.stack([np.interp(samples, along, column) for column in corners.T], axis=-1)
        directions = np.unwrap(np.arctan2(*np.diff(xy, axis=0).T[::-1]))
        yaws = np.concatenate([directions[:1], (directions[1:] + directions[:-1]) / 2, directions[-1:]])
        bends = np.gradient(yaws, samples)
        width = max(int(_EASED_M / (samples[1] - samples[0])), 1)
        eased = np.convolve(np.pad(bends, width, mode="edge"), np.ones(width) / width, mode="same")[width:-width]
        paths.append(Path2d(xy, samples, yaws, eased))
    return paths


def _arc(before: FloatArray, corner: FloatArray, after: FloatArray) -> FloatArray:
    """Points (N, 2) of the arc that rounds a corner; smaller where a leg is too short for it."""
    into, out = corner - before, after - corner
    reach = np.hypot(*into), np.hypot(*out)
    into, out = into / reach[0], out / reach[1]
    turn = float(np.arctan2(into[0] * out[1] - into[1] * out[0], into @ out))
    if abs(turn) < 1e-6:
        return corner[None]
    # Its middle is (1 - cos(turn / 2)) of the radius off both legs.
    radius = min(_OFF_LEGS_M / (1 - np.cos(turn / 2)), _WIDEST_RADIUS_M)
    tangent = min(radius * abs(np.tan(turn / 2)), 0.5 * min(reach))
    radius = tangent / abs(np.tan(turn / 2))
    inward = np.sign(turn) * np.array([-into[1], into[0]])
    centre = corner - tangent * into + radius * inward
    angles = np.linspace(0, abs(turn), max(int(np.ceil(abs(turn) * radius / _SPACING_M)), 3) + 1)
    sideways, onward = np.cos(angles)[:, None], np.sin(angles)[:, None]
    return np.asarray(centre + radius * (onward * into - sideways * inward))
