"""Worlds to drive in: a floor of a building, two homes, a blank corridor and a hall for UMBmark, as MJCF documents.
A floor plan becomes a world, too.

Each built-in world is a YAML file beside this one. Its `steps` are calls of methods of `Building`, in order, with their
arguments; a mapping at the end of the arguments holds keywords.
"""

from __future__ import annotations

import math
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from wheelsight.core.areas import Area
from wheelsight.core.errors import ConfigError
from wheelsight.core.inputs import read_yaml
from wheelsight_sim.settings import FloorPlan, refuse_unknown
from wheelsight_sim.world import World
from wheelsight_sim.worlds.building import Building, Spot
from wheelsight_sim.worlds.floor_plan import build_floor_plan

__all__ = ["FloorPlan", "build_floor_plan", "build_world", "world_names"]

_NAMES = ("floor4", "flat", "studio", "blank", "square")
_read_once = cache(read_yaml)


def world_names() -> tuple[str, ...]:
    """What `build_world` knows."""
    return _NAMES


def build_world(name: str, seed: int = 0, day: int = 0, *, has_leaves: bool = False) -> World:
    """The world of that name.

    Args:
        name: one of `world_names()`.
        seed: of its dressing: which posters hang where, where bins and chairs stand, how paint came out; walls, route
            and areas are the same for all.
        day: another one has chairs and bins elsewhere.
        has_leaves: whether its doorways, where a door fits in, have leaves that can swing.

    Raises:
        ConfigError: there is no such world, or the seed is negative.
    """
    if seed < 0:
        raise ConfigError(f"seed is {seed}", fix="a whole number from 0 on")
    refuse_unknown(name, _NAMES, f"there is no world {name}")
    document = _read_once(Path(__file__).with_name(f"{name}.yaml"), ConfigError)
    building = Building(name, seed, day)
    for step in document["steps"]:
        for verb, arguments in step.items():
            values = [_argument(building, value) for value in arguments]
            more = values.pop() if isinstance(values[-1], dict) else {}
            getattr(building, verb)(*values, **more)
    for leaf in document.get("leaves", ()) if has_leaves else ():
        (x_m, y_m), width_m, turn_rad = leaf["hinge"], leaf["width"], math.radians(leaf["opened_deg"])
        middle = Spot(x_m, y_m, math.radians(leaf["shut_deg"]) + turn_rad).offset(width_m / 2, 0.0)
        building.leaf("leaf", "door_white", middle, width_m, (x_m, y_m), -turn_rad)
    areas = []
    for area in document["areas"]:
        (x_min, x_max), (y_min, y_max) = area["x"], area["y"]
        polygon = np.array([(x_min, y_min), (x_max, y_min), (x_max, y_max), (x_min, y_max)], float)
        x_m, y_m = (sum(area[axis]) / 2 if axis in area["known"] else None for axis in "xy")
        areas.append(Area(area["name"], polygon, x_m, y_m))
    return building.world(document["description"], areas, document["route"], is_loop=document["is_loop"])


def _argument(building: Building, value: Any) -> Any:
    """An argument of a step: mappings stand for places and for what lies loosely, lists for tuples."""
    if isinstance(value, list):
        return tuple(_argument(building, inner) for inner in value)
    if not isinstance(value, dict):
        return value
    if "loose" in value:
        return value.get("near", 0.0) + building.loose(*value["loose"])
    if "face" in value:
        return building.faces[value["face"]].spot(value["at"], value.get("out", 0.0))
    if "x" in value:
        return Spot(*(_argument(building, value.get(name, 0.0)) for name in ("x", "y", "yaw")))
    return value
