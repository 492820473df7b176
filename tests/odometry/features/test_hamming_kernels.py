from __future__ import annotations

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from odometry.plain_kernels import plain

from wheelsight.core.geometry.hamming_kernels import hamming
from wheelsight.vision import image_kernels as compiled
from wheelsight.vision.features.tracking import match_all, match_near

in_python = plain(compiled)


def descriptors(rng: np.random.Generator, n: int) -> np.ndarray:
    return rng.integers(0, 2**64, (n, 4), np.uint64)


def flipped(rng: np.random.Generator, words: np.ndarray, bits: int) -> np.ndarray:
    """The same descriptors (N, 4) with so many bits, chosen at random, turned over."""
    turned = np.unpackbits(words.view(np.uint8), axis=1)
    for row in turned:
        row[rng.choice(256, bits, replace=False)] ^= 1
    return np.packbits(turned, axis=1).view(np.uint64)


def distances(first: np.ndarray, second: np.ndarray) -> np.ndarray:
    """(N, M) by counting unpacked bits."""
    a, b = (np.unpackbits(words.view(np.uint8), axis=1).astype(int) for words in (first, second))
    return (a[:, None] != b[None]).sum(axis=2)


def test_hamming_counts_the_bits_that_differ(rng):
    a, b = descriptors(rng, 50), descriptors(rng, 50)
    expected = np.diag(distances(a, b))
    assert [hamming(p, q) for p, q in zip(a, b, strict=True)] == expected.tolist()
    assert [in_python.hamming(p, q) for p, q in zip(a, b, strict=True)] == expected.tolist()


def test_hamming_of_all_bits_and_of_none():
    nothing, everything = np.zeros(4, np.uint64), np.full(4, 2**64 - 1, np.uint64)
    assert hamming(nothing, everything) == 256
    assert hamming(everything, everything) == 0


def test_nearest_both_ways_in_plain_python(rng):
    first, second = descriptors(rng, 30), descriptors(rng, 25)
    for got, expected in zip(
        compiled.nearest_both_ways(first, second), in_python.nearest_both_ways(first, second), strict=True
    ):
        np.testing.assert_array_equal(got, expected)


def test_nearest_both_ways_of_all_distances(rng):
    first, second = descriptors(rng, 40), descriptors(rng, 60)
    apart = distances(first, second)
    nearest, distance, nearest_back = compiled.nearest_both_ways(first, second)
    np.testing.assert_array_equal(nearest, apart.argmin(axis=1))
    np.testing.assert_array_equal(distance, apart.min(axis=1))
    np.testing.assert_array_equal(nearest_back, apart.argmin(axis=0))


@pytest.mark.parametrize(("n", "m"), [(0, 3), (3, 0), (0, 0)])
def test_nothing_is_near_nothing(rng, n, m):
    nearest, _, nearest_back = compiled.nearest_both_ways(descriptors(rng, n), descriptors(rng, m))
    assert nearest.tolist() == [-1] * n
    assert nearest_back.tolist() == [-1] * m
    assert len(match_all(descriptors(rng, n), descriptors(rng, m), 256).first) == 0


def test_match_all_agrees_with_opencv_s_cross_check(rng):
    first = descriptors(rng, 300)
    second = np.concatenate([flipped(rng, first[:200], 30), descriptors(rng, 150)])[rng.permutation(350)]
    ours = match_all(first, second, 256)
    theirs = cv2.BFMatcher(cv2.NORM_HAMMING, crossCheck=True).match(first.view(np.uint8), second.view(np.uint8))
    apart = distances(first, second)
    # Where two are equally near either may be chosen, so pairs are compared by those no one rivals.
    sole = ((apart == apart.min(axis=1, keepdims=True)).sum(axis=1) == 1) & (apart.argmin(axis=1) >= 0)
    sole_back = (apart == apart.min(axis=0)).sum(axis=0) == 1
    pairs = {(int(i), int(j)) for i, j in zip(*ours, strict=True) if sole[i] and sole_back[j]}
    expected = {(m.queryIdx, m.trainIdx) for m in theirs if sole[m.queryIdx] and sole_back[m.trainIdx]}
    assert pairs == expected
    assert len(pairs) >= 200
    found = dict(zip(ours.first.tolist(), apart[ours].tolist(), strict=True))
    assert all(found[m.queryIdx] == m.distance for m in theirs if m.queryIdx in found)


def test_match_all_keeps_to_the_limit(rng):
    first = descriptors(rng, 60)
    second = np.concatenate([flipped(rng, first[:20], 10), flipped(rng, first[20:40], 60), descriptors(rng, 20)])
    np.testing.assert_array_equal(match_all(first, second, 10).first, np.arange(20))
    np.testing.assert_array_equal(match_all(first, second, 60).second, np.arange(40))
    assert match_all(first, second, 9).first.size == 0


def nearby_by_hand(expected_px, expected, px, words, radius_px, max_hamming):
    """What `match_near` promises, without cells: pairs in the order of asking, each keypoint to its nearest asker."""
    apart = distances(expected, words)
    owners: dict[int, tuple[int, int]] = {}
    for i, where in enumerate(expected_px):
        inside = np.flatnonzero(((px - where) ** 2).sum(axis=1) <= radius_px**2)
        ranked = sorted(apart[i, inside].tolist())
        if not ranked or ranked[0] > max_hamming or (len(ranked) > 1 and ranked[0] > 0.9 * ranked[1] + 1):
            continue
        rivals = [j for j in inside if apart[i, j] == ranked[0]]
        assert len(rivals) == 1
        j = int(rivals[0])
        if j not in owners or ranked[0] < owners[j][0]:
            owners[j] = (ranked[0], i)
    return {(i, j) for j, (_, i) in owners.items()}


@given(
    seed=st.integers(0, 10_000), radius_px=st.sampled_from([2.0, 12.0, 40.0]), max_hamming=st.sampled_from([20, 120])
)
def test_match_near_finds_what_a_search_of_everything_finds(seed, radius_px, max_hamming):
    rng = np.random.default_rng(seed)
    seen = descriptors(rng, 40)
    px = rng.uniform(0, (200, 150), (40, 2))
    asked = np.concatenate([flipped(rng, seen[rng.integers(0, 40, 25)], 15), descriptors(rng, 8)])
    expected_px = rng.uniform(0, (200, 150), (33, 2))
    expected_px[:20] = px[rng.integers(0, 40, 20)] + rng.normal(0, 3, (20, 2))
    expected_px = expected_px.clip(0, None)
    matches = match_near(expected_px, asked, px, seen, radius_px, max_hamming)
    pairs = set(zip(matches.first.tolist(), matches.second.tolist(), strict=True))
    assert pairs == nearby_by_hand(expected_px, asked, px, seen, radius_px, max_hamming)
    assert len(set(matches.second.tolist())) == len(matches.second)


def test_nearest_within_in_plain_python(rng, monkeypatch):
    seen, px = descriptors(rng, 60), rng.uniform(0, 100, (60, 2))
    expected_px, asked = px[:40] + rng.normal(0, 2, (40, 2)), flipped(rng, seen[:40], 12)
    expected_px[7] = np.nan
    got = match_near(expected_px, asked, px, seen, 8.0)
    monkeypatch.setattr(compiled, "nearest_within", in_python.nearest_within)
    expected = match_near(expected_px, asked, px, seen, 8.0)
    assert len(got.first) > 25
    assert 7 not in got.first
    np.testing.assert_array_equal(got, expected)


def test_a_keypoint_goes_to_the_landmark_whose_descriptor_is_nearest(rng):
    seen = descriptors(rng, 1)
    px = np.array([[50.0, 50.0]])
    asked = np.concatenate([flipped(rng, seen, 20), flipped(rng, seen, 5), flipped(rng, seen, 30)])
    matches = match_near(np.repeat(px, 3, axis=0), asked, px, seen, 10.0)
    assert (matches.first.tolist(), matches.second.tolist()) == ([1], [0])


def test_a_repeated_texture_matches_nothing(rng):
    word = descriptors(rng, 1)
    seen = np.concatenate([flipped(rng, word, 20), flipped(rng, word, 20)])
    px = np.array([[50.0, 50.0], [54.0, 50.0]])
    assert len(match_near(px[:1], word, px, seen, 10.0).first) == 0
    assert len(match_near(px[:1], word, px, seen, 3.0).first) == 1


def test_landmarks_that_lie_nowhere_and_images_without_keypoints_match_nothing(rng):
    px, words = rng.uniform(0, 100, (5, 2)), descriptors(rng, 5)
    none_px, no_words = np.zeros((0, 2)), np.zeros((0, 4), np.uint64)
    assert len(match_near(np.full((5, 2), np.nan), words, px, words, 1e3, 256).first) == 0
    assert len(match_near(px, words, none_px, no_words, 1e3, 256).first) == 0
    assert len(match_near(none_px, no_words, px, words, 1e3, 256).first) == 0


def test_keypoints_straightened_out_of_the_image_are_still_found(rng):
    px = np.array([[-3.0, 40.0], [60.0, -2.0], [100.5, 80.5]])
    words = descriptors(rng, 3)
    expected_px = np.array([[1.0, 40.0], [60.0, 1.0], [99.0, 79.0]])
    np.testing.assert_array_equal(match_near(expected_px, words, px, words, 5.0).second, [0, 1, 2])
