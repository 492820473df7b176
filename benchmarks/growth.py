"""Whether a longer way makes the surfel map slower or larger: a recording forwards and then backwards."""

from __future__ import annotations

import statistics
import tempfile
from collections.abc import Sequence as Many
from dataclasses import dataclass
from pathlib import Path

from benchmarks.contenders import wheelsight_dense
from benchmarks.measure import Feed, Passage
from benchmarks.run import read_passage, run_process
from benchmarks.sequences import Sequence
from benchmarks.table import Sheet
from benchmarks.targets import Target
from wheelsight.io.recordings import open_recording

GROWTH_PERCENT = 10.0
MEMORY_MB = 1000.0


@dataclass(frozen=True, slots=True)
class Growth:
    """Of one way.

    Attributes:
        name: of the way.
        frames: along it.
        first_ms, last_ms: median of a frame in the first and the last quarter.
        peak_memory_mb: of the whole process, megabytes of 10⁶ bytes.
    """

    name: str
    frames: int
    first_ms: float
    last_ms: float
    peak_memory_mb: float

    @property
    def percent(self) -> float:
        """By how much the last quarter takes longer."""
        return 100 * (self.last_ms / self.first_ms - 1)


def measure_growth(sequences: Many[Sequence], frames: int | None = None) -> Growth:
    """The longest recording there and back, streamed, so that memory holds no frames but a few.

    The last quarter shows what the first did, from the same places, so that only the map differs.

    Raises ContenderError where the process ends badly.
    """
    longest = max(sequences, key=lambda sequence: open_recording(sequence.path).frame_count)
    with tempfile.TemporaryDirectory() as scratch:
        folder = Path(scratch) / "streamed"
        how = ("--there-and-back",)
        run_process(wheelsight_dense.SURFELS, longest.path, Feed.STREAMED, folder, frames, extra=how)
        return growth_of(f"{longest.name} there and back", read_passage(folder))


def growth_of(name: str, passage: Passage) -> Growth:
    """Quarters of a passage."""
    times_ms = [1e3 * seconds for seconds in passage.seconds]
    quarter = len(times_ms) // 4
    first_ms, last_ms = statistics.median(times_ms[:quarter]), statistics.median(times_ms[-quarter:])
    return Growth(name, len(times_ms), first_ms, last_ms, passage.peak_memory_mb)


def growth_sheet(growth: Growth) -> Sheet:
    """Time and memory along the way."""
    rows = (
        ("a frame in the first quarter, median", f"{growth.first_ms:.1f} ms"),
        ("a frame in the last quarter, median", f"{growth.last_ms:.1f} ms"),
        ("peak memory of the process", f"{growth.peak_memory_mb:.0f} MB"),
    )
    return Sheet(f"Growth: surfels over {growth.name}, {growth.frames:,} frames", ("", "measured"), rows)


def judge_growth(growth: Growth) -> list[Target]:
    """A longer way must cost neither time nor much memory."""
    what = f"surfels, {growth.name}, {growth.frames:,} frames"
    return [
        Target(f"{what}: slower from first to last quarter", GROWTH_PERCENT, growth.percent, "%"),
        Target(f"{what}: peak memory", MEMORY_MB, growth.peak_memory_mb, "MB", 0),
    ]
