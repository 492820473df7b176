"""Bytes of a .sens file, version 4, little-endian: its header, where each frame lies, and a frame's two images.

A frame is a pose (16 float32, row by row, camera to world), stamps of colour and depth and sizes of both in bytes (four
uint64), then the two images. Only sizes are read when a file is opened: it has gigabytes.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO

import numpy as np
from numpy.typing import NDArray

from wheelsight.errors import RecordingError
from wheelsight.geometry import MOST_PIXELS, FloatArray
from wheelsight.inputs import Kind, decompressed, open_binary

_VERSION = 4
_MATRIX, _SIZES, _FRAME = struct.Struct("<16f"), struct.Struct("<iiIIIIfQ"), struct.Struct("<16fQQQQ")
_LONGEST_NAME = 1024
_MOST_FRAMES = 500_000  # as in a list of images
_LARGEST_IMAGE = 1 << 27  # bytes, as an image's file
_COLOR_KINDS = {1: "PNG", 2: "JPEG"}
_RAW, _ZLIB = 0, 1
_COPY = "copy the file again"
_FILE = Kind("a .sens", 1 << 40)


@dataclass(frozen=True, slots=True, eq=False)
class SensHeader:
    """What stands before the frames. Sizes are width and height; T_base_color, T_base_depth are the extrinsics."""

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
    """Where a frame's colour begins, and how many bytes both images have; depth follows colour."""

    T_frame_camera: FloatArray
    color_stamp: int
    at: int
    color_bytes: int
    depth_bytes: int


@dataclass(frozen=True, slots=True, eq=False)
class SensFile:
    """A file's header and frames; `cut_off` says how many frames are missing, and is empty where none is."""

    header: SensHeader
    frames: tuple[SensFrame, ...]
    cut_off: str = ""


def read_sens(path: Path) -> SensFile:
    """Header and frames, no image. Raises RecordingError naming the file and the field."""
    try:
        with open_binary(path, _FILE, RecordingError) as stream:
            size = stream.seek(0, 2)
            stream.seek(0)
            header = _read_header(stream, path)
            frames = _read_frames(stream, header, size, path)
    except OSError as error:
        raise RecordingError(f"cannot be read: {error.strerror}", path=path) from error
    if not frames:
        raise RecordingError("is cut off before the end of its first frame", path=path, fix=_COPY)
    missing = header.frame_count - len(frames)
    told = f"The file is cut off: {missing} of {header.frame_count} frames are missing." if missing else ""
    return SensFile(header, tuple(frames), told)


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


def _read_frames(stream: BinaryIO, header: SensHeader, size: int, path: Path) -> list[SensFrame]:
    """The frames that are whole."""
    frames: list[SensFrame] = []
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
    return frames


def _exactly(stream: BinaryIO, count: int, path: Path) -> bytes:
    data = stream.read(count)
    if len(data) < count:
        raise RecordingError("is cut off within its header", path=path, fix=_COPY)
    return data


def _read_at(path: Path, at: int, count: int) -> bytes:
    """Bytes of the file, maybe fewer where it was cut off since; raises RecordingError where it cannot be read."""
    try:
        with open_binary(path, _FILE, RecordingError) as stream:
            stream.seek(at)
            return stream.read(count)
    except OSError as error:
        raise RecordingError(f"cannot be read: {error.strerror}", path=path) from error
