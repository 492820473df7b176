"""`BoardView` holds the corners and depth of a board in one view. `find_corners` detects corners; `read_views` reads
views from folders of images.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from wheelsight.core.depth_errors import NO_DISPARITY
from wheelsight.core.errors import RecordingError
from wheelsight.core.files import StrPath
from wheelsight.core.geometry import MOST_PIXELS, BoolArray, ByteArray, FloatArray, IntArray
from wheelsight.core.inputs import Kind, picture_size, read_bytes, scan_count
from wheelsight_calibration.board import Board

SENSORS = ("structured-light", "tof", "stereo")
RAW_DISPARITY = "raw-disparity"


@dataclass(frozen=True, eq=False, slots=True)
class Corners:
    """Corners of a board in an image: their numbers (N,), row by row from 0, and pixels (N, 2)."""

    ids: IntArray
    px: FloatArray

    def only(self, kept: BoolArray) -> Corners:
        """A subset of them."""
        return Corners(self.ids[kept], self.px[kept])

    def turned(self, count: int) -> Corners:
        """The same for the board rotated by 180°."""
        return Corners(count - 1 - self.ids, self.px)


@dataclass(frozen=True, eq=False, slots=True)
class BoardView:
    """One view of a board at rest.

    Attributes:
        name: for messages.
        color: corners in the colour image.
        infrared: corners in the infrared image, where there is one.
        reading: (H, W) depth image as read, metres along the axis or raw disparities; 0 and NaN if unknown.
    """

    name: str
    color: Corners
    infrared: Corners | None = None
    reading: NDArray[Any] | None = None


@dataclass(frozen=True, eq=False, slots=True)
class ViewSet:
    """Views of one board by one pair of cameras.

    Attributes:
        views: views in which the board was found.
        color_size, depth_size: width and height of the images; the latter is None without depth and infrared.
        left_out: names of other views, with reasons.
        is_disparity: whether readings are raw disparities of Kinect v1.
    """

    views: tuple[BoardView, ...]
    color_size: tuple[int, int]
    depth_size: tuple[int, int] | None = None
    left_out: tuple[tuple[str, str], ...] = field(default=())
    is_disparity: bool = False

    @property
    def has_depth(self) -> bool:
        """Whether some view has a depth image."""
        return any(view.reading is not None for view in self.views)

    @property
    def has_infrared(self) -> bool:
        """Whether some view has corners in an infrared image."""
        return any(view.infrared is not None for view in self.views)


@dataclass(frozen=True, eq=False, slots=True)
class DepthCells:
    """Readings of the board's plane in one view: pixels (N, 2) and readings (N,), means of small cells.

    `scatter` (N,) is the standard deviation of a pixel about the plane in each, of inverse depths or raw disparities.
    """

    px: FloatArray
    reading: FloatArray
    scatter: FloatArray

    def only(self, kept: BoolArray | IntArray) -> DepthCells:
        """A subset of them."""
        return DepthCells(self.px[kept], self.reading[kept], self.scatter[kept])

    @staticmethod
    def none() -> DepthCells:
        """No cells, for a view that shows no plane."""
        return DepthCells(np.empty((0, 2)), np.empty(0), np.empty(0))


_FLAGS = cv2.CALIB_CB_NORMALIZE_IMAGE | cv2.CALIB_CB_ACCURACY | cv2.CALIB_CB_EXHAUSTIVE
# Infrared images are dark but for reflections: what lies between these percentiles is stretched.
_DARKEST, _BRIGHTEST = 1.0, 99.0
# Narrower images without a board are searched once more at twice their size: else squares under 10 px are missed
# (Kinect v1's board of Herrera et al.).
_ENLARGE_BELOW_PX = 1000.0
# An edge between black and white that takes longer, from 10 to 90 %, is blurred, and corners are off by a tenth of it;
# chosen.
_BLURRED_PX = 4.5
FEWEST_CORNERS = 8  # of a board partly in view; fewer do not determine a pose
_OTHER_SIZES = tuple((columns, rows) for columns in range(4, 13) for rows in range(3, columns + 1))


def find_corners(image: ByteArray, board: Board) -> Corners | str:
    """The board's corners in a grey image (H, W) uint8, or the reason why it has none."""
    if board.is_charuco:
        px, ids, _, _ = cv2.aruco.CharucoDetector(board.charuco()).detectBoard(image)
        if ids is None or not len(ids):
            return "no board is seen"
        ids = np.asarray(ids, np.int64).ravel()
    else:
        size, ids = (board.columns, board.rows), np.arange(board.count)
        is_found, px = cv2.findChessboardCornersSB(image, size, flags=_FLAGS)
        if not is_found and image.shape[1] < _ENLARGE_BELOW_PX:
            large = cv2.resize(image, None, fx=2, fy=2, interpolation=cv2.INTER_CUBIC)
            is_found, px = cv2.findChessboardCornersSB(large, size, flags=_FLAGS)
            if is_found:
                px = (px + 0.5) / 2 - 0.5
        if not is_found:
            return "no whole board is seen"
    found = Corners(ids, np.asarray(px, float).reshape(-1, 2))
    if len(found.ids) < min(FEWEST_CORNERS, board.count):
        return f"only {len(found.ids)} corners of the board are seen"
    width_px = edge_width_px(image, found, board)
    if width_px > _BLURRED_PX:
        return f"blurred: edges take {width_px:.1f} px"
    return found


def as_grey(image: Any) -> ByteArray:
    """An image of any depth and number of channels as grey (H, W) uint8; 16 bits are stretched."""
    if image.ndim == 3:
        image = cv2.cvtColor(image[..., :3], cv2.COLOR_BGR2GRAY)
    if image.dtype == np.uint8:
        return np.asarray(image, np.uint8)
    low, high = np.percentile(image, (_DARKEST, _BRIGHTEST))
    return np.asarray(np.clip((image.astype(float) - low) / max(high - low, 1) * 255, 0, 255), np.uint8)


def edge_width_px(image: ByteArray, corners: Corners, board: Board) -> float:
    """Width in pixels of an edge between squares, from 10 to 90 %: the median over pairs of neighbouring corners.

    0 without neighbours.
    """
    places = {int(number): px for number, px in zip(corners.ids, corners.px, strict=True)}
    widths = []
    for number, px in places.items():
        for step in (1, board.columns):
            if number + step in places and (step != 1 or (number + 1) % board.columns):
                widths.append(_width_across(image, px, places[number + step]))
    return float(np.median(widths)) if widths else 0.0


def _width_across(image: ByteArray, a: Any, b: Any) -> float:
    """Width of the edge between corners a and b at its middle: 0.8 of its contrast over its slope."""
    length = float(np.linalg.norm(b - a))
    across = np.array([a[1] - b[1], b[0] - a[0]]) / max(length, 1e-9)
    reach = 0.45 * length
    at = np.linspace(-reach, reach, 41)
    along = a + (b - a) * np.linspace(0.3, 0.7, 5)[:, None]
    map_px = (along[:, None] + at[None, :, None] * across).astype(np.float32)
    profile = cv2.remap(image.astype(np.float32), map_px[..., 0], map_px[..., 1], cv2.INTER_LINEAR).mean(axis=0)
    contrast = abs(float(profile[:6].mean() - profile[-6:].mean()))
    slope = float(np.abs(np.gradient(profile, at)).max())
    return 0.8 * contrast / max(slope, 1e-6)


def other_size(image: ByteArray, board: Board) -> tuple[int, int] | None:
    """Inner corners of another checkerboard than `board` in the image; None without one."""
    for columns, rows in _OTHER_SIZES:
        if {columns, rows} == {board.columns, board.rows}:
            continue
        found, px = cv2.findChessboardCornersSB(
            image, (columns, rows), flags=cv2.CALIB_CB_NORMALIZE_IMAGE | cv2.CALIB_CB_LARGER
        )
        if found and len(px) == columns * rows:
            return columns, rows
    return None


_SUFFIXES = {".png", ".jpg", ".jpeg", ".pgm", ".ppm", ".bmp", ".tif", ".tiff"}
_WORDS = {
    "color": ("c1", "c", "color", "colour", "rgb"),
    "infrared": ("ir", "infrared"),
    "depth": ("d", "depth", "disparity"),
}
_KIND_OF = {word: kind for kind, words in _WORDS.items() for word in words}
_NAMED = re.compile(
    rf"^(?:(?P<a>.*?)[-_ .])?(?P<kind>{'|'.join(sorted(_KIND_OF, key=len, reverse=True))})(?:[-_ .]?(?P<b>\d.*))?$",
    re.IGNORECASE,
)
# Pixels over all scans of a progressive JPEG, as of recordings.
_MOST_DECODED = 8 * MOST_PIXELS
_IMAGE = Kind("an image", most_mb=128)
_FIX = "name images VIEW-color.png, VIEW-ir.png, VIEW-depth.png, or put them into folders color, ir and depth"
_OTHERS_TRIED = 3


def find_view_files(folders: Sequence[StrPath]) -> dict[str, dict[str, Path]]:
    """The image files of each view, by its name and by kind: color, infrared, depth.

    Raises:
        RecordingError: a path is no folder, or no file has the name of a colour image.
    """
    views: dict[str, dict[str, Path]] = {}
    for folder in map(Path, folders):
        if not folder.is_dir():
            raise RecordingError("is no folder of images", path=folder, fix=_FIX)
        for path in sorted(path for path in folder.rglob("*") if path.suffix.lower() in _SUFFIXES):
            kind, name = _kind_and_name(path, folder)
            if kind is not None:
                full = name if len(folders) == 1 else f"{folder.name}/{name}"
                views.setdefault(full, {}).setdefault(kind, path)
    if not any("color" in files for files in views.values()):
        raise RecordingError("holds no colour image", path=Path(folders[0]), fix=_FIX)
    return dict(sorted(views.items()))


def _kind_and_name(path: Path, folder: Path) -> tuple[str | None, str]:
    above = path.relative_to(folder).parent
    kind = _KIND_OF.get(above.name.lower())
    if kind is not None:
        return kind, (above.parent / path.stem).as_posix()
    found = _NAMED.match(path.stem)
    if not found:
        return None, path.stem
    name = "-".join(part for part in (found["a"], found["b"]) if part)
    return _KIND_OF[found["kind"].lower()], (above / name).as_posix()


def read_views(
    folders: Sequence[StrPath], board: Board, depth_factor: float = 1000.0, on_view: Callable[[], None] = lambda: None
) -> ViewSet:
    """Views with their corners; unusable ones are left out with a reason.

    Args:
        folders: of images.
        board: the board that they show.
        depth_factor: units per metre of depth images; not used for raw disparities.
        on_view: called after each view.

    Raises:
        RecordingError: no view shows the board; the fix names another board that the first ones show.
    """
    left_out, seen = [], []
    for name, files in find_view_files(folders).items():
        found = _read_view(name, files, board)
        if isinstance(found, str):
            left_out.append((name, found))
        else:
            seen.append(found)
        on_view()
    if not seen:
        raise _none_found(folders, board, left_out)
    views, size, depth_size = _of_one_size(seen, left_out)
    # Raw disparities of Kinect v1 have 11 bits, and the greatest means none; depth images mark none by 0.
    readings = [view.reading for view in views if view.reading is not None]
    is_disparity = bool(readings) and all(image.max() == NO_DISPARITY and image.min() > 0 for image in readings)
    none, unit = (NO_DISPARITY, 1.0) if is_disparity else (np.iinfo(np.uint16).max, depth_factor)
    for index, view in enumerate(views):
        if view.reading is not None:
            reading = np.where(view.reading < none, view.reading, 0).astype(np.float32) / np.float32(unit)
            views[index] = replace(view, reading=reading)
    return ViewSet(tuple(views), size, depth_size, tuple(left_out), is_disparity)


def size_text(size: tuple[int, int]) -> str:
    """Width × height, for messages."""
    return f"{size[0]}×{size[1]}"


_Seen = tuple[BoardView, tuple[int, int], tuple[int, int] | None]


def _of_one_size(
    seen: list[_Seen], left_out: list[tuple[str, str]]
) -> tuple[list[BoardView], tuple[int, int], tuple[int, int] | None]:
    """The views whose images have the most common size, and that size; others are added to `left_out`."""
    size = Counter(size for _, size, _ in seen).most_common(1)[0][0]
    depth_sizes = Counter(depth for _, _, depth in seen if depth is not None).most_common(1)
    depth_size = depth_sizes[0][0] if depth_sizes else None
    views = []
    for view, own, own_depth in seen:
        if own != size:
            left_out.append((view.name, f"colour image is {size_text(own)}, others {size_text(size)}"))
        elif own_depth is not None and depth_size is not None and own_depth != depth_size:
            left_out.append((view.name, f"depth image is {size_text(own_depth)}, others {size_text(depth_size)}"))
        else:
            views.append(view)
    return views, size, depth_size


def _read_view(name: str, files: dict[str, Path], board: Board) -> _Seen | str:
    if "color" not in files:
        return "has no colour image"
    try:
        images = {kind: _read_image(path) for kind, path in files.items()}
    except RecordingError as error:
        return f"{error.path.name if error.path else name}: {error.problem}"
    color = find_corners(as_grey(images["color"]), board)
    if isinstance(color, str):
        return color
    infrared = find_corners(as_grey(images["infrared"]), board) if "infrared" in images else None
    depth = images.get("depth")
    if depth is not None and (depth.ndim != 2 or depth.dtype != np.uint16):
        return f"{files['depth'].name}: is no 16-bit image of one channel"
    sizes = {_size(image) for image in (images.get("infrared"), depth) if image is not None}
    if len(sizes) > 1:
        return "infrared and depth image differ in size"
    view = BoardView(name, color, None if isinstance(infrared, str) else infrared, depth)
    return view, _size(images["color"]), next(iter(sizes), None)


def _read_image(path: Path) -> Any:
    data = read_bytes(path, _IMAGE, RecordingError)
    size = picture_size(data)
    if size is None:
        raise RecordingError("is damaged, or no image", path=path)
    if size[0] * size[1] > MOST_PIXELS or size[0] * size[1] * scan_count(data) > _MOST_DECODED:
        raise RecordingError(f"says it is {size[0]}×{size[1]} pixels", path=path)
    try:
        image = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_UNCHANGED)
    except cv2.error:
        image = None
    if image is None:
        raise RecordingError("is damaged, or no image", path=path)
    return image


def _none_found(folders: Sequence[StrPath], board: Board, left_out: list[tuple[str, str]]) -> RecordingError:
    whole = f"none of {len(left_out)} views shows the board {board}"
    files = find_view_files(folders)
    for name, reason in left_out[:_OTHERS_TRIED] if not board.is_charuco else []:
        if "no whole board" in reason:
            size = other_size(as_grey(_read_image(files[name]["color"])), board)
            if size is not None:
                fix = f"{name} shows {size[0]}×{size[1]} inner corners: --board {size[0]}x{size[1]}:SIDE"
                return RecordingError(whole, path=Path(folders[0]), fix=fix)
    name, reason = left_out[0]
    return RecordingError(f"{whole}; {name}: {reason}", path=Path(folders[0]), fix="check --board, light and focus")


def _size(image: Any) -> tuple[int, int]:
    return int(image.shape[1]), int(image.shape[0])
