"""Compiled inner loop of meshing: signed distances to a surface that surfels describe."""

from __future__ import annotations

from typing import Any

import numpy as np

from wheelsight.compiled import kernel


@kernel
def add_distances(
    position: Any, normal: Any, confidence: Any, origin: Any, voxel_m: float, reach: int, distance: Any, weight: Any
) -> None:
    """Add to each voxel about surfels its distance to their planes, positive on the side their normals point to.

    The mean of plane distances, weighted by nearness, is the implicit moving-least-squares surface of Kolluri 2008.

    Args:
        position, normal, confidence: (n, 3), (n, 3), (n,).
        origin: (3,) of voxel 0's middle. reach: in voxels, beyond which a surfel says nothing.
        distance, weight: (x, y, z) sums.
    """
    size = distance.shape
    inverse = 1.0 / (reach * voxel_m) ** 2
    for i in range(len(position)):
        p, n = position[i], normal[i]
        a = int(np.rint((p[0] - origin[0]) / voxel_m))
        b = int(np.rint((p[1] - origin[1]) / voxel_m))
        c = int(np.rint((p[2] - origin[2]) / voxel_m))
        for x in range(max(a - reach, 0), min(a + reach + 1, size[0])):
            for y in range(max(b - reach, 0), min(b + reach + 1, size[1])):
                for z in range(max(c - reach, 0), min(c + reach + 1, size[2])):
                    dx = origin[0] + x * voxel_m - p[0]
                    dy = origin[1] + y * voxel_m - p[1]
                    dz = origin[2] + z * voxel_m - p[2]
                    near = 1.0 - (dx * dx + dy * dy + dz * dz) * inverse
                    if near > 0:
                        share = near * near * confidence[i]
                        distance[x, y, z] += share * (dx * n[0] + dy * n[1] + dz * n[2])
                        weight[x, y, z] += share
