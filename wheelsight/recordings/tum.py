"""The TUM RGB-D benchmark's layout: rgb.txt, depth.txt, groundtruth.txt (Sturm et al., IROS 2012)."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

from wheelsight.calibration import Calibration
from wheelsight.errors import CalibrationError
from wheelsight.geometry import FloatArray
from wheelsight.inputs import is_there
from wheelsight.recordings._associations import read_associations
from wheelsight.recordings._cameras import camera_choices, choose_calibration, load_camera
from wheelsight.recordings._file_lists import read_file_list
from wheelsight.recordings._images import DepthEncoding
from wheelsight.recordings.image_recording import FramePaths, ImageRecording, PairedImages, pair_images, recording_of
from wheelsight.recordings.protocol import AssociationReport, Layout, OpenOptions
from wheelsight.trajectory import Trajectory, read_tum

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
