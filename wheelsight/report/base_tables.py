"""A camera's mount before and after its calibration, as rows of text: for the page and for the terminal."""

from __future__ import annotations

import numpy as np

from wheelsight.odometry.extrinsics import QUANTITIES, BaseCalibration

# Name, unit, and how many of it make one of radians, metres or seconds.
UNITS = {
    "roll": ("roll, leans right", "°", 180 / np.pi),
    "pitch": ("pitch, looks down", "°", 180 / np.pi),
    "yaw": ("yaw, looks left", "°", 180 / np.pi),
    "x": ("x, ahead of the axle", "mm", 1e3),
    "y": ("y, left of the middle", "mm", 1e3),
    "height": ("height over the floor", "mm", 1e3),
    "delay": ("delay of the wheels' stamps", "ms", 1e3),
}


def mount_rows(found: BaseCalibration) -> list[tuple[str, ...]]:
    """One row a quantity, as `wheel_tables.HEAD` names the columns."""
    return [_row(found, name) for name in QUANTITIES]


def told(name: str, value: float, *, signed: bool = False) -> str:
    """A quantity in the unit that people measure it in."""
    _, unit, factor = UNITS[name]
    places = 2 if unit == "°" else 1
    shown = round(factor * value, places) + 0.0  # no minus before nothing
    text = f"{shown:{'+' if signed else ''}.{places}f}"
    return f"{text}°" if unit == "°" else f"{text} {unit}"


def _row(found: BaseCalibration, name: str) -> tuple[str, ...]:
    after, before = found.values[name], found.nominal_values.get(name)
    known = (
        ("unknown", "")
        if before is None
        else (told(name, before), told(name, _change(name, after - before), signed=True))
    )
    return UNITS[name][0], known[0], told(name, after), told(name, found.sigmas[name]), known[1]


def _change(name: str, change: float) -> float:
    return float((change + np.pi) % (2 * np.pi) - np.pi) if UNITS[name][1] == "°" else change
