"""Ctrl-C in the middle of a step, and each of the signals that end a program."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager

import pytest

from wheelsight.core.runtime import ENDING, until_stopped, whole_step


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
    got: list[int] = []
    signal.signal(signal.SIGINT, lambda number, _: got.append(number))
    with whole_step():
        press()
        assert got == [signal.SIGINT]


def test_another_thread_may_step_too() -> None:
    done: list[int] = []
    thread = threading.Thread(target=step, args=[lambda: done.append(1)])
    thread.start()
    thread.join()
    assert done == [1]


# A program in a process of its own: it says that it is ready, waits in one of three ways, and takes its time to end.
PROGRAM = """
import sys, time
from wheelsight.core.runtime import end_by_signals, exit_code, until_stopped, whole_step
end_by_signals()
way, ends_after_s = sys.argv[1], float(sys.argv[2])

def wait():
    print("ready", flush=True)
    for _ in range(600):
        time.sleep(0.05)

try:
    if way == "anywhere":
        wait()
    elif way == "in a step":
        with whole_step():
            print("ready", flush=True)
            time.sleep(0.2)
            print("whole", flush=True)
    else:
        with until_stopped() as is_over:
            print("ready", flush=True)
            while not is_over():
                time.sleep(0.02)
            print("over", flush=True)
except KeyboardInterrupt:
    pass
try:
    print("ending", flush=True)
    end_s = time.monotonic() + ends_after_s
    while time.monotonic() < end_s:
        time.sleep(0.02)
    print("written", flush=True)
except KeyboardInterrupt:
    is_stuck = "stuck" in sys.argv
    print("given up", flush=True)
    time.sleep(60 if is_stuck else 0)
sys.exit(exit_code())
"""


@contextmanager
def program(
    way: str, ends_after_s: float = 0.0, *more: str, ignores: tuple[int, ...] = ()
) -> Iterator[subprocess.Popen[str]]:
    """Once it is ready. Signals do what they do in a terminal, however these tests were started."""

    def as_in_a_terminal() -> None:
        for number in ENDING:
            signal.signal(number, signal.SIG_IGN if number in ignores else signal.SIG_DFL)

    command = [sys.executable, "-c", PROGRAM, way, str(ends_after_s), *more]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True, preexec_fn=as_in_a_terminal) as process:
        try:
            assert line_of(process) == "ready"
            yield process
        finally:
            process.kill()


def line_of(process: subprocess.Popen[str]) -> str:
    assert process.stdout is not None
    return process.stdout.readline().strip()


@pytest.mark.parametrize("way", ["anywhere", "in a step", "until stopped"])
@pytest.mark.parametrize("number", ENDING)
def test_each_signal_begins_a_tidy_end(way: str, number: signal.Signals) -> None:
    with program(way) as process:
        process.send_signal(number)
        said, _ = process.communicate(timeout=60)
        assert process.returncode == 128 + number
    of_way = {"anywhere": [], "in a step": ["whole"], "until stopped": ["over"]}
    assert said.split("\n")[:-1] == [*of_way[way], "ending", "written"]


@pytest.mark.parametrize("way", ["anywhere", "until stopped"])
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_second_one_gives_the_tidy_end_up(way: str, number: signal.Signals) -> None:
    with program(way, 60) as process:
        process.send_signal(number)
        while line_of(process) != "ending":
            pass
        process.send_signal(number)
        assert line_of(process) == "given up"
        assert process.wait(60) == 128 + number


def test_a_second_one_ends_a_wait_that_does_not_ask_whether_it_is_over() -> None:
    with until_stopped() as is_over:
        os.kill(os.getpid(), signal.SIGTERM)
        assert is_over()
        with pytest.raises(KeyboardInterrupt):
            os.kill(os.getpid(), signal.SIGTERM)


def test_a_third_one_kills() -> None:
    with program("anywhere", 60, "stuck") as process:
        for said in ("ending", "given up"):
            process.send_signal(signal.SIGTERM)
            assert line_of(process) == said
        process.send_signal(signal.SIGTERM)
        assert process.wait(60) == -signal.SIGTERM


@pytest.mark.slow
def test_what_is_stuck_after_the_second_is_killed() -> None:
    with program("anywhere", 60, "stuck") as process:
        for said in ("ending", "given up"):
            process.send_signal(signal.SIGTERM)
            assert line_of(process) == said
        assert process.wait(40) == -signal.SIGALRM  # by itself it would be stuck for a minute


@pytest.mark.parametrize("others", [(signal.SIGHUP, signal.SIGHUP), (signal.SIGHUP, signal.SIGTERM)])
def test_signals_of_one_cause_are_one(others: tuple[signal.Signals, ...]) -> None:
    """As a shell and its terminal send them, or systemd."""
    with program("anywhere", 0.5) as process:
        for number in others:
            process.send_signal(number)
        said, _ = process.communicate(timeout=60)
        assert "written" in said
        assert process.returncode in [128 + number for number in others]


@pytest.mark.parametrize("way", ["anywhere", "until stopped"])
def test_what_is_ignored_from_the_beginning_on_stays_ignored(way: str) -> None:
    with program(way, ignores=(signal.SIGHUP,)) as process:
        process.send_signal(signal.SIGHUP)
        with pytest.raises(subprocess.TimeoutExpired):
            process.wait(0.3)
        process.send_signal(signal.SIGTERM)
        assert process.wait(60) == 128 + signal.SIGTERM
