"""What is measured beside the contenders: each part by its name, its table and its targets."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from benchmarks.firmware import measure_firmware
from benchmarks.link import measure_link
from benchmarks.places import judge_places, measure_places, places_sheet
from benchmarks.simulation import judge_simulation, measure_simulation, simulation_sheet
from benchmarks.startup import measure_startup
from benchmarks.table import Sheet, firmware_sheet, link_sheet, startup_sheet, wheels_sheet
from benchmarks.targets import Target, judge_firmware, judge_link, judge_startup, judge_wheels
from benchmarks.wheels import measure_wheels

Judged = tuple[Sheet, list[Target]]


@dataclass(frozen=True, slots=True)
class Part:
    """One thing to measure.

    Attributes:
        name: for `--only`.
        measure: measures it: its table, and its targets.
    """

    name: str
    measure: Callable[[], Judged]


def _startup() -> Judged:
    startup = measure_startup()
    return startup_sheet(startup), judge_startup(startup)


def _wheels() -> Judged:
    times = measure_wheels()
    return wheels_sheet(times), judge_wheels(times)


def _link() -> Judged:
    figures = measure_link()
    return link_sheet(figures), judge_link(figures)


def _firmware() -> Judged:
    figures = measure_firmware()
    return firmware_sheet(figures), judge_firmware(figures)


def _simulation() -> Judged:
    figures = measure_simulation()
    return simulation_sheet(figures), judge_simulation(figures)


def _places() -> Judged:
    times = measure_places()
    return places_sheet(times), judge_places(times)


ALL = (
    Part("wheels", _wheels),
    Part("link", _link),
    Part("firmware", _firmware),
    Part("simulator", _simulation),
    Part("places", _places),
    Part("start-up", _startup),
)
