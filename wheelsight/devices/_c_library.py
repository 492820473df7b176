"""C libraries that a system's packages bring, through ctypes."""

from __future__ import annotations

import ctypes
from collections.abc import Sequence
from contextlib import suppress

from wheelsight.errors import DeviceError


def c_library(called: str, files: Sequence[str], package: str) -> ctypes.CDLL:
    """The first of the files that the loader finds; a new one at each call.

    Args:
        called: name of the library, for the message.
        files: such as "libfreenect.so.0.5", the best first.
        package: Debian's, which brings it.

    Raises:
        DeviceError: none is there; says how to install it.
    """
    for name in files:
        with suppress(OSError):
            return ctypes.CDLL(name)
    raise DeviceError(f"{called} is missing", fix=f"sudo apt-get install {package}")
