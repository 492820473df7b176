"""Images and data in a page: matches between two frames, a cloud of points, and packed bytes."""

from __future__ import annotations

import base64
import json
import zlib
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np

from wheelsight.app.run.run_record import MatchPicture
from wheelsight.core.geometry import ByteArray, FloatArray
from wheelsight.mapping.plan import MapCloud

INLIER_RGB = (0, 158, 115)
OUTLIER_RGB = (213, 94, 0)
_HALO_RGB = (255, 255, 255)
_PANEL_WIDTH_PX = 640
_GUTTER_PX = 6
_DRAWN_LINES = 100
_SUBPIXEL_BITS = 4


def draw_matches(picture: MatchPicture) -> ByteArray:
    """The reference frame (left) and the current frame (right) with their matches, (H, W, 3) uint8, red green blue.

    Each match is marked in both images, inliers with circles, outliers with crosses; about 100 of them,
    evenly chosen, are joined by a line. Images wider than 640 px are drawn smaller.
    """
    left, left_scale = _panel(picture.reference_color)
    right, right_scale = _panel(picture.color)
    canvas = np.full((max(len(left), len(right)), left.shape[1] + _GUTTER_PX + right.shape[1], 3), 255, np.uint8)
    canvas[: len(left), : left.shape[1]] = left
    canvas[: len(right), left.shape[1] + _GUTTER_PX :] = right
    start = np.asarray(picture.reference_px, float).reshape(-1, 2) * left_scale
    end = np.asarray(picture.px, float).reshape(-1, 2) * right_scale + (left.shape[1] + _GUTTER_PX, 0)
    drawable = np.isfinite(start).all(axis=1) & np.isfinite(end).all(axis=1)
    is_inlier = np.asarray(picture.is_inlier, bool)
    classes = ((is_inlier & drawable, INLIER_RGB), (~is_inlier & drawable, OUTLIER_RGB))
    for which, colour in classes:
        # Matches that get lines: a proportional share of all lines
        total = drawable.sum()
        index = np.flatnonzero(which)
        share = min(len(index), int(np.ceil(_DRAWN_LINES * len(index) / max(total, 1))))
        evenly = index[np.linspace(0, len(index) - 1, share).round().astype(int)] if share else index
        for i in evenly:
            cv2.line(canvas, _fixed(start[i]), _fixed(end[i]), colour, 1, cv2.LINE_AA, _SUBPIXEL_BITS)
    for which, colour in classes:
        points = np.concatenate([start[which], end[which]])
        for point in points:
            x, y = point.round().astype(int).tolist()
            for shade, width in ((_HALO_RGB, 3), (colour, 2)):
                if colour == INLIER_RGB:
                    cv2.circle(canvas, _fixed(point), 3 << _SUBPIXEL_BITS, shade, width, cv2.LINE_AA, _SUBPIXEL_BITS)
                else:
                    cv2.drawMarker(canvas, (x, y), shade, cv2.MARKER_TILTED_CROSS, 7, width, cv2.LINE_AA)
    return canvas


def webp_uri(image: ByteArray) -> str:
    """An image (H, W, 3) uint8, red green blue, as WebP in a data URI."""
    return _uri(image, "webp", cv2.IMWRITE_WEBP_QUALITY, 85)


def jpeg_uri(image: ByteArray) -> str:
    """As `webp_uri`, as a JPEG."""
    return _uri(image, "jpeg", cv2.IMWRITE_JPEG_QUALITY, 80)


def png_uri(image: ByteArray) -> str:
    """As `webp_uri`, as a PNG, which loses nothing."""
    return _uri(image, "png")


def _uri(image: ByteArray, kind: str, *how: int) -> str:
    _, code = cv2.imencode(f".{kind}", np.ascontiguousarray(image[..., ::-1]), how)
    return f"data:image/{kind};base64," + base64.b64encode(code.tobytes()).decode("ascii")


def _panel(color: ByteArray) -> tuple[ByteArray, float]:
    """The image, brought to the panel's width where it is wider, and its scale."""
    scale = min(1.0, _PANEL_WIDTH_PX / color.shape[1])
    if scale == 1.0:
        return color, scale
    size = (_PANEL_WIDTH_PX, max(1, round(color.shape[0] * scale)))
    return np.asarray(cv2.resize(color, size, interpolation=cv2.INTER_AREA), np.uint8), scale


def _fixed(point: FloatArray) -> tuple[int, int]:
    x, y = (point * (1 << _SUBPIXEL_BITS)).round().astype(int).tolist()
    return x, y


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
class OrbitView:
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
    def of(cls, position: FloatArray, path: FloatArray) -> OrbitView:
        """That holds points (n, 3) but for strays, and a path (m, 3)."""
        low, high = np.quantile(position, [_STRAY_SHARE, 1 - _STRAY_SHARE], axis=0)
        if len(path):
            low, high = np.minimum(low, path.min(axis=0)), np.maximum(high, path.max(axis=0))
        radius_m = max(float(np.linalg.norm(high - low)) / 2, 0.05)
        return cls((low + high) / 2, _FILL * radius_m * float(_FOCAL))

    def to_dict(self) -> dict[str, object]:
        """For the page's script."""
        angles = {"distance": self.distance_m, "yaw": self.yaw_rad, "pitch": self.pitch_rad}
        return {
            "centre": np.round(self.centre, 4).tolist(),
            **{name: round(value, 5) for name, value in angles.items()},
        }

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
    view: OrbitView, position: FloatArray, cloud: MapCloud, R_plan_map: FloatArray, path: FloatArray, loops: FloatArray
) -> ByteArray:
    """The view (h, w, 3) uint8 of points (n, 3) in the plan, with lines (m, 2, 3) of path and loops."""
    image = np.full((*_SIZE_PX, 3), _WHITE, np.uint8)
    towards = view.centre + view.distance_m * view.axes[2] - position
    faces = np.einsum("ij,ij->i", cloud.normal.astype(float) @ R_plan_map.T, towards) > 0
    px = view.project(position[faces])
    # Draw points as squares, the nearest last
    color = cloud.color[faces]
    height, width = _SIZE_PX
    wide_px = _POINT_SHARE * cloud.edge_m * _FOCAL * height / 2 / np.maximum(px[:, 2], 1e-6)
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
    for lines, colour in ((loops, _GREEN), (path, _ORANGE)):
        ends = view.project(lines.reshape(-1, 3)).reshape(-1, 2, 3)
        ends = ends[(ends[..., 2] > 0).all(axis=1), :, :2]
        cv2.polylines(image, list(np.rint(ends).astype(np.int32)), False, colour, 2, cv2.LINE_AA)
    return image


# Of its extent: a figure 1000 px wide may be zoomed in a hundred times before such a rounding moves a line by a pixel.
_SEEN_SHARE = 1e-5


def packed(data: bytes) -> str:
    """`data` as the page's script unpacks it."""
    return base64.b64encode(zlib.compress(data, 9)).decode("ascii")


def lean_json(figure_json: str) -> str:
    """A plotly figure's JSON with its arrays in single precision, where the difference is invisible."""
    return json.dumps(_lean(json.loads(figure_json)), separators=(",", ":"), ensure_ascii=False)


def _lean(value: Any) -> Any:
    if isinstance(value, list):
        return [_lean(part) for part in value]
    if not isinstance(value, dict):
        return value
    if value.get("dtype") == "f8":
        wide = np.frombuffer(base64.b64decode(value["bdata"]), "<f8")
        known = wide[np.isfinite(wide)]
        if len(known) == 0 or abs(known).max() > np.finfo(np.float32).max:
            return value
        narrow = wide.astype("<f4")
        if abs(narrow[np.isfinite(wide)] - known).max() > _SEEN_SHARE * np.ptp(known):
            return value
        return {**value, "dtype": "f4", "bdata": base64.b64encode(narrow.tobytes()).decode("ascii")}
    return {name: _lean(part) for name, part in value.items()}
