"""`WheelRecording`: a recording of wheels without images, and its formats: odometry.csv, encoders of a skid-steered
robot, and the measurement lines of TU Chemnitz.
"""

from __future__ import annotations

import heapq
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import accumulate
from pathlib import Path

import numpy as np

from wheelsight.core.calibration import Calibration, load_calibration
from wheelsight.core.calibration_parts import Wheels
from wheelsight.core.errors import CalibrationError, RecordingError
from wheelsight.core.geometry import FloatArray, se3
from wheelsight.core.inputs import is_there
from wheelsight.core.messages import Event, Match, SpeedVariances, WheelReading, WheelSpeeds, WheelTicks, YawRate
from wheelsight.core.trajectory import Trajectory
from wheelsight.io.recordings.recording import AssociationReport, Layout, LeftOut, OpenOptions, choose_calibration
from wheelsight.io.recordings.tables import keep_growing, read_columns, read_items, read_lines, read_table
from wheelsight.io.recordings.tum_datasets import read_truth

_FOLDER = Path(__file__).parent / "robots"


@dataclass(frozen=True, eq=False)
class WheelRecording:
    """A `Recording` of wheel readings.

    Attributes in addition to the protocol's:
        wheels: readings of the wheels in order of time, all of one type.
        yaw_rates: readings of a gyroscope in order of time.
        matches: of places, from an external source.
        speed_variances: the variances of the odometry's speeds that the recording states, or None.
    """

    name: str
    path: Path
    format: str
    calibration: Calibration
    wheels: tuple[WheelReading, ...]
    yaw_rates: tuple[YawRate, ...] = ()
    ground_truth: Trajectory | None = None
    warnings: tuple[str, ...] = ()
    matches: tuple[Match, ...] = ()
    speed_variances: SpeedVariances | None = None

    @property
    def body(self) -> str:
        """The frame the ground truth describes."""
        return "base"

    @property
    def frame_count(self) -> int:
        """0: there are no images."""
        return 0

    @property
    def wheel_count(self) -> int:
        """The number of wheel readings that `events()` yields."""
        return len(self.wheels)

    @property
    def association(self) -> AssociationReport:
        """Zero pairs: there are no images."""
        return AssociationReport(0, 0, 0, 0.0)

    def events(self, *, images: bool = True) -> Iterator[Event]:
        """Readings of gyroscope and wheels in order of time, from the start at each call; there are no `images`."""
        sources: Sequence[Sequence[Event]] = (self.yaw_rates, self.wheels)
        yield from heapq.merge(*sources, key=lambda event: event.stamp_s)


def shipped_robot(name: str) -> Calibration:
    """The nominal wheels that come with the package, for a format without wheel parameters."""
    return load_calibration(_FOLDER / f"{name}.yaml")


def speeds_of_wheels(wheels: Wheels, stamp_s: float, forward_m_s: float, yaw_rate_rad_s: float) -> WheelSpeeds:
    """The wheel speeds of a differential drive with the given forward speed and yaw rate."""
    across_m_s = yaw_rate_rad_s * wheels.track_width_m / 2
    left, right = forward_m_s - across_m_s, forward_m_s + across_m_s
    return WheelSpeeds(stamp_s, left / wheels.left_radius_m, right / wheels.right_radius_m)


def need_wheels(calibration: Calibration) -> Wheels:
    """The calibration's wheels. Raises CalibrationError where there are none."""
    if calibration.wheels is None:
        problem = f"the calibration ({calibration.source}) {calibration.lacks_two_wheels}"
        raise CalibrationError(problem, fix="give a calibration.yaml with wheels by --calibration")
    return calibration.wheels


class VelocityReader:
    """Reads forward speed and yaw rate of a robot's odometry, and poses of a motion-capture system.

    odometry.csv has stamp_s, v_mps, w_radps; a row holds until the next one. ground_truth.csv has stamp_s, x_m, y_m,
    yaw_rad and valid, which is 0 for an invalid pose. The wheels are those of `robots/velocities.yaml`.
    """

    name = "velocities"
    layout = Layout.WHEELS
    needs = "odometry.csv and ground_truth.csv"

    def recognises(self, folder: Path) -> bool:
        """Whether both are there."""
        return all(is_there(folder / name) for name in ("odometry.csv", "ground_truth.csv"))

    def open(self, folder: Path, options: OpenOptions) -> WheelRecording:
        """The recording in `folder`. Raises InputError naming file and line."""
        path = folder / "odometry.csv"
        nominal = need_wheels(shipped_robot("velocities"))
        speeds, warnings = read_items(path, partial(speeds_of_wheels, nominal), ("v_mps", "w_radps"))
        path = folder / "ground_truth.csv"
        poses, more = read_table(path, ("stamp_s", "x_m", "y_m", "yaw_rad", "valid"))
        warnings += more
        poses = [row for row in poses if row["valid"] != 0]
        poses, more = keep_growing(poses, [row.number for row in poses], path)
        warnings += more
        truth = None
        if poses:
            x, y, yaw = np.array([[row[name] for name in ("x_m", "y_m", "yaw_rad")] for row in poses]).T
            stamps_s = np.array([row.stamp_s for row in poses])
            truth = Trajectory(stamps_s, se3.from_plane(x, y, yaw), body="base")
        else:
            warnings.append(f"{path.name}: no true pose is marked valid.")
        return WheelRecording(
            name=folder.resolve().name,
            path=folder,
            format=self.name,
            calibration=choose_calibration(folder, options, lambda: shipped_robot("velocities")),
            wheels=tuple(speeds),
            ground_truth=truth,
            warnings=tuple(warnings),
        )


_SIDES = (("front_left", "rear_left"), ("front_right", "rear_right"))


class SkidSteerReader:
    """Reads increments of four encoders of a skid-steered robot, and the yaw rate of an IMU.

    encoders.csv has stamp_s, front_right, front_left, rear_right, rear_left, in any order; a row holds the ticks since
    the one before. imu.csv has stamp_s and wz_radps. reference.txt, which may be missing, is the base's trajectory by
    another system, in TUM text. A side's ticks are the sum of its two encoders, so `ticks_per_turn` of a
    calibration.yaml is twice that of one encoder.
    """

    name = "skid_steer"
    layout = Layout.WHEELS
    needs = "encoders.csv and imu.csv"

    def recognises(self, folder: Path) -> bool:
        """Whether both are there."""
        return all(is_there(folder / name) for name in ("encoders.csv", "imu.csv"))

    def open(self, folder: Path, options: OpenOptions) -> WheelRecording:
        """The recording in `folder`. Raises InputError naming file and line."""
        calibration = choose_calibration(folder, options, lambda: shipped_robot("skid_steer"))
        path = folder / "encoders.csv"
        table, warnings = read_columns(path, counts=(*_SIDES[0], *_SIDES[1]))
        # Sums over all rows: one that is left out because of its stamp still contributes its ticks.
        left, right = (accumulate(map(sum, zip(*(table[name] for name in side), strict=True))) for side in _SIDES)
        ticks, more = keep_growing(list(map(WheelTicks, table.stamps_s, left, right)), table.lines, path)
        warnings += more
        path = folder / "imu.csv"
        rates, more = read_items(path, YawRate, ("wz_radps",))
        warnings += more
        reference = read_truth(folder / "reference.txt", warnings, body="base")
        if reference is not None:
            warnings.append("The reference trajectory is another system's estimate: errors against it hold its own.")
        return WheelRecording(
            name=folder.resolve().name,
            path=folder,
            format=self.name,
            calibration=calibration,
            wheels=tuple(ticks),
            yaw_rates=tuple(rates),
            ground_truth=reference,
            warnings=tuple(warnings),
        )


_INPUT, _TRUTH = "*_Input.txt", "*_GT.txt"
_NUMBERS = {"odom2": 7, "loop": 3, "point2": 7, "angle": 3}
_SAME_STAMP_S = 1e-6


@dataclass(frozen=True, slots=True)
class _Measurement:
    stamp_s: float
    line: int
    values: tuple[float, ...]


class MeasurementLineReader:
    """Reads text with one measurement per line, its kind first, as TU Chemnitz's SLAM datasets have it.

    *_Input.txt has lines odom2 (stamp, vx, vy, turn rate, three variances), whose speeds hold until the next line, and
    loop (stamp, stamp of the same place before, score), which are matches. *_GT.txt has the true pose as lines point2
    and angle. vy is ignored. The wheels are those of `robots/velocities.yaml`. See Neubert, Schubert & Protzel, RA-L
    2019.
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
        odometry = kinds["odom2"]
        if not odometry:
            fix = "odom2 stamp vx vy turn-rate and three variances"
            raise RecordingError("holds no line odom2", path=path, fix=fix)
        nominal = need_wheels(shipped_robot("velocities"))
        speeds = [speeds_of_wheels(nominal, m.stamp_s, m.values[0], m.values[2]) for m in odometry]
        growing, warnings = keep_growing(speeds, [m.line for m in odometry], path)
        across_m_s = max(abs(m.values[1]) for m in odometry)
        if across_m_s > 0:
            warnings.append(f"Speeds across, up to {across_m_s:.2g} m/s, are left out: two wheels cannot measure them.")
        for m in odometry:
            if min(m.values[3:]) < 0:
                raise RecordingError("a variance is negative", path=path, line=m.line, fix="three variances from 0 up")
        stated = sorted(odometry, key=lambda m: m.stamp_s)
        variances = SpeedVariances(np.array([m.stamp_s for m in stated]), np.array([m.values[3:] for m in stated]))
        truth, more = _true_poses(_only(folder, _TRUTH))
        return WheelRecording(
            name=folder.resolve().name,
            path=folder,
            format=self.name,
            calibration=choose_calibration(folder, options, lambda: shipped_robot("velocities")),
            wheels=tuple(growing),
            ground_truth=truth,
            warnings=(*warnings, *more),
            matches=tuple(Match(m.values[0], m.stamp_s, score=m.values[1]) for m in kinds["loop"]),
            speed_variances=variances,
        )


def _only(folder: Path, pattern: str) -> Path:
    found = sorted(folder.glob(pattern))
    if len(found) > 1:
        raise RecordingError(f"holds {len(found)} files {pattern}", path=folder, fix="keep each recording in a folder")
    return found[0]


def _read(path: Path) -> dict[str, list[_Measurement]]:
    """The measurements of each kind in a file. Raises RecordingError."""
    found: dict[str, list[_Measurement]] = {kind: [] for kind in _NUMBERS}
    for line in read_lines(path):
        kind, *words = line.text.split()
        if kind not in found:
            known = ", ".join(_NUMBERS)
            raise RecordingError(f"unknown measurement {kind!r}", path=path, line=line.number, fix=f"known: {known}")
        if len(words) != _NUMBERS[kind]:
            problem = f"{kind} has {len(words)} numbers, not {_NUMBERS[kind]}"
            raise RecordingError(problem, path=path, line=line.number)
        try:
            stamp_s, *values = map(float, words)
        except ValueError as error:
            raise RecordingError(str(error), path=path, line=line.number) from error
        if not np.isfinite([stamp_s, *values]).all():
            raise RecordingError("a value is not finite", path=path, line=line.number)
        found[kind].append(_Measurement(stamp_s, line.number, tuple(values)))
    return found


def _true_poses(path: Path) -> tuple[Trajectory | None, list[str]]:
    """T_frame_base at the stamps that have a point and an angle, None without any; and warnings."""
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
    warning = f"{path.name}: {count} {reason} of their stamp and were left out."
    return LeftOut(warning, count, of, f"{path.name}: {reason}")


def _column(measurements: list[_Measurement], column: int) -> FloatArray:
    return np.array([m.values[column] for m in measurements])
