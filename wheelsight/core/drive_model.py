"""`DriveModel`: how the wheels of a robot answer commands, straight on and in turns. A part of a calibration file."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass, fields
from typing import Any, Literal, get_args

from wheelsight.core.calibration_parts import Range, check_range, made, mapping, number
from wheelsight.core.errors import CalibrationError

# One-sided 95 % of a normal distribution, in standard deviations.
WORST_SIGMAS = 1.645
# Range of commands above the dead zone in which a jump of the speed is complete by 63 %. Chosen: a controller's step of
# speed at its least command is not sharper in the logs of a real chair.
EDGE = 0.01
# Largest share by which the track widths of the model's robot and of the calibration differ; a chair's own differs by a
# few percent between floors.
_MOST_TRACK_CHANGE = 0.2

DriveCommand = Literal["joystick", "velocity"]
Pair = tuple[float, float]

_TIME, _SPEED = Range(0.0, 5.0, "s"), Range(0.0, 20.0, "m/s")
_NUMBERS = {
    "dead_time_s": Range(0.0, 3.0, "s"),
    "rise_s": Range(0.001, 5.0, "s"),
    "fall_s": Range(0.001, 5.0, "s"),
    "dead_time_sigma_s": _TIME,
    "rise_sigma_s": _TIME,
    "fall_sigma_s": _TIME,
    "stop_sigma_s": _TIME,
    "acceleration_m_s2": Range(0.0, 50.0, "m/s²"),
    "braking_m_s2": Range(0.0, 50.0, "m/s²"),
    "residual_m_s": _SPEED,
}
_PAIRS = {
    "dead_zone": Range(0.0, 10.0, ""),
    "gain": Range(-100.0, 100.0, ""),
    "bend": Range(-1000.0, 1000.0, ""),
    "jump_m_s": Range(-20.0, 20.0, "m/s"),
    "largest_command": Range(0.0, 20.0, ""),
    "largest_speed_m_s": _SPEED,
    "dead_zone_sigma": Range(0.0, 100.0, ""),
    "gain_sigma": Range(0.0, 100.0, ""),
}
_NEEDED = ("dead_time_s", "rise_s", "fall_s")


@dataclass(frozen=True, slots=True)
class DriveAxis:
    """Response of the wheels to one kind of command: a static gain, a dead time, and a lag of first order.

    Speeds are those of a rim: of straight commands the mean of both, of turns half of right minus left, which is the
    yaw rate times half the track width. A pair has a value for positive and one for negative commands.

    Attributes:
        dead_time_s: from a command to its first effect.
        rise_s, fall_s: time constants while the wheels gain and lose speed.
        dead_zone: size of a command up to which the wheels stand.
        gain, bend, jump_m_s: a command that exceeds the dead zone by x has the speed jump + gain x + bend x². All are
            negative if positive commands give negative speeds.
        largest_command: that was driven; 0 for a direction that was not. Beyond, the gain is that at this command.
        largest_speed_m_s: that was driven.
        acceleration_m_s2, braking_m_s2: largest that were driven; 0 if unknown.
        dead_time_sigma_s, rise_sigma_s, fall_sigma_s, dead_zone_sigma: standard deviations.
        gain_sigma: of the speed at the largest command, relative.
        stop_sigma_s: of the sum of dead time and `fall_s`, which a stop determines better than each.
        residual_m_s: root mean square of measured minus predicted speed.

    Raises:
        CalibrationError: an impossible value.
    """

    dead_time_s: float
    rise_s: float
    fall_s: float
    dead_zone: Pair = (0.0, 0.0)
    gain: Pair = (1.0, 1.0)
    bend: Pair = (0.0, 0.0)
    jump_m_s: Pair = (0.0, 0.0)
    largest_command: Pair = (0.0, 0.0)
    largest_speed_m_s: Pair = (0.0, 0.0)
    acceleration_m_s2: float = 0.0
    braking_m_s2: float = 0.0
    dead_time_sigma_s: float = 0.0
    rise_sigma_s: float = 0.0
    fall_sigma_s: float = 0.0
    stop_sigma_s: float = 0.0
    dead_zone_sigma: Pair = (0.0, 0.0)
    gain_sigma: Pair = (0.0, 0.0)
    residual_m_s: float = 0.0

    def __post_init__(self) -> None:
        for name, allowed in _NUMBERS.items():
            check_range(name, number(getattr(self, name), name), allowed)
        for name, allowed in _PAIRS.items():
            for value in getattr(self, name):
                check_range(name, number(value, name), allowed)
        if self.gain[0] * self.gain[1] < 0:
            raise CalibrationError(
                f"gain is {list(self.gain)}: both directions of a command would move the wheels the same way",
                fix="two numbers of one sign",
            )

    def speed_m_s(self, command: float) -> float:
        """Return the speed of a rim that a constant command leads to."""
        side = 0 if command >= 0 else 1
        above = abs(command) - self.dead_zone[side]
        if above <= 0.0:
            return 0.0
        # The gain is linear beyond the largest command: an extrapolated curve may fall again.
        most = max(self.largest_command[side] - self.dead_zone[side], 0.0)
        known = min(above, most) if most else above
        gain, bend = self.gain[side], self.bend[side]
        speed = self.jump_m_s[side] * (1.0 - math.exp(-above / EDGE)) + gain * above
        speed += bend * (known * known + 2.0 * known * (above - known))
        return math.copysign(1.0, command) * speed

    def after(self, speed_m_s: float, towards_m_s: float, seconds: float) -> float:
        """Return the speed after a time in which the wheels were led towards another one."""
        return lagged(speed_m_s, towards_m_s, seconds, self.rise_s, self.fall_s)

    def stop_s(self, sigmas: float = WORST_SIGMAS) -> float:
        """Return the way to a standstill after a command to stop, divided by the speed at that command.

        A dead time and a lag of first order make it independent of the speed. `sigmas` standard deviations are added.
        """
        return self.dead_time_s + self.fall_s + sigmas * self.stop_sigma_s


@dataclass(frozen=True, slots=True)
class DriveModel:
    """Response of a robot's drive to commands, by `wheelsight calibrate drive`.

    Attributes:
        command: "velocity" for commands as `VelocityCommand`, whose turns count as speeds of a rim; "joystick" for
            shares of a joystick's way, or of the motors' duty.
        straight, turn: the responses; None for one that was not driven.
        right_over_left: speed of the right wheel over that of the left one at straight commands.
        right_over_left_sigma: its standard deviation.
        track_width_m: of the robot whose model it is; 0 if unknown.

    Raises:
        CalibrationError: an impossible value.
    """

    command: DriveCommand
    straight: DriveAxis | None = None
    turn: DriveAxis | None = None
    right_over_left: float = 1.0
    right_over_left_sigma: float = 0.0
    track_width_m: float = 0.0

    def __post_init__(self) -> None:
        if self.command not in get_args(DriveCommand):
            raise CalibrationError(f"command is {self.command!r}", fix=f"one of {', '.join(get_args(DriveCommand))}")
        if self.straight is None and self.turn is None:
            raise CalibrationError("has neither straight nor turn", fix="wheelsight calibrate drive measures them")
        check_range("right_over_left", number(self.right_over_left, "right_over_left"), Range(0.2, 5.0, ""))
        check_range("right_over_left_sigma", number(self.right_over_left_sigma, ""), Range(0.0, 5.0, ""))
        check_range("track_width_m", number(self.track_width_m, "track_width_m"), Range(0.0, 10.0, "m"))

    def stop_s(self, *, straight: bool, turn: bool, sigmas: float = WORST_SIGMAS) -> float:
        """Return the longest `DriveAxis.stop_s` of the motions named; of the other kind if one was not driven."""
        axes = [axis for axis, is_so in ((self.straight, straight), (self.turn, turn)) if is_so and axis is not None]
        axes = axes or [axis for axis in (self.straight, self.turn) if axis is not None]
        return max(axis.stop_s(sigmas) for axis in axes)

    @property
    def longest_lag_s(self) -> float:
        """Time after which any command has had most of its effect, at the 95 % worst."""
        axes = [axis for axis in (self.straight, self.turn) if axis is not None]
        return max(axis.dead_time_s + max(axis.rise_s, axis.fall_s) + WORST_SIGMAS * axis.stop_sigma_s for axis in axes)

    def check_robot(self, track_width_m: float) -> None:
        """Raise CalibrationError if the model is of a robot with another track width."""
        known_m = self.track_width_m
        if known_m and abs(known_m - track_width_m) > _MOST_TRACK_CHANGE * track_width_m:
            raise CalibrationError(
                f"drive_model is of a robot with a track width of {known_m:g} m, and wheels has {track_width_m:g} m",
                fix="calibrate the drive of this robot: wheelsight calibrate drive RECORDING",
            )


def lagged(speed: float, towards: float, seconds: float, rise_s: float, fall_s: float) -> float:
    """Return a speed after a time, by a lag of first order with one time constant for each direction.

    A speed of the opposite sign falls to zero first.
    """
    if speed * towards < 0:
        to_zero_s = fall_s * math.log1p(-speed / towards)
        if seconds < to_zero_s:
            return towards + (speed - towards) * math.exp(-seconds / fall_s)
        speed, seconds = 0.0, seconds - to_zero_s
    time_s = rise_s if abs(towards) > abs(speed) else fall_s
    return towards + (speed - towards) * math.exp(-seconds / time_s)


class DriveResponse:
    """The rims of a robot that answers velocities as a drive model says: dead time and lag of straight on and turns.

    Velocities are in m/s of a rim. The gain of a velocity model applies. That of a joystick does not: the controller
    between both inverts it.
    """

    def __init__(self, model: DriveModel) -> None:
        axes = [model.straight or model.turn, model.turn or model.straight]
        self._axes = [axis for axis in axes if axis is not None]
        self._has_gain = model.command == "velocity"
        self._now_s, self._speeds = 0.0, [0.0, 0.0]
        self._sent: list[deque[tuple[float, float]]] = [deque([(-math.inf, 0.0)]) for _ in axes]

    def after(self, forward_m_s: float, turn_m_s: float, seconds: float) -> tuple[float, float]:
        """Return the speeds of the left and right rim after a time with a command."""
        for index, (axis, command) in enumerate(zip(self._axes, (forward_m_s, turn_m_s), strict=True)):
            sent = self._sent[index]
            sent.append((self._now_s + axis.dead_time_s, command))
            while len(sent) > 1 and sent[1][0] <= self._now_s + 1e-9:
                sent.popleft()
            towards = axis.speed_m_s(sent[0][1]) if self._has_gain else sent[0][1]
            self._speeds[index] = axis.after(self._speeds[index], towards, seconds)
        self._now_s += seconds
        return self._speeds[0] - self._speeds[1], self._speeds[0] + self._speeds[1]


_AXES = ("straight", "turn")
_AXIS_FIELDS = tuple(one.name for one in fields(DriveAxis))
_MODEL_FIELDS = tuple(one.name for one in fields(DriveModel))


def drive_model_fields(model: DriveModel) -> dict[str, Any]:
    """Return the fields of a model for a file."""
    document: dict[str, Any] = {"command": model.command}
    document |= {name: float(getattr(model, name)) for name in _MODEL_FIELDS if name not in ("command", *_AXES)}
    for name in _AXES:
        axis: DriveAxis | None = getattr(model, name)
        if axis is not None:
            document[name] = {key: float(getattr(axis, key)) for key in _NUMBERS}
            document[name] |= {key: [float(value) for value in getattr(axis, key)] for key in _PAIRS}
    return document


def drive_model_from(value: Any) -> DriveModel:
    """Return the model of a file's fields. Raises CalibrationError that names the field."""
    known = dict(mapping(value, "drive_model", _MODEL_FIELDS))
    for name in _AXES:
        if known.get(name) is not None:
            known[name] = _axis(known[name], f"drive_model.{name}")
    if "command" not in known:
        fix = f"one of {', '.join(get_args(DriveCommand))}"
        raise CalibrationError("field drive_model.command is missing", fix=fix)
    return made(DriveModel, "drive_model", known)


def _axis(value: Any, name: str) -> DriveAxis:
    known: Mapping[str, Any] = mapping(value, name, _AXIS_FIELDS)
    for key in _NEEDED:
        if key not in known:
            raise CalibrationError(f"field {name}.{key} is missing", fix=f"{name} needs {', '.join(_NEEDED)}")
    numbers: dict[str, Any] = {}
    for key, one in known.items():
        if key in _NUMBERS:
            numbers[key] = number(one, f"{name}.{key}")
        elif not isinstance(one, list) or len(one) != len(("positive", "negative")):
            fix = "two numbers, for positive and for negative commands: [0.1, 0.1]"
            raise CalibrationError(f"field {name}.{key} is {one!r}", fix=fix)
        else:
            numbers[key] = tuple(number(part, f"{name}.{key}") for part in one)
    return made(DriveAxis, name, numbers)
