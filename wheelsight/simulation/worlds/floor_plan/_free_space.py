"""The free space of a floor plan: rid of what scanners leave, and as polygons with straight sides."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
import shapely
from numpy.typing import ArrayLike

from wheelsight.errors import ConfigError
from wheelsight.geometry import ByteArray, Float32Array, FloatArray, Int32Array
from wheelsight.ros_map import FREE, UNKNOWN, RosMap

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
    grid = _largest_part(_cleaned(plan), plan.resolution_m, width_m)
    outline = _polygon(grid)
    shape = _straightened(outline, straight_m / plan.resolution_m)
    if not is_coarse and _short_share(shape, _SHORT_M / plan.resolution_m) > _JAGGED_SHARE:
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


def _cleaned(plan: RosMap) -> ByteArray:
    """(R, C) uint8 free cells, without specks, shadows and slits."""
    cell_m2 = plan.resolution_m**2
    grid = (plan.occupancy == FREE).astype(np.uint8)
    count, labels, facts, _ = cv2.connectedComponentsWithStats(1 - grid, connectivity=8)
    has_wall = np.bincount(labels.ravel(), weights=(plan.occupancy > FREE).ravel(), minlength=count) > 0
    limit = np.where(has_wall, _SPECK_M2, _SHADOW_M2) / cell_m2
    small = facts[:, cv2.CC_STAT_AREA] < limit
    small[0] = False
    grid[small[labels]] = 1
    reach = max(round(_SLIT_M / plan.resolution_m), 1)
    opened = cv2.morphologyEx(grid, cv2.MORPH_OPEN, _disc(reach))
    # Opening rounds corners of rooms; they grow back, and no more than a stump of a slit does.
    return np.asarray(cv2.dilate(opened, _disc(max(reach // 2, 1))) & grid, np.uint8)


def _largest_part(grid: ByteArray, cell_m: float, width_m: float) -> ByteArray:
    """The connected part of `grid` in which what is `width_m` wide can move about most."""
    away_m = _distance_m(grid, cell_m)
    _, places, facts, _ = cv2.connectedComponentsWithStats((away_m >= width_m / 2).astype(np.uint8), connectivity=8)
    if len(facts) < 2:
        widest_m = 2 * float(away_m.max())
        problem = f"the widest free place of the plan is {widest_m:.2f} m across, and the robot needs {width_m:.2f} m"
        raise ConfigError(problem, fix=f"it misses {width_m - widest_m:.2f} m; is the resolution right?")
    best = 1 + int(np.argmax(facts[1:, cv2.CC_STAT_AREA]))
    row, column = np.argwhere(places == best)[0]
    _, parts = cv2.connectedComponents(grid, connectivity=4)
    return np.asarray(parts == parts[row, column], np.uint8)


def _distance_m(grid: ByteArray, cell_m: float) -> Float32Array:
    """(R, C) from a free cell's middle to the nearest side of a cell that is not free; none is beyond the border."""
    padded = cv2.copyMakeBorder(grid, 1, 1, 1, 1, cv2.BORDER_CONSTANT, value=0)
    distance = np.asarray(cv2.distanceTransform(padded, cv2.DIST_L2, cv2.DIST_MASK_PRECISE), np.float32)[1:-1, 1:-1]
    return np.asarray(np.maximum(distance - 0.5, 0) * cell_m, np.float32)


def _polygon(grid: ByteArray) -> shapely.Polygon:
    """The outline of connected cells, in cells, with its holes: along the cells' sides."""
    steps = np.diff(np.pad(grid, ((0, 0), (1, 1))).astype(np.int8), axis=1)
    (rows, begins), (_, ends) = np.nonzero(steps == 1), np.nonzero(steps == -1)
    return shapely.union_all(shapely.box(begins, rows, ends, rows + 1))


def _straightened(shape: shapely.Polygon, tolerance: float) -> shapely.Polygon:
    """Without the stairs and jags that cells make; walls keep two sides that do not cross."""
    simple = shapely.simplify(shape, tolerance, preserve_topology=True)
    if simple.geom_type != "Polygon":  # cells that touched at a corner have come apart
        simple = max(simple.geoms, key=lambda part: float(part.area))
    return shapely.remove_repeated_points(simple)


def _short_share(shape: shapely.Polygon, short: float) -> float:
    """How much of a polygon's outline are sides that are shorter than `short`."""
    rings = [shapely.get_coordinates(ring) for ring in (shape.exterior, *shape.interiors)]
    lengths = np.concatenate([np.hypot(*np.diff(ring, axis=0).T) for ring in rings])
    return float(lengths[lengths < short].sum() / lengths.sum())


def drawn(shape: shapely.Geometry, plan: RosMap, size: tuple[int, ...], *, is_generous: bool = False) -> ByteArray:
    """(R, C) uint8, 1 for cells whose middles lie within polygons in `map`, as near as an eighth of a cell.

    With `is_generous` those are drawn, too, that a polygon only touches: necks narrower than a cell stay whole.
    """
    grid = np.zeros(size, np.uint8)
    for polygon in shapely.get_parts(shape):
        # Holes are drawn on a sheet of their own: another polygon may lie in one.
        sheet = np.zeros(size, np.uint8)
        for k, ring in enumerate((polygon.exterior, *polygon.interiors)):
            whole = shapely.Polygon(ring)
            shrunk = whole if is_generous else whole.buffer(-_TOUCHED * plan.resolution_m, join_style="mitre")
            _fill(sheet, whole if shrunk.is_empty else shrunk, plan, int(k == 0))
        grid |= sheet
    return grid


def _fill(sheet: ByteArray, polygon: shapely.Geometry, plan: RosMap, value: int) -> None:
    """Set the cells of polygons without holes, with those that an edge touches: half a cell more all round."""
    fraction = 3
    for part in shapely.get_parts(polygon):
        corners = plan.to_cells(shapely.get_coordinates(part.exterior)) - 0.5
        cv2.fillPoly(sheet, [np.round(corners * 2**fraction).astype(np.int32)], value, shift=fraction)


def _disc(reach: int) -> ByteArray:
    return np.asarray(cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * reach + 1, 2 * reach + 1)), np.uint8)
