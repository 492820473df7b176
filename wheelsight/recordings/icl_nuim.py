"""ICL-NUIM, rendered rooms, as published for TUM's tools and as rendered (Handa et al., ICRA 2014)."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import numpy as np

from wheelsight.calibration import Calibration
from wheelsight.errors import RecordingError
from wheelsight.recordings._cameras import choose_calibration, load_camera
from wheelsight.recordings._file_lists import ListedFile
from wheelsight.recordings._images import DepthEncoding
from wheelsight.recordings._numbered import need_files, numbered_files, rate_of
from wheelsight.recordings.image_recording import ImageRecording, pair_images, recording_of
from wheelsight.recordings.protocol import Layout, OpenOptions
from wheelsight.recordings.tum import DEPTH_FACTOR
from wheelsight.trajectory import Trajectory, read_tum

_TRUTH = "*.gt.freiburg"
_FRAME = re.compile(r"(\d{1,9})\.png")
_COLOR = re.compile(r"scene_\d+_(\d{1,9})\.png")
_DISTANCES = re.compile(r"scene_\d+_(\d{1,9})\.depth")
_UP_DOWN = np.diag([1.0, -1.0, 1.0, 1.0])


class IclNuimReader:
    """Colour and registered depth: 16-bit PNG at 5000 units a metre, or text of distances along the pixels' rays."""

    name = "icl_nuim"
    layout = Layout.NUMBERED
    needs = "*.gt.freiburg, rgb/ and depth/, or scene_*.png and .depth"

    def recognises(self, folder: Path) -> bool:
        """Whether true poses called as theirs, or distances as rendered, are there."""
        return any(True for _ in folder.glob(_TRUTH)) or any(True for _ in folder.glob("scene_*.depth"))

    def open(self, folder: Path, options: OpenOptions) -> ImageRecording:
        """The recording in `folder`. Stamps are the frames' numbers at 30 Hz, or the rate given. Raises InputError."""
        warnings: list[str] = []
        rate_hz = rate_of(options, warnings)
        calibration = choose_calibration(folder, options, lambda: load_camera(self.name))
        color, depth = _list_files(folder, rate_hz)
        need_files(color, "colour image", folder, self.needs)
        need_files(depth, "depth image", folder, self.needs)
        images = pair_images(color, depth, 0.0, folder)
        return recording_of(
            folder,
            self.name,
            calibration,
            images,
            _encoding(depth, calibration, options),
            _read_truth(folder, rate_hz, warnings),
            warnings,
        )


def _list_files(folder: Path, rate_hz: float) -> tuple[list[ListedFile], list[ListedFile]]:
    """Colour and depth files, as published for TUM's tools, else as rendered."""
    published = [numbered_files((folder / name).glob("*.png"), _FRAME, rate_hz) for name in ("rgb", "depth")]
    if any(published):
        return published[0], published[1]
    rendered = list(folder.glob("scene_*"))
    return numbered_files(rendered, _COLOR, rate_hz), numbered_files(rendered, _DISTANCES, rate_hz)


def _encoding(depth: list[ListedFile], calibration: Calibration, options: OpenOptions) -> DepthEncoding:
    if depth[0].path.suffix != ".depth":
        return DepthEncoding(options.depth_factor or DEPTH_FACTOR)
    return DepthEncoding(options.depth_factor or 1.0, rays=calibration.cameras[1])


def _read_truth(folder: Path, rate_hz: float, warnings: list[str]) -> Trajectory | None:
    """T_frame_camera in the optical frame; the file's y axes, the camera's and the room's, point up.

    Raises TrajectoryError naming file and line, and RecordingError for several files.
    """
    found = sorted(folder.glob(_TRUTH))
    if len(found) > 1:
        problem = f"holds {len(found)} files of true poses: {', '.join(path.name for path in found)}"
        raise RecordingError(problem, path=folder, fix="leave the one that belongs to these images")
    if not found:
        warnings.append(f"There is no {_TRUTH}, so that nothing can be evaluated.")
        return None
    truth = read_tum(found[0], "camera", warnings.append)
    T = _UP_DOWN @ truth.T_frame_body @ _UP_DOWN
    return replace(truth, stamps_s=truth.stamps_s / rate_hz, T_frame_body=T)
