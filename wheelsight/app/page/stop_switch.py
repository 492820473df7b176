"""StopSwitch stops a robot from its own thread, even if the rest of the program hangs; Watchdog finds what hangs."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable

from wheelsight.core.errors import WheelsightError
from wheelsight.core.robots import Robot

_ENDS_S = 2.0
# Until a robot that did not obey is stopped once more.
_AGAIN_S = 0.2
# Between two looks of the watchdog.
_LOOK_S = 0.05


class StopSwitch:
    """A stop switch for any thread; pressing never blocks.

    Args:
        robot: the robot. Its `stop` is called until it succeeds.

    Attributes:
        problem: error of the last `stop`; "" if it succeeded.
    """

    def __init__(self, robot: Robot) -> None:
        self._robot, self.problem = robot, ""
        self._lock, self._wake = threading.Lock(), threading.Event()
        self._reason, self._presses, self._is_closed = "", 0, False
        self._thread = threading.Thread(target=self._run, name="wheelsight-stop", daemon=True)
        self._thread.start()

    @property
    def reason(self) -> str:
        """Why the robot must stand; "" if it may move."""
        return self._reason

    @property
    def presses(self) -> int:
        """Number of presses."""
        return self._presses

    def press(self, reason: str) -> None:
        """Stop the robot now, and hold it until `release`."""
        with self._lock:
            self._presses += 1
            self._reason = self._reason or reason
        self._wake.set()

    def release(self, presses: int) -> bool:
        """Let the robot move again, unless the switch was pressed after the caller read `presses`."""
        with self._lock:
            if presses != self._presses:
                return False
            self._reason = ""
            return True

    def close(self) -> None:
        """End the thread; may be called twice."""
        self._is_closed = True
        self._wake.set()
        self._thread.join(_ENDS_S)

    def _run(self) -> None:
        while True:
            self._wake.wait(_AGAIN_S if self.problem else None)
            self._wake.clear()
            if self._is_closed:
                return
            if self.problem and not self._reason:
                # It moves again by another task: its `stop` that failed is over.
                self.problem = ""
                continue
            try:
                self._robot.stop()
                self.problem = ""
            except WheelsightError as error:
                self.problem = str(error)
            except Exception as error:
                # This thread is needed for the next press, whatever a robot's program does wrong.
                self.problem = f"{type(error).__name__}: {error}".partition("\n")[0]


class Watchdog:
    """Checks in its own thread that parts of a program do not hang.

    Args:
        limit_s: returns how long a part may be silent now; infinity: no limit.
        on_silent: called in the watchdog's thread with one line, once for each silence.
        on_again: called with one line when a silent part goes on.
    """

    def __init__(
        self, limit_s: Callable[[], float], on_silent: Callable[[str], None], on_again: Callable[[str], None]
    ) -> None:
        self._limit_s, self._on_silent, self._on_again = limit_s, on_silent, on_again
        self._beats: dict[str, float] = {}
        self._silent: dict[str, float] = {}
        self._over = threading.Event()
        self._thread = threading.Thread(target=self._run, name="wheelsight-watchdog", daemon=True)
        self._thread.start()

    def watch(self, part: str) -> Callable[[], None]:
        """Watch a part from now on; its name begins sentences. The part calls the returned function."""

        def beat() -> None:
            self._beats[part] = time.monotonic()

        beat()
        return beat

    def forget(self, part: str) -> None:
        """End the watch of a part; may be called twice."""
        self._beats.pop(part, None)
        self._silent.pop(part, None)

    def close(self) -> None:
        """End the thread; may be called twice."""
        self._over.set()
        self._thread.join(_ENDS_S)

    def _run(self) -> None:
        looked_s = time.monotonic()
        while not self._over.wait(_LOOK_S):
            now_s, limit_s = time.monotonic(), self._limit_s()
            stood_s, looked_s = now_s - looked_s - _LOOK_S, now_s
            if stood_s > limit_s:
                # All parts stood with it, and none of them is to blame.
                self._beats = dict.fromkeys(list(self._beats), now_s)
                self._on_silent(f"the program stood still for {stood_s:.1f} s")
                continue
            for part, beat_s in list(self._beats.items()):
                since_s = self._silent.get(part)
                if since_s is None and now_s - beat_s > limit_s:
                    self._silent[part] = beat_s
                    self._on_silent(f"{part} does not answer")
                elif since_s is not None and beat_s > since_s:
                    del self._silent[part]
                    self._on_again(f"{part} answers again after {beat_s - since_s:.1f} s")
