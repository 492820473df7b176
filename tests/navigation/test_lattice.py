"""Arcs, curves and the search over places and headings: closed forms, and compiled against plain Python."""

from __future__ import annotations

from dataclasses import replace
from types import ModuleType, SimpleNamespace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from navigation.floors import CHAIR, costmap_of, room
from odometry.plain_kernels import plain

from wheelsight.core.geometry import se2
from wheelsight.navigation import PlannerSettings, cost_to_go
from wheelsight.navigation import planner_kernels as drive
from wheelsight.navigation import planner_kernels as lattice
from wheelsight.navigation.path_smoothing import Drivable

SETTINGS = PlannerSettings(margin_m=0.05)
_ROOM = Drivable.of(costmap_of(room(4, 5)), CHAIR, SETTINGS)
# A coarse search, which ends soon without a compiler, too.
MOST_STATES = 3000
ROOM = replace(_ROOM, rules=_ROOM.rules._replace(headings=24, place_m=0.25, stride_m=0.375))
YAWS = st.floats(-3, 3)


@given(st.floats(-1, 1), st.floats(-2, 2), YAWS)
def test_an_arc_is_the_exponential_of_its_tangent(way_m: float, turn: float, yaw: float) -> None:
    poses = ROOM.arc(np.array([1.0, 2.0, yaw, 1.0]), way_m, turn)
    end = se2.from_parts(1.0, 2.0, yaw) @ se2.exp([way_m, 0.0, turn])
    np.testing.assert_allclose(se2.from_parts(*poses[-1, :3]), end, atol=1e-9)
    corners = CHAIR.padded(SETTINGS.margin_m).at(poses[:, :3])
    assert np.linalg.norm(np.diff(corners, axis=0), axis=-1).max(initial=0) <= ROOM.rules.step_m + 1e-9
    if way_m != 0 and len(poses) > 1:
        assert (poses[1:, 3] == np.sign(way_m)).all()


@given(st.integers(0, drive.WAYS - 1), st.floats(-3, 3), st.floats(-3, 3), YAWS)
def test_a_way_ends_where_it_is_to_end(way: int, x: float, y: float, yaw: float) -> None:
    poses = ROOM.way(np.array([0.0, 0.0, 0.4, 1.0]), np.array([x, y, yaw]), way)
    if not len(poses):
        assert way >= drive.CURVE
        return
    np.testing.assert_allclose(se2.from_parts(*poses[-1, :3]), se2.from_parts(x, y, yaw), atol=1e-6)
    corners = CHAIR.padded(SETTINGS.margin_m).at(poses[:, :3])
    assert np.linalg.norm(np.diff(corners, axis=0), axis=-1).max(initial=0) <= ROOM.rules.step_m + 1e-9


def test_curves_keep_their_radius() -> None:
    pose = np.array([0.0, 0.0, 0.0, 1.0])
    curve = ROOM.way(pose, np.array([1.0, 1.0, np.pi / 2]), drive.CURVE)
    bends = np.abs(np.diff(curve[:, 2])) / np.hypot(*np.diff(curve[:, :2], axis=0).T)
    assert 1 / ROOM.rules.radius_m > bends.max() > 1
    assert not len(ROOM.way(pose, np.array([0.2, 0.2, np.pi / 2]), drive.CURVE))
    assert not len(ROOM.way(pose, np.array([-1.0, 0.0, 0.0]), drive.CURVE))
    assert (ROOM.way(pose, np.array([-1.0, 0.2, 0.0]), drive.CURVE_BACK)[1:, 3] == -1).all()


def test_costs_are_those_of_way_turn_and_changes_of_direction() -> None:
    made = Drivable.of(costmap_of(np.zeros((200, 200), bool)), CHAIR, PlannerSettings())
    pose, rules = np.array([5.0, 5.0, 0.3, 1.0]), made.rules
    assert made.cost(made.arc(pose, 2.0, 0.0)) == pytest.approx(2.0)
    assert made.cost(made.arc(pose, 0.0, -1.5)) == pytest.approx(1.5 * rules.turn_m)
    assert made.cost(made.arc(pose, 1.0, 0.5)) == pytest.approx(1.0 + 0.5 * rules.bend_m, rel=1e-3)
    assert made.cost(made.arc(pose, -1.0, 0.0)) == pytest.approx(rules.backward + rules.switch_m)
    assert made.cost(made.arc(pose, 6.0, 0.0)) == np.inf


def searched(kernels: ModuleType | SimpleNamespace, start: np.ndarray, goal: np.ndarray) -> tuple[int, int, np.ndarray]:
    most = MOST_STATES
    tree = lattice.SearchTree(
        np.empty((most, 4)),
        np.empty(most),
        np.empty((most, 2), np.int32),
        np.full(8192, -1, np.int32),
        np.empty(most, np.uint8),
        np.empty(most, np.int64),
    )
    row, column = ROOM.costmap.cells_at(goal[:2]).tolist()
    known = cost_to_go(ROOM.cells.metre_cost, 0.05, (row, column))
    how, last, count = kernels.search(ROOM.cells, ROOM.shape, ROOM.rules, known, start, goal, tree)
    out = np.empty((4096, 4))
    return how, count, out[: kernels.way_to(ROOM.rules, tree, last, goal, out)].copy()


def test_compiled_and_plain_searches_find_the_same() -> None:
    """Into a corner, from where the chair does not turn to it in one go."""
    start, goal = np.array([1.2, 1.2, 2.0]), np.array([4.0, 3.4, 0.1])
    how, count, way = searched(lattice, start, goal)
    plain_how, plain_count, plain_way = searched(plain(lattice), start, goal)
    assert (how, count) == (plain_how, plain_count)
    assert count > 50
    assert how == lattice.FOUND
    np.testing.assert_allclose(way, plain_way, atol=1e-9)
    np.testing.assert_allclose(way[-1, :2], goal[:2], atol=1e-9)
    assert ROOM.is_free(way[:, :3]).all()
