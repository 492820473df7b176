"""Sunlight that falls through windows: bright patches in colour, in which infrared patterns drown."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from wheelsight.geometry import Float32Array, FloatArray
from wheelsight.simulation import _sunlight_kernels as kernels
from wheelsight.simulation._light_kernels import Views
from wheelsight.simulation.view import Geoms, View

_PANE = "pane"  # what the names of windows' geoms begin with
_BOX = 6


@dataclass(frozen=True, slots=True)
class SunlightSettings:
    """How often and how strongly the sun shines in.

    Attributes:
        chance: share of the drives on which it does. Chosen.
        elevation_deg: (lowest, highest) above the horizon; at 50° north the sun stands up to 63° high.
        brightness: of a patch that faces the sun, over what the room's lamps send it. Direct sun is 100 klx, half of it
            comes through two panes at a slant, and offices are lit by 500 lx (EN 12464-1): a hundred times; chosen for
            a sensor that saturates anyway.
        blinds_from: share of that from which a depth camera sees nothing; Kinect fails in direct sunlight (Suarez &
            Murphy, "Using the Kinect for search and rescue robotics", SSRR 2012).
    """

    chance: float = 0.5
    elevation_deg: tuple[float, float] = (20.0, 50.0)
    brightness: float = 12.0
    blinds_from: float = 0.1


class Sunlight:
    """The sun of one drive.

    Args:
        settings: how it shines.
        geoms: of the scene; windows are the boxes whose names begin with "pane".
        towards: (3,) vector to where the windows' light comes from; its height is replaced.
        rng: of the drive.
    """

    def __init__(self, settings: SunlightSettings, geoms: Geoms, towards: FloatArray, rng: np.random.Generator) -> None:
        elevation_rad = np.radians(rng.uniform(*settings.elevation_deg))
        level = np.asarray(towards[:2], float) / np.hypot(*towards[:2])
        self.towards = np.array([*(np.cos(elevation_rad) * level), np.sin(elevation_rad)])
        shines = bool(rng.random() < settings.chance)
        names: Sequence[str] = geoms.names if shines else ()
        panes = [g for g, name in enumerate(names) if name.startswith(_PANE) and geoms.kind[g] == _BOX]
        axes, halves = np.zeros((len(panes), 3, 3)), np.zeros((len(panes), 2))
        for k, g in enumerate(panes):
            # Across, along, and last through it.
            order = np.argsort(-geoms.size_m[g])
            axes[k], halves[k] = geoms.R_world_geom[g].T[order], geoms.size_m[g][order[:2]]
        self._panes = kernels.Panes(np.ascontiguousarray(geoms.position_world[panes]), axes, halves)

    def on(self, view: View) -> Float32Array:
        """(H, W) share of full sunlight on what a view shows: the cosine of incidence in patches, 0 elsewhere.

        Furniture throws no shadow into them.
        """
        out = np.empty(view.depth_m.shape, np.float32)
        arrays = Views(view.depth_m, view.geom, view.normal_world, view.T_world_camera, view.rays)
        kernels.shine_in(arrays, self._panes, self.towards, out)
        return out
