"""Compiled sunlight: which points of a view the sun reaches through a window."""

from __future__ import annotations

from typing import Any, NamedTuple

from wheelsight.compiled import kernel
from wheelsight.geometry.arrays import Float32Array, FloatArray
from wheelsight.simulation._light_kernels import Views, nine, turned

_NEAREST_M = 0.05
_SHADE_M = 0.1  # behind what stands in the light before it is shaded; a cell of a pane is as wide


class Panes(NamedTuple):
    """Windows that the sun stands behind.

    Attributes:
        middle: (P, 3).
        axes: (P, 3, 3) across, along and through the pane, as rows.
        half_m: (P, 2) half lengths across and along.
        reach_m: (P, A, B) how far sunlight comes from each cell of a pane before it meets something.
    """

    middle: FloatArray
    axes: FloatArray
    half_m: FloatArray
    reach_m: Float32Array


@kernel(error_model="numpy")
def shine_in(view: Views, panes: Panes, towards: FloatArray, out: Any) -> None:
    """Put the cosine of the sun's incidence into `out` (H, W) where it comes through a pane, else 0.

    `towards` (3,) is the unit vector to the sun.
    """
    depth_m, _, normal_world, T_world_camera, rays = view
    height, width = depth_m.shape
    x, y, z = towards
    for v in range(height):
        R = nine(T_world_camera[v])
        for u in range(width):
            out[v, u] = 0.0
            facing = normal_world[v, u, 0] * x + normal_world[v, u, 1] * y + normal_world[v, u, 2] * z
            if facing <= 0 or depth_m[v, u] <= 0:
                continue
            ray = turned(R, (rays[v, u, 0], rays[v, u, 1], rays[v, u, 2]))
            p0 = T_world_camera[v, 0, 3] + depth_m[v, u] * ray[0]
            p1 = T_world_camera[v, 1, 3] + depth_m[v, u] * ray[1]
            p2 = T_world_camera[v, 2, 3] + depth_m[v, u] * ray[2]
            if _is_reached(p0, p1, p2, panes, towards):
                out[v, u] = facing


@kernel(error_model="numpy")
def _is_reached(p0: float, p1: float, p2: float, panes: Panes, towards: FloatArray) -> bool:
    """Whether the way from a point to the sun goes through a pane."""
    middle, axes, half_m, reach_m = panes
    cells_across, cells_along = reach_m.shape[1:]
    for k in range(len(middle)):
        a0, a1, a2 = middle[k, 0] - p0, middle[k, 1] - p1, middle[k, 2] - p2
        along = axes[k, 2, 0] * towards[0] + axes[k, 2, 1] * towards[1] + axes[k, 2, 2] * towards[2]
        if abs(along) < 1e-3:
            continue
        way_m = (axes[k, 2, 0] * a0 + axes[k, 2, 1] * a1 + axes[k, 2, 2] * a2) / along
        if way_m < _NEAREST_M:
            continue
        b0, b1, b2 = way_m * towards[0] - a0, way_m * towards[1] - a1, way_m * towards[2] - a2
        across = axes[k, 0, 0] * b0 + axes[k, 0, 1] * b1 + axes[k, 0, 2] * b2
        if abs(across) >= half_m[k, 0]:
            continue
        along_m = axes[k, 1, 0] * b0 + axes[k, 1, 1] * b1 + axes[k, 1, 2] * b2
        if abs(along_m) >= half_m[k, 1]:
            continue
        i = min(int((across / half_m[k, 0] + 1) * 0.5 * cells_across), cells_across - 1)
        j = min(int((along_m / half_m[k, 1] + 1) * 0.5 * cells_along), cells_along - 1)
        if way_m < reach_m[k, i, j] + _SHADE_M:
            return True
    return False
