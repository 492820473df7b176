"""LiveSource: a live camera and live wheels as a source of events. Holds what is known of any source before its first
event, and the odometry that a run of it uses.
"""

from __future__ import annotations

from collections.abc import Callable, Generator, Iterator
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass, replace
from pathlib import Path

from wheelsight.app.run.kernels import DrawnDrive, Rehearses
from wheelsight.app.run.realtime import REHEARSED_FRAMES, AnswerTimes, RealTimeRecording
from wheelsight.app.run.run_record import RealTimeRecord
from wheelsight.config import Config
from wheelsight.core.calibration import Calibration
from wheelsight.core.errors import ConfigError
from wheelsight.core.messages import AngularVelocity, Event, RgbdFrame, WheelReading, WheelTicks, YawRate
from wheelsight.core.robots import EventSource
from wheelsight.estimation.odometry_choice import (
    FRAMES,
    NO_PARTS,
    RATES,
    READINGS,
    Choice,
    OwnParts,
    Sensors,
    choose_odometry,
    counted,
    why_unused,
)
from wheelsight.io.devices import WheelLink, host_clock
from wheelsight.io.devices.live_camera import (
    CameraReport,
    CameraStatus,
    CameraWatch,
    LiveCamera,
    LiveFrame,
    take_angular_velocities,
)
from wheelsight.io.devices.recorder import LiveRecorder
from wheelsight.io.devices.wheel_source import ReadingLink
from wheelsight.io.recordings import Recording

_WAIT_S = 0.005  # for what comes next; a frame waits no longer for a reading
_SILENT_S = 1.0
_REHEARSED_WITHIN_S = 3.0

Until = Callable[[], AbstractContextManager[Callable[[], bool]]]
"""A context that opens with the first event; it yields a function that returns whether the run is over."""


@dataclass(frozen=True, slots=True)
class LiveSensors:
    """The sensors of a live run.

    Attributes:
        calibration: of the robot.
        camera, link: camera and wheel link; either may be None.
        recorder: records all events, or None.
    """

    calibration: Calibration
    camera: LiveCamera | None = None
    link: ReadingLink | None = None
    recorder: LiveRecorder | None = None


class LiveSource:
    """Events of live sensors. It ends when `until` says so, or with the file that the camera plays.

    All readings are given, but only the newest frame: frames that the run is too slow for are dropped and counted.
    Cameras deliver later than wheels, so a frame may have an earlier stamp than readings before it. Events from before
    the first request are discarded. The loss of a sensor is reported; the other one goes on.

    Args:
        sensors: open; the caller closes them.
        until: says when the run is over; None: never.
        on_begin: called when all is ready, before the first event.
        note: called with one sentence about each change of a sensor.

    Raises:
        ConfigError: no sensor, or wheels of unknown size.
    """

    def __init__(
        self,
        sensors: LiveSensors,
        until: Until | None = None,
        on_begin: Callable[[], None] = lambda: None,
        note: Callable[[str], None] = lambda text: None,
    ) -> None:
        if sensors.camera is None and sensors.link is None:
            raise ConfigError("there is no sensor to listen to", fix="--camera NAME, --wheels PORT, or both")
        if isinstance(sensors.link, WheelLink) and sensors.calibration.holonomic is not None:
            problem = f"wheels at {sensors.link.port} are two, and the calibration has a holonomic base"
            raise ConfigError(problem, fix="record its odometry in a bag, or leave out --wheels")
        if sensors.link is not None and sensors.calibration.any_wheels is None:
            problem = f"wheels at {sensors.link.port} give no motion without their sizes"
            raise ConfigError(problem, fix="--calibration FILE with wheels, or leave out --wheels")
        if sensors.camera is not None and sensors.calibration.color is None:
            raise ConfigError(f"{sensors.camera.name} has no calibration", fix="--calibration FILE of the camera")
        self._sensors, self._on_begin, self._note = sensors, on_begin, note
        self._until: Until = until or (lambda: nullcontext(lambda: False))
        self._watch = None if sensors.camera is None else CameraWatch(sensors.camera)
        self._times = AnswerTimes()
        self._at_begin: CameraReport | None = None
        self._began_s: float | None = None
        self._ended_s: float | None = None
        self._heard_s: float | None = None
        self._fetched = self._answered = self._readings = 0
        self._has_lost_recorder = False

    @property
    def name(self) -> str:
        """Name of the camera, the port, or both."""
        names = [] if self._sensors.camera is None else [self._sensors.camera.name]
        return " and ".join([*names, *([] if self._sensors.link is None else [self._sensors.link.port])])

    @property
    def calibration(self) -> Calibration:
        """The robot's calibration without absent sensors. The link has unrolled the wheels' counters."""
        known = self._sensors.calibration
        if self._sensors.camera is None:
            known = replace(known, color=None, depth=None, T_color_depth=None)
        listens = self._sensors.link is not None and known.wheels is not None
        return replace(known, wheels=known.wheels.never_rolling_over if listens and known.wheels else None)

    @property
    def warnings(self) -> tuple[str, ...]:
        """Warnings of the camera, and each sensor that has given nothing."""
        camera, link = self._sensors.camera, self._sensors.link
        silent = [] if camera is None else [*camera.warnings]
        if self._ended_s is not None:
            if camera is not None and not self._fetched:
                silent.append(f"No frame came from {camera.name}: {camera.report().status}.")
            if link is not None and not self._readings:
                silent.append(f"No wheel reading came from {link.port}.")
        return tuple(silent)

    def events(self, *, images: bool = True) -> Generator[Event]:
        """Events in the order of their arrival."""
        with self._until() as is_over:
            # Discard events from before the start
            for _ in self._ticks():
                pass
            for _ in (*self._frames(0.0), *self._rates()):
                pass
            self._began_s, self._ended_s, self._heard_s = host_clock.now_s(), None, None
            self._fetched = self._answered = self._readings = 0
            self._times = AnswerTimes()
            self._at_begin = None if self._sensors.camera is None else self._sensors.camera.report()
            self._on_begin()
            camera = self._sensors.camera
            ended = (CameraStatus.ENDED, CameraStatus.CLOSED)
            while not (is_over() or (camera is not None and camera.report().status in ended)):
                # All readings and the newest frame, by their stamps
                ticks = list(self._ticks(_WAIT_S))
                frames = [live.frame for live in self._frames(0.0 if self._sensors.link is not None else _WAIT_S)]
                self._fetched += len(frames)
                self._readings += len(ticks)
                if ticks:
                    self._heard_s = host_clock.now_s()
                newest: list[RgbdFrame] = frames[-1:] if images else []
                self._answered += len(newest)
                came: list[Event] = [*ticks, *self._rates(), *newest]
                for event in sorted(came, key=lambda event: event.stamp_s):
                    yield event
                    self._times.add(event, host_clock.now_s())
                for text in () if self._watch is None else self._watch.changes():
                    self._note(text)
            self._ended_s = host_clock.now_s()

    def rehearsals(self) -> tuple[Rehearses, ...]:
        """A drive that calls every kernel, then live events of the sensors."""
        return DrawnDrive(self.calibration), self

    def rehearsal(self) -> Iterator[Event]:
        """A few live frames, between readings of wheels that stand still."""
        camera, ends_s = self._sensors.camera, host_clock.now_s() + _REHEARSED_WITHIN_S
        for _ in range(REHEARSED_FRAMES if camera is not None else 0):
            assert camera is not None
            live = camera.read(max(ends_s - host_clock.now_s(), 0.0))
            if live is None:
                return
            if self.calibration.wheels is not None:
                yield WheelTicks(live.frame.stamp_s, 0, 0)
            yield live.frame

    def report(self) -> RealTimeRecord:
        """Counts and latencies so far."""
        frames, dropped = self.frames_so_far
        counts = (frames, dropped, max(frames - self._fetched, 0), self._readings)
        camera, link = self._sensors.camera, self._sensors.link
        port, name = None if link is None else link.port, None if camera is None else camera.name
        lasted_s = 0.0 if self._began_s is None else (self._ended_s or host_clock.now_s()) - self._began_s
        return RealTimeRecord(lasted_s, *counts, *self._times.median_and_p95_s(), port, True, name)

    def lately(self) -> tuple[float, float] | None:
        """Frames answered a second and their median latency, seconds, in the recent window; None before two frames."""
        return self._times.lately()

    @property
    def frames_so_far(self) -> tuple[int, int]:
        """Number of frames so far, with those that the camera lost, and number of frames without an answer."""
        lost = 0
        if self._sensors.camera is not None and self._at_begin is not None:
            lost = _lost(self._sensors.camera.report()) - _lost(self._at_begin)
        return self._fetched + lost, self._fetched + lost - self._answered

    @property
    def is_missing_wheels(self) -> bool:
        """Whether the wheels are silent."""
        if self._sensors.link is None or self._began_s is None:
            return False
        return host_clock.now_s() - (self._heard_s or self._began_s) > _SILENT_S

    def _ticks(self, timeout_s: float = 0.0) -> Iterator[WheelReading | YawRate]:
        """All waiting readings; waits for the first."""
        while self._sensors.link is not None and (ticks := self._sensors.link.read(timeout_s)) is not None:
            timeout_s = 0.0
            self._keep(ticks)
            yield ticks

    def _frames(self, timeout_s: float) -> Iterator[LiveFrame]:
        """All waiting frames; waits for the first."""
        while self._sensors.camera is not None and (live := self._sensors.camera.read(timeout_s)) is not None:
            timeout_s = 0.0
            self._keep(live)
            yield live

    def _rates(self) -> list[YawRate]:
        """All rates of the camera's gyroscope; none without the camera's mount."""
        turns, mount = take_angular_velocities(self._sensors.camera), self._sensors.calibration.T_base_camera
        for turn in turns:
            self._keep(turn)
        return [] if mount is None else [turn.yaw_rate(mount) for turn in turns]

    def _keep(self, event: WheelReading | YawRate | LiveFrame | AngularVelocity) -> None:
        """Record an event, if there is a recorder, from the first requested event on."""
        recorder = self._sensors.recorder
        if recorder is None or self._began_s is None:
            return
        if isinstance(event, LiveFrame):
            recorder.add_frame(event)
        else:
            recorder.add_reading(event)
        problem = recorder.report().problem
        if problem is not None and not self._has_lost_recorder:
            self._has_lost_recorder = True
            self._note(f"nothing more is recorded: {problem}")


def _lost(report: CameraReport) -> int:
    return report.device_drops + report.host_drops + report.stale


LIVE = "live"
# Frames to show of a source of unknown length: each index is this factor later than the one before.
_FIRST_FRAME, _LATER = 10, 4


def frame_count_of(source: EventSource) -> int | None:
    """Number of frames, with skipped ones; None if unknown."""
    return source.frame_count if isinstance(source, Recording) else None


def wheel_count_of(source: EventSource) -> int | None:
    """Number of wheel readings; None if unknown."""
    return source.wheel_count if isinstance(source, Recording) else None


def path_of(source: EventSource) -> Path | None:
    """The path of the source, or None."""
    return source.path if isinstance(source, Recording) else None


def format_of(source: EventSource) -> str:
    """The name of the source's reader, or "live"."""
    return source.format if isinstance(source, Recording) else LIVE


def where(source: EventSource) -> str:
    """The name of the source in messages: its path, else its name."""
    return str(path_of(source) or source.name)


def spread(wanted: int, frame_count: int | None) -> list[int]:
    """Rising indices of `count` frames. If the total is known, they are evenly spread and none is at either end."""
    if frame_count is None:
        return [_FIRST_FRAME * _LATER**number for number in range(wanted)]
    return [int((number + 0.5) * frame_count / wanted) for number in range(wanted)]


def default_odometry(source: EventSource, config: Config) -> Choice:
    """The odometry of `localizer.choose_odometry` for the sensors of the source. Raises ConfigError."""
    elsewhere = source.wheels.where if isinstance(source, RealTimeRecording) and source.wheels is not None else ""
    sensors = Sensors(frame_count_of(source), wheel_count_of(source), elsewhere, where(source))
    return choose_odometry(source.calibration, config, sensors)


def resolved(source: EventSource, config: Config, parts: OwnParts = NO_PARTS) -> Config:
    """The configuration with its odometry: `default_odometry` where it is automatic. Raises ConfigError."""
    if config.odometry and parts == NO_PARTS:
        return config
    return parts.named_in(config, default_odometry(source, config))


def unused_of(source: EventSource, config: Config, yaw_rates: int) -> tuple[str, ...]:
    """One sentence about each sensor of the source that a run of `config` does not use, with the reason.

    Args:
        source: of the run.
        config: all settings of the run, with its odometry.
        yaw_rates: number of readings of a gyroscope.
    """
    choice, calibration = default_odometry(source, config), source.calibration
    frames, readings = frame_count_of(source), wheel_count_of(source)
    has_frames = frames > 0 if frames is not None else calibration.color is not None
    has_readings = readings > 0 if readings is not None else calibration.any_wheels is not None
    by_wheels = "wheels" in config.odometry
    is_left_out = {
        counted(frames, FRAMES): config.tracks == ("wheels",) and has_frames,
        counted(readings, READINGS): not by_wheels and has_readings,
        counted(yaw_rates, RATES): bool(yaw_rates) and not (config.wheels.gyro and by_wheels),
    }
    return tuple(why_unused(what, config, choice) for what, is_unused in is_left_out.items() if is_unused)
