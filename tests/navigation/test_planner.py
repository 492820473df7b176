"""Plans: closed forms, and every pose of a plan against cells by clipping in plain Python."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from navigation.floors import CHAIR, costmap_of, room, room_with_door, static_of
from navigation.plain_polygons import cells_under
from pydantic import ValidationError

from wheelsight.navigation import (
    CellState,
    Costmap,
    Footprint,
    Plan,
    PlanFailure,
    Planner,
    PlannerSettings,
    PlanReason,
    RobotLimits,
    StaticLayer,
)

MARGIN_M, WANTED_M = PlannerSettings().margin_m, PlannerSettings().wanted_margin_m


def planned(costmap: Costmap, start: Any, goal: Any, **changes: Any) -> Plan:
    plan = Planner(CHAIR, PlannerSettings(**changes)).plan(costmap, start, goal)
    assert isinstance(plan, Plan), plan
    check(plan, costmap, start)
    return plan


def failed(costmap: Costmap, start: Any, goal: Any, **changes: Any) -> PlanReason:
    failure = Planner(CHAIR, PlannerSettings(**changes)).plan(costmap, start, goal)
    assert isinstance(failure, PlanFailure)
    assert not failure
    assert failure.detail
    return failure.reason


def check(plan: Plan, costmap: Costmap, start: Any) -> None:
    """What every plan of a start that is free promises."""
    outline = CHAIR.padded(MARGIN_M)
    np.testing.assert_allclose(plan.poses[0, :2], start[:2], atol=1e-9)
    np.testing.assert_allclose(plan.poses[-1], plan.goal, atol=1e-9)
    for pose in plan.poses:
        assert cells_under(costmap.is_lethal, costmap.resolution_m, costmap.origin, outline.corners, pose) == 0
    corners = outline.at(plan.poses)
    assert np.linalg.norm(np.diff(corners, axis=0), axis=-1).max(initial=0) <= 2 * MARGIN_M + 1e-9
    steps = np.diff(plan.poses[:, :2], axis=0)
    lengths = np.hypot(*steps.T)
    assert plan.length_m == pytest.approx(lengths.sum())
    # Two driven wheels go along their heading: forward, or backward where the plan says so.
    turn = np.remainder(np.diff(plan.poses[:, 2]) + np.pi, 2 * np.pi) - np.pi
    heading = plan.poses[:-1, 2] + turn / 2
    along = steps[:, 0] * np.cos(heading) + steps[:, 1] * np.sin(heading)
    goes = lengths > 1e-6
    np.testing.assert_allclose(along[goes], (plan.directions[1:] * lengths)[goes], rtol=0.02)
    assert plan.least_clearance_m >= MARGIN_M - 1e-6


def test_on_a_free_floor_it_turns_and_goes_straight() -> None:
    start, goal = (2.02, 3.03, 2.0), (8.51, 6.07, -1.0)
    plan = planned(costmap_of(room(10, 10)), start, goal)
    assert plan.length_m == pytest.approx(math.hypot(6.49, 3.04), abs=0.05)
    assert plan.states == 0
    assert plan.goal_change == ""
    np.testing.assert_allclose(plan.goal, goal)
    assert (plan.directions == 1).all()
    # It turns the shorter way round: 2 rad to 0.44, and on to -1.
    turned = np.abs(np.remainder(np.diff(plan.poses[:, 2]) + np.pi, 2 * np.pi) - np.pi).sum()
    assert turned == pytest.approx(2.0 + 1.0, abs=0.3)


def test_a_goal_of_two_numbers_is_reached_without_a_turn_there() -> None:
    plan = planned(costmap_of(room(10, 10)), (2, 3, 0), (8, 3.1))
    assert plan.poses[-1, 2] == pytest.approx(math.atan2(0.1, 6.0), abs=1e-6)


def test_where_it_stands_already_it_stays() -> None:
    plan = planned(costmap_of(room(6, 6)), (3, 3, 1), (3, 3, 1))
    assert plan.length_m == 0
    assert planned(costmap_of(room(6, 6)), (3, 3, 1), (3, 3)).length_m == 0


def test_it_goes_around_a_u_by_the_shorter_way() -> None:
    """From within a U, whose mouth is behind the robot, to the other side of its bottom."""
    cells = room(12, 12)
    cells[60:64, 80:160] = cells[170:174, 80:160] = True
    cells[60:174, 156:160] = True
    plan = planned(costmap_of(cells), (5.5, 5.0, 0.0), (9.5, 5.0, 0.0))
    # A point's way, past two corners of the lower wall and one behind; a chair's is not much longer.
    corners = np.array([[5.5, 5.0], [4.0, 3.2], [4.0, 3.0], [8.0, 3.0], [9.5, 5.0]])
    shortest_m = float(np.hypot(*np.diff(corners, axis=0).T).sum())
    assert shortest_m < plan.length_m < 1.25 * shortest_m
    assert plan.poses[:, 1].min() < 3.0
    assert plan.poses[:, 1].max() < 8.5


@pytest.mark.parametrize("resolution_m", [0.02, 0.05])
def test_a_door_ten_centimetres_wider_is_passed(resolution_m: float) -> None:
    plan = planned(costmap_of(room_with_door(0.7, resolution_m), resolution_m), (1.8, 1.5, 0.3), (4.2, 4.6, 2.0))
    in_door = np.abs(plan.poses[:, 1] - 3.05) < 0.2
    assert np.abs(plan.poses[in_door, 0] - 3.0).max() < 0.05
    assert plan.least_clearance_m <= 0.05 + 1e-6


def test_a_door_two_centimetres_narrower_is_not() -> None:
    assert failed(costmap_of(room_with_door(0.58), 0.02), (1.8, 1.5, 0.3), (4.2, 4.6, 2.0)) == PlanReason.UNREACHABLE


def test_a_door_that_only_the_circle_passes_is_not_passed() -> None:
    """A corridor like a Z: wide enough for the axle's circle, too narrow for the chair's length at its corners."""
    cells = np.ones((120, 120), bool)
    cells[5:50, 5:40] = cells[70:115, 80:115] = False
    cells[30:44, 5:67] = cells[30:90, 53:67] = cells[76:90, 53:115] = False
    assert failed(costmap_of(cells), (1.0, 1.0, 0.0), (4.9, 4.9, 0.0)) == PlanReason.UNREACHABLE
    small = Planner(Footprint.circle(0.3))
    assert isinstance(small.plan(costmap_of(cells), (1.0, 1.0, 0.0), (4.9, 4.9, 0.0)), Plan)


def test_out_of_a_dead_end_it_drives_backward() -> None:
    """A corridor 0.9 m wide, closed ahead, in which nothing of 1.1 m turns."""
    cells = np.ones((120, 160), bool)
    cells[51:69, 5:80] = False
    cells[10:110, 80:155] = False
    plan = planned(costmap_of(cells), (1.3, 3.0, np.pi), (6.0, 3.5, 0.0))
    backward = plan.directions < 0
    assert backward.any()
    inside = plan.poses[:, 0] < 3.4
    assert backward[1:][inside[1:]].all()
    assert np.abs(np.remainder(plan.poses[inside, 2], 2 * np.pi) - np.pi).max() < 0.2
    # Into it, too, where it is to stand with its back to the wall.
    there = planned(costmap_of(cells), (6.0, 3.5, np.pi), (1.0, 3.0, 0.0))
    assert (there.directions < 0).any()


def test_it_turns_in_place_only_where_it_turns_freely() -> None:
    """In a corridor 1.2 m wide, with a bay 2 m wide: it turns round, and there."""
    cells = np.ones((100, 240), bool)
    cells[38:62, 5:235] = False
    cells[28:72, 100:140] = False
    plan = planned(costmap_of(cells), (1.5, 2.5, np.pi), (10.5, 2.5, 0.0))
    stands = np.hypot(*np.diff(plan.poses[:, :2], axis=0).T) < 1e-9
    turns = np.abs(np.remainder(np.diff(plan.poses[:, 2]) + np.pi, 2 * np.pi) - np.pi)
    far = (plan.poses[1:, 0] < 4.0) | (plan.poses[1:, 0] > 8.0)
    assert turns[far & stands].sum() < 0.3
    assert turns.sum() > 3.0


def test_a_goal_in_an_obstacle_goes_to_the_nearest_free_pose_and_says_so() -> None:
    costmap = costmap_of(room(8, 8))
    plan = planned(costmap, (2, 2, 0), (7.3, 4.0, 0.0))
    assert "does not fit" in plan.goal_change
    assert plan.goal[0] == pytest.approx(7.95 - 0.8 - WANTED_M, abs=0.05)
    assert plan.goal[1] == pytest.approx(4.0, abs=1e-9)
    assert np.hypot(*(plan.goal[:2] - [7.3, 4.0])) <= 0.5
    assert failed(costmap, (2, 2, 0), (7.3, 4.0, 0.0), goal_tolerance_m=0.05) == PlanReason.GOAL_OCCUPIED
    assert failed(costmap, (2, 2, 0), (7.999, 4.0, 0.0)) == PlanReason.GOAL_OCCUPIED


def test_a_goal_does_not_move_to_the_other_side_of_a_wall() -> None:
    """It is nearer to what lies behind, but only this side can be reached."""
    cells = room(6, 4)
    cells[60:63] = True
    plan = planned(costmap_of(cells), (2, 1.0, 0), (2, 3.12, 0.0), goal_tolerance_m=1.0)
    assert plan.goal[1] < 3.0
    beyond = planned(costmap_of(cells), (2, 5.0, 0), (2, 3.03, 0.0), goal_tolerance_m=1.0)
    assert beyond.goal[1] > 3.15


def test_what_cannot_be_is_reported_by_its_reason() -> None:
    cells = room(8, 8)
    cells[80:83] = True
    state = np.where(cells, CellState.OCCUPIED, CellState.FREE).astype(np.uint8)
    state[10:60, 100:150] = CellState.UNKNOWN
    costmap = Costmap.of(StaticLayer(state, np.full(state.shape, np.inf, np.float32), 0.05, (0.0, 0.0)), CHAIR)
    start = (2.0, 2.0, 0.0)
    assert failed(costmap, start, (2.0, 6.0, 0.0)) == PlanReason.UNREACHABLE
    assert failed(costmap, start, (20.0, 2.0, 0.0)) == PlanReason.GOAL_OUTSIDE
    assert failed(costmap, start, (2.0, -0.1, 0.0)) == PlanReason.GOAL_OUTSIDE
    assert failed(costmap, start, (6.2, 1.7, 0.0)) == PlanReason.GOAL_UNKNOWN
    assert failed(costmap, (-1.0, 2.0, 0.0), start) == PlanReason.START_OUTSIDE
    assert failed(costmap, (6.0, 4.05, 0.0), start) == PlanReason.START_OCCUPIED
    for wrong in ((np.nan, 2.0, 0.0), (2.0, np.inf, 0.0), (2.0, 2.0, np.nan), (2.0,), (1.0, 2.0, 3.0, 4.0), ()):
        assert failed(costmap, start, wrong) == PlanReason.INVALID
        assert failed(costmap, wrong, start) == PlanReason.INVALID


def test_a_search_that_takes_too_long_gives_up(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("wheelsight.navigation.planner._MOST_STATES", 1000)
    cells = room_with_door(0.7)
    assert failed(costmap_of(cells, 0.02), (1.8, 1.5, 0.3), (4.2, 4.6, 2.0)) == PlanReason.GAVE_UP


def test_where_the_search_gives_up_a_straight_way_that_is_tight_is_taken(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("wheelsight.navigation.planner._MOST_STATES", 1000)
    monkeypatch.setattr("wheelsight.navigation.path_smoothing._CONNECT_M", 0.0)
    """Through a corridor 0.7 m wide, in which the wanted clearance cannot be kept."""
    cells = np.ones((100, 200), bool)
    cells[43:57, 5:195] = False
    costmap, start, goal = costmap_of(cells), (1.0, 2.5, 0.0), (8.0, 2.5, 0.0)
    plan = planned(costmap, start, goal)
    assert plan.states == 0
    assert plan.length_m == pytest.approx(7.0, abs=0.05)


@pytest.mark.parametrize("start", [(1.0, 0.33, 0.0), (1.0, 0.345, 0.1), (7.2, 4.0, 0.0), (0.36, 4.0, 0.5)])
def test_a_start_too_near_to_a_wall_gets_out_first(start: tuple[float, float, float]) -> None:
    """Never nearer to the wall than it stands, and free from then on."""
    costmap = costmap_of(room(8, 8))
    plan = Planner(CHAIR).plan(costmap, start, (4.0, 4.0, 0.0))
    assert isinstance(plan, Plan)
    np.testing.assert_allclose(plan.poses[0], start, atol=1e-9)

    def under(outline: Footprint) -> np.ndarray:
        corners = outline.corners
        return np.array([cells_under(costmap.is_lethal, 0.05, (0.0, 0.0), corners, pose) for pose in plan.poses])

    padded = under(CHAIR.padded(MARGIN_M))
    assert padded[0] > 0
    for depth_m in (0.0, 0.03, 0.05):
        inner = under(CHAIR.padded(-depth_m))
        assert inner[0] > 0 or not inner.any()
    free_from = int(np.flatnonzero(padded)[-1]) + 1
    assert not padded[free_from:].any()
    steps = np.hypot(*np.diff(plan.poses[: free_from + 1, :2], axis=0).T)
    assert steps.sum() <= 1.2 + 1e-6


@pytest.mark.parametrize(
    ("deep", "gap_m", "start", "clear_m"),
    [(5, 0.5, (3.0, 1.32, 0.0), 0.02), (3, 0.25, (3.0, 1.335, 0.05), 0.02), (8, 0.5, (3.0, 1.334, -0.03), 0.01)],
)
def test_a_start_beside_a_wall_between_two_things_gets_out(
    deep: int, gap_m: float, start: tuple[float, ...], clear_m: float
) -> None:
    """As a car parked too near to the kerb: of the first no arc alone comes free, and none is where a step may turn."""
    cells = np.zeros((80, 120), bool)
    cells[:20] = True
    for edge_m in (3.8 + gap_m, 2.0 - gap_m):
        column = round(edge_m / 0.05)
        cells[20 : 20 + deep, column : column + 14] = True
    plan = Planner(CHAIR).plan(costmap_of(cells), start, (3.0, 2.5, 0.0))
    assert isinstance(plan, Plan)
    assert not plan.goal_change

    def under(margin_m: float) -> np.ndarray:
        corners = CHAIR.padded(margin_m).corners
        return np.array([cells_under(cells, 0.05, (0.0, 0.0), corners, pose) for pose in plan.poses])

    padded = under(MARGIN_M)
    assert padded[0] > 0
    # Controllers reckon from cells' middles less half a side: corners are up to 1 cm nearer.
    assert not under(clear_m - 0.01 - 0.011).any()
    out = int(np.flatnonzero(padded)[-1]) + 1
    steps = np.hypot(*np.diff(plan.poses[: out + 1, :2], axis=0).T)
    assert steps.sum() <= 2 * 1.2


def test_a_heading_that_nothing_leads_to_is_reported_and_the_nearest_one_is_taken() -> None:
    """In a corridor in which the chair cannot turn it comes to the place as it is turned."""
    cells = np.ones((40, 140), bool)
    cells[12:28, 10:130] = False
    plan = Planner(CHAIR).plan(costmap_of(cells), (1.5, 1.0, 0.0), (4.5, 1.0, math.pi))
    assert isinstance(plan, Plan)
    assert "no path leads to the goal as requested" in plan.goal_change
    np.testing.assert_allclose(plan.goal[:2], (4.5, 1.0), atol=0.11)
    np.testing.assert_allclose(plan.poses[-1], plan.goal, atol=1e-9)
    assert abs(math.remainder(plan.goal[2], 2 * math.pi)) < math.radians(20)
    assert f"{math.degrees(abs(math.remainder(plan.goal[2] - math.pi, 2 * math.pi))):.0f}°" in plan.goal_change
    check(plan, costmap_of(cells), (1.5, 1.0, 0.0))


def test_it_does_not_know_the_floor_below_it_and_leaves_all_the_same() -> None:
    state = np.full((160, 160), CellState.FREE, np.uint8)
    state[:, :60] = CellState.UNKNOWN
    static = StaticLayer(state, np.full(state.shape, np.inf, np.float32), 0.05, (0.0, 0.0))
    costmap = Costmap.of(static, CHAIR)
    plan = Planner(CHAIR).plan(costmap, (2.6, 4.0, 0.0), (6.0, 4.0, 0.0))
    assert isinstance(plan, Plan)
    assert plan.length_m == pytest.approx(3.4, abs=0.02)
    assert failed(costmap, (2.6, 4.0, 0.0), (1.0, 4.0, 0.0)) == PlanReason.GOAL_UNKNOWN


def test_slow_zones_are_driven_around_where_that_is_quicker() -> None:
    static = static_of(room(8, 10))
    speed = np.full((160, 200), np.inf, np.float32)
    speed[60:120, 80:120] = 0.1
    around = Costmap.of(StaticLayer(static.state, speed, 0.05, (0.0, 0.0)), CHAIR)
    straight = planned(Costmap.of(static, CHAIR), (2, 4.2, 0), (8, 4.2, 0))
    slow = planned(around, (2, 4.2, 0), (8, 4.2, 0))
    assert straight.length_m == pytest.approx(6.0, abs=0.01)
    crosses = around.speed_m_s[tuple(around.cells_at(slow.poses[:, :2]).T)] < 1
    # It may cut the zone's corner.
    assert np.hypot(*np.diff(slow.poses[:, :2], axis=0).T)[crosses[1:]].sum() < 0.2


@pytest.mark.slow
@settings(max_examples=25)
@given(st.integers(0, 10**6))
def test_plans_among_boxes_can_be_driven(seed: int) -> None:
    rng = np.random.default_rng(seed)
    cells = room(7, 7)
    for _ in range(rng.integers(2, 9)):
        row, column = rng.integers(0, 140, 2)
        height, width = rng.integers(2, 20, 2)
        cells[row : row + height, column : column + width] = True
    costmap = costmap_of(cells)
    start, goal = ([*rng.uniform(0.9, 6.1, 2), rng.uniform(-np.pi, np.pi)] for _ in range(2))
    outline = CHAIR.padded(MARGIN_M)
    is_free = [cells_under(cells, 0.05, (0.0, 0.0), outline.corners, pose) == 0 for pose in (start, goal)]
    answer = Planner(CHAIR).plan(costmap, start, goal)
    if not is_free[0]:
        assert isinstance(answer, Plan) or answer.reason != PlanReason.INVALID
    elif isinstance(answer, Plan):
        check(answer, costmap, start)
        assert (answer.goal_change == "") == is_free[1]
        if is_free[1]:
            np.testing.assert_allclose(answer.goal, goal, atol=1e-9)
    else:
        assert answer.reason in (PlanReason.UNREACHABLE, PlanReason.GOAL_OCCUPIED)
        assert (answer.reason == PlanReason.UNREACHABLE) or not is_free[1]


def test_it_says_the_same_every_time() -> None:
    costmap = costmap_of(room_with_door(0.8), 0.02)
    one, other = (planned(costmap, (1.8, 1.5, 0.3), (4.2, 4.6, 2.0)) for _ in range(2))
    np.testing.assert_array_equal(one.poses, other.poses)
    np.testing.assert_array_equal(one.directions, other.directions)


def test_margins_that_contradict_are_refused() -> None:
    with pytest.raises(ValidationError, match="wanted_margin_m"):
        PlannerSettings(margin_m=0.2, wanted_margin_m=0.1)


def test_what_limits_of_zero_forbid_is_in_no_plan() -> None:
    cells = np.ones((80, 100), bool)
    cells[31:49, 5:40] = False
    cells[10:70, 40:95] = False
    ahead = Planner(CHAIR, limits=RobotLimits(backward_m_s=0)).plan(costmap_of(cells), (1.3, 2.0, np.pi), (3.5, 2, 0))
    assert isinstance(ahead, PlanFailure)
    assert ahead.reason == PlanReason.UNREACHABLE
    free = costmap_of(room(8, 8))
    straight = Planner(CHAIR, limits=RobotLimits(turn_rad_s=0))
    along = straight.plan(free, (2, 4, 0), (6, 4, 0))
    assert isinstance(along, Plan)
    np.testing.assert_allclose(along.poses[:, 1:], [[4, 0]] * len(along.poses), atol=1e-9)
    aside = straight.plan(free, (2, 4, 0), (6, 5, 0))
    assert isinstance(aside, PlanFailure)
    assert aside.reason == PlanReason.UNREACHABLE
    behind = Planner(CHAIR, limits=RobotLimits(forward_m_s=0)).plan(free, (4, 4, 0), (2, 4, 0))
    assert isinstance(behind, Plan)
    assert (behind.directions[1:] == -1).all()
    none = Planner(CHAIR, limits=RobotLimits(forward_m_s=0, backward_m_s=0)).plan(free, (2, 4, 0), (6, 4, 0))
    assert isinstance(none, PlanFailure)
    assert none.reason == PlanReason.STANDS


def test_a_plan_that_something_blocks_is_repaired_and_joins_the_old_one() -> None:
    start, goal = np.array([1.5, 5.0, 0.0]), np.array([18.0, 5.0, 0.0])
    before = planned(costmap_of(room(10, 20)), start, goal)
    cells = room(10, 20)
    cells[96:104, 90:98] = True
    costmap, planner = costmap_of(cells), Planner(CHAIR)
    repaired = planner.repaired(costmap, before, start)
    assert repaired is not None
    check(repaired, costmap, start)
    whole = planned(costmap, start, goal)
    assert repaired.cost < 1.1 * whole.cost
    np.testing.assert_allclose(repaired.poses[-50:], before.poses[-50:])
    assert len(repaired.directions) == len(repaired.poses)
    # From beside the old plan, with nothing in the way, it joins it; too far ahead, or at the goal, a whole one is due.
    beside = planner.repaired(costmap_of(room(10, 20)), before, np.array([3.0, 5.3, 0.2]))
    assert beside is not None
    np.testing.assert_allclose(beside.poses[0], [3.0, 5.3, 0.2])
    for columns in (slice(240, 248), slice(352, 364)):
        cells = room(10, 20)
        cells[96:104, columns] = True
        assert planner.repaired(costmap_of(cells), before, start) is None


def test_a_repair_is_no_long_way_round() -> None:
    start, goal = np.array([1.5, 5.0, 0.0]), np.array([18.0, 5.0, 0.0])
    before = planned(costmap_of(room(10, 20)), start, goal)
    cells = room(10, 20)
    cells[20:, 90:94] = True
    assert Planner(CHAIR).repaired(costmap_of(cells), before, start) is None
