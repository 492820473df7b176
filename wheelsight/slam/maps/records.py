"""Binary records of a map other than keyframes: initial poses of keyframes, edges, and changed poses.

Numbers are little-endian.
"""

from __future__ import annotations

import struct
from collections.abc import Sequence
from dataclasses import dataclass
from enum import IntEnum

import numpy as np

from wheelsight.core.errors import MapError
from wheelsight.core.geometry import FloatArray, IntArray, se3
from wheelsight.core.geometry.motion_kernels import is_definite
from wheelsight.core.keyframes import KeyframeId
from wheelsight.slam.graph import RelativePose

_DAMAGED = "use another copy of the map"
_PLACE = struct.Struct("<d?7x12d12d")
_MOTION, _COVARIANCE = 12, 36
_EDGE = np.dtype([("ends", "<i8", 2), ("is_loop", "<i8"), ("T", "<f8", _MOTION), ("C", "<f8", _COVARIANCE)])
_POSE = np.dtype([("number", "<i8"), ("T", "<f8", _MOTION)])
# Above these limits, sums of squares overflow. No robot drives 1000 km within a map.
_FARTHEST_M, _LARGEST_VARIANCE = 1e6, 1e18
_UNKNOWN = np.full((4, 4), np.nan)


class RecordKind(IntEnum):
    """Kinds of records. Maps from before 2026-11-27 have `FIRST_KEYFRAME`."""

    FIRST_KEYFRAME = 1
    PLACE = 2
    EDGES = 3
    WITHDRAWN = 4
    POSES = 5
    KEYFRAME = 6


@dataclass(frozen=True, slots=True, eq=False)
class Place:
    """Pose of a keyframe when it was added.

    Attributes:
        stamp_s: stamp of the keyframe, seconds.
        T_map_keyframe: (4, 4) at that time.
        T_odom_keyframe: (4, 4) pose in odom, or None.
    """

    stamp_s: float
    T_map_keyframe: FloatArray
    T_odom_keyframe: FloatArray | None = None


def pack_place(place: Place) -> bytes:
    """Return the record of a place."""
    T_odom = _UNKNOWN if place.T_odom_keyframe is None else place.T_odom_keyframe
    has_odom = place.T_odom_keyframe is not None
    return _PLACE.pack(place.stamp_s, has_odom, *_flat(place.T_map_keyframe), *_flat(T_odom))


def unpack_place(content: bytes) -> Place:
    """Return the place of a record. Raises MapError."""
    if len(content) != _PLACE.size:
        raise MapError("is no place of a keyframe", fix=_DAMAGED)
    stamp_s, has_odom, *numbers = _PLACE.unpack(content)
    if not np.isfinite(stamp_s):
        raise MapError("is a keyframe of no time", fix=_DAMAGED)
    T_odom = _motions(np.array(numbers[_MOTION:]))[0] if has_odom else None
    return Place(stamp_s, _motions(np.array(numbers[:_MOTION]))[0], T_odom)


def pack_edges(edges: Sequence[RelativePose]) -> bytes:
    """Return the record of edges."""
    table = np.zeros(len(edges), _EDGE)
    for row, edge in zip(table, edges, strict=True):
        row["ends"], row["is_loop"] = (edge.first, edge.second), edge.is_loop
        row["T"], row["C"] = _flat(edge.T_first_second), edge.covariance.ravel()
    return table.tobytes()


def unpack_edges(content: bytes) -> tuple[RelativePose, ...]:
    """Return the edges of a record. Raises MapError."""
    table = _table(content, _EDGE, "edges")
    T = _motions(table["T"])
    edges = []
    for row, T_first_second in zip(table, T, strict=True):
        first, second = (KeyframeId(int(end)) for end in row["ends"])
        C = np.array(row["C"], float).reshape(6, 6)
        is_sound = first != second and min(first, second) >= 0 and bool((np.abs(C) < _LARGEST_VARIANCE).all())
        if not is_sound or not is_definite(C):
            raise MapError("holds an invalid edge", fix=_DAMAGED)
        edges.append(RelativePose(first, second, T_first_second, C, bool(row["is_loop"])))
    return tuple(edges)


def pack_poses(numbers: Sequence[int] | IntArray, T_map_keyframe: FloatArray) -> bytes:
    """Return the record of keyframe numbers (K,) and poses (K, 4, 4)."""
    table = np.zeros(len(numbers), _POSE)
    table["number"], table["T"] = numbers, T_map_keyframe[:, :3].reshape(-1, _MOTION)
    return table.tobytes()


def unpack_poses(content: bytes) -> tuple[IntArray, FloatArray]:
    """Return the numbers and poses of a record. Raises MapError."""
    table = _table(content, _POSE, "poses")
    return table["number"].astype(np.int64), _motions(table["T"])


def pack_numbers(numbers: Sequence[int]) -> bytes:
    """Return the record of numbers, such as those of withdrawn edges."""
    return np.asarray(numbers, "<i8").tobytes()


def unpack_numbers(content: bytes) -> tuple[int, ...]:
    """Return the numbers of a record. Raises MapError."""
    return tuple(_table(content, np.dtype("<i8"), "numbers").tolist())


def _table(content: bytes, dtype: np.dtype, what: str) -> np.ndarray:
    if len(content) % dtype.itemsize:
        raise MapError(f"holds {len(content)} bytes, which are no {what}", fix=_DAMAGED)
    return np.frombuffer(content, dtype)


def _flat(T: FloatArray) -> FloatArray:
    return np.asarray(T, float)[:3].ravel()


def _motions(rows: FloatArray) -> FloatArray:
    """Return poses (K, 4, 4) from their upper three rows, flat. Raises MapError for invalid ones."""
    T = np.zeros((rows.size // _MOTION, 4, 4))
    T[:, :3], T[:, 3, 3] = rows.reshape(-1, 3, 4), 1.0
    if not (np.abs(rows) < _FARTHEST_M).all() or (len(T) and not se3.is_valid(T, tolerance=1e-4)):
        raise MapError("holds poses that are no rigid motions", fix=_DAMAGED)
    return T
