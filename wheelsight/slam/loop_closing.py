"""Loop closing in a thread during a drive, and the correction of a trajectory after its end."""

from __future__ import annotations

import logging
import time
from collections import Counter, deque
from collections.abc import Mapping, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass
from enum import StrEnum

import numpy as np

from wheelsight.core.calibration import Calibration
from wheelsight.core.errors import ArgumentError, PartError
from wheelsight.core.geometry import BoolArray, FloatArray, IntArray, se3
from wheelsight.core.keyframes import KeyframeId, KeyframeStore
from wheelsight.core.messages import Match, SpeedVariances
from wheelsight.core.settings import RecognitionSettings
from wheelsight.core.threads import LOCK, in_span, span, yield_to_others
from wheelsight.core.trajectory import Trajectory
from wheelsight.places.recognition import Recognizer
from wheelsight.slam.drive_graph import DriveGraph, KeyframePlace, OdometryKeyframe, PoseUpdate, Revisit
from wheelsight.slam.graph import PoseGraph, RelativePose, anchor, step_edge
from wheelsight.slam.loop_gate import LoopCloser, LoopReport
from wheelsight.slam.place_recognition import KnownMap, LoopDetector, PlaceWatcher
from wheelsight.slam.settings import LoopSettings
from wheelsight.slam.solvers import new_pose_graph

_LOG = logging.getLogger(__name__)
# Queued keyframes of a driving robot beyond which further ones are not compared. Chosen.
_MOST_WAITING = 5
# Distance of keyframes that are compared as near ones, and of those that nearly always show what a keyframe sees (three
# days among people in a known map: 95 % are recognised there); a turn by a radian counts as 1.5 m; chosen.
_NEAR_M, _SAME_VIEW_M = 1.0, 0.5
# External matches. Those with a lower score are more probably wrong than right; chosen.
_LEAST_SCORE = 0.5
_MOST_GAP_S = 0.2  # largest time between a match and its nearest pose; chosen
_KEYFRAME_WAY_M = 1.0  # distance after which a keyframe is made without a match; chosen
# Standard deviations per coordinate and axis of a relative pose whose file has none. Chosen.
_POSE_SIGMA_M, _POSE_SIGMA_RAD = 0.1, 0.05
# Standard deviation of each coordinate between two views of one place whose relative pose is unknown, and of the
# heading, which then is unknown too. Estimated: place recognition accepts views some metres apart.
_PLACE_SIGMA_M = 1.0
_ANY_HEADING_RAD = 10.0


@dataclass(frozen=True, slots=True, eq=False)
class ClosedLoops:
    """All loops of a drive, and the poses they lead to.

    Attributes:
        stamps_s: (N,) stamps of this drive's keyframes, seconds.
        T_odom_keyframe: (N, 4, 4) poses from odometry alone.
        T_map_keyframe: (M, 4, 4) final poses of all keyframes. The last N belong to this drive.
        refused: number of candidates that failed verification, by reason.
        unseen: number of keyframes that were not compared, for lack of time.
        submaps: number of submaps with unknown relative pose; 1 if all are joined.
        is_in_map: (N,) whether the pose of each keyframe in the map is known.
        begins: (N,) whether a keyframe begins a submap, so that odometry does not link it to the previous one.
        processing_s: (N,) processing time of each keyframe in the thread, seconds.
    """

    stamps_s: FloatArray
    T_odom_keyframe: FloatArray
    T_map_keyframe: FloatArray
    edges: tuple[RelativePose, ...]
    loops: LoopReport
    refused: Mapping[str, int]
    unseen: int
    submaps: int
    is_in_map: BoolArray
    begins: BoolArray
    processing_s: FloatArray
    revisits: tuple[Revisit, ...] = ()

    @property
    def is_joined(self) -> bool:
        """Whether the pose of the last keyframe in the map is known."""
        return bool(self.is_in_map[-1:].all())

    @property
    def known(self) -> int:
        """Number of keyframes from earlier drives."""
        return len(self.T_map_keyframe) - len(self.T_odom_keyframe)

    @property
    def T_map_odom(self) -> FloatArray:
        """(N, 4, 4) pose of odom in the map at each keyframe."""
        return np.asarray(self.T_map_keyframe[self.known :] @ se3.invert(self.T_odom_keyframe))


@dataclass(frozen=True, slots=True, eq=False)
class KeyframeResult:
    """The thread's result for one keyframe.

    Attributes:
        place: pose of the keyframe in the map with its covariance; None while its submap is not joined to the map.
        is_expected: whether it lies where keyframes of the known map show what it sees.
    """

    update: PoseUpdate | None
    place: KeyframePlace | None
    ties: tuple[RelativePose, ...] = ()
    is_expected: bool = False


class LiveLoops:
    """Closes loops in a background thread while the robot drives.

    Odometry passes each new keyframe with its odometry pose. The thread recognizes earlier places, verifies them,
    and updates the pose graph. Odometry polls `due` for corrected keyframe poses.

    Args:
        store: the keyframes. Poses are never changed here; `due` stores which keyframes loops link.
        known: map of an earlier drive. The store contains its keyframes.
        waits: whether `due` blocks until a due result is ready, so that a recording gives reproducible poses. A driving
            robot does not wait and takes the finished results.
        detector: user-defined detector; see `PlaceWatcher`.

    Attributes:
        place: `KeyframeResult.place` of the newest finished keyframe, or of one revisited since.
        recognised_views: number of this drive's keyframes and revisits that recognised the known map.
        missed: number of keyframes in a row that keyframes of the known map should show, and that were not recognised.
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
        self._watcher = PlaceWatcher(store, calibration, self._settings.apart_s, recognition, recognizer, detector)
        self._graph = DriveGraph(known)
        self._keyframes: list[OdometryKeyframe] = []
        self._waiting: deque[tuple[float, Future[KeyframeResult]]] = deque()
        self._thread: ThreadPoolExecutor | None = None
        self._unseen = 0
        self._processing_s: list[float] = []
        self._revisits: list[Revisit] = []
        self.place: KeyframePlace | None = None
        self._known = 0 if known is None else len(known.store)
        self._recognised = self.recognised_views = self.missed = 0
        self._has_raised = False

    def add(self, keyframe: OdometryKeyframe) -> None:
        """Submit a keyframe to the thread, which looks for earlier views of the same place."""
        if self._thread is None:
            self._thread = ThreadPoolExecutor(1, "wheelsight-loops", yield_to_others)
        has_time = self._waits or len(self._waiting) < _MOST_WAITING
        self._unseen += not has_time
        self._keyframes.append(keyframe)
        self._waiting.append((keyframe.stamp_s, self._thread.submit(self._process, keyframe, has_time)))

    def _process(self, keyframe: OdometryKeyframe, has_time: bool) -> KeyframeResult:
        """Process one keyframe in the thread."""
        started = time.perf_counter()
        self._graph.add(keyframe)
        loops, is_expected = tuple[RelativePose, ...](), False
        if has_time:
            near = self._graph.near(_NEAR_M)
            if self._known:
                is_expected = any(number < self._known and apart_m < _SAME_VIEW_M for number, apart_m in near.items())
            with span("recognise"):
                loops = self._watcher.find_loops(keyframe.number, tuple(near), self._graph.unjoined)
        else:
            self._watcher.add(keyframe.number)
        alignment = keyframe.seen_from
        if alignment is not None and not loops:  # a verified place is more certain than odometry's alignment
            loops = (alignment,)
        with span("graph"):
            update = self._graph.close(loops)
        kept = set(map(id, self._graph.edges)) if loops else ()
        ties = tuple(loop for loop in loops if id(loop) in kept)
        result = KeyframeResult(update, self._graph.place(), ties, is_expected)
        self._processing_s.append(time.perf_counter() - started)
        return result

    def request_place(self, revisit: Revisit) -> None:
        """Request the pose and covariance of a revisited keyframe. A busy thread skips the request."""
        if revisit.number < self._known:
            self._count_recognitions(1)
        if self._thread is not None and (self._waits or not self._waiting):
            found = self._thread.submit(lambda: KeyframeResult(None, self._graph.place(revisit)))
            self._waiting.append((revisit.stamp_s, found))

    def _count_recognitions(self, of_a_view: int) -> None:
        """Count the recognitions of the known map by a view."""
        self._recognised += of_a_view
        self.recognised_views += 1
        self.missed = 0

    def add_revisit(self, revisit: Revisit) -> None:
        """Add a revisit of a keyframe to the points that the corrected trajectory follows."""
        self._revisits.append(revisit)

    def due(self, stamp_s: float) -> PoseUpdate | None:
        """Return the poses of the first keyframes if loops moved them since the last call, else None.

        Also stores which keyframes the kept loops link. Raises any error of the thread.
        """
        newest: PoseUpdate | None = None
        while self._waiting:
            keyframe_s, future = self._waiting[0]
            if not (stamp_s >= keyframe_s + self._settings.latency_s if self._waits else future.done()):
                break
            self._waiting.popleft()
            found = self._result(future)
            newest = newest if found.update is None else found.update
            self.place = found.place
            recognised = sum(tie.first < self._known <= tie.second for tie in found.ties)
            if recognised:
                self._count_recognitions(recognised)
            else:
                self.missed += found.is_expected
            for tie in found.ties:
                self._store.add_loop(tie.first, tie.second)
        return newest

    def finish(self) -> ClosedLoops:
        """Finish all submitted keyframes, review all loops, stop the thread, and return the result.

        Further keyframes may follow; they start the thread again. Raises any error of the thread, but logs a
        `PartError` of a user-defined part as a warning.
        """
        try:
            self.close()
        except PartError as error:  # earlier loops remain valid
            _LOG.warning("loops of the last keyframes are missing: %s", error)
        self._graph.review()
        stamps_s = np.array([keyframe.stamp_s for keyframe in self._keyframes])
        T_odom = np.array([keyframe.T_odom_keyframe for keyframe in self._keyframes]).reshape(-1, 4, 4)
        found = (self._graph.poses, self._graph.edges, self._graph.report(), dict(self._watcher.refusals), self._unseen)
        submaps = self._graph.submaps
        is_in_map = submaps[len(submaps) - len(stamps_s) :] == 0
        begins = np.array([keyframe.begins for keyframe in self._keyframes], bool)
        rows = is_in_map, begins, np.array(self._processing_s)
        return ClosedLoops(stamps_s, T_odom, *found, max(len(np.unique(submaps)), 1), *rows, tuple(self._revisits))

    @property
    def recognised(self) -> int | None:
        """Number of times this drive recognized the known map so far; None without a known map.

        Counts the kept loops to the map's keyframes, and revisits of them by odometry. With a given start pose, this is
        the only confirmation of that pose.
        """
        return self._recognised if self._known else None

    @property
    def recognizer(self) -> Recognizer:
        """Recognizer with all processed keyframes. The thread writes to it."""
        return self._watcher.recognizer

    def close(self) -> None:
        """Wait for the thread and stop it. Raises an error of the thread unless one was raised before."""
        thread, self._thread = self._thread, None
        if thread is not None:
            thread.shutdown()
        for _, future in () if self._has_raised else tuple(self._waiting):
            self._result(future)

    def _result(self, future: Future[KeyframeResult]) -> KeyframeResult:
        try:
            return in_span("wait for loops", future.result, LOCK)
        except BaseException:
            self._has_raised = True
            raise


class Unused(StrEnum):
    """Reason why a match does not reach the gate."""

    LOW_SCORE = "its score is low"
    NO_POSE = "there is no pose near one of its stamps"
    ONE_PLACE = "both stamps are of one keyframe"


@dataclass(frozen=True, slots=True, eq=False)
class Correction:
    """A trajectory corrected by matches.

    Attributes:
        rows: (K,) trajectory rows of this drive's keyframes.
        T_map_keyframe: (M, 4, 4) body poses at all keyframes. The last K belong to this drive.
        unused: number of matches that did not reach the gate, by reason.
    """

    corrected: Trajectory
    rows: IntArray
    T_map_keyframe: FloatArray
    loops: LoopReport
    unused: dict[str, int]


def correct(
    odometry: Trajectory,
    matches: Sequence[Match],
    *,
    stated: SpeedVariances | None = None,
    graph: PoseGraph | None = None,
) -> Correction:
    """Return the trajectory corrected by all matches.

    Keyframes are placed at the matches and every metre. The corrections of two neighbouring keyframes are
    interpolated for the poses between them.

    Args:
        stated: odometry noise stated by the recording, used instead of the trajectory's covariances.
        graph: empty graph to use; None for GTSAM's, or for the built-in solver without GTSAM.

    Raises ArgumentError if the trajectory has no poses, or neither it nor the recording has covariances.
    """
    if not len(odometry):
        raise ArgumentError("the trajectory has no poses", fix="give a trajectory with poses")
    C = odometry.covariances
    if stated is not None:
        # Speed errors are independent between steps.
        at = (np.searchsorted(stated.stamps_s, odometry.stamps_s[:-1] + 1e-9, side="right") - 1).clip(min=0)
        Q = np.zeros((len(odometry) - 1, 6, 6))
        for axis, variance in zip((0, 1, 5), stated.variances[at].T, strict=True):
            Q[:, axis, axis] = variance * np.diff(odometry.stamps_s) ** 2
        Ad = se3.adjoint(odometry.T_frame_body[:-1])
        C = np.concatenate([np.zeros((1, 6, 6)), np.cumsum(Ad @ Q @ np.swapaxes(Ad, 1, 2), axis=0)])
    if C is None:
        fix = "use odometry that reports covariances, as wheels do"
        raise ArgumentError("the trajectory has no covariances", fix=fix)
    placed, unused = _rows_of_matches(matches, odometry)
    _, first_each = np.unique(np.floor(odometry.distances_m / _KEYFRAME_WAY_M), return_index=True)
    wanted = np.asarray([row for _, ends in placed for row in ends], np.int64)
    rows = np.unique(np.concatenate([first_each, wanted, [0, len(odometry) - 1]])).astype(np.int64)
    ends_of = [(match, *np.searchsorted(rows, ends).tolist()) for match, ends in placed]
    loops = [_loop(match, KeyframeId(first), KeyframeId(second)) for match, first, second in ends_of if first != second]
    unused[Unused.ONE_PLACE] += len(placed) - len(loops)
    graph = graph if graph is not None else new_pose_graph()
    # The first keyframe is fixed.
    ways = [*zip(odometry.T_frame_body[rows], C[rows], strict=True)]
    for T, _ in ways:
        graph.add(T)
    graph.add_prior(anchor(KeyframeId(0), ways[0][0]))
    ends = [(KeyframeId(k - 1), KeyframeId(k)) for k in range(1, len(ways))]
    graph.add_edges([step_edge(pair, ways[pair[0]], ways[pair[1]]) for pair in ends])
    report = LoopCloser(graph).offer_all(loops) if loops else LoopReport(())
    counts = {str(reason): count for reason, count in unused.items() if count}
    T_map_odom = graph.poses @ se3.invert(odometry.T_frame_body[rows])
    return Correction(in_map(odometry, odometry.stamps_s[rows], T_map_odom), rows, graph.poses, report, counts)


def _rows_of_matches(
    matches: Sequence[Match], odometry: Trajectory
) -> tuple[list[tuple[Match, tuple[int, int]]], Counter[Unused]]:
    """Return the matches with their two trajectory rows, and the number of unused ones by reason."""
    unused: Counter[Unused] = Counter()
    placed = []
    for match in matches:
        rows = [_nearest(odometry.stamps_s, stamp_s) for stamp_s in (match.stamp_a_s, match.stamp_b_s)]
        gaps_s = np.abs(odometry.stamps_s[rows] - [match.stamp_a_s, match.stamp_b_s])
        if match.score is not None and match.score < _LEAST_SCORE:
            unused[Unused.LOW_SCORE] += 1
        elif (gaps_s > _MOST_GAP_S).any():
            unused[Unused.NO_POSE] += 1
        else:
            placed.append((match, (rows[0], rows[1])))
    return placed, unused


def _loop(match: Match, first: KeyframeId, second: KeyframeId) -> RelativePose:
    if match.T_a_b is None:
        sigmas = [_PLACE_SIGMA_M] * 3 + [_ANY_HEADING_RAD] * 3
        return RelativePose(first, second, np.eye(4), np.diag(np.square(sigmas)), is_loop=True)
    C = match.covariance
    if C is None:
        C = np.diag(np.square([_POSE_SIGMA_M] * 3 + [_POSE_SIGMA_RAD] * 3))
    return RelativePose(first, second, match.T_a_b, C, is_loop=True)


def corrected_by(found: ClosedLoops, odometry: Trajectory) -> Correction:
    """Return a trajectory corrected by loops that were closed while driving.

    The correction is known at keyframes and at revisits of them, and interpolated between these. With a known map,
    poses of submaps that are not joined to it are left out.
    """
    rows = np.array([_nearest(odometry.stamps_s, stamp_s) for stamp_s in found.stamps_s], np.int64)
    numbers = np.array([one.number for one in found.revisits], np.int64)
    T_odom = np.array([one.T_odom_keyframe for one in found.revisits]).reshape(-1, 4, 4)
    of_revisits = (
        np.array([one.stamp_s for one in found.revisits]),
        found.T_map_keyframe[numbers] @ se3.invert(T_odom),
        np.zeros(len(numbers), bool),
        found.is_in_map[numbers - found.known],
    )
    of_keyframes = found.stamps_s, found.T_map_odom, found.begins, found.is_in_map
    both = [np.concatenate(columns) for columns in zip(of_keyframes, of_revisits, strict=True)]
    order = np.argsort(both[0], kind="stable")
    stamps_s, T_map_odom, begins, is_in_map = (column[order] for column in both)
    corrected = in_map(odometry, stamps_s, T_map_odom, begins)
    if found.known:
        corrected = corrected.select(is_in_map[_before(odometry.stamps_s, stamps_s)])
    T_map_new = found.T_map_odom @ odometry.T_frame_body[rows]
    T_camera_body = se3.invert(found.T_odom_keyframe[0]) @ odometry.T_frame_body[rows[0]]
    T_map_known = found.T_map_keyframe[: found.known] @ T_camera_body
    return Correction(corrected, rows, np.concatenate([T_map_known, T_map_new]), found.loops, {})


def in_map(
    odometry: Trajectory, stamps_s: FloatArray, T_map_odom: FloatArray, begins: BoolArray | None = None
) -> Trajectory:
    """Return all trajectory poses in the map frame, given T_map_odom (K, 4, 4) at keyframe stamps (K,).

    Interpolates between the neighbouring keyframes by time. If the next keyframe `begins` (K,) another submap, uses the
    previous keyframe alone.
    """
    before = _before(odometry.stamps_s, stamps_s)
    after = np.minimum(before + 1, len(stamps_s) - 1)
    if begins is not None:
        after = np.where(begins[after], before, after)
    T_before, T_after = (T_map_odom[of] @ odometry.T_frame_body for of in (before, after))
    begin_s, end_s = stamps_s[before], stamps_s[after]
    share = (odometry.stamps_s - begin_s) / np.where(end_s > begin_s, end_s - begin_s, 1.0)
    T_map_body = se3.interpolate(T_before, T_after, share.clip(0, 1))
    return Trajectory(odometry.stamps_s, T_map_body, None, odometry.body, "map")


def _before(at_s: FloatArray, stamps_s: FloatArray) -> IntArray:
    """Return the index (N,) of the last keyframe, of those at (K,) stamps, before each time; 0 if there is none."""
    return np.asarray((np.searchsorted(stamps_s, at_s, side="right") - 1).clip(0), np.int64)


def _nearest(stamps_s: FloatArray, stamp_s: float) -> int:
    """Return the index of the nearest of (N,) stamps."""
    after = int(np.searchsorted(stamps_s, stamp_s).clip(1, max(len(stamps_s) - 1, 1)))
    before = after - 1
    is_after = after < len(stamps_s) and stamps_s[after] - stamp_s < stamp_s - stamps_s[before]
    return after if is_after else before
