"""Commands and wheel speeds of a drive: `DriveLog`, of a recording with commands.csv or of a table."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from wheelsight.core.drive_model import DriveCommand
from wheelsight.core.errors import CalibrationError, RecordingError
from wheelsight.core.geometry import FloatArray
from wheelsight.core.inputs import is_there
from wheelsight.io.recordings import Recording
from wheelsight.io.recordings.native import COMMANDS_FILE, COMMANDS_HEADER
from wheelsight.io.recordings.tables import column_names, read_columns
from wheelsight_calibration.wheel_drive import drive_of

# Counts of fine encoders are no speeds: over this time they are averaged.
_WINDOW_S = 0.05
# Of a table whose rows hold commands and speeds at once; a longer gap is a loss of rows. Chosen.
_MOST_GAP_S = 0.5
_SPEEDS = ("left_m_s", "right_m_s")
_KNOWN: tuple[tuple[tuple[str, ...], DriveCommand], ...] = (
    (("forward_m_s", "turn_rad_s"), "velocity"),
    (("joystick_forward", "joystick_turn"), "joystick"),
    (("joystick",), "joystick"),
)


@dataclass(frozen=True, eq=False)
class DriveLog:
    """Commands and speeds of one drive, on one clock.

    Attributes:
        command: the kind of commands, as in `DriveModel`.
        commands_s: (K,) when each command began, growing.
        forward, turn: (K,) commands; a velocity command's turn is the speed of a rim, m/s.
        command_sigma_s: standard deviation of all `commands_s` together.
        stamps_s: (N,) growing.
        left_m_s, right_m_s: (N,) speeds of the rims.
        is_mean: whether a speed is the mean since the stamp before, as of counts; else it is that at its stamp.
        track_width_m: 0 if unknown.
    """

    name: str
    command: DriveCommand
    commands_s: FloatArray
    forward: FloatArray
    turn: FloatArray
    command_sigma_s: float
    stamps_s: FloatArray
    left_m_s: FloatArray
    right_m_s: FloatArray
    is_mean: bool
    track_width_m: float = 0.0
    warnings: tuple[str, ...] = ()


def recording_in(path: Path) -> Path | None:
    """Return the folder of wheels.csv in a recording or in the results of a drive; None for tables."""
    return next((folder for folder in (path, path / "wheels") if is_there(folder / "wheels.csv")), None)


def log_of_recording(recording: Recording) -> DriveLog:
    """Return the log of a recording of two wheels with commands.csv.

    Raises:
        RecordingError: it has no commands, or no two wheels.
        CalibrationError: fewer than two readings.
    """
    wheels, path = recording.calibration.wheels, Path(recording.path) / COMMANDS_FILE
    if wheels is None:
        problem = recording.calibration.lacks_two_wheels
        raise RecordingError(problem, path=recording.path, fix="a robot with two driven wheels, or --calibration FILE")
    if not is_there(path):
        raise RecordingError(
            f"has no {COMMANDS_FILE}, the commands that the wheels answered",
            path=recording.path,
            fix=f"a folder wheels of drive --out DIR, a table of commands and speeds, or a file {COMMANDS_HEADER}",
        )
    table, warnings = read_columns(path, ("forward_m_s", "turn_rad_s"))
    drive = drive_of(recording, wheels)
    kept = _apart(drive.stamps_s, _WINDOW_S)
    stamps_s = drive.stamps_s[kept]
    sides = (wheels.left_radius_m * drive.left_rad[kept], wheels.right_radius_m * drive.right_rad[kept])
    left, right = (np.concatenate([[0.0], np.diff(side_m) / np.diff(stamps_s)]) for side_m in sides)
    return _checked(
        name=recording.name,
        command="velocity",
        commands_s=np.array(table.stamps_s),
        forward=np.array(table["forward_m_s"], float),
        turn=np.array(table["turn_rad_s"], float) * wheels.track_width_m / 2,
        command_sigma_s=0.0,
        stamps_s=stamps_s - wheels.delay_s,
        left_m_s=left,
        right_m_s=right,
        is_mean=True,
        track_width_m=wheels.track_width_m,
        warnings=(*recording.warnings, *warnings),
    )


def logs_of_tables(path: Path, track_width_m: float = 0.0) -> list[DriveLog]:
    """Return the logs of a table, or of all tables in a folder: stamp_s, commands, and speeds of both wheels.

    Commands are `joystick`, `joystick_forward` and `joystick_turn`, or `forward_m_s` and `turn_rad_s`. A single
    `joystick` is of turns if the wheels run mostly against each other.

    Raises RecordingError naming file and line, or the columns that are missing.
    """
    files = sorted(path.glob("*.csv")) if path.is_dir() else [path]
    found = [log for file in files if (log := _table(file, track_width_m, is_alone=not path.is_dir())) is not None]
    if not found:
        raise RecordingError("has no table of commands and speeds", path=path, fix=_NEEDS)
    return found


_NEEDS = f"columns stamp_s, {' and '.join(_SPEEDS)}, and joystick, or forward_m_s and turn_rad_s"


def _table(path: Path, track_width_m: float, *, is_alone: bool) -> DriveLog | None:
    try:
        names = column_names(path, ("stamp_s", *_SPEEDS))
        columns, command = next((one for one in _KNOWN if set(one[0]) <= set(names)), ((), "velocity"))
        if not columns:
            raise RecordingError("has no column of commands", path=path, fix=_NEEDS)
    except RecordingError:
        if is_alone:
            raise
        return None
    table, warnings = read_columns(path, (*_SPEEDS, *columns))
    stamps_s, left, right = np.array(table.stamps_s), *(np.array(table[name], float) for name in _SPEEDS)
    if len(stamps_s) < 2:
        raise RecordingError(f"has {len(stamps_s)} rows", path=path, fix="a drive of a minute")
    given = [np.array(table[name], float) for name in columns]
    if len(given) == 1:
        is_turn = np.abs(right - left).sum() > np.abs(left + right).sum()
        given = [np.zeros_like(given[0]), given[0]] if is_turn else [given[0], np.zeros_like(given[0])]
    elif command == "velocity":
        if not track_width_m:
            problem = "has turns in rad/s, and the track width is not known"
            raise RecordingError(problem, path=path, fix="--calibration FILE with wheels")
        given[1] = given[1] * track_width_m / 2
    # A row shows that its command began since the row before: in the middle, on average.
    period_s = float(np.median(np.diff(stamps_s)))
    return _checked(
        name=path.name,
        command=command,
        commands_s=stamps_s - period_s / 2,
        forward=given[0],
        turn=given[1],
        command_sigma_s=period_s / np.sqrt(12),
        stamps_s=stamps_s,
        left_m_s=left,
        right_m_s=right,
        is_mean=False,
        track_width_m=track_width_m,
        warnings=tuple(warnings),
    )


def _checked(**parts: Any) -> DriveLog:
    """Return a log whose commands hold only changes. Raises CalibrationError if its clocks do not fit."""
    log = DriveLog(**parts)
    for name, stamps_s in (("commands", log.commands_s), ("wheel readings", log.stamps_s)):
        if not len(stamps_s) or (np.diff(stamps_s) <= 0).any():
            raise CalibrationError(f"{log.name}: stamps of {name} do not grow", fix="sort them, and keep one of each")
    begin_s, end_s = (float(end(log.commands_s[i], log.stamps_s[i])) for end, i in ((max, 0), (min, -1)))
    if end_s <= begin_s:
        spans = [f"{stamps_s[0]:.3f} to {stamps_s[-1]:.3f} s" for stamps_s in (log.commands_s, log.stamps_s)]
        raise CalibrationError(
            f"{log.name}: commands ({spans[0]}) and wheel readings ({spans[1]}) share no time: they are of two clocks",
            fix="stamp both by one clock",
        )
    return log


def series_of(logs: Sequence[DriveLog], *, is_turn: bool) -> list[Series]:
    """Return the parts of logs in which commands of one kind are given, straight on or turns."""
    found = []
    for log in logs:
        commands = log.turn if is_turn else log.forward
        if not np.any(commands):
            continue
        speeds = (log.right_m_s - log.left_m_s) / 2 if is_turn else (log.left_m_s + log.right_m_s) / 2
        is_new = np.concatenate([[True], np.diff(commands) != 0])
        step_s = np.diff(log.stamps_s)
        is_good = np.concatenate([[False], step_s <= max(_MOST_GAP_S, 3 * float(np.median(step_s)))])
        changes_s, changed = log.commands_s[is_new], commands[is_new]
        found.append(
            Series(log.name, changes_s, changed, log.stamps_s, speeds, is_good, log.is_mean, log.command_sigma_s)
        )
    return found


@dataclass(frozen=True, eq=False)
class Series:
    """Commands of one kind and the speeds that follow; `is_good` (N,) says which speeds count. Else as `DriveLog`."""

    name: str
    commands_s: FloatArray
    commands: FloatArray
    stamps_s: FloatArray
    speeds_m_s: FloatArray
    is_good: np.ndarray
    is_mean: bool
    command_sigma_s: float


def _apart(stamps_s: FloatArray, least_s: float) -> FloatArray:
    """Return indices of stamps that are at least so far apart."""
    kept, last_s = [0], stamps_s[0]
    for index, stamp_s in enumerate(stamps_s.tolist()):
        if stamp_s - last_s >= least_s - 1e-6:
            kept.append(index)
            last_s = stamp_s
    return np.array(kept)
