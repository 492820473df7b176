"""`PlaceFinder` returns the pose of a view in a map of keyframes, confirmed by a second keyframe where one shows the
place.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass, replace

import numpy as np

from wheelsight.core.estimates import DEGENERATE_SCALE
from wheelsight.core.geometry import FloatArray, se3
from wheelsight.core.keyframes import Keyframe, KeyframeId, KeyframeStore
from wheelsight.core.settings import PlaceVerificationSettings, RecognitionSettings
from wheelsight.places.recognition import Recognizer, SeenView
from wheelsight.places.verification import PlaceVerifier, RefusedPlace, VerifiedPlace

# PlaceFinder: where a view was seen from in a map of keyframes, confirmed by a second keyframe where one shows it.


_CERTAIN = np.zeros((6, 6))


@dataclass(frozen=True, slots=True, eq=False)
class Search:
    """What became of a view.

    Attributes:
        found: where it was seen from; None where no keyframe shows the place, or two tell different ones.
        is_confirmed: a second keyframe, seen from elsewhere, says the same.
        verified: all answers, with keyframes of their own.
        refused: candidates that are none.
    """

    found: VerifiedPlace | None
    is_confirmed: bool
    verified: tuple[VerifiedPlace, ...]
    refused: tuple[RefusedPlace, ...]


class PlaceFinder:
    """Asks for candidates and verifies them one by one, until two that were seen from apart say the same.

    Args:
        recognizer: knows the keyframes.
        verifier: compares the view with one.
        settings: or the defaults.
    """

    def __init__(
        self, recognizer: Recognizer, verifier: PlaceVerifier, settings: RecognitionSettings | None = None
    ) -> None:
        self._recognizer, self._verifier = recognizer, verifier
        self._settings = settings or RecognitionSettings()

    def find(
        self,
        view: SeenView,
        keyframes: Mapping[KeyframeId, Keyframe | SeenView] | KeyframeStore,
        T_map_keyframe: FloatArray,
        forbidden: Collection[KeyframeId] = (),
    ) -> Search:
        """Where a view was seen from.

        Args:
            view: the view.
            keyframes: those that the recognizer knows, by number.
            T_map_keyframe: (N, 4, 4) where they are, by number.
            forbidden: keyframes that are no answer.
        """
        verified: list[VerifiedPlace] = []
        refused: list[RefusedPlace] = []
        for candidate in self._recognizer.candidates(view, forbidden=forbidden):
            answer = self._verifier.verify(view, candidate.keyframe, keyframes[candidate.keyframe])
            if isinstance(answer, RefusedPlace):
                refused.append(answer)
                continue
            for earlier in verified:
                both = self._both(earlier, answer, T_map_keyframe)
                if both is not None:
                    return Search(both, True, (*verified, answer), tuple(refused))
            verified.append(answer)
        return Search(self._alone(verified, T_map_keyframe), False, tuple(verified), tuple(refused))

    def _both(self, first: VerifiedPlace, second: VerifiedPlace, T_map_keyframe: FloatArray) -> VerifiedPlace | None:
        """Two answers together, where they agree, and each by itself knows all directions.

        Two that know but some each would agree on whatever the other one does not know.
        """
        if not (first.shows_all and second.shows_all):
            return None
        T_first_second = se3.invert(T_map_keyframe[first.keyframe]) @ T_map_keyframe[second.keyframe]
        if se3.view_shift_m(T_first_second) < self._settings.apart_m:
            return None
        return joined(first, second, T_first_second, _CERTAIN, self._settings.verification)

    def _alone(self, verified: list[VerifiedPlace], T_map_keyframe: FloatArray) -> VerifiedPlace | None:
        """The answer that most keypoints speak for, unless another one says that it is elsewhere.

        Those that know all directions come first.
        """
        answers = [answer for answer in verified if answer.shows_all] or verified
        if not answers:
            return None
        best = max(answers, key=lambda answer: answer.inliers)
        for other in answers:
            T_best_other = se3.invert(T_map_keyframe[best.keyframe]) @ T_map_keyframe[other.keyframe]
            if joined(best, other, T_best_other, _CERTAIN, self._settings.verification) is None:
                return None
        return best


# Two answers about one stretch: whether they say the same, and what they say together.


def distance_chi2(
    first: VerifiedPlace, second: VerifiedPlace, T_first_second: FloatArray, covariance: FloatArray
) -> float:
    """How far apart two answers about one view are, as χ² of 6 numbers.

    Args:
        first: by one keyframe.
        second: by another.
        T_first_second: (4, 4) of the second keyframe in the first one's frame, as the map has them.
        covariance: (6, 6) of its left perturbation.
    """
    off, spread = _apart(first, second, T_first_second, covariance)
    return float(off @ np.linalg.solve(spread[0] + spread[1], off))


def joined(
    first: VerifiedPlace,
    second: VerifiedPlace,
    T_first_second: FloatArray,
    covariance: FloatArray,
    settings: PlaceVerificationSettings,
) -> VerifiedPlace | None:
    """Both as one about the first keyframe, or None where they contradict each other; see `distance_chi2`.

    What the view itself is off by is in both, and stays. A direction is unknown where neither knows it.
    """
    off, (own, others) = _apart(first, second, T_first_second, covariance)
    total = own + others
    if off @ np.linalg.solve(total, off) > settings.agree_chi2:
        return None
    T = se3.exp(own @ np.linalg.solve(total, off)) @ first.T_keyframe_camera
    spread = own - own @ np.linalg.solve(total, own)
    together = 0.5 * (spread + spread.T) + first.shared
    return replace(
        first,
        T_keyframe_camera=T,
        covariance=together,
        degenerate=_unknown(together, settings.unseen_sigma_m),
        matches=first.matches + second.matches,
        inliers=first.inliers + second.inliers,
        intruding=max(first.intruding, second.intruding),
    )


def _apart(
    first: VerifiedPlace, second: VerifiedPlace, T_first_second: FloatArray, covariance: FloatArray
) -> tuple[FloatArray, tuple[FloatArray, FloatArray]]:
    """How far (6,) the second pose is off the first, and what both err by themselves, (6, 6) each."""
    T_second = T_first_second @ second.T_keyframe_camera
    Ad = se3.adjoint(T_first_second)
    others = covariance + Ad @ (second.covariance - second.shared) @ Ad.T
    off = se3.log(T_second @ se3.invert(first.T_keyframe_camera))
    return off, (first.covariance - first.shared, others)


def _unknown(covariance: FloatArray, unseen_sigma_m: float) -> FloatArray:
    """Unit vectors (K, 6) of (v, ω · 2 m) along which a covariance is about as large as that of what is not seen."""
    variances, directions = np.linalg.eigh(covariance * np.outer(DEGENERATE_SCALE, DEGENERATE_SCALE))
    return np.asarray(directions[:, variances > (0.5 * unseen_sigma_m) ** 2].T)
