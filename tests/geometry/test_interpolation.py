"""Poses between stamps, against scipy's Slerp and the single-pair interpolation."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation, Slerp

from wheelsight.core.geometry import interpolate_at, se3


@pytest.fixture
def stamps_s(rng: np.random.Generator) -> np.ndarray:
    return np.cumsum(rng.uniform(0.01, 0.2, 20))


@pytest.fixture
def T_map_body(rng: np.random.Generator) -> np.ndarray:
    return se3.exp(rng.normal(scale=0.5, size=(20, 6)))


def test_rotation_is_scipys_slerp(rng: np.random.Generator, stamps_s: np.ndarray, T_map_body: np.ndarray) -> None:
    wanted_s = rng.uniform(stamps_s[0], stamps_s[-1], 200)
    expected = Slerp(stamps_s, Rotation.from_matrix(T_map_body[:, :3, :3]))(wanted_s).as_matrix()
    found = interpolate_at(stamps_s, T_map_body, wanted_s)
    np.testing.assert_allclose(found[:, :3, :3], expected, atol=1e-12)


def test_each_answer_lies_between_its_neighbours(stamps_s: np.ndarray, T_map_body: np.ndarray) -> None:
    wanted_s = 0.75 * stamps_s[:-1] + 0.25 * stamps_s[1:]
    expected = se3.interpolate(T_map_body[:-1], T_map_body[1:], np.full(19, 0.25))
    np.testing.assert_allclose(interpolate_at(stamps_s, T_map_body, wanted_s), expected, atol=1e-12)


def test_a_steady_motion_is_exact(rng: np.random.Generator, stamps_s: np.ndarray) -> None:
    xi = rng.normal(scale=0.3, size=6)
    wanted_s = rng.uniform(stamps_s[0], stamps_s[-1], 50)
    found = interpolate_at(stamps_s, se3.exp(stamps_s[:, None] * xi), wanted_s)
    np.testing.assert_allclose(found, se3.exp(wanted_s[:, None] * xi), atol=1e-12)


def test_known_stamps_give_known_poses_bit_for_bit(stamps_s: np.ndarray, T_map_body: np.ndarray) -> None:
    np.testing.assert_array_equal(interpolate_at(stamps_s, T_map_body, stamps_s, max_gap_s=0.0), T_map_body)


def test_outside_and_within_long_gaps_there_is_no_pose() -> None:
    stamps_s = [0.0, 0.1, 1.0, 1.1]
    T = se3.exp(np.arange(24).reshape(4, 6) / 50)
    wanted_s = [-0.01, 0.05, 0.1, 0.5, 1.0, 1.05, 1.11, np.nan]
    known = ~np.isnan(interpolate_at(stamps_s, T, wanted_s, max_gap_s=0.2)).any(axis=(1, 2))
    assert known.tolist() == [False, True, True, False, True, True, False, False]
    assert np.isfinite(interpolate_at(stamps_s, T, [0.5])).all()


def test_order_of_the_wanted_stamps_is_free(
    rng: np.random.Generator, stamps_s: np.ndarray, T_map_body: np.ndarray
) -> None:
    wanted_s = rng.uniform(stamps_s[0] - 0.1, stamps_s[-1] + 0.1, 50)
    found = interpolate_at(stamps_s, T_map_body, wanted_s)
    order = np.argsort(wanted_s)
    np.testing.assert_array_equal(interpolate_at(stamps_s, T_map_body, wanted_s[order]), found[order])


def test_one_pose_holds_at_its_stamp_only() -> None:
    found = interpolate_at([1.0], np.eye(4)[None], [0.9, 1.0, 1.1])
    np.testing.assert_array_equal(found[1], np.eye(4))
    assert np.isnan(found[[0, 2]]).all()


def test_no_poses_and_no_wishes() -> None:
    assert np.isnan(interpolate_at([], np.zeros((0, 4, 4)), [1.0])).all()
    assert interpolate_at([1.0], np.eye(4)[None], []).shape == (0, 4, 4)
    assert interpolate_at([1.0], np.eye(4)[None], 1.0).shape == (1, 4, 4)
