"""Threads that yield come after others, and are not kept from running."""

from __future__ import annotations

import os
import sys
import threading
from concurrent.futures import ThreadPoolExecutor

import pytest

from wheelsight.threads import yield_to_others

_LESS_A_STEP = 1.25  # by which Linux divides a thread's share for each step of `nice`


def niceness() -> int:
    return os.getpriority(os.PRIO_PROCESS, threading.get_native_id())


@pytest.mark.skipif(sys.platform != "linux", reason="threads differ in priority on Linux alone")
def test_a_thread_that_yields_has_less_than_the_others_and_enough_to_let_go_of_python() -> None:
    with ThreadPoolExecutor(1, "yields", yield_to_others) as pool:
        share = _LESS_A_STEP ** (niceness() - pool.submit(niceness).result())
    assert 0.25 < share < 1.0
