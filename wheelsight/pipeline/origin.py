"""What is known of a source before its first event: much of a recording, little of a live one."""

from __future__ import annotations

from pathlib import Path

from wheelsight.recordings import Recording
from wheelsight.sources import EventSource

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
