"""How sure a run was of its poses, as a table beside its trajectory: TUM text has no room for it."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np

from wheelsight.errors import TrajectoryError
from wheelsight.files import StrPath, write_lines
from wheelsight.inputs import Kind, lines_of, read_text
from wheelsight.trajectory import Trajectory

COVARIANCES_FILE = "covariances.csv"
_AXES = ("vx", "vy", "vz", "wx", "wy", "wz")
_UPPER = np.triu_indices(6)
_HEADER = ",".join(["stamp_s", *(f"{_AXES[row]}_{_AXES[column]}" for row, column in zip(*_UPPER, strict=True))])
# 200 bytes a pose; 1 500 000 of them, as many as a trajectory may have.
_FILE = Kind("covariances", most_mb=384)


def write_covariances(trajectory: Trajectory, path: StrPath) -> None:
    """Write the covariances of a trajectory that has them: of left perturbations (v, ω), 21 numbers a stamp.

    Raises OutputError.
    """
    write_lines(path, _lines(trajectory))


def _lines(trajectory: Trajectory) -> Iterator[str]:
    assert trajectory.covariances is not None
    yield f"{_HEADER}\n"
    for stamp_s, C in zip(trajectory.stamps_s, trajectory.covariances, strict=True):
        numbers = ",".join(f"{value:.6g}" for value in C[_UPPER])
        yield f"{np.format_float_positional(stamp_s, min_digits=6)},{numbers}\n"


def with_covariances(trajectory: Trajectory, path: StrPath) -> Trajectory:
    """A trajectory with the covariances of its stamps. Raises TrajectoryError where the table is another's."""
    path = Path(path)
    first, *lines = lines_of(read_text(path, _FILE, TrajectoryError)) or [""]
    try:
        rows = np.array([[float(value) for value in line.split(",")] for line in lines if line.strip()])
    except ValueError as error:
        raise TrajectoryError("a line is no row of numbers", path=path, fix="run again") from error
    fits = first == _HEADER and rows.shape == (len(trajectory), 1 + len(_UPPER[0])) and np.isfinite(rows).all()
    if not fits or not np.array_equal(rows[:, 0], trajectory.stamps_s):
        raise TrajectoryError("does not have one line for each pose of trajectory.txt", path=path, fix="run again")
    C = np.zeros((len(rows), 6, 6))
    C[:, _UPPER[0], _UPPER[1]] = C[:, _UPPER[1], _UPPER[0]] = rows[:, 1:]
    return replace(trajectory, covariances=C)
