from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from wheelsight.core.errors import EvaluationError
from wheelsight.core.geometry import se3
from wheelsight.core.trajectory import Trajectory, read_tum
from wheelsight.evaluation import sequence_statistics


def test_of_a_circle_at_constant_speed() -> None:
    """Radius 2 m at 0.5 rad/s: 1 m/s along the arc; in one second the chord is 4 sin(0.25) m."""
    stamps_s = np.arange(0, 10.005, 0.01)
    T = se3.exp(stamps_s[:, None] * np.array([1.0, 0, 0, 0, 0, 0.5]))
    s = sequence_statistics(Trajectory(stamps_s, T))
    assert s.duration_s == pytest.approx(10.0)
    assert s.posed_duration_s == pytest.approx(10.01)
    assert s.length_m == pytest.approx(10.0, rel=1e-5)
    assert s.mean_speed_m_per_s == pytest.approx(4 * np.sin(0.25))
    assert s.mean_angular_speed_rad_per_s == pytest.approx(0.5)
    assert s.windowed_length_m == pytest.approx(9 * 4 * np.sin(0.25))
    np.testing.assert_allclose(s.extent_m, np.ptp(T[:, :3, 3], axis=0))


def test_windows_see_through_shaking(rng: np.random.Generator) -> None:
    stamps_s = np.arange(0, 20, 0.01)
    positions = stamps_s[:, None] * [0.3, 0, 0] + rng.normal(0, 0.002, (len(stamps_s), 3))
    s = sequence_statistics(Trajectory(stamps_s, se3.from_parts(np.eye(3), positions)))
    assert s.length_m > 1.5 * 6.0
    assert s.mean_speed_m_per_s == pytest.approx(0.3, abs=1e-3)


def test_a_short_trajectory_is_one_window() -> None:
    for n in (2, 5):
        stamps_s = 1.3e9 + np.arange(float(n)) * 0.033
        s = sequence_statistics(Trajectory(stamps_s, se3.from_parts(np.eye(3), np.arange(n)[:, None] * [0.1, 0, 0])))
        assert s.window_s == s.duration_s
        assert s.length_m == pytest.approx(0.1 * (n - 1))
        assert s.windowed_length_m == pytest.approx(s.length_m)
        assert s.mean_speed_m_per_s == pytest.approx(s.length_m / s.duration_s)


def test_poses_farther_apart_than_the_window_still_have_a_speed() -> None:
    T = se3.from_parts(np.eye(3), np.arange(4)[:, None] * [10.0, 0, 0])
    assert sequence_statistics(Trajectory(np.arange(4.0) * 5.0, T)).mean_speed_m_per_s == pytest.approx(2.0)


@pytest.mark.parametrize("n", [0, 1])
def test_a_motion_needs_two_poses(n: int) -> None:
    with pytest.raises(EvaluationError, match=f"the trajectory has {n}"):
        sequence_statistics(Trajectory(np.arange(float(n)), np.tile(np.eye(4), (n, 1, 1))))


@pytest.mark.data
def test_gives_table_2_of_zhang(data_folder: Path) -> None:
    s = sequence_statistics(read_tum(data_folder / "trajectories/tum_ground_truth/freiburg1_desk.txt"))
    assert round(s.duration_s, 2) == 23.40
    assert round(s.posed_duration_s, 2) == 23.35
    assert round(s.mean_speed_m_per_s, 3) == 0.413
    assert round(np.degrees(s.mean_angular_speed_rad_per_s), 3) == 23.327
    assert np.round(s.extent_m, 2).tolist() == [2.42, 1.34, 0.66]
    assert s.windowed_length_m == pytest.approx(9.263, abs=0.004)


@pytest.mark.data
def test_zhangs_length_is_that_of_windows_that_overlap(data_folder: Path) -> None:
    truth = read_tum(data_folder / "trajectories/tum_ground_truth/freiburg1_desk.txt")
    stamps_s, positions_m = truth.stamps_s, truth.positions_m
    end = np.array([int(np.abs(stamps_s - later_s).argmin()) for later_s in stamps_s + 1.0])
    whole = stamps_s + 1.0 <= stamps_s[-1] + 1e-6
    moved_m = np.linalg.norm(positions_m[end] - positions_m, axis=1)
    length_m = moved_m[whole].sum() / np.mean((end - np.arange(len(end)))[whole])
    assert round(float(length_m), 3) == 9.263
