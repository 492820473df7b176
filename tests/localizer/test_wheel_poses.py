"""WheelPoses: what wheels and gyroscope reported in the last seconds."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose

from wheelsight.core.geometry import se3
from wheelsight.estimation.consistency_check import WheelPoses


def rolled(seconds: float) -> WheelPoses:
    """Straight on at 0.5 m/s, reported fifty times a second; the gyroscope turns at 0.2 rad/s."""
    poses = WheelPoses()
    for k in range(round(50 * seconds) + 1):
        assert poses.add(k / 50, se3.from_plane(0.5 * k / 50, 0.0, 0.0), 0.5 / 50)
        poses.add_yaw_rate(k / 50, 0.2)
    return poses


def test_poses_are_reported_between_readings_and_never_beyond() -> None:
    poses = rolled(2.0)
    between = poses.at(1.013)
    assert between is not None
    assert_allclose(between, se3.from_plane(0.5065, 0.0, 0.0), atol=1e-12)
    assert poses.at(2.01) is None
    assert poses.at(-0.01) is None
    assert poses.way_m == pytest.approx(1.0)


@pytest.mark.parametrize(("seconds", "is_kept"), [(2.0, True), (4.0, False)])
def test_they_are_kept_for_three_seconds(seconds: float, is_kept: bool) -> None:
    assert (rolled(seconds).at(0.5) is not None) == is_kept


def test_a_clock_that_goes_back_begins_again_but_the_way_stays() -> None:
    poses = rolled(2.0)
    assert not poses.add(1.0, se3.from_plane(1.0, 0.0, 0.0), 0.01)
    assert poses.at(0.5) is None
    assert poses.way_m == pytest.approx(1.0)
    poses.forget()
    assert poses.newest is None


def test_the_gyroscope_shows_turns_of_the_time_that_it_heard() -> None:
    poses = rolled(2.0)
    assert poses.turned_between(0.5, 1.25) == pytest.approx(0.15)
    assert poses.turned_between(0.5, 2.05) is not None
    assert poses.turned_between(0.5, 2.15) is None
    assert poses.turned_between(-0.5, 1.0) is None
    poses.add_yaw_rate(np.nan, 9.0)
    poses.add_yaw_rate(1.0, 9.0)
    assert poses.turned_between(0.5, 1.25) == pytest.approx(0.15)
