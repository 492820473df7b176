"""The Bonn RGB-D Dynamic dataset: TUM's layout, true poses of markers (Palazzolo et al., IROS 2019)."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from wheelsight.geometry import se3
from wheelsight.inputs import is_there
from wheelsight.recordings._cameras import choose_calibration, load_camera
from wheelsight.recordings.image_recording import ImageRecording
from wheelsight.recordings.protocol import Layout, OpenOptions
from wheelsight.recordings.tum import open_lists, read_truth
from wheelsight.trajectory import Trajectory

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
