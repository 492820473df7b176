"""The report of a run: one self-contained HTML page that opens offline."""

from __future__ import annotations

import json
from pathlib import Path

from wheelsight import __version__
from wheelsight.app.run import words
from wheelsight.app.run.run_record import RunRecord
from wheelsight.app.run.verdict import Finding, RunVerdict, notes, summarise, verdict_of_run
from wheelsight.core.files import StrPath, settings_text
from wheelsight.core.runtime import why_missing
from wheelsight_report import html, sections
from wheelsight_report.sections import files_section, loop_section, map_section, map_tile

_BODIES = {
    "camera": "poses of the camera's optical frame (x right, y down, z forward)",
    "base": "poses of the robot's base (x forward, y left, z up)",
}


def write_report(record: RunRecord, path: StrPath) -> None:
    """Write the page about `record` to `path`, atomically, under 3 MB. Raises OutputError."""
    summary, verdict = summarise(record), verdict_of_run([record])
    frame = f"T_{record.estimate.frame}_{record.estimate.body}"
    body = _BODIES.get(record.estimate.body, f"poses of the {record.estimate.body}")
    where = "the map" if record.estimate.frame == "map" else f"{record.estimate.frame}, where it was at first"
    listed = "image" if record.unit == "frame" else "reading"
    posed = f"{summary.posed:,} of {summary.frames:,}"
    unit = summary.unit
    rate = f"{words.number(summary.frames_per_second)} {unit}s/s, 95 % under {words.duration(summary.p95_s)}"
    lost = f"{words.duration(summary.lost_s)} in all" if summary.lost_episodes else ""
    evaluation = record.evaluation
    if evaluation is None:
        tiles = [("ATE", words.UNKNOWN, "not evaluated")]
    else:
        ate = evaluation.ate.translation
        share = f"{words.percent(ate.rmse / summary.length_m)} of the path" if summary.length_m > 0 else ""
        tiles = [("ATE, RMSE", words.length(ate.rmse), share)]
        for name, error in (("second", evaluation.rpe_per_second), ("metre", evaluation.rpe_per_metre)):
            if error is not None:
                turn = f"{words.angle(error.rotation.in_degrees().rmse)} of rotation"
                tiles.append((f"RPE a {name}, RMSE", words.length(error.translation.rmse), turn))
    page = html.page(
        kicker="wheelsight run report",
        title=record.recording,
        facts=(f"format {record.format}", frame, finished(record), f"wheelsight {__version__}"),
        tone=verdict.tone,
        phrase=verdict.phrase,
        found=shown_findings(verdict),
        sentences=verdict.facts,
        tiles=[
            *tiles,
            (f"{unit.capitalize()}s with a pose", words.percent(summary.pose_share), posed),
            *([("Lost episodes", str(summary.lost_episodes), lost)] if unit == "frame" else []),
            (f"Median time a {unit}", words.duration(summary.median_s), rate if summary.median_s > 0 else ""),
            ("Distance travelled", words.length(summary.length_m), "of the estimate"),
            ("Duration", words.duration(summary.duration_s), words.count(summary.frames, unit)),
            *([] if record.map is None else [map_tile(record.map)]),
            *([("Peak memory", f"{record.peak_memory_mb:,.0f} MB", "")] if record.peak_memory_mb is not None else []),
        ],
        notes=notes(record),
        no_notes=f"Nothing: every listed {listed} was used, and every {record.unit} has a pose.",
        sections=(
            sections.path_section(record, summary),
            loop_section(record),
            map_section(record),
            sections.errors(record),
            sections.certainty(record),
            sections.tracking(record, summary),
            sections.timing(record, summary),
            sections.pictures(record),
            settings(record),
            files_section(Path(path).parent),
        ),
        footer=f"{frame}: {body} in {where}. Lengths are in metres, stamps in seconds. This page needs no network.",
    )
    html.save(page, path)


def finished(record: RunRecord) -> str:
    """The time at the end of the run."""
    return record.finished_at.strftime("%Y-%m-%d %H:%M %Z").strip()


def shown_findings(verdict: RunVerdict) -> list[Finding]:
    """The findings at the top of a page: recognition in a known map, and all that are not green.

    If all are green, the share of frames with a pose.
    """
    in_map = [one for one in verdict.findings if one.about == "map"]
    concerns = [one for one in verdict.concerns if one.about != "map"]
    return [*in_map, *concerns] if concerns else [*in_map, *(one for one in verdict.findings if one.about == "poses")]


def settings(record: RunRecord) -> str:
    """The resolved configuration, folded."""
    plain = json.loads(json.dumps(record.config, default=str))
    text = settings_text(plain) if plain else "none recorded"
    return html.section("settings", "Settings", "", html.folded("Show the settings of this run", text))


def why_no_page() -> str | None:
    """Why no page can be written: plotly is not installed. None if it is."""
    return why_missing("plotly")
