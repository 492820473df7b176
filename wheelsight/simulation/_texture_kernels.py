"""Compiled building blocks of textures, and the textures that repeat: plaster, carpet, tiles, wood, ceiling, fabric.

All lengths are metres on the surface. Each block takes the width of the pixel's footprint, `ws` and `wt`, and answers
the mean over it, or what a mean would leave of it: detail finer than a pixel fades instead of flickering.
Colours are three reflectances.
"""

from __future__ import annotations

import math
from typing import Any

from wheelsight.compiled import kernel

_MASK = 0xFFFFFFFF
_I, _J, _SEED = 0x27D4EB2F, 0x165667B1, 0x1E3779B1
# What is left of noise then is less than a hundredth of it.
_FADED = 0.1
_LINT = (0.66, 0.64, 0.60)
_CARPET_SQUARE_M = 0.5
_VEIN_M = 0.025
_CHIPPED_FROM_M = 0.25


@kernel(error_model="numpy")
def hash_unit(i: int, j: int, seed: int) -> Any:
    """A number in [0, 1) that two integers and a seed always give: MurmurHash3's finalizer (Appleby, 2011)."""
    return _mixed(i * _I + j * _J + seed * _SEED)


@kernel(error_model="numpy")
def _mixed(h: int) -> Any:
    h &= _MASK
    h ^= h >> 16
    h = (h * 0x85EBCA6B) & _MASK
    h ^= h >> 13
    h = (h * 0xC2B2AE35) & _MASK
    h ^= h >> 16
    return h / 4294967296.0


@kernel(error_model="numpy")
def cover(x: float, low: float, high: float, w: float) -> Any:
    """Share of a footprint of width w around x that lies between two edges."""
    inside = min(high, x + 0.5 * w) - max(low, x - 0.5 * w)
    return min(max(inside / w, 0.0), 1.0)


@kernel(error_model="numpy")
def stripes(x: float, period: float, width: float, w: float) -> Any:
    """Share of a footprint around x that lies on stripes centred at multiples of a period."""
    a, b = (x + 0.5 * width - 0.5 * w) / period, (x + 0.5 * width + 0.5 * w) / period
    share = width / period
    below_a, below_b = math.floor(a), math.floor(b)
    covered = (below_b - below_a) * share + min(b - below_b, share) - min(a - below_a, share)
    return covered * period / w


@kernel(error_model="numpy")
def noise(s: float, t: float, cell_s: float, cell_t: float, ws: float, wt: float, seed: int) -> Any:
    """Smooth noise in (-1, 1) with one random value a corner of a grid; faded out as cells grow smaller than pixels."""
    per_s, per_t = 1 / cell_s, 1 / cell_t
    fade_s, fade_t = 1 - 0.25 * (ws * per_s) ** 2, 1 - 0.25 * (wt * per_t) ** 2
    if min(fade_s, fade_t) < _FADED:
        return 0.0
    a, b = s * per_s, t * per_t
    i, j = math.floor(a), math.floor(b)
    a, b = a - i, b - j
    a, b = a * a * (3 - 2 * a), b * b * (3 - 2 * b)
    key = i * _I + j * _J + seed * _SEED
    low = (1 - a) * _mixed(key) + a * _mixed(key + _I)
    high = (1 - a) * _mixed(key + _J) + a * _mixed(key + _I + _J)
    return (2 * ((1 - b) * low + b * high) - 1) * fade_s * fade_s * fade_t * fade_t


@kernel(error_model="numpy")
def cells(s: float, t: float, cell_s: float, cell_t: float, ws: float, wt: float, seed: int, share: float) -> Any:
    """Mean over a footprint of a grid of flat cells.

    Each cell has a random value in [0, 1); or, with a share above 0, is 1 for that share of them and else 0.
    """
    mean = share if share > 0 else 0.5
    fade = min(2 - ws / cell_s, 1.0) * min(2 - wt / cell_t, 1.0)
    if ws >= 2 * cell_s or wt >= 2 * cell_t:
        return mean
    ws, wt = min(ws, cell_s), min(wt, cell_t)
    i, j = math.floor((s - 0.5 * ws) / cell_s), math.floor((t - 0.5 * wt) / cell_t)
    a = min(max((s + 0.5 * ws - (i + 1) * cell_s) / ws, 0.0), 1.0)
    b = min(max((t + 0.5 * wt - (j + 1) * cell_t) / wt, 0.0), 1.0)
    key = i * _I + j * _J + seed * _SEED
    value = (1 - a) * (1 - b) * _cell(key, share)
    if a > 0:
        value += a * (1 - b) * _cell(key + _I, share)
    if b > 0:
        value += (1 - a) * b * _cell(key + _J, share)
        if a > 0:
            value += a * b * _cell(key + _I + _J, share)
    return mean + (value - mean) * fade


@kernel(error_model="numpy")
def _cell(key: int, share: float) -> Any:
    value = _mixed(key)
    if share > 0:
        return 1.0 if value < share else 0.0
    return value


@kernel(error_model="numpy")
def mix(a: Any, b: Any, k: float) -> Any:
    """Colour a, of which a share k is replaced by colour b."""
    return (a[0] + k * (b[0] - a[0]), a[1] + k * (b[1] - a[1]), a[2] + k * (b[2] - a[2]))


@kernel(error_model="numpy")
def scaled(a: Any, k: float) -> Any:
    """Colour a, k times as bright."""
    return (a[0] * k, a[1] * k, a[2] * k)


@kernel(error_model="numpy")
def print_lines(s: float, t: float, pitch: float, ws: float, wt: float, seed: int) -> Any:
    """Share of ink in lines of words whose letters are blocks of three by four strokes; `pitch` is between lines."""
    if wt > 2 * pitch:
        return 0.25
    row = math.floor(t / pitch)
    line = stripes(t - 0.5 * pitch, pitch, 0.62 * pitch, wt)
    word = cells(s + pitch * hash_unit(row, 7, seed), t, 1.1 * pitch, pitch, ws, wt, seed + 1, 0.8)
    letter = stripes(s, 0.6 * pitch, 0.46 * pitch, ws)
    strokes = cells(s, t, 0.2 * pitch, 0.155 * pitch, ws, wt, seed + 2, 0.55)
    return line * word * letter * strokes


@kernel(error_model="numpy")
def plaster(s: float, t: float, ws: float, wt: float, rgb: Any, contrast: float, seed: int) -> Any:
    """Nearly uniform: stains a metre wide, the roller's traces, a fine grain, and spots where something was once."""
    shade = 0.05 * noise(s, t, 1.3, 1.1, ws, wt, seed) + 0.05 * noise(s, t, 0.31, 0.37, ws, wt, seed + 1)
    shade += 0.10 * noise(s, t, 0.019, 0.023, ws, wt, seed + 2) + 0.06 * noise(s, t, 0.006, 0.006, ws, wt, seed + 3)
    spot = blot(s, t, 0.21, ws, wt, seed + 4, 0.45, 0.012)
    return scaled(rgb, max(1 + contrast * (shade - 0.9 * spot), 0.1))


@kernel(error_model="numpy")
def blot(s: float, t: float, cell: float, ws: float, wt: float, seed: int, share: float, largest_m: float) -> Any:
    """How strongly, 0 to 1, a footprint lies on one of the small spots that a `share` of square cells has.

    A spot is up to twice `largest_m` across, somewhere in its cell, longer or higher, and of some strength.
    """
    if ws > cell or wt > cell:
        return share * (largest_m / cell) ** 2
    i, j = math.floor(s / cell), math.floor(t / cell)
    if hash_unit(i, j, seed) > share:
        return 0.0
    half_s = largest_m * (0.3 + 0.7 * hash_unit(i, j, seed + 101))
    half_t = largest_m * (0.3 + 0.7 * hash_unit(i, j, seed + 102))
    a = s - (i + 0.5) * cell - (2 * hash_unit(i, j, seed + 103) - 1) * (0.5 * cell - half_s)
    b = t - (j + 0.5) * cell - (2 * hash_unit(i, j, seed + 104) - 1) * (0.5 * cell - half_t)
    strength = 0.2 + 0.8 * hash_unit(i, j, seed + 105)
    return strength * cover(a, -half_s, half_s, ws) * cover(b, -half_t, half_t, wt)


@kernel(error_model="numpy")
def carpet(
    s: float, t: float, ws: float, wt: float, rgb: Any, accent: Any, scale_m: float, contrast: float, seed: int
) -> Any:
    """Mottled loops of two yarns in squares laid by quarter turns, with lint and stains; large scales have figures."""
    # Walls stand at round coordinates; a seam along one would lie where rounding decides.
    s, t = s + 0.137, t + 0.071
    i, j = math.floor(s / _CARPET_SQUARE_M), math.floor(t / _CARPET_SQUARE_M)
    pile = cells(s, t, _CARPET_SQUARE_M, _CARPET_SQUARE_M, ws, wt, seed, 0.5) - 0.5
    along, across, w_along, w_across = s, t, ws, wt
    if (i + j) % 2:
        along, across, w_along, w_across = t, s, wt, ws
    # Light yarns come up in streaks along the way a square was woven, and darker ones between them.
    light = cells(along, across, 0.11, 0.022, w_along, w_across, seed + 5, 0.16)
    dark = cells(along, across, 0.08, 0.027, w_along, w_across, seed + 8, 0.13)
    wear = noise(s, t, 1.6, 1.6, ws, wt, seed + 1) + 0.7 * noise(s, t, 0.23, 0.23, ws, wt, seed + 9)
    mottle = 0.5 * noise(s, t, 1.6 * scale_m, 1.6 * scale_m, ws, wt, seed + 2) + 0.6 * noise(
        s, t, 0.028, 0.028, ws, wt, seed + 3
    )
    yarn = cells(s, t, 0.009, 0.007, ws, wt, seed + 4, 0.0) - 0.5
    figure = cells(s, t, 0.2 * scale_m, 0.2 * scale_m, ws, wt, seed + 6, 0.22) if scale_m > 0.15 else 0.0
    shade = 1 + contrast * (0.16 * pile + 0.16 * wear + 0.25 * mottle + 0.5 * yarn - 0.55 * dark)
    seam = max(stripes(s, _CARPET_SQUARE_M, 0.004, ws), stripes(t, _CARPET_SQUARE_M, 0.004, wt))
    share = min(max(contrast * (0.95 * light + 0.25 * (0.5 + mottle) + 0.6 * figure), 0.0), 1.0)
    body = scaled(mix(rgb, accent, share), max(shade, 0.1) * (1 - 0.3 * seam))
    stain = blot(s, t, 0.43, ws, wt, seed + 10, 0.35, 0.05)
    lint = blot(s, t, 0.17, ws, wt, seed + 11, 0.3, 0.012)
    return mix(scaled(body, 1 - 0.6 * contrast * stain), _LINT, 0.8 * contrast * lint)


@kernel(error_model="numpy")
def tiles(
    s: float, t: float, ws: float, wt: float, rgb: Any, accent: Any, scale_m: float, contrast: float, seed: int
) -> Any:
    """Square tiles of slightly different shade, veined and speckled; large ones of terrazzo, with chips of stone."""
    shade = 0.4 * (cells(s, t, scale_m, scale_m, ws, wt, seed, 0.0) - 0.5)
    i, j = math.floor(s / scale_m), math.floor(t / scale_m)
    # Each tile is cut from another place of the stone.
    a, b = s + 17 * hash_unit(i, j, seed + 1), t + 17 * hash_unit(i, j, seed + 2)
    cloud = noise(a, b, 0.14, 0.14, ws, wt, seed + 3) + 0.5 * noise(a, b, 0.05, 0.05, ws, wt, seed + 4)
    sharp = min(max(2 - (ws + wt) / _VEIN_M, 0.0), 1.0)
    vein = 0.1 * (1 - sharp)
    if sharp > 0:
        vein += sharp * max(0.0, 1 - 7 * abs(noise(a, b, 0.19, 0.11, ws, wt, seed + 5) + 0.2 * cloud))
    speck = cells(s, t, 0.008, 0.008, ws, wt, seed + 6, 0.0) - 0.5
    chips = 0.0
    if scale_m > _CHIPPED_FROM_M:
        chips += cells(a, b, 0.024, 0.019, ws, wt, seed + 7, 0.05)
        chips -= 0.8 * cells(a, b, 0.021, 0.027, ws, wt, seed + 8, 0.06)
    body = scaled(rgb, max(1 + contrast * (shade + 0.16 * cloud - 0.35 * vein + 0.3 * speck + 0.9 * chips), 0.1))
    gap = min(0.005, 0.06 * scale_m)
    joint = 1 - (1 - stripes(s, scale_m, gap, ws)) * (1 - stripes(t, scale_m, gap, wt))
    return mix(body, accent, joint)


@kernel(error_model="numpy")
def wood(
    s: float, t: float, ws: float, wt: float, rgb: Any, accent: Any, scale_m: float, contrast: float, seed: int
) -> Any:
    """Planks along s, as wide as the scale and seven times as long, each with its own grain and shade."""
    width, length = scale_m, 7 * scale_m
    row = math.floor(t / width)
    along = s + length * hash_unit(row, 3, seed)
    plank = cells(along, t, length, width, ws, wt, seed + 1, 0.0) - 0.5
    joint = 1 - (1 - stripes(t, width, 0.002, wt)) * (1 - stripes(along, length, 0.002, ws))
    return scaled(grain(along + 3 * row, t, ws, wt, rgb, accent, contrast, seed + 2, 0.3 * plank), 1 - 0.65 * joint)


@kernel(error_model="numpy")
def grain(
    s: float, t: float, ws: float, wt: float, rgb: Any, accent: Any, contrast: float, seed: int, shade: float
) -> Any:
    """Wood whose fibres run along s."""
    bent = t + 0.02 * noise(s, t, 0.5, 0.08, ws, wt, seed)
    ring = noise(s, bent, 0.9, 0.022, ws, wt, seed + 1)
    fibre = noise(s, bent, 0.12, 0.005, ws, wt, seed + 2)
    dark = min(max(0.25 + 0.3 * ring + 0.3 * fibre, 0.0), 1.0)
    return scaled(mix(rgb, accent, 0.45 * contrast * dark), 1 + contrast * (shade + 0.06 * ring))


@kernel(error_model="numpy")
def ceiling(
    s: float, t: float, ws: float, wt: float, rgb: Any, accent: Any, scale_m: float, contrast: float, seed: int
) -> Any:
    """Mineral-fibre panels in a metal grid: small holes and fissures."""
    panel = cells(s, t, scale_m, scale_m, ws, wt, seed, 0.0) - 0.5
    pits = cells(s, t, 0.012, 0.009, ws, wt, seed + 1, 0.12) + 0.6 * max(0.0, noise(s, t, 0.03, 0.02, ws, wt, seed + 2))
    body = scaled(rgb, 1 + contrast * (0.06 * panel - 0.35 * pits))
    bar = 1 - (1 - stripes(s, scale_m, 0.024, ws)) * (1 - stripes(t, scale_m, 0.024, wt))
    edge = 1 - (1 - stripes(s, scale_m, 0.036, ws)) * (1 - stripes(t, scale_m, 0.036, wt))
    return mix(scaled(body, 1 - 0.35 * (edge - bar)), accent, bar)


@kernel(error_model="numpy")
def fabric(
    s: float, t: float, ws: float, wt: float, rgb: Any, accent: Any, scale_m: float, contrast: float, seed: int
) -> Any:
    """A weave with broad folds and stripes as far apart as the scale."""
    fold = noise(s, t, 0.22, 0.45, ws, wt, seed) + 0.4 * noise(s, t, 0.07, 0.12, ws, wt, seed + 1)
    weave = cells(s, t, 0.006, 0.004, ws, wt, seed + 2, 0.0) - 0.5
    stripe = stripes(s, scale_m, 0.18 * scale_m, ws)
    shade = 1 + contrast * (0.16 * fold + 0.3 * weave)
    return scaled(mix(rgb, accent, 0.6 * contrast * stripe), max(shade, 0.1))
