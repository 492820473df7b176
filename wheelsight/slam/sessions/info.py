"""MapInfo: what a map folder holds, in figures."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from wheelsight.errors import MapError
from wheelsight.files import StrPath
from wheelsight.inputs import is_there
from wheelsight.mapping import MapEdits
from wheelsight.slam.sessions.hanging import connected
from wheelsight.slam.sessions.header import HEADER_FILE, MapHeader
from wheelsight.slam.sessions.map_folder import (
    OCCUPANCY_FILE,
    OCCUPANCY_IMAGE,
    RECOGNITION_FILE,
    SURFELS_FILE,
    MapFolder,
)
from wheelsight.slam.sessions.parts import new_numbers, renumbered
from wheelsight.slam.sessions.reading import GRAPH, KEYFRAMES, Health, journals_of

MAP_FOLDER = "map"
_OF_RUN = ("", "joined", "dense", "features", "own")


@dataclass(frozen=True, slots=True)
class MapInfo:
    """Figures of a map folder.

    Attributes:
        header: what it says of itself.
        keyframes: how many are there.
        edges, loops: between them: by odometry, and by places that were seen again.
        parts: how many parts hang together by edges.
        begin_s, end_s: stamps of the first and the last keyframe; None without any.
        length_m: of the way from keyframe to keyframe, where they are by now.
        bytes: of all files.
        keyframe_bytes: a keyframe, with its place, its edges and its moves.
        surfel_bytes, recognition_bytes, occupancy_bytes: of these files; None where they are missing.
        edits: how many zones and wiped obstacles; None where their file cannot be read.
        areas: names of areas, which are in the same file; likewise.
        places: names of poses; likewise.
        health: what is wrong.
    """

    header: MapHeader
    keyframes: int
    edges: int
    loops: int
    parts: int
    begin_s: float | None
    end_s: float | None
    length_m: float
    bytes: int
    keyframe_bytes: float
    surfel_bytes: int | None
    recognition_bytes: int | None
    occupancy_bytes: int | None
    edits: int | None
    areas: tuple[str, ...] | None
    places: tuple[str, ...] | None
    health: Health

    def to_dict(self) -> dict[str, Any]:
        """As plain nested values."""
        told = {name: getattr(self, name) for name in self.__slots__ if name not in ("header", "health")}
        health = {"is_whole": self.health.is_whole, "notes": list(self.health.notes)}
        return {**asdict(self.header), **told, "health": health}


def info_of(folder: MapFolder) -> MapInfo:
    """The figures of an open map."""
    path, store, edges, edits = folder.path, folder.store, folder.edges, _edits(folder)
    numbers = list(store)
    stamps_s = [folder.contents.places[number].stamp_s for number in numbers]
    at = store.T_map_keyframe[numbers][:, :3, 3]
    journals = [*journals_of(path, KEYFRAMES), *journals_of(path, GRAPH)]
    journal_bytes = sum(file.stat().st_size for file in journals)
    between = renumbered(edges, new_numbers(np.array(numbers, np.int64), len(store)))
    return MapInfo(
        header=folder.header,
        keyframes=len(numbers),
        edges=sum(not edge.is_loop for edge in edges),
        loops=sum(edge.is_loop for edge in edges),
        parts=len(np.unique(connected(between, len(numbers)))),
        begin_s=min(stamps_s, default=None),
        end_s=max(stamps_s, default=None),
        length_m=float(np.linalg.norm(np.diff(at, axis=0), axis=1).sum()),
        bytes=sum(file.stat().st_size for file in path.iterdir() if file.is_file()),
        keyframe_bytes=journal_bytes / max(len(numbers), 1),
        surfel_bytes=_size(path / SURFELS_FILE),
        recognition_bytes=_size(path / RECOGNITION_FILE),
        occupancy_bytes=_occupancy_bytes(path),
        edits=None if edits is None else len(edits) - len(edits.areas),
        areas=None if edits is None else edits.area_names,
        places=_places(folder),
        health=folder.contents.health,
    )


def is_map(path: StrPath) -> bool:
    """Whether a folder has what says that it is a map."""
    return is_there(Path(path) / HEADER_FILE)


def find_map(path: StrPath) -> Path:
    """The map folder that a path names: itself, or that of a run's folder. Raises MapError."""
    path = Path(path)
    if not is_there(path):
        raise MapError("there is no such folder", path=path, fix="check the path")
    own = [path, *(path / track / MAP_FOLDER for track in _OF_RUN)]
    found = next((folder for folder in own if is_map(folder)), None)
    if found is None:
        fix = "make one: wheelsight run RECORDING --odometry dense --map surfels --out DIR"
        raise MapError("is no map, and no folder of a run with one", path=path, fix=fix)
    return found


def _occupancy_bytes(path: Path) -> int | None:
    """Of both files; the image alone is none."""
    about, image = _size(path / OCCUPANCY_FILE), _size(path / OCCUPANCY_IMAGE)
    return None if about is None or image is None else about + image


def _edits(folder: MapFolder) -> MapEdits | None:
    try:
        return folder.map_edits()
    except MapError:
        return None


def _places(folder: MapFolder) -> tuple[str, ...] | None:
    try:
        return folder.named_poses().names
    except MapError:
        return None


def _size(path: Path) -> int | None:
    return path.stat().st_size if path.is_file() else None
