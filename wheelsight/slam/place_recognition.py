"""PlaceWatcher: finds earlier keyframes that show the same place. KnownMap: the map of an earlier drive."""

from __future__ import annotations

import bisect
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass
from numbers import Integral
from typing import Protocol

import numpy as np

from wheelsight.core.calibration import Calibration
from wheelsight.core.checks import answer_of
from wheelsight.core.errors import MapError, PartError
from wheelsight.core.geometry import FloatArray
from wheelsight.core.keyframes import Keyframe, KeyframeId, KeyframeStore
from wheelsight.core.settings import RecognitionSettings
from wheelsight.places.recognition import Recognizer, ViewMaker
from wheelsight.places.verification import PlaceVerifier, VerifiedPlace
from wheelsight.slam.graph import Prior, RelativePose

# Largest number of candidates verified for each keyframe, and of further ones in the map while the pose in it is
# unknown: docs/decisions/loops-and-graph.md. The latter are fewer than for a single view: each keyframe tries again.
_CANDIDATES, _CANDIDATES_UNJOINED = 5, 24
_NEAR_CANDIDATES = 2  # of these, keyframes near the current pose: under other light they may look different; chosen
_MOST_PLACES = 5  # number of verified places that are enough for each keyframe; chosen
_UNREAD = "the keyframe cannot be read"


class LoopDetector(Protocol):
    """User-defined detector of loop candidates.

    `Localizer` and `run` accept one as `loop_detector` in place of the built-in recognition. Each candidate is verified
    geometrically and checked by the pose graph: a wrong candidate costs time and does not affect poses.
    """

    def candidates(self, number: KeyframeId, keyframe: Keyframe) -> Iterable[int]:
        """Return numbers of earlier keyframes that look like this one, best first; empty if there are none.

        Called once for each keyframe, in the order of their numbers, in the loop-closing thread. Store here what later
        keyframes are compared with. Keyframes of a known map come first, and their results are ignored. Keyframes may
        be skipped while the thread is busy. The first five are verified; keyframes of the last `loops.apart_s` seconds
        are ignored.

        An exception ends the run by a `PartError`, and so does the number of a keyframe not passed in before.

        Args:
            keyframe: its images `grey` and `depth_m`, keypoints and stamp.
        """
        ...


class PlaceWatcher:
    """Recognizes each keyframe among those at least `apart_s` older, and verifies the candidates.

    It uses one thread, since odometry needs the others.

    Args:
        apart_s: least time between the two keyframes of a loop, seconds.
        recognizer: recognizer with the keyframes of an earlier drive; None for a new one.
        detector: source of candidates in place of the recognizer, which still learns all keyframes for the next drive.
    """

    def __init__(
        self,
        store: KeyframeStore,
        calibration: Calibration,
        apart_s: float,
        recognition: RecognitionSettings | None = None,
        recognizer: Recognizer | None = None,
        detector: LoopDetector | None = None,
    ) -> None:
        self._store, self._apart_s = store, apart_s
        self._views = ViewMaker(calibration)
        self.recognizer = recognizer or Recognizer(recognition)
        self._verifier = PlaceVerifier(calibration, recognition, self._views)
        self._known: list[KeyframeId] = []
        self._stamps_s: list[float] = []
        self._unread = 0
        self._detector, self._shown = detector, set[int]()
        self._unshown = self.recognizer.keyframes  # of the known map, which a detector is shown once

    @property
    def refusals(self) -> Mapping[str, int]:
        """Number of refused candidates so far, by reason."""
        counts = {str(reason): count for reason, count in self._verifier.refusals.items()}
        return counts | ({_UNREAD: self._unread} if self._unread else {})

    def find_loops(
        self, number: KeyframeId, near: Sequence[KeyframeId] = (), unjoined: Sequence[KeyframeId] = ()
    ) -> tuple[RelativePose, ...]:
        """Return loops from a keyframe to earlier ones that show the same place, and add it to the known keyframes.

        Keyframes come in order of time. Keyframes `near` it, the nearest first, are verified as well. `unjoined` are
        the keyframes of its submap while that is not joined to the map; then more candidates of the map are verified.
        """
        stamp_s = self._store[number].stamp_s
        recent = self._known[bisect.bisect_right(self._stamps_s, stamp_s - self._apart_s) :]
        found = self.recognised(number, recent, near, unjoined)
        self.add(number)
        return found

    def add(self, number: KeyframeId) -> None:
        """Add a keyframe to the known ones without looking for loops."""
        keyframe = self._store[number]
        self.recognizer.add(number, keyframe)
        self._known.append(number)
        self._stamps_s.append(keyframe.stamp_s)

    def recognised(
        self,
        number: KeyframeId,
        but: Collection[KeyframeId] = (),
        near: Sequence[KeyframeId] = (),
        unjoined: Sequence[KeyframeId] = (),
    ) -> tuple[RelativePose, ...]:
        """Return loops from a keyframe to known ones except `but`, without adding it to the known ones.

        `near` and `unjoined` are as in `find_loops`.
        """
        keyframe = self._store[number]
        view = self._views.of_keyframe(keyframe)
        found: list[RelativePose] = []
        named = None if self._detector is None else self._named(self._detector, number, keyframe, {*but})
        # Keyframes that look like the view, and some near it.
        alike = (
            [one.keyframe for one in self.recognizer.candidates(view, _CANDIDATES, but)]
            if named is None
            else named[:_CANDIDATES]
        )
        known_ones = set(self.recognizer.keyframes)
        others = [one for one in near if one in known_ones and one not in but and one not in alike]
        left = max(_CANDIDATES - min(_NEAR_CANDIDATES, len(others)), 0)
        here = *alike[:left], *others[: _CANDIDATES - min(left, len(alike))][:_NEAR_CANDIDATES]
        elsewhere: Sequence[KeyframeId] = ()
        if unjoined and named is not None:
            elsewhere = [one for one in named if one not in unjoined][:_CANDIDATES_UNJOINED]
        elif unjoined:
            found_there = self.recognizer.candidates(view, _CANDIDATES_UNJOINED, {*but, *unjoined})
            elsewhere = [one.keyframe for one in found_there]
        for candidate in dict.fromkeys((*elsewhere, *here)):
            try:
                known = self._store.as_of(candidate, number)
            except MapError:  # unreadable on disk: the drive continues without it
                self._unread += 1
                continue
            answer = self._verifier.verify(view, candidate, known)
            if isinstance(answer, VerifiedPlace):
                motion = answer.T_keyframe_camera, answer.covariance
                found.append(RelativePose(candidate, number, *motion, is_loop=True))
                if len(found) == _MOST_PLACES:
                    break
        return tuple(found)

    def _named(
        self, detector: LoopDetector, number: KeyframeId, keyframe: Keyframe, but: Collection[KeyframeId]
    ) -> list[KeyframeId]:
        """Return a user detector's candidates except `but`. Keyframes of the known map are passed to it first."""
        unshown, self._unshown = self._unshown, ()
        for known in unshown:
            try:
                earlier = self._store[known]
            except MapError:
                self._unread += 1
                continue
            answer_of(detector, "candidates", known, earlier)
            self._shown.add(known)
        answer = answer_of(detector, "candidates", number, keyframe)
        name = f"{type(detector).__name__}.candidates"
        try:
            numbers = list(answer)
        except TypeError as error:
            raise PartError(f"{name} answered {type(answer).__name__}, not numbers", fix="a list, or ()") from error
        for one in numbers:
            if not isinstance(one, Integral) or one not in self._shown:
                fix = "numbers of keyframes that it was given before"
                raise PartError(f"{name} answered {one!r} at keyframe {number}: it was not shown", fix=fix)
        self._shown.add(number)
        return [KeyframeId(int(one)) for one in dict.fromkeys(numbers) if one not in but]


@dataclass(frozen=True, slots=True, eq=False)
class KnownMap:
    """Keyframes of an earlier drive, with their poses.

    Attributes:
        store: the keyframes. Those of the new drive are added to it.
        edges: edges between them; empty if the map is fixed.
        T_map_camera: (4, 4) given start pose of the camera; None: the start is to be recognized.
        covariance: (6, 6) of the left perturbation (v, ω) of T_map_camera.
    """

    store: KeyframeStore
    recognizer: Recognizer
    edges: tuple[RelativePose, ...] = ()
    T_map_camera: FloatArray | None = None
    covariance: FloatArray | None = None

    @property
    def start(self) -> tuple[FloatArray, FloatArray] | None:
        """Start pose of the camera with its covariance; None if it is not given."""
        if self.T_map_camera is None or self.covariance is None:
            return None
        return self.T_map_camera, self.covariance

    def priors(self, sigma_fixed: float, sigma_m: float, sigma_rad: float) -> list[Prior]:
        """Return priors of the keyframes: tight ones in a fixed map, looser ones in a map that is extended.

        A keyframe lost to damage has no pose. It gets an arbitrary one, and has no edges.

        Args:
            sigma_fixed: standard deviation in a fixed map, metres and radians.
            sigma_m, sigma_rad: standard deviations in a map that is extended.
        """
        sigmas = [sigma_m] * 3 + [sigma_rad] * 3 if self.edges else [sigma_fixed] * 6
        C, T = np.diag(np.square(sigmas)), np.array(self.store.T_map_keyframe)
        T[~np.isfinite(T).all(axis=(1, 2))] = np.eye(4)
        return [Prior(KeyframeId(number), T_map_keyframe, C) for number, T_map_keyframe in enumerate(T)]
