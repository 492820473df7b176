"""Floor plans and occupancy maps in the format of ROS map_server and Nav2, read and written: an image, and YAML."""

from __future__ import annotations

import logging
import math
import re
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import cv2
import numpy as np
import yaml
from numpy.typing import ArrayLike, NDArray

from wheelsight.core.errors import MapError
from wheelsight.core.files import StrPath, output_error, write_bytes, write_text
from wheelsight.core.geometry import MOST_PIXELS, ByteArray, FloatArray, se2
from wheelsight.core.inputs import PNM_GAP, Kind, is_there, line_of, picture_size, read_bytes, read_yaml, scan_count

OCCUPIED, FREE, UNKNOWN = 100, 0, -1
# The thresholds that map_server documents and map_saver writes; defaults where a YAML file states none.
OCCUPIED_THRESHOLD, FREE_THRESHOLD = 0.65, 0.196

Mode = Literal["trinary", "scale", "raw"]

_MODES = ("trinary", "scale", "raw")
# The grey values of map_saver. That of unknown cells is free by the free_thresh of 0.25 that Nav2's map_saver writes.
_BLACK, _GREY, _WHITE = 0, 205, 254
_YAML_SUFFIXES = (".yaml", ".yml")
_PICTURE = Kind("a map's image", most_mb=128, missing="the map's image is missing", fix="put it where image: says")
_LARGEST_CELL_M = 10.0
_LARGEST_SPAN_M = 10_000.0
_OPAQUE, _DEEPEST = 255, 65535
# A portable grey or colour map states the value of white. Not all decoders scale by it.
_PNM_WHITE = re.compile(rb"P[2356](?:%b\d{1,9}){2}%b(\d{1,5})\s" % (PNM_GAP, PNM_GAP))
_PNM_REACH = 2048
# NaN as C and C++ programs print it: nan, -nan, -nan(ind), 1.#QNAN.
_NOT_A_NUMBER = re.compile(r"[-+]?(\.?nan\b.*|1\.#.*)", re.IGNORECASE)

_log = logging.getLogger(__name__)


@dataclass(frozen=True, eq=False)
class RosMap:
    """An occupancy grid.

    Attributes:
        occupancy: (H, W) int8 as in `nav_msgs/OccupancyGrid`: 0 free to 100 occupied, -1 unknown; row 0 has the least
            y, unlike in an image.
        resolution_m: side of a cell.
        origin: x and y in metres and yaw in radians of the corner of cell (0, 0) in the frame `map`.
    """

    occupancy: NDArray[np.int8]
    resolution_m: float
    origin: tuple[float, float, float] = (0.0, 0.0, 0.0)

    def to_map(self, cells: ArrayLike) -> FloatArray:
        """Points (..., 2) in `map`, metres, of (column, row) (..., 2) in cells; integers are corners of cells."""
        R_map_grid, t = self._T_map_grid[:2, :2], self._T_map_grid[:2, 2]
        return np.asarray(self.resolution_m * np.asarray(cells, float) @ R_map_grid.T + t)

    def to_cells(self, xy_map: ArrayLike) -> FloatArray:
        """(column, row) (..., 2) in cells of points (..., 2) in `map`; the inverse of `to_map`."""
        R_map_grid, t = self._T_map_grid[:2, :2], self._T_map_grid[:2, 2]
        return np.asarray((np.asarray(xy_map, float) - t) @ R_map_grid / self.resolution_m)

    @property
    def _T_map_grid(self) -> FloatArray:
        return se2.from_parts(*self.origin)


def read_ros_map(
    path: StrPath, resolution_m: float | None = None, warn: Callable[[str], None] = _log.warning
) -> RosMap:
    """Read a map_server map by its YAML file, or a bare image by its resolution.

    The occupancy of a cell is 1 - the mean of its colours, or the mean with `negate`, relative to white: 255, 65535, or
    the value that a PGM states. Mode `trinary` makes it occupied from `occupied_thresh`, free up to `free_thresh`, and
    unknown between; `scale` interpolates between the two. Transparent pixels are unknown in both. `raw` takes pixel
    values 0 to 100 of 255 as percent, others as unknown.

    Cells equal those of Nav2's map_server, with two exceptions. map_saver's grey for unknown cells, 205, stays unknown
    in a trinary map whose `free_thresh` makes it free, such as the 0.25 of Nav2's map_saver. Nav2 weighs red, green and
    blue of colour images; this function does not.

    Args:
        path: of the YAML file, or of a PNG or PGM image, read as `trinary` with its lower left corner at (0, 0).
        resolution_m: side of a cell of a bare image; a YAML file states its own.
        warn: called with a sentence for each deviation from the file: a missing image that another one beside the YAML
            file replaces, map_saver's grey as above, a yaw of NaN that becomes 0.

    Raises:
        MapError: a file is missing or damaged, a field is invalid, the image has too many pixels; or a bare image is
            transparent, or has 16 bits and no free cells. Names file, line and fix.
    """
    path = Path(path)
    if path.suffix.lower() in _YAML_SUFFIXES:
        if resolution_m is not None:
            raise MapError("states its own resolution", path=path, fix="leave out --resolution")
        about = _Description.of(read_yaml(path, MapError), path, warn)
    elif resolution_m is None:
        raise MapError("is an image without a scale", path=path, fix="give --resolution in metres, or its map.yaml")
    else:
        if not 0 < resolution_m <= _LARGEST_CELL_M:
            fix = f"metres a cell: over 0, up to {_LARGEST_CELL_M:g}"
            raise MapError(f"--resolution is {resolution_m:g}", path=path, fix=fix)
        about = _Description(path, resolution_m)
    image, white = _read_image(about.image)
    if about.image == path:
        image = _opaque(image, white, path)
    if max(image.shape[:2]) * about.resolution_m > _LARGEST_SPAN_M:
        raise MapError(f"is over {_LARGEST_SPAN_M / 1000:g} km long", path=path, fix="resolution is metres a cell")
    occupancy = _occupancy(image, white, about, lambda what: warn(f"{path}: {what}"))
    if about.image == path and image.dtype != np.uint8 and not (occupancy == FREE).any():
        raise _sixteen_bits(path)
    return RosMap(occupancy, about.resolution_m, about.origin)


def write_ros_map(ros_map: RosMap, path: StrPath, mode: Mode = "trinary") -> tuple[Path, Path]:
    """Write a map as Nav2's map_saver does: a YAML file and an image beside it. Returns their paths.

    `trinary` and `raw` are written as PGM; `scale` as PNG with transparent unknown cells. In `trinary`, cells between
    both thresholds become unknown; `raw` and `scale` keep every percent.

    An old YAML file is removed before the image is written, so that no YAML file ever describes another map's image.

    Args:
        ros_map: with at least one cell.

    Raises:
        MapError: the path does not end in .yaml or .yml, or the mode is unknown.
        OutputError: a file cannot be written.
    """
    path = Path(path)
    if path.suffix.lower() not in _YAML_SUFFIXES:
        raise MapError(f"does not end in {' or '.join(_YAML_SUFFIXES)}", path=path, fix="the image stands beside it")
    if mode not in _MODES:
        raise MapError(f"mode is {mode!r}", path=path, fix=f"one of {', '.join(_MODES)}")
    image = path.with_suffix(".png" if mode == "scale" else ".pgm")
    percent = ros_map.occupancy[::-1].astype(np.int64)
    is_known = (percent >= FREE) & (percent <= OCCUPIED)
    if mode == "raw":
        painted = np.where(is_known, percent, _OPAQUE).astype(np.uint8)
    elif mode == "scale":
        shade = np.where(is_known, np.rint(_OPAQUE * (OCCUPIED - percent) / OCCUPIED), _OPAQUE // 2).astype(np.uint8)
        painted = np.dstack([shade, shade, shade, np.where(is_known, _OPAQUE, 0).astype(np.uint8)])
    else:
        limits = round(100 * FREE_THRESHOLD), round(100 * OCCUPIED_THRESHOLD)
        grey = np.where(percent <= limits[0], _WHITE, np.where(percent >= limits[1], _BLACK, _GREY))
        painted = np.where(is_known, grey, _GREY).astype(np.uint8)
    written, code = cv2.imencode(image.suffix, painted)
    assert written
    try:
        path.unlink(missing_ok=True)
    except OSError as error:
        raise output_error(error, path) from error
    write_bytes(image, code.tobytes())
    # The thresholds 0 and 1 keep every share of mode `scale`.
    free, occupied = (0.0, 1.0) if mode == "scale" else (FREE_THRESHOLD, OCCUPIED_THRESHOLD)
    fields: dict[str, Any] = {"image": image.name, "mode": mode, "resolution": float(ros_map.resolution_m)}
    fields |= {"origin": [float(part) for part in ros_map.origin], "negate": 0}
    fields |= {"occupied_thresh": occupied, "free_thresh": free}
    write_text(path, yaml.safe_dump(fields, sort_keys=False, default_flow_style=None, allow_unicode=True))
    return path, image


def read_plan_image(path: StrPath) -> ByteArray:
    """An image (H, W, 3) uint8, or (H, W) if it is grey; row 0 is the top. Raises MapError."""
    image, white = _read_image(path)
    if image.dtype != np.uint8:
        raise _sixteen_bits(path)
    image = _opaque(image, white, path)
    if white != _OPAQUE:
        image = np.rint(np.minimum(image / white, 1) * _OPAQUE)
    return np.ascontiguousarray(image, np.uint8)


def _opaque(image: NDArray[Any], white: int, path: StrPath) -> NDArray[Any]:
    """The image without its alpha channel. Raises MapError where any pixel is transparent."""
    if image.ndim == 3 and image.shape[2] == 4:
        if (image[..., 3] != white).any():
            raise MapError("is transparent in places", path=path, fix="save it without alpha channel, on white or grey")
        image = image[..., :3]
    return image


def _sixteen_bits(path: StrPath) -> MapError:
    return MapError("has 16 bits a pixel and colour", path=path, fix="save it with 8 bits; is it a depth image?")


def _read_image(path: StrPath) -> tuple[NDArray[Any], int]:
    """The image (H, W), (H, W, 3) or, with alpha, (H, W, 4) of uint8 or uint16, and the value of white."""
    data = read_bytes(path, _PICTURE, MapError)
    size = picture_size(data)
    if size is None:
        raise MapError("is no image, or a damaged one", path=path, fix="a PNG or PGM image")
    if size[0] * size[1] * scan_count(data) > MOST_PIXELS:
        problem = f"says it is {size[0]}×{size[1]} pixels"
        raise MapError(problem, path=path, fix=f"at most {MOST_PIXELS / 1e6:.0f} million; use larger cells")
    white, stated = 0, _PNM_WHITE.match(data[:_PNM_REACH])
    if stated is not None:
        white = int(stated[1])
        if not 0 < white < 1 << 16:
            raise MapError(f"says that {white} is white", path=path, fix="1 to 65535; save it again")
        # Decoders then do not scale.
        full = b"255" if white < 1 << 8 else b"65535"
        # OpenCV takes a text file without a final newline as truncated.
        data = data[: stated.start(1)] + full + data[stated.end(1) :] + b"\n"
    try:
        image = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_UNCHANGED)
    except cv2.error:
        image = None
    if image is None:
        raise MapError("is no image, or a damaged one", path=path, fix="a PNG or PGM image")
    if image.dtype not in (np.uint8, np.uint16):
        problem = f"has {8 * image.dtype.itemsize} bits a pixel and colour"
        raise MapError(problem, path=path, fix="save it with 8 bits")
    return np.asarray(image), white or (_OPAQUE if image.dtype == np.uint8 else _DEEPEST)


@dataclass(frozen=True, slots=True)
class _Description:
    """The contents of a map's YAML file."""

    image: Path
    resolution_m: float
    origin: tuple[float, float, float] = (0.0, 0.0, 0.0)
    mode: str = "trinary"
    negate: bool = False
    occupied: float = OCCUPIED_THRESHOLD
    free: float = FREE_THRESHOLD

    @classmethod
    def of(cls, document: Any, path: Path, warn: Callable[[str], None]) -> _Description:
        """The validated description. Raises MapError naming the line of an invalid field."""
        if not isinstance(document, dict):
            raise MapError("has no names and values", path=path, fix="image, resolution, origin")
        fields = _Fields(document, path)
        image = document.get("image")
        if not isinstance(image, str) or not image.strip():
            raise fields.error("image", "the name of the image's file")
        mode = document.get("mode", _MODES[0])
        if mode not in _MODES:
            raise fields.error("mode", f"one of {', '.join(_MODES)}")
        negate = document.get("negate", 0)
        if negate not in (0, 1):
            raise fields.error("negate", "0 or 1")
        resolution_m = fields.number("resolution")
        if not 0 < resolution_m <= _LARGEST_CELL_M:
            raise fields.error("resolution", f"metres a cell: over 0, up to {_LARGEST_CELL_M:g}")
        occupied = fields.number("occupied_thresh", OCCUPIED_THRESHOLD)
        free = fields.number("free_thresh", FREE_THRESHOLD)
        for name, threshold in (("occupied_thresh", occupied), ("free_thresh", free)):
            if not 0 <= threshold <= 1:
                raise fields.error(name, "a share from 0 to 1")
        if free > occupied:
            raise fields.error("free_thresh", f"at most occupied_thresh, {occupied:g}")
        found = _image_of(image.strip(), path, warn)
        return cls(found, resolution_m, fields.origin(warn), mode, bool(negate), occupied, free)


@dataclass(frozen=True, slots=True)
class _Fields:
    """Names and values of a YAML file, and their lines."""

    values: dict[Any, Any]
    path: Path

    def number(self, name: str, default: float | None = None) -> float:
        """The number of a field, or `default` where the field is missing."""
        value = self.values.get(name, default)
        number = _number(value)
        if number is None:
            raise self.error(name, "a number")
        return number

    def origin(self, warn: Callable[[str], None]) -> tuple[float, float, float]:
        """The pose of the lower left corner. A yaw of NaN becomes 0, with a warning."""
        value = self.values.get("origin")
        parts: list[Any] = value if isinstance(value, list) else []
        numbers = [_number(part) for part in parts]
        if len(parts) == 3 and _NOT_A_NUMBER.fullmatch(str(parts[2]).strip()):
            line = line_of(self.path, ("origin",), MapError)
            warn(f"{self.path}:{line}: the origin's yaw is {parts[2]}, no number; 0 is used")
            numbers[2] = 0.0
        x_m, y_m, yaw_rad = numbers if len(numbers) == 3 else (None, None, None)
        if x_m is None or y_m is None or yaw_rad is None:
            raise self.error("origin", "[x, y, yaw] of the lower left corner, metres and radians")
        return x_m, y_m, yaw_rad

    def error(self, name: str, fix: str) -> MapError:
        """The error of an invalid or missing field."""
        if name not in self.values:
            return MapError(f"field {name} is missing", path=self.path, fix=fix)
        line = line_of(self.path, (name,), MapError)
        return MapError(f"{name} is {self.values[name]!r}", path=self.path, line=line, fix=fix)


def _number(value: Any) -> float | None:
    """A finite number, also from text (YAML 1.1 reads 1e-3, without a dot, as text); None for other values."""
    if isinstance(value, bool) or not isinstance(value, int | float | str):
        return None
    try:
        number = float(value)
    except ValueError:
        return None
    return number if math.isfinite(number) else None


def _image_of(name: str, path: Path, warn: Callable[[str], None]) -> Path:
    """The image that a YAML file names. If it is missing, the one of the same name beside the file, with a warning.

    The YAML file of a map from another computer may have that computer's folder, separators or case.
    """
    stated = path.parent / name
    if is_there(stated):
        return stated
    last = re.split(r"[\\/]", name)[-1]
    below = path.parent / name.replace("\\", "/")
    beside = path.parent / last
    try:
        names = sorted(entry.name for entry in path.parent.iterdir())
    except OSError:
        names = []
    for found in (below, beside, *(path.parent / one for one in names if one.lower() == last.lower())):
        if last and is_there(found):
            warn(f"{path}: its image {name} is missing; {found} is used")
            return found
    return stated


def _occupancy(image: NDArray[Any], white: int, about: _Description, warn: Callable[[str], None]) -> NDArray[np.int8]:
    """The occupancy (H, W) of an image, with row 0 at the bottom.

    Single precision and inclusive thresholds, as in Nav2 since 2025.
    """
    image = image[::-1]
    grey = image if image.ndim == 2 else image[..., :3].mean(axis=2)
    shade = np.minimum(grey.astype(np.float32) / np.float32(white), np.float32(1))
    if about.mode == "raw":
        percent = np.round(shade * np.float32(_OPAQUE))
        return np.where(percent <= OCCUPIED, percent, UNKNOWN).astype(np.int8)
    occupied = shade if about.negate else np.float32(1) - shade
    free_at, occupied_at = np.float32(about.free), np.float32(about.occupied)
    found = np.full(shade.shape, float(UNKNOWN))
    if about.mode == "scale" and about.occupied > about.free:
        share = (occupied - free_at) / np.float32(about.occupied - about.free)
        found = np.floor(share * np.float32(OCCUPIED) + np.float32(0.5)).astype(float)
    found = np.where(occupied >= occupied_at, OCCUPIED, found)
    found = np.where(occupied <= free_at, FREE, found)
    if image.ndim == 3 and image.shape[2] == 4:
        found = np.where(image[..., 3] < white, UNKNOWN, found)
    if about.mode == _MODES[0] and not about.negate:
        # Only in a map with a white floor, as map_saver paints it. Without whiter cells, this grey may be the floor.
        is_grey = (grey == _GREY) & (white == _OPAQUE) & (found == FREE)
        count = int(is_grey.sum())
        if count and (grey >= _WHITE).any():
            problem = f"{count} cells have map_saver's grey for unknown, and are free by free_thresh {about.free:g}"
            warn(f"{problem}: they are read as unknown; set free_thresh to {FREE_THRESHOLD:g}")
            found[is_grey] = UNKNOWN
    return found.astype(np.int8)
