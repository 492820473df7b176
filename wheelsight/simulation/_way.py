"""The way a simulated robot is to go: along the world's route or by a file, refused where it leads into a wall."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from wheelsight.errors import ConfigError
from wheelsight.geometry import FloatArray, se2
from wheelsight.simulation.drivers import (
    COMMAND_PERIOD_S,
    Driver,
    StopAndTurn,
    follow_route,
    read_manual_velocities,
)
from wheelsight.simulation.settings import SimulationSettings
from wheelsight.simulation.world import World

# A driver strays by so much from the legs; and what turns about its axle sweeps more than its width.
_MARGIN_M = 0.1
_UMBMARK_WORLD = "square"


def route_of(settings: SimulationSettings, world: World) -> FloatArray:
    """The world's waypoints (N, 2) in the order in which the settings want them driven; a loop keeps its first."""
    if not settings.is_reverse:
        return world.route
    return np.concatenate([world.route[:1], world.route[:0:-1]]) if world.is_loop else world.route[::-1].copy()


def driver_of(settings: SimulationSettings, world: World) -> Driver:
    """Who drives. Raises InputError for a file of velocities that cannot be driven."""
    if settings.velocities is not None:
        return read_manual_velocities(settings.velocities)
    route = route_of(settings, world)
    if settings.stops_to_turn:
        laps = np.concatenate([np.tile(route, (settings.laps, 1)), route[: int(world.is_loop)]])
        is_umbmark = settings.plan is None and world.name == _UMBMARK_WORLD
        # UMBmark is driven by the wheels alone: steering by sight would hide their errors. Elsewhere walls are near.
        return StopAndTurn(laps, settings.speed_m_s, is_blind=is_umbmark)
    return follow_route(route, is_loop=world.is_loop, laps=settings.laps, speed_m_s=settings.speed_m_s)


def refuse_walls(settings: SimulationSettings, world: World, driver: Driver, picture: Path | None) -> None:
    """Raises ConfigError where the way ahead leads into something; leaves a picture of it if one is wanted."""
    from wheelsight.simulation.plan import draw_plan
    from wheelsight.simulation.worlds.clearance import find_collision

    way = route_of(settings, world) if settings.velocities is None else _foreseen_way(driver, world)
    is_loop = world.is_loop and settings.velocities is None
    collision = find_collision(world, way, settings.robot.width_m / 2 + _MARGIN_M, is_loop=is_loop)
    if collision is None:
        return
    what = "leaves the floor" if collision.geom is None else f"runs into {collision.geom}"
    problem = f"the way {what} at x = {collision.place[0]:.2f}, y = {collision.place[1]:.2f} m"
    if picture is not None:
        draw_plan(world, picture, route=way, mark=collision.place, is_loop=is_loop)
    raise ConfigError(problem, path=settings.velocities, fix=None if picture is None else f"see {picture}")


def _foreseen_way(driver: Driver, world: World) -> FloatArray:
    """(N, 2) where given velocities lead a robot that obeys at once, in steps of 5 cm or more."""
    (x, y), towards = world.route[0], world.route[1] - world.route[0]
    T = se2.from_parts(x, y, np.arctan2(towards[1], towards[0]))
    way = [world.route[0]]
    stamp_s = 0.0
    while (command := driver.command(stamp_s, np.eye(4))) is not None:
        T = T @ se2.exp(COMMAND_PERIOD_S * np.array([command.v_m_s, 0.0, command.yaw_rate_rad_s]))
        stamp_s += COMMAND_PERIOD_S
        if np.hypot(*(T[:2, 2] - way[-1])) >= 0.05:
            way.append(T[:2, 2].copy())
    return np.array([*way, T[:2, 2] + 1e-6])


def expected_s(settings: SimulationSettings, world: World) -> float | None:
    """About how long the drive will take, or None where nothing tells."""
    if settings.velocities is not None:
        return settings.duration_s
    route = route_of(settings, world)
    lap = np.concatenate([route, route[: int(world.is_loop)]])
    corners_s = len(lap) * (4.0 if settings.stops_to_turn else 1.0)
    way_s = np.hypot(*np.diff(lap, axis=0).T).sum() / settings.speed_m_s
    return min(settings.laps * float(way_s + corners_s), settings.duration_s or np.inf)
