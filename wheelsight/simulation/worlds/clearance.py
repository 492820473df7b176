"""Where a wheelchair can drive: the footprints of what stands in a world, and whether a route keeps clear of them."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise, product

import mujoco
import numpy as np
import shapely
from numpy.typing import ArrayLike

from wheelsight.errors import ConfigError
from wheelsight.geometry import FloatArray
from wheelsight.simulation.world import World

LOWEST_M = 0.05  # what is lower, a wheelchair rolls over
HIGHEST_M = 1.0  # what is higher, it passes under
_CIRCLE_SEGMENTS = 16  # in a quarter
_SPHERE, _CYLINDER, _ELLIPSOID = (
    int(kind)
    for kind in (mujoco.mjtGeom.mjGEOM_SPHERE, mujoco.mjtGeom.mjGEOM_CYLINDER, mujoco.mjtGeom.mjGEOM_ELLIPSOID)
)


@dataclass(frozen=True, eq=False)
class Footprint:
    """A geom seen from above.

    Attributes:
        name, material: of the geom.
        polygon: shapely, metres.
        bottom_m, top_m: between which heights it reaches.
        is_solid: whether a robot can bump into it.
    """

    name: str
    material: str
    polygon: shapely.Polygon
    bottom_m: float
    top_m: float
    is_solid: bool

    @property
    def is_in_the_way(self) -> bool:
        """Whether a wheelchair runs into it: solid, and between what it rolls over and what it passes under."""
        return self.is_solid and self.top_m > LOWEST_M and self.bottom_m < HIGHEST_M


@dataclass(frozen=True, slots=True)
class Collision:
    """Where a route runs into something.

    Attributes:
        leg: from 1; the way from a waypoint to the next.
        start, end: of the leg, metres.
        place: where on the leg the robot first touches, metres.
        geom: what it touches, or None where it leaves the floor.
    """

    leg: int
    start: tuple[float, float]
    end: tuple[float, float]
    place: tuple[float, float]
    geom: str | None

    def __str__(self) -> str:
        (ax, ay), (bx, by) = self.start, self.end
        what = "leaves the floor" if self.geom is None else f"runs into {self.geom}"
        return f"leg {self.leg}, from ({ax:g}, {ay:g}) to ({bx:g}, {by:g}), {what}"


def footprints(world: World) -> tuple[Footprint, ...]:
    """All geoms but planes, in the MJCF's order."""
    model = mujoco.MjModel.from_xml_string(world.mjcf)
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    return tuple(_footprints(model, data))


def obstacles(world: World) -> shapely.Geometry:
    """The union of everything solid between LOWEST_M and HIGHEST_M over the floor, metres."""
    return shapely.union_all([footprint.polygon for footprint in footprints(world) if footprint.is_in_the_way])


def find_collision(
    world: World, route: ArrayLike, half_width_m: float, *, is_loop: bool | None = None
) -> Collision | None:
    """The first place where a disc of `half_width_m` that follows `route` touches something, or None.

    Args:
        world: to drive in.
        route: (N, 2) waypoints, metres.
        half_width_m: of the robot, with whatever margin is wanted.
        is_loop: whether the way leads back to the first waypoint; None for as `world` has it.
    """
    waypoints = _checked(route)
    if is_loop if is_loop is not None else world.is_loop:
        waypoints = np.vstack([waypoints, waypoints[:1]])
    solid = [footprint for footprint in footprints(world) if footprint.is_in_the_way]
    swollen = [footprint.polygon.buffer(half_width_m) for footprint in solid]
    outside = shapely.box(*shapely.MultiPoint(waypoints).bounds).buffer(1.0) - shapely.box(*world.size_m)
    tree = shapely.STRtree([*swollen, outside])
    names = [*[footprint.name for footprint in solid], None]
    for number, (start, end) in enumerate(pairwise(waypoints), 1):
        leg = shapely.LineString([start, end])
        hits = [(_first_touch(leg, tree.geometries[k]), names[k]) for k in sorted(tree.query(leg, "intersects"))]
        if hits:
            along, name = min(hits, key=lambda hit: hit[0])
            place = leg.interpolate(along)
            return Collision(number, _pair(start), _pair(end), (place.x, place.y), name)
    return None


def check_route(world: World, route: ArrayLike, half_width_m: float, *, is_loop: bool | None = None) -> None:
    """Refuse a route that touches something; arguments as of `find_collision`.

    Raises:
        ConfigError: the route has no two waypoints, or names the leg that hits and what it hits.
    """
    collision = find_collision(world, route, half_width_m, is_loop=is_loop)
    if collision is not None:
        raise ConfigError(f"the route's {collision}", fix=f"keep {half_width_m:g} m away from what stands there")


def _checked(route: ArrayLike) -> FloatArray:
    waypoints = np.asarray(route, float)
    if waypoints.ndim != 2 or waypoints.shape[1] != 2 or len(waypoints) < 2:
        raise ConfigError("a route needs two waypoints or more, each x and y")
    if not np.isfinite(waypoints).all():
        raise ConfigError("a waypoint is not a number")
    return waypoints


def _first_touch(leg: shapely.LineString, shape: shapely.Geometry) -> float:
    """How far along `leg` it first meets `shape`, metres."""
    places = shapely.points(shapely.get_coordinates(leg.intersection(shape)))
    return float(np.min(shapely.line_locate_point(leg, places)))


def _pair(xy: FloatArray) -> tuple[float, float]:
    return float(xy[0]), float(xy[1])


def _footprints(model: mujoco.MjModel, data: mujoco.MjData) -> Iterator[Footprint]:
    for k in range(model.ngeom):
        if model.geom_type[k] == mujoco.mjtGeom.mjGEOM_PLANE:
            continue
        R, middle = data.geom_xmat[k].reshape(3, 3), data.geom_xpos[k]
        centre, half = model.geom_aabb[k, :3], model.geom_aabb[k, 3:]
        corners = middle + (centre + half * np.array(list(product((-1, 1), repeat=3)))) @ R.T
        is_upright_round = int(model.geom_type[k]) in (_SPHERE, _CYLINDER, _ELLIPSOID) and abs(R[2, 2]) > 0.999
        if is_upright_round:
            polygon = shapely.Point(middle[:2]).buffer(max(half[:2]), _CIRCLE_SEGMENTS)
        else:
            polygon = shapely.MultiPoint(corners[:, :2]).convex_hull
        yield Footprint(
            name=model.geom(k).name,
            material=model.mat(int(model.geom_matid[k])).name,
            polygon=polygon,
            bottom_m=float(corners[:, 2].min()),
            top_m=float(corners[:, 2].max()),
            is_solid=bool(model.geom_contype[k] or model.geom_conaffinity[k]),
        )
