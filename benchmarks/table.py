"""The figures as tables: in the terminal with rich, and as Markdown to keep."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from rich.markup import escape
from rich.table import Table

from benchmarks.contenders import Contender
from benchmarks.firmware import FirmwareFigures
from benchmarks.link import LinkFigures
from benchmarks.measure import THREADS
from benchmarks.published import Published, published_of
from benchmarks.run import Result
from benchmarks.startup import Startup
from benchmarks.targets import CRC_RATE, Target
from benchmarks.wheels import WheelTimes

_NONE = "—"


@dataclass(frozen=True, slots=True)
class Sheet:
    """A table of words: the first column is set to the left, the others, figures, to the right."""

    title: str
    header: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]

    def to_rich(self) -> Table:
        """For the terminal."""
        table = Table(title=self.title, title_justify="left")
        for column, name in enumerate(self.header):
            table.add_column(escape(name), justify="left" if column == 0 else "right")
        for row in self.rows:
            table.add_row(*map(escape, row))
        return table

    def to_markdown(self) -> str:
        """For a file."""
        rule = [":---" if column == 0 else "---:" for column in range(len(self.header))]
        lines = [" | ".join(cells) for cells in (self.header, rule, *self.rows)]
        return f"## {self.title}\n\n" + "\n".join(f"| {line} |" for line in lines) + "\n"


def targets_sheet(targets: Sequence[Target]) -> Sheet:
    """What was to be reached, and whether it was."""
    rows = tuple((t.what, _limit(t), _figure(t.measured, t.decimals, t.unit), t.verdict) for t in targets)
    return Sheet("Targets", ("target", "must reach", "measured", "verdict"), rows)


def results_sheets(results: Sequence[Result]) -> list[Sheet]:
    """One sheet a sequence, one row a contender, and one for each system that was published with it."""
    figures = ("ATE m", "RPE/s m", "RPE/s °", "poses %", "median ms", "p95 ms", "streamed ms", "peak MB", "same twice")
    return [
        Sheet(
            f"Side by side: {sequence}",
            ("contender", *figures),
            (
                *((result.contender.name, *_cells(result)) for result in results if result.sequence == sequence),
                *(_published_cells(published) for published in published_of(sequence)),
            ),
        )
        for sequence in dict.fromkeys(result.sequence for result in results)
    ]


def startup_sheet(startup: Startup) -> Sheet:
    """Seconds before anything happens."""
    rows = (
        ("bare Python", _figure(startup.bare_s, 3)),
        ("Python and `import wheelsight`", _figure(startup.import_s, 3)),
        ("`import wheelsight` alone (the difference)", _figure(startup.import_alone_s, 3)),
        ("`wheelsight --help`", _figure(startup.help_s, 3)),
    )
    return Sheet("Start-up, medians of fresh processes", ("program", "s"), rows)


def wheels_sheet(times: WheelTimes) -> Sheet:
    """How quick dead reckoning is."""
    rows = (
        (f"{times.samples:,} samples with covariance", _figure(times.log_ms, 1, "ms")),
        ("the same with a gyroscope", _figure(times.log_with_gyro_ms, 1, "ms")),
        ("one reading of a stream, to its Estimate", _figure(times.update_us, 1, "µs")),
    )
    return Sheet("Wheel odometry, medians on one core", ("what", "time"), rows)


def link_sheet(figures: LinkFigures) -> Sheet:
    """How quick the serial link is, and what becomes of damage."""
    latency_ms, noise, damaged = figures.latency_ms, figures.noise, figures.damaged
    rows = (
        ("decode, framed", _figure(figures.decode_mb_s, 1, "MB/s")),
        ("decode, format recognised on the way", _figure(figures.recognised_mb_s, 1, "MB/s")),
        ("last byte to pose on the pipe, median", _figure(float(np.median(latency_ms)), 2, "ms")),
        ("last byte to pose, 99th percentile", _figure(float(np.percentile(latency_ms, 99)), 2, "ms")),
        (f"last byte to pose, the latest of {len(latency_ms):,}", _figure(float(latency_ms.max()), 2, "ms")),
        (f"messages in {noise.decoder.statistics.bytes:,} random bytes", str(noise.wrong)),
        (f"wrong counts of {damaged.damaged:,} damaged frames", str(damaged.wrong)),
        ("the same, expected of 16 bits of CRC", f"{damaged.damaged / CRC_RATE:.1f}"),
        (f"missed of {damaged.undamaged:,} frames after a sound one", str(damaged.missed)),
    )
    return Sheet("The serial link, on one core and a pseudo-terminal", ("what", "measured"), rows)


def firmware_sheet(figures: FirmwareFigures) -> Sheet:
    """What the wheel controller takes, and how fast wheels it counts."""
    why_not = f"not measured: {' and '.join(figures.missing)} {'is' if len(figures.missing) == 1 else 'are'} missing"

    def reported(figure: int | None, unit: str) -> str:
        return why_not if figure is None else f"{figure:,} {unit}"

    rows = (
        ("flash, of 8,192 bytes", reported(figures.flash_bytes, "bytes")),
        ("memory without the stack, of 1,024 bytes", reported(figures.ram_bytes, "bytes")),
        ("the fastest both wheels turn before a count is lost", reported(figures.pulses_per_s, "pulses/s")),
    )
    return Sheet("The wheel controller's program, on a simulated ATmega8", ("what", "measured"), rows)


def problems_of(results: Sequence[Result]) -> list[str]:
    """A line for each contender that could not be measured."""
    return [f"{r.contender.name} failed on {r.sequence}: {r.problem}" for r in results if r.problem is not None]


def document(
    sheets: Sequence[Sheet],
    machine: dict[str, str],
    command: str,
    contenders: Sequence[Contender],
    problems: Sequence[str] = (),
) -> str:
    """The whole of docs/benchmarks/peers.md."""
    about = "\n".join(f"- {name}: {value}" for name, value in machine.items())
    about += f"\n- Threads: {THREADS} for every contender, if nothing else is said" if contenders else ""
    settings = "\n".join(f"- {contender.name}: {contender.settings}." for contender in contenders)
    return "\n".join(
        (
            "# Peers and parts\n",
            f"Written by `{command}`; how it measures: [Benchmarks](../benchmarks.md).\n",
            f"{about}\n",
            *(sheet.to_markdown() for sheet in sheets),
            *(f"{problem}\n" for problem in problems),
            *([f"## Contenders\n\n{settings}\n"] if contenders else []),
        )
    )


def shown(path: Path) -> str:
    """The path as it stands in a command that a page shows: as typed, or the name alone of an absolute one."""
    return path.name if path.is_absolute() else path.as_posix()


def write_page(path: Path, title: str, reported: str, about: Mapping[str, str], sheets: Sequence[Sheet]) -> None:
    """Keep the tables of one benchmark as Markdown, with what it measures and what it ran on."""
    lines = "\n".join(f"- {topic}: {value}" for topic, value in about.items())
    pages = [f"# {title}\n\n{reported}", f"{lines}\n", *(sheet.to_markdown() for sheet in sheets)]
    path.write_text("\n".join(pages), encoding="utf-8")


def _cells(result: Result) -> tuple[str, ...]:
    figures = result.figures
    if figures is None:
        return (_NONE,) * 8 + ("failed",)
    return (
        _figure(figures.accuracy.ate_m, 4),
        _figure(figures.accuracy.rpe_m, 4),
        _figure(figures.accuracy.rpe_deg, 2),
        f"{100 * figures.with_pose / figures.frames:.1f}" if figures.frames else _NONE,
        _figure(figures.median_ms, 1),
        _figure(figures.p95_ms, 1),
        _figure(figures.streamed_ms, 1),
        _figure(figures.peak_memory_mb, 0),
        {None: _NONE, 0: "yes"}.get(figures.differing_poses, f"{figures.differing_poses} differ"),
    )


def _published_cells(published: Published) -> tuple[str, ...]:
    return (f"{published.system} (published: {published.source})", _figure(published.ate_m, 4), *(_NONE,) * 8)


def _limit(target: Target) -> str:
    if target.limit is None:
        return _NONE
    return f"at {'least' if target.is_least else 'most'} {_figure(target.limit, target.decimals, target.unit)}"


def _figure(value: float | None, decimals: int, unit: str = "") -> str:
    return _NONE if value is None else f"{value:.{decimals}f} {unit}".rstrip()
