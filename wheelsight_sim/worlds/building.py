"""Building: collects what stands in a world, and writes it as one MJCF document.

Walls are drawn as lines with the free side on the left, as one walks round a room anticlockwise or round a core
clockwise; what hangs on a wall is then placed by its distance along the wall. Boxes have their x axis along the
wall, y out of it and z up. `materials.yaml` says how materials look.
"""

from __future__ import annotations

import math
import xml.etree.ElementTree as ET
import zlib
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cache
from itertools import chain, count
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from wheelsight.core.areas import Area, AreaMap
from wheelsight.core.errors import ConfigError
from wheelsight.core.geometry import FloatArray
from wheelsight.core.inputs import read_yaml
from wheelsight_sim.world import Leaf, Surface, World

CEILING_M = 2.8
WALL_THICKNESS_M = 0.2
LEAF_M, LEAF_BOTTOM_M, LEAF_TOP_M = 0.045, 0.005, 2.08
_PANE_M = 0.03
_COVERING_M = 0.003  # over the floor, so that no renderer takes one for the other
_FLUSH_M = 0.001  # how far a wall ends short of a corner, so that no two faces lie in one plane
_SQUARE_RAD = 0.05
POSTERS = tuple(f"poster_{colour}" for colour in ("red", "blue", "green", "yellow", "dark"))
_POSTER_SIZES_M = ((0.59, 0.84), (0.84, 1.19), (0.84, 0.59), (1.19, 0.84))


class Opening(NamedTuple):
    """A hole in a wall: a doorway, or a window with a pane.

    Attributes:
        at_m: its middle, from the wall's start.
        width_m: along the wall.
        sill_m, head_m: where it begins and ends over the floor.
        pane: the material that closes it at its far side, or None.
    """

    at_m: float
    width_m: float = 1.0
    sill_m: float = 0.0
    head_m: float = 2.1
    pane: str | None = None


@dataclass(frozen=True, slots=True)
class Face:
    """The free side of a wall, from start to end, on their left."""

    name: str
    start: tuple[float, float]
    end: tuple[float, float]

    @property
    def length_m(self) -> float:
        """From start to end."""
        return math.dist(self.start, self.end)

    @property
    def yaw_rad(self) -> float:
        """Of the direction from start to end."""
        return math.atan2(self.end[1] - self.start[1], self.end[0] - self.start[0])

    def spot(self, at_m: float, out_m: float = 0.0) -> Spot:
        """The place `at_m` along the wall and `out_m` away from it."""
        return Spot(*self.start, self.yaw_rad).offset(at_m, out_m)


class _WallPart(NamedTuple):
    """A part of a wall between two places along it; of a window's material where `pane` names one."""

    kind: str
    begin_m: float
    end_m: float
    bottom_m: float
    top_m: float
    pane: str | None = None


def _pieces(openings: Sequence[Opening], begin_m: float, end_m: float) -> Iterator[_WallPart]:
    """Piers between the openings; below and above these sills and lintels; windows in a row share theirs."""
    heights = {(opening.sill_m, opening.head_m, opening.pane) for opening in openings}
    is_row = len(heights) == 1 and openings[0].sill_m > 0
    bottom_m, top_m = (openings[0].sill_m, openings[0].head_m) if is_row else (0.0, CEILING_M)
    if is_row:
        yield _WallPart("sill", begin_m, end_m, 0.0, bottom_m)
        yield _WallPart("lintel", begin_m, end_m, top_m, CEILING_M)
        yield from _panes(openings[0], openings[-1])
    at_m = begin_m
    for opening in openings:
        left_m, right_m = opening.at_m - opening.width_m / 2, opening.at_m + opening.width_m / 2
        yield _WallPart("wall", at_m, left_m, bottom_m, top_m)
        at_m = right_m
        if is_row:
            continue
        if opening.sill_m > 0:
            yield _WallPart("sill", left_m, right_m, 0.0, opening.sill_m)
        if opening.head_m < CEILING_M:
            yield _WallPart("lintel", left_m, right_m, opening.head_m, CEILING_M)
        yield from _panes(opening, opening)
    yield _WallPart("wall", at_m, end_m, bottom_m, top_m)


def _panes(first: Opening, last: Opening) -> Iterator[_WallPart]:
    """What closes the openings from the first to the last, if anything."""
    if first.pane is not None:
        begin_m, end_m = first.at_m - first.width_m / 2, last.at_m + last.width_m / 2
        yield _WallPart("pane", begin_m, end_m, first.sill_m, first.head_m, first.pane)


@dataclass(frozen=True, slots=True)
class Spot:
    """A place on the floor and a direction."""

    x_m: float
    y_m: float
    yaw_rad: float = 0.0

    def offset(self, forward_m: float, left_m: float) -> Spot:
        """The place so far ahead and to the left of this one."""
        c, s = math.cos(self.yaw_rad), math.sin(self.yaw_rad)
        return Spot(self.x_m + c * forward_m - s * left_m, self.y_m + s * forward_m + c * left_m, self.yaw_rad)


class Building:
    """A world in the making.

    `rng` places posters, bins and chairs by the seed, and materials come out a little different. Another day has what
    people move elsewhere, and all else where it was.
    """

    def __init__(self, name: str, seed: int, day: int = 0) -> None:
        self.name = name
        self.rng = np.random.default_rng([seed, 2024])
        self._day_rng = np.random.default_rng([seed, 2024, day]) if day else None
        self.faces: dict[str, Face] = {}
        self._seed = seed
        self._geoms: dict[str, dict[str, str]] = {}
        self._surfaces: dict[str, Surface] = {}
        self._leaves: list[Leaf] = []
        self._size_m = (0.0, 0.0, 0.0, 0.0)

    def loose(self, low: float, high: float) -> float:
        """Where between two bounds somebody has left a thing that is easily moved, or how it is turned, on this day."""
        usual = float(self.rng.uniform(low, high))  # drawn on every day, so that what follows stays as it is
        return usual if self._day_rng is None else float(self._day_rng.uniform(low, high))

    def floor_and_ceiling(
        self, floor: str, ceiling: str, size_m: tuple[float, float, float, float], friction: float = 0.9
    ) -> None:
        """The ground at z = 0, which wheels roll on, and the ceiling, one-sided: a viewer looks in from above."""
        self._size_m = size_m
        x_min, y_min, x_max, y_max = size_m
        half = ((x_max - x_min) / 2, (y_max - y_min) / 2, 1.0)
        middle = ((x_min + x_max) / 2, (y_min + y_max) / 2)
        grip = f"{friction:g} 0.005 0.0001"
        self._add("floor", "plane", floor, (*middle, 0), half, is_solid=True, friction=grip)
        self._add("ceiling", "plane", ceiling, (*middle, CEILING_M), half, is_solid=False, quat="0 1 0 0")

    def walls(
        self,
        corners: Sequence[tuple[float, float]],
        edges: Sequence[Sequence[Any]],
        *,
        is_closed: bool = True,
        thickness_m: float = WALL_THICKNESS_M,
    ) -> None:
        """Walls along `corners`, free on the left; an edge is (name, material, *openings) up to the next corner."""
        n = len(corners)
        for k, (name, material, *openings) in enumerate(edges):
            start, end = corners[k], corners[(k + 1) % n]
            has_before, has_after = is_closed or k > 0, is_closed or k + 2 < n
            before_m = _growth(corners[k - 1], start, end, thickness_m) if has_before else 0.0
            after_m = _growth(start, end, corners[(k + 2) % n], thickness_m) if has_after else 0.0
            face = self.faces[name] = Face(name, start, end)
            self._wall(face, material, openings, -thickness_m / 2, thickness_m, (before_m, after_m))

    def partition(
        self,
        name: str,
        material: str,
        start: tuple[float, float],
        end: tuple[float, float],
        openings: Sequence[Sequence[Any]] = (),
        thickness_m: float = 0.12,
    ) -> None:
        """A wall between two rooms, on both sides of its line; faces `name` (on the left) and `name`_back."""
        line = Face(name, start, end)
        self._wall(line, material, openings, 0.0, thickness_m, (0.0, 0.0))
        left, right = line.spot(0, thickness_m / 2), line.spot(line.length_m, -thickness_m / 2)
        far_left, far_right = line.spot(line.length_m, thickness_m / 2), line.spot(0, -thickness_m / 2)
        self.faces[name] = Face(name, (left.x_m, left.y_m), (far_left.x_m, far_left.y_m))
        self.faces[f"{name}_back"] = Face(f"{name}_back", (right.x_m, right.y_m), (far_right.x_m, far_right.y_m))

    def hang(
        self,
        face: str,
        name: str,
        material: str,
        at_m: float,
        width_m: float,
        bottom_m: float,
        top_m: float,
        depth_m: float = 0.02,
        *,
        is_solid: bool = False,
    ) -> None:
        """Something on a wall, its middle `at_m` from the wall's start."""
        spot = self.faces[face].spot(at_m, depth_m / 2)
        self.box(name, material, spot, (width_m, depth_m), bottom_m, top_m, is_solid=is_solid)

    def doors(self, face: str, material: str, *at_m: float, width_m: float = 0.95, height_m: float = 2.08) -> None:
        """Closed doors with their frames, as leaves on the wall."""
        for at in at_m:
            self.hang(face, f"door_{face}", material, at, width_m, 0.0, height_m, 0.03)

    def posters(self, face: str, *stretches: tuple[float, float]) -> None:
        """A poster somewhere on each of the stretches (from, to) along the wall, as the seed has it."""
        for begin, end in stretches:
            width, height = _POSTER_SIZES_M[self.rng.integers(len(_POSTER_SIZES_M))]
            slack = (end - begin - width) / 2
            at = (begin + end) / 2 + (self.rng.uniform(-slack, slack) if slack > 0 else 0.0)
            bottom = self.rng.uniform(1.45, 1.60) - height / 2
            material = POSTERS[self.rng.integers(len(POSTERS))]
            self.hang(face, f"poster_{face}", material, at, min(width, end - begin), bottom, bottom + height, 0.015)

    def cover(self, name: str, material: str, x: tuple[float, float], y: tuple[float, float]) -> None:
        """Carpet or other tiles over a part of the floor; too thin to feel."""
        spot = Spot((x[0] + x[1]) / 2, (y[0] + y[1]) / 2)
        self.box(name, material, spot, (x[1] - x[0], y[1] - y[0]), -0.02, _COVERING_M, is_solid=False)

    def lamps(self, *places: tuple[float, float], along_x: bool = True) -> None:
        """Long lamps under the ceiling."""
        size = (1.2, 0.3) if along_x else (0.3, 1.2)
        for x, y in places:
            self.box("lamp", "lamp", Spot(x, y), size, CEILING_M - 0.06, CEILING_M + 0.02, is_solid=False)

    def box(
        self,
        name: str,
        material: str,
        spot: Spot,
        size_m: tuple[float, float],
        bottom_m: float,
        top_m: float,
        *,
        is_solid: bool = True,
    ) -> None:
        """A box with its middle over `spot`, `size_m` along and across the spot's direction."""
        centre = (spot.x_m, spot.y_m, (bottom_m + top_m) / 2)
        half = (size_m[0] / 2, size_m[1] / 2, (top_m - bottom_m) / 2)
        turn = {} if spot.yaw_rad == 0 else {"euler": f"0 0 {spot.yaw_rad:.6g}"}
        self._add(name, "box", material, centre, half, is_solid=is_solid, **turn)

    def leaf(
        self,
        name: str,
        material: str,
        middle: Spot,
        width_m: float,
        hinge_m: tuple[float, float] | None,
        turn_rad: float,
    ) -> None:
        """A door's leaf with its middle over a spot, along the spot's direction; it swings where it has a hinge."""
        name = self._free_name(name)
        self.box(name, material, middle, (width_m, LEAF_M), LEAF_BOTTOM_M, LEAF_TOP_M)
        if hinge_m is not None:
            self._leaves.append(Leaf(name, hinge_m, turn_rad))

    def cylinder(self, name: str, material: str, spot: Spot, radius_m: float, bottom_m: float, top_m: float) -> None:
        """An upright cylinder, solid."""
        centre = (spot.x_m, spot.y_m, (bottom_m + top_m) / 2)
        self._add(name, "cylinder", material, centre, (radius_m, (top_m - bottom_m) / 2), is_solid=True)

    # Furniture from boxes and cylinders, each piece around a spot that it faces along y. A piece that stands at a wall
    # takes `Face.spot(at_m)`: its back is at the wall and its front looks out of it.

    def table(
        self, name: str, spot: Spot, size_m: tuple[float, float], height_m: float = 0.74, top: str = "wood_light"
    ) -> None:
        """A board between two sides, its middle at the spot."""
        length, width = size_m
        self.box(f"{name}_top", top, spot, size_m, height_m - 0.04, height_m)
        for end in (-1, 1):
            side = spot.offset(end * (length / 2 - 0.08), 0)
            self.box(f"{name}_leg", "wood_dark", side, (0.05, width - 0.1), 0.0, height_m - 0.04)

    def four_legged_table(self, name: str, spot: Spot, size_m: tuple[float, float], height_m: float) -> None:
        """A board on four thin legs, its middle at the spot."""
        length, width = size_m
        self.box(f"{name}_top", "wood_light", spot, size_m, height_m - 0.04, height_m)
        for forward in (-1, 1):
            for left in (-1, 1):
                leg = spot.offset(forward * (length / 2 - 0.06), left * (width / 2 - 0.06))
                self.cylinder(f"{name}_leg", "steel", leg, 0.025, 0.0, height_m - 0.04)

    def chair(self, name: str, spot: Spot, fabric: str = "fabric_blue") -> None:
        """A seat on a foot, with its back behind it."""
        self.box(f"{name}_seat", fabric, spot, (0.44, 0.42), 0.40, 0.47)
        self.box(f"{name}_back", fabric, spot.offset(0, -0.20), (0.42, 0.04), 0.50, 0.88)
        self.box(f"{name}_foot", "plastic_black", spot, (0.34, 0.34), 0.0, 0.40)

    def shelf(
        self, name: str, wall: Spot, width_m: float, height_m: float = 1.9, depth_m: float = 0.3, rows: int = 4
    ) -> None:
        """Books on boards between two sides, at a wall."""
        middle = wall.offset(0, depth_m / 2)
        for side in (-1, 1):
            end = middle.offset(side * (width_m - 0.03) / 2, 0)
            self.box(f"{name}_side", "wood_dark", end, (0.03, depth_m), 0, height_m)
        pitch = height_m / rows
        for row in range(rows):
            self.box(f"{name}_board", "wood_dark", middle, (width_m - 0.06, depth_m), row * pitch, row * pitch + 0.04)
            fill = self.rng.uniform(0.7, 0.95) * (width_m - 0.1)
            shift = self.rng.uniform(-1, 1) * (width_m - 0.08 - fill) / 2
            books = wall.offset(shift, depth_m * 0.42)
            bottom, top = row * pitch + 0.04, (row + self.rng.uniform(0.68, 0.86)) * pitch
            self.box(f"{name}_books", "books", books, (fill, depth_m * 0.8), bottom, top)

    def sofa(self, name: str, wall: Spot, width_m: float = 2.0, fabric: str = "fabric_dark") -> None:
        """Seat, back and two arms, at a wall."""
        self.box(f"{name}_seat", fabric, wall.offset(0, 0.48), (width_m - 0.4, 0.80), 0.08, 0.44)
        self.box(f"{name}_back", fabric, wall.offset(0, 0.13), (width_m - 0.4, 0.22), 0.44, 0.86)
        for side in (-1, 1):
            arm = wall.offset(side * (width_m / 2 - 0.1), 0.46)
            self.box(f"{name}_arm", fabric, arm, (0.2, 0.88), 0.05, 0.62)

    def bed(self, name: str, wall: Spot, width_m: float = 1.6) -> None:
        """A mattress on its frame, the headboard at a wall."""
        self.box(f"{name}_headboard", "wood_dark", wall.offset(0, 0.04), (width_m, 0.06), 0.0, 1.0)
        self.box(f"{name}_frame", "wood_dark", wall.offset(0, 1.08), (width_m, 2.0), 0.06, 0.30)
        self.box(f"{name}_mattress", "linen", wall.offset(0, 1.08), (width_m - 0.06, 1.96), 0.30, 0.52)
        for side in (-1, 1):
            pillow = wall.offset(side * width_m / 4, 0.36)
            self.box(f"{name}_pillow", "fabric_beige", pillow, (0.6, 0.4), 0.52, 0.64)

    def bench(self, name: str, wall: Spot, width_m: float = 1.5) -> None:
        """A board on two feet, at a wall."""
        self.box(f"{name}_board", "wood_light", wall.offset(0, 0.24), (width_m, 0.38), 0.40, 0.46)
        for side in (-1, 1):
            foot = wall.offset(side * (width_m / 2 - 0.15), 0.24)
            self.box(f"{name}_foot", "steel", foot, (0.06, 0.34), 0.0, 0.40)

    def desk(self, name: str, wall: Spot) -> None:
        """A table at a wall with a screen on it, and a chair before it."""
        self.table(name, wall.offset(0, 0.4), (1.5, 0.75))
        self.box(f"{name}_screen", "screen", wall.offset(0.1, 0.25), (0.56, 0.04), 0.80, 1.14)
        swivel = self.loose(-0.5, 0.5)
        place = wall.offset(self.loose(-0.2, 0.2), 1.05)
        self.chair(f"{name}_chair", Spot(place.x_m, place.y_m, place.yaw_rad + 3.1416 + swivel), "fabric_dark")

    def plant(self, name: str, spot: Spot, height_m: float = 1.3) -> None:
        """Leaves over a pot."""
        self.cylinder(f"{name}_pot", "clay", spot, 0.19, 0.0, 0.40)
        centre = (spot.x_m, spot.y_m, (0.38 + height_m) / 2)
        self._add(f"{name}_leaves", "ellipsoid", "leaves", centre, (0.30, 0.30, (height_m - 0.38) / 2), is_solid=True)

    def bin_beside(self, face: str, begin_m: float, end_m: float) -> None:
        """A waste bin at a wall, somewhere between two places along it, as the seed has it."""
        spot = self.faces[face].spot(self.loose(begin_m, end_m), 0.2)
        self.cylinder(f"bin_{face}", "plastic_grey", spot, 0.15, 0.0, 0.55)

    def loose_chair(self, name: str, face: str, begin_m: float, end_m: float) -> None:
        """A chair with its back to a wall, not quite straight, somewhere between two places along it."""
        spot = self.faces[face].spot(self.loose(begin_m, end_m), 0.32)
        fabric = ("fabric_red", "fabric_blue", "fabric_dark")[self.rng.integers(3)]
        self.chair(name, Spot(spot.x_m, spot.y_m, spot.yaw_rad + self.loose(-0.25, 0.25)), fabric)

    @property
    def geom_count(self) -> int:
        """How many there are by now."""
        return len(self._geoms)

    def remove_since(self, kept: int) -> None:
        """Remove all but the first `kept` geoms. No door's leaf may be among them."""
        for name in list(self._geoms)[kept:]:
            del self._geoms[name]

    def world(self, description: str, areas: Sequence[Area], route: ArrayLike, *, is_loop: bool) -> World:
        """What was built."""
        waypoints: FloatArray = np.array(route, float)
        waypoints.setflags(write=False)
        surfaces = dict(sorted(self._surfaces.items()))
        x_min, y_min, x_max, y_max = self._size_m
        extent = max(x_max - x_min, y_max - y_min) / 2
        root = ET.Element("mujoco", model=self.name)
        ET.SubElement(root, "compiler", angle="radian")
        middle = _numbers(((x_min + x_max) / 2, (y_min + y_max) / 2, 1.0))
        ET.SubElement(root, "statistic", center=middle, extent=f"{extent:g}")
        visual = ET.SubElement(root, "visual")
        ET.SubElement(visual, "headlight", ambient="0.55 0.55 0.55", diffuse="0.45 0.45 0.45", specular="0.1 0.1 0.1")
        ET.SubElement(visual, "map", znear=f"{0.05 / extent:.6g}", zfar="10")
        ET.SubElement(visual, "global", azimuth="90", elevation="-60", offwidth="1280", offheight="960")
        asset = ET.SubElement(root, "asset")
        for name, surface in surfaces.items():
            colour, shine = _numbers((*surface.rgb, 1.0)), f"{surface.shine:g}"
            ET.SubElement(asset, "material", name=name, rgba=colour, specular=shine, shininess=shine)
        ground = ET.SubElement(root, "worldbody")
        daylight = {"name": "daylight", "type": "directional", "dir": "0.3 0.2 -1", "castshadow": "false"}
        ET.SubElement(ground, "light", daylight, diffuse="0.35 0.35 0.35", specular="0.1 0.1 0.1")
        for name, attributes in self._geoms.items():
            ET.SubElement(ground, "geom", {"name": name, **attributes})
        ET.indent(root)
        mjcf = ET.tostring(root, encoding="unicode") + "\n"
        of = AreaMap(tuple(areas)), waypoints, is_loop, self._size_m, tuple(self._leaves)
        return World(self.name, description, mjcf, surfaces, *of)

    def _wall(
        self,
        face: Face,
        material: str,
        openings: Sequence[Sequence[Any]],
        out_m: float,
        thickness_m: float,
        grow_m: tuple[float, float],
    ) -> None:
        holes = sorted((Opening(*opening) for opening in openings), key=lambda hole: hole.at_m)
        for piece in _pieces(holes, -grow_m[0], face.length_m + grow_m[1]):
            aside_m, thick_m = (0.0, thickness_m) if piece.pane is None else (_PANE_M / 2 - thickness_m / 2, _PANE_M)
            spot = face.spot((piece.begin_m + piece.end_m) / 2, out_m + aside_m)
            size_m = (piece.end_m - piece.begin_m, thick_m)
            self.box(f"{piece.kind}_{face.name}", piece.pane or material, spot, size_m, piece.bottom_m, piece.top_m)

    def _add(
        self,
        name: str,
        kind: str,
        material: str,
        position_m: tuple[float, float, float],
        size_m: tuple[float, ...],
        *,
        is_solid: bool,
        **more: str,
    ) -> None:
        if material not in self._surfaces:
            self._surfaces[material] = painted(material, self._seed)
        touch = "1" if is_solid else "0"
        self._geoms[self._free_name(name)] = {
            "type": kind,
            "material": material,
            "pos": _numbers(position_m),
            "size": _numbers(size_m),
            **more,
            "contype": touch,
            "conaffinity": touch,
        }

    def _free_name(self, name: str) -> str:
        names = chain([name], (f"{name}_{number}" for number in count(2)))
        return next(free for free in names if free not in self._geoms)


def _growth(
    before: tuple[float, float], corner: tuple[float, float], after: tuple[float, float], thickness_m: float
) -> float:
    """How far walls reach beyond a corner: through each other's bodies where it is hollow, just short where it juts."""
    (ax, ay), (bx, by), (cx, cy) = before, corner, after
    sine = (bx - ax) * (cy - by) - (by - ay) * (cx - bx)
    turn = math.atan2(sine, (bx - ax) * (cx - bx) + (by - ay) * (cy - by))
    if turn >= 0:
        return thickness_m * min(math.tan(turn / 2), 1.0)
    # Ends of walls that meet at another angle lie in no plane of the other wall, and a gap would be seen through.
    return -_FLUSH_M if abs(turn + math.pi / 2) < _SQUARE_RAD else 0.0


def _numbers(values: Sequence[float]) -> str:
    return " ".join(f"{value:.6g}" for value in values)


@cache
def palette() -> dict[str, Surface]:
    """The surface of each material."""
    rows = read_yaml(Path(__file__).with_name("materials.yaml"), ConfigError)
    return {
        name: Surface(kind, (rgb[0], rgb[1], rgb[2]), (accent[0], accent[1], accent[2]), *numbers)
        for name, (kind, rgb, accent, *numbers) in rows.items()
    }


def painted(name: str, seed: int) -> Surface:
    """The material `name` of the palette as it came out of its tin for `seed`: colours a few percent off."""
    surface = palette()[name]
    if surface.contrast == 0.0:  # what must show nothing, by any seed the same
        return surface
    rng = np.random.default_rng([seed, zlib.crc32(name.encode())])
    light, tints = rng.uniform(-0.05, 0.05), rng.uniform(-0.025, 0.025, 3)
    factors = 1 + light + tints
    r, g, b = (round(float(min(share * factor, 1.0)), 4) for share, factor in zip(surface.rgb, factors, strict=True))
    return replace(surface, rgb=(r, g, b))
