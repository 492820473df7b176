"""What a run goes by: a recording, at once or in its time, or sensors as they are just now."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import AbstractContextManager, ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from wheelsight.errors import ConfigError

if TYPE_CHECKING:
    from wheelsight.calibration import Calibration
    from wheelsight.cli._run_options import RunOptions
    from wheelsight.config import Config
    from wheelsight.devices.recorder import LiveRecorder
    from wheelsight.pipeline import LiveSensors, LiveSource
    from wheelsight.sources import EventSource


@dataclass(frozen=True, slots=True)
class LiveRun:
    """The options that say so."""

    live: bool
    recording: Path | None
    camera: str | None
    wheels: str | None
    seconds: float | None
    record: Path | None
    calibration: tuple[str, ...]
    baud: int | None

    @classmethod
    def of(cls, given: RunOptions) -> LiveRun:
        """Those that were typed."""
        sensors = given.recording, given.camera, given.wheels
        return cls(given.live, *sensors, given.seconds, given.record, tuple(given.calibration or ()), given.baud)

    def check(self, realtime: bool, wheels_from: str | None) -> None:
        """Raises ConfigError for options that mean nothing together."""
        if not self.live:
            needs = {"--wheels": self.wheels, "--seconds": self.seconds, "--record": self.record}
            if given := [option for option, value in needs.items() if value is not None]:
                raise ConfigError(f"{given[0]} is of a live run", fix="add --live, or leave it out")
            if self.recording is None:
                raise ConfigError("no recording is named", fix="wheelsight run RECORDING, or --live --camera NAME")
            return
        if self.recording is not None:
            raise ConfigError("--live follows sensors, no recording", fix="leave one of them out")
        if realtime or wheels_from is not None:
            raise ConfigError("--realtime plays a recording", fix="with --live, --wheels PORT alone")
        if self.camera is None and self.wheels is None:
            raise ConfigError("there is nothing to listen to", fix="--camera NAME, --wheels PORT, or both")

    def source(
        self, settings: Config, out: Path, realtime: bool, wheels_from: str | None, force: bool
    ) -> AbstractContextManager[EventSource]:
        """What the run goes by, for a block. Raises InputError."""
        from wheelsight.cli._options import open_source
        from wheelsight.cli._run_progress import played

        if self.live:
            return _opened(self, settings, out, force)
        assert self.recording is not None
        recording = open_source(self.recording, settings)
        return played(recording, realtime, wheels_from, self.baud, settings.realtime)


@contextmanager
def _opened(asked: LiveRun, settings: Config, out: Path, force: bool) -> Iterator[LiveSource]:
    """Sensors, kernels and what is recorded, ready for the first event."""
    from wheelsight.cli._compiling import compile_missing
    from wheelsight.cli._console import print_note
    from wheelsight.cli._record_view import note
    from wheelsight.files import new_output_folder
    from wheelsight.interrupts import until_stopped
    from wheelsight.pipeline import LiveSource
    from wheelsight.pipeline.kernels import parts_of

    with ExitStack() as opened:
        opened.enter_context(new_output_folder(out, force))  # refused before a device is touched
        compile_missing(parts_of(settings))  # minutes, in which a camera had better not run
        sensors = _sensors(asked, settings, force, opened)
        told = f"for {asked.seconds:g} s" if asked.seconds is not None else "until Ctrl-C"
        yield LiveSource(
            sensors,
            lambda: until_stopped(asked.seconds),
            lambda: print_note(f"ready; following {told}"),
            note,
            settings.realtime,
        )


def _sensors(asked: LiveRun, settings: Config, force: bool, opened: ExitStack) -> LiveSensors:
    """Raises DeviceError, CalibrationError, OutputError."""
    from wheelsight.calibration import load_calibration
    from wheelsight.cli.wheels import note_status
    from wheelsight.devices import BAUDRATE, WheelLink
    from wheelsight.devices.robot_camera import open_robot_camera
    from wheelsight.pipeline import LiveSensors

    camera = None
    if asked.camera is not None:
        of_camera = settings.camera.model_copy(update={"topics": settings.recording.topics or settings.camera.topics})
        camera, calibration = open_robot_camera(asked.camera, of_camera, asked.calibration)
        opened.callback(camera.close)
    elif asked.calibration:
        calibration = load_calibration(*asked.calibration)
    else:
        raise ConfigError("nothing says how large the wheels are", fix="--calibration FILE")
    link = None
    if asked.wheels is not None:
        link = opened.enter_context(WheelLink(asked.wheels, asked.baud or BAUDRATE, note_status(asked.wheels)))
    recorder = None if asked.record is None else _recorder(asked.record, calibration, settings, force, opened)
    return LiveSensors(calibration, camera, link, recorder)


def _recorder(folder: Path, calibration: Calibration, settings: Config, force: bool, opened: ExitStack) -> LiveRecorder:
    """What keeps all that is heard. Raises OutputError."""
    from wheelsight.cli._record_view import tell_end
    from wheelsight.devices.recorder import LiveRecorder
    from wheelsight.recordings import RecordingWriter

    writer = RecordingWriter(folder, calibration, force)
    recorder = opened.enter_context(LiveRecorder(writer, settings.recorder))
    opened.callback(tell_end, writer, recorder, folder, calibration.color is not None)
    return recorder
