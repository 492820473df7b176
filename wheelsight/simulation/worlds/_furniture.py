"""Furniture: tables, chairs, shelves and the like, from boxes and cylinders, each around a spot that it faces along y.

A piece that stands at a wall takes `Face.spot(at_m)`: its back is at the wall and its front looks out of it.
"""

from __future__ import annotations

from wheelsight.simulation.worlds._building import Building, Spot


def table(
    building: Building,
    name: str,
    spot: Spot,
    size_m: tuple[float, float],
    height_m: float = 0.74,
    top: str = "wood_light",
) -> None:
    """A board between two sides, its middle at the spot."""
    length, width = size_m
    building.box(f"{name}_top", top, spot, size_m, height_m - 0.04, height_m)
    for end in (-1, 1):
        side = spot.offset(end * (length / 2 - 0.08), 0)
        building.box(f"{name}_leg", "wood_dark", side, (0.05, width - 0.1), 0.0, height_m - 0.04)


def four_legged_table(building: Building, name: str, spot: Spot, size_m: tuple[float, float], height_m: float) -> None:
    """A board on four thin legs, its middle at the spot."""
    length, width = size_m
    building.box(f"{name}_top", "wood_light", spot, size_m, height_m - 0.04, height_m)
    for forward in (-1, 1):
        for left in (-1, 1):
            leg = spot.offset(forward * (length / 2 - 0.06), left * (width / 2 - 0.06))
            building.cylinder(f"{name}_leg", "steel", leg, 0.025, 0.0, height_m - 0.04)


def chair(building: Building, name: str, spot: Spot, fabric: str = "fabric_blue") -> None:
    """A seat on a foot, with its back behind it."""
    building.box(f"{name}_seat", fabric, spot, (0.44, 0.42), 0.40, 0.47)
    building.box(f"{name}_back", fabric, spot.offset(0, -0.20), (0.42, 0.04), 0.50, 0.88)
    building.box(f"{name}_foot", "plastic_black", spot, (0.34, 0.34), 0.0, 0.40)


def shelf(
    building: Building,
    name: str,
    wall: Spot,
    width_m: float,
    height_m: float = 1.9,
    depth_m: float = 0.3,
    rows: int = 4,
) -> None:
    """Books on boards between two sides, at a wall."""
    middle = wall.offset(0, depth_m / 2)
    for side in (-1, 1):
        building.box(
            f"{name}_side", "wood_dark", middle.offset(side * (width_m - 0.03) / 2, 0), (0.03, depth_m), 0, height_m
        )
    pitch = height_m / rows
    for row in range(rows):
        building.box(f"{name}_board", "wood_dark", middle, (width_m - 0.06, depth_m), row * pitch, row * pitch + 0.04)
        fill = building.rng.uniform(0.7, 0.95) * (width_m - 0.1)
        shift = building.rng.uniform(-1, 1) * (width_m - 0.08 - fill) / 2
        books = wall.offset(shift, depth_m * 0.42)
        bottom, top = row * pitch + 0.04, (row + building.rng.uniform(0.68, 0.86)) * pitch
        building.box(f"{name}_books", "books", books, (fill, depth_m * 0.8), bottom, top)


def sofa(building: Building, name: str, wall: Spot, width_m: float = 2.0, fabric: str = "fabric_dark") -> None:
    """Seat, back and two arms, at a wall."""
    building.box(f"{name}_seat", fabric, wall.offset(0, 0.48), (width_m - 0.4, 0.80), 0.08, 0.44)
    building.box(f"{name}_back", fabric, wall.offset(0, 0.13), (width_m - 0.4, 0.22), 0.44, 0.86)
    for side in (-1, 1):
        arm = wall.offset(side * (width_m / 2 - 0.1), 0.46)
        building.box(f"{name}_arm", fabric, arm, (0.2, 0.88), 0.05, 0.62)


def bed(building: Building, name: str, wall: Spot, width_m: float = 1.6) -> None:
    """A mattress on its frame, the headboard at a wall."""
    building.box(f"{name}_headboard", "wood_dark", wall.offset(0, 0.04), (width_m, 0.06), 0.0, 1.0)
    building.box(f"{name}_frame", "wood_dark", wall.offset(0, 1.08), (width_m, 2.0), 0.06, 0.30)
    building.box(f"{name}_mattress", "linen", wall.offset(0, 1.08), (width_m - 0.06, 1.96), 0.30, 0.52)
    for side in (-1, 1):
        pillow = wall.offset(side * width_m / 4, 0.36)
        building.box(f"{name}_pillow", "fabric_beige", pillow, (0.6, 0.4), 0.52, 0.64)


def bench(building: Building, name: str, wall: Spot, width_m: float = 1.5) -> None:
    """A board on two feet, at a wall."""
    building.box(f"{name}_board", "wood_light", wall.offset(0, 0.24), (width_m, 0.38), 0.40, 0.46)
    for side in (-1, 1):
        foot = wall.offset(side * (width_m / 2 - 0.15), 0.24)
        building.box(f"{name}_foot", "steel", foot, (0.06, 0.34), 0.0, 0.40)


def desk(building: Building, name: str, wall: Spot) -> None:
    """A table at a wall with a screen on it, and a chair before it."""
    table(building, name, wall.offset(0, 0.4), (1.5, 0.75))
    building.box(f"{name}_screen", "screen", wall.offset(0.1, 0.25), (0.56, 0.04), 0.80, 1.14)
    swivel = building.loose(-0.5, 0.5)
    place = wall.offset(building.loose(-0.2, 0.2), 1.05)
    chair(building, f"{name}_chair", Spot(place.x_m, place.y_m, place.yaw_rad + 3.1416 + swivel), "fabric_dark")


def plant(building: Building, name: str, spot: Spot, height_m: float = 1.3) -> None:
    """Leaves over a pot."""
    building.cylinder(f"{name}_pot", "clay", spot, 0.19, 0.0, 0.40)
    building.ellipsoid(f"{name}_leaves", "leaves", spot, 0.30, 0.38, height_m)


def bin_beside(building: Building, face: str, begin_m: float, end_m: float) -> None:
    """A waste bin at a wall, somewhere between two places along it, as the seed has it."""
    spot = building.faces[face].spot(building.loose(begin_m, end_m), 0.2)
    building.cylinder(f"bin_{face}", "plastic_grey", spot, 0.15, 0.0, 0.55)


def loose_chair(building: Building, name: str, face: str, begin_m: float, end_m: float) -> None:
    """A chair with its back to a wall, not quite straight, somewhere between two places along it."""
    spot = building.faces[face].spot(building.loose(begin_m, end_m), 0.32)
    fabric = ("fabric_red", "fabric_blue", "fabric_dark")[building.rng.integers(3)]
    chair(building, name, Spot(spot.x_m, spot.y_m, spot.yaw_rad + building.loose(-0.25, 0.25)), fabric)
