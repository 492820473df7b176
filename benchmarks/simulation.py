"""`python -m benchmarks.simulation`: how quick the simulator is, and whether its memory stays flat."""

from __future__ import annotations

import re
import subprocess
import sys
import time
from dataclasses import dataclass
from pathlib import Path

from rich.console import Console

from benchmarks import machine
from benchmarks.table import Sheet
from benchmarks.targets import Target
from wheelsight.core.messages import RgbdFrame
from wheelsight_sim import SimulationSettings, simulate

SMALL, LARGE = (320, 240), (640, 480)
SMALL_HZ, LARGE_HZ = 20.0, 6.0
GROWTH_MB = 20.0
_DRIVE_S = 5.0
_REPEATS = 3
_EARLY_S, _LATE_S = 60.0, 600.0
_LONG = SimulationSettings(world="floor4", size=(64, 48), rate_hz=2.0, laps=4, duration_s=_LATE_S, seed=1)


@dataclass(frozen=True, slots=True)
class SimulationFigures:
    """What was measured.

    Attributes:
        small_hz, large_hz: frames a second of 320×240 and 640×480, from the settings to the last frame, physics and
            noise included, two threads; the best of some runs, for other programs only slow it.
        early_mb, late_mb: memory of a process that has rendered the first minute of a drive, and all ten, megabytes of
            10⁶ bytes.
    """

    small_hz: float
    large_hz: float
    early_mb: float
    late_mb: float


def measure_simulation() -> SimulationFigures:
    """All figures of the simulator; takes about two minutes."""
    _frames_per_s(SMALL)  # compiles kernels
    small_hz, large_hz = (max(_frames_per_s(size) for _ in range(_REPEATS)) for size in (SMALL, LARGE))
    return SimulationFigures(small_hz, large_hz, *_memory_mb())


def simulation_sheet(figures: SimulationFigures) -> Sheet:
    """How quick the simulator is, and what memory it takes."""
    rows = (
        ("frames a second, 320×240, physics and noise included", f"{figures.small_hz:.1f}"),
        ("frames a second, 640×480, physics and noise included", f"{figures.large_hz:.1f}"),
        ("memory after the first minute of a drive of ten", f"{figures.early_mb:.0f} MB"),
        ("memory after all ten", f"{figures.late_mb:.0f} MB"),
    )
    return Sheet("The simulator, floor4 by kinect-v1, two threads", ("what", "measured"), rows)


def judge_simulation(figures: SimulationFigures) -> list[Target]:
    """What the simulator must reach."""
    growth_mb = figures.late_mb - figures.early_mb
    return [
        Target("simulator: frames/s, 320×240", SMALL_HZ, figures.small_hz, "/s", is_least=True),
        Target("simulator: frames/s, 640×480", LARGE_HZ, figures.large_hz, "/s", is_least=True),
        Target("simulator: memory gained from minute 1 to 10", GROWTH_MB, growth_mb, "MB"),
    ]


def _frames_per_s(size: tuple[int, int]) -> float:
    settings = SimulationSettings(world="floor4", size=size, duration_s=_DRIVE_S, seed=1)
    begun = time.perf_counter()
    frames = sum(isinstance(event, RgbdFrame) for event in simulate(settings).events())
    return frames / (time.perf_counter() - begun)


def _memory_mb() -> tuple[float, float]:
    """Of a process of its own, which holds nothing else."""
    words = [sys.executable, "-m", "benchmarks.simulation", "memory"]
    reported = subprocess.run(words, check=True, capture_output=True, text=True).stdout.split()
    return float(reported[0]), float(reported[1])


def _tell_memory() -> None:
    early_mb = 0.0
    for event in simulate(_LONG).events():
        if early_mb == 0 and event.stamp_s >= _EARLY_S:
            early_mb = _held_mb()
    print(early_mb, _held_mb())


def _held_mb() -> float:
    """The memory this process holds now (Linux)."""
    held = re.search(r"^VmRSS:\s*(\d+) kB", Path("/proc/self/status").read_text(), re.MULTILINE)
    assert held is not None
    return int(held[1]) * 1024 / 1e6


if __name__ == "__main__":
    if sys.argv[1:] == ["memory"]:
        _tell_memory()
        sys.exit()
    if machine.is_busy():
        print("The machine is busy: times will be too long.", file=sys.stderr)
    Console().print(simulation_sheet(measure_simulation()).to_rich())
