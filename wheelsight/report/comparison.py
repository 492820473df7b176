"""One page about several odometries of one recording: where they agree, where they part, and what each cost."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from html import escape
from pathlib import Path

from wheelsight._version import __version__
from wheelsight.files import StrPath, write_text
from wheelsight.pipeline import words
from wheelsight.pipeline.joined import JOINED, BestAlone, JoinedFacts, best_alone_of, facts_of, joined_of
from wheelsight.pipeline.run_record import RunRecord
from wheelsight.pipeline.summary import Summary, summarise
from wheelsight.pipeline.verdict import Tone, Verdict, notes, true_way_m, verdict_of, verdict_of_run
from wheelsight.report import _files as files
from wheelsight.report import _html as html
from wheelsight.report import _joined as fusion
from wheelsight.report import _map as surfels
from wheelsight.report import _rectification as rectification
from wheelsight.report import _sections as sections
from wheelsight.report import comparison_figures as figures
from wheelsight.report import loop_figures
from wheelsight.report.overlay import Overlay, overlay_of
from wheelsight.report.page import fill_template, settings, shown_findings

_MOST_OF_THE_TIME = 0.95
_STEPS = ("second", "metre")
_MOST_LINES = 3
Judged = tuple[RunRecord, Summary, Verdict]


@dataclass(frozen=True, slots=True, eq=False)
class _Joined:
    """The record of joined sensors, which is the page's main answer, and what there is to say of it."""

    record: RunRecord
    facts: JoinedFacts
    best_alone: BestAlone | None


def write_comparison(records: Sequence[RunRecord], path: StrPath) -> None:
    """Write the page about `records`, each of another odometry, to `path`, atomically. Raises OutputError."""
    # A folder's name may hold bytes that are no text; they must not cost the page.
    path = Path(path)
    write_text(path, render_comparison(records, path.parent).encode("utf-8", "replace").decode("utf-8"))


def render_comparison(records: Sequence[RunRecord], folder: Path | None = None) -> str:
    """The page about several odometries as HTML that needs nothing outside; it links results that lie in `folder`."""
    joined, verdict = _joined_of(records), verdict_of_run(records)
    judged = [(record, summarise(record), verdict_of(record, records)) for record in records]
    judged.sort(key=lambda found: not found[0].is_joined)  # the main answer comes first
    is_green = verdict.tone is Tone.GREEN
    nearest = [] if is_green else [f"{_phrase(records)}."]
    paths = overlay_of(records)
    return fill_template(
        kicker="wheelsight run report",
        title=escape(records[0].recording),
        facts=" · ".join(escape(fact) for fact in _facts(records)),
        tone=verdict.tone,
        phrase=escape(_phrase(records) if joined is None and is_green else verdict.phrase),
        findings=html.findings(shown_findings(verdict)),
        sentences=html.lines(judged[0][2].facts if joined is not None else nearest + _lines(judged)),
        more=html.fold("Each in words", f"<p>{html.lines(_sentences(judged))}</p>"),
        tiles="\n".join(html.tile(*tile) for tile in _tiles(judged, joined)),
        notes=_notes(judged, paths),
        sections="\n".join(
            filter(None, (*_sections(judged, paths, joined), files.section(folder, [r.odometry for r in records])))
        ),
        footer=escape("Lengths are in metres, stamps in seconds. This page needs no network."),
    )


def _lines(judged: Sequence[Judged]) -> list[str]:
    """One a track: how long it was followed, how far off, how quick."""
    found = []
    for record, summary, _ in judged[:_MOST_LINES]:
        judged_by = record.evaluation
        off = "" if judged_by is None else f"{words.length(judged_by.ate.translation.rmse)} off (RMSE)"
        quick = f"{words.duration(summary.median_s)} a {summary.unit}" if summary.median_s > 0 else ""
        posed = f"a pose in {words.percent(summary.pose_share)} of {summary.unit}s"
        found.append(f"{record.odometry.capitalize()}: {', '.join(filter(None, (posed, off, quick)))}.")
    return found


def _sentences(judged: Sequence[Judged]) -> list[str]:
    return [f"{record.odometry.capitalize()}: {' '.join(verdict.sentences)}" for record, _, verdict in judged]


def _joined_of(records: Sequence[RunRecord]) -> _Joined | None:
    record = joined_of(records)
    return None if record is None else _Joined(record, facts_of(record), best_alone_of(records))


def comparison_rows(records: Sequence[RunRecord]) -> tuple[tuple[str, ...], list[tuple[str, ...]]]:
    """Column names with units, and one row an odometry: errors, coverage, time. For the page and for the terminal."""
    found = [record.evaluation if record.ground_truth is not None else None for record in records]
    summaries = [summarise(record) for record in records]
    seconds, metres = ([None if one is None else getattr(one, f"rpe_per_{name}") for one in found] for name in _STEPS)
    columns = [
        ("Odometry", [record.odometry for record in records]),
        words.column("ATE, RMSE", [None if one is None else one.ate.translation.rmse for one in found], "m"),
        words.column("ATE, max", [None if one is None else one.ate.translation.max for one in found], "m"),
        ("of the way", ["–" if r.evaluation is None else words.percent(_share_of_the_way(r)) for r in records]),
        words.column("RPE a second", [None if one is None else one.translation.rmse for one in seconds], "m"),
        words.column("RPE a metre", [None if one is None else one.translation.rmse for one in metres], "m"),
        words.column("turn a metre", [None if o is None else o.rotation.in_degrees().rmse for o in metres], "°"),
        ("with a pose", [words.percent(summary.pose_share) for summary in summaries]),
        ("time covered", ["–" if one is None else words.percent(one.truth_time_covered) for one in found]),
        words.column("median time", [summary.median_s for summary in summaries], "s"),
        words.column("95 % within", [summary.p95_s for summary in summaries], "s"),
    ]
    return tuple(head for head, _ in columns), list(zip(*(cells for _, cells in columns), strict=True))


def _share_of_the_way(record: RunRecord) -> float:
    """ATE over the true way."""
    assert record.evaluation is not None
    way_m = true_way_m(record)
    return record.evaluation.ate.translation.rmse / way_m if way_m > 0 else float("nan")


def _facts(records: Sequence[RunRecord]) -> list[str]:
    when = records[0].finished_at.strftime("%Y-%m-%d %H:%M %Z").strip()
    frames = ", ".join(f"{r.odometry} T_{r.estimate.frame}_{r.estimate.body}" for r in records)
    return [f"format {records[0].format}", frames, when, f"wheelsight {__version__}"]


def _phrase(records: Sequence[RunRecord]) -> str:
    """What areas did, or which came nearest to the truth, of those with poses throughout: few poses err less."""
    of_areas = [rectification.phrase(r.rectification) for r in records if r.rectification is not None]
    if of_areas and of_areas[0] is not None:
        return of_areas[0]
    evaluated = [(record.evaluation, record) for record in records if record.evaluation is not None]
    if not evaluated:
        return "Side by side, without a truth to judge them by"
    whole = [(found, record) for found, record in evaluated if found.truth_time_covered >= _MOST_OF_THE_TIME]
    if not whole:
        return "Followed throughout by none"
    found, record = min(whole, key=lambda pair: pair[0].ate.translation.rmse)
    name, error = record.odometry.capitalize(), words.length(found.ate.translation.rmse)
    if len(whole) == 1:
        return f"Followed throughout by {record.odometry} alone, {error} off (RMSE)"
    return f"{name} came nearest to the truth, {error} off (RMSE)"


def _tiles(judged: Sequence[Judged], joined: _Joined | None) -> Iterable[tuple[str, str, str]]:
    if joined is not None:
        yield from fusion.tiles(joined.record, joined.facts, joined.best_alone)
    for record, _, _ in judged:
        yield from rectification.tiles(record)
    for record, summary in ((record, summary) for record, summary, _ in judged if not record.is_joined):
        if record.evaluation is None and joined is None:
            yield f"ATE, {record.odometry}", words.UNKNOWN, "not evaluated"
        if record.evaluation is None:
            continue
        more = f"{words.percent(_share_of_the_way(record))} of the way"
        if joined is not None and summary.pose_share < _MOST_OF_THE_TIME:
            more = f"where it has a pose, {words.percent(summary.pose_share)}"
        yield f"ATE, {record.odometry}", words.length(record.evaluation.ate.translation.rmse), more
    for record, summary, _ in judged if joined is None or joined.record.evaluation is None else ():
        posed = f"{summary.posed:,} of {words.count(summary.frames, summary.unit)}"
        yield f"With a pose, {record.odometry}", words.percent(summary.pose_share), posed
    for record, summary, _ in judged if joined is None else judged[:1]:
        yield f"Time a {summary.unit}, {record.odometry}", words.duration(summary.median_s), "median"
    yield from (surfels.tile(record.map) for record, _, _ in judged if record.map is not None)
    yield "Duration", words.duration(max(summary.duration_s for _, summary, _ in judged)), "one pass for all"
    memory_mb = max((r.peak_memory_mb for r, _, _ in judged if r.peak_memory_mb is not None), default=None)
    if memory_mb is not None:
        yield "Peak memory", f"{memory_mb:,.0f} MB", ""


def _notes(judged: Sequence[Judged], paths: Overlay) -> str:
    """What holds for all once, and what holds for one under its name."""
    of_each = {r.odometry: [*notes(r), *rectification.notes(r)] for r, _, _ in judged}
    shared = [note for note in next(iter(of_each.values())) if all(note in found for found in of_each.values())]
    own = [f"{name.capitalize()}: {note}" for name, found in of_each.items() for note in found if note not in shared]
    out = [
        f"{name.capitalize()}: not drawn with the others ({why.rstrip('.')})." for name, why in paths.left_out.items()
    ]
    found = [*shared, *own, *out]
    intro = "" if found else "Nothing: everything listed was used, and every answer has a pose."
    body = html.bullets(found, "notes") if found else ""
    return html.section("notes", "What to know before trusting it", intro, body)


def _sections(judged: Sequence[Judged], paths: Overlay, joined: _Joined | None) -> Iterable[str]:
    records = sorted(
        (record for record, _, _ in judged), key=lambda record: record.is_joined
    )  # in figures it is on top
    of_areas = rectification.section(records)
    yield of_areas if joined is None else ""
    yield _path(records, paths)
    if joined is not None:
        yield fusion.section(joined.record, joined.facts)
        yield surfels.section(joined.record, joined.record.odometry)
        yield of_areas
    yield _errors(records)
    yield _bands(records)
    for record, summary, _ in judged:
        yield from _details(record, summary)
    yield settings(records[0])


def _details(record: RunRecord, summary: Summary) -> Iterable[str]:
    """What there is to say of one odometry; of joined sensors only what is not said above already."""
    of = record.odometry
    yield sections.certainty(record, of)
    if record.unit == "frame" and record.rectification is None and not record.is_joined:
        yield sections.tracking(record, summary, of)
    yield loop_figures.section(record, of)
    yield sections.timing(record, summary, of)
    if not record.is_joined:
        yield surfels.section(record, of)
    yield sections.pictures(record, of)


def _path(records: Sequence[RunRecord], paths: Overlay) -> str:
    title = "Where each went"
    if not paths.paths_m:
        return html.section("path", title, "", html.paragraph("No pose was found, so there is no path.", "missing"))
    if paths.by == "true start":
        intro = (
            "Each path begins where the truth does, in its direction, and nothing is fitted afterwards: where it "
            "leaves the truth, it has drifted."
        )
    elif paths.by == "truth":
        intro = (
            "Each path by itself is laid upon the ground truth by one rigid motion, as ATE does it: what is left is "
            "the error of its shape, and not where it drifts to from a common start."
        )
    else:
        intro = (
            "Without a ground truth to lay them upon, the paths begin at one point in one direction: where they "
            "part, at least one of them is wrong."
        )
    if JOINED in paths.trajectories:
        intro += (
            " Ellipses are where the joined sensors say that the robot is, by 3σ; where none is seen, they are smaller "
            "than the line. The legend shows those of the others too."
        )
    names = ", ".join(paths.paths_m)
    sentence = "Seen from above. Lines break where no pose is known; squares are where each one ends."
    plot = html.plot("overlay", figures.overlay_figure(paths), "x–y", sentence, f"Paths of {names} seen from above.")
    return html.section("path", title, intro, plot)


def _errors(records: Sequence[RunRecord]) -> str:
    title = "How far off each was, and what it cost"
    caption = (
        "One row an odometry. RPE is RMSE, “turn a metre” its rotation; the time is of one frame or reading, reading "
        "images not included. Errors speak only of the time covered."
    )
    table = html.table(caption, *comparison_rows(records), main=JOINED)
    evaluated = [record for record in records if record.evaluation is not None]
    if not evaluated:
        why = records[0].evaluation_problem or "the recording has no ground truth"
        return html.section("errors", title, "", html.paragraph(f"Not evaluated: {why.rstrip('.')}.", "missing"), table)
    sentence = (
        "ATE is the distance to the true position once the path is laid upon the truth; RPE is the error of the motion "
        "over one second, which tells when it went wrong."
    )
    alt = "Errors over time of " + ", ".join(record.odometry for record in evaluated) + "."
    plot = html.plot("errors", figures.errors_figure(records), "Error over time", sentence, alt)
    all_errors = (html.fold(f"All errors of {r.odometry}", sections.error_table(r)) for r in evaluated)
    return html.section("errors", title, "", table, plot, *all_errors)


def _bands(records: Sequence[RunRecord]) -> str:
    if not any(record.frames for record in records):
        return ""
    shares = ", ".join(f"{record.odometry} {words.percent(summarise(record).pose_share)}" for record in records)
    sentence = "In an odometry's own colour its pose is known; other colours say why it is not."
    if joined_of(records) is not None:
        sentence += " While coasting, joined sensors know it by the wheels alone."
    plot = html.plot(
        "bands",
        figures.bands_figure(records),
        "Status over time",
        sentence,
        f"With a pose: {shares}.",
    )
    return html.section("bands", "When each was followed", "", plot)
