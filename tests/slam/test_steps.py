"""Edges of odometry: what a motion tells of the way along the floor, and poses of height and tilt."""

from __future__ import annotations

import numpy as np
import pytest

from wheelsight.geometry import se3
from wheelsight.keyframes import KeyframeId
from wheelsight.slam.graph import RelativePose
from wheelsight.slam.steps import along_floor

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
