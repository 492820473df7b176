"""LocalizerInStep and LocalizerBeside: a localizer as navigation asks for it, in the caller's thread or in its own."""

from __future__ import annotations

import queue
import threading
from collections.abc import Sequence

from wheelsight.estimates import Estimate
from wheelsight.events import Event
from wheelsight.keyframes import KeyframeStore
from wheelsight.localizer.localizer import Localizer

Answered = tuple[Event, Estimate | None]


class LocalizerInStep:
    """Answers all that it is told before it goes on: equal events, equal answers. For simulators.

    Args:
        localizer: that answers; closed with this.
    """

    def __init__(self, localizer: Localizer) -> None:
        self.localizer = localizer

    @property
    def keyframes(self) -> KeyframeStore | None:
        """Of the localizer."""
        return self.localizer.keyframes

    def hear(self, events: Sequence[Event]) -> list[Answered]:
        """Each event with its answer. Raises what `Localizer.process` raises."""
        return [(event, self.localizer.process(event)) for event in events]

    def close(self) -> None:
        """End the localizer's threads."""
        self.localizer.close()


class LocalizerBeside:
    """Answers in a thread of its own, so that who controls a robot never waits for a frame.

    Where frames come faster than they are answered, those that wait are left out but for the newest; wheel readings
    never are.

    Args:
        localizer: that answers; used by nobody else from now on, and closed with this.

    Attributes:
        dropped: frames that were left out.
    """

    def __init__(self, localizer: Localizer) -> None:
        self.localizer, self.dropped = localizer, 0
        self._events: queue.Queue[Event | None] = queue.Queue()
        self._answers: queue.Queue[Answered] = queue.Queue()
        self._error: BaseException | None = None
        self._thread = threading.Thread(target=self._run, name="localizer", daemon=True)
        self._thread.start()

    @property
    def keyframes(self) -> KeyframeStore | None:
        """Of the localizer."""
        return self.localizer.keyframes

    def hear(self, events: Sequence[Event]) -> list[Answered]:
        """What was answered since the last call. Raises what went wrong in the thread."""
        for event in events:
            self._events.put(event)
        if self._error is not None:
            raise self._error
        answered = []
        while not self._answers.empty():
            answered.append(self._answers.get_nowait())
        return answered

    def close(self) -> None:
        """End the thread, then the localizer's."""
        self._events.put(None)
        self._thread.join()
        self.localizer.close()

    def _run(self) -> None:
        try:
            waiting: list[Event] = []
            while True:
                waiting.append(self._events.get()) if not waiting else None
                while not self._events.empty():
                    waiting.append(self._events.get_nowait())
                event = waiting.pop(0)
                if event is None:
                    return
                self._answers.put((event, self.localizer.process(event)))
        except BaseException as error:
            self._error = error
