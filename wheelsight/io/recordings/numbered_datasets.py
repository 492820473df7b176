"""Datasets of numbered frames without stamps, with poses as matrices. Readers for ICL-NUIM, 7-Scenes, 3DMatch,
Redwood and Replica.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

from wheelsight.core.calibration import Calibration
from wheelsight.core.errors import CalibrationError, RecordingError, TrajectoryError
from wheelsight.core.geometry import FloatArray, PinholeCamera, se3, so3
from wheelsight.core.inputs import Kind, is_there, parse_json, read_text
from wheelsight.core.trajectory import Trajectory, read_tum
from wheelsight.io.recordings.image_recording import FramePaths, ImageRecording, pair_images, recording_of
from wheelsight.io.recordings.images import DepthEncoding, color_size
from wheelsight.io.recordings.recording import Layout, LeftOut, OpenOptions, Reader, choose_calibration, load_camera
from wheelsight.io.recordings.tables import ListedFile, read_lines
from wheelsight.io.recordings.tum_datasets import DEPTH_FACTOR

_ASSUMED_RATE_HZ = 30.0  # of the Kinects, Xtions and renderings of these datasets
_ORTHONORMAL_TOLERANCE = 1e-2


@dataclass(frozen=True, slots=True, eq=False)
class WrittenPose:
    """A pose in a file: its time, its matrix (4, 4), and its file and line."""

    stamp_s: float
    T: FloatArray
    path: Path
    line: int | None = None


def rate_of(options: OpenOptions, warnings: list[str]) -> float:
    """The frame rate, given or 30 Hz. Appends a warning about the assumption."""
    rate_hz = options.rate_hz or _ASSUMED_RATE_HZ
    assumed = "" if options.rate_hz else "; others by --rate-hz"
    warnings.append(f"The format has no time stamps; {rate_hz:g} frames a second are assumed{assumed}.")
    return rate_hz


def numbered_files(paths: Iterable[Path], pattern: re.Pattern[str], rate_hz: float) -> list[ListedFile]:
    """The files whose names match, in order of the number in the pattern's first group, with stamps from it."""
    matches = ((pattern.fullmatch(path.name), path) for path in paths)
    found = {int(match[1]): path for match, path in sorted(matches, key=lambda item: item[1]) if match}
    return [ListedFile(number / rate_hz, found[number]) for number in sorted(found)]


def need_files(files: Sequence[ListedFile], what: str, folder: Path, needs: str) -> None:
    """Raise RecordingError where there are no files."""
    if not files:
        raise RecordingError(f"holds no {what}", path=folder, fix=f"it needs {needs}")


def read_matrix(path: Path, size: int) -> FloatArray:
    """The matrix (size, size) in a text file. Raises RecordingError naming the file."""
    try:
        rows = [[float(word) for word in line.text.split()] for line in read_lines(path)]
        matrix = np.array(rows, np.float64)
    except ValueError as error:
        raise RecordingError(f"is not a {size}×{size} matrix: {error}", path=path) from error
    if matrix.shape != (size, size):
        raise RecordingError(f"holds {matrix.size} numbers, not a {size}×{size} matrix", path=path)
    return matrix


def intrinsic_numbers(path: Path) -> tuple[float, float, float, float]:
    """fx, fy, cx, cy of the matrix (3, 3) in a text file. Raises RecordingError or CalibrationError."""
    (fx, skew, cx), (_, fy, cy), bottom = read_matrix(path, 3).tolist()
    if skew != 0 or bottom != [0, 0, 1]:
        raise CalibrationError("is not an intrinsic matrix fx 0 cx, 0 fy cy, 0 0 1")
    return fx, fy, cx, cy


def true_poses(poses: Sequence[WrittenPose], warnings: list[str]) -> Trajectory | None:
    """T_frame_camera with the nearest orthonormal rotations, or None without valid poses.

    Poses that are not finite, where tracking was lost, are left out with a warning. Raises TrajectoryError where a
    matrix is not a rotation.
    """
    known = [pose for pose in poses if np.isfinite(pose.T).all()]
    if len(known) < len(poses):
        gone = len(poses) - len(known)
        warning = f"{gone} of {len(poses)} true poses are not finite and were left out."
        warnings.append(LeftOut(warning, gone, len(poses), "true poses are not finite"))
    if not known:
        return None
    T = np.stack([pose.T for pose in known])
    R = so3.nearest(T[:, :3, :3])
    off = np.abs(R - T[:, :3, :3]).max(axis=(1, 2))
    if off.max() > _ORTHONORMAL_TOLERANCE:
        worst = known[int(off.argmax())]
        fix = "give poses as rotation and translation, without scale"
        raise TrajectoryError("the first 3×3 numbers are no rotation", path=worst.path, line=worst.line, fix=fix)
    return Trajectory(np.array([pose.stamp_s for pose in known]), se3.from_parts(R, T[:, :3, 3]))


_TRUTH = "*.gt.freiburg"
_FRAME = re.compile(r"(\d{1,9})\.png")
_COLOR = re.compile(r"scene_\d+_(\d{1,9})\.png")
_DISTANCES = re.compile(r"scene_\d+_(\d{1,9})\.depth")
_UP_DOWN = np.diag([1.0, -1.0, 1.0, 1.0])


class IclNuimReader:
    """Reads ICL-NUIM, rendered rooms, as published for TUM's tools or as rendered (Handa et al., ICRA 2014).

    Depth is registered to colour: 16-bit PNG with 5000 units per metre, or text of distances along the pixels' rays.
    """

    name = "icl_nuim"
    layout = Layout.NUMBERED
    needs = "*.gt.freiburg, rgb/ and depth/, or scene_*.png and .depth"

    def recognises(self, folder: Path) -> bool:
        """Whether the folder has true poses with their suffix, or rendered distances."""
        return any(True for _ in folder.glob(_TRUTH)) or any(True for _ in folder.glob("scene_*.depth"))

    def open(self, folder: Path, options: OpenOptions) -> ImageRecording:
        """The recording in `folder`. Stamps are the frames' numbers at 30 Hz, or the rate given. Raises InputError."""
        warnings: list[str] = []
        rate_hz = rate_of(options, warnings)
        calibration = choose_calibration(folder, options, lambda: load_camera(self.name))
        # As published for TUM's tools, else as rendered.
        color, depth = (numbered_files((folder / name).glob("*.png"), _FRAME, rate_hz) for name in ("rgb", "depth"))
        if not color and not depth:
            rendered = list(folder.glob("scene_*"))
            color, depth = (numbered_files(rendered, pattern, rate_hz) for pattern in (_COLOR, _DISTANCES))
        need_files(color, "colour image", folder, self.needs)
        need_files(depth, "depth image", folder, self.needs)
        encoding = DepthEncoding(options.depth_factor or DEPTH_FACTOR)
        if depth[0].path.suffix == ".depth":
            encoding = DepthEncoding(options.depth_factor or 1.0, rays=calibration.cameras[1])
        images = pair_images(color, depth, 0.0, folder)
        found, truth = sorted(folder.glob(_TRUTH)), None
        if len(found) > 1:
            problem = f"holds {len(found)} files of true poses: {', '.join(path.name for path in found)}"
            raise RecordingError(problem, path=folder, fix="leave the one that belongs to these images")
        if found:
            # In the file the y axes of camera and room point up.
            read = read_tum(found[0], "camera", warnings.append)
            T = _UP_DOWN @ read.T_frame_body @ _UP_DOWN
            truth = replace(read, stamps_s=read.stamps_s / rate_hz, T_frame_body=T)
        else:
            warnings.append(f"There is no {_TRUTH}, so that nothing can be evaluated.")
        return recording_of(folder, self.name, calibration, images, encoding, truth, warnings)


_DEPTH = DepthEncoding(factor=1000.0, invalid=65535)
_FILE = re.compile(r"frame-(\d{6})\.(?:(color)\.(?:png|jpe?g)|(depth)\.png|(pose)\.txt)")

_SEVEN_SCENES_TRUTH = "True poses come from the tracker of a Kinect, not from motion capture: good to about 2 cm."


class SevenScenesReader:
    """Reads Microsoft's 7-Scenes: frame-NNNNNN.color.png, .depth.png, .pose.txt (Shotton et al., CVPR 2013).

    Depth is in millimetres, 65535 without a measurement, and not registered. The colour camera is 25 mm beside the
    depth camera and shows objects 0.90 times as large. At 2 m, colour lies about 25 px right of depth at the image's
    left edge, 7 px left of it in the middle, and 40 px left at the right edge.
    """

    name = "seven_scenes"
    layout = Layout.NUMBERED
    needs = "frame-NNNNNN.color.png or .jpg, and .depth.png"

    def recognises(self, folder: Path) -> bool:
        """Whether a file is called as the frames are."""
        return has_frames(folder)

    def open(self, folder: Path, options: OpenOptions) -> ImageRecording:
        """The recording in `folder`. Stamps are the frames' numbers at 30 Hz, or the rate given. Raises InputError."""

        def known() -> Calibration:
            """The shipped calibration, with the depth camera of camera-intrinsics.txt if it exists."""
            shipped, path = load_camera("seven_scenes"), folder / _INTRINSICS
            if not is_there(path):
                return shipped
            try:
                fx, fy, cx, cy = intrinsic_numbers(path)
                depth = replace(shipped.cameras[1], fx=fx, fy=fy, cx=cx, cy=cy)
            except (CalibrationError, RecordingError) as error:
                raise CalibrationError(error.problem, path=path, fix="correct or remove the file") from error
            return replace(shipped, depth=depth)

        calibration = choose_calibration(folder, options, known)
        return open_frames(folder, options, self, _SEVEN_SCENES_TRUTH, lambda _: calibration)


def has_frames(folder: Path) -> bool:
    """Whether a file is called as the frames are."""
    return any(_FILE.fullmatch(path.name) for path in folder.glob("frame-*"))


def open_frames(
    folder: Path,
    options: OpenOptions,
    reader: Reader,
    of_truth: str,
    calibration_of: Callable[[tuple[FramePaths, ...]], Calibration],
) -> ImageRecording:
    """The recording of frames in the layout of 7-Scenes. Raises InputError.

    Args:
        of_truth: a warning about the origin of the true poses.
        calibration_of: gives the calibration for the frames.
    """
    warnings: list[str] = []
    rate_hz = rate_of(options, warnings)
    found: dict[str, dict[int, Path]] = {"color": {}, "depth": {}, "pose": {}}
    for path in sorted(folder.glob("frame-*")):
        if match := _FILE.fullmatch(path.name):
            found[match[2] or match[3] or match[4]][int(match[1])] = path
    files = {
        kind: [ListedFile(number / rate_hz, paths[number]) for number in sorted(paths)] for kind, paths in found.items()
    }
    for kind in ("color", "depth"):
        need_files(files[kind], f"frame-NNNNNN.{kind} image", folder, reader.needs)
    images = pair_images(files["color"], files["depth"], 0.0, folder)
    calibration = calibration_of(images.frames)
    if not calibration.is_registered:
        warnings.append(
            "Colour and depth images are not registered: things lie up to about 40 px apart in them. "
            f"They are joined by T_color_depth of: {calibration.source}."
        )
    encoding = replace(_DEPTH, factor=options.depth_factor or _DEPTH.factor)
    # Of the depth camera. The files' rotations deviate from orthonormal by 4e-4.
    poses = [WrittenPose(pose.stamp_s, read_matrix(pose.path, 4), pose.path) for pose in files["pose"]]
    truth = true_poses(poses, warnings)
    if truth is not None:
        warnings.append(of_truth)
    return recording_of(folder, reader.name, calibration, images, encoding, truth, warnings)


_INTRINSICS = "camera-intrinsics.txt"
_UNREGISTERED = "7-scenes"
_THREE_D_MATCH_TRUTH = "True poses are those of the reconstructions that 3DMatch took over, not motion capture."


class ThreeDMatchReader:
    """Reads 3DMatch's RGB-D reconstructions: frames as in 7-Scenes, one camera for all (Zeng et al., CVPR 2017).

    Depth is registered to colour and in millimetres, 0 or 65535 without a measurement.
    """

    name = "three_d_match"
    layout = Layout.NUMBERED
    needs = "as seven_scenes, and camera-intrinsics.txt above"

    def recognises(self, folder: Path) -> bool:
        """Whether there are frames, and a camera in the folder above, other than the unregistered ones of 7-Scenes."""
        above = folder.resolve().parent
        is_alone = is_there(above / _INTRINSICS) and not is_there(folder / _INTRINSICS)
        return is_alone and not above.name.startswith(_UNREGISTERED) and has_frames(folder)

    def open(self, folder: Path, options: OpenOptions) -> ImageRecording:
        """The recording in `folder`. Stamps are the frames' numbers at 30 Hz, or the rate given. Raises InputError."""
        path = folder.resolve().parent / _INTRINSICS

        def known(frames: tuple[FramePaths, ...]) -> Calibration:
            width, height = color_size(frame.color for frame in frames)
            try:
                camera = PinholeCamera(width, height, *intrinsic_numbers(path))
                return Calibration.registered_camera(camera, source=f"{path.name} of {path.parent.name}")
            except (CalibrationError, RecordingError) as error:
                raise CalibrationError(error.problem, path=path, fix="correct it, or give --camera") from error

        def calibration_of(frames: tuple[FramePaths, ...]) -> Calibration:
            return choose_calibration(folder, options, lambda: known(frames))

        return open_frames(folder, options, self, _THREE_D_MATCH_TRUTH, calibration_of)


_COLOR_FOLDERS = ("rgb", "image", "color")
_IMAGE = re.compile(r"(\d{1,9})(?:-\d+)?\.(?:png|jpe?g)", re.IGNORECASE)
_DEPTH_FACTOR = 1000.0
_LINES_A_POSE = 5
_FIX = "a pose is a line of three whole numbers and four lines of four"


class RedwoodReader:
    """Reads Redwood's indoor recordings: folders of images and a trajectory (Choi, Zhou & Koltun, CVPR 2015).

    Depth is registered to colour and in millimetres. Poses of the log map the camera into the room.
    """

    name = "redwood"
    layout = Layout.NUMBERED
    needs = "rgb/, image/ or color/ with N.jpg, depth/N.png and one *.log"

    def recognises(self, folder: Path) -> bool:
        """Whether a log lies beside folders called as theirs."""
        has_images = _color_folder(folder) is not None and (folder / "depth").is_dir()
        return has_images and any(True for _ in folder.glob("*.log"))

    def open(self, folder: Path, options: OpenOptions) -> ImageRecording:
        """The recording in `folder`. Stamps are the frames' numbers at 30 Hz, or the rate given. Raises InputError."""
        warnings: list[str] = []
        rate_hz = rate_of(options, warnings)
        calibration = choose_calibration(folder, options, lambda: load_camera(self.name))
        color_folder = _color_folder(folder) or folder
        color, depth = (numbered_files(place.iterdir(), _IMAGE, rate_hz) for place in (color_folder, folder / "depth"))
        need_files(color, "colour image called by its number", color_folder, self.needs)
        need_files(depth, "depth image called by its number", folder / "depth", self.needs)
        images = pair_images(color, depth, 0.0, folder)
        logs = sorted(folder.glob("*.log"))
        if len(logs) != 1:
            problem = f"holds {len(logs)} logs: {', '.join(log.name for log in logs)}"
            raise RecordingError(problem, path=folder, fix="leave the one with these images' poses")
        encoding = DepthEncoding(options.depth_factor or _DEPTH_FACTOR)
        truth = true_poses(_read_log(logs[0], depth, warnings), warnings)
        return recording_of(folder, self.name, calibration, images, encoding, truth, warnings)


def _color_folder(folder: Path) -> Path | None:
    return next((folder / name for name in _COLOR_FOLDERS if (folder / name).is_dir()), None)


def _read_log(path: Path, depth: list[ListedFile], warnings: list[str]) -> list[WrittenPose]:
    """Poses of depth images, which the third number counts from 1 in order. Raises TrajectoryError with the line."""
    lines = read_lines(path)
    if not lines or len(lines) % _LINES_A_POSE:
        problem = f"holds {len(lines)} lines, not five a pose"
        raise TrajectoryError(problem, path=path, line=lines[-1].number if lines else None, fix=_FIX)
    known = []
    for first, *others in zip(*[iter(lines)] * _LINES_A_POSE, strict=True):
        try:
            _, _, count = (int(word) for word in first.text.split())
        except ValueError as error:
            raise TrajectoryError("three whole numbers are expected", path=path, line=first.number, fix=_FIX) from error
        rows = []
        for line in others:
            try:
                a, b, c, d = (float(word) for word in line.text.split())
            except ValueError as error:
                raise TrajectoryError("four numbers are expected", path=path, line=line.number, fix=_FIX) from error
            rows.append((a, b, c, d))
        if 1 <= count <= len(depth):
            known.append(WrittenPose(depth[count - 1].stamp_s, np.array(rows), path, first.number))
    total = len(lines) // _LINES_A_POSE
    if len(known) < total:
        warnings.append(f"{total - len(known)} of {total} poses of {path.name} are of no depth image here.")
    stamps = [pose.stamp_s for pose in known]
    if any(later <= before for before, later in pairwise(stamps)):
        raise TrajectoryError("its third numbers do not grow", path=path, fix="put its poses in order of frames")
    return known


_REPLICA_COLOR = re.compile(r"frame(\d{1,9})\.(?:jpe?g|png)")
_REPLICA_DEPTH = re.compile(r"depth(\d{1,9})\.png")
_REPLICA_TRUTH, _CAMERA = "traj.txt", "cam_params.json"
_REPLICA_DEPTH_FACTOR = 6553.5  # 65535 is 10 m
_REPLICA_FIX = 'it needs {"camera": {"w", "h", "fx", "fy", "cx", "cy", "scale"}}'
_POSE_FIX = "one pose a line, row by row"
_JSON = Kind("a camera's description", most_mb=1)


class ReplicaReader:
    """Reads Replica's rooms as NICE-SLAM renders them (Zhu et al., CVPR 2022).

    Depth is registered to colour. The camera's file states its units per metre.
    """

    name = "replica"
    layout = Layout.NUMBERED
    needs = "results/frameN.jpg and depthN.png, and cam_params.json"

    def recognises(self, folder: Path) -> bool:
        """Whether results/ has depth images with their names."""
        results = folder / "results"
        return results.is_dir() and any(_REPLICA_DEPTH.fullmatch(path.name) for path in results.glob("depth*.png"))

    def open(self, folder: Path, options: OpenOptions) -> ImageRecording:
        """The recording in `folder`. Stamps are the frames' numbers at 30 Hz, or the rate given. Raises InputError."""
        warnings: list[str] = []
        rate_hz = rate_of(options, warnings)
        # The camera's file is in the folder, or in the one above, where one serves all rooms.
        beside = [above / _CAMERA for above in (folder, folder.resolve().parent)]
        camera_file = next((path for path in beside if is_there(path)), None)
        values: dict[str, Any] = {}
        if camera_file is not None:
            try:
                values = dict(parse_json(read_text(camera_file, _JSON, CalibrationError))["camera"])
            except (KeyError, TypeError, ValueError) as error:
                raise CalibrationError(f"describes no camera: {error}", path=camera_file, fix=_REPLICA_FIX) from error

        def known() -> Calibration:
            if camera_file is None:
                fix = f"copy {_CAMERA} of the data set here, or say which camera with --camera"
                raise CalibrationError(f"there is no {_CAMERA}, here or in the folder above", path=folder, fix=fix)
            try:
                width, height, fx, fy, cx, cy = (values[name] for name in ("w", "h", "fx", "fy", "cx", "cy"))
                camera = PinholeCamera(width, height, fx, fy, cx, cy)
                return Calibration.registered_camera(camera, source=_CAMERA)
            except KeyError as error:
                raise CalibrationError(f"camera has no {error}", path=camera_file, fix=_REPLICA_FIX) from error
            except CalibrationError as error:
                raise CalibrationError(error.problem, path=camera_file, fix=error.fix or _REPLICA_FIX) from error

        calibration = choose_calibration(folder, options, known)
        files = list((folder / "results").iterdir())
        color, depth = (numbered_files(files, pattern, rate_hz) for pattern in (_REPLICA_COLOR, _REPLICA_DEPTH))
        need_files(color, "colour image", folder / "results", self.needs)
        images = pair_images(color, depth, 0.0, folder / "results")
        factor = options.depth_factor or values.get("scale", _REPLICA_DEPTH_FACTOR)
        if isinstance(factor, bool) or not isinstance(factor, int | float) or not factor > 0:
            problem = f"scale is {factor!r}, not a positive number"
            raise CalibrationError(problem, path=camera_file, fix=_REPLICA_FIX)
        encoding = DepthEncoding(float(factor))
        truth = _replica_read_truth(folder / _REPLICA_TRUTH, rate_hz, warnings)
        return recording_of(folder, self.name, calibration, images, encoding, truth, warnings)


def _replica_read_truth(path: Path, rate_hz: float, warnings: list[str]) -> Trajectory | None:
    """T_frame_camera of the optical frame: sixteen numbers a line, one line for each frame from 0."""
    if not is_there(path):
        return None
    poses = []
    for number, line in enumerate(read_lines(path)):
        try:
            T = np.array([float(word) for word in line.text.split()], np.float64)
        except ValueError as error:
            problem = f"holds an invalid number: {error}"
            raise TrajectoryError(problem, path=path, line=line.number, fix=_POSE_FIX) from error
        if T.size != 16:
            problem = f"holds {T.size} numbers where the sixteen of a 4×4 matrix are expected"
            raise TrajectoryError(problem, path=path, line=line.number, fix=_POSE_FIX)
        poses.append(WrittenPose(number / rate_hz, T.reshape(4, 4), path, line.number))
    if not poses:
        raise RecordingError("holds no poses", path=path, fix="copy it again, or remove it")
    return true_poses(poses, warnings)
