"""MapFolder: reads and writes a map on disk. MapLock: prevents two runs from writing the same map."""

from __future__ import annotations

import fcntl
import os
import re
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import replace
from pathlib import Path
from typing import Any, Self

from wheelsight.core.calibration import Calibration, load_calibration, save_calibration
from wheelsight.core.errors import ArgumentError, InputError, MapError, OutputError
from wheelsight.core.files import StrPath, make_output_folder, output_error, refuse_full
from wheelsight.core.geometry import FloatArray, IntArray, se3
from wheelsight.core.geometry.arrays import UInt64Array
from wheelsight.core.inputs import is_there
from wheelsight.core.keyframes import Keyframe, KeyframeId
from wheelsight.core.settings import RecognitionSettings
from wheelsight.mapping import MapEdits, NamedPoses, SurfelMap, load_map, save_map
from wheelsight.places.recognition import NO_FEATURES, Recognizer
from wheelsight.slam.graph import RelativePose
from wheelsight.slam.maps.journal import (
    GRAPH,
    HEADER_FILE,
    KEYFRAMES,
    REMOVAL,
    RUN_AGAIN,
    FolderContents,
    Health,
    JournalWriter,
    MapCamera,
    MapHeader,
    Place,
    Record,
    RecordKind,
    journal_name,
    journals_of,
    next_number,
    pack_edges,
    pack_numbers,
    pack_place,
    pack_poses,
    read_contents,
    read_header,
)
from wheelsight.slam.maps.keyframes import DepthSteps, KeptKeyframes, pack_keyframe, read_descriptors
from wheelsight.slam.settings import SessionSettings

CALIBRATION_FILE, RECOGNITION_FILE, SURFELS_FILE = "calibration.yaml", "recognition.npz", "map.surfels"
OCCUPANCY_FILE, OCCUPANCY_IMAGE, EDITS_FILE = "occupancy.yaml", "occupancy.pgm", "edits.json"
PLACES_FILE = "places.json"
_MADE = (RECOGNITION_FILE, SURFELS_FILE, OCCUPANCY_FILE, OCCUPANCY_IMAGE, EDITS_FILE, PLACES_FILE)
_FILES = (HEADER_FILE, CALIBRATION_FILE, *_MADE)
_TEMPORARY = re.compile(rf"\.({'|'.join(map(re.escape, _FILES))})\.[0-9a-f]{{8}}")
_JOURNAL_KEYFRAMES = 64  # keyframes per journal: 4 MB
_READ_ONLY = "open it with read_only=False"
# Largest number of records in a graph journal that is written; readers accept three times as many.
_GRAPH_RECORDS = 100_000
NEW_FOLDER = "choose a folder that is empty or not there yet: no map is written over"


class MapFolder:
    """A map on disk: keyframes, their poses, edges between them, and data made of them.

    `create` begins a new map, and `open` reads one. Keyframes, edges and poses can be appended unless it is read-only.
    `store`, `edges` and `contents` show the state at opening, without later appends.

    Nothing is rewritten in place: each writer begins its own journals. Not thread-safe.

    Attributes:
        contents: contents of its journals at opening.
        store: its keyframes at opening.
    """

    def __init__(
        self,
        path: Path,
        header: MapHeader,
        calibration: Calibration,
        contents: FolderContents,
        settings: SessionSettings,
        lock: MapLock | None,
    ) -> None:
        self.path, self.header, self.calibration, self.settings = path, header, calibration, settings
        self.contents, self._lock = contents, lock
        self.store = KeptKeyframes(
            contents.where, contents.T_map_keyframe, settings.memory_keyframes, header.camera.size_px
        )
        self._steps = DepthSteps.of_noise(calibration.depth_noise)
        self._journals = _Journals(path)
        self._edge_count = contents.edge_count
        self._where = dict(contents.where)

    @classmethod
    def create(
        cls,
        path: StrPath,
        calibration: Calibration,
        settings: SessionSettings | None = None,
        *,
        source: str = "",
        depth_factor: float | None = None,
        unfinished: str = "",
    ) -> Self:
        """Begin a map in an empty or missing folder.

        Args:
            depth_factor: depth units per metre, if different from the recording format's.
            unfinished: what makes the map until `finish`, one of `journal.MAKERS`; "": it is always finished.

        Raises OutputError if the folder is not empty, or cannot be made or written, and CalibrationError if there is no
        camera.
        """
        settings, path = settings or SessionSettings(), Path(path)
        header = MapHeader.new(MapCamera.of(calibration, depth_factor), source, unfinished)
        refuse_full(path, NEW_FOLDER)
        make_output_folder(path, force=True)
        lock = MapLock(path)
        try:
            save_calibration(calibration, path / CALIBRATION_FILE)
            header.save(path)  # written last: its presence makes the folder a map
            return cls(path, header, calibration, read_contents(path), settings, lock)
        except BaseException:
            lock.release()
            raise

    @classmethod
    def open(
        cls,
        path: StrPath,
        *,
        read_only: bool = True,
        settings: SessionSettings | None = None,
        is_incomplete_read: bool = False,
    ) -> Self:
        """Read a map.

        Args:
            read_only: whether appending is disabled.
            is_incomplete_read: whether to accept the output of an interrupted rebuild, merge or prune.

        Raises MapError if it is not a map, of a newer version, incomplete, damaged too much, or being written by
        another run, CalibrationError if its calibration is damaged, and OutputError if it is opened for writing and not
        writable.
        """
        path, settings = Path(path), settings or SessionSettings()
        header = read_header(path)
        state: dict[str, Any] = {"unfinished": header.unfinished}
        state["is_being_made"] = bool(header.unfinished) and MapLock.is_held(path)
        incomplete = Health(**state).incomplete
        if incomplete and not is_incomplete_read:
            raise MapError(f"is {incomplete}", path=path, fix=RUN_AGAIN)
        lock = None if read_only else MapLock(path)
        try:
            contents = read_contents(path)
            contents = replace(contents, health=replace(contents.health, **state))
            if lock is not None:
                _remove(_temporaries(path))
            calibration = load_calibration(path / CALIBRATION_FILE)
            return cls(path, header, calibration, contents, settings, lock)
        except BaseException:
            if lock is not None:
                lock.release()
            raise

    @property
    def edges(self) -> tuple[RelativePose, ...]:
        """Valid edges at opening, of odometry and loops."""
        return self.contents.edges

    def check_camera(self, calibration: Calibration, depth_factor: float | None = None) -> None:
        """Raise MapError with the difference if a calibration is of another camera than the map's."""
        camera = MapCamera.of(calibration, depth_factor)
        why = self.header.camera.why_other(camera)
        if why is not None:
            fix = "give the map of this camera, or --camera and --calibration as when it was made"
            raise MapError(f"is of another camera: {why}", path=self.path, fix=fix)

    def append_keyframe(
        self, number: int, keyframe: Keyframe, T_map_keyframe: FloatArray, T_odom_keyframe: FloatArray | None = None
    ) -> tuple[Path, Record]:
        """Write a keyframe, and return its journal and record. Of records with the same number, the last is valid.

        Args:
            T_map_keyframe: (4, 4) current pose.
            T_odom_keyframe: (4, 4) pose in odom, if known.

        Raises OutputError if it cannot be written, or the map is read-only, and ArgumentError if a pose is not a rigid
        motion.
        """
        for T in (T_map_keyframe, T_odom_keyframe):
            if T is not None and not se3.is_valid(T):
                raise ArgumentError(f"the pose of keyframe {number} is no rigid motion", fix="give SE(3), (4, 4)")
        self._need_lock()
        content = pack_keyframe(keyframe, self._steps, self.settings.most_kb)
        journal = self._journals.of(KEYFRAMES)
        record = journal.append(RecordKind.KEYFRAME, number, content)
        self._where[number] = journal.path, record
        place = pack_place(Place(keyframe.stamp_s, T_map_keyframe, T_odom_keyframe))
        self._journals.of(GRAPH).append(RecordKind.PLACE, number, place)
        return journal.path, record

    def append_edges(self, edges: Sequence[RelativePose]) -> tuple[int, ...]:
        """Write edges, and return their numbers, which `withdraw_edges` takes. Raises OutputError."""
        self._need_lock()
        first = self._edge_count
        if edges:
            self._journals.of(GRAPH).append(RecordKind.EDGES, first, pack_edges(edges))
            self._edge_count += len(edges)
        return tuple(range(first, self._edge_count))

    def withdraw_edges(self, numbers: Sequence[int]) -> None:
        """Withdraw edges, such as loops found to be wrong. Raises OutputError."""
        self._need_lock()
        if numbers:
            self._journals.of(GRAPH).append(RecordKind.WITHDRAWN, 0, pack_numbers(numbers))

    def append_poses(self, numbers: Sequence[int] | IntArray, T_map_keyframe: FloatArray) -> None:
        """Write poses (K, 4, 4) of keyframes (K,); the last pose of each is valid. Raises OutputError."""
        self._need_lock()
        if len(numbers):
            self._journals.of(GRAPH).append(RecordKind.POSES, 0, pack_poses(numbers, T_map_keyframe))

    def flush(self) -> None:
        """Make appended data survive a loss of power. Raises OutputError."""
        self._journals.flush()

    def save_recognition(self, recognizer: Recognizer) -> None:
        """Write the recognizer of the keyframes, so that the next drive does not rebuild it. Raises OutputError."""
        self._need_lock()
        recognizer.save(self.path / RECOGNITION_FILE, self._descriptors)

    def save_surfels(self, surfel_map: SurfelMap) -> None:
        """Write a surfel map attached to the map's keyframes. Raises OutputError."""
        self._need_lock()
        save_map(surfel_map, self.path / SURFELS_FILE)

    def map_edits(self) -> MapEdits:
        """Return the edits of the map, zones and wiped obstacles; empty without a file. Raises MapError."""
        path = self.path / EDITS_FILE
        return MapEdits.load(path) if is_there(path) else MapEdits()

    def save_edits(self, edits: MapEdits) -> None:
        """Write the edits of the map in place of the present ones. Raises OutputError."""
        self._need_lock()
        edits.save(self.path / EDITS_FILE)

    def named_poses(self) -> NamedPoses:
        """Return the named poses of the map; empty without a file. Raises MapError."""
        path = self.path / PLACES_FILE
        return NamedPoses.load(path) if is_there(path) else NamedPoses()

    def save_named_poses(self, poses: NamedPoses) -> None:
        """Write the named poses in place of the present ones. Raises OutputError."""
        self._need_lock()
        poses.save(self.path / PLACES_FILE)

    def begin(self, unfinished: str) -> None:
        """Mark the map as being made by one of `journal.MAKERS`, until `finish`. Raises OutputError."""
        self._need_lock()
        if self.header.unfinished != unfinished:
            self.header = replace(self.header, unfinished=unfinished)
            self.header.save(self.path)

    def finish(self) -> None:
        """Flush all data, then mark the map as finished. Raises OutputError."""
        self.flush()
        self.begin("")

    def close(self) -> None:
        """Flush, and release the lock. Raises OutputError."""
        lock, self._lock = self._lock, None
        try:
            self._journals.close()
        finally:
            if lock is not None:
                lock.release()

    def recognizer(
        self,
        settings: RecognitionSettings | None = None,
        on_keyframe: Callable[[int, int], None] = lambda done, total: None,
    ) -> Recognizer:
        """Return the recognizer of the keyframes: loaded and completed, or rebuilt if its file is missing or does not
        match.

        Args:
            settings: settings, or None for the defaults; a file of other settings is not used.
            on_keyframe: called with the number of added keyframes and their total, if any are added.

        Raises MapError if a keyframe cannot be read.
        """
        path, numbers = self.path / RECOGNITION_FILE, list(self.store)
        needed = settings or RecognitionSettings()
        found = Recognizer(needed)
        if is_there(path):
            with suppress(MapError):  # it can be rebuilt
                found = Recognizer.load(path, self._descriptors, settings=needed, most_keyframes=len(self.store))
        known = set(found.keyframes)
        if not known <= set(numbers):
            found, known = Recognizer(settings), set()
        todo = [number for number in numbers if number not in known]
        for done, number in enumerate(todo, start=1):
            found.add(number, self.store[number])
            on_keyframe(done, len(todo))
        return found

    def surfels(self) -> SurfelMap | None:
        """Return the surfel map at the current keyframe poses; None if there is none. Raises MapError."""
        path = self.path / SURFELS_FILE
        if not is_there(path):
            return None
        surfel_map = load_map(path)
        if len(surfel_map.T_map_keyframe) > len(self.store):
            fix = "rebuild it: wheelsight map rebuild"
            raise MapError("is attached to keyframes that the map does not have", path=path, fix=fix)
        surfel_map.attach_to(self.store)
        return surfel_map

    def _descriptors(self, number: KeyframeId) -> UInt64Array:
        """Return the descriptors of a keyframe's record; empty if it is lost."""
        try:
            return read_descriptors(*self._where[number])
        except (KeyError, MapError):
            return NO_FEATURES.descriptors

    def _need_lock(self) -> None:
        if self._lock is None:
            raise OutputError("is read-only here", path=self.path, fix=_READ_ONLY)


class _Journals:
    """The journals of one writer, begun on demand, with a limited number of records per journal."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._open: dict[str, tuple[JournalWriter, int]] = {}

    def of(self, kind: str) -> JournalWriter:
        """Return the journal for the next record, of keyframes or of the graph."""
        journal, count = self._open.pop(kind, (None, 0))
        if journal is not None and count >= (_JOURNAL_KEYFRAMES if kind == KEYFRAMES else _GRAPH_RECORDS):
            journal.close()
            journal = None
        if journal is None:
            journal, count = JournalWriter(self._folder / journal_name(kind, next_number(self._folder, kind))), 0
        self._open[kind] = journal, count + 1
        return journal

    def flush(self) -> None:
        """Flush the keyframes first: a pose without its keyframe is useless."""
        for kind in (KEYFRAMES, GRAPH):
            if kind in self._open:
                self._open[kind][0].flush()

    def close(self) -> None:
        """Close both journals, the keyframes first, even if one fails."""
        journals, self._open = self._open, {}
        with ExitStack() as stack:
            for kind in (GRAPH, KEYFRAMES):
                if kind in journals:
                    stack.callback(journals[kind][0].close)


@contextmanager
def map_being_made(out: StrPath, maker: str, like: MapFolder, source: str | None = None) -> Iterator[MapFolder]:
    """Yield a new map with the calibration and settings of another, to be written in the block.

    At the end of the block the map is marked as finished. If the block fails, the map is removed. After a kill, the map
    is marked as incomplete, and the next one in its place replaces it.

    Args:
        out: folder that is empty, missing, or left by an interrupted call.
        maker: one of `journal.MAKERS`.
        like: map with the calibration and settings.
        source: name of the source, or None for that of `like`.

    Raises OutputError, and MapError if another process makes a map there.
    """
    make_room(out)
    name, factor = like.header.source if source is None else source, like.header.camera.depth_factor
    new = MapFolder.create(out, like.calibration, like.settings, source=name, depth_factor=factor, unfinished=maker)
    try:
        yield new
        new.finish()
        new.close()
    except BaseException:
        with suppress(InputError):
            new.close()
        with suppress(InputError):
            discard_map(out)
        raise


def make_room(out: StrPath) -> None:
    """Remove the output of an interrupted rebuild, merge or prune. Raise OutputError if the folder has other contents.

    Raises MapError if another process makes a map there.
    """
    out = Path(out)
    # A folder with an unusable map, or with only the first or last files of one.
    is_left_over = not is_there(out / HEADER_FILE) and _is_bare(out)
    if is_there(out / HEADER_FILE):
        with suppress(MapError):
            is_left_over = not read_header(out).is_usable
    if is_left_over:
        discard_map(out)
    refuse_full(out, NEW_FOLDER)


def _is_bare(path: Path) -> bool:
    """Return whether a folder has no more than the first files of a map, written before its header."""
    try:
        files = list(path.iterdir())
    except OSError:
        return False
    return (path / LOCK_FILE) in files and {*files} <= {path / LOCK_FILE, path / CALIBRATION_FILE, *_temporaries(path)}


def _temporaries(path: Path) -> list[Path]:
    """Return unfinished files of a killed process; see `files.atomic_write`."""
    return [file for file in path.iterdir() if _TEMPORARY.fullmatch(file.name)]


def _remove(files: Iterable[Path]) -> None:
    """Remove files. Raises OSError."""
    for file in files:
        file.unlink(missing_ok=True)


def discard_map(path: StrPath) -> None:
    """Remove a map; other files in its folder remain.

    Raises MapError if another run writes it, and OutputError if it cannot be removed.
    """
    path = Path(path)
    if not is_there(path / HEADER_FILE) and not _is_bare(path):
        return
    lock = MapLock(path)
    try:
        # After a kill here, `make_room` recognizes the rest as removable, rather than as a map with missing parts.
        try:
            replace(read_header(path), unfinished=REMOVAL).save(path)
        except InputError:  # damaged, or the disk is full
            _remove([path / HEADER_FILE])
        _remove([*journals_of(path, KEYFRAMES), *journals_of(path, GRAPH), *_temporaries(path)])
        _remove(path / name for name in (*_MADE, CALIBRATION_FILE, HEADER_FILE, LOCK_FILE))
        if not any(path.iterdir()):
            path.rmdir()
    except OSError as error:
        raise output_error(error, path) from error
    finally:
        lock.release()


LOCK_FILE = "lock"
_LONGEST = 32


class MapLock:
    """Locks a map folder for one writer, until `release`.

    The system releases the lock when the process ends, even after a kill.

    Raises MapError if another run writes the map, and OutputError if the folder is not writable.
    """

    def __init__(self, folder: StrPath) -> None:
        path = Path(folder) / LOCK_FILE
        try:
            self._descriptor = os.open(path, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC | os.O_NOFOLLOW, 0o644)
        except OSError as error:
            raise output_error(error, path) from error
        try:
            fcntl.flock(self._descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
            os.ftruncate(self._descriptor, 0)
            os.pwrite(self._descriptor, f"{os.getpid()}\n".encode(), 0)
        except BlockingIOError as error:
            number = os.pread(self._descriptor, _LONGEST, 0).decode("ascii", "replace").strip()
            holder = number if number.isdecimal() else "unknown number"
            os.close(self._descriptor)
            fix = "wait until it ends, or choose another map"
            raise MapError(f"another run, of process {holder}, writes this map", path=Path(folder), fix=fix) from error
        except OSError as error:
            os.close(self._descriptor)
            raise output_error(error, path) from error

    @staticmethod
    def is_held(folder: StrPath) -> bool:
        """Return whether a process currently writes a map."""
        try:
            descriptor = os.open(Path(folder) / LOCK_FILE, os.O_RDONLY | os.O_CLOEXEC | os.O_NOFOLLOW | os.O_NONBLOCK)
        except OSError:
            return False
        try:
            fcntl.flock(descriptor, fcntl.LOCK_SH | fcntl.LOCK_NB)
        except OSError:
            return True
        finally:
            os.close(descriptor)
        return False

    def release(self) -> None:
        """Release the lock; the file remains."""
        descriptor, self._descriptor = self._descriptor, -1
        with suppress(OSError):
            os.close(descriptor)
