"""Azure Kinect: one Matroska file (.mkv) with colour, depth and the calibration of the device. Depth is registered
to the undistorted colour image.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import cv2
import numpy as np

from wheelsight.core.calibration import Calibration
from wheelsight.core.calibration_parts import DepthNoise
from wheelsight.core.errors import CalibrationError, RecordingError
from wheelsight.core.geometry import MOST_PIXELS, ByteArray, Float32Array, FloatArray, IntArray, PinholeCamera, se3
from wheelsight.core.geometry.arrays import UInt16Array
from wheelsight.core.inputs import Kind, open_binary, parse_json
from wheelsight.core.messages import NOTHING_MEASURED, Event, RgbdFrame, SkippedFrame
from wheelsight.core.runtime import needed
from wheelsight.core.stamps import associate
from wheelsight.core.trajectory import Trajectory
from wheelsight.io.recordings.images import corrected_depth
from wheelsight.io.recordings.recording import AssociationReport, Layout, OpenOptions, choose_calibration

# The calibration in the file. Its lenses have eight coefficients, more than `PinholeCamera`: colour is undistorted, and
# depth registered to it.


class _KinectMode(NamedTuple):
    """A mode: the sensor's image is scaled to `sensor` pixels and cropped to `size` at `corner`."""

    sensor: tuple[int, int]
    corner: tuple[int, int]
    size: tuple[int, int]


# From the maker's SDK (MIT), mode_specific_calibration.c.
_DEPTH_MODES = {
    "NFOV_2X2BINNED": _KinectMode((512, 512), (96, 90), (320, 288)),
    "NFOV_UNBINNED": _KinectMode((1024, 1024), (192, 180), (640, 576)),
    "WFOV_2X2BINNED": _KinectMode((512, 512), (0, 0), (512, 512)),
    "WFOV_UNBINNED": _KinectMode((1024, 1024), (0, 0), (1024, 1024)),
}
# From the maker's data sheet, for 15 to 95 % of reflectance.
_RANGES_M = {
    "NFOV_2X2BINNED": (0.5, 5.46),
    "NFOV_UNBINNED": (0.5, 3.86),
    "WFOV_2X2BINNED": (0.25, 2.88),
    "WFOV_UNBINNED": (0.25, 2.21),
}
_COLOR_MODES = {
    (1280, 720): _KinectMode((1280, 960), (0, 120), (1280, 720)),
    (1920, 1080): _KinectMode((1920, 1440), (0, 180), (1920, 1080)),
    (2560, 1440): _KinectMode((2560, 1920), (0, 240), (2560, 1440)),
    (2048, 1536): _KinectMode((2048, 1536), (0, 0), (2048, 1536)),
    (3840, 2160): _KinectMode((3840, 2880), (0, 360), (3840, 2160)),
    (4096, 3072): _KinectMode((4096, 3072), (0, 0), (4096, 3072)),
}
_MODEL, _PARAMETERS = "CALIBRATION_LensDistortionModelBrownConrady", 14
_UNDISTORT = (cv2.TERM_CRITERIA_COUNT + cv2.TERM_CRITERIA_EPS, 50, 1e-9)
# Focal lengths of real cameras are 0.2 to 1 image widths; their coefficients are below 100.
_MOST_PARAMETER, _LEAST_FOCAL = 1e4, 0.01
# Largest error of an undistorted point. Iteration diverges beyond the lens's field of view, and errs far less inside.
_CONVERGED_PX = 0.05
_FAR_M = 100.0


@dataclass(frozen=True, slots=True, eq=False)
class KinectLens:
    """A camera of the device in one mode: K (3, 3), OpenCV's eight coefficients, size and pose.

    Attributes:
        reach: the largest distance from the axis on the plane z = 1 where the coefficients are valid.
        T_camera_device: (4, 4); the device's frame is the depth camera's.
    """

    K: FloatArray
    coefficients: FloatArray
    size: tuple[int, int]
    reach: float
    T_camera_device: FloatArray


def read_lenses(document: Any, depth_mode: str, color_size: tuple[int, int]) -> tuple[KinectLens, KinectLens]:
    """The colour and depth cameras in these modes, by a calibration.json. Raises CalibrationError."""
    if depth_mode not in _DEPTH_MODES:
        raise CalibrationError(f"depth mode {depth_mode} measures no depth", fix=f"record {', '.join(_DEPTH_MODES)}")
    if color_size not in _COLOR_MODES:
        raise CalibrationError(f"colour images of {color_size[0]}×{color_size[1]} are none of the camera's modes")
    try:
        cameras = document["CalibrationInformation"]["Cameras"]
        by_place = {camera["Location"]: camera for camera in cameras}
        color = _lens(by_place["CALIBRATION_CameraLocationPV0"], _COLOR_MODES[color_size])
        return color, _lens(by_place["CALIBRATION_CameraLocationD0"], _DEPTH_MODES[depth_mode])
    except (KeyError, TypeError, ValueError, IndexError, AttributeError, ArithmeticError) as error:
        raise CalibrationError(f"its calibration cannot be read: {error!r}") from error


def _lens(camera: Any, mode: _KinectMode) -> KinectLens:
    intrinsics = camera["Intrinsics"]
    parameters = np.array(intrinsics["ModelParameters"], float)
    if intrinsics["ModelType"] != _MODEL or parameters.shape != (_PARAMETERS,):
        raise ValueError(f"lens model {intrinsics['ModelType']} of {parameters.size} numbers")
    if not (np.abs(parameters) <= _MOST_PARAMETER).all() or parameters[2:4].min() <= _LEAST_FOCAL:
        raise ValueError("numbers that are implausible for a lens")
    aspect = camera["SensorWidth"] / camera["SensorHeight"]
    if abs(aspect - mode.sensor[0] / mode.sensor[1]) > 1e-3:
        raise ValueError(f"a sensor of {camera['SensorWidth']}×{camera['SensorHeight']}")
    cx, cy, fx, fy = parameters[:4] * np.tile(mode.sensor, 2)
    # The origin of the file is the image's corner, that of OpenCV and wheelsight the centre of the first pixel.
    cx, cy = cx - mode.corner[0] - 0.5, cy - mode.corner[1] - 0.5
    k1, k2, k3, k4, k5, k6, _, _, p2, p1 = parameters[4:]
    T_camera_device = np.eye(4)
    T_camera_device[:3, :3] = np.reshape(camera["Rt"]["Rotation"], (3, 3))
    T_camera_device[:3, 3] = camera["Rt"]["Translation"]
    if wrong := se3.why_invalid(T_camera_device, tolerance=1e-4):
        raise ValueError(wrong[0])
    K = np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1]])
    reach = float(camera["MetricRadius"]) or np.inf
    if not reach > 0:
        raise ValueError(f"a lens that reaches {reach}")
    return KinectLens(K, np.array([k1, k2, p1, p2, k3, k4, k5, k6]), mode.size, reach, T_camera_device)


class KinectRegistration:
    """Undistorts colour and registers depth to it.

    A depth pixel covers more than one colour pixel. Each is projected as four quarters, so that surfaces have no holes.
    Where several fall on a pixel, the nearest occludes the others.
    """

    def __init__(self, color: KinectLens, depth: KinectLens) -> None:
        self._color, self._depth = color, depth
        width, height = color.size
        self._map_u, self._map_v = cv2.initUndistortRectifyMap(
            color.K, color.coefficients, np.eye(3), color.K, (width, height), cv2.CV_32FC1
        )
        T_color_depth = se3.compose(color.T_camera_device, se3.invert(depth.T_camera_device))
        # Rays (4·H·W, 3) with z = 1 of the quarters of depth pixels, row by row; NaN outside the lens's reach.
        columns, rows = (np.arange(2 * side) / 2 - 0.25 for side in depth.size)
        u, v = np.meshgrid(columns, rows)
        px = np.stack([u, v], axis=-1).reshape(-1, 1, 2)
        if hasattr(cv2, "undistortPointsIter"):  # before OpenCV 5
            undistorted = cv2.undistortPointsIter(px, depth.K, depth.coefficients, None, None, _UNDISTORT)
        else:
            undistorted = cv2.undistortPoints(px, depth.K, depth.coefficients, criteria=_UNDISTORT)
        xy: FloatArray = np.asarray(undistorted, float).reshape(-1, 2)
        focal_px, middle = depth.K[[0, 1], [0, 1]], depth.K[:2, 2]
        # The points are distorted again as a check. OpenCV also computes derivatives, which takes seconds.
        k1, k2, p1, p2, k3, k4, k5, k6 = depth.coefficients
        x, y = xy.T
        r2 = x**2 + y**2
        radial = (1 + r2 * (k1 + r2 * (k2 + r2 * k3))) / (1 + r2 * (k4 + r2 * (k5 + r2 * k6)))
        moved = (2 * p1 * x * y + p2 * (r2 + 2 * x**2), p1 * (r2 + 2 * y**2) + 2 * p2 * x * y)
        distorted = np.stack([x * radial + moved[0], y * radial + moved[1]], axis=1)
        off_px = np.abs(distorted * focal_px + middle - px.reshape(-1, 2)).max(axis=1)
        is_beyond = (off_px > _CONVERGED_PX) | (np.linalg.norm(xy, axis=1) > depth.reach)
        rays = np.concatenate([xy, np.ones((len(xy), 1))], axis=1)
        rays[is_beyond] = np.nan
        self._rays: Float32Array = (rays @ T_color_depth[:3, :3].T).astype(np.float32)
        self._t: Float32Array = T_color_depth[:3, 3].astype(np.float32)

    def calibration(self, depth_mode: str, serial: str) -> Calibration:
        """The calibration of the undistorted and registered images."""
        (fx, _, cx), (_, fy, cy), _ = self._color.K.tolist()
        camera = PinholeCamera(*self._color.size, fx, fy, cx, cy)
        near_m, far_m = _RANGES_M[depth_mode]
        noise = DepthNoise(near_m=near_m, far_m=far_m)
        source = f"the calibration in the recording, of the Azure Kinect {serial}"
        return Calibration.registered_camera(camera, depth_noise=noise, source=source)

    def undistorted(self, color: ByteArray) -> ByteArray:
        """The colour image without distortion. Pixels outside the lens's image repeat the border."""
        done = cv2.remap(color, self._map_u, self._map_v, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
        return np.asarray(done, np.uint8)

    def registered(self, depth_mm: UInt16Array) -> Float32Array:
        """Depth (H, W) in metres on the pixels of the undistorted colour image, 0 without a measurement."""
        width, height = self._color.size
        z_m = np.repeat(np.repeat(depth_mm, 2, axis=0), 2, axis=1).reshape(-1) * np.float32(1e-3)
        is_seen = (z_m > 0) & np.isfinite(self._rays[:, 2])
        p_color = self._rays[is_seen] * z_m[is_seen, None] + self._t
        fx, fy, cx, cy = self._color.K[[0, 1, 0, 1], [0, 1, 2, 2]].astype(np.float32)
        with np.errstate(divide="ignore", invalid="ignore"):
            u = np.rint(fx * p_color[:, 0] / p_color[:, 2] + cx)
            v = np.rint(fy * p_color[:, 1] / p_color[:, 2] + cy)
        inside = (p_color[:, 2] > 0) & (u >= 0) & (u < width) & (v >= 0) & (v < height)
        index: IntArray = (v[inside] * width + u[inside]).astype(np.int64)
        nearest = np.full(width * height, _FAR_M, np.float32)
        np.minimum.at(nearest, index, p_color[inside, 2])
        nearest[nearest >= _FAR_M] = 0
        return nearest.reshape(height, width)


_COLOR, _DEPTH = "COLOR", "DEPTH"
_SEGMENT, _HEAD = b"\x18\x53\x80\x67", 4096
_MOST_ATTACHED = 1 << 20  # bytes; a calibration has 4000
_MKV = Kind("an .mkv", 1 << 40)
_COPY = "copy the file again"


class AzureKinectReader:
    """Reads files of `k4arecorder`."""

    name = "azure_kinect"
    layout = Layout.FILE
    needs = "an .mkv"

    def recognises(self, folder: Path) -> bool:
        """Whether it is an .mkv file, by its name."""
        return folder.suffix.lower() == ".mkv" and folder.is_file()

    def open(self, folder: Path, options: OpenOptions) -> AzureKinectRecording:
        """The recording in a file. Raises RecordingError, or ConfigError where PyAV is missing."""
        listed = _list(folder)
        try:
            lenses = read_lenses(listed.calibration, listed.depth_mode, listed.color_size)
        except CalibrationError as error:
            raise CalibrationError(error.problem, path=folder, fix=error.fix) from error
        registration = KinectRegistration(*lenses)
        calibration = choose_calibration(
            folder, options, lambda: registration.calibration(listed.depth_mode, listed.serial)
        )
        color, _ = calibration.cameras
        if (color.width, color.height) != listed.color_size or not calibration.is_registered or color.has_distortion:
            problem = "the given calibration is not of undistorted colour images with depth registered to them"
            raise CalibrationError(problem, path=folder, fix="leave the cameras out: the recording has its own")
        color_s, depth_s = (np.array(pts, float) * listed.tick_s for pts in (listed.color_pts, listed.depth_pts))
        found = associate(color_s, depth_s - listed.depth_delay_s, options.max_gap_s)
        if not len(found):
            if listed.is_cut_off:
                raise RecordingError("is cut off before the first pair of images", path=folder, fix="copy it again")
            counts = f"{len(color_s)} colour and {len(depth_s)} depth images"
            problem = f"of {counts}, none lie within {options.max_gap_s:g} s"
            raise RecordingError(problem, path=folder, fix="raise --max-gap, or record both")
        late_s = depth_s[found[:, 1]] - color_s[found[:, 0]]
        pairs = [
            _KinectPair(float(color_s[i]), listed.color_pts[i], listed.depth_pts[j], late)
            for (i, j), late in zip(found.tolist(), late_s.tolist(), strict=True)
        ]
        largest_s = float(np.abs(late_s - listed.depth_delay_s).max())
        association = AssociationReport(len(color_s), len(depth_s), len(pairs), options.max_gap_s, largest_s)
        warnings = ["Its gyroscope and accelerometer are not read."] if listed.has_imu else []
        if listed.is_cut_off:
            warnings.append("The file is cut off; what comes before is read.")
        return AzureKinectRecording(
            folder.stem,
            folder,
            calibration,
            association,
            registration,
            tuple(pairs),
            listed.depth_size,
            tuple(warnings),
        )


@dataclass(frozen=True, slots=True)
class _KinectPair:
    """A frame: its stamp, and the times of both images in the file's units, which identify the packets."""

    stamp_s: float
    color_pts: int
    depth_pts: int
    depth_late_s: float


@dataclass(frozen=True, eq=False)
class AzureKinectRecording:
    """A `Recording`. Frames are undistorted and registered during iteration."""

    name: str
    path: Path
    calibration: Calibration
    association: AssociationReport
    registration: KinectRegistration
    pairs: tuple[_KinectPair, ...]
    depth_size: tuple[int, int]
    warnings: tuple[str, ...] = ()
    format: str = AzureKinectReader.name
    wheel_count: int = 0
    ground_truth: Trajectory | None = None

    @property
    def body(self) -> str:
        """The frame its trajectory describes: "base" where the calibration has T_base_camera, else "camera"."""
        return "camera" if self.calibration.T_base_camera is None else "base"

    @property
    def frame_count(self) -> int:
        """The number of frames that `events()` yields, skipped ones included."""
        return len(self.pairs)

    def events(self, *, images: bool = True) -> Iterator[Event]:
        """Frames in order of time, from the start at each call; none without `images`."""
        if not images or not self.pairs:
            return
        by_color = {pair.color_pts: pair for pair in self.pairs}
        wanted = {pair.depth_pts for pair in self.pairs}
        color: dict[int, Any] = {}
        depth: dict[int, Any] = {}
        index = 0
        for kind, packet in _packets(self.path):
            if kind == _COLOR and packet.pts in by_color:
                color[packet.pts] = packet
            elif kind == _DEPTH and packet.pts in wanted:
                depth[packet.pts] = packet
            while index < len(self.pairs):
                pair = self.pairs[index]
                if pair.color_pts not in color or pair.depth_pts not in depth:
                    break
                yield self._frame(pair, index, color.pop(pair.color_pts), depth.pop(pair.depth_pts))
                index += 1
        for left in range(index, len(self.pairs)):
            yield SkippedFrame(self.pairs[left].stamp_s, "the file was truncated after it was opened", left)

    def _frame(self, pair: _KinectPair, index: int, color: Any, depth: Any) -> RgbdFrame | SkippedFrame:
        width, height = self.depth_size
        data = bytes(depth)
        if len(data) != 2 * width * height:
            return SkippedFrame(pair.stamp_s, "depth image is cut off", index)
        depth_mm = np.frombuffer(data, ">u2").reshape(height, width).astype(np.uint16)
        if not depth_mm.any():
            return SkippedFrame(pair.stamp_s, NOTHING_MEASURED, index)
        av, pixels = needed("av"), None
        with suppress(av.error.FFmpegError, OSError, ValueError):
            for decoded in color.decode()[:1]:
                pixels = np.asarray(decoded.to_ndarray(format="rgb24"), np.uint8)
        camera, _ = self.calibration.cameras
        if pixels is None or pixels.shape != (camera.height, camera.width, 3):
            return SkippedFrame(pair.stamp_s, "colour image is damaged", index)
        seen, depth_m = self.registration.undistorted(pixels), self.registration.registered(depth_mm)
        depth_m = corrected_depth(seen, depth_m, self.calibration, (self.path, self.path))
        return RgbdFrame(pair.stamp_s, seen, depth_m, index, pair.depth_late_s)


@dataclass(frozen=True, slots=True, eq=False)
class _Listed:
    """The contents of a file, without images."""

    color_pts: list[int]
    depth_pts: list[int]
    tick_s: float
    depth_delay_s: float
    color_size: tuple[int, int]
    depth_size: tuple[int, int]
    depth_mode: str
    serial: str
    calibration: Any
    has_imu: bool
    is_cut_off: bool


@contextmanager
def _opened(path: Path) -> Iterator[Any]:
    """The file's container; errors are raised as RecordingError.

    An open file is passed, as Matroska only: FFmpeg would also follow lists of files, and open devices and addresses.
    """
    av = needed("av")
    with open_binary(path, _MKV, RecordingError) as stream:
        try:
            with av.open(stream, format="matroska") as container:
                yield container
        # Attributes of PyAV are missing or None in incomplete files.
        except (av.error.FFmpegError, OSError, ValueError, TypeError, AttributeError, ArithmeticError) as error:
            raise RecordingError(f"is no Matroska file that can be read: {error}", path=path, fix=_COPY) from error


def _streams(container: Any, path: Path) -> dict[str, Any]:
    """The colour and depth streams by name. Raises RecordingError where one is missing or invalid."""
    found = {str(stream.metadata.get("title", "")): stream for stream in container.streams.video}
    for name in (_COLOR, _DEPTH):
        if name not in found:
            there = ", ".join(sorted(found)) or "none"
            fix = "record colour and depth with k4arecorder"
            raise RecordingError(f"no stream is called {name}; there are: {there}", path=path, fix=fix)
        stream = found[name]
        if stream.codec_context is None:
            raise RecordingError(f"its stream {name} has an unknown codec", path=path, fix=_COPY)
        if not stream.time_base or not 0 < stream.width * stream.height <= MOST_PIXELS:
            problem = f"its stream {name} is of {stream.width}×{stream.height} pixels, in units of {stream.time_base} s"
            raise RecordingError(problem, path=path, fix=_COPY)
        # An image states its own size, which may differ from its stream's.
        stream.codec_context.options = {"max_pixels": str(MOST_PIXELS)}
    return found


def _list(path: Path) -> _Listed:
    """The contents of a file. Decodes no images. Raises RecordingError."""
    with _opened(path) as container:
        streams = _streams(container, path)
        color, depth = streams[_COLOR], streams[_DEPTH]
        if color.time_base != depth.time_base:
            raise RecordingError("colour and depth have clocks of their own", path=path)
        stamps: dict[int, list[int]] = {color.index: [], depth.index: []}
        av, is_whole = needed("av"), True
        try:
            for packet in container.demux(color, depth):
                if packet.pts is not None and packet.size:
                    stamps[packet.stream_index].append(packet.pts)
        except av.error.FFmpegError:
            is_whole = False
        return _Listed(
            color_pts=sorted(set(stamps[color.index])),
            depth_pts=sorted(set(stamps[depth.index])),
            tick_s=float(color.time_base),
            depth_delay_s=1e-9 * int(container.metadata.get("K4A_DEPTH_DELAY_NS", "0")),
            color_size=(color.width, color.height),
            depth_size=(depth.width, depth.height),
            depth_mode=str(depth.metadata.get("K4A_DEPTH_MODE", "")),
            serial=str(container.metadata.get("K4A_DEVICE_SERIAL_NUMBER", "")),
            calibration=_calibration_in(container, path),
            has_imu=any(stream.metadata.get("title") == "IMU" for stream in container.streams),
            # FFmpeg does not report that a file is cut off.
            is_cut_off=not is_whole or _ends_early(path),
        )


def _ends_early(path: Path) -> bool:
    """Whether the file ends before its segment, by the stated sizes (RFC 8794, sections 4 and 6)."""
    with open_binary(path, _MKV, RecordingError) as stream:
        head = stream.read(_HEAD)
    length, at = _size_at(head, 4)
    at += length or 0
    length, begin = _size_at(head, at + 4)
    return head[at : at + 4] == _SEGMENT and length is not None and begin + length > path.stat().st_size


def _size_at(data: bytes, at: int) -> tuple[int | None, int]:
    """An element's size, None where it is not stated, and the offset of its content."""
    if at >= len(data):
        return None, at
    bytes_of_it = 9 - data[at].bit_length()
    end, unknown = at + bytes_of_it, (1 << 7 * bytes_of_it) - 1
    size = int.from_bytes(data[at:end]) & unknown
    return None if size == unknown else size, end


def _packets(path: Path) -> Iterator[tuple[str, Any]]:
    """Colour and depth packets in file order, up to any damage."""
    with _opened(path) as container:
        streams = _streams(container, path)
        names = {streams[name].index: name for name in (_COLOR, _DEPTH)}
        packets = container.demux(*(streams[name] for name in (_COLOR, _DEPTH)))
        av = needed("av")
        while True:
            try:
                packet = next(packets)
            except (StopIteration, av.error.FFmpegError):
                return
            if packet.pts is not None and packet.size:
                yield names[packet.stream_index], packet


def _calibration_in(container: Any, path: Path) -> Any:
    """The attached calibration.json, parsed. Raises RecordingError where it is missing or invalid."""
    for stream in container.streams:
        if stream.type == "attachment" and str(stream.metadata.get("filename", "")) == "calibration.json":
            data = bytes(stream.data or b"").rstrip(b"\0")
            try:
                return parse_json(data) if len(data) <= _MOST_ATTACHED else None
            except ValueError as error:
                raise RecordingError(f"its calibration.json {error}", path=path) from error
    raise RecordingError("has no calibration.json", path=path, fix="record with k4arecorder, which attaches it")
