from __future__ import annotations

import threading
import time

import pytest

from wheelsight.io.recordings.images import read_ahead


def threads():
    return [thread for thread in threading.enumerate() if thread.name == "wheelsight-read-ahead"]


class Source:
    """Counts up to `length`; remembers how far it got."""

    def __init__(self, length, fail_at=None):
        self.made, self.length, self.fail_at, self.closed = 0, length, fail_at, False

    def items(self):
        try:
            for i in range(self.length):
                if i == self.fail_at:
                    raise OSError("the disk is gone")
                self.made += 1
                yield i
        finally:
            self.closed = True


@pytest.mark.parametrize("depth", [1, 4, 100])
@pytest.mark.parametrize("length", [0, 1, 50])
def test_gives_all_items_in_order(length, depth):
    source = Source(length)
    assert list(read_ahead(source.items(), depth)) == list(range(length))
    assert source.closed
    assert not threads()


def test_what_goes_wrong_arrives_after_the_items_before_it():
    items = read_ahead(Source(10, fail_at=5).items(), 3)
    assert [next(items) for _ in range(5)] == [0, 1, 2, 3, 4]
    with pytest.raises(OSError, match="the disk is gone"):
        next(items)
    assert not threads()


@pytest.mark.parametrize("taken", [1, 2, 7])
def test_closing_early_stops_the_thread(taken):
    source = Source(1_000_000)
    items = read_ahead(source.items(), 4)
    for _ in range(taken):
        next(items)
    items.close()
    assert not threads()
    assert source.closed
    assert source.made <= taken + 4 + 2


def test_an_error_in_the_consumer_stops_the_thread():
    def consume():
        for item in read_ahead(Source(1_000_000).items(), 2):
            raise RuntimeError(item)

    with pytest.raises(RuntimeError):
        consume()
    assert not threads()


def test_a_generator_that_is_never_started_starts_no_thread():
    items = read_ahead(Source(3).items(), 2)
    assert not threads()
    items.close()


def test_makes_no_more_than_it_may():
    source = Source(1_000_000)
    items = read_ahead(source.items(), 3)
    next(items)
    time.sleep(0.05)  # for a thread that does not stop to show it
    assert source.made <= 1 + 3 + 1
    items.close()


def test_works_while_the_consumer_is_busy():
    made = threading.Event()

    def source():
        yield 0
        made.set()
        yield 1

    items = read_ahead(source(), 4)
    next(items)
    assert made.wait(timeout=30), "the second is not made before it is asked for"
    items.close()
