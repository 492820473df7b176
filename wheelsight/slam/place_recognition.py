"""PlaceWatcher: finds keyframes that show the same place as earlier ones. KnownMap: the map of an earlier drive."""

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
from wheelsight.places.recognition import Recognizer, SeenView, ViewMaker
from wheelsight.places.verification import PlaceVerifier, VerifiedPlace
from wheelsight.slam.graph import Prior, RelativePose
from wheelsight.slam.settings import SeenSettings
from wheelsight.vision.dense import DenseSettings

# PlaceWatcher: which keyframes show a place that earlier ones show, one keyframe after the other.


_UNREAD = "the keyframe cannot be read"


class LoopDetector(Protocol):
    """Names keyframes that may show the same place, by a method of your own.

    `Localizer` and `run` take one as `loop_detector` in place of the built-in recognition. Each candidate is verified
    by geometry, and the pose graph judges each loop: a wrong candidate costs time and moves nothing.
    """

    def candidates(self, number: KeyframeId, keyframe: Keyframe) -> Iterable[int]:
        """Numbers of earlier keyframes that look like this one, the most alike first; empty where none does.

        It is called once for each keyframe, in the order of their numbers, in the thread that closes loops: remember
        here what later keyframes are compared with. Keyframes of a known map come first, and their answers are not
        used. Keyframes that come while the thread is busy with older ones may be left out. The first
        `loops.seen.candidates` are verified; keyframes of the last `loops.seen.apart_s` seconds are left out.

        An exception, and a number that was not shown before, end the run by a `PartError`.

        Args:
            number: names the keyframe for good.
            keyframe: its images `grey` and `depth_m`, keypoints and stamp.
        """
        ...


class PlaceWatcher:
    """Recognises each keyframe among those of `apart_s` and more before it, and verifies what is recognised.

    It works in one thread, since odometry needs the others.

    Args:
        store: of the keyframes, with keypoints.
        calibration: of the camera that saw them.
        settings, recognition: or the defaults.
        recognizer: knows keyframes of an earlier drive; or a new one.
        detector: names candidates in place of the recognizer, which learns all keyframes for the next drive.

    Attributes:
        recognizer: knows all that were seen.
    """

    def __init__(
        self,
        store: KeyframeStore,
        calibration: Calibration,
        settings: SeenSettings | None = None,
        recognition: RecognitionSettings | None = None,
        recognizer: Recognizer | None = None,
        detector: LoopDetector | None = None,
    ) -> None:
        self._store, self._settings = store, settings or SeenSettings()
        self._views = ViewMaker(calibration, DenseSettings(threads=1))
        self.recognizer = recognizer or Recognizer(recognition)
        self._verifier = PlaceVerifier(calibration, recognition, self._views)
        self._known: list[KeyframeId] = []
        self._stamps_s: list[float] = []
        self._unread = 0
        self._detector, self._shown = detector, set[int]()
        self._unshown = self.recognizer.keyframes  # of before, which a detector is shown once

    @property
    def refusals(self) -> Mapping[str, int]:
        """How many candidates were refused so far, by reason."""
        told = {str(reason): count for reason, count in self._verifier.refusals.items()}
        return told | ({_UNREAD: self._unread} if self._unread else {})

    def look(
        self, number: KeyframeId, near: Sequence[KeyframeId] = (), adrift: Sequence[KeyframeId] = ()
    ) -> tuple[RelativePose, ...]:
        """Where earlier keyframes show the place of one, which is known from now on.

        Keyframes come in order of time. Those that lie `near`, the nearest first, are verified as if recognised. While
        nobody knows where in the map one lies, those that are `adrift` with it cannot tell: more others are asked.
        """
        keyframe = self._store[number]
        recent = self._known[bisect.bisect_right(self._stamps_s, keyframe.stamp_s - self._settings.apart_s) :]
        found = self.recognised(number, recent, near, adrift)
        self._learn(number, keyframe)
        return found

    def recognised(
        self,
        number: KeyframeId,
        but: Collection[KeyframeId] = (),
        near: Sequence[KeyframeId] = (),
        adrift: Sequence[KeyframeId] = (),
    ) -> tuple[RelativePose, ...]:
        """Where keyframes that the recognizer knows, `but` some, show the place of one, which is not known by that.

        `near` and `adrift` as in `look`.
        """
        keyframe = self._store[number]
        view = self._views.of_keyframe(keyframe)
        found: list[RelativePose] = []
        named = None if self._detector is None else self._named(self._detector, number, keyframe, {*but})
        elsewhere = self._elsewhere(view, but, adrift, named)
        for candidate in dict.fromkeys((*elsewhere, *self._candidates(view, but, near, named))):
            try:
                known = self._store.recalled(candidate, number)
            except MapError:  # the disk is gone, or damaged there: the drive goes on without
                self._unread += 1
                continue
            answer = self._verifier.verify(view, candidate, known)
            if isinstance(answer, VerifiedPlace):
                motion = answer.T_keyframe_camera, answer.covariance
                found.append(RelativePose(candidate, number, *motion, is_loop=True))
                if len(found) == self._settings.most_places:
                    break
        return tuple(found)

    def _named(
        self, detector: LoopDetector, number: KeyframeId, keyframe: Keyframe, but: Collection[KeyframeId]
    ) -> list[KeyframeId]:
        """What a user's detector names, but some; keyframes that the recognizer has from before are shown first."""
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

    def _elsewhere(
        self,
        view: SeenView,
        but: Collection[KeyframeId],
        adrift: Sequence[KeyframeId],
        named: Sequence[KeyframeId] | None,
    ) -> tuple[KeyframeId, ...]:
        """Those that look like a view, of the rest of the map; none where the view is known to lie in it."""
        if not adrift:
            return ()
        if named is not None:
            return tuple(one for one in named if one not in adrift)[: self._settings.candidates_adrift]
        found = self.recognizer.candidates(view, self._settings.candidates_adrift, {*but, *adrift})
        return tuple(one.keyframe for one in found)

    def _candidates(
        self,
        view: SeenView,
        but: Collection[KeyframeId],
        near: Sequence[KeyframeId],
        named: Sequence[KeyframeId] | None,
    ) -> tuple[KeyframeId, ...]:
        """Those that look like a view, and some that lie near, each once."""
        s = self._settings
        alike = (
            [one.keyframe for one in self.recognizer.candidates(view, s.candidates, but)]
            if named is None
            else list(named[: s.candidates])
        )
        known = set(self.recognizer.keyframes)
        others = [one for one in near if one in known and one not in but and one not in alike]
        left = max(s.candidates - min(s.near_candidates, len(others)), 0)
        return (*alike[:left], *others[: s.candidates - min(left, len(alike))][: s.near_candidates])

    def pass_by(self, number: KeyframeId) -> tuple[RelativePose, ...]:
        """Know a keyframe from now on, without asking what it shows."""
        self._learn(number, self._store[number])
        return ()

    def _learn(self, number: KeyframeId, keyframe: Keyframe) -> None:
        self.recognizer.add(number, keyframe)
        self._known.append(number)
        self._stamps_s.append(keyframe.stamp_s)


# KnownMap: what an earlier drive has left, in which the next one finds itself.


@dataclass(frozen=True, slots=True, eq=False)
class KnownMap:
    """Keyframes of before, and what is known of where they are.

    Attributes:
        store: has them; those of the drive that begins are added.
        recognizer: knows all of them that can be recognised.
        edges: between them; none of a map that is to stay as it is.
        T_map_camera: (4, 4) where the camera begins, as somebody says; None: it is to be recognised.
        covariance: (6, 6) of the left perturbation (v, ω) of that.
    """

    store: KeyframeStore
    recognizer: Recognizer
    edges: tuple[RelativePose, ...] = ()
    T_map_camera: FloatArray | None = None
    covariance: FloatArray | None = None

    @property
    def start(self) -> tuple[FloatArray, FloatArray] | None:
        """Where the camera begins, and how sure that is; None where nobody says."""
        if self.T_map_camera is None or self.covariance is None:
            return None
        return self.T_map_camera, self.covariance

    def priors(self, sigma_fixed: float, sigma_m: float, sigma_rad: float) -> list[Prior]:
        """What holds its keyframes where they are: all but exactly, or as loosely as they may still move.

        One that damage took has no pose: it lies anywhere, and nothing hangs on it.
        """
        sigmas = [sigma_m] * 3 + [sigma_rad] * 3 if self.edges else [sigma_fixed] * 6
        C, T = np.diag(np.square(sigmas)), np.array(self.store.T_map_keyframe)
        T[~np.isfinite(T).all(axis=(1, 2))] = np.eye(4)
        return [Prior(KeyframeId(number), T_map_keyframe, C) for number, T_map_keyframe in enumerate(T)]
