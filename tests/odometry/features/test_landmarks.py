from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from odometry.views import odometry, room_frames
from synthetic import wobbling_trajectory

from wheelsight.core.estimates import Status
from wheelsight.core.geometry import se3
from wheelsight.core.keyframes import KeyframeId
from wheelsight.vision.features.tracking import Features, KeypointView, LandmarkMap

FIRST = KeyframeId(0)


def features_at(points: np.ndarray, sigma_m: float = 0.01, has_depth: np.ndarray | None = None) -> Features:
    """Features that show points (N, 3) of the camera's frame."""
    n = len(points)
    depth_m = points[:, 2] if has_depth is None else np.where(has_depth, points[:, 2], 0.0)
    words = np.arange(4 * n, dtype=np.uint64).reshape(n, 4)
    xy = points[:, :2] / points[:, 2:]
    return Features(0.0, 100 * xy, np.zeros(n, int), words, xy, depth_m, np.ones(n), np.full(n, sigma_m))


def view_at(T: np.ndarray, points: np.ndarray, landmark: np.ndarray | None = None, **how: Any) -> KeypointView:
    landmark = np.full(len(points), -1) if landmark is None else landmark
    return KeypointView(features_at(points, **how), T, np.eye(6), landmark)


@pytest.fixture
def points(rng) -> np.ndarray:
    return rng.uniform((-1, -1, 1), (1, 1, 3), (10, 3))


def aside(metres: float) -> np.ndarray:
    return se3.from_parts(np.eye(3), [metres, 0, 0])


def test_keypoints_with_depth_become_landmarks_of_the_world(rng, points):
    T = se3.exp(rng.standard_normal(6))
    has_depth = np.arange(10) % 3 > 0
    landmarks = LandmarkMap(5)
    keyframe = landmarks.add_keyframe(view_at(T, points, has_depth=has_depth), FIRST)
    np.testing.assert_array_equal(keyframe.landmark >= 0, has_depth)
    np.testing.assert_array_equal(landmarks.numbers, np.arange(6))
    held, words, sightings = landmarks.get(keyframe.landmark[has_depth])
    np.testing.assert_allclose(held, se3.apply(T, points[has_depth]), atol=1e-12)
    np.testing.assert_array_equal(words, keyframe.features.descriptors[has_depth])
    np.testing.assert_array_equal(sightings, 1)


def test_known_landmarks_are_not_made_twice(points):
    landmarks = LandmarkMap(5)
    first = landmarks.add_keyframe(view_at(np.eye(4), points), FIRST)
    again = first.landmark.copy()
    again[6:] = -1
    second = landmarks.add_keyframe(view_at(np.eye(4), points, again), FIRST)
    np.testing.assert_array_equal(second.landmark, [0, 1, 2, 3, 4, 5, 10, 11, 12, 13])
    assert len(landmarks.numbers) == 14


def test_averaging_is_the_mean_weighted_by_the_depths_certainty(rng, points):
    landmarks = LandmarkMap(5)
    sigmas = [0.01, 0.02, 0.005, 0.04]
    seen = [points + s * rng.standard_normal(points.shape) for s in sigmas]
    landmarks.add_keyframe(view_at(np.eye(4), seen[0], sigma_m=sigmas[0]), FIRST)
    T = se3.exp(0.3 * rng.standard_normal(6))
    for p_map, sigma in zip(seen[1:], sigmas[1:], strict=True):
        features = features_at(se3.apply(se3.invert(T), p_map), sigma)
        landmarks.see_again(np.arange(10), features, np.arange(10), T)
    mean = np.average(seen, axis=0, weights=np.array(sigmas) ** -2.0)
    held, _, sightings = landmarks.get(np.arange(10))
    np.testing.assert_allclose(held, mean, atol=1e-12)
    np.testing.assert_array_equal(sightings, 4)


def test_a_sighting_without_depth_moves_nothing_but_counts(points):
    landmarks = LandmarkMap(5)
    landmarks.add_keyframe(view_at(np.eye(4), points), FIRST)
    features = features_at(points + 1, has_depth=np.arange(10) >= 3)
    features.descriptors[:] += np.uint64(7)
    landmarks.see_again(np.array([0, 1, 4]), features, np.array([0, 1, 4]), np.eye(4))
    held, words, sightings = landmarks.get(np.arange(10))
    np.testing.assert_allclose(held[4], points[4] + 0.5)
    others = np.arange(10) != 4
    np.testing.assert_allclose(held[others], points[others])
    np.testing.assert_array_equal(sightings, [2, 2, 1, 1, 2, 1, 1, 1, 1, 1])
    np.testing.assert_array_equal(words[[0, 1, 4]], features.descriptors[[0, 1, 4]])


def test_the_oldest_keyframe_is_forgotten_and_numbers_are_not_used_again(points):
    landmarks = LandmarkMap(2)
    landmarks.add_keyframe(view_at(np.eye(4), points), FIRST)
    kept_on = np.where(np.arange(10) < 3, np.arange(10), -1)
    landmarks.add_keyframe(view_at(np.eye(4), points, kept_on), FIRST)
    np.testing.assert_array_equal(landmarks.numbers, np.arange(17))
    landmarks.add_keyframe(view_at(np.eye(4), points), FIRST)
    # Gone: 3 to 9, seen by the first keyframe alone. Kept: 0 to 2, kept again by the second.
    np.testing.assert_array_equal(landmarks.numbers, [0, 1, 2, *range(10, 27)])
    np.testing.assert_array_equal(
        landmarks.holds(np.array([2, 3, 9, 10, 26, 27])), [True, False, False, True, True, False]
    )
    assert len(landmarks.keyframes) == 2
    stale = np.array([0, 5, 12, -1, -1, -1, -1, -1, -1, -1])
    keyframe = landmarks.add_keyframe(view_at(np.eye(4), points, stale), FIRST)
    assert keyframe.landmark[1] == 27
    assert keyframe.landmark[[0, 2]].tolist() == [0, 12]
    assert (np.diff(landmarks.numbers) > 0).all()


def test_near_are_the_landmarks_of_keyframes_that_look_there(points):
    landmarks = LandmarkMap(100)
    for i in range(10):
        landmarks.add_keyframe(view_at(aside(2.0 * i), points), FIRST)
    np.testing.assert_array_equal(landmarks.near(aside(6.1), 1), np.arange(30, 40))
    np.testing.assert_array_equal(landmarks.near(aside(6.4), 2), np.arange(30, 50))
    np.testing.assert_array_equal(landmarks.near(aside(-9.0), 3), np.arange(30))
    np.testing.assert_array_equal(landmarks.near(aside(0.0), 10), landmarks.numbers)


def test_a_view_the_other_way_is_not_near(points):
    landmarks = LandmarkMap(100)
    back = se3.exp(np.array([0, 0, 0, 0, np.pi, 0]))
    for T in (back, aside(1.0), aside(1.5)):
        landmarks.add_keyframe(view_at(T, points), FIRST)
    np.testing.assert_array_equal(landmarks.near(np.eye(4), 2), np.arange(10, 30))


def test_near_goes_on_after_forgetting(points):
    landmarks = LandmarkMap(4)
    for i in range(9):
        landmarks.add_keyframe(view_at(aside(2.0 * i), points), FIRST)
    np.testing.assert_array_equal(landmarks.near(aside(12.2), 1), np.arange(60, 70))


def test_landmarks_and_views_go_with_the_keyframe_that_made_them(rng, points):
    landmarks = LandmarkMap(5)
    T = se3.exp(0.5 * rng.standard_normal((2, 6)))
    first = landmarks.add_keyframe(view_at(T[0], points), KeyframeId(0))
    known = np.where(np.arange(10) < 4, first.landmark, -1)
    landmarks.add_keyframe(view_at(T[1], points, known), KeyframeId(1))
    np.testing.assert_array_equal(landmarks.made_by, [0] * 10 + [1] * 6)
    before = landmarks.points.copy()
    T_new_old = np.stack([np.eye(4), se3.exp(rng.standard_normal(6))])
    landmarks.move(T_new_old)
    np.testing.assert_array_equal(landmarks.points[:10], before[:10])
    np.testing.assert_allclose(landmarks.points[10:], se3.apply(T_new_old[1], before[10:]), atol=1e-12)
    still, moved = landmarks.keyframes
    np.testing.assert_array_equal(still.T_map_color, T[0])
    np.testing.assert_allclose(moved.T_map_color, T_new_old[1] @ T[1], atol=1e-12)
    Ad = se3.adjoint(T_new_old[1])
    np.testing.assert_allclose(moved.covariance, Ad @ Ad.T, atol=1e-12)


@pytest.mark.slow
def test_a_long_drive_stays_within_its_memory():
    """Back and forth, with so few keyframes kept that most are forgotten: tracking goes on, arrays stay bounded."""
    truth = wobbling_trajectory(90, speed=4.0)
    subject = odometry(kept_keyframes=4, local_keyframes=2, keyframe_share=0.9, keypoints=300)
    for frame in room_frames(truth):
        assert subject.process(frame).status is Status.TRACKING
        landmarks = subject.landmarks
        assert len(landmarks.keyframes) <= 4
        n = len(landmarks.numbers)
        assert n <= 4 * 300
        sizes = {len(x) for x in (landmarks.points, landmarks.descriptors, landmarks.sightings, landmarks.made_by)}
        assert sizes == {n}
        assert (np.diff(landmarks.numbers) > 0).all()
    assert len(subject.store) - len(landmarks.keyframes) > 10
    assert landmarks.numbers[-1] > 2 * len(landmarks.numbers)


def test_landmarks_stay_as_they_are_where_keypoints_of_older_keyframes_are_forgotten(points):
    kept, subject = (LandmarkMap(3) for _ in range(2))
    known = np.full(10, -1)
    for number in range(5):
        for one in (kept, subject):
            T = se3.exp([0.5 * number, 0, 0, 0, 0, 0])
            keyframe = one.add_keyframe(view_at(T, points, known.copy()), KeyframeId(number))
        subject.forget_keypoints()
        known = np.where(np.arange(10) < 4, keyframe.landmark, -1)
    assert [len(view.features) for view in subject.keyframes] == [0, 0, 10]
    np.testing.assert_array_equal(subject.keyframes[-1].landmark, kept.keyframes[-1].landmark)
    np.testing.assert_array_equal(subject.numbers, kept.numbers)
    np.testing.assert_array_equal(subject.near(aside(1.4), 1), kept.near(aside(1.4), 1))
    moves = np.tile(se3.exp([0, 1, 0, 0, 0, 0.1]), (5, 1, 1))
    for one in (kept, subject):
        one.move(moves)
    for now, then in zip(subject.get(subject.numbers), kept.get(kept.numbers), strict=True):
        np.testing.assert_array_equal(now, then)
