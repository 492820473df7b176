"""`World` describes a simulated world: its objects, their look, its areas, and a route."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Literal

from wheelsight.core.areas import AreaMap
from wheelsight.core.geometry import FloatArray

SurfaceKind = Literal[
    "plain", "plaster", "carpet", "tiles", "wood", "ceiling", "door", "poster", "notice_board", "fabric", "books"
]


@dataclass(frozen=True, slots=True)
class Surface:
    """How a material looks to the colour camera, and to the infrared light of a depth camera.

    Attributes:
        kind: the procedural texture.
        rgb: main colour, three reflectances 0 to 1.
        accent_rgb: second colour of the texture: joints, frames, print.
        scale_m: size of the texture's largest element: a tile, a plank, a poster.
        contrast: how strongly the texture's detail differs from the main colour, 0 to 1.
        infrared: reflectance at the depth camera's wavelength, 0 to 1; below about 0.1 little returns.
        shine: share of the light that is mirrored away rather than scattered, 0 to 1.
        glow: light it sends out itself; the lamps of an office send about 5.
    """

    kind: SurfaceKind
    rgb: tuple[float, float, float]
    accent_rgb: tuple[float, float, float] = (0.2, 0.2, 0.2)
    scale_m: float = 1.0
    contrast: float = 0.5
    infrared: float = 0.6
    shine: float = 0.0
    glow: float = 0.0


@dataclass(frozen=True, slots=True)
class Leaf:
    """A door's leaf that can swing: it turns about a hinge between where the MJCF has it and its other end.

    Attributes:
        geom: its upright box in the MJCF, at rest where it is out of the way.
        hinge_m: (x, y) of the upright axis it turns about.
        turn_rad: how far it turns from there, anticlockwise seen from above: from open to shut, or from shut to open.
    """

    geom: str
    hinge_m: tuple[float, float]
    turn_rad: float


@dataclass(frozen=True, eq=False)
class World:
    """A world whose floor is the plane z = 0; +z up, metres.

    Attributes:
        name: what `wheelsight simulate` calls it.
        description: one line for `--list`.
        mjcf: the whole MJCF document, without robot; MuJoCo's own viewer opens it. Every geom has a name and a
            material; what a robot can bump into has contype 1, what is only to be seen (posters, door leaves on walls)
            contype 0.
        surfaces: how each material of the MJCF looks, by the material's name.
        areas: named polygons on the floor.
        route: (N, 2) metres, waypoints of the base; the robot starts at the first one, heading for the second.
        is_loop: whether a lap ends where it began.
        size_m: (x_min, y_min, x_max, y_max) of the floor.
        leaves: of doors, those that can swing.
        warnings: sentences on what was not taken as its files state it.
    """

    name: str
    description: str
    mjcf: str
    surfaces: Mapping[str, Surface]
    areas: AreaMap
    route: FloatArray
    is_loop: bool
    size_m: tuple[float, float, float, float]
    leaves: tuple[Leaf, ...] = ()
    warnings: tuple[str, ...] = ()

    def at_rest(self) -> tuple[Any, Any]:
        """MuJoCo's model of the MJCF, and its data with all geoms where they stand."""
        import mujoco

        model = mujoco.MjModel.from_xml_string(self.mjcf)
        data = mujoco.MjData(model)
        mujoco.mj_kinematics(model, data)
        return model, data
