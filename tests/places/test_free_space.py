from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from wheelsight.core.calibration_parts import DepthNoise
from wheelsight.core.geometry import se3
from wheelsight.places.verification import intrusion, shown_share
from wheelsight.vision.dense.alignment import Level

NOISE = DepthNoise(0.001, 0.001425, 0.3, 10.0)
SHAPE, INTRINSICS = (60, 80), np.array([65.0, 65.0, 39.5, 29.5])


def level(depth_m: np.ndarray) -> Level:
    return Level(INTRINSICS, depth_m.astype(np.float32), np.full(SHAPE, 128, np.float32))


def wall(distance_m: float) -> np.ndarray:
    return np.full(SHAPE, float(distance_m))


def test_the_same_view_does_not_intrude():
    found = intrusion(level(wall(3)), level(wall(3)), np.eye(4), NOISE)
    assert found.intruding == 0
    assert found.compared == 2 * SHAPE[0] * SHAPE[1]


def test_a_cabinet_where_a_wall_was_seen_intrudes_by_its_share():
    with_cabinet = wall(3)
    with_cabinet[:, 20:50] = 1.5
    found = intrusion(level(wall(3)), level(with_cabinet), np.eye(4), NOISE)
    # From the other side it hides what is behind it, which shows nothing.
    assert found.intruding / found.compared == pytest.approx(30 / (80 + 50), abs=0.02)


def corridor(end_m: float) -> np.ndarray:
    """2 m wide, open above and below, up to a wall that closes it."""
    aside = np.abs((np.arange(SHAPE[1]) - INTRINSICS[2]) / INTRINSICS[0])
    return np.tile(np.minimum(1.0 / np.maximum(aside, 1e-6), end_m), (SHAPE[0], 1))


@pytest.mark.parametrize("person_first", [True, False])
def test_somebody_before_the_camera_stands_free_and_is_left_out(person_first: bool):
    with_person = corridor(6.0)
    with_person[:, 30:55] = 0.9
    first, second = level(with_person), level(corridor(6.0))
    if not person_first:
        first, second = second, first
    found = intrusion(first, second, np.eye(4), NOISE)
    assert found.free == found.intruding > 0.3 * SHAPE[0] * SHAPE[1] * 0.9
    assert found.share < 0.01
    assert found.free_share < 0.5


def test_somebody_who_hides_nearly_all_leaves_nothing_that_speaks_for_a_place():
    with_person = corridor(6.0)
    with_person[:, 4:-4] = 0.7
    assert intrusion(level(corridor(6.0)), level(with_person), np.eye(4), NOISE).free_share > 0.5


@pytest.mark.parametrize("end_m", [2.5, 4.0])
def test_a_wall_that_closes_a_corridor_does_not_stand_free(end_m: float):
    found = intrusion(level(corridor(8.0)), level(corridor(end_m)), np.eye(4), NOISE)
    assert found.intruding > 500
    assert found.free == 0


def test_a_thing_is_no_wall_where_the_other_view_knows_no_depth_beside_it():
    """Beside it nothing was compared, though the same thing goes on there."""
    with_person, far = corridor(6.0), corridor(6.0)
    with_person[:, 30:55] = 0.9
    far[20:30, 25:60] = 0
    found = intrusion(level(far), level(with_person), np.eye(4), NOISE)
    assert found.free == found.intruding > 500


def test_what_hides_something_else_does_not_intrude_when_both_saw_it():
    scene = wall(3)
    scene[:, 20:50] = 1.5
    T = se3.exp([0.2, 0, 0, 0, 0, 0])
    moved = wall(3)
    left, right = (65.0 * (((20 - 39.5) / 65 * 1.5 - 0.2) / 1.5) + 39.5, 65.0 * ((50 - 39.5) / 65 - 0.2 / 1.5) + 39.5)
    moved[:, max(0, round(left)) : round(right)] = 1.5
    assert intrusion(level(scene), level(moved), T, NOISE).share < 0.03


def test_a_pose_inside_the_wall_intrudes():
    T = se3.exp([0.0, 0, 0.8, 0, 0, 0])
    assert intrusion(level(wall(3)), level(wall(3)), T, NOISE).share > 0.4


def test_unknown_depth_shows_nothing():
    found = intrusion(level(wall(0)), level(wall(1)), np.eye(4), NOISE)
    assert found == (0, 0, 0)
    assert found.share == 0


@given(st.floats(-0.5, 0.5), st.floats(-0.3, 0.3), st.integers(0, 1000))
def test_it_does_not_matter_which_view_is_first(x, yaw, seed):
    rng = np.random.default_rng(seed)
    first, second = (level(rng.uniform(1, 4, SHAPE)) for _ in range(2))
    T = se3.exp([x, 0, 0, 0, yaw, 0])
    assert intrusion(first, second, T, NOISE) == intrusion(second, first, se3.invert(T), NOISE)


def test_what_another_view_shows_of_a_view_is_its_share():
    same = shown_share(level(wall(3)), level(wall(3)), np.eye(4), NOISE)
    assert same == 1
    with_cabinet = wall(3)
    with_cabinet[:, 20:50] = 1.5
    assert shown_share(level(wall(3)), level(with_cabinet), np.eye(4), NOISE) == pytest.approx(0.6, abs=0.03)
    # A quarter of the view lies beside that of the other one.
    T = se3.exp([20 / 65 * 3, 0, 0, 0, 0, 0])
    assert shown_share(level(wall(3)), level(wall(3)), T, NOISE) == pytest.approx(0.75, abs=0.02)
    assert shown_share(level(wall(0)), level(wall(3)), np.eye(4), NOISE) == 0
