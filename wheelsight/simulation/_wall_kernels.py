"""Compiled traces of use on plastered walls: scuffs, retouched places, sockets, switches, signs, ducts, a skirting.

As in `_texture_kernels`; s runs along the wall, and the other coordinate is the height over the floor.
"""

from __future__ import annotations

import math
from typing import Any

from wheelsight.compiled import kernel
from wheelsight.simulation._texture_kernels import blot, cover, hash_unit, mix, noise, print_lines, scaled, stripes

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
