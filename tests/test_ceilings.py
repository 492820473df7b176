"""How much a reader has to open: ceilings that are lowered as the package gets simpler, and never rise."""

from __future__ import annotations

import re
import sys
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import cache
from itertools import chain, pairwise
from pathlib import Path
from statistics import median
from types import FrameType
from typing import Any, NamedTuple

import pytest
from rehearsed_drive import rehearsed_drive

import wheelsight
from wheelsight import Localizer, RgbdFrame, SimulationSettings, WheelTicks, load_config, simulate

PROJECT = Path(__file__).resolve().parent.parent
PACKAGE = Path(wheelsight.__file__).resolve().parent
# The simulator is a part of the package, or a package beside it.
SIMULATOR = next(path for path in (PROJECT / "wheelsight_sim", PACKAGE / "simulation") if path.exists())


class Ceiling(NamedTuple):
    """The most that is allowed today, and what is to be reached."""

    now: float
    target: float


CEILINGS = {
    "modules": Ceiling(266, 330),
    "lines without the simulator": Ceiling(78_000, 78_000),
    "lines of the simulator": Ceiling(11_000, 11_000),
    "share of private functions used in one place": Ceiling(0.39, 0.40),
    "class names with two or more meanings": Ceiling(0, 0),
    "settings": Ceiling(181, 200),
    "decision pages": Ceiling(15, 15),
    "benchmark files in the root": Ceiling(1, 1),
    "words of the changelog": Ceiling(480, 500),
    "files of a joined frame": Ceiling(24, 24),
    "calls of a joined frame": Ceiling(640, 700),
    "files of a wheel reading": Ceiling(12, 12),
    "calls of a wheel reading": Ceiling(103, 150),
    "files from go_to_pose through a control period": Ceiling(26, 28),
}
# A figure that is lower than this share of its ceiling lowers the ceiling.
LOOSE = 0.95


def check(name: str, figure: float) -> None:
    now, target = CEILINGS[name]
    assert figure <= now, f"{name}: {figure} is more than {now}, and is to be {target}"
    assert figure >= LOOSE * now, f"{name}: {figure} is well below {now}: lower CEILINGS to it"


@cache
def sources() -> dict[Path, str]:
    paths = {*PACKAGE.rglob("*.py"), *SIMULATOR.rglob("*.py")}
    return {path: path.read_text(encoding="utf-8") for path in sorted(paths)}


def lines(*, of_simulator: bool) -> int:
    return sum(
        len(text.splitlines()) for path, text in sources().items() if path.is_relative_to(SIMULATOR) == of_simulator
    )


def places_of_use(source: str) -> list[int]:
    """For each private function and method of a file, in how many places of the file its name stands."""
    names = re.findall(r"^\s*(?:async )?def (_(?!_)\w+)", source, re.MULTILINE)
    words, definitions = Counter(re.findall(r"\b_\w+", source)), Counter(names)
    return [words[name] - definitions[name] for name in names]


def share_used_once() -> float:
    counts = [count for source in sources().values() for count in places_of_use(source)]
    return counts.count(1) / len(counts)


def shared_class_names() -> int:
    names = (re.findall(r"^\s*class (\w+)", source, re.MULTILINE) for source in sources().values())
    return sum(count > 1 for count in Counter(chain.from_iterable(names)).values())


def settings_in(values: Any) -> int:
    return sum(map(settings_in, values.values())) if isinstance(values, dict) else 1


STATIC: dict[str, Callable[[], float]] = {
    "modules": lambda: len(sources()),
    "lines without the simulator": lambda: lines(of_simulator=False),
    "lines of the simulator": lambda: lines(of_simulator=True),
    "share of private functions used in one place": share_used_once,
    "class names with two or more meanings": shared_class_names,
    "settings": lambda: settings_in(load_config().to_dict()),
    "decision pages": lambda: len([*(PROJECT / "docs" / "decisions").glob("*.md")]) - 1,  # but the index
    "benchmark files in the root": lambda: len([*PROJECT.glob("BENCHMARKS*")]),
    "words of the changelog": lambda: len((PROJECT / "CHANGELOG.md").read_text(encoding="utf-8").split()),
}


@pytest.mark.parametrize("name", STATIC)
def test_a_ceiling_holds(name: str) -> None:
    check(name, STATIC[name]())


@contextmanager
def files_called() -> Iterator[list[str]]:
    """The file of each Python call of the package in this thread, in order; compiled kernels are not seen."""
    called: list[str] = []
    roots = (f"{PACKAGE}/", f"{SIMULATOR}/")

    def note(frame: FrameType, event: str, _: object) -> None:
        if event == "call" and frame.f_code.co_filename.startswith(roots):
            called.append(frame.f_code.co_filename)

    before = sys.getprofile()
    sys.setprofile(note)
    try:
        yield called
    finally:
        sys.setprofile(before)


@pytest.mark.slow
def test_ceilings_of_a_frame_and_a_wheel_reading_hold() -> None:
    """Wheels and camera joined, with a map; in the second half of a drive, so that what is done once is done."""
    recording = simulate(SimulationSettings("flat", seed=1, size=(320, 240), rate_hz=10.0, duration_s=12.0))
    config = load_config(overrides={"odometry": "wheels,dense", "map": "surfels"})
    passed: dict[type, list[list[str]]] = {RgbdFrame: [], WheelTicks: []}
    with Localizer(recording.calibration, config) as localizer:
        for event in recording.events():
            with files_called() as called:
                localizer.process(event)
            if event.stamp_s > 6.0:
                passed[type(event)].append(called)
    for name, kind in (("a joined frame", RgbdFrame), ("a wheel reading", WheelTicks)):
        assert len(passed[kind]) > 50
        check(f"files of {name}", median(len(set(called)) for called in passed[kind]))
        check(f"calls of {name}", median(map(len, passed[kind])))


@pytest.mark.slow
def test_the_ceiling_of_a_control_period_holds() -> None:
    """Of two periods in a row, since each second one has a frame; the robot is given its place."""
    drive, _, _ = rehearsed_drive()
    navigator = drive.navigator
    with files_called() as asked:
        navigator.go_to_pose([2.0, 0.0])
    periods = []
    while not navigator.is_task_complete():
        with files_called() as called:
            navigator.step()
        periods.append({*asked, *called})
    assert len(periods) > 50
    check("files from go_to_pose through a control period", median(len(a | b) for a, b in pairwise(periods)))


def test_a_figure_that_rises_or_leaves_its_ceiling_behind_is_found() -> None:
    name, (now, _) = next(iter(CEILINGS.items()))
    check(name, now)
    with pytest.raises(AssertionError, match="is more than"):
        check(name, now + 1)
    with pytest.raises(AssertionError, match="lower CEILINGS"):
        check(name, 0.9 * now)


def test_places_that_use_a_private_function_are_counted() -> None:
    source = (
        "def _a(): _b(); self._c()\ndef _b(): ...\n    async def _c(self): map(_b)\ndef __len__(): ...\ndef d(): d()"
    )
    assert places_of_use(source) == [0, 2, 1]
