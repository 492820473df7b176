"""Light that reaches a time-of-flight camera by way of a second surface, and makes corners look further away."""

from __future__ import annotations

import cv2
import numpy as np

from wheelsight.geometry import Float32Array, FloatArray
from wheelsight.simulation.view import View

_NEAREST_M = 0.1


def multipath_m(view: View, scattered: FloatArray, grid: tuple[int, int]) -> Float32Array:
    """(H, W) how much deeper points seem for the light that was scattered twice; 0 where nothing is seen.

    The radiometric model of Jiménez et al., "Modeling and correction of multipath interference in time of flight
    cameras", Image and Vision Computing 32 (2014), with one further reflection: each of a grid of patches receives the
    light of the lamp directly, and from every other patch, on which the lamp shines too, by their form factor. A
    pixel's distance is the mean of the ways, weighted by their light. Patches do not hide one another.

    Args:
        view: what is seen.
        scattered: (G,) share of the light that each geom scatters at the sensor's wavelength.
        grid: columns and rows of patches.
    """
    h, w = view.depth_m.shape
    rows = ((np.arange(grid[1]) + 0.5) * h / grid[1]).astype(int)
    columns = ((np.arange(grid[0]) + 0.5) * w / grid[0]).astype(int)
    at = np.ix_(rows, columns)
    z, geom = view.depth_m[at].astype(float).ravel(), view.geom[at].ravel()
    p = (view.rays[at] * view.depth_m[at][..., None]).reshape(-1, 3)
    R = view.T_world_camera[rows][:, None, :3, :3]
    n = np.einsum("rcji,rcj->rci", np.broadcast_to(R, (*grid[::-1], 3, 3)), view.normal_world[at]).reshape(-1, 3)
    reach_m = np.maximum(np.linalg.norm(p, axis=1), _NEAREST_M)
    towards = -p / reach_m[:, None]
    cosine = np.maximum(np.einsum("ni,ni->n", n, towards), 0.05)
    albedo = np.where(geom >= 0, scattered[geom], 0.0)
    # A patch is as large as its share of the image, at its depth, and more where it is seen aslant.
    per_px = abs(view.rays[0, -1, 0] - view.rays[0, 0, 0]) / w * abs(view.rays[-1, 0, 1] - view.rays[0, 0, 1]) / h
    area_m2 = per_px * (h * w / len(z)) * z**2 / cosine
    longer_m = _mean_detour_m(p, n, reach_m, albedo, area_m2 * cosine / reach_m**2, cosine / reach_m**2)
    longer_m = np.where(z > 0, longer_m * z / reach_m, 0.0).reshape(grid[::-1]).astype(np.float32)
    return np.asarray(cv2.resize(longer_m, (w, h), interpolation=cv2.INTER_LINEAR))


def _mean_detour_m(
    p: FloatArray, n: FloatArray, reach_m: FloatArray, albedo: FloatArray, sent: FloatArray, direct: FloatArray
) -> FloatArray:
    """(N,) mean of half the detours by every other patch, weighted by light; none for the direct way.

    `sent` is the light a patch receives from the lamp in all, `direct` that which a unit of a patch's surface does.
    """
    apart = p[None] - p[:, None]
    distance_m = np.maximum(np.linalg.norm(apart, axis=2), _NEAREST_M)
    leaving = np.maximum(np.einsum("ijk,jk->ij", -apart, n), 0) / distance_m
    arriving = np.maximum(np.einsum("ijk,ik->ij", apart, n), 0) / distance_m
    indirect = albedo * sent * leaving * arriving / (np.pi * distance_m**2)
    detour_m = 0.5 * (reach_m[None] + distance_m - reach_m[:, None])
    return np.asarray((indirect * detour_m).sum(axis=1) / (direct + indirect.sum(axis=1)))
