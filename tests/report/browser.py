"""Opens a page in headless Chromium, without a network, and hands back what came of it."""

from __future__ import annotations

import subprocess
import tempfile
from pathlib import Path

_FLAGS = (
    "--headless=new",
    "--no-sandbox",
    "--disable-quic",
    "--no-first-run",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
    "--disable-dev-shm-usage",
    "--window-size=1280,2000",
    "--virtual-time-budget=20000",
    "--enable-logging=stderr",
    "--v=0",
    "--dump-dom",
)


# WebGL by Chromium's own renderer, which needs no graphics card; or none at all.
WITH_WEBGL, WITHOUT_WEBGL = ("--use-angle=swiftshader", "--enable-unsafe-swiftshader"), ("--disable-3d-apis",)


def open_page(chromium: str, page: Path, flags: tuple[str, ...] = WITHOUT_WEBGL) -> tuple[str, list[str]]:
    """The document after its scripts have run, and every line that it wrote to the browser's console."""
    with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as profile:
        command = [chromium, *_FLAGS, *flags, f"--user-data-dir={profile}", page.resolve().as_uri()]
        done = subprocess.run(command, capture_output=True, text=True, encoding="utf-8", timeout=120, check=True)
    return done.stdout, [line for line in done.stderr.splitlines() if ":CONSOLE:" in line]
