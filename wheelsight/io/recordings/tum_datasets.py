"""Datasets in the layout of the TUM RGB-D benchmark: lists of stamped images. Readers for TUM, Bonn, ETH3D and
OpenLORIS.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from wheelsight.core.calibration import Calibration
from wheelsight.core.calibration_parts import DepthNoise
from wheelsight.core.errors import CalibrationError, RecordingError
from wheelsight.core.geometry import FloatArray, PinholeCamera, se3, so3
from wheelsight.core.inputs import is_there, read_yaml
from wheelsight.core.trajectory import Trajectory, read_tum
from wheelsight.io.recordings.image_recording import FramePaths, ImageRecording, PairedImages, pair_images, recording_of
from wheelsight.io.recordings.images import DepthEncoding, color_size, is_depth_image
from wheelsight.io.recordings.recording import (
    AssociationReport,
    Layout,
    OpenOptions,
    camera_choices,
    choose_calibration,
    load_camera,
)
from wheelsight.io.recordings.tables import (
    find_files,
    keep_growing,
    listed_lines,
    pair_of_files,
    read_file_list,
    read_lines,
)

DEPTH_FACTOR = 5000.0
_ASSOCIATIONS = ("associations.txt", "association.txt", "associated.txt", "associate.txt", "assoc.txt")
_FREIBURG = re.compile(r"(?<![a-z])(?:freiburg|fr)([123])(?![0-9])", re.IGNORECASE)


class TumReader:
    """Reads rgb.txt, depth.txt and groundtruth.txt of the TUM RGB-D benchmark (Sturm et al., IROS 2012).

    Colour and registered depth are PNG or JPEG files, depth with 5000 units per metre.
    """

    name = "tum"
    layout = Layout.LISTS
    needs = "rgb.txt and depth.txt"

    def recognises(self, folder: Path) -> bool:
        """Whether one of the two list files exists."""
        return any(is_there(folder / name) for name in ("rgb.txt", "depth.txt"))

    def open(self, folder: Path, options: OpenOptions) -> ImageRecording:
        """The recording in `folder`. An associations file in it determines the pairs.

        Raises:
            InputError: a file is invalid, or the camera is unknown from folder name, files and options; names file and
                line.
        """

        def known() -> Calibration:
            name = folder.resolve().name
            found = set(_FREIBURG.findall(name))
            if len(found) != 1:
                problem = f"its camera is unknown: the folder's name {name!r} names no freiburg1, 2 or 3"
                raise CalibrationError(problem, path=folder, fix=camera_choices())
            return load_camera(f"freiburg{found.pop()}")

        calibration = choose_calibration(folder, options, known)
        return open_lists(folder, options, self.name, lambda _: calibration)


def open_lists(
    folder: Path,
    options: OpenOptions,
    name: str,
    calibration_of: Callable[[tuple[FramePaths, ...]], Calibration],
    truth_of: Callable[[Path, list[str]], Trajectory | None] | None = None,
) -> ImageRecording:
    """The recording of rgb.txt, depth.txt and groundtruth.txt. Raises InputError.

    Args:
        calibration_of: gives the calibration for the frames.
        truth_of: reads groundtruth.txt; None where it has poses of the camera.
    """
    images, warnings = read_frames(folder, options)
    return recording_of(
        folder,
        name,
        calibration_of(images.frames),
        images,
        DepthEncoding(options.depth_factor or DEPTH_FACTOR),
        by_frame_clock((truth_of or read_truth)(folder / "groundtruth.txt", warnings), images.frames, options),
        warnings,
    )


def read_frames(folder: Path, options: OpenOptions) -> tuple[PairedImages, list[str]]:
    """The frames of rgb.txt and depth.txt, and warnings. Raises RecordingError."""
    color, color_warnings = read_file_list(folder / "rgb.txt", options.rate_hz)
    depth, depth_warnings = read_file_list(folder / "depth.txt", options.rate_hz)
    warnings = color_warnings + depth_warnings
    ready = next((folder / name for name in _ASSOCIATIONS if is_there(folder / name)), None)
    if ready is None:
        return pair_images(color, depth, options.max_gap_s, folder / "rgb.txt"), warnings
    frames, pair_warnings = read_associations(ready, options.rate_hz)
    gap_s, count = max(abs(frame.depth_late_s) for frame in frames), len(frames)
    association = AssociationReport(max(len(color), count), max(len(depth), count), count, gap_s, gap_s)
    note = f"Colour and depth are paired as {ready.name} says, with gaps up to {gap_s:.3f} s."
    return PairedImages(tuple(frames), association), [*warnings, *pair_warnings, note]


def by_frame_clock(truth: Trajectory | None, frames: tuple[FramePaths, ...], options: OpenOptions) -> Trajectory | None:
    """The true poses by the frames' clock.

    Where the frames' stamps count `rate_hz` per second, those of the poses may do so too, or be in seconds. The unit is
    used that shares more time with the frames.
    """
    if truth is None or options.rate_hz is None or not len(truth) or not frames:
        return truth

    def shared(found: Trajectory) -> float:
        """The time that both share, divided by the time of both together."""
        (begin_s, end_s), stamps_s = (frames[0].stamp_s, frames[-1].stamp_s), found.stamps_s
        both_s = max(stamps_s[-1], end_s) - min(stamps_s[0], begin_s)
        return float((min(stamps_s[-1], end_s) - max(stamps_s[0], begin_s)) / both_s) if both_s > 0 else 0.0

    return max(replace(truth, stamps_s=truth.stamps_s / options.rate_hz), truth, key=shared)


def read_truth(path: Path, warnings: list[str], body: str = "camera") -> Trajectory | None:
    """The trajectory in `path`, or None where the file does not exist. Appends to `warnings`.

    Raises TrajectoryError naming file and line.
    """
    return read_tum(path, body, warnings.append) if is_there(path) else None


# Associations files, with lines `stamp color stamp depth`, or depth first

# The last such word of a path counts: depth/rgb_17.png is a colour image.
_WORD = re.compile(r"(?P<depth>depth)|(?:rgb|colou?r)(?!-?d(?![a-z]))", re.IGNORECASE)
_PAIRS_TRIED = 8

_Stamped = tuple[float, str]


def read_associations(path: Path, rate_hz: float | None) -> tuple[list[FramePaths], list[str]]:
    """The frames of an associations file, and warnings.

    Args:
        rate_hz: units per second of the stamps; None for the unit that the file names, else seconds.

    Raises:
        RecordingError: a line is invalid, or neither names nor images distinguish colour from depth.
    """
    lines, per_second = listed_lines(path)
    rate = rate_hz or per_second
    if not lines:
        raise RecordingError("pairs no images", path=path, fix="remove the file to have them paired by stamp")
    numbers = [line.number for line in lines]
    entries = _color_first([pair_of_files(line, path) for line in lines], numbers, path)
    color, warnings = find_files([first[1] for first, _ in entries], path, "rgb")
    depth, more = find_files([second[1] for _, second in entries], path, "depth")
    frames = [
        FramePaths(color_s / rate, color_path, depth_path, (depth_s - color_s) / rate)
        for ((color_s, _), (depth_s, _)), color_path, depth_path in zip(entries, color, depth, strict=True)
    ]
    growing, left_out = keep_growing(frames, numbers, path)
    return growing, warnings + more + left_out


def _color_first(
    pairs: list[tuple[_Stamped, _Stamped]], numbers: Sequence[int], path: Path
) -> list[tuple[_Stamped, _Stamped]]:
    """The pairs with colour first, judged by file names, or by the types of some images where names are ambiguous."""
    kinds = [(_kind(first[1]), _kind(second[1])) for first, second in pairs]
    depth_first = [None if a == b else a == "depth" or b == "color" for a, b in kinds]
    ambiguous = [i for i, known in enumerate(depth_first) if known is None]
    if ambiguous:
        by_images = _is_depth_first([pairs[i] for i in ambiguous], path, numbers[ambiguous[0]])
        depth_first = [by_images if known is None else known for known in depth_first]
    return [pair[::-1] if turned else pair for pair, turned in zip(pairs, depth_first, strict=True)]


def _kind(name: str) -> str | None:
    """Either "depth" or "color", by a file's path, or None."""
    words = list(_WORD.finditer(name))
    return None if not words else "depth" if words[-1]["depth"] else "color"


def _is_depth_first(pairs: Sequence[tuple[_Stamped, _Stamped]], path: Path, line: int) -> bool:
    """Whether the first image of pairs is depth, of 16 bits and grey. False where no image can be read."""
    tried = pairs[:: max(len(pairs) // _PAIRS_TRIED, 1)]
    columns = [find_files([pair[k][1] for pair in tried], path, folder)[0] for k, folder in ((0, "rgb"), (1, "depth"))]
    kinds = {(is_depth_image(first), is_depth_image(second)) for first, second in zip(*columns, strict=True)}
    known = {kind for kind in kinds if None not in kind}
    if known == {(True, False)}:
        return True
    if known in (set(), {(False, True)}):
        return False
    problem = "neither names nor images show which of the two is depth"
    raise RecordingError(problem, path=path, line=line, fix="put depth images, of 16 bits, into a folder called depth")


_PREFIX = "rgbd_bonn_"
# Published with the data: axes of the motion capture, and the markers' frame seen from the camera. The columns of the
# latter have length 1.06; the nearest rigid motion is used.
_AXES = np.array([[-1.0, 0, 0, 0], [0, 0, 1, 0], [0, 1, 0, 0], [0, 0, 0, 1]])
_MARKERS = np.array(
    [
        [1.0157, 0.1828, -0.2389, 0.0113],
        [0.0009, -0.8431, -0.6413, -0.0098],
        [-0.3009, 0.6147, -0.8085, 0.0111],
        [0, 0, 0, 1],
    ]
)


class BonnReader:
    """Reads the Bonn RGB-D Dynamic dataset: TUM's layout with true poses of markers (Palazzolo et al., IROS 2019)."""

    name = "bonn"
    layout = Layout.LISTS
    needs = f"as tum, in {_PREFIX}*"

    def recognises(self, folder: Path) -> bool:
        """Whether the folder has their prefix and a list of images."""
        is_called = folder.resolve().name.startswith(_PREFIX)
        return is_called and any(is_there(folder / name) for name in ("rgb.txt", "depth.txt"))

    def open(self, folder: Path, options: OpenOptions) -> ImageRecording:
        """The recording in `folder`. Raises InputError naming file and line."""
        calibration = choose_calibration(folder, options, lambda: load_camera(self.name))

        def truth_of(path: Path, warnings: list[str]) -> Trajectory | None:
            truth = read_truth(path, warnings)
            if truth is None:
                return None
            warnings.append("True poses are of markers; the camera's pose among them is by the data set's authors.")
            return replace(truth, T_frame_body=_AXES @ truth.T_frame_body @ _AXES @ se3.nearest(_MARKERS))

        return open_lists(folder, options, self.name, lambda _: calibration, truth_of)


_INTRINSICS = "calibration.txt"
_FIX = "write fx fy cx cy in pixels, or remove the file to have the folder read as TUM's"


class Eth3dReader:
    """Reads the ETH3D SLAM benchmark: TUM's lists, and calibration.txt (Schöps, Sattler, Pollefeys, CVPR 2019).

    Colour is undistorted and depth registered to it, with 5000 units per metre. Both have a global shutter.
    """

    name = "eth3d"
    layout = Layout.LISTS
    needs = "as tum, and calibration.txt"

    def recognises(self, folder: Path) -> bool:
        """Whether the folder has intrinsics and a list of images."""
        return is_there(folder / _INTRINSICS) and any(is_there(folder / name) for name in ("rgb.txt", "depth.txt"))

    def open(self, folder: Path, options: OpenOptions) -> ImageRecording:
        """The recording in `folder`. Raises InputError naming file and line."""
        path = folder / _INTRINSICS

        def known(frames: tuple[FramePaths, ...]) -> Calibration:
            """The camera of four numbers, with the size of the first image."""
            lines = read_lines(path)
            try:
                numbers = [float(word) for line in lines for word in line.text.split()]
            except ValueError as error:
                raise CalibrationError(f"holds an invalid number: {error}", path=path, fix=_FIX) from error
            if len(numbers) != 4 or not all(map(math.isfinite, numbers)):
                problem = f"holds {len(numbers)} numbers where the four fx fy cx cy are expected"
                raise CalibrationError(problem, path=path, fix=_FIX)
            width, height = color_size(frame.color for frame in frames)
            try:
                fx, fy, cx, cy = numbers
                camera = PinholeCamera(width, height, fx, fy, cx, cy)
                return Calibration.registered_camera(camera, source=f"{path.name} of {path.resolve().parent.name}")
            except CalibrationError as error:
                raise CalibrationError(error.problem, path=path, fix=_FIX) from error

        def calibration_of(frames: tuple[FramePaths, ...]) -> Calibration:
            return choose_calibration(folder, options, lambda: known(frames))

        return open_lists(folder, options, self.name, calibration_of)


_CAMERA = "d400_color_optical_frame"
_BASE = "base_link"
_DEPTH_FACTOR = 1000.0
_RIGID_TOLERANCE = 1e-2  # files have four digits or more
_FARTHEST_M = 1000.0  # between parts of a robot
_OPENLORIS_FIX = "correct it, or give a calibration.yaml with --camera"
_D435_NOISE = DepthNoise(quadratic_per_m=3.9e-3, near_m=0.3, far_m=10.0)
"""Intel's rule for stereo depth, σ = z² · subpixel / (f · baseline), with 0.08 px, 415 px and 0.05 m for the D435."""


class OpenLorisReader:
    """Reads a sequence of OpenLORIS-Scene in its package format (Shi et al., ICRA 2020).

    Colour and depth registered to it are of a RealSense D435i, depth with 1000 units per metre. The ground truth is
    that of base_link.
    """

    name = "openloris"
    layout = Layout.LISTS
    needs = "color.txt, aligned_depth.txt and sensors.yaml"

    def recognises(self, folder: Path) -> bool:
        """Whether the folder has the list of aligned depth, or that of colour and sensors.yaml."""
        has_color = is_there(folder / "color.txt") and is_there(folder / "sensors.yaml")
        return has_color or is_there(folder / "aligned_depth.txt")

    def open(self, folder: Path, options: OpenOptions) -> ImageRecording:
        """The recording in `folder`. Raises InputError naming file and line."""
        color, warnings = read_file_list(folder / "color.txt")
        depth, depth_warnings = read_file_list(folder / "aligned_depth.txt")
        warnings += depth_warnings

        def known() -> Calibration:
            """Intrinsics from sensors.yaml, and T_base_camera from trans_matrix.yaml if it exists."""
            path = folder / "sensors.yaml"
            try:
                sensor = read_yaml(path, CalibrationError)[_CAMERA]
                fx, cx, fy, cy = _numbers(sensor["intrinsics"], 4)
                k1, k2, p1, p2, k3 = (*_numbers(sensor.get("distortion_coefficients") or {"data": []}), 0, 0, 0, 0, 0)[
                    :5
                ]
                camera = PinholeCamera(
                    int(sensor["width"]), int(sensor["height"]), fx, fy, cx, cy, (k1, k2, p1, p2, k3)
                )
            except (KeyError, TypeError, ValueError, OverflowError) as error:
                problem = f"does not describe {_CAMERA} with width, height and intrinsics fx, cx, fy, cy: {error}"
                raise CalibrationError(problem, path=path, fix=_OPENLORIS_FIX) from error
            except CalibrationError as error:
                raise CalibrationError(error.problem, path=path, fix=error.fix or _OPENLORIS_FIX) from error
            T_base_camera = _read_mount(folder / "trans_matrix.yaml")
            source = f"{path.name} of {folder.resolve().name}"
            return Calibration.registered_camera(
                camera, depth_noise=_D435_NOISE, T_base_camera=T_base_camera, source=source
            )

        calibration = choose_calibration(folder, options, known)
        images = pair_images(color, depth, options.max_gap_s, folder / "color.txt")
        if is_there(folder / "odom.txt"):
            warnings.append("odom.txt holds poses the robot computed, no encoder ticks; it is not used.")
        truth = read_truth(folder / "groundtruth.txt", warnings, body="base")
        if truth is not None and calibration.T_base_camera is None:
            warnings.append(
                "The ground truth describes the base, but nothing says where the camera is; it is not used."
            )
            truth = None
        return recording_of(
            folder,
            self.name,
            calibration,
            images,
            DepthEncoding(options.depth_factor or _DEPTH_FACTOR),
            truth,
            warnings,
        )


def _read_mount(path: Path) -> FloatArray | None:
    """T_base_camera, composed along the frames of the file; None where it does not exist. Raises CalibrationError."""
    if not is_there(path):
        return None
    try:
        links: list[tuple[str, str, FloatArray]] = []
        for link in read_yaml(path, CalibrationError)["trans_matrix"]:
            parent, child = str(link["parent_frame"]), str(link["child_frame"])
            links.append((parent, child, np.reshape(_numbers(link["matrix"], 16), (4, 4))))
    except (KeyError, TypeError, ValueError) as error:
        problem = f"is not a list of parent_frame, child_frame, matrix: {error}"
        raise CalibrationError(problem, path=path, fix="each with four times four numbers in matrix.data") from error
    joined: dict[str, dict[str, FloatArray]] = {}
    for parent, child, T_parent_child in links:
        if not se3.is_valid(T_parent_child, _RIGID_TOLERANCE) or np.abs(T_parent_child).max() > _FARTHEST_M:
            problem = f"the matrix from {child} to {parent} is no rigid motion"
            raise CalibrationError(problem, path=path, fix="orthonormal rotation, metres, last row 0 0 0 1")
        joined.setdefault(parent, {}).setdefault(child, T_parent_child)
        joined.setdefault(child, {}).setdefault(parent, np.asarray(np.linalg.inv(T_parent_child), np.float64))
    T_base, reached = {_BASE: np.eye(4)}, [_BASE]
    while reached:
        parent = reached.pop()
        for child in joined.get(parent, {}).keys() - T_base.keys():
            T_base[child] = T_base[parent] @ joined[parent][child]
            reached.append(child)
    if _CAMERA not in T_base:
        fix = f"join them, parent_frame: {_BASE}, child_frame: {_CAMERA}"
        raise CalibrationError(f"no chain of frames leads from {_BASE} to {_CAMERA}", path=path, fix=fix)
    T = T_base[_CAMERA]
    return se3.from_parts(so3.nearest(T[:3, :3]), T[:3, 3])


def _numbers(matrix: dict[str, Any], count: int | None = None) -> list[float]:
    """The numbers of a tagged matrix; ValueError if they are not `count`."""
    numbers = [float(x) for x in matrix["data"]]
    if count is not None and len(numbers) != count:
        raise ValueError(f"{len(numbers)} numbers where {count} are expected")
    return numbers
