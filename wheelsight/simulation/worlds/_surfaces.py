"""The materials that worlds are made of: how each looks to the eye and to infrared light.

Colours are reflectances. Infrared reflectances are those of ordinary stuff near 830 nm: paint and paper scatter most of
it, dark dyed cloth and wood less, black plastic, rubber and glass hardly any.
"""

from __future__ import annotations

import zlib
from dataclasses import replace

import numpy as np

from wheelsight.simulation.world import Surface

_WALLS = {
    "plaster_white": Surface("plaster", (0.80, 0.79, 0.76), (0.70, 0.69, 0.66), 0.6, 0.25, 0.80),
    "plaster_cream": Surface("plaster", (0.80, 0.74, 0.61), (0.70, 0.64, 0.52), 0.6, 0.30, 0.76),
    "plaster_grey": Surface("plaster", (0.63, 0.65, 0.66), (0.53, 0.55, 0.57), 0.8, 0.30, 0.68),
    "plaster_sage": Surface("plaster", (0.60, 0.66, 0.57), (0.50, 0.57, 0.48), 0.7, 0.30, 0.70),
    "paint_plain": Surface("plain", (0.78, 0.77, 0.74), (0.78, 0.77, 0.74), 1.0, 0.0, 0.78),
    "panelling": Surface("wood", (0.50, 0.35, 0.22), (0.34, 0.22, 0.13), 0.16, 0.55, 0.55, 0.08),
    "brick_tiles": Surface("tiles", (0.62, 0.36, 0.28), (0.72, 0.68, 0.62), 0.20, 0.60, 0.52),
    "wall_tiles": Surface("tiles", (0.82, 0.84, 0.84), (0.58, 0.60, 0.62), 0.15, 0.60, 0.72, 0.25),
}
_CEILINGS = {
    "ceiling_panels": Surface("ceiling", (0.84, 0.84, 0.82), (0.56, 0.56, 0.55), 0.60, 0.50, 0.82),
    "ceiling_plain": Surface("plain", (0.84, 0.84, 0.82), (0.84, 0.84, 0.82), 1.0, 0.0, 0.82),
    "lamp": Surface("plain", (0.97, 0.97, 0.93), (0.90, 0.90, 0.86), 1.2, 0.1, 0.85, 0.05, glow=5.0),
}
_FLOORS = {
    "tiles_grey": Surface("tiles", (0.52, 0.51, 0.49), (0.34, 0.34, 0.33), 0.40, 0.55, 0.50, 0.20),
    "tiles_light": Surface("tiles", (0.70, 0.66, 0.58), (0.46, 0.43, 0.38), 0.60, 0.55, 0.62, 0.30),
    "tiles_dark": Surface("tiles", (0.30, 0.31, 0.33), (0.50, 0.50, 0.50), 0.30, 0.55, 0.30, 0.25),
    "carpet_blue": Surface("carpet", (0.20, 0.27, 0.40), (0.46, 0.52, 0.62), 0.05, 0.60, 0.36),
    "carpet_brown": Surface("carpet", (0.38, 0.30, 0.24), (0.64, 0.56, 0.47), 0.05, 0.60, 0.42),
    "carpet_grey": Surface("carpet", (0.36, 0.36, 0.37), (0.62, 0.62, 0.62), 0.05, 0.60, 0.38),
    "carpet_red": Surface("carpet", (0.48, 0.17, 0.15), (0.78, 0.64, 0.42), 0.30, 0.70, 0.45),
    "parquet": Surface("wood", (0.62, 0.45, 0.28), (0.42, 0.28, 0.16), 0.12, 0.55, 0.58, 0.12),
    "screed_plain": Surface("plain", (0.58, 0.57, 0.55), (0.58, 0.57, 0.55), 1.0, 0.0, 0.55),
}
_DOORS = {
    "door_oak": Surface("door", (0.56, 0.40, 0.24), (0.32, 0.22, 0.13), 0.95, 0.60, 0.55, 0.08),
    "door_white": Surface("door", (0.82, 0.82, 0.80), (0.45, 0.45, 0.46), 0.95, 0.50, 0.78, 0.08),
    "door_blue": Surface("door", (0.22, 0.34, 0.50), (0.72, 0.73, 0.74), 0.95, 0.60, 0.50, 0.10),
    "door_fire": Surface("door", (0.42, 0.43, 0.45), (0.75, 0.62, 0.20), 1.00, 0.60, 0.42, 0.12),
    "door_lift": Surface("door", (0.62, 0.63, 0.64), (0.30, 0.31, 0.32), 1.10, 0.45, 0.48, 0.60),
}
_PAPER = {
    "poster_red": Surface("poster", (0.85, 0.82, 0.76), (0.68, 0.14, 0.12), 0.60, 0.90, 0.70, 0.10),
    "poster_blue": Surface("poster", (0.80, 0.83, 0.86), (0.10, 0.24, 0.55), 0.60, 0.90, 0.70, 0.10),
    "poster_green": Surface("poster", (0.80, 0.84, 0.74), (0.10, 0.42, 0.20), 0.60, 0.90, 0.68, 0.10),
    "poster_yellow": Surface("poster", (0.88, 0.74, 0.28), (0.16, 0.16, 0.18), 0.60, 0.90, 0.66, 0.10),
    "poster_dark": Surface("poster", (0.14, 0.15, 0.20), (0.84, 0.82, 0.74), 0.60, 0.90, 0.30, 0.12),
    "notice_cork": Surface("notice_board", (0.60, 0.43, 0.27), (0.88, 0.87, 0.82), 0.22, 0.90, 0.58),
    "notice_felt": Surface("notice_board", (0.20, 0.36, 0.32), (0.88, 0.86, 0.80), 0.22, 0.90, 0.40),
    "sign": Surface("poster", (0.14, 0.44, 0.30), (0.92, 0.92, 0.90), 0.35, 0.90, 0.60, 0.10),
    "books": Surface("books", (0.46, 0.24, 0.20), (0.84, 0.76, 0.60), 0.06, 0.90, 0.50),
}
_THINGS = {
    "wood_light": Surface("wood", (0.70, 0.55, 0.36), (0.50, 0.37, 0.22), 0.14, 0.45, 0.60, 0.08),
    "wood_dark": Surface("wood", (0.36, 0.24, 0.16), (0.22, 0.14, 0.09), 0.14, 0.50, 0.40, 0.10),
    "white_board": Surface("plain", (0.90, 0.90, 0.90), (0.70, 0.70, 0.70), 0.6, 0.1, 0.80, 0.25),
    "steel": Surface("plain", (0.60, 0.61, 0.62), (0.45, 0.46, 0.47), 0.5, 0.2, 0.45, 0.55),
    "radiator": Surface("tiles", (0.86, 0.86, 0.84), (0.55, 0.55, 0.54), 0.06, 0.60, 0.75, 0.10),
    "locker": Surface("door", (0.40, 0.50, 0.56), (0.22, 0.27, 0.30), 0.40, 0.60, 0.45, 0.15),
    "machine": Surface("poster", (0.66, 0.12, 0.12), (0.92, 0.90, 0.86), 0.90, 0.90, 0.40, 0.25),
    "plastic_black": Surface("plain", (0.06, 0.06, 0.07), (0.12, 0.12, 0.12), 0.3, 0.3, 0.06, 0.15),
    "plastic_grey": Surface("plain", (0.42, 0.43, 0.45), (0.30, 0.31, 0.33), 0.3, 0.3, 0.38, 0.10),
    "screen": Surface("plain", (0.04, 0.04, 0.05), (0.08, 0.08, 0.09), 1.0, 0.1, 0.05, 0.60),
    "glass": Surface("plain", (0.70, 0.79, 0.85), (0.74, 0.82, 0.87), 1.0, 0.2, 0.04, 0.85),
    "fabric_dark": Surface("fabric", (0.10, 0.11, 0.14), (0.17, 0.18, 0.22), 0.03, 0.50, 0.07),
    "fabric_red": Surface("fabric", (0.55, 0.16, 0.15), (0.68, 0.30, 0.26), 0.03, 0.50, 0.48),
    "fabric_blue": Surface("fabric", (0.22, 0.34, 0.55), (0.36, 0.48, 0.66), 0.03, 0.50, 0.44),
    "fabric_beige": Surface("fabric", (0.68, 0.60, 0.48), (0.56, 0.48, 0.38), 0.04, 0.50, 0.60),
    "linen": Surface("fabric", (0.84, 0.84, 0.88), (0.44, 0.54, 0.72), 0.12, 0.60, 0.75),
    "leaves": Surface("fabric", (0.16, 0.36, 0.14), (0.32, 0.52, 0.22), 0.08, 0.90, 0.55),
    "clay": Surface("plain", (0.62, 0.36, 0.25), (0.52, 0.30, 0.20), 0.2, 0.3, 0.50),
    "concrete": Surface("plaster", (0.56, 0.55, 0.53), (0.44, 0.43, 0.42), 0.3, 0.55, 0.50),
}
PALETTE = {**_WALLS, **_CEILINGS, **_FLOORS, **_DOORS, **_PAPER, **_THINGS}
POSTERS = tuple(name for name in _PAPER if name.startswith("poster_"))

_TINT = 0.05
_BLANK = 0.0  # contrast of what must show nothing, by any seed the same


def painted(name: str, seed: int) -> Surface:
    """The material `name` of the palette as it came out of its tin for `seed`: colours a few percent off."""
    surface = PALETTE[name]
    if surface.contrast == _BLANK:
        return surface
    rng = np.random.default_rng([seed, zlib.crc32(name.encode())])
    light, tints = rng.uniform(-_TINT, _TINT), rng.uniform(-_TINT / 2, _TINT / 2, 3)
    factors = 1 + light + tints
    r, g, b = (
        round(float(min(channel * factor, 1.0)), 4) for channel, factor in zip(surface.rgb, factors, strict=True)
    )
    return replace(surface, rgb=(r, g, b))
