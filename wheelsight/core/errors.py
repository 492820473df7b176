"""Exceptions, one type for each kind of error that a caller may handle.

    WheelsightError
    ├── InputError               invalid input: with file, place and fix
    │   ├── RecordingError       a recording's folder, list files or images
    │   ├── CalibrationError     camera, depth or robot parameters
    │   ├── TrajectoryError      a trajectory's text or values
    │   ├── AreaError            polygons of areas, their coordinates, or labels that fit none
    │   ├── PlaceError           a model of places that is invalid, hostile, or does not fit these areas or frames
    │   ├── MapError             an invalid map file, or a frame or pose that a map cannot take
    │   ├── ConfigError          a setting that is unknown, impossible or in conflict
    │   ├── ArgumentError        an event or array from Python code of the wrong type or shape
    │   ├── OutputError          an output that cannot be written, or would be overwritten
    │   ├── DeviceError          a port or pipe that is missing, denied, in use, or does not answer
    │   └── PartError            a user's own part, such as a planner, raised, or gave an invalid answer
    ├── DegenerateGeometryError  points that do not determine a motion
    └── EvaluationError          two trajectories that cannot be compared

A frame that cannot be tracked is a value, not an exception: `MotionEstimate.reason`.
"""

from __future__ import annotations

from os import PathLike
from pathlib import Path

# Together at most a screen of 25 lines of 80 columns, whatever a file quotes.
_LONGEST_PATH, _LONGEST_PROBLEM, _LONGEST_FIX = 600, 800, 500


class WheelsightError(Exception):
    """Root of everything wheelsight raises on purpose."""


class InputError(WheelsightError):
    """Invalid input; the message is one line, `file:line: problem (fix)`."""

    def __init__(
        self, problem: str, *, path: str | PathLike[str] | None = None, line: int | None = None, fix: str | None = None
    ) -> None:
        self.problem = problem
        self.path = None if path is None else Path(path)
        self.line = line
        self.fix = fix
        where = "" if path is None else _shown(str(self.path), _LONGEST_PATH)
        if line is not None:
            where += f":{line}"
        text = _shown(" ".join(problem.split()), _LONGEST_PROBLEM)
        text = f"{where}: {text}" if where else text
        shown = _shown(" ".join((fix or "").split()), _LONGEST_FIX)
        super().__init__(f"{text} ({shown})" if shown else text)


def _shown(text: str, longest: int) -> str:
    """Return text without control characters, and without its middle if it is longer than `longest`."""
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
    """A model of places cannot be trained, read, or used with these inputs."""


class MapError(InputError):
    """A map cannot be read, written, or take a frame or pose."""


class ConfigError(InputError):
    """A setting is unknown, impossible, or contradicts another."""


class ArgumentError(InputError):
    """An event or array passed to a function has the wrong type or shape."""


class OutputError(InputError):
    """An output cannot be written, or would overwrite a file."""


class DeviceError(InputError):
    """A serial port or pipe is missing, denied or in use, or its device does not answer."""


class PartError(InputError):
    """A user's own part raised an exception, or gave an invalid answer."""


class DegenerateGeometryError(WheelsightError):
    """Points do not determine a motion."""


class EvaluationError(WheelsightError):
    """Two trajectories share too little to be compared."""
