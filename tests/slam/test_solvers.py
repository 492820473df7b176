import numpy as np
import pytest
from graphs import ANCHOR, dead_reckoned, drive, false_loops, filled, odometry, true_loops
from hypothesis import given, settings
from hypothesis import strategies as st

from wheelsight.core.errors import ArgumentError, ConfigError
from wheelsight.core.geometry import se3
from wheelsight.core.keyframes import KeyframeId
from wheelsight.core.runtime import needed
from wheelsight.slam import solvers as pose_graph
from wheelsight.slam.graph import Prior, RelativePose, arrays_of, edge_errors, edge_jacobians, inverse_left_jacobian
from wheelsight.slam.solvers import GtsamPoseGraph, OwnPoseGraph, new_pose_graph

SOLVERS = [OwnPoseGraph, GtsamPoseGraph]


def noisy(seed, loops=12, wrong=0):
    rng = np.random.default_rng(seed)
    T = drive()
    steps = odometry(rng, T)
    edges = [*steps, *true_loops(rng, T, loops), *false_loops(rng, T, wrong)]
    return T, edges, dead_reckoned(T[0], steps)


def shifts(T, T_other):
    return np.abs(se3.log(T @ se3.invert(T_other))).max()


@pytest.mark.parametrize("solver", SOLVERS)
def test_two_measurements_of_one_pose_are_weighed_by_their_variances(solver):
    graph = solver()
    a, b = graph.add(np.eye(4)), graph.add(np.eye(4))
    graph.add_prior(Prior(a, np.eye(4), 1e-12 * np.eye(6)))
    ways = ((1.0, 0.04), (2.0, 0.01))
    graph.add_edges([RelativePose(a, b, se3.exp([x, 0, 0, 0, 0, 0]), v * np.eye(6)) for x, v in ways])
    graph.optimise()
    np.testing.assert_allclose(graph.poses[1][:3, 3], [(1 * 0.01 + 2 * 0.04) / 0.05, 0, 0], atol=1e-6)
    np.testing.assert_allclose(graph.marginal(b)[0, 0], 1 / (1 / 0.04 + 1 / 0.01), rtol=1e-6)


@pytest.mark.parametrize("solver", SOLVERS)
def test_the_covariance_of_a_chain_is_that_of_composed_steps(solver):
    rng = np.random.default_rng(1)
    T = drive(laps=1)
    steps = odometry(rng, T)
    graph = filled(solver(), steps, dead_reckoned(T[0], steps))
    graph.optimise()
    expected = ANCHOR.copy()
    for step, T_here in zip(steps, graph.poses[:-1], strict=True):
        Ad = se3.adjoint(T_here)
        expected = expected + Ad @ step.covariance @ Ad.T
    np.testing.assert_allclose(graph.marginal(KeyframeId(len(T) - 1)), expected, rtol=1e-4, atol=1e-9)


@pytest.mark.parametrize("wrong", [0, 10])
def test_both_solvers_give_the_same_poses_costs_and_covariances(wrong):
    _, edges, start = noisy(2, wrong=wrong)
    own, gtsam = (filled(solver(), edges, start) for solver in SOLVERS)
    costs = own.optimise(), gtsam.optimise()
    assert costs[0] == pytest.approx(costs[1], rel=1e-4)
    assert shifts(own.poses, gtsam.poses) < 2e-3
    first, second = KeyframeId(5), KeyframeId(40)
    scale = np.sqrt(np.diag(own.joint(first, second)))
    np.testing.assert_allclose(
        own.joint(first, second) / np.outer(scale, scale),
        gtsam.joint(first, second) / np.outer(scale, scale),
        atol=0.02,
    )


@pytest.mark.parametrize("solver", SOLVERS)
def test_step_by_step_comes_to_the_same_as_all_at_once(solver):
    T, edges, start = noisy(3)
    whole = filled(solver(), edges, start)
    whole.optimise()
    graph = solver()
    graph.add(T[0])
    graph.add_prior(Prior(KeyframeId(0), T[0], ANCHOR))
    steps = [edge for edge in edges if not edge.is_loop]
    for step in steps:
        graph.add(graph.poses[-1] @ step.T_first_second)
        graph.add_edges([step, *(e for e in edges if e.is_loop and e.second == step.second)])
        graph.update()
    assert shifts(graph.poses, whole.poses) < 0.02


@pytest.mark.parametrize("solver", SOLVERS)
def test_a_removed_edge_leaves_no_trace(solver):
    _, edges, start = noisy(4, wrong=5)
    true = edges[:-5]
    graph, without = filled(solver(), edges, start), filled(solver(), true, start)
    graph.update()
    graph.remove_edges(edges[-5:])
    graph.optimise(start)
    without.optimise()
    assert shifts(graph.poses, without.poses) < 1e-6
    assert len(graph.edges) == len(true)


@pytest.mark.parametrize("solver", SOLVERS)
def test_covariances_are_honest(solver):
    """NEES of all poses over many drives: 6 on the average, if errors are as large as stated."""
    nees = []
    for seed in range(12):
        T, edges, start = noisy(100 + seed, loops=8)
        plain = [RelativePose(e.first, e.second, e.T_first_second, e.covariance) for e in edges]
        graph = filled(solver(), plain, start)
        graph.optimise()
        for keyframe in range(8, len(T), 8):
            error = se3.log(graph.poses[keyframe] @ se3.invert(T[keyframe]))
            nees.append(error @ np.linalg.solve(graph.marginal(KeyframeId(keyframe)), error))
    assert 4.8 < np.mean(nees) < 7.2


@pytest.mark.parametrize("solver", SOLVERS)
def test_what_makes_no_graph_is_refused(solver):
    graph = solver()
    a = graph.add(np.eye(4))
    with pytest.raises(ArgumentError, match="no prior"):
        graph.optimise()
    with pytest.raises(ArgumentError, match="no keyframe 7"):
        graph.add_edges([RelativePose(a, KeyframeId(7), np.eye(4), np.eye(6))])
    b = graph.add(np.eye(4))
    with pytest.raises(ArgumentError, match="positive definite"):
        graph.add_edges([RelativePose(a, b, np.eye(4), np.zeros((6, 6)))])
    with pytest.raises(ArgumentError, match="itself"):
        graph.add_edges([RelativePose(a, a, np.eye(4), np.eye(6))])
    with pytest.raises(ArgumentError, match="no such edge"):
        graph.remove_edges([RelativePose(a, b, np.eye(4), np.eye(6))])
    with pytest.raises(ArgumentError, match="rigid"):
        graph.add(2 * np.eye(4))


def test_without_gtsam_our_own_solver_stands_in(monkeypatch):
    assert isinstance(new_pose_graph(), GtsamPoseGraph)
    monkeypatch.setattr(pose_graph, "why_missing", lambda library: f"{library} is missing")
    assert isinstance(new_pose_graph(), OwnPoseGraph)

    def missing(module):
        raise ConfigError(f"{module} is missing")

    monkeypatch.setattr(pose_graph, "needed", missing)
    with pytest.raises(ConfigError, match="gtsam"):
        GtsamPoseGraph()


def test_jacobians_are_those_of_differences():
    rng = np.random.default_rng(5)
    T = se3.exp(rng.normal(0, 1, (2, 6)))
    edge = RelativePose(KeyframeId(0), KeyframeId(1), se3.exp(rng.normal(0, 1, 6)), np.eye(6))
    arrays = arrays_of([edge])
    J = edge_jacobians(T, arrays, edge_errors(T, arrays))[0]
    for keyframe, sign in ((0, -1), (1, 1)):
        for k, h in enumerate(1e-6 * np.eye(6)):
            ahead, back = T.copy(), T.copy()
            ahead[keyframe], back[keyframe] = se3.exp(h) @ T[keyframe], se3.exp(-h) @ T[keyframe]
            slope = (edge_errors(ahead, arrays) - edge_errors(back, arrays))[0] / 2e-6
            np.testing.assert_allclose(sign * J[:, k], slope, atol=1e-7)


@settings(deadline=None, max_examples=50)
@given(st.lists(st.floats(-2, 2), min_size=6, max_size=6), st.sampled_from([1e-6, 1e-3, 0.1, 0.17, 0.18, 0.5, 0.85]))
def test_the_inverse_left_jacobian_undoes_a_perturbation_at_any_angle(values, scale):
    xi = scale * np.array(values)
    J = inverse_left_jacobian(xi)
    for k, h in enumerate(1e-5 * np.eye(6)):
        ahead = se3.log(se3.exp(h) @ se3.exp(xi))
        back = se3.log(se3.exp(-h) @ se3.exp(xi))
        np.testing.assert_allclose(J[:, k], (ahead - back) / 2e-5, atol=1e-6)


def test_where_gtsam_runs_short_of_digits_our_own_factor_shows_covariances(monkeypatch):
    _, edges, start = noisy(6)
    graph, own = filled(GtsamPoseGraph(), edges, start), filled(OwnPoseGraph(), edges, start)

    def ill_posed(*_):
        raise RuntimeError("Indeterminate linear system")

    monkeypatch.setattr(needed("gtsam"), "Marginals", ill_posed)
    ends = KeyframeId(3), KeyframeId(30)
    np.testing.assert_allclose(graph.joint(*ends), own.joint(*ends), rtol=1e-6, atol=1e-12)
    np.testing.assert_allclose(graph.marginal(ends[0]), own.marginal(ends[0]), rtol=1e-6, atol=1e-12)
