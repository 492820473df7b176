"""What is round a robot that is commanded: distances by closed form, people and doors that see it, and whose fault."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
import shapely
from grids import mostly_slow
from small_rooms import corridor, room

from wheelsight.core.errors import ConfigError
from wheelsight.core.geometry import FloatArray, se3
from wheelsight.core.messages import STOP, VelocityCommand
from wheelsight_sim import RobotModel, SimulationSettings, Simulator
from wheelsight_sim.doors import DoorSettings, LiveDoors
from wheelsight_sim.people import RADIUS_M, STEP_S, LivePassersby, LivePeopleSettings
from wheelsight_sim.robot import outline_at
from wheelsight_sim.world import Leaf, World

SETTINGS = SimulationSettings(seed=1)
CARELESS, MINDING = LivePeopleSettings(careless=1.0), LivePeopleSettings(careless=0.0)


def in_corridor(
    start: tuple[float, float, float], passersby: int = 0, people: LivePeopleSettings = MINDING, seed: int = 1
) -> Simulator:
    settings = replace(SETTINGS, passersby=passersby, seed=seed)
    return Simulator(settings, start=start, world=corridor(), people=people, has_camera=False)


def drive(simulator: Simulator, command: VelocityCommand, seconds: float) -> None:
    for _ in range(round(seconds / 0.05)):
        simulator.step(command)


@pytest.mark.parametrize(
    ("start", "clearance_m"),
    [
        ((4.0, 0.0, 0.0), 1.4 - 0.3),
        ((4.0, 0.5, 0.0), 1.4 - 0.5 - 0.3),
        ((4.0, 0.0, math.pi / 2), 1.4 - 0.8),
        ((4.0, 0.0, math.pi / 4), 1.4 - (0.8 + 0.3) * math.sqrt(0.5)),
        ((7.7, 0.8, 0.0), 0.3),  # the bin, 0.2 m round (9, 1.2), is 0.3 m ahead of the front; so is the wall, aside
        ((9.0, 0.0, 0.0), 1.0 - 0.3),
    ],
)
def test_clearance_is_that_of_the_true_outline(start: tuple[float, float, float], clearance_m: float) -> None:
    assert in_corridor(start).clearance_m() == pytest.approx(clearance_m, abs=1e-3)


def test_nothing_round_is_infinitely_far() -> None:
    simulator = Simulator(SETTINGS, world=room('<geom name="floor" type="plane" size="40 40 1"/>'), has_camera=False)
    assert simulator.clearance_m() == simulator.people_clearance_m() == math.inf


def test_a_corner_that_turns_into_a_wall_is_the_robots() -> None:
    simulator = in_corridor((4.0, 0.85, 0.0))
    drive(simulator, VelocityCommand(0.0, 0.6), 3.0)
    assert simulator.contacts[0].name == "left"
    assert simulator.contacts[0].is_by_robot
    assert simulator.contacts[0].place_m[1] == pytest.approx(1.4, abs=0.01)


@pytest.mark.parametrize("seed", mostly_slow(range(3), quick=[0]))
def test_people_keep_away_from_a_robot_that_stands(seed: int) -> None:
    simulator = in_corridor((17.0, 0.0, 0.0), 4, seed=seed)
    nearest_m, crossings = [], 0
    side = np.sign(simulator.people_m[:, 0] - 17)
    for _ in range(800):
        simulator.step(STOP)
        nearest_m.append(simulator.people_clearance_m())
        now = np.sign(simulator.people_m[:, 0] - 17)
        crossings += int((now != side).sum())
        side = now
        between_walls = simulator.people_m[np.abs(simulator.people_m[:, 0] - 12) < 12.5]
        assert (np.abs(between_walls[:, 1]) <= 1.4 - RADIUS_M).all()
    assert min(nearest_m) > 0.05
    assert simulator.contacts == ()
    assert crossings >= 2  # they pass it all the same


def test_who_walks_into_a_robot_that_stands_has_done_it() -> None:
    simulator = in_corridor((17.0, 0.0, 0.0), 4, CARELESS)
    drive(simulator, STOP, 40.0)
    people = [contact for contact in simulator.contacts if contact.name.startswith("passerby")]
    assert people
    assert not any(contact.is_by_robot for contact in people)
    assert all(contact.other_m_s > 0.3 and abs(contact.robot_m_s) < 0.02 for contact in people)
    assert simulator.contact == simulator.contacts[-1]


def test_driven_at_people_the_robot_has_done_it() -> None:
    """People who do not look, at a robot that does not either."""
    simulator = in_corridor((1.5, 0.0, 0.0), 6, CARELESS)
    drive(simulator, VelocityCommand(1.0), 15.0)
    assert any(contact.is_by_robot and contact.robot_m_s > 0.5 for contact in simulator.contacts)


def test_people_are_where_they_were_at_times_between_steps() -> None:
    T = se3.from_plane(12.0, 0.0, 0.0)
    people = LivePassersby(corridor(), T, 3, 5, RobotModel(), MINDING)
    places = [people.positions_at(0.0)]
    for step in range(40):
        people.step(T, T)
        places.append(people.positions_at((step + 1) * STEP_S))
        middle = people.positions_at((step + 0.5) * STEP_S)
        np.testing.assert_allclose(middle, (places[-1] + places[-2]) / 2)
        speed = (places[-1] - places[-2]) / STEP_S
        np.testing.assert_allclose(people.velocities_at((step + 0.5) * STEP_S), speed, atol=1e-9)
    assert np.hypot(*(places[-1] - places[0]).T).max() > 1.0


def test_a_world_without_room_for_people_is_refused() -> None:
    closet = corridor(0.7, ((3.0, 0.0), (3.5, 0.0)), ends_m=(2.2, 4.4))
    with pytest.raises(ConfigError, match="no room for passers-by"):
        LivePassersby(closet, se3.from_plane(3.0, 0.0, 0.0), 1, 0, RobotModel())


SHUT = '<geom name="leaf" type="box" pos="3 0 1" size="0.0225 0.5 1"/>'


def gap(turn_rad: float = math.pi / 2) -> World:
    """A doorway at x = 3 whose leaf the world has across the way, hinged on the left."""
    return replace(room(SHUT), leaves=(Leaf("leaf", (3.0, 0.5), turn_rad),))


def swung(doors: LiveDoors, T: FloatArray, seconds: float, begin_s: float = 0.0) -> FloatArray:
    """(N,) turns of the leaf while the robot stands at a pose."""
    outline = outline_at(RobotModel(), T)
    turns = []
    for stamp_s in begin_s + 0.05 * np.arange(round(seconds / 0.05)):
        doors.step(float(stamp_s), outline, np.zeros((0, 2)))
        turns.append(float(doors.turns_at(float(stamp_s))[0]))
    return np.array(turns)


def test_doors_swing_while_no_one_is_near_and_not_else() -> None:
    far, near = se3.from_plane(-5.0, 0.0, 0.0), se3.from_plane(2.4, 0.0, math.pi)
    quick = DoorSettings(rests_s=(1.0, 2.0))
    outline = outline_at(RobotModel(), far)
    turns = swung(LiveDoors(gap(), outline, 1, 4, quick), far, 60.0)
    assert turns.min() == pytest.approx(0.0, abs=1e-9)
    assert turns.max() == pytest.approx(math.pi / 2)
    assert (np.diff(turns) != 0).mean() > 0.2
    assert not swung(LiveDoors(gap(), outline_at(RobotModel(), near), 1, 4, quick), near, 60.0).any()


def test_a_leaf_is_held_when_somebody_comes_and_goes_on_once_they_are_gone() -> None:
    far, near = se3.from_plane(-5.0, 0.0, 0.0), se3.from_plane(2.4, 0.0, math.pi)
    slow = DoorSettings(swing_s=(2.0, 2.0), rests_s=(1.0, 1.0))
    doors = LiveDoors(gap(), outline_at(RobotModel(), near), 1, 4, slow)
    turns = swung(doors, far, 2.0)
    assert 0 < turns[-1] < math.pi / 2
    held = swung(doors, near, 5.0, 2.0)
    assert np.ptp(held) < 1e-9
    assert held[0] == pytest.approx(turns[-1], abs=0.1)
    after = swung(doors, far, 4.0, 7.0)
    assert after[0] == pytest.approx(held[0])
    assert 0.0 in after


def test_a_leaf_is_solid_and_touching_it_is_reported() -> None:
    settings = replace(SETTINGS, doors=1)
    world = replace(gap(), route=np.array([[0.0, 0.0], [8.0, 0.0]]))
    simulator = Simulator(settings, start=(2.0, 0.0, 0.0), world=world, has_camera=False)
    assert simulator.clearance_m() == pytest.approx(3 - 0.0225 - 2.0 - 0.8, abs=1e-4)
    drive(simulator, VelocityCommand(0.5), 4.0)
    contact = simulator.contacts[0]
    assert (contact.name, contact.is_by_robot) == ("leaf", True)
    assert simulator.T_world_base[0, 3] + 0.8 < 3.0
    assert simulator.clearance_m() < 0.01


def test_a_leaf_that_swings_is_reported_with_its_speed() -> None:
    doors = LiveDoors(gap(), outline_at(RobotModel(), se3.from_plane(-5, 0, 0)), 1, 4, DoorSettings(rests_s=(1.0, 1.0)))
    swung(doors, se3.from_plane(-5, 0, 0), 1.5)
    place_m, step_s = np.array([3.0, -0.4]), 1e-4
    before, after = (shapely.get_coordinates(doors.places_at(1.3 + s)[0]) for s in (0.0, step_s))
    fastest_m_s = np.hypot(*((after - before) / step_s).T).max()
    speed_m_s = np.hypot(*doors.velocity_at(0, place_m, 1.3))
    assert speed_m_s == pytest.approx(0.9 * fastest_m_s, rel=0.02)
