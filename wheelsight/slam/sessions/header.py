"""MapHeader: map.json, which says what a map folder is, who made it, and of which camera it is."""

from __future__ import annotations

import json
import math
import zlib
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from wheelsight._version import __version__
from wheelsight.calibration import Calibration
from wheelsight.errors import MapError
from wheelsight.files import StrPath, write_text
from wheelsight.geometry import MOST_PIXELS
from wheelsight.inputs import Kind, parse_json, read_text

FORMAT, VERSION = "wheelsight-map-folder", 1
HEADER_FILE = "map.json"
DRIVE, REBUILD, MERGE, PRUNE, REMOVAL = MAKERS = ("drive", "rebuild", "merge", "prune", "removal")
"""What changes maps for long: drives, commands that write another one, and what removes one."""
_NO_MAP = "give a folder that `wheelsight run` left as its map"
_DAMAGED = "use another copy of the map"
_FILE = Kind("what a map says of itself", most_mb=1, fix=_NO_MAP, missing="is no map: map.json is missing")
_LENS = ("fx", "fy", "cx", "cy")
_SIZE = ("width", "height")


@dataclass(frozen=True, slots=True)
class MapCamera:
    """The camera of a map: its images' size and its lens, by which another is known to be the same.

    Attributes:
        width, height: of depth images, pixels.
        fx, fy, cx, cy: of the depth camera, pixels.
        is_registered: whether colour and depth share one pixel grid.
        depth_factor: depth units a metre, where the run was told other than its format's; else None.
    """

    width: int
    height: int
    fx: float
    fy: float
    cx: float
    cy: float
    is_registered: bool
    depth_factor: float | None = None

    @property
    def size_px(self) -> tuple[int, int]:
        """Width and height of depth images; keyframes have none that are larger."""
        return self.width, self.height

    @classmethod
    def of(cls, calibration: Calibration, depth_factor: float | None = None) -> MapCamera:
        """The depth camera of a calibration. Raises CalibrationError where it has none."""
        _, depth = calibration.cameras
        fx, fy, cx, cy = (float(getattr(depth, name)) for name in _LENS)
        return cls(int(depth.width), int(depth.height), fx, fy, cx, cy, calibration.is_registered, depth_factor)

    def why_other(self, other: MapCamera, share: float) -> str | None:
        """What makes another camera not this one, within a share of its numbers; None where nothing does."""
        if (self.width, self.height) != (other.width, other.height):
            return f"its images are {self.width}×{self.height}, these {other.width}×{other.height}"
        limits = {"fx": self.fx, "fy": self.fy, "cx": self.width, "cy": self.height}
        for name, size in limits.items():
            mine, theirs = getattr(self, name), getattr(other, name)
            if abs(mine - theirs) > share * size:
                return f"its {name} is {mine:.1f} px, here {theirs:.1f}"
        if self.is_registered != other.is_registered:
            return (
                "its depth is registered to colour, here it is not"
                if self.is_registered
                else ("its depth is not registered to colour, here it is")
            )
        factors = self.depth_factor, other.depth_factor
        if factors[0] is not None and factors[1] is not None and abs(factors[0] / factors[1] - 1) > share:
            return f"its depth factor is {factors[0]:g}, here {factors[1]:g}"
        return None


@dataclass(frozen=True, slots=True)
class MapHeader:
    """What a map folder says of itself.

    Attributes:
        camera: whose map it is.
        made_by: the program and its version.
        made: when, as ISO 8601 in UTC.
        source: the recording's name, or the live source's.
        unfinished: what makes the map, or has made it when it was ended: one of `MAKERS`; "" of a finished one.
        version: of the format.
    """

    camera: MapCamera
    made_by: str
    made: str
    source: str = ""
    unfinished: str = ""
    version: int = VERSION

    @classmethod
    def new(cls, camera: MapCamera, source: str = "", unfinished: str = "") -> MapHeader:
        """Of a map that begins now."""
        made = datetime.now(UTC).isoformat(timespec="seconds")
        return cls(camera, f"wheelsight {__version__}", made, source, unfinished)

    @property
    def is_usable(self) -> bool:
        """Whether it is finished, or of a drive, each part of which is a map; a part of a merged map is none."""
        return self.unfinished in ("", DRIVE)

    def save(self, folder: StrPath) -> None:
        """Write map.json. Raises OutputError."""
        camera = {name: getattr(self.camera, name) for name in (*_SIZE, *_LENS, "is_registered", "depth_factor")}
        told = {"made_by": self.made_by, "made": self.made, "source": self.source, "camera": camera}
        document: dict[str, Any] = {"format": FORMAT, "version": self.version, **told}
        if self.unfinished:
            document["unfinished"] = self.unfinished
        document["crc32"] = _crc(document)
        write_text(Path(folder) / HEADER_FILE, json.dumps(document, indent=2) + "\n")


def read_header(folder: StrPath) -> MapHeader:
    """Read map.json. Raises MapError: it is missing, damaged, or of a newer version."""
    path = Path(folder) / HEADER_FILE
    text = read_text(path, _FILE, MapError)
    try:
        document = parse_json(text)
    except ValueError as error:
        raise MapError(f"is damaged: {error}", path=path, fix=_DAMAGED) from error
    if not isinstance(document, dict) or document.get("format") != FORMAT:
        raise MapError(f"is not of format {FORMAT!r}", path=path, fix=_NO_MAP)
    version = document.get("version")
    if type(version) is not int or version < 1:
        raise MapError(f"its version is {version!r}", path=path, fix=_DAMAGED)
    if version > VERSION:
        problem = f"is of version {version}, newer than {VERSION}, which this wheelsight reads"
        raise MapError(problem, path=path, fix="open it with the wheelsight that wrote it, or a newer one")
    crc = document.pop("crc32", None)
    if crc != _crc(document):
        raise MapError("its checksum is wrong: it is damaged, or was edited", path=path, fix=_DAMAGED)
    try:
        return _header(document)
    except (KeyError, TypeError, ValueError) as error:
        raise MapError(f"is damaged: {type(error).__name__}", path=path, fix=_DAMAGED) from error


def _header(document: dict[str, Any]) -> MapHeader:
    camera, factor = document["camera"], document["camera"]["depth_factor"]
    width, height = (int(camera[name]) for name in _SIZE)
    fx, fy, cx, cy = (float(camera[name]) for name in _LENS)
    if min(width, height) < 1 or width * height > MOST_PIXELS or not all(map(math.isfinite, (fx, fy, cx, cy))):
        raise ValueError("no camera has such images")
    depth_factor = None if factor is None else float(factor)
    if depth_factor is not None and not 0 < depth_factor < math.inf:
        raise ValueError("no camera has such units")
    of_camera = MapCamera(width, height, fx, fy, cx, cy, bool(camera["is_registered"]), depth_factor)
    made_by, made, source = (str(document[name]) for name in ("made_by", "made", "source"))
    unfinished = document.get("unfinished", "")
    if unfinished not in ("", *MAKERS):
        raise ValueError("nothing makes maps so")
    return MapHeader(of_camera, made_by, made, source, unfinished, document["version"])


def _crc(document: dict[str, Any]) -> int:
    """Of all that is told, in whatever order and layout."""
    return zlib.crc32(json.dumps(document, sort_keys=True, separators=(",", ":")).encode())
