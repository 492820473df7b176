"""`OniPlayer` plays an `.oni` file through OpenNI2 in another process, since damaged files crash or hang the library.

The process sends numbers and arrays, which are validated here, so that a file that takes it over gains nothing.
`python -m wheelsight.io.devices.oni_player FILE SETTINGS` is that process.
"""

from __future__ import annotations

import json
import os
import select
import signal
import struct
import subprocess
import sys
import threading
import time
from contextlib import suppress
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
import yaml
from numpy.typing import NDArray

from wheelsight.core.calibration import calibration_fields, parse_calibration
from wheelsight.core.errors import DeviceError, InputError, RecordingError
from wheelsight.core.geometry import MOST_PIXELS
from wheelsight.core.inputs import Kind, open_binary, parse_json
from wheelsight.core.settings import LiveCameraSettings
from wheelsight.io.devices.camera_driver import DeviceImages, OpenedDevice, PlaybackEndedError

_FILE = Kind("an .oni", 1 << 40, missing="there is no such file", fix="check the path")
_COPY = "copy the file again"
_COMMAND = [sys.executable, "-m", "wheelsight.io.devices.oni_player"]
# A start loads Python and numpy: 1 s, and more on a busy computer.
_OPENING_S = 30.0
# Longest silence. The process sends a message before it opens the file, and five times a second while it plays.
_HANGING_S = 5.0
_READ_S, _PIECE_BYTES = 0.2, 1 << 20
_MOST_MEMORY = 1 << 30  # bytes, beside those of Python and numpy
_LENGTH = struct.Struct("<I")
_MOST_TEXT = 1 << 16
# The images of a message: name, type, channels.
_PARTS = (("color", np.uint8, 3), ("depth_m", np.float32, 1), ("infrared", np.uint16, 1))


class OniPlayer:
    """A `CameraDriver` of a file.

    Args:
        settings: as for `OpenNI2Driver`.
    """

    def __init__(self, path: str, settings: LiveCameraSettings) -> None:
        self._path, self._settings = path, settings
        self._process: subprocess.Popen[bytes] | None = None
        self._got, self._wanted = bytearray(), 0  # received bytes of the next message, and its size
        self._silent_s = 0.0

    def open(self) -> OpenedDevice:
        """See `CameraDriver`. Raises DeviceError where the file is invalid, or OpenNI2 crashes or hangs on it."""
        open_binary(self._path, _FILE, DeviceError).close()
        self.close()
        paths = os.pathsep.join(filter(None, (str(Path(__file__).parents[3]), os.environ.get("PYTHONPATH"))))
        self._process = subprocess.Popen(
            [*_COMMAND, self._path, self._settings.model_dump_json()],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            env=os.environ | {"PYTHONPATH": paths},
            start_new_session=True,  # this process handles Ctrl-C and ends the other one
        )
        self._got, self._wanted, self._silent_s = bytearray(), 0, 0.0
        hanging_s = _OPENING_S
        try:
            while True:
                message, _ = self._receive(_READ_S, hanging_s)
                if message is None:
                    continue
                self._refuse_end(message)
                hanging_s = _HANGING_S
                if "name" in message:
                    calibration = parse_calibration(str(message["calibration"]), self._path)
                    return OpenedDevice(str(message["name"]), calibration, tuple(map(str, message["warnings"])))
        except (InputError, ValueError, TypeError, LookupError) as error:
            self.close()
            if isinstance(error, DeviceError):
                raise
            problem = error.problem if isinstance(error, InputError) else f"OpenNI2 sends an invalid message: {error}"
            raise DeviceError(problem, path=self._path, fix=_COPY) from error

    def read(self, timeout_s: float) -> DeviceImages | None:
        """See `CameraDriver`. Raises RecordingError, which is final, where OpenNI2 fails, crashes or hangs."""
        ends_s = time.monotonic() + timeout_s
        try:
            while (left_s := ends_s - time.monotonic()) > 0:
                message, data = self._receive(left_s, _HANGING_S)
                if message is None or "images" not in message:
                    self._refuse_end(message or {})
                    continue
                arrays: dict[str, NDArray[Any]] = {}
                at = 0
                for name, shape, dtype in _shapes(message):
                    count = int(np.prod(shape))
                    arrays[name] = np.frombuffer(data, dtype, count, at).reshape(shape)
                    at += count * np.dtype(dtype).itemsize
                stamps_s = (message["color_s"], message["depth_s"])
                color_s, depth_s = (None if stamp_s is None else float(stamp_s) for stamp_s in stamps_s)
                number = None if message["sequence"] is None else int(message["sequence"])
                infrared = arrays.get("infrared")
                return DeviceImages(arrays["color"], arrays["depth_m"], color_s, depth_s, number, infrared)
        except PlaybackEndedError:
            raise
        except DeviceError as error:
            raise RecordingError(error.problem, path=self._path, fix=error.fix) from error
        except (ValueError, TypeError, LookupError) as error:
            raise RecordingError(f"OpenNI2 sends an invalid message: {error}", path=self._path, fix=_COPY) from error
        return None

    def close(self) -> None:
        """See `CameraDriver`."""
        process, self._process = self._process, None
        if process is not None:
            process.kill()
            process.wait()
            for pipe in (process.stdin, process.stdout):
                assert pipe is not None
                pipe.close()

    def _refuse_end(self, message: dict[str, Any]) -> None:
        """Raise the end of the file, or an error, that a message reports."""
        if message.get("is_over"):
            raise PlaybackEndedError("the file is over", path=self._path)
        if "error" in message:
            raise DeviceError(str(message["error"]), path=self._path, fix=str(message["fix"]) or _COPY)

    def _receive(self, timeout_s: float, hanging_s: float) -> tuple[dict[str, Any] | None, bytearray]:
        """The next message and its arrays; None after the timeout. Raises RecordingError, ValueError."""
        found = self._taken()
        if found is None:
            assert self._process is not None
            assert self._process.stdout is not None
            began_s = time.monotonic()
            if select.select([self._process.stdout], [], [], timeout_s)[0]:
                piece = os.read(self._process.stdout.fileno(), _PIECE_BYTES)
                if not piece:
                    code = self._process.wait()
                    names = {number.value: number.name for number in signal.Signals}
                    by = names.get(-code, f"signal {-code}")
                    how = f"crashed by {by}" if code < 0 else f"ended with exit code {code}"
                    raise RecordingError(f"OpenNI2 {how} on this file", path=self._path, fix=_COPY)
                self._got += piece
                self._silent_s = 0.0
            else:
                self._silent_s += time.monotonic() - began_s
                if self._silent_s >= hanging_s:
                    self.close()
                    raise RecordingError("OpenNI2 hung on this file and was ended", path=self._path, fix=_COPY)
            found = self._taken()
        return (None, bytearray()) if found is None else found

    def _taken(self) -> tuple[dict[str, Any], bytearray] | None:
        """A message that is complete, or None. Raises ValueError where it is damaged."""
        if len(self._got) < max(self._wanted, _LENGTH.size):
            return None
        (length,) = _LENGTH.unpack_from(self._got)
        if length > _MOST_TEXT:
            raise ValueError(f"a text of {length} bytes")
        begin = _LENGTH.size + length
        if len(self._got) < begin:
            return None
        message = parse_json(bytes(self._got[_LENGTH.size : begin]))
        if not isinstance(message, dict):
            raise ValueError("no message")
        end = begin + sum(int(np.prod(shape)) * np.dtype(dtype).itemsize for _, shape, dtype in _shapes(message))
        if len(self._got) < end:
            self._wanted = end
            return None
        data = self._got[begin:end]
        del self._got[:end]
        self._wanted = 0
        return message, data


def _shapes(message: dict[str, Any]) -> list[tuple[str, tuple[int, ...], Any]]:
    """Name, shape and type of a message's arrays. Raises ValueError for an implausible shape."""
    found: list[tuple[str, tuple[int, ...], Any]] = []
    for name, dtype, channels in _PARTS:
        size = message.get("images", {}).get(name)
        if size is None:
            continue
        height, width = size
        if not (isinstance(height, int) and isinstance(width, int)) or min(height, width) < 0:
            raise ValueError(f"an image of {height!r} rows")
        if height * width > MOST_PIXELS:
            raise ValueError(f"an image of {width}×{height} pixels")
        found.append((name, (height, width, channels) if channels > 1 else (height, width), dtype))
    return found


def play(path: str, settings: LiveCameraSettings, output: BinaryIO) -> None:
    """Send the frames of a file until its end: the work of the other process."""
    from wheelsight.io.devices.openni2 import OpenNI2Driver

    driver = OpenNI2Driver(path, settings)
    _send(output, {})
    try:
        opened = driver.open()
        text = yaml.safe_dump(calibration_fields(opened.calibration), sort_keys=False)
        _send(output, {"name": opened.name, "calibration": text, "warnings": list(opened.warnings)})
        while True:
            images = driver.read(_READ_S)
            if images is None:
                _send(output, {})
                continue
            arrays = {name: getattr(images, name) for name, _, _ in _PARTS}
            there = {name: np.ascontiguousarray(array) for name, array in arrays.items() if array is not None}
            about = {"color_s": images.color_s, "depth_s": images.depth_s, "sequence": images.sequence}
            sizes = {name: array.shape[:2] for name, array in there.items()}
            _send(output, {"images": sizes, **about}, *there.values())
    except PlaybackEndedError:
        _send(output, {"is_over": True})
    except InputError as error:
        _send(output, {"error": error.problem, "fix": error.fix or ""})


def _send(output: BinaryIO, message: dict[str, Any], *arrays: NDArray[Any]) -> None:
    text = json.dumps(message).encode()
    output.write(_LENGTH.pack(len(text)) + text)
    for array in arrays:
        output.write(array.data)
    output.flush()


def main() -> None:
    """The other process, whose output only `OniPlayer` reads."""
    import resource

    def end_with_parent() -> None:
        while os.read(sys.stdin.fileno(), 1):  # standard input is closed when the parent ends in any way
            pass
        os._exit(0)

    threading.Thread(target=end_with_parent, daemon=True).start()
    output = os.fdopen(os.dup(sys.stdout.fileno()), "wb")
    os.dup2(2, 1)  # messages of the library
    settings = LiveCameraSettings.model_validate_json(sys.argv[2])
    # Bound memory and disk: a damaged file may ask for any amount.
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    with Path("/proc/self/statm").open() as stream:
        taken = int(stream.read().split()[0]) * os.sysconf("SC_PAGE_SIZE")
    resource.setrlimit(resource.RLIMIT_AS, (taken + _MOST_MEMORY, taken + _MOST_MEMORY))
    with suppress(BrokenPipeError):
        play(sys.argv[1], settings, output)
    os._exit(0)  # the library may crash as it ends


if __name__ == "__main__":
    main()
