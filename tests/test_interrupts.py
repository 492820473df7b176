"""Ctrl-C in the middle of a step."""

from __future__ import annotations

import os
import signal
import threading
from collections.abc import Callable, Iterator

import pytest

from wheelsight.interrupts import whole_step


@pytest.fixture(autouse=True)
def ctrl_c_raises() -> Iterator[None]:
    """As in a terminal, wherever tests run."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, before)


def press() -> None:
    os.kill(os.getpid(), signal.SIGINT)


def step(*parts: Callable[[], object]) -> None:
    with whole_step():
        for part in parts:
            part()


def test_the_first_waits_for_the_end() -> None:
    done: list[str] = []
    with pytest.raises(KeyboardInterrupt):
        step(press, lambda: done.append("all of it"))
    assert done
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler


def test_the_second_does_not_wait() -> None:
    done: list[str] = []
    with pytest.raises(KeyboardInterrupt):
        step(press, press, lambda: done.append("never"))
    assert not done


def test_without_one_nothing_happens() -> None:
    with whole_step():
        pass
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler


def test_an_error_in_the_step_goes_its_way() -> None:
    with pytest.raises(ZeroDivisionError):
        step(press, lambda: 1 / 0)
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler


def test_a_programs_own_answer_stays() -> None:
    heard: list[int] = []
    signal.signal(signal.SIGINT, lambda number, _: heard.append(number))
    with whole_step():
        press()
        assert heard == [signal.SIGINT]


def test_another_thread_may_step_too() -> None:
    done: list[int] = []
    thread = threading.Thread(target=step, args=[lambda: done.append(1)])
    thread.start()
    thread.join()
    assert done == [1]
