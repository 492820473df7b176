"""What is in a recording, and what a user should know before trusting results made from it."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from dataclasses import asdict, dataclass, field
from typing import Any

import cv2
import numpy as np

from wheelsight.calibration import Calibration
from wheelsight.evaluation import SequenceStatistics, sequence_statistics
from wheelsight.events import Event, RgbdFrame, SkippedFrame, WheelSpeeds, WheelTicks, YawRate
from wheelsight.geometry import ByteArray, Float32Array, FloatArray
from wheelsight.recordings.protocol import AssociationReport, Recording

_GAP_PERIODS = 3.0
_DEPTH_STRIDE = 4
_PLAUSIBLE_SHARE = 0.5
_OFFSET_FRAMES = 16
_DEPTH_EDGES_M = np.geomspace(1e-3, 1e3, 6001)


@dataclass(frozen=True, slots=True)
class Gap:
    """A stretch without frames: after `start_s`, for `length_s` seconds."""

    start_s: float
    length_s: float


@dataclass(frozen=True, slots=True)
class Inspection:
    """A recording in figures.

    Attributes:
        name: the recording's.
        format: its reader's name.
        body: the frame its trajectory describes.
        camera: colour camera: image size, focal lengths, where the numbers come from; None without one.
        wheels: radii, track width, where the numbers come from; None where the calibration has no wheels.
        is_registered: whether, by its calibration, depth and colour share one pixel grid; None without cameras.
        frames: how many are listed.
        skipped: (why, how many) of those that cannot be used.
        wheel_readings: how many there are of the wheels.
        yaw_readings: how many there are of a gyroscope.
        duration_s: from the first frame to the last, or where there are none of the wheel readings.
        rate_hz: of the same, at their median period; NaN with fewer than two.
        gaps: stretches without one of these longer than three periods.
        valid_depth_share: share of depth pixels that measured something; NaN without a usable frame.
        depth_m: depth in metres at the 5th, 50th and 95th percentile; NaN where nothing was measured.
        offset: how far colour lies from depth, as seen in the images; None where too little is seen to say.
        association: how colour and depth were paired.
        ground_truth: Zhang's Table 2 statistics of it, or None.
        warnings: one sentence each.
    """

    name: str
    format: str
    body: str
    camera: str | None
    wheels: str | None
    is_registered: bool | None
    frames: int
    skipped: tuple[tuple[str, int], ...]
    wheel_readings: int
    yaw_readings: int
    duration_s: float
    rate_hz: float
    gaps: tuple[Gap, ...]
    valid_depth_share: float
    depth_m: dict[str, float]
    offset: RegistrationOffset | None
    association: AssociationReport
    ground_truth: SequenceStatistics | None
    warnings: tuple[str, ...]

    def to_dict(self) -> dict[str, Any]:
        """All of it as plain nested values; may hold NaN."""
        return asdict(self)


def inspect_recording(recording: Recording, on_event: Callable[[], None] | None = None) -> Inspection:
    """Read a whole recording once, every image of it, and say what is in it.

    `on_event` is called after each frame, or where there are none each wheel reading, for a progress bar.
    Raises RecordingError when it cannot be read on.
    """
    tally = _Tally(recording)
    for event in recording.events():
        tally.add(event)
        if on_event is not None and isinstance(event, tally.counted):
            on_event()
    stamps_s = np.array(tally.stamps_s, float)
    period_s = float(np.median(np.diff(stamps_s))) if len(stamps_s) > 1 else float("nan")
    truth, calibration = recording.ground_truth, recording.calibration
    offset = tally.offset_meter.offset()
    return Inspection(
        name=recording.name,
        format=recording.format,
        body=recording.body,
        camera=_camera(calibration),
        wheels=_wheels(calibration),
        is_registered=None if calibration.color is None else calibration.is_registered,
        frames=recording.frame_count,
        skipped=tuple(tally.skipped.most_common()),
        wheel_readings=tally.wheel_readings,
        yaw_readings=tally.yaw_readings,
        duration_s=float(np.ptp(stamps_s)) if len(stamps_s) else 0.0,
        rate_hz=1 / period_s if period_s > 0 else float("nan"),
        gaps=_gaps(stamps_s, period_s),
        valid_depth_share=tally.valid_share,
        depth_m=tally.depth_percentiles_m(),
        offset=offset,
        association=recording.association,
        ground_truth=sequence_statistics(truth) if truth is not None and len(truth) > 1 else None,
        warnings=(*recording.warnings, *_depth_warnings(tally, recording), *_offset_warnings(offset, recording)),
    )


def _camera(calibration: Calibration) -> str | None:
    camera = calibration.color
    if camera is None:
        return None
    return f"{camera.width} × {camera.height}, f {camera.fx:g}, {camera.fy:g} px ({calibration.source})"


def _wheels(calibration: Calibration) -> str | None:
    wheels = calibration.wheels
    if wheels is None:
        return None
    sizes = f"radius {wheels.left_radius_m:.5g} m left, {wheels.right_radius_m:.5g} m right"
    return f"{sizes}, track {wheels.track_width_m:.5g} m, {wheels.ticks_per_turn:g} ticks a turn ({calibration.source})"


@dataclass
class _Tally:
    """Counts over the events of a recording, in little memory however long it is."""

    recording: Recording
    stamps_s: list[float] = field(default_factory=list)
    skipped: Counter[str] = field(default_factory=Counter)
    wheel_readings: int = 0
    yaw_readings: int = 0
    pixels: int = 0
    histogram: FloatArray = field(default_factory=lambda: np.zeros(len(_DEPTH_EDGES_M) - 1))
    offset_meter: _OffsetMeter = field(default_factory=lambda: _OffsetMeter())

    @property
    def counted(self) -> tuple[type, ...]:
        """The events whose times are told of: frames, or where there are none the wheels' readings."""
        return (RgbdFrame, SkippedFrame) if self.recording.frame_count else (WheelTicks, WheelSpeeds)

    def add(self, event: Event) -> None:
        if isinstance(event, self.counted):
            self.stamps_s.append(event.stamp_s)
        self.wheel_readings += isinstance(event, WheelTicks | WheelSpeeds)
        self.yaw_readings += isinstance(event, YawRate)
        if isinstance(event, SkippedFrame):
            self.skipped[event.reason] += 1
        if isinstance(event, RgbdFrame):
            self._add_frame(event)

    def _add_frame(self, event: RgbdFrame) -> None:
        self._add_depth(event.depth_m[::_DEPTH_STRIDE, ::_DEPTH_STRIDE])
        every = max(1, self.recording.frame_count // _OFFSET_FRAMES)
        if event.index % every == every // 2 and event.color.shape[:2] == event.depth_m.shape:
            self.offset_meter.add(event.color, event.depth_m)

    def _add_depth(self, depth_m: Float32Array) -> None:
        self.pixels += depth_m.size
        self.histogram += np.histogram(depth_m[depth_m > 0], _DEPTH_EDGES_M)[0]

    @property
    def valid_share(self) -> float:
        return float(self.histogram.sum() / self.pixels) if self.pixels else float("nan")

    def depth_percentiles_m(self) -> dict[str, float]:
        """Depth at three percentiles, to a quarter of a percent."""
        total = self.histogram.cumsum()
        places = {name: np.searchsorted(total, share * total[-1]) for name, share in _PERCENTILES.items()}
        return {name: float(_DEPTH_EDGES_M[place]) if total[-1] else float("nan") for name, place in places.items()}

    def share_between(self, near_m: float, far_m: float) -> float:
        inside = (_DEPTH_EDGES_M[:-1] >= near_m) & (_DEPTH_EDGES_M[:-1] <= far_m)
        return float(self.histogram[inside].sum() / max(self.histogram.sum(), 1))


_PERCENTILES = {"p5": 0.05, "median": 0.5, "p95": 0.95}


def _gaps(stamps_s: FloatArray, period_s: float) -> tuple[Gap, ...]:
    steps_s = np.diff(stamps_s)
    long = np.flatnonzero(steps_s > _GAP_PERIODS * period_s)
    return tuple(Gap(float(stamps_s[i]), float(steps_s[i])) for i in long)


def _depth_warnings(tally: _Tally, recording: Recording) -> list[str]:
    noise = recording.calibration.depth_noise
    if not tally.histogram.any():
        return ["No depth pixel measured anything."] if tally.pixels else []
    if tally.share_between(noise.near_m, noise.far_m) >= _PLAUSIBLE_SHARE:
        return []
    median_m = tally.depth_percentiles_m()["median"]
    return [
        f"Most depth lies outside the {noise.near_m:g} to {noise.far_m:g} m the sensor is trusted in "
        f"(median {median_m:.3g} m): is the depth scale right? See --depth-factor."
    ]


def _offset_warnings(offset: RegistrationOffset | None, recording: Recording) -> list[str]:
    if offset is None or not offset.is_clear or not recording.calibration.is_registered:
        return []
    return [
        f"Colour and depth are not registered, though the calibration says so: {offset}. "
        f"Give a calibration with T_color_depth."
    ]


# How far colour and depth are searched for each other, in pixels of images of about this width.
_SEARCH_WIDTH = 320
_SEARCH_PX = (20, 8)
_SEARCH_SCALES = np.round(np.arange(0.84, 1.161, 0.02), 2)
_WIDEST_SHADOW_PX = 30
_DEPTH_STEP = 0.08


@dataclass(frozen=True, slots=True)
class RegistrationOffset:
    """Where the colour image shows what the depth image shows, as their edges tell.

    Attributes:
        shift_px: (right, down) that the colour image's things lie from the depth image's in the image's middle.
        scale: how many times as large they are.
        strength: mean contrast of colour edges at depth edges moved by shift and scale (all contrast: 1, by chance: 0).
        strength_as_is: the same where depth edges lie.
    """

    shift_px: tuple[float, float]
    scale: float
    strength: float
    strength_as_is: float

    @property
    def is_clear(self) -> bool:
        """Whether the images fit clearly better when moved."""
        return self.strength > 1.5 * max(self.strength_as_is, 0.0)

    def __str__(self) -> str:
        """In words, for a user."""
        right, down = self.shift_px
        across = f"{abs(right):.0f} px {'left' if right < 0 else 'right'}"
        along = f"{abs(down):.0f} px {'up' if down < 0 else 'down'}"
        size = f"shows things {self.scale:.2f} times as large"
        return f"in the middle of the image colour lies {across} and {along} of depth, and {size}"


class _OffsetMeter:
    """Sums, over frames, how well depth edges fall on colour edges for each scale and shift (cross-correlation)."""

    def __init__(self) -> None:
        self._fit: FloatArray = np.zeros((len(_SEARCH_SCALES), 2 * _SEARCH_PX[1] + 1, 2 * _SEARCH_PX[0] + 1))
        self._edges = 0.0
        self._reduction = 1

    def add(self, color: ByteArray, depth_m: Float32Array) -> None:
        """Count in one frame; both images (H, W)."""
        height, width = depth_m.shape
        self._reduction = max(1, round(width / _SEARCH_WIDTH))
        size = (width // self._reduction, height // self._reduction)
        right, down = _SEARCH_PX
        if size[0] <= 2 * right or size[1] <= 2 * down:
            return  # smaller than the shifts that are tried
        for contrast, border in zip(_color_contrast(color), _depth_borders(depth_m), strict=True):
            spectrum = np.fft.rfft2(cv2.resize(contrast, size, interpolation=cv2.INTER_AREA))
            for index, scale in enumerate(_SEARCH_SCALES):
                about = cv2.getRotationMatrix2D(((width - 1) / 2, (height - 1) / 2), 0.0, float(scale))
                moved = cv2.resize(cv2.warpAffine(border, about, (width, height)), size, interpolation=cv2.INTER_AREA)
                fit = np.fft.irfft2(spectrum * np.conj(np.fft.rfft2(moved)), s=size[::-1])
                self._fit[index] += np.roll(fit, (down, right), (0, 1))[: 2 * down + 1, : 2 * right + 1]
            self._edges += float(border.sum()) / self._reduction**2

    def offset(self) -> RegistrationOffset | None:
        """The best fit, or None where none stands out."""
        if not self._edges or self._fit.max() < 5 * self._fit.std():
            return None
        scale, down, right = np.unravel_index(self._fit.argmax(), self._fit.shape)
        as_is = self._fit[len(_SEARCH_SCALES) // 2, _SEARCH_PX[1], _SEARCH_PX[0]]
        shift = self._reduction * (np.array([right, down]) - _SEARCH_PX)
        strengths = (float(fit) / self._edges for fit in (self._fit.max(), as_is))
        return RegistrationOffset((float(shift[0]), float(shift[1])), float(_SEARCH_SCALES[scale]), *strengths)


def _color_contrast(color: ByteArray) -> list[Float32Array]:
    """Brightness steps along x and along y (H, W): 1 on average, then less their neighbourhood's mean."""
    grey = cv2.GaussianBlur(cv2.cvtColor(color, cv2.COLOR_RGB2GRAY).astype(np.float32), (0, 0), 1.5)
    images = []
    for along_x in (1, 0):
        step = np.abs(cv2.Sobel(grey, cv2.CV_32F, along_x, 1 - along_x))
        step = np.minimum(step, np.percentile(step, 95))
        step /= max(float(step.mean()), 1e-6)
        images.append(step - cv2.blur(step, (81, 81)))
    return images


def _depth_borders(depth_m: Float32Array) -> list[Float32Array]:
    """1 at the near side of depth steps along x and along y (H, W), else 0; the shadow beside it is crossed."""
    return [_borders_along_rows(depth_m), np.ascontiguousarray(_borders_along_rows(depth_m.T).T)]


def _borders_along_rows(depth_m: Float32Array) -> Float32Array:
    columns = np.arange(depth_m.shape[1])
    newest = np.maximum.accumulate(np.where(depth_m > 0, columns, -1), axis=1)
    before = np.pad(newest, ((0, 0), (1, 0)), constant_values=-1)[:, :-1]
    rows, here = np.nonzero((depth_m > 0) & (before >= 0) & (columns - before <= _WIDEST_SHADOW_PX))
    there = before[rows, here]
    step = np.log(depth_m[rows, here] / depth_m[rows, there])
    borders = np.zeros(depth_m.shape, np.float32)
    for is_step, column in ((step > _DEPTH_STEP, there), (step < -_DEPTH_STEP, here)):
        borders[rows[is_step], column[is_step]] = 1
    return borders
