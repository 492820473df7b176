"""PlaceWatcher: which keyframes show a place that earlier ones show, one keyframe after the other."""

from __future__ import annotations

import bisect
from collections.abc import Collection, Mapping, Sequence

from wheelsight.calibration import Calibration
from wheelsight.errors import MapError
from wheelsight.keyframes import Keyframe, KeyframeId, KeyframeStore
from wheelsight.odometry.dense import DenseSettings
from wheelsight.places.recognition import Recognizer
from wheelsight.places.verification import PlaceVerifier, VerifiedPlace
from wheelsight.places.views import SeenView, ViewMaker
from wheelsight.settings import RecognitionSettings
from wheelsight.slam.graph import RelativePose
from wheelsight.slam.settings import SeenSettings

_UNREAD = "the keyframe cannot be read"


class PlaceWatcher:
    """Recognises each keyframe among those of `apart_s` and more before it, and verifies what is recognised.

    It works in one thread, since odometry needs the others.

    Args:
        store: of the keyframes, with keypoints.
        calibration: of the camera that saw them.
        settings, recognition: or the defaults.
        recognizer: knows keyframes of an earlier drive; or a new one.

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
    ) -> None:
        self._store, self._settings = store, settings or SeenSettings()
        self._views = ViewMaker(calibration, DenseSettings(threads=1))
        self.recognizer = recognizer or Recognizer(recognition)
        self._verifier = PlaceVerifier(calibration, recognition, self._views)
        self._known: list[KeyframeId] = []
        self._stamps_s: list[float] = []
        self._unread = 0

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
        view = self._views.of_keyframe(self._store[number])
        found: list[RelativePose] = []
        elsewhere = self._elsewhere(view, but, adrift)
        for candidate in dict.fromkeys((*elsewhere, *self._candidates(view, but, near))):
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

    def _elsewhere(
        self, view: SeenView, but: Collection[KeyframeId], adrift: Sequence[KeyframeId]
    ) -> tuple[KeyframeId, ...]:
        """Those that look like a view, of the rest of the map; none where the view is known to lie in it."""
        if not adrift:
            return ()
        found = self.recognizer.candidates(view, self._settings.candidates_adrift, {*but, *adrift})
        return tuple(one.keyframe for one in found)

    def _candidates(
        self, view: SeenView, but: Collection[KeyframeId], near: Sequence[KeyframeId]
    ) -> tuple[KeyframeId, ...]:
        """Those that look like a view, and some that lie near, each once."""
        s = self._settings
        alike = [one.keyframe for one in self.recognizer.candidates(view, s.candidates, but)]
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
