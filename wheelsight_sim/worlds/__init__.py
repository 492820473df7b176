"""Worlds to drive in: a floor of a building, two homes, a blank corridor and a hall for UMBmark, as MJCF documents.
A floor plan becomes a world, too.
"""

from __future__ import annotations

from difflib import get_close_matches

from wheelsight.core.errors import ConfigError
from wheelsight_sim.settings import FloorPlan
from wheelsight_sim.world import World
from wheelsight_sim.worlds.floor4 import build_floor4
from wheelsight_sim.worlds.floor_plan import build_floor_plan
from wheelsight_sim.worlds.small_worlds import build_blank, build_flat, build_square, build_studio

__all__ = ["FloorPlan", "build_floor_plan", "build_world", "world_names"]

_BUILDERS = {
    "floor4": build_floor4,
    "flat": build_flat,
    "studio": build_studio,
    "blank": build_blank,
    "square": build_square,
}
_WITH_LEAVES = {"flat": build_flat}


def world_names() -> tuple[str, ...]:
    """What `build_world` knows."""
    return tuple(_BUILDERS)


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
    builder = _BUILDERS.get(name)
    if builder is None:
        near = get_close_matches(name, world_names(), n=1)
        hint = f"did you mean {near[0]}? " if near else ""
        raise ConfigError(f"there is no world {name}", fix=f"{hint}known: {', '.join(world_names())}")
    if has_leaves and name in _WITH_LEAVES:
        return _WITH_LEAVES[name](seed, day, has_leaves=True)
    return builder(seed, day)
