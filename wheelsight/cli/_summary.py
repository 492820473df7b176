"""What `wheelsight run` prints at its end."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from rich.table import Table

    from wheelsight.pipeline import RectificationRecord, RunRecord

_ON_THE_PAGE_ONLY = ("ATE, max", "of the way", "turn a metre", "95 % within")  # a terminal is 80 signs wide


def print_summary(records: Sequence[RunRecord], out: Path) -> None:
    """Figures of the only odometry, or a table of several with one row each; warnings and files."""
    from wheelsight.cli._console import console, facts_table, print_warning
    from wheelsight.cli.evaluate import evaluation_table
    from wheelsight.report import why_no_page

    stdout = console()
    first = records[0]
    if len(records) > 1:
        stdout.print(_joint_table(records))
        for record in records:
            if record.rectification is not None and record.rectification.errors is not None:
                stdout.print(_map_error_table(record.rectification))
        if any(record.is_joined for record in records):
            stdout.print(facts_table("what joining came to", _joined_facts(records)))
    else:
        stdout.print(facts_table(f"{first.recording}: T_{first.estimate.frame}_{first.estimate.body}", _facts(first)))
        if first.evaluation is not None:
            stdout.print(evaluation_table(first.evaluation))
    for shown in (*_corrections(records), *([] if first.realtime is None else [first.realtime.sentence])):
        stdout.print(shown, markup=False)
    for warning in dict.fromkeys(w for record in records for w in record.warnings):
        print_warning(warning)
    for line in _maps(records, out):
        stdout.print(line)
    if why_no_page() is None:
        stdout.print(f"report: {out / 'report.html'}")


def _corrections(records: Sequence[RunRecord]) -> Iterator[Table | str]:
    """What loops made of each trajectory."""
    from wheelsight.cli.evaluate import evaluation_table

    for record in records:
        if record.correction is not None:
            yield f"{record.odometry}: {record.correction.sentence}"
            if record.correction.evaluation is not None:
                yield evaluation_table(record.correction.evaluation)


def _maps(records: Sequence[RunRecord], out: Path) -> Iterator[str]:
    """Where each map is, and how large."""
    for record in records:
        folder = out / record.odometry if len(records) > 1 else out
        for kept in (record.map, record.kept_map):
            if kept is not None:
                yield f"map: {folder / kept.file} ({kept.sentence})"


def _joint_table(records: Sequence[RunRecord]) -> Table:
    """One row an odometry; below, why one was not evaluated."""
    from rich.box import SIMPLE_HEAD
    from rich.table import Table

    from wheelsight.report import comparison_rows

    head, rows = comparison_rows(records)
    missing = [f"{r.odometry} not evaluated: {r.evaluation_problem}" for r in records if r.evaluation is None]
    table = Table(
        title=records[0].recording,
        box=SIMPLE_HEAD,
        title_justify="left",
        caption="\n".join(missing) or None,
        caption_justify="left",
        caption_style="",
    )
    shown = [index for index, name in enumerate(head) if name not in _ON_THE_PAGE_ONLY]
    for index in shown:
        table.add_column(head[index], justify="right" if index else "left")
    for record, row in zip(records, rows, strict=True):
        table.add_row(*(row[index] for index in shown), style="bold" if record.is_joined else None)
    return table


def _joined_facts(records: Sequence[RunRecord]) -> Iterator[tuple[str, str]]:
    """What joining came to."""
    from wheelsight.cli._console import percent
    from wheelsight.pipeline import best_alone_of, facts_of, joined_of, words

    joined, best_alone = joined_of(records), best_alone_of(records)
    assert joined is not None
    facts = facts_of(joined)
    if best_alone is not None:
        yield "error", f"{words.number(best_alone.ratio, 2)} times that of {best_alone.odometry} alone"
    for status, seconds in facts.seconds.items():
        episodes = len(facts.coasting_s)
        times = "once" if episodes == 1 else f"{episodes} times"
        yield status, f"{seconds:.2f} s, {times}" if status == "coasting" else f"{seconds:.2f} s"
    for flag, share in facts.flag_shares.items():
        if share:
            yield flag, f"{percent(share)} of the time"
    found = facts.consistency
    if found is not None:
        yield "end", f"{found.drift_m:.3f} m off after {found.way_m:.2f} m ({100 * found.drift_share:.2f} %)"
        yield "stated 3σ", f"holds {percent(found.share)} of the time"


def _map_error_table(found: RectificationRecord) -> Table:
    """What areas leave of the wheels' error."""
    from rich.box import SIMPLE_HEAD
    from rich.table import Table

    from wheelsight.report import ERROR_HEAD, error_rows

    table = Table(title="distance from the truth, nothing aligned", box=SIMPLE_HEAD, title_justify="left")
    for index, name in enumerate(ERROR_HEAD):
        table.add_column(name, justify="right" if index else "left")
    for row in error_rows(found):
        table.add_row(*row)
    return table


def _facts(record: RunRecord) -> Iterator[tuple[str, str]]:
    from wheelsight.cli._console import percent
    from wheelsight.report import summarise

    summary = summarise(record)
    digits = ".1f" if summary.unit == "frame" else ".4f"
    yield f"{summary.unit}s", f"{summary.posed} of {summary.frames} with a pose ({percent(summary.pose_share)})"
    for why, count in summary.skips:
        yield "skipped", f"{count} × {why}"
    for why, count in summary.failures:
        yield "no pose", f"{count} × {why}"
    if summary.lost_episodes:
        times = "once" if summary.lost_episodes == 1 else f"{summary.lost_episodes} times"
        yield "lost", f"{times}, for {summary.lost_s:.2f} s in all"
    yield "way", f"{summary.length_m:.2f} m in {summary.duration_s:.2f} s"
    yield (
        f"time a {summary.unit}",
        f"median {1e3 * summary.median_s:{digits}} ms, 95 % within {1e3 * summary.p95_s:{digits}} ms",
    )
    if record.evaluation is None:
        yield "not evaluated", record.evaluation_problem or ""
