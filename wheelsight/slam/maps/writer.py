"""MapWriter: writes a map during a drive, in its own thread."""

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
from wheelsight.core.threads import in_span
from wheelsight.mapping import OccupancyMapper, SurfelMap
from wheelsight.places.recognition import Recognizer
from wheelsight.slam.graph import RelativePose, step_edge
from wheelsight.slam.maps.contents import save_occupancy
from wheelsight.slam.maps.folder import MapFolder
from wheelsight.slam.maps.journal import DRIVE, Record
from wheelsight.slam.maps.keyframes import WIDTH_PX, DepthSteps, pack_keyframe, read_keyframe


@dataclass(frozen=True, slots=True, eq=False)
class SeenKeyframe:
    """A keyframe with its odometry at the frame it was made of.

    Attributes:
        T_odom_keyframe: (4, 4), or None if the estimate has none.
        covariance: (6, 6) of its left perturbation (v, ω), or None.
    """

    number: KeyframeId
    T_odom_keyframe: FloatArray | None = None
    covariance: FloatArray | None = None

    @classmethod
    def of(cls, number: KeyframeId, estimate: Estimate | None) -> Self:
        """Return a keyframe with the odometry of its frame's estimate."""
        if estimate is None or estimate.keyframe != number or estimate.T_filter_body is None:
            return cls(number)
        if estimate.T_keyframe_body is None:
            return cls(number)
        T_odom_keyframe = se3.nearest(estimate.T_filter_body @ se3.invert(estimate.T_keyframe_body))
        return cls(number, T_odom_keyframe, estimate.filter_covariance)


def odometry_edge(before: SeenKeyframe, now: SeenKeyframe) -> RelativePose | None:
    """Return the odometry edge between successive keyframes; None if either has no odometry."""
    T_before, C_before, T_now, C_now = before.T_odom_keyframe, before.covariance, now.T_odom_keyframe, now.covariance
    if T_before is None or C_before is None or T_now is None or C_now is None:
        return None
    return step_edge((before.number, now.number), (T_before, C_before), (T_now, C_now))


# Frames after which a keyframe is written: the first one is undistorted once the second shows the camera's speed.
_SETTLED_FRAMES = 2
# Changed poses written while driving, for each new keyframe, 104 bytes each; the largest changes first, and all at the
# end. A hundredth of a keyframe's 100 kB: docs/decisions/maps-in-memory-and-on-disk.md.
_MOVED_POSES = 8
THREAD = "wheelsight-map-writer"
_MOUNTED = Calibration(T_base_camera=np.eye(4))


class MapWriter:
    """Appends keyframes, edges and changed poses to a map as they occur.

    `update` is called after each frame; it copies poses and never waits for the disk. A thread does the rest. Appended
    data survives a kill of the process, and a loss of power after the next `flush_s`. If the disk is full or the folder
    cannot be written, writing ends, the drive continues, and `warnings` has the reason.

    A written keyframe leaves the memory once `memory_keyframes` newer ones follow. The store reads it again on demand,
    for recognition and verification. Odometry holds the keyframes it tracks by.

    Args:
        folder: map to append to; the writer closes it.
        store: odometry's store. Keyframes keep their numbers; those it already has are not written.
        recognition: settings of the recognizer written for the next drive; None: it is not built here.
        now_s: clock, seconds.
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
        # Load compiled kernels before the drive, since loading blocks all threads.
        width_px = 2 * WIDTH_PX  # halved as images of most cameras are
        images = np.ones((width_px // 2, width_px), np.float32), np.ones((width_px // 2, width_px), np.float32)
        features = KeyframeFeatures(np.ones((1, 2)), np.ones((1, 3)), np.zeros((1, 4), np.uint64))
        intrinsics = np.array([width_px, width_px, width_px / 2, width_px / 4])
        keyframe = Keyframe.of_images(0.0, intrinsics, *images, features)
        pack_keyframe(keyframe, DepthSteps.of_noise(folder.calibration.depth_noise), folder.settings.most_kb)
        if recognition is not None:
            Recognizer(recognition).add(KeyframeId(0), keyframe)
        OccupancyMapper(_MOUNTED).add(KeyframeId(0), keyframe, np.eye(4))
        self._unsettled: deque[tuple[int, SeenKeyframe]] = deque()
        self._frames, self._taken = 0, len(store)
        self._revision, self._sent_s = store.revision, -np.inf
        self._work: queue.SimpleQueue[Callable[[], None] | None] = queue.SimpleQueue()
        self._is_closed = False
        store.limit_memory(folder.settings.memory_keyframes)
        store.is_written = True
        self._out = _FolderWriter(folder, store, self._recognizer)
        self._thread = threading.Thread(target=self._write, name=THREAD, daemon=True)
        self._thread.start()

    @property
    def keyframes(self) -> int:
        """Number of keyframes written so far."""
        return self._out.keyframes

    @property
    def taken(self) -> int:
        """Number of the store's keyframes, from the first, that are written or queued."""
        return self._taken

    @property
    def warnings(self) -> tuple[str, ...]:
        """What could not be written, and why; one sentence each."""
        return tuple(self._out.warnings)

    def update(self, estimate: Estimate | None) -> None:
        """Queue the changes of the store by the frame of `estimate`."""
        self._frames += 1
        for number in range(self._taken, len(self._store)):
            self._unsettled.append((self._frames, SeenKeyframe.of(KeyframeId(number), estimate)))
        self._taken = len(self._store)
        self._queue_settled(self._frames - _SETTLED_FRAMES)
        if self._store.revision != self._revision and self._now_s() - self._sent_s >= self._folder.settings.flush_s:
            self._queue_poses()

    def add_edges(self, edges: Sequence[RelativePose]) -> None:
        """Queue edges, such as loops.

        The writer itself adds odometry edges between successive keyframes; a given one is used only in place of a
        missing one.
        """
        self._work.put(partial(self._out.add_edges, tuple(edges)))

    def withdraw_edges(self, edges: Sequence[RelativePose]) -> None:
        """Withdraw edges that were added, by identity, not by value."""
        self._work.put(partial(self._out.withdraw_edges, tuple(edges)))

    def close(self, surfel_map: SurfelMap | None = None, recognizer: Recognizer | None = None) -> None:
        """Write the remaining changes and the data made of the keyframes, and close the folder.

        Does not raise. A second call has no effect.

        Args:
            recognizer: recognizer of the keyframes, in place of the writer's own.
        """
        if self._is_closed:
            return
        self._is_closed = True
        self._queue_settled(self._frames)
        self._queue_poses(is_last=True)
        self._work.put(None)
        self._thread.join()
        self._out.finish(surfel_map, recognizer)

    def _queue_settled(self, last_frame: int) -> None:
        """Queue keyframes that were new at a frame or before."""
        while self._unsettled and self._unsettled[0][0] <= last_frame:
            _, seen = self._unsettled.popleft()
            self._work.put(partial(self._out.add, seen, self._store.pose(seen.number)))

    def _queue_poses(self, *, is_last: bool = False) -> None:
        # Only of queued keyframes; the others are queued with their pose at that time.
        count = self._taken - len(self._unsettled)
        self._work.put(partial(self._out.move, self._store.T_map_keyframe[:count].copy(), is_last=is_last))
        self._revision, self._sent_s = self._store.revision, self._now_s()

    def _write(self) -> None:
        """Process the queue in the thread, and flush periodically."""
        flushed_s, flush_s = self._now_s(), self._folder.settings.flush_s
        while True:
            try:
                work = self._work.get(timeout=max(flushed_s + flush_s - self._now_s(), 0.001))
            except queue.Empty:
                pass
            else:
                if work is None:
                    return
                self._out.do(partial(in_span, "write", work))
            if self._now_s() - flushed_s >= flush_s:
                self._out.flush()
                flushed_s = self._now_s()


class _FolderWriter:
    """Writes to the folder in the thread. After the first write error, nothing more is written."""

    def __init__(self, folder: MapFolder, store: KeyframeStore, recognizer: Recognizer | None) -> None:
        self.keyframes, self.warnings = 0, list[str]()
        self._folder, self._store, self._recognizer = folder, store, recognizer
        self._before: SeenKeyframe | None = None
        self._T_map_keyframe, self._moved = folder.contents.T_map_keyframe.copy(), 0
        # By id. The edge is kept too, so that its id is not reused.
        self._edges: dict[int, tuple[RelativePose, int]] = {}
        # Not guaranteed to be on disk before the next flush.
        self._unflushed: list[tuple[KeyframeId, tuple[Path, Record]]] = []
        self._stepped: set[int] = set()  # keyframes with an odometry edge from the previous one
        self._is_over = self._is_dirty = False
        is_mounted = folder.calibration.T_base_camera is not None
        self._mapper = OccupancyMapper(folder.calibration, folder.settings.occupancy) if is_mounted else None
        self.do(lambda: folder.begin(DRIVE))

    def flush(self) -> None:
        """Flush appended data to the disk, and let the store drop flushed keyframes from memory."""
        if not self._is_dirty:
            return

        def to_disk() -> None:
            self._folder.flush()
            for number, where in self._unflushed:
                self._store.keep_on_disk(number, partial(read_keyframe, *where, self._folder.header.camera.size_px))
            self._unflushed.clear()

        self.do(to_disk)
        self._is_dirty = False

    def finish(self, surfel_map: SurfelMap | None, recognizer: Recognizer | None) -> None:
        """Write the data made of the keyframes and the occupancy grid, and close the folder."""
        found = self._recognizer if recognizer is None else recognizer
        if found is not None:
            self.do(lambda: self._folder.save_recognition(found))
        if surfel_map is not None:
            self.do(lambda: self._folder.save_surfels(surfel_map))
        if self._mapper is not None and self.keyframes and not self._is_over:
            # Of earlier drives' keyframes too. It can be made at any time, so that no error here ends the drive.
            try:
                save_occupancy(MapFolder.open(self._folder.path, settings=self._folder.settings), mapper=self._mapper)
            except Exception as error:
                self.warnings.append(f"The occupancy map was not written: {_why(error)}.")
        self.do(self._folder.finish)
        try:
            self._folder.close()
        except OutputError as error:
            self._end(error)

    def do(self, work: Callable[[], None]) -> None:
        """Run a piece of work, unless an earlier one has failed."""
        if self._is_over:
            return
        try:
            work()
            self._is_dirty = True
        except Exception as error:  # a thread that dies silently would lose all later data
            self._end(error)

    def _end(self, error: Exception) -> None:
        if not self._is_over:
            self.warnings.append(f"The map is not written any further: {_why(error)}.")
        self._is_over = True

    def add(self, seen: SeenKeyframe, T_map_keyframe: FloatArray) -> None:
        """Append a keyframe with its pose (4, 4)."""
        number, before = seen.number, self._before
        try:
            keyframe = self._store[number]
        except Exception as error:  # whatever failed in making it: the store reports it to the drive, too
            self.warnings.append(f"Keyframe {number} is not in the map: {error}.")
            return
        where = self._folder.append_keyframe(number, keyframe, T_map_keyframe, seen.T_odom_keyframe)
        self._unflushed.append((number, where))
        edge = None if before is None else odometry_edge(before, seen)
        if edge is not None and number not in self._stepped:
            self._folder.append_edges([edge])
            self._stepped.add(number)
        if self._recognizer is not None:
            self._recognizer.add(number, keyframe)
        if self._mapper is not None:
            self._mapper.keep(number, keyframe)
        self._before = seen
        self._grow(number + 1)
        self._T_map_keyframe[number] = T_map_keyframe
        self.keyframes += 1

    def add_edges(self, edges: tuple[RelativePose, ...]) -> None:
        """Append edges, except of odometry to keyframes that have one."""
        new = [edge for edge in edges if edge.is_loop or edge.second not in self._stepped]
        numbers = self._folder.append_edges(new)
        self._edges |= {id(edge): (edge, number) for edge, number in zip(new, numbers, strict=True)}
        self._stepped |= {edge.second for edge in new if not edge.is_loop}

    def withdraw_edges(self, edges: tuple[RelativePose, ...]) -> None:
        """Withdraw edges by identity."""
        known = [self._edges.pop(id(edge), None) for edge in edges]
        self._folder.withdraw_edges([number for _, number in filter(None, known)])

    def move(self, T_map_keyframe: FloatArray, *, is_last: bool) -> None:
        """Append changed poses: at the end all, before that as many as there is room for.

        Each loop moves all keyframes slightly. Writing all of them each time would take more, the longer the drive.
        """
        self._grow(len(T_map_keyframe))
        known = self._T_map_keyframe[: len(T_map_keyframe)]
        off = np.abs(known - T_map_keyframe).max(axis=(1, 2))  # metres, and about radians for rotations
        moved = np.flatnonzero(off > 0)
        if not is_last:
            room = _MOVED_POSES * self.keyframes - self._moved
            moved = moved[np.argsort(-off[moved], kind="stable")[: max(room, 0)]]
        self._folder.append_poses(moved, T_map_keyframe[moved])
        known[moved] = T_map_keyframe[moved]
        self._moved += len(moved)

    def _grow(self, count: int) -> None:
        if count > len(self._T_map_keyframe):
            more = np.zeros((max(count, 2 * len(self._T_map_keyframe)) - len(self._T_map_keyframe), 4, 4))
            self._T_map_keyframe = np.concatenate([self._T_map_keyframe, more])


def _why(error: Exception) -> str:
    return str(error) if isinstance(error, InputError) else f"{type(error).__name__}: {error}"
