"""LiveLoops: loops that are closed while the robot drives, in a thread of their own.

Odometry hands over each new keyframe, with where it is by odometry alone. The thread recognises and verifies, and has
the pose graph judge what is found. Odometry is told where keyframes are by now, some frames later.
"""

from __future__ import annotations

import logging
import time
from collections import deque
from collections.abc import Mapping
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np

from wheelsight.calibration import Calibration
from wheelsight.errors import PartError
from wheelsight.geometry import BoolArray, FloatArray, se3
from wheelsight.keyframes import KeyframeStore
from wheelsight.places.recognition import Recognizer
from wheelsight.settings import RecognitionSettings
from wheelsight.slam.drive_graph import DriveGraph, KeyframePlace, LivedKeyframe, PoseUpdate, SeenAgain
from wheelsight.slam.graph import RelativePose
from wheelsight.slam.known import KnownMap
from wheelsight.slam.loops import LoopReport
from wheelsight.slam.recognised import LoopDetector, PlaceWatcher
from wheelsight.slam.settings import LoopSettings
from wheelsight.threads import yield_to_others

_LOG = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True, eq=False)
class ClosedLoops:
    """What became of all loops of a drive.

    Attributes:
        stamps_s: (N,) of the keyframes of this drive, seconds.
        T_odom_keyframe: (N, 4, 4) as lived.
        T_map_keyframe: (M, 4, 4) of all, the N last ones of this drive, as known at the end.
        edges: of the graph.
        loops: how they were judged.
        refused: how many candidates were no place seen again, by reason.
        unseen: keyframes that nobody had time to compare.
        pieces: of how many pieces nobody knows how they lie to each other; 1 where all are joined.
        is_in_map: (N,) whether it is known where each keyframe of this drive lies in the map.
        judged_s: (N,) seconds that the thread took for each.
        begins: (N,) whether odometry does not tell how each lies to the one before.
        again: keyframes of this drive that odometry came back to, in order of time.
    """

    stamps_s: FloatArray
    T_odom_keyframe: FloatArray
    T_map_keyframe: FloatArray
    edges: tuple[RelativePose, ...]
    loops: LoopReport
    refused: Mapping[str, int]
    unseen: int
    pieces: int
    is_in_map: BoolArray
    begins: BoolArray
    judged_s: FloatArray
    again: tuple[SeenAgain, ...] = ()

    @property
    def is_joined(self) -> bool:
        """Whether it is known where the last keyframe lies in the map."""
        return bool(self.is_in_map[-1:].all())

    @property
    def known(self) -> int:
        """How many keyframes are of earlier drives."""
        return len(self.T_map_keyframe) - len(self.T_odom_keyframe)

    @property
    def T_map_odom(self) -> FloatArray:
        """(N, 4, 4) where odom lies in the map, as each keyframe of this drive has it."""
        return np.asarray(self.T_map_keyframe[self.known :] @ se3.invert(self.T_odom_keyframe))


@dataclass(frozen=True, slots=True, eq=False)
class Judged:
    """What the thread found of a keyframe.

    Attributes:
        update: where all keyframes are by now, if its loops have moved any.
        place: how surely it is placed in the map; None while nobody knows where its piece lies.
        ties: its loops that are kept.
    """

    update: PoseUpdate | None
    place: KeyframePlace | None
    ties: tuple[RelativePose, ...] = ()


class LiveLoops:
    """See the module.

    Args:
        store: holds the keyframes. It is read here, and never moved; it is told which ones loops tie.
        calibration: of the camera.
        settings, recognition: or the defaults.
        known: what an earlier drive has left, whose keyframes the store has.
        waits: an answer is waited for once it is due, so that the same recording gives the same poses. A robot that
            drives does not wait: it takes what is there.
        detector: of a user's own; see `PlaceWatcher`.

    Attributes:
        place: of the newest keyframe that an answer was taken of, or of one seen again since; see `Judged`.
    """

    def __init__(
        self,
        store: KeyframeStore,
        calibration: Calibration,
        settings: LoopSettings | None = None,
        recognition: RecognitionSettings | None = None,
        *,
        known: KnownMap | None = None,
        waits: bool = False,
        detector: LoopDetector | None = None,
    ) -> None:
        self._store, self._settings, self._waits = store, settings or LoopSettings(), waits
        recognizer = None if known is None else known.recognizer
        self._watcher = PlaceWatcher(store, calibration, self._settings.seen, recognition, recognizer, detector)
        self._graph = DriveGraph(self._settings, known)
        self._lived: list[LivedKeyframe] = []
        self._waiting: deque[tuple[float, Future[Judged]]] = deque()
        self._thread: ThreadPoolExecutor | None = None
        self._unseen = 0
        self._judged_s: list[float] = []
        self._again: list[SeenAgain] = []
        self.place: KeyframePlace | None = None
        self._known = 0 if known is None else len(known.store)
        self._recognised = 0
        self._has_raised = False

    def add(self, keyframe: LivedKeyframe) -> None:
        """Have the thread look whether a keyframe shows a place seen before."""
        if self._thread is None:
            self._thread = ThreadPoolExecutor(1, "wheelsight-loops", yield_to_others)
        has_time = self._waits or len(self._waiting) < self._settings.most_waiting
        self._unseen += not has_time
        self._lived.append(keyframe)
        self._waiting.append((keyframe.stamp_s, self._thread.submit(self._judge, keyframe, has_time)))

    def see_again(self, keyframe: SeenAgain) -> None:
        """Have the thread tell how surely a keyframe that it was handed before is placed; a busy one need not."""
        self._recognised += keyframe.number < self._known
        if self._thread is not None and (self._waits or not self._waiting):
            found = self._thread.submit(lambda: Judged(None, self._graph.place(keyframe)))
            self._waiting.append((keyframe.stamp_s, found))

    def follow(self, keyframe: SeenAgain) -> None:
        """The drive's corrected way is to follow a keyframe that was seen again, too, as what was seen has it."""
        self._again.append(keyframe)

    def due(self, stamp_s: float) -> PoseUpdate | None:
        """Where the first keyframes are, if loops have moved them since it was asked last; the store hears of ties.

        Raises what went wrong in the thread.
        """
        newest: PoseUpdate | None = None
        while self._waiting and self._is_due(stamp_s, *self._waiting[0]):
            found = self._result(self._waiting.popleft()[1])
            newest = newest if found.update is None else found.update
            self.place = found.place
            for tie in found.ties:
                self._recognised += tie.first < self._known <= tie.second
                self._store.tie(tie.first, tie.second)
        return newest

    def finish(self) -> ClosedLoops:
        """Wait for all that was handed over, judge all loops once more, and end the thread; it may go on all the same.

        Raises what went wrong in the thread; an error of a part of a user's own is a warning here.
        """
        try:
            self.close()
        except PartError as error:  # of the last keyframes: the loops before them count
            _LOG.warning("loops of the last keyframes are missing: %s", error)
        self._graph.review()
        stamps_s = np.array([keyframe.stamp_s for keyframe in self._lived])
        T_odom = np.array([keyframe.T_odom_keyframe for keyframe in self._lived]).reshape(-1, 4, 4)
        found = (self._graph.poses, self._graph.edges, self._graph.report(), dict(self._watcher.refusals), self._unseen)
        pieces = self._graph.pieces
        is_in_map = pieces[len(pieces) - len(stamps_s) :] == 0
        begins = np.array([keyframe.begins for keyframe in self._lived], bool)
        judged = is_in_map, begins, np.array(self._judged_s)
        return ClosedLoops(stamps_s, T_odom, *found, max(len(np.unique(pieces)), 1), *judged, tuple(self._again))

    @property
    def recognised(self) -> int | None:
        """How often this drive has seen something of the map of before so far; None without such a map.

        By its loops that are kept, and by keyframes of it that odometry came back to. Where a start was said, that
        alone bears it out.
        """
        return self._recognised if self._known else None

    @property
    def recognizer(self) -> Recognizer:
        """Knows all keyframes that were looked at. The thread writes to it."""
        return self._watcher.recognizer

    def close(self) -> None:
        """Wait for the thread, and end it. Raises what went wrong in it, unless an error was raised before."""
        thread, self._thread = self._thread, None
        if thread is not None:
            thread.shutdown()
        for _, judged in () if self._has_raised else tuple(self._waiting):
            self._result(judged)

    def _result(self, judged: Future[Judged]) -> Judged:
        try:
            return judged.result()
        except BaseException:
            self._has_raised = True
            raise

    def _is_due(self, stamp_s: float, keyframe_s: float, judged: Future[Judged]) -> bool:
        return stamp_s >= keyframe_s + self._settings.latency_s if self._waits else judged.done()

    def _judge(self, keyframe: LivedKeyframe, has_time: bool) -> Judged:
        """The thread: one keyframe."""
        started = time.perf_counter()
        self._graph.add(keyframe)
        if has_time:
            near = self._graph.near(self._settings.seen.near_m)
            loops = self._watcher.look(keyframe.number, near, self._graph.adrift)
        else:
            loops = self._watcher.pass_by(keyframe.number)
        told = keyframe.seen_from
        if told is not None and not loops:  # what is recognised by both views is surer than odometry's own word
            loops = (told,)
        update = self._graph.close(loops)
        kept = set(map(id, self._graph.edges)) if loops else ()
        judged = Judged(update, self._graph.place(), tuple(loop for loop in loops if id(loop) in kept))
        self._judged_s.append(time.perf_counter() - started)
        return judged
