"""Depth cameras as they are: what each makes of the depth that its rays truly meet."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from wheelsight.geometry import Float32Array, FloatArray, PinholeCamera
from wheelsight.simulation.view import View


class DepthSensor(Protocol):
    """Turns true depth into a measurement."""

    def measure(
        self, view: View, camera: PinholeCamera, infrared: FloatArray, shine: FloatArray, rng: np.random.Generator
    ) -> Float32Array:
        """(H, W) depth in metres along z as the sensor reports it, 0 where it reports none.

        Args:
            view: what the rays hit.
            camera: whose pixels they go through.
            infrared: (G,) reflectance of each geom at the sensor's wavelength, 0 to 1.
            shine: (G,) share of the light each geom mirrors away, 0 to 1.
            rng: of this frame; the same state gives the same image.
        """
        ...


@dataclass(frozen=True, slots=True)
class IdealDepth:
    """Depth without error from `near_m` to `far_m`, so that what remains of an error is not the sensor's."""

    near_m: float = 0.05
    far_m: float = 20.0

    def measure(
        self, view: View, camera: PinholeCamera, infrared: FloatArray, shine: FloatArray, rng: np.random.Generator
    ) -> Float32Array:
        """The true depth where it is in range."""
        in_range = (view.depth_m >= self.near_m) & (view.depth_m <= self.far_m)
        return np.where(in_range, view.depth_m, np.float32(0))
