"""Which way is up in a map that nobody has levelled."""

from __future__ import annotations

import numpy as np

from wheelsight.geometry import FloatArray
from wheelsight.mapping.values import Parts

# Hand-held cameras look down by less; the narrower cones leave walls and slopes out that the widest let in.
_CONES_DEG = (40.0, 20.0, 10.0)
_LEAST_SURFELS = 100


def upward(parts: Parts, R_map_camera: FloatArray) -> FloatArray:
    """The direction (3,) of length 1 that floors and tables face, by the area of all that face about the camera's up.

    Args:
        parts: of the map.
        R_map_camera: (3, 3) of a camera that was held upright, within 40°; where nothing faces up, its own up is
            all that is known.
    """
    up = -np.asarray(R_map_camera, float)[:, 1]
    for cone_deg in _CONES_DEG:
        total, count = np.zeros(3), 0
        for surfels in parts():
            facing = surfels.normal @ up > np.cos(np.radians(cone_deg))
            total += (surfels.normal[facing] * surfels.radius_m[facing, None].astype(float) ** 2).sum(axis=0)
            count += int(np.count_nonzero(facing))
        if count < _LEAST_SURFELS:
            break
        up = total / np.linalg.norm(total)
    return up
