"""Text with one measurement a line, its kind first: odom2 and loop in *_Input.txt, point2 and angle in *_GT.txt.

The layout of TU Chemnitz's SLAM datasets (Neubert, Schubert & Protzel, RA-L 2019).
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from wheelsight.errors import RecordingError
from wheelsight.events import WheelSpeeds
from wheelsight.geometry import FloatArray, se3
from wheelsight.matches import Match, SpeedVariances
from wheelsight.recordings._cameras import choose_calibration
from wheelsight.recordings._wheel_recording import WheelRecording, need_wheels, shipped_robot, speeds_of_wheels
from wheelsight.recordings.protocol import Layout, LeftOut, OpenOptions
from wheelsight.recordings.text import keep_growing, read_lines
from wheelsight.trajectory import Trajectory

_INPUT, _TRUTH = "*_Input.txt", "*_GT.txt"
_NUMBERS = {"odom2": 7, "loop": 3, "point2": 7, "angle": 3}
_SAME_STAMP_S = 1e-6


@dataclass(frozen=True, slots=True)
class _Measurement:
    stamp_s: float
    line: int
    values: tuple[float, ...]


class MeasurementLineReader:
    """Speeds of lines odom2 (stamp, vx, vy, turn rate, variances), each until the next; true poses of point2 and angle.

    Of the speeds, that across is left out: wheels cannot tell of it. Lines `loop` (stamp, stamp of the same place
    before, score) are matches. The robot's wheels are not told of: `robots/velocities.yaml` stands for them.
    """

    name = "measurement_lines"
    layout = Layout.WHEELS
    needs = f"one {_INPUT} of odom2 lines, and {_TRUTH}"

    def recognises(self, folder: Path) -> bool:
        """Whether a file of each name is there."""
        return any(folder.glob(_INPUT)) and any(folder.glob(_TRUTH))

    def open(self, folder: Path, options: OpenOptions) -> WheelRecording:
        """The recording in `folder`. Raises InputError naming file and line."""
        path = _only(folder, _INPUT)
        kinds = _read(path)
        speeds, warnings = _speeds(kinds["odom2"], path)
        truth, more = _read_truth(_only(folder, _TRUTH))
        return WheelRecording(
            name=folder.resolve().name,
            path=folder,
            format=self.name,
            calibration=choose_calibration(folder, options, lambda: shipped_robot("velocities")),
            wheels=tuple(speeds),
            ground_truth=truth,
            warnings=(*warnings, *more),
            matches=tuple(Match(m.values[0], m.stamp_s, score=m.values[1]) for m in kinds["loop"]),
            speed_variances=_variances(kinds["odom2"], path),
        )


def _only(folder: Path, pattern: str) -> Path:
    found = sorted(folder.glob(pattern))
    if len(found) > 1:
        raise RecordingError(f"holds {len(found)} files {pattern}", path=folder, fix="keep each recording in a folder")
    return found[0]


def _speeds(odometry: list[_Measurement], path: Path) -> tuple[list[WheelSpeeds], list[str]]:
    if not odometry:
        raise RecordingError("holds no line odom2", path=path, fix="odom2 stamp vx vy turn-rate and three variances")
    nominal = need_wheels(shipped_robot("velocities"))
    speeds = [speeds_of_wheels(nominal, m.stamp_s, m.values[0], m.values[2]) for m in odometry]
    growing, warnings = keep_growing(speeds, [m.line for m in odometry], path)
    across_m_s = max(abs(m.values[1]) for m in odometry)
    if across_m_s > 0:
        warnings.append(f"Speeds across, up to {across_m_s:.2g} m/s, are left out: wheels cannot tell of them.")
    return growing, warnings


def _variances(odometry: list[_Measurement], path: Path) -> SpeedVariances:
    """What the lines state of their own errors. Raises RecordingError for variances below 0."""
    for m in odometry:
        if min(m.values[3:]) < 0:
            raise RecordingError("a variance is negative", path=path, line=m.line, fix="three variances from 0 up")
    stated = sorted(odometry, key=lambda m: m.stamp_s)
    return SpeedVariances(np.array([m.stamp_s for m in stated]), np.array([m.values[3:] for m in stated]))


def _read_truth(path: Path) -> tuple[Trajectory | None, list[str]]:
    """T_frame_base where a point and an angle share their stamp."""
    kinds = _read(path)
    points, warnings = keep_growing(kinds["point2"], [m.line for m in kinds["point2"]], path)
    angles, more = keep_growing(kinds["angle"], [m.line for m in kinds["angle"]], path)
    warnings += more
    stamps_s, angle_stamps_s = (np.array([m.stamp_s for m in kind]) for kind in (points, angles))
    beside = np.searchsorted(angle_stamps_s, stamps_s - _SAME_STAMP_S).clip(max=max(len(angles) - 1, 0))
    if not len(angles) or not len(points):
        kind, missing = ("point2", "angle") if len(points) else ("angle", "point2")
        count = max(len(points), len(angles))
        warnings += [_without_partner(path, kind, missing, count, count)] if count else []
        return None, [*warnings, f"{path.name}: has no lines angle beside point2, so no true poses."]
    is_pose = np.abs(angle_stamps_s[beside] - stamps_s) < _SAME_STAMP_S
    if not is_pose.all():
        warnings.append(_without_partner(path, "point2", "angle", int(np.count_nonzero(~is_pose)), len(points)))
    lone = len(angles) - len(np.unique(beside[is_pose]))
    if lone:
        warnings.append(_without_partner(path, "angle", "point2", lone, len(angles)))
    x, y = _column(points, 0)[is_pose], _column(points, 1)[is_pose]
    yaw_rad = _column(angles, 0)[beside][is_pose]
    return Trajectory(stamps_s[is_pose], se3.from_plane(x, y, yaw_rad), body="base"), warnings


def _without_partner(path: Path, kind: str, missing: str, count: int, of: int) -> LeftOut:
    reason = f"lines {kind} have no {missing}"
    return LeftOut(
        f"{path.name}: {count} {reason} of their stamp and were left out.", count, of, f"{path.name}: {reason}"
    )


def _column(measurements: list[_Measurement], column: int) -> FloatArray:
    return np.array([m.values[column] for m in measurements])


def _read(path: Path) -> dict[str, list[_Measurement]]:
    """The measurements of each kind."""
    found: dict[str, list[_Measurement]] = {kind: [] for kind in _NUMBERS}
    for line in read_lines(path):
        kind, *words = line.text.split()
        if kind not in found:
            known = ", ".join(_NUMBERS)
            raise RecordingError(f"unknown measurement {kind!r}", path=path, line=line.number, fix=f"known: {known}")
        if len(words) != _NUMBERS[kind]:
            problem = f"{kind} has {len(words)} numbers, not {_NUMBERS[kind]}"
            raise RecordingError(problem, path=path, line=line.number)
        stamp_s, *values = _numbers(words, path, line.number)
        found[kind].append(_Measurement(stamp_s, line.number, tuple(values)))
    return found


def _numbers(words: list[str], path: Path, line: int) -> list[float]:
    try:
        values = [float(word) for word in words]
    except ValueError as error:
        raise RecordingError(str(error), path=path, line=line) from error
    if not np.isfinite(values).all():
        raise RecordingError("a value is not finite", path=path, line=line)
    return values
