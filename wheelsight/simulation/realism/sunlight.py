"""Sunlight that falls through windows: bright patches in colour, in which infrared patterns drown."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from wheelsight.geometry import Float32Array, FloatArray
from wheelsight.simulation import _sunlight_kernels as kernels
from wheelsight.simulation._light_kernels import Views
from wheelsight.simulation.scene import Scene
from wheelsight.simulation.view import View

_PANE = "pane"  # what the names of windows' geoms begin with
_BOX = 6
_CELLS = 64, 32
_BEHIND_M = 0.01


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
    """The sun of one drive. What stands in its way throws a shadow; people do not.

    Args:
        settings: how it shines.
        scene: with its windows, which are the boxes whose names begin with "pane".
        towards: (3,) vector to where the windows' light comes from; its height is replaced.
        rng: of the drive.
    """

    def __init__(self, settings: SunlightSettings, scene: Scene, towards: FloatArray, rng: np.random.Generator) -> None:
        elevation_rad = np.radians(rng.uniform(*settings.elevation_deg))
        level = np.asarray(towards[:2], float) / np.hypot(*towards[:2])
        self.brightness = settings.brightness
        self.towards = np.array([*(np.cos(elevation_rad) * level), np.sin(elevation_rad)])
        self._panes = _panes_of(scene, self.towards, bool(rng.random() < settings.chance))

    def on(self, view: View) -> Float32Array:
        """(H, W) share of full sunlight on what a view shows: the cosine of incidence in patches, 0 elsewhere."""
        out = np.empty(view.depth_m.shape, np.float32)
        arrays = Views(view.depth_m, view.geom, view.normal_world, view.T_world_camera, view.rays)
        kernels.shine_in(arrays, self._panes, self.towards, out)
        return out


def _panes_of(scene: Scene, towards: FloatArray, shines: bool) -> kernels.Panes:
    """The windows of a scene, and how far the sun comes through them; none where it does not shine."""
    geoms = scene.geoms
    panes = [g for g, name in enumerate(geoms.names) if shines and name.startswith(_PANE) and geoms.kind[g] == _BOX]
    axes, halves = np.zeros((len(panes), 3, 3)), np.zeros((len(panes), 2))
    reach_m = np.zeros((len(panes), *_CELLS), np.float32)
    for k, g in enumerate(panes):
        # Across, along, and last through it.
        order = np.argsort(-geoms.size_m[g])
        axes[k], halves[k] = geoms.R_world_geom[g].T[order], geoms.size_m[g][order[:2]]
        across, along = ((np.arange(count) + 0.5) / count * 2 - 1 for count in _CELLS)
        grid = across[:, None, None] * halves[k, 0] * axes[k, 0] + along[None, :, None] * halves[k, 1] * axes[k, 1]
        # Begun behind the pane, which would stop the ray itself.
        through_m = geoms.size_m[g][order[2]] + _BEHIND_M
        slant = max(abs(float(axes[k, 2] @ towards)), 0.05)
        begins = geoms.position_world[g] + grid - towards * through_m / slant
        reach_m[k] = scene.reach_m(begins.reshape(-1, 3), -towards).reshape(_CELLS) + through_m / slant
    return kernels.Panes(np.ascontiguousarray(geoms.position_world[panes]), axes, halves, reach_m)
