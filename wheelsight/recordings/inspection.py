"""What is in a recording, and what a user should know before trusting results made from it."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from dataclasses import asdict, dataclass, field
from typing import Any

import numpy as np

from wheelsight.calibration import Calibration
from wheelsight.evaluation import SequenceStatistics, sequence_statistics
from wheelsight.events import WHEEL_READINGS, Event, RgbdFrame, SkippedFrame, WheelReading, YawRate
from wheelsight.geometry import Float32Array, FloatArray
from wheelsight.recordings.clock_mapping import ClockMapping, clock_mapping
from wheelsight.recordings.frame_clocks import read_frame_clocks
from wheelsight.recordings.motion_clocks import MotionClock, MotionOffset
from wheelsight.recordings.protocol import AssociationReport, ListsTopics, RecordedTopic, Recording, left_out_of
from wheelsight.recordings.registration import FAR_FROM_CALIBRATED, OffsetMeter, RegistrationOffset, off_calibrated
from wheelsight.recordings.repeats import Repeats

_GAP_PERIODS = 3.0
_DEPTH_STRIDE = 4
_PLAUSIBLE_SHARE = 0.5
_NEAR_SHARE = 0.2  # nearer than a sensor measures, some depth is wrong always; so much of it is a wrong scale
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
        topics: of a bag, all of them and what each is used as; else none.
        clock: how the clock of the live camera that it is from was mapped; None where that is not known.
        repeated: how many frames show the image of the frame before.
        left_out: (why, how many, of how many) lines or messages of readings and truth that were not used.
        motion: how far the camera's stamps are ahead of the wheels', by the turns of both; None without either.
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
    motion = tally.turns.offset() if tally.wheel_readings and recording.frame_count else None
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
        warnings=(*recording.warnings, *_warnings(tally, offset, recording), *_clock_warnings(motion, recording)),
        topics=tuple(recording.topics) if isinstance(recording, ListsTopics) else (),
        clock=clock_mapping(read_frame_clocks(recording.path)) if recording.path.is_dir() else None,
        repeated=tally.repeated,
        motion=motion,
        left_out=tuple((why, *counts) for why, counts in left_out_of(recording.warnings).items()),
    )


def _clock_warnings(motion: MotionOffset | None, recording: Recording) -> list[str]:
    """That the clocks of camera and wheels are apart, by the turns of both."""
    if motion is None or motion.offset_s is None or not motion.is_apart:
        return []
    wheels = recording.calibration.any_wheels
    delay_s = (0.0 if wheels is None else wheels.delay_s) - motion.offset_s
    return [
        f"By the turns of both, the camera's stamps are {motion} of the wheels': the clocks are apart. "
        f"Say `delay_s: {delay_s:.3f}` of the calibration's wheels."
    ]


def _warnings(tally: _Tally, offset: RegistrationOffset | None, recording: Recording) -> list[str]:
    """What images tell."""
    of_depth = [*_depth_warnings(tally, recording), *_offset_warnings(offset, tally, recording)]
    return [*_repeat_warnings(tally), *of_depth]


def _camera(calibration: Calibration) -> str | None:
    camera = calibration.color
    if camera is None:
        return None
    return f"{camera.width} × {camera.height}, f {camera.fx:g}, {camera.fy:g} px ({calibration.source})"


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
    """Counts over the events of a recording, in little memory however long it is."""

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
        """The events whose times are told of: frames, or where there are none the wheels' readings."""
        return (RgbdFrame, SkippedFrame) if self.recording.frame_count else WHEEL_READINGS

    def add(self, event: Event) -> None:
        self.turns.add(event)
        if isinstance(event, self.counted):
            self.stamps_s.append(event.stamp_s)
        self.wheel_readings += isinstance(event, WheelReading)
        self.yaw_readings += isinstance(event, YawRate)
        if isinstance(event, SkippedFrame):
            self.skipped[event.reason] += 1
        if isinstance(event, RgbdFrame):
            self._add_frame(event)

    def _add_frame(self, event: RgbdFrame) -> None:
        self.repeated += self.repeats.lasting_s(event) > 0
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


def _repeat_warnings(tally: _Tally) -> list[str]:
    if not tally.repeated:
        return []
    told = f"{tally.repeated} of {tally.recording.frame_count} frames show the same image as the frame before"
    return [f"{told}: fewer images a second were taken than recorded, or the camera hung. They are skipped."]


def _depth_warnings(tally: _Tally, recording: Recording) -> list[str]:
    noise = recording.calibration.depth_noise
    if not tally.histogram.any():
        return ["No depth pixel measured anything."] if tally.pixels else []
    near_share = tally.share_between(0.0, noise.near_m)
    if near_share > _NEAR_SHARE and near_share < _PLAUSIBLE_SHARE:
        return [
            f"{100 * near_share:.0f} % of depth lies nearer than the {noise.near_m:g} m from which the sensor is "
            "trusted: is the depth scale right? Depth in millimetres is read by --depth-factor 1000."
        ]
    if tally.share_between(noise.near_m, noise.far_m) >= _PLAUSIBLE_SHARE:
        return []
    median_m = tally.depth_percentiles_m()["median"]
    return [
        f"Most depth lies outside the {noise.near_m:g} to {noise.far_m:g} m the sensor is trusted in "
        f"(median {median_m:.3g} m): is the depth scale right? See --depth-factor."
    ]


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
