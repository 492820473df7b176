"""`inspect_recording` returns the contents of a recording and warnings about it: gaps, repeated frames, depth range,
and the offset between colour and depth edges.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, field, replace
from typing import Any

import cv2
import numpy as np

from wheelsight.core.calibration import Calibration
from wheelsight.core.checks import Repeats
from wheelsight.core.geometry import ByteArray, Float32Array, FloatArray, IntArray, se3
from wheelsight.core.messages import WHEEL_READINGS, Event, RgbdFrame, SkippedFrame, WheelReading, YawRate
from wheelsight.evaluation import SequenceStatistics, sequence_statistics
from wheelsight.io.recordings.clock_checks import MotionClock, MotionOffset
from wheelsight.io.recordings.native import FrameClock, read_frame_clocks
from wheelsight.io.recordings.recording import AssociationReport, ListsTopics, RecordedTopic, Recording, left_out_of

# Offset between colour and depth, by their edges

# Range of shifts in the near search, in pixels of images of about this width.
_SEARCH_WIDTH = 320
_SEARCH_PX = (20, 8)
_SEARCH_SCALES = np.round(np.arange(0.84, 1.161, 0.02), 2)
_WIDEST_SHADOW_PX = 30
_DEPTH_STEP = 0.08
# The far search, for another lens or mirrored images, is coarse: in images of about this width, over half to twice the
# size and a seventh of the width, in some of the frames.
_FAR_WIDTH = 160
_FAR_PX = (24, 16)
_FAR_SCALES = np.exp(0.04 * np.arange(-18, 19))
_FAR_FRAMES = 8
_AS_IS = len(_FAR_SCALES) // 2
# Least fit in standard deviations over all shifts, and least ratio to the fit of unmoved images. Real and simulated
# recordings have 9 to 24 where images fit, and up to 8 by chance, from repetitive structure.
_FAR_STANDS_OUT, _FAR_FACTOR = 8.5, 1.5
_FLIPS = ((False, False), (True, False), (False, True), (True, True))
_FLIP_WORDS = {(True, False): "mirrored left to right", (False, True): "upside down", (True, True): "turned by 180°"}
# Largest median distance between measured and calibrated positions, as a share of the image width.
FAR_FROM_CALIBRATED = 0.02


@dataclass(frozen=True, slots=True)
class RegistrationOffset:
    """The offset of the colour image against the depth image, by their edges.

    Attributes:
        shift_px: shift (right, down) of colour against depth in the middle of the image.
        scale: size of objects in colour divided by that in depth.
        strength: mean contrast of colour at depth edges moved by shift and scale (average contrast: 1, by chance: 0).
        strength_as_is: the same at unmoved depth edges.
        flips: whether colour is mirrored left to right, and upside down.
    """

    shift_px: tuple[float, float]
    scale: float
    strength: float
    strength_as_is: float
    flips: tuple[bool, bool] = (False, False)

    @property
    def is_clear(self) -> bool:
        """Whether moved images fit clearly better."""
        return self.strength > 1.5 * max(self.strength_as_is, 0.0)

    def __str__(self) -> str:
        """The offset in words."""
        right, down = self.shift_px
        across = f"{abs(right):.0f} px {'left' if right < 0 else 'right'}"
        along = f"{abs(down):.0f} px {'up' if down < 0 else 'down'}"
        size = f"shows things {self.scale:.2f} times as large"
        if any(self.flips):
            size += f" and {_FLIP_WORDS[self.flips]}"
        return f"in the middle of the image colour lies {across} and {along} of depth, and {size}"


class OffsetMeter:
    """Estimates the offset by cross-correlation of depth edges with colour edges, summed over frames."""

    def __init__(self) -> None:
        self._fit: FloatArray = np.zeros((len(_SEARCH_SCALES), 2 * _SEARCH_PX[1] + 1, 2 * _SEARCH_PX[0] + 1))
        self._edges = 0.0
        self._reduction = 1
        self._far = _FarSearch()

    def add(self, color: ByteArray, depth_m: Float32Array) -> None:
        """Add a frame; both images have (H, W) pixels."""
        height, width = depth_m.shape
        self._reduction = max(1, round(width / _SEARCH_WIDTH))
        size = (width // self._reduction, height // self._reduction)
        right, down = _SEARCH_PX
        # Gradients along x and along y (H, W), with mean 1, minus the mean of their neighbourhood.
        grey = cv2.GaussianBlur(cv2.cvtColor(color, cv2.COLOR_RGB2GRAY).astype(np.float32), (0, 0), 1.5)
        contrasts: list[Float32Array] = []
        for along_x in (1, 0):
            step = np.abs(cv2.Sobel(grey, cv2.CV_32F, along_x, 1 - along_x))
            step = np.minimum(step, np.percentile(step, 95))
            step /= max(float(step.mean()), 1e-6)
            contrasts.append(step - cv2.blur(step, (81, 81)))
        borders = [_borders_along_rows(depth_m), np.ascontiguousarray(_borders_along_rows(depth_m.T).T)]
        self._far.keep(contrasts, borders)
        if size[0] <= 2 * right or size[1] <= 2 * down:
            return  # smaller than the searched shifts
        spectra = [cv2.dft(cv2.resize(contrast, size, interpolation=cv2.INTER_AREA)) for contrast in contrasts]
        for index, scale in enumerate(_SEARCH_SCALES):
            about = cv2.getRotationMatrix2D(((width - 1) / 2, (height - 1) / 2), 0.0, float(scale))
            product = np.zeros_like(spectra[0])
            for spectrum, border in zip(spectra, borders, strict=True):
                moved = cv2.resize(cv2.warpAffine(border, about, (width, height)), size, interpolation=cv2.INTER_AREA)
                product += _correlation(spectrum, moved)
            fit = cv2.idft(product, flags=cv2.DFT_SCALE)
            self._fit[index] += np.roll(fit, (down, right), (0, 1))[: 2 * down + 1, : 2 * right + 1]
        self._edges += sum(float(border.sum()) for border in borders) / self._reduction**2

    def offset(self) -> RegistrationOffset | None:
        """The best offset, or None without a significant one. The far search has precedence over the near one."""
        far = self._far.offset()
        if far is not None:
            return far
        if not self._edges or self._fit.max() < 5 * self._fit.std():
            return None
        scale, down, right = np.unravel_index(self._fit.argmax(), self._fit.shape)
        as_is = self._fit[len(_SEARCH_SCALES) // 2, _SEARCH_PX[1], _SEARCH_PX[0]]
        shift = self._reduction * (np.array([right, down]) - _SEARCH_PX)
        strength, strength_as_is = float(self._fit.max()) / self._edges, float(as_is) / self._edges
        at = (float(shift[0]), float(shift[1]))
        return RegistrationOffset(at, float(_SEARCH_SCALES[scale]), strength, strength_as_is)


# The fit of an offset in standard deviations over all shifts, and the offset.
_FarFit = tuple[float, RegistrationOffset]


class _FarSearch:
    """A search over large scales, large shifts and mirrored images, on the edges of a few frames.

    It returns only offsets beyond the near search: another scale, or a mirrored image.
    """

    def __init__(self) -> None:
        self._kept: list[list[tuple[Any, IntArray]]] = []
        self._shape = (0, 0)

    def keep(self, contrasts: list[Float32Array], borders: list[Float32Array]) -> None:
        """Keep the reduced colour contrast of a frame, and the pixels of its depth edges."""
        height, width = self._shape = (int(borders[0].shape[0]), int(borders[0].shape[1]))
        small = (cv2.resize(c, _far_size(width, height), interpolation=cv2.INTER_AREA) for c in contrasts)
        self._kept.append([(c, np.argwhere(b > 0)[:, ::-1]) for c, b in zip(small, borders, strict=True)])

    def offset(self) -> RegistrationOffset | None:
        """The significant offset beyond the near search, or None."""
        every = -(-len(self._kept) // _FAR_FRAMES) if self._kept else 1
        edges = [(cv2.dft(contrast), px) for kept in self._kept[::every] for contrast, px in kept]
        if not any(len(px) for _, px in edges):
            return None
        fits = {
            (flips, scale): self._fit(edges, flips, float(_FAR_SCALES[scale]))
            for flips in _FLIPS
            for scale in range(len(_FAR_SCALES))
        }
        (flips, scale), (deviations, best) = max(fits.items(), key=lambda item: item[1][0])
        deviations_as_is, as_is = fits[_FLIPS[0], _AS_IS]
        reach = float(_SEARCH_SCALES[-1])
        is_far = any(flips) or not 1 / reach < _FAR_SCALES[scale] < reach
        if not is_far or deviations < max(_FAR_STANDS_OUT, _FAR_FACTOR * deviations_as_is):
            return None
        return replace(best, flips=flips, strength_as_is=as_is.strength_as_is)

    def _fit(self, edges: list[tuple[Any, IntArray]], flips: tuple[bool, bool], scale: float) -> _FarFit:
        """The best shift of edges that are flipped and scaled about the middle, and how far it stands out."""
        (height, width), (right, down) = self._shape, _FAR_PX
        columns, rows = _far_size(width, height)
        middle, step = np.array([(width - 1) / 2, (height - 1) / 2]), np.array([width / columns, height / rows])
        signs, count = np.where(flips, -scale, scale), 0
        # The transform is linear, so the sum is inverted once.
        product = np.zeros_like(edges[0][0])
        for spectrum, px in edges:
            x, y = np.floor((signs * (px - middle) + middle + 0.5) / step).astype(np.int64).T
            inside = (x >= 0) & (x < columns) & (y >= 0) & (y < rows)
            count += int(np.count_nonzero(inside))
            moved = np.bincount(y[inside] * columns + x[inside], minlength=rows * columns).reshape(rows, columns)
            product += _correlation(spectrum, moved.astype(np.float32))
        fit = cv2.idft(product, flags=cv2.DFT_SCALE)
        near = np.roll(fit, (down, right), (0, 1))[: 2 * down + 1, : 2 * right + 1]
        y_best, x_best = np.unravel_index(near.argmax(), near.shape)
        shift_px = step * (np.array([x_best, y_best]) - _FAR_PX)
        strength, as_is = float(near.max()) / max(count, 1), float(fit[0, 0]) / max(count, 1)
        offset = RegistrationOffset((float(shift_px[0]), float(shift_px[1])), round(scale, 2), strength, as_is)
        return float(near.max() / max(fit.std(), 1e-12)), offset


def _correlation(spectrum: Any, moved: Any) -> Any:
    """The packed spectrum of the cross-correlation of an image with one of that spectrum."""
    return cv2.mulSpectrums(spectrum, cv2.dft(moved), 0, conjB=True)


def _far_size(width: int, height: int) -> tuple[int, int]:
    """Width and height of the reduced image of the far search."""
    reduction = max(1, round(width / _FAR_WIDTH))
    return width // reduction, height // reduction


def off_calibrated(offset: RegistrationOffset, calibration: Calibration, depth_m: float) -> float:
    """The distance between measured and calibrated positions of colour, as a share of the image width.

    Args:
        calibration: with T_color_depth.
        depth_m: depth of the scene, metres.

    Returns:
        The median over the image; NaN where the images hardly overlap.
    """
    color, depth = calibration.cameras
    assert calibration.T_color_depth is not None
    size = np.array([depth.width, depth.height], float)
    px = (np.stack(np.meshgrid(np.linspace(0.1, 0.9, 9), np.linspace(0.1, 0.9, 7)), axis=-1).reshape(-1, 2)) * size
    expected, is_seen = color.project(
        se3.apply(calibration.T_color_depth, depth.back_project(px, np.full(len(px), depth_m)))
    )
    signs, shift = np.where(offset.flips, -offset.scale, offset.scale), np.array(offset.shift_px)
    if not offset.is_clear:
        signs, shift = np.ones(2), np.zeros(2)
    seen = signs * (px - size / 2) + size / 2 + shift
    off_px = np.linalg.norm(seen - expected, axis=1)[is_seen]
    return float(np.median(off_px) / depth.width) if len(off_px) >= len(px) / 4 else float("nan")


def _borders_along_rows(depth_m: Float32Array) -> Float32Array:
    """1 at the near side of depth steps along x (H, W), also across shadows; else 0."""
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


# Clock of a live camera


@dataclass(frozen=True, slots=True)
class ClockMapping:
    """The mapping of a live camera's clock to the host's, over a recording.

    Attributes:
        offset_s: host time minus camera time, at the first frame with a stamp of the camera; None without any.
        drift_ppm: drift of the camera's clock in millionths, positive where it ran faster; None for fewer than two.
        sigma_median_s, sigma_largest_s: standard deviation of the mapping.
        arrival_median_s, arrival_p95_s: delay from a frame's stamp to its arrival.
        missing: the number of frames missing in the camera's frame numbers.
    """

    frames: int
    offset_s: float | None
    drift_ppm: float | None
    sigma_median_s: float
    sigma_largest_s: float
    arrival_median_s: float
    arrival_p95_s: float
    missing: int


def clock_mapping(clocks: Sequence[FrameClock]) -> ClockMapping | None:
    """The statistics of a recording's clock; None without frames."""
    if not clocks:
        return None
    sigmas_s = np.array([clock.stamp_sigma_s for clock in clocks])
    arrivals_s = np.array([clock.arrived_s - clock.stamp_s for clock in clocks])
    paired = [(clock.device_s, clock.stamp_s) for clock in clocks if clock.device_s is not None]
    # Slopes over a quarter of the stamps: their median is robust to one jump of the clock.
    paired_s, quarter = np.array(paired, float).reshape(-1, 2), max(len(paired) // 4, 1)
    drifts = paired_s[quarter:] - paired_s[:-quarter]
    drifts = drifts[drifts[:, 1] > 0]
    numbers = [clock.sequence for clock in clocks if clock.sequence is not None]
    steps = np.diff(np.array(numbers, float))
    # After a reconnection frame numbers start again: decreasing steps do not count.
    missing = int((steps[steps > 0] - 1).sum()) if len(steps) else 0
    return ClockMapping(
        frames=len(clocks),
        offset_s=paired[0][1] - paired[0][0] if paired else None,
        drift_ppm=float(1e6 * np.median(drifts[:, 0] / drifts[:, 1] - 1)) if len(drifts) else None,
        sigma_median_s=float(np.median(sigmas_s)),
        sigma_largest_s=float(sigmas_s.max()),
        arrival_median_s=float(np.median(arrivals_s)),
        arrival_p95_s=float(np.percentile(arrivals_s, 95)),
        missing=missing,
    )


_GAP_PERIODS = 3.0
_DEPTH_STRIDE = 4
_PLAUSIBLE_SHARE = 0.5
_NEAR_SHARE = 0.2  # some depth below the sensor's range is normal; more shows a wrong scale
_OFFSET_FRAMES = 16
_DEPTH_EDGES_M = np.geomspace(1e-3, 1e3, 6001)


@dataclass(frozen=True, slots=True)
class Gap:
    """A time without frames: from `start_s`, for `length_s` seconds."""

    start_s: float
    length_s: float


@dataclass(frozen=True, slots=True)
class Inspection:
    """The contents of a recording.

    Attributes:
        camera: image size, focal lengths and source of the colour camera; None without one.
        wheels: radii, track width and source of the wheels; None where the calibration has none.
        is_registered: whether, by its calibration, depth and colour share one pixel grid; None without cameras.
        skipped: (reason, number) of unusable frames.
        duration_s: from the first frame to the last, or of wheel readings without frames.
        rate_hz: of the same, from their median period; NaN with fewer than two.
        gaps: times without any of these, longer than three periods.
        valid_depth_share: share of depth pixels with a measurement; NaN without a usable frame.
        depth_m: depth in metres at the 5th, 50th and 95th percentile; NaN without measurements.
        offset: the offset between colour and depth, by the images; None where it is not significant.
        ground_truth: Zhang's Table 2 statistics of it, or None.
        topics: all topics of a bag with their use; empty for other formats.
        clock: the mapping of a live camera's clock; None where it is unknown.
        repeated: the number of frames with the image of the frame before.
        left_out: (reason, number, number of all) of lines or messages that were not used.
        motion: the offset between the clocks of camera and wheels, by their turns; None without both.
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
    topics: tuple[RecordedTopic, ...] = ()
    clock: ClockMapping | None = None
    repeated: int = 0
    motion: MotionOffset | None = None
    left_out: tuple[tuple[str, int, int], ...] = ()

    def to_dict(self) -> dict[str, Any]:
        """The fields as nested plain values; may contain NaN."""
        return asdict(self)


def inspect_recording(recording: Recording, on_event: Callable[[], None] | None = None) -> Inspection:
    """The contents of a recording, from one pass over all its events and images.

    Args:
        on_event: called after each frame, or each wheel reading without frames, for a progress bar.

    Raises:
        RecordingError: the recording cannot be read to its end.
    """
    tally = _Tally(recording)
    for event in recording.events():
        tally.add(event)
        if on_event is not None and isinstance(event, tally.counted):
            on_event()
    stamps_s = np.array(tally.stamps_s, float)
    period_s = float(np.median(np.diff(stamps_s))) if len(stamps_s) > 1 else float("nan")
    truth, calibration = recording.ground_truth, recording.calibration
    motion = tally.turns.offset() if tally.wheel_readings and recording.frame_count else None
    offset, color = tally.offset_meter.offset(), calibration.color
    of_clocks = []
    if motion is not None and motion.offset_s is not None and motion.is_apart:
        wheels = calibration.any_wheels
        delay_s = (0.0 if wheels is None else wheels.delay_s) - motion.offset_s
        of_clocks.append(
            f"By the turns of both, the camera's stamps are {motion} of the wheels': the clocks are apart. "
            f"Say `delay_s: {delay_s:.3f}` of the calibration's wheels."
        )
    camera = None
    if color is not None:
        camera = f"{color.width} × {color.height}, f {color.fx:g}, {color.fy:g} px ({calibration.source})"
    steps_s = np.diff(stamps_s)
    long = np.flatnonzero(steps_s > _GAP_PERIODS * period_s)
    return Inspection(
        name=recording.name,
        format=recording.format,
        body=recording.body,
        camera=camera,
        wheels=_wheels(calibration),
        is_registered=None if calibration.color is None else calibration.is_registered,
        frames=recording.frame_count,
        skipped=tuple(tally.skipped.most_common()),
        wheel_readings=tally.wheel_readings,
        yaw_readings=tally.yaw_readings,
        duration_s=float(np.ptp(stamps_s)) if len(stamps_s) else 0.0,
        rate_hz=1 / period_s if period_s > 0 else float("nan"),
        gaps=tuple(Gap(float(stamps_s[i]), float(steps_s[i])) for i in long),
        valid_depth_share=float(tally.histogram.sum() / tally.pixels) if tally.pixels else float("nan"),
        depth_m=tally.depth_percentiles_m(),
        offset=offset,
        association=recording.association,
        ground_truth=sequence_statistics(truth) if truth is not None and len(truth) > 1 else None,
        warnings=(
            *recording.warnings,
            *_image_warnings(tally, recording),
            *_offset_warnings(offset, tally, recording),
            *of_clocks,
        ),
        topics=tuple(recording.topics) if isinstance(recording, ListsTopics) else (),
        clock=clock_mapping(read_frame_clocks(recording.path)) if recording.path.is_dir() else None,
        repeated=tally.repeated,
        motion=motion,
        left_out=tuple((why, *counts) for why, counts in left_out_of(recording.warnings).items()),
    )


def _wheels(calibration: Calibration) -> str | None:
    wheels, holonomic = calibration.wheels, calibration.holonomic
    if holonomic is not None:
        of = f"{len(holonomic.wheel_names)} wheels of" if holonomic.wheel_names else "x, y and yaw of"
        sizes = "" if holonomic.radius_m is None else f", radius {holonomic.radius_m:.5g} m"
        return f"{of} a holonomic base ({holonomic.layout}){sizes} ({calibration.source})"
    if wheels is None:
        return None
    sizes = f"radius {wheels.left_radius_m:.5g} m left, {wheels.right_radius_m:.5g} m right"
    return f"{sizes}, track {wheels.track_width_m:.5g} m, {wheels.ticks_per_turn:g} ticks a turn ({calibration.source})"


@dataclass
class _Tally:
    """Counts over the events of a recording, in constant memory but for stamps."""

    recording: Recording
    stamps_s: list[float] = field(default_factory=list)
    skipped: Counter[str] = field(default_factory=Counter)
    wheel_readings: int = 0
    yaw_readings: int = 0
    repeated: int = 0
    repeats: Repeats = field(default_factory=Repeats)
    pixels: int = 0
    histogram: FloatArray = field(default_factory=lambda: np.zeros(len(_DEPTH_EDGES_M) - 1))
    offset_meter: OffsetMeter = field(default_factory=lambda: OffsetMeter())

    def __post_init__(self) -> None:
        self.turns = MotionClock(self.recording.calibration)

    @property
    def counted(self) -> tuple[type, ...]:
        """The events whose times are analysed: frames, or wheel readings without frames."""
        return (RgbdFrame, SkippedFrame) if self.recording.frame_count else WHEEL_READINGS

    def add(self, event: Event) -> None:
        self.turns.add(event)
        if isinstance(event, self.counted):
            self.stamps_s.append(event.stamp_s)
        self.wheel_readings += isinstance(event, WheelReading)
        self.yaw_readings += isinstance(event, YawRate)
        if isinstance(event, SkippedFrame):
            self.skipped[event.reason] += 1
        if not isinstance(event, RgbdFrame):
            return
        self.repeated += self.repeats.lasting_s(event) > 0
        depth_m = event.depth_m[::_DEPTH_STRIDE, ::_DEPTH_STRIDE]
        self.pixels += depth_m.size
        self.histogram += np.histogram(depth_m[depth_m > 0], _DEPTH_EDGES_M)[0]
        every = max(1, self.recording.frame_count // _OFFSET_FRAMES)
        if event.index % every == every // 2 and event.color.shape[:2] == event.depth_m.shape:
            self.offset_meter.add(event.color, event.depth_m)

    def depth_percentiles_m(self) -> dict[str, float]:
        """Depth at three percentiles, with a resolution of a quarter of a percent."""
        total = self.histogram.cumsum()
        places = {name: np.searchsorted(total, share * total[-1]) for name, share in _PERCENTILES.items()}
        return {name: float(_DEPTH_EDGES_M[place]) if total[-1] else float("nan") for name, place in places.items()}

    def share_between(self, near_m: float, far_m: float) -> float:
        inside = (_DEPTH_EDGES_M[:-1] >= near_m) & (_DEPTH_EDGES_M[:-1] <= far_m)
        return float(self.histogram[inside].sum() / max(self.histogram.sum(), 1))


_PERCENTILES = {"p5": 0.05, "median": 0.5, "p95": 0.95}


def _image_warnings(tally: _Tally, recording: Recording) -> list[str]:
    """Warnings about repeated images, and about depth outside the sensor's range."""
    noise, warnings = recording.calibration.depth_noise, list[str]()
    if tally.repeated:
        repeated = f"{tally.repeated} of {recording.frame_count} frames show the same image as the frame before"
        slow = "fewer images a second were taken than recorded, or the camera hung. They are skipped."
        warnings.append(f"{repeated}: {slow}")
    if not tally.histogram.any():
        return [*warnings, *(["No depth pixel measured anything."] if tally.pixels else [])]
    near_share = tally.share_between(0.0, noise.near_m)
    if near_share > _NEAR_SHARE and near_share < _PLAUSIBLE_SHARE:
        warnings.append(
            f"{100 * near_share:.0f} % of depth lies nearer than the {noise.near_m:g} m from which the sensor is "
            "trusted: is the depth scale right? Depth in millimetres is read by --depth-factor 1000."
        )
    elif tally.share_between(noise.near_m, noise.far_m) < _PLAUSIBLE_SHARE:
        median_m = tally.depth_percentiles_m()["median"]
        warnings.append(
            f"Most depth lies outside the {noise.near_m:g} to {noise.far_m:g} m the sensor is trusted in "
            f"(median {median_m:.3g} m): is the depth scale right? See --depth-factor."
        )
    return warnings


def _offset_warnings(offset: RegistrationOffset | None, tally: _Tally, recording: Recording) -> list[str]:
    calibration = recording.calibration
    if offset is None:
        return []
    if offset.is_clear and any(offset.flips):
        return [f"Colour and depth are mirrored against each other: {offset}. Mirror the images of one as the other's."]
    if calibration.is_registered:
        if not offset.is_clear:
            return []
        return [
            f"Colour and depth are not registered, though the calibration says so: {offset}. "
            f"Give a calibration with T_color_depth."
        ]
    if not off_calibrated(offset, calibration, tally.depth_percentiles_m()["median"]) > FAR_FROM_CALIBRATED:
        return []
    seen = f"{offset}" if offset.is_clear else "colour and depth share pixels"
    return [
        f"The calibration ({calibration.source}) says that colour and depth are not registered, but by the images "
        f"{seen}: is it of another camera? Give this one's by --camera."
    ]
