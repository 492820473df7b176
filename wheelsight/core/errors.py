"""Exceptions, one type for each kind of error that a caller may handle.

    WheelsightError
    ├── InputError               what was handed in is wrong: names the file, the place and the fix
    │   ├── RecordingError       a recording's folder, list files or images
    │   ├── CalibrationError     camera, depth or robot parameters
    │   ├── TrajectoryError      a trajectory's text or values
    │   ├── AreaError            polygons of areas, their coordinates, or labels that fit none
    │   ├── PlaceError           a model of places that is none, is hostile, or does not fit these areas or frames
    │   ├── MapError             a map's file that is none, or a frame or pose that cannot go into a map
    │   ├── ConfigError          a setting that is unknown, impossible or in conflict
    │   ├── ArgumentError        an event or array from Python code, of another type or shape than asked for
    │   ├── OutputError          an output that cannot be written, or would be overwritten
    │   ├── DeviceError          a port or pipe that is missing, denied, in use, or does not answer
    │   └── PartError            a part of a user's own, such as a planner, raised, or answered what is no answer
    ├── DegenerateGeometryError  points that do not determine the motion asked for
    └── EvaluationError          two trajectories that cannot be compared

A frame that cannot be tracked is no exception but a value: `MotionEstimate.reason`.
"""

from __future__ import annotations

from os import PathLike
from pathlib import Path

# Together no longer than a screen of 25 lines of 80 columns, whatever a file quotes.
_LONGEST_PATH, _LONGEST_PROBLEM, _LONGEST_FIX = 600, 800, 500


class WheelsightError(Exception):
    """Root of everything wheelsight raises on purpose."""


class InputError(WheelsightError):
    """Something handed in is wrong; the message is one line, `file:line: problem (fix)`."""

    def __init__(
        self,
        problem: str,
        *,
        path: str | PathLike[str] | None = None,
        line: int | None = None,
        fix: str | None = None,
    ) -> None:
        self.problem = problem
        self.path = None if path is None else Path(path)
        self.line = line
        self.fix = fix
        super().__init__(self._one_line())

    def _one_line(self) -> str:
        where = "" if self.path is None else _shown(str(self.path), _LONGEST_PATH)
        if self.line is not None:
            where += f":{self.line}"
        problem = _shown(" ".join(self.problem.split()), _LONGEST_PROBLEM)
        fix = _shown(" ".join((self.fix or "").split()), _LONGEST_FIX)
        text = f"{where}: {problem}" if where else problem
        return f"{text} ({fix})" if fix else text


def _shown(text: str, longest: int) -> str:
    """Text as a terminal may show it: no control characters, its middle left out where it is longer than that."""
    text = _shortened(text, longest)
    if text.isprintable():
        return text
    return _shortened("".join(c if c.isprintable() else ascii(c)[1:-1] for c in text), longest)


def _shortened(text: str, longest: int) -> str:
    return text if len(text) <= longest else f"{text[: longest // 2]} … {text[-longest // 2 + 3 :]}"


class RecordingError(InputError):
    """A recording cannot be read as it stands."""


class CalibrationError(InputError):
    """Parameters of a camera, a depth sensor or a robot are missing or impossible."""


class TrajectoryError(InputError):
    """A trajectory's text or values are not one."""


class AreaError(InputError):
    """Areas overlap, cross themselves, have no coordinate, or a label names none of them."""


class PlaceError(InputError):
    """A model of places cannot be trained, read, or used with what it is given."""


class MapError(InputError):
    """A map cannot be read, written as asked, or take the frame or pose it is given."""


class ConfigError(InputError):
    """A setting is unknown, impossible, or contradicts another."""


class ArgumentError(InputError):
    """An event or array handed to a function is of another type or shape than it takes."""


class OutputError(InputError):
    """An output cannot be written, or would overwrite what is there."""


class DeviceError(InputError):
    """A serial port or pipe is missing, denied or in use, or what is behind it does not answer."""


class PartError(InputError):
    """A part of a user's own raised an exception, or answered what is not asked for."""


class DegenerateGeometryError(WheelsightError):
    """The points given do not determine the motion asked for."""


class EvaluationError(WheelsightError):
    """Two trajectories share too little to be compared."""
