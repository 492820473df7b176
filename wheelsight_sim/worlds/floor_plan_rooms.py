"""The free space of a floor plan, its rooms and doorways, and the areas in an image of its rooms."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
import shapely
from numpy.typing import ArrayLike
from shapely.ops import nearest_points

from wheelsight.core.areas import Area
from wheelsight.core.errors import AreaError, ConfigError
from wheelsight.core.geometry import BoolArray, ByteArray, Float32Array, FloatArray, Int32Array
from wheelsight.io.ros_map import FREE, UNKNOWN, RosMap, read_plan_image

CELL_M = 0.05  # plans are worked on in cells of about this size, whatever theirs is
_TOUCHED = 0.49  # of a cell: what OpenCV draws beyond a polygon
_MOST_CELLS = 60_000_000
_COARSE = 1.5
# What is smaller is noise of a scanner, or a foot of a chair: 8 cells of 5 cm, as thick as a leg of a table.
_SPECK_M2 = 0.02
# Unknown places all round which the floor is free are shadows; a chair's is about that large.
_SHADOW_M2 = 0.5
# Slits narrower than twice this are rays of a scanner that passed between things, or behind glass.
_SLIT_M = 0.2
# What is straight within this is drawn straight: a cell of 5 cm, that jambs of doors keep their shape; and two cells of
# coarser plans, whose scans stray by so much.
_STRAIGHT_M, _STRAIGHT_CELLS = 0.06, 2.0
# Outlines a quarter of which are sides shorter than this are jagged (a fifth at most in drawn plans, a third or more in
# raw scans, of the eight buildings tried): these are drawn straight within twice as much, and doors' jambs with them.
_SHORT_M, _JAGGED_SHARE = 0.4, 0.25


@dataclass(frozen=True, eq=False)
class FreeSpace:
    """Where there is floor.

    Attributes:
        grid: (R, C) uint8, 1 where the floor is free; row 0 is the least y.
        plan: of the same cells; turns cells into metres.
        shape: the same in `map`, metres, with straight sides; holes are walls, pillars and furniture.
    """

    grid: ByteArray
    plan: RosMap
    shape: shapely.Polygon

    @property
    def cell_m(self) -> float:
        """Side of a cell."""
        return self.plan.resolution_m

    def distance_m(self) -> Float32Array:
        """(R, C) from a cell's middle to the nearest that is not free."""
        return _distance_m(self.grid, self.cell_m)

    def middle_of(self, cells: ArrayLike) -> FloatArray:
        """(..., 2) in `map` of the middles of cells (..., 2) of row and column."""
        return self.plan.to_map(np.asarray(cells)[..., ::-1] + 0.5)

    def cells_at(self, xy_map: FloatArray) -> Int32Array:
        """(..., 2) row and column of points (..., 2), brought onto the grid."""
        cells = np.floor(self.plan.to_cells(xy_map)).astype(np.int32)[..., ::-1]
        return np.asarray(np.clip(cells, 0, np.array(self.grid.shape) - 1), np.int32)


def free_space_of(plan: RosMap, width_m: float) -> FreeSpace:
    """The part of a plan's free floor in which most can be reached by what is `width_m` wide.

    Unknown cells are closed. Raises ConfigError where it fits nowhere.
    """
    is_coarse = plan.resolution_m > _COARSE * CELL_M
    straight_m = _STRAIGHT_CELLS * plan.resolution_m if is_coarse else _STRAIGHT_M
    plan = _resampled(plan)
    # Free cells, without specks, shadows and slits.
    grid = (plan.occupancy == FREE).astype(np.uint8)
    count, labels, facts, _ = cv2.connectedComponentsWithStats(1 - grid, connectivity=8)
    has_wall = np.bincount(labels.ravel(), weights=(plan.occupancy > FREE).ravel(), minlength=count) > 0
    small = facts[:, cv2.CC_STAT_AREA] < np.where(has_wall, _SPECK_M2, _SHADOW_M2) / plan.resolution_m**2
    small[0] = False
    grid[small[labels]] = 1
    reach = max(round(_SLIT_M / plan.resolution_m), 1)
    opened = cv2.morphologyEx(grid, cv2.MORPH_OPEN, _disc(reach))
    # Opening rounds corners of rooms; they grow back, and no more than a stump of a slit does.
    grid = np.asarray(cv2.dilate(opened, _disc(max(reach // 2, 1))) & grid, np.uint8)
    # The connected part in which what is so wide can move about most.
    away_m = _distance_m(grid, plan.resolution_m)
    _, places, facts, _ = cv2.connectedComponentsWithStats((away_m >= width_m / 2).astype(np.uint8), connectivity=8)
    if len(facts) < 2:
        widest_m = 2 * float(away_m.max())
        problem = f"the widest free place of the plan is {widest_m:.2f} m across, and the robot needs {width_m:.2f} m"
        raise ConfigError(problem, fix=f"it misses {width_m - widest_m:.2f} m; is the resolution right?")
    row, column = np.argwhere(places == 1 + int(np.argmax(facts[1:, cv2.CC_STAT_AREA])))[0]
    _, parts = cv2.connectedComponents(grid, connectivity=4)
    grid = np.asarray(parts == parts[row, column], np.uint8)
    outline = _outline(grid)
    shape = _straightened(outline, straight_m / plan.resolution_m)
    rings = [shapely.get_coordinates(ring) for ring in (shape.exterior, *shape.interiors)]
    sides = np.concatenate([np.hypot(*np.diff(ring, axis=0).T) for ring in rings])
    short = sides[sides < _SHORT_M / plan.resolution_m]
    if not is_coarse and float(short.sum() / sides.sum()) > _JAGGED_SHARE:
        shape = _straightened(outline, 2 * straight_m / plan.resolution_m)
    shape = shapely.transform(shape, plan.to_map)
    return FreeSpace(drawn(shape, plan, grid.shape), plan, shape)


def _resampled(plan: RosMap) -> RosMap:
    """The same in cells of about CELL_M, cut to what is free."""
    rows, columns = (np.flatnonzero((plan.occupancy == FREE).any(axis=axis)) for axis in (1, 0))
    if not len(rows):
        raise ConfigError("no cell of the plan is free", fix="free cells are white; or is it negated?")
    if len(rows) * len(columns) * (plan.resolution_m / CELL_M) ** 2 > _MOST_CELLS:
        size = f"{len(columns) * plan.resolution_m:.0f} × {len(rows) * plan.resolution_m:.0f} m"
        raise ConfigError(f"the plan's free floor is {size} large", fix="is its resolution right? metres a cell")
    low = np.maximum([rows[0] - 2, columns[0] - 2], 0)
    cut = plan.occupancy[low[0] : rows[-1] + 3, low[1] : columns[-1] + 3]
    x_m, y_m = plan.to_map(low[::-1]).tolist()
    origin = x_m, y_m, plan.origin[2]
    ratio = plan.resolution_m / CELL_M
    if 1 / _COARSE < ratio < _COARSE:
        return RosMap(cut, plan.resolution_m, origin)
    if ratio > 1:
        times = round(ratio)
        return RosMap(cut.repeat(times, axis=0).repeat(times, axis=1), plan.resolution_m / times, origin)
    times = round(1 / ratio)
    padded = np.pad(cut, [(0, -side % times) for side in cut.shape], constant_values=UNKNOWN)
    blocks = padded.reshape(padded.shape[0] // times, times, padded.shape[1] // times, times)
    # A thin wall must not get lost among free cells, nor a free block in one that is unknown.
    share_free = (blocks == FREE).mean(axis=(1, 3))
    merged = np.where(blocks.max(axis=(1, 3)) > FREE, blocks.max(axis=(1, 3)), np.where(share_free > 0.5, FREE, -1))
    return RosMap(merged.astype(np.int8), plan.resolution_m * times, origin)


def _distance_m(grid: ByteArray, cell_m: float) -> Float32Array:
    """(R, C) from a free cell's middle to the nearest side of a cell that is not free; none is beyond the border."""
    padded = cv2.copyMakeBorder(grid, 1, 1, 1, 1, cv2.BORDER_CONSTANT, value=0)
    distance = np.asarray(cv2.distanceTransform(padded, cv2.DIST_L2, cv2.DIST_MASK_PRECISE), np.float32)[1:-1, 1:-1]
    return np.asarray(np.maximum(distance - 0.5, 0) * cell_m, np.float32)


def _outline(marked: ByteArray | BoolArray) -> shapely.Geometry:
    """The outline of marked cells (R, C), in cells, with its holes: along the cells' sides."""
    steps = np.diff(np.pad(marked.astype(np.int8), ((0, 0), (1, 1))), axis=1)
    (rows, begins), (_, ends) = np.nonzero(steps == 1), np.nonzero(steps == -1)
    return shapely.union_all(shapely.box(begins, rows, ends, rows + 1))


def _straightened(shape: shapely.Polygon, tolerance: float) -> shapely.Polygon:
    """Without the stairs and jags that cells make; walls keep two sides that do not cross."""
    simple = shapely.simplify(shape, tolerance, preserve_topology=True)
    if simple.geom_type != "Polygon":  # cells that touched at a corner have come apart
        simple = max(simple.geoms, key=lambda part: float(part.area))
    return shapely.remove_repeated_points(simple)


def drawn(shape: shapely.Geometry, plan: RosMap, size: tuple[int, ...], *, is_generous: bool = False) -> ByteArray:
    """(R, C) uint8, 1 for cells whose middles lie within polygons in `map`, as near as an eighth of a cell.

    With `is_generous` those are drawn, too, that a polygon only touches: necks narrower than a cell stay whole.
    """
    grid, fraction = np.zeros(size, np.uint8), 3
    for polygon in shapely.get_parts(shape):
        # Holes are drawn on a sheet of their own: another polygon may lie in one.
        sheet = np.zeros(size, np.uint8)
        for k, ring in enumerate((polygon.exterior, *polygon.interiors)):
            whole = shapely.Polygon(ring)
            shrunk = whole if is_generous else whole.buffer(-_TOUCHED * plan.resolution_m, join_style="mitre")
            for piece in shapely.get_parts(whole if shrunk.is_empty else shrunk):
                corners = plan.to_cells(shapely.get_coordinates(piece.exterior)) - 0.5
                cv2.fillPoly(sheet, [np.round(corners * 2**fraction).astype(np.int32)], int(k == 0), shift=fraction)
        grid |= sheet
    return grid


def _disc(reach: int) -> ByteArray:
    return np.asarray(cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * reach + 1, 2 * reach + 1)), np.uint8)


# Doors have 0.7 to 1.2 m between their jambs (DIN 18101), in scans up to 1.4.
_NARROWEST_M, _WIDEST_M = 0.65, 1.4
# What opens behind a doorway is wider than it: half a room's width over half the doorway's.
_OPENS_BY_M = 0.2
_LOOK_M = 0.9  # within which it opens
_JAMB_M = 0.3  # of wall beside a doorway; less is a pillar, or furniture
_THICKEST_M = 0.6
_APART_M = 0.8
_STRIDE = 2  # of cells by which rooms are separated


@dataclass(frozen=True, slots=True)
class Doorway:
    """A gap in a wall that a door fits in.

    Attributes:
        left, right: its jambs in `map`, metres, in the middle of the wall.
        thickness_m: of the wall.
    """

    left: tuple[float, float]
    right: tuple[float, float]
    thickness_m: float

    @property
    def width_m(self) -> float:
        """Between the jambs."""
        return float(np.hypot(self.right[0] - self.left[0], self.right[1] - self.left[1]))

    @property
    def middle(self) -> tuple[float, float]:
        """Between the jambs, metres."""
        return (self.left[0] + self.right[0]) / 2, (self.left[1] + self.right[1]) / 2

    @property
    def yaw_rad(self) -> float:
        """Of the direction from left to right."""
        return float(np.arctan2(self.right[1] - self.left[1], self.right[0] - self.left[0]))

    @property
    def onward(self) -> FloatArray:
        """(2,) unit vector through the doorway, to the left of the line from its left jamb to the right one."""
        return np.array([-np.sin(self.yaw_rad), np.cos(self.yaw_rad)])


@dataclass(frozen=True, eq=False)
class Rooms:
    """The parts of a floor between its narrow places.

    Attributes:
        labels: (R', C') int32, the room of every second cell in each direction, -1 where none is.
        doorways: between them.
    """

    labels: Int32Array
    doorways: tuple[Doorway, ...]

    def room_at(self, space: FreeSpace, xy_map: FloatArray) -> Int32Array:
        """(...) the room of points (..., 2) in `map`, -1 for none."""
        cells = np.minimum(space.cells_at(xy_map) // _STRIDE, np.array(self.labels.shape) - 1)
        return np.asarray(self.labels[cells[..., 0], cells[..., 1]], np.int32)


def find_rooms(space: FreeSpace) -> Rooms:
    """The rooms of a floor, and the doorways where they meet."""
    away_m = space.distance_m()
    labels, saddles = _basins(away_m[::_STRIDE, ::_STRIDE])
    boundary = space.shape.boundary
    found: list[Doorway] = []
    for cell in saddles:
        place = space.middle_of(np.array(cell) * _STRIDE)
        doorway = _doorway_at(space, boundary, away_m, place)
        if doorway is not None and all(np.hypot(*np.subtract(doorway.middle, d.middle)) > _APART_M for d in found):
            found.append(doorway)
    return Rooms(labels, tuple(found))


def _basins(away_m: Float32Array) -> tuple[Int32Array, list[tuple[int, int]]]:
    """Labels (R, C) of the basins around the roomiest places, and the cells (row, column) where two of them meet.

    Cells are flooded from the roomiest on; basins that meet join, unless both are wider by _OPENS_BY_M than where
    they meet, and that is as narrow as a doorway.
    """
    rows, columns = away_m.shape
    flat = np.pad(away_m, 1).ravel()
    width = columns + 2
    order = np.flatnonzero(flat)[np.argsort(-flat[flat > 0], kind="stable")].tolist()
    values = flat.tolist()
    label = [-1] * len(flat)
    parent: list[int] = []
    peak: list[float] = []
    saddles: list[int] = []
    around = (-width - 1, -width, -width + 1, -1, 1, width - 1, width, width + 1)

    def root(k: int) -> int:
        while parent[k] != k:
            parent[k] = parent[parent[k]]
            k = parent[k]
        return k

    for cell in order:
        near = {root(label[cell + step]) for step in around if label[cell + step] >= 0}
        if not near:
            label[cell] = len(parent)
            parent.append(len(parent))
            peak.append(values[cell])
            continue
        best, *others = sorted(near, key=lambda k: -peak[k])
        label[cell] = best
        for other in others:
            if peak[other] >= values[cell] + _OPENS_BY_M and 2 * values[cell] <= _WIDEST_M:
                saddles.append(cell)
            else:
                parent[other] = best
    names = np.array([root(k) for k in range(len(parent))] + [-1], np.int32)
    labels = names[np.array(label)].reshape(rows + 2, width)[1:-1, 1:-1]
    return np.asarray(labels, np.int32), [(cell // width - 1, cell % width - 1) for cell in saddles]


def _doorway_at(
    space: FreeSpace, boundary: shapely.Geometry, away_m: Float32Array, place: FloatArray
) -> Doorway | None:
    """The doorway around a place, if it is one: jambs of wall, wider on both sides."""
    near = shapely.intersection(boundary, shapely.Point(place).buffer(_WIDEST_M))
    if near.is_empty:
        return None
    left = _nearest(near, place)
    across = (place - left) / max(float(np.hypot(*(place - left))), 1e-9)
    onward = np.array([-across[1], across[0]])
    # The other jamb lies about opposite: within 45° of the line from the first through the place.
    reach = 2 * _WIDEST_M
    wedge = shapely.Polygon([place, place + reach * (across + onward), place + reach * (across - onward)])
    opposite = shapely.intersection(near, wedge)
    if opposite.is_empty:
        return None
    right = _nearest(opposite, left)
    width_m = float(np.hypot(*(right - left)))
    if not _NARROWEST_M <= width_m <= _WIDEST_M:
        return None
    across = (right - left) / width_m
    onward = np.array([-across[1], across[0]])
    middle = (left + right) / 2
    both = middle + _LOOK_M * np.array([onward, -onward])
    cells = space.cells_at(both)
    if (away_m[cells[:, 0], cells[:, 1]] < width_m / 2 + _OPENS_BY_M / 2).any():
        return None
    # The thickness of the wall, which must be on both sides of the doorway.
    depths_m = np.arange(-_THICKEST_M, _THICKEST_M + 0.01, space.cell_m / 2)
    out_m = np.arange(width_m / 2 + space.cell_m, width_m / 2 + _JAMB_M, space.cell_m)
    sides = np.concatenate([out_m, -out_m])
    places = middle + depths_m[:, None, None] * onward + sides[None, :, None] * across
    cells = space.cells_at(places)
    is_wall: BoolArray = (space.grid[cells[..., 0], cells[..., 1]] == 0).all(axis=1)
    centre = len(depths_m) // 2
    if not is_wall[centre - 1 : centre + 2].any():
        return None
    first = last = centre - 1 + int(np.argmax(is_wall[centre - 1 : centre + 2]))
    while first > 0 and is_wall[first - 1]:
        first -= 1
    while last + 1 < len(depths_m) and is_wall[last + 1]:
        last += 1
    thickness_m = float(depths_m[last] - depths_m[first]) + space.cell_m / 2
    if thickness_m > _THICKEST_M:
        return None
    middle = middle + onward * float(depths_m[first] + depths_m[last]) / 2
    left, right = middle - across * width_m / 2, middle + across * width_m / 2
    return Doorway((float(left[0]), float(left[1])), (float(right[0]), float(right[1])), max(thickness_m, 0.08))


def _nearest(shape: shapely.Geometry, place: FloatArray) -> FloatArray:
    """The point (2,) of a shape nearest to a place."""
    return np.array(shapely.shortest_line(shapely.Point(place), shape).coords[-1])


_SMALLEST_M2 = 1.0
_AREAS_NARROWEST_M = 0.7
_MOST_COLOURS = 500
_LEAST_FREE = 0.7  # of a room; walls and the world outside have colours, too
_AREAS_STRAIGHT_M = 0.1
_CUT_M = 0.004  # polygons of areas have no holes: a cut leads into each
_LONGEST_KNOWN_M = 10.0  # a longer area gives no coordinate along its length, as corridors of Trinh et al., Fig. 7


def read_room_areas(path: Path, plan: RosMap) -> list[Area]:
    """An area for each region of one colour in the image that is free floor in `plan`, numbered from the lower left.

    Raises:
        AreaError: the image is of another size than the plan's, shows no room, or is no drawing of rooms.
        MapError: it cannot be read.
    """
    image = read_plan_image(path)
    if image.shape[:2] != plan.occupancy.shape:
        sizes = [f"{size[1]}×{size[0]}" for size in (image.shape, plan.occupancy.shape)]
        raise AreaError(f"is {sizes[0]} pixels, and the plan {sizes[1]}", path=path, fix="draw rooms into the plan")
    labels = _regions(np.ascontiguousarray(image[::-1]), _SMALLEST_M2 / plan.resolution_m**2, path)
    sizes_m2 = np.bincount(labels.ravel()) * plan.resolution_m**2
    free = np.bincount(labels.ravel(), weights=(plan.occupancy == FREE).ravel()) * plan.resolution_m**2
    rooms = np.flatnonzero((sizes_m2 >= _SMALLEST_M2) & (free >= _LEAST_FREE * sizes_m2))
    taken: shapely.Geometry = shapely.Polygon()
    areas: list[Area] = []
    for room in rooms:
        # A region (H, W) as polygons in `map`, with straight sides.
        shape = shapely.simplify(
            _outline(labels == room), _AREAS_STRAIGHT_M / plan.resolution_m, preserve_topology=True
        )
        polygon = shapely.transform(shape, plan.to_map)
        if polygon.buffer(-_AREAS_NARROWEST_M / 2).is_empty:  # softened edges, and gaps between lines
            continue
        polygon = _whole(shapely.difference(polygon, taken.buffer(_CUT_M)))
        if polygon is not None:
            taken = shapely.union(taken, polygon)
            name = str(len(areas) + 1)
            corners: FloatArray = shapely.get_coordinates(polygon)[:-1]
            low, high = corners.min(axis=0), corners.max(axis=0)
            middle, spans = (low + high) / 2, high - low
            is_known = spans <= max(_LONGEST_KNOWN_M, float(spans.min()))
            areas.append(
                Area(name, corners, *(float(m) if known else None for m, known in zip(middle, is_known, strict=True)))
            )
    if not areas:
        raise AreaError("shows no room on the plan's free floor", path=path, fix="one colour a room, or lines between")
    return areas


def _regions(image: ByteArray, least_px: float, path: Path) -> Int32Array:
    """(H, W) numbers of the connected regions of one colour, 0 for colours that have too few pixels for a room."""
    flat = image if image.ndim == 3 else image[..., None]
    colours = (flat.astype(np.int64) << (8 * np.arange(flat.shape[2]))).sum(axis=2)
    labels = np.zeros(colours.shape, np.int32)
    values, counts = np.unique(colours, return_counts=True)
    values = values[counts >= least_px]
    if len(values) > _MOST_COLOURS:
        problem = f"has {len(values)} colours that are large enough for rooms"
        raise AreaError(problem, path=path, fix="one colour a room")
    for value in values:
        _, found = cv2.connectedComponents((colours == value).astype(np.uint8), connectivity=4)
        labels = np.where(found > 0, found + labels.max(), labels).astype(np.int32)
    return labels


def _whole(shape: shapely.Geometry) -> shapely.Polygon | None:
    """The largest polygon of a shape, cut open where it has holes; None where there is none large enough."""
    largest = max(shapely.get_parts(shape), key=lambda part: float(part.area), default=None)
    if largest is None or largest.area < _SMALLEST_M2 / 2 or largest.geom_type != "Polygon":
        return None
    for _ in range(len(largest.interiors)):
        if not len(largest.interiors):
            break
        hole = shapely.Polygon(largest.interiors[0])
        others = [largest.exterior, *largest.interiors[1:]]
        cut = shapely.LineString(nearest_points(hole, shapely.union_all(others)))
        parts = shapely.get_parts(shapely.difference(largest, cut.buffer(_CUT_M, cap_style="square")))
        largest = max(parts, key=lambda part: float(part.area))
    simple = shapely.Polygon(largest.exterior)
    return simple if simple.is_valid else None
