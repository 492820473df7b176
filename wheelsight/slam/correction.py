"""A trajectory as known at its end: by loops that were closed on the way, or by matches from outside."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum
from typing import NamedTuple

import numpy as np

from wheelsight.errors import ArgumentError
from wheelsight.geometry import BoolArray, FloatArray, IntArray, se3
from wheelsight.keyframes import KeyframeId
from wheelsight.matches import Match, SpeedVariances
from wheelsight.slam.graph import PoseGraph, RelativePose
from wheelsight.slam.live import ClosedLoops
from wheelsight.slam.loops import LoopCloser, LoopReport
from wheelsight.slam.pose_graph import new_pose_graph
from wheelsight.slam.settings import LoopSettings, MatchSettings
from wheelsight.slam.steps import anchor, step_edge
from wheelsight.trajectory import Trajectory

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
