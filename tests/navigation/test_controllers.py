"""Controllers in a closed loop with a base that obeys: they arrive, and touch nothing."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from grids import mostly_slow
from navigation.floors import static_of
from navigation.unicycle import (
    CHAIR,
    NOBODY,
    Drive,
    Path,
    centres_of,
    clearance_m,
    closed_loop,
    field_of,
    room,
    with_door,
)

from benchmarks.plain_rooms import Unicycle
from wheelsight.core.geometry import BoolArray, FloatArray
from wheelsight.core.messages import STOP
from wheelsight.navigation import Costmap, NavigationSettings, Plan, RobotLimits
from wheelsight.navigation.clearance_kernels import CostField
from wheelsight.navigation.controllers import (
    Controller,
    ControlReason,
    MotionState,
    MppiController,
    PurePursuitController,
)
from wheelsight.navigation.planning import RoutePlanner
from wheelsight.navigation.settings import MppiSettings

QUARTER = np.pi / 2
MAKERS = [MppiController, PurePursuitController]
both = pytest.mark.parametrize("make", MAKERS, ids=["mppi", "pure pursuit"])


@pytest.mark.parametrize(
    ("make", "start", "goal"),
    [
        (MppiController, (4.66, 5.2, 1.4), (4.0, 4.4)),
        (PurePursuitController, (4.66, 5.2, 1.4), (4.0, 4.4)),
        (PurePursuitController, (1.0, 0.345, 0.0), (2.6, 0.8)),
    ],
)
def test_a_way_out_of_what_is_too_near_is_driven_as_it_was_planned(
    make: type[MppiController], start: tuple[float, float, float], goal: tuple[float, float]
) -> None:
    """Along a wall, and askew in a door 1.2 m wide: the planner let a corner come nearer, controllers did not."""
    cells, settings = with_door(5.05, 1.2), NavigationSettings()
    costmap = Costmap.of(static_of(cells), CHAIR)
    plan = RoutePlanner(CHAIR, settings).plan(costmap, np.array(start), [np.array([*goal, np.nan])])
    assert isinstance(plan, Plan)
    field, base = field_of(cells), Unicycle(start)
    before = signed_m(cells, np.array(start))
    assert before < settings.follow.margin_m
    drive = closed_loop(make(CHAIR), plan, field, base)
    assert drive.reason is ControlReason.ARRIVED
    assert min(signed_m(cells, pose) for pose in drive.poses) >= before - 0.02


def signed_m(cells: BoolArray, pose: FloatArray) -> float:
    """From the chair's outline to the nearest cell's middle, below 0 within; beside a corner by the nearer side."""
    c, s = np.cos(pose[2]), np.sin(pose[2])
    u, v = ((centres_of(cells) - pose[:2]) @ np.array([[c, -s], [s, c]])).T
    return float(np.max([u - 0.8, -0.3 - u, np.abs(v) - 0.3], axis=0).min())


def corridor() -> BoolArray:
    """1.6 m wide, with a corner to the left."""
    cells = np.ones((200, 200), bool)
    cells[80:112, 5:150] = False
    cells[80:190, 118:150] = False
    return cells


WAYS: dict[str, tuple[BoolArray, Path]] = {
    "straight": (room(), Path.of((2, 5, 0), (8, 5, 0))),
    "another heading at the end": (room(), Path.of((2, 5, 0), (7, 5, 0), (7, 5, 2.5))),
    "a bend": (room(), Path.of((2, 5, 0), (5, 5, 0), (8, 6.5, 0.46))),
    "a sharp corner": (room(), Path.of((2, 3, 0), (6, 3, 0), (6, 3, QUARTER), (6, 7, QUARTER))),
    "backward": (room(), Path.of((5, 5, 0), (3.5, 5, 0))),
    "backward, turn, forward": (room(), Path.of((5, 5, 0), (4, 5, 0), (4, 5, QUARTER), (4, 7, QUARTER))),
    "a door": (with_door(5.05, 0.9), Path.of((2, 3, 0.8), (2, 3, 0.6), (4, 5.05, 0.6), (7, 5.05, 0), (8, 5.05, 1))),
    "a narrow door": (with_door(5.05, 0.75), Path.of((2, 5.05, 0), (8, 5.05, 0))),
    "a corridor": (
        corridor(),
        Path.of(
            (0.8, 4.8, 0),
            (6.2, 4.8, 0),
            (6.45, 4.87, 0.52),
            (6.63, 5.05, 1.05),
            (6.7, 5.3, QUARTER),
            (6.7, 8.5, QUARTER),
        ),
    ),
}


def drive(make: Callable[..., Controller], cells: BoolArray, path: Path, base: Unicycle | None = None) -> Drive:
    base = base or Unicycle(tuple(map(float, path.poses[0])))  # type: ignore[arg-type]
    return closed_loop(make(CHAIR), path, field_of(cells), base)


@both
@pytest.mark.parametrize(
    "name", mostly_slow(WAYS, quick=["another heading at the end", "backward, turn, forward", "a narrow door"])
)
def test_it_arrives_and_touches_nothing(make: Callable[..., Controller], name: str) -> None:
    cells, path = WAYS[name]
    drove = drive(make, cells, path)
    off_m, off_deg = drove.off_goal(path)
    assert drove.reason is ControlReason.ARRIVED
    assert off_m <= 0.05
    assert off_deg <= 3
    # Half a cell: distances are to the centres of cells.
    assert clearance_m(CHAIR, drove.poses[::3], centres_of(cells)) > 0.025
    speeds = np.array([(command.forward_m_s, command.turn_rad_s) for command in drove.commands])
    limits = RobotLimits()
    assert speeds[:, 0].max() <= limits.forward_m_s
    assert speeds[:, 0].min() >= -limits.backward_m_s
    assert np.abs(speeds[:, 1]).max() <= limits.turn_rad_s + 1e-6


def walled(low: int, left: int) -> BoolArray:
    """With a wall to the right, y < low cells, and one ahead, from x = left cells on."""
    cells = room().copy()
    cells[:low] = True
    cells[:, left:] = True
    return cells


@both
@pytest.mark.parametrize(
    ("cells", "way_m"),
    [(walled(92, 200), 0.5), (walled(92, 200), 1.0), (walled(0, 118), 3.0), (walled(0, 68), 0.5)],
    ids=["beside a wall, 0.5 m", "beside a wall, 1 m", "up to a wall, 3 m", "up to a wall, 0.5 m"],
)
def test_walls_near_the_goal_do_not_hold_it_off(
    make: Callable[..., Controller], cells: BoolArray, way_m: float
) -> None:
    path = Path.of((2, 5, 0), (2 + way_m, 5, 0))
    drove = drive(make, cells, path)
    assert drove.reason is ControlReason.ARRIVED
    assert drove.off_goal(path)[0] < 0.05
    assert len(drove.commands) * 0.05 < 3.0 + 2.5 * way_m


@pytest.mark.slow
@both
@pytest.mark.parametrize("lag_s", [0.0, 0.3])
def test_a_base_that_lags_otherwise_arrives_too(make: Callable[..., Controller], lag_s: float) -> None:
    cells, path = WAYS["another heading at the end"]
    drove = drive(make, cells, path, Unicycle((2.0, 5.2, 0.2), lag_s=lag_s))
    assert drove.reason is ControlReason.ARRIVED
    off_m, off_deg = drove.off_goal(path)
    assert off_m <= 0.05
    assert off_deg <= 5


@pytest.mark.slow
@both
@pytest.mark.parametrize("seed", range(4))
def test_it_finds_onto_the_path_from_beside(make: Callable[..., Controller], seed: int) -> None:
    rng = np.random.default_rng(seed)
    path = WAYS["straight"][1]
    start = (2 + rng.uniform(-0.2, 0.2), 5 + rng.uniform(-0.4, 0.4), rng.uniform(-2.5, 2.5))
    drove = drive(make, room(), path, Unicycle(start))
    assert drove.reason is ControlReason.ARRIVED


@pytest.mark.slow
@both
def test_before_a_wall_across_the_path_it_stands(make: Callable[..., Controller]) -> None:
    cells, path = room(), WAYS["straight"][1]
    cells[:, 100] = True
    drove = drive(make, cells, path)
    assert drove.reason is ControlReason.BLOCKED
    assert clearance_m(CHAIR, drove.poses[::3], centres_of(cells)) > 0.02
    assert drove.poses[-1, 0] > 3


def test_rollouts_go_around_a_box_that_the_plan_does_not_know() -> None:
    cells, path = room(), WAYS["straight"][1]
    cells[100:108, 100:108] = True
    drove = drive(MppiController, cells, path)
    assert drove.reason is ControlReason.ARRIVED
    assert clearance_m(CHAIR, drove.poses[::3], centres_of(cells)) > 0.025
    assert drive(PurePursuitController, cells, path).reason is ControlReason.BLOCKED


@pytest.mark.slow
@pytest.mark.parametrize(
    "person",
    [(5.0, 5.1, 0.0, 0.0, 0.3), (9.0, 5.0, -0.6, 0.0, 0.3), (5.0, 2.0, 0.0, 0.7, 0.3), (6.0, 4.2, -0.3, 0.2, 0.3)],
)
def test_rollouts_go_around_people(person: tuple[float, ...]) -> None:
    """Who stands, comes along, crosses, or walks aslant; no one makes way."""
    people, path = np.array([person]), WAYS["straight"][1]
    drove = closed_loop(MppiController(CHAIR), path, field_of(room()), Unicycle((2.0, 5.0, 0.0)), people)
    assert drove.reason is ControlReason.ARRIVED
    for n, pose in enumerate(drove.poses):
        at = people[:, :2] + 0.05 * n * people[:, 2:4]
        assert clearance_m(CHAIR, pose, at) > people[0, 4]


def test_equal_input_gives_equal_commands() -> None:
    cells, path = WAYS["backward"]
    first, second = (drive(MppiController, cells, path) for _ in range(2))
    assert len(first.commands) > 40
    assert first.commands == second.commands


@pytest.mark.slow
@both
def test_zones_limit_the_speed(make: Callable[..., Controller]) -> None:
    field, path = field_of(room()), WAYS["straight"][1]
    speed = np.full(field.distance_m.shape, np.inf, np.float32)
    speed[:, 80:] = 0.3
    base = Unicycle((2.0, 5.0, 0.0))
    drove = closed_loop(make(CHAIR), path, field._replace(speed_m_s=speed), base)
    assert drove.reason is ControlReason.ARRIVED
    within = drove.poses[:-1, 0] > 4.0
    assert max(c.forward_m_s for c, inside in zip(drove.commands, within, strict=True) if inside) <= 0.3 + 1e-6
    assert max(c.forward_m_s for c in drove.commands) > 0.6


@both
def test_what_is_no_input_gives_a_stop_and_a_reason(make: Callable[..., Controller]) -> None:
    field, path, pose = field_of(room()), WAYS["straight"][1], np.array([2.0, 5.0, 0.0])

    def reason(
        state: MotionState | None = None, plan: Path = path, at: CostField = field, people: object = NOBODY
    ) -> ControlReason | None:
        result = make(CHAIR).command(state or MotionState(pose), plan, at, people)  # type: ignore[arg-type]
        assert (result.command == STOP) == (result.reason is not None)
        return result.reason

    assert reason() is None
    assert reason(MotionState(np.array([2.0, np.nan, 0.0]))) is ControlReason.INVALID
    assert reason(MotionState(pose, np.inf)) is ControlReason.INVALID
    assert reason(MotionState(pose[:2])) is ControlReason.INVALID
    assert reason(plan=Path(np.empty((0, 3)))) is ControlReason.NO_PATH
    assert reason(plan=Path.of((2, 5, 0), (np.nan, 5, 0))) is ControlReason.NO_PATH
    assert reason(people=np.array([[5, 5, np.nan, 0, 0.3]])) is ControlReason.INVALID
    assert reason(people=np.zeros(4)) is ControlReason.INVALID
    assert reason(at=field._replace(resolution=0.0)) is ControlReason.INVALID
    assert reason(at=field._replace(distance_m=np.full((200, 200), np.nan, np.float32))) is ControlReason.INVALID
    assert reason(at=field._replace(cost=np.zeros((3, 3), np.float32))) is ControlReason.INVALID
    assert reason(MotionState(np.array([2.0, 8.0, 0.0]))) is ControlReason.OFF_PATH
    assert reason(MotionState(np.array([20.0, 5.0, 0.0])), Path.of((20, 5, 0), (21, 5, 0))) is ControlReason.BLOCKED
    assert reason(plan=Path.of((2, 5, 0))) is ControlReason.ARRIVED
    assert reason(plan=Path.of((2.2, 5, 0))) is ControlReason.MISSED


@both
@pytest.mark.parametrize("limit", ["forward_m_s", "turn_rad_s"])
def test_a_robot_that_may_not_move_says_so(make: Callable[..., Controller], limit: str) -> None:
    cells, path = WAYS["a sharp corner"]
    controller = make(CHAIR, RobotLimits(**{limit: 0.0}))
    drove = closed_loop(controller, path, field_of(cells), Unicycle((2.0, 3.0, 0.0)), longest_s=40.0)
    assert drove.reason is ControlReason.BLOCKED


@both
def test_what_is_predicted_is_what_comes(make: Callable[..., Controller]) -> None:
    """At a steady speed, half a second on; within what the commands of meanwhile change."""
    controller, base, field = make(CHAIR), Unicycle((2.0, 5.0, 0.0)), field_of(room())
    path, predicted = WAYS["straight"][1], []
    for n in range(60):
        result = controller.command(base.state, path, field, NOBODY)
        base.step(result.command)
        predicted.append(result.predicted)
        if n == 59:
            away = np.hypot(*(predicted[49][:, :2] - base.pose[:2]).T).min()
            assert away < 0.03


def test_rollouts_may_be_few_and_short(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("wheelsight.navigation.controllers._STEPS", 30)
    cells, path = WAYS["straight"]
    few = MppiController(CHAIR, settings=MppiSettings(rollouts=401))
    assert closed_loop(few, path, field_of(cells), Unicycle((2.0, 5.0, 0.0))).reason is ControlReason.ARRIVED


def test_a_new_plan_is_taken_up() -> None:
    controller, base, field = MppiController(CHAIR), Unicycle((2.0, 5.0, 0.0)), field_of(room())
    first, second = WAYS["straight"][1], Path.of((2.0, 5.0, 0.0), (4.0, 5.0, 0.0))
    for _ in range(20):
        base.step(controller.command(base.state, first, field, NOBODY).command)
    drove = closed_loop(controller, replace(second), field, base)
    assert drove.reason is ControlReason.ARRIVED
    assert drove.off_goal(second)[0] <= 0.05
