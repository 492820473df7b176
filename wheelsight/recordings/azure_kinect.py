"""Recordings of an Azure Kinect: one Matroska file (.mkv) with colour, depth and the device's calibration."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from wheelsight.association import associate
from wheelsight.calibration import Calibration
from wheelsight.errors import CalibrationError, RecordingError
from wheelsight.events import NOTHING_MEASURED, Event, RgbdFrame, SkippedFrame
from wheelsight.extras import needed
from wheelsight.geometry import MOST_PIXELS, ByteArray
from wheelsight.geometry.arrays import UInt16Array
from wheelsight.inputs import Kind, open_binary, parse_json
from wheelsight.recordings._azure_calibration import Registration, read_lenses
from wheelsight.recordings._calibrated import corrected_depth
from wheelsight.recordings._cameras import choose_calibration
from wheelsight.recordings.protocol import AssociationReport, Layout, OpenOptions
from wheelsight.trajectory import Trajectory

_COLOR, _DEPTH = "COLOR", "DEPTH"
_SEGMENT, _HEAD = b"\x18\x53\x80\x67", 4096
_MOST_ATTACHED = 1 << 20  # bytes; a calibration has 4 000
_MKV = Kind("an .mkv", 1 << 40)
_COPY = "copy the file again"


class AzureKinectReader:
    """A file of `k4arecorder`, or of another program that writes what it writes."""

    name = "azure_kinect"
    layout = Layout.FILE
    needs = "an .mkv"

    def recognises(self, folder: Path) -> bool:
        """Whether it is a file of that name."""
        return folder.suffix.lower() == ".mkv" and folder.is_file()

    def open(self, folder: Path, options: OpenOptions) -> AzureKinectRecording:
        """The recording in a file. Raises RecordingError, or ConfigError where PyAV is missing."""
        listed = _list(folder)
        try:
            lenses = read_lenses(listed.calibration, listed.depth_mode, listed.color_size)
        except CalibrationError as error:
            raise CalibrationError(error.problem, path=folder, fix=error.fix) from error
        registration = Registration(*lenses)
        calibration = choose_calibration(
            folder, options, lambda: registration.calibration(listed.depth_mode, listed.serial)
        )
        _check_fits(calibration, listed.color_size, folder)
        pairs, association = _pair(listed, options.max_gap_s, folder)
        warnings = ["Its gyroscope and accelerometer are not read."] if listed.has_imu else []
        if listed.is_cut_off:
            warnings.append("The file is cut off; what comes before is read.")
        return AzureKinectRecording(
            folder.stem,
            folder,
            calibration,
            association,
            registration,
            tuple(pairs),
            listed.depth_size,
            tuple(warnings),
        )


@dataclass(frozen=True, slots=True)
class _Pair:
    """A frame: when colour was taken, and the times of both in the file's own units, by which they are found."""

    stamp_s: float
    color_pts: int
    depth_pts: int
    depth_late_s: float


@dataclass(frozen=True, eq=False)
class AzureKinectRecording:
    """A `Recording`. Frames are straightened and registered as they are asked for."""

    name: str
    path: Path
    calibration: Calibration
    association: AssociationReport
    registration: Registration
    pairs: tuple[_Pair, ...]
    depth_size: tuple[int, int]
    warnings: tuple[str, ...] = ()
    format: str = AzureKinectReader.name
    wheel_count: int = 0
    ground_truth: Trajectory | None = None

    @property
    def body(self) -> str:
        """The frame a trajectory describes: "base" where the calibration says T_base_camera, else "camera"."""
        return "camera" if self.calibration.T_base_camera is None else "base"

    @property
    def frame_count(self) -> int:
        """How many frames `events()` will yield, skipped ones included."""
        return len(self.pairs)

    def events(self, *, images: bool = True) -> Iterator[Event]:
        """Frames in order of time, from the start at each call; none without `images`."""
        if not images or not self.pairs:
            return
        by_color = {pair.color_pts: pair for pair in self.pairs}
        wanted = {pair.depth_pts for pair in self.pairs}
        color: dict[int, Any] = {}
        depth: dict[int, Any] = {}
        index = 0
        for kind, packet in _packets(self.path):
            if kind == _COLOR and packet.pts in by_color:
                color[packet.pts] = packet
            elif kind == _DEPTH and packet.pts in wanted:
                depth[packet.pts] = packet
            while index < len(self.pairs) and self._has(self.pairs[index], color, depth):
                pair = self.pairs[index]
                yield self._frame(pair, index, color.pop(pair.color_pts), depth.pop(pair.depth_pts))
                index += 1
        for left in range(index, len(self.pairs)):
            yield SkippedFrame(self.pairs[left].stamp_s, "the file was cut off since it was opened", left)

    @staticmethod
    def _has(pair: _Pair, color: dict[int, Any], depth: dict[int, Any]) -> bool:
        return pair.color_pts in color and pair.depth_pts in depth

    def _frame(self, pair: _Pair, index: int, color: Any, depth: Any) -> RgbdFrame | SkippedFrame:
        depth_mm = _depth_of(bytes(depth), self.depth_size)
        if depth_mm is None:
            return SkippedFrame(pair.stamp_s, "depth image is cut off", index)
        if not depth_mm.any():
            return SkippedFrame(pair.stamp_s, NOTHING_MEASURED, index)
        pixels = _color_of(color)
        camera, _ = self.calibration.cameras
        if pixels is None or pixels.shape != (camera.height, camera.width, 3):
            return SkippedFrame(pair.stamp_s, "colour image is damaged", index)
        seen, depth_m = self.registration.straightened(pixels), self.registration.registered(depth_mm)
        depth_m = corrected_depth(seen, depth_m, self.calibration, (self.path, self.path))
        return RgbdFrame(pair.stamp_s, seen, depth_m, index, pair.depth_late_s)


@dataclass(frozen=True, slots=True, eq=False)
class _Listed:
    """What a file holds."""

    color_pts: list[int]
    depth_pts: list[int]
    tick_s: float
    depth_delay_s: float
    color_size: tuple[int, int]
    depth_size: tuple[int, int]
    depth_mode: str
    serial: str
    calibration: Any
    has_imu: bool
    is_cut_off: bool


@contextmanager
def _opened(path: Path) -> Iterator[Any]:
    """The file's container, and its faults as RecordingError.

    It is opened as Matroska alone, from a file that is open: FFmpeg also reads lists of other files, and opens devices
    and addresses by their names.
    """
    av = needed("av")
    with open_binary(path, _MKV, RecordingError) as stream:
        try:
            with av.open(stream, format="matroska") as container:
                yield container
        # PyAV has no attributes, or None, where a file lacks what they are made of.
        except (av.error.FFmpegError, OSError, ValueError, TypeError, AttributeError, ArithmeticError) as error:
            raise RecordingError(f"is no Matroska file that can be read: {error}", path=path, fix=_COPY) from error


def _streams(container: Any, path: Path) -> dict[str, Any]:
    """Video streams by the names that the recorder gives them. Raises RecordingError."""
    found = {str(stream.metadata.get("title", "")): stream for stream in container.streams.video}
    for name in (_COLOR, _DEPTH):
        if name not in found:
            there = ", ".join(sorted(found)) or "none"
            fix = "record colour and depth with k4arecorder"
            raise RecordingError(f"no stream is called {name}; there are: {there}", path=path, fix=fix)
        _check(found[name], name, path)
    return found


def _check(stream: Any, name: str, path: Path) -> None:
    """Raises RecordingError for a stream of which FFmpeg knows no codec, size or clock."""
    if stream.codec_context is None:
        raise RecordingError(f"its stream {name} is of an unknown codec", path=path, fix=_COPY)
    if not stream.time_base or not 0 < stream.width * stream.height <= MOST_PIXELS:
        problem = f"its stream {name} is of {stream.width}×{stream.height} pixels, in units of {stream.time_base} s"
        raise RecordingError(problem, path=path, fix=_COPY)
    # An image says its own size, which may be another than its stream's.
    stream.codec_context.options = {"max_pixels": str(MOST_PIXELS)}


def _list(path: Path) -> _Listed:
    """Read the file once, decoding nothing. Raises RecordingError."""
    with _opened(path) as container:
        streams = _streams(container, path)
        color, depth = streams[_COLOR], streams[_DEPTH]
        if color.time_base != depth.time_base:
            raise RecordingError("colour and depth have clocks of their own", path=path)
        stamps: dict[int, list[int]] = {color.index: [], depth.index: []}
        is_whole = _list_packets(container, (color, depth), stamps)
        return _Listed(
            color_pts=sorted(set(stamps[color.index])),
            depth_pts=sorted(set(stamps[depth.index])),
            tick_s=float(color.time_base),
            depth_delay_s=1e-9 * int(container.metadata.get("K4A_DEPTH_DELAY_NS", "0")),
            color_size=(color.width, color.height),
            depth_size=(depth.width, depth.height),
            depth_mode=str(depth.metadata.get("K4A_DEPTH_MODE", "")),
            serial=str(container.metadata.get("K4A_DEVICE_SERIAL_NUMBER", "")),
            calibration=_calibration_in(container, path),
            has_imu=any(stream.metadata.get("title") == "IMU" for stream in container.streams),
            # FFmpeg takes the end of a file that was cut off for its end.
            is_cut_off=not is_whole or _ends_early(path),
        )


def _list_packets(container: Any, streams: tuple[Any, Any], stamps: dict[int, list[int]]) -> bool:
    """Whether the file could be read to its end."""
    av = needed("av")
    try:
        for packet in container.demux(*streams):
            if packet.pts is not None and packet.size:
                stamps[packet.stream_index].append(packet.pts)
    except av.error.FFmpegError:
        return False
    return True


def _ends_early(path: Path) -> bool:
    """Whether a file ends before its segment does, by the sizes that it states (RFC 8794, sections 4 and 6)."""
    with open_binary(path, _MKV, RecordingError) as stream:
        head = stream.read(_HEAD)
    length, at = _size_at(head, 4)
    at += length or 0
    length, begin = _size_at(head, at + 4)
    return head[at : at + 4] == _SEGMENT and length is not None and begin + length > path.stat().st_size


def _size_at(data: bytes, at: int) -> tuple[int | None, int]:
    """An element's size, None where it is not stated, and where its content begins."""
    if at >= len(data):
        return None, at
    bytes_of_it = 9 - data[at].bit_length()
    end, unknown = at + bytes_of_it, (1 << 7 * bytes_of_it) - 1
    size = int.from_bytes(data[at:end]) & unknown
    return None if size == unknown else size, end


def _packets(path: Path) -> Iterator[tuple[str, Any]]:
    """Colour and depth packets in the file's order; ends where the file is damaged."""
    with _opened(path) as container:
        streams = _streams(container, path)
        names = {streams[name].index: name for name in (_COLOR, _DEPTH)}
        packets = container.demux(*(streams[name] for name in (_COLOR, _DEPTH)))
        av = needed("av")
        while True:
            try:
                packet = next(packets)
            except (StopIteration, av.error.FFmpegError):
                return
            if packet.pts is not None and packet.size:
                yield names[packet.stream_index], packet


def _calibration_in(container: Any, path: Path) -> Any:
    for stream in container.streams:
        if stream.type == "attachment" and str(stream.metadata.get("filename", "")) == "calibration.json":
            data = bytes(stream.data or b"").rstrip(b"\0")
            try:
                return parse_json(data) if len(data) <= _MOST_ATTACHED else None
            except ValueError as error:
                raise RecordingError(f"its calibration.json {error}", path=path) from error
    raise RecordingError("holds no calibration.json", path=path, fix="record with k4arecorder, which attaches it")


def _pair(listed: _Listed, max_gap_s: float, path: Path) -> tuple[list[_Pair], AssociationReport]:
    """Colour and depth of one moment. Raises RecordingError where there are none."""
    color_s, depth_s = (np.array(pts, float) * listed.tick_s for pts in (listed.color_pts, listed.depth_pts))
    found = associate(color_s, depth_s - listed.depth_delay_s, max_gap_s)
    if not len(found):
        if listed.is_cut_off:
            raise RecordingError("is cut off before the first pair of images", path=path, fix="copy it again")
        problem = f"of {len(color_s)} colour and {len(depth_s)} depth images, none lie within {max_gap_s:g} s"
        raise RecordingError(problem, path=path, fix="raise --max-gap, or record both")
    late_s = depth_s[found[:, 1]] - color_s[found[:, 0]]
    pairs = [
        _Pair(float(color_s[i]), listed.color_pts[i], listed.depth_pts[j], late)
        for (i, j), late in zip(found.tolist(), late_s.tolist(), strict=True)
    ]
    largest_s = float(np.abs(late_s - listed.depth_delay_s).max())
    return pairs, AssociationReport(len(color_s), len(depth_s), len(pairs), max_gap_s, largest_s)


def _check_fits(calibration: Calibration, size: tuple[int, int], path: Path) -> None:
    """Raises CalibrationError for a given calibration that cannot be of straightened colour with registered depth."""
    color, _ = calibration.cameras
    if (color.width, color.height) != size or not calibration.is_registered or color.has_distortion:
        problem = "the calibration given is not of straightened colour images with depth registered to them"
        raise CalibrationError(problem, path=path, fix="leave the cameras out: the recording has its own")


def _depth_of(data: bytes, size: tuple[int, int]) -> UInt16Array | None:
    """(H, W) millimetres; they are written most significant byte first."""
    width, height = size
    if len(data) != 2 * width * height:
        return None
    return np.frombuffer(data, ">u2").reshape(height, width).astype(np.uint16)


def _color_of(packet: Any) -> ByteArray | None:
    av = needed("av")
    try:
        frames = packet.decode()
        return np.asarray(frames[0].to_ndarray(format="rgb24"), np.uint8) if frames else None
    except (av.error.FFmpegError, OSError, ValueError):
        return None
