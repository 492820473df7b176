from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.testing import assert_allclose
from sessions.kept_views import pose

from wheelsight.core.estimates import Estimate, Status
from wheelsight.core.geometry import se3
from wheelsight.core.keyframes import KeyframeId
from wheelsight.slam.maps import SeenKeyframe, odometry_edge

T_KEYFRAME_BODY = se3.exp([0.1, -0.2, 0.05, 0.3, 0.1, -0.2])


def seen(number: int, C: np.ndarray) -> SeenKeyframe:
    T_odom_body = pose(number) @ T_KEYFRAME_BODY
    held = KeyframeId(number)
    known = Estimate(float(number), Status.TRACKING, T_odom_body, C, T_map_odom=pose(9))
    return SeenKeyframe.of(held, replace(known, keyframe=held, T_keyframe_body=T_KEYFRAME_BODY))


def test_an_edge_is_the_way_between_and_as_uncertain_as_the_way_made_it() -> None:
    C = 1e-3 * np.eye(6)
    step = np.diag([4e-4, 1e-4, 1e-5, 1e-6, 1e-6, 9e-5])
    Ad = se3.adjoint(pose(3))
    edge = odometry_edge(seen(3, C), seen(4, C + Ad @ step @ Ad.T))
    assert edge is not None
    assert (edge.first, edge.second, edge.is_loop) == (3, 4, False)
    assert_allclose(edge.T_first_second, se3.invert(pose(3)) @ pose(4), atol=1e-12)
    assert_allclose(edge.covariance, step + 1e-6 * np.eye(6), atol=1e-9)


def test_what_is_known_better_than_before_is_no_negative_way() -> None:
    edge = odometry_edge(seen(3, 1e-3 * np.eye(6)), seen(4, 1e-6 * np.eye(6)))
    assert edge is not None
    assert np.linalg.eigvalsh(edge.covariance).min() > 0.99e-6


def test_an_estimate_of_another_keyframe_shows_no_edge() -> None:
    lost = Estimate(4.0, Status.FAILING)
    other = Estimate(4.0, Status.TRACKING, pose(4), np.eye(6), keyframe=KeyframeId(3), T_keyframe_body=np.eye(4))
    for estimate in (None, lost, other):
        after = SeenKeyframe.of(KeyframeId(4), estimate)
        assert after.T_odom_keyframe is None
        assert odometry_edge(seen(3, np.eye(6)), after) is None
        assert odometry_edge(after, seen(5, np.eye(6))) is None
