"""The link on a board that prints plain lines behind a pseudo-terminal, and what it is reported that it cannot do."""

from __future__ import annotations

import os
import threading
import time
import tty
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from itertools import pairwise

import pytest

from wheelsight.core.errors import DeviceError
from wheelsight.io.devices import Format, LinkStatus, WheelLink

PERIOD_S = 0.02


class Printer:
    """A board that prints what `line` answers for each reading's number, at once and for ever."""

    def __init__(self, line: Callable[[int], str]) -> None:
        self.line, self.printed = line, 0
        self._master, self._slave = os.openpty()
        tty.setraw(self._slave)
        os.set_blocking(self._master, False)
        self.port = os.ttyname(self._slave)
        self._is_over = threading.Event()
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    def _run(self) -> None:
        while not self._is_over.wait(PERIOD_S):
            with suppress(BlockingIOError):
                os.write(self._master, self.line(self.printed).encode() + b"\r\n")
            self.printed += 1

    def received(self) -> bytes:
        """What was sent to it."""
        with suppress(BlockingIOError):
            return os.read(self._master, 4096)
        return b""

    def close(self) -> None:
        self._is_over.set()
        self._thread.join()
        os.close(self._master)
        os.close(self._slave)


@contextmanager
def printing(line: Callable[[int], str]) -> Iterator[Printer]:
    printer = Printer(line)
    try:
        yield printer
    finally:
        printer.close()


def wait(is_so: Callable[[], bool]) -> None:
    until = time.monotonic() + 60
    while not is_so():
        assert time.monotonic() < until, "it never came"
        time.sleep(0.005)


@pytest.mark.parametrize("has_time", [True, False])
def test_ticks_are_what_is_printed(has_time: bool) -> None:
    def line(n: int) -> str:
        moved = min(n, 60)
        return f"{int(1e3 * time.monotonic())},{7 * moved},{-3 * moved}" if has_time else f"{7 * moved} {-3 * moved}"

    with printing(line) as board, WheelLink(board.port) as link:
        wait(lambda: link.status is LinkStatus.CONNECTED)
        assert link.report().format is Format.PLAIN
        wait(lambda: (last := link.report().last) is not None and (last.left, last.right) == (420, -180))
        report, now_s, ticks = link.report(), time.time(), []
        while (tick := link.read(0)) is not None:
            ticks.append(tick)
        assert (report.restarts, report.line.malformed) == (0, 0)
        assert all(before.stamp_s < after.stamp_s for before, after in pairwise(ticks))
        assert ticks[-1].stamp_s == pytest.approx(now_s, abs=30)
        assert board.received() == b""  # it only listens


@pytest.mark.parametrize(
    "command",
    [
        lambda link: link.drive(0.1, 0.1),
        lambda link: link.stop(),
        lambda link: link.ask_version(),
        lambda link: link.reset_counts(),
        lambda link: link.set_format(Format.FRAMED),
    ],
)
def test_a_board_that_prints_takes_no_commands(command: Callable[[WheelLink], object]) -> None:
    with printing(lambda n: f"{n},{n}") as board, WheelLink(board.port) as link:
        wait(lambda: link.status is LinkStatus.CONNECTED)
        with pytest.raises(DeviceError, match=r"prints plain text, and takes no commands \(give it a program"):
            command(link)
        assert board.received() == b""


def test_text_that_is_no_counts_is_reported_with_what_to_print() -> None:
    with printing(lambda n: f"speed {n} rpm") as board, WheelLink(board.port) as link:
        wait(lambda: link.status is LinkStatus.TEXT)
        assert "print left,right or time,left,right" in link.status
        assert link.report().other_line.startswith("speed")
        assert link.report().last is None
        board.line = lambda n: f"{n},{n}"
        wait(lambda: link.status is LinkStatus.CONNECTED)


def test_other_text_between_is_counted_and_shown() -> None:
    with printing(lambda n: f"{n},{n}" if n % 5 else "battery 12 V") as board, WheelLink(board.port) as link:
        wait(lambda: link.report().line.malformed > 10)
        report = link.report()
    assert report.format is Format.PLAIN
    assert report.other_line == "battery 12 V"


def test_no_one_asks_for_plain_text() -> None:
    refused = pytest.raises(DeviceError, match="no controller changes to plain text")
    with printing(lambda n: "") as board, WheelLink(board.port) as link, refused:
        link.set_format(Format.PLAIN)
