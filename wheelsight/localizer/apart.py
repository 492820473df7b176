"""LocalizerApart: a localizer in a process of its own, which takes neither time nor Python's lock from control."""

from __future__ import annotations

import threading
import time
from multiprocessing import get_context
from typing import Any

from wheelsight.errors import DeviceError
from wheelsight.estimates import Estimate
from wheelsight.events import Event
from wheelsight.keyframes import KeyframeId, KeyframeStore
from wheelsight.localizer._apart_process import Answer, Beat, KeyframeNews, serve
from wheelsight.localizer.in_step import Make

# How long the end waits for a process that gives no sign of life, and for one that does while it writes its map.
_ENDING_S, _WRITING_S = 5.0, 300.0


class LocalizerApart:
    """Has another process answer; each call waits for it, so that `LocalizerBeside` is what a robot is led by.

    The process ends where this one does, however that ends; what was made is closed first. A process that hangs
    blocks `process`, as the navigator notices by the age of its answers; `close` kills it.

    Args:
        make: a function of a module, which the process imports: what answers, in a `with` block.
        arguments: of it.
        tells_keyframes: whether `keyframes` are kept here, too, of depth alone, as a floor that grows needs them.

    Raises what went wrong in making it, and DeviceError where the process has died.
    """

    def __init__(self, make: Make, *arguments: Any, tells_keyframes: bool = False) -> None:
        self.keyframes: KeyframeStore | None = KeyframeStore() if tells_keyframes else None
        self.recognised: int | None = None
        context = get_context("spawn")
        self._connection, theirs = context.Pipe()
        what = (theirs, make, arguments, tells_keyframes)
        self._process = context.Process(target=serve, args=what, name="wheelsight-localizer", daemon=True)
        self._is_over, self._calling = False, threading.Lock()
        self._process.start()
        theirs.close()
        self._take(self._heard())  # that it is ready: else the first event would have this for its answer

    def process(self, event: Event) -> Estimate | None:
        """As `Answering.process`. Raises what that raises, and DeviceError where the process has died."""
        with self._calling:
            self._say(event)
            return self._take(self._heard())

    def close(self) -> None:
        """Close what was made, and wait for that; may be called twice.

        A call of `process` that hangs ends by this: the process is killed, and that call raises DeviceError.
        Raises what went wrong in closing, and DeviceError where that hung.
        """
        if self._is_over:
            return
        if not self._calling.acquire(timeout=_ENDING_S):
            self._process.kill()
            self._process.join()
            return
        try:
            self._say(None)
            self._await_end()
            self._end()
        finally:
            self._calling.release()

    def _await_end(self) -> None:
        """Wait for the last answer while the process shows that it lives."""
        until_s = time.monotonic() + _WRITING_S
        while time.monotonic() < until_s and self._connection.poll(_ENDING_S):
            if isinstance(self._heard(), Answer):
                return
        self._process.kill()
        self._end()
        raise DeviceError("the process that localizes hung and was killed", fix="see what it had not yet written")

    def _say(self, event: Event | None) -> None:
        try:
            self._connection.send(event)
        except OSError:
            raise self._died() from None

    def _heard(self) -> Answer | Beat:
        """The next answer; raises the error that came instead."""
        try:
            answer = self._connection.recv()
        except (EOFError, OSError):
            raise self._died() from None
        if isinstance(answer, BaseException):
            self._end()
            raise answer
        assert isinstance(answer, Answer | Beat)
        return answer

    def _take(self, answer: Answer | Beat) -> Estimate | None:
        assert isinstance(answer, Answer)
        self.recognised = answer.recognised
        if self.keyframes is not None and answer.news is not None:
            _take_news(self.keyframes, answer.news)
        return answer.estimate

    def _died(self) -> DeviceError:
        self._end()
        code = self._process.exitcode
        how = f"by signal {-code}" if code is not None and code < 0 else f"with exit code {code}"
        return DeviceError(f"the process that localizes has ended {how}", fix="see whether memory ran out; begin anew")

    def _end(self) -> None:
        self._is_over = True
        self._process.join(_ENDING_S)
        if self._process.is_alive():
            self._process.kill()
            self._process.join()
        self._connection.close()


def _take_news(store: KeyframeStore, news: KeyframeNews) -> None:
    """Keep what is new, and move what has moved."""
    for keyframe, T_map_keyframe in news.added:
        store.add(keyframe, T_map_keyframe)
    if news.T_map_keyframe is not None:
        store.move([KeyframeId(number) for number in range(len(news.T_map_keyframe))], news.T_map_keyframe)
