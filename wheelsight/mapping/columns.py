"""Quantized columns of surfels as in map files, and their buffers on disk.

The steps are far below a depth camera's accuracy:

| column | content |
|---|---|
| `keyframe` | number of the keyframe, -1 for none |
| `normal_u`, `normal_v` | normal in octahedral coordinates, from -127 to 127 |
| `radius` | 16 · log2 of the radius over 1 mm |
| `across_1`, `across_2` | position along the two axes after the normal's main axis, in steps of 0.5 mm · 2^e |
| `along` | position along the normal's main axis, in steps of 0.5 mm |
| `red_green`, `green`, `blue_green`, `grey` | colours minus green, green and grey; -1 if unknown |
| `confidence` | 4 · log2 of the confidence over that of stable surfels; at least 0 if stable |
| `variance` | 4 · log2 of the variance over 1 mm² |
| `first_age`, `last_age` | half seconds from the first and last observation to the map's time |

The normal's main axis is the nearest one, and e is radius // 16 - 1, at least 0: the step is at most a quarter of the
radius. The position is first rounded across that axis. Then the surfel slides back into its own plane, and is rounded
along the axis, so that a surface does not move.
"""

from __future__ import annotations

import lzma
import tempfile
from contextlib import ExitStack
from pathlib import Path
from types import TracebackType
from typing import IO, Any, Self

import numpy as np
from numpy.typing import NDArray

from wheelsight.core.geometry import ByteArray, Float32Array, FloatArray, IntArray
from wheelsight.mapping.surfels import Surfels

# Name and type, in the order of the file: positions are decoded from the columns before them.
COLUMNS = (
    ("keyframe", "<i4"),
    ("normal_u", "<i1"),
    ("normal_v", "<i1"),
    ("radius", "<i2"),
    ("across_1", "<i4"),
    ("across_2", "<i4"),
    ("along", "<i4"),
    ("red_green", "<i2"),
    ("green", "<i2"),
    ("blue_green", "<i2"),
    ("grey", "<i2"),
    ("confidence", "<i2"),
    ("variance", "<i2"),
    ("first_age", "<i4"),
    ("last_age", "<i4"),
)
# A surface moves by at most half of it; surfels are accurate to 2 mm in the median.
STEP_M = 0.0005
# Times are only compared with limits of seconds.
_AGE_S = 0.5
# Tolerance of a time read from a file, in ages.
_ROUNDING = 1e-4
_NORMAL_STEPS = 127
# Steps of 4 % of the radius, 9 % of a standard deviation, and 19 % of the confidence.
_PER_OCTAVE_OF_RADIUS, _PER_OCTAVE = 16, 4
_RADIUS_M, _VARIANCE_M2 = 1e-3, 1e-6
# Surfels of one surface are ordered in strips of this width, so that neighbours differ least.
_STRIP_BITS = 4
_MIX = np.uint64(0x9E3779B97F4A7C15)

Columns = dict[str, NDArray[np.signedinteger]]


def columns_of(surfels: Surfels, stamp_s: float, stable_confidence: float) -> Columns:
    """Return columns (n,) of surfels, ordered so that neighbours are adjacent.

    The columns do not depend on the order of the surfels.
    """
    # Octahedral coordinates of the normals; the lower half is folded outwards.
    wide = surfels.normal.astype(float)
    wide /= np.abs(wide).sum(axis=1, keepdims=True)
    xy = wide[:, :2]
    # With the sign of zeros, so that a normal on an edge is read as it was written.
    outwards = np.copysign(1 - np.abs(xy[:, ::-1]), xy)
    u, v = np.rint(_NORMAL_STEPS * np.where(wide[:, 2:] < 0, outwards, xy)).T
    radius = _logs(surfels.radius_m, _RADIUS_M, _PER_OCTAVE_OF_RADIUS)
    # Steps of positions along the next two axes and the main axis, after sliding in the surfel's plane.
    main, rows = _axes(u, v)[0], np.arange(len(radius))
    step_m = np.ldexp(STEP_M, _coarser(radius))
    along_m, slope = surfels.position[rows, main].astype(float), surfels.normal[rows, main].astype(float)
    steps = []
    for turn in (1, 2):
        at = (main + turn) % 3
        across_m = surfels.position[rows, at].astype(float)
        steps.append(np.rint(across_m / step_m))
        along_m -= surfels.normal[rows, at] / slope * (steps[-1] * step_m - across_m)
    red, green, blue = np.rint(surfels.color).astype(np.int16).T
    confidence = _logs(surfels.confidence, stable_confidence, _PER_OCTAVE)
    # Rounded down, so that nothing expires earlier, and at most 34 years.
    ages = [
        np.minimum(np.floor((stamp_s - seen_s) / _AGE_S + _ROUNDING), np.iinfo(np.int32).max)
        for seen_s in (surfels.first_s, surfels.last_s)
    ]
    found = (
        *(surfels.keyframe, u, v, radius, *steps, np.rint(along_m / STEP_M)),
        *(red - green, green, blue - green, np.rint(surfels.grey)),
        np.where(surfels.confidence >= stable_confidence, confidence, np.minimum(confidence, -1)),
        _logs(surfels.variance_m2, _VARIANCE_M2, _PER_OCTAVE),
        *ages,
    )
    columns = {name: np.asarray(column, dtype) for (name, dtype), column in zip(COLUMNS, found, strict=True)}
    # Surface by surface, in strips.
    axis, side = _axes(columns["normal_u"], columns["normal_v"])
    surface = (columns["keyframe"].astype(np.int64) * 3 + axis) * 2 + side
    surface = surface << 16 | _coarser(columns["radius"])
    every = np.zeros(len(axis), np.uint64)
    for column in columns.values():
        every = every * _MIX + column.astype(np.uint64)
    strip = columns["across_2"] >> _STRIP_BITS
    order = np.lexsort((every, columns["across_2"], columns["across_1"], strip, surface))
    return {name: column[order] for name, column in columns.items()}


def surfels_of(columns: Columns, stamp_s: float, stable_confidence: float) -> Surfels:
    """Return the surfels of columns. Impossible values become infinite or out of range, for the caller to reject."""
    normal = _direction_of(columns["normal_u"], columns["normal_v"])
    axis, _ = _axes(columns["normal_u"], columns["normal_v"])
    rows, position = np.arange(len(axis)), np.empty((len(axis), 3), np.float32)
    position[rows, axis] = columns["along"] * STEP_M
    with np.errstate(over="ignore", invalid="ignore"):  # of an impossible radius
        step_m = np.ldexp(STEP_M, _coarser(columns["radius"]))
        for turn, name in ((1, "across_1"), (2, "across_2")):
            position[rows, (axis + turn) % 3] = columns[name] * step_m
    red_green, green, blue_green, grey = (columns[name] for name in ("red_green", "green", "blue_green", "grey"))
    return Surfels(
        position=position,
        normal=np.asarray(normal / np.linalg.norm(normal, axis=1, keepdims=True), np.float32),
        radius_m=_powers(columns["radius"], _RADIUS_M, _PER_OCTAVE_OF_RADIUS),
        color=np.stack([red_green + green, green, blue_green + green], axis=-1).astype(np.float32),
        grey=grey.astype(np.float32),
        confidence=_powers(columns["confidence"], stable_confidence, _PER_OCTAVE),
        variance_m2=_powers(columns["variance"], _VARIANCE_M2, _PER_OCTAVE),
        first_s=np.asarray(stamp_s - _AGE_S * columns["first_age"], float),
        last_s=np.asarray(stamp_s - _AGE_S * columns["last_age"], float),
        keyframe=columns["keyframe"].astype(np.int32),
    )


def packed(column: NDArray[np.signedinteger]) -> bytes:
    """Return the bytes of a column: single bytes unchanged, others by `steps_of`, in planes of first, second, … bytes.

    A compressor finds the redundancy of single bytes by itself.
    """
    return steps_of(column, 0).view(np.uint8).reshape(-1, column.itemsize).T.tobytes()


def steps_of(column: NDArray[np.signedinteger], before: int) -> NDArray[np.integer]:
    """Return differences between neighbours, the first to `before`, coded so that small ones are small numbers.

    0, -1, 1, -2, … become 0, 1, 2, 3, …. Columns of single bytes are unchanged.
    """
    if column.itemsize == 1:
        return column
    step = np.diff(column, prepend=column.dtype.type(before))
    return np.asarray((step << 1) ^ (step >> (8 * column.itemsize - 1)))


def unpacked(data: bytes, dtype: str) -> NDArray[np.signedinteger]:
    """Return the column packed by `packed`."""
    width = np.dtype(dtype).itemsize
    if width == 1:
        return np.frombuffer(data, dtype)
    flat = np.ascontiguousarray(np.frombuffer(data, np.uint8).reshape(width, -1).T).reshape(-1)
    unsigned = flat.view(f"<u{width}")
    step = (unsigned >> 1) ^ (np.zeros(1, unsigned.dtype) - (unsigned & 1))
    return np.cumsum(step, dtype=unsigned.dtype).view(dtype)


def _direction_of(u: NDArray[Any], v: NDArray[Any]) -> FloatArray:
    """Return points (n, 3) on the octahedron, times 127: integers."""
    x, y = u.astype(float), v.astype(float)
    z = _NORMAL_STEPS - np.abs(x) - np.abs(y)
    is_below = z < 0
    inwards = np.copysign(_NORMAL_STEPS - np.abs(y), x), np.copysign(_NORMAL_STEPS - np.abs(x), y)
    return np.stack([np.where(is_below, inwards[0], x), np.where(is_below, inwards[1], y), z], axis=-1)


def _axes(u: NDArray[Any], v: NDArray[Any]) -> tuple[IntArray, ByteArray]:
    """Return the main axis (n,) of normals, and whether they point against it."""
    found = _direction_of(u, v)
    axis = np.abs(found).argmax(axis=1)
    return axis, np.asarray(found[np.arange(len(axis)), axis] < 0, np.uint8)


def _coarser(radius: NDArray[Any]) -> NDArray[Any]:
    """Return the exponent e of the steps across the main axis."""
    return np.maximum(radius.astype(np.int32) // _PER_OCTAVE_OF_RADIUS - 1, 0)


def _logs(values: Float32Array, one: float, per_octave: int) -> FloatArray:
    return np.asarray(np.rint(per_octave * np.log2(values.astype(float) / one)))


def _powers(logs: NDArray[Any], one: float, per_octave: int) -> Float32Array:
    with np.errstate(over="ignore", under="ignore"):
        return np.asarray(one * np.exp2(logs / per_octave), np.float32)


_ROWS_AT_ONCE = 1 << 16


class ColumnFiles:
    """Buffers columns part by part on disk, and returns them column by column; a context manager.

    All columns in memory would take half as much as the map. The files have no name, so that a killed process leaves
    none behind.

    Args:
        folder: folder of the files. Raises OSError, as all methods do.
    """

    def __init__(self, folder: Path) -> None:
        self._open = ExitStack()
        self._streams: dict[str, IO[bytes]] = {
            name: self._open.enter_context(tempfile.TemporaryFile(dir=folder))  # noqa: SIM115 - closed by the stack
            for name, _ in COLUMNS
        }
        self._last = {name: np.zeros(1, dtype) for name, dtype in COLUMNS}

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._open.close()

    def add(self, columns: Columns) -> None:
        """Append columns."""
        for name, column in columns.items():
            self._streams[name].write(steps_of(column, self._last[name][0]).tobytes())
            self._last[name] = column[-1:] if len(column) else self._last[name]

    def compressed(self, compressor: lzma.LZMACompressor) -> bytes:
        """Return all columns, packed as by `packed`, compressed."""
        pieces = []
        for name, dtype in COLUMNS:
            stream, width = self._streams[name], np.dtype(dtype).itemsize
            for byte in range(width):
                stream.seek(0)
                while rows := stream.read(width * _ROWS_AT_ONCE):
                    pieces.append(compressor.compress(rows[byte::width]))
        return b"".join(pieces)
