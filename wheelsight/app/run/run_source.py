"""LiveSource: a camera and wheels as they are just now, as a source of events. Says what is known of any source
before its first event, and which odometry a run of it follows.
"""

from __future__ import annotations

from collections.abc import Callable, Generator, Iterator
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass, replace
from pathlib import Path

from wheelsight.app.run.kernels import DrawnDrive, Rehearses
from wheelsight.app.run.realtime import AnswerTimes, RealTimeRecording
from wheelsight.app.run.run_record import RealTimeRecord
from wheelsight.config import Config
from wheelsight.core.calibration import Calibration
from wheelsight.core.errors import ConfigError
from wheelsight.core.messages import AngularVelocity, Event, RgbdFrame, WheelTicks, YawRate
from wheelsight.core.robots import EventSource
from wheelsight.core.settings import RealTimeSettings
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
from wheelsight.io.recordings import Recording

# LiveSource: a camera and wheels as they are just now, as a source of events for a run.


_WAIT_S = 0.005  # for what comes next; a frame waits no longer for a reading
_SILENT_S = 1.0
_REHEARSED_WITHIN_S = 3.0

Until = Callable[[], AbstractContextManager[Callable[[], bool]]]
"""Opened when the first event is asked for; tells whether it is over."""


@dataclass(frozen=True, slots=True)
class LiveSensors:
    """What a run listens to.

    Attributes:
        calibration: of the robot.
        camera, link: either may be None.
        recorder: what keeps all that is heard, or None.
    """

    calibration: Calibration
    camera: LiveCamera | None = None
    link: WheelLink | None = None
    recorder: LiveRecorder | None = None


class LiveSource:
    """Events of sensors that are there just now; it ends when it is told to, or the camera plays a file that ends.

    Readings come all, of frames only the newest: what the run was too slow for is dropped, and counted. A frame may be
    stamped before readings that were handed out earlier, since cameras deliver later than wheels. What came before the
    first event is asked for is left out: it is old by then. A sensor that goes away is told, and the other goes on.

    Args:
        sensors: opened, and closed by whoever opened them.
        until: tells when it is over; for ever, if None.
        on_begin: called when all is ready, right before the first event is waited for.
        note: told a sentence about each change of a sensor.
        settings: of None, the defaults.

    Raises:
        ConfigError: no sensor, or wheels of unknown size.
    """

    def __init__(
        self,
        sensors: LiveSensors,
        until: Until | None = None,
        on_begin: Callable[[], None] = lambda: None,
        note: Callable[[str], None] = lambda text: None,
        settings: RealTimeSettings | None = None,
    ) -> None:
        _check(sensors)
        self.settings = settings or RealTimeSettings()
        self._sensors, self._on_begin, self._note = sensors, on_begin, note
        self._until: Until = until or (lambda: nullcontext(lambda: False))
        self._watch = None if sensors.camera is None else CameraWatch(sensors.camera)
        self._times = AnswerTimes(self.settings.recent_frames)
        self._at_begin: CameraReport | None = None
        self._began_s: float | None = None
        self._ended_s: float | None = None
        self._heard_s: float | None = None
        self._fetched = self._answered = self._readings = 0
        self._has_lost_recorder = False

    @property
    def name(self) -> str:
        """What it listens to."""
        names = [] if self._sensors.camera is None else [self._sensors.camera.name]
        return " and ".join([*names, *([] if self._sensors.link is None else [self._sensors.link.port])])

    @property
    def calibration(self) -> Calibration:
        """The robot's, without the sensors that are not listened to; the link has unrolled the wheels' counters."""
        known = self._sensors.calibration
        if self._sensors.camera is None:
            known = replace(known, color=None, depth=None, T_color_depth=None)
        listens = self._sensors.link is not None and known.wheels is not None
        return replace(known, wheels=known.wheels.never_rolling_over if listens and known.wheels else None)

    @property
    def warnings(self) -> tuple[str, ...]:
        """The camera's, and which sensor never spoke."""
        camera, link = self._sensors.camera, self._sensors.link
        told = [] if camera is None else [*camera.warnings]
        if self._ended_s is not None:
            if camera is not None and not self._fetched:
                told.append(f"No frame came from {camera.name}: {camera.report().status}.")
            if link is not None and not self._readings:
                told.append(f"No wheel reading came from {link.port}.")
        return tuple(told)

    def events(self, *, images: bool = True) -> Generator[Event]:
        """As they come."""
        with self._until() as is_over:
            self._begin()
            self._on_begin()
            while not (is_over() or self._has_ended()):
                for event in self._came(images):
                    yield event
                    self._times.add(event, host_clock.now_s())
                for text in () if self._watch is None else self._watch.changes():
                    self._note(text)
            self._ended_s = host_clock.now_s()

    def rehearsals(self) -> tuple[Rehearses, ...]:
        """A drive in which everything happens, then what the sensors show just now."""
        return DrawnDrive(self.calibration), self

    def rehearsal(self) -> Iterator[Event]:
        """A few frames as they come, between wheels that stand still."""
        camera, ends_s = self._sensors.camera, host_clock.now_s() + _REHEARSED_WITHIN_S
        for _ in range(self.settings.rehearsed_frames if camera is not None else 0):
            assert camera is not None
            live = camera.read(max(ends_s - host_clock.now_s(), 0.0))
            if live is None:
                return
            if self.calibration.wheels is not None:
                yield WheelTicks(live.frame.stamp_s, 0, 0)
            yield live.frame

    def report(self) -> RealTimeRecord:
        """How it went so far."""
        frames, dropped = self.frames_so_far
        counts = (frames, dropped, max(frames - self._fetched, 0), self._readings)
        camera, link = self._sensors.camera, self._sensors.link
        port, name = None if link is None else link.port, None if camera is None else camera.name
        return RealTimeRecord(self._lasted_s, *counts, *self._times.median_and_p95_s(), port, True, name)

    def lately(self) -> tuple[float, float] | None:
        """Frames answered a second, and their median latency in seconds, over the last of them; None before two."""
        return self._times.lately()

    @property
    def frames_so_far(self) -> tuple[int, int]:
        """Frames that came by, those that the camera lost included, and how many were not answered."""
        lost = 0
        if self._sensors.camera is not None and self._at_begin is not None:
            lost = _lost(self._sensors.camera.report()) - _lost(self._at_begin)
        return self._fetched + lost, self._fetched + lost - self._answered

    @property
    def is_missing_wheels(self) -> bool:
        """Whether the wheels have fallen silent."""
        if self._sensors.link is None or self._began_s is None:
            return False
        return host_clock.now_s() - (self._heard_s or self._began_s) > _SILENT_S

    @property
    def _lasted_s(self) -> float:
        if self._began_s is None:
            return 0.0
        return (self._ended_s or host_clock.now_s()) - self._began_s

    def _begin(self) -> None:
        """Leave out what came while others made ready."""
        for _ in self._ticks():
            pass
        for _ in (*self._frames(0.0), *self._rates()):
            pass
        self._began_s, self._ended_s, self._heard_s = host_clock.now_s(), None, None
        self._fetched = self._answered = self._readings = 0
        self._times = AnswerTimes(self.settings.recent_frames)
        self._at_begin = None if self._sensors.camera is None else self._sensors.camera.report()

    def _came(self, images: bool) -> list[Event]:
        """What has come by now: all readings and the newest frame, by their stamps."""
        ticks = list(self._ticks(_WAIT_S))
        frames = [live.frame for live in self._frames(0.0 if self._sensors.link is not None else _WAIT_S)]
        self._fetched += len(frames)
        self._readings += len(ticks)
        if ticks:
            self._heard_s = host_clock.now_s()
        newest: list[RgbdFrame] = frames[-1:] if images else []
        self._answered += len(newest)
        return sorted([*ticks, *self._rates(), *newest], key=lambda event: event.stamp_s)

    def _ticks(self, timeout_s: float = 0.0) -> Iterator[WheelTicks]:
        """All that came; the first is waited for."""
        while self._sensors.link is not None and (ticks := self._sensors.link.read(timeout_s)) is not None:
            timeout_s = 0.0
            self._keep(ticks)
            yield ticks

    def _frames(self, timeout_s: float) -> Iterator[LiveFrame]:
        """All that came; the first is waited for."""
        while self._sensors.camera is not None and (live := self._sensors.camera.read(timeout_s)) is not None:
            timeout_s = 0.0
            self._keep(live)
            yield live

    def _rates(self) -> list[YawRate]:
        """All that the camera's gyroscope told; nothing where it is not known how the camera sits."""
        turns, mount = take_angular_velocities(self._sensors.camera), self._sensors.calibration.T_base_camera
        for turn in turns:
            self._keep(turn)
        return [] if mount is None else [turn.yaw_rate(mount) for turn in turns]

    def _keep(self, heard: WheelTicks | LiveFrame | AngularVelocity) -> None:
        """Have it recorded, if that was asked for, from the first event on."""
        recorder = self._sensors.recorder
        if recorder is None or self._began_s is None:
            return
        if isinstance(heard, LiveFrame):
            recorder.add_frame(heard)
        else:
            recorder.add_reading(heard)
        problem = recorder.report().problem
        if problem is not None and not self._has_lost_recorder:
            self._has_lost_recorder = True
            self._note(f"nothing more is recorded: {problem}")

    def _has_ended(self) -> bool:
        camera = self._sensors.camera
        return camera is not None and camera.report().status in (CameraStatus.ENDED, CameraStatus.CLOSED)


def _check(sensors: LiveSensors) -> None:
    if sensors.camera is None and sensors.link is None:
        raise ConfigError("there is no sensor to listen to", fix="--camera NAME, --wheels PORT, or both")
    if sensors.link is not None and sensors.calibration.holonomic is not None:
        problem = f"wheels at {sensors.link.port} are two, and the calibration has a holonomic base"
        raise ConfigError(problem, fix="record its odometry in a bag, or leave out --wheels")
    if sensors.link is not None and sensors.calibration.wheels is None:
        problem = f"wheels at {sensors.link.port} tell nothing while their size is not known"
        raise ConfigError(problem, fix="--calibration FILE with wheels, or leave out --wheels")
    if sensors.camera is not None and sensors.calibration.color is None:
        raise ConfigError(f"{sensors.camera.name} has no calibration", fix="--calibration FILE of the camera")


def _lost(report: CameraReport) -> int:
    return report.device_drops + report.host_drops + report.stale


# What is known of a source before its first event: much of a recording, little of a live one.


LIVE = "live"
# Frames that are shown of a source without an end: nobody knows how long it will be, so each is so much later.
_FIRST_FRAME, _LATER = 10, 4


def frame_count_of(source: EventSource) -> int | None:
    """How many frames there will be, skipped ones included; None where nobody knows."""
    return source.frame_count if isinstance(source, Recording) else None


def wheel_count_of(source: EventSource) -> int | None:
    """How many wheel readings there will be; None where nobody knows."""
    return source.wheel_count if isinstance(source, Recording) else None


def path_of(source: EventSource) -> Path | None:
    """The folder it is read from, if any."""
    return source.path if isinstance(source, Recording) else None


def format_of(source: EventSource) -> str:
    """Its reader's name, or "live"."""
    return source.format if isinstance(source, Recording) else LIVE


def where(source: EventSource) -> str:
    """What messages call it: its folder, else its name."""
    return str(path_of(source) or source.name)


def spread(wanted: int, frame_count: int | None) -> list[int]:
    """Indices of so many frames, growing: evenly spread and none at the very ends, where their count is known."""
    if frame_count is None:
        return [_FIRST_FRAME * _LATER**number for number in range(wanted)]
    return [int((number + 0.5) * frame_count / wanted) for number in range(wanted)]


# Which odometry a run of a source follows, and what of the source it does not use.


def default_odometry(source: EventSource, config: Config) -> Choice:
    """`localizer.choose_odometry` by what the source has. Raises ConfigError."""
    elsewhere = source.wheels.where if isinstance(source, RealTimeRecording) and source.wheels is not None else ""
    sensors = Sensors(frame_count_of(source), wheel_count_of(source), elsewhere, where(source))
    return choose_odometry(source.calibration, config, sensors)


def resolved(source: EventSource, config: Config, parts: OwnParts = NO_PARTS) -> Config:
    """The configuration with its odometry named: `default_odometry` where it is automatic. Raises ConfigError."""
    if config.odometry and parts == NO_PARTS:
        return config
    return parts.named_in(config, default_odometry(source, config))


def unused_of(source: EventSource, config: Config, yaw_rates: int) -> tuple[str, ...]:
    """One sentence about each sensor of the source that a run of `config` does not use, and why.

    Args:
        source: what was followed.
        config: all settings of the run, its odometry named.
        yaw_rates: how many readings of a gyroscope came.
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
