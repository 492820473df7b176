"""The main loop of a pool process: it runs one job after another until the connection closes."""

from __future__ import annotations

import faulthandler
import os
import shutil
import signal
import sys
import tempfile
import threading
from collections.abc import Callable
from contextlib import suppress
from multiprocessing import parent_process
from multiprocessing.connection import Connection, wait
from pathlib import Path
from typing import Any

_TRIES = 50


def serve(connection: Connection, work: Callable[[Any], object], folder: str) -> None:
    """Answer each job with its outcome.

    Args:
        connection: to the process that distributes the jobs.
        work: what is done with a job.
        folder: what is written meanwhile goes there, stderr too.
    """
    for of_terminals in (signal.SIGINT, getattr(signal, "SIGHUP", signal.SIGINT)):
        signal.signal(of_terminals, signal.SIG_IGN)
    tempfile.tempdir = folder
    # Output of libraries would tear the progress bar; the last lines of a process are its reason.
    log = os.path.join(folder, "stderr.txt")  # noqa: PTH118 - before anything else is loaded
    descriptor = os.open(log, os.O_WRONLY | os.O_CREAT | os.O_APPEND, 0o644)
    for stream in (sys.stdout, sys.stderr):
        stream.flush()
        os.dup2(descriptor, stream.fileno())
    os.close(descriptor)
    faulthandler.enable()
    ending = threading.Thread(target=_end_with_parent, args=(folder,), daemon=True)
    ending.start()
    while True:
        try:
            job = connection.recv()
        except (EOFError, ConnectionError):
            break
        outcome = work(job)
        try:
            connection.send(outcome)
        except ConnectionError:
            break
    ending.join()  # it cleans up and ends this process, unless the parent does


def _end_with_parent(folder: str) -> None:
    """End this process with its parent, which may be killed at any time."""
    parent = parent_process()
    assert parent is not None
    wait([parent.sentinel])
    for _ in range(_TRIES):  # a job that goes on may write into it meanwhile
        shutil.rmtree(folder, ignore_errors=True)
        if not Path(folder).exists():
            break
    with suppress(OSError):  # the last one removes what all of them were in
        Path(folder).parent.rmdir()
    os._exit(1)
