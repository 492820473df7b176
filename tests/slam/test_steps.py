"""Edges of odometry: what a motion shows the way along the floor, and poses of height and tilt."""

from __future__ import annotations

import numpy as np
import pytest

from wheelsight.core.geometry import se3
from wheelsight.core.keyframes import KeyframeId
from wheelsight.slam.graph import RelativePose, along_floor, step_edge
from wheelsight.slam.solvers import OwnPoseGraph

# The camera looks ahead: its y axis points down.
UP = np.array([0.0, -1.0, 0.0])
ENDS = KeyframeId(0), KeyframeId(1)


def test_the_way_is_the_motions_and_height_and_tilt_are_the_poses() -> None:
    by_poses = se3.exp([0.0, 0.01, 0.3, 0.02, 0.0, -0.01])
    leapt = se3.exp([0.1, 0.0, 0.05, 0.0, 0.2, 0.0]) @ by_poses
    wrong = se3.exp([0.0, 0.4, 0.0, 0.3, 0.0, 0.0])
    edge = along_floor(RelativePose(*ENDS, leapt, 1e-4 * np.eye(6)), (wrong @ by_poses, np.eye(6)), UP)
    off = se3.log(edge.T_first_second @ se3.invert(by_poses))
    assert np.abs(off[[1, 3, 5]]).max() < 0.03  # of height and tilt nothing is taken, but for what turns exchange
    assert np.abs(off[[0, 2, 4]]).max() < 0.06
    np.testing.assert_allclose(np.diag(edge.covariance), [1, 1e-4, 1, 1e-4, 1, 1e-4], rtol=1e-3)
    assert np.linalg.eigvalsh(edge.covariance)[0] > 0


@pytest.mark.parametrize("way", [[0.02, 0.0, 0.3, 0.0, 0.1, 0.0], [0.0, 0.0, -0.2, 0.0, -0.5, 0.0]])
def test_a_motion_in_the_plane_is_taken_whole(way: list[float]) -> None:
    motion = se3.exp(way)
    edge = along_floor(
        RelativePose(*ENDS, se3.exp([0.1, 0, 0, 0, 0.3, 0]) @ motion, np.eye(6)), (motion, np.eye(6)), UP
    )
    np.testing.assert_allclose(edge.T_first_second, motion, atol=1e-9)


@pytest.mark.parametrize("variance", [1e2, 1e9, 1e12, 1e15])
@pytest.mark.parametrize("seed", range(3))
def test_an_edge_stays_definite_where_a_direction_is_hardly_known(seed: int, variance: float) -> None:
    """Rounding of so large a variance made others negative, and the graph refused the edge: it ended the drive."""
    rng = np.random.default_rng(seed)
    T_before, T_now = (se3.exp(rng.normal(0, 1, 6)) for _ in range(2))
    axes = np.linalg.qr(rng.normal(0, 1, (6, 6)))[0]
    C_now = (axes * [variance, 1.0, 1.0, 1.0, 1.0, 1.0]) @ axes.T
    edge = step_edge(ENDS, (T_before, 0.1 * np.eye(6)), (T_now, (C_now + C_now.T) / 2))
    graph = OwnPoseGraph()
    for _ in ENDS:
        graph.add(np.eye(4))
    graph.add_edges([edge])
    assert np.linalg.eigvalsh(edge.covariance)[0] > 0
    variances = np.linalg.eigvalsh(edge.covariance)
    assert variances[4] < 30.0  # all other directions are known as before: rounding of the largest is 1 m² at most
    assert variances[5] < 1.01e6
