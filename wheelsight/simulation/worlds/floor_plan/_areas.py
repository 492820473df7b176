"""Areas of a building from an image of its rooms: one colour a room, or rooms parted by lines."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import shapely
from shapely.ops import nearest_points

from wheelsight.areas import Area
from wheelsight.errors import AreaError
from wheelsight.geometry import ByteArray, FloatArray, Int32Array
from wheelsight.ros_map import FREE, RosMap, read_plan_image

_SMALLEST_M2 = 1.0
_NARROWEST_M = 0.7
_MOST_COLOURS = 500
_LEAST_FREE = 0.7  # of a room; walls and the world outside have colours, too
_STRAIGHT_M = 0.1
_CUT_M = 0.004  # polygons of areas have no holes: a cut leads into each
_TELLS_WITHIN_M = 10.0  # an area that is longer tells nothing along its length, as corridors of Trinh et al., Fig. 7


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
        polygon = _outline(labels == room, plan)
        if polygon.buffer(-_NARROWEST_M / 2).is_empty:  # softened edges, and gaps between lines
            continue
        polygon = _whole(shapely.difference(polygon, taken.buffer(_CUT_M)))
        if polygon is not None:
            taken = shapely.union(taken, polygon)
            areas.append(_area(str(len(areas) + 1), polygon))
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
        raise AreaError(
            f"has {len(values)} colours that are large enough for rooms", path=path, fix="one colour a room"
        )
    for value in values:
        _, found = cv2.connectedComponents((colours == value).astype(np.uint8), connectivity=4)
        labels = np.where(found > 0, found + labels.max(), labels).astype(np.int32)
    return labels


def _outline(mask: np.ndarray[tuple[int, ...], np.dtype[np.bool_]], plan: RosMap) -> shapely.Geometry:
    """A region (H, W) as polygons in `map`, with straight sides."""
    steps = np.diff(np.pad(mask.astype(np.int8), ((0, 0), (1, 1))), axis=1)
    (rows, begins), (_, ends) = np.nonzero(steps == 1), np.nonzero(steps == -1)
    shape = shapely.union_all(shapely.box(begins, rows, ends, rows + 1))
    shape = shapely.simplify(shape, _STRAIGHT_M / plan.resolution_m, preserve_topology=True)
    return shapely.transform(shape, plan.to_map)


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


def _area(name: str, polygon: shapely.Polygon) -> Area:
    corners: FloatArray = shapely.get_coordinates(polygon)[:-1]
    low, high = corners.min(axis=0), corners.max(axis=0)
    middle, spans = (low + high) / 2, high - low
    tells = spans <= max(_TELLS_WITHIN_M, float(spans.min()))
    return Area(name, corners, *(float(m) if told else None for m, told in zip(middle, tells, strict=True)))
