"""OniPlayer: an `.oni` file that OpenNI2 plays in a process of its own, since damaged files crash or hang that library.

The process answers in plain numbers and arrays, which are checked here: what takes it over gains nothing by that.
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
# Without any word, which comes before the file is opened, and five times a second while it plays.
_HANGING_S = 5.0
_READ_S, _PIECE_BYTES = 0.2, 1 << 20
_MOST_MEMORY = 1 << 30  # bytes beside what Python and numpy take
_LENGTH = struct.Struct("<I")
_MOST_TEXT = 1 << 16
# Of one image in each part of an answer: name, type, values a pixel.
_PARTS = (("color", np.uint8, 3), ("depth_m", np.float32, 1), ("infrared", np.uint16, 1))


class OniPlayer:
    """A `CameraDriver` of a file.

    Args:
        path: of the file.
        settings: as of `OpenNI2Driver`.
    """

    def __init__(self, path: str, settings: LiveCameraSettings) -> None:
        self._path, self._settings = path, settings
        self._process: subprocess.Popen[bytes] | None = None
        self._got, self._wanted = bytearray(), 0  # of the next answer, as far as it has come, and its bytes
        self._silent_s = 0.0

    def open(self) -> OpenedDevice:
        """As `CameraDriver` has it. Raises DeviceError where the file is none, or OpenNI2 crashes or hangs on it."""
        open_binary(self._path, _FILE, DeviceError).close()
        self.close()
        here = str(Path(__file__).parents[3])
        paths = os.pathsep.join(part for part in (here, os.environ.get("PYTHONPATH")) if part)
        self._process = subprocess.Popen(
            [*_COMMAND, self._path, self._settings.model_dump_json()],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            env=os.environ | {"PYTHONPATH": paths},
            start_new_session=True,  # Ctrl-C is for this process, which then ends that one
        )
        self._got, self._wanted, self._silent_s = bytearray(), 0, 0.0
        try:
            return self._opened()
        except (InputError, ValueError, TypeError, LookupError) as error:
            self.close()
            if isinstance(error, DeviceError):
                raise
            problem = error.problem if isinstance(error, InputError) else f"OpenNI2 gives no sound answer: {error}"
            raise DeviceError(problem, path=self._path, fix=_COPY) from error

    def read(self, timeout_s: float) -> DeviceImages | None:
        """As `CameraDriver` has it. Raises RecordingError where OpenNI2 fails, crashes or hangs: that is final."""
        ends_s = time.monotonic() + timeout_s
        try:
            while (left_s := ends_s - time.monotonic()) > 0:
                answer, data = self._answer(left_s, _HANGING_S)
                if answer is not None and "images" in answer:
                    return _images(answer, data)
                if answer is not None:
                    self._refuse_end(answer)
        except PlaybackEndedError:
            raise
        except DeviceError as error:
            raise RecordingError(error.problem, path=self._path, fix=error.fix) from error
        except (ValueError, TypeError, LookupError) as error:
            raise RecordingError(f"OpenNI2 gives no sound answer: {error}", path=self._path, fix=_COPY) from error
        return None

    def close(self) -> None:
        """As `CameraDriver` has it."""
        process, self._process = self._process, None
        if process is not None:
            process.kill()
            process.wait()
            for pipe in (process.stdin, process.stdout):
                assert pipe is not None
                pipe.close()

    def _opened(self) -> OpenedDevice:
        hanging_s = _OPENING_S
        while True:
            answer, _ = self._answer(_READ_S, hanging_s)
            if answer is None:
                continue
            self._refuse_end(answer)
            hanging_s = _HANGING_S
            if "name" in answer:
                calibration = parse_calibration(str(answer["calibration"]), self._path)
                return OpenedDevice(str(answer["name"]), calibration, tuple(map(str, answer["warnings"])))

    def _refuse_end(self, answer: dict[str, Any]) -> None:
        if answer.get("is_over"):
            raise PlaybackEndedError("the file is over", path=self._path)
        if "error" in answer:
            raise DeviceError(str(answer["error"]), path=self._path, fix=str(answer["fix"]) or _COPY)

    def _answer(self, timeout_s: float, hanging_s: float) -> tuple[dict[str, Any] | None, bytearray]:
        """The next answer and its arrays; None after a while without one. Raises RecordingError, ValueError."""
        found = self._taken()
        if found is None:
            assert self._process is not None
            assert self._process.stdout is not None
            began_s = time.monotonic()
            if select.select([self._process.stdout], [], [], timeout_s)[0]:
                piece = os.read(self._process.stdout.fileno(), _PIECE_BYTES)
                if not piece:
                    raise self._died()
                self._got += piece
                self._silent_s = 0.0
            else:
                self._silent_s += time.monotonic() - began_s
                if self._silent_s >= hanging_s:
                    raise self._hung()
            found = self._taken()
        return (None, bytearray()) if found is None else found

    def _taken(self) -> tuple[dict[str, Any], bytearray] | None:
        """An answer that has come whole. Raises ValueError where it is damaged."""
        if len(self._got) < max(self._wanted, _LENGTH.size):
            return None
        (length,) = _LENGTH.unpack_from(self._got)
        if length > _MOST_TEXT:
            raise ValueError(f"a text of {length} bytes")
        begin = _LENGTH.size + length
        if len(self._got) < begin:
            return None
        answer = parse_json(bytes(self._got[_LENGTH.size : begin]))
        if not isinstance(answer, dict):
            raise ValueError("no answer")
        end = begin + sum(int(np.prod(shape)) * np.dtype(dtype).itemsize for _, shape, dtype in _shapes(answer))
        if len(self._got) < end:
            self._wanted = end
            return None
        data = self._got[begin:end]
        del self._got[:end]
        self._wanted = 0
        return answer, data

    def _died(self) -> RecordingError:
        assert self._process is not None
        code = self._process.wait()
        how = f"crashed by {_signal(-code)}" if code < 0 else f"ended with exit code {code}"
        return RecordingError(f"OpenNI2 {how} on this file", path=self._path, fix=_COPY)

    def _hung(self) -> RecordingError:
        self.close()
        return RecordingError("OpenNI2 hung on this file and was ended", path=self._path, fix=_COPY)


def _signal(number: int) -> str:
    try:
        return signal.Signals(number).name
    except ValueError:
        return f"signal {number}"


def _shapes(answer: dict[str, Any]) -> list[tuple[str, tuple[int, ...], Any]]:
    """Name, shape and type of an answer's arrays. Raises ValueError for those that no camera has."""
    found: list[tuple[str, tuple[int, ...], Any]] = []
    for name, dtype, channels in _PARTS:
        size = answer.get("images", {}).get(name)
        if size is None:
            continue
        height, width = size
        if not (isinstance(height, int) and isinstance(width, int)) or min(height, width) < 0:
            raise ValueError(f"an image of {height!r} rows")
        if height * width > MOST_PIXELS:
            raise ValueError(f"an image of {width}×{height} pixels")
        found.append((name, (height, width, channels) if channels > 1 else (height, width), dtype))
    return found


def _images(answer: dict[str, Any], data: bytearray) -> DeviceImages:
    arrays: dict[str, NDArray[Any]] = {}
    at = 0
    for name, shape, dtype in _shapes(answer):
        size = int(np.prod(shape)) * np.dtype(dtype).itemsize
        arrays[name] = np.frombuffer(data, dtype, int(np.prod(shape)), at).reshape(shape)
        at += size
    color_s, depth_s = (None if answer[name] is None else float(answer[name]) for name in ("color_s", "depth_s"))
    sequence = None if answer["sequence"] is None else int(answer["sequence"])
    return DeviceImages(arrays["color"], arrays["depth_m"], color_s, depth_s, sequence, arrays.get("infrared"))


def play(path: str, settings: LiveCameraSettings, output: BinaryIO) -> None:
    """What the process does: answer what the file holds until it is over."""
    from wheelsight.io.devices.openni2 import OpenNI2Driver

    driver = OpenNI2Driver(path, settings)
    _say(output, {})
    try:
        opened = driver.open()
        text = yaml.safe_dump(calibration_fields(opened.calibration), sort_keys=False)
        _say(output, {"name": opened.name, "calibration": text, "warnings": list(opened.warnings)})
        while True:
            images = driver.read(_READ_S)
            if images is None:
                _say(output, {})
                continue
            arrays = {name: getattr(images, name) for name, _, _ in _PARTS}
            there = {name: np.ascontiguousarray(array) for name, array in arrays.items() if array is not None}
            about = {"color_s": images.color_s, "depth_s": images.depth_s, "sequence": images.sequence}
            sizes = {name: array.shape[:2] for name, array in there.items()}
            _say(output, {"images": sizes, **about}, *there.values())
    except PlaybackEndedError:
        _say(output, {"is_over": True})
    except InputError as error:
        _say(output, {"error": error.problem, "fix": error.fix or ""})


def _say(output: BinaryIO, answer: dict[str, Any], *arrays: NDArray[Any]) -> None:
    text = json.dumps(answer).encode()
    output.write(_LENGTH.pack(len(text)) + text)
    for array in arrays:
        output.write(array.data)
    output.flush()


def _end_with_parent() -> None:
    """A thread: end once the other end of standard input is closed, as it is when that process ends in any way."""
    while os.read(sys.stdin.fileno(), 1):
        pass
    os._exit(0)


def _limit() -> None:
    """Bound what a damaged file can take of memory and disk."""
    import resource

    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    with Path("/proc/self/statm").open() as stream:
        taken = int(stream.read().split()[0]) * os.sysconf("SC_PAGE_SIZE")
    resource.setrlimit(resource.RLIMIT_AS, (taken + _MOST_MEMORY, taken + _MOST_MEMORY))


def main() -> None:
    """The process; its output is for `OniPlayer` alone."""
    threading.Thread(target=_end_with_parent, daemon=True).start()
    output = os.fdopen(os.dup(sys.stdout.fileno()), "wb")
    os.dup2(2, 1)  # what the library prints
    settings = LiveCameraSettings.model_validate_json(sys.argv[2])
    _limit()
    with suppress(BrokenPipeError):
        play(sys.argv[1], settings, output)
    os._exit(0)  # the library may crash as it ends


if __name__ == "__main__":
    main()
