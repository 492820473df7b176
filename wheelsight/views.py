"""What odometry asks of a map without knowing it: the view from a pose."""

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


class ReferenceModel(Protocol):
    """Predicts what the camera sees from a pose: a surfel map, for instance."""

    def predict(self, T_map_camera: FloatArray, intrinsics: FloatArray, shape: tuple[int, int]) -> PredictedView:
        """The view (h, w) = `shape` of a camera with `intrinsics` (4,) fx, fy, cx, cy at a pose (4, 4)."""
