"""Places that the camera saw again on a drive that is over: each keyframe against those of long before."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from wheelsight.calibration import Calibration
from wheelsight.geometry import FloatArray, se3
from wheelsight.keyframes import KeyframeId, KeyframeStore
from wheelsight.matches import Match
from wheelsight.places.recognition import Recognizer
from wheelsight.places.verification import PlaceVerifier, VerifiedPlace
from wheelsight.places.views import SeenView, ViewMaker
from wheelsight.settings import RecognitionSettings
from wheelsight.slam.settings import SeenSettings


@dataclass(frozen=True, slots=True, eq=False)
class SeenAgain:
    """Which keyframes show a place that earlier ones show.

    Attributes:
        matches: relative poses of the body at both, with their covariances.
        keyframes: how many were compared.
        refused: how many candidates were refused, by reason.
    """

    matches: tuple[Match, ...]
    keyframes: int
    refused: Mapping[str, int]


def seen_again(
    store: KeyframeStore,
    calibration: Calibration,
    settings: SeenSettings | None = None,
    recognition: RecognitionSettings | None = None,
    T_body_camera: FloatArray | None = None,
) -> SeenAgain:
    """Recognise each keyframe among those of `apart_s` and more before it, and verify what is recognised.

    Args:
        store: keyframes with keypoints.
        calibration: of the camera that saw them.
        settings, recognition: or the defaults.
        T_body_camera: (4, 4) where the camera is on the body whose matches these are; None: the body is the camera.
    """
    settings, views = settings or SeenSettings(), ViewMaker(calibration)
    recognizer = Recognizer(recognition)
    verifier = PlaceVerifier(calibration, recognition, views)
    T_body_camera = np.eye(4) if T_body_camera is None else T_body_camera
    stamps_s = np.array([store[number].stamp_s for number in store])
    matches: list[Match] = []
    for number in store:
        view = views.of_keyframe(store[number])
        first_recent = int(np.searchsorted(stamps_s, stamps_s[number] - settings.apart_s, side="right"))
        recent = [KeyframeId(other) for other in range(first_recent, number)]
        for place in _verified(view, recognizer, verifier, store, recent, settings):
            stamps = float(stamps_s[place.keyframe]), float(stamps_s[number])
            matches.append(_match(place, *stamps, T_body_camera))
        recognizer.add(number, view)
    refused: Counter[str] = Counter({str(reason): count for reason, count in verifier.refusals.items()})
    return SeenAgain(tuple(matches), len(store), refused)


def _verified(
    view: SeenView,
    recognizer: Recognizer,
    verifier: PlaceVerifier,
    store: KeyframeStore,
    recent: list[KeyframeId],
    settings: SeenSettings,
) -> list[VerifiedPlace]:
    """The first candidates that are verified."""
    found: list[VerifiedPlace] = []
    for candidate in recognizer.candidates(view, settings.candidates, recent):
        answer = verifier.verify(view, candidate.keyframe, store[candidate.keyframe])
        if isinstance(answer, VerifiedPlace):
            found.append(answer)
            if len(found) == settings.most_places:
                break
    return found


def _match(place: VerifiedPlace, stamp_a_s: float, stamp_b_s: float, T_body_camera: FloatArray) -> Match:
    """A verified place as the body's own motion."""
    Ad = se3.adjoint(T_body_camera)
    T_a_b = T_body_camera @ place.T_keyframe_camera @ se3.invert(T_body_camera)
    return Match(stamp_a_s, stamp_b_s, T_a_b, Ad @ place.covariance @ Ad.T)
