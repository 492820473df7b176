"""A page in headless Chromium that is led by its debugging protocol: clicks, keys, sizes, what it shows."""

from __future__ import annotations

import base64
import json
import subprocess
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any
from urllib.request import urlopen

from websockets.sync.client import ClientConnection, connect

_FLAGS = (
    "--headless=new",
    "--no-sandbox",
    "--disable-gpu",
    "--no-first-run",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
    "--disable-dev-shm-usage",
    "--remote-debugging-port=0",
)
_ANSWER_S = 60.0


class BrowserPage:
    """One page.

    Attributes:
        problems: what went wrong in its scripts, or could not be fetched.
        asked: the address of each request that it made.
    """

    def __init__(self, debugger: ClientConnection) -> None:
        self._debugger, self._count = debugger, 0
        self.problems: list[str] = []
        self.asked: list[str] = []
        for domain in ("Page", "Runtime", "Log", "Network"):
            self.call(f"{domain}.enable")

    def call(self, method: str, **parameters: Any) -> dict[str, Any]:
        """One call of the protocol."""
        self._count += 1
        self._debugger.send(json.dumps({"id": self._count, "method": method, "params": parameters}))
        while True:
            reported = json.loads(self._debugger.recv(timeout=_ANSWER_S))
            if reported.get("id") == self._count:
                return dict(reported.get("result", {}))
            self._note(reported.get("method"), reported.get("params", {}))

    def open(self, address: str, width: int = 1280, height: int = 900) -> None:
        """Go there, with a window of a size."""
        self.resize(width, height)
        self.call("Page.navigate", url=address)
        self.until("location.href !== 'about:blank' && document.readyState === 'complete'")

    def resize(self, width: int, height: int, *, is_phone: bool = False) -> None:
        """Another size of the window."""
        self.call(
            "Emulation.setDeviceMetricsOverride", width=width, height=height, deviceScaleFactor=1, mobile=is_phone
        )

    def value(self, script: str) -> Any:
        """What an expression of the page is."""
        found = self.call("Runtime.evaluate", expression=script, returnByValue=True, awaitPromise=True)
        assert "exceptionDetails" not in found, found["exceptionDetails"]
        return found["result"].get("value")

    def until(self, script: str, seconds: float = 60.0) -> None:
        """Wait until an expression is true; fails where it does not come to be."""
        ends_s = time.monotonic() + seconds
        while not self.value(f"Boolean({script})"):
            if time.monotonic() > ends_s:
                raise AssertionError(f"{script}: {self.value('document.body.innerText')}")
            time.sleep(0.05)

    def click(self, x: float, y: float, to: tuple[float, float] | None = None) -> None:
        """With the left button; or drag to another place."""
        ends = (x, y) if to is None else to
        self._mouse("mousePressed", x, y, 1)
        if to is not None:
            self._mouse("mouseMoved", *to, 1)
        self._mouse("mouseReleased", *ends, 0)

    def key(self, key: str) -> None:
        """Press and let go."""
        for kind in ("keyDown", "keyUp"):
            self.call("Input.dispatchKeyEvent", type=kind, key=key)

    def picture(self, path: Path) -> None:
        """What is to be seen, as PNG."""
        path.write_bytes(base64.b64decode(self.call("Page.captureScreenshot", format="png")["data"]))

    def _mouse(self, kind: str, x: float, y: float, buttons: int) -> None:
        self.call("Input.dispatchMouseEvent", type=kind, x=x, y=y, button="left", buttons=buttons, clickCount=1)

    def _note(self, method: str | None, reported: dict[str, Any]) -> None:
        if method == "Runtime.exceptionThrown":
            self.problems.append(json.dumps(reported["exceptionDetails"])[:500])
        elif method == "Log.entryAdded" and reported["entry"]["level"] == "error":
            self.problems.append(f"{reported['entry']['text']} {reported['entry'].get('url', '')}")
        elif method == "Network.requestWillBeSent":
            self.asked.append(reported["request"]["url"])


@contextmanager
def browser(chromium: str) -> Iterator[BrowserPage]:
    """An empty page of a browser that ends with the block."""
    with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as profile:
        command = [chromium, *_FLAGS, f"--user-data-dir={profile}", "about:blank"]
        running = subprocess.Popen(command, stderr=subprocess.PIPE, text=True)
        try:
            assert running.stderr is not None
            lines = (line for line in running.stderr if "DevTools listening on" in line)
            port = next(lines).split("ws://")[1].split("/")[0].rpartition(":")[2]
            with urlopen(f"http://127.0.0.1:{port}/json/list", timeout=_ANSWER_S) as answer:
                found = next(one for one in json.load(answer) if one["type"] == "page")
            with connect(found["webSocketDebuggerUrl"], max_size=None) as debugger:
                yield BrowserPage(debugger)
        finally:
            running.kill()
            running.wait(10)
            if running.stderr is not None:
                running.stderr.close()
