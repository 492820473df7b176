"""Graphs to test with: a drive in a plane or in space, whose noise is drawn from the covariances that it states."""

from __future__ import annotations

import numpy as np

from wheelsight.core.geometry import se3
from wheelsight.core.keyframes import KeyframeId
from wheelsight.slam.graph import Prior, RelativePose

STEP_SIGMAS = np.array([0.02, 0.01, 0.005, 0.002, 0.002, 0.01])
LOOP_SIGMAS = np.array([0.05, 0.05, 0.05, 0.02, 0.02, 0.02])
ANCHOR = np.diag([1e-8] * 6)


def drive(laps=2, side=8):
    """True poses (N, 4, 4) of rounds on a square, a metre a step, on a floor that is not quite flat."""
    corner = np.array([i % side == side - 1 for i in range(4 * side * laps)])
    ahead = se3.exp([1.0, 0, 0, 0, 0, 0]) @ se3.exp(np.outer(corner, [0, 0, 0, 0, 0, np.pi / 2]))
    T = [np.eye(4)]
    for step in ahead:
        T.append(T[-1] @ step)
    place = np.arange(len(T)) % (4 * side) / (4 * side)
    bumps = [0.1 * np.sin(2 * np.pi * (k + 1) * place) for k in range(3)]
    return np.array(T) @ se3.exp(np.stack([0 * place, 0 * place, *bumps, 0 * place], axis=-1))


def measured(rng, T, first, second, sigmas, is_loop=False):
    C = np.diag(np.square(sigmas))
    T_true = se3.invert(T[first]) @ T[second]
    noise = se3.exp(rng.normal(0, sigmas))
    return RelativePose(KeyframeId(first), KeyframeId(second), noise @ T_true, C, is_loop)


def odometry(rng, T):
    return [measured(rng, T, i, i + 1, STEP_SIGMAS) for i in range(len(T) - 1)]


def true_loops(rng, T, count, least=8, radius=0.5):
    """Relative poses of keyframes that are near each other, and far apart in time."""
    d = np.linalg.norm(T[:, None, :3, 3] - T[None, :, :3, 3], axis=-1)
    i, j = np.nonzero((d < radius) & (np.arange(len(T))[None] - np.arange(len(T))[:, None] > least))
    assert len(i) >= count
    chosen = rng.choice(len(i), count, replace=False)
    return [measured(rng, T, int(i[k]), int(j[k]), LOOP_SIGMAS, is_loop=True) for k in chosen]


def false_loops(rng, T, count, least=8):
    """Relative poses near the identity of keyframes that have nothing to do with each other."""
    found: list[RelativePose] = []
    while len(found) < count:
        i, j = sorted(rng.integers(0, len(T), 2).tolist())
        if j - i > least and np.linalg.norm(T[i, :3, 3] - T[j, :3, 3]) > 3:
            T_false = se3.exp(rng.normal(0, LOOP_SIGMAS))
            C = np.diag(np.square(LOOP_SIGMAS))
            found.append(RelativePose(KeyframeId(i), KeyframeId(j), T_false, C, is_loop=True))
    return found


def false_cluster(rng, T, size, least=8):
    """A stretch taken for another one, far off: relative poses that agree with each other and with the odometry."""
    while True:
        i, j = sorted(rng.integers(0, len(T) - size, 2).tolist())
        if j - i > least + size and np.linalg.norm(T[i, :3, 3] - T[j, :3, 3]) > 3:
            break
    C = np.diag(np.square(LOOP_SIGMAS))
    found: list[RelativePose] = []
    for k in range(size):
        T_false = se3.invert(T[i + k]) @ T[i] @ se3.invert(T[j]) @ T[j + k]
        noise = se3.exp(rng.normal(0, LOOP_SIGMAS))
        found.append(RelativePose(KeyframeId(i + k), KeyframeId(j + k), noise @ T_false, C, is_loop=True))
    return found


def filled(graph, edges, T_start):
    for T in T_start:
        graph.add(T)
    graph.add_prior(Prior(KeyframeId(0), T_start[0], ANCHOR))
    graph.add_edges(edges)
    return graph


def dead_reckoned(T_first, steps):
    T = [T_first]
    for step in steps:
        T.append(T[-1] @ step.T_first_second)
    return np.array(T)
