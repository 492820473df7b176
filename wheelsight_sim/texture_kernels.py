"""Compiled textures: building blocks, textures that repeat, traces of use on walls, pictures of single things."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

from wheelsight.core.compiled import kernel

# All lengths are metres on the surface. Each block takes the width of the pixel's footprint, `ws` and `wt`, and
# answers the mean over it, or what a mean would leave of it: detail finer than a pixel fades instead of flickering.
# Colours are three reflectances.

_MASK = 0xFFFFFFFF
_I, _J, _SEED = 0x27D4EB2F, 0x165667B1, 0x1E3779B1
# What is left of noise then is less than a hundredth of it.
_FADED = 0.1
_LINT = (0.66, 0.64, 0.60)
_CARPET_SQUARE_M = 0.5
_VEIN_M = 0.025
_CHIPPED_FROM_M = 0.25


class PixelFootprint(NamedTuple):
    """Where a pixel's ray meets a face, and how wide the pixel is there; metres along s and t."""

    s: float
    t: float
    ws: float
    wt: float


class Look(NamedTuple):
    """How one thing's surface looks: main and accent reflectances, metres of a pattern, contrast from 0 to 1, seed."""

    rgb: tuple[float, float, float]
    accent: tuple[float, float, float]
    scale_m: float
    contrast: float
    seed: int


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
def carpet(at: PixelFootprint, look: Look) -> Any:
    """Mottled loops of two yarns in squares laid by quarter turns, with lint and stains; large scales have figures."""
    s, t, ws, wt = at
    rgb, accent, scale_m, contrast, seed = look
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
def tiles(at: PixelFootprint, look: Look) -> Any:
    """Square tiles of slightly different shade, veined and speckled; large ones of terrazzo, with chips of stone."""
    s, t, ws, wt = at
    rgb, accent, scale_m, contrast, seed = look
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
def wood(at: PixelFootprint, look: Look) -> Any:
    """Planks along s, as wide as the scale and seven times as long, each with its own grain and shade."""
    s, t, ws, wt = at
    rgb, accent, scale_m, contrast, seed = look
    width, length = scale_m, 7 * scale_m
    row = math.floor(t / width)
    along = s + length * hash_unit(row, 3, seed)
    plank = cells(along, t, length, width, ws, wt, seed + 1, 0.0) - 0.5
    joint = 1 - (1 - stripes(t, width, 0.002, wt)) * (1 - stripes(along, length, 0.002, ws))
    fibres = grain(PixelFootprint(along + 3 * row, t, ws, wt), rgb, accent, contrast, seed + 2, 0.3 * plank)
    return scaled(fibres, 1 - 0.65 * joint)


@kernel(error_model="numpy")
def grain(at: PixelFootprint, rgb: Any, accent: Any, contrast: float, seed: int, shade: float) -> Any:
    """Wood whose fibres run along s."""
    s, t, ws, wt = at
    bent = t + 0.02 * noise(s, t, 0.5, 0.08, ws, wt, seed)
    ring = noise(s, bent, 0.9, 0.022, ws, wt, seed + 1)
    fibre = noise(s, bent, 0.12, 0.005, ws, wt, seed + 2)
    dark = min(max(0.25 + 0.3 * ring + 0.3 * fibre, 0.0), 1.0)
    return scaled(mix(rgb, accent, 0.45 * contrast * dark), 1 + contrast * (shade + 0.06 * ring))


@kernel(error_model="numpy")
def ceiling(at: PixelFootprint, look: Look) -> Any:
    """Mineral-fibre panels in a metal grid: small holes and fissures."""
    s, t, ws, wt = at
    rgb, accent, scale_m, contrast, seed = look
    panel = cells(s, t, scale_m, scale_m, ws, wt, seed, 0.0) - 0.5
    pits = cells(s, t, 0.012, 0.009, ws, wt, seed + 1, 0.12) + 0.6 * max(0.0, noise(s, t, 0.03, 0.02, ws, wt, seed + 2))
    body = scaled(rgb, 1 + contrast * (0.06 * panel - 0.35 * pits))
    bar = 1 - (1 - stripes(s, scale_m, 0.024, ws)) * (1 - stripes(t, scale_m, 0.024, wt))
    edge = 1 - (1 - stripes(s, scale_m, 0.036, ws)) * (1 - stripes(t, scale_m, 0.036, wt))
    return mix(scaled(body, 1 - 0.35 * (edge - bar)), accent, bar)


@kernel(error_model="numpy")
def fabric(at: PixelFootprint, look: Look) -> Any:
    """A weave with broad folds and stripes as far apart as the scale."""
    s, t, ws, wt = at
    rgb, accent, scale_m, contrast, seed = look
    fold = noise(s, t, 0.22, 0.45, ws, wt, seed) + 0.4 * noise(s, t, 0.07, 0.12, ws, wt, seed + 1)
    weave = cells(s, t, 0.006, 0.004, ws, wt, seed + 2, 0.0) - 0.5
    stripe = stripes(s, scale_m, 0.18 * scale_m, ws)
    shade = 1 + contrast * (0.16 * fold + 0.3 * weave)
    return scaled(mix(rgb, accent, 0.6 * contrast * stripe), max(shade, 0.1))


# On walls s runs along the wall, and the other coordinate is the height over the floor.
_SKIRTING_M = 0.08
_SKIRTING = (0.24, 0.23, 0.22)
_BARE = (0.62, 0.58, 0.50)
_RUBBER = (0.16, 0.15, 0.15)
_PLASTIC = (0.86, 0.86, 0.83)
_DARK = (0.08, 0.08, 0.09)
_RED = (0.62, 0.07, 0.06)
_SIGN = ((0.10, 0.30, 0.18), (0.12, 0.22, 0.42), (0.80, 0.79, 0.74))
_TALL_M = 2.0
_FITTINGS_M = 1.7
_PATCH_S_M, _PATCH_T_M = 0.9, 0.7
_SCUFF_S_M, _SCUFF_T_M = 0.40, 0.10
# Bags, trolleys and chairs touch walls up to here.
_TOUCHED_M, _REACHED_M = 1.05, 1.5


@kernel(error_model="numpy")
def used_wall(colour: Any, s: float, height_m: float, wall_m: float, ws: float, wt: float, seed: int) -> Any:
    """A plastered wall's colour with all that happens to walls; one of less than two metres has nothing mounted."""
    colour = scaled(colour, 1 + _retouched(s, height_m, ws, wt, seed + 40))
    colour = mix(colour, _RUBBER, _scuffed(s, height_m, ws, wt, seed + 50))
    if wall_m > _TALL_M:
        colour = _fittings(colour, s, height_m, ws, wt, seed + 60)
    return skirting(colour, s, height_m, ws, wt, seed + 70)


@kernel(error_model="numpy")
def skirting(colour: Any, s: float, height_m: float, ws: float, wt: float, seed: int) -> Any:
    """A wall's colour with the darker board along its foot, which has joints, and paint knocked off."""
    board = cover(height_m, -1.0, _SKIRTING_M, wt)
    if board > 0:
        worn = noise(s, height_m, 0.35, 0.05, ws, wt, seed) + noise(s, height_m, 0.06, 0.02, ws, wt, seed + 1)
        chip = blot(s, height_m, _SKIRTING_M, ws, wt, seed + 2, 0.4, 0.016)
        bright = (1 + 0.15 * worn) * (1 - 0.6 * stripes(s, 2.1, 0.004, ws))
        colour = mix(colour, mix(scaled(_SKIRTING, bright), _BARE, 0.7 * chip), board)
    groove = cover(height_m, _SKIRTING_M, _SKIRTING_M + 0.006, wt)
    return scaled(colour, 1 - 0.5 * groove)


@kernel(error_model="numpy")
def _retouched(s: float, t: float, ws: float, wt: float, seed: int) -> Any:
    """By how much paint laid later differs in shade, -0.07 to 0.07; in patches with straight edges."""
    if ws > 0.5 * _PATCH_S_M or wt > 0.5 * _PATCH_T_M:
        return 0.0
    i, j = math.floor(s / _PATCH_S_M), math.floor(t / _PATCH_T_M)
    if hash_unit(i, j, seed) > 0.35:
        return 0.0
    half_s, half_t = 0.06 + 0.2 * hash_unit(i, j, seed + 1), 0.05 + 0.15 * hash_unit(i, j, seed + 2)
    a = s - (i + 0.5) * _PATCH_S_M - (2 * hash_unit(i, j, seed + 3) - 1) * (0.5 * _PATCH_S_M - half_s)
    b = t - (j + 0.5) * _PATCH_T_M - (2 * hash_unit(i, j, seed + 4) - 1) * (0.5 * _PATCH_T_M - half_t)
    shade = 0.14 * (hash_unit(i, j, seed + 5) - 0.5)
    return shade * cover(a, -half_s, half_s, ws) * cover(b, -half_t, half_t, wt)


@kernel(error_model="numpy")
def _scuffed(s: float, t: float, ws: float, wt: float, seed: int) -> Any:
    """Share of rubber and dirt rubbed off on the wall: streaks, most of them below where hands and chairs reach."""
    if ws > _SCUFF_S_M or wt > _SCUFF_T_M or t < 0:
        return 0.0
    i, j = math.floor(s / _SCUFF_S_M), math.floor(t / _SCUFF_T_M)
    likely = 0.38 if t < _TOUCHED_M else (0.15 if t < _REACHED_M else 0.03)
    if hash_unit(i, j, seed) > likely:
        return 0.0
    half_s = 0.01 + 0.15 * hash_unit(i, j, seed + 1) ** 2
    half_t = 0.0015 + 0.006 * hash_unit(i, j, seed + 2)
    slant = 0.4 * (hash_unit(i, j, seed + 3) - 0.5)
    a = s - (i + 0.5) * _SCUFF_S_M - (2 * hash_unit(i, j, seed + 4) - 1) * (0.5 * _SCUFF_S_M - half_s)
    room = 0.5 * _SCUFF_T_M - half_t - abs(slant) * half_s
    b = t - (j + 0.5) * _SCUFF_T_M - (2 * hash_unit(i, j, seed + 5) - 1) * max(room, 0.0) - slant * a
    share = cover(a, -half_s, half_s, ws) * cover(b, -half_t, half_t, wt + abs(slant) * ws)
    # What rubs along a wall presses hardest in the middle.
    pressed = max(0.0, 1 - (a / (half_s + 0.5 * ws)) ** 2)
    return share * pressed * (0.15 + 0.55 * hash_unit(i, j, seed + 6) ** 2)


@kernel(error_model="numpy")
def _fittings(colour: Any, s: float, t: float, ws: float, wt: float, seed: int) -> Any:
    """What electricians and caretakers mount: of a stretch of wall one thing, or none."""
    if ws > 0.5:
        return colour
    i = math.floor(s / _FITTINGS_M)
    kind = hash_unit(i, 1, seed)
    a = s - (i + 0.5 + 0.6 * (hash_unit(i, 2, seed) - 0.5)) * _FITTINGS_M
    if abs(a) > 0.3 + ws:
        return colour
    if kind < 0.3:
        return _socket(colour, a, t - 0.28, ws, wt)
    if kind < 0.45:
        return _switch(colour, a, t - 1.08, ws, wt)
    if kind < 0.6:
        sign = _SIGN[int(3 * hash_unit(i, 3, seed))]
        return _sign(colour, a, t - 1.2 - 0.4 * hash_unit(i, 4, seed), ws, wt, sign, seed + i)
    if kind < 0.66:
        return _call_point(colour, a, t - 1.35, ws, wt)
    if kind < 0.8:
        duct = _plate(colour, a, t - 1.4, 0.022, 1.4, ws, wt, _PLASTIC)
        lid = stripes(t, 0.93, 0.003, wt) * cover(a, -0.022, 0.022, ws)
        return _socket(scaled(duct, 1 - 0.5 * lid), a, t - 0.4, ws, wt)
    return colour


@kernel(error_model="numpy")
def _plate(under: Any, a: float, b: float, half_a: float, half_b: float, ws: float, wt: float, colour: Any) -> Any:
    """A thing a centimetre thick, with its shadow on the wall below and beside it."""
    shadow = cover(a, -half_a, half_a + 0.007, ws) * cover(b, -half_b - 0.009, half_b, wt)
    return mix(scaled(under, 1 - 0.45 * shadow), colour, cover(a, -half_a, half_a, ws) * cover(b, -half_b, half_b, wt))


@kernel(error_model="numpy")
def _socket(under: Any, a: float, b: float, ws: float, wt: float) -> Any:
    """Two sockets in one frame."""
    if abs(a) > 0.2 + ws or abs(b) > 0.2 + wt:
        return under
    colour = _plate(under, a, b, 0.078, 0.041, ws, wt, _PLASTIC)
    for side in (-1.0, 1.0):
        well = cover(a - 0.037 * side, -0.021, 0.021, ws) * cover(b, -0.021, 0.021, wt)
        colour = mix(colour, scaled(_PLASTIC, 0.45), well)
        for pin in (-1.0, 1.0):
            hole = cover(a - 0.037 * side - 0.0095 * pin, -0.004, 0.004, ws) * cover(b, -0.004, 0.004, wt)
            colour = mix(colour, _DARK, hole)
    return colour


@kernel(error_model="numpy")
def _switch(under: Any, a: float, b: float, ws: float, wt: float) -> Any:
    """A light switch with two rockers, and the wall around it darkened by hands."""
    if abs(a) > 0.3 + ws or abs(b) > 0.3 + wt:
        return under
    touched = 0.12 * max(0.0, 1 - math.hypot(a, b + 0.03) / 0.16)
    colour = _plate(scaled(under, 1 - touched), a, b, 0.041, 0.041, ws, wt, _PLASTIC)
    frame = cover(a, -0.031, 0.031, ws) * cover(b, -0.031, 0.031, wt)
    rocker = cover(a, -0.028, 0.028, ws) * cover(b, -0.028, 0.028, wt)
    split = cover(a, -0.0015, 0.0015, ws) * cover(b, -0.028, 0.028, wt)
    return scaled(colour, 1 - 0.5 * (frame - rocker) - 0.5 * split)


@kernel(error_model="numpy")
def _sign(under: Any, a: float, b: float, ws: float, wt: float, rgb: Any, seed: int) -> Any:
    """A small plate with a few lines on it."""
    if abs(a) > 0.3 + ws or abs(b) > 0.3 + wt:
        return under
    half_a, half_b = 0.07 + 0.07 * hash_unit(1, 5, seed), 0.05 + 0.05 * hash_unit(2, 5, seed)
    ink = print_lines(a, b, 0.028, ws, wt, seed)
    ink *= cover(a, 0.015 - half_a, half_a - 0.015, ws) * cover(b, 0.012 - half_b, half_b - 0.012, wt)
    written = mix(rgb, _DARK if rgb[1] > 0.5 else _PLASTIC, 0.9 * ink)
    return _plate(under, a, b, half_a, half_b, ws, wt, written)


@kernel(error_model="numpy")
def _call_point(under: Any, a: float, b: float, ws: float, wt: float) -> Any:
    """A fire alarm's red box with its pane."""
    if abs(a) > 0.2 + ws or abs(b) > 0.2 + wt:
        return under
    colour = _plate(under, a, b, 0.047, 0.047, ws, wt, _RED)
    colour = mix(colour, _PLASTIC, cover(a, -0.03, 0.03, ws) * cover(b, -0.03, 0.03, wt))
    return mix(colour, _DARK, cover(a, -0.011, 0.011, ws) * cover(b, -0.011, 0.011, wt))


# On single things s runs right and t up from the middle of a face of half size `hs` by `ht`.
_PAPER = (0.84, 0.83, 0.79)
_INK = (0.06, 0.06, 0.08)
_STEEL = (0.52, 0.53, 0.55)
_SHELF_M = 0.34
# What spines, labels and gaps come to from afar.
_MEAN_SPINE = (0.41, 0.40, 0.38)


@kernel(error_model="numpy")
def rectangle(s: float, t: float, left: float, right: float, low: float, high: float, ws: float, wt: float) -> Any:
    """Share of a footprint that lies in a rectangle."""
    if abs(2 * s - left - right) >= right - left + ws or abs(2 * t - low - high) >= high - low + wt:
        return 0.0
    return cover(s, left, right, ws) * cover(t, low, high, wt)


@kernel(error_model="numpy")
def pick_colour(key: int, seed: int, strength: float) -> Any:
    """A printer's colour: any hue, neither glaring nor black; a strength of 0 is grey."""
    hue, light = 6.2832 * hash_unit(key, 11, seed), 0.2 + 0.5 * hash_unit(key, 12, seed)
    k = strength * (0.15 + 0.45 * hash_unit(key, 13, seed))
    return (
        light * (1 + k * math.cos(hue)),
        light * (1 + k * math.cos(hue - 2.0944)),
        light * (1 + k * math.cos(hue + 2.0944)),
    )


@kernel(error_model="numpy")
def door(at: PixelFootprint, hs: float, ht: float, look: Look) -> Any:
    """Frame, leaf with grain, two panels or a slit of glass, handle, kick plate, dents, and a number at eye height."""
    s, t, ws, wt = at
    rgb, accent, _, contrast, seed = look
    side = 1.0 if hash_unit(1, 1, seed) < 0.5 else -1.0
    up, x = t + ht, s * side
    leaf = grain(PixelFootprint(t, s, wt, ws), rgb, scaled(rgb, 0.45), contrast, seed, 0.0)
    if hash_unit(2, 1, seed) < 0.45:
        glass = rectangle(x, up, 0.25 * hs, 0.25 * hs + 0.14, 0.55, 2 * ht - 0.3, ws, wt)
        rim = rectangle(x, up, 0.25 * hs - 0.02, 0.25 * hs + 0.16, 0.53, 2 * ht - 0.28, ws, wt)
        leaf = mix(
            mix(leaf, accent, rim), scaled((0.10, 0.13, 0.15), 1 + 0.8 * noise(s, t, 0.4, 0.3, ws, wt, seed)), glass
        )
    else:
        for low, high in ((0.3, 0.45 * 2 * ht), (0.52 * 2 * ht, 2 * ht - 0.25)):
            outer = rectangle(s, up, -hs + 0.2, hs - 0.2, low, high, ws, wt)
            inner = rectangle(s, up, -hs + 0.215, hs - 0.215, low + 0.015, high - 0.015, ws, wt)
            leaf = scaled(leaf, 1 - 0.4 * (outer - inner) + 0.05 * inner)
    knocked = blot(s, up, 0.19, ws, wt, seed + 7, 0.5, 0.011)
    leaf = scaled(mix(leaf, _STEEL, rectangle(s, up, -hs + 0.08, hs - 0.08, 0.01, 0.2, ws, wt)), 1 - 0.5 * knocked)
    # Lever and plate at hand's height, and the room's number with lines of print.
    leaf = mix(leaf, scaled(_STEEL, 1.1), rectangle(x, up, -hs + 0.1, -hs + 0.15, 0.92, 1.14, ws, wt))
    leaf = mix(leaf, scaled(_STEEL, 0.35), rectangle(x, up, -hs + 0.115, -hs + 0.25, 1.04, 1.065, ws, wt))
    leaf = mix(leaf, _INK, rectangle(x, up, -hs + 0.118, -hs + 0.132, 0.95, 0.985, ws, wt))
    plate = rectangle(s, up, -0.13, 0.13, 1.5, 1.66, ws, wt)
    if plate > 0:
        ink = rectangle(s, up, -0.11, 0.05, 1.57, 1.65, ws, wt) * cells(
            s, up - 1.57, 0.016, 0.02, ws, wt, seed + 5, 0.5
        )
        ink *= stripes(s - 0.024, 0.048 + 0.006, 0.042, ws)
        ink += rectangle(s, up, -0.11, 0.11, 1.51, 1.56, ws, wt) * print_lines(s, up - 1.51, 0.025, ws, wt, seed + 6)
        leaf = mix(leaf, mix(_PAPER, accent if hash_unit(3, 1, seed) < 0.5 else _INK, min(ink, 1.0)), plate)
    frame = 1 - rectangle(s, up, -hs + 0.06, hs - 0.06, -1.0, 2 * ht - 0.06, ws, wt)
    gap = 1 - rectangle(s, up, -hs + 0.068, hs - 0.068, 0.006, 2 * ht - 0.068, ws, wt)
    return mix(scaled(leaf, 1 - 0.8 * gap), accent, frame)


@kernel(error_model="numpy")
def picture(s: float, t: float, w_m: float, ws: float, wt: float, strength: float, seed: int) -> Any:
    """A printed picture w_m wide: a town before hills, or areas within areas, in a few colours and their mixtures."""
    a, b, c = pick_colour(1, seed, strength), pick_colour(2, seed, strength), pick_colour(3, seed, strength)
    cloud = noise(s, t, 0.4 * w_m, 0.3 * w_m, ws, wt, seed + 24)
    if hash_unit(4, 4, seed) < 0.5:
        coarse = cells(s, t, 0.31 * w_m, 0.23 * w_m, ws, wt, seed + 21, 0.0)
        middle = cells(s, t, 0.11 * w_m, 0.13 * w_m, ws, wt, seed + 22, 0.35)
        fine = cells(s, t, 0.045 * w_m, 0.036 * w_m, ws, wt, seed + 23, 0.0)
        return scaled(mix(mix(a, b, coarse), c, 0.6 * middle), max(0.85 + 0.3 * fine + 0.4 * cloud, 0.1))
    # Posters count t from the top, notes from their middle: the town stands in rows, one behind another.
    row_m, house_m = 0.3 * w_m, 0.09 * w_m
    row, house = math.floor(t / row_m), math.floor(s / house_m)
    roof = (0.15 + 0.6 * hash_unit(house, row, seed + 25)) * row_m
    down = t - row * row_m
    sky = scaled(mix(_PAPER, a, 0.5 + 0.4 * cloud), 1 - 0.3 * cover(down, roof - 0.25 * row_m, roof, row_m))
    front = scaled(mix(b, c, hash_unit(house, row, seed + 26)), 0.6 + 0.7 * hash_unit(house, row, seed + 27))
    window = stripes(s - 0.25 * house_m, 0.5 * house_m, 0.26 * house_m, ws) * stripes(t, 0.14 * row_m, 0.08 * row_m, wt)
    lit = cells(s, t, 0.5 * house_m, 0.14 * row_m, ws, wt, seed + 28, 0.6)
    front = mix(front, mix(_INK, _PAPER, lit), 0.8 * window)
    return mix(sky, front, cover(down, roof, row_m, wt))


@kernel(error_model="numpy")
def poster(at: PixelFootprint, hs: float, ht: float, look: Look) -> Any:
    """A frame, a headline, a picture, a chart, and columns of print, laid out by the seed."""
    s, t, ws, wt = at
    rgb, accent, _, contrast, seed = look
    u, v, width, height = s + hs, ht - t, 2 * hs, 2 * ht
    margin = 0.05 * width
    ground = mix(_PAPER, rgb, 0.3 + 0.7 * hash_unit(1, 2, seed))
    bright = ground[0] + ground[1] + ground[2] > 1.1
    ink_colour = _INK if bright else _PAPER
    head, split = 0.16 * height, (0.35 + 0.35 * hash_unit(2, 2, seed)) * height
    colour = ground
    if v < head + wt:
        ink = print_lines(u, v - 0.2 * head, 0.62 * head, ws, wt, seed + 3) * cover(v, 0.2 * head, 0.82 * head, wt)
        band = mix(mix(ground, accent, 0.9), _PAPER, ink * cover(u, margin, width - margin, ws))
        colour = mix(colour, band, cover(v, -1.0, head, wt))
    area = rectangle(u, v, margin, width - margin, head + margin, split - margin, ws, wt)
    if area > 0:
        colour = mix(colour, picture(u, v, width, ws, wt, contrast, seed), area)
    column = (0.5 + 0.4 * hash_unit(3, 2, seed)) * width
    ink = rectangle(u, v, margin, column, split, height - margin, ws, wt)
    if ink > 0:
        ink *= print_lines(u, v, max(0.012, 0.055 * width), ws, wt, seed + 4)
        colour = mix(colour, ink_colour, 0.9 * ink)
    chart = rectangle(u, v, column + 0.04 * width, width - margin, split, height - margin, ws, wt)
    if chart > 0:
        colour = mix(colour, picture(u, v, 0.5 * width, ws, wt, contrast, seed + 50), chart)
    frame = 1 - rectangle(s, t, -hs + 0.012, hs - 0.012, -ht + 0.012, ht - 0.012, ws, wt)
    return mix(colour, accent, frame)


@kernel(error_model="numpy")
def notice_board(at: PixelFootprint, hs: float, ht: float, look: Look) -> Any:
    """Cork in a frame, covered with notes: large sheets below, smaller ones over them, each with its own print."""
    s, t, ws, wt = at
    rgb, accent, scale_m, contrast, seed = look
    cork = 0.5 * noise(s, t, 0.02, 0.02, ws, wt, seed) + (cells(s, t, 0.006, 0.006, ws, wt, seed + 1, 0.0) - 0.5)
    colour = scaled(rgb, 1 + 0.5 * contrast * cork)
    largest = min(max(scale_m, 0.15), 0.45)
    for layer in range(3):
        size = largest * (1.0, 0.66, 0.36)[layer]
        likely = (0.7, 0.55, 0.4)[layer]
        colour = _note(colour, at, hs, ht, size, likely, contrast, seed + 31 * (layer + 1))
    frame = 1 - rectangle(s, t, -hs + 0.035, hs - 0.035, -ht + 0.035, ht - 0.035, ws, wt)
    shadow = 1 - rectangle(s, t, -hs + 0.045, hs - 0.045, -ht + 0.045, ht - 0.055, ws, wt)
    return mix(scaled(colour, 1 - 0.4 * shadow), accent, frame)


@kernel(error_model="numpy")
def _note(
    under: Any, at: PixelFootprint, hs: float, ht: float, size: float, likely: float, contrast: float, seed: int
) -> Any:
    """What is under, or the note pinned over it: one in a cell of a grid, somewhere in the cell and of some size."""
    s, t, ws, wt = at
    if ws > size or wt > size:
        return mix(under, _PAPER, 0.5 * likely)
    i, j = math.floor(s / size), math.floor(t / size)
    if hash_unit(i, j, seed) > likely:
        return under
    half_w, half_h = size * (0.26 + 0.2 * hash_unit(i, j, seed + 1)), size * (0.26 + 0.2 * hash_unit(i, j, seed + 2))
    middle_s = (i + 0.5) * size + (2 * hash_unit(i, j, seed + 3) - 1) * (0.5 * size - half_w)
    middle_t = (j + 0.5) * size + (2 * hash_unit(i, j, seed + 4) - 1) * (0.5 * size - half_h)
    if abs(middle_s) + half_w > hs - 0.04 or abs(middle_t) + half_h > ht - 0.04:
        return under
    a, b = s - middle_s, t - middle_t
    shadow = rectangle(a, b, -half_w + 0.004, half_w + 0.008, -half_h - 0.008, half_h - 0.004, ws, wt)
    sheet = rectangle(a, b, -half_w, half_w, -half_h, half_h, ws, wt)
    if shadow + sheet <= 0:
        return under
    # Paper, headline or picture, lines of print, a pin.
    key = int(hash_unit(i, j, seed + 5) * 65536)
    paper = _PAPER if hash_unit(key, 6, seed) < 0.55 else mix(_PAPER, pick_colour(key, seed, 1.0), 0.75 * contrast)
    margin = 0.14 * half_w
    has_picture = hash_unit(key, 7, seed) < 0.3
    if has_picture:
        inside = rectangle(a, b, -half_w + margin, half_w - margin, -0.2 * half_h, half_h - margin, ws, wt)
        paper = mix(paper, picture(a, b, 2 * half_w, ws, wt, contrast, seed + key), inside)
    else:
        title = rectangle(a, b, -half_w + margin, 0.6 * half_w, 0.62 * half_h, 0.85 * half_h, ws, wt)
        paper = mix(paper, _INK, 0.8 * title)
    high = -0.3 * half_h if has_picture else 0.5 * half_h
    ink = rectangle(a, b, -half_w + margin, half_w - margin, -half_h + margin, high, ws, wt)
    if ink > 0:
        pitch = half_h * (0.12 + 0.25 * hash_unit(key, 8, seed))
        paper = mix(paper, _INK, 0.9 * ink * print_lines(a + half_w, b, pitch, ws, wt, seed + key))
    pin = rectangle(a, b, -0.008, 0.008, half_h - 0.022, half_h - 0.006, ws, wt)
    return mix(scaled(under, 1 - 0.5 * shadow), mix(paper, pick_colour(key + 1, seed, 1.4), pin), sheet)


@kernel(error_model="numpy")
def books(at: PixelFootprint, hs: float, ht: float, look: Look) -> Any:
    """Spines about as wide as the scale, of many heights and colours, in rows with boards between where it is tall."""
    s, t, ws, wt = at
    rgb, _, scale_m, contrast, seed = look
    rows = max(math.floor(2 * ht / _SHELF_M + 0.5), 1)
    pitch = 2 * ht / rows
    thick = 0.025 if rows > 1 else 0.0
    up, clear = t + ht, pitch - thick
    row = math.floor(up / pitch)
    above = up - row * pitch - thick
    back = scaled(rgb, 0.18)
    blurred = min(max(0.7 * ws / scale_m - 1, 0.0), 1.0)
    inside = mix(back, _MEAN_SPINE, cover(above, 0.0, 0.77 * clear, max(wt, 0.3 * clear)))
    if blurred < 1:
        # The book at s, and the next where the footprint reaches over to it. A spine's right edge is moved within its
        # slot; the rest of the slot belongs to the next book.
        column, stands, spines = math.floor(s / scale_m), PixelFootprint(s, above, ws, wt), back
        edge = (column + 0.35 + 0.65 * hash_unit(column, row, seed)) * scale_m
        left = cover(s, edge - 1.0, edge, ws)
        if left > 0:
            spines = mix(spines, _spine(column, row, stands, clear, back, contrast, seed), left)
        if left < 1:
            spines = mix(spines, _spine(column + 1, row, stands, clear, back, contrast, seed), 1 - left)
        inside = mix(scaled(spines, 1 - 0.6 * cover(s, edge - 0.002, edge + 0.002, ws)), inside, blurred)
    if thick == 0:
        return inside
    board = stripes(up - 0.5 * thick, pitch, thick, wt)
    side = 1 - cover(s, -hs + thick, hs - thick, ws)
    return mix(inside, rgb, max(board, side))


@kernel(error_model="numpy")
def _spine(book: int, row: int, at: PixelFootprint, clear: float, back: Any, contrast: float, seed: int) -> Any:
    """A book's spine with label and band, and the shelf's back above it; some books are missing."""
    s, above, ws, wt = at
    if hash_unit(book, row, seed + 2) < 0.07:
        return back
    tall = clear * (0.62 + 0.3 * hash_unit(book, row, seed + 1))
    colour = pick_colour(book * 57 + row, seed, contrast)
    if hash_unit(book, row, seed + 3) < 0.6:
        label = cover(above, 0.55 * tall, 0.8 * tall, wt)
        colour = mix(colour, _PAPER, label * (0.35 + 0.6 * cells(s, above, 0.011, 0.018, ws, wt, seed + 4, 0.45)))
    colour = mix(colour, _INK, 0.5 * cover(above, 0.12 * tall, 0.16 * tall, wt))
    return mix(back, colour, cover(above, 0.0, tall, wt))
