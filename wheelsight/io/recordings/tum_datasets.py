"""Datasets in the layout of the TUM RGB-D benchmark: lists of stamped images. Readers for TUM, Bonn, ETH3D and
OpenLORIS.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
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

# The TUM RGB-D benchmark's layout: rgb.txt, depth.txt, groundtruth.txt (Sturm et al., IROS 2012).


DEPTH_FACTOR = 5000.0
_ASSOCIATIONS = ("associations.txt", "association.txt", "associated.txt", "associate.txt", "assoc.txt")
_FREIBURG = re.compile(r"(?<![a-z])(?:freiburg|fr)([123])(?![0-9])", re.IGNORECASE)


class TumReader:
    """Colour and registered depth in PNG or JPEG files; 5000 depth units a metre."""

    name = "tum"
    layout = Layout.LISTS
    needs = "rgb.txt and depth.txt"

    def recognises(self, folder: Path) -> bool:
        """Whether one of the two list files is there."""
        return any(is_there(folder / name) for name in ("rgb.txt", "depth.txt"))

    def open(self, folder: Path, options: OpenOptions) -> ImageRecording:
        """The recording in `folder`; a ready associations file in it is used as it is.

        Raises:
            InputError: naming file and line; also for a camera that neither folder name, file nor option tells.
        """
        calibration = choose_calibration(folder, options, lambda: _camera_by_name(folder))
        return open_lists(folder, options, self.name, lambda _: calibration)


def open_lists(
    folder: Path,
    options: OpenOptions,
    name: str,
    calibration_of: Callable[[tuple[FramePaths, ...]], Calibration],
    truth_of: Callable[[Path, list[str]], Trajectory | None] | None = None,
) -> ImageRecording:
    """The recording of rgb.txt, depth.txt and groundtruth.txt, of the format `name`. Raises InputError.

    `truth_of` reads groundtruth.txt, if it is not of the camera as it stands.
    """
    images, warnings = read_frames(folder, options)
    return recording_of(
        folder,
        name,
        calibration_of(images.frames),
        images,
        DepthEncoding(options.depth_factor or DEPTH_FACTOR),
        beside((truth_of or read_truth)(folder / "groundtruth.txt", warnings), images.frames, options),
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
    pairs, pair_warnings = read_associations(ready, options.rate_hz)
    frames = tuple(pair.frame for pair in pairs)
    gap_s = max(pair.gap_s for pair in pairs)
    association = AssociationReport(
        max(len(color), len(frames)), max(len(depth), len(frames)), len(frames), gap_s, gap_s
    )
    note = f"Colour and depth are paired as {ready.name} says, with gaps up to {gap_s:.3f} s."
    return PairedImages(frames, association), [*warnings, *pair_warnings, note]


def beside(truth: Trajectory | None, frames: tuple[FramePaths, ...], options: OpenOptions) -> Trajectory | None:
    """The true poses by the frames' clock: where that counts `rate_hz` a second, theirs may, or be in seconds already.

    They are taken as what shares more time with the frames.
    """
    if truth is None or options.rate_hz is None or not len(truth) or not frames:
        return truth
    there_s = frames[0].stamp_s, frames[-1].stamp_s
    divided = replace(truth, stamps_s=truth.stamps_s / options.rate_hz)
    return max(divided, truth, key=lambda found: _common_share(found.stamps_s, there_s))


def _common_share(stamps_s: FloatArray, span_s: tuple[float, float]) -> float:
    """The time that stamps (N,) share with a span, as a share of both together."""
    common_s = min(stamps_s[-1], span_s[1]) - max(stamps_s[0], span_s[0])
    both_s = max(stamps_s[-1], span_s[1]) - min(stamps_s[0], span_s[0])
    return float(common_s / both_s) if both_s > 0 else 0.0


def read_truth(path: Path, warnings: list[str], body: str = "camera") -> Trajectory | None:
    """The trajectory in `path`, or None where there is no such file; warnings are added to the list.

    Raises TrajectoryError naming file and line.
    """
    return read_tum(path, body, warnings.append) if is_there(path) else None


def _camera_by_name(folder: Path) -> Calibration:
    name = folder.resolve().name
    found = set(_FREIBURG.findall(name))
    if len(found) != 1:
        problem = f"nothing says which camera took it: the folder's name {name!r} names no freiburg1, 2 or 3"
        raise CalibrationError(problem, path=folder, fix=camera_choices())
    return load_camera(f"freiburg{found.pop()}")


# Ready lists of pairs, `stamp color stamp depth` a line or depth first; names or images tell which is which.


# The last such word in a path counts: depth/rgb_17.png is colour's.
_WORD = re.compile(r"(?P<depth>depth)|(?:rgb|colou?r)(?!-?d(?![a-z]))", re.IGNORECASE)
_PAIRS_TRIED = 8

_Stamped = tuple[float, str]


@dataclass(frozen=True, slots=True)
class Pair:
    """One line of an associations file."""

    stamp_s: float
    frame: FramePaths
    gap_s: float


def read_associations(path: Path, rate_hz: float | None) -> tuple[list[Pair], list[str]]:
    """Pairs of `stamp color stamp depth`, or depth first; stamps count `rate_hz` a second, else as the file names it.

    Raises:
        RecordingError: naming file and line; also where neither names nor images tell colour from depth.
    """
    lines, per_second = listed_lines(path)
    rate = rate_hz or per_second
    if not lines:
        raise RecordingError("pairs no images", path=path, fix="remove the file to have them paired by stamp")
    numbers = [line.number for line in lines]
    told = _color_first([pair_of_files(line, path) for line in lines], numbers, path)
    color, warnings = find_files([first[1] for first, _ in told], path, "rgb")
    depth, more = find_files([second[1] for _, second in told], path, "depth")
    pairs = [
        Pair(
            first[0] / rate,
            FramePaths(first[0] / rate, color_path, depth_path, (second[0] - first[0]) / rate),
            abs(first[0] - second[0]) / rate,
        )
        for (first, second), color_path, depth_path in zip(told, color, depth, strict=True)
    ]
    growing, left_out = keep_growing(pairs, numbers, path)
    return growing, warnings + more + left_out


def _color_first(
    pairs: list[tuple[_Stamped, _Stamped]], numbers: Sequence[int], path: Path
) -> list[tuple[_Stamped, _Stamped]]:
    """The pairs with colour first: by their names; where these do not tell, by the type of some of their images."""
    depth_first = [_is_depth_first(first[1], second[1]) for first, second in pairs]
    untold = [i for i, known in enumerate(depth_first) if known is None]
    if untold:
        by_images = _by_images([pairs[i] for i in untold], path, numbers[untold[0]])
        depth_first = [by_images if known is None else known for known in depth_first]
    return [
        (second, first) if turned else (first, second)
        for (first, second), turned in zip(pairs, depth_first, strict=True)
    ]


def _is_depth_first(first: str, second: str) -> bool | None:
    """Whether names say that the first of two is the depth image; None where they say nothing, or both the same."""
    kinds = [_kind(first), _kind(second)]
    if kinds[0] == kinds[1]:
        return None
    return kinds[0] == "depth" or kinds[1] == "color"


def _kind(name: str) -> str | None:
    words = list(_WORD.finditer(name))
    return None if not words else "depth" if words[-1]["depth"] else "color"


def _by_images(pairs: Sequence[tuple[_Stamped, _Stamped]], path: Path, line: int) -> bool:
    """Whether the first images are of 16 bits and grey, the second ones not; colour first where none can be read."""
    tried = pairs[:: max(len(pairs) // _PAIRS_TRIED, 1)]
    columns = [find_files([pair[k][1] for pair in tried], path, folder)[0] for k, folder in ((0, "rgb"), (1, "depth"))]
    kinds = {(is_depth_image(first), is_depth_image(second)) for first, second in zip(*columns, strict=True)}
    known = {kind for kind in kinds if None not in kind}
    if known == {(True, False)}:
        return True
    if known in (set(), {(False, True)}):
        return False
    problem = "neither names nor images tell which of the two is depth"
    raise RecordingError(problem, path=path, line=line, fix="put depth images, of 16 bits, into a folder called depth")


# The Bonn RGB-D Dynamic dataset: TUM's layout, true poses of markers (Palazzolo et al., IROS 2019).


_PREFIX = "rgbd_bonn_"
# Published with the data: axes of the motion capture, and the markers' frame seen from the camera. The latter's columns
# are 1.06 long; a pose has no scale, so the nearest rigid motion is taken.
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
    """Colour and registered depth in PNG files; 5000 depth units a metre."""

    name = "bonn"
    layout = Layout.LISTS
    needs = f"as tum, in {_PREFIX}*"

    def recognises(self, folder: Path) -> bool:
        """Whether a folder called as theirs holds a list of images."""
        is_called = folder.resolve().name.startswith(_PREFIX)
        return is_called and any(is_there(folder / name) for name in ("rgb.txt", "depth.txt"))

    def open(self, folder: Path, options: OpenOptions) -> ImageRecording:
        """The recording in `folder`. Raises InputError naming file and line."""
        calibration = choose_calibration(folder, options, lambda: load_camera(self.name))
        return open_lists(folder, options, self.name, lambda _: calibration, _read_truth)


def _read_truth(path: Path, warnings: list[str]) -> Trajectory | None:
    """T_frame_camera; the file's poses are of markers, in axes of motion capture. Raises TrajectoryError."""
    truth = read_truth(path, warnings)
    if truth is None:
        return None
    warnings.append("True poses are of markers; the camera among them is where the data set's authors say.")
    return replace(truth, T_frame_body=_AXES @ truth.T_frame_body @ _AXES @ se3.nearest(_MARKERS))


# The ETH3D SLAM benchmark's RGB-D layout: TUM's lists, and calibration.txt (Schöps, Sattler, Pollefeys, CVPR 2019).


_INTRINSICS = "calibration.txt"
_FIX = "write fx fy cx cy in pixels, or remove the file to have the folder read as TUM's"


class Eth3dReader:
    """Undistorted colour and depth registered to it, both of a global shutter; 5000 depth units a metre."""

    name = "eth3d"
    layout = Layout.LISTS
    needs = "as tum, and calibration.txt"

    def recognises(self, folder: Path) -> bool:
        """Whether intrinsics lie beside a list of images."""
        return is_there(folder / _INTRINSICS) and any(is_there(folder / name) for name in ("rgb.txt", "depth.txt"))

    def open(self, folder: Path, options: OpenOptions) -> ImageRecording:
        """The recording in `folder`. Raises InputError naming file and line."""

        def calibration_of(frames: tuple[FramePaths, ...]) -> Calibration:
            return choose_calibration(folder, options, lambda: _calibration(folder / _INTRINSICS, frames))

        return open_lists(folder, options, self.name, calibration_of)


def _calibration(path: Path, frames: tuple[FramePaths, ...]) -> Calibration:
    """Of four numbers; the size of images, which the file does not tell, is that of the first."""
    lines = read_lines(path)
    try:
        numbers = [float(word) for line in lines for word in line.text.split()]
    except ValueError as error:
        raise CalibrationError(f"holds what is no number: {error}", path=path, fix=_FIX) from error
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


# OpenLORIS-Scene, a sequence of its package format: colour and depth aligned to it (Shi et al., ICRA 2020).


_CAMERA = "d400_color_optical_frame"
_BASE = "base_link"
_DEPTH_FACTOR = 1000.0
_RIGID_TOLERANCE = 1e-2  # files round to four digits and more
_FARTHEST_M = 1000.0  # of one part of a robot from another
_OPENLORIS_FIX = "correct it, or give a calibration.yaml with --camera"
_D435_NOISE = DepthNoise(quadratic_per_m=3.9e-3, near_m=0.3, far_m=10.0)
"""Intel's rule for stereo depth, σ = z² · subpixel / (f · baseline), with 0.08 px, 415 px and 0.05 m for the D435."""


class OpenLorisReader:
    """Colour and depth aligned to it, both of a RealSense D435i; 1000 depth units a metre; truth of base_link."""

    name = "openloris"
    layout = Layout.LISTS
    needs = "color.txt, aligned_depth.txt and sensors.yaml"

    def recognises(self, folder: Path) -> bool:
        """Whether the list of aligned depth, or that of colour beside the sensors' description, is there."""
        has_color = is_there(folder / "color.txt") and is_there(folder / "sensors.yaml")
        return has_color or is_there(folder / "aligned_depth.txt")

    def open(self, folder: Path, options: OpenOptions) -> ImageRecording:
        """The recording in `folder`. Raises InputError naming file and line."""
        color, warnings = read_file_list(folder / "color.txt")
        depth, depth_warnings = read_file_list(folder / "aligned_depth.txt")
        warnings += depth_warnings
        calibration = choose_calibration(folder, options, lambda: _openloris_calibration(folder))
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


def _openloris_calibration(folder: Path) -> Calibration:
    """Intrinsics from sensors.yaml, T_base_camera from trans_matrix.yaml where that is there."""
    path = folder / "sensors.yaml"
    try:
        sensor = read_yaml(path, CalibrationError)[_CAMERA]
        fx, cx, fy, cy = _numbers(sensor["intrinsics"], 4)
        k1, k2, p1, p2, k3 = (*_numbers(sensor.get("distortion_coefficients") or {"data": []}), 0, 0, 0, 0, 0)[:5]
        camera = PinholeCamera(int(sensor["width"]), int(sensor["height"]), fx, fy, cx, cy, (k1, k2, p1, p2, k3))
    except (KeyError, TypeError, ValueError, OverflowError) as error:
        problem = f"does not describe {_CAMERA} with width, height and intrinsics fx, cx, fy, cy: {error}"
        raise CalibrationError(problem, path=path, fix=_OPENLORIS_FIX) from error
    except CalibrationError as error:
        raise CalibrationError(error.problem, path=path, fix=error.fix or _OPENLORIS_FIX) from error
    T_base_camera = _chain(folder / "trans_matrix.yaml")
    source = f"{path.name} of {folder.resolve().name}"
    return Calibration.registered_camera(camera, depth_noise=_D435_NOISE, T_base_camera=T_base_camera, source=source)


def _chain(path: Path) -> FloatArray | None:
    """T_base_camera, composed over the frames that the file joins; None where there is no such file."""
    if not is_there(path):
        return None
    try:
        links = [_link(link) for link in read_yaml(path, CalibrationError)["trans_matrix"]]
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


def _link(link: Any) -> tuple[str, str, FloatArray]:
    """Parent, child and T_parent_child of an entry; KeyError, TypeError or ValueError where it is none."""
    parent, child = link["parent_frame"], link["child_frame"]
    return str(parent), str(child), np.reshape(_numbers(link["matrix"], 16), (4, 4))


def _numbers(matrix: dict[str, Any], count: int | None = None) -> list[float]:
    """The numbers of a tagged matrix; ValueError if they are not `count`."""
    numbers = [float(x) for x in matrix["data"]]
    if count is not None and len(numbers) != count:
        raise ValueError(f"{len(numbers)} numbers where {count} are expected")
    return numbers
