"""`PlaceFinder` returns the pose of a view in a map of keyframes, confirmed by a second keyframe if possible."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass, replace

import numpy as np

from wheelsight.core.estimates import DEGENERATE_SCALE
from wheelsight.core.geometry import FloatArray, se3
from wheelsight.core.keyframes import Keyframe, KeyframeId, KeyframeStore
from wheelsight.places.recognition import Recognizer, SeenView
from wheelsight.places.verification import PlaceVerifier, RefusedPlace, VerifiedPlace

_APART_M = 0.05  # between two keyframes that count as two, a turn by a radian as 1.5 m
_AGREE_CHI2 = 22.5  # up to which two answers agree: χ² of 6, 99.9 %
_UNSEEN_SIGMA_M = 10.0  # as places are verified
_CERTAIN = np.zeros((6, 6))


@dataclass(frozen=True, slots=True, eq=False)
class Search:
    """Result of a search for a view.

    Attributes:
        found: pose of the view; None if no keyframe shows the place, or two contradict each other.
        is_confirmed: whether a second keyframe from another viewpoint agrees.
        verified: all verified places, with their keyframes.
        refused: refused candidates.
    """

    found: VerifiedPlace | None
    is_confirmed: bool
    verified: tuple[VerifiedPlace, ...]
    refused: tuple[RefusedPlace, ...]


class PlaceFinder:
    """Verifies candidates one by one, until two from separate viewpoints agree.

    Args:
        recognizer: recognizer with the keyframes.
        verifier: compares the view with a keyframe.
    """

    def __init__(self, recognizer: Recognizer, verifier: PlaceVerifier) -> None:
        self._recognizer, self._verifier = recognizer, verifier

    def find(
        self,
        view: SeenView,
        keyframes: Mapping[KeyframeId, Keyframe | SeenView] | KeyframeStore,
        T_map_keyframe: FloatArray,
        forbidden: Collection[KeyframeId] = (),
    ) -> Search:
        """Return the pose of a view.

        Args:
            view: the view.
            keyframes: the recognizer's keyframes, by number.
            T_map_keyframe: (N, 4, 4) their poses, by number.
            forbidden: keyframes to leave out.
        """
        verified: list[VerifiedPlace] = []
        refused: list[RefusedPlace] = []
        for candidate in self._recognizer.candidates(view, forbidden=forbidden):
            answer = self._verifier.verify(view, candidate.keyframe, keyframes[candidate.keyframe])
            if isinstance(answer, RefusedPlace):
                refused.append(answer)
                continue
            for earlier in verified:
                # Two places with unobserved directions would agree on whatever the other one does not observe.
                T_first_second = se3.invert(T_map_keyframe[earlier.keyframe]) @ T_map_keyframe[answer.keyframe]
                is_apart = not se3.view_shift_m(T_first_second) < _APART_M
                if not (earlier.shows_all and answer.shows_all and is_apart):
                    continue
                both = joined(earlier, answer, T_first_second, _CERTAIN)
                if both is not None:
                    return Search(both, True, (*verified, answer), tuple(refused))
            verified.append(answer)
        return Search(self._best(verified, T_map_keyframe), False, tuple(verified), tuple(refused))

    def _best(self, verified: list[VerifiedPlace], T_map_keyframe: FloatArray) -> VerifiedPlace | None:
        """Return the place with the most keypoints, unless another one contradicts it.

        Places that observe all directions are preferred.
        """
        answers = [answer for answer in verified if answer.shows_all] or verified
        if not answers:
            return None
        best = max(answers, key=lambda answer: answer.inliers)
        for other in answers:
            T_best_other = se3.invert(T_map_keyframe[best.keyframe]) @ T_map_keyframe[other.keyframe]
            if joined(best, other, T_best_other, _CERTAIN) is None:
                return None
        return best


def distance_chi2(
    first: VerifiedPlace, second: VerifiedPlace, T_first_second: FloatArray, covariance: FloatArray
) -> float:
    """Return the squared Mahalanobis distance of two places of one view, χ² with 6 degrees of freedom.

    Args:
        first: place by one keyframe.
        second: place by another.
        T_first_second: (4, 4) pose of the second keyframe relative to the first, by the map.
        covariance: (6, 6) of its left perturbation.
    """
    off, spread = _apart(first, second, T_first_second, covariance)
    return float(off @ np.linalg.solve(spread[0] + spread[1], off))


def joined(
    first: VerifiedPlace,
    second: VerifiedPlace,
    T_first_second: FloatArray,
    covariance: FloatArray,
) -> VerifiedPlace | None:
    """Return both places combined, relative to the first keyframe; None if they contradict; see `distance_chi2`.

    The view's own error is common to both, and remains. A direction is unobserved if neither observes it.
    """
    off, (own, others) = _apart(first, second, T_first_second, covariance)
    total = own + others
    if off @ np.linalg.solve(total, off) > _AGREE_CHI2:
        return None
    T = se3.exp(own @ np.linalg.solve(total, off)) @ first.T_keyframe_camera
    spread = own - own @ np.linalg.solve(total, own)
    together = 0.5 * (spread + spread.T) + first.shared
    # Directions with about the variance of unobserved ones.
    variances, directions = np.linalg.eigh(together * np.outer(DEGENERATE_SCALE, DEGENERATE_SCALE))
    is_unseen = variances > (0.5 * _UNSEEN_SIGMA_M) ** 2
    return replace(
        first,
        T_keyframe_camera=T,
        covariance=together,
        degenerate=np.asarray(directions[:, is_unseen].T),
        matches=first.matches + second.matches,
        inliers=first.inliers + second.inliers,
        intruding=max(first.intruding, second.intruding),
    )


def _apart(
    first: VerifiedPlace, second: VerifiedPlace, T_first_second: FloatArray, covariance: FloatArray
) -> tuple[FloatArray, tuple[FloatArray, FloatArray]]:
    """Return the offset (6,) of the second pose from the first, and the separate covariances, (6, 6) each."""
    T_second = T_first_second @ second.T_keyframe_camera
    Ad = se3.adjoint(T_first_second)
    others = covariance + Ad @ (second.covariance - second.shared) @ Ad.T
    off = se3.log(T_second @ se3.invert(first.T_keyframe_camera))
    return off, (first.covariance - first.shared, others)
