"""Where a wheelchair can drive: what stands in a world, whether a route keeps clear of it, a picture of both."""

from __future__ import annotations

import io
from dataclasses import dataclass
from itertools import pairwise, product
from pathlib import Path
from typing import NamedTuple

import numpy as np
import shapely
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.collections import PolyCollection
from matplotlib.colors import to_rgba
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.patheffects import withStroke
from numpy.typing import ArrayLike

from wheelsight.core.errors import ConfigError
from wheelsight.core.files import write_bytes
from wheelsight.core.geometry import FloatArray
from wheelsight_sim.world import Surface, World

LOWEST_M = 0.05  # what is lower, a wheelchair rolls over
HIGHEST_M = 1.0  # what is higher, it passes under
_CIRCLE_SEGMENTS = 16  # in a quarter


@dataclass(frozen=True, eq=False)
class GeomOutline:
    """A geom seen from above.

    Attributes:
        name, material: of the geom.
        polygon: shapely, metres.
        bottom_m, top_m: between which heights it reaches.
        is_solid: whether a robot can bump into it.
    """

    name: str
    material: str
    polygon: shapely.Polygon
    bottom_m: float
    top_m: float
    is_solid: bool

    @property
    def is_in_the_way(self) -> bool:
        """Whether a wheelchair runs into it: solid, and between what it rolls over and what it passes under."""
        return self.is_solid and self.top_m > LOWEST_M and self.bottom_m < HIGHEST_M


class Collision(NamedTuple):
    """Where (x, y) a robot on a route first touches something, metres, and which geom; None if it leaves the floor."""

    place: tuple[float, float]
    geom: str | None


def footprints(world: World) -> tuple[GeomOutline, ...]:
    """All geoms but planes, in the MJCF's order."""
    import mujoco

    model, data = world.at_rest()
    kinds = mujoco.mjtGeom
    rounds = [int(kind) for kind in (kinds.mjGEOM_SPHERE, kinds.mjGEOM_CYLINDER, kinds.mjGEOM_ELLIPSOID)]
    found = []
    for k in range(model.ngeom):
        if model.geom_type[k] == kinds.mjGEOM_PLANE:
            continue
        R, middle = data.geom_xmat[k].reshape(3, 3), data.geom_xpos[k]
        centre, half = model.geom_aabb[k, :3], model.geom_aabb[k, 3:]
        corners = middle + (centre + half * np.array(list(product((-1, 1), repeat=3)))) @ R.T
        is_upright_round = int(model.geom_type[k]) in rounds and abs(R[2, 2]) > 0.999
        if is_upright_round:
            polygon = shapely.Point(middle[:2]).buffer(max(half[:2]), _CIRCLE_SEGMENTS)
        else:
            polygon = shapely.MultiPoint(corners[:, :2]).convex_hull
        bottom_m, top_m = float(corners[:, 2].min()), float(corners[:, 2].max())
        is_solid = bool(model.geom_contype[k] or model.geom_conaffinity[k])
        material = model.mat(int(model.geom_matid[k])).name
        found.append(GeomOutline(model.geom(k).name, material, polygon, bottom_m, top_m, is_solid))
    return tuple(found)


def obstacles(world: World) -> shapely.Geometry:
    """The union of everything solid between LOWEST_M and HIGHEST_M over the floor, metres."""
    return shapely.union_all([footprint.polygon for footprint in footprints(world) if footprint.is_in_the_way])


def find_collision(
    world: World, route: ArrayLike, half_width_m: float, *, is_loop: bool | None = None
) -> Collision | None:
    """The first place where a disc of `half_width_m` that follows `route` touches something, or None.

    Args:
        world: to drive in.
        route: (N, 2) waypoints, metres.
        half_width_m: of the robot, with whatever margin is wanted.
        is_loop: whether the way leads back to the first waypoint; None for as `world` has it.
    """
    waypoints = np.asarray(route, float)
    if waypoints.ndim != 2 or waypoints.shape[1] != 2 or len(waypoints) < 2:
        raise ConfigError("a route needs two waypoints or more, each x and y")
    if not np.isfinite(waypoints).all():
        raise ConfigError("a waypoint is not a number")
    if is_loop if is_loop is not None else world.is_loop:
        waypoints = np.vstack([waypoints, waypoints[:1]])
    solid = [footprint for footprint in footprints(world) if footprint.is_in_the_way]
    swollen = [footprint.polygon.buffer(half_width_m) for footprint in solid]
    outside = shapely.box(*shapely.MultiPoint(waypoints).bounds).buffer(1.0) - shapely.box(*world.size_m)
    tree = shapely.STRtree([*swollen, outside])
    names = [*[footprint.name for footprint in solid], None]
    for leg in map(shapely.LineString, pairwise(waypoints)):
        hits = []
        for k in sorted(tree.query(leg, "intersects")):
            places = shapely.points(shapely.get_coordinates(leg.intersection(tree.geometries[k])))
            hits.append((float(np.min(shapely.line_locate_point(leg, places))), names[k]))
        if hits:
            along, name = min(hits, key=lambda hit: hit[0])
            place = leg.interpolate(along)
            return Collision((place.x, place.y), name)
    return None


_WALL, _SILL, _GLASS, _DOOR, _PAPER = "#3d434d", "#8b929c", "#7fb7d9", "#a8642a", "#d9952b"
_ROUTE, _TRACK, _MARK, _INK = "#c2185b", "#1565c0", "#d50000", "#262b33"
_TINTS = ("#4e9a51", "#3f7fbf", "#c98a2b", "#8e63b5", "#2f9e9e", "#c25b5b", "#7d8b2f", "#5a6bb8")
_DOTS_PER_INCH = 150
_LONG_SIDE_INCHES = 11.5
_THIN_M = 0.05  # coverings of the floor end below
_EYE_M = 1.9  # what begins above hangs from the ceiling or spans a doorway, and would hide what is below


def draw_plan(
    world: World,
    path: Path,
    route: ArrayLike | None = None,
    track: ArrayLike | None = None,
    mark: tuple[float, float] | None = None,
    *,
    is_loop: bool | None = None,
) -> None:
    """Write the top view of a world as a PNG picture.

    Drawn are the `route` (N, 2), or else the world's own, the `track` (M, 2) where a robot truly drove, and a place to
    point at, the `mark` (x, y); all in metres. The picture appears whole or not at all.

    Raises:
        OutputError: the picture cannot be written.
    """
    waypoints = np.asarray(world.route if route is None else route, float)
    if is_loop if is_loop is not None else world.is_loop:
        waypoints = np.vstack([waypoints, waypoints[:1]])
    figure, axes = _sheet(world)
    seen = [footprint for footprint in footprints(world) if footprint.bottom_m < _EYE_M]
    layers: dict[int, list[tuple[FloatArray, _Pen]]] = {}
    for footprint in sorted(seen, key=lambda footprint: footprint.top_m):
        pen = _pen_for(footprint, world.surfaces[footprint.material])
        layers.setdefault(pen.layer, []).append((shapely.get_coordinates(footprint.polygon), pen))
    for layer, things in layers.items():
        outlines, pens = zip(*things, strict=True)
        collection = PolyCollection(list(outlines), zorder=layer, linewidths=[pen.width for pen in pens])
        collection.set_facecolor([pen.face for pen in pens])
        collection.set_edgecolor([pen.edge for pen in pens])
        axes.add_collection(collection)
    crowd = shapely.union_all([*[thing.polygon for thing in seen if thing.is_solid], shapely.LineString(waypoints)])
    _draw_areas(axes, world, crowd)
    axes.plot(*waypoints.T, color=_ROUTE, lw=2, zorder=6, solid_joinstyle="round")
    axes.plot(*waypoints.T, "o", ms=4, color=_ROUTE, zorder=6)
    start = waypoints[0]
    axes.plot(*start, "o", ms=9, mfc="white", mec=_ROUTE, mew=2, zorder=8)
    length_m = np.linalg.norm(waypoints[1] - start)
    if length_m > 0:
        x_range, y_range = axes.get_xlim(), axes.get_ylim()
        reach = min(0.045 * max(x_range[1] - x_range[0], y_range[1] - y_range[0]), length_m)
        tip = start + (waypoints[1] - start) / length_m * reach
        arrow = {"arrowstyle": "-|>", "color": _ROUTE, "lw": 2, "mutation_scale": 20, "shrinkA": 5, "shrinkB": 0}
        axes.annotate("", xy=tuple(tip), xytext=tuple(start), arrowprops=arrow, zorder=8)
    lines = [Line2D([], [], color=_ROUTE, lw=2, label="route")]
    if track is not None:
        axes.plot(*np.asarray(track, float).T, color=_TRACK, lw=1.4, zorder=7)
        lines.append(Line2D([], [], color=_TRACK, lw=1.4, label="driven"))
    if mark is not None:
        axes.plot(*mark, "o", ms=22, mfc="none", mec=_MARK, mew=2.5, zorder=9)
        axes.plot(*mark, "x", ms=9, mec=_MARK, mew=2.5, zorder=9)
        lines.append(Line2D([], [], color=_MARK, marker="x", mew=2, lw=0, label="runs into something"))
    handles = [
        *lines,
        Patch(color=_WALL, label="wall"),
        Line2D([], [], color=_GLASS, lw=3, label="window, glass"),
        Line2D([], [], color=_DOOR, lw=3, label="closed door"),
        Line2D([], [], color=_PAPER, lw=3, label="hangs on a wall"),
        Patch(facecolor="#cdbb9e", edgecolor="#6f5a3a", label="furniture"),
    ]
    columns = 4 if len(handles) > 6 else 6
    figure.legend(handles=handles, loc="lower center", ncols=columns, frameon=False, fontsize=8.5, labelcolor=_INK)
    stream = io.BytesIO()
    figure.savefig(stream, format="png", metadata={"Software": None})
    write_bytes(path, stream.getvalue())


def _sheet(world: World) -> tuple[Figure, Axes]:
    """Axes in metres that hold the floor, in the middle of white paper with room for title and legend."""
    x_min, y_min, x_max, y_max = world.size_m
    width_m, height_m = x_max - x_min, y_max - y_min
    inches = _LONG_SIDE_INCHES / max(width_m, height_m * 1.3)
    width, height = max(width_m * inches, 6.5), height_m * inches
    left, right, below, above = 0.6, 0.2, 0.95, 0.5
    sheet = (width + left + right, height + below + above)
    figure = Figure(figsize=sheet, dpi=_DOTS_PER_INCH, facecolor="white")
    FigureCanvasAgg(figure)
    axes = figure.add_axes((left / sheet[0], below / sheet[1], width / sheet[0], height / sheet[1]))
    axes.set(xlim=(x_min, x_max), ylim=(y_min, y_max), aspect="equal")
    axes.set_facecolor("#f7f6f3")
    axes.set_xticks(_ticks(x_min, x_max))
    axes.set_yticks(_ticks(y_min, y_max))
    axes.tick_params(colors=_INK, labelsize=8, length=3)
    axes.set_xlabel("x [m]", color=_INK, fontsize=9)
    axes.set_ylabel("y [m]", color=_INK, fontsize=9)
    for spine in axes.spines.values():
        spine.set_color("#c9ccd1")
    figure.text(left / sheet[0], 1 - 0.3 / sheet[1], world.name, color=_INK, fontsize=14, weight="bold", va="center")
    name_inches = 0.135 * len(world.name) + 0.15
    where = ((left + name_inches) / sheet[0], 1 - 0.31 / sheet[1])
    figure.text(*where, world.description, color="#6a717c", fontsize=10, va="center")
    return figure, axes


def _ticks(low_m: float, high_m: float) -> FloatArray:
    step_m = 5 if high_m - low_m > 15 else 1
    return np.arange(np.ceil(low_m / step_m) * step_m, high_m, step_m)


class _Pen(NamedTuple):
    face: tuple[float, ...]
    edge: tuple[float, ...]
    width: float
    layer: int


def _pen_for(footprint: GeomOutline, surface: Surface) -> _Pen:
    """How to draw a thing: walls, windows and what hangs on walls by what they are, the rest in its own colour."""
    own = np.array(surface.rgb)
    for start, colour, width, layer in (("wall_", _WALL, 0.4, 5), ("sill_", _SILL, 0.4, 4), ("pane_", _GLASS, 1.2, 4)):
        if footprint.name.startswith(start):
            return _Pen(to_rgba(colour), to_rgba(colour), width, layer)
    if footprint.is_solid:
        return _Pen(to_rgba(tuple(0.75 * own + 0.25)), to_rgba(tuple(0.45 * own)), 0.6, 3)
    if footprint.top_m < _THIN_M:
        return _Pen(to_rgba(tuple(0.35 * own + 0.65)), to_rgba("none"), 0.0, 1)
    if surface.kind == "door":
        return _Pen(to_rgba(_DOOR), to_rgba(_DOOR), 2.0, 6)
    return _Pen(to_rgba(_PAPER), to_rgba(_PAPER), 1.4, 6)


def _draw_areas(axes: Axes, world: World, crowd: shapely.Geometry) -> None:
    metres_per_point = float(np.diff(axes.get_xlim())[0]) / (axes.bbox.width / _DOTS_PER_INCH * 72)
    for index, area in enumerate(world.areas.areas):
        tint = _TINTS[index % len(_TINTS)]
        axes.add_collection(PolyCollection([area.polygon], facecolors=[tint], alpha=0.20, zorder=2))
        edges = PolyCollection([area.polygon], facecolors="none", edgecolors=[tint], linewidths=1.0, zorder=2)
        edges.set_linestyle((0, (4, 3)))
        axes.add_collection(edges)
        halo = [withStroke(linewidth=4, foreground="white")]
        size = 15 if len(area.name) < 3 else 11
        # Where in the polygon the name covers the least, as near to its middle as may be.
        width_m, height_m = len(area.name) * 0.65 * size * metres_per_point, size * metres_per_point
        low, high = area.polygon.min(0), area.polygon.max(0)
        x, y = (grid.ravel() for grid in np.meshgrid(*np.linspace(low, high, 25).T))
        words = shapely.box(x - width_m / 2, y - height_m / 2, x + width_m / 2, y + height_m / 2)
        is_inside = shapely.contains_properly(shapely.Polygon(area.polygon), words)
        room_m = np.minimum(shapely.distance(words, crowd), 0.5 * height_m)
        away_m = np.hypot(x - (low[0] + high[0]) / 2, y - (low[1] + high[1]) / 2)
        best = int(np.argmax(np.where(is_inside, 0.0, -1e3) + 10 * room_m - 0.2 * away_m))
        label = axes.text(
            float(x[best]),
            float(y[best]),
            area.name,
            color=tint,
            fontsize=size,
            weight="bold",
            ha="center",
            va="center",
        )
        label.set(zorder=8, path_effects=halo)
