"""Exchange of keyframes with the thread that closes loops, and the update of keyframe poses from its answers."""

from __future__ import annotations

import logging
from collections.abc import Sequence
from dataclasses import replace
from itertools import chain
from typing import TypeVar

import numpy as np

from wheelsight.config import Config
from wheelsight.core.calibration import Calibration
from wheelsight.core.estimates import CameraEstimate, Estimate, Status
from wheelsight.core.geometry import FloatArray, IntArray, se3
from wheelsight.core.geometry import motion_kernels as motions
from wheelsight.core.geometry.chi_square import quantile
from wheelsight.core.keyframes import KeyframeId, KeyframeStore
from wheelsight.places.recognition import Recognizer
from wheelsight.slam.drive_graph import CameraMotion, LivedKeyframe, PoseUpdate, SeenAgain
from wheelsight.slam.graph import ANCHOR_SIGMA, RelativePose, aligned_edge, along_floor
from wheelsight.slam.loop_closing import ClosedLoops, LiveLoops
from wheelsight.slam.place_recognition import KnownMap, LoopDetector
from wheelsight.slam.settings import FROM_KEYFRAMES, PieceSettings

# LoopsBeside: hands an odometry's new keyframes to the thread that closes loops, and moves them where it says.


_LOG = logging.getLogger(__name__)
AnyEstimate = TypeVar("AnyEstimate", bound=Estimate)


class LoopsBeside:
    """See the module.

    Args:
        store: of the odometry.
        calibration, settings: of the run.
        known: what an earlier drive has left, whose keyframes the store has.
        waits, detector: see `LiveLoops`.

    Attributes:
        is_laid: whether loops have laid the piece of map that the robot is in, however surely.
        is_joined: whether it is known where that piece lies.
    """

    def __init__(
        self,
        store: KeyframeStore,
        calibration: Calibration,
        settings: Config,
        known: KnownMap | None = None,
        *,
        waits: bool,
        detector: LoopDetector | None = None,
    ) -> None:
        self._store, self._settings = store, settings.loops
        how = (calibration, settings.loops, settings.recognition)
        self._live = LiveLoops(store, *how, known=known, waits=waits, detector=detector)
        self._map_stays, self._was_sure = known is not None and not known.edges, False
        self._told = len(store)
        self._waiting: list[list[LivedKeyframe]] = []  # by the frames at which they were kept
        self._hangs_on: KeyframeId | None = None
        self.hung_s = -np.inf
        self._seen_from: tuple[KeyframeId, FloatArray] | None = None
        self._nearest: tuple[float, SeenAgain] | None = None  # of the frames that hang on one that it came back to
        self._closed: ClosedLoops | None = None
        self._loops: IntArray = np.zeros((0, 2), np.int64)
        self._pieces: list[int] = [0]  # by the numbers of their first keyframes
        self.is_laid, self.is_joined, self._is_new = True, True, False
        if known is not None and len(store) and known.start is None:
            self.begin_piece(KeyframeId(len(store)))
            self._is_new = True  # in this map it has not been anywhere yet

    def apart(self, T_map_camera: FloatArray) -> FloatArray:
        """T_map_camera (4, 4) at which odometry is to begin another piece of map, of a camera at (4, 4) in this one."""
        here = 0 if self.is_laid else len(self._pieces) - 1
        return self._apart(len(self._pieces)) @ se3.invert(self._apart(here)) @ T_map_camera

    def begin_piece(self, keyframe: KeyframeId) -> None:
        """A keyframe begins a piece of map, apart from the others."""
        self._pieces.append(keyframe)
        self.is_laid = self.is_joined = self._was_sure = False

    def move_keyframes(self, stamp_s: float, keyframe: KeyframeId | None) -> FloatArray | None:
        """Put keyframes to where loops have them; T_new_old (4, 4) of one of them, or None where none has moved.

        Those that are newer than what the thread knows go with the last one that it does.
        """
        update = self._live.due(stamp_s)
        return None if update is None else self._move(update, keyframe)

    def _move(self, update: PoseUpdate, keyframe: KeyframeId | None) -> FloatArray:
        if len(update.loops) != len(self._loops):
            _LOG.info("%d loops are closed (before: %d); keyframes move", len(update.loops), len(self._loops))
        self._loops = update.loops
        T_known, T_old = self._laid(update), np.array(self._store.T_map_keyframe)
        count = len(T_known)
        T_newer = T_old[count:]
        if self._pieces[-1] < count:  # else the newer ones are of a piece that the thread has not heard of
            T_newer = T_known[-1] @ se3.invert(T_old[count - 1]) @ T_newer
            self.is_laid = bool(update.piece[-1] == 0)
            self.is_joined &= self.is_laid
        T_new = np.concatenate([T_known, T_newer])
        self._store.move(list(self._store), T_new)
        at = count - 1 if keyframe is None else keyframe
        return np.asarray(se3.nearest(T_new[at] @ se3.invert(T_old[at])))

    def _is_sure(self, answer: Estimate, covariance_map: FloatArray | None) -> bool:
        """Whether an answer is of a piece that lies in the map, and sure enough there."""
        place, limits = self._live.place, self._settings
        if covariance_map is None or place is None or place.newest < self._pieces[-1]:
            return False
        return _is_within(answer, covariance_map, limits.sure_m, limits.sure_rad)

    def _is_unsure(self, answer: Estimate, covariance_map: FloatArray | None) -> bool:
        """Whether an answer that was sure is by now too unsure in a map of before that stays as it is.

        In a map that grows it is the drive's own way that makes it so, and the map is as unsure there. A start that
        somebody gave is believed as it is until loops make it surer.
        """
        if covariance_map is None or not self._was_sure:
            return False
        return not _is_within(answer, covariance_map, self._settings.unsure_m, self._settings.unsure_rad)

    def tie(self, number: int) -> bool:
        """Whether loops tie keyframes from `number` on to older ones, and were seen from apart as those between pieces.

        Then it is known how they lie to each other, however little odometry knew.
        """
        older, newer = self._loops.T
        ends = newer[(older < number) & (newer >= number)]
        if not len(ends):
            return False
        T = self._store.T_map_keyframe[ends]
        return bool((se3.view_shift_m(se3.invert(T[0]) @ T) >= self._settings.join_apart_m).any())

    @property
    def kept(self) -> IntArray:
        """(K, 2) numbers of the keyframes that loops tie to each other, by what is known now."""
        if self._closed is None:
            return self._loops
        ends = [(loop.first, loop.second) for loop in self._closed.loops.kept]
        return np.array(ends, np.int64).reshape(-1, 2)

    @property
    def has_new(self) -> bool:
        """Whether odometry has kept keyframes that this was not told of."""
        return len(self._store) > self._told

    @property
    def is_waiting(self) -> bool:
        """Whether keyframes wait to be handed over."""
        return bool(self._waiting)

    def keep(
        self, stamp_s: float, T_odom_map: FloatArray, covariance: FloatArray, motion: CameraMotion | None = None
    ) -> None:
        """Keyframes that odometry has kept at a frame, where the camera's pose in odom is as uncertain as (6, 6).

        `motion`: of the camera since the frame before of which keyframes were kept; see `LivedKeyframe`.
        """
        kept: list[LivedKeyframe] = []
        for number in range(self._told, len(self._store)):
            T_odom_keyframe = se3.nearest(T_odom_map @ self._store.pose(KeyframeId(number)))
            begins = number > 0 and number in self._pieces
            T_before_now = self._laid_since(KeyframeId(number))
            lived = (KeyframeId(number), stamp_s, T_odom_keyframe, covariance, begins, T_before_now)
            since = None if kept else motion
            told = self._store.pose(KeyframeId(number)), None if kept else self._aligned(KeyframeId(number))
            kept.append(LivedKeyframe(*lived, since, *told))
        self._told = len(self._store)
        if kept:
            self._waiting.append(kept)

    def _aligned(self, number: KeyframeId) -> RelativePose | None:
        """A new keyframe against the older one by which odometry has found it; None where that is the one before."""
        if self._seen_from is None:
            return None
        older, covariance = self._seen_from
        T_older_new = se3.invert(self._store.pose(older)) @ self._store.pose(number)
        return aligned_edge((older, number), T_older_new, covariance, self._settings.matches)

    def hang_on(self, seen: CameraEstimate, T_odom_map: FloatArray, covariance: FloatArray) -> None:
        """By which keyframe odometry has a frame, where the map lies at (4, 4), as uncertain in odom as (6, 6).

        Where it has come back to an older one, that tells how surely the frame is placed. It is asked before `keep`.
        """
        number, motion, T_keyframe_camera = seen.keyframe, seen.motion.covariance, seen.T_keyframe_body
        before, self._hangs_on, self._seen_from = self._hangs_on, number, None
        self.hung_s = seen.stamp_s
        if number != before:
            self._leave()
        if number is None or motion is None or T_keyframe_camera is None:
            return
        if number >= self._told:
            self._seen_from = None if before is None or before == number - 1 else (before, motion)
            return
        if self._waiting and number >= self._waiting[0][0].number:
            return  # the thread does not know it yet
        apart_m = float(se3.view_shift_m(T_keyframe_camera))
        if number == before and (self._nearest is None or self._nearest[0] <= apart_m):
            return
        T_odom_keyframe = se3.nearest(T_odom_map @ self._store.pose(number))
        again = SeenAgain(number, seen.stamp_s, T_odom_keyframe, covariance, motion)
        self._nearest = apart_m, again
        if number != before:
            self._live.see_again(again)

    def let_go(self) -> None:
        """A frame came to nothing that is believed: by which keyframe odometry has the next one tells nothing of it.

        Else a camera that somebody who walks past has led astray would tie what it saw then to what it saw before.
        """
        self._leave()
        self._hangs_on = self._seen_from = None

    def _leave(self) -> None:
        """Another keyframe comes. Of the last one the nearest frame counts: a view's error grows by the way."""
        if self._nearest is not None:
            self._live.follow(self._nearest[1])
            self._nearest = None

    def hand_over(
        self, motions: Sequence[CameraMotion | None] = (), keyframe: KeyframeId | None = None
    ) -> FloatArray | None:
        """Hand all that were kept to the thread, with what is known by now of the motions to the last of them.

        Where the camera was astray they are put to where those motions lead: T_new_old (4, 4) of a keyframe, or None.
        """
        waiting, self._waiting = self._waiting, []
        # Another filter that has taken over knows of the last ones alone.
        for kept, motion in zip(reversed(waiting), reversed(motions), strict=False):
            kept[0] = kept[0] if motion is None else replace(kept[0], motion=motion)
        anew = laid_anew(self._store, waiting, self._settings.gate_probability)
        waiting, T_new = (waiting, None) if anew is None else anew
        for lived in chain.from_iterable(waiting):
            self._live.add(lived)
        if T_new is None:
            return None
        numbers = [KeyframeId(len(self._store) - len(T_new) + row) for row in range(len(T_new))]
        T_old = np.array(self._store.T_map_keyframe)
        self._store.move(numbers, T_new)
        if keyframe not in numbers:
            return None
        return np.asarray(se3.nearest(self._store.pose(keyframe) @ se3.invert(T_old[keyframe])))

    def _laid_since(self, number: KeyframeId) -> FloatArray | None:
        """(4, 4) from the keyframe before, as both lie in the store; None of the first."""
        if number == 0:
            return None
        T_map_before, T_map_now = (self._store.pose(KeyframeId(one)) for one in (number - 1, number))
        return np.asarray(se3.nearest(se3.invert(T_map_before) @ T_map_now))

    def called(self, answer: AnyEstimate) -> AnyEstimate:
        """The answer, by a status that says whether it is known where in the map it is; if so, how surely."""
        covariance_map = self._covariance_map(answer) if self.is_laid else None
        if not self.is_joined and answer.status is Status.TRACKING and self._is_sure(answer, covariance_map):
            self.is_joined, self._is_new = True, False
        if self.is_joined:
            answer = replace(answer, covariance_map=covariance_map)
            if answer.status is not Status.TRACKING or not self._map_stays:
                return answer
            self._was_sure = self._was_sure or self._is_sure(answer, covariance_map)
            return replace(answer, status=Status.COASTING) if self._is_unsure(answer, covariance_map) else answer
        if answer.status not in (Status.TRACKING, Status.COASTING):
            return answer
        return replace(answer, status=Status.INITIALIZING if self._is_new else Status.COASTING)

    def _covariance_map(self, answer: Estimate) -> FloatArray | None:
        """(6, 6) of T_map_body: of the newest keyframe that was judged, and what odometry's has grown by since."""
        place = self._live.place
        if place is None or answer.T_odom_body is None or answer.covariance is None:
            return None
        before = place.T_odom_keyframe, place.covariance_odom
        _, grown = motions.step_between(*before, answer.T_odom_body, answer.covariance)
        Ad = se3.adjoint(place.T_map_keyframe)
        return np.asarray(place.covariance + Ad @ grown @ Ad.T)

    @property
    def recognised(self) -> int | None:
        """As `LiveLoops.recognised`."""
        return self._live.recognised

    @property
    def recognizer(self) -> Recognizer:
        """Knows all keyframes; whole once loops are finished."""
        return self._live.recognizer

    def finish(self) -> ClosedLoops:
        """All loops, once the drive is over; keyframes are put to where they are known to be."""
        if self._closed is not None and len(self._closed.T_map_keyframe) == len(self._store):
            return self._closed
        self.hand_over()
        self._leave()
        self._closed = found = self._live.finish()
        if len(found.T_map_keyframe) == len(self._store):
            self._store.move(list(self._store), found.T_map_keyframe)
        return found

    def close(self) -> None:
        """End the thread."""
        self._live.close()

    def _apart(self, piece: int) -> FloatArray:
        return apart(piece, self._settings.pieces)

    def _laid(self, update: PoseUpdate) -> FloatArray:
        """T_map_keyframe (K, 4, 4), pieces apart."""
        T: FloatArray = update.T_map_keyframe.copy()
        unjoined: IntArray = np.unique(update.piece[update.piece > 0])
        for first in unjoined:
            T[update.piece == first] = self._apart(self._pieces.index(int(first))) @ T[update.piece == first]
        return T


def loops_beside(
    store: KeyframeStore,
    calibration: Calibration,
    settings: Config,
    known: KnownMap | None = None,
    *,
    waits: bool,
    detector: LoopDetector | None = None,
) -> LoopsBeside | None:
    """Where the settings ask for loops that the camera finds; Ligocki's filter, as its paper has it, knows none."""
    is_asked = settings.loops.source == FROM_KEYFRAMES and settings.fusion.filter != "ligocki"
    return LoopsBeside(store, calibration, settings, known, waits=waits, detector=detector) if is_asked else None


def begin_in(known: KnownMap, calibration: Calibration, settings: PieceSettings) -> FloatArray:
    """T_map_camera (4, 4) at which a drive begins in a map of before."""
    if known.T_map_camera is not None:
        return known.T_map_camera
    T_base_camera = np.eye(4) if calibration.T_base_camera is None else se3.nearest(calibration.T_base_camera)
    return apart(1, settings) @ T_base_camera if len(known.store) else T_base_camera


def apart(piece: int, settings: PieceSettings) -> FloatArray:
    """(4, 4) to where a piece is kept until it is known where it lies."""
    T = np.eye(4)
    T[2, 3] = -settings.apart_m * piece
    return T


def _is_within(answer: Estimate, covariance_map: FloatArray, most_m: float, most_rad: float) -> bool:
    """Whether a pose in the map is known to so many metres and radians along the worst axis."""
    if answer.T_odom_body is None:
        return False
    C = se3.position_covariance(answer.T_map_odom @ answer.T_odom_body, covariance_map)
    sigma_m, sigma_rad = (np.sqrt(np.linalg.eigvalsh(one)[-1]) for one in (C, covariance_map[3:, 3:]))
    return bool(sigma_m <= most_m and sigma_rad <= most_rad)


# Keyframes that a camera led astray has laid are put where the wheels know that it went.
#
# Somebody who walks past close by leads a camera some decimetres off. Keyframes that it keeps meanwhile lie there in
# its map, one after the other; once the wheels are believed it goes on by them, and would be as far off in the map
# until loops have moved them.


# By the frames at which they were kept.
Kept = list[list[LivedKeyframe]]


def laid_anew(store: KeyframeStore, waiting: Kept, probability: float) -> tuple[Kept, FloatArray] | None:
    """Those that wait, and all their poses (K, 4, 4) in the store; None where they may stay where they are.

    They move where one lies farther from the one before, along the floor, than the motion between them and its
    covariance allow: but for so small a probability that all is well. Height and tilt stay as the camera has them. What
    it alone has aligned meanwhile is forgotten.
    """
    first = waiting[0][0].number if waiting else 0
    if not first or not _is_one_way(waiting):
        return None
    T_old = T_before = T_last = store.pose(KeyframeId(first - 1))
    T_new: list[FloatArray] = []
    laid: Kept = []
    is_astray = False
    for kept in waiting:
        T_now = store.pose(kept[0].number)
        assert kept[0].motion is not None
        step = se3.invert(T_old) @ T_now
        is_astray |= _misfit(step, kept[0].motion, T_old[2, :3]) > quantile(probability, 3)
        T_here, T_old = se3.nearest(T_before @ _along_floor(step, kept[0].motion, T_old[2, :3])), T_now
        T_new_old = T_here @ se3.invert(T_now)
        of_frame = []
        for lived in kept:
            T_new.append(se3.nearest(T_new_old @ store.pose(lived.number)))
            of_frame.append(replace(lived, T_before_now=se3.invert(T_last) @ T_new[-1], seen_from=None))
            T_last = T_new[-1]
        laid.append(of_frame)
        T_before = T_here
    return (laid, np.array(T_new)) if is_astray else None


def _is_one_way(waiting: Sequence[Sequence[LivedKeyframe]]) -> bool:
    """Whether it is known how one went to the other: none begins a piece, and each motion is told."""
    return all(kept[0].motion is not None and not any(lived.begins for lived in kept) for kept in waiting)


def _misfit(step: FloatArray, motion: CameraMotion, up: FloatArray) -> float:
    """χ² of three degrees of freedom: how far a step (4, 4) is from a motion along a floor with a normal (3,)."""
    T, C = motion
    along = np.zeros((6, 3))
    along[:3, :2], along[3:, 2] = np.linalg.svd(up[None])[2][1:].T, up
    off = along.T @ motions.log(motions.times(step, motions.inverse(T)))
    return float(off @ np.linalg.solve(along.T @ C @ along + ANCHOR_SIGMA**2 * np.eye(3), off))


def _along_floor(step: FloatArray, motion: CameraMotion, up: FloatArray) -> FloatArray:
    """A step (4, 4) that goes along the floor as a motion says."""
    ends = KeyframeId(0), KeyframeId(1)
    return along_floor(RelativePose(*ends, step, np.eye(6)), motion, up).T_first_second
