"""loops.csv: matches from outside, which anybody's place recognition may write beside a recording."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from wheelsight.errors import RecordingError
from wheelsight.files import StrPath
from wheelsight.geometry import FloatArray, se3, so3
from wheelsight.inputs import is_there
from wheelsight.matches import Match
from wheelsight.recordings.protocol import GivesMatches, Recording
from wheelsight.recordings.tables import Row, column_names, read_table
from wheelsight.recordings.text import LIST, parse_stamp

MATCHES_FILE = "loops.csv"
_STAMPS = ("stamp_a_s", "stamp_b_s")
_POSE = ("x_m", "y_m", "z_m", "qx", "qy", "qz", "qw")
_SIGMAS = ("sigma_m", "sigma_rad")
_SCORE = "score"
_UNIT_TOLERANCE = 0.01
# A match a second over a whole day; each is checked by itself, which takes 25 µs.
_FILE = replace(LIST, name="a list of matches", most_mb=32, most_lines=100_000)


def read_matches(path: StrPath) -> tuple[list[Match], list[str]]:
    """Matches of a table, one a line, and warnings.

    Columns, named in the first line, in any order: stamp_a_s and stamp_b_s; if there are any, all of x_m, y_m, z_m, qx,
    qy, qz, qw, the pose of the body at b seen from a; sigma_m and sigma_rad of that pose; score, 0 to 1.

    Raises:
        RecordingError: naming file and line, for columns that are missing, or what is no number, pose or score.
    """
    path = Path(path)
    has = set(column_names(path, _STAMPS, _FILE))
    given = [name for group in (_POSE, _SIGMAS) for name in group if set(group) & has]
    if set(_SIGMAS) & has and not set(_POSE) & has:
        raise RecordingError("has sigmas and no poses", path=path, line=1, fix=f"columns {', '.join(_POSE)}")
    columns = (*_STAMPS, *given, *((_SCORE,) if _SCORE in has else ()))
    rows, warnings = read_table(path, columns, _FILE)
    return [_match(row, has) for row in rows], warnings


def matches_of(recording: Recording) -> tuple[list[Match], list[str]]:
    """The recording's own, and those of a loops.csv in its folder; and warnings. Raises RecordingError."""
    own = list(recording.matches) if isinstance(recording, GivesMatches) else []
    path = recording.path / MATCHES_FILE
    if not is_there(path):
        return own, []
    others, warnings = read_matches(path)
    return own + others, warnings


def _match(row: Row, has: set[str]) -> Match:
    a_s, b_s = (parse_stamp(row.words[row.columns[name]], row.path, row.number) for name in _STAMPS)
    score = row[_SCORE] if _SCORE in has else None
    if score is not None and not 0 <= score <= 1:
        raise RecordingError(f"score is {score:g}", path=row.path, line=row.number, fix="0 to 1: how probable it is")
    if _POSE[0] not in has:
        return Match(a_s, b_s, score=score)
    *position, qx, qy, qz, qw = (row[name] for name in _POSE)
    quaternion = np.array([qx, qy, qz, qw])
    if abs(np.linalg.norm(quaternion) - 1) > _UNIT_TOLERANCE:
        problem = f"quaternion has length {np.linalg.norm(quaternion):.4g}, not 1"
        raise RecordingError(problem, path=row.path, line=row.number, fix="write qx qy qz qw")
    T_a_b = se3.from_parts(so3.from_quaternion(quaternion / np.linalg.norm(quaternion)), position)
    return Match(a_s, b_s, T_a_b, _covariance(row) if _SIGMAS[0] in has else None, score)


def _covariance(row: Row) -> FloatArray:
    sigmas = [row[name] for name in _SIGMAS]
    if min(sigmas) <= 0:
        raise RecordingError("a sigma is not positive", path=row.path, line=row.number, fix="standard deviations")
    return np.diag(np.square(np.repeat(sigmas, 3)))
