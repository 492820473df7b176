"""Reading ahead in a thread, so that decoding images never keeps tracking waiting."""

from __future__ import annotations

from collections.abc import Generator, Iterator
from contextlib import suppress
from dataclasses import dataclass
from queue import Empty, Queue
from threading import Event, Thread
from typing import TypeVar

T = TypeVar("T")


@dataclass(frozen=True, slots=True)
class _End:
    """The last thing in the queue, with what stopped the source, if it did not end by itself."""

    error: BaseException | None = None


def read_ahead(items: Iterator[T], depth: int) -> Generator[T]:
    """The items of an iterator in their order, up to `depth` of them (1 or more) made ahead in a thread.

    What the iterator raises is raised here, at its place. Closing this generator, or leaving a loop over it,
    stops the thread after the item it is at; `items` is closed then too.
    """
    ready: Queue[T | _End] = Queue(maxsize=depth)
    stop = Event()
    thread = Thread(target=_produce, args=(items, ready, stop), name="wheelsight-read-ahead", daemon=True)
    thread.start()
    try:
        while not isinstance(item := ready.get(), _End):
            yield item
        if item.error is not None:
            raise item.error
    finally:
        stop.set()
        with suppress(Empty):
            while True:
                ready.get_nowait()
        thread.join()


def _produce(items: Iterator[T], ready: Queue[T | _End], stop: Event) -> None:
    """Fill the queue until the items end or `stop` is set; after that at most one more item is put."""
    end = _End()
    try:
        for item in items:
            ready.put(item)
            if stop.is_set():
                break
    except BaseException as error:
        end = _End(error)
    finally:
        if isinstance(items, Generator):
            items.close()
    if not stop.is_set():
        ready.put(end)
