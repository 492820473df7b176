"""CountedLines: what a page's program says on its terminal, where strangers decide how often."""

from __future__ import annotations

import math
import re
import threading
import time
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from typing import Self

_LOOK_S, _ENDS_S = 0.1, 2.0
# So many different lines of refusals at once, and one more each 10 s: less than 1 MB a day. Up to 10 minutes apart.
_NEW_LINES, _NEW_LINE_S, _LONGEST_S = 8.0, 10.0, 600.0
_TIMES = re.compile(r" \((\d+) times\)$")


class CountedLines:
    """Shows lines in a thread of its own, so that a terminal that takes nothing stops no other; counts repeats.

    A line that comes again and again is shown with its count after 1 s, 2 s, 4 s and so on, up to 10 minutes. Of lines
    that differ, which a stranger can make up, few are shown, and the others counted.

    Args:
        show: called with a line, in that thread.
    """

    def __init__(self, show: Callable[[str], None]) -> None:
        self._show = show
        self._lines: dict[str, _Line] = {}
        self._left, self._filled_s = _NEW_LINES, time.monotonic()
        self._changed, self._is_over = threading.Condition(), False
        self._thread = threading.Thread(target=self._run, name="wheelsight-lines", daemon=True)
        self._thread.start()

    def tell(self, line: str, *, is_problem: bool = False) -> None:
        """One more; a problem of the robot is never among the others."""
        found = _TIMES.search(line)
        text, times = (line[: found.start()], int(found[1])) if found else (line, 1)
        now_s = time.monotonic()
        with self._changed:
            if text not in self._lines and not is_problem and not self._may_be_new(now_s):
                text = "refused others"
            kept = self._lines.setdefault(text, _Line(due_s=now_s))
            kept.times += times
            self._changed.notify()

    def _may_be_new(self, now_s: float) -> bool:
        self._left = min(self._left + (now_s - self._filled_s) / _NEW_LINE_S, _NEW_LINES)
        self._filled_s = now_s
        if self._left < 1:
            return False
        self._left -= 1
        return True

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        """Print what is left, and end."""
        with self._changed:
            self._is_over = True
            self._changed.notify()
        self._thread.join(_ENDS_S)

    def _run(self) -> None:
        while True:
            with self._changed:
                is_over = self._is_over
                printed = self._due(math.inf if is_over else time.monotonic())
                if not printed and not is_over:
                    waits = any(line.times for line in self._lines.values())
                    self._changed.wait(_LOOK_S if waits else None)
                    continue
            for text, times in printed:
                with suppress(OSError):
                    self._show(text if times == 1 else f"{text} ({times} times)")
            if is_over:
                return

    def _due(self, now_s: float) -> list[tuple[str, int]]:
        """Lines to be printed, and how often each came; those that have not come for long are forgotten."""
        found = []
        for text, line in list(self._lines.items()):
            if line.times and line.due_s <= now_s:
                found.append((text, line.times))
                line.times, line.due_s = 0, now_s + line.wait_s
                line.wait_s = min(2 * line.wait_s, _LONGEST_S)
            elif not line.times and line.due_s + line.wait_s < now_s:
                del self._lines[text]
        return found


@dataclass
class _Line:
    """How often a line came since it was printed, and when it may be printed again."""

    due_s: float
    wait_s: float = 1.0
    times: int = 0
