"""Contents of a map folder: its keyframes as parts of a new map, connected pieces, occupancy grid and figures."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import asdict, dataclass, replace
from itertools import pairwise
from pathlib import Path
from typing import Any, Self

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from wheelsight.core.errors import MapError
from wheelsight.core.files import StrPath
from wheelsight.core.geometry import BoolArray, FloatArray, IntArray
from wheelsight.core.inputs import is_there
from wheelsight.core.keyframes import KeyframeId
from wheelsight.core.settings import RecognitionSettings
from wheelsight.io.ros_map import write_ros_map
from wheelsight.mapping import MapEdits, NamedPoses, OccupancyGrid, OccupancyMapper, OccupancySettings, SurfelMap
from wheelsight.places.recognition import Recognizer
from wheelsight.slam.graph import RelativePose
from wheelsight.slam.maps.folder import OCCUPANCY_FILE, OCCUPANCY_IMAGE, RECOGNITION_FILE, SURFELS_FILE, MapFolder
from wheelsight.slam.maps.journal import GRAPH, HEADER_FILE, KEYFRAMES, Health, MapHeader, Place, Record, journals_of
from wheelsight.slam.maps.keyframes import KeptKeyframes, Size

Progress = Callable[[str, int, int], None]

# Standard deviations from which an edge does not connect its keyframes, as of a camera that was carried away. Chosen.
_SURE_M, _SURE_RAD = 0.5, 0.3


@dataclass(frozen=True, slots=True, eq=False)
class MapParts:
    """Keyframes of a new map, numbered from 0 without gaps, with poses and edges. Their records stay in the old maps.

    Attributes:
        places: pose of each keyframe when it was added.
        T_map_keyframe: (N, 4, 4) current poses.
        camera_px: width and height of the camera.
    """

    where: tuple[tuple[Path, Record], ...]
    places: tuple[Place, ...]
    T_map_keyframe: FloatArray
    edges: tuple[RelativePose, ...]
    camera_px: Size

    @classmethod
    def of(cls, folder: MapFolder) -> Self:
        """Return all keyframes of a map in order, except those whose image or pose is lost to damage."""
        kept = np.flatnonzero(are_there(folder))
        where, places = folder.contents.where, folder.contents.places
        records, at = [where[number] for number in kept.tolist()], [places[number] for number in kept.tolist()]
        numbers = new_numbers(kept, len(folder.store))
        T, edges = folder.store.T_map_keyframe[kept], renumbered(folder.edges, numbers)
        return cls(tuple(records), tuple(at), T, edges, folder.header.camera.size_px)

    def __len__(self) -> int:
        return len(self.where)

    def beside(self, other: MapParts) -> MapParts:
        """Return both, the other one's keyframes after these."""
        shift = np.arange(len(other)) + len(self)
        T = np.concatenate([self.T_map_keyframe, other.T_map_keyframe])
        edges = (*self.edges, *renumbered(other.edges, shift))
        return MapParts((*self.where, *other.where), (*self.places, *other.places), T, edges, self.camera_px)

    def some(self, kept: Sequence[int] | IntArray) -> MapParts:
        """Return these keyframes alone, in ascending order, with the edges between them."""
        rows = np.asarray(kept, np.int64)
        where, places = [self.where[row] for row in rows.tolist()], [self.places[row] for row in rows.tolist()]
        edges = renumbered(self.edges, new_numbers(rows, len(self)))
        return MapParts(tuple(where), tuple(places), self.T_map_keyframe[rows], edges, self.camera_px)

    def store(self, memory_keyframes: int) -> KeptKeyframes:
        """Return a store that reads the keyframes on demand."""
        return KeptKeyframes(dict(enumerate(self.where)), self.T_map_keyframe, memory_keyframes, self.camera_px)


def are_there(folder: MapFolder) -> BoolArray:
    """Return (N,) which keyframes of a map have both image and pose."""
    there: BoolArray = np.asarray(np.isfinite(folder.store.T_map_keyframe).all(axis=(1, 2)))
    there[[int(number) for number in folder.store.missing]] = False
    return there


@dataclass(frozen=True, slots=True, eq=False)
class MapAnnotations:
    """User annotations of a map, attached to its keyframes: edits and named poses."""

    edits: MapEdits
    poses: NamedPoses

    def save(self, folder: MapFolder) -> None:
        """Write them into a map that is open for writing. Raises OutputError."""
        if len(self.edits):
            folder.save_edits(self.edits)
        if len(self.poses):
            folder.save_named_poses(self.poses)


def current_edits(folder: MapFolder) -> MapEdits:
    """Return the edits of a map at their current poses. Those of a lost keyframe stay where they were drawn.

    Raises MapError.
    """
    return folder.map_edits().transferred(folder.store.T_map_keyframe, _own_numbers(folder))


def current_named_poses(folder: MapFolder) -> NamedPoses:
    """Return the named poses of a map, likewise. Raises MapError."""
    return folder.named_poses().transferred(folder.store.T_map_keyframe, _own_numbers(folder))


def _own_numbers(folder: MapFolder) -> IntArray:
    """Return (K,) the number of each keyframe, -1 for lost ones."""
    there = are_there(folder)
    return np.where(there, np.arange(len(there)), -1)


def transferred(folder: MapFolder, kept: IntArray, first: int = 0, *, is_same_frame: bool = True) -> MapAnnotations:
    """Return the annotations of a map for a new map made of its parts; see `MapEdits.transferred`. Raises MapError.

    Args:
        kept: kept rows of the new map's parts, in ascending order.
        first: row of the folder's first keyframe in these parts.
    """
    there = np.flatnonzero(are_there(folder))
    numbers = np.full(len(folder.store), -1)
    of_kept = new_numbers(kept, max(int(kept.max(initial=-1)) + 1, first + len(there)))
    numbers[there] = of_kept[first : first + len(there)]
    T = folder.store.T_map_keyframe
    edits = folder.map_edits().transferred(T, numbers, is_same_frame=is_same_frame)
    return MapAnnotations(edits, folder.named_poses().transferred(T, numbers, is_same_frame=is_same_frame))


def new_numbers(kept: IntArray, count: int) -> IntArray:
    """Return (count,) the new number of each keyframe if only `kept` ones remain; -1 for the others."""
    numbers = np.full(count, -1)
    numbers[kept] = np.arange(len(kept))
    return numbers


def renumbered(edges: Sequence[RelativePose], numbers: IntArray) -> tuple[RelativePose, ...]:
    """Return the edges between keyframes with a new number (N,)."""
    ends = ((edge, int(numbers[edge.first]), int(numbers[edge.second])) for edge in edges)
    return tuple(
        replace(edge, first=KeyframeId(first), second=KeyframeId(second))
        for edge, first, second in ends
        if min(first, second) >= 0
    )


def write_parts(
    parts: MapParts, new: MapFolder, made: tuple[Recognizer, SurfelMap | None, MapAnnotations], on_keyframe: Progress
) -> None:
    """Write parts into an empty map.

    Args:
        on_keyframe: called with the current task, the number of finished keyframes, and their total.

    Raises MapError if a keyframe cannot be read, and OutputError.
    """
    recognizer, surfel_map, annotations = made
    store = parts.store(new.settings.memory_keyframes)
    for number, place in enumerate(parts.places):
        new.append_keyframe(number, store[KeyframeId(number)], parts.T_map_keyframe[number], place.T_odom_keyframe)
        on_keyframe("writing", number + 1, len(parts))
    new.append_edges(parts.edges)
    new.save_recognition(recognizer)
    if surfel_map is not None:
        new.save_surfels(surfel_map)
    annotations.save(new)


def recognizer_of(parts: MapParts, settings: RecognitionSettings | None, on_keyframe: Progress) -> Recognizer:
    """Return a new recognizer of the keyframes of parts."""
    store, made = parts.store(1), Recognizer(settings)
    for number in store:
        made.add(number, store[number])
        on_keyframe("recognition", number + 1, len(parts))
    return made


def in_largest_piece(folder: MapFolder) -> BoolArray:
    """Return (N,) which keyframes belong to the largest piece connected by certain edges."""
    there = are_there(folder)
    together = np.zeros(len(there), bool)
    together[there] = pieces_of(MapParts.of(folder)) == 0
    return together


def pieces_of(parts: MapParts) -> IntArray:
    """Return the piece (N,) of each keyframe, connected by certain edges; the largest piece is 0."""
    piece = connected([edge for edge in parts.edges if _is_sure(edge)], len(parts))
    order = np.argsort(-np.bincount(piece, minlength=1), kind="stable")
    return np.asarray(np.argsort(order)[piece], np.int64)


def connected(edges: Sequence[RelativePose], count: int) -> IntArray:
    """Return the connected component (count,) of each keyframe, from 0."""
    if not count:
        return np.zeros(0, np.int64)
    ends = np.array([(edge.first, edge.second) for edge in edges], np.int64).reshape(-1, 2)
    graph = coo_array((np.ones(len(ends)), (ends[:, 0], ends[:, 1])), shape=(count, count))
    return np.asarray(connected_components(graph, directed=False)[1], np.int64)


def _is_sure(edge: RelativePose) -> bool:
    """Return whether an edge constrains its keyframes; that of a camera that was carried away does not."""
    sigmas: FloatArray = np.sqrt(np.diag(edge.covariance))
    return bool((sigmas[:3] < _SURE_M).all() and (sigmas[3:] < _SURE_RAD).all())


OccupancyProgress = Callable[[int, int], None]

# In a 1 m step with a turn of 90 degrees, the robot was 0.2 m off the straight line. On a longer step it may have
# passed behind a wall.
_STRAIGHT_M = 1.0


def occupancy_of(
    folder: MapFolder,
    settings: OccupancySettings | None = None,
    on_keyframe: OccupancyProgress = lambda done, total: None,
    mapper: OccupancyMapper | None = None,
) -> OccupancyGrid:
    """Return the occupancy grid of a map, with its edits applied.

    Only the largest piece connected by certain edges is used, since the relative poses of the others are unknown.

    Args:
        on_keyframe: called with the number of keyframes read and their total, if any are read.
        mapper: mapper of these settings that already has some of the keyframes.

    Raises MapError if the calibration has no camera mount, a keyframe or the edits cannot be read, or the grid would be
    too large.
    """
    made = mapper or OccupancyMapper(folder.calibration, settings or folder.settings.occupancy)
    together = in_largest_piece(folder)
    todo = [KeyframeId(int(number)) for number in np.flatnonzero(together) if number not in made]
    for done, number in enumerate(todo, start=1):
        made.keep(number, folder.store[number])
        on_keyframe(done, len(todo))
    made.move(folder.store.T_map_keyframe, together)
    return current_edits(folder).applied(made.grid(), folder.store.T_map_keyframe)


def save_occupancy(
    folder: MapFolder, on_keyframe: OccupancyProgress = lambda done, total: None, mapper: OccupancyMapper | None = None
) -> OccupancyGrid | None:
    """Write the occupancy grid of an open map into its folder, and return it; None without a calibrated camera mount.

    Raises MapError as `occupancy_of` does, and OutputError.
    """
    if folder.calibration.T_base_camera is None:
        return None
    grid = occupancy_of(folder, None, on_keyframe, mapper)
    write_ros_map(grid.to_ros(), folder.path / OCCUPANCY_FILE)
    return grid


def add_occupancy(new: MapFolder, on_keyframe: Callable[[str, int, int], None]) -> None:
    """Write the occupancy grid of a map under construction, if possible: a map is complete without it.

    `occupancy_of` gives the reason if it is missing. Raises OutputError.
    """
    with suppress(MapError):
        so_far = MapFolder.open(new.path, settings=new.settings, is_incomplete_read=True)
        save_occupancy(so_far, lambda done, total: on_keyframe("occupancy", done, total))


def driven_way(folder: MapFolder) -> tuple[FloatArray, ...]:
    """Return paths (K, 3) of x, y, yaw of the base at connected keyframes; of the camera without a mount.

    The robot drove about straight between successive poses of a path. Between paths, its way is unknown or belongs to
    another drive.
    """
    numbers = np.flatnonzero(in_largest_piece(folder))
    if not len(numbers):
        return ()
    T = folder.store.T_map_keyframe[numbers]
    if folder.calibration.T_base_camera is not None:
        T = T @ np.linalg.inv(folder.calibration.T_base_camera)
    at = np.column_stack([T[:, :2, 3], np.arctan2(T[:, 1, 0], T[:, 0, 0])])
    driven = {(int(edge.first), int(edge.second)) for edge in folder.edges if not edge.is_loop and _is_sure(edge)}
    is_step = np.array([ends in driven for ends in pairwise(numbers.tolist())], bool)  # empty for one keyframe
    is_step &= np.linalg.norm(np.diff(at[:, :2], axis=0), axis=1) <= _STRAIGHT_M
    return tuple(np.split(at, np.flatnonzero(~is_step) + 1))


MAP_FOLDER = "map"
_OF_RUN = ("", "joined", "dense", "features", "own")


@dataclass(frozen=True, slots=True)
class MapInfo:
    """Figures of a map folder.

    Attributes:
        keyframes: number of readable keyframes.
        edges, loops: number of odometry edges and of loops between them.
        begin_s, end_s: stamps of the first and the last keyframe; None without any.
        length_m: path length from keyframe to keyframe, by current poses.
        keyframe_bytes: mean size of a keyframe, with its pose, edges and moves.
        surfel_bytes, recognition_bytes, occupancy_bytes: sizes of these files; None if missing.
        edits: number of zones and wiped obstacles; None if their file cannot be read.
        areas: names of areas, from the same file; likewise.
        places: names of poses; likewise.
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
        """Return plain nested values."""
        figures = {name: getattr(self, name) for name in self.__slots__ if name not in ("header", "health")}
        health = {"is_whole": self.health.is_whole, "notes": list(self.health.notes)}
        return {**asdict(self.header), **figures, "health": health}


def info_of(folder: MapFolder) -> MapInfo:
    """Return the figures of an open map."""
    path, store, edges = folder.path, folder.store, folder.edges
    edits: MapEdits | None = None
    places: tuple[str, ...] | None = None
    with suppress(MapError):
        edits = folder.map_edits()
    with suppress(MapError):
        places = folder.named_poses().names
    about, image = _size(path / OCCUPANCY_FILE), _size(path / OCCUPANCY_IMAGE)
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
        occupancy_bytes=None if about is None or image is None else about + image,
        edits=None if edits is None else len(edits) - len(edits.areas),
        areas=None if edits is None else edits.area_names,
        places=places,
        health=folder.contents.health,
    )


def _size(path: Path) -> int | None:
    return path.stat().st_size if path.is_file() else None


def is_map(path: StrPath) -> bool:
    """Return whether a folder has a map header."""
    return is_there(Path(path) / HEADER_FILE)


def find_map(path: StrPath) -> Path:
    """Return the map folder at a path: the path itself, or the map of a run's folder. Raises MapError."""
    path = Path(path)
    if not is_there(path):
        raise MapError("there is no such folder", path=path, fix="check the path")
    own = [path, *(path / track / MAP_FOLDER for track in _OF_RUN)]
    found = next((folder for folder in own if is_map(folder)), None)
    if found is None:
        fix = "make one: wheelsight run RECORDING --odometry dense --map surfels --out DIR"
        raise MapError("is no map, and no folder of a run with one", path=path, fix=fix)
    return found
