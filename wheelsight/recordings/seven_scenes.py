"""Microsoft's 7-Scenes: frame-NNNNNN.color.png, .depth.png, .pose.txt (Shotton et al., CVPR 2013)."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

from wheelsight.calibration import Calibration
from wheelsight.errors import CalibrationError, RecordingError
from wheelsight.inputs import is_there
from wheelsight.recordings._cameras import choose_calibration, load_camera
from wheelsight.recordings._file_lists import ListedFile
from wheelsight.recordings._images import DepthEncoding
from wheelsight.recordings._numbered import WrittenPose, intrinsic_numbers, need_files, rate_of, read_matrix, true_poses
from wheelsight.recordings.image_recording import FramePaths, ImageRecording, pair_images, recording_of
from wheelsight.recordings.protocol import Layout, OpenOptions, Reader
from wheelsight.trajectory import Trajectory

_DEPTH = DepthEncoding(factor=1000.0, invalid=65535)
_FILE = re.compile(r"frame-(\d{6})\.(?:(color)\.(?:png|jpe?g)|(depth)\.png|(pose)\.txt)")

_OF_TRUTH = "True poses come from the tracker of a Kinect, not from motion capture: good to about 2 cm."


class SevenScenesReader:
    """Colour and depth that are not registered; depth in millimetres, 65535 where nothing was measured.

    The colour camera sits 25 mm beside the depth camera and shows things 0.90 times as large. At 2 m, colour lies about
    25 px right of depth at the image's left edge, 7 px left of it in the middle, and 40 px left at the right edge.
    """

    name = "seven_scenes"
    layout = Layout.NUMBERED
    needs = "frame-NNNNNN.color.png or .jpg, and .depth.png"

    def recognises(self, folder: Path) -> bool:
        """Whether a file is called as the frames are."""
        return has_frames(folder)

    def open(self, folder: Path, options: OpenOptions) -> ImageRecording:
        """The recording in `folder`. Stamps are the frames' numbers at 30 Hz, or the rate given. Raises InputError."""
        calibration = choose_calibration(folder, options, lambda: _calibration(folder))
        return open_frames(folder, options, self, _OF_TRUTH, lambda _: calibration)


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
    """The recording of the frames in `folder`, as `reader`'s; `of_truth` says what its poses are. Raises InputError."""
    warnings: list[str] = []
    files = _list_files(folder, rate_of(options, warnings))
    for kind in ("color", "depth"):
        need_files(files[kind], f"frame-NNNNNN.{kind} image", folder, reader.needs)
    images = pair_images(files["color"], files["depth"], 0.0, folder)
    calibration = calibration_of(images.frames)
    if not calibration.is_registered:
        warnings.append(
            "Colour and depth images are not registered: things lie up to about 40 px apart in them. "
            f"They are joined by T_color_depth of: {calibration.source}."
        )
    return recording_of(
        folder,
        reader.name,
        calibration,
        images,
        replace(_DEPTH, factor=options.depth_factor or _DEPTH.factor),
        _read_truth(files["pose"], of_truth, warnings),
        warnings,
    )


def _list_files(folder: Path, rate_hz: float) -> dict[str, list[ListedFile]]:
    """Colour, depth and pose files in order of their numbers."""
    found: dict[str, dict[int, Path]] = {"color": {}, "depth": {}, "pose": {}}
    for path in sorted(folder.glob("frame-*")):
        if match := _FILE.fullmatch(path.name):
            found[match[2] or match[3] or match[4]][int(match[1])] = path
    return {
        kind: [ListedFile(number / rate_hz, paths[number]) for number in sorted(paths)] for kind, paths in found.items()
    }


def _calibration(folder: Path) -> Calibration:
    """The shipped calibration, its depth camera replaced by camera-intrinsics.txt where that is there."""
    shipped = load_camera("seven_scenes")
    path = folder / "camera-intrinsics.txt"
    if not is_there(path):
        return shipped
    try:
        fx, fy, cx, cy = intrinsic_numbers(path)
        depth = replace(shipped.cameras[1], fx=fx, fy=fy, cx=cx, cy=cy)
    except (CalibrationError, RecordingError) as error:
        raise CalibrationError(error.problem, path=path, fix="correct or remove the file") from error
    return replace(shipped, depth=depth)


def _read_truth(poses: list[ListedFile], of_truth: str, warnings: list[str]) -> Trajectory | None:
    """T_frame_camera of the depth camera; the files' rotations are 4e-4 off orthonormal."""
    truth = true_poses([WrittenPose(pose.stamp_s, read_matrix(pose.path, 4), pose.path) for pose in poses], warnings)
    if truth is not None:
        warnings.append(of_truth)
    return truth
