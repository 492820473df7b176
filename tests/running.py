"""Commands of a process of their own, which Ctrl-C ends."""

from __future__ import annotations

import os
import signal
import subprocess
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import IO


@contextmanager
def interrupted(command: Sequence[str]) -> Iterator[IO[str]]:
    """The output of a command that runs in the block. Ctrl-C then ends it, with exit code 0."""
    environment = {**os.environ, "PYTHONUNBUFFERED": "1"}
    running = subprocess.Popen(command, stdout=subprocess.PIPE, text=True, env=environment)
    try:
        assert running.stdout is not None
        yield running.stdout
        running.send_signal(signal.SIGINT)
        assert running.wait(120) == 0
    finally:
        running.kill()
        running.wait(10)
        if running.stdout is not None:
            running.stdout.close()
