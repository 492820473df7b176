"""ScanNet: one `.sens` file (version 4) of cameras, JPEG colour, compressed depth and poses (Dai et al., CVPR 2017)."""

from __future__ import annotations

import struct
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import BinaryIO

import numpy as np
from numpy.typing import NDArray

from wheelsight.core.calibration import Calibration
from wheelsight.core.errors import CalibrationError, RecordingError
from wheelsight.core.geometry import MOST_PIXELS, FloatArray, PinholeCamera, se3
from wheelsight.core.inputs import Kind, decompressed, open_binary
from wheelsight.core.messages import RgbdFrame
from wheelsight.io.recordings.image_recording import FramePaths, ImageRecording
from wheelsight.io.recordings.images import DepthEncoding, corrected_depth, decoded_color, depth_of_units
from wheelsight.io.recordings.numbered_datasets import WrittenPose, rate_of, true_poses
from wheelsight.io.recordings.recording import AssociationReport, Layout, OpenOptions, choose_calibration, express_for

# A .sens file is little-endian: a header, then frames. A frame is a pose (16 float32, row by row, camera to world),
# stamps of colour and depth and sizes of both in bytes (four uint64), then the two images. Opening reads no images: a
# file has gigabytes.

_VERSION = 4
_MATRIX, _SIZES, _FRAME = struct.Struct("<16f"), struct.Struct("<iiIIIIfQ"), struct.Struct("<16fQQQQ")
_LONGEST_NAME = 1024
_MOST_FRAMES = 500_000  # as for a list of images
_LARGEST_IMAGE = 1 << 27  # bytes, as for an image file
_COLOR_KINDS = {1: "PNG", 2: "JPEG"}
_RAW, _ZLIB = 0, 1
_COPY = "copy the file again"
_FILE = Kind("a .sens", 1 << 40)


@dataclass(frozen=True, slots=True, eq=False)
class SensHeader:
    """The header. Sizes are width and height; T_base_color and T_base_depth are the extrinsics."""

    sensor: str
    K_color: FloatArray
    T_base_color: FloatArray
    K_depth: FloatArray
    T_base_depth: FloatArray
    depth_kind: int
    color_size: tuple[int, int]
    depth_size: tuple[int, int]
    units_a_metre: float
    frame_count: int


@dataclass(frozen=True, slots=True, eq=False)
class SensFrame:
    """A frame: its pose, its stamp, the offset of its colour image, and the sizes of both. Depth follows colour."""

    T_frame_camera: FloatArray
    color_stamp: int
    at: int
    color_bytes: int
    depth_bytes: int


@dataclass(frozen=True, slots=True, eq=False)
class SensFile:
    """Header and frames. `cut_off` is a warning where frames are missing, else empty."""

    header: SensHeader
    frames: tuple[SensFrame, ...]
    cut_off: str = ""


def read_sens(path: Path) -> SensFile:
    """Header and frames, without images. Raises RecordingError naming the file and the field."""
    try:
        with open_binary(path, _FILE, RecordingError) as stream:
            size = stream.seek(0, 2)
            stream.seek(0)
            header, frames = _read_header(stream, path), list[SensFrame]()
            for number in range(header.frame_count):
                data = stream.read(_FRAME.size)
                if len(data) < _FRAME.size:
                    break
                *pose, color_stamp, _, color_bytes, depth_bytes = _FRAME.unpack(data)
                if max(color_bytes, depth_bytes) > _LARGEST_IMAGE:
                    problem = f"frame {number} says its images have {color_bytes} and {depth_bytes} bytes"
                    raise RecordingError(problem, path=path, fix=_COPY)
                at = stream.tell()
                if at + color_bytes + depth_bytes > size:
                    break
                T = np.array(pose, np.float64).reshape(4, 4)
                frames.append(SensFrame(T, color_stamp, at, color_bytes, depth_bytes))
                stream.seek(at + color_bytes + depth_bytes)
    except OSError as error:
        raise RecordingError(f"cannot be read: {error.strerror}", path=path) from error
    if not frames:
        raise RecordingError("is cut off before the end of its first frame", path=path, fix=_COPY)
    missing = header.frame_count - len(frames)
    cut_off = f"The file is cut off: {missing} of {header.frame_count} frames are missing." if missing else ""
    return SensFile(header, tuple(frames), cut_off)


def color_of(path: Path, frame: SensFrame) -> bytes:
    """The compressed colour image."""
    return _read_at(path, frame.at, frame.color_bytes)


def depth_units_of(path: Path, frame: SensFrame, header: SensHeader) -> NDArray[np.uint16]:
    """Depth (H, W) in the file's units. Raises RecordingError."""
    data = _read_at(path, frame.at + frame.color_bytes, frame.depth_bytes)
    width, height = header.depth_size
    expected = 2 * width * height
    if header.depth_kind == _ZLIB:
        try:
            data = decompressed(data, "zlib", expected)
        except ValueError as error:
            raise RecordingError(f"depth image {error}", path=path, fix=_COPY) from error
    if len(data) != expected:
        problem = f"depth image holds {len(data)} bytes where {width}×{height} pixels have {expected}"
        raise RecordingError(problem, path=path, fix=_COPY)
    return np.frombuffer(data, "<u2").reshape(height, width).astype(np.uint16)


def _read_header(stream: BinaryIO, path: Path) -> SensHeader:
    (version,) = struct.unpack("<I", _exactly(stream, 4, path))
    if version != _VERSION:
        fix = "convert it with ScanNet's tools"
        raise RecordingError(f"is no .sens of version {_VERSION}: its version field is {version}", path=path, fix=fix)
    (length,) = struct.unpack("<Q", _exactly(stream, 8, path))
    if length > _LONGEST_NAME:
        raise RecordingError(f"its sensor name would have {length} characters", path=path, fix=_COPY)
    sensor = _exactly(stream, length, path).decode("utf-8", "replace")
    matrices = [
        np.array(_MATRIX.unpack(_exactly(stream, _MATRIX.size, path)), np.float64).reshape(4, 4) for _ in range(4)
    ]
    color_kind, depth_kind, *sizes, shift, count = _SIZES.unpack(_exactly(stream, _SIZES.size, path))
    if color_kind not in _COLOR_KINDS:
        problem = f"its colour compression field is {color_kind}; read are 1 (PNG) and 2 (JPEG)"
        raise RecordingError(problem, path=path, fix="convert it with ScanNet's tools")
    if depth_kind not in (_RAW, _ZLIB):
        problem = f"its depth compression field is {depth_kind}; read are 0 (none) and 1 (zlib)"
        raise RecordingError(problem, path=path, fix="convert it with ScanNet's tools")
    if not shift > 0 or count > _MOST_FRAMES or sizes[2] * sizes[3] > MOST_PIXELS:
        problem = f"its header says {shift:g} units a metre, {count} frames, depth of {sizes[2]}×{sizes[3]} pixels"
        raise RecordingError(problem, path=path, fix=_COPY)
    color_size, depth_size = (sizes[0], sizes[1]), (sizes[2], sizes[3])
    K_color, T_color, K_depth, T_depth = matrices
    return SensHeader(
        sensor, K_color, T_color, K_depth, T_depth, depth_kind, color_size, depth_size, float(shift), count
    )


def _exactly(stream: BinaryIO, count: int, path: Path) -> bytes:
    data = stream.read(count)
    if len(data) < count:
        raise RecordingError("is cut off within its header", path=path, fix=_COPY)
    return data


def _read_at(path: Path, at: int, count: int) -> bytes:
    """Bytes of the file; fewer where it was truncated meanwhile. Raises RecordingError where it cannot be read."""
    try:
        with open_binary(path, _FILE, RecordingError) as stream:
            stream.seek(at)
            return stream.read(count)
    except OSError as error:
        raise RecordingError(f"cannot be read: {error.strerror}", path=path) from error


_MICROSECONDS = 1e6
_RIGID_TOLERANCE = 1e-2


class ScanNetReader:
    """Reads a .sens file of version 4."""

    name = "scannet"
    layout = Layout.FILE
    needs = "a .sens"

    def recognises(self, folder: Path) -> bool:
        """Whether it is a .sens file, by its name."""
        return folder.suffix.lower() == ".sens" and folder.is_file()

    def open(self, folder: Path, options: OpenOptions) -> ScanNetRecording:
        """The recording in a file. Raises InputError naming it."""
        sens = read_sens(folder)
        warnings = [sens.cut_off] if sens.cut_off else []
        stamps = np.array([frame.color_stamp for frame in sens.frames], np.float64)
        if options.rate_hz is None and (np.diff(stamps) > 0).all() and stamps[-1] > 0:
            stamps_s = [float(stamp_s) for stamp_s in stamps / _MICROSECONDS]
        else:  # some files have no stamps
            rate_hz = rate_of(options, warnings)
            stamps_s = [number / rate_hz for number in range(len(stamps))]

        def known() -> Calibration:
            """Both cameras, by the header."""
            header = sens.header
            try:
                color, depth = (
                    PinholeCamera(*size, float(K[0, 0]), float(K[1, 1]), float(K[0, 2]), float(K[1, 2]))
                    for size, K in ((header.color_size, header.K_color), (header.depth_size, header.K_depth))
                )
                for T in (header.T_base_color, header.T_base_depth):
                    if not se3.is_valid(T, _RIGID_TOLERANCE):
                        raise CalibrationError("an extrinsic matrix is no rigid motion")
                T_color_depth = se3.nearest(np.linalg.inv(header.T_base_color) @ header.T_base_depth)
                return Calibration(color, depth, T_color_depth, source=f"{folder.name}, {header.sensor}")
            except CalibrationError as error:
                fix = error.fix or "give a calibration.yaml with --camera"
                raise CalibrationError(f"its header: {error.problem}", path=folder, fix=fix) from error

        calibration = choose_calibration(folder, options, known)
        poses = [
            WrittenPose(stamp_s, frame.T_frame_camera, folder)
            for stamp_s, frame in zip(stamps_s, sens.frames, strict=True)
        ]
        truth = true_poses(poses, warnings)
        if truth is not None:
            warnings.append("True poses are ScanNet's reconstruction by BundleFusion, not motion capture.")
        count = len(sens.frames)
        recording = ScanNetRecording(
            folder.stem,
            folder,
            self.name,
            calibration,
            AssociationReport(count, count, count, options.max_gap_s),
            tuple(FramePaths(stamp_s, folder, folder) for stamp_s in stamps_s),
            DepthEncoding(options.depth_factor or sens.header.units_a_metre, invalid=65535),
            warnings=tuple(warnings),
            sens=sens,
        )
        try:
            recording.read_frame(count // 2)
        except RecordingError:
            recording.read_frame(0)
        return replace(
            recording, ground_truth=None if truth is None else express_for(recording.body, truth, calibration)
        )


@dataclass(frozen=True, eq=False)
class ScanNetRecording(ImageRecording):
    """A `Recording` of the file `sens`. Frames are read from it during iteration."""

    sens: SensFile = field(kw_only=True)

    def read_frame(self, index: int) -> RgbdFrame:
        """The frame at `index`. Raises RecordingError where it is unusable."""
        frame = self.sens.frames[index]
        color = decoded_color(color_of(self.path, frame), self.path)
        units = depth_units_of(self.path, frame, self.sens.header)
        depth_m = depth_of_units(units, self.encoding, self.path)
        depth_m = corrected_depth(color, depth_m, self.calibration, (self.path, self.path))
        return RgbdFrame(self.frames[index].stamp_s, color, depth_m, index)
