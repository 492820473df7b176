"""Worlds of boxes: a hall of one's own size, and things put into a world that was made without them."""

from __future__ import annotations

import math
import xml.etree.ElementTree as ET
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from wheelsight.core.areas import AreaMap
from wheelsight.core.geometry import FloatArray
from wheelsight_sim import Surface, World

CEILING_M = 2.8
_THICK_M = 0.2
_PANEL_M = 1.3
_STREAM = 0xB0C5

_FLOOR = Surface("tiles", (0.52, 0.51, 0.49), (0.34, 0.34, 0.33), 0.40, 0.55, 0.50, 0.20)
_CEILING = Surface("ceiling", (0.84, 0.84, 0.82), (0.56, 0.56, 0.55), 0.60, 0.50, 0.82)
# Reflectances as of paint, paper, wood and cloth in a building; none of them swallows a depth camera's light.
_LOOKS = (
    Surface("plaster", (0.80, 0.74, 0.61), (0.70, 0.64, 0.52), 0.6, 0.30, 0.76),
    Surface("wood", (0.50, 0.35, 0.22), (0.34, 0.22, 0.13), 0.16, 0.55, 0.55, 0.08),
    Surface("tiles", (0.62, 0.36, 0.28), (0.72, 0.68, 0.62), 0.20, 0.60, 0.52),
    Surface("poster", (0.85, 0.82, 0.76), (0.68, 0.14, 0.12), 0.60, 0.90, 0.70, 0.10),
    Surface("poster", (0.80, 0.83, 0.86), (0.10, 0.24, 0.55), 0.45, 0.90, 0.70, 0.10),
    Surface("books", (0.46, 0.24, 0.20), (0.84, 0.76, 0.60), 0.06, 0.90, 0.50),
    Surface("notice_board", (0.60, 0.43, 0.27), (0.88, 0.87, 0.82), 0.22, 0.90, 0.58),
    Surface("fabric", (0.30, 0.36, 0.50), (0.62, 0.66, 0.72), 0.10, 0.60, 0.45),
)


@dataclass(frozen=True, slots=True)
class Box:
    """Upright on the floor, along the axes of the world but for a turn.

    Attributes:
        x_m, y_m: its middle.
        length_m, width_m, height_m: along x, along y, and up.
        yaw_rad: its turn.
    """

    x_m: float
    y_m: float
    length_m: float
    width_m: float
    height_m: float
    yaw_rad: float = 0.0

    @property
    def corners_m(self) -> FloatArray:
        """(4, 2) on the floor."""
        half = np.array([(-1, -1), (1, -1), (1, 1), (-1, 1)]) * (self.length_m / 2, self.width_m / 2)
        c, s = math.cos(self.yaw_rad), math.sin(self.yaw_rad)
        return np.asarray(half @ np.array([[c, s], [-s, c]]) + (self.x_m, self.y_m))


def hall(name: str, size_m: tuple[float, float, float, float], boxes: Sequence[Box], seed: int) -> World:
    """A room with walls round it, of which every panel looks otherwise, and boxes in it.

    Args:
        name: of the world.
        size_m: x_min, y_min, x_max, y_max of the free floor.
        boxes: what stands there.
        seed: of how it all looks.
    """
    x_min, y_min, x_max, y_max = size_m
    middle, half = ((x_min + x_max) / 2, (y_min + y_max) / 2), ((x_max - x_min) / 2 + 1, (y_max - y_min) / 2 + 1)
    root = ET.Element("mujoco")
    assets, body = ET.SubElement(root, "asset"), ET.SubElement(root, "worldbody")
    for material in ("floor", "ceiling"):
        ET.SubElement(assets, "material", name=material, rgba="0.5 0.5 0.5 1")
    plane = {"type": "plane", "size": f"{half[0]:.6g} {half[1]:.6g} 1"}
    at = f"{middle[0]:.6g} {middle[1]:.6g}"
    ground = {"name": "floor", "material": "floor", "pos": f"{at} 0", "friction": "0.9 0.005 0.0001"}
    above = {"name": "ceiling", "material": "ceiling", "pos": f"{at} {CEILING_M}", "quat": "0 1 0 0"}
    ET.SubElement(body, "geom", plane | ground)
    ET.SubElement(body, "geom", plane | above | {"contype": "0", "conaffinity": "0"})
    surfaces = {"floor": _FLOOR, "ceiling": _CEILING}
    route = np.array([[x_min + 1, middle[1]], [x_max - 1, middle[1]]])
    size = (x_min - 1, y_min - 1, x_max + 1, y_max + 1)
    empty = World(name, "a hall of boxes", ET.tostring(root, "unicode"), surfaces, AreaMap(), route, False, size)
    return with_boxes(empty, [*_panels(size_m), *boxes], seed)


def with_boxes(world: World, boxes: Sequence[Box], seed: int) -> World:
    """The same with boxes; each gets one of some looks, a little lighter or darker than others of that look."""
    root, rng, surfaces = ET.fromstring(world.mjcf), np.random.default_rng([seed, _STREAM]), dict(world.surfaces)
    assets, body = _part(root, "asset"), _part(root, "worldbody")
    for number, box in enumerate(boxes):
        name = f"box{number}"
        surfaces[name] = _shaded(_LOOKS[rng.integers(len(_LOOKS))], float(rng.uniform(0.8, 1.15)))
        ET.SubElement(assets, "material", name=name, rgba="0.5 0.5 0.5 1")
        half = f"{box.length_m / 2:.6g} {box.width_m / 2:.6g} {box.height_m / 2:.6g}"
        place = {"pos": f"{box.x_m:.6g} {box.y_m:.6g} {box.height_m / 2:.6g}", "euler": _turn(root, box.yaw_rad)}
        ET.SubElement(body, "geom", place | {"name": name, "type": "box", "material": name, "size": half})
    return replace(world, mjcf=ET.tostring(root, "unicode"), surfaces=surfaces)


def with_pillars(world: World, centres_m: FloatArray, radius_m: float, height_m: float, seed: int) -> World:
    """The same with upright cylinders at (N, 2); each has one of the looks."""
    root, rng, surfaces = ET.fromstring(world.mjcf), np.random.default_rng([seed, _STREAM, 1]), dict(world.surfaces)
    assets, body = _part(root, "asset"), _part(root, "worldbody")
    for number, look in enumerate(_LOOKS):
        surfaces[f"pillar{number}"] = look
        ET.SubElement(assets, "material", name=f"pillar{number}", rgba="0.5 0.5 0.5 1")
    for number, (x_m, y_m) in enumerate(centres_m.tolist()):
        material, size = f"pillar{rng.integers(len(_LOOKS))}", f"{radius_m:.6g} {height_m / 2:.6g}"
        place = {"pos": f"{x_m:.6g} {y_m:.6g} {height_m / 2:.6g}", "size": size}
        ET.SubElement(body, "geom", place | {"name": f"cylinder{number}", "type": "cylinder", "material": material})
    return replace(world, mjcf=ET.tostring(root, "unicode"), surfaces=surfaces)


def _panels(size_m: tuple[float, float, float, float]) -> list[Box]:
    """Walls, in panels."""
    x_min, y_min, x_max, y_max = size_m
    out, panels = _THICK_M / 2, []
    for low, high in pairwise(np.linspace(x_min, x_max, 1 + math.ceil((x_max - x_min) / _PANEL_M))):
        for y in (y_min - out, y_max + out):
            panels.append(Box(float(low + high) / 2, y, float(high - low), _THICK_M, CEILING_M))
    for low, high in pairwise(np.linspace(y_min, y_max, 1 + math.ceil((y_max - y_min) / _PANEL_M))):
        for x in (x_min - out, x_max + out):
            panels.append(Box(x, float(low + high) / 2, _THICK_M, float(high - low), CEILING_M))
    return panels


def _shaded(look: Surface, share: float) -> Surface:
    red, green, blue = (min(share * value, 0.95) for value in look.rgb)
    return replace(look, rgb=(red, green, blue))


def _turn(root: ET.Element, yaw_rad: float) -> str:
    """In the document's own angles: MJCF's are degrees where it says nothing."""
    compiler = root.find("compiler")
    is_radian = compiler is not None and compiler.get("angle") == "radian"
    return f"0 0 {yaw_rad if is_radian else math.degrees(yaw_rad):.9g}"


def _part(root: ET.Element, name: str) -> ET.Element:
    found = root.find(name)
    return ET.SubElement(root, name) if found is None else found
