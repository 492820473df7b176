"""`save_map` and `load_map` write and read map files. Files of versions 1 and 2 can be read.

A file has a line with the format's name, a line with a JSON header, and the compressed surfels. These are the columns
of `mapping.columns`, in the order of the header's `columns`, and the poses T_map_keyframe (keyframes, 4, 4) as float64.
They are compressed by LZMA in an .xz container, with little-endian numbers. All is in the frame that the header names,
which is `map`.

Versions 1 and 2 have plain arrays instead, row by row, in the order of the header's `fields`. Version 1 has no
keyframes and no frame name; its surfels have no keyframe.
"""

from __future__ import annotations

import json
import lzma
import math
import zlib
from collections.abc import Iterator
from dataclasses import fields
from pathlib import Path
from typing import Any

import numpy as np

from wheelsight.core.errors import MapError
from wheelsight.core.files import StrPath, atomic_write
from wheelsight.core.geometry import FloatArray, se3
from wheelsight.core.inputs import Kind, parse_json, read_bytes
from wheelsight.core.settings.base import checked_settings, split_removed
from wheelsight.mapping.columns import COLUMNS, ColumnFiles, columns_of, surfels_of, unpacked
from wheelsight.mapping.surfels import FRAME, SurfelMap, Surfels, SurfelSettings

FIRST_FORMAT, SECOND_FORMAT = "wheelsight-map-1", "wheelsight-map-2"
# Fields of version 2: name, type and number of columns; 0 for a flat array.
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
_COUNTS, _POSE_BYTES = ("surfels", "keyframes"), 16 * 8
assert tuple(name for name, _, _ in _FIELDS) == tuple(field.name for field in fields(Surfels))


FORMAT = "wheelsight-map-3"
_VERSIONS = (FORMAT, SECOND_FORMAT, FIRST_FORMAT)
_LONGEST_HEADER = 1 << 16
_NO_MAP = "give a file that `save_map` wrote"
# Beyond 16 km, float32 is coarser than a millimetre. The other limits are far above the values of any map.
_LARGEST = {"position": 16_000.0, "normal": 1.01, "radius_m": 100.0, "color": 1000.0, "grey": 1000.0}
_LARGEST |= {"confidence": 1e9, "variance_m2": 1e4, "first_s": 1e20, "last_s": 1e20}
_FILE = Kind("a map", most_mb=2000, fix=_NO_MAP)
_DAMAGED = "it is damaged or cut short: use another copy"
# More than the largest file of version 2 had, so that a few damaged bytes do not allocate all memory.
_MOST = {"surfels": 30_000_000, "keyframes": 10_000_000}
# Limits per compressed byte, plus a constant for small maps. A surfel takes 6 bytes and a pose 100; a byte of
# compressed zeros expands to 7000.
_MOST_PER_BYTE, _MOST_BESIDES = {"surfels": 2.0, "keyframes": 0.1}, {"surfels": 100_000, "keyframes": 10_000}
# Columns are mostly noise, which a longer search hardly compresses: preset 6 takes eight times as long for 1 %.
_COMPRESSION = {
    "id": lzma.FILTER_LZMA2,
    "preset": 0,
    "dict_size": 1 << 16,
    "lc": 4,
    "lp": 0,
    "pb": 0,
    "mode": lzma.MODE_NORMAL,
    "mf": lzma.MF_HC3,
    "nice_len": 273,
    "depth": 1,
}
_MOST_MEMORY = 16 << 20
_COLUMNS_AT_ONCE = 1 << 16


def save_map(surfel_map: SurfelMap, path: StrPath) -> None:
    """Write a whole map, atomically, quantised as `mapping.columns` describes. Raises OutputError.

    It is written keyframe by keyframe, since all columns at once would take half as much memory as the map.
    """
    path = Path(path)
    T_map_keyframe = np.ascontiguousarray(surfel_map.T_map_keyframe, "<f8")
    with atomic_write(path, "wb") as stream:
        count, rules = 0, (surfel_map.stamp_s, surfel_map.settings.stable_confidence)
        compressor = lzma.LZMACompressor(lzma.FORMAT_XZ, lzma.CHECK_NONE, filters=[_COMPRESSION])
        with ColumnFiles(path.parent) as files:
            for keyframes in _intervals(surfel_map, len(T_map_keyframe)):
                pieces = list(surfel_map.parts(keyframes=keyframes))
                arrays = (np.concatenate([getattr(piece, name) for piece in pieces]) for name in Surfels.__slots__)
                columns = columns_of(Surfels(*arrays), *rules)
                files.add(columns)
                count += len(columns["keyframe"])
            compressed = files.compressed(compressor)
        # In memory, since the header before it has its length.
        body = b"".join([compressed, compressor.compress(T_map_keyframe.tobytes()), compressor.flush()])
        header = {
            "frame": FRAME,
            "surfels": count,
            "columns": [list(column) for column in COLUMNS],
            "keyframes": len(T_map_keyframe),
            "stamp_s": surfel_map.stamp_s if math.isfinite(surfel_map.stamp_s) else None,
            "dropped": surfel_map.dropped,
            "bytes": len(body),
            "crc32": zlib.crc32(body),
            "settings": surfel_map.settings.model_dump(),
        }
        stream.write(f"{FORMAT}\n{json.dumps(header)}\n".encode())
        stream.write(body)


def _intervals(surfel_map: SurfelMap, keyframes: int) -> Iterator[tuple[int, int]]:
    """Yield intervals of keyframes, from -1 for none on, each with about `_COLUMNS_AT_ONCE` surfels."""
    counts = np.zeros(keyframes + 1, np.int64)
    for part in surfel_map.parts():
        counts += np.bincount(part.keyframe + 1, minlength=keyframes + 1)
    begin = 0
    while begin <= keyframes:
        end = int(np.searchsorted(np.cumsum(counts[begin:]), _COLUMNS_AT_ONCE, "right"))
        end = min(begin + max(end, 1), keyframes + 1)
        if counts[begin:end].any():
            yield begin - 1, end - 1
        begin = end


def load_map(path: StrPath) -> SurfelMap:
    """Read a whole map.

    Raises MapError if the file cannot be read, is not a map, of a later version, truncated, damaged, or has values that
    no surfel or keyframe has.
    """
    path = Path(path)
    data = read_bytes(path, _FILE, MapError)
    try:
        version, header, body = _split(data)
        known, _ = split_removed(dict(header["settings"]), "surfels")
        settings = checked_settings(SurfelSettings, known, MapError, "settings: ", _DAMAGED)
        surfels, T_map_keyframe = _contents(version, header, body, settings)
        del data, body  # in old versions, as large as the map
        _refuse_impossible(surfels, T_map_keyframe)
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
    except MapError as error:
        raise MapError(error.problem, path=path, fix=error.fix) from error
    except (KeyError, TypeError, ValueError, OverflowError) as error:
        raise MapError(f"its header is invalid: {type(error).__name__}", path=path, fix=_DAMAGED) from error


def _split(data: bytes) -> tuple[str, dict[str, Any], memoryview]:
    """Return the version, the header, and the body."""
    name, _, rest = data[:_LONGEST_HEADER].partition(b"\n")
    version = name[:40].decode("ascii", "replace")
    if version not in _VERSIONS or len(name) > len(version):
        if name.startswith(FORMAT.rpartition("-")[0].encode()):
            raise MapError(f"is of version {version!r}, not {FORMAT!r}", fix=_NO_MAP)
        raise MapError("is no map", fix=_NO_MAP)
    text, newline, _ = rest.partition(b"\n")
    if not newline:
        raise MapError("ends in its header", fix=_DAMAGED)
    try:
        header = parse_json(text)
    except ValueError as error:
        raise MapError(f"its header is invalid: {error}", fix=_DAMAGED) from error
    if not isinstance(header, dict):
        raise MapError("its header is not a JSON object", fix=_DAMAGED)
    if version == FIRST_FORMAT:  # without these entries
        header |= {"frame": FRAME, "keyframes": 0}
    known = COLUMNS if version == FORMAT else _FIELDS[:-1] if version == FIRST_FORMAT else _FIELDS
    is_known = header["columns" if version == FORMAT else "fields"] == [list(column) for column in known]
    if header["frame"] != FRAME or not is_known or not all(_is_count(header[name], _MOST[name]) for name in _COUNTS):
        raise MapError(f"its frame, fields or counts are not those of {version}", fix=_DAMAGED)
    return version, header, memoryview(data)[len(name) + len(text) + 2 :]


def _is_count(value: object, most: float = math.inf) -> bool:
    return type(value) is int and 0 <= value <= most


def _contents(
    version: str, header: dict[str, Any], body: memoryview, settings: SurfelSettings
) -> tuple[Surfels, FloatArray]:
    """Return surfels and T_map_keyframe (keyframes, 4, 4)."""
    if version != FORMAT:
        return _old_contents(header, body)
    if len(body) != header["bytes"]:
        raise MapError(f"holds {len(body)} bytes of surfels and keyframes, not {header['bytes']}", fix=_DAMAGED)
    if zlib.crc32(body) != header["crc32"]:
        raise MapError("its checksum is wrong", fix=_DAMAGED)
    for name in _COUNTS:
        if header[name] > _MOST_BESIDES[name] + _MOST_PER_BYTE[name] * len(body):
            raise MapError(f"states {header[name]:,} {name} in {len(body):,} bytes", fix=_DAMAGED)
    lengths = [header["surfels"] * np.dtype(dtype).itemsize for _, dtype in COLUMNS]
    *columns, poses = _decompressed(body, [*lengths, header["keyframes"] * _POSE_BYTES])
    found = {name: unpacked(column, dtype) for (name, dtype), column in zip(COLUMNS, columns, strict=True)}
    stamp_s = -math.inf if header["stamp_s"] is None else float(header["stamp_s"])
    T_map_keyframe = np.frombuffer(poses, "<f8").reshape(-1, 4, 4).astype(float)
    return surfels_of(found, stamp_s, settings.stable_confidence), T_map_keyframe


def _decompressed(body: memoryview, lengths: list[int]) -> Iterator[bytes]:
    """Yield pieces of the given lengths. Raises MapError if there is more or less data."""
    decompressor = lzma.LZMADecompressor(lzma.FORMAT_XZ, _MOST_MEMORY)
    given: bytes | memoryview = body
    try:
        for length in lengths:
            piece = b""
            if length and not decompressor.eof:  # repeated requests of 0 bytes would raise an error
                piece, given = decompressor.decompress(given, length), b""
            if len(piece) != length:
                raise MapError("it has fewer surfels and keyframes than stated", fix=_DAMAGED)
            yield piece
        if not decompressor.eof and decompressor.decompress(given, 1):
            raise MapError("it has more surfels and keyframes than stated", fix=_DAMAGED)
    except lzma.LZMAError as error:
        raise MapError(f"its surfels cannot be unpacked: {error}", fix=_DAMAGED) from error
    if not decompressor.eof or decompressor.unused_data:
        raise MapError("it has more surfels and keyframes than stated", fix=_DAMAGED)


def _old_contents(header: dict[str, Any], body: memoryview) -> tuple[Surfels, FloatArray]:
    """Return surfels and T_map_keyframe (keyframes, 4, 4) of versions 1 and 2. Raises MapError."""
    n, keyframes, known = header["surfels"], header["keyframes"], header["fields"]
    expected = n * sum(np.dtype(dtype).itemsize * max(columns, 1) for _, dtype, columns in known)
    expected += keyframes * _POSE_BYTES
    if len(body) != expected:
        raise MapError(f"holds {len(body)} bytes of surfels and keyframes, not {expected}", fix=_DAMAGED)
    if zlib.crc32(body) != header["crc32"]:
        raise MapError("its checksum is wrong", fix=_DAMAGED)
    arrays, begin = [], 0
    for _, dtype, columns in known:
        flat = np.frombuffer(body, dtype, n * max(columns, 1), begin)
        begin += flat.nbytes
        arrays.append(flat.reshape(n, columns).copy() if columns else flat.copy())
    if len(known) < len(_FIELDS):
        arrays.append(np.full(n, -1, np.int32))
    return Surfels(*arrays), np.frombuffer(body, "<f8", 16 * keyframes, begin).reshape(-1, 4, 4).astype(float)


def _refuse_impossible(surfels: Surfels, T_map_keyframe: FloatArray) -> None:
    """Raise MapError for values that no surfel or keyframe has."""
    for name, largest in _LARGEST.items():
        values = getattr(surfels, name)
        if not np.isfinite(values).all():
            raise MapError(f"{name} holds numbers that are not finite", fix=_DAMAGED)
        if len(values) and np.abs(values).max() > largest:
            raise MapError(f"{name} holds numbers beyond {largest:g}", fix=_DAMAGED)
    for name in ("radius_m", "confidence", "variance_m2"):
        if getattr(surfels, name).min(initial=1.0) <= 0:
            raise MapError(f"{name} holds numbers that are not positive", fix=_DAMAGED)
    if np.abs(np.linalg.norm(surfels.normal, axis=1) - 1).max(initial=0.0) > 1e-3:
        raise MapError("normal holds vectors that are not of length 1", fix=_DAMAGED)
    if not np.isfinite(T_map_keyframe).all() or not np.all(se3.is_valid(T_map_keyframe, tolerance=1e-4)):
        raise MapError("its keyframes have poses that are no rigid motions", fix=_DAMAGED)
    numbers = surfels.keyframe
    if len(numbers) and not (numbers.min() >= -1 and numbers.max() < len(T_map_keyframe)):
        raise MapError(f"keyframe holds numbers beyond the {len(T_map_keyframe)} there are", fix=_DAMAGED)
