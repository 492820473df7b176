"""Behaviours: they end when they are done, and when the collision monitor lets them make no more way."""

from __future__ import annotations

import numpy as np
import pytest

from wheelsight.core.estimates import Status
from wheelsight.core.messages import VelocityCommand
from wheelsight.navigation import Behaviour, BehaviourSettings, Straight, Turn, Wait
from wheelsight.navigation.behaviours import OpenWay, Series, when_blocked, when_lost

PERIOD_S = 0.05
WIDE = OpenWay(0.5, 3.0)


def search(attempt: int, status: Status, way: OpenWay | None, *, is_held: bool = False, sees: bool = True) -> Behaviour:
    return when_lost(attempt, BehaviourSettings(), status, way, is_held=is_held, sees=sees)


def done_by(behaviour: Behaviour, obeys: float = 1.0, longest_s: float = 60.0) -> tuple[np.ndarray, float]:
    """Pose and time of a base that obeys exactly, or by a share, until a behaviour is done."""
    pose = np.array([1.0, 2.0, 3.0])
    for n in range(round(longest_s / PERIOD_S)):
        command = behaviour.command(n * PERIOD_S, pose.copy())
        if command is None:
            return pose, n * PERIOD_S
        pose[2] = np.angle(np.exp(1j * (pose[2] + obeys * command.turn_rad_s * PERIOD_S)))
        way_m = obeys * command.forward_m_s * PERIOD_S
        pose[:2] += way_m * np.cos(pose[2]), way_m * np.sin(pose[2])
    raise AssertionError("it never ends")


def test_waiting_takes_its_time() -> None:
    _, spent_s = done_by(Wait(2.0))
    assert spent_s == pytest.approx(2.0, abs=PERIOD_S)


@pytest.mark.parametrize("way_m", [0.5, -0.3])
def test_straight_on_and_back(way_m: float) -> None:
    pose, _ = done_by(Straight(way_m, 0.1, "go"))
    expected = np.array([1.0, 2.0]) + way_m * np.array([np.cos(3.0), np.sin(3.0)])
    assert pose[:2] == pytest.approx(expected, abs=0.01)


def test_a_turn_of_more_than_once_around_is_one() -> None:
    behaviour, turned, yaw = Turn((6.5,)), 0.0, 0.0
    for n in range(2000):
        command = behaviour.command(n * PERIOD_S, np.array([0.0, 0.0, yaw]))
        if command is None:
            break
        turned += command.turn_rad_s * PERIOD_S
        yaw = float(np.angle(np.exp(1j * turned)))
    assert turned == pytest.approx(6.5, abs=0.05)


def test_to_one_side_and_to_the_other_and_back() -> None:
    pose, _ = done_by(Turn((1.0, -2.0, 1.0)))
    assert pose[2] == pytest.approx(3.0, abs=0.1)


@pytest.mark.parametrize("behaviour", [Straight(-0.3, 0.1, "back"), Turn((1.0,))])
def test_what_is_held_ends(behaviour: Behaviour) -> None:
    _, spent_s = done_by(behaviour, obeys=0.0)
    assert 2.0 <= spent_s < 3.0


def test_without_a_pose_nothing_is_driven() -> None:
    assert Straight(0.3, 0.1, "go").command(0.0, None) is None
    assert Turn((1.0,)).command(0.0, None) is None
    assert Wait(1.0).command(0.0, None) == VelocityCommand()


def test_the_gentlest_first() -> None:
    settings = BehaviourSettings()
    assert [when_blocked(n, settings.wait_s).name for n in range(4)] == ["wait", "look about", "back up", "wait"]
    assert [type(search(n, Status.LOST, WIDE)) for n in range(4)] == [Wait, Turn, Series, Turn]


@pytest.mark.parametrize("status", [Status.LOST, Status.INITIALIZING])
def test_a_search_turns_to_one_side_and_then_to_the_other(status: Status) -> None:
    searches = (search(n, status, None) for n in range(5))
    turns = [np.sign(one.angles_rad[0]) for one in searches if isinstance(one, Turn)]
    assert turns[:4] == [1, -1, 1, -1]


def test_who_begins_in_a_map_does_not_stand_first() -> None:
    assert isinstance(search(0, Status.INITIALIZING, WIDE), Turn)


@pytest.mark.parametrize(
    ("sees", "ways"), [(False, [Turn, Straight, Straight, Straight]), (True, [Turn, Turn, Straight, Turn])]
)
def test_who_may_not_turn_backs_up_and_does_not_begin_with_it(sees: bool, ways: list[type]) -> None:
    found = [search(n, Status.INITIALIZING, WIDE, is_held=True, sees=sees) for n in range(4)]
    assert [type(one) for one in found] == ways
    assert all(one.way_m < 0 for one in found if isinstance(one, Straight))


def test_a_search_goes_on_from_elsewhere_after_a_whole_turn() -> None:
    settings = BehaviourSettings()
    searches = [search(n, Status.INITIALIZING, WIDE) for n in range(4)]
    assert [type(one) for one in searches] == [Turn, Series, Turn, Series]
    pose, _ = done_by(searches[1])
    way = settings.search_m * np.array([np.cos(3.5), np.sin(3.5)])
    assert pose[:2] == pytest.approx(np.array([1.0, 2.0]) + way, abs=0.05)


@pytest.mark.parametrize("way", [None, OpenWay(0.5, 0.3)])
def test_a_search_stays_where_nothing_is_open(way: OpenWay | None) -> None:
    searches = [search(n, Status.INITIALIZING, way) for n in range(4)]
    assert [type(one) for one in searches] == [Turn] * 4
