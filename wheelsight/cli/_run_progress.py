"""What the progress bar says of a run, also in real time, and how a recording is opened for that."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING

from wheelsight.errors import ConfigError

if TYPE_CHECKING:
    from wheelsight.cli._progress import FrameProgress
    from wheelsight.config import Config
    from wheelsight.pipeline import InRealTime, RealTimeRecording
    from wheelsight.recordings import Recording
    from wheelsight.settings import RealTimeSettings
    from wheelsight.sources import EventSource


@contextmanager
def played(
    recording: Recording, realtime: bool, wheels_from: str | None, baud: int | None, settings: RealTimeSettings
) -> Iterator[Recording | RealTimeRecording]:
    """The recording as it is, or in real time, with wheels from elsewhere if asked for.

    Raises:
        ConfigError: something is given that another option is needed for.
        InputError: the wheels cannot be had.
    """
    from wheelsight.devices import BAUDRATE
    from wheelsight.pipeline import in_real_time

    if wheels_from is not None and not realtime:
        raise ConfigError("--wheels-from joins wheels that turn just now", fix="add --realtime")
    if baud is not None and wheels_from is None:
        raise ConfigError("--baud is the rate of a port", fix="add --wheels-from PORT")
    if not realtime:
        yield recording
        return
    with in_real_time(recording, wheels_from, baud or BAUDRATE, settings=settings) as live:
        yield live


def counts_frames(source: EventSource, settings: Config) -> bool:
    """Whether progress is that of frames passing by, some of them dropped."""
    from wheelsight.pipeline import InRealTime

    return isinstance(source, InRealTime) and settings.tracks != ("wheels",)


def expected(source: EventSource, settings: Config) -> tuple[int | None, str]:
    """How many events will be answered, where that is known, and their name; "" where their rate says nothing."""
    from wheelsight.pipeline.origin import frame_count_of, wheel_count_of

    frames, readings = frame_count_of(source), wheel_count_of(source)
    if counts_frames(source, settings):
        return frames, ""
    if settings.tracks == ("wheels",):
        return readings, "readings"
    if "wheels" not in settings.tracks:
        return frames, "frames"
    return None if frames is None or readings is None else frames + readings, "events"


def show_progress(progress: FrameProgress, source: EventSource, settings: Config, status: str) -> None:
    """One event more was answered; in real time also how well that keeps up."""
    from wheelsight.pipeline import InRealTime
    from wheelsight.pipeline.origin import frame_count_of

    if isinstance(source, InRealTime):
        status = " · ".join(filter(None, [status, words(source)]))
        if counts_frames(source, settings):
            progress.reach(source.frames_so_far[0], frame_count_of(source), status, rate_of(source))
            return
    progress.advance(status)


def rate_of(recording: InRealTime) -> str:
    """Of frames that were answered, such as "29.8 frames/s"; nothing before the first."""
    lately = recording.lately()
    return "" if lately is None else f"{lately[0]:.1f} frames/s"


def words(recording: InRealTime) -> str:
    """Such as "31 ms late, 12 dropped"."""
    parts = []
    if (lately := recording.lately()) is not None:
        parts.append(f"{1e3 * lately[1]:.0f} ms late")
    frames, dropped = recording.frames_so_far
    if frames:
        parts.append(f"{dropped} dropped")
    if recording.is_missing_wheels:
        parts.append("wheels silent")
    return ", ".join(parts)
