"""Rigid motions, cameras and alignment: mathematics that knows nothing of robots."""

from wheelsight.geometry.alignment import align_points, align_points_with_scale
from wheelsight.geometry.arrays import BoolArray, ByteArray, Float32Array, FloatArray, Int32Array, IntArray
from wheelsight.geometry.camera import MOST_PIXELS, PinholeCamera
from wheelsight.geometry.interpolation import interpolate_at

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
