"""Fig. 8 for `trinh_rectification.py`: the floor and its areas, and where a drive went by truth and each method."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from wheelsight.core.errors import InputError
from wheelsight.core.files import atomic_write
from wheelsight.core.geometry import FloatArray
from wheelsight_sim import World

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

INK, GREY, PAPER, WALL, FURNITURE = "#262b33", "#6a717c", "#ffffff", "#4a505b", "#d9d5cd"
TINTS = ("#4e9a51", "#3f7fbf", "#c98a2b", "#8e63b5", "#2f9e9e", "#c25b5b", "#7d8b2f", "#5a6bb8")
WHEELS, METHODS = "#aab1bc", ("#d95f0e", "#0a6fc2")
_MARGIN_M = 1.0
_EYE_M, _THIN_M = 1.9, 0.05
_PANEL_INCHES, _TITLE_INCHES, _LEGEND_INCHES = 6.6, 0.45, 0.4


def draw(
    world: World,
    truth: FloatArray,
    wheels: FloatArray,
    methods: Mapping[str, FloatArray],
    path: Path,
) -> None:
    """Write the figure as PNG: two panels of the same floor, one a method.

    Args:
        world: the floor.
        truth: (N, 2) metres at the frames of a drive.
        wheels: (N, 2) metres, by the wheels alone.
        methods: (N, 2) metres by each of two methods, by its title.
        path: of the picture.

    Raises:
        InputError: matplotlib is missing.
    """
    try:
        from matplotlib.figure import Figure
    except ImportError as error:
        raise InputError("matplotlib is missing", fix="pip install matplotlib") from error
    low, high = _extent(world, [wheels, *methods.values()])
    tall = _PANEL_INCHES * (high - low)[1] / (high - low)[0]
    whole = tall + _TITLE_INCHES + _LEGEND_INCHES
    figure = Figure(figsize=(len(methods) * _PANEL_INCHES, whole), facecolor=PAPER)
    for number, ((title, track), colour) in enumerate(zip(methods.items(), METHODS, strict=True)):
        axes = figure.add_axes(
            (number / len(methods), _LEGEND_INCHES / whole, 1 / len(methods), tall / whole), facecolor=PAPER
        )
        axes.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), aspect="equal")
        axes.set_axis_off()
        _floor(axes, world, truth)
        _lines(axes, truth, wheels, track, colour)
        left = number / len(methods) + 0.12 / (len(methods) * _PANEL_INCHES)
        words = f"{title}: {_off_m(track, truth):.1f} m off"
        figure.text(left, 1 - 0.25 / whole, words, color=colour, fontsize=14, weight="bold", va="center")
    _legend(figure, f"wheels alone: {_off_m(wheels, truth):.1f} m off")
    with atomic_write(path, "wb") as stream:
        figure.savefig(stream, format="png", dpi=120, metadata={"Software": None})


def _off_m(track: FloatArray, truth: FloatArray) -> float:
    return float(np.hypot(*(track - truth).T).mean())


def _extent(world: World, tracks: list[FloatArray]) -> tuple[FloatArray, FloatArray]:
    x_min, y_min, x_max, y_max = world.size_m
    points = np.concatenate([[(x_min, y_min), (x_max, y_max)], *tracks])
    return points.min(axis=0) - _MARGIN_M, points.max(axis=0) + _MARGIN_M


def _floor(axes: Axes, world: World, truth: FloatArray) -> None:
    """Areas in pale colours with their names; walls and what stands on the floor."""
    import shapely
    from matplotlib.collections import PolyCollection

    from wheelsight_sim.clearance import footprints

    seen = [thing for thing in footprints(world) if thing.bottom_m < _EYE_M and thing.top_m > _THIN_M]
    seen = [thing for thing in seen if thing.is_solid or thing.name.startswith(("wall_", "sill_"))]
    crowd = shapely.union_all([*(thing.polygon for thing in seen), shapely.LineString(truth)])
    for index, area in enumerate(world.areas):
        tint = TINTS[index % len(TINTS)]
        axes.add_collection(PolyCollection([area.polygon], facecolors=[tint], alpha=0.2, zorder=1))
        x, y = _free_place(area.polygon, crowd)
        axes.text(x, y, area.name, color=tint, fontsize=11, weight="bold", ha="center", va="center", zorder=9)
    for thing in seen:
        colour = WALL if thing.name.startswith(("wall_", "sill_")) else FURNITURE
        outline = shapely.get_coordinates(thing.polygon)
        axes.add_collection(PolyCollection([outline], facecolors=[colour], edgecolors="none", zorder=3))


def _free_place(polygon: FloatArray, crowd: Any) -> tuple[float, float]:
    """Where in an area a name is farthest from all that is drawn there, up to a metre and a half."""
    import shapely

    x, y = (grid.ravel() for grid in np.meshgrid(*np.linspace(polygon.min(axis=0), polygon.max(axis=0), 41).T))
    middle = polygon.mean(axis=0)
    room_m = np.minimum(shapely.distance(shapely.points(x, y), crowd), 1.5)
    best = int(np.argmax(room_m - 0.02 * np.hypot(x - middle[0], y - middle[1])))
    return float(x[best]), float(y[best])


def _lines(axes: Axes, truth: FloatArray, wheels: FloatArray, track: FloatArray, colour: str) -> None:
    axes.plot(*wheels.T, color=WHEELS, linewidth=1.4, zorder=4, solid_joinstyle="round")
    axes.plot(*truth.T, color=INK, linewidth=2.6, zorder=5, solid_joinstyle="round")
    # A dot a frame: between some of them eq. 5 leaps, and a line alone would look like a way.
    axes.plot(*track.T, color=colour, linewidth=0.9, alpha=0.6, zorder=6, solid_joinstyle="round")
    axes.plot(*track.T, ".", color=colour, markersize=4.5, markeredgewidth=0, zorder=7)
    axes.plot(*truth[0], "o", color=PAPER, markeredgecolor=INK, markeredgewidth=1.6, markersize=7, zorder=8)


def _legend(figure: Figure, wheels: str) -> None:
    """What both panels have in common."""
    from matplotlib.lines import Line2D

    handles = [
        Line2D([], [], color=INK, linewidth=2.6, label="truth"),
        Line2D([], [], color=WHEELS, linewidth=1.6, label=wheels),
        Line2D([], [], color=INK, marker="o", markerfacecolor=PAPER, linewidth=0, label="start"),
        Line2D([], [], color=WALL, linewidth=2.6, label="walls"),
    ]
    figure.legend(handles=handles, loc="lower center", ncols=4, frameon=False, fontsize=11, labelcolor=INK)
