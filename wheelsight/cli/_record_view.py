"""What `wheelsight record` shows while it runs: one line, as much of it as the terminal is wide."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

from wheelsight.cli._console import console, print_note, print_warning

if TYPE_CHECKING:
    from collections.abc import Callable

    from wheelsight.devices.recorder import LiveRecorder
    from wheelsight.devices.recording_session import SessionLook
    from wheelsight.recordings.writer import LiveWriter

# A line for a log, where no terminal watches.
_LINE_EVERY_S = 10.0


def line_of(look: SessionLook, width: int, seconds: float | None = None) -> str:
    """Time, count, rate, drops by cause, disk: with all words where there is room, else with few.

    Of a recording that ends after some seconds the time says of how many.
    """
    causes = " ".join(f"{_short(cause)} {count}" for cause, count in look.drops.items())
    few = f"{sum(look.drops.values())} dropped" if causes else ""
    lines = [" · ".join(_words(look, seconds, are_few)) for are_few in (False, True)]
    lines += [" ".join(_fewest_words(look, seconds, f"dropped: {causes}" if causes else ""))]
    lines += [" ".join(_fewest_words(look, seconds, few, has_speed=has_speed)) for has_speed in (True, False)]
    return next((line for line in lines if len(line) <= width), lines[-1][: max(width, 0)])


def _words(look: SessionLook, seconds: float | None, are_few: bool) -> Iterator[str]:
    yield _time_of(look, seconds, "/" if are_few else " of ")
    if look.camera is not None:
        yield f"{look.recorder.frames} frames, {look.frames_per_s:.1f}/s"
    if look.link is not None:
        yield f"{look.recorder.readings} {'wheels' if are_few else 'wheel readings'}, {look.readings_per_s:.0f}/s"
    if look.camera is not None:
        yield _drops(look, _short if are_few else str)
    if are_few:
        yield f"{look.bytes_per_s / 1e6:.0f} MB/s"
        yield f"{_bytes(look.free_bytes)}{_left(look, ' = ')}"
    else:
        yield f"{look.bytes_per_s / 1e6:.1f} MB/s, {_bytes(look.free_bytes)} free{_left(look, ', full in ')}"


def _fewest_words(look: SessionLook, seconds: float | None, drops: str, *, has_speed: bool = True) -> Iterator[str]:
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


def _time_of(look: SessionLook, seconds: float | None, of: str) -> str:
    return clock_of(look.seconds) if seconds is None else f"{clock_of(look.seconds)}{of}{clock_of(seconds)}"


def _drops(look: SessionLook, named: Callable[[str], str]) -> str:
    """Such as "3 dropped (slow disk 2, camera 1)"."""
    causes = ", ".join(f"{named(cause)} {count}" for cause, count in look.drops.items())
    return f"{sum(look.drops.values())} dropped ({causes})" if causes else "0 dropped"


def _short(cause: str) -> str:
    """Its last word, such as "disk" of "slow disk"."""
    return cause.split()[-1]


def clock_of(seconds: float) -> str:
    """Minutes and seconds, such as "12:05"."""
    return f"{int(seconds) // 60}:{int(seconds) % 60:02d}"


def _left(look: SessionLook, before: str) -> str:
    """How long the room lasts; nothing where nobody knows."""
    if look.full_after_s is None:
        return ""
    minutes = look.full_after_s / 60
    told = f"{minutes:.0f} min" if minutes < 100 else f"{minutes / 60:.0f} h"
    return f"{before}{told}"


def _bytes(count: int) -> str:
    return f"{count / 1e6:.0f} MB" if count < 1e9 else f"{count / 1e9:.0f} GB"


@contextmanager
def shown_looks(seconds: float | None = None) -> Iterator[Callable[[SessionLook], None]]:
    """What shows a look, of so many seconds if given: a line on a terminal that changes, or one every ten seconds."""
    stderr = console(stderr=True)
    if stderr.is_terminal:
        with stderr.status("") as line:
            yield lambda look: line.update(line_of(look, stderr.width - 2, seconds))
        return
    shown_s = [time.monotonic()]

    def show(look: SessionLook) -> None:
        if time.monotonic() - shown_s[0] >= _LINE_EVERY_S:
            shown_s[0] = time.monotonic()
            stderr.print(line_of(look, stderr.width, seconds))

    yield show


def note(text: str) -> None:
    """Say something that happened, with the time, on stderr."""
    print_note(f"{time.strftime('%H:%M:%S')} {text}")


def tell_end(writer: LiveWriter, recorder: LiveRecorder, out: Path, has_camera: bool) -> None:
    """What is in the folder by now, and what is not."""
    recorder.close()
    report = recorder.report()
    frames = f"{writer.frames} frames and " if has_camera else ""
    turns = f", and {report.turns} of the camera's gyroscope," if report.turns else ""
    print_note(f"{frames}{writer.readings} wheel readings{turns} are in {out}")
    if report.dropped:
        share = 100 * report.dropped / (report.dropped + report.frames)
        text = f"{report.dropped} frames ({share:.1f} %) were dropped: the disk or the encoding was too slow"
        print_warning(f"{text} (--color jpeg, or a faster disk)")
