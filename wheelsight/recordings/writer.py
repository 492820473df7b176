"""Writing recordings in wheelsight's own layout, so that a broken-off recording is only a shorter one."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from types import TracebackType

import cv2
import numpy as np
from numpy.typing import NDArray

from wheelsight.calibration import Calibration, save_calibration
from wheelsight.checks import check_event, check_images, need_calibration
from wheelsight.depth_error import DepthError
from wheelsight.errors import CalibrationError, OutputError, RecordingError
from wheelsight.events import Event, RgbdFrame, SkippedFrame, WheelSpeeds, WheelTicks
from wheelsight.files import StrPath, make_output_folder, write_bytes
from wheelsight.geometry import Float32Array
from wheelsight.recordings.bodies import express_for
from wheelsight.recordings.growing_text import GrowingText
from wheelsight.recordings.native import GYRO_HEADER, WHEELS_HEADER
from wheelsight.recordings.protocol import Recording
from wheelsight.recordings.tum import DEPTH_FACTOR
from wheelsight.stamps import StampCheck
from wheelsight.trajectory import Trajectory, tum_header, tum_lines, write_tum

_IMAGE_HEADERS = {
    "rgb.txt": "# color images\n# timestamp filename\n",
    "depth.txt": "# depth maps\n# timestamp filename\n",
}
_READING_HEADERS = {"wheels.csv": f"{WHEELS_HEADER}\n", "gyro.csv": f"{GYRO_HEADER}\n"}
TRUTH_FILES = {"camera": "groundtruth.txt", "base": "groundtruth_base.txt"}
_LABELS = "labels.csv"
_LABELS_HEADER = "stamp_s,area\n"
_DEEPEST_UNITS = np.iinfo(np.uint16).max
_FAST_PNG = (cv2.IMWRITE_PNG_COMPRESSION, 1)


class RecordingWriter:
    """Writes events into a folder as they come; use it in a `with` block, and `open_recording` reads them again.

    Colour is kept exactly, depth to 0.1 mm: 5000 units a metre in 16 bits, as in the TUM benchmark, so that any
    TUM tool reads it. That ends at 13.107 m; what lies beyond is written as not measured and counted in
    `depths_too_far`. Images appear whole or not at all, and a list names an image only once it is
    there; a recording broken off at any point, even by a power cut, is a valid shorter one.

    Of a robot without cameras, by its calibration, it is a recording of the wheels alone; so it is where `calibration`
    is None, of a robot not calibrated yet.

    Attributes:
        folder: where the recording lies.
        frames: how many were written.
        readings: how many wheel readings were written.
        depths_too_far: depth pixels beyond 13.107 m, in all frames.

    Raises:
        OutputError: the folder is not empty and `force` is off, cannot be written, or the disk is full.
    """

    def __init__(self, folder: StrPath, calibration: Calibration | None, force: bool = False) -> None:
        calibration = None if calibration is None else need_calibration(calibration)
        self.folder = make_output_folder(Path(folder), force)
        self.frames = self.readings = self.depths_too_far = 0
        self._calibration = calibration
        self._last_stamp_s: dict[str, float] = {}
        self._stamps = StampCheck()
        for name in (*TRUTH_FILES.values(), _LABELS):
            (self.folder / name).unlink(missing_ok=True)
        has_cameras = calibration is not None and calibration.color is not None
        for name in ("rgb", "depth") if has_cameras else ():
            make_output_folder(self.folder / name, force=True)
        if calibration is None:
            (self.folder / "calibration.yaml").unlink(missing_ok=True)
        else:
            # Depth is written as it was corrected when it was read; it must not be corrected again.
            save_calibration(replace(calibration, depth_error=DepthError()), self.folder / "calibration.yaml")
        headers = (_IMAGE_HEADERS if has_cameras else {}) | _READING_HEADERS
        self._lists = {name: GrowingText(self.folder / name, header) for name, header in headers.items()}

    def add(self, event: Event) -> None:
        """Write one event; frames that were skipped when they were read leave no trace.

        Raises:
            ArgumentError: no event, stamps that are no seconds, or numbers or images that cannot be read again as they
                are: of another size or kind than the calibration's, or depth that is not in metres.
            RecordingError: stamps that do not grow.
            OutputError: the disk is full or the folder has gone.
        """
        check_event(event, finite=not isinstance(event, SkippedFrame))
        if isinstance(event, SkippedFrame):
            return
        if isinstance(event, WheelSpeeds):
            raise RecordingError("wheel speeds have no place here: wheels.csv holds ticks", path=self.folder)
        if isinstance(event, RgbdFrame):
            check_images(event, self._known_calibration())
        self._stamps.check(event)
        self._check_stamps(type(event).__name__, event.stamp_s, event.stamp_s)
        if isinstance(event, RgbdFrame):
            self._add_frame(event)
        elif isinstance(event, WheelTicks):
            self._lists["wheels.csv"].append(f"{_seconds(event.stamp_s)},{int(event.left)},{int(event.right)}\n")
            self.readings += 1
        else:
            self._lists["gyro.csv"].append(f"{_seconds(event.stamp_s)},{_seconds(event.yaw_rate_rad_s)}\n")

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
        if name not in self._lists:
            self._lists[name] = GrowingText(self.folder / name, tum_header(truth))
        self._lists[name].append("".join(tum_lines(truth)))

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
        if _LABELS not in self._lists:
            self._lists[_LABELS] = GrowingText(self.folder / _LABELS, _LABELS_HEADER)
        self._lists[_LABELS].append(f"{_seconds(stamp_s)},{name}\n")

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

    def _add_frame(self, frame: RgbdFrame) -> None:
        seconds = {"rgb": _seconds(frame.stamp_s), "depth": _seconds(frame.stamp_s + frame.depth_late_s)}
        names = {name: f"{name}/{stamp}.png" for name, stamp in seconds.items()}
        _write_png(self.folder / names["rgb"], cv2.cvtColor(frame.color, cv2.COLOR_RGB2BGR))
        _write_png(self.folder / names["depth"], self._depth_units(frame.depth_m))
        for name, file in names.items():
            self._lists[f"{name}.txt"].append(f"{seconds[name]} {file}\n")
        self.frames += 1

    def _depth_units(self, depth_m: Float32Array) -> NDArray[np.uint16]:
        units = np.rint(np.asarray(depth_m, np.float64) * DEPTH_FACTOR)
        is_too_far = units > _DEEPEST_UNITS
        self.depths_too_far += int(np.count_nonzero(is_too_far))
        return np.where(is_too_far, 0, units).astype(np.uint16)

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


def _seconds(stamp_s: float) -> str:
    """A stamp with all its decimals, never in powers of ten, so that it reads back exactly."""
    return np.format_float_positional(stamp_s, min_digits=6)


def _write_png(path: Path, image: NDArray[np.integer | np.floating]) -> None:
    is_encoded, data = cv2.imencode(".png", image, _FAST_PNG)
    if not is_encoded:
        raise OutputError("the image cannot be encoded as PNG", path=path)
    write_bytes(path, data.tobytes())
