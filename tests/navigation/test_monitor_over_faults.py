"""The collision monitor keeps a robot off a wall that the map does not know, whatever is wrong above it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import pytest
from narrowing import not_none
from navigation.rooms import Ride
from navigation.unguarded import FULL, Asks, without_monitor
from navigation.unicycle import clearance_m, field_of

from benchmarks.plain_rooms import Walls, walls_about
from wheelsight.core.estimates import Estimate
from wheelsight.core.geometry import FloatArray, se3
from wheelsight.core.messages import STOP, Event, VelocityCommand
from wheelsight.navigation import MonitorReason, MonitorResult, MonitorState, NavigationSettings, NavigatorSettings
from wheelsight.navigation.clearance_kernels import CostField
from wheelsight.navigation.controllers import (
    Controller,
    ControlReason,
    ControlResult,
    DrivenPath,
    MotionState,
    PurePursuitController,
)
from wheelsight.navigation.perception import LiveLayer
from wheelsight.navigation.planner import Plan
from wheelsight.navigation.planning import CautiousPlanner, PlannerClient
from wheelsight.navigation.senses import Senses
from wheelsight.navigation.settings import PeopleSettings

SIZE_M = (9.0, 6.0)
ROOM = walls_about(*SIZE_M)
# Right across the room: no one gets past it, nor around it.
WALL_M = 5.0
ACROSS = (*ROOM, ((WALL_M, 0.0), (WALL_M, 6.0)))
POINTS = np.concatenate([np.linspace(a, b, 1 + round(np.hypot(b[0] - a[0], b[1] - a[1]) / 0.02)) for a, b in ACROSS])
BEGIN, GOAL = (1.5, 3.0, 0.0), (8.0, 3.0, 0.0)
NEARER = (2.9, 3.0, 0.0)
# A chair's link stands still by itself when nothing is said for so long: docs/serial-link.md.
WATCHDOG_S, PERIOD_S, HANGS_S = 0.25, 0.05, 1.0
# No one walks here, and looking for people takes time.
UNTRACKED = PeopleSettings(is_predicted=False)
ABOUT_THINGS = (MonitorReason.OBSTACLE, MonitorReason.IN_ZONE, MonitorReason.NEAR, MonitorReason.INSIDE)


class AsksAnything:
    """A controller that asks for speeds far beyond what the robot can do, each for half a second to two."""

    def __init__(self, seed: int) -> None:
        self.rng, self.left, self.asked = np.random.default_rng(seed), 0, STOP

    def command(self, state: MotionState, plan: DrivenPath, field: CostField, people: FloatArray) -> ControlResult:
        if self.left == 0:
            self.left = int(self.rng.integers(10, 30))
            size = 10.0 ** self.rng.uniform(-1, 6)
            self.asked = VelocityCommand(size * self.rng.uniform(-0.2, 1.0), self.rng.uniform(-1.0, 1.0))
        self.left -= 1
        return ControlResult(self.asked)


class LooksAtNothing:
    """A controller that follows its plan, and takes all floor for free."""

    def __init__(self) -> None:
        self.follows = PurePursuitController(NavigationSettings().footprint.outline)
        self.free = field_of(np.zeros((round(SIZE_M[1] / 0.05), round(SIZE_M[0] / 0.05)), bool))

    def command(self, state: MotionState, plan: DrivenPath, field: CostField, people: FloatArray) -> ControlResult:
        return self.follows.command(state, plan, self.free, people)


@dataclass
class Hangs:
    """A controller that takes a second for each answer once the robot is past some x; the robot's clock goes on."""

    ride: Ride
    from_m: float
    late: list[Event] = field(default_factory=list)
    hung: int = 0

    def __post_init__(self) -> None:
        self.step = self.ride.robot.step
        self.reported = STOP
        self.ride.robot.step = self._step  # type: ignore[method-assign]

    def _step(self, command: VelocityCommand) -> list[Event]:
        late, self.late, self.reported = self.late, [], command
        return [*late, *self.step(command)]

    def command(self, state: MotionState, plan: DrivenPath, field: CostField, people: FloatArray) -> ControlResult:
        if self.ride.robot.base.pose[0] > self.from_m:
            self.hung += 1
            for period in range(round(HANGS_S / PERIOD_S)):
                kept = self.reported if period * PERIOD_S < WATCHDOG_S else STOP
                self.late += self.step(kept)
        return ControlResult(FULL)


@dataclass
class DrivesOn:
    """A behaviour that never ends."""

    name: str = "drive on"

    def command(self, now_s: float, odom_pose: FloatArray | None) -> VelocityCommand | None:
        return FULL


def leaps(seed: int) -> Callable[[Estimate], Estimate]:
    """Once a second after the first two it is metres and turns elsewhere, in `odom` and in the map, and sure of it."""
    rng, until_s = np.random.default_rng(seed), 2.0
    off = [np.eye(4), np.eye(4)]

    def says(estimate: Estimate) -> Estimate:
        nonlocal until_s
        assert estimate.T_odom_body is not None
        if estimate.stamp_s >= until_s:
            until_s = estimate.stamp_s + 1.0
            off[:] = [se3.from_plane(*rng.normal(0.0, (1.0, 1.0, 0.5))) for _ in range(2)]
        return replace(estimate, T_odom_body=estimate.T_odom_body @ off[0], T_map_odom=off[1])

    return says


def straight_on(pose: Any, goals: Any) -> tuple[Plan, bool]:
    """The plan of a planner that asks nothing."""
    ahead = np.asarray(goals[-1], float)
    share = np.linspace(0.0, 1.0, 200)[:, None]
    poses = np.column_stack([pose[:2] + share * (ahead[:2] - pose[:2]), np.zeros(len(share))])
    length_m = float(np.hypot(*(ahead[:2] - pose[:2])))
    plan = Plan(poses, np.ones(len(poses), int), length_m, 0.5, poses[-1], "", "map", length_m, 0)
    return plan, False


class Faults:
    """Put into a ride's parts above the monitor."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch, ride: Ride) -> None:
        self.patch, self.ride = monkeypatch, ride

    def empty_costmap(self) -> None:
        """Nothing that the camera meets gets into any costmap, nor what the monitor shows."""
        self.patch.setattr(LiveLayer, "update", lambda layer, *seen: None)
        nothing = self.ride.navigator.senses._live.obstacles()  # noqa: SLF001
        self.patch.setattr(Senses, "_obstacles", lambda senses, hidden=None: nothing)

    def plans_through(self) -> None:
        """It plans through the wall, and finds each plan free for ever."""
        self.patch.setattr(CautiousPlanner, "plan", lambda planner, *asked: straight_on(*asked[-2:]))
        self.patch.setattr(PlannerClient, "look", lambda planning, *asked: ("", True))
        self.patch.setattr(PlannerClient, "is_free", lambda planning, *asked: True)

    def controller(self, controller: Controller) -> None:
        """Another one."""
        self.ride.navigator._controller = controller  # noqa: SLF001


def plan_leads_through_the_wall(faults: Faults) -> None:
    faults.plans_through()
    faults.controller(LooksAtNothing())


def costmap_is_empty(faults: Faults) -> None:
    """Planner and controller are sound, and see no obstacles."""
    faults.empty_costmap()


def controller_asks_full_speed(faults: Faults) -> None:
    faults.empty_costmap()
    faults.controller(Asks(ControlResult(FULL)))


def controller_hangs(from_m: float) -> Callable[[Faults], None]:
    def put(faults: Faults) -> None:
        faults.empty_costmap()
        faults.controller(Hangs(faults.ride, from_m))

    return put


def behaviour_drives_on(faults: Faults) -> None:
    """It is to get the robot out, where a controller finds no way on."""
    faults.empty_costmap()
    faults.controller(Asks(ControlResult.standing(ControlReason.BLOCKED)))
    faults.patch.setattr("wheelsight.navigation.navigator.when_blocked", lambda *asked: DrivesOn())


def localization_leaps(faults: Faults) -> None:
    faults.ride.localization.says = leaps(1)
    faults.empty_costmap()
    faults.plans_through()
    faults.controller(Asks(ControlResult(FULL)))


def controller_asks_anything(faults: Faults) -> None:
    faults.empty_costmap()
    faults.controller(AsksAnything(19))


def all_is_wrong(faults: Faults) -> None:
    faults.ride.localization.says = leaps(3)
    faults.plans_through()
    faults.empty_costmap()
    faults.controller(AsksAnything(19))


@dataclass
class Seen:
    """What became of a ride."""

    ride: Ride
    ends_where_it_stands: bool
    closest_m: float = np.inf
    fastest_m_s: float = 0.0
    results: list[MonitorResult] = field(default_factory=list)

    @property
    def is_stopped(self) -> bool:
        """Whether the monitor stopped it before a thing at some time."""
        return any(
            result.state is MonitorState.STOPPED and result.reason is MonitorReason.OBSTACLE for result in self.results
        )

    def look(self) -> bool:
        """After each period; whether no more is to be seen: it has touched something, or was stopped and stands."""
        base, navigator = self.ride.robot.base, self.ride.navigator
        # Within the outline is 0, other than in the ride's own clearance, which is from the outline's sides.
        self.closest_m = min(self.closest_m, clearance_m(navigator.footprint, base.pose, POINTS))
        self.fastest_m_s = max(self.fastest_m_s, base.forward_m_s)
        self.results.append(not_none(navigator.feedback.monitor))
        return self.closest_m == 0.0 or (self.ends_where_it_stands and self.is_stopped and base.stands)


def ride_with(
    put: Callable[[Faults], None],
    monkeypatch: pytest.MonkeyPatch,
    seconds: float,
    *,
    is_checked: bool,
    begin: tuple[float, float, float] = BEGIN,
) -> Seen:
    settings = NavigationSettings(controller="pure_pursuit", navigator=NavigatorSettings(held_s=1.0), people=UNTRACKED)
    ride = Ride.of(Walls.of(*ACROSS), begin, SIZE_M, Walls.of(*ROOM), settings)
    seen = Seen(ride, ends_where_it_stands=begin is BEGIN)
    with monkeypatch.context() as patch:
        faults = Faults(patch, ride)
        put(faults)
        if not is_checked:
            without_monitor(patch, ride)
        ride.navigator.go_to_pose(GOAL)
        ride.go(seconds, seen.look)
    return seen


STRAIGHT = (
    plan_leads_through_the_wall,
    costmap_is_empty,
    controller_asks_full_speed,
    behaviour_drives_on,
    localization_leaps,
)


@pytest.mark.parametrize("put", STRAIGHT, ids=lambda put: str(put.__name__))
def test_what_drives_at_a_wall_at_full_speed_is_stopped_before_it(
    put: Callable[[Faults], None], monkeypatch: pytest.MonkeyPatch
) -> None:
    checked = ride_with(put, monkeypatch, 9.0, is_checked=True)
    assert checked.fastest_m_s > 0.9
    assert checked.closest_m > 0
    assert checked.ride.clearance_m > 0
    assert checked.is_stopped
    assert checked.ride.robot.base.stands
    # It came as near as it may, and did not stand for some other reason before.
    assert checked.closest_m < 0.1
    assert ride_with(put, monkeypatch, 7.5, is_checked=False).closest_m == 0


def test_a_controller_that_hangs_for_a_second_before_each_answer_touches_nothing(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """From full speed on, and before the wall; the command before is driven on until the link's watchdog stops it."""
    for from_m in (3.1, 4.0):
        checked = ride_with(controller_hangs(from_m), monkeypatch, 7.5, is_checked=True)
        assert checked.fastest_m_s > 0.9
        assert checked.closest_m > 0
        assert checked.ride.clearance_m > 0
        assert any(result.reason in ABOUT_THINGS for result in checked.results)
        assert checked.ride.robot.base.pose[0] > from_m
    assert ride_with(controller_hangs(3.1), monkeypatch, 7.5, is_checked=False).closest_m == 0


@pytest.mark.parametrize("put", [controller_asks_anything, all_is_wrong], ids=lambda put: str(put.__name__))
def test_anyone_who_asks_for_anything_touches_nothing(
    put: Callable[[Faults], None], monkeypatch: pytest.MonkeyPatch
) -> None:
    checked = ride_with(put, monkeypatch, 5.8, is_checked=True, begin=NEARER)
    assert checked.fastest_m_s > 0.4
    assert checked.closest_m > 0
    assert checked.ride.clearance_m > 0
    assert checked.is_stopped
    assert ride_with(put, monkeypatch, 5.8, is_checked=False, begin=NEARER).closest_m == 0
