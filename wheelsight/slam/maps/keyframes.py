"""Keyframes of a map: loaded on demand, and packed into binary records.

A record has little-endian numbers, lossless images quantised below the sensor's noise, and the keypoints with depth.
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import partial
from itertools import pairwise
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from wheelsight.core.calibration_parts import DepthNoise
from wheelsight.core.errors import MapError
from wheelsight.core.geometry import Float32Array, FloatArray, IntArray
from wheelsight.core.geometry.arrays import UInt64Array
from wheelsight.core.inputs import picture_within
from wheelsight.core.keyframes import Keyframe, KeyframeFeatures, KeyframeId, KeyframeStore
from wheelsight.mapping import columns
from wheelsight.places.recognition import known_grey
from wheelsight.slam.maps.journal import Record, RecordKind, read_record
from wheelsight.vision.dense.alignment import Level, coarser

_LOST = "use another copy of the map, or go on without this keyframe"


class KeptKeyframes(KeyframeStore):
    """A store whose first keyframes are those of a map folder; more may be added.

    The most recently used ones are in memory, the others are read again: see `KeyframeStore.limit_memory`. Iteration
    skips keyframes lost to damage. They keep their numbers, and access to one raises MapError.

    Args:
        where: journal and record of each keyframe, by number.
        T_map_keyframe: (N, 4, 4) poses of all; NaN if the pose is lost too.
        camera_px: width and height of the map's camera; larger images are rejected.
    """

    def __init__(
        self,
        where: Mapping[int, tuple[Path, Record]],
        T_map_keyframe: FloatArray,
        memory_keyframes: int,
        camera_px: Size,
    ) -> None:
        super().__init__()
        count = len(T_map_keyframe)
        self.limit_memory(memory_keyframes)
        self._lost = frozenset(range(count)) - where.keys()
        self._keyframes = [None] * count
        self._readers = {number: partial(read_keyframe, *found, camera_px) for number, found in where.items()}
        room = np.zeros((max(16, count), 4, 4))
        room[:count] = T_map_keyframe
        self._T_map_keyframe = room

    @property
    def missing(self) -> tuple[KeyframeId, ...]:
        """Keyframes lost to damage."""
        return tuple(KeyframeId(number) for number in sorted(self._lost))

    def __iter__(self) -> Iterator[KeyframeId]:
        return (KeyframeId(number) for number in range(len(self)) if number not in self._lost)

    def __getitem__(self, number: KeyframeId) -> Keyframe:
        """Return a keyframe. Raises ArgumentError for an unknown number, and MapError if it cannot be read."""
        if number in self._lost:
            raise MapError(f"keyframe {number} is lost", fix=_LOST)
        return super().__getitem__(number)


def read_keyframe(path: Path, record: Record, camera_px: Size) -> Keyframe:
    """Return the keyframe of a record, with images up to its camera's size. Raises MapError with file and offset."""
    try:
        return unpack_keyframe(read_record(path, record), camera_px, is_old=record.kind == RecordKind.FIRST_KEYFRAME)
    except MapError as error:
        problem = error.problem if error.path is not None else f"its record at byte {record.offset:,} {error.problem}"
        raise MapError(problem, path=path, fix=error.fix) from error


def read_descriptors(path: Path, record: Record) -> UInt64Array:
    """Return the descriptors (N, 4) of a keyframe's record. Raises MapError."""
    _, parts, _ = _parts_of(read_record(path, record), is_old=record.kind == RecordKind.FIRST_KEYFRAME)
    return _descriptors(parts[4])


_DAMAGED = "use another copy of the map"
# Keyframes store depth no finer than this, metres. Without the quadratic term, the closed form below does not exist.
_FINEST_M, _LEAST_QUADRATIC = 0.0004, 1e-9
_BRIGHTEST = 255
WIDTH_PX = 320  # largest width of stored images; larger ones are halved, as in recognition
# Steps of depth, in standard deviations of its noise, and of grey, in levels of 255: two real recordings of Kinects,
# docs/decisions/maps-in-memory-and-on-disk.md.
DEPTH_SIGMAS, GREY_STEP = 2.0, 8
_LEAST_KEYPOINTS = 300  # stored even if images leave no room for them; as many as become words
# Of maps from before 2026-11-29, whose width could be set.
LARGEST_PX = 4096, 4096
# Above 100, WebP is lossless: 22 to 27 % smaller than PNG (docs/decisions/maps-in-memory-and-on-disk.md).
_LOSSLESS = (cv2.IMWRITE_WEBP_QUALITY, 101)
Size = tuple[int, int]
"""Width and height of an image, pixels."""


def pack_keyframe(keyframe: Keyframe, steps: DepthSteps, most_kb: int) -> bytes:
    """Return the record of a keyframe, of at most `most_kb` kilobytes.

    `unpack_keyframe` restores it up to quantisation, image width, and surplus keypoints.
    """
    level = halved(keyframe)
    depth = packed_depth(steps.numbers(level.depth_m))
    grey = packed_grey(grey_numbers(level.grey, GREY_STEP))
    code = b"" if keyframe.code is None else np.ascontiguousarray(keyframe.code, "<f8").tobytes()
    room = 1000 * most_kb - _HEAD.size - len(depth) - len(grey) - len(code)
    count, places, descriptors = _packed_features(keyframe.features, _MOST_KEYPOINTS)
    while (taken := len(places) + len(descriptors)) > room and count > _LEAST_KEYPOINTS:
        most = max(min(room * count // taken, count - 1), _LEAST_KEYPOINTS)
        count, places, descriptors = _packed_features(keyframe.features, most)
    sizes = (len(depth), len(grey), len(code), count, len(places))
    head = _HEAD.pack(keyframe.stamp_s, *level.intrinsics, steps.step_m, steps.growth, *sizes, GREY_STEP)
    return b"".join([head, depth, grey, code, places, descriptors])


def unpack_keyframe(content: bytes, most_px: Size = LARGEST_PX, *, is_old: bool = False) -> Keyframe:
    """Return the keyframe of a record. Raises MapError for invalid data or images larger than `most_px`.

    Records from before 2026-11-27 are old: they have PNG images, and keypoint positions as float32.
    """
    (stamp_s, *intrinsics, step_m, growth, grey_step), parts, count = _parts_of(content, is_old)
    if is_old:
        depth, grey = (_decoded(parts[k], most_px, 2, dtype) for k, dtype in enumerate((np.uint16, np.uint8)))
    else:
        depth = unpacked_depth(parts[0], most_px)
        grey = unpacked_grey(parts[1], most_px)
    if depth.shape != grey.shape:
        raise MapError("its images are of two sizes", fix=_DAMAGED)
    features = None
    if count >= 0 and is_old:
        rows = np.frombuffer(_inflated(parts[3], count * _BYTES), "<f4").reshape(5, count).T.astype(float)
        if not np.isfinite(rows).all():
            raise MapError("its keypoints are not finite", fix=_DAMAGED)
        features = KeyframeFeatures(rows[:, :2].copy(), rows[:, 2:].copy(), _descriptors(parts[4]))
    elif count >= 0:
        features = KeyframeFeatures(*unpacked_keypoints(parts[3], count), _descriptors(parts[4]))
    images = DepthSteps(step_m, growth).depth_m(depth), grey_of(grey, int(grey_step))
    made = Keyframe.of_images(stamp_s, np.array(intrinsics), *images, features)
    if not parts[2]:
        return made
    code = np.frombuffer(parts[2], "<f8").astype(float)
    return Keyframe(stamp_s, made.intrinsics, made.depth_png, made.grey_png, features, code)


def _parts_of(content: bytes, is_old: bool) -> tuple[tuple[float, ...], list[bytes], int]:
    """Return the numbers of a record's head, its five parts, and the number of keypoints. Raises MapError."""
    head = _OLD_HEAD if is_old else _HEAD
    try:
        *numbers, depth, grey, code, count, places, grey_step = head.unpack_from(content)
    except struct.error as error:
        raise MapError("is no keyframe", fix=_DAMAGED) from error
    lengths = (depth, grey, code, places, max(count, 0) * _ORB_BYTES)
    _, fx, fy, _, _, step_m, growth = numbers
    is_sound = np.isfinite(numbers).all() and min(fx, fy, step_m, growth) > 0 and -1 <= count <= _MOST_KEYPOINTS
    if not is_sound or min(lengths) < 0 or head.size + sum(lengths) != len(content) or code % 8:
        raise MapError("is no keyframe", fix=_DAMAGED)
    ends = head.size + np.cumsum((0, *lengths))
    return (*numbers, grey_step), [content[a:b] for a, b in pairwise(ends.tolist())], count


def _packed_features(features: KeyframeFeatures | None, most: int) -> tuple[int, bytes, bytes]:
    """Return the number of keypoints, -1 for None, with their packed positions and descriptors."""
    if features is None:
        return -1, b"", b""
    kept = np.flatnonzero(features.points[:, 2] > 0)  # without depth they do not constrain the pose
    if len(kept) > most:
        kept = kept[np.linspace(0, len(kept) - 1, most).astype(np.int64)]
    order, places = packed_keypoints(features.px[kept], features.points[kept])
    return len(kept), places, np.ascontiguousarray(features.descriptors[kept][order], "<u8").tobytes()


def _descriptors(data: bytes) -> UInt64Array:
    return np.frombuffer(data, "<u8").reshape(-1, 4).astype(np.uint64)


@dataclass(frozen=True, slots=True)
class DepthSteps:
    """Depth steps that grow with the noise: multiples of σ(z) = constant + quadratic · z².

    Attributes:
        step_m: step at depth 0, metres.
        growth: growth of the step with squared depth, 1/m.
    """

    step_m: float
    growth: float

    @classmethod
    def of_noise(cls, noise: DepthNoise) -> DepthSteps:
        """Return steps of `DEPTH_SIGMAS` standard deviations."""
        step_m, growth = DEPTH_SIGMAS * noise.constant_m, DEPTH_SIGMAS * noise.quadratic_per_m
        return cls(max(step_m, _FINEST_M), max(growth, _LEAST_QUADRATIC))

    def numbers(self, depth_m: Float32Array) -> NDArray[np.uint16]:
        """Return the nearest step (h, w) of each depth, from 1 on; 0 for unknown depth.

        The integral of dz / (a + b z²) is arctan(z √(b / a)) / √(a b).
        """
        a, b = self.step_m, self.growth
        numbers = np.rint(np.arctan(depth_m * np.sqrt(b / a)) / np.sqrt(a * b))
        return np.asarray(np.where(depth_m > 0, np.maximum(numbers, 1), 0), np.uint16)

    def depth_m(self, numbers: NDArray[np.uint16]) -> Float32Array:
        """Return depth (h, w), metres, of steps."""
        a, b = self.step_m, self.growth
        # A damaged number may exceed the range of any depth.
        angle = np.minimum(numbers * np.sqrt(a * b), np.pi / 2 - 1e-6)
        return np.asarray(np.tan(angle) * np.sqrt(a / b), np.float32)


def grey_numbers(grey: Float32Array, step: int) -> NDArray[np.uint8]:
    """Return the nearest step (h, w) of each grey value from 0 to 255, from 1 on; 0 for unknown ones, at most 0."""
    return np.asarray(np.where(grey > 0, np.maximum(np.rint(grey / step), 1), 0), np.uint8)


def grey_of(numbers: NDArray[np.uint8], step: int) -> Float32Array:
    """Return grey values (h, w) of steps."""
    return np.asarray(np.minimum(numbers.astype(np.float32) * step, _BRIGHTEST), np.float32)


def halved(keyframe: Keyframe) -> Level:
    """Return the keyframe's images, halved until they are at most `WIDTH_PX` wide."""
    level = Level(keyframe.intrinsics, keyframe.depth_m, known_grey(keyframe))
    while level.depth_m.shape[1] > WIDTH_PX:
        level = coarser(level, 1)[1]
    return level


def packed_depth(numbers: NDArray[np.uint16]) -> bytes:
    """Return compressed depth steps (h, w), 0 if unknown.

    Each known step is coded by its difference from the previous known one in row order: 0, -1, 1, -2, … become 1, 2, 3,
    4, …, and unknown depth becomes 0. The codes are split into three byte planes.
    """
    is_known = numbers > 0
    step: NDArray[np.int32] = np.diff(numbers[is_known].astype(np.int32), prepend=0).astype(np.int32)
    codes = np.zeros(numbers.shape, np.int32)
    codes[is_known] = (step << 1 ^ step >> 31) + 1
    return _webp(np.dstack([codes >> 16, codes & 255, codes >> 8 & 255]).astype(np.uint8))


def unpacked_depth(code: bytes, most_px: Size = LARGEST_PX) -> NDArray[np.uint16]:
    """Return the steps packed by `packed_depth`. Raises MapError for invalid data or images larger than `most_px`."""
    planes = _decoded(code, most_px, 3, np.uint8)
    codes = planes[..., 0].astype(np.int32)
    for plane in (2, 1):  # in place: each copy of a large image takes 67 MB
        codes <<= 8
        codes |= planes[..., plane]
    is_known = codes > 0
    steps = codes[is_known] - 1
    depth = np.cumsum(steps >> 1 ^ -(steps & 1), dtype=np.int64)
    if len(depth) and not 0 < depth.min() <= depth.max() <= np.iinfo(np.uint16).max:
        raise MapError("its depth is out of range", fix=_DAMAGED)
    numbers = np.zeros(codes.shape, np.uint16)
    numbers[is_known] = depth
    return numbers


def packed_grey(numbers: NDArray[np.uint8]) -> bytes:
    """Return compressed grey steps (h, w)."""
    return _webp(numbers)


def unpacked_grey(code: bytes, most_px: Size = LARGEST_PX) -> NDArray[np.uint8]:
    """Return the steps packed by `packed_grey`. Raises as `unpacked_depth`."""
    return np.ascontiguousarray(_decoded(code, most_px, 3, np.uint8)[..., 0])


def _webp(image: NDArray[np.uint8]) -> bytes:
    written, code = cv2.imencode(".webp", image, _LOSSLESS)
    assert written
    return code.tobytes()


def _decoded(code: bytes, most_px: Size, dimensions: int, dtype: type) -> NDArray[Any]:
    """Return an image whose header states at most this width and height. Raises MapError."""
    image = picture_within(code, (min(most_px[0], LARGEST_PX[0]), min(most_px[1], LARGEST_PX[1])))
    if image is None or image.ndim != dimensions or image.dtype != dtype:
        raise MapError("an image of it cannot be read, or is larger than its camera's", fix=_DAMAGED)
    return image


# Stamp, intrinsics, step_m and growth of depth steps; bytes of depth, grey and code; number of keypoints (-1: unknown)
# and bytes of their positions; grey step. Descriptors come last, so that they can be read alone.
_HEAD = struct.Struct("<d4ddd5iB")
# Of records from before 2026-11-27.
_OLD_HEAD = struct.Struct("<d4ddd5i4xB")
_ORB_BYTES = 32
_MOST_KEYPOINTS = 100_000


# Keypoints are accurate to half a pixel, and their depth to millimetres. Depth in memory has steps of 0.2 mm, too.
_STEPS = np.array([1 / 16, 1 / 16, 0.0002, 0.0002, 0.0002])
_COLUMN = "<i4"
_LARGEST = 2**30
_BYTES = 5 * 4


def packed_keypoints(px: FloatArray, points: FloatArray) -> tuple[IntArray, bytes]:
    """Return the stored order (N,) of keypoints, and their packed positions: pixels (N, 2) and points (N, 3), metres.

    They are quantised and sorted by row, so that neighbours differ least.
    """
    numbers = np.rint(np.hstack([px, points]) / _STEPS).clip(-_LARGEST, _LARGEST).astype(_COLUMN)
    order = np.lexsort((numbers[:, 0], numbers[:, 1]))
    rows = numbers[order]
    return order, zlib.compress(b"".join(columns.packed(np.ascontiguousarray(column)) for column in rows.T))


def unpacked_keypoints(data: bytes, count: int) -> tuple[FloatArray, FloatArray]:
    """Return pixels (count, 2) and points (count, 3) packed by `packed_keypoints`. Raises MapError for invalid data."""
    expected = count * _BYTES
    flat = _inflated(data, expected)
    width = 4 * count
    numbers = [columns.unpacked(flat[at : at + width], _COLUMN) for at in range(0, expected, max(width, 1))]
    rows = np.reshape(numbers, (5, count)).T * _STEPS
    return rows[:, :2].copy(), rows[:, 2:].copy()


def _inflated(data: bytes, expected: int) -> bytes:
    """Decompress exactly the expected number of bytes of keypoints. Raises MapError for any other number."""
    try:
        flat = zlib.decompressobj().decompress(data, expected + 1)
    except zlib.error as error:
        raise MapError("its keypoints cannot be read", fix=_DAMAGED) from error
    if len(flat) != expected:
        raise MapError("it has another number of keypoints than stated", fix=_DAMAGED)
    return flat
