"""When a keyframe is made: a new view, or one that shows the same much more finely."""

from __future__ import annotations

import numpy as np
import pytest
from odometry.dense.scenes import Plane, apart, bench, dense, frame_of

from wheelsight.core.estimates import Status
from wheelsight.core.geometry import se3
from wheelsight.vision.dense.tracking import fine_share

WALL = [Plane((0, 0, 1), 4.0, is_painted=True), Plane((0, 1, 0), 0.8, is_painted=True)]


def ahead(way_m: float) -> np.ndarray:
    return np.asarray(se3.from_parts(np.eye(3), [0.0, 0.0, way_m]))


@pytest.mark.parametrize(("way_m", "share"), [(-1.0, 1.0), (0.0, 1.0), (1.9, 1.0), (2.1, 0.0)])
def test_a_reference_shows_finely_what_was_at_most_twice_as_far(way_m: float, share: float) -> None:
    frame = bench().grid(frame_of(WALL[:1], ahead(way_m), 0.0))
    assert fine_share(frame, ahead(way_m), 0.5) == share


def test_without_depth_nothing_is_shown() -> None:
    frame = bench().grid(frame_of([], np.eye(4), 0.0))
    assert fine_share(frame, np.eye(4), 0.5) == 0.0


@pytest.mark.slow
def test_on_the_way_to_a_wall_keyframes_are_made_though_all_stays_in_sight() -> None:
    subject = dense()
    made: list[int] = []
    for k in range(60):
        T = ahead(0.05 * k)
        answer = subject.process(frame_of(WALL, T, k / 15, noise_seed=k))
        made += [k] if len(subject.store) > len(made) else []
        assert answer.status is Status.TRACKING
        assert answer.T_odom_body is not None
        assert apart(T, answer.T_odom_body)[0] < 0.02
    assert 2 <= len(made) <= 6
