"""Bodies of map files of versions 1 and 2: plain arrays, row by row, in the order of the header's `fields`."""

from __future__ import annotations

import zlib
from dataclasses import fields
from typing import Any

import numpy as np

from wheelsight.errors import MapError
from wheelsight.geometry import FloatArray
from wheelsight.mapping.values import FRAME, Surfels

FIRST_FORMAT, SECOND_FORMAT = "wheelsight-map-1", "wheelsight-map-2"
# Name, type and number of columns; 0 for a flat array.
_FIELDS: tuple[tuple[str, str, int], ...] = (
    ("position", "<f4", 3),
    ("normal", "<f4", 3),
    ("radius_m", "<f4", 0),
    ("color", "<f4", 3),
    ("grey", "<f4", 0),
    ("confidence", "<f4", 0),
    ("variance_m2", "<f4", 0),
    ("first_s", "<f8", 0),
    ("last_s", "<f8", 0),
    ("keyframe", "<i4", 0),
)
_POSE_BYTES = 16 * 8
assert tuple(name for name, _, _ in _FIELDS) == tuple(field.name for field in fields(Surfels))


def known_fields(header: dict[str, Any], version: str) -> bool:
    """Whether a header has the fields of its version; to one of version 1 what that does not say is added."""
    known = _FIELDS
    if version == FIRST_FORMAT:
        header |= {"frame": FRAME, "keyframes": 0}
        known = _FIELDS[:-1]
    return bool(header["fields"] == [list(field) for field in known])


def contents_of(header: dict[str, Any], body: memoryview, damaged: str) -> tuple[Surfels, FloatArray]:
    """Surfels, and T_map_keyframe (keyframes, 4, 4). Raises MapError, with what to do where it is damaged."""
    n, keyframes, known = header["surfels"], header["keyframes"], header["fields"]
    expected = n * sum(np.dtype(dtype).itemsize * max(columns, 1) for _, dtype, columns in known)
    expected += keyframes * _POSE_BYTES
    if len(body) != expected:
        raise MapError(f"holds {len(body)} bytes of surfels and keyframes, not {expected}", fix=damaged)
    if zlib.crc32(body) != header["crc32"]:
        raise MapError("its checksum is wrong", fix=damaged)
    arrays, begin = [], 0
    for _, dtype, columns in known:
        flat = np.frombuffer(body, dtype, n * max(columns, 1), begin)
        begin += flat.nbytes
        arrays.append(flat.reshape(n, columns).copy() if columns else flat.copy())
    if len(known) < len(_FIELDS):
        arrays.append(np.full(n, -1, np.int32))
    return Surfels(*arrays), np.frombuffer(body, "<f8", 16 * keyframes, begin).reshape(-1, 4, 4).astype(float)
