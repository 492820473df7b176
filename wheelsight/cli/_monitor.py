"""What `wheels monitor` shows: rates from one look at the link to the next, as a table or a line."""

from __future__ import annotations

import time
from collections.abc import Iterator
from dataclasses import dataclass

from rich.table import Table

from wheelsight.calibration import Wheels
from wheelsight.cli._console import facts_table
from wheelsight.devices import LinkReport

_SHORTEST_S = 0.5


@dataclass(frozen=True, slots=True)
class Look:
    """The link at one moment, and what changed since half a second before.

    Attributes:
        report: the link's own.
        frames_per_s: good frames; None before there was time for it.
        left, right: speed of each wheel in `unit`.
    """

    report: LinkReport
    frames_per_s: float | None
    left: float | None
    right: float | None
    unit: str


class Meter:
    """Looks at a link again and again; speeds are in m/s where the wheels are known, else in ticks/s."""

    def __init__(self, wheels: Wheels | None) -> None:
        self._scales = (1.0, 1.0) if wheels is None else (wheels.left_m_per_tick, wheels.right_m_per_tick)
        self._unit = "ticks/s" if wheels is None else "m/s"
        self._before: list[tuple[float, LinkReport]] = []

    def look(self, report: LinkReport) -> Look:
        """The link now; `report` is a fresh one."""
        now_s = time.monotonic()
        self._before.append((now_s, report))
        while len(self._before) > 2 and self._before[1][0] <= now_s - _SHORTEST_S:
            self._before.pop(0)
        then_s, then = self._before[0]
        frames_per_s = (report.line.frames - then.line.frames) / (now_s - then_s) if now_s > then_s else None
        left, right = self._speeds(then, report)
        return Look(report, frames_per_s, left, right, self._unit)

    def _speeds(self, then: LinkReport, now: LinkReport) -> tuple[float | None, float | None]:
        if then.last is None or now.last is None or now.last.stamp_s <= then.last.stamp_s:
            return None, None
        passed_s = now.last.stamp_s - then.last.stamp_s
        left, right = now.last.left - then.last.left, now.last.right - then.last.right
        return left * self._scales[0] / passed_s, right * self._scales[1] / passed_s


def live_table(port: str, look: Look) -> Table:
    """All facts below each other."""
    return facts_table(port, _facts(look))


def live_line(look: Look) -> str:
    """All facts in one line."""
    return "; ".join(f"{name}: {value}" for name, value in _facts(look))


def _facts(look: Look) -> Iterator[tuple[str, str]]:
    report = look.report
    line, last = report.line, report.last
    yield "status", str(report.status)
    yield "format", str(report.format or "not recognised yet")
    for name, ticks, speed in (
        ("left", last and last.left, look.left),
        ("right", last and last.right, look.right),
    ):
        yield name, "—" if ticks is None else f"{ticks} ticks, {_speed(speed, look.unit)}"
    yield "frames", f"{line.frames}, {'—' if look.frames_per_s is None else f'{look.frames_per_s:.1f}'} a second"
    yield "lost", f"{line.lost}; {line.crc_errors} damaged, {line.malformed} garbled, {line.duplicates} repeated"
    if report.other_line:
        yield "other text", report.other_line
    yield "controller", f"{report.restarts} restarts; its clock {report.drift_ppm:+.0f} ppm fast"
    yield "port", f"{line.bytes} bytes, {report.reconnects} times plugged in again"


def _speed(speed: float | None, unit: str) -> str:
    return "standing still or unknown" if speed is None else f"{speed:+.3f} {unit}"
