"""MapWriter: writes a map during a drive, in a thread of its own."""

from __future__ import annotations

import queue
import threading
import time
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Self

import numpy as np

from wheelsight.core.calibration import Calibration
from wheelsight.core.errors import InputError, OutputError
from wheelsight.core.estimates import Estimate
from wheelsight.core.geometry import FloatArray, se3
from wheelsight.core.keyframes import Keyframe, KeyframeFeatures, KeyframeId, KeyframeStore
from wheelsight.core.settings import RecognitionSettings
from wheelsight.mapping import OccupancyMapper, SurfelMap
from wheelsight.places.recognition import Recognizer
from wheelsight.slam.graph import RelativePose, step_edge
from wheelsight.slam.maps.contents import save_occupancy
from wheelsight.slam.maps.folder import MapFolder
from wheelsight.slam.maps.journal import DRIVE, Record
from wheelsight.slam.maps.keyframes import DepthSteps, pack_keyframe, read_keyframe
from wheelsight.slam.settings import SessionSettings

# Edges between successive keyframes, from estimates whose covariances grow along the way.


@dataclass(frozen=True, slots=True, eq=False)
class SeenKeyframe:
    """A keyframe as the estimate at its own frame has it.

    Attributes:
        number: of the keyframe.
        T_odom_keyframe: (4, 4), or None where that estimate tells none.
        covariance: (6, 6) of its left perturbation (v, ω), or None.
    """

    number: KeyframeId
    T_odom_keyframe: FloatArray | None = None
    covariance: FloatArray | None = None

    @classmethod
    def of(cls, number: KeyframeId, estimate: Estimate | None) -> Self:
        """By the estimate at the frame of which the keyframe was made."""
        if estimate is None or estimate.keyframe != number or estimate.T_filter_body is None:
            return cls(number)
        if estimate.T_keyframe_body is None:
            return cls(number)
        T_odom_keyframe = se3.nearest(estimate.T_filter_body @ se3.invert(estimate.T_keyframe_body))
        return cls(number, T_odom_keyframe, estimate.filter_covariance)


def odometry_edge(before: SeenKeyframe, now: SeenKeyframe, settings: SessionSettings) -> RelativePose | None:
    """The way from a keyframe to the next, as uncertain as covariances grew on it; None where odometry tells none."""
    T_before, C_before, T_now, C_now = before.T_odom_keyframe, before.covariance, now.T_odom_keyframe, now.covariance
    if T_before is None or C_before is None or T_now is None or C_now is None:
        return None
    return step_edge((before.number, now.number), (T_before, C_before), (T_now, C_now), settings)


# MapWriter: writes a map while driving, in a thread of its own.


THREAD = "wheelsight-map-writer"
# Wide enough to be halved where images of most cameras are.
_REHEARSED_PX = 320
_MOUNTED = Calibration(T_base_camera=np.eye(4))


@dataclass(frozen=True, slots=True, eq=False)
class _NewKeyframe:
    seen: SeenKeyframe
    T_map_keyframe: FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class _Moved:
    T_map_keyframe: FloatArray
    is_last: bool


@dataclass(frozen=True, slots=True, eq=False)
class _Edges:
    edges: tuple[RelativePose, ...]
    holds: bool


_Work = _NewKeyframe | _Moved | _Edges


class MapWriter:
    """Takes keyframes from a store as they come, and appends them, what lies between them, and where they move.

    `look` is called after each frame; it copies some numbers and never waits for the disk. All else is done by the
    thread: what it has appended outlives a kill of the process, and each `flush_s` a loss of power. Where the disk is
    full or the folder cannot be written any more, writing ends, the drive goes on, and `warnings` says so.

    Keyframes that are on the disk rest there once `memory_keyframes` newer ones follow: the store reads them again for
    who recognises and verifies. Odometry tracks by what it holds itself.

    Args:
        folder: to append to; the writer closes it.
        store: of the odometry that drives; its keyframes keep their numbers, and those it has already are not written.
        recognition: by what keyframes are recognised on the next drive; None: nobody builds that here.
        now_s: seconds since some moment.
    """

    def __init__(
        self,
        folder: MapFolder,
        store: KeyframeStore,
        recognition: RecognitionSettings | None = None,
        *,
        now_s: Callable[[], float] = time.monotonic,
    ) -> None:
        self._folder, self._store, self._now_s = folder, store, now_s
        self._recognizer = None if recognition is None else Recognizer(recognition)
        _rehearse(folder, recognition)
        self._unsettled: deque[tuple[int, SeenKeyframe]] = deque()
        self._frames, self._taken = 0, len(store)
        self._revision, self._told_s = store.revision, -np.inf
        self._work: queue.SimpleQueue[_Work | None] = queue.SimpleQueue()
        self._is_closed = False
        store.hold(folder.settings.memory_keyframes)
        store.is_written = True
        self._written = _Written(folder, store, self._recognizer)
        self._thread = threading.Thread(target=self._write, name=THREAD, daemon=True)
        self._thread.start()

    @property
    def keyframes(self) -> int:
        """How many are written by now."""
        return self._written.keyframes

    @property
    def taken(self) -> int:
        """How many of the store's are written, or will be: the first ones."""
        return self._taken

    @property
    def warnings(self) -> tuple[str, ...]:
        """What could not be written, and why; one sentence each."""
        return tuple(self._written.warnings)

    def look(self, estimate: Estimate | None) -> None:
        """Take what the frame that `estimate` answers has changed in the store."""
        self._frames += 1
        for number in range(self._taken, len(self._store)):
            self._unsettled.append((self._frames, SeenKeyframe.of(KeyframeId(number), estimate)))
        self._taken = len(self._store)
        self._hand_over(self._frames - self._folder.settings.settled_frames)
        if self._store.revision != self._revision and self._now_s() - self._told_s >= self._folder.settings.flush_s:
            self._tell_poses()

    def add_edges(self, edges: Sequence[RelativePose]) -> None:
        """Keep edges, such as loops.

        Those of odometry between successive keyframes the writer adds by itself; given ones only where it has none.
        """
        self._work.put(_Edges(tuple(edges), holds=True))

    def withdraw_edges(self, edges: Sequence[RelativePose]) -> None:
        """Edges that were added, each by itself and not by what it says, do not hold any more."""
        self._work.put(_Edges(tuple(edges), holds=False))

    def close(self, surfel_map: SurfelMap | None = None, recognizer: Recognizer | None = None) -> None:
        """Write all that is left, and what was made of the keyframes, and close the folder.

        It does not raise, and does nothing a second time.

        Args:
            surfel_map: whose surfels hang on the keyframes.
            recognizer: that knows them, in place of the writer's own.
        """
        if self._is_closed:
            return
        self._is_closed = True
        self._hand_over(self._frames)
        self._tell_poses(is_last=True)
        self._work.put(None)
        self._thread.join()
        self._written.finish(surfel_map, recognizer)

    def _hand_over(self, last_frame: int) -> None:
        """Those that were new at a frame, or before."""
        while self._unsettled and self._unsettled[0][0] <= last_frame:
            _, seen = self._unsettled.popleft()
            self._work.put(_NewKeyframe(seen, self._store.pose(seen.number)))

    def _tell_poses(self, *, is_last: bool = False) -> None:
        # Of those handed over alone; the others come with the pose that they have by then.
        count = self._taken - len(self._unsettled)
        self._work.put(_Moved(self._store.T_map_keyframe[:count].copy(), is_last))
        self._revision, self._told_s = self._store.revision, self._now_s()

    def _write(self) -> None:
        """The thread: work as it comes, and a flush each so often."""
        flushed_s, flush_s = self._now_s(), self._folder.settings.flush_s
        while True:
            try:
                work = self._work.get(timeout=max(flushed_s + flush_s - self._now_s(), 0.001))
            except queue.Empty:
                pass
            else:
                if work is None:
                    return
                self._written.take(work)
            if self._now_s() - flushed_s >= flush_s:
                self._written.flush()
                flushed_s = self._now_s()


def _rehearse(folder: MapFolder, recognition: RecognitionSettings | None) -> None:
    """Let kernels be loaded before the drive, since loading them holds up all threads."""
    width_px = 2 * min(folder.settings.width_px, _REHEARSED_PX)
    images = np.ones((width_px // 2, width_px), np.float32), np.ones((width_px // 2, width_px), np.float32)
    features = KeyframeFeatures(np.ones((1, 2)), np.ones((1, 3)), np.zeros((1, 4), np.uint64))
    keyframe = Keyframe.of_images(0.0, np.array([width_px, width_px, width_px / 2, width_px / 4]), *images, features)
    pack_keyframe(keyframe, DepthSteps.of_noise(folder.calibration.depth_noise, 1.0), folder.settings)
    if recognition is not None:
        Recognizer(recognition).add(KeyframeId(0), keyframe)
    OccupancyMapper(_MOUNTED).add(KeyframeId(0), keyframe, np.eye(4))


class _Written:
    """What has been written; after the first problem of the disk nothing more."""

    def __init__(self, folder: MapFolder, store: KeyframeStore, recognizer: Recognizer | None) -> None:
        self.keyframes, self.warnings = 0, list[str]()
        self._folder, self._store, self._recognizer = folder, store, recognizer
        self._before: SeenKeyframe | None = None
        self._T_map_keyframe, self._moved = folder.contents.T_map_keyframe.copy(), 0
        # With the edge, lest its identity go to another.
        self._edges: dict[int, tuple[RelativePose, int]] = {}
        # Not on the disk for sure before the next flush.
        self._unflushed: list[tuple[KeyframeId, tuple[Path, Record]]] = []
        self._stepped: set[int] = set()  # to which an edge of odometry leads from the one before
        self._is_over = self._is_dirty = False
        is_mounted = folder.calibration.T_base_camera is not None
        self._mapper = OccupancyMapper(folder.calibration, folder.settings.occupancy) if is_mounted else None
        self._do(lambda: folder.begin(DRIVE))

    def take(self, work: _Work) -> None:
        """Append it."""
        match work:
            case _NewKeyframe():
                self._do(lambda: self._add(work))
            case _Moved():
                self._do(lambda: self._move(work.T_map_keyframe, is_last=work.is_last))
            case _Edges():
                self._do(lambda: self._add_edges(work.edges) if work.holds else self._withdraw(work.edges))

    def flush(self) -> None:
        """Where anything was appended since."""
        if self._is_dirty:
            self._do(self._flush)
            self._is_dirty = False

    def finish(self, surfel_map: SurfelMap | None, recognizer: Recognizer | None) -> None:
        """Write what was made of the keyframes, and their occupancy map, and close the folder."""
        found = self._recognizer if recognizer is None else recognizer
        if found is not None:
            self._do(lambda: self._folder.save_recognition(found))
        if surfel_map is not None:
            self._do(lambda: self._folder.save_surfels(surfel_map))
        if self._mapper is not None and self.keyframes and not self._is_over:
            self._save_occupancy(self._mapper)
        self._do(self._folder.finish)
        try:
            self._folder.close()
        except OutputError as error:
            self._end(error)

    def _save_occupancy(self, mapper: OccupancyMapper) -> None:
        """Of all keyframes, of earlier drives too. It can be made of them at any time: a map without it is whole."""
        try:
            save_occupancy(MapFolder.open(self._folder.path, settings=self._folder.settings), mapper=mapper)
        except Exception as error:  # a drive does not end in an error for its sake
            self.warnings.append(f"The occupancy map was not written: {_why(error)}.")

    def _flush(self) -> None:
        """What is on the disk by then need not stay in memory."""
        self._folder.flush()
        for number, where in self._unflushed:
            self._store.rest(number, partial(read_keyframe, *where, self._folder.header.camera.size_px))
        self._unflushed.clear()

    def _add(self, new: _NewKeyframe) -> None:
        number, before = new.seen.number, self._before
        try:
            keyframe = self._store[number]
        except Exception as error:  # whatever went wrong in making it: the drive is told by the store, too
            self.warnings.append(f"Keyframe {number} is not in the map: {error}.")
            return
        where = self._folder.append_keyframe(number, keyframe, new.T_map_keyframe, new.seen.T_odom_keyframe)
        self._unflushed.append((number, where))
        edge = None if before is None else odometry_edge(before, new.seen, self._folder.settings)
        if edge is not None and number not in self._stepped:
            self._folder.append_edges([edge])
            self._stepped.add(number)
        if self._recognizer is not None:
            self._recognizer.add(number, keyframe)
        if self._mapper is not None:
            self._mapper.keep(number, keyframe)
        self._before = new.seen
        self._grow(number + 1)
        self._T_map_keyframe[number] = new.T_map_keyframe
        self.keyframes += 1

    def _add_edges(self, edges: tuple[RelativePose, ...]) -> None:
        new = [edge for edge in edges if edge.is_loop or edge.second not in self._stepped]
        numbers = self._folder.append_edges(new)
        self._edges |= {id(edge): (edge, number) for edge, number in zip(new, numbers, strict=True)}
        self._stepped |= {edge.second for edge in new if not edge.is_loop}

    def _withdraw(self, edges: tuple[RelativePose, ...]) -> None:
        known = [self._edges.pop(id(edge), None) for edge in edges]
        self._folder.withdraw_edges([number for _, number in filter(None, known)])

    def _move(self, T_map_keyframe: FloatArray, *, is_last: bool) -> None:
        """Append the poses that have changed since: at the end all, before as many as there is room for.

        Each loop moves all keyframes by a little: to tell all of them each time would take more the longer one drives.
        """
        self._grow(len(T_map_keyframe))
        known = self._T_map_keyframe[: len(T_map_keyframe)]
        off = np.abs(known - T_map_keyframe).max(axis=(1, 2))  # metres, and of turns about radians
        moved = np.flatnonzero(off > 0)
        if not is_last:
            room = self._folder.settings.moved_poses * self.keyframes - self._moved
            moved = moved[np.argsort(-off[moved], kind="stable")[: max(room, 0)]]
        self._folder.append_poses(moved, T_map_keyframe[moved])
        known[moved] = T_map_keyframe[moved]
        self._moved += len(moved)

    def _grow(self, count: int) -> None:
        if count > len(self._T_map_keyframe):
            more = np.zeros((max(count, 2 * len(self._T_map_keyframe)) - len(self._T_map_keyframe), 4, 4))
            self._T_map_keyframe = np.concatenate([self._T_map_keyframe, more])

    def _do(self, work: Callable[[], None]) -> None:
        if self._is_over:
            return
        try:
            work()
            self._is_dirty = True
        except Exception as error:  # a thread that ends without a word would lose all that comes after
            self._end(error)

    def _end(self, error: Exception) -> None:
        if not self._is_over:
            self.warnings.append(f"The map is not written any further: {_why(error)}.")
        self._is_over = True


def _why(error: Exception) -> str:
    return str(error) if isinstance(error, InputError) else f"{type(error).__name__}: {error}"
