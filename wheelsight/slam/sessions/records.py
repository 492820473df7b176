"""What the records of a map hold, as bytes and back: keyframes, where they are, edges between them, moved poses.

Plain numbers in little-endian order and compressed images, and nothing that could do something. What is kept of a
keyframe is what another drive needs of it: images in steps that noise hides, and the keypoints that have depth.
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Sequence
from dataclasses import dataclass
from enum import IntEnum

import numpy as np

from wheelsight.errors import MapError
from wheelsight.geometry import FloatArray, IntArray, se3
from wheelsight.geometry.motion_kernels import is_definite
from wheelsight.keyframes import Keyframe, KeyframeFeatures, KeyframeId
from wheelsight.slam.graph import RelativePose
from wheelsight.slam.sessions import images
from wheelsight.slam.sessions.images import DepthSteps
from wheelsight.slam.sessions.settings import SessionSettings

_DAMAGED = "use another copy of the map"
# Stamp, intrinsics, both numbers of the steps of depth, the step of grey; bytes of both images, of the code, keypoints
# (-1: none are known) and bytes of where they are.
_KEYFRAME = struct.Struct("<d4ddd5i4x")
_PLACE = struct.Struct("<d?7x12d12d")
_MOTION, _COVARIANCE = 12, 36
_EDGE = np.dtype([("ends", "<i8", 2), ("is_loop", "<i8"), ("T", "<f8", _MOTION), ("C", "<f8", _COVARIANCE)])
_POSE = np.dtype([("number", "<i8"), ("T", "<f8", _MOTION)])
_ORB_BYTES, _KEYPOINT_BYTES = 32, 5 * 4
_MOST_KEYPOINTS = 100_000
_UNKNOWN = np.full((4, 4), np.nan)


class Kind(IntEnum):
    """Of records."""

    KEYFRAME = 1
    PLACE = 2
    EDGES = 3
    WITHDRAWN = 4
    POSES = 5


@dataclass(frozen=True, slots=True, eq=False)
class Place:
    """Where a keyframe was when it was kept.

    Attributes:
        stamp_s: of the keyframe, seconds.
        T_map_keyframe: (4, 4) by what was known then.
        T_odom_keyframe: (4, 4) in the frame that never jumps, or None.
    """

    stamp_s: float
    T_map_keyframe: FloatArray
    T_odom_keyframe: FloatArray | None = None


def pack_keyframe(keyframe: Keyframe, steps: DepthSteps, settings: SessionSettings) -> bytes:
    """A keyframe; `unpack_keyframe` gives back all but what steps, width and too many keypoints make less."""
    level = images.halved(keyframe, settings.width_px)
    depth = images.packed(steps.numbers(level.depth_m))
    grey = images.packed(images.grey_numbers(level.grey, settings.grey_step))
    code = b"" if keyframe.code is None else np.ascontiguousarray(keyframe.code, "<f8").tobytes()
    room = 1000 * settings.most_kb - _KEYFRAME.size - 1 - len(depth) - len(grey) - len(code)
    count, places, descriptors = _packed_features(keyframe.features, _MOST_KEYPOINTS)
    if len(places) + len(descriptors) > room:
        most = max(room // (_KEYPOINT_BYTES + _ORB_BYTES), settings.least_keypoints)
        count, places, descriptors = _packed_features(keyframe.features, most)
    sizes = (len(depth), len(grey), len(code), count, len(places))
    head = _KEYFRAME.pack(keyframe.stamp_s, *level.intrinsics, steps.step_m, steps.growth, *sizes)
    return b"".join([head, bytes([settings.grey_step]), depth, grey, code, places, descriptors])


def _packed_features(features: KeyframeFeatures | None, most: int) -> tuple[int, bytes, bytes]:
    """How many keypoints are kept, -1 for None; where they are; and their descriptors."""
    if features is None:
        return -1, b"", b""
    kept = np.flatnonzero(features.points[:, 2] > 0)  # without depth they tell no relative pose
    if len(kept) > most:
        kept = kept[np.linspace(0, len(kept) - 1, most).astype(np.int64)]
    rows = np.hstack([features.px[kept], features.points[kept]]).astype("<f4")
    descriptors = np.ascontiguousarray(features.descriptors[kept], "<u8")
    return len(kept), zlib.compress(rows.T.tobytes()), descriptors.tobytes()


def unpack_keyframe(content: bytes) -> Keyframe:
    """What `pack_keyframe` made. Raises MapError for what is none."""
    try:
        stamp_s, fx, fy, cx, cy, step_m, growth, *sizes = _KEYFRAME.unpack_from(content)
    except struct.error as error:
        raise MapError("is no keyframe", fix=_DAMAGED) from error
    depth_bytes, grey_bytes, code_bytes, count, place_bytes = sizes
    descriptor_bytes = max(count, 0) * _ORB_BYTES
    lengths = (depth_bytes, grey_bytes, code_bytes, place_bytes, descriptor_bytes)
    numbers = np.array([stamp_s, fx, fy, cx, cy, step_m, growth])
    is_sound = np.isfinite(numbers).all() and min(fx, fy, step_m, growth) > 0 and -1 <= count <= _MOST_KEYPOINTS
    if not is_sound or min(lengths) < 0 or _KEYFRAME.size + 1 + sum(lengths) != len(content) or code_bytes % 8:
        raise MapError("is no keyframe", fix=_DAMAGED)
    parts, at = [], _KEYFRAME.size + 1
    for length in lengths:
        parts.append(content[at : at + length])
        at += length
    depth = images.unpacked(parts[0], np.uint16)
    grey = images.unpacked(parts[1], np.uint8)
    if depth.shape != grey.shape:
        raise MapError("its images are of two sizes", fix=_DAMAGED)
    features = None if count < 0 else _features(count, parts[3], parts[4])
    straight = DepthSteps(step_m, growth).depth_m(depth), images.grey_of(grey, content[_KEYFRAME.size])
    made = Keyframe.of_images(stamp_s, np.array([fx, fy, cx, cy]), *straight, features)
    if not code_bytes:
        return made
    code = np.frombuffer(parts[2], "<f8").astype(float)
    return Keyframe(stamp_s, made.intrinsics, made.depth_png, made.grey_png, features, code)


def _features(count: int, places: bytes, descriptors: bytes) -> KeyframeFeatures:
    expected = count * _KEYPOINT_BYTES
    try:
        flat = zlib.decompressobj().decompress(places, expected + 1)
    except zlib.error as error:
        raise MapError("its keypoints cannot be read", fix=_DAMAGED) from error
    if len(flat) != expected:
        raise MapError("its keypoints are of another number than it says", fix=_DAMAGED)
    rows = np.frombuffer(flat, "<f4").reshape(5, count).T.astype(float)
    if not np.isfinite(rows).all():
        raise MapError("its keypoints are nowhere", fix=_DAMAGED)
    orb = np.frombuffer(descriptors, "<u8").reshape(count, 4).astype(np.uint64)
    return KeyframeFeatures(rows[:, :2].copy(), rows[:, 2:].copy(), orb)


def pack_place(place: Place) -> bytes:
    """Where a keyframe was."""
    T_odom = _UNKNOWN if place.T_odom_keyframe is None else place.T_odom_keyframe
    has_odom = place.T_odom_keyframe is not None
    return _PLACE.pack(place.stamp_s, has_odom, *_flat(place.T_map_keyframe), *_flat(T_odom))


def unpack_place(content: bytes) -> Place:
    """What `pack_place` made. Raises MapError."""
    if len(content) != _PLACE.size:
        raise MapError("is no place of a keyframe", fix=_DAMAGED)
    stamp_s, has_odom, *numbers = _PLACE.unpack(content)
    T_odom = _motions(np.array(numbers[_MOTION:]))[0] if has_odom else None
    return Place(stamp_s, _motions(np.array(numbers[:_MOTION]))[0], T_odom)


def pack_edges(edges: Sequence[RelativePose]) -> bytes:
    """Edges of the pose graph."""
    table = np.zeros(len(edges), _EDGE)
    for row, edge in zip(table, edges, strict=True):
        row["ends"], row["is_loop"] = (edge.first, edge.second), edge.is_loop
        row["T"], row["C"] = _flat(edge.T_first_second), edge.covariance.ravel()
    return table.tobytes()


def unpack_edges(content: bytes) -> tuple[RelativePose, ...]:
    """What `pack_edges` made. Raises MapError."""
    table = _table(content, _EDGE, "edges")
    T = _motions(table["T"])
    edges = []
    for row, T_first_second in zip(table, T, strict=True):
        first, second = (KeyframeId(int(end)) for end in row["ends"])
        C = np.array(row["C"], float).reshape(6, 6)
        if first == second or min(first, second) < 0 or not is_definite(C):
            raise MapError("holds an edge that is none", fix=_DAMAGED)
        edges.append(RelativePose(first, second, T_first_second, C, bool(row["is_loop"])))
    return tuple(edges)


def pack_poses(numbers: Sequence[int] | IntArray, T_map_keyframe: FloatArray) -> bytes:
    """Keyframes (K,) and where they are by now (K, 4, 4)."""
    table = np.zeros(len(numbers), _POSE)
    table["number"], table["T"] = numbers, T_map_keyframe[:, :3].reshape(-1, _MOTION)
    return table.tobytes()


def unpack_poses(content: bytes) -> tuple[IntArray, FloatArray]:
    """What `pack_poses` made. Raises MapError."""
    table = _table(content, _POSE, "poses")
    return table["number"].astype(np.int64), _motions(table["T"])


def pack_numbers(numbers: Sequence[int]) -> bytes:
    """Such as those of edges that do not hold any more."""
    return np.asarray(numbers, "<i8").tobytes()


def unpack_numbers(content: bytes) -> tuple[int, ...]:
    """What `pack_numbers` made. Raises MapError."""
    return tuple(_table(content, np.dtype("<i8"), "numbers").tolist())


def _table(content: bytes, dtype: np.dtype, what: str) -> np.ndarray:
    if len(content) % dtype.itemsize:
        raise MapError(f"holds {len(content)} bytes, which are no {what}", fix=_DAMAGED)
    return np.frombuffer(content, dtype)


def _flat(T: FloatArray) -> FloatArray:
    return np.asarray(T, float)[:3].ravel()


def _motions(rows: FloatArray) -> FloatArray:
    """(K, 4, 4) of their upper three rows, flat. Raises MapError for what are no rigid motions."""
    T = np.zeros((rows.size // _MOTION, 4, 4))
    T[:, :3], T[:, 3, 3] = rows.reshape(-1, 3, 4), 1.0
    if len(T) and not np.all(se3.is_valid(T, tolerance=1e-4)):
        raise MapError("holds poses that are no rigid motions", fix=_DAMAGED)
    return T
