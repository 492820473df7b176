"""The one host clock that stamps of all devices are told in: seconds since 1970 that never run backwards."""

from __future__ import annotations

import time
from functools import cache


@cache
def unix_offset_s() -> float:
    """Seconds since 1970 at which the monotonic clock was 0, as the system had it when first asked for.

    Kept for the life of the program: where a time server sets the system's clock meanwhile, stamps of two devices
    would else differ by that step.
    """
    return time.time() - time.monotonic()


def now_s() -> float:
    """Now."""
    return unix_offset_s() + time.monotonic()
