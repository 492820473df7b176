"""A person crosses a robot's way: a robot that knows where he walks arrives sooner and keeps away from him."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest
from navigation.rooms import Ride
from patched import patched

from benchmarks.plain_rooms import Walls
from wheelsight.core.geometry import FloatArray
from wheelsight.navigation import NavigationSettings, PeopleSettings

constants = patched({"perception._VIEW_COLUMNS": 16})
WIDTH_M, HEIGHT_M = 12.0, 8.0
ROOM = Walls.of(
    ((0.0, 0.0), (WIDTH_M, 0.0)),
    ((WIDTH_M - 0.01, 0.0), (WIDTH_M - 0.01, HEIGHT_M)),
    ((WIDTH_M, HEIGHT_M - 0.01), (0.0, HEIGHT_M - 0.01)),
    ((0.01, HEIGHT_M), (0.01, 0.0)),
)
START, GOAL = (1.5, 4.0, 0.0), (9.5, 4.0, 0.0)
EIGHTHS = np.arange(9) * np.pi / 4
BODY = 0.25 * np.column_stack([np.cos(EIGHTHS), np.sin(EIGHTHS)])
LONGEST_S = 16.0


@dataclass
class Crossing:
    """What became of a drive.

    Attributes:
        has_arrived: whether it did, before `LONGEST_S`.
        time_s: until then.
        apart_m: least distance from the outline to the person.
        driven_at_m: the same while the robot itself came nearer.
        reported: periods in which it knew of somebody who walks.
    """

    has_arrived: bool
    time_s: float
    apart_m: float
    driven_at_m: float
    reported: int


def body_at(place: FloatArray) -> Walls:
    sides = BODY + place
    return Walls(np.stack([sides[:-1], sides[1:]], axis=1))


def crossed(begin: tuple[float, float], velocity: tuple[float, float], *, is_predicted: bool) -> Crossing:
    """Somebody walks straight on through the room, whatever the robot does."""
    # The rooms' camera has 64 columns; a view of as many would have gaps.
    settings = NavigationSettings(people=PeopleSettings(is_predicted=is_predicted))
    subject = Ride.of(Walls(ROOM.ends), START, (WIDTH_M, HEIGHT_M), ROOM, settings)
    robot, navigator = subject.robot, subject.navigator
    navigator.go_to_pose(GOAL)
    result = Crossing(False, LONGEST_S, np.inf, np.inf, 0)
    while robot.now_s < LONGEST_S and not result.has_arrived:
        person = body_at(np.array(begin) + robot.now_s * np.array(velocity))
        is_inside = bool((person.ends > 0.02).all() and (person.ends < (WIDTH_M - 0.02, HEIGHT_M - 0.02)).all())
        robot.walls = Walls(np.concatenate([ROOM.ends, person.ends])) if is_inside else ROOM
        before_m = person.clearance_m(navigator.footprint.at(robot.base.pose))
        navigator.step()
        after_m = person.clearance_m(navigator.footprint.at(robot.base.pose))
        result.reported += len(navigator.senses.people(robot.now_s)) > 0
        if is_inside:
            result.apart_m = min(result.apart_m, after_m)
            result.driven_at_m = min(result.driven_at_m, after_m if after_m < before_m - 1e-3 else np.inf)
        if navigator.is_task_complete():
            result.has_arrived, result.time_s = bool(navigator.result), robot.now_s
    return result


@pytest.mark.slow
def test_reported_who_walks_where_it_arrives_sooner_and_keeps_away() -> None:
    crossings = (((8.2, 10.0), (-0.15, -1.3)), ((10.6, -1.2), (-0.3, 0.8)))
    reported = [crossed(*crossing, is_predicted=True) for crossing in crossings]
    unreported = [crossed(*crossing, is_predicted=False) for crossing in crossings]
    assert all(one.reported > 5 for one in reported)
    assert all(one.reported == 0 for one in unreported)
    assert all(one.driven_at_m > 0.1 for one in reported), [one.driven_at_m for one in reported]
    assert sum(one.has_arrived for one in reported) >= sum(one.has_arrived for one in unreported)
    assert sum(one.time_s for one in reported) < sum(one.time_s for one in unreported)
    # Untold, what blocked a way is taken for a thing, and it goes far round: nearer than that is near enough.
    assert all(one.apart_m > 0.4 for one in reported), [one.apart_m for one in reported]
