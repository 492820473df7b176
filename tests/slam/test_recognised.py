"""Keyframes that show a place again become matches; those of just now do not."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from narrowing import not_none
from places.seen_room import EXACT, kept, ring, seen

from wheelsight.geometry import FloatArray, se3, so3
from wheelsight.keyframes import KeyframeStore
from wheelsight.matches import Match
from wheelsight.slam.recognised import SeenAgain, seen_again
from wheelsight.slam.settings import SeenSettings

# Half round the room and the same way again, some centimetres aside; a keyframe a second.
WAY = [T for lap in (0.0, 0.06) for T in (pose @ se3.exp([lap, 0, 0, 0, 0, 0]) for pose in ring(16)[:8])]
T_BODY_CAMERA = se3.from_parts(so3.exp([0.3, -0.2, 1.1]), np.array([0.2, 0.1, 0.9]))


@pytest.fixture(scope="module")
def store() -> KeyframeStore:
    """Where keyframes are said to be plays no part: all are said to be at the origin."""
    made = KeyframeStore()
    for second, T in enumerate(WAY):
        made.add(replace(kept(seen(T)), stamp_s=float(second)), np.eye(4))
    return made


@pytest.fixture(scope="module")
def found(store: KeyframeStore) -> SeenAgain:
    return seen_again(store, EXACT, SeenSettings(apart_s=5.0))


def error(match: Match) -> FloatArray:
    """Of the camera's motion, as a left perturbation."""
    truth = se3.invert(WAY[int(match.stamp_a_s)]) @ WAY[int(match.stamp_b_s)]
    return se3.log(not_none(match.T_a_b) @ se3.invert(truth))


def test_each_place_of_the_second_lap_is_found_where_it_is(found: SeenAgain) -> None:
    again = {match.stamp_b_s for match in found.matches}
    assert again >= {9.0, 10.0, 11.0, 12.0, 13.0, 14.0}
    for match in found.matches:
        off = error(match)
        assert np.linalg.norm(off[:3]) < 0.03
        assert off @ np.linalg.solve(not_none(match.covariance), off) < 30


def test_what_was_seen_just_now_is_no_match(found: SeenAgain) -> None:
    assert min(match.stamp_b_s - match.stamp_a_s for match in found.matches) >= 5.0


def test_candidates_are_counted_that_were_refused(found: SeenAgain) -> None:
    assert found.keyframes == len(WAY)
    assert sum(found.refused.values()) > 0


def test_a_body_that_carries_the_camera_moves_as_the_camera_does(store: KeyframeStore, found: SeenAgain) -> None:
    of_body = seen_again(store, EXACT, SeenSettings(apart_s=5.0), T_body_camera=T_BODY_CAMERA)
    assert len(of_body.matches) == len(found.matches)
    for camera, body in zip(found.matches, of_body.matches, strict=True):
        T_a_b = T_BODY_CAMERA @ not_none(camera.T_a_b) @ se3.invert(T_BODY_CAMERA)
        np.testing.assert_allclose(not_none(body.T_a_b), T_a_b, atol=1e-9)
        # The same squared length, whoever's perturbation it is.
        x = np.array([0.01, -0.02, 0.03, 0.004, 0.005, -0.006])
        moved = se3.adjoint(T_BODY_CAMERA) @ x
        squares = [v @ np.linalg.solve(not_none(m.covariance), v) for v, m in ((x, camera), (moved, body))]
        assert squares[1] == pytest.approx(squares[0], rel=1e-6)
