from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from places.seen_room import EXACT, kept, maker, ring, seen, standing

from wheelsight.core.geometry import se3
from wheelsight.core.keyframes import KeyframeId, KeyframeStore
from wheelsight.places.place_finder import PlaceFinder
from wheelsight.places.recognition import Recognizer
from wheelsight.places.verification import PlaceVerifier, Refusal, RefusedPlace, VerifiedPlace


class Told(PlaceVerifier):
    """Answers as it was told, whatever is seen."""

    def __init__(self, answers):
        self.answers = answers

    def verify(self, view, candidate, keyframe):
        return self.answers.get(candidate, RefusedPlace(candidate, Refusal.TOO_FEW_MATCHES))


@pytest.fixture(scope="module")
def mapped() -> tuple[Recognizer, KeyframeStore]:
    recognizer, store = Recognizer(), KeyframeStore()
    for T in ring():
        keyframe = kept(seen(T))
        recognizer.add(store.add(keyframe, T), keyframe)
    return recognizer, store


def answer(store, number, T_map_camera, inliers=20, **told):
    T = se3.invert(store.pose(KeyframeId(number))) @ T_map_camera
    known = VerifiedPlace(KeyframeId(number), T, 1e-4 * np.eye(6), 0 * np.eye(6), np.zeros((0, 6)), 90, inliers, 0.0)
    return replace(known, **told)


def test_a_view_is_found_in_the_map_and_confirmed(mapped):
    recognizer, store = mapped
    finder = PlaceFinder(recognizer, PlaceVerifier(EXACT, views=maker()))
    T = standing(-0.1, 0.2, 0.1)
    search = finder.find(seen(T), store, store.T_map_keyframe)
    assert search.is_confirmed
    assert search.found is not None
    T_map_camera = store.pose(search.found.keyframe) @ search.found.T_keyframe_camera
    assert np.linalg.norm(T_map_camera[:3, 3] - T[:3, 3]) < 0.02


def test_a_view_of_another_room_is_not_found(mapped):
    recognizer, store = mapped
    verifier = PlaceVerifier(EXACT, views=maker())
    search = PlaceFinder(recognizer, verifier).find(seen(standing(-0.1, 0.2, 0.1), seed=9), store, store.T_map_keyframe)
    assert search.found is None
    assert len(search.refused) == sum(verifier.refusals.values()) == 24


def test_the_place_may_be_the_fortieth_of_those_that_are_alike(mapped):
    """Seen from far aside, it is not among the first 24."""
    recognizer, store = Recognizer(), KeyframeStore()
    for T, number in zip(ring() * 2, (*mapped[1], *mapped[1]), strict=True):
        keyframe = mapped[1][number]
        recognizer.add(store.add(keyframe, T), keyframe)
    view = seen(ring()[0])
    last = recognizer.candidates(view, k=40)[-1].keyframe
    search = PlaceFinder(recognizer, Told({last: answer(store, last, standing(0, 0, 0))})).find(
        view, store, store.T_map_keyframe
    )
    assert search.found is not None
    assert search.found.keyframe == last


def test_two_places_that_look_alike_are_neither(mapped):
    recognizer, store = mapped
    here, there = standing(0, 0, 0), standing(1.5, 0, 0)
    finder = PlaceFinder(recognizer, Told({0: answer(store, 0, here, 50), 12: answer(store, 12, there, 20)}))
    search = finder.find(seen(ring()[0]), store, store.T_map_keyframe)
    assert search.found is None
    assert len(search.verified) == 2


def test_one_answer_alone_is_told_to_be_alone(mapped):
    recognizer, store = mapped
    finder = PlaceFinder(recognizer, Told({3: answer(store, 3, standing(0, 0, 0))}))
    search = finder.find(seen(ring()[3]), store, store.T_map_keyframe)
    assert search.found is not None
    assert search.found.keyframe == 3
    assert not search.is_confirmed


def test_answers_that_leave_directions_unknown_confirm_nothing(mapped):
    recognizer, store = mapped
    here = standing(0, 0, 0)
    part = {"degenerate": np.eye(6)[:1]}
    finder = PlaceFinder(recognizer, Told({3: answer(store, 3, here, **part), 4: answer(store, 4, here, **part)}))
    search = finder.find(seen(ring()[3]), store, store.T_map_keyframe)
    assert not search.is_confirmed
    assert search.found is not None
    assert not search.found.shows_all
