"""What `wheelsight run` prints at its end."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from rich.console import Group
    from rich.table import Table

    from wheelsight.pipeline import RectificationRecord, RunRecord, Verdict

_ON_THE_PAGE_ONLY = ("ATE, max", "of the way", "turn a metre", "95 % within", "time covered")  # 80 signs wide


def print_summary(records: Sequence[RunRecord], out: Path) -> None:
    """Whether a known map was recognised; figures, a row for each odometry; warnings, the verdict, files."""
    from wheelsight.cli._console import console, facts_table, print_warning
    from wheelsight.cli.evaluate import evaluation_table
    from wheelsight.pipeline import verdict_of_run
    from wheelsight.report import why_no_page

    stdout = console()
    first = records[0]
    for known in (record.known_map for record in records if record.known_map is not None):
        stdout.print(f"{known.sentence}.")
    if len(records) > 1:
        stdout.print(_joint_table(records))
        for areas in (record.rectification for record in records if record.rectification is not None):
            if areas.errors is not None:
                stdout.print(_map_error_table(areas))
    else:
        stdout.print(facts_table(f"{first.recording}: T_{first.estimate.frame}_{first.estimate.body}", _facts(first)))
        if first.evaluation is not None:
            stdout.print(evaluation_table(first.evaluation))
    for shown in _corrections(records):
        stdout.print(shown, markup=False)
    for warning in dict.fromkeys(w for record in records for w in record.warnings):
        print_warning(warning)
    _print_verdict(verdict_of_run(records))
    for line in _maps(records, out):
        stdout.print(line)
    if why_no_page() is None:
        stdout.print(f"report: {out / 'report.html'}")


def _print_verdict(verdict: Verdict) -> None:
    """In a line; below, what it rests on, the worst first, each with what to do."""
    from rich.text import Text

    from wheelsight.cli._console import console
    from wheelsight.pipeline import Tone

    styles = {Tone.GREEN: "green", Tone.AMBER: "yellow", Tone.RED: "bold red"}
    stdout = console()
    stdout.print(Text.assemble("verdict: ", (str(verdict.tone), styles[verdict.tone]), f", {verdict.phrase}"))
    for found in verdict.concerns:
        if found.about != "sensors":  # a warning, printed above
            stdout.print(Text.assemble((f"  {found.tone:<6}", styles[found.tone]), found.line))
    sound = [found for found in verdict.findings if found.tone is Tone.GREEN and found.about != "map"]
    if sound:
        shorts = "; ".join(found.short for found in sound)
        stdout.print(Text.assemble((f"  {Tone.GREEN:<6}", styles[Tone.GREEN]), f"{shorts}."))
    for fact in verdict.facts:
        stdout.print(Text(f"        {fact}"))


def _corrections(records: Sequence[RunRecord]) -> Iterator[Group | str]:
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
    table = Table(title=records[0].recording, box=SIMPLE_HEAD, caption="\n".join(missing) or None, caption_style="")
    table.title_justify = table.caption_justify = "left"
    shown = [index for index, name in enumerate(head) if not name.startswith(_ON_THE_PAGE_ONLY)]
    for index in shown:
        table.add_column(head[index], justify="right" if index else "left")
    for record, row in zip(records, rows, strict=True):
        table.add_row(*(row[index] for index in shown), style="bold" if record.is_joined else None)
    return table


def _map_error_table(found: RectificationRecord) -> Table:
    """What areas leave of the wheels' error."""
    from rich.box import SIMPLE_HEAD
    from rich.table import Table

    from wheelsight.report import error_rows

    table = Table(title="distance from the truth, nothing aligned", box=SIMPLE_HEAD, title_justify="left")
    head, rows = error_rows(found)
    for index, name in enumerate(head):
        table.add_column(name, justify="right" if index else "left")
    for row in rows:
        table.add_row(*row)
    return table


def _facts(record: RunRecord) -> Iterator[tuple[str, str]]:
    from wheelsight.cli._console import percent
    from wheelsight.report import summarise

    summary = summarise(record)
    digits = ".1f" if summary.unit == "frame" else ".4f"
    yield f"{summary.unit}s", f"{summary.posed} of {summary.frames} with a pose ({percent(summary.pose_share)})"
    if record.drops is not None and record.drops.total:
        yield "dropped", record.drops.sentence
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
