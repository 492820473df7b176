"""What odometry and a map tell each other without knowing each other: a view from a pose, and a surface to add."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

from wheelsight.geometry import Float32Array, FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class PredictedView:
    """What a model looks like from a pose, on the ideal grid at the finest level.

    Attributes:
        depth_m: (h, w) float32, 0 where the model has nothing.
        normal: (h, w, 3) float32 in the camera frame, towards the camera; 0 where unknown.
        grey: (h, w) float32, -1 where unknown.
    """

    depth_m: Float32Array
    normal: Float32Array
    grey: Float32Array


@dataclass(frozen=True, slots=True, eq=False)
class Surface:
    """What a tracked frame adds to a map, on the ideal grid at the finest level.

    Attributes:
        depth_m: (h, w) float32, 0 where unknown.
        normal: (h, w, 3) float32 in the camera frame, towards the camera; 0 where unknown: such pixels add nothing.
        grey: (h, w) float32 from 0 to 255, -1 where unknown.
        color: (h, w, 3) float32 red, green, blue from 0 to 255, -1 where unknown; or None.
    """

    depth_m: Float32Array
    normal: Float32Array
    grey: Float32Array
    color: Float32Array | None = None


class ReferenceModel(Protocol):
    """Predicts what the camera sees from a pose: a surfel map, for instance."""

    def predict(self, T_map_camera: FloatArray, intrinsics: FloatArray, shape: tuple[int, int]) -> PredictedView:
        """The view (h, w) = `shape` of a camera with `intrinsics` (4,) fx, fy, cx, cy at a pose (4, 4)."""
