"""Areas of a building: named polygons on the floor and the coordinates that each one gives (Trinh et al., Fig. 7)."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from difflib import get_close_matches
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from wheelsight.core.errors import AreaError
from wheelsight.core.files import StrPath, write_text
from wheelsight.core.geometry import BoolArray, FloatArray, IntArray

__all__ = ["Area", "AreaError", "AreaMap", "load_areas", "save_areas"]

FORMAT = "wheelsight-areas-1"
_FIELDS = ("name", "polygon", "x_m", "y_m")
_TOP_FIELDS = ("format", "areas")
_LARGEST_OVERLAP_M2 = 1e-4  # corners of one plan rarely meet to the last digit
_SMALLEST_AREA_M2 = 1e-4
_MOST_AREAS = 2000  # more than a building has; the table of neighbours holds all pairs


@dataclass(frozen=True, eq=False)
class Area:
    """A part of the floor that a classifier can distinguish by its appearance.

    Attributes:
        name: its label.
        polygon: (N, 2) corners in the map frame, metres, in either direction, not closed.
        x_m: the coordinate x of a robot in it, or None if it is undetermined, as in a corridor along x.
        y_m: the same for y.

    Raises:
        AreaError: a polygon that crosses itself, has fewer than three corners or no surface; numbers that are not
            finite; no coordinate, or one outside the polygon.
    """

    name: str
    polygon: FloatArray
    x_m: float | None = None
    y_m: float | None = None

    def __post_init__(self) -> None:
        if not self.name.strip():
            raise AreaError("an area has no name", fix="give it one, for labels and forests to use")
        corners = _corners(self.polygon, self.name)
        corners.setflags(write=False)
        object.__setattr__(self, "polygon", corners)
        if self.shape.convex_hull.area < _SMALLEST_AREA_M2:
            raise _area_error(self.name, "has a polygon without surface", "its corners lie on one line or in one place")
        if not self.shape.is_valid:
            raise _area_error(self.name, "has a polygon that crosses itself", "give corners in order around it")
        given = {"x_m": self.x_m, "y_m": self.y_m}
        if all(value is None for value in given.values()):
            raise _area_error(self.name, "has neither x_m nor y_m", "give at least one, else it rectifies nothing")
        for axis, (name, value) in enumerate(given.items()):
            low, high = self.polygon[:, axis].min(), self.polygon[:, axis].max()
            if value is not None and not low <= value <= high:
                problem = f"has {name} {value}, but its polygon reaches from {low:g} to {high:g} m"
                raise _area_error(self.name, problem, "coordinates are metres in the map frame, as the polygon's")

    @cached_property
    def shape(self) -> Any:
        """The polygon as shapely's."""
        import shapely

        return shapely.Polygon(self.polygon)


@dataclass(frozen=True, eq=False)
class AreaMap:
    """Areas that do not overlap; together they may leave floor uncovered.

    Raises:
        AreaError: two areas of one name, two that share more than a border, or over 2000.
    """

    areas: tuple[Area, ...] = ()

    def __post_init__(self) -> None:
        import shapely

        if len(self.areas) > _MOST_AREAS:
            raise AreaError(f"there are more than {_MOST_AREAS:,} areas", fix="is it the right file?")
        for name, count in Counter(self.names).items():
            if count > 1:
                raise _area_error(name, "is there twice", "every area needs a name of its own")
        shapes = np.array([area.shape for area in self.areas], object)
        pairs = np.sort(shapely.STRtree(shapes).query(shapes, predicate="intersects"), axis=0).T
        for first, second in np.unique(pairs[pairs[:, 0] < pairs[:, 1]], axis=0).tolist():
            one, other = self.areas[first], self.areas[second]
            shared_m2 = shapely.intersection(one.shape, other.shape).area
            if shared_m2 > _LARGEST_OVERLAP_M2:
                problem = f"overlaps area {other.name!r} by {shared_m2:.3g} m²"
                raise _area_error(one.name, problem, "areas may touch, not overlap")

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the areas in their order."""
        return tuple(area.name for area in self.areas)

    def __len__(self) -> int:
        return len(self.areas)

    def __iter__(self) -> Iterator[Area]:
        return iter(self.areas)

    def index_of(self, name: str) -> int:
        """Return the index of the area `name`. Raises AreaError if there is none."""
        if name not in self.names:
            raise AreaError(f"no area is called {name!r}", fix=f"areas: {', '.join(self.names) or 'none'}")
        return self.names.index(name)

    def index_at(self, xy: ArrayLike) -> IntArray:
        """Return the index (...) of the area of each point (..., 2) in metres; -1 without area or for NaN.

        A point on a common border belongs to the area that is listed first.
        """
        import shapely

        xy = np.asarray(xy, float)
        found = np.full(xy.shape[:-1], -1, np.int64)
        for index, area in reversed(list(enumerate(self.areas))):
            found[shapely.intersects_xy(area.shape, xy[..., 0], xy[..., 1])] = index
        return found

    def name_at(self, x_m: float, y_m: float) -> str | None:
        """Return the area of a point, or None."""
        index = int(self.index_at(np.array([x_m, y_m])))
        return None if index < 0 else self.areas[index].name

    def adjacency(self, within_m: float = 0.5) -> BoolArray:
        """Return (A, A) whether two areas touch or are within `within_m`.

        Symmetric; an area is its own neighbour. Walls are unknown, so rooms back to back count as neighbours.
        """
        import shapely

        shapes = np.array([area.shape for area in self.areas], object)
        near: BoolArray = shapely.dwithin(shapes[:, None], shapes[None, :], within_m)
        return near


def load_areas(path: StrPath) -> AreaMap:
    """Read an areas.yaml.

    Raises:
        AreaError: with file, area and problem.
    """
    from wheelsight.core.inputs import read_yaml

    document = read_yaml(Path(path), AreaError)
    try:
        if not isinstance(document, dict) or document.get("format") != FORMAT:
            found = document.get("format") if isinstance(document, dict) else None
            raise AreaError(f"field format is {found!r}", fix=f"write format: {FORMAT}")
        _refuse_unknown(document, _TOP_FIELDS, "the file")
        entries = document.get("areas")
        if not isinstance(entries, list) or not entries:
            raise AreaError("field areas is no list of areas", fix="list at least one, with name, polygon, x_m or y_m")
        return AreaMap(tuple(_area(entry, f"area {number}") for number, entry in enumerate(entries, 1)))
    except AreaError as error:
        raise AreaError(error.problem, path=path, fix=error.fix) from error


def save_areas(areas: AreaMap, path: StrPath) -> None:
    """Write an areas.yaml atomically, with all digits. Raises OutputError."""
    path = Path(path)
    import yaml

    entries = []
    for area in areas:
        given = {name: float(value) for name, value in (("x_m", area.x_m), ("y_m", area.y_m)) if value is not None}
        entries.append({"name": area.name, "polygon": area.polygon.tolist(), **given})
    document = {"format": FORMAT, "areas": entries}
    write_text(path, yaml.safe_dump(document, sort_keys=False, default_flow_style=None, width=100, allow_unicode=True))


def _area(entry: Any, where: str) -> Area:
    if not isinstance(entry, dict):
        raise AreaError(f"{where} must hold names and values", fix="name, polygon, x_m, y_m")
    if not isinstance(entry.get("name"), str):
        raise AreaError(f"{where} has the name {entry.get('name')!r}", fix="give a name; numbers in quotes")
    name = entry["name"]
    _refuse_unknown(entry, _FIELDS, f"area {name!r}")
    if "polygon" not in entry:
        raise _area_error(name, "has no polygon", "give its corners: [[x, y], [x, y], [x, y]]")
    coordinates = {}
    for key in ("x_m", "y_m"):
        if (value := entry.get(key)) is None:
            continue
        try:
            coordinates[key] = float(value)  # from text too: YAML 1.1 reads 1e-3, without a dot, as text
        except (TypeError, ValueError):
            coordinates[key] = np.nan
        if isinstance(value, bool) or not np.isfinite(coordinates[key]):
            raise _area_error(name, f"has {key} {value!r}, not a number", "metres in the map frame, or leave it out")
    return Area(name, entry["polygon"], **coordinates)


def _corners(polygon: Any, name: str) -> FloatArray:
    try:
        corners = np.array(polygon, float)
    except (TypeError, ValueError):
        corners = np.empty(0)
    if corners.ndim != 2 or corners.shape[1] != 2:
        raise _area_error(name, "has a polygon that is no list of corners", "give [[x, y], [x, y], [x, y]], metres")
    if len(corners) > 3 and np.array_equal(corners[0], corners[-1]):
        corners = corners[:-1]
    if len(corners) < 3:
        raise _area_error(name, f"has a polygon of {len(corners)} corners", "give at least three")
    if not np.isfinite(corners).all():
        raise _area_error(name, "has a corner that is not finite", "metres in the map frame")
    return corners


def _refuse_unknown(mapping: dict[Any, Any], known: tuple[str, ...], where: str) -> None:
    for key in mapping:
        if key not in known:
            close = get_close_matches(str(key), known, 1, cutoff=0.3)
            hint = f"did you mean {close[0]}?" if close else f"known: {', '.join(known)}"
            raise AreaError(f"{where} has an unknown field {key!r}", fix=hint)


def _area_error(name: str, problem: str, fix: str) -> AreaError:
    return AreaError(f"area {name!r} {problem}", fix=fix)
