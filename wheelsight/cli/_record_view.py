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


def line_of(look: SessionLook, width: int) -> str:
    """Time, frames and readings a second, drops by cause, disk: with all words where there is room, else with few."""
    for are_few in (False, True):
        if len(text := " · ".join(_words(look, are_few))) <= width:
            return text
    causes = " ".join(f"{_short(cause)} {count}" for cause, count in look.drops.items())
    for drops in (f"dropped: {causes}", f"{sum(look.drops.values())} dropped"):
        if len(text := " ".join(_fewest_words(look, drops if causes else ""))) <= width:
            return text
    return text[: max(width, 0)]


def _words(look: SessionLook, are_few: bool) -> Iterator[str]:
    yield clock_of(look.seconds)
    if look.camera is not None:
        yield f"{look.frames_per_s:.1f} frames/s"
    if look.link is not None:
        yield f"{look.readings_per_s:.0f} {'wheels' if are_few else 'wheel readings'}/s"
    if look.camera is not None:
        yield _drops(look, _short if are_few else str)
    if are_few:
        yield f"{look.bytes_per_s / 1e6:.0f} MB/s"
        yield f"{_bytes(look.free_bytes)}{_left(look, ' = ')}"
    else:
        yield f"{look.bytes_per_s / 1e6:.1f} MB/s, {_bytes(look.free_bytes)} free{_left(look, ', full in ')}"


def _fewest_words(look: SessionLook, drops: str) -> Iterator[str]:
    yield clock_of(look.seconds)
    if look.camera is not None:
        yield f"{look.frames_per_s:.0f} fr/s"
    if look.link is not None:
        yield f"{look.readings_per_s:.0f} wh/s"
    if drops:
        yield drops
    yield f"{look.bytes_per_s / 1e6:.0f} MB/s"
    yield f"{_bytes(look.free_bytes)}{_left(look, '=')}"


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
def shown_looks() -> Iterator[Callable[[SessionLook], None]]:
    """What shows a look: a line on a terminal that changes, or one every ten seconds."""
    stderr = console(stderr=True)
    if stderr.is_terminal:
        with stderr.status("") as line:
            yield lambda look: line.update(line_of(look, stderr.width - 2))
        return
    shown_s = [time.monotonic()]

    def show(look: SessionLook) -> None:
        if time.monotonic() - shown_s[0] >= _LINE_EVERY_S:
            shown_s[0] = time.monotonic()
            stderr.print(line_of(look, stderr.width))

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
