"""How near a robot is to things and people, and what it touches: for judging, not for the robot."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import shapely

from wheelsight.geometry import FloatArray
from wheelsight.simulation._chair import Touch
from wheelsight.simulation.live_doors import LiveDoors
from wheelsight.simulation.live_passersby import LivePassersby
from wheelsight.simulation.outline import outline_at
from wheelsight.simulation.robot import Robot
from wheelsight.simulation.walking import RADIUS_M
from wheelsight.simulation.world import World

_STANDS_M_S = 0.02  # a rider who fidgets moves no point of a chair that stands by more than 0.0014


@dataclass(frozen=True, slots=True)
class Contact:
    """The robot and something else came to touch.

    Attributes:
        time_s: when.
        name: what: a geom of the world, or `passerby` and a number.
        place_m: (x, y) where.
        robot_m_s: how fast the robot's outline moved towards it there.
        other_m_s: how fast it moved towards the robot; 0 for what stands.
    """

    time_s: float
    name: str
    place_m: tuple[float, float]
    robot_m_s: float
    other_m_s: float

    @property
    def is_by_robot(self) -> bool:
        """Whether the robot drove into it; what comes at a robot that stands or goes away has done it itself."""
        return self.robot_m_s > _STANDS_M_S or self.other_m_s < _STANDS_M_S


@dataclass(frozen=True, slots=True, eq=False)
class Motion:
    """Of a base: T_world_base (4, 4), velocity (2,) in the world in m/s, and yaw rate in rad/s."""

    T_world_base: FloatArray
    velocity_m_s: FloatArray
    turn_rad_s: float

    def velocity_at(self, place_m: FloatArray) -> FloatArray:
        """(2,) of the robot's body at a place (2,) of the world."""
        x, y = place_m - self.T_world_base[:2, 3]
        return np.asarray(self.velocity_m_s + self.turn_rad_s * np.array([-y, x]))


class Bystanders:
    """All that a robot can bump into.

    Args:
        world: what stands, between what a wheelchair rolls over and what it passes under.
        robot: whose outline it is.
        people: who walks, or None.
        doors: which swing, or None.
    """

    def __init__(
        self, world: World, robot: Robot, people: LivePassersby | None = None, doors: LiveDoors | None = None
    ) -> None:
        from wheelsight.simulation.worlds.clearance import footprints

        self._robot, self._people, self._doors = robot, people, doors
        moving = set() if doors is None else {leaf.geom for leaf in doors.leaves}
        things = [thing for thing in footprints(world) if thing.is_in_the_way and thing.name not in moving]
        self._tree = shapely.STRtree([thing.polygon for thing in things])

    def clearance_m(self, T_world_base: FloatArray, stamp_s: float) -> float:
        """From the robot's outline to the nearest thing, doors included and people not; infinite where nothing is."""
        outline = outline_at(self._robot, T_world_base)
        leaves = [] if self._doors is None else self._doors.places_at(stamp_s)
        distances = [float(outline.distance(leaf)) for leaf in leaves]
        if len(self._tree.geometries):
            distances.append(float(outline.distance(self._tree.geometries[self._tree.nearest(outline)])))
        return min(distances, default=np.inf)

    def people_clearance_m(self, T_world_base: FloatArray, stamp_s: float) -> float:
        """From the robot's outline to the nearest person's; infinite where there is nobody."""
        if self._people is None:
            return np.inf
        outline = outline_at(self._robot, T_world_base)
        axes = shapely.points(self._people.positions_at(stamp_s))
        return max(float(shapely.distance(outline, axes).min()) - RADIUS_M, 0.0)

    def touching_things(self, motion: Motion, touches: list[Touch], stamp_s: float) -> list[Contact]:
        """Contacts with what physics says that the hull touches."""
        leaves = () if self._doors is None else self._doors.leaves
        index_of = {leaf.geom: index for index, leaf in enumerate(leaves)}
        found = []
        for touch in touches:
            velocity = np.zeros(2)
            if self._doors is not None and touch.name in index_of:
                velocity = self._doors.velocity_at(index_of[touch.name], touch.place_m, stamp_s)
            found.append(_contact(stamp_s, touch.name, touch.place_m, motion, velocity, touch.towards))
        return found

    def touching_people(self, motion: Motion, stamp_s: float) -> list[Contact]:
        """Contacts with people, of whom physics knows nothing."""
        if self._people is None:
            return []
        outline = outline_at(self._robot, motion.T_world_base)
        found = []
        axes, velocities = self._people.positions_at(stamp_s), self._people.velocities_at(stamp_s)
        for i, (axis, velocity) in enumerate(zip(axes, velocities, strict=True)):
            line = shapely.shortest_line(outline, shapely.Point(axis))
            if line.length <= RADIUS_M:
                place_m = np.asarray(line.coords[0], float)
                is_inside = line.length < 1e-6
                towards = axis - (motion.T_world_base[:2, 3] if is_inside else place_m)
                found.append(_contact(stamp_s, f"passerby{i}", place_m, motion, velocity, towards))
        return found


def _contact(
    stamp_s: float, name: str, place_m: FloatArray, motion: Motion, velocity_m_s: FloatArray, towards: FloatArray
) -> Contact:
    unit = towards / max(float(np.hypot(*towards)), 1e-9)
    robot_m_s, other_m_s = float(motion.velocity_at(place_m) @ unit), -float(velocity_m_s @ unit)
    return Contact(stamp_s, name, (float(place_m[0]), float(place_m[1])), robot_m_s, other_m_s + 0.0)
