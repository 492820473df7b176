"""Doors in doorways: lintels, casings, and leaves that stand open or are closed."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import shapely

from wheelsight.simulation.worlds._building import CEILING_M, LEAF_M, LEAF_TOP_M, Building, Spot
from wheelsight.simulation.worlds.floor_plan._doorways import Doorway

_CASING_M, _PROUD_M = 0.07, 0.015
_SHARE_CLOSED = 0.5
# Doors are pushed open to about these angles.
_OPEN_DEG = (88.0, 110.0)
# Of one that is shut in the plan: no more, as its hinge is at the wall's face and the leaf deeper in it.
_SWUNG_RAD = math.radians(88.0)
MATERIALS = ("door_oak", "door_white", "door_blue", "door_fire")


@dataclass(frozen=True, slots=True)
class Door:
    """How a doorway is furnished.

    Attributes:
        doorway: the gap.
        leaf: (x, y, yaw) of its middle in `map`, metres and radians; None where it has been taken off.
        is_closed: whether nobody can go through.
        hinge: (x, y) that the leaf turns about when it swings, metres; None where there is no room to.
        turn_rad: how far it swings from where it is, anticlockwise.
    """

    doorway: Doorway
    leaf: tuple[float, float, float] | None
    is_closed: bool
    hinge: tuple[float, float] | None = None
    turn_rad: float = 0.0

    @property
    def footprint(self) -> shapely.Geometry:
        """Of the leaf, metres."""
        if self.leaf is None:
            return shapely.Polygon()
        x_m, y_m, yaw_rad = self.leaf
        half = self.doorway.width_m / 2
        along = half * math.cos(yaw_rad), half * math.sin(yaw_rad)
        line = shapely.LineString([(x_m - along[0], y_m - along[1]), (x_m + along[0], y_m + along[1])])
        return line.buffer(LEAF_M / 2, cap_style="flat")


def choose_door(doorway: Doorway, way: shapely.Geometry, floor: shapely.Geometry, rng: np.random.Generator) -> Door:
    """A door by seed: closed only where nobody drives through, else open to where its leaf is in nobody's way.

    Args:
        doorway: the gap.
        way: what the robot sweeps.
        floor: that is free.
        rng: decides.
    """
    gap = shapely.LineString([doorway.left, doorway.right])
    wants_closed = rng.random() < _SHARE_CLOSED
    angle_rad = math.radians(rng.uniform(*_OPEN_DEG))
    hinges = rng.permutation(4).tolist()
    if wants_closed and not shapely.intersects(gap, way):
        return _closed(doorway, floor)
    for hinge in hinges:
        door = _open(doorway, hinge % 2 == 0, 1 if hinge < 2 else -1, angle_rad)
        is_clear = not shapely.intersects(door.footprint, way)
        if is_clear and shapely.covers(floor, door.footprint):
            return door
    return Door(doorway, None, is_closed=False)


def _open(doorway: Doorway, is_left: bool, side: int, angle_rad: float) -> Door:
    """A door whose leaf hangs on a jamb and is open to a side of the wall."""
    jamb = doorway.left if is_left else doorway.right
    yaw_rad = doorway.yaw_rad if is_left else doorway.yaw_rad + math.pi
    turn = angle_rad if (side > 0) == is_left else -angle_rad
    out_m = doorway.thickness_m / 2 + LEAF_M
    half = doorway.width_m / 2
    hinge = jamb[0] + side * out_m * float(doorway.onward[0]), jamb[1] + side * out_m * float(doorway.onward[1])
    x_m, y_m = hinge[0] + half * math.cos(yaw_rad + turn), hinge[1] + half * math.sin(yaw_rad + turn)
    return Door(doorway, (x_m, y_m, yaw_rad + turn), False, hinge, -turn)


def _closed(doorway: Doorway, floor: shapely.Geometry) -> Door:
    """A shut door; it swings to where its leaf stands on free floor, if there is such a side."""
    leaf = (*doorway.middle, doorway.yaw_rad)
    for is_left, side in ((True, 1), (False, 1), (True, -1), (False, -1)):
        opened = _open(doorway, is_left, side, _SWUNG_RAD)
        if shapely.covers(floor, opened.footprint):
            jamb, out_m = doorway.left if is_left else doorway.right, side * doorway.thickness_m / 2
            hinge = jamb[0] + out_m * float(doorway.onward[0]), jamb[1] + out_m * float(doorway.onward[1])
            return Door(doorway, leaf, True, hinge, -opened.turn_rad)
    return Door(doorway, leaf, is_closed=True)


def build_door(building: Building, name: str, door: Door, wall: str, material: str) -> None:
    """Put a door into its gap: what is over it of the material `wall`, the rest of `material`."""
    doorway = door.doorway
    middle = Spot(*doorway.middle, doorway.yaw_rad)
    width, deep = doorway.width_m, doorway.thickness_m
    building.box(f"lintel_{name}", wall, middle, (width + 0.04, deep + 0.004), LEAF_TOP_M, CEILING_M)
    for side in (-1, 1):
        casing = middle.offset(side * ((width + _CASING_M) / 2 - 0.004), 0.0)
        size_m = (_CASING_M, deep + 2 * _PROUD_M)
        building.box(f"casing_{name}", material, casing, size_m, 0.0, LEAF_TOP_M + _CASING_M, is_solid=False)
    head = (width, deep + 2 * _PROUD_M)
    building.box(f"casing_{name}", material, middle, head, LEAF_TOP_M, LEAF_TOP_M + _CASING_M, is_solid=False)
    if door.leaf is not None:
        x_m, y_m, yaw_rad = door.leaf
        building.leaf(f"leaf_{name}", material, Spot(x_m, y_m, yaw_rad), width, door.hinge, door.turn_rad)
