"""Writing recordings in wheelsight's own layout, so that a broken-off recording is only a shorter one."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from types import TracebackType
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from wheelsight.calibration import Calibration, save_calibration
from wheelsight.checks import check_event, check_images, need_calibration
from wheelsight.depth_error import DepthError
from wheelsight.errors import ArgumentError, CalibrationError, RecordingError
from wheelsight.events import (
    AngularVelocity,
    Event,
    OdometryReading,
    RgbdFrame,
    SkippedFrame,
    WheelCounts,
    WheelReading,
    WheelSpeeds,
    WheelTicks,
    YawRate,
)
from wheelsight.files import StrPath, make_output_folder
from wheelsight.geometry import Float32Array
from wheelsight.geometry.arrays import UInt16Array
from wheelsight.recordings.bodies import express_for
from wheelsight.recordings.frame_clocks import CLOCK_FILE, CLOCK_HEADER, FrameClock
from wheelsight.recordings.growing_text import GrowingText, seconds
from wheelsight.recordings.image_files import SUFFIXES, ColorFormat, write_color, write_units
from wheelsight.recordings.native import GYRO_HEADER, IMU_FILE, IMU_HEADER, wheels_header
from wheelsight.recordings.protocol import Recording
from wheelsight.recordings.resuming import check_resumable, last_stamp_s, remove_leftovers
from wheelsight.recordings.tum import DEPTH_FACTOR
from wheelsight.stamps import StampCheck
from wheelsight.threads import OneCaller, one_at_a_time
from wheelsight.trajectory import Trajectory, tum_header, tum_lines, write_tum

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
# What a stamp of each list must come after.
_KINDS = {
    "rgb.txt": ("RgbdFrame",),
    "wheels.csv": ("WheelTicks", "WheelCounts", "OdometryReading"),
    "gyro.csv": ("YawRate",),
}


@dataclass(frozen=True, slots=True)
class WrittenFrame:
    """A frame whose images are in the folder, and which no list names yet.

    Attributes:
        lines: what the lists are to get, by their names.
        size_bytes: of the images.
        too_far: depth pixels beyond 13.107 m.
    """

    lines: dict[str, str]
    size_bytes: int
    too_far: int


class LiveWriter(Protocol):
    """Where what live sensors say is written: frames by several threads, listed by one in the order they came."""

    @property
    def last_stamp_s(self) -> float:
        """The newest of all sensors; -∞ before the first."""

    @property
    def frames(self) -> int:
        """How many it has by now."""

    @property
    def readings(self) -> int:
        """How many wheel readings it has."""

    def check(self, event: Event) -> None:
        """Refuse what cannot be read again. Raises ArgumentError, RecordingError."""

    def add(self, event: Event) -> None:
        """Write one event. Raises as `check`, and OutputError."""

    def add_angular_velocity(self, turn: AngularVelocity) -> None:
        """Write a reading of the camera's gyroscope. Raises as `add`."""

    def write_frame(self, frame: RgbdFrame, infrared: UInt16Array | None = None) -> Any:
        """Encode a frame that was checked; what it comes to tells its `size_bytes`. Raises OutputError."""

    def list_frame(self, written: Any, clock: FrameClock | None = None) -> None:
        """Let readers find a frame. Raises OutputError."""

    def close(self) -> None:
        """End. Raises OutputError."""


class RecordingWriter(OneCaller):
    """Writes events into a folder as they come; use it in a `with` block, and `open_recording` reads them again.

    Colour is kept exactly, unless as JPEG, depth to 0.1 mm: 5000 units a metre in 16 bits, as in the TUM benchmark,
    so that any TUM tool reads it. That ends at 13.107 m; what lies beyond is written as not measured and counted in
    `depths_too_far`. Images appear whole or not at all, and a list names an image only once it is
    there; a recording broken off at any point, even by a power cut, is a valid shorter one.

    Of a robot without cameras, by its calibration, it is a recording of the wheels alone; so it is where `calibration`
    is None, of a robot not calibrated yet.

    Several threads may `write_frame` at once, which takes nearly all the time of a frame; one of them `list_frame`.

    Args:
        folder: made if need be.
        calibration: of the robot; None of one that is not calibrated yet.
        force: whether a recording in the folder is overwritten.
        color: "png" keeps colour exactly, "jpeg" with quality 95, in a tenth of the time and a fifth of the room.
        resume: whether to go on behind what the folder holds, by its own calibration; where it holds nothing, anew.

    Attributes:
        folder: where the recording lies.
        frames: how many it has by now.
        readings: how many wheel readings it has.
        depths_too_far: depth pixels beyond 13.107 m, in all frames that were added.

    Raises:
        OutputError: the folder is not empty and neither `force` nor `resume` is on, cannot be written, or the disk is
            full; or what is to be resumed is no recording of these sensors.
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
            self._begin_anew()
        for name in ("rgb", "depth") if has_cameras else ():
            make_output_folder(self.folder / name, force=True)
        if calibration is not None:
            # Depth is written as it was corrected when it was read; it must not be corrected again.
            save_calibration(replace(calibration, depth_error=DepthError()), self.folder / "calibration.yaml")
        of_wheels = {"wheels.csv": f"{wheels_header(calibration)}\n"}
        headers = (_IMAGE_HEADERS if has_cameras else {}) | of_wheels | _GYRO_HEADERS
        self._lists = {name: GrowingText(self.folder / name, header, resume) for name, header in headers.items()}
        self._count_earlier()

    def _begin_anew(self) -> None:
        """Leave nothing of a recording before that this one may lack."""
        for name in (*TRUTH_FILES.values(), _LABELS, _INFRARED, CLOCK_FILE, IMU_FILE, "calibration.yaml"):
            (self.folder / name).unlink(missing_ok=True)

    def _count_earlier(self) -> None:
        """What is resumed counts, and its stamps are those that others must come after."""
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
        """Write one event; frames that were skipped when they were read leave no trace.

        Raises:
            ArgumentError: no event, stamps that are no seconds, or numbers or images that cannot be read again as they
                are: of another size or kind than the calibration's, or depth that is not in metres.
            RecordingError: stamps that do not grow.
            OutputError: the disk is full or the folder has gone.
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
        """Write a reading of the camera's gyroscope, in imu.csv: how the camera sits need not be known yet.

        Raises:
            ArgumentError: a number that is not finite.
            RecordingError: a stamp that does not grow.
            OutputError: as `add`.
        """
        numbers = (turn.stamp_s, turn.x_rad_s, turn.y_rad_s, turn.z_rad_s)
        if not np.isfinite(numbers).all():
            raise ArgumentError(f"{turn} holds what is no number", fix="leave it out")
        lines = self._list(IMU_FILE, f"{IMU_HEADER}\n")
        if lines.earlier and IMU_FILE not in self._last_stamp_s:
            self._last_stamp_s[IMU_FILE] = last_stamp_s(lines.earlier)
        self._check_stamps(IMU_FILE, turn.stamp_s, turn.stamp_s)
        lines.append(",".join(map(seconds, numbers)) + "\n")

    def check(self, event: Event) -> None:
        """Refuse what `add` refuses, and take note of its stamp: others of its kind must come after it.

        Raises ArgumentError, RecordingError.
        """
        check_event(event, finite=True)
        if isinstance(event, WheelSpeeds):
            raise RecordingError("wheel speeds have no place here: wheels.csv holds ticks", path=self.folder)
        if isinstance(event, WheelReading):
            self._check_wheels(event)
        if isinstance(event, RgbdFrame):
            check_images(event, self._known_calibration())
        self._stamps.check(event)
        self._check_stamps(type(event).__name__, event.stamp_s, event.stamp_s)

    def _check_wheels(self, reading: WheelReading) -> None:
        """Refuse readings of other wheels than the calibration's: wheels.csv has the columns of these."""
        of = None if self._calibration is None else self._calibration.holonomic
        header = wheels_header(self._calibration)
        kind = WheelTicks if of is None else WheelCounts if of.wheel_names else OdometryReading
        given = len(_columns_of(reading))
        if type(reading) is not kind or given != header.count(","):
            problem = f"a {type(reading).__name__} of {given} numbers has no place here"
            fix = f"wheels.csv has {header}, by the calibration's wheels"
            raise RecordingError(problem, path=self.folder, fix=fix)

    def write_frame(self, frame: RgbdFrame, infrared: UInt16Array | None = None) -> WrittenFrame:
        """Write the images of a frame that was checked, and (H, W) infrared beside depth; no list names them yet.

        Raises OutputError.
        """
        color, depth = seconds(frame.stamp_s), seconds(frame.stamp_s + frame.depth_late_s)
        names = {"rgb.txt": f"rgb/{color}{SUFFIXES[self._color]}", "depth.txt": f"depth/{depth}.png"}
        lines = {"rgb.txt": f"{color} {names['rgb.txt']}\n", "depth.txt": f"{depth} {names['depth.txt']}\n"}
        units, too_far = _depth_units(frame.depth_m)
        size = write_color(self.folder / names["rgb.txt"], frame.color, self._color)
        size += write_units(self.folder / names["depth.txt"], units)
        if infrared is not None:
            make_output_folder(self.folder / "infrared", force=True)
            size += write_units(self.folder / f"infrared/{depth}.png", infrared)
            lines[_INFRARED] = f"{depth} infrared/{depth}.png\n"
        return WrittenFrame(lines, size, too_far)

    def list_frame(self, written: WrittenFrame, clock: FrameClock | None = None) -> None:
        """Name the images of a frame in their lists, in the order of stamps, and how it got its stamp.

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
        """One that not every recording has."""
        if name not in self._lists:
            self._lists[name] = GrowingText(self.folder / name, header, self._resumes)
        return self._lists[name]

    @one_at_a_time
    def add_ground_truth(self, truth: Trajectory) -> None:
        """Write the true trajectory of the camera or the base; if the calibration joins the two, both.

        Raises:
            CalibrationError: the trajectory describes the base and no T_base_camera says where the camera is.
            OutputError: it cannot be written.
        """
        calibration = self._known_calibration()
        bodies: tuple[str, ...] = ("camera",) if calibration.T_base_camera is None else ("camera", "base")
        if calibration.color is None:
            bodies = ("base",)
        for body in bodies:
            write_tum(express_for(body, truth, calibration), self.folder / TRUTH_FILES[body])

    def append_ground_truth(self, truth: Trajectory) -> None:
        """Append true poses of the camera or the base as they become known, to that body's file alone.

        Unlike `add_ground_truth` it believes no T_base_camera: whoever knows both bodies' truth gives both.

        Raises:
            RecordingError: the body is another, or stamps do not come after those appended before.
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
        """Say in which area the robot was at a frame's time, None for no area; they land in labels.csv.

        Raises:
            RecordingError: a stamp that does not grow, or a name that would break its line.
            OutputError: as `add`.
        """
        name = area or ""
        if any(sign in name for sign in ',"\r\n#'):
            raise RecordingError(f"an area cannot be called {name!r}", path=self.folder / _LABELS)
        self._check_stamps(_LABELS, stamp_s, stamp_s)
        self._list(_LABELS, _LABELS_HEADER).append(f"{seconds(stamp_s)},{name}\n")

    def close(self) -> None:
        """End the recording. Nothing is lost without it but what the system had not yet written."""
        for stream in self._lists.values():
            stream.close()

    def __enter__(self) -> RecordingWriter:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def _known_calibration(self) -> Calibration:
        if self._calibration is None:
            raise CalibrationError("is missing", path=self.folder / "calibration.yaml", fix="record with a calibration")
        return self._calibration

    def _check_stamps(self, what: str, first_s: float, last_s: float) -> None:
        """Refuse stamps that do not come after those of the same kind, or are no numbers."""
        before_s = self._last_stamp_s.get(what, -np.inf)
        if not before_s < first_s <= last_s < np.inf:
            raise RecordingError(f"stamp {first_s:.6f} does not come after {before_s:.6f}", path=self.folder)
        self._last_stamp_s[what] = last_s


def write_recording(folder: StrPath, recording: Recording, force: bool = False) -> RecordingWriter:
    """Write any recording in wheelsight's own layout; answers the closed writer with its counts.

    Raises:
        OutputError: as `RecordingWriter`.
        RecordingError: as `RecordingWriter`.
    """
    folder = Path(folder)
    with RecordingWriter(folder, recording.calibration, force) as writer:
        if recording.ground_truth is not None:
            writer.add_ground_truth(recording.ground_truth)
        for event in recording.events():
            writer.add(event)
    return writer


def _columns_of(reading: WheelReading) -> list[str]:
    """The numbers of a reading after its stamp, as wheels.csv has them."""
    if isinstance(reading, WheelTicks):
        return [str(int(reading.left)), str(int(reading.right))]
    if isinstance(reading, WheelCounts):
        return [str(int(count)) for count in reading.counts]
    if isinstance(reading, OdometryReading):
        return [seconds(number) for number in (reading.x_m, reading.y_m, reading.yaw_rad)]
    return [seconds(number) for number in (reading.left_rad_s, reading.right_rad_s)]


def _depth_units(depth_m: Float32Array) -> tuple[NDArray[np.uint16], int]:
    """Depth (H, W) as a file holds it, and how many pixels were too far for that."""
    units = np.rint(np.asarray(depth_m, np.float64) * DEPTH_FACTOR)
    is_too_far = units > _DEEPEST_UNITS
    return np.where(is_too_far, 0, units).astype(np.uint16), int(np.count_nonzero(is_too_far))
