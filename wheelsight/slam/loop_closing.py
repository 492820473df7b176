"""Loop closing in a thread during a drive, and the correction of a trajectory after its end."""

from __future__ import annotations

import logging
import time
from collections import Counter, deque
from collections.abc import Mapping, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass
from enum import StrEnum
from typing import NamedTuple

import numpy as np

from wheelsight.core.calibration import Calibration
from wheelsight.core.errors import ArgumentError, PartError
from wheelsight.core.geometry import BoolArray, FloatArray, IntArray, se3
from wheelsight.core.keyframes import KeyframeId, KeyframeStore
from wheelsight.core.messages import Match, SpeedVariances
from wheelsight.core.settings import RecognitionSettings
from wheelsight.core.threads import yield_to_others
from wheelsight.core.trajectory import Trajectory
from wheelsight.places.recognition import Recognizer
from wheelsight.slam.drive_graph import DriveGraph, KeyframePlace, LivedKeyframe, PoseUpdate, SeenAgain
from wheelsight.slam.graph import PoseGraph, RelativePose, anchor, step_edge
from wheelsight.slam.loop_gate import LoopCloser, LoopReport
from wheelsight.slam.place_recognition import KnownMap, LoopDetector, PlaceWatcher
from wheelsight.slam.settings import LoopSettings, MatchSettings
from wheelsight.slam.solvers import new_pose_graph

# LiveLoops: loops that are closed while the robot drives, in a thread of their own.
#
# Odometry hands over each new keyframe, with where it is by odometry alone. The thread recognises and verifies, and
# has the pose graph judge what is found. Odometry is told where keyframes are by now, some frames later.


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


# A trajectory as known at its end: by loops that were closed on the way, or by matches from outside.


# A heading that is said to be no better known than this is not known: the root of its variance, radians.
_ANY_HEADING_RAD = 10.0


class Unused(StrEnum):
    """Why a match was not even judged."""

    LOW_SCORE = "its score is low"
    NO_POSE = "there is no pose near one of its stamps"
    ONE_PLACE = "both stamps are of one keyframe"


@dataclass(frozen=True, slots=True, eq=False)
class Correction:
    """What matches made of a trajectory.

    Attributes:
        corrected: the trajectory as known at the end, in the map; without covariances.
        rows: (K,) of which poses of the trajectory keyframes are.
        T_map_keyframe: (M, 4, 4) where the body was at all keyframes; the K last ones are those of this drive.
        loops: how matches were judged.
        unused: how many matches were not judged, by reason.
    """

    corrected: Trajectory
    rows: IntArray
    T_map_keyframe: FloatArray
    loops: LoopReport
    unused: dict[str, int]


def correct(
    lived: Trajectory,
    matches: Sequence[Match],
    settings: LoopSettings | None = None,
    *,
    stated: SpeedVariances | None = None,
    graph: PoseGraph | None = None,
) -> Correction:
    """The trajectory by all that is known at its end.

    Keyframes are where matches are, and one each `keyframe_way_m`; poses between two keyframes follow both.

    Args:
        lived: as known on the way, with covariances that grow along it.
        matches: what to judge.
        settings: see `LoopSettings`.
        stated: what the recording states of its odometry's errors, in place of the covariances.
        graph: an empty one to use; None for GTSAM's, or where that is missing our own.

    Raises:
        ArgumentError: the trajectory has no poses, or neither it nor the recording states errors.
    """
    settings = settings or LoopSettings()
    C = _covariances(lived, stated)
    placed, unused = _placed(matches, lived, settings.matches)
    rows = _keyframe_rows(lived, [row for _, ends in placed for row in ends], settings.matches.keyframe_way_m)
    loops = _loops(placed, rows, settings.matches)
    unused[Unused.ONE_PLACE] += len(placed) - len(loops)
    graph = graph if graph is not None else new_pose_graph(settings.cauchy_scale)
    _lay(graph, lived.T_frame_body[rows], C[rows], settings.matches)
    report = LoopCloser(graph, settings).offer_all(loops) if loops else LoopReport(())
    counts = {str(reason): count for reason, count in unused.items() if count}
    T_map_odom = graph.poses @ se3.invert(lived.T_frame_body[rows])
    return Correction(carried(lived, lived.stamps_s[rows], T_map_odom), rows, graph.poses, report, counts)


def corrected_by(found: ClosedLoops, lived: Trajectory) -> Correction:
    """A trajectory as known at the end, by loops that were closed while driving.

    It follows keyframes where they were kept and where odometry came back to them. In the map of an earlier drive it
    has no poses where it is not known how they lie in that: odom begins anywhere.
    """
    rows = np.array([_nearest(lived.stamps_s, stamp_s) for stamp_s in found.stamps_s], np.int64)
    followed = _followed(found)
    corrected = carried(lived, followed.stamps_s, followed.T_map_odom, followed.begins)
    if found.known:
        corrected = corrected.select(followed.is_in_map[_before(lived.stamps_s, followed.stamps_s)])
    T_map_new = found.T_map_odom @ lived.T_frame_body[rows]
    T_camera_body = se3.invert(found.T_odom_keyframe[0]) @ lived.T_frame_body[rows[0]]
    T_map_known = found.T_map_keyframe[: found.known] @ T_camera_body
    return Correction(corrected, rows, np.concatenate([T_map_known, T_map_new]), found.loops, {})


class _Followed(NamedTuple):
    """Where odom lies in the map (F, 4, 4) at stamps (F,), and as `ClosedLoops` has them (F,)."""

    stamps_s: FloatArray
    T_map_odom: FloatArray
    begins: BoolArray
    is_in_map: BoolArray


def _followed(found: ClosedLoops) -> _Followed:
    """By keyframes as they were kept, and as they were seen again."""
    kept = found.stamps_s, found.T_map_odom, found.begins, found.is_in_map
    numbers = np.array([one.number for one in found.again], np.int64)
    T_odom = np.array([one.T_odom_keyframe for one in found.again]).reshape(-1, 4, 4)
    stamps_s, in_map = np.array([one.stamp_s for one in found.again]), found.is_in_map[numbers - found.known]
    T_map_odom = found.T_map_keyframe[numbers] @ se3.invert(T_odom)
    both = zip(kept, (stamps_s, T_map_odom, np.zeros(len(numbers), bool), in_map), strict=True)
    arrays = [np.concatenate(pair) for pair in both]
    order = np.argsort(arrays[0], kind="stable")
    return _Followed(*(array[order] for array in arrays))


def _before(at_s: FloatArray, stamps_s: FloatArray) -> IntArray:
    """(N,) the last keyframe, of those at (K,) stamps, before each time; the first where there is none."""
    return np.asarray((np.searchsorted(stamps_s, at_s, side="right") - 1).clip(0), np.int64)


def _covariances(lived: Trajectory, stated: SpeedVariances | None) -> FloatArray:
    """(N, 6, 6), as the recording states, or the trajectory itself. Raises ArgumentError where neither does."""
    if not len(lived):
        raise ArgumentError("the trajectory has no poses", fix="give one that has")
    C = lived.covariances if stated is None else _covariances_by(stated, lived)
    if C is None:
        raise ArgumentError("the trajectory states no covariances", fix="odometry that states its errors, as wheels do")
    return C


def _covariances_by(stated: SpeedVariances, lived: Trajectory) -> FloatArray:
    """Covariances (N, 6, 6) that grow by what speeds err, each step by itself."""
    at = (np.searchsorted(stated.stamps_s, lived.stamps_s[:-1] + 1e-9, side="right") - 1).clip(min=0)
    Q = np.zeros((len(lived) - 1, 6, 6))
    for axis, variance in zip((0, 1, 5), stated.variances[at].T, strict=True):
        Q[:, axis, axis] = variance * np.diff(lived.stamps_s) ** 2
    Ad = se3.adjoint(lived.T_frame_body[:-1])
    return np.concatenate([np.zeros((1, 6, 6)), np.cumsum(Ad @ Q @ np.swapaxes(Ad, 1, 2), axis=0)])


def _placed(
    matches: Sequence[Match], lived: Trajectory, settings: MatchSettings
) -> tuple[list[tuple[Match, tuple[int, int]]], Counter[Unused]]:
    """Matches with the poses (rows) that they are of, and how many have none."""
    unused: Counter[Unused] = Counter()
    placed = []
    for match in matches:
        rows = [_nearest(lived.stamps_s, stamp_s) for stamp_s in (match.stamp_a_s, match.stamp_b_s)]
        gaps_s = np.abs(lived.stamps_s[rows] - [match.stamp_a_s, match.stamp_b_s])
        if match.score is not None and match.score < settings.least_score:
            unused[Unused.LOW_SCORE] += 1
        elif (gaps_s > settings.most_gap_s).any():
            unused[Unused.NO_POSE] += 1
        else:
            placed.append((match, (rows[0], rows[1])))
    return placed, unused


def _nearest(stamps_s: FloatArray, stamp_s: float) -> int:
    after = int(np.searchsorted(stamps_s, stamp_s).clip(1, max(len(stamps_s) - 1, 1)))
    before = after - 1
    is_after = after < len(stamps_s) and stamps_s[after] - stamp_s < stamp_s - stamps_s[before]
    return after if is_after else before


def _keyframe_rows(lived: Trajectory, wanted: Sequence[int], way_m: float) -> IntArray:
    """Rows (K,) of keyframes: where they are wanted, at both ends, and where so much way has been gone."""
    _, first_each = np.unique(np.floor(lived.distances_m / way_m), return_index=True)
    return np.unique(np.concatenate([first_each, np.asarray(wanted, np.int64), [0, len(lived) - 1]])).astype(np.int64)


def _loops(
    placed: Sequence[tuple[Match, tuple[int, int]]], rows: IntArray, settings: MatchSettings
) -> list[RelativePose]:
    """Edges of those matches that join two keyframes."""
    joined = [(match, *np.searchsorted(rows, ends).tolist()) for match, ends in placed]
    return [
        _loop(match, KeyframeId(first), KeyframeId(second), settings)
        for match, first, second in joined
        if first != second
    ]


def _loop(match: Match, first: KeyframeId, second: KeyframeId, settings: MatchSettings) -> RelativePose:
    if match.T_a_b is None:
        sigmas = [settings.place_sigma_m] * 3 + [_ANY_HEADING_RAD] * 3
        return RelativePose(first, second, np.eye(4), np.diag(np.square(sigmas)), is_loop=True)
    C = match.covariance
    if C is None:
        C = np.diag(np.square([settings.pose_sigma_m] * 3 + [settings.pose_sigma_rad] * 3))
    return RelativePose(first, second, match.T_a_b, C, is_loop=True)


def _lay(graph: PoseGraph, T: FloatArray, C: FloatArray, settings: MatchSettings) -> None:
    """Keyframes (K, 4, 4), where the first one is held, and the ways between, as covariances (K, 6, 6) grow."""
    for pose in T:
        graph.add(pose)
    graph.add_prior(anchor(KeyframeId(0), T[0]))
    ways = [(T[k], C[k]) for k in range(len(T))]
    ends = [(KeyframeId(k - 1), KeyframeId(k)) for k in range(1, len(T))]
    graph.add_edges([step_edge(pair, ways[pair[0]], ways[pair[1]], settings) for pair in ends])


def carried(
    lived: Trajectory, stamps_s: FloatArray, T_map_odom: FloatArray, begins: BoolArray | None = None
) -> Trajectory:
    """All poses of a trajectory in the map, where odom (K, 4, 4) lies in it as keyframes at (K,) stamps have it.

    Each pose goes with the keyframes before and after it, in shares of the time between; with the one before alone
    where the one after `begins` (K,) another piece.
    """
    before = _before(lived.stamps_s, stamps_s)
    after = np.minimum(before + 1, len(stamps_s) - 1)
    if begins is not None:
        after = np.where(begins[after], before, after)
    T_before, T_after = (T_map_odom[of] @ lived.T_frame_body for of in (before, after))
    begin_s, end_s = stamps_s[before], stamps_s[after]
    share = (lived.stamps_s - begin_s) / np.where(end_s > begin_s, end_s - begin_s, 1.0)
    T_map_body = se3.interpolate(T_before, T_after, share.clip(0, 1))
    return Trajectory(lived.stamps_s, T_map_body, None, lived.body, "map")
