"""LocalizerBeside: a localizer as navigation asks for it, in a thread of its own."""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Sequence

from wheelsight.estimates import Estimate
from wheelsight.events import Event, RgbdFrame
from wheelsight.keyframes import KeyframeStore
from wheelsight.localizer.in_step import Answering
from wheelsight.threads import OneCaller, one_at_a_time, yield_to_others

# How long the end waits for an event that is being answered, before the localizer is closed beside it.
_ENDING_S = 5.0


class LocalizerBeside(OneCaller):
    """Answers in a thread of its own, which yields to the thread that controls a robot and never waits for a frame.

    Frames that come faster than they are answered are left out but for the newest; wheel readings never are.

    Args:
        localizer: that answers; used by nobody else from now on, and closed with this.

    Attributes:
        dropped: frames that were left out.
    """

    def __init__(self, localizer: Answering) -> None:
        self.localizer, self.dropped = localizer, 0
        self._waiting: deque[Event] = deque()
        self._answered: deque[tuple[Event, Estimate | None]] = deque()
        self._error: BaseException | None = None
        self._is_closed = False
        self._changed = threading.Condition()
        self._thread = threading.Thread(target=self._run, name="localizer", daemon=True)
        self._thread.start()

    @property
    def keyframes(self) -> KeyframeStore | None:
        """Of the localizer."""
        return self.localizer.keyframes

    @property
    def recognised(self) -> int | None:
        """Of the localizer."""
        return self.localizer.recognised

    @one_at_a_time
    def hear(self, events: Sequence[Event]) -> list[tuple[Event, Estimate | None]]:
        """What was answered since the last call. Raises what went wrong in the thread."""
        with self._changed:
            for event in events:
                self._put(event)
            self._changed.notify()
            if self._error is not None:
                raise self._error
            answered = list(self._answered)
            self._answered.clear()
        return answered

    def close(self) -> None:
        """End the thread, then the localizer's; may be called twice."""
        self._is_over = True
        with self._changed:
            self._is_closed = True
            self._changed.notify()
        self._thread.join(_ENDING_S)
        self.localizer.close()

    def _put(self, event: Event) -> None:
        if isinstance(event, RgbdFrame):
            older = [waiting for waiting in self._waiting if isinstance(waiting, RgbdFrame)]
            for frame in older:
                self._waiting.remove(frame)
            self.dropped += len(older)
        self._waiting.append(event)

    def _run(self) -> None:
        yield_to_others()
        try:
            while True:
                with self._changed:
                    self._changed.wait_for(lambda: self._is_closed or bool(self._waiting))
                    if self._is_closed:
                        return
                    event = self._waiting.popleft()
                estimate = self.localizer.process(event)
                with self._changed:
                    self._answered.append((event, estimate))
        except BaseException as error:  # told to whoever asks next
            self._error = error
