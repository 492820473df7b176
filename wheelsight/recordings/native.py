"""wheelsight's own layout: the TUM benchmark's, which any TUM tool reads, plus wheels, a gyroscope, calibration.yaml.

A recording of wheels alone has no lists of images.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from wheelsight.calibration import Calibration
from wheelsight.errors import CalibrationError, RecordingError
from wheelsight.events import AngularVelocity, OdometryReading, WheelCounts, WheelTicks, YawRate
from wheelsight.files import StrPath
from wheelsight.inputs import is_there
from wheelsight.recordings._cameras import camera_choices, choose_calibration
from wheelsight.recordings._images import DepthEncoding
from wheelsight.recordings._wheel_recording import WheelRecording
from wheelsight.recordings.image_recording import ImageRecording, recording_of
from wheelsight.recordings.protocol import Layout, OpenOptions
from wheelsight.recordings.tables import column_names, read_columns
from wheelsight.recordings.text import keep_growing
from wheelsight.recordings.tum import DEPTH_FACTOR, beside, read_frames, read_truth

WHEELS_HEADER = "stamp_s,left,right"
_ODOMETRY = ("x_m", "y_m", "yaw_rad")
GYRO_HEADER = "stamp_s,yaw_rate_rad_s"
IMU_FILE = "imu.csv"
IMU_HEADER = "stamp_s,x_rad_s,y_rad_s,z_rad_s"


def wheels_header(calibration: Calibration | None) -> str:
    """The first line of wheels.csv: counts of each wheel, or the pose by a holonomic base's own odometry."""
    if calibration is None or calibration.holonomic is None:
        return WHEELS_HEADER
    return ",".join(("stamp_s", *(calibration.holonomic.wheel_names or _ODOMETRY)))


class NativeReader:
    """What `RecordingWriter` writes."""

    name = "wheelsight"
    layout = Layout.WHEELS
    needs = "wheels.csv and calibration.yaml; images as tum"

    def recognises(self, folder: Path) -> bool:
        """Whether wheels.csv is there."""
        return is_there(folder / "wheels.csv")

    def open(self, folder: Path, options: OpenOptions) -> ImageRecording | WheelRecording:
        """The recording in `folder`. Raises InputError naming file and line."""
        has_images = any(is_there(folder / name) for name in ("rgb.txt", "depth.txt"))
        calibration = choose_calibration(folder, options, lambda: _missing(folder, has_images))
        wheels, warnings = _read_readings(folder / "wheels.csv", calibration)
        yaw_rates, more = _read_yaw_rates(folder, calibration)
        warnings += more
        truth = None
        if not has_images or calibration.T_base_camera is not None:
            truth = read_truth(folder / "groundtruth_base.txt", warnings, body="base")
        if not has_images:
            given = (wheels, tuple(yaw_rates), truth, tuple(warnings))
            return WheelRecording(folder.resolve().name, folder, self.name, calibration, *given)
        images, more = read_frames(folder, options)
        warnings += more
        made = recording_of(
            folder,
            self.name,
            calibration,
            images,
            DepthEncoding(options.depth_factor or DEPTH_FACTOR),
            truth or beside(read_truth(folder / "groundtruth.txt", warnings), images.frames, options),
            warnings,
        )
        return replace(made, wheels=wheels, yaw_rates=tuple(yaw_rates))


def _missing(folder: Path, has_images: bool) -> Calibration:
    """Raises CalibrationError: nothing tells what sensors these are."""
    fix = camera_choices() if has_images else "say how large the wheels are with --calibration"
    raise CalibrationError("is missing", path=folder / "calibration.yaml", fix=fix)


def read_wheels(path: Path) -> tuple[list[WheelTicks], list[str]]:
    """The counts of two wheels in wheels.csv in order of time, and warnings. Raises RecordingError."""
    table, warnings = read_columns(path, counts=("left", "right"))
    ticks = list(map(WheelTicks, table.stamps_s, table["left"], table["right"]))
    growing, more = keep_growing(ticks, table.lines, path)
    return growing, warnings + more


def _read_readings(
    path: Path, calibration: Calibration
) -> tuple[tuple[WheelTicks, ...] | tuple[WheelCounts, ...] | tuple[OdometryReading, ...], list[str]]:
    """The readings of wheels.csv in order of time, and warnings. Raises RecordingError.

    Which columns it has goes by the calibration's wheels; the pose by a base's own odometry is read beside any
    holonomic wheels.
    """
    holonomic = calibration.holonomic
    names = () if holonomic is None else holonomic.wheel_names
    if _has_columns(path, _ODOMETRY) and not _has_columns(path, names or ("left", "right")):
        if calibration.wheels is not None:
            fix = "say `kind: holonomic` of wheels in calibration.yaml, or write stamp_s,left,right"
            raise RecordingError(f"has {', '.join(_ODOMETRY)}, which two wheels have not", path=path, fix=fix)
        table, warnings = read_columns(path, numbers=_ODOMETRY)
        poses = list(map(OdometryReading, table.stamps_s, *(table[name] for name in _ODOMETRY)))
        growing_poses, more = keep_growing(poses, table.lines, path)
        return tuple(growing_poses), warnings + more
    if names:
        table, warnings = read_columns(path, counts=names)
        rows = zip(*(table[name] for name in names), strict=True)
        counts = list(map(WheelCounts, table.stamps_s, rows))
        growing_counts, more = keep_growing(counts, table.lines, path)
        return tuple(growing_counts), warnings + more
    ticks, warnings = read_wheels(path)
    return tuple(ticks), warnings


def _has_columns(path: Path, names: Sequence[str]) -> bool:
    try:
        return bool(column_names(path, ("stamp_s", *names)))
    except RecordingError:
        return False


def _read_yaw_rates(folder: Path, calibration: Calibration) -> tuple[list[YawRate], list[str]]:
    """The readings of gyro.csv in order of time, or where it has none those of the camera's gyroscope; and warnings."""
    rates, warnings = _read_gyro(folder / "gyro.csv")
    if rates or not is_there(folder / IMU_FILE):
        return rates, warnings
    turns, more = read_angular_velocities(folder / IMU_FILE)
    mount = calibration.T_base_camera
    if mount is None:
        unused = f"{len(turns)} readings in {IMU_FILE} are not used: T_base_camera, how the camera sits, is not known."
        return [], [*warnings, *more, *([unused] if turns else [])]
    return [turn.yaw_rate(mount) for turn in turns], [*warnings, *more]


def read_angular_velocities(path: Path) -> tuple[list[AngularVelocity], list[str]]:
    """The readings of imu.csv in order of time, about the camera's axes, and warnings. Raises RecordingError."""
    names = IMU_HEADER.split(",")[1:]
    table, warnings = read_columns(path, numbers=names)
    turns = list(map(AngularVelocity, table.stamps_s, *(table[name] for name in names)))
    growing, more = keep_growing(turns, table.lines, path)
    return growing, warnings + more


def camera_turns(folder: StrPath) -> tuple[list[AngularVelocity], list[str]]:
    """What the gyroscope in a recording's camera told, and warnings; nothing where the recording keeps none."""
    path = Path(folder) / IMU_FILE
    return read_angular_velocities(path) if is_there(path) else ([], [])


def _read_gyro(path: Path) -> tuple[list[YawRate], list[str]]:
    """The readings of gyro.csv in order of time, and warnings; none where there is no such file."""
    if not is_there(path):
        return [], []
    table, warnings = read_columns(path, numbers=("yaw_rate_rad_s",))
    rates = list(map(YawRate, table.stamps_s, table["yaw_rate_rad_s"]))
    growing, more = keep_growing(rates, table.lines, path)
    return growing, warnings + more
