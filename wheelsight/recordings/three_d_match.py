"""3DMatch's RGB-D reconstructions: frames as in 7-Scenes, one camera for all sequences (Zeng et al., CVPR 2017)."""

from __future__ import annotations

from pathlib import Path

from wheelsight.calibration import Calibration
from wheelsight.errors import CalibrationError, RecordingError
from wheelsight.geometry import PinholeCamera
from wheelsight.inputs import is_there
from wheelsight.recordings._cameras import choose_calibration
from wheelsight.recordings._images import color_size
from wheelsight.recordings._numbered import intrinsic_numbers
from wheelsight.recordings.image_recording import FramePaths, ImageRecording
from wheelsight.recordings.protocol import Layout, OpenOptions
from wheelsight.recordings.seven_scenes import has_frames, open_frames

_INTRINSICS = "camera-intrinsics.txt"
_UNREGISTERED = "7-scenes"
_OF_TRUTH = "True poses are those of the reconstructions that 3DMatch took over, not motion capture."


class ThreeDMatchReader:
    """Colour and depth registered to it; depth in millimetres, 0 or 65535 where nothing was measured."""

    name = "three_d_match"
    layout = Layout.NUMBERED
    needs = "as seven_scenes, and camera-intrinsics.txt above"

    def recognises(self, folder: Path) -> bool:
        """Whether a camera lies above frames; those taken over from 7-Scenes are not registered, and left to that."""
        above = folder.resolve().parent
        is_alone = is_there(above / _INTRINSICS) and not is_there(folder / _INTRINSICS)
        return is_alone and not above.name.startswith(_UNREGISTERED) and has_frames(folder)

    def open(self, folder: Path, options: OpenOptions) -> ImageRecording:
        """The recording in `folder`. Stamps are the frames' numbers at 30 Hz, or the rate given. Raises InputError."""
        path = folder.resolve().parent / _INTRINSICS

        def calibration_of(frames: tuple[FramePaths, ...]) -> Calibration:
            return choose_calibration(folder, options, lambda: _calibration(path, frames))

        return open_frames(folder, options, self, _OF_TRUTH, calibration_of)


def _calibration(path: Path, frames: tuple[FramePaths, ...]) -> Calibration:
    width, height = color_size(frame.color for frame in frames)
    try:
        camera = PinholeCamera(width, height, *intrinsic_numbers(path))
        return Calibration.registered_camera(camera, source=f"{path.name} of {path.parent.name}")
    except (CalibrationError, RecordingError) as error:
        raise CalibrationError(error.problem, path=path, fix="correct it, or give --camera") from error
