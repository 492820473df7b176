"""Compiled textures of single things, laid out over their whole face: doors, posters, notice boards, bookshelves.

As in `_texture_kernels`; s runs right and t up from the middle of a face of half size `hs` by `ht`.
"""

from __future__ import annotations

import math
from typing import Any

from wheelsight.compiled import kernel
from wheelsight.simulation._texture_kernels import (
    blot,
    cells,
    cover,
    grain,
    hash_unit,
    mix,
    noise,
    print_lines,
    scaled,
    stripes,
)

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
def door(
    s: float, t: float, hs: float, ht: float, ws: float, wt: float, rgb: Any, accent: Any, contrast: float, seed: int
) -> Any:
    """Frame, leaf with grain, two panels or a slit of glass, handle, kick plate, dents, and a number at eye height."""
    side = 1.0 if hash_unit(1, 1, seed) < 0.5 else -1.0
    up, x = t + ht, s * side
    leaf = grain(t, s, wt, ws, rgb, scaled(rgb, 0.45), contrast, seed, 0.0)
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
    leaf = _handle_and_number(leaf, x, s, up, hs, ws, wt, accent, seed)
    frame = 1 - rectangle(s, up, -hs + 0.06, hs - 0.06, -1.0, 2 * ht - 0.06, ws, wt)
    gap = 1 - rectangle(s, up, -hs + 0.068, hs - 0.068, 0.006, 2 * ht - 0.068, ws, wt)
    return mix(scaled(leaf, 1 - 0.8 * gap), accent, frame)


@kernel(error_model="numpy")
def _handle_and_number(
    leaf: Any, x: float, s: float, up: float, hs: float, ws: float, wt: float, accent: Any, seed: int
) -> Any:
    """A leaf's colour with lever and plate at hand's height, and the room's number with lines of print."""
    leaf = mix(leaf, scaled(_STEEL, 1.1), rectangle(x, up, -hs + 0.1, -hs + 0.15, 0.92, 1.14, ws, wt))
    leaf = mix(leaf, scaled(_STEEL, 0.35), rectangle(x, up, -hs + 0.115, -hs + 0.25, 1.04, 1.065, ws, wt))
    leaf = mix(leaf, _INK, rectangle(x, up, -hs + 0.118, -hs + 0.132, 0.95, 0.985, ws, wt))
    plate = rectangle(s, up, -0.13, 0.13, 1.5, 1.66, ws, wt)
    if plate <= 0:
        return leaf
    ink = rectangle(s, up, -0.11, 0.05, 1.57, 1.65, ws, wt) * cells(s, up - 1.57, 0.016, 0.02, ws, wt, seed + 5, 0.5)
    ink *= stripes(s - 0.024, 0.048 + 0.006, 0.042, ws)
    ink += rectangle(s, up, -0.11, 0.11, 1.51, 1.56, ws, wt) * print_lines(s, up - 1.51, 0.025, ws, wt, seed + 6)
    return mix(leaf, mix(_PAPER, accent if hash_unit(3, 1, seed) < 0.5 else _INK, min(ink, 1.0)), plate)


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
def poster(
    s: float, t: float, hs: float, ht: float, ws: float, wt: float, rgb: Any, accent: Any, contrast: float, seed: int
) -> Any:
    """A frame, a headline, a picture, a chart, and columns of print, laid out by the seed."""
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
def notice_board(
    s: float,
    t: float,
    hs: float,
    ht: float,
    ws: float,
    wt: float,
    rgb: Any,
    accent: Any,
    scale_m: float,
    contrast: float,
    seed: int,
) -> Any:
    """Cork in a frame, covered with notes: large sheets below, smaller ones over them, each with its own print."""
    cork = 0.5 * noise(s, t, 0.02, 0.02, ws, wt, seed) + (cells(s, t, 0.006, 0.006, ws, wt, seed + 1, 0.0) - 0.5)
    colour = scaled(rgb, 1 + 0.5 * contrast * cork)
    largest = min(max(scale_m, 0.15), 0.45)
    for layer in range(3):
        size = largest * (1.0, 0.66, 0.36)[layer]
        likely = (0.7, 0.55, 0.4)[layer]
        colour = _note(colour, s, t, hs, ht, ws, wt, size, likely, contrast, seed + 31 * (layer + 1))
    frame = 1 - rectangle(s, t, -hs + 0.035, hs - 0.035, -ht + 0.035, ht - 0.035, ws, wt)
    shadow = 1 - rectangle(s, t, -hs + 0.045, hs - 0.045, -ht + 0.045, ht - 0.055, ws, wt)
    return mix(scaled(colour, 1 - 0.4 * shadow), accent, frame)


@kernel(error_model="numpy")
def _note(
    under: Any,
    s: float,
    t: float,
    hs: float,
    ht: float,
    ws: float,
    wt: float,
    size: float,
    likely: float,
    contrast: float,
    seed: int,
) -> Any:
    """What is under, or the note pinned over it: one in a cell of a grid, somewhere in the cell and of some size."""
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
    key = int(hash_unit(i, j, seed + 5) * 65536)
    paper = _sheet(a, b, half_w, half_h, ws, wt, contrast, seed, key)
    return mix(scaled(under, 1 - 0.5 * shadow), paper, sheet)


@kernel(error_model="numpy")
def _sheet(
    a: float, b: float, half_w: float, half_h: float, ws: float, wt: float, contrast: float, seed: int, key: int
) -> Any:
    """A note's colour at a, b from its middle: paper, headline or picture, lines of print, a pin."""
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
    return mix(paper, pick_colour(key + 1, seed, 1.4), pin)


@kernel(error_model="numpy")
def books(
    s: float, t: float, hs: float, ht: float, ws: float, wt: float, rgb: Any, scale_m: float, contrast: float, seed: int
) -> Any:
    """Spines about as wide as the scale, of many heights and colours, in rows with boards between where it is tall."""
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
        spines = _two_spines(s, row, above, clear, back, ws, wt, scale_m, contrast, seed)
        inside = mix(spines, inside, blurred)
    if thick == 0:
        return inside
    board = stripes(up - 0.5 * thick, pitch, thick, wt)
    side = 1 - cover(s, -hs + thick, hs - thick, ws)
    return mix(inside, rgb, max(board, side))


@kernel(error_model="numpy")
def _two_spines(
    s: float,
    row: int,
    above: float,
    clear: float,
    back: Any,
    ws: float,
    wt: float,
    scale_m: float,
    contrast: float,
    seed: int,
) -> Any:
    """The book at s, and the next where the footprint reaches over to it."""
    column = math.floor(s / scale_m)
    # A spine's right edge is moved within its slot; what is left of the slot belongs to the next book.
    edge = (column + 0.35 + 0.65 * hash_unit(column, row, seed)) * scale_m
    left = cover(s, edge - 1.0, edge, ws)
    inside = back
    if left > 0:
        inside = mix(inside, _spine(column, row, s, above, clear, back, ws, wt, contrast, seed), left)
    if left < 1:
        inside = mix(inside, _spine(column + 1, row, s, above, clear, back, ws, wt, contrast, seed), 1 - left)
    return scaled(inside, 1 - 0.6 * cover(s, edge - 0.002, edge + 0.002, ws))


@kernel(error_model="numpy")
def _spine(
    book: int,
    row: int,
    s: float,
    above: float,
    clear: float,
    back: Any,
    ws: float,
    wt: float,
    contrast: float,
    seed: int,
) -> Any:
    """A book's spine with label and band, and the shelf's back above it; some books are missing."""
    if hash_unit(book, row, seed + 2) < 0.07:
        return back
    tall = clear * (0.62 + 0.3 * hash_unit(book, row, seed + 1))
    colour = pick_colour(book * 57 + row, seed, contrast)
    if hash_unit(book, row, seed + 3) < 0.6:
        label = cover(above, 0.55 * tall, 0.8 * tall, wt)
        colour = mix(colour, _PAPER, label * (0.35 + 0.6 * cells(s, above, 0.011, 0.018, ws, wt, seed + 4, 0.45)))
    colour = mix(colour, _INK, 0.5 * cover(above, 0.12 * tall, 0.16 * tall, wt))
    return mix(back, colour, cover(above, 0.0, tall, wt))
