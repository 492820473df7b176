"""Microsoft's 7-Scenes: frame-NNNNNN.color.png, .depth.png, .pose.txt (Shotton et al., CVPR 2013)."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

from wheelsight.calibration import Calibration
from wheelsight.errors import CalibrationError, RecordingError
from wheelsight.inputs import is_there
from wheelsight.recordings._cameras import choose_calibration, load_camera
from wheelsight.recordings._file_lists import ListedFile
from wheelsight.recordings._images import DepthEncoding
from wheelsight.recordings._numbered import WrittenPose, rate_of, read_matrix, true_poses
from wheelsight.recordings.image_recording import ImageRecording, complete, pair_images
from wheelsight.recordings.protocol import OpenOptions
from wheelsight.trajectory import Trajectory

_DEPTH = DepthEncoding(factor=1000.0, invalid=65535)
_FILE = re.compile(r"frame-(\d{6})\.(?:(color)\.(?:png|jpe?g)|(depth)\.png|(pose)\.txt)")


class SevenScenesReader:
    """Colour and depth that are not registered; depth in millimetres, 65535 where nothing was measured.

    The colour camera sits 25 mm beside the depth camera and shows things 0.90 times as large. At 2 m, colour lies about
    25 px right of depth at the image's left edge, 7 px left of it in the middle, and 40 px left at the right edge.
    """

    name = "seven_scenes"
    needs = "frame-NNNNNN.color.png or .jpg, and .depth.png"

    def recognises(self, folder: Path) -> bool:
        """Whether a file is called as the frames are."""
        return any(_FILE.fullmatch(path.name) for path in folder.glob("frame-*"))

    def open(self, folder: Path, options: OpenOptions) -> ImageRecording:
        """The recording in `folder`. Stamps are the frames' numbers at 30 Hz, or the rate given. Raises InputError."""
        warnings: list[str] = []
        rate_hz = rate_of(options, warnings)
        files = _list_files(folder, rate_hz)
        for kind in ("color", "depth"):
            if not files[kind]:
                raise RecordingError(f"holds no frame-NNNNNN.{kind} image", path=folder, fix=f"it needs {self.needs}")
        calibration = choose_calibration(folder, options, lambda: _calibration(folder))
        frames, association = pair_images(files["color"], files["depth"], 0.0, folder)
        if not calibration.is_registered:
            warnings.append(
                "Colour and depth images are not registered: things lie up to about 40 px apart in them. "
                f"They are joined by T_color_depth of: {calibration.source}."
            )
        return complete(
            ImageRecording(
                name=folder.resolve().name,
                path=folder,
                format=self.name,
                calibration=calibration,
                association=association,
                frames=frames,
                encoding=replace(_DEPTH, factor=options.depth_factor or _DEPTH.factor),
                ground_truth=_read_truth(files["pose"], warnings),
                warnings=tuple(warnings),
            )
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
        (fx, skew, cx), (_, fy, cy), bottom = read_matrix(path, 3)
        if skew != 0 or bottom.tolist() != [0, 0, 1]:
            raise CalibrationError("is not an intrinsic matrix fx 0 cx, 0 fy cy, 0 0 1")
        depth = replace(shipped.cameras[1], fx=float(fx), fy=float(fy), cx=float(cx), cy=float(cy))
    except (CalibrationError, RecordingError) as error:
        raise CalibrationError(error.problem, path=path, fix="correct or remove the file") from error
    return replace(shipped, depth=depth)


def _read_truth(poses: list[ListedFile], warnings: list[str]) -> Trajectory | None:
    """T_frame_camera of the depth camera; the files' rotations are 4e-4 off orthonormal."""
    truth = true_poses([WrittenPose(pose.stamp_s, read_matrix(pose.path, 4), pose.path) for pose in poses], warnings)
    if truth is not None:
        warnings.append("True poses come from the tracker of a Kinect, not from motion capture: good to about 2 cm.")
    return truth
