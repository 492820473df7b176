"""The table of a batch: one row for each recording and configuration, with figures over the seeds. `compare` finds
figures that are worse than a baseline.
"""

from __future__ import annotations

import csv
import io
import math
import statistics
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

from wheelsight.core.errors import ConfigError
from wheelsight.core.files import StrPath
from wheelsight.core.inputs import Kind, read_text
from wheelsight_batch.jobs import Case, Outcome

BROKEN, DONE = "broken", "ok"


@dataclass(frozen=True, slots=True)
class Figure:
    """A column of the table.

    Attributes:
        name: in files, with its unit.
        title: in shown tables.
        scale: factor from the stored to the shown value.
        digits: shown digits after the point.
        is_cost: whether it depends on the computer, too.
        grows_better: whether more is better.
    """

    name: str
    title: str
    scale: float = 1.0
    digits: int = 4
    is_cost: bool = False
    grows_better: bool = False


FIGURES = (
    Figure("ate_m", "ATE, m"),
    Figure("rpe_m", "RPE, m/s"),
    Figure("rpe_deg", "RPE, °/s", digits=3),
    Figure("tracked", "posed, %", 100.0, 1, grows_better=True),
    Figure("frame_ms", "ms", digits=2, is_cost=True),
    Figure("memory_mb", "MB", digits=0, is_cost=True),
)
# 100 000 rows; and a figure that can still be scaled, rounded and compared.
_FILE = Kind("a table of a batch", most_mb=16, fix="give the table.csv of an earlier --out")
_LARGEST = 1e15
_HEAD = ("recording", "config", "odometry", "seeds", "status", "problem")


class Spread(NamedTuple):
    """Statistics of a figure over the seeds of a row."""

    median: float
    worst: float


@dataclass(frozen=True, slots=True)
class BatchRow:
    """Figures of a recording with one configuration.

    Attributes:
        recording, config, odometry: as in its `Case`.
        seeds: number of successful seeds.
        status: DONE; BROKEN; or "2 of 5 broken".
        problem: the first error, or "".
        figures: by name, without unavailable ones.
    """

    recording: str
    config: str
    odometry: str
    seeds: int
    status: str
    problem: str
    figures: Mapping[str, Spread]


def rows_of(cases: Sequence[Case], outcomes: Mapping[str, Outcome]) -> tuple[BatchRow, ...]:
    """A row for each case, from outcomes by job identifier."""
    rows = []
    for case in cases:
        done = [outcomes[job] for job in case.jobs]
        well = [outcome for outcome in done if outcome.problem is None]
        broken = [outcome.problem for outcome in done if outcome.problem is not None]
        status = BROKEN if not well else DONE if not broken else f"{len(broken)} of {len(done)} broken"
        figures = {}
        for figure in FIGURES:
            values = [value for outcome in well if (value := outcome.figures.get(figure.name)) is not None]
            if values:
                worst = min(values) if figure.grows_better else max(values)
                figures[figure.name] = Spread(statistics.median(values), worst)
        problem = case.problem or next(iter(broken), "")
        rows.append(BatchRow(case.recording, case.config, case.odometry, len(well), status, problem, figures))
    return tuple(rows)


def shown(figure: Figure, value: float) -> str:
    """A value as text, rounded; small times keep enough digits to differ from zero."""
    scaled = figure.scale * value
    places = -math.floor(math.log10(abs(scaled))) if scaled else 0
    return f"{scaled:.{max(figure.digits, min(places, 4)) if figure.is_cost else figure.digits}f}"


def csv_text(rows: Sequence[BatchRow]) -> str:
    """All figures in full precision, for `read_rows`."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow([*_HEAD, *(f"{figure.name}_{of}" for figure in FIGURES for of in Spread._fields)])
    for row in rows:
        spreads = [row.figures.get(figure.name) for figure in FIGURES]
        values = [value for spread in spreads for value in (("", "") if spread is None else map(repr, spread))]
        writer.writerow([row.recording, row.config, row.odometry, row.seeds, row.status, row.problem, *values])
    return text.getvalue()


def markdown_text(rows: Sequence[BatchRow]) -> str:
    """Medians, with the worst seed in brackets; errors below."""
    head = ["recording", "config", "odometry", "seeds", *(figure.title for figure in FIGURES), "status"]
    lines = [head, ["---"] * 4 + ["---:"] * len(FIGURES) + ["---"]]
    for row in rows:
        figures = []
        for figure in FIGURES:
            spread = row.figures.get(figure.name)
            worst = f" ({shown(figure, spread.worst)})" if spread is not None and row.seeds > 1 else ""
            figures.append("–" if spread is None else shown(figure, spread.median) + worst)
        lines.append([row.recording, row.config, row.odometry, str(row.seeds), *figures, row.status])
    text = "".join("| " + " | ".join(cell.replace("|", "\\|") for cell in line) + " |\n" for line in lines)
    reasons = [f"- {row.recording}, {row.config}: {row.problem}\n" for row in rows if row.problem]
    return text + ("\n" + "".join(reasons) if reasons else "")


def read_rows(path: StrPath) -> tuple[BatchRow, ...]:
    """Rows of an earlier table.csv. Raises ConfigError, with the line, for an invalid file."""
    path = Path(path)
    reader = csv.DictReader(io.StringIO(read_text(path, _FILE, ConfigError), newline=""))
    try:
        if not {*_HEAD} <= {*(reader.fieldnames or ())}:
            raise ConfigError("is no table of a batch", path=path, fix=_FILE.fix)
        rows = []
        for cells in reader:
            figures = {}
            for name in (figure.name for figure in FIGURES):
                values = [float(cell) for of in Spread._fields if (cell := cells.get(f"{name}_{of}"))]
                if not all(abs(value) < _LARGEST for value in values):
                    raise ValueError(name)
                if len(values) == len(Spread._fields):
                    figures[name] = Spread(*values)
            own = (cells["recording"], cells["config"], cells["odometry"], int(cells["seeds"]), cells["status"])
            rows.append(BatchRow(*own, cells["problem"], figures))
    except csv.Error as error:
        raise ConfigError("is no table of a batch", path=path, fix=_FILE.fix) from error
    except (TypeError, ValueError) as error:
        raise ConfigError("holds no numbers where they should be", path=path, line=reader.line_num) from error
    return tuple(rows)


# Growth of an error, metres or degrees, that is not worse: two versions of a library differ so. And of the share of
# frames with a pose: a frame or two of a short recording.
_LEAST_ERROR, _LEAST_SHARE = 1e-4, 0.005


@dataclass(frozen=True, slots=True)
class Comparison:
    """A comparison with a baseline.

    Attributes:
        worse: a line for each worse figure.
        unmatched: a line for each row that only one table has.
        compared: number of common rows.
    """

    worse: tuple[str, ...]
    unmatched: tuple[str, ...]
    compared: int


def compare(
    rows: Sequence[BatchRow], baseline: Sequence[BatchRow], tolerance: float, cost_tolerance: float | None = None
) -> Comparison:
    """Compare medians and worst seeds with the baseline's row of the same recording and configuration.

    Args:
        rows: current rows.
        baseline: earlier rows.
        tolerance: allowed relative growth of errors, and allowed drop of the share of frames with a pose.
        cost_tolerance: likewise for time and memory; None: not compared, for another computer.
    """
    now, before = ({(row.recording, row.config): row for row in one} for one in (rows, baseline))
    worse = [
        f"{row.recording}, {row.config}: {what}"
        for key, row in now.items()
        if key in before
        for what in _worse(row, before[key], tolerance, cost_tolerance)
    ]
    lonely = [f"{', '.join(key)}: not in the baseline" for key in now if key not in before]
    lonely += [f"{', '.join(key)}: in the baseline alone" for key in before if key not in now]
    return Comparison(tuple(worse), tuple(lonely), len(now.keys() & before.keys()))


def _worse(row: BatchRow, before: BatchRow, tolerance: float, cost_tolerance: float | None) -> Iterator[str]:
    if not row.seeds:
        if before.seeds:
            yield "broken"
        return
    for figure in FIGURES:
        allowed = cost_tolerance if figure.is_cost else tolerance
        was, found = before.figures.get(figure.name), row.figures.get(figure.name)
        if allowed is None or was is None:
            continue
        if found is None:
            yield f"no {figure.title} any more"
            continue
        for name in Spread._fields:
            old, new = getattr(was, name), getattr(found, name)
            grown = old - new if figure.grows_better else new - old
            least = 0.0 if figure.is_cost else _LEAST_SHARE if figure.grows_better else _LEAST_ERROR
            if grown > max(least, allowed * abs(old)):
                yield f"{figure.title} {name} {shown(figure, new)}, was {shown(figure, old)}"
                break
