"""How a page looks at a map's points at first: the camera, and the same view as a picture."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from wheelsight.geometry import ByteArray, FloatArray
from wheelsight.mapping.cloud import MapCloud

# As of `cloud.js`.
_FOCAL = 1 / np.tan(np.radians(20))
_POINT_SHARE = 1.5  # how wide a point is, in edges of cubes: less leaves holes
_LEAST_PX, _LARGEST_PX = 2, 9
_SIZE_PX = (560, 960)
_YAW_RAD, _PITCH_RAD = np.radians(-30), np.radians(42)
# Of the points, on each side: strays must not make a room small.
_STRAY_SHARE = 0.02
# A sphere about them is seen whole at 1.06; rooms are flat, and fill the view when it is nearer.
_FILL = 0.95
_WHITE, _ORANGE, _GREEN = 255, (213, 94, 0), (0, 158, 115)


@dataclass(frozen=True, slots=True, eq=False)
class View:
    """Where a reader looks from, in the plan: x to the right, y up the page, z towards the reader.

    Attributes:
        centre: (3,) what is looked at, metres.
        distance_m: from there.
        yaw_rad: 0 looks along y; it grows to the left.
        pitch_rad: from how far above the horizon.
    """

    centre: FloatArray
    distance_m: float
    yaw_rad: float = float(_YAW_RAD)
    pitch_rad: float = float(_PITCH_RAD)

    @classmethod
    def of(cls, position: FloatArray, path: FloatArray) -> View:
        """That holds points (n, 3) but for strays, and a path (m, 3)."""
        low, high = np.quantile(position, [_STRAY_SHARE, 1 - _STRAY_SHARE], axis=0)
        if len(path):
            low, high = np.minimum(low, path.min(axis=0)), np.maximum(high, path.max(axis=0))
        radius_m = max(float(np.linalg.norm(high - low)) / 2, 0.05)
        return cls((low + high) / 2, _FILL * radius_m * float(_FOCAL))

    def to_dict(self) -> dict[str, object]:
        """For the page's script."""
        told = {"distance": self.distance_m, "yaw": self.yaw_rad, "pitch": self.pitch_rad}
        return {"centre": np.round(self.centre, 4).tolist(), **{name: round(value, 5) for name, value in told.items()}}

    @property
    def axes(self) -> FloatArray:
        """(3, 3) rows: to the right of the picture, up, and towards the reader."""
        sin, cos = np.sin(self.yaw_rad), np.cos(self.yaw_rad)
        right = np.array([cos, sin, 0.0])
        back = np.array([np.cos(self.pitch_rad) * sin, -np.cos(self.pitch_rad) * cos, np.sin(self.pitch_rad)])
        return np.stack([right, np.cross(back, right), back])

    def project(self, points: FloatArray, size_px: tuple[int, int] = _SIZE_PX) -> FloatArray:
        """(n, 3) u to the right and v down in pixels of a picture (h, w), and depth in metres, of points (n, 3)."""
        height, width = size_px
        x, y, z = ((points - self.centre) @ self.axes.T).T
        depth = self.distance_m - z
        scale = _FOCAL * height / 2 / np.maximum(depth, 1e-6)
        return np.stack([width / 2 + scale * x, height / 2 - scale * y, depth], axis=-1)


def draw_cloud(
    view: View, position: FloatArray, cloud: MapCloud, R_plan_map: FloatArray, path: FloatArray, loops: FloatArray
) -> ByteArray:
    """The view (h, w, 3) uint8 of points (n, 3) in the plan, with lines (m, 2, 3) of path and loops."""
    image = np.full((*_SIZE_PX, 3), _WHITE, np.uint8)
    towards = view.centre + view.distance_m * view.axes[2] - position
    faces = np.einsum("ij,ij->i", cloud.normal.astype(float) @ R_plan_map.T, towards) > 0
    px = view.project(position[faces])
    _draw_points(image, px, cloud.color[faces], cloud.edge_m)
    for lines, colour in ((loops, _GREEN), (path, _ORANGE)):
        ends = view.project(lines.reshape(-1, 3)).reshape(-1, 2, 3)
        ends = ends[(ends[..., 2] > 0).all(axis=1), :, :2]
        cv2.polylines(image, list(np.rint(ends).astype(np.int32)), False, colour, 2, cv2.LINE_AA)
    return image


def _draw_points(image: ByteArray, px: FloatArray, color: ByteArray, edge_m: float) -> None:
    """Squares, the nearest on top."""
    height, width = _SIZE_PX
    wide_px = _POINT_SHARE * edge_m * _FOCAL * height / 2 / np.maximum(px[:, 2], 1e-6)
    wide = np.rint(wide_px).clip(_LEAST_PX, _LARGEST_PX).astype(np.int64)
    corner = np.rint(px[:, :2] - wide[:, None] / 2)
    order = np.argsort(-px[:, 2], kind="stable")
    order = order[(px[order, 2] > 0) & (np.abs(corner[order]) < 2 * width).all(axis=1)]
    nearest = np.full(height * width, -1, np.int64)
    for dv, du in np.ndindex(_LARGEST_PX, _LARGEST_PX):
        drawn = np.flatnonzero(wide[order] > max(du, dv))
        u, v = corner[order[drawn]].astype(np.int64).T + np.array([[du], [dv]])
        inside = (u >= 0) & (u < width) & (v >= 0) & (v < height)
        np.maximum.at(nearest, v[inside] * width + u[inside], drawn[inside])
    seen = nearest >= 0
    image.reshape(-1, 3)[seen] = color[order[nearest[seen]]]
