"""`.oni` files that OpenNI2's own recorder makes of its own dummy camera, 320×240 at 30 Hz; no camera is needed."""

from __future__ import annotations

import ctypes as c
import subprocess
import sys
from pathlib import Path

import pytest

try:
    c.CDLL("libOpenNI2.so.0")
    WHY_MISSING = ""
except OSError:
    WHY_MISSING = "needs Debian's libopenni2-0"
needs_openni2 = pytest.mark.skipif(bool(WHY_MISSING), reason=WHY_MISSING)

# The player hands out no frame of a stream that has no cropping, and the dummy has none; a property that it passes over
# makes room for one that is off, so that nothing moves in the file.
_PASSED_OVER, _CROPPING = b"xnSupportedMapOutputModes\0", b"xnCropping\0"
_SIZE_OF_CROPPING = 12


def record_dummy(path: Path, seconds: float) -> None:
    """Record so long by the library's recorder, in a program of its own: the dummy survives no closing."""
    subprocess.run([sys.executable, "-c", _RECORDING, str(path), str(seconds)], check=True, timeout=60)
    path.write_bytes(with_cropping(path.read_bytes()))


_RECORDING = """
import ctypes as c, os, sys, time
lib = c.CDLL("libOpenNI2.so.0")
device, recorder, streams = c.c_void_p(), c.c_void_p(), [c.c_void_p(), c.c_void_p()]
assert lib.oniInitialize(2002) == 0
assert lib.oniDeviceOpen(b"Dummy", c.byref(device)) == 0
assert lib.oniCreateRecorder(sys.argv[1].encode(), c.byref(recorder)) == 0
for sensor, stream in zip((2, 3), streams):
    assert lib.oniDeviceCreateStream(device, sensor, c.byref(stream)) == 0
    assert lib.oniRecorderAttachStream(recorder, stream, 0) == 0
for stream in streams:
    assert lib.oniStreamStart(stream) == 0
assert lib.oniRecorderStart(recorder) == 0
time.sleep(float(sys.argv[2]))
lib.oniRecorderStop(recorder)
assert lib.oniRecorderDestroy(c.byref(recorder)) == 0
os._exit(0)
"""


def with_cropping(data: bytes) -> bytes:
    found = data
    size = _SIZE_OF_CROPPING.to_bytes(4, "little")
    at = found.find(_PASSED_OVER + size)
    while at >= 0:
        begin = at + len(_PASSED_OVER) + len(size)
        name = _CROPPING.ljust(len(_PASSED_OVER), b"\0")
        found = found[:at] + name + size + bytes(_SIZE_OF_CROPPING) + found[begin + _SIZE_OF_CROPPING :]
        at = found.find(_PASSED_OVER + size)
    assert found != data
    return found
