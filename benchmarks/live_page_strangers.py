"""`python -m benchmarks.live_page_strangers`: how soon STOP is answered beside thousands of strangers.

`wheelsight serve` drives a simulated robot (studio, 160×120 at 5 images a second, a new map) with a limit of file
descriptors. Strangers on the same computer hold connections, and open each again that is closed to them, as quickly
as one process can. Meanwhile the owner, at the same address, presses STOP on a connection of its own for each press:
the time from before it connects until it has the answer counts. A page is open, and gets its updates. Without a token
all that the strangers ask is allowed, as on a computer that serves its page to itself alone. The log is all that the
program writes to stderr.

The strangers, the owner and the robot share the computer's cores; the row without strangers shows what the computer's
load alone costs.
"""

from __future__ import annotations

import argparse
import multiprocessing
import re
import resource
import selectors
import signal
import socket
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from http.client import HTTPConnection, HTTPException
from multiprocessing.sharedctypes import Synchronized
from multiprocessing.synchronize import Event
from pathlib import Path

import numpy as np
from rich.console import Console
from websockets.exceptions import WebSocketException
from websockets.sync.client import connect

from benchmarks import machine
from benchmarks.table import Sheet, targets_sheet, write_page
from benchmarks.targets import Target

STRANGERS, STOP_MS, LOG_BYTES = 2000, 50.0, 1e6
LIMITS = 1024, 8192
TOKEN = "0123456789abcdef0123456789abcdef"
_HOST = b"Host: 127.0.0.1\r\n"
_SOCKET = b"Upgrade: websocket\r\nConnection: Upgrade\r\nSec-WebSocket-Version: 13\r\n"
ALONE = "no strangers"
KINDS = {
    ALONE: b"",
    "nothing": b"",
    "half a request line": b"GET /pa",
    "half a head": b"GET / HTTP/1.1\r\n" + _HOST + b"X: ",
    "half a body": b"POST /stop HTTP/1.1\r\n" + _HOST + b"Content-Length: 1000\r\n\r\nhalf",
    "whole requests": b"GET / HTTP/1.1\r\n" + _HOST + b"\r\n",
    "garbage": bytes(range(256)),
    "half a websocket": b"GET /live HTTP/1.1\r\n" + _HOST + _SOCKET,
    "heads of 64 kB": b"GET / HTTP/1.1\r\nX: " + 65_536 * b"x",
}
_WAIT_S, _BEGINS_S = 8.0, 120.0


@dataclass(frozen=True, slots=True)
class Row:
    """What came of one kind.

    Attributes:
        asks_token: whether the page has one.
        stops_ms: of each press that was answered.
        unanswered: presses that were not.
        opened_hz: connections that the strangers opened, a second.
        updates_hz: that the open page got.
        log_bytes: that the kind added.
    """

    limit: int
    asks_token: bool
    kind: str
    stops_ms: list[float]
    unanswered: int
    opened_hz: float
    updates_hz: float
    log_bytes: int

    @property
    def cells(self) -> tuple[str, ...]:
        """Of the table."""
        ms = self.stops_ms or [float("nan")]
        figures = f"{np.median(ms):.1f}", f"{np.percentile(ms, 95):.1f}", f"{max(ms):.1f}", str(self.unanswered)
        loads = f"{self.opened_hz:.0f}", f"{self.updates_hz:.1f}", str(self.log_bytes)
        return str(self.limit), "yes" if self.asks_token else "no", self.kind, *figures, *loads


def besiege(port: int, sent: bytes, count: int, opened: Synchronized[int], is_over: Event) -> None:
    """Hold so many connections that have sent something, and open each again that is closed."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    hard = resource.getrlimit(resource.RLIMIT_NOFILE)[1]
    resource.setrlimit(resource.RLIMIT_NOFILE, (hard, hard))
    selector, missing = selectors.DefaultSelector(), count
    while not is_over.is_set():
        for _ in range(min(missing, 64)):
            made = socket.socket()
            made.settimeout(1.0)
            try:
                made.connect(("127.0.0.1", port))
                made.setblocking(False)
                with suppress(BlockingIOError):
                    made.send(sent) if sent else 0
                selector.register(made, selectors.EVENT_READ)
                missing -= 1
                opened.value += 1
            except OSError:
                made.close()
        for key, _ in selector.select(0 if missing else 0.05):
            there = key.fileobj
            assert isinstance(there, socket.socket)
            try:
                came = there.recv(65_536)
            except OSError:
                came = b""
            if not came:
                selector.unregister(there)
                there.close()
                missing += 1


@contextmanager
def serving(limit: int, token: str) -> Iterator[tuple[int, Path]]:
    """The port of a page, and the file that its program logs to."""
    with tempfile.TemporaryDirectory() as folder, (Path(folder) / "log").open("wb") as log:
        words = f"serve --sim studio --rate 5 --size 160x120 --out {folder}/maps --port 0".split()
        words += ["--token", token] if token else []
        begun = ["bash", "-c", f'ulimit -n {limit}; exec "$@"', "serve", sys.executable, "-m", "wheelsight", *words]
        running = subprocess.Popen(begun, stdout=subprocess.PIPE, stderr=log, text=True)
        try:
            assert running.stdout is not None
            found = re.search(r":(\d+)/", running.stdout.readline())
            if found is None:
                raise RuntimeError(f"wheelsight serve does not begin: {Path(log.name).read_text()[-500:]}")
            time.sleep(10)  # what is loaded at first use has been
            yield int(found[1]), Path(log.name)
        finally:
            running.send_signal(signal.SIGINT)
            running.communicate(timeout=_BEGINS_S)


def press(port: int, token: str) -> float | None:
    """Milliseconds from before a connection is opened until STOP is answered; None where it is not."""
    began_s = time.monotonic()
    connection = HTTPConnection("127.0.0.1", port, timeout=_WAIT_S)
    try:
        connection.request("POST", "/stop", headers={"Authorization": f"Bearer {token}"} if token else {})
        answer = connection.getresponse()
        answer.read()
        return 1e3 * (time.monotonic() - began_s) if answer.status == 200 else None
    except (OSError, HTTPException):
        return None
    finally:
        connection.close()


def measured(port: int, log: Path, limit: int, token: str, kind: str, presses: int) -> Row:
    """Press STOP beside strangers of a kind."""
    context = multiprocessing.get_context("spawn")
    opened, is_over, seen = context.Value("q", 0), context.Event(), [0]
    count = 0 if kind == ALONE else STRANGERS
    strangers = context.Process(target=besiege, args=(port, KINDS[kind], count, opened, is_over))
    before = log.stat().st_size
    page = threading.Thread(target=_watch, args=(port, token, is_over, seen))
    page.start()
    strangers.start()
    ends_s = time.monotonic() + _BEGINS_S
    while opened.value < count:
        if time.monotonic() > ends_s:
            raise RuntimeError(f"the strangers do not come: {opened.value} of {count}")
        time.sleep(0.05)
    began_s, opened_before, seen_before = time.monotonic(), opened.value, seen[0]
    found = []
    for _ in range(presses):
        found.append(press(port, token))
        time.sleep(0.1)
    took_s = time.monotonic() - began_s
    opened_hz, updates_hz = (opened.value - opened_before) / took_s, (seen[0] - seen_before) / took_s
    is_over.set()
    strangers.join()
    page.join()
    time.sleep(2)
    stops_ms = [one for one in found if one is not None]
    missed = len(found) - len(stops_ms)
    return Row(limit, bool(token), kind, stops_ms, missed, opened_hz, updates_hz, log.stat().st_size - before)


def _watch(port: int, token: str, is_over: Event, seen: list[int]) -> None:
    """A page that is open."""
    with (
        suppress(OSError, WebSocketException),
        connect(f"ws://127.0.0.1:{port}/live" + (f"?token={token}" if token else ""), compression=None) as page,
    ):
        while not is_over.is_set():
            page.recv(timeout=_WAIT_S)
            seen[0] += 1


def main() -> None:
    """Print what was measured, and write it where asked to."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.live_page_strangers", description=__doc__)
    parser.add_argument("--presses", type=int, default=50, help="of STOP, beside each kind")
    parser.add_argument("--out", type=Path, help="Markdown to write")
    arguments = parser.parse_args()
    about, console, rows = machine.description(), Console(width=150), list[Row]()
    about["Command"] = f"`python -m benchmarks.live_page_strangers --presses {arguments.presses}`"
    for limit in LIMITS:
        for token in (TOKEN, ""):
            with serving(limit, token) as (port, log):
                for kind in KINDS:
                    rows.append(measured(port, log, limit, token, kind, arguments.presses))
                    console.print(*rows[-1].cells)
    every = [ms for row in rows if row.kind != ALONE for ms in row.stops_ms]
    alone = [ms for row in rows if row.kind == ALONE for ms in row.stops_ms]
    targets = [
        Target(f"STOP beside {STRANGERS} strangers, median of {len(every)}", STOP_MS, float(np.median(every)), "ms"),
        Target("the same, 95 %", STOP_MS, float(np.percentile(every, 95)), "ms"),
        Target("the same, worst", STOP_MS, max(every), "ms"),
        Target(f"STOP without strangers, worst of {len(alone)}", STOP_MS, max(alone), "ms"),
        Target("STOP unanswered", 0, sum(row.unanswered for row in rows), "", 0),
        Target("log of all kinds", LOG_BYTES / 1e3, sum(row.log_bytes for row in rows) / 1e3, "kB"),
    ]
    header = (
        "descriptors",
        "token",
        "each sends",
        "STOP, ms",
        "95 %",
        "worst",
        "none",
        "opened/s",
        "updates/s",
        "log, B",
    )
    sheets = [Sheet("STOP beside strangers", header, tuple(row.cells for row in rows)), targets_sheet(targets)]
    for sheet in sheets:
        console.print(sheet.to_rich())
    if arguments.out is not None:
        write_page(arguments.out, "The live page beside strangers", __doc__ or "", about, sheets)


if __name__ == "__main__":
    main()
