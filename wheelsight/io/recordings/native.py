"""`NativeReader` and `RecordingWriter` of wheelsight's own layout: the lists of the TUM benchmark, which any TUM tool
reads, with wheels.csv, gyro.csv, imu.csv, camera_clock.csv, loops.csv and calibration.yaml. A recording of wheels alone
has no lists of images. An interrupted recording is valid, and can be resumed.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Protocol

import numpy as np

from wheelsight.core.calibration import Calibration, load_calibration, save_calibration
from wheelsight.core.checks import check_event, check_images, need_calibration
from wheelsight.core.depth_errors import DepthError
from wheelsight.core.errors import ArgumentError, CalibrationError, OutputError, RecordingError
from wheelsight.core.files import StrPath, make_output_folder
from wheelsight.core.geometry import se3, so3
from wheelsight.core.geometry.arrays import UInt16Array
from wheelsight.core.inputs import is_there
from wheelsight.core.messages import (
    AngularVelocity,
    Event,
    Match,
    OdometryReading,
    RgbdFrame,
    SkippedFrame,
    VelocityCommand,
    WheelCounts,
    WheelReading,
    WheelSpeeds,
    WheelTicks,
    YawRate,
)
from wheelsight.core.stamps import StampCheck
from wheelsight.core.threads import Closing, OneCaller, one_at_a_time
from wheelsight.core.trajectory import Trajectory, tum_header, tum_lines, write_tum
from wheelsight.io.recordings.image_recording import ImageRecording, on_one_clock, recording_of
from wheelsight.io.recordings.images import SUFFIXES, ColorFormat, DepthEncoding, write_color, write_units
from wheelsight.io.recordings.recording import (
    HasMatches,
    Layout,
    OpenOptions,
    Recording,
    camera_choices,
    choose_calibration,
    express_for,
)
from wheelsight.io.recordings.tables import (
    LIST,
    GrowingText,
    Row,
    column_names,
    parse_stamp,
    read_items,
    read_table,
    seconds,
)
from wheelsight.io.recordings.tum_datasets import DEPTH_FACTOR, by_frame_clock, read_frames, read_truth
from wheelsight.io.recordings.wheel_recording import WheelRecording

WHEELS_HEADER = "stamp_s,left,right"
_ODOMETRY = ("x_m", "y_m", "yaw_rad")
GYRO_HEADER = "stamp_s,yaw_rate_rad_s"
COMMANDS_FILE = "commands.csv"
COMMANDS_HEADER = "stamp_s,forward_m_s,turn_rad_s"
IMU_FILE = "imu.csv"
IMU_HEADER = "stamp_s,x_rad_s,y_rad_s,z_rad_s"


def wheels_header(calibration: Calibration | None) -> str:
    """The first line of wheels.csv: a column for each wheel's count, or the pose by a holonomic base's own odometry."""
    if calibration is None or calibration.holonomic is None:
        return WHEELS_HEADER
    return ",".join(("stamp_s", *(calibration.holonomic.wheel_names or _ODOMETRY)))


class NativeReader:
    """What `RecordingWriter` writes."""

    name = "wheelsight"
    layout = Layout.WHEELS
    needs = "wheels.csv and calibration.yaml; images as tum"

    def recognises(self, folder: Path) -> bool:
        """Whether the folder has a wheels.csv."""
        return is_there(folder / "wheels.csv")

    def open(self, folder: Path, options: OpenOptions) -> ImageRecording | WheelRecording:
        """The recording in `folder`. Raises InputError naming file and line."""
        has_images = any(is_there(folder / name) for name in ("rgb.txt", "depth.txt"))

        def no_calibration() -> Calibration:
            fix = camera_choices() if has_images else "say how large the wheels are with --calibration"
            raise CalibrationError("is missing", path=folder / "calibration.yaml", fix=fix)

        calibration = choose_calibration(folder, options, no_calibration)
        wheels, warnings = _read_readings(folder / "wheels.csv", calibration)
        yaw_rates: list[YawRate] = []
        if is_there(folder / "gyro.csv"):
            yaw_rates, more = read_items(folder / "gyro.csv", YawRate, ("yaw_rate_rad_s",))
            warnings += more
        if not yaw_rates and is_there(folder / IMU_FILE):
            turns, more = read_angular_velocities(folder / IMU_FILE)
            warnings += more
            mount = calibration.T_base_camera
            yaw_rates = [] if mount is None else [turn.yaw_rate(mount) for turn in turns]
            if mount is None and turns:
                unused = f"{len(turns)} readings in {IMU_FILE} are not used"
                warnings.append(f"{unused}: T_base_camera, the camera's mount, is unknown.")
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
            truth or by_frame_clock(read_truth(folder / "groundtruth.txt", warnings), images.frames, options),
            warnings,
        )
        made = replace(made, wheels=wheels, yaw_rates=tuple(yaw_rates))
        return on_one_clock(made, is_gyro_beside_wheels=is_there(folder / "gyro.csv"))


def _read_readings(
    path: Path, calibration: Calibration
) -> tuple[tuple[WheelTicks, ...] | tuple[WheelCounts, ...] | tuple[OdometryReading, ...], list[str]]:
    """The readings of wheels.csv in order of time, and warnings. Raises RecordingError.

    The calibration's wheels determine the columns. For holonomic wheels the columns of a pose are accepted too.
    """
    holonomic = calibration.holonomic
    names = () if holonomic is None else holonomic.wheel_names
    if _has_columns(path, _ODOMETRY) and not _has_columns(path, names or ("left", "right")):
        if calibration.wheels is not None:
            fix = "say `kind: holonomic` of wheels in calibration.yaml, or write stamp_s,left,right"
            problem = f"has {', '.join(_ODOMETRY)}, but the calibration has two wheels"
            raise RecordingError(problem, path=path, fix=fix)
        poses, warnings = read_items(path, OdometryReading, _ODOMETRY)
        return tuple(poses), warnings
    if names:
        found, warnings = read_items(path, lambda stamp_s, *counts: WheelCounts(stamp_s, counts), counts=names)
        return tuple(found), warnings
    ticks, warnings = read_wheels(path)
    return tuple(ticks), warnings


def _has_columns(path: Path, names: Sequence[str]) -> bool:
    try:
        return bool(column_names(path, ("stamp_s", *names)))
    except RecordingError:
        return False


def read_wheels(path: Path) -> tuple[list[WheelTicks], list[str]]:
    """The counts of two wheels in wheels.csv in order of time, and warnings. Raises RecordingError."""
    return read_items(path, WheelTicks, counts=("left", "right"))


def read_angular_velocities(path: Path) -> tuple[list[AngularVelocity], list[str]]:
    """The readings of imu.csv in order of time, about the camera's axes, and warnings. Raises RecordingError."""
    return read_items(path, AngularVelocity, IMU_HEADER.split(",")[1:])


def camera_angular_velocities(folder: StrPath) -> tuple[list[AngularVelocity], list[str]]:
    """The readings of the camera's gyroscope in a recording, and warnings; empty where it has none."""
    path = Path(folder) / IMU_FILE
    return read_angular_velocities(path) if is_there(path) else ([], [])


_IMAGE_HEADERS = {
    "rgb.txt": "# color images\n# timestamp filename\n",
    "depth.txt": "# depth maps\n# timestamp filename\n",
}
_GYRO_HEADERS = {"gyro.csv": f"{GYRO_HEADER}\n"}
TRUTH_FILES = {"camera": "groundtruth.txt", "base": "groundtruth_base.txt"}
_LABELS = "labels.csv"
_LABELS_HEADER = "stamp_s,area\n"
_DEEPEST_UNITS = np.iinfo(np.uint16).max
_INFRARED = "infrared.txt"
_INFRARED_HEADER = "# infrared images\n# timestamp filename\n"
# The kinds of events in each list. Stamps of each kind must increase.
_KINDS = {
    "rgb.txt": ("RgbdFrame",),
    "wheels.csv": ("WheelTicks", "WheelCounts", "OdometryReading"),
    "gyro.csv": ("YawRate",),
}


@dataclass(frozen=True, slots=True)
class WrittenFrame:
    """A frame whose images are written, but not listed yet.

    Attributes:
        lines: the line for each list, by the list's name.
        too_far: the number of depth pixels beyond 13.107 m.
    """

    lines: dict[str, str]
    size_bytes: int
    too_far: int


class LiveWriter(Protocol):
    """A writer for events of live sensors. Several threads write frames; one thread lists them in order."""

    @property
    def last_stamp_s(self) -> float:
        """The newest of all sensors; -∞ before the first."""

    @property
    def frames(self) -> int:
        """The number of frames so far."""

    @property
    def readings(self) -> int:
        """The number of wheel readings so far."""

    def check(self, event: Event) -> None:
        """Raise ArgumentError or RecordingError where the event cannot be stored without loss."""

    def add(self, event: Event) -> None:
        """Write one event. Raises as `check`, and OutputError."""

    def add_angular_velocity(self, turn: AngularVelocity) -> None:
        """Write a reading of the camera's gyroscope. Raises as `add`."""

    def write_frame(self, frame: RgbdFrame, infrared: UInt16Array | None = None) -> Any:
        """Encode a checked frame. Returns a value with `size_bytes`, for `list_frame`. Raises OutputError."""

    def list_frame(self, written: Any, clock: FrameClock | None = None) -> None:
        """Add a written frame to the lists. Raises OutputError."""

    def close(self) -> None:
        """Close all files. Raises OutputError."""


class RecordingWriter(Closing, OneCaller):
    """Writes events into a folder as they come. Use it in a `with` block; `open_recording` reads the folder.

    PNG stores colour without loss. Depth has a resolution of 0.2 mm: 16 bits with 5000 units per metre, as in the TUM
    benchmark, so that any TUM tool reads it. Depth beyond 13.107 m is written as invalid and counted in
    `depths_too_far`. Images are written atomically, and before the list that names them. An interrupted recording, even
    by a power cut, is therefore valid and only shorter.

    Without cameras in `calibration`, or without a calibration, it is a recording of the wheels alone.

    Several threads may call `write_frame` at once, which takes nearly all the time of a frame; one thread calls
    `list_frame`.

    Args:
        folder: created if necessary.
        calibration: of the robot; None where it is not calibrated yet.
        force: whether to overwrite a recording in the folder.
        color: "png" for lossless colour; "jpeg" with quality 95, in a tenth of the time and a fifth of the space.
        resume: whether to append to the folder's recording, or start one where the folder is empty.

    Attributes:
        frames: the number of frames so far.
        readings: the number of wheel readings so far.
        depths_too_far: the number of depth pixels beyond 13.107 m in all frames that were added.

    Raises:
        OutputError: the folder is not empty and neither `force` nor `resume` is set, the folder cannot be written, the
            disk is full, or the recording to resume has other sensors.
    """

    def __init__(
        self,
        folder: StrPath,
        calibration: Calibration | None,
        force: bool = False,
        *,
        color: ColorFormat = "png",
        resume: bool = False,
    ) -> None:
        calibration = None if calibration is None else need_calibration(calibration)
        if resume:
            check_resumable(Path(folder), calibration)
        self.folder = make_output_folder(Path(folder), force or resume)
        self.frames = self.readings = self.depths_too_far = 0
        self._calibration, self._color, self._resumes = calibration, color, resume
        self._last_stamp_s: dict[str, float] = {}
        self._stamps = StampCheck()
        has_cameras = calibration is not None and calibration.color is not None
        if resume:
            remove_leftovers(self.folder)
        else:
            # Remove files of an earlier recording that this one may not overwrite.
            for name in (
                *TRUTH_FILES.values(),
                _LABELS,
                _INFRARED,
                CLOCK_FILE,
                IMU_FILE,
                COMMANDS_FILE,
                "calibration.yaml",
            ):
                (self.folder / name).unlink(missing_ok=True)
        for name in ("rgb", "depth") if has_cameras else ():
            make_output_folder(self.folder / name, force=True)
        if calibration is not None:
            # Depth is written after its correction, so the correction must not be applied again.
            save_calibration(replace(calibration, depth_error=DepthError()), self.folder / "calibration.yaml")
        of_wheels = {"wheels.csv": f"{wheels_header(calibration)}\n"}
        headers = (_IMAGE_HEADERS if has_cameras else {}) | of_wheels | _GYRO_HEADERS
        self._lists = {name: GrowingText(self.folder / name, header, resume) for name, header in headers.items()}
        for name, kinds in _KINDS.items():
            if name in self._lists and (earlier := self._lists[name].earlier):
                self._last_stamp_s |= dict.fromkeys(kinds, last_stamp_s(earlier))
        self.readings = len(self._lists["wheels.csv"].earlier)
        self.frames = len(self._lists["depth.txt"].earlier) if "depth.txt" in self._lists else 0

    @property
    def last_stamp_s(self) -> float:
        """The newest of all sensors; -∞ before the first."""
        return max(self._last_stamp_s.values(), default=-np.inf)

    @one_at_a_time
    def add(self, event: Event) -> None:
        """Write one event. Skipped frames are ignored.

        Raises:
            ArgumentError: the argument is not an event, its stamp is not in seconds, or its numbers or images cannot be
                stored: another size or type than the calibration's, or depth that is not in metres.
            RecordingError: the stamp does not increase.
            OutputError: the disk is full, or the folder was removed.
        """
        if isinstance(event, SkippedFrame):
            check_event(event)
            return
        self.check(event)
        if isinstance(event, RgbdFrame):
            self.list_frame(self.write_frame(event))
        elif isinstance(event, WheelReading):
            self._lists["wheels.csv"].append(f"{seconds(event.stamp_s)},{','.join(_columns_of(event))}\n")
            self.readings += 1
        elif isinstance(event, YawRate):
            self._lists["gyro.csv"].append(f"{seconds(event.stamp_s)},{seconds(event.yaw_rate_rad_s)}\n")

    def add_angular_velocity(self, turn: AngularVelocity) -> None:
        """Write a reading of the camera's gyroscope to imu.csv. The camera's mount may be unknown.

        Raises:
            ArgumentError: a number is not finite.
            RecordingError: the stamp does not increase.
            OutputError: as `add`.
        """
        numbers = (turn.stamp_s, turn.x_rad_s, turn.y_rad_s, turn.z_rad_s)
        if not np.isfinite(numbers).all():
            raise ArgumentError(f"{turn} has a number that is not finite", fix="leave it out")
        lines = self._list(IMU_FILE, f"{IMU_HEADER}\n")
        if lines.earlier and IMU_FILE not in self._last_stamp_s:
            self._last_stamp_s[IMU_FILE] = last_stamp_s(lines.earlier)
        self._check_stamps(IMU_FILE, turn.stamp_s, turn.stamp_s)
        lines.append(",".join(map(seconds, numbers)) + "\n")

    @one_at_a_time
    def add_command(self, stamp_s: float, command: VelocityCommand) -> None:
        """Write a command to the robot, which holds until the next one, to commands.csv.

        Raises:
            RecordingError: the stamp does not increase.
            OutputError: as `add`.
        """
        self._check_stamps(COMMANDS_FILE, stamp_s, stamp_s)
        numbers = (stamp_s, command.forward_m_s, command.turn_rad_s)
        self._list(COMMANDS_FILE, f"{COMMANDS_HEADER}\n").append(",".join(map(seconds, numbers)) + "\n")

    def check(self, event: Event) -> None:
        """Check an event as `add` does. Later stamps of its kind must be greater than this one.

        Raises ArgumentError, RecordingError as `add`.
        """
        check_event(event, finite=True)
        if isinstance(event, WheelSpeeds):
            raise RecordingError("wheel speeds have no place here: wheels.csv holds ticks", path=self.folder)
        if isinstance(event, WheelReading):
            of = None if self._calibration is None else self._calibration.holonomic
            header = wheels_header(self._calibration)
            kind = WheelTicks if of is None else WheelCounts if of.wheel_names else OdometryReading
            given = len(_columns_of(event))
            if type(event) is not kind or given != header.count(","):
                problem = f"a {type(event).__name__} of {given} numbers has no place here"
                fix = f"wheels.csv has {header}, by the calibration's wheels"
                raise RecordingError(problem, path=self.folder, fix=fix)
        if isinstance(event, RgbdFrame):
            check_images(event, self._known_calibration())
        self._stamps.check(event)
        self._check_stamps(type(event).__name__, event.stamp_s, event.stamp_s)

    def write_frame(self, frame: RgbdFrame, infrared: UInt16Array | None = None) -> WrittenFrame:
        """Write the images of a checked frame, with (H, W) infrared where given. `list_frame` adds them to the lists.

        Raises OutputError.
        """
        color, depth = seconds(frame.stamp_s), seconds(frame.stamp_s + frame.depth_late_s)
        names = {"rgb.txt": f"rgb/{color}{SUFFIXES[self._color]}", "depth.txt": f"depth/{depth}.png"}
        lines = {"rgb.txt": f"{color} {names['rgb.txt']}\n", "depth.txt": f"{depth} {names['depth.txt']}\n"}
        units = np.rint(np.asarray(frame.depth_m, np.float64) * DEPTH_FACTOR)
        is_too_far = units > _DEEPEST_UNITS
        size = write_color(self.folder / names["rgb.txt"], frame.color, self._color)
        size += write_units(self.folder / names["depth.txt"], np.where(is_too_far, 0, units).astype(np.uint16))
        if infrared is not None:
            make_output_folder(self.folder / "infrared", force=True)
            size += write_units(self.folder / f"infrared/{depth}.png", infrared)
            lines[_INFRARED] = f"{depth} infrared/{depth}.png\n"
        return WrittenFrame(lines, size, int(np.count_nonzero(is_too_far)))

    def list_frame(self, written: WrittenFrame, clock: FrameClock | None = None) -> None:
        """Add a written frame to the lists, and its clock to camera_clock.csv. Call it in order of stamps.

        Raises OutputError.
        """
        if clock is not None:
            self._list(CLOCK_FILE, f"{CLOCK_HEADER}\n").append(clock.line)
        if _INFRARED in written.lines:
            self._list(_INFRARED, _INFRARED_HEADER)
        for name, line in written.lines.items():
            self._lists[name].append(line)
        self.frames += 1
        self.depths_too_far += written.too_far

    def _list(self, name: str, header: str) -> GrowingText:
        """A list or table that is created at first use."""
        if name not in self._lists:
            self._lists[name] = GrowingText(self.folder / name, header, self._resumes)
        return self._lists[name]

    @one_at_a_time
    def add_ground_truth(self, truth: Trajectory) -> None:
        """Write the true trajectory of the camera or the base; of both where T_base_camera is known.

        Raises:
            CalibrationError: the trajectory describes the base, and the calibration has no T_base_camera.
            OutputError: it cannot be written.
        """
        calibration = self._known_calibration()
        bodies: tuple[str, ...] = ("camera",) if calibration.T_base_camera is None else ("camera", "base")
        if calibration.color is None:
            bodies = ("base",)
        for body in bodies:
            write_tum(express_for(body, truth, calibration), self.folder / TRUTH_FILES[body])

    def append_ground_truth(self, truth: Trajectory) -> None:
        """Append true poses of the camera or the base to the file of that body.

        Unlike `add_ground_truth` it does not use T_base_camera; call it for each body.

        Raises:
            RecordingError: the body is neither, or the stamps do not increase.
            OutputError: as `add`.
        """
        name = TRUTH_FILES.get(truth.body)
        if name is None:
            raise RecordingError(f"the truth of {truth.body!r} has no place here", path=self.folder)
        if not len(truth):
            return
        self._check_stamps(name, float(truth.stamps_s[0]), float(truth.stamps_s[-1]))
        self._list(name, tum_header(truth)).append("".join(tum_lines(truth)))

    @one_at_a_time
    def add_label(self, stamp_s: float, area: str | None) -> None:
        """Write the robot's area at a frame's time to labels.csv; None for no area.

        Raises:
            RecordingError: the stamp does not increase, or the name has a character that the table cannot hold.
            OutputError: as `add`.
        """
        name = area or ""
        if any(sign in name for sign in ',"\r\n#'):
            raise RecordingError(f"an area cannot be called {name!r}", path=self.folder / _LABELS)
        self._check_stamps(_LABELS, stamp_s, stamp_s)
        self._list(_LABELS, _LABELS_HEADER).append(f"{seconds(stamp_s)},{name}\n")

    def close(self) -> None:
        """Close all files. Without it, only data in the system's buffers is lost."""
        for stream in self._lists.values():
            stream.close()

    def _known_calibration(self) -> Calibration:
        if self._calibration is None:
            raise CalibrationError("is missing", path=self.folder / "calibration.yaml", fix="record with a calibration")
        return self._calibration

    def _check_stamps(self, what: str, first_s: float, last_s: float) -> None:
        """Raise RecordingError where stamps are not greater than earlier ones of their kind, or not finite."""
        before_s = self._last_stamp_s.get(what, -np.inf)
        if not before_s < first_s <= last_s < np.inf:
            raise RecordingError(f"stamp {first_s:.6f} does not come after {before_s:.6f}", path=self.folder)
        self._last_stamp_s[what] = last_s


def write_recording(folder: StrPath, recording: Recording, force: bool = False) -> RecordingWriter:
    """Write any recording in wheelsight's own layout. Returns the closed writer, with its counts.

    Raises OutputError, RecordingError as `RecordingWriter`.
    """
    folder = Path(folder)
    with RecordingWriter(folder, recording.calibration, force) as writer:
        if recording.ground_truth is not None:
            writer.add_ground_truth(recording.ground_truth)
        for event in recording.events():
            writer.add(event)
    return writer


def _columns_of(reading: WheelReading) -> list[str]:
    """The columns of a reading in wheels.csv, without its stamp."""
    if isinstance(reading, WheelTicks):
        return [str(int(reading.left)), str(int(reading.right))]
    if isinstance(reading, WheelCounts):
        return [str(int(count)) for count in reading.counts]
    if isinstance(reading, OdometryReading):
        return [seconds(number) for number in (reading.x_m, reading.y_m, reading.yaw_rad)]
    return [seconds(number) for number in (reading.left_rad_s, reading.right_rad_s)]


# Resuming an interrupted recording

_IMAGE_FOLDERS = "rgb", "depth", "infrared"
_LEFT_OVER = re.compile(r"\..+\.[0-9a-f]{8}")  # temporary files of `files.atomic_write`


def resumed_calibration(folder: Path) -> Calibration | None:
    """The calibration of a recording to resume; None where it has none, or does not exist. Raises CalibrationError."""
    path = folder / "calibration.yaml"
    return load_calibration(path) if is_there(path) else None


def check_resumable(folder: Path, calibration: Calibration | None) -> None:
    """Raise OutputError where a folder has other contents than a recording of the same sensors."""
    if not folder.is_dir() or not any(folder.iterdir()):
        return
    another = "record into another --out"
    if not is_there(folder / "wheels.csv"):
        raise OutputError("holds no recording to resume", path=folder, fix=another)
    try:
        before = resumed_calibration(folder)
    except CalibrationError as error:
        raise OutputError(f"cannot be resumed: {error.problem}", path=error.path or folder, fix=another) from error
    if _sizes(before) != _sizes(calibration):
        problem = f"holds a recording of {_sensors(before)}, which {_sensors(calibration)} cannot resume"
        raise OutputError(problem, path=folder, fix=another)
    headers = [wheels_header(of) for of in (before, calibration)]
    if headers[0] != headers[1]:
        problem = f"its wheels.csv has {headers[0]}, which {headers[1]} cannot resume"
        raise OutputError(problem, path=folder, fix=another)


def remove_leftovers(folder: Path) -> None:
    """Remove files that were written only in part when the recording was interrupted."""
    for place in (folder, *(folder / name for name in _IMAGE_FOLDERS)):
        for path in place.glob(".*") if place.is_dir() else ():
            if _LEFT_OVER.fullmatch(path.name) and path.is_file():
                with suppress(OSError):
                    path.unlink()


def last_stamp_s(lines: Sequence[str]) -> float:
    """The stamp of the last line of a list or table. Raises OutputError where it has none."""
    word = re.split(r"[\s,]", lines[-1], maxsplit=1)[0]
    try:
        return float(word)
    except ValueError as error:
        raise OutputError(f"a last line of {lines[-1]!r} has no stamp", fix="remove the line, then --resume") from error


def _sizes(calibration: Calibration | None) -> tuple[tuple[int, int], ...]:
    """Width and height of the images of both cameras; empty without cameras."""
    if calibration is None or calibration.color is None:
        return ()
    return tuple((camera.width, camera.height) for camera in calibration.cameras)


def _sensors(calibration: Calibration | None) -> str:
    sizes = _sizes(calibration)
    return f"a camera of {' and '.join(f'{w}×{h}' for w, h in dict.fromkeys(sizes))}" if sizes else "wheels alone"


# camera_clock.csv: the stamps of a live camera's frames

CLOCK_FILE = "camera_clock.csv"
CLOCK_HEADER = "stamp_s,stamp_sigma_s,arrived_s,device_s,sequence"


@dataclass(frozen=True, slots=True)
class FrameClock:
    """The times of one frame. All but `device_s` are of the host's clock.

    Attributes:
        stamp_s: of the frame, mapped from the camera's clock.
        stamp_sigma_s: standard deviation of that mapping.
        arrived_s: when the host received the frame.
        device_s: the stamp by the camera's clock; None where it gives none.
        sequence: the frame number that the camera gives; None where it gives none.
    """

    stamp_s: float
    stamp_sigma_s: float
    arrived_s: float
    device_s: float | None = None
    sequence: int | None = None

    @property
    def line(self) -> str:
        """The line in camera_clock.csv; unknown values are empty."""
        device = "" if self.device_s is None else seconds(self.device_s)
        numbers = (seconds(value) for value in (self.stamp_s, self.stamp_sigma_s, self.arrived_s))
        return ",".join([*numbers, device, "" if self.sequence is None else str(self.sequence)]) + "\n"


def read_frame_clocks(folder: Path) -> tuple[FrameClock, ...]:
    """The clock of each frame of a recording in wheelsight's own layout; empty where it has no such file.

    Raises RecordingError.
    """
    path = folder / CLOCK_FILE
    if not is_there(path):
        return ()
    rows, _ = read_table(path, CLOCK_HEADER.split(","))
    clocks = []
    for row in rows:
        known = {name: bool(row.words[row.columns[name]]) for name in ("device_s", "sequence")}
        device_s = row["device_s"] if known["device_s"] else None
        sequence = row.whole("sequence") if known["sequence"] else None
        clocks.append(FrameClock(row.stamp_s, row["stamp_sigma_s"], row["arrived_s"], device_s, sequence))
    return tuple(clocks)


# loops.csv: matches of places from an external place recognition

MATCHES_FILE = "loops.csv"
_STAMPS = ("stamp_a_s", "stamp_b_s")
_POSE = ("x_m", "y_m", "z_m", "qx", "qy", "qz", "qw")
_SIGMAS = ("sigma_m", "sigma_rad")
_SCORE = "score"
_UNIT_TOLERANCE = 0.01
# One match per second over a day. Checking one takes 25 µs.
_FILE = replace(LIST, name="a list of matches", most_mb=32, most_lines=100_000)


def read_matches(path: StrPath) -> tuple[list[Match], list[str]]:
    """The matches of a table, one per line, and warnings.

    The first line names the columns, in any order. Required are stamp_a_s and stamp_b_s. Optional are the pose T_a_b
    of the body as x_m, y_m, z_m, qx, qy, qz, qw, its standard deviations sigma_m and sigma_rad, and score, 0 to 1.

    Raises RecordingError where a column is missing, or a number, pose or score is invalid; names file and line.
    """
    path = Path(path)
    has = set(column_names(path, _STAMPS, _FILE))
    given = [name for group in (_POSE, _SIGMAS) for name in group if set(group) & has]
    if set(_SIGMAS) & has and not set(_POSE) & has:
        raise RecordingError("has sigmas and no poses", path=path, line=1, fix=f"columns {', '.join(_POSE)}")
    columns = (*_STAMPS, *given, *((_SCORE,) if _SCORE in has else ()))
    rows, warnings = read_table(path, columns, _FILE)
    return [_match(row, has) for row in rows], warnings


def _match(row: Row, has: set[str]) -> Match:
    """The match of a line, given the table's columns. Raises RecordingError."""
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
    if _SIGMAS[0] not in has:
        return Match(a_s, b_s, T_a_b, None, score)
    sigmas = [row[name] for name in _SIGMAS]
    if min(sigmas) <= 0:
        raise RecordingError("a sigma is not positive", path=row.path, line=row.number, fix="standard deviations")
    return Match(a_s, b_s, T_a_b, np.diag(np.square(np.repeat(sigmas, 3))), score)


def matches_of(recording: Recording) -> tuple[list[Match], list[str]]:
    """The matches of a recording and of the loops.csv in its folder, and warnings. Raises RecordingError."""
    own = list(recording.matches) if isinstance(recording, HasMatches) else []
    path = recording.path / MATCHES_FILE
    if not is_there(path):
        return own, []
    others, warnings = read_matches(path)
    return own + others, warnings
