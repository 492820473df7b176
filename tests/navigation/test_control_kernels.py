"""Kernels of control against closed forms, scipy and plain numpy."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from navigation.unicycle import CHAIR, NOBODY, centres_of, clearance_m, field_of, room
from numpy.testing import assert_allclose
from scipy import ndimage

from benchmarks.plain_rollouts import plain_costs
from wheelsight.core.geometry import BoolArray
from wheelsight.navigation import Footprint, RobotLimits
from wheelsight.navigation.clearance_kernels import (
    apart_from,
    clearance_at,
    distance_at,
    free_arc,
    moved,
    people_apart,
    toward,
)
from wheelsight.navigation.controllers import MotionState, Rollouts, Situation, cut, noise_of
from wheelsight.navigation.mppi_kernels import RolloutWeights, blend
from wheelsight.navigation.settings import FollowSettings, outline_of

OUTLINE = outline_of(CHAIR)
MARGIN_M = 0.04
WEIGHTS = RolloutWeights(MARGIN_M, MARGIN_M)


def pose_of(x: float, y: float, yaw: float) -> tuple[float, float, float, float]:
    return x, y, float(np.cos(yaw)), float(np.sin(yaw))


def cluttered(seed: int) -> BoolArray:
    cells = room(6.0, 6.0)
    cells |= np.random.default_rng(seed).random(cells.shape) < 0.004
    return cells


def test_distances_are_those_of_scipys_bilinear_interpolation() -> None:
    field, rng = field_of(cluttered(1)), np.random.default_rng(2)
    xy = rng.uniform(0.1, 5.9, (200, 2))
    cells = (xy / 0.05 - 0.5)[:, ::-1]
    expected = ndimage.map_coordinates(field.distance_m.astype(float), cells.T, order=1)
    assert_allclose([distance_at(field, x, y) for x, y in xy], expected, atol=1e-6)
    assert distance_at(field, -1.0, 3.0) == 0.0


@given(seed=st.integers(0, 50), x=st.floats(1, 5), y=st.floats(1, 5), yaw=st.floats(-4, 4))
def test_clearance_is_the_plain_distance_of_cells_but_for_cover_and_grid(
    seed: int, x: float, y: float, yaw: float
) -> None:
    cells = cluttered(seed)
    found = clearance_at(field_of(cells), OUTLINE, pose_of(x, y, yaw), MARGIN_M)
    plain = clearance_m(CHAIR, np.array([x, y, yaw]), centres_of(cells))
    assert plain == 0 or found >= min(plain, 0.5) - 0.04 - 0.03
    # Below the margin points are half a cell apart or nearer, and a cell's distance is off by less than that.
    assert min(found, 0.5) <= max(plain + 0.03, MARGIN_M + 0.03)


@given(seed=st.integers(0, 50), x=st.floats(1, 5), y=st.floats(1, 5), yaw=st.floats(-4, 4))
def test_below_the_margin_clearance_is_that_of_the_nearest_cell_with_its_sign(
    seed: int, x: float, y: float, yaw: float
) -> None:
    """Of several the nearest, and below 0 within: who leaves one must not come nearer to another, nor deeper."""
    cells, (c, s) = cluttered(seed), (np.cos(yaw), np.sin(yaw))
    u, v = ((centres_of(cells) - (x, y)) @ np.array([[c, -s], [s, c]])).T
    along, across = np.maximum(u - 0.8, -0.3 - u), np.abs(v) - 0.3
    plain = float(np.maximum(along, across).min())
    found = clearance_at(field_of(cells), OUTLINE, pose_of(x, y, yaw), MARGIN_M)
    # Beside a corner what is reported may be less than it is.
    is_near = np.hypot(np.maximum(along, 0), np.maximum(across, 0)).min() <= MARGIN_M
    assert found == pytest.approx(plain, abs=1e-5) if is_near else found > 0.7 * MARGIN_M


@given(shape=st.sampled_from([CHAIR, Footprint.circle(0.3), Footprint.of([(-0.3, -0.2), (0.7, 0.0), (-0.3, 0.4)])]))
def test_the_cover_holds_the_outline_and_little_else(shape: Footprint) -> None:
    outline, rng = outline_of(shape), np.random.default_rng(3)
    points = rng.uniform(-1.2, 1.2, (4000, 2))
    away = np.linalg.norm(points[:, None] - outline.cover[:, :2], axis=-1) - outline.cover[:, 2]
    is_held, inside = (away <= 0).any(axis=1), shape.contains(points)
    assert is_held[inside].all()
    assert not is_held[~shape.padded(0.041).contains(points)].any()


def test_arcs_are_exact() -> None:
    x, y, c, s = moved(pose_of(1.0, 2.0, 0.0), np.pi / 2, np.pi / 2)
    assert_allclose((x, y, c, s), (2.0, 3.0, 0.0, 1.0), atol=1e-12)
    assert_allclose(
        moved(pose_of(0, 0, 0.3), -2.0, 0.0), (-2 * np.cos(0.3), -2 * np.sin(0.3), np.cos(0.3), np.sin(0.3))
    )


@given(st.floats(-1, 1), st.floats(-1, 1))
def test_a_speed_falls_by_braking_and_grows_by_acceleration(speed: float, wanted: float) -> None:
    after = toward(speed, wanted, 0.025, 0.05)
    assert min(speed, wanted) - 1e-12 <= after <= max(speed, wanted) + 1e-12
    away = speed * (wanted - speed) >= 0
    assert abs(after - speed) <= (0.025 if away else 0.05) + 1e-12
    assert after * speed >= 0 or abs(after) <= 0.025


def test_people_are_where_they_will_be() -> None:
    pose = pose_of(0.0, 0.0, 0.0)
    person = np.array([[3.0, 0.0, -1.0, 0.0, 0.3]])
    assert people_apart(person, OUTLINE, pose, 0.0) == pytest.approx(1.9)
    assert people_apart(person, OUTLINE, pose, 1.5) == pytest.approx(0.4)
    assert people_apart(NOBODY, OUTLINE, pose, 1.5) == np.inf
    assert apart_from(OUTLINE, pose, 0.2, 0.1) == pytest.approx(-0.2)


def test_an_arc_is_free_as_far_as_a_wall() -> None:
    """The front, 0.8 m ahead, comes within the margin of the wall's cells at 5.975 m."""
    field, start = field_of(room(6.0, 6.0)), pose_of(3.0, 3.0, 0.0)
    steps = free_arc(field, OUTLINE, NOBODY, start, (0.05, 0.0, 0.05, 100), MARGIN_M)
    assert 0.05 * steps == pytest.approx(5.975 - MARGIN_M - 0.8 - 3.0, abs=0.05)
    away = pose_of(5.16, 3.0, 0.0)
    assert free_arc(field, OUTLINE, NOBODY, away, (0.05, 0.0, 0.05, 10), MARGIN_M) == 0
    assert free_arc(field, OUTLINE, NOBODY, away, (-0.05, 0.0, 0.05, 10), MARGIN_M) == 10


@pytest.mark.parametrize("direction", [1, -1])
def test_rollouts_cost_what_plain_numpy_says(direction: int) -> None:
    """In a room without things near, where both look at the same; contacts are compared below."""
    rollouts = Rollouts(OUTLINE, RobotLimits(), 200, FollowSettings())
    path = np.array([[4.0, 5, 0], [6, 5, 0], [6.9, 5.3, 0.3]])[::direction]
    segment = next(piece for piece in cut(path) if piece.direction)
    assert segment.direction == direction
    state = MotionState(path[0] + [0.02, 0.03, 0.1], 0.1 * direction, 0.2)
    given = rollouts.given(Situation(state, segment, 0, field_of(room()), NOBODY, MARGIN_M))
    costs, drawn = rollouts.costs(given)
    plain, least = plain_costs(*given, drawn)
    assert least.min() > WEIGHTS.near_m
    assert_allclose(costs, plain, rtol=1e-6, atol=1e-6)


def test_rollouts_that_touch_are_those_that_come_within_the_margin() -> None:
    cells = room()
    cells[105:, 100] = cells[:88, 100] = True
    rollouts = Rollouts(OUTLINE, RobotLimits(), 600, FollowSettings())
    (segment,) = cut(np.array([[3.0, 5, 0], [8.0, 5, 0]]))
    given = rollouts.given(
        Situation(MotionState(np.array([3.7, 4.7, 0.3]), 0.9, 0.2), segment, 0, field_of(cells), NOBODY, MARGIN_M)
    )
    costs, drawn = rollouts.costs(given)
    _, least = plain_costs(*given, drawn)
    touches = costs > WEIGHTS.contact / 2
    assert 0.1 < touches.mean() < 0.9
    assert not touches[least > MARGIN_M + 0.01].any()
    # Looks are a tenth of a metre apart, so that a corner may graze.
    assert touches[least < MARGIN_M - 0.04].all()


def test_the_mean_is_by_weight() -> None:
    drawn = np.random.default_rng(1).normal(size=(50, 6, 2)).astype(np.float32)
    costs, mean = np.random.default_rng(2).uniform(0, 3, 50), np.empty((6, 2))
    assert blend(costs, drawn, 0.7, mean) == costs.argmin()
    weights = np.exp(-costs / 0.7)
    assert_allclose(mean, (weights[:, None, None] * drawn).sum(axis=0) / weights.sum(), atol=1e-6)


def test_noise_is_standard_and_favours_no_side(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("wheelsight.navigation.controllers._FINE_SHARE", 0.0)
    monkeypatch.setattr("wheelsight.navigation.controllers._LONG_SHARE", 0.0)
    noise = noise_of(4000)
    assert_allclose(noise.mean(axis=0), 0, atol=1e-6)
    at_knots = noise[:, ::7]
    assert at_knots.std() == pytest.approx(1.0, abs=0.02)
    assert_allclose(noise[0], -noise[1])
