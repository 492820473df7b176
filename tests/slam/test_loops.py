import numpy as np
import pytest
from graphs import (
    ANCHOR,
    LOOP_SIGMAS,
    dead_reckoned,
    drive,
    false_cluster,
    false_loops,
    filled,
    odometry,
    true_loops,
)

from wheelsight.core.geometry import se3
from wheelsight.core.keyframes import KeyframeId
from wheelsight.slam.graph import Prior, RelativePose
from wheelsight.slam.loop_gate import LoopCloser, chi_squared, clusters_of
from wheelsight.slam.solvers import GtsamPoseGraph, OwnPoseGraph

SOLVERS = [OwnPoseGraph, GtsamPoseGraph]


def rmse_m(T, T_true):
    return float(np.sqrt(np.mean(np.sum((T[:, :3, 3] - T_true[:, :3, 3]) ** 2, axis=1))))


def driven(graph, T, steps, loops):
    """Loops are offered as the drive comes to them."""
    graph.add(T[0])
    graph.add_prior(Prior(KeyframeId(0), T[0], ANCHOR))
    closer = LoopCloser(graph)
    for step in steps:
        graph.add(graph.poses[-1] @ step.T_first_second)
        graph.add_edges([step])
        new = [loop for loop in loops if loop.second == step.second]
        if new:
            closer.offer(new)
    graph.optimise()
    return closer.report()


def among(loops, report):
    kept = {id(loop) for loop in report.kept}
    return sum(id(loop) in kept for loop in loops)


@pytest.mark.parametrize("solver", SOLVERS)
def test_false_loops_are_refused_and_true_ones_kept_as_they_come(solver):
    rng = np.random.default_rng(10)
    T = drive()
    steps, true, false = odometry(rng, T), true_loops(rng, T, 15), false_loops(rng, T, 30)
    graph = solver()
    report = driven(graph, T, steps, [*true, *false])
    assert (among(true, report), among(false, report)) == (15, 0)
    assert len(report.decisions) == len(report.kept) + len(report.refused) == 45
    assert rmse_m(graph.poses, T) < 0.5 * rmse_m(dead_reckoned(T[0], steps), T)


def test_a_false_cluster_that_agrees_with_itself_is_refused_all_the_same(monkeypatch):
    monkeypatch.setattr("wheelsight.slam.loop_gate._REVIEW_AFTER", 4)
    rng = np.random.default_rng(11)
    T = drive()
    steps, true, false = odometry(rng, T), true_loops(rng, T, 12), false_cluster(rng, T, 8)
    graph = GtsamPoseGraph()
    report = driven(graph, T, steps, [*true, *false])
    assert report.reviews >= 1
    assert among(false, report) == 0
    assert among(true, report) == 12


@pytest.mark.parametrize("count", [1, 8])
def test_loops_alone_against_an_honest_odometry_are_not_believed(monkeypatch, count):
    monkeypatch.setattr("wheelsight.slam.loop_gate._REVIEW_AFTER", 1)
    rng = np.random.default_rng(12)
    T = drive()
    steps = odometry(rng, T)
    false = false_cluster(rng, T, count)
    graph = filled(GtsamPoseGraph(), steps, dead_reckoned(T[0], steps))
    report = LoopCloser(graph).offer(false)
    assert not any(one.is_kept for one in report)


@pytest.mark.parametrize("solver", SOLVERS)
def test_loops_refused_for_a_dishonest_odometry_win_in_a_review(monkeypatch, solver):
    """The odometry turns by more than it states, always to one side: the gate refuses what is true."""
    monkeypatch.setattr("wheelsight.slam.loop_gate._REVIEW_AFTER", 5)
    rng = np.random.default_rng(13)
    T = drive()
    drift = se3.exp([0, 0, 0, 0, 0, 0.012])
    steps = [RelativePose(s.first, s.second, drift @ s.T_first_second, s.covariance) for s in odometry(rng, T)]
    true = [loop for loop in true_loops(rng, T, 25) if loop.second - loop.first > 25]
    graph = filled(solver(), steps, dead_reckoned(T[0], steps))
    gated = sum(chi_squared(graph, loop) > 22.5 for loop in true)
    assert gated > len(true) / 2
    before = rmse_m(graph.poses, T)
    closer = LoopCloser(graph)
    closer.offer(true)
    report = closer.report()
    assert report.overturned == 1
    assert among(true, report) > 0.8 * len(true)
    assert rmse_m(graph.poses, T) < 0.5 * before


def test_loops_of_a_drive_that_is_over_are_judged_together():
    rng = np.random.default_rng(14)
    T = drive()
    steps, true, false = odometry(rng, T), true_loops(rng, T, 20), false_loops(rng, T, 40)
    graph = filled(GtsamPoseGraph(), steps, dead_reckoned(T[0], steps))
    report = LoopCloser(graph).offer_all([*true, *false])
    assert (among(true, report) >= 19, among(false, report)) == (True, 0)
    assert all(one.is_kept == (one.chi2 <= one.limit) for one in report.decisions)


def test_the_gate_lets_through_as_many_true_loops_as_it_says():
    """Squared errors of true loops, over many drives, have the mean that chi-square has: their freedom."""
    found = []
    for seed in range(20):
        rng = np.random.default_rng(200 + seed)
        T = drive()
        steps = odometry(rng, T)
        graph = filled(OwnPoseGraph(), steps, dead_reckoned(T[0], steps))
        found += [chi_squared(graph, loop) for loop in true_loops(rng, T, 4)]
    assert 4.5 < np.mean(found) < 7.5


def test_neighbours_that_agree_are_one_cluster():
    rng = np.random.default_rng(15)
    T = drive()
    one, other = false_cluster(rng, T, 5), false_cluster(rng, T, 4)
    lone = RelativePose(one[0].first, one[0].second, se3.exp([5.0, 0, 0, 0, 0, 0]), np.diag(LOOP_SIGMAS**2))
    numbers = clusters_of([*one, *other, lone], T, nearby=3, probability=0.9999)
    assert len(set(numbers[:5])) == len(set(numbers[5:9])) == 1
    assert len(set(numbers)) == 3


def test_a_place_without_a_heading_has_three_freedoms():
    C = np.diag(np.square([1.0, 1, 1, 10, 10, 10]))
    assert RelativePose(KeyframeId(0), KeyframeId(1), np.eye(4), C).freedom == 3
    assert RelativePose(KeyframeId(0), KeyframeId(1), np.eye(4), np.eye(6)).freedom == 6
