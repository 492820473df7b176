"""give_back: memory that was freed goes back to the system, where the C library would keep it."""

from __future__ import annotations

import ctypes
import gc
from contextlib import suppress


def give_back() -> None:
    """Have glibc hand back all pages that are free; elsewhere nothing happens. It takes some 20 ms: not while driving.

    Loading kernels needs much for a moment, in small pieces that lie between others: by itself glibc gives back the end
    of its heap alone.
    """
    gc.collect()
    with suppress(OSError, AttributeError, TypeError):  # no glibc
        ctypes.CDLL(None).malloc_trim(0)
