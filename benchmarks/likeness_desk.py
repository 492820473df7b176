"""A desk full of things in the middle of an office, as the real recordings show one: what hand-held cameras look at."""

from __future__ import annotations

import numpy as np

from wheelsight.core.areas import AreaMap
from wheelsight.core.geometry import FloatArray
from wheelsight_sim import Surface, World

_TOP_M = 0.74
_DESK_M = 3.0, 1.7
_ROOM_M = 3.2  # from the middle to each wall
_CEILING_M = 2.8
_THINGS = 90
_SURFACES = {
    "floor": Surface("carpet", (0.33, 0.33, 0.36), (0.55, 0.55, 0.58), 0.05, 0.6, 0.38),
    "ceiling": Surface("ceiling", (0.84, 0.84, 0.82), (0.56, 0.56, 0.55), 0.6, 0.5, 0.82),
    "wall": Surface("plaster", (0.78, 0.76, 0.70), (0.68, 0.66, 0.60), 0.6, 0.3, 0.78),
    "desk": Surface("wood", (0.72, 0.62, 0.48), (0.60, 0.50, 0.38), 0.2, 0.3, 0.62, 0.08),
    "screen": Surface("plain", (0.04, 0.04, 0.05), (0.08, 0.08, 0.09), 1.0, 0.1, 0.05, 0.6),
    "black": Surface("plain", (0.06, 0.06, 0.07), (0.12, 0.12, 0.12), 0.3, 0.3, 0.06, 0.15),
    "grey": Surface("plain", (0.42, 0.43, 0.45), (0.30, 0.31, 0.33), 0.3, 0.3, 0.38, 0.1),
    "books": Surface("books", (0.46, 0.24, 0.20), (0.84, 0.76, 0.60), 0.06, 0.9, 0.5),
    "paper": Surface("poster", (0.88, 0.87, 0.84), (0.12, 0.13, 0.16), 0.3, 0.9, 0.72),
    "red": Surface("poster", (0.85, 0.82, 0.76), (0.68, 0.14, 0.12), 0.3, 0.9, 0.7, 0.1),
    "blue": Surface("poster", (0.80, 0.83, 0.86), (0.10, 0.24, 0.55), 0.3, 0.9, 0.7, 0.1),
    "cloth": Surface("fabric", (0.22, 0.34, 0.55), (0.36, 0.48, 0.66), 0.03, 0.5, 0.44),
    "steel": Surface("plain", (0.6, 0.61, 0.62), (0.45, 0.46, 0.47), 0.5, 0.2, 0.45, 0.55),
}
_LOOSE = ("black", "grey", "books", "paper", "paper", "red", "blue", "cloth", "steel")


def desk_world(seed: int) -> World:
    """The office; its things lie otherwise with another seed."""
    rng = np.random.default_rng([seed, 0xDE5C])
    geoms = [*_room(), *_desk(rng), *_around(rng)]
    materials = [f'<material name="{name}" rgba="{_rgb(surface)} 1"/>' for name, surface in _SURFACES.items()]
    mjcf = "\n".join(
        ['<mujoco model="desk">', "<asset>", *materials, "</asset>", "<worldbody>", *geoms, "</worldbody>", "</mujoco>"]
    )
    route: FloatArray = np.array([(-2.6, -2.0), (2.6, -2.0)])
    size_m = (-_ROOM_M, -_ROOM_M, _ROOM_M, _ROOM_M)
    return World("desk", "a desk in an office", mjcf, _SURFACES, AreaMap(()), route, False, size_m)


def _rgb(surface: Surface) -> str:
    return " ".join(f"{share:g}" for share in surface.rgb)


def _box(name: str, material: str, middle: tuple[float, ...], half: tuple[float, ...], yaw_rad: float = 0.0) -> str:
    turn = f"{np.cos(yaw_rad / 2):.6f} 0 0 {np.sin(yaw_rad / 2):.6f}"
    place, size = (" ".join(f"{x:.4f}" for x in numbers) for numbers in (middle, half))
    return f'<geom name="{name}" type="box" material="{material}" pos="{place}" size="{size}" quat="{turn}"/>'


def _room() -> list[str]:
    r, h = _ROOM_M, _CEILING_M / 2
    geoms = [
        _box("floor", "floor", (0, 0, -0.05), (r, r, 0.05)),
        _box("ceiling", "ceiling", (0, 0, 2.85), (r, r, 0.05)),
    ]
    for k, (x, y) in enumerate(((r, 0), (-r, 0), (0, r), (0, -r))):
        half = (0.05, r, h) if x else (r, 0.05, h)
        geoms.append(_box(f"wall{k}", "wall", (x, y, h), half))
        for at in (-1.8, -0.4, 1.2):
            middle = (0.93 * x, at, 1.5) if x else (at, 0.93 * y, 1.5)
            geoms.append(_box(f"shelf{k}_{at}", "books", middle, (0.15, 0.5, 0.7) if x else (0.5, 0.15, 0.7)))
    return geoms


def _desk(rng: np.random.Generator) -> list[str]:
    """The board, four screens back to back, and what lies and stands on it."""
    length_m, width_m = _DESK_M
    geoms = [_box("desk", "desk", (0, 0, _TOP_M - 0.02), (length_m / 2, width_m / 2, 0.02))]
    geoms += [_box(f"foot{k}", "steel", (x, 0, 0.35), (0.03, 0.7, 0.35)) for k, x in enumerate((-1.4, 1.4))]
    for k, (x, y, yaw_rad) in enumerate(((-0.7, 0.12, 0.1), (0.8, 0.12, -0.1), (-0.6, -0.12, 3.3), (0.7, -0.12, 3.0))):
        geoms.append(_box(f"screen{k}", "screen", (x, y, _TOP_M + 0.27), (0.26, 0.02, 0.17), yaw_rad))
        geoms.append(_box(f"stand{k}", "black", (x, y, _TOP_M + 0.05), (0.1, 0.08, 0.05), yaw_rad))
    for k in range(_THINGS):
        place = rng.uniform((-0.47, -0.46), (0.47, 0.46)) * _DESK_M
        half = rng.uniform((0.02, 0.02, 0.003), (0.14, 0.10, 0.02))
        if rng.random() < 0.35:
            half = rng.uniform((0.02, 0.02, 0.04), (0.08, 0.08, 0.12))
        material = _LOOSE[rng.integers(len(_LOOSE))]
        middle = (float(place[0]), float(place[1]), _TOP_M + float(half[2]) + 1e-4 * k)
        geoms.append(_box(f"thing{k}", material, middle, tuple(half.tolist()), float(rng.uniform(-np.pi, np.pi))))
    return geoms


def _around(rng: np.random.Generator) -> list[str]:
    """Chairs at the desk."""
    geoms = []
    for k, (x, y) in enumerate(((-0.8, 1.35), (0.7, 1.45), (-0.7, -1.4), (0.9, -1.35))):
        yaw_rad = float(rng.uniform(-0.5, 0.5))
        back_y = y + 0.22 * np.sign(y)
        geoms.append(_box(f"seat{k}", "cloth", (x, y, 0.45), (0.24, 0.22, 0.04), yaw_rad))
        geoms.append(_box(f"back{k}", "cloth", (x, back_y, 0.8), (0.22, 0.03, 0.25), yaw_rad))
        geoms.append(_box(f"column{k}", "black", (x, y, 0.2), (0.04, 0.04, 0.2)))
    return geoms
