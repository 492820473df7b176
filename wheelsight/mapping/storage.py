"""Maps in files: one line that names the format, one line of JSON that says what follows, and then plain arrays.

The arrays are those of `Surfels`, one after the other in the order of the header's `fields`, row by row, and then the
poses T_map_keyframe (keyframes, 4, 4) of float64; numbers are in little-endian order. Whoever can read JSON and raw
numbers can read a map. All of it is in the frame that the header names, which is `map`.

Files of version 1 have neither keyframes nor the name of a frame; their surfels hang on no keyframe.
"""

from __future__ import annotations

import json
import math
import zlib
from collections.abc import Iterable, Iterator
from dataclasses import fields
from pathlib import Path
from typing import Any

import numpy as np

from wheelsight.errors import MapError
from wheelsight.files import StrPath, atomic_write
from wheelsight.geometry import FloatArray, IntArray, se3
from wheelsight.inputs import Kind, parse_json, read_bytes
from wheelsight.inputs.settings import checked_settings
from wheelsight.mapping.settings import SurfelSettings
from wheelsight.mapping.surfels import SurfelMap
from wheelsight.mapping.values import FRAME, Surfels

FORMAT = "wheelsight-map-2"
_FIRST_FORMAT = "wheelsight-map-1"
_LONGEST_HEADER = 1 << 16
_NO_MAP = "give a file that `save_map` wrote"
# Beyond 16 km, float32 no longer tells millimetres apart; the others are far beyond what a map ever holds.
_LARGEST = {"position": 16_000.0, "normal": 1.01, "radius_m": 100.0, "color": 1000.0, "grey": 1000.0}
_LARGEST |= {"confidence": 1e9, "variance_m2": 1e4, "first_s": 1e20, "last_s": 1e20}
_FILE = Kind("a map", most_mb=2000, fix=_NO_MAP)
_DAMAGED = "it is damaged or cut short: use another copy"
# Name, type and number of columns; 0 for a flat array.
_FIELDS = (
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
# Settings that files of before have, and that mean nothing now.
_RETIRED = ("beyond_share",)
_COUNTS, _POSE_BYTES = ("surfels", "keyframes"), 16 * 8
assert tuple(name for name, _, _ in _FIELDS) == tuple(field.name for field in fields(Surfels))


def save_map(surfel_map: SurfelMap, path: StrPath) -> None:
    """Write a whole map, atomically. Raises OutputError."""
    path = Path(path)
    surfels = surfel_map.surfels()
    # Sorted, so that equal maps are equal files, however their surfels came to be where they lie in memory.
    order = np.lexsort(surfels.position.T)
    T_map_keyframe = np.ascontiguousarray(surfel_map.T_map_keyframe, "<f8")
    header = {
        "frame": FRAME,
        "surfels": len(surfels.grey),
        "fields": [[name, dtype, columns] for name, dtype, columns in _FIELDS],
        "keyframes": len(surfel_map.T_map_keyframe),
        "stamp_s": surfel_map.stamp_s if math.isfinite(surfel_map.stamp_s) else None,
        "dropped": surfel_map.dropped,
        "crc32": _crc(_sorted(surfels, order, T_map_keyframe)),
        "settings": surfel_map.settings.model_dump(),
    }
    with atomic_write(path, "wb") as stream:
        stream.write(f"{FORMAT}\n{json.dumps(header)}\n".encode())
        for array in _sorted(surfels, order, T_map_keyframe):
            stream.write(array.data)


def _sorted(surfels: Surfels, order: IntArray, T_map_keyframe: FloatArray) -> Iterator[np.ndarray]:
    """The arrays of a file, one at a time: all together would take as much memory as the map once more."""
    for name, dtype, _ in _FIELDS:
        yield np.ascontiguousarray(getattr(surfels, name)[order], dtype)
    yield T_map_keyframe


def load_map(path: StrPath) -> SurfelMap:
    """Read a whole map.

    Raises:
        MapError: naming the file: it cannot be read, is no map, of a later version, cut short, damaged, or holds
            numbers that no surfel or keyframe has.
    """
    path = Path(path)
    data = read_bytes(path, _FILE, MapError)
    try:
        header, body = _split(data)
        contents = _contents(header, body)
        del data, body  # as large as the map
        return _map_of(header, *contents)
    except MapError as error:
        raise MapError(error.problem, path=path, fix=error.fix) from error
    except (KeyError, TypeError, ValueError, OverflowError) as error:
        raise MapError(f"its header is not one: {type(error).__name__}", path=path, fix=_DAMAGED) from error


def _split(data: bytes) -> tuple[dict[str, Any], memoryview]:
    """Header, as the present version has it, and all that follows."""
    name, _, rest = data[:_LONGEST_HEADER].partition(b"\n")
    if name not in (FORMAT.encode(), _FIRST_FORMAT.encode()):
        if name.startswith(FORMAT.rpartition("-")[0].encode()):
            raise MapError(f"is of version {name[:40].decode('ascii', 'replace')!r}, not {FORMAT!r}", fix=_NO_MAP)
        raise MapError("is no map", fix=_NO_MAP)
    text, newline, _ = rest.partition(b"\n")
    if not newline:
        raise MapError("ends in its header", fix=_DAMAGED)
    try:
        header = parse_json(text)
    except ValueError as error:
        raise MapError(f"its header is not one: {error}", fix=_DAMAGED) from error
    if not isinstance(header, dict):
        raise MapError("its header is no object", fix=_DAMAGED)
    if name == _FIRST_FORMAT.encode():
        header |= {"frame": FRAME, "keyframes": 0}
    is_known = header["fields"] == [list(field) for field in _fields_of(name)]
    if header["frame"] != FRAME or not is_known or not all(_is_count(header[name]) for name in _COUNTS):
        raise MapError(f"its frame, fields or counts are not those of {name.decode()}", fix=_DAMAGED)
    return header, memoryview(data)[len(name) + len(text) + 2 :]


def _fields_of(name: bytes) -> tuple[tuple[str, str, int], ...]:
    return _FIELDS if name == FORMAT.encode() else _FIELDS[:-1]


def _is_count(value: object) -> bool:
    return type(value) is int and value >= 0


def _contents(header: dict[str, Any], body: memoryview) -> tuple[Surfels, FloatArray]:
    """Surfels, and T_map_keyframe (keyframes, 4, 4)."""
    n, keyframes, fields = header["surfels"], header["keyframes"], header["fields"]
    expected = n * sum(np.dtype(dtype).itemsize * max(columns, 1) for _, dtype, columns in fields)
    expected += keyframes * _POSE_BYTES
    if len(body) != expected:
        raise MapError(f"holds {len(body)} bytes of surfels and keyframes, not {expected}", fix=_DAMAGED)
    if zlib.crc32(body) != header["crc32"]:
        raise MapError("its checksum is wrong", fix=_DAMAGED)
    arrays, begin = [], 0
    for _, dtype, columns in fields:
        flat = np.frombuffer(body, dtype, n * max(columns, 1), begin)
        begin += flat.nbytes
        arrays.append(flat.reshape(n, columns).copy() if columns else flat.copy())
    if len(fields) < len(_FIELDS):
        arrays.append(np.full(n, -1, np.int32))
    surfels = Surfels(*arrays)
    T_map_keyframe = np.frombuffer(body, "<f8", 16 * keyframes, begin).reshape(-1, 4, 4).astype(float)
    _refuse_impossible(surfels)
    _refuse_wrong_keyframes(surfels, T_map_keyframe)
    return surfels, T_map_keyframe


def _refuse_impossible(surfels: Surfels) -> None:
    for name, largest in _LARGEST.items():
        values = getattr(surfels, name)
        if not np.isfinite(values).all():
            raise MapError(f"{name} holds numbers that are not finite", fix=_DAMAGED)
        if len(values) and np.abs(values).max() > largest:
            raise MapError(f"{name} holds numbers beyond {largest:g}", fix=_DAMAGED)
    if len(surfels.grey) == 0:
        return
    for name in ("radius_m", "confidence", "variance_m2"):
        if getattr(surfels, name).min() <= 0:
            raise MapError(f"{name} holds numbers that are not positive", fix=_DAMAGED)
    if np.abs(np.linalg.norm(surfels.normal, axis=1) - 1).max() > 1e-3:
        raise MapError("normal holds vectors that are not of length 1", fix=_DAMAGED)


def _refuse_wrong_keyframes(surfels: Surfels, T_map_keyframe: FloatArray) -> None:
    if not np.isfinite(T_map_keyframe).all() or not np.all(se3.is_valid(T_map_keyframe, tolerance=1e-4)):
        raise MapError("its keyframes have poses that are no rigid motions", fix=_DAMAGED)
    numbers = surfels.keyframe
    if len(numbers) and not (numbers.min() >= -1 and numbers.max() < len(T_map_keyframe)):
        raise MapError(f"keyframe holds numbers beyond the {len(T_map_keyframe)} there are", fix=_DAMAGED)


def _map_of(header: dict[str, Any], surfels: Surfels, T_map_keyframe: FloatArray) -> SurfelMap:
    told = {name: value for name, value in dict(header["settings"]).items() if name not in _RETIRED}
    settings = checked_settings(SurfelSettings, told, MapError, "settings: ", _DAMAGED)
    stamp_s, dropped, n = header["stamp_s"], header["dropped"], len(surfels.grey)
    if not _is_count(dropped):
        raise MapError(f"dropped is {dropped!r}, not a count", fix=_DAMAGED)
    stamp_s = -math.inf if stamp_s is None else float(stamp_s)
    if math.isnan(stamp_s) or (n and (surfels.last_s.max() > stamp_s or (surfels.first_s > surfels.last_s).any())):
        raise MapError("its surfels were seen after it ends, or before they were first seen", fix=_DAMAGED)
    surfel_map = SurfelMap(settings)
    surfel_map.restore(dropped, T_map_keyframe)
    if surfel_map.add(surfels, stamp_s) != n:
        raise MapError(f"{n} surfels find no room in a map of {settings.max_surfels}", fix=_DAMAGED)
    return surfel_map


def _crc(arrays: Iterable[np.ndarray]) -> int:
    crc = 0
    for array in arrays:
        crc = zlib.crc32(array.data, crc)
    return crc
