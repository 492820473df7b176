"""Image files to arrays and back: colour as RGB bytes, depth in metres, corrected by the calibration. `read_ahead`
runs an iterator in a thread.
"""

from __future__ import annotations

from collections.abc import Generator, Iterable, Iterator
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from queue import Empty, Queue
from threading import Event, Thread
from typing import Literal, TypeVar

import cv2
import numpy as np
from numpy.typing import NDArray

from wheelsight.core.calibration import Calibration
from wheelsight.core.depth_errors import NO_DISPARITY, DepthError
from wheelsight.core.errors import OutputError, RecordingError
from wheelsight.core.files import write_bytes
from wheelsight.core.geometry import MOST_PIXELS, ByteArray, Float32Array, PinholeCamera
from wheelsight.core.inputs import Kind, picture_size, read_bytes, scan_count
from wheelsight.core.messages import NOTHING_MEASURED
from wheelsight.core.threads import LOCK, in_span, in_spans, span

_PLAUSIBLE_MEDIAN_M = (0.05, 50.0)
_MEDIAN_STRIDE = 8
_COLOR_FLAGS = cv2.IMREAD_COLOR_RGB | cv2.IMREAD_IGNORE_ORIENTATION
_TRAILERS = {b"\x89PNG": b"IEND", b"\xff\xd8": b"\xff\xd9"}
_TRAILER_REACH = 64
_MOST_PIXELS_DECODED = 1 << 28  # 12 million in 22 scans; a progressive JPEG has about 10
_KINDS = {
    kind: Kind(f"a {kind} image", most_mb=128, missing=f"listed {kind} image is absent") for kind in ("colour", "depth")
}

_DISTANCES = Kind("a text of distances", most_mb=32, missing="listed depth image is absent")  # 640×480 take 3 MB
_LONGEST_NUMBER = 40  # characters
_FARTHEST_M = 1e6  # beyond the range of any camera, within that of float32


@dataclass(frozen=True, slots=True)
class DepthEncoding:
    """The encoding of depth images.

    Attributes:
        factor: units per metre of 16-bit images.
        invalid: a raw value besides 0 that means no measurement.
        disparity: the disparity model, for raw disparities of Kinect v1.
        rays: the camera, for text files with each pixel's distance from the camera's centre.
    """

    factor: float
    invalid: int | None = None
    disparity: DepthError | None = None
    rays: PinholeCamera | None = None


def read_color(path: Path) -> ByteArray:
    """The colour image (H, W, 3) uint8, RGB. Raises RecordingError naming the file."""
    return np.asarray(_decode(path, _COLOR_FLAGS, "colour"), np.uint8)


def read_depth(path: Path, encoding: DepthEncoding) -> Float32Array:
    """The depth image (H, W) float32 in metres, 0 where there is no measurement.

    Raises:
        RecordingError: it is not a 16-bit image with one channel, has no depth at all, or a median depth under 5 cm or
            over 50 m; names the file.
    """
    if encoding.rays is not None:
        camera = encoding.rays  # the file is text: distances along rays, row by row
        words = read_bytes(path, _DISTANCES, RecordingError).split()
        if len(words) != camera.width * camera.height:
            problem = f"holds {len(words)} distances where {camera.width}×{camera.height} pixels need one each"
            raise RecordingError(problem, path=path, fix="copy the file again, or give its camera with --camera")
        if max(map(len, words)) > _LONGEST_NUMBER:
            raise RecordingError("holds an invalid number", path=path, fix="copy the file again")
        try:
            distances = np.array(words).astype(np.float64).reshape(camera.height, camera.width)
        except ValueError as error:
            raise RecordingError(f"holds an invalid number: {error}", path=path, fix="copy the file again") from error
        most = encoding.factor * _FARTHEST_M
        distances[~((distances > 0) & (distances <= most))] = 0
        lengths = np.linalg.norm(camera.rays(), axis=-1)
        depth_m: Float32Array = (distances / encoding.factor / lengths).astype(np.float32)
        _check_scale(_median(depth_m, path), path, encoding)
        return depth_m
    return depth_of_units(_decode(path, cv2.IMREAD_UNCHANGED, "depth"), encoding, path)


def depth_of_units(raw: NDArray[np.integer], encoding: DepthEncoding, path: Path) -> Float32Array:
    """Depth (H, W) float32 in metres of a raw depth image, which may be modified. Raises as `read_depth`."""
    if raw.ndim != 2 or raw.dtype != np.uint16:
        channels = 1 if raw.ndim == 2 else raw.shape[2]
        problem = f"depth image has {channels} channel(s) of {8 * raw.dtype.itemsize} bits, not one of 16"
        raise RecordingError(problem, path=path, fix="depth must be a 16-bit greyscale PNG")
    if encoding.disparity is not None:
        if int(raw.max()) > NO_DISPARITY:
            problem = f"holds {int(raw.max())}, which is no raw disparity of Kinect v1"
            raise RecordingError(problem, path=path, fix="remove disparity_step_per_m from the calibration")
        disparity_depth_m = encoding.disparity.of_disparity(raw)
        if not disparity_depth_m.any():
            raise RecordingError(NOTHING_MEASURED, path=path)
        return disparity_depth_m
    if encoding.invalid is not None:
        raw[raw == encoding.invalid] = 0
    _check_scale(_median(raw, path) / encoding.factor, path, encoding)
    depth_m: Float32Array = np.multiply(raw, np.float32(1 / encoding.factor), dtype=np.float32)
    return depth_m


def is_depth_image(path: Path) -> bool | None:
    """Whether an image has one channel of 16 bits, as depth has; None where it cannot be read."""
    try:
        image = _decode(path, cv2.IMREAD_UNCHANGED, "depth")
    except RecordingError:
        return None
    return image.ndim == 2 and image.dtype == np.uint16


def image_size(image: NDArray[np.generic]) -> str:
    """Width × height of an image, for messages."""
    return f"{image.shape[1]}×{image.shape[0]}"


def color_size(paths: Iterable[Path]) -> tuple[int, int]:
    """Width and height of the first readable colour image.

    Raises RecordingError naming the first image where none is readable.
    """
    first: RecordingError | None = None
    for path in paths:
        try:
            size = picture_size(read_bytes(path, _KINDS["colour"], RecordingError))
            if size is not None:
                return size
            raise RecordingError("colour image is damaged, or no image", path=path, fix="convert it to PNG")
        except RecordingError as error:
            first = first or error
    raise first or RecordingError("there are no colour images")


def decoded_color(data: bytes, path: Path) -> ByteArray:
    """The colour image (H, W, 3), RGB, of PNG or JPEG data from the file at `path`. Raises RecordingError."""
    return np.asarray(_decoded(data, path, _COLOR_FLAGS, "colour"), np.uint8)


def decoded_units(data: bytes, path: Path) -> NDArray[np.integer]:
    """The pixels of PNG data from the file at `path`, unconverted. Raises RecordingError."""
    return _decoded(data, path, cv2.IMREAD_UNCHANGED, "depth")


def check_scale(depth_m: Float32Array, path: Path) -> None:
    """Raise RecordingError for a depth image without measurements, or with a median that is implausible in metres."""
    _check_scale(_median(depth_m, path), path, DepthEncoding(1.0))


def _decode(path: Path, flags: int, kind: str) -> NDArray[np.integer]:
    return _decoded(read_bytes(path, _KINDS[kind], RecordingError), path, flags, kind)


def _decoded(data: bytes, path: Path, flags: int, kind: str) -> NDArray[np.integer]:
    """The pixels of an image. Checks its size before decoding. Raises RecordingError."""
    for start, trailer in _TRAILERS.items():
        if data.startswith(start) and trailer not in data[-_TRAILER_REACH:]:
            raise RecordingError(f"{kind} image is cut off before its end", path=path)
    if not data:
        raise RecordingError(f"{kind} image is empty", path=path)
    size = picture_size(data)
    if size is None:
        raise RecordingError(f"{kind} image is damaged, or no image", path=path, fix="convert it to PNG")
    width, height = size
    if width * height > MOST_PIXELS:
        problem = f"{kind} image says it is {width}×{height} pixels, more than any depth camera has"
        raise RecordingError(problem, path=path, fix=f"at most {MOST_PIXELS / 1e6:.0f} million pixels")
    if width * height * scan_count(data) > _MOST_PIXELS_DECODED:
        problem = f"{kind} image has {scan_count(data)} scans, which take long to decode"
        raise RecordingError(problem, path=path, fix="convert it to PNG")
    try:
        image = cv2.imdecode(np.frombuffer(data, np.uint8), flags)
    except cv2.error:
        image = None
    if image is None:
        raise RecordingError(f"{kind} image is damaged, or no image", path=path)
    return np.asarray(image)


def _median(raw: NDArray[np.integer] | Float32Array, path: Path) -> float:
    """The median of measured depth units, of a sample of pixels unless none of these is measured."""
    sample = raw[::_MEDIAN_STRIDE, ::_MEDIAN_STRIDE]
    measured = sample[sample > 0]
    if not len(measured):
        measured = raw[raw > 0]
    if not len(measured):
        raise RecordingError(NOTHING_MEASURED, path=path)
    return float(np.median(measured))


def _check_scale(median_m: float, path: Path, encoding: DepthEncoding) -> None:
    """Raise RecordingError for an implausible median depth."""
    near, far = _PLAUSIBLE_MEDIAN_M
    if not near <= median_m <= far:
        raise RecordingError(
            f"median depth is {median_m:.3g} m at {encoding.factor:g} depth units a metre",
            path=path,
            fix="give the right number of units a metre with --depth-factor; 1000 means millimetres",
        )


ColorFormat = Literal["png", "jpeg"]
SUFFIXES: dict[str, str] = {"png": ".png", "jpeg": ".jpg"}
JPEG_QUALITY = 95


# The fastest PNG that still compresses, for colour of 640×480. Without a filter, compression level 1 tries all five for
# each row: 18 ms instead of 12 ms. Filtered bytes are noise with runs of zeros, so that a search for runs alone takes
# 9 to 10 ms and makes smaller files too (docs/decisions/bags-and-formats). Older OpenCV has no setting of the filter.
FAST_PNG: tuple[int, ...] = (cv2.IMWRITE_PNG_COMPRESSION, 1, cv2.IMWRITE_PNG_STRATEGY, cv2.IMWRITE_PNG_STRATEGY_RLE)
if hasattr(cv2, "IMWRITE_PNG_FILTER") and hasattr(cv2, "IMWRITE_PNG_FILTER_SUB"):
    FAST_PNG = (*FAST_PNG, cv2.IMWRITE_PNG_FILTER, cv2.IMWRITE_PNG_FILTER_SUB)


def write_color(path: Path, color: ByteArray, encoding: ColorFormat) -> int:
    """Write colour (H, W, 3), RGB. Returns the file size in bytes. Raises OutputError."""
    flags = FAST_PNG if encoding == "png" else (cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY)
    return _write(path, SUFFIXES[encoding], cv2.cvtColor(color, cv2.COLOR_RGB2BGR), flags)


def write_units(path: Path, units: NDArray[np.uint16]) -> int:
    """Write an image (H, W) of 16 bits as PNG. Returns the file size in bytes. Raises OutputError."""
    return _write(path, ".png", units, FAST_PNG)


def _write(path: Path, kind: str, image: NDArray[np.integer | np.floating], flags: tuple[int, ...]) -> int:
    is_encoded, data = cv2.imencode(kind, image, flags)
    if not is_encoded:
        raise OutputError(f"the image cannot be encoded as {kind[1:].upper()}", path=path)
    write_bytes(path, data.tobytes())
    return int(data.size)


_FIX = "choose another with --camera"


def corrected_depth(
    color: ByteArray, depth_m: Float32Array, calibration: Calibration, paths: tuple[Path, Path], fix: str = _FIX
) -> Float32Array:
    """Depth (H, W) in metres of a frame, corrected by the calibration's depth error.

    Args:
        color: colour image (H, W, 3); only its size is checked.
        depth_m: decoded depth (H, W).
        paths: of colour and depth, for error messages.
        fix: the fix in the error of a wrong size.

    Raises:
        RecordingError: an image has another size than its camera; names the file.
    """
    color_camera, depth_camera = calibration.cameras
    _need_size("colour", image_size(color), color_camera, paths[0], fix)
    _need_size("depth", image_size(depth_m), depth_camera, paths[1], fix)
    return calibration.depth_error.corrected(depth_m, depth_camera)


def _need_size(name: str, size: str, camera: PinholeCamera, path: Path, fix: str) -> None:
    expected = f"{camera.width}×{camera.height}"
    if size != expected:
        raise RecordingError(f"{name} image is {size}, the calibration's {expected}", path=path, fix=fix)


T = TypeVar("T")


@dataclass(frozen=True, slots=True)
class _End:
    """The last item of the queue, with the error that stopped the source, if any."""

    error: BaseException | None = None


def read_ahead(items: Iterator[T], depth: int) -> Generator[T]:
    """The items of an iterator in order; a thread produces up to `depth` of them (1 or more) ahead.

    An exception of the iterator is raised here in its place. Closing this generator, or leaving a loop over it, stops
    the thread after its current item and closes `items`.
    """
    ready: Queue[T | _End] = Queue(maxsize=depth)
    stop = Event()

    def produce() -> None:
        """Fill the queue until the items end or `stop` is set; at most one item follows `stop`."""
        end = _End()
        try:
            for item in in_spans("decode", items):
                with span("room ahead", LOCK):
                    ready.put(item)
                if stop.is_set():
                    break
        except BaseException as error:
            end = _End(error)
        finally:
            if isinstance(items, Generator):
                items.close()
        if not stop.is_set():
            ready.put(end)

    thread = Thread(target=produce, name="wheelsight-read-ahead", daemon=True)
    thread.start()
    try:
        while not isinstance(item := in_span("next image", ready.get, LOCK), _End):
            yield item
        if item.error is not None:
            raise item.error
    finally:
        stop.set()
        with suppress(Empty):
            while True:
                ready.get_nowait()
        thread.join()
