"""Compiled per-pixel steps of the colour sensor: image motion, the smear along it, electrons, noise and bytes."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from wheelsight.compiled import kernel
from wheelsight.simulation._texture_kernels import hash_unit

_LONGEST_SMEAR_PX = 60.0


@kernel(error_model="numpy")
def flow(depth_m: Any, rays: Any, twist: Any, out: Any) -> None:
    """Pixels per second `out` (H, W, 2) from depth (H, W), rays (H, W, 3) and the camera's (v, ω); 0 without depth."""
    height, width = depth_m.shape
    v0, v1, v2, w0, w1, w2 = twist
    for v in range(height):
        below = v + 1 if v + 1 < height else v - 1
        for u in range(width):
            z = float(depth_m[v, u])
            if z <= 0:
                out[v, u, 0] = out[v, u, 1] = 0.0
                continue
            x, y = rays[v, u, 0], rays[v, u, 1]
            beside = u + 1 if u + 1 < width else u - 1
            along = -v2 / z - (w0 * y - w1 * x)
            dx = -v0 / z - (w1 - w2 * y) - x * along
            dy = -v1 / z - (w2 * x - w0) - y * along
            out[v, u, 0] = dx / abs(rays[v, beside, 0] - x)
            out[v, u, 1] = dy / abs(rays[below, u, 1] - y)


@kernel(error_model="numpy")
def smear(image: Any, moved: Any) -> Any:
    """Image (H, W, 3) of which each pixel is the mean along a line (H, W, 2) in pixels through its middle."""
    height, width, _ = image.shape
    out = np.empty_like(image)
    for v in range(height):
        for u in range(width):
            du, dv = float(moved[v, u, 0]), float(moved[v, u, 1])
            length = math.sqrt(du * du + dv * dv)
            if length < 0.1:
                for c in range(3):
                    out[v, u, c] = image[v, u, c]
                continue
            shrink = min(1.0, _LONGEST_SMEAR_PX / length)
            steps = math.ceil(length * shrink) + 1
            r, g, b = 0.0, 0.0, 0.0
            for k in range(steps):
                share = ((k + 0.5) / steps - 0.5) * shrink
                a, e, f = _between(image, u + share * du, v + share * dv)
                r, g, b = r + a, g + e, b + f
            out[v, u, 0], out[v, u, 1], out[v, u, 2] = r / steps, g / steps, b / steps
    return out


@kernel(error_model="numpy")
def _between(image: Any, u: float, v: float) -> Any:
    """Bilinear colour at a place in the image; outside, that of the nearest edge."""
    height, width, _ = image.shape
    u, v = min(max(u, 0.0), width - 1.0), min(max(v, 0.0), height - 1.0)
    column, row = min(int(u), width - 2), min(int(v), height - 2)
    a, b = u - column, v - row
    w00, w01, w10, w11 = (1 - a) * (1 - b), a * (1 - b), (1 - a) * b, a * b
    return (
        w00 * image[row, column, 0] + w01 * image[row, column + 1, 0]
        + w10 * image[row + 1, column, 0] + w11 * image[row + 1, column + 1, 0],
        w00 * image[row, column, 1] + w01 * image[row, column + 1, 1]
        + w10 * image[row + 1, column, 1] + w11 * image[row + 1, column + 1, 1],
        w00 * image[row, column, 2] + w01 * image[row, column + 1, 2]
        + w10 * image[row + 1, column, 2] + w11 * image[row + 1, column + 1, 2],
    )  # fmt: skip


@kernel(error_model="numpy")
def develop(
    image: Any,
    fall_off: Any,
    electrons: float,
    full_well: float,
    read_noise: float,
    gain: float,
    normals: Any,
    curve: Any,
    seed: int,
    out: Any,
) -> None:
    """Bytes `out` (H, W, 3) of radiance: electrons, shot and read noise, saturation, gain, tone curve.

    Shot noise is drawn from the normal distribution of Poisson's mean and variance; `normals` (N,) are equally
    likely values of the unit normal, `curve` (L,) the byte of each level from 0 to 1.
    """
    height, width, _ = image.shape
    last = len(curve) - 1
    for v in range(height):
        for u in range(width):
            pixel = v * width + u
            for c in range(3):
                mean = max(electrons * float(image[v, u, c]) * float(fall_off[v, u]), 0.0)
                draw = normals[int(hash_unit(pixel, c, seed) * len(normals))]
                collected = min(mean + math.sqrt(mean + read_noise * read_noise) * float(draw), full_well)
                level = min(max(gain * collected, 0.0), 1.0)
                out[v, u, c] = curve[int(level * last + 0.5)]
