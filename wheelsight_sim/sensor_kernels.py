"""Compiled per-pixel steps of the sensors: light that comes back, matching, edges; motion, electrons and noise."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np

from wheelsight.core.compiled import kernel
from wheelsight.core.geometry.arrays import ByteArray, Float32Array, FloatArray, Int32Array
from wheelsight_sim.light_kernels import View
from wheelsight_sim.texture_kernels import hash_unit

_BINS_PER_PX = 2
_BYTE = 256


class Seen(NamedTuple):
    """Depth in metres, index of the geom, cosine of incidence and returned light of each pixel; all (H, W)."""

    depth_m: Float32Array
    geom: Int32Array
    cosine: Float32Array
    light: Float32Array


class Chance(NamedTuple):
    """Three random bytes (h, w, 3) for each cell of pixels, and how many cells there are to a pixel's width."""

    cells: ByteArray
    cells_per_px: float


class Limits(NamedTuple):
    """What a depth sensor can see."""

    near_m: float
    far_m: float
    least_cosine: float
    least_light: float
    lobe_rad: float
    blinding: float


class Pattern(NamedTuple):
    """How well a projected pattern is matched, and focal length times baseline of the image and of native pixels."""

    sigma_px: float
    oblique_m: float
    focal_baseline_px_m: float
    focal_baseline_native: float
    steps_per_px: float


class Phase(NamedTuple):
    """How well light is timed: noise `axial` (4,) of what scatters `reference`, and what edges do."""

    axial: FloatArray
    reference: float
    jump: float
    edge_share: float
    edge_loss: float


@kernel
def returned_light(view: View, scattered: Any) -> Seen:
    """Cosine of incidence and returned light of each pixel, 0 where nothing was hit.

    A surface scatters the share `scattered` (G,) of the light like Lambert's; a lamp at the camera gives
    scattered · cos θ / r², in reflectances per square metre.
    """
    depth_m, geom, normal_world, T_world_rows, rays = view
    cosine, light = np.zeros(depth_m.shape, np.float32), np.zeros(depth_m.shape, np.float32)
    for row in range(depth_m.shape[0]):
        R = T_world_rows[row]
        for column in range(depth_m.shape[1]):
            g = geom[row, column]
            if g < 0:
                continue
            ray, n = rays[row, column], normal_world[row, column]
            across, square = 0.0, 0.0
            for k in range(3):
                across -= n[k] * (R[k, 0] * ray[0] + R[k, 1] * ray[1] + R[k, 2] * ray[2])
                square += ray[k] * ray[k]
            cosine[row, column] = max(across, 0.0) / np.sqrt(square)
            light[row, column] = scattered[g] * cosine[row, column] / (square * depth_m[row, column] ** 2)
    return Seen(depth_m, geom, cosine, light)


@kernel
def lit_by_projector(depth_m: Any, geom: Any, focal_baseline_px_m: float, tolerance_px: float) -> Any:
    """(H, W) which pixels a projector to the camera's right lights, seen from the camera.

    Row by row: a point at column u with disparity d stands at column u - d of the projector's image, where whatever
    has a greater disparity stands before it. Between neighbours on one geom the surface is unbroken. A point counts as
    lit unless something stands before it by more than `tolerance_px`.
    """
    rows, columns = depth_m.shape
    lit = np.zeros((rows, columns), np.bool_)
    disparity = np.empty(columns)
    for row in range(rows):
        greatest = 0.0
        for column in range(columns):
            z = depth_m[row, column]
            disparity[column] = focal_baseline_px_m / z if z > 0 else 0.0
            greatest = max(greatest, disparity[column])
        before = int(greatest) + 2
        nearest = np.zeros((columns + before + 2) * _BINS_PER_PX)
        for column in range(columns):
            d = disparity[column]
            if d <= 0:
                continue
            _cover(nearest, column - d - 0.5 + before, column - d + 0.5 + before, d, d)
            if column + 1 < columns and geom[row, column + 1] == geom[row, column]:
                other = disparity[column + 1]
                _cover(nearest, column - d + before, column + 1 - other + before, d, other)
        for column in range(columns):
            d = disparity[column]
            if d > 0:
                at = int(np.floor((column - d + before) * _BINS_PER_PX))
                lit[row, column] = nearest[at] - d <= tolerance_px
    return lit


@kernel
def _cover(nearest: Any, start: float, end: float, d_start: float, d_end: float) -> None:
    """Let a piece of surface stand in the projector's bins whose centres it covers, unless something nearer does."""
    if start > end:
        start, end, d_start, d_end = end, start, d_end, d_start
    first, last = int(np.ceil(start * _BINS_PER_PX - 0.5)), int(np.floor(end * _BINS_PER_PX - 0.5))
    for b in range(max(first, 0), min(last, len(nearest) - 1) + 1):
        share = 0.0 if end <= start else ((b + 0.5) / _BINS_PER_PX - start) / (end - start)
        nearest[b] = max(nearest[b], d_start + share * (d_end - d_start))


@kernel
def detectable(seen: Seen, shine: FloatArray, chance: Chance, limits: Limits) -> Any:
    """(H, W) which pixels get enough light from in range, and are not blinded by a mirrored lamp.

    The three limits sway by a quarter with the first byte of a pixel's cell, so that what fades does so in patches. A
    mirror's lobe is shine (G,) · exp(-(θ / lobe)²).
    """
    depth_m, geom, cosine, light = seen
    near_m, far_m, least_cosine, least_light, lobe_rad, blinding = limits
    cells_per_px = chance.cells_per_px
    usable = np.zeros(depth_m.shape, np.bool_)
    for row in range(depth_m.shape[0]):
        for column in range(depth_m.shape[1]):
            z = depth_m[row, column]
            if z < near_m or z > far_m or z <= 0:
                continue
            luck = 0.75 + 0.5 * chance.cells[int(row * cells_per_px), int(column * cells_per_px), 0] / _BYTE
            if cosine[row, column] < least_cosine * luck or light[row, column] < least_light * luck:
                continue
            mirrored = shine[geom[row, column]]
            if mirrored > 0:
                angle = np.arccos(min(cosine[row, column], 1.0))
                usable[row, column] = mirrored * np.exp(-((angle / lobe_rad) ** 2)) < blinding * luck
            else:
                usable[row, column] = True
    return usable


@kernel
def match_pattern(seen: Seen, usable: Any, noise: Any, chance: Chance, shifts_px: Any, pattern: Pattern) -> Any:
    """(H, W) depth by matching a projected pattern; 0 where it is not `usable`.

    Disparities in native pixels get the unit normal `noise` (H, W) times `sigma_px` and are rounded to
    1 / `steps_per_px`, depths then to millimetres. `oblique_m` scales the noise that grows with the angle of incidence.
    Edges are displaced by entries of `shifts_px` (256,), which the second and third byte of a cell choose for all its
    pixels together.
    """
    depth_m, _, cosine, _ = seen
    sigma_px, oblique_m, focal_baseline_px_m, focal_baseline_native, steps_per_px = pattern
    cells_per_px = chance.cells_per_px
    measured = np.zeros(depth_m.shape, np.float32)
    for row in range(depth_m.shape[0]):
        for column in range(depth_m.shape[1]):
            cell = chance.cells[int(row * cells_per_px), int(column * cells_per_px)]
            r = min(max(int(np.round(row + shifts_px[cell[1]])), 0), depth_m.shape[0] - 1)
            c = min(max(int(np.round(column + shifts_px[cell[2]])), 0), depth_m.shape[1] - 1)
            here, there = depth_m[row, column], depth_m[r, c]
            # A match is displaced only across an edge, a step of disparity by more than a pixel.
            if here > 0 and there > 0 and focal_baseline_px_m * abs(here - there) <= here * there:
                r, c = row, column
            if not usable[r, c]:
                continue
            z = depth_m[r, c]
            per_m = focal_baseline_native / (z * z)
            extra_px = oblique_m / np.sqrt(z) * _obliqueness(cosine[r, c]) * per_m
            sigma = np.sqrt(sigma_px * sigma_px + extra_px * extra_px)
            d = np.round((focal_baseline_native / z + sigma * noise[row, column]) * steps_per_px) / steps_per_px
            if d > 0:
                measured[row, column] = np.round(1000 * focal_baseline_native / d) / 1000
    return measured


@kernel
def _obliqueness(cosine: float) -> Any:
    """θ² / (π/2 - θ)², the growth of noise with the angle of incidence in Nguyen's and Fankhauser's models."""
    angle = np.arccos(min(max(cosine, 0.02), 1.0))
    return (angle / (0.5 * np.pi - angle)) ** 2


@kernel
def time_light(seen: Seen, usable: Any, scattered: Any, noise: Any, chance: ByteArray, phase: Phase) -> Any:
    """(H, W) depth by the phase of returned light, rounded to millimetres; 0 where it is not `usable`.

    Noise is the unit normal `noise` (H, W) times a + b·z + c·z² + d·z^1.5·θ²/(π/2 - θ)² of `axial` (4,) in metres, and
    times sqrt(reference / scattered (G,)). A pixel beside a step of more than `jump` of its depth is lost with the
    chance `edge_loss`, else gets up to `edge_share` of its light from beyond the step: bytes 1 and 2 of `chance`
    (H, W, 3) decide.
    """
    depth_m, geom, cosine, light = seen
    axial, reference, jump, edge_share, edge_loss = phase
    measured = np.zeros(depth_m.shape, np.float32)
    for row in range(depth_m.shape[0]):
        for column in range(depth_m.shape[1]):
            if not usable[row, column]:
                continue
            z = depth_m[row, column]
            sigma_m = axial[0] + axial[1] * z + axial[2] * z * z + axial[3] * z**1.5 * _obliqueness(cosine[row, column])
            sigma_m *= np.sqrt(reference / scattered[geom[row, column]])
            r, c = _across_edge(depth_m, row, column, jump)
            if r >= 0:
                if chance[row, column, 1] < edge_loss * _BYTE:
                    continue
                there = edge_share * chance[row, column, 2] / _BYTE
                own, other = (1 - there) * light[row, column], there * light[r, c]
                z = (own * z + other * depth_m[r, c]) / (own + other)
            measured[row, column] = max(np.round(1000 * (z + sigma_m * noise[row, column])) / 1000, 0.0)
    return measured


@kernel
def _across_edge(depth_m: Any, row: int, column: int, jump: float) -> tuple[int, int]:
    """The neighbour of four across the greatest step of depth; (-1, -1) where there is none.

    A step is one that the surface on the pixel's other side does not go on with: a slope is none.
    """
    rows, columns = depth_m.shape
    z = depth_m[row, column]
    best, found = jump * z, (-1, -1)
    for down, right in ((-1, 0), (1, 0), (0, -1), (0, 1)):
        r, c = row + down, column + right
        if not (0 <= r < rows and 0 <= c < columns) or depth_m[r, c] <= 0:
            continue
        step = depth_m[r, c] - z
        if abs(step) <= best:
            continue
        r_back, c_back = row - down, column - right
        if 0 <= r_back < rows and 0 <= c_back < columns and depth_m[r_back, c_back] > 0:
            slope = z - depth_m[r_back, c_back]
            if abs(step - slope) <= 0.5 * abs(step):
                continue
        best, found = abs(step), (r, c)
    return found


_LONGEST_SMEAR_PX = 60.0


class Exposed(NamedTuple):
    """A sensor's pixel as it is exposed: electrons of white, those it can hold, noise of reading, and gain."""

    electrons: float
    full_well: float
    read_noise: float
    gain: float


@kernel(error_model="numpy")
def flow_kernel(depth_m: Any, rays: Any, twist: Any, out: Any) -> None:
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
def develop(image: Any, fall_off: Any, exposed: Exposed, normals: Any, curve: Any, seed: int, out: Any) -> None:
    """Bytes `out` (H, W, 3) of radiance: electrons, shot and read noise, saturation, gain, tone curve.

    Shot noise is drawn from the normal distribution of Poisson's mean and variance; `normals` (N,) are equally
    likely values of the unit normal, `curve` (L,) the byte of each level from 0 to 1.
    """
    electrons, full_well, read_noise, gain = exposed
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
