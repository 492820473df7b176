"""A world that goes on while a robot is commanded: people walk, doors swing, and who touches the robot is noted."""

from __future__ import annotations

import numpy as np

from wheelsight.errors import ConfigError
from wheelsight.geometry import FloatArray, se3
from wheelsight.simulation.contacts import Bystanders, Contact, Motion
from wheelsight.simulation.frames import Surroundings
from wheelsight.simulation.live_doors import LiveDoors
from wheelsight.simulation.live_passersby import LivePassersby, LivePeopleSettings
from wheelsight.simulation.outline import outline_at
from wheelsight.simulation.settings import SimulationSettings
from wheelsight.simulation.simulate import world_of
from wheelsight.simulation.stepping import SteppedRobot, start_of, ticks_of
from wheelsight.simulation.walking import STEP_S
from wheelsight.simulation.world import World

_LOOK_S = 0.02  # at 1.2 m/s, 24 mm
_DOORS_S = 0.05
_ANEW_S = 1.0  # what rests on something rings, and is one contact


class LiveWorld:
    """What is round a robot.

    Attributes:
        world: without people.
        T_world_start: (4, 4) where the base begins.
        contacts: all so far, each when it began.

    Args:
        settings: world, seed, day, robot, people, doors.
        start: x, y, yaw of the base, or None for the world's own.
        world: in place of the one the settings name.
        people: how they mind the robot.

    Raises:
        ConfigError: a world that cannot be, or a start that touches something.
    """

    def __init__(
        self,
        settings: SimulationSettings,
        start: tuple[float, float, float] | None = None,
        world: World | None = None,
        people: LivePeopleSettings | None = None,
    ) -> None:
        self.world = world or world_of(settings, start)
        self.T_world_start = _start(self.world, start)
        seed, robot = settings.day_seed, settings.robot
        outline = outline_at(robot, self.T_world_start)
        self.doors = LiveDoors(self.world, outline, settings.doors, seed) if settings.doors else None
        count, T_start = settings.passersby, self.T_world_start
        self._people = LivePassersby(self.world, T_start, count, seed, robot, people) if count else None
        self._robot, self.contacts = robot, list[Contact]()
        self._touched_s: dict[str, float] = {}
        self._bystanders = Bystanders(self.world, robot, self._people, self.doors)
        if self.clearance_m(self.T_world_start, 0.0) <= 0:
            place = self.T_world_start[:2, 3].round(2).tolist()
            raise ConfigError(f"the robot cannot begin at {place}: something stands there", fix="begin on free floor")

    @property
    def surroundings(self) -> Surroundings:
        """For whoever renders it."""
        return Surroundings(self.world, self._people, self.doors)

    def clearance_m(self, T_world_base: FloatArray, stamp_s: float) -> float:
        """From a robot's outline to the nearest thing, doors included and people not."""
        return self._bystanders.clearance_m(T_world_base, stamp_s)

    def people_clearance_m(self, T_world_base: FloatArray, stamp_s: float) -> float:
        """From a robot's outline to the nearest person's."""
        return self._bystanders.people_clearance_m(T_world_base, stamp_s)

    def people_at(self, stamp_s: float) -> FloatArray:
        """(N, 2) where people stand at a time of the last second, metres."""
        return np.zeros((0, 2)) if self._people is None else self._people.positions_at(stamp_s)

    def step(self, tick: int, stepped: SteppedRobot) -> None:
        """Go on by a tick of physics: whose turn it is looks at the robot and moves."""
        chair, stamp_s = stepped.chair, stepped.time_s
        motion = Motion(chair.T_world_base, chair.velocity_m_s, chair.yaw_rate_rad_s)
        if self._people is not None and tick % ticks_of(STEP_S) == 0:
            self._people.step(motion.T_world_base, _going_on(motion, STEP_S))
        if self.doors is not None:
            if tick % ticks_of(_DOORS_S) == 0:
                outline = outline_at(self._robot, motion.T_world_base)
                self.doors.step(stamp_s, outline, self.people_at(stamp_s))
            chair.swing(*self.doors.poses_at(stamp_s))
        self._note(self._bystanders.touching_things(motion, chair.touches, stamp_s))
        if tick % ticks_of(_LOOK_S) == 0:
            self._note(self._bystanders.touching_people(motion, stamp_s))

    def _note(self, contacts: list[Contact]) -> None:
        """Keep those that begin now."""
        for contact in contacts:
            if contact.time_s - self._touched_s.get(contact.name, -np.inf) > _ANEW_S:
                self.contacts.append(contact)
            self._touched_s[contact.name] = contact.time_s


def _start(world: World, start: tuple[float, float, float] | None) -> FloatArray:
    if start is None:
        return start_of(world)
    x_min, y_min, x_max, y_max = world.size_m
    if not (np.isfinite(start[2]) and x_min <= start[0] <= x_max and y_min <= start[1] <= y_max):
        raise ConfigError(f"the robot cannot begin at {start}: there is no floor", fix="begin on free floor")
    return se3.from_plane(*start)


def _going_on(motion: Motion, seconds: float) -> FloatArray:
    """T_world_base (4, 4) after so long, if the base goes on as it does."""
    T = motion.T_world_base
    v_base = np.append(motion.velocity_m_s, 0.0) @ T[:3, :3]
    twist = np.array([v_base[0], v_base[1], 0, 0, 0, motion.turn_rad_s])
    return np.asarray(se3.compose(T, se3.exp(seconds * twist)))
