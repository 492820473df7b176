"""Signals and optional libraries. `end_by_signals` turns SIGINT, SIGTERM and SIGHUP into a tidy end;
`needed` imports an optional library or names the extra that installs it; `public_name` loads names at their first use.
"""

from __future__ import annotations

import os
import signal
import threading
import time
from collections.abc import Callable, Collection, Iterable, Iterator
from contextlib import contextmanager
from importlib import import_module
from types import FrameType
from typing import Any

from wheelsight.core.errors import ConfigError

# Ctrl-C, SIGTERM, and SIGHUP of a closed terminal end a program alike. The first begins a tidy end: the current step is
# finished, a robot is stopped, results are written. A second signal ends that wherever it is, and the system kills the
# program if it hangs. A third kills it at once.


ENDING: tuple[signal.Signals, ...] = tuple(
    getattr(signal, name) for name in ("SIGINT", "SIGTERM", "SIGHUP") if hasattr(signal, name)
)
_SIGHUP = getattr(signal, "SIGHUP", None)
# A closed terminal sends SIGHUP through its shell and by itself, and systemd SIGTERM and SIGHUP: one request each.
_ONE_REQUEST_S = 1.0
# Closing a camera and a serial line takes up to 3 s.
_FORCED_S = 5

_Handler = Callable[[int, FrameType | None], None]


class _Program:
    """Received signals, and the stage of the program's end.

    Args:
        is_ours: whether the program may be killed; else it only uses this package.
    """

    def __init__(self, *, is_ours: bool = False) -> None:
        self.asked: list[int] = []
        self._is_ours, self._last_s, self._begun = is_ours, 0.0, 0
        self._is_in_step, self._is_due = False, False

    def interrupt(self, number: int, _: FrameType | None) -> None:
        """The handler of a signal: raises KeyboardInterrupt, in a step at its end."""
        if not self.asks(number):
            return
        if self._is_in_step and not self._is_due:
            self._is_due = True
            return
        self._is_due = False
        self.begin_end()
        raise KeyboardInterrupt

    @contextmanager
    def whole_step(self) -> Iterator[None]:
        """See the function."""
        self._is_in_step = True
        try:
            yield
        finally:
            self._is_in_step = False
        if self._is_due:
            self._is_due = False
            self.begin_end()
            raise KeyboardInterrupt

    def asks(self, number: int) -> bool:
        """Note a signal; return False if it belongs to the previous request."""
        now_s = time.monotonic()
        is_close = bool(self.asked) and now_s - self._last_s < _ONE_REQUEST_S
        if is_close and (number == _SIGHUP or number not in self.asked):
            return False
        self._last_s = now_s
        self.asked.append(number)
        return True

    def begin_end(self) -> None:
        """Begin the tidy end; at the second call, limit it to `_FORCED_S`; at the third, end at once."""
        self._begun += 1
        if not self._is_ours or self._begun == 1:
            return
        if self._begun == 2:
            if hasattr(signal, "alarm"):
                # The system's own handler also ends compiled code.
                signal.signal(signal.SIGALRM, signal.SIG_DFL)
                signal.alarm(_FORCED_S)
            return
        signal.signal(self.asked[0], signal.SIG_DFL)
        os.kill(os.getpid(), self.asked[0])


_program: _Program | None = None


def end_by_signals() -> None:
    """Let SIGTERM and SIGHUP raise KeyboardInterrupt, as Ctrl-C does. For a program's entry.

    Signals that the program ignores at its start, such as SIGHUP under nohup, stay ignored.
    """
    global _program
    _program = _Program(is_ours=True)
    for number in ENDING:
        if signal.getsignal(number) in (signal.SIG_DFL, signal.default_int_handler):
            signal.signal(number, _program.interrupt)


def exit_code() -> int:
    """Return the exit code after a signal: 130 after Ctrl-C, 143 after SIGTERM, 129 after SIGHUP."""
    return 128 + (_program.asked[0] if _program is not None and _program.asked else signal.SIGINT)


def was_asked() -> bool:
    """Return whether a signal has asked this program to end, since `end_by_signals`."""
    return _program is not None and bool(_program.asked)


@contextmanager
def until_stopped(seconds: float | None = None) -> Iterator[Callable[[], bool]]:
    """Yield a function that returns whether a signal has arrived, or `seconds` have passed.

    A second signal raises KeyboardInterrupt. A SIGHUP that is ignored stays so.
    """
    program = _program or _Program()
    ends_s = None if seconds is None else time.monotonic() + seconds
    came: list[int] = []

    def stop(number: int, _: FrameType | None) -> None:
        if program.asks(number):
            came.append(number)
            program.begin_end()
            if len(came) > 1:
                raise KeyboardInterrupt

    ignored = [number for number in ENDING if number == _SIGHUP and signal.getsignal(number) is signal.SIG_IGN]
    with _handled([number for number in ENDING if number not in ignored], stop):
        yield lambda: bool(came) or (ends_s is not None and time.monotonic() >= ends_s)


@contextmanager
def whole_step() -> Iterator[None]:
    """Delay KeyboardInterrupt by a first signal to the end of the block; a second one raises it at once.

    It applies only to signals that would raise it; a program's own handlers and other threads do not change.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
    elif _program is not None:
        with _program.whole_step():
            yield
    elif signal.getsignal(signal.SIGINT) is signal.default_int_handler:
        program = _Program()
        with _handled([signal.SIGINT], program.interrupt), program.whole_step():
            yield
    else:
        yield


@contextmanager
def _handled(numbers: list[signal.Signals], handler: _Handler) -> Iterator[None]:
    before = {number: signal.signal(number, handler) for number in numbers}
    try:
        yield
    finally:
        for number, handler_before in before.items():
            signal.signal(number, handler_before)


# By imported name: the library, and the packages to install.
_EXTRAS = {
    "av": ("PyAV", "av"),
    "backports": ("backports.zstd", "rosbags"),
    "cyclonedds": ("Cyclone DDS", "cyclonedds rosbags"),
    "compression": ("compression.zstd", "rosbags"),
    "distributed": ("Dask", "distributed"),
    "gtsam": ("GTSAM", "gtsam"),
    "lz4": ("lz4", "rosbags"),
    "mujoco": ("MuJoCo", "mujoco matplotlib"),
    "octomap": ("octomap-python", "octomap-python"),
    "plotly": ("plotly", "plotly"),
    "rosbags": ("rosbags", "rosbags"),
    "pyrealsense2": ("pyrealsense2", "pyrealsense2"),
    "rerun": ("Rerun", "rerun-sdk"),
    "skimage": ("scikit-image", "scikit-image"),
    "sklearn": ("scikit-learn", "scikit-learn skops"),
    "starlette": ("Starlette", "starlette uvicorn websockets"),
    "uvicorn": ("uvicorn", "starlette uvicorn websockets"),
    "websockets": ("websockets", "starlette uvicorn websockets"),
    "skops": ("skops", "scikit-learn skops"),
    "zenoh": ("Zenoh", "eclipse-zenoh rosbags"),
}


def needed(module: str) -> Any:
    """Return a module of an optional library, such as "skops.io".

    Raises:
        ConfigError: the library is not installed, with the command that installs it.
    """
    library, libraries = _EXTRAS[module.partition(".")[0]]
    try:
        return import_module(module)
    except ImportError as error:
        raise ConfigError(f"{library} is missing", fix=f"pip install {libraries}") from error


def why_missing(library: str) -> str | None:
    """Return the message for a missing optional library, by imported name; None if it is installed."""
    try:
        needed(library)
    except ConfigError as error:
        return str(error)
    return None


def public_name(package: str, name: str, names: Collection[str], modules: Iterable[str]) -> Any:
    """Return a public name of a package, for its `__getattr__`, from the first of its modules that has it.

    The command line loads packages beside wheelsight for their commands alone; their modules wait for this.

    Raises AttributeError for other names.
    """
    if name not in names:
        raise AttributeError(f"module {package!r} has no attribute {name!r}")
    loaded = (import_module(f"{package}.{module}") for module in modules)
    return next(getattr(module, name) for module in loaded if hasattr(module, name))
