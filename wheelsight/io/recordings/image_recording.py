"""`ImageRecording`, a recording of image files. Readers of all folder formats make one from their lists."""

from __future__ import annotations

import heapq
import math
from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import partial
from itertools import pairwise
from pathlib import Path
from typing import NamedTuple, TypeVar

import numpy as np

from wheelsight.core.calibration import Calibration
from wheelsight.core.errors import CalibrationError, RecordingError
from wheelsight.core.messages import Event, RgbdFrame, WheelReading, YawRate
from wheelsight.core.stamps import associate, unit_of
from wheelsight.core.trajectory import Trajectory
from wheelsight.io.recordings.clock_checks import MOST_COMPARED_S, MotionClock, MotionOffset
from wheelsight.io.recordings.images import (
    DepthEncoding,
    corrected_depth,
    image_size,
    read_ahead,
    read_color,
    read_depth,
)
from wheelsight.io.recordings.recording import AssociationReport, ListedFrame, express_for, frame_or_reason
from wheelsight.io.recordings.tables import ListedFile

_Reading = TypeVar("_Reading", bound=WheelReading | YawRate)
# Least offset of clocks that is removed, s, and its multiple of σ. Of 35 simulated drives whose clocks agree, one
# showed 0.06 s (σ 0.012 s). Least correlation of the turns at that offset, and least ratio of what no offset leaves
# unexplained to what it leaves: people who pass showed 0.28 s in one drive, at 0.89 and 2.2.
_LEAST_REMOVED_S, _SURE_SIGMAS, _SURE_AGREEMENT, _SURE_RATIO = 0.1, 5.0, 0.95, 4.0
_BY_TURNS = "By the turns that camera and "
_FRAMES_READ_AHEAD = 4
_FRAMES_TRIED = 8


@dataclass(frozen=True, slots=True)
class FramePaths:
    """The two image files of a frame, the time of the colour image, and by how much depth was later."""

    stamp_s: float
    color: Path
    depth: Path
    depth_late_s: float = 0.0


@dataclass(frozen=True, eq=False)
class ImageRecording:
    """A `Recording` of image files.

    Attributes in addition to the protocol's:
        frames: the image files of each frame, in order of time.
        encoding: of the depth images.
        wheels: readings of the wheel encoders, in order of time.
        yaw_rates: readings of a gyroscope, in order of time.
        shifts_s: by how much the stamps of wheels and gyroscope are moved to the camera's clock; see `on_one_clock`.
    """

    name: str
    path: Path
    format: str
    calibration: Calibration
    association: AssociationReport
    frames: tuple[FramePaths, ...]
    encoding: DepthEncoding
    ground_truth: Trajectory | None = None
    warnings: tuple[str, ...] = ()
    wheels: tuple[WheelReading, ...] = ()
    yaw_rates: tuple[YawRate, ...] = ()
    shifts_s: tuple[float, float] = (0.0, 0.0)

    @property
    def body(self) -> str:
        """The frame the ground truth describes: "base" where the calibration has one, else "camera"."""
        return "camera" if self.calibration.T_base_camera is None else "base"

    @property
    def frame_count(self) -> int:
        """The number of frames that `events()` yields, skipped ones included."""
        return len(self.frames)

    @property
    def wheel_count(self) -> int:
        """The number of wheel readings that `events()` yields."""
        return len(self.wheels)

    def events(self, *, images: bool = True) -> Iterator[Event]:
        """Frames (unless without `images`) and readings in order of time, from the start at each call.

        Images are decoded a few frames ahead.
        """
        listed = (event for event in self.listed() if images or not isinstance(event, ListedFrame))
        events = (event.read() if isinstance(event, ListedFrame) else event for event in listed)
        return read_ahead(events, _FRAMES_READ_AHEAD)

    def listed(self) -> Iterator[Event | ListedFrame]:
        """Undecoded frames and readings, in order of time."""
        stamps_s = [*(frame.stamp_s for frame in self.frames), math.inf]
        frames = (
            ListedFrame(
                stamp_s, next_stamp_s, partial(frame_or_reason, partial(self.read_frame, index), stamp_s, index)
            )
            for index, (stamp_s, next_stamp_s) in enumerate(pairwise(stamps_s))
        )
        return heapq.merge(self.yaw_rates, self.wheels, frames, key=lambda item: item.stamp_s)

    def read_frame(self, index: int) -> RgbdFrame:
        """The frame at `index`. Raises RecordingError naming the file and what makes it unusable."""
        files = self.frames[index]
        error = self.calibration.depth_error
        encoding = replace(self.encoding, disparity=error) if error.is_of_disparity else self.encoding
        color, depth_m = read_color(files.color), read_depth(files.depth, encoding)
        registered = self.calibration.is_registered
        if registered and color.shape[:2] != depth_m.shape:
            problem = f"depth image is {image_size(depth_m)}, its colour image {image_size(color)}"
            raise RecordingError(problem, path=files.depth, fix="register depth to colour, or give T_color_depth")
        depth_m = corrected_depth(color, depth_m, self.calibration, (files.color, files.depth))
        return RgbdFrame(files.stamp_s, color, depth_m, index, files.depth_late_s)

    def moved(self, wheels_s: float, gyro_s: float) -> ImageRecording:
        """Return the recording with later stamps: of the wheels by `wheels_s`, of the gyroscope by `gyro_s` seconds."""
        shifts_s = self.shifts_s[0] + wheels_s, self.shifts_s[1] + gyro_s
        wheels, yaw_rates = _later(self.wheels, wheels_s), _later(self.yaw_rates, gyro_s)
        return replace(self, wheels=wheels, yaw_rates=yaw_rates, shifts_s=shifts_s)

    def as_stamped(self) -> ImageRecording:
        """See `HasClocksOfItsOwn`."""
        wheels_s, gyro_s = self.shifts_s
        warnings = tuple(warning for warning in self.warnings if not warning.startswith(_BY_TURNS))
        return replace(self.moved(-wheels_s, -gyro_s), warnings=warnings)


def _later(readings: tuple[_Reading, ...], by_s: float) -> tuple[_Reading, ...]:
    return tuple(replace(one, stamp_s=one.stamp_s + by_s) for one in readings) if by_s else readings


def on_one_clock(recording: ImageRecording, *, is_gyro_beside_wheels: bool) -> ImageRecording:
    """The recording with stamps of wheels and gyroscope on the camera's clock, with a warning if they were on another.

    The turns at its beginning that both show give the offset (`MotionClock`), as in bags. Without a claim all stamps
    stay.

    Args:
        is_gyro_beside_wheels: whether one computer reads both, so that an offset of the wheels is the gyroscope's too.
    """
    calibration = recording.calibration
    if not recording.wheels or calibration.T_base_camera is None or calibration.any_wheels is None:
        return recording
    begin_s = min(recording.wheels[0].stamp_s, recording.frames[0].stamp_s)
    first = [one for one in recording.wheels if one.stamp_s - begin_s <= MOST_COMPARED_S]
    probe, turns = MotionClock(calibration), MotionClock(calibration)
    for reading in first:
        probe.add(reading)
    if not probe.may_show:  # no image is worth decoding
        return recording
    for item in heapq.merge(recording.yaw_rates, first, recording.frames, key=lambda item: item.stamp_s):
        if not isinstance(item, FramePaths):
            turns.add(item)
        elif turns.needs_image(item.stamp_s):
            with suppress(RecordingError):  # the pass over all frames reports damaged images
                turns.add_image(item.stamp_s, read_color(item.color))
        if turns.is_enough(item.stamp_s - begin_s):
            break
    wheels, gyro = turns.offset(), turns.offset("gyroscope")
    if gyro.offset_s is None and is_gyro_beside_wheels:
        gyro = wheels
    moved = recording.moved(*(sure_offset_s(offset) for offset in (wheels, gyro)))
    if moved.shifts_s == (0.0, 0.0):
        return recording
    delay_s = calibration.any_wheels.delay_s - moved.shifts_s[0]
    found = [("wheels", wheels, f" (delay_s: {delay_s:.3f} of the calibration's wheels states it)")]
    found += [("gyroscope", gyro, "")] if recording.yaw_rates else []
    warnings = [
        f"{_BY_TURNS}{what} show, the camera's stamps are {offset}: the clocks are apart. "
        f"The difference is removed{how}."
        for what, offset, how in found
        if sure_offset_s(offset)
    ]
    return replace(moved, warnings=(*recording.warnings, *warnings))


def sure_offset_s(offset: MotionOffset) -> float:
    """The offset, or 0 if it is unknown or may be latency: one computer stamps most recordings."""
    found_s, left = offset.offset_s or 0.0, 1 - offset.agreement**2
    is_large = abs(found_s) > max(_LEAST_REMOVED_S, _SURE_SIGMAS * offset.sigma_s)
    is_clear = offset.agreement > _SURE_AGREEMENT and 1 - offset.as_stamped**2 > _SURE_RATIO * left
    return found_s if is_large and is_clear else 0.0


class PairedImages(NamedTuple):
    """The frames of a folder, and the report of their pairing."""

    frames: tuple[FramePaths, ...]
    association: AssociationReport


def recording_of(
    folder: Path,
    reader: str,
    calibration: Calibration,
    images: PairedImages,
    encoding: DepthEncoding,
    truth: Trajectory | None,
    warnings: Sequence[str],
) -> ImageRecording:
    """The recording of a folder, with ground truth of its own body. Decodes a frame as a check.

    Args:
        folder: of the recording, which has the folder's name.
        calibration, encoding: as in `ImageRecording`.
        truth: T_frame_body of camera or base, or None.

    Raises:
        RecordingError: none of several frames spread over the recording is valid; the error of the first.
        CalibrationError: the ground truth describes the other body, and the calibration has no T_base_camera.
    """
    made = ImageRecording(
        name=folder.resolve().name,
        path=folder,
        format=reader,
        calibration=calibration,
        association=images.association,
        frames=images.frames,
        encoding=encoding,
        ground_truth=truth,
        warnings=tuple(warnings),
    )
    # Decode frames spread over the recording until one is valid; if none is, raise the first one's error.
    first: RecordingError | None = None
    for index in dict.fromkeys(np.linspace(0, len(made.frames) - 1, _FRAMES_TRIED).astype(int).tolist()):
        try:
            made.read_frame(index)
            break
        except RecordingError as error:
            first = first or error
    else:
        if first is not None:
            raise first
    if truth is None:
        return made
    try:
        truth = express_for(made.body, truth, calibration)
    except CalibrationError as error:
        raise CalibrationError(f"ground truth: {error.problem}", path=folder, fix=error.fix) from error
    start_s, end_s, count = truth.stamps_s[0], truth.stamps_s[-1], len(made.frames)
    covered = sum(bool(start_s <= frame.stamp_s <= end_s) for frame in made.frames)
    if covered + (0 if count < 3 else 2) < count:
        warnings = [*warnings, f"The ground truth covers {covered} of {count} frames; only these can be evaluated."]
    return replace(made, ground_truth=truth, warnings=tuple(warnings))


def pair_images(
    color: Sequence[ListedFile], depth: Sequence[ListedFile], max_gap_s: float, color_list: Path
) -> PairedImages:
    """Frames of the colour and depth images that are nearest in time, at most `max_gap_s` apart.

    Raises RecordingError where there is no pair; names `color_list` and the smallest gap.
    """
    color_s, depth_s = (np.array([file.stamp_s for file in files], float) for files in (color, depth))
    pairs = associate(color_s, depth_s, max_gap_s)
    if not len(pairs):
        after = np.searchsorted(depth_s, color_s)
        beside = (depth_s[(after - 1).clip(0)], depth_s[after.clip(max=len(depth_s) - 1)])
        nearest_s = min(float(np.abs(color_s - other).min()) for other in beside)
        problem = f"no depth image lies within {max_gap_s:g} s of a colour image; the nearest pair is {nearest_s:.6g} s"
        unit = unit_of(color_s)
        fix = "check that both lists use one clock, or raise --max-gap"
        if unit is not None and unit.per_second is not None:
            fix = f"stamps look like {unit.name}: --rate-hz {unit.per_second:.0f}"
        raise RecordingError(f"{problem} apart", path=color_list, fix=fix)
    late_s = depth_s[pairs[:, 1]] - color_s[pairs[:, 0]]
    frames = tuple(
        FramePaths(color[i].stamp_s, color[i].path, depth[j].path, late)
        for (i, j), late in zip(pairs.tolist(), late_s.tolist(), strict=True)
    )
    largest_s = float(np.abs(color_s[pairs[:, 0]] - depth_s[pairs[:, 1]]).max())
    return PairedImages(frames, AssociationReport(len(color), len(depth), len(frames), max_gap_s, largest_s))
