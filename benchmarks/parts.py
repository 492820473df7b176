"""What is measured beside the contenders: each part by its name, its tables and its targets."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

from benchmarks.contenders import MAPPERS, Contender
from benchmarks.dense import ON_ONE_THREAD, judge_dense, measure_one_thread, one_thread_sheet
from benchmarks.firmware import measure_firmware
from benchmarks.flat import judge_flat, measure_flat, model_sheet, tracking_sheet
from benchmarks.growth import growth_sheet, judge_growth, measure_growth
from benchmarks.joined_speed import joined_speed_sheet, judge_joined_speed, measure_joined_speed
from benchmarks.kernels import judge_kernels, kernels_sheet, measure_kernels
from benchmarks.link import measure_link
from benchmarks.mapping import judge_mapping, mapping_sheet, measure_mapping
from benchmarks.places import judge_places, measure_places, places_sheet
from benchmarks.run import ContenderError
from benchmarks.sequences import find_sequences
from benchmarks.simulation import judge_simulation, measure_simulation, simulation_sheet
from benchmarks.startup import measure_startup
from benchmarks.table import Sheet, firmware_sheet, link_sheet, problems_of, startup_sheet, wheels_sheet
from benchmarks.targets import Target, judge_firmware, judge_link, judge_startup, judge_wheels
from benchmarks.wheels import measure_wheels


@dataclass(frozen=True, slots=True)
class Scope:
    """What the command line asks for: the data folder, and the most frames of a recording, or None."""

    data: Path
    frames: int | None = None


@dataclass(frozen=True, slots=True)
class Judged:
    """A part's tables, its targets, and a line for each thing that could not be measured."""

    sheets: tuple[Sheet, ...]
    targets: list[Target]
    problems: Sequence[str] = ()


@dataclass(frozen=True, slots=True)
class Part:
    """One thing to measure.

    Attributes:
        name: for `--only`.
        measure: measures it.
        contenders: that take part, whose settings are to be reported.
    """

    name: str
    measure: Callable[[Scope], Judged]
    contenders: tuple[Contender, ...] = ()


def _startup(_: Scope) -> Judged:
    startup = measure_startup()
    return Judged((startup_sheet(startup),), judge_startup(startup))


def _wheels(_: Scope) -> Judged:
    times = measure_wheels()
    return Judged((wheels_sheet(times),), judge_wheels(times))


def _link(_: Scope) -> Judged:
    figures = measure_link()
    return Judged((link_sheet(figures),), judge_link(figures))


def _firmware(_: Scope) -> Judged:
    figures = measure_firmware()
    return Judged((firmware_sheet(figures),), judge_firmware(figures))


def _simulation(_: Scope) -> Judged:
    figures = measure_simulation()
    return Judged((simulation_sheet(figures),), judge_simulation(figures))


def _places(_: Scope) -> Judged:
    times = measure_places()
    return Judged((places_sheet(times),), judge_places(times))


def _one_thread(scope: Scope) -> Judged:
    results = measure_one_thread(find_sequences(scope.data), scope.frames)
    return Judged((one_thread_sheet(results),), judge_dense(results, threads=1), problems_of(results))


def _mapping(scope: Scope) -> Judged:
    results = measure_mapping(find_sequences(scope.data), scope.frames)
    return Judged((mapping_sheet(results),), judge_mapping(results), problems_of(results))


def _growth(scope: Scope) -> Judged:
    try:
        growth = measure_growth(find_sequences(scope.data), scope.frames)
    except ContenderError as error:
        return Judged((), [], [f"growth: {error}"])
    return Judged((growth_sheet(growth),), judge_growth(growth))


def _flat(_: Scope) -> Judged:
    figures = measure_flat()
    return Judged((tracking_sheet(figures), model_sheet(figures)), judge_flat(figures))


def _joined(_: Scope) -> Judged:
    spent = measure_joined_speed()
    return Judged((joined_speed_sheet(spent),), judge_joined_speed(spent))


def _kernels(_: Scope) -> Judged:
    times = measure_kernels()
    return Judged((kernels_sheet(times),), judge_kernels(times))


ALL = (
    Part("mapping", _mapping, MAPPERS),
    Part("one-thread", _one_thread, ON_ONE_THREAD),
    Part("growth", _growth),
    Part("flat", _flat),
    Part("joined", _joined),
    Part("kernels", _kernels),
    Part("wheels", _wheels),
    Part("link", _link),
    Part("firmware", _firmware),
    Part("simulator", _simulation),
    Part("places", _places),
    Part("start-up", _startup),
)
