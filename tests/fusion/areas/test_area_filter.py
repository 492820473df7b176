"""The hidden Markov filter against sums over all hidden ways, and by what it has to know of forests."""

from __future__ import annotations

from itertools import product

import numpy as np
import pytest
from fusion.areas.loops import answers, box, loop

from wheelsight.core.areas import AreaMap
from wheelsight.estimation import AreaFilter
from wheelsight.estimation.area_rectifier import AreaFilterParameters

ROW = AreaMap((box("a", 0, 0, 4, 2, "y"), box("b", 4, 0, 8, 2, "xy"), box("c", 8, 0, 12, 2, "y")))
SETTINGS = AreaFilterParameters(
    accuracies=(0.8,),
    failing_appearances_m=(3.0,),
    worth=0.5,
    appearance_m=1.0,
    blip=0.1,
    failure_m=20.0,
    recovery_m=30.0,
)


def brute_force(steps, evidences):
    """Belief (2, 4, 3), each frame's place likelihoods, and worth, by summing over all 24ⁿ hidden ways."""
    wrong = np.array([[0, 0.75, 0.25], [0.5, 0, 0.5], [0.25, 0.75, 0]])  # half a neighbour's, half anyone's
    drawn = np.full((2, 4, 3), 1 / 3)
    drawn[0, :3] = 0.8 * np.eye(3) + 0.2 * wrong
    leaves = np.array([[0, 0.5, 0, 0.5], [1 / 3, 0, 1 / 3, 1 / 3], [0, 0.5, 0, 0.5], [1 / 3, 1 / 3, 1 / 3, 0]])
    states = list(product(range(2), range(4), range(3)))
    start = {(m, z, c): (m == 0) * 0.25 * drawn[m, z, c] for m, z, c in states}
    weights = np.array([0.9 * e / e.mean() + 0.1 for e in evidences])

    def transition(one, other, way_m):
        (m, z, c), (n, y, d) = one, other
        fastest = 1 / 20
        jump = np.array([[0, 1], [20 / 30, 10 / 30]])
        level = np.exp(-way_m * fastest) * (m == n) + (1 - np.exp(-way_m * fastest)) * jump[m, n]
        left = 1 - np.exp(-way_m / 10)
        place = (1 - left) * (z == y) + left * leaves[z, y]
        kept = np.exp(-way_m / (1, 3)[n])
        return level * place * (kept * (c == d) + (1 - kept) * drawn[n, y, d])

    final = dict.fromkeys(states, 0.0)
    for way in product(states, repeat=len(steps) + 1):
        p = start[way[0]]
        for one, other, way_m, weight in zip(way, way[1:], steps, weights, strict=False):
            p *= transition(one, other, way_m) * weight[other[2]]
        final[way[-1]] += p
    belief = np.array([final[s] for s in states]).reshape(2, 4, 3)
    idle = 0.0
    for names in product(range(3), repeat=len(steps) + 1):
        p = 1 / 3
        for before, after, way_m, weight in zip(names, names[1:], steps, weights, strict=False):
            kept = np.exp(-way_m / 3)
            p *= (kept * (before == after) + (1 - kept) / 3) * weight[after]
        idle += p
    return belief / belief.sum(), 1 / (1 + idle / belief.sum())


def test_it_is_the_sum_over_all_hidden_ways():
    steps, evidences = (0.7, 2.0), np.array([[0.2, 0.7, 0.1], [0.05, 0.15, 0.8]])
    areas = AreaFilter(ROW, SETTINGS, np.full(4, 0.25))
    for way_m, evidence in zip(steps, evidences, strict=True):
        areas.predict(way_m)
        areas.update(evidence)
    belief, worth = brute_force(steps, evidences)
    np.testing.assert_allclose(areas.belief, belief, atol=1e-12)
    assert areas.worth == pytest.approx(worth)
    assert areas.trust == pytest.approx(worth * belief[0].sum())


def test_likelihoods_are_what_the_frame_changes_of_the_places():
    areas = AreaFilter(ROW, SETTINGS, np.array([0.5, 0.3, 0.1, 0.1]))
    for evidence in ([0.6, 0.3, 0.1], [0.1, 0.8, 0.1]):
        areas.predict(0.5)
        before = areas.places
        likelihoods = areas.update(np.array(evidence))
        np.testing.assert_allclose(before * likelihoods, areas.places, atol=1e-12)
        assert before @ likelihoods == pytest.approx(1)


def test_one_may_agree_on_the_places_and_keep_what_was_known_in_each():
    areas = AreaFilter(ROW, SETTINGS)
    areas.predict(1.0)
    areas.update(np.array([0.1, 0.8, 0.1]))
    before, places = areas.belief, np.array([0.7, 0.1, 0.1, 0.1])
    areas.agree_with(places)
    np.testing.assert_allclose(areas.places, places)
    after = areas.belief
    inside = before.sum(axis=(0, 2)) > 0
    shares = [belief[:, inside] / belief[:, inside].sum(axis=(0, 2), keepdims=True) for belief in (before, after)]
    np.testing.assert_allclose(*shares)


def test_frames_of_one_place_count_as_one_look():
    standing = AreaFilter(ROW, AreaFilterParameters(blip=0.0))
    standing.predict(3.0)
    first = standing.update(np.array([0.05, 0.9, 0.05]))
    for _ in range(50):
        standing.predict(0.0)
        last = standing.update(np.array([0.05, 0.9, 0.05]))
    assert first[1] > 1.5
    np.testing.assert_allclose(last, 1, atol=1e-6)


def through(areas: AreaFilter, named, way_m=0.2):
    """Drives south to east of the loop, 40 frames an area, with what is known of the place."""
    for t, probabilities in enumerate(answers(named, 8)):
        areas.predict(way_m)
        places = np.full(9, 1e-4)
        places[t // 40] = 1
        areas.agree_with(places / places.sum())
        areas.update(probabilities)
    return areas


TRUE_NAMES = np.repeat([0, 1, 2, 3], 40)


def test_a_forest_that_is_right_is_trusted():
    assert through(AreaFilter(loop()), TRUE_NAMES).trust > 0.98


@pytest.mark.parametrize("shift", [2, 3, 4, 6])
def test_a_forest_that_names_other_areas_is_worth_nothing(shift):
    areas = through(AreaFilter(loop()), (TRUE_NAMES + shift) % 8)
    assert areas.worth < 0.05
    assert areas.trust < 0.05


def test_a_forest_whose_answers_have_nothing_to_do_with_the_area_is_worth_nothing(rng):
    named = np.repeat(rng.integers(0, 8, 32), 5)
    assert through(AreaFilter(loop()), named).worth < 0.05


def test_a_forest_may_fail_for_a_while_and_was_worth_something_all_the_same():
    named = TRUE_NAMES.copy()
    named[60:100] = 6
    failing = through(AreaFilter(loop()), named[:100], 0.4)
    assert failing.trust < 0.1 < failing.worth
    assert through(AreaFilter(loop()), named, 0.4).trust > 0.8


def test_a_single_area_says_nothing():
    areas = AreaFilter(AreaMap((box("all", 0, 0, 4, 4, "xy"),)))
    areas.predict(1.0)
    np.testing.assert_allclose(areas.update(np.array([1.0]))[0], 1)
    assert areas.worth == pytest.approx(AreaFilterParameters().worth)
