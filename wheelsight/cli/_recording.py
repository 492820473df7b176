"""Sensors opened for `wheelsight record`, and what is said in the end."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, get_args

from wheelsight.cli._recording_place import BagPlace
from wheelsight.errors import ConfigError, OutputError

if TYPE_CHECKING:
    from wheelsight.calibration import Calibration
    from wheelsight.devices import WheelLink
    from wheelsight.devices.live_camera import LiveCamera
    from wheelsight.devices.recording_session import RecordingSession
    from wheelsight.recordings.writer import LiveWriter
    from wheelsight.settings import LiveCameraSettings, RecorderSettings


@dataclass(frozen=True, slots=True)
class Sensors:
    """What is to be recorded, as the options say."""

    camera: str | None
    wheels: str | None
    calibration: tuple[Path, ...]
    infrared: bool
    baud: int
    config: Path | None
    topics: tuple[str, ...] = ()


@contextmanager
def opened_recording(
    asked: Sensors, out: Path | BagPlace, color: str, *, force: bool, resume: bool
) -> Iterator[RecordingSession]:
    """Sensors and recording opened for the block; what is refused leaves no folder, and what is over is told.

    Raises InputError.
    """
    from wheelsight.cli._record_view import note, tell_end
    from wheelsight.devices.recorder import LiveRecorder
    from wheelsight.devices.recording_session import RecordingSession
    from wheelsight.files import new_output_folder
    from wheelsight.recordings import RecordingWriter

    _check(asked, color, force=force, resume=resume)
    of_camera, of_recorder = _settings(asked)
    bag = out if isinstance(out, BagPlace) else None
    folder = out.path.parent if isinstance(out, BagPlace) else out
    if bag is not None:
        bag.check(has_infrared=asked.infrared, force=force, resume=resume)
        of_recorder = bag.settings(of_recorder)
    known = _known(asked, folder, resume)
    with ExitStack() as opened:
        # refused before a device is touched
        opened.enter_context(new_output_folder(folder, force or resume or bag is not None))
        camera, calibration = _camera(asked, of_camera, known, opened)
        link = _link(asked, opened)
        writer: LiveWriter
        if bag is not None:
            writer = bag.writer(calibration, color, of_recorder)
        else:
            writer = RecordingWriter(folder, calibration, force, color=color, resume=resume)  # type: ignore[arg-type]
        recorder = opened.enter_context(LiveRecorder(writer, of_recorder))
        _check_time(writer, folder)
        opened.callback(tell_end, writer, recorder, folder if bag is None else bag.path, camera is not None)
        yield RecordingSession(recorder, folder, camera, link, note)


def _check(asked: Sensors, color: str, *, force: bool, resume: bool) -> None:
    """Raises ConfigError for options that mean nothing, or nothing together."""
    from wheelsight.recordings.image_files import ColorFormat

    if asked.camera is None and asked.wheels is None:
        raise ConfigError("there is nothing to record", fix="--camera NAME, --wheels PORT, or both")
    if color not in get_args(ColorFormat):
        raise ConfigError(f"--color is {color!r}", fix=f"one of {', '.join(get_args(ColorFormat))}")
    if force and resume:
        raise ConfigError("--force begins anew and --resume does not", fix="one of them")
    if asked.infrared and asked.camera is None:
        raise ConfigError("--infrared is of a camera", fix="add --camera NAME")
    if asked.topics and not (asked.camera or "").startswith("recording:"):
        raise ConfigError("--topic is of a bag", fix="--camera recording:BAG, or leave it out")


def _known(asked: Sensors, out: Path, resume: bool) -> Calibration | None:
    """Of what is resumed, which stands whatever the camera says. Raises CalibrationError, ConfigError."""
    from wheelsight.recordings.resuming import resumed_calibration

    known = resumed_calibration(out) if resume else None
    if known is not None and asked.calibration:
        raise ConfigError("--resume goes by the recording's own calibration", fix="leave out --calibration")
    return known


def _camera(
    asked: Sensors, settings: LiveCameraSettings, known: Calibration | None, opened: ExitStack
) -> tuple[LiveCamera | None, Calibration | None]:
    """The camera, if any, and the calibration of what is recorded. Raises DeviceError, CalibrationError."""
    from wheelsight.calibration import load_calibration
    from wheelsight.cli._console import print_warning
    from wheelsight.devices.robot_camera import open_robot_camera

    if asked.camera is None:
        return None, known or (load_calibration(*asked.calibration) if asked.calibration else None)
    camera, calibration = open_robot_camera(asked.camera, settings, asked.calibration, known)
    opened.callback(camera.close)
    for warning in camera.warnings:
        print_warning(warning)
    return camera, calibration


def _settings(asked: Sensors) -> tuple[LiveCameraSettings, RecorderSettings]:
    """Of camera and recorder. Raises ConfigError."""
    from wheelsight.settings import LiveCameraSettings, RecorderSettings

    camera, recorder = LiveCameraSettings(), RecorderSettings()
    if asked.config is not None:
        from wheelsight.config import load_config  # takes seconds, which a robot that stands ready need not wait

        config = load_config(asked.config)
        camera, recorder = config.camera, config.recorder
    changes = {"infrared": camera.infrared or asked.infrared, "topics": asked.topics or camera.topics}
    return camera.model_copy(update=changes), recorder


def _link(asked: Sensors, opened: ExitStack) -> WheelLink | None:
    """Raises DeviceError."""
    from wheelsight.cli.wheels import note_status
    from wheelsight.devices import WheelLink

    if asked.wheels is None:
        return None
    return opened.enter_context(WheelLink(asked.wheels, asked.baud, note_status(asked.wheels)))


def _check_time(writer: LiveWriter, folder: Path) -> None:
    """Refuse to go on with a recording whose stamps are still to come. Raises OutputError."""
    from wheelsight.devices import host_clock

    ahead_s = writer.last_stamp_s - host_clock.now_s()
    if ahead_s > 0:
        problem = f"its last stamp lies {ahead_s:.0f} s in the future: the clock was set back"
        raise OutputError(problem, path=folder, fix="set this computer's clock, or record into another --out")
