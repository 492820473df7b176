"""ScanNet's .sens: one file of cameras, JPEG colour, compressed depth and poses (Dai et al., CVPR 2017)."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import partial
from itertools import pairwise
from pathlib import Path

import numpy as np

from wheelsight.calibration import Calibration
from wheelsight.errors import CalibrationError, RecordingError
from wheelsight.events import Event, RgbdFrame, SkippedFrame
from wheelsight.geometry import PinholeCamera, se3
from wheelsight.recordings._calibrated import corrected_depth
from wheelsight.recordings._cameras import choose_calibration
from wheelsight.recordings._images import DepthEncoding, decoded_color, depth_of_units
from wheelsight.recordings._numbered import WrittenPose, rate_of, true_poses
from wheelsight.recordings._read_ahead import read_ahead
from wheelsight.recordings._sens_file import SensFile, SensFrame, SensHeader, color_of, depth_units_of, read_sens
from wheelsight.recordings.bodies import express_for
from wheelsight.recordings.protocol import AssociationReport, Layout, ListedFrame, OpenOptions
from wheelsight.trajectory import Trajectory

_FRAMES_READ_AHEAD = 4
_MICROSECONDS = 1e6
_RIGID_TOLERANCE = 1e-2


class ScanNetReader:
    """A file of ScanNet's, or of another program that writes version 4 of its format."""

    name = "scannet"
    layout = Layout.FILE
    needs = "a .sens"

    def recognises(self, folder: Path) -> bool:
        """Whether it is a file of that name."""
        return folder.suffix.lower() == ".sens" and folder.is_file()

    def open(self, folder: Path, options: OpenOptions) -> ScanNetRecording:
        """The recording in a file. Raises InputError naming it."""
        sens = read_sens(folder)
        warnings = [sens.cut_off] if sens.cut_off else []
        stamps_s = _stamps_s(sens, options, warnings)
        calibration = choose_calibration(folder, options, lambda: _calibration(sens.header, folder))
        poses = [
            WrittenPose(stamp_s, frame.T_frame_camera, folder)
            for stamp_s, frame in zip(stamps_s, sens.frames, strict=True)
        ]
        truth = true_poses(poses, warnings)
        if truth is not None:
            warnings.append("True poses are ScanNet's own reconstruction by BundleFusion, not motion capture.")
        count = len(sens.frames)
        recording = ScanNetRecording(
            name=folder.stem,
            path=folder,
            calibration=calibration,
            association=AssociationReport(count, count, count, options.max_gap_s),
            header=sens.header,
            frames=sens.frames,
            stamps_s=tuple(stamps_s),
            encoding=DepthEncoding(options.depth_factor or sens.header.units_a_metre, invalid=65535),
            ground_truth=truth,
            warnings=tuple(warnings),
        )
        return recording.tried()


@dataclass(frozen=True, eq=False)
class ScanNetRecording:
    """A `Recording`. Frames are read from the file as they are asked for."""

    name: str
    path: Path
    calibration: Calibration
    association: AssociationReport
    header: SensHeader
    frames: tuple[SensFrame, ...]
    stamps_s: tuple[float, ...]
    encoding: DepthEncoding
    ground_truth: Trajectory | None = None
    warnings: tuple[str, ...] = ()
    format: str = ScanNetReader.name
    wheel_count: int = 0

    @property
    def body(self) -> str:
        """The frame a trajectory describes: "base" where the calibration says T_base_camera, else "camera"."""
        return "camera" if self.calibration.T_base_camera is None else "base"

    @property
    def frame_count(self) -> int:
        """How many frames `events()` will yield, skipped ones included."""
        return len(self.frames)

    def events(self, *, images: bool = True) -> Iterator[Event]:
        """Frames in order of time, from the start at each call; none without `images`. Decoded a few ahead."""
        listed = self.listed() if images else iter(())
        return read_ahead((event.read() for event in listed), _FRAMES_READ_AHEAD)

    def listed(self) -> Iterator[ListedFrame]:
        """Frames that are still to be decoded."""
        for index, (stamp_s, next_stamp_s) in enumerate(pairwise((*self.stamps_s, math.inf))):
            yield ListedFrame(stamp_s, next_stamp_s, partial(self._frame_or_reason, index))

    def read_frame(self, index: int) -> RgbdFrame:
        """The frame at `index`. Raises RecordingError naming the file and what makes it unusable."""
        frame = self.frames[index]
        color = decoded_color(color_of(self.path, frame), self.path)
        units = depth_units_of(self.path, frame, self.header)
        depth_m = depth_of_units(units, self.encoding, self.path)
        depth_m = corrected_depth(color, depth_m, self.calibration, (self.path, self.path))
        return RgbdFrame(self.stamps_s[index], color, depth_m, index)

    def _frame_or_reason(self, index: int) -> RgbdFrame | SkippedFrame:
        try:
            return self.read_frame(index)
        except RecordingError as error:
            return SkippedFrame(self.stamps_s[index], error.problem, index)

    def tried(self) -> ScanNetRecording:
        """Itself, with truth of its body. Raises RecordingError where neither first nor middle frame can be used."""
        middle = self._frame_or_reason(len(self.frames) // 2)
        if isinstance(middle, SkippedFrame):
            self.read_frame(0)
        if self.ground_truth is None:
            return self
        return replace(self, ground_truth=express_for(self.body, self.ground_truth, self.calibration))


def _stamps_s(sens: SensFile, options: OpenOptions, warnings: list[str]) -> list[float]:
    """Of colour, in microseconds in the file; where they do not grow, as in files that have none, by a rate."""
    stamps = np.array([frame.color_stamp for frame in sens.frames], np.float64)
    if options.rate_hz is None and (np.diff(stamps) > 0).all() and stamps[-1] > 0:
        return [float(stamp_s) for stamp_s in stamps / _MICROSECONDS]
    rate_hz = rate_of(options, warnings)
    return [number / rate_hz for number in range(len(stamps))]


def _calibration(header: SensHeader, path: Path) -> Calibration:
    """Two cameras of their own sizes at nearly one place: the extrinsic of depth leads to colour's."""
    try:
        color, depth = (
            PinholeCamera(*size, float(K[0, 0]), float(K[1, 1]), float(K[0, 2]), float(K[1, 2]))
            for size, K in ((header.color_size, header.K_color), (header.depth_size, header.K_depth))
        )
        for T in (header.T_base_color, header.T_base_depth):
            if not se3.is_valid(T, _RIGID_TOLERANCE):
                raise CalibrationError("an extrinsic matrix is no rigid motion")
        T_color_depth = se3.nearest(np.linalg.inv(header.T_base_color) @ header.T_base_depth)
        return Calibration(color, depth, T_color_depth, source=f"{path.name}, {header.sensor}")
    except CalibrationError as error:
        fix = error.fix or "give a calibration.yaml with --camera"
        raise CalibrationError(f"its header: {error.problem}", path=path, fix=fix) from error
