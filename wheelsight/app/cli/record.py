"""`wheelsight record`: records the robot's sensors. Opens sensors and output, and shows the progress."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, get_args

from wheelsight.app.cli.console import console, print_note, print_warning, takes
from wheelsight.app.cli.options import OUTPUT, Topics, option_field
from wheelsight.app.cli.wheels import Baud, Seconds
from wheelsight.core.errors import ConfigError, OutputError
from wheelsight.core.runtime import needed, until_stopped

if TYPE_CHECKING:
    from collections.abc import Callable

    from wheelsight.core.calibration import Calibration
    from wheelsight.core.settings import LiveCameraSettings, RecorderSettings
    from wheelsight.io.devices.live_camera import LiveCamera
    from wheelsight.io.devices.recorder import LiveRecorder, RecordingSession, SessionStatus
    from wheelsight.io.recordings.native import LiveWriter
    from wheelsight_export.bag_writing import LiveBag

# A frame waits no longer on its way into a bag: readers put messages in order within half a second, and would leave out
# later ones.
_BAG_WAIT_S = 0.4
# A bag is readable up to the last flush; with `_BAG_WAIT_S` under a second, so that a program that dies loses no more.
# Each flush is a chunk of MCAP, with a line in its index.
_BAG_FLUSH_S = 0.5
_SENSORS = "Sensors"


@dataclass(frozen=True, slots=True)
class RecordOptions:
    """Options of `record`."""

    out: Path | None = option_field("Folder of the recording; made.", "DIR", False, OUTPUT)
    bag: Path | None = option_field("Write a bag of ROS 2, .mcap, in place of a folder.", "FILE", False, OUTPUT)
    color: str = option_field("How colour is kept: exactly, or small.", "png|jpeg", default="png", panel=OUTPUT)
    resume: bool = option_field("Go on with the recording in DIR.", default=False, panel=OUTPUT)
    force: bool = option_field("Overwrite a recording in DIR.", default=False, panel=OUTPUT)
    camera: str | None = option_field(
        "Camera: its kind, or kind:serial number; any for the first that is plugged in; recording:DIR plays one.",
        "NAME",
        "none",
        _SENSORS,
    )
    wheels: str | None = option_field("Serial port of the wheel controller.", "PORT", "none", _SENSORS)
    baud: Baud = 115200
    calibration: list[Path] | None = option_field(
        "calibration.yaml to put into the recording, over what the camera says of itself. May be given again.",
        "FILE",
        "none",
        _SENSORS,
    )
    infrared: bool = option_field("Infrared images too, where the camera has them.", default=False, panel=_SENSORS)
    topic: Topics = None
    seconds: Seconds = None
    config: Path | None = option_field("Settings in YAML: camera and recorder.", "FILE", False)


@takes(RecordOptions)
def record(options: RecordOptions) -> None:
    """Record a camera, wheels, or both until Ctrl-C, SIGTERM or SIGHUP, which `wheelsight run DIR` reads.

    Everything is on its way to the disk within a second, so whatever ends the recording leaves a valid one; --resume
    goes on with it. A camera or port that vanishes is waited for, and the other sensor goes on. Frames for which the
    disk is too slow are dropped, counted and reported. A recording without calibration.yaml is run with --calibration.

    [bold]Examples[/bold]

    wheelsight record --camera any --wheels /dev/ttyUSB0 --out corridor --calibration robot.yaml
    wheelsight record --camera realsense --color jpeg --out corridor
    wheelsight record --camera any --wheels /dev/ttyUSB0 --out corridor --resume
    wheelsight record --wheels /dev/ttyUSB0 --out square --seconds 60
    wheelsight record --camera any --wheels /dev/ttyUSB0 --calibration robot.yaml --bag corridor.mcap
    """
    with until_stopped() as is_over, opened_recording(options) as session, shown_looks(options.seconds) as show:
        session.run(is_over, show, options.seconds)


@contextmanager
def opened_recording(asked: RecordOptions) -> Iterator[RecordingSession]:
    """Open sensors and recording for the block. A refusal leaves no folder; the end prints a summary.

    Raises InputError.
    """
    from wheelsight.app.cli.wheels import note_status
    from wheelsight.core.files import new_output_folder
    from wheelsight.core.settings import LiveCameraSettings, RecorderSettings
    from wheelsight.io.devices import WheelLink, host_clock
    from wheelsight.io.devices.recorder import LiveRecorder, RecordingSession
    from wheelsight.io.recordings import RecordingWriter

    out, force, resume = place_of(asked.out, asked.bag), asked.force, asked.resume
    _check(asked)
    of_camera, of_recorder = LiveCameraSettings(), RecorderSettings()
    if asked.config is not None:
        from wheelsight.config import load_config  # takes seconds, which a robot that stands ready need not wait

        config = load_config(asked.config)
        of_camera, of_recorder = config.camera, config.recorder
    infrared, topics = of_camera.infrared or asked.infrared, tuple(asked.topic or ()) or of_camera.topics
    of_camera = of_camera.model_copy(update={"infrared": infrared, "topics": topics})
    bag = out if isinstance(out, BagPlace) else None
    folder = out.path.parent if isinstance(out, BagPlace) else out
    if bag is not None:
        bag.check(has_infrared=asked.infrared, force=force, resume=resume)
        of_recorder = bag.settings(of_recorder)
    with ExitStack() as opened:
        # refused before a device is touched
        opened.enter_context(new_output_folder(folder, force or resume or bag is not None))
        camera, calibration = _camera(asked, of_camera, folder if resume else None, opened)
        link = None
        if asked.wheels is not None:
            link = opened.enter_context(WheelLink(asked.wheels, asked.baud, note_status(asked.wheels)))
        writer: LiveWriter
        if bag is not None:
            writer = bag.writer(calibration, asked.color)
        else:
            writer = RecordingWriter(folder, calibration, force, color=asked.color, resume=resume)  # type: ignore[arg-type]
        recorder = opened.enter_context(LiveRecorder(writer, of_recorder))
        # Stamps in the future mean that the clock was set back.
        ahead_s = writer.last_stamp_s - host_clock.now_s()
        if ahead_s > 0:
            problem = f"its last stamp lies {ahead_s:.0f} s in the future: the clock was set back"
            raise OutputError(problem, path=folder, fix="set this computer's clock, or record into another --out")
        opened.callback(print_end, writer, recorder, folder if bag is None else bag.path, camera is not None)
        yield RecordingSession(recorder, folder, camera, link, note)


def _check(asked: RecordOptions) -> None:
    from wheelsight.io.recordings.images import ColorFormat

    if asked.camera is None and asked.wheels is None:
        raise ConfigError("there is nothing to record", fix="--camera NAME, --wheels PORT, or both")
    if (asked.wheels or "").startswith("ros2:"):
        raise ConfigError("--wheels ros2:… is of run --live", fix="record topics by ros2 bag record; its bags are read")
    if asked.color not in get_args(ColorFormat):
        raise ConfigError(f"--color is {asked.color!r}", fix=f"one of {', '.join(get_args(ColorFormat))}")
    if asked.force and asked.resume:
        raise ConfigError("--force starts over and --resume does not", fix="one of them")
    if asked.infrared and asked.camera is None:
        raise ConfigError("--infrared is of a camera", fix="add --camera NAME")
    if asked.topic and not (asked.camera or "").startswith(("recording:", "ros2:")):
        raise ConfigError("--topic is of a bag, or of ROS 2", fix="--camera recording:BAG, or leave it out")


def _camera(
    asked: RecordOptions, settings: LiveCameraSettings, resumed: Path | None, opened: ExitStack
) -> tuple[LiveCamera | None, Calibration | None]:
    """The camera, if any, and the calibration of the recording. Raises DeviceError, CalibrationError."""
    from wheelsight.app.cli.console import print_warning
    from wheelsight.app.cli.options import robot_camera
    from wheelsight.core.calibration import load_calibration
    from wheelsight.io.recordings.native import resumed_calibration

    # That of the resumed recording overrides the camera's.
    known = None if resumed is None else resumed_calibration(resumed)
    if known is not None and asked.calibration:
        raise ConfigError("--resume goes by the recording's own calibration", fix="leave out --calibration")
    if asked.camera is None:
        return None, known or (load_calibration(*asked.calibration) if asked.calibration else None)
    camera, calibration = robot_camera(asked.camera, settings, asked.calibration or (), known)
    opened.callback(camera.close)
    for warning in camera.warnings:
        print_warning(warning)
    return camera, calibration


@dataclass(frozen=True, slots=True)
class BagPlace:
    """The path of a bag to write."""

    path: Path

    def check(self, *, has_infrared: bool, force: bool, resume: bool) -> None:
        """Check a bag before a device is opened. Raises ConfigError, OutputError."""
        from wheelsight.app.cli.options import check_out
        from wheelsight_export.bag_writing import check_growing_name

        if resume:
            raise ConfigError("a bag cannot be resumed", fix="choose another name: a folder is read as one bag")
        if has_infrared:
            raise ConfigError("--infrared is not kept in bags", fix="record into a folder, --out")
        check_growing_name(self.path)
        needed("rosbags")
        check_out(self.path, force)

    def settings(self, of_recorder: RecorderSettings) -> RecorderSettings:
        """Settings in which frames wait no longer than readers of bags."""
        wait_s = min(of_recorder.longest_wait_s, _BAG_WAIT_S)
        return of_recorder.model_copy(update={"longest_wait_s": wait_s})

    def writer(self, calibration: Calibration | None, color: str) -> LiveBag:
        """The writer of the bag. Raises CalibrationError, OutputError."""
        from wheelsight_export.bag_writing import LiveBag

        return LiveBag(self.path, calibration, color, _BAG_FLUSH_S)  # type: ignore[arg-type]


def place_of(out: Path | None, bag: Path | None) -> Path | BagPlace:
    """The output of --out or --bag. Raises ConfigError unless exactly one is given."""
    if out is not None and bag is not None:
        raise ConfigError("--out and --bag are two recordings", fix="one of them; `wheelsight export` makes the other")
    if bag is not None:
        return BagPlace(bag)
    if out is None:
        raise ConfigError("--out or --bag is needed", fix="--out DIR, or --bag FILE.mcap")
    return out


# A line for a log, where no terminal watches.
_LINE_EVERY_S = 10.0


def line_of(look: SessionStatus, width: int, seconds: float | None = None) -> str:
    """Time, count, rate, drops by cause, disk: with all words where there is room, else with few.

    Of a recording that ends after some seconds the time says of how many.
    """
    causes = " ".join(f"{_short(cause)} {count}" for cause, count in look.drops.items())
    few = f"{sum(look.drops.values())} dropped" if causes else ""
    lines = [" · ".join(_words(look, seconds, are_few)) for are_few in (False, True)]
    lines += [" ".join(_fewest_words(look, seconds, f"dropped: {causes}" if causes else ""))]
    lines += [" ".join(_fewest_words(look, seconds, few, has_speed=has_speed)) for has_speed in (True, False)]
    return next((line for line in lines if len(line) <= width), lines[-1][: max(width, 0)])


def _words(look: SessionStatus, seconds: float | None, are_few: bool) -> Iterator[str]:
    yield _time_of(look, seconds, "/" if are_few else " of ")
    if look.camera is not None:
        yield f"{look.recorder.frames} frames, {look.frames_per_s:.1f}/s"
    if look.link is not None:
        yield f"{look.recorder.readings} {'wheels' if are_few else 'wheel readings'}, {look.readings_per_s:.0f}/s"
    if look.camera is not None:
        named = _short if are_few else str
        causes = ", ".join(f"{named(cause)} {count}" for cause, count in look.drops.items())
        yield f"{sum(look.drops.values())} dropped ({causes})" if causes else "0 dropped"
    if are_few:
        yield f"{look.bytes_per_s / 1e6:.0f} MB/s"
        yield f"{_bytes(look.free_bytes)}{_left(look, ' = ')}"
    else:
        yield f"{look.bytes_per_s / 1e6:.1f} MB/s, {_bytes(look.free_bytes)} free{_left(look, ', full in ')}"


def _fewest_words(look: SessionStatus, seconds: float | None, drops: str, *, has_speed: bool = True) -> Iterator[str]:
    yield _time_of(look, seconds, "/")
    if look.camera is not None:
        yield f"{look.recorder.frames} fr {look.frames_per_s:.0f}/s"
    if look.link is not None:
        counted = f"{look.recorder.readings} " if look.camera is None else ""
        yield f"{counted}{look.readings_per_s:.0f} wh/s"
    if drops:
        yield drops
    if has_speed:
        yield f"{look.bytes_per_s / 1e6:.0f} MB/s"
    yield f"{_bytes(look.free_bytes)}{_left(look, '=')}"


def _time_of(look: SessionStatus, seconds: float | None, of: str) -> str:
    return clock_of(look.seconds) if seconds is None else f"{clock_of(look.seconds)}{of}{clock_of(seconds)}"


def _short(cause: str) -> str:
    """The last word of a cause, such as "disk" of "slow disk"."""
    return cause.split()[-1]


def clock_of(seconds: float) -> str:
    """Minutes and seconds, such as "12:05"."""
    return f"{int(seconds) // 60}:{int(seconds) % 60:02d}"


def _left(look: SessionStatus, before: str) -> str:
    """How long the free space lasts; "" if unknown."""
    if look.full_after_s is None:
        return ""
    minutes = look.full_after_s / 60
    left = f"{minutes:.0f} min" if minutes < 100 else f"{minutes / 60:.0f} h"
    return f"{before}{left}"


def _bytes(count: int) -> str:
    return f"{count / 1e6:.0f} MB" if count < 1e9 else f"{count / 1e9:.0f} GB"


@contextmanager
def shown_looks(seconds: float | None = None) -> Iterator[Callable[[SessionStatus], None]]:
    """Show the state of a recording: a changing line on a terminal, else a line every ten seconds."""
    stderr = console(stderr=True)
    if stderr.is_terminal:
        with stderr.status("") as line:
            yield lambda look: line.update(line_of(look, stderr.width - 2, seconds))
        return
    shown_s = [time.monotonic()]

    def show(look: SessionStatus) -> None:
        if time.monotonic() - shown_s[0] >= _LINE_EVERY_S:
            shown_s[0] = time.monotonic()
            stderr.print(line_of(look, stderr.width, seconds))

    yield show


def note(text: str) -> None:
    """Print an event with its time on stderr."""
    print_note(f"{time.strftime('%H:%M:%S')} {text}")


def print_end(writer: LiveWriter, recorder: LiveRecorder, out: Path, has_camera: bool) -> None:
    """Print the contents of the recording, and what was dropped."""
    recorder.close()
    report = recorder.report()
    frames = f"{writer.frames} frames and " if has_camera else ""
    turns = f", and {report.turns} of the camera's gyroscope," if report.turns else ""
    print_note(f"{frames}{writer.readings} wheel readings{turns} are in {out}")
    if report.dropped:
        share = 100 * report.dropped / (report.dropped + report.frames)
        text = f"{report.dropped} frames ({share:.1f} %) were dropped: the disk or the encoding was too slow"
        print_warning(f"{text} (--color jpeg, or a faster disk)")
