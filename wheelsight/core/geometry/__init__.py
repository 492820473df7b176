"""Rigid motions, cameras and alignment."""

from wheelsight.core.geometry.alignment import align_points, align_points_with_scale, interpolate_at
from wheelsight.core.geometry.arrays import BoolArray, ByteArray, Float32Array, FloatArray, Int32Array, IntArray
from wheelsight.core.geometry.camera import MOST_PIXELS, PinholeCamera

__all__ = [
    "MOST_PIXELS",
    "BoolArray",
    "ByteArray",
    "Float32Array",
    "FloatArray",
    "Int32Array",
    "IntArray",
    "PinholeCamera",
    "align_points",
    "align_points_with_scale",
    "interpolate_at",
]
