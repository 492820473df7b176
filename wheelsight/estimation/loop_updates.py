"""Exchange of keyframes with the thread that closes loops, and the update of keyframe poses from its results.

`corrected_keyframes` moves keyframes that a failing camera has placed wrongly, by the motions of the filter.
"""

from __future__ import annotations

import logging
from collections.abc import Sequence
from dataclasses import replace
from enum import Enum
from itertools import chain

import numpy as np

from wheelsight.config import Config
from wheelsight.core.calibration import Calibration
from wheelsight.core.estimates import CameraEstimate, PoseEvidence, PoseFinding, Status
from wheelsight.core.geometry import FloatArray, IntArray, se3
from wheelsight.core.geometry import motion_kernels as motions
from wheelsight.core.geometry.chi_square import quantile
from wheelsight.core.keyframes import KeyframeId, KeyframeStore
from wheelsight.places.recognition import Recognizer
from wheelsight.slam.drive_graph import JOIN_APART_M, CameraMotion, OdometryKeyframe, Revisit
from wheelsight.slam.graph import ANCHOR_SIGMA, RelativePose, aligned_edge, along_floor
from wheelsight.slam.loop_closing import ClosedLoops, LiveLoops
from wheelsight.slam.loop_gate import GATE_PROBABILITY
from wheelsight.slam.place_recognition import KnownMap, LoopDetector
from wheelsight.slam.settings import FROM_KEYFRAMES

_LOG = logging.getLogger(__name__)

# A submap counts as joined once the standard deviation of a pose in the map is at most this, along the worst axis.
# Estimated: a place 0.5 m or 10 degrees off is wrong, and this is less than a third of it.
_ACCURATE_M, _ACCURATE_RAD = 0.15, 0.06
# In a fixed known map, a pose with a larger standard deviation is `coasting`. Larger than above, so that the status
# does not alternate.
_INACCURATE_M, _INACCURATE_RAD = 0.2, 0.08
# Way and time in which the camera has to confirm a place in a known map, and the views that have to recognise it: one
# alone has been 0.3 m off. And the number of keyframes in a row that lie among those of the map and are not recognised,
# after which the place is in doubt. At a right place, two in a row were missed among six people (simulator).
# Time counts in steps of the robot, since one that stands sees nothing new.
_CONFIRM_M, _CONFIRM_S, _CONFIRM_VIEWS, _MOST_MISSED = 5.0, 20.0, 2, 5
_STEP_M, _LONGEST_STEP_S = 0.1, 2.0
# Distance below the map at which unjoined submaps are kept, so that none is visible from another. Estimated: surfels
# there are still placed to 0.02 mm.
_SUBMAP_SPACING_M = 200.0

# New keyframes that the thread does not have yet, grouped by the frames at which they were added.
PendingKeyframes = list[list[OdometryKeyframe]]


class SubmapState(Enum):
    """State of the submap in which the camera is."""

    APART = "no loop joins it to the rest of the map"
    PLACED = "loops have placed it, at any certainty"
    JOINED = "the pose in the map is known well enough"


class LoopClosureClient:
    """Passes new keyframes of odometry to the thread that closes loops, and moves keyframes by its results.

    Args:
        store: of the odometry.
        calibration, settings: of the run.
        known: map of an earlier drive, whose keyframes are in the store.
        waits, detector: see `LiveLoops`.

    Attributes:
        submap: state of the submap in which the camera is.
        confirmation: of the place in the known map.
        tracked_s: stamp of the last frame in `add_tracked`.
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
        self._store = store
        how = (calibration, settings.loops, settings.recognition)
        self._live = LiveLoops(store, *how, known=known, waits=waits, detector=detector)
        self._is_map_fixed, self._was_accurate = known is not None and not known.edges, False
        self._added = len(store)  # keyframes of the store that `add_keyframes` has taken
        self._pending: PendingKeyframes = []
        self._tracked_by: KeyframeId | None = None  # keyframe by which the last frame was tracked
        self.tracked_s = -np.inf
        self._seen_from: tuple[KeyframeId, FloatArray] | None = None
        self._nearest: tuple[float, Revisit] | None = None  # of the frames tracked by a revisited keyframe
        self._closed: ClosedLoops | None = None
        self._loops: IntArray = np.zeros((0, 2), np.int64)
        self._submap_starts: list[int] = [0]  # numbers of their first keyframes
        self.submap, self._awaits_recognition = SubmapState.JOINED, False
        self._has_known = known is not None and len(store) > 0
        self.confirmation = PlaceConfirmation(is_given=known is not None and known.start is not None)
        if known is not None and len(store) and known.start is None:
            self.begin_submap(KeyframeId(len(store)))
            self._awaits_recognition = True

    def move_keyframes(self, stamp_s: float, keyframe: KeyframeId | None) -> FloatArray | None:
        """Move keyframes to their poses by loops; return T_new_old (4, 4) of one of them, or None without a change.

        Keyframes that the thread does not know yet move with the last one that it knows.
        """
        update = self._live.due(stamp_s)
        if update is None:
            return None
        if len(update.loops) != len(self._loops):
            _LOG.info("%d loops are closed (before: %d); keyframes move", len(update.loops), len(self._loops))
        self._loops = update.loops
        T_known, T_old = update.T_map_keyframe.copy(), np.array(self._store.T_map_keyframe)
        unjoined: IntArray = np.unique(update.submap[update.submap > 0])
        for first in unjoined:  # stays apart
            T_submap = provisional_submap_pose(self._submap_starts.index(int(first)))
            T_known[update.submap == first] = T_submap @ T_known[update.submap == first]
        count = len(T_known)
        T_newer = T_old[count:]
        if self._submap_starts[-1] < count:  # else the thread does not know the submap of the newer ones
            T_newer = T_known[-1] @ se3.invert(T_old[count - 1]) @ T_newer
            if update.submap[-1] != 0:
                self.submap = SubmapState.APART
            elif self.submap is SubmapState.APART:
                self.submap = SubmapState.PLACED
        T_new = np.concatenate([T_known, T_newer])
        self._store.move(list(self._store), T_new)
        at = count - 1 if keyframe is None else keyframe
        return np.asarray(se3.nearest(T_new[at] @ se3.invert(T_old[at])))

    def add_tracked(self, seen: CameraEstimate, T_odom_map: FloatArray, covariance: FloatArray) -> None:
        """Add a tracked frame, before `add_keyframes`. If it is tracked by an older keyframe, that is a measurement.

        Args:
            seen: of the frame, with its keyframe.
            T_odom_map: (4, 4) pose of the map in the frame of odometry; with a filter, that is the filter's frame.
            covariance: (6, 6) of the camera's pose in that frame.
        """
        number, motion, T_keyframe_camera = seen.keyframe, seen.motion.covariance, seen.T_keyframe_body
        before, self._tracked_by, self._seen_from = self._tracked_by, number, None
        self.tracked_s = seen.stamp_s
        if number != before:
            self._end_revisit()
        if number is None or motion is None or T_keyframe_camera is None:
            return
        if number >= self._added:
            self._seen_from = None if before is None or before == number - 1 else (before, motion)
            return
        if self._pending and number >= self._pending[0][0].number:
            return  # the thread does not know it yet
        apart_m = float(se3.view_shift_m(T_keyframe_camera))
        if number == before and (self._nearest is None or self._nearest[0] <= apart_m):
            return
        T_odom_keyframe = se3.nearest(T_odom_map @ self._store.pose(number))
        again = Revisit(number, seen.stamp_s, T_odom_keyframe, covariance, motion)
        self._nearest = apart_m, again
        if number != before:
            self._live.request_place(again)

    def forget_tracked(self) -> None:
        """Forget the last tracked frame, after one that the filter rejects.

        Otherwise a camera that a person has misled would connect what it saw meanwhile to what it saw before.
        """
        self._end_revisit()
        self._tracked_by = self._seen_from = None

    def _end_revisit(self) -> None:
        """Pass on the nearest frame of a revisited keyframe: the error of a view grows with the distance."""
        if self._nearest is not None:
            self._live.add_revisit(self._nearest[1])
            self._nearest = None

    @property
    def has_new(self) -> bool:
        """Whether odometry has added keyframes since the last `add_keyframes`."""
        return len(self._store) > self._added

    @property
    def has_pending(self) -> bool:
        """Whether keyframes wait for `hand_over`."""
        return bool(self._pending)

    def add_keyframes(
        self, stamp_s: float, T_odom_map: FloatArray, covariance: FloatArray, motion: CameraMotion | None = None
    ) -> None:
        """Take the keyframes that odometry has added at a frame.

        Args:
            stamp_s: of the frame.
            T_odom_map, covariance: as of `add_tracked`.
            motion: of the camera from the previous frame with new keyframes to this one.
        """
        added: list[OdometryKeyframe] = []
        for number in map(KeyframeId, range(self._added, len(self._store))):
            T_map_keyframe = self._store.pose(number)
            T_odom_keyframe = se3.nearest(T_odom_map @ T_map_keyframe)
            begins = number > 0 and number in self._submap_starts
            T_before_now = None
            if number:
                T_map_before = self._store.pose(KeyframeId(number - 1))
                T_before_now = np.asarray(se3.nearest(se3.invert(T_map_before) @ T_map_keyframe))
            seen_from = None
            if not added and self._seen_from is not None:
                older, spread = self._seen_from
                T_older_new = se3.invert(self._store.pose(older)) @ T_map_keyframe
                seen_from = aligned_edge((older, number), T_older_new, spread)
            by_odometry = (number, stamp_s, T_odom_keyframe, covariance, begins, T_before_now)
            added.append(OdometryKeyframe(*by_odometry, None, T_map_keyframe, seen_from))
        self._added = len(self._store)
        if added:
            set_motion(added, motion)
            self._pending.append(added)

    def hand_over(
        self, motions: Sequence[CameraMotion | None] = (), keyframe: KeyframeId | None = None
    ) -> FloatArray | None:
        """Pass all pending keyframes to the thread, with the current estimates of the motions to the last of them.

        Keyframes that a failing camera has placed wrongly move to where those motions lead. Return T_new_old (4, 4) of
        one keyframe, or None if it stays.
        """
        pending, self._pending = self._pending, []
        # A filter that has taken over knows the motions to the last ones only.
        for of_frame, motion in zip(reversed(pending), reversed(motions), strict=False):
            set_motion(of_frame, motion)
        corrected = corrected_keyframes(self._store, pending, GATE_PROBABILITY)
        pending, T_new = (pending, None) if corrected is None else corrected
        for one in chain.from_iterable(pending):
            self._live.add(one)
        if T_new is None:
            return None
        numbers = [KeyframeId(len(self._store) - len(T_new) + row) for row in range(len(T_new))]
        T_old = np.array(self._store.T_map_keyframe)
        self._store.move(numbers, T_new)
        if keyframe not in numbers:
            return None
        return np.asarray(se3.nearest(self._store.pose(keyframe) @ se3.invert(T_old[keyframe])))

    def update_evidence(
        self,
        stamp_s: float,
        status: Status,
        T_odom_body: FloatArray | None,
        covariance: FloatArray | None,
        T_map_odom: FloatArray,
    ) -> PoseEvidence:
        """Return whether the pose in the map is known, with its covariance (6, 6) if loops know that.

        A submap is joined here, and the confirmation of the place continues.

        Args:
            stamp_s: of the pose.
            status: its status.
            T_odom_body, covariance: (4, 4) and (6, 6) pose in the frame of `add_tracked`; or None.
            T_map_odom: (4, 4) pose of that frame in the map.
        """
        place, C, T = None if self.submap is SubmapState.APART else self._live.place, None, None
        if place is not None and T_odom_body is not None and covariance is not None:
            # That of the newest evaluated keyframe, and what odometry has added since.
            _, grown = motions.step_between(place.T_odom_keyframe, place.covariance_odom, T_odom_body, covariance)
            Ad = se3.adjoint(place.T_map_keyframe)
            C, T = np.asarray(place.covariance + Ad @ grown @ Ad.T), T_map_odom @ T_odom_body
        is_accurate = False
        is_joined = self.submap is SubmapState.JOINED
        if status is Status.TRACKING and not (is_joined and (self._was_accurate or not self._is_map_fixed)):
            # Loops have placed the current submap, and the pose in the map is accurate enough.
            is_current = place is not None and place.newest >= self._submap_starts[-1]
            is_accurate = is_current and _is_within(T, C, _ACCURATE_M, _ACCURATE_RAD)
        if not is_joined and is_accurate:
            self.submap, self._awaits_recognition = SubmapState.JOINED, False
        elif not is_joined:
            return PoseEvidence(PoseFinding.NOT_RECOGNISED if self._awaits_recognition else PoseFinding.PLACE_UNCERTAIN)
        doubt = None
        if self._has_known and T_odom_body is not None:
            doubt = self.confirmation.update(stamp_s, T_odom_body, self._live.recognised_views, self._live.missed)
        if doubt is not None and status in (Status.TRACKING, Status.COASTING):
            return PoseEvidence(doubt, covariance_map=C)
        if status is Status.TRACKING and self._is_map_fixed:
            # An existing map does not grow as uncertain as the drive. A given start is accepted as it is until loops
            # make it more certain.
            self._was_accurate |= is_accurate
            if C is not None and self._was_accurate and not _is_within(T, C, _INACCURATE_M, _INACCURATE_RAD):
                return PoseEvidence(PoseFinding.PLACE_UNCERTAIN, covariance_map=C)
        return PoseEvidence(PoseFinding.PLACE_KNOWN, covariance_map=C)

    @property
    def is_joined(self) -> bool:
        """Whether the pose in the map is known well enough."""
        return self.submap is SubmapState.JOINED

    def camera_in_new_submap(self, T_map_camera: FloatArray) -> FloatArray:
        """Return T_map_camera (4, 4) at the begin of a new submap, for a camera at (4, 4) in the current one."""
        here = len(self._submap_starts) - 1 if self.submap is SubmapState.APART else 0
        T_new, T_here = (provisional_submap_pose(index) for index in (len(self._submap_starts), here))
        return T_new @ se3.invert(T_here) @ T_map_camera

    def begin_submap(self, keyframe: KeyframeId) -> None:
        """Begin a submap, apart from the others, at a keyframe."""
        self._submap_starts.append(keyframe)
        self.submap, self._was_accurate = SubmapState.APART, False
        if self.confirmation.is_refuted:
            self._awaits_recognition = True
            self.confirmation.reset(self._live.recognised_views)

    def has_loop_across(self, number: int) -> bool:
        """Whether loops connect keyframes from `number` on to older ones, from views as far apart as between submaps.

        Then their relative pose is known, however uncertain odometry was.
        """
        older, newer = self._loops.T
        ends = newer[(older < number) & (newer >= number)]
        if not len(ends):
            return False
        T = self._store.T_map_keyframe[ends]
        return bool((se3.view_shift_m(se3.invert(T[0]) @ T) >= JOIN_APART_M).any())

    @property
    def accepted_loops(self) -> IntArray:
        """(K, 2) numbers of the keyframes that accepted loops connect."""
        if self._closed is None:
            return self._loops
        ends = [(loop.first, loop.second) for loop in self._closed.loops.kept]
        return np.array(ends, np.int64).reshape(-1, 2)

    @property
    def recognised(self) -> int | None:
        """As `LiveLoops.recognised`."""
        return self._live.recognised

    @property
    def recognizer(self) -> Recognizer:
        """Recognizer of all keyframes; complete after `finish`."""
        return self._live.recognizer

    def finish(self) -> ClosedLoops:
        """Return all loops of a finished drive, and move its keyframes to their final poses."""
        if self._closed is not None and len(self._closed.T_map_keyframe) == len(self._store):
            return self._closed
        self.hand_over()
        self._end_revisit()
        self._closed = found = self._live.finish()
        if len(found.T_map_keyframe) == len(self._store):
            self._store.move(list(self._store), found.T_map_keyframe)
        return found

    def close(self) -> None:
        """End the thread."""
        self._live.close()


class PlaceConfirmation:
    """Whether the camera confirms the robot's place in a known map.

    A given start is a hypothesis until two views recognise the map. A place that was recognised is in doubt once
    keyframes that lie among those of the map are not recognised any more, until the next one is. A place that is not
    confirmed within `_CONFIRM_M` of way, or `_CONFIRM_S` of motion, is refuted.

    Args:
        is_given: whether the place is a start that a person has given.

    Attributes:
        is_refuted: whether the place is wrong.
        warnings: a sentence if it was.
    """

    def __init__(self, *, is_given: bool) -> None:
        self._is_given, self._is_doubtful = is_given, is_given
        self.is_refuted, self._recognised = False, 0
        self.warnings: tuple[str, ...] = ()
        # Stamp and pose at the last step, and way and time of all steps since the place is in doubt.
        self._since: tuple[float, FloatArray, float, float] | None = None

    def update(self, stamp_s: float, T_odom_body: FloatArray, recognised: int, missed: int) -> PoseFinding | None:
        """Return what the place is in a map, at a pose (4, 4) in odom; None if it is confirmed.

        Args:
            recognised: number of views that recognised the map so far.
            missed: number of keyframes in a row that were not recognised though they lie among those of the map.
        """
        if recognised - self._recognised >= (_CONFIRM_VIEWS if self._is_given else 1):
            self.reset(recognised)
        self._is_doubtful |= missed >= _MOST_MISSED
        if not self._is_doubtful:
            return None
        last_s, T_last, way_m, moved_s = self._since or (stamp_s, T_odom_body, 0.0, 0.0)
        T_last_now = motions.times(motions.inverse(T_last), T_odom_body)
        if self._since is None or motions.view_shift_m(T_last_now) > _STEP_M:
            way_m += float(np.hypot(*T_last_now[:2, 3]))
            moved_s += min(stamp_s - last_s, _LONGEST_STEP_S)
            self._since = stamp_s, T_odom_body, way_m, moved_s
        if not self.is_refuted and (way_m > _CONFIRM_M or moved_s > _CONFIRM_S):
            where = "near the given start" if self._is_given else "where the robot was taken to be"
            within = f"in {way_m:.1f} m of way and {moved_s:.0f} s"
            self.is_refuted = True
            self.warnings = (f"nothing looks like the map {where} {within}: the place was wrong, or it is another map",)
        return PoseFinding.NOT_RECOGNISED if self.is_refuted else PoseFinding.UNCONFIRMED

    def reset(self, recognised: int) -> None:
        """Begin again without a doubt, after `recognised` views: a place is confirmed, or a submap begins."""
        self._is_doubtful = self._is_given = self.is_refuted = False
        self._recognised, self._since = recognised, None


def loop_closure_client(
    store: KeyframeStore,
    calibration: Calibration,
    settings: Config,
    known: KnownMap | None = None,
    *,
    waits: bool,
    detector: LoopDetector | None = None,
) -> LoopClosureClient | None:
    """Return loop closing if the settings ask for it. Ligocki's filter has none, as in its paper."""
    is_asked = settings.loops.source == FROM_KEYFRAMES and settings.fusion.filter != "ligocki"
    return LoopClosureClient(store, calibration, settings, known, waits=waits, detector=detector) if is_asked else None


def begin_in(known: KnownMap, calibration: Calibration) -> FloatArray:
    """Return T_map_camera (4, 4) at the start of a drive in an existing map."""
    if known.T_map_camera is not None:
        return known.T_map_camera
    T_base_camera = np.eye(4) if calibration.T_base_camera is None else se3.nearest(calibration.T_base_camera)
    return provisional_submap_pose(1) @ T_base_camera if len(known.store) else T_base_camera


def provisional_submap_pose(index: int) -> FloatArray:
    """Return (4, 4), the pose of a submap in the map until loops join it."""
    T = np.eye(4)
    T[2, 3] = -_SUBMAP_SPACING_M * index
    return T


def _is_within(T_map_body: FloatArray | None, covariance: FloatArray | None, most_m: float, most_rad: float) -> bool:
    """Whether the σ of a pose in the map, along its worst axis, is known and within limits in metres and radians."""
    if T_map_body is None or covariance is None:
        return False
    C = se3.position_covariance(T_map_body, covariance)
    sigma_m, sigma_rad = (np.sqrt(np.linalg.eigvalsh(one)[-1]) for one in (C, covariance[3:, 3:]))
    return bool(sigma_m <= most_m and sigma_rad <= most_rad)


def set_motion(of_frame: list[OdometryKeyframe], motion: CameraMotion | None) -> None:
    """Set the motion to the first of some keyframes, given that to the last; None for nothing new.

    While the filter has no pose, keyframes of several frames come together. The camera's map has the motions between.
    """
    if motion is None:
        return
    T, covariance = motion
    for keyframe in reversed(of_frame[1:]):
        assert keyframe.T_before_now is not None
        T = se3.nearest(T @ se3.invert(keyframe.T_before_now))
    of_frame[0] = replace(of_frame[0], motion=(T, covariance))


def corrected_keyframes(
    store: KeyframeStore, pending: PendingKeyframes, probability: float
) -> tuple[PendingKeyframes, FloatArray] | None:
    """Return the pending keyframes with corrected poses (K, 4, 4) in the store; None if all may stay.

    A person who walks past closely can mislead the camera by some decimetres. The keyframes that it adds meanwhile are
    wrong in the map, and the camera continues from them once the filter follows the wheels again.

    Keyframes move if a step between two of them, along the floor, contradicts the motion of the filter: its χ² exceeds
    the quantile of `probability`. Height and tilt stay as the camera measured them. Alignments by the camera alone are
    dropped.
    """
    first = pending[0][0].number if pending else 0
    is_connected = all(one[0].motion is not None and not any(keyframe.begins for keyframe in one) for one in pending)
    if not first or not is_connected:
        return None
    T_old = T_before = T_last = store.pose(KeyframeId(first - 1))
    T_new: list[FloatArray] = []
    corrected: PendingKeyframes = []
    is_misplaced = False
    for of_frame in pending:
        T_now, motion = store.pose(of_frame[0].number), of_frame[0].motion
        assert motion is not None
        step, up = se3.invert(T_old) @ T_now, T_old[2, :3]
        is_misplaced |= _misfit(step, motion, up) > quantile(probability, 3)
        T_along = along_floor(RelativePose(KeyframeId(0), KeyframeId(1), step, np.eye(6)), motion, up).T_first_second
        T_here, T_old = se3.nearest(T_before @ T_along), T_now
        T_new_old = T_here @ se3.invert(T_now)
        corrected.append([])
        for keyframe in of_frame:
            T_new.append(se3.nearest(T_new_old @ store.pose(keyframe.number)))
            corrected[-1].append(replace(keyframe, T_before_now=se3.invert(T_last) @ T_new[-1], seen_from=None))
            T_last = T_new[-1]
        T_before = T_here
    return (corrected, np.array(T_new)) if is_misplaced else None


def _misfit(step: FloatArray, motion: CameraMotion, up: FloatArray) -> float:
    """Return χ², of three degrees of freedom, of a step (4, 4) against a motion along a floor with a normal (3,)."""
    T, C = motion
    along = np.zeros((6, 3))
    along[:3, :2], along[3:, 2] = np.linalg.svd(up[None])[2][1:].T, up
    off = along.T @ motions.log(motions.times(step, motions.inverse(T)))
    return float(off @ np.linalg.solve(along.T @ C @ along + ANCHOR_SIGMA**2 * np.eye(3), off))
