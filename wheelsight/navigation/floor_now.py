"""FloorNow: all that is known of the floor at one moment, as a value; costmaps of it are made in whichever thread."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from wheelsight.geometry import FloatArray, se2
from wheelsight.navigation.costmap import Costmap, StaticLayer
from wheelsight.navigation.costmap_settings import CostmapSettings
from wheelsight.navigation.footprint import Footprint
from wheelsight.navigation.live_layer import LiveObstacles

_NOWHERE: FloatArray = np.empty((0, 2))


@dataclass(frozen=True, slots=True, eq=False)
class FloorNow:
    """See the module.

    Attributes:
        layer: of the map.
        obstacles: that the camera met.
        T_map_odom: (3,) of now.
        hidden: (M, 3) x, y in the map of floor about the robot that no camera has looked at, and how near to it one
            must look, metres.
        footprint: of the robot.
        settings: of costmaps.
    """

    layer: StaticLayer
    obstacles: LiveObstacles
    T_map_odom: FloatArray
    hidden: FloatArray
    footprint: Footprint
    settings: CostmapSettings

    def costmap(self, avoided: FloatArray = _NOWHERE) -> Costmap:
        """Of it, in the map, with obstacles at (N, 2) besides."""
        T_odom_map = se2.invert(se2.from_parts(*self.T_map_odom))
        live = self.obstacles.with_points(se2.apply(T_odom_map, avoided)) if len(avoided) else self.obstacles
        return Costmap.of(self.layer, self.footprint, self.settings, live, self.T_map_odom)
