"""One page about several odometries of one recording: their paths, errors and times. Has the sections of joined sensors
and of areas that rectify wheels.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Sequence
from pathlib import Path

import numpy as np

from wheelsight import __version__
from wheelsight.app.run import words
from wheelsight.app.run.run_record import RectificationRecord, RunRecord
from wheelsight.app.run.verdict import (
    JOINED,
    BestAlone,
    JoinedFacts,
    RunVerdict,
    Summary,
    Tone,
    best_alone_of,
    facts_of,
    joined_of,
    notes,
    summarise,
    true_way_m,
    verdict_of,
    verdict_of_run,
)
from wheelsight.core.estimates import Status
from wheelsight.core.files import StrPath
from wheelsight_report import comparison_figures as figures
from wheelsight_report import figures as joined_figures
from wheelsight_report import html, sections
from wheelsight_report.comparison_figures import (
    Overlay,
    area_map_figure,
    area_time_figure,
    map_error_figure,
    overlay_of,
    trust_figure,
)
from wheelsight_report.page import finished, settings, shown_findings, write_report
from wheelsight_report.sections import files_section, loop_section, map_section, map_tile

_MOST_OF_THE_TIME = 0.95
_STEPS = ("second", "metre")
_MOST_LINES = 3
Judged = tuple[RunRecord, Summary, RunVerdict]


def write_page(records: Sequence[RunRecord], path: StrPath) -> None:
    """Write the page of one odometry, or that of several side by side.

    Raises:
        OutputError: it cannot be written.
        ConfigError: plotly is not installed.
    """
    if len(records) == 1:
        write_report(records[0], path)
    else:
        write_comparison(records, path)


def write_comparison(records: Sequence[RunRecord], path: StrPath) -> None:
    """Write the page about `records`, each of another odometry, to `path`, atomically. Raises OutputError."""
    html.save(render_comparison(records, Path(path).parent), path)


def render_comparison(records: Sequence[RunRecord], folder: StrPath | None = None) -> str:
    """The page about several odometries as self-contained HTML, with links to results in `folder`."""
    joined, verdict = joined_of(records), verdict_of_run(records)
    judged = [(record, summarise(record), verdict_of(record, records)) for record in records]
    judged.sort(key=lambda found: not found[0].is_joined)  # the main answer comes first
    is_green = verdict.tone is Tone.GREEN
    sentences = [] if is_green else [f"{_phrase(records)}."]
    for record, summary, _ in judged[:_MOST_LINES]:  # coverage, error and speed of each
        off = "" if record.evaluation is None else f"{words.length(record.evaluation.ate.translation.rmse)} off (RMSE)"
        quick = f"{words.duration(summary.median_s)} a {summary.unit}" if summary.median_s > 0 else ""
        posed = f"a pose in {words.percent(summary.pose_share)} of {summary.unit}s"
        sentences.append(f"{record.odometry.capitalize()}: {', '.join(filter(None, (posed, off, quick)))}.")
    in_words = (f"{record.odometry.capitalize()}: {' '.join(one.sentences)}" for record, _, one in judged)
    frames = ", ".join(f"{r.odometry} T_{r.estimate.frame}_{r.estimate.body}" for r in records)
    paths = overlay_of(records)
    # Common notes once, others under the name of their odometry
    of_each = {r.odometry: [*notes(r), *rectification_notes(r)] for r, _, _ in judged}
    shared = [note for note in next(iter(of_each.values())) if all(note in found for found in of_each.values())]
    own = [f"{name.capitalize()}: {note}" for name, found in of_each.items() for note in found if note not in shared]
    undrawn = [
        f"{name.capitalize()}: not drawn with the others ({w.rstrip('.')})." for name, w in paths.left_out.items()
    ]
    return html.page(
        kicker="wheelsight run report",
        title=records[0].recording,
        facts=(f"format {records[0].format}", frames, finished(records[0]), f"wheelsight {__version__}"),
        tone=verdict.tone,
        phrase=_phrase(records) if joined is None and is_green else verdict.phrase,
        found=shown_findings(verdict),
        sentences=judged[0][2].facts if joined is not None else sentences,
        more=html.fold("Each in words", f"<p>{html.lines(in_words)}</p>"),
        tiles=_tiles(judged, joined, best_alone_of(records)),
        notes=[*shared, *own, *undrawn],
        no_notes="Nothing: everything listed was used, and every answer has a pose.",
        sections=(*_sections(judged, paths, joined), files_section(folder, [r.odometry for r in records])),
        footer="Lengths are in metres, stamps in seconds. This page needs no network.",
    )


def comparison_rows(records: Sequence[RunRecord]) -> words.Table:
    """Column names with units, and one row an odometry: errors, coverage, time. For the page and for the terminal."""
    found = [record.evaluation if record.ground_truth is not None else None for record in records]
    summaries = [summarise(record) for record in records]
    seconds, metres = ([None if one is None else getattr(one, f"rpe_per_{name}") for one in found] for name in _STEPS)
    return words.table(
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
    )


def _share_of_the_way(record: RunRecord) -> float:
    """ATE over the length of the true path."""
    assert record.evaluation is not None
    way_m = true_way_m(record)
    return record.evaluation.ate.translation.rmse / way_m if way_m > 0 else float("nan")


def _phrase(records: Sequence[RunRecord]) -> str:
    """The effect of areas, or the most accurate odometry among those with poses throughout."""
    of_areas = [phrase(r.rectification) for r in records if r.rectification is not None]
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


def _tiles(
    judged: Sequence[Judged], joined: RunRecord | None, best_alone: BestAlone | None
) -> Iterable[tuple[str, str, str]]:
    if joined is not None:
        yield from tiles(joined, facts_of(joined), best_alone)
    for record, _, _ in judged:
        yield from rectification_tiles(record)
    for record, summary in ((record, summary) for record, summary, _ in judged if not record.is_joined):
        if record.evaluation is None and joined is None:
            yield f"ATE, {record.odometry}", words.UNKNOWN, "not evaluated"
        if record.evaluation is None:
            continue
        more = f"{words.percent(_share_of_the_way(record))} of the way"
        if joined is not None and summary.pose_share < _MOST_OF_THE_TIME:
            more = f"where it has a pose, {words.percent(summary.pose_share)}"
        yield f"ATE, {record.odometry}", words.length(record.evaluation.ate.translation.rmse), more
    for record, summary, _ in judged if joined is None or joined.evaluation is None else ():
        posed = f"{summary.posed:,} of {words.count(summary.frames, summary.unit)}"
        yield f"With a pose, {record.odometry}", words.percent(summary.pose_share), posed
    for record, summary, _ in judged if joined is None else judged[:1]:
        yield f"Time a {summary.unit}, {record.odometry}", words.duration(summary.median_s), "median"
    yield from (map_tile(record.map) for record, _, _ in judged if record.map is not None)
    yield "Duration", words.duration(max(summary.duration_s for _, summary, _ in judged)), "one pass for all"
    memory_mb = max((r.peak_memory_mb for r, _, _ in judged if r.peak_memory_mb is not None), default=None)
    if memory_mb is not None:
        yield "Peak memory", f"{memory_mb:,.0f} MB", ""


def _sections(judged: Sequence[Judged], paths: Overlay, joined: RunRecord | None) -> Iterable[str]:
    records = sorted((record for record, _, _ in judged), key=lambda record: record.is_joined)  # drawn on top
    of_areas = rectification_section(records)
    yield of_areas if joined is None else ""
    yield _path(records, paths)
    if joined is not None:
        yield joined_section(joined, facts_of(joined))
        yield map_section(joined, joined.odometry)
        yield of_areas
    yield _errors(records)
    if any(record.frames for record in records):
        shares = ", ".join(f"{record.odometry} {words.percent(summarise(record).pose_share)}" for record in records)
        sentence = "In an odometry's own colour its pose is known; other colours say why it is not."
        if joined is not None:
            sentence += " While coasting, joined sensors know it by the wheels alone."
        figure = figures.bands_figure(records)
        plot = html.plot("bands", figure, "Status over time", sentence, f"With a pose: {shares}.")
        yield html.section("bands", "When each was followed", "", plot)
    for record, summary, _ in judged:
        # Sections of one odometry, without those that joined sensors have above
        of = record.odometry
        yield sections.certainty(record, of)
        if record.unit == "frame" and record.rectification is None and not record.is_joined:
            yield sections.tracking(record, summary, of)
        yield loop_section(record, of)
        yield sections.timing(record, summary, of)
        if not record.is_joined:
            yield map_section(record, of)
        yield sections.pictures(record, of)
    yield settings(records[0])


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
        "over one second, which shows when it went wrong."
    )
    alt = "Errors over time of " + ", ".join(record.odometry for record in evaluated) + "."
    plot = html.plot("errors", figures.errors_figure(records), "Error over time", sentence, alt)
    all_errors = (html.fold(f"All errors of {r.odometry}", sections.error_table(r)) for r in evaluated)
    return html.section("errors", title, "", table, plot, *all_errors)


def tiles(record: RunRecord, facts: JoinedFacts, best_alone: BestAlone | None) -> Iterable[tuple[str, str, str]]:
    """Key figures of joined sensors."""
    if record.evaluation is None:
        yield "ATE, joined", words.UNKNOWN, "not evaluated"
    else:
        more = (
            "RMSE" if best_alone is None else f"{words.number(best_alone.ratio, 2)} times that of {best_alone.odometry}"
        )
        yield "ATE, joined", words.length(record.evaluation.ate.translation.rmse), more
    found = facts.consistency
    if found is not None:
        yield "Within its stated 3σ", words.percent(found.share), "of the time"
        yield "Off at the end", words.length(found.drift_m), f"{words.percent(found.drift_share)} of the way"
    elif record.estimate.covariances is not None and len(record.estimate):
        yield "3σ at the end", words.length(3 * joined_figures.standard_deviations(record.estimate)[0][-1]), "as stated"
    coasting = sum(facts.coasting_s)
    yield (
        "Coasting",
        words.duration(coasting),
        f"{words.times(len(facts.coasting_s))}, {words.duration(max(facts.coasting_s))} at most"
        if coasting
        else "never",
    )
    if facts.flag_shares:
        (first, share), *others = facts.flag_shares.items()
        yield f"Flagged: {first}", _share(share), ", ".join(f"{flag} {_share(share)}" for flag, share in others)


def joined_section(record: RunRecord, facts: JoinedFacts) -> str:
    """Errors beside their stated uncertainty, statuses and flags on one time axis; the camera's matches below."""
    key, title = "joined-trust", "Joined: how far to trust it"
    if not record.frames:
        return ""
    if record.estimate.covariances is None:
        status = html.plot(
            "joined-status", joined_figures.status_figure(record), "Status over time", "", "No pose is known."
        )
        return html.section(key, title, "", html.paragraph("No pose was found.", "missing"), status)
    found = facts.consistency
    intro = (
        "Tracking is when the camera was believed, coasting when the wheels alone led. Flagged is slip, when the "
        "wheels were not believed; doubtful, when camera and wheels contradicted each other and it was not known which "
        "was right; degenerate, when an image did not show all directions."
    )
    sentence = (
        "The band is ±3σ as the filter stated it. Without a truth, whether that is honest cannot be said."
        if found is None
        else "Estimated minus true position, as the robot sees it, begun at the true start and never fitted again. The "
        "band is ±3σ as the filter stated it; red is where the true position lies beyond it. (Both directions are "
        "judged together, by the 3σ ellipse.)"
    )
    # Which sensor led
    led = "the camera led throughout"
    if facts.coasting_s:
        share = words.percent(facts.share_of(Status.COASTING))
        whole, longest = words.duration(sum(facts.coasting_s)), words.duration(max(facts.coasting_s))
        led = f"it coasted on the wheels {words.times(len(facts.coasting_s))}, for {whole} in all ({share} of the time)"
        led += f", {longest} at most" if len(facts.coasting_s) > 1 else ""
    elif not facts.seconds.get(Status.TRACKING):
        led = "it never tracked"
    lost_s = facts.seconds.get(Status.LOST, 0.0)
    led += f", and was lost for {words.duration(lost_s)}" if lost_s else ""
    alt = f"{led[0].upper()}{led[1:]}."
    if found is not None:
        alt += (
            f" Begun at the true start, it ends {words.length(found.drift_m)} off, "
            f"{words.percent(found.drift_share)} of the way; the position is within its stated 3σ in "
            f"{words.percent(found.share)} of the time."
        )
    plot = html.plot(key, trust_figure(record, found), "Error, stated error, status", sentence, alt)
    return html.section(key, title, intro, plot, sections.matches(record, record.odometry))


def _share(share: float) -> str:
    return words.percent(share) if share else "never"


_DOUBT = 0.5
_WAYS = {"probabilistic": "probabilities, filtered", "paper": "eq. 5 of Trinh et al."}


def phrase(found: RectificationRecord) -> str | None:
    """Error of the rectified wheels relative to the wheels alone, or None if it is not smaller."""
    if found.errors is None or not found.errors.left < 1:
        return None
    before, after = (words.length(s.mean) for s in (found.errors.wheels, found.errors.rectified))
    return f"Areas bring the wheels from {before} to {after} off (mean)"


def rectification_tiles(record: RunRecord) -> Iterable[tuple[str, str, str]]:
    """Key figures of areas."""
    found = record.rectification
    if found is None:
        return
    if found.errors is not None:
        before = f"wheels alone {words.length(found.errors.wheels.mean)}"
        yield "In the map, mean error", words.length(found.errors.rectified.mean), before
    if found.is_judged.any():
        more = "" if found.belief is None else f"filtered {words.percent(found.accuracy(found.belief))}"
        yield "Right area, frame by frame", words.percent(found.accuracy(found.forest)), more


def rectification_notes(record: RunRecord) -> list[str]:
    """Notes on frames without a measurement, models without answers, and distrusted models."""
    found = record.rectification
    if found is None or not found.looks:
        return []
    said = []
    unmeasured = [look.note for look in found.looks if look.probabilities is None]
    if unmeasured:
        kinds = Counter(note.removeprefix("no measurement: ") or "no pose yet" for note in unmeasured)
        which = ", ".join(f"{why} ({n:,})" for why, n in kinds.most_common(5))
        said.append(f"{words.count(len(unmeasured), 'frame')} gave no probabilities: {which}.")
    if found.way == "paper" and not any(look.named >= 0 for look in found.looks):
        said.append("The model was never sure enough to name an area, so that eq. 5 had nothing to go by.")
    distrusted = np.isfinite(found.trust) & (found.trust < _DOUBT)
    if distrusted.any():
        share = words.percent(float(distrusted.mean()))
        said.append(f"The model was not trusted in {share} of the frames, and corrected little there.")
    return said


def error_rows(found: RectificationRecord) -> words.Table:
    """Column names with units, and a row for the wheels alone and one for the rectified path; none without truth."""
    errors = found.errors
    if errors is None:
        return (), []
    both = ("wheels", errors.wheels, errors.wheels_m), ("rectified", errors.rectified, errors.rectified_m)
    return words.table(
        ("Path", [name for name, _, _ in both]),
        words.column("mean", [one.mean for _, one, _ in both], "m"),
        words.column("RMSE", [one.rmse for _, one, _ in both], "m"),
        words.column("median", [one.median for _, one, _ in both], "m"),
        words.column("maximum", [one.max for _, one, _ in both], "m"),
        words.column("at the end", [float(each_m[-1]) for _, _, each_m in both], "m"),
        (
            "of the wheels' mean",
            [words.percent(one.mean / errors.wheels.mean if errors.wheels.mean > 0 else None) for _, one, _ in both],
        ),
    )


def rectification_section(records: Sequence[RunRecord]) -> str:
    """The effect of areas on the wheels: map, errors, probabilities over time; "" without places."""
    record = next((record for record in records if record.rectification is not None), None)
    if record is None or record.rectification is None:
        return ""
    found = record.rectification
    intro = (
        f"Wheels lead from frame to frame; the area that each frame shows corrects them, by {_WAYS[found.way]}. Here "
        f"nothing is laid upon anything: all paths are where they say they are in the map of the areas. {found.start}"
    )
    area_map = html.plot(
        "area-map",
        area_map_figure(record),
        "On the map of areas",
        "Seen from above. All begin at the ring; squares are where each one ends.",
        "Areas from above with the paths of wheels alone, of rectified wheels, and of the ground truth where known.",
    )
    if found.errors is None:
        errors = html.paragraph("Without a ground truth, how far off either is cannot be said.", "missing")
    else:
        frames = words.count(len(found.errors.stamps_s), "frame")
        caption = f"Distance from the true base in x and y, nothing aligned, over {frames}."
        wheels_m, rectified_m = (words.length(one.mean) for one in (found.errors.wheels, found.errors.rectified))
        alt = f"Distances from the truth over time, wheels {wheels_m} in the mean; rectified {rectified_m} in the mean."
        sentence = "Wheels drift away for good; what is rectified is brought back at each change of area."
        plot = html.plot("map-error", map_error_figure(record), "Error in the map over time", sentence, alt)
        errors = html.table(caption, *error_rows(found)) + "\n" + plot
    if not found.looks:
        over_time = html.paragraph("No frame was looked at.", "missing")
    else:
        sentence = "One row an area, in its colour on the map: the fuller, the more probable."
        if found.true_areas is not None:
            sentence += " The line is the area in which the robot truly was."
        alt = "Probability of each area over time"
        if found.is_judged.any():
            right = words.percent(found.accuracy(found.forest))
            alt += f"; the most probable one is right in {right} of the frames"
        over_time = html.plot("area-time", area_time_figure(record), "Areas along time", sentence, alt + ".")
    return html.section("areas", "What areas did to the wheels", intro, area_map, errors, over_time)
