"""The report of a run: one self-contained HTML page that opens offline."""

from __future__ import annotations

import json
from html import escape
from pathlib import Path
from string import Template

from wheelsight._version import __version__
from wheelsight.app.report import html, sections
from wheelsight.app.report.pictures import packed
from wheelsight.app.report.sections import files_section, loop_section, map_section, map_tile
from wheelsight.app.run import words
from wheelsight.app.run.run_record import RunRecord
from wheelsight.app.run.verdict import Finding, RunVerdict, Summary, notes, summarise, verdict_of_run
from wheelsight.core.files import StrPath, settings_text, write_text

_BODIES = {
    "camera": "poses of the camera's optical frame (x right, y down, z forward)",
    "base": "poses of the robot's base (x forward, y left, z up)",
}


def write_report(record: RunRecord, path: StrPath) -> None:
    """Write the page about `record` to `path`, atomically, under 3 MB. Raises OutputError."""
    # A folder's name may hold bytes that are no text; they must not cost the page.
    path = Path(path)
    write_text(path, render(record, path.parent).encode("utf-8", "replace").decode("utf-8"))


def render(record: RunRecord, folder: Path | None = None) -> str:
    """The page about `record` as HTML that needs nothing outside itself; it links results that lie in `folder`."""
    summary = summarise(record)
    verdict = verdict_of_run([record])
    body = _BODIES.get(record.estimate.body, f"poses of the {record.estimate.body}")
    where = "the map" if record.estimate.frame == "map" else f"{record.estimate.frame}, where it was at first"
    footer = (
        f"{_frame(record)}: {body} in {where}. Lengths are in metres, stamps in seconds. This page needs no network."
    )
    found = notes(record)
    listed = "image" if record.unit == "frame" else "reading"
    intro = "" if found else f"Nothing: every listed {listed} was used, and every {record.unit} has a pose."
    bulleted = html.bullets(found, "notes") if found else ""
    remarks = html.section("notes", "What to know before trusting it", intro, bulleted)
    return fill_template(
        kicker="wheelsight run report",
        title=escape(record.recording),
        facts=" · ".join(escape(fact) for fact in _facts(record)),
        tone=verdict.tone,
        phrase=escape(verdict.phrase),
        findings=html.findings(shown_findings(verdict)),
        sentences=html.lines(verdict.facts),
        tiles="\n".join(html.tile(*tile) for tile in _tiles(record, summary)),
        notes=remarks,
        sections="\n".join(part for part in (*_sections(record, summary), files_section(folder)) if part),
        footer=escape(footer),
    )


def fill_template(**parts: str) -> str:
    """Fill the page's template with HTML: kicker, title, facts, tone, phrase, sentences, tiles, notes, sections,
    footer.

    Optional parts are `findings`, above the sentences, and `more`, below them.
    """
    plotly = packed(html.asset("plotly-cartesian.min.js").encode())
    script = html.asset("page.js") + (html.asset("cloud.js") if 'class="cloud"' in parts["sections"] else "")
    assets = {"style": html.asset("style.css"), "plotly": plotly, "script": script}
    assets["contents"] = html.contents(parts["notes"] + parts["sections"])
    return Template(html.asset("template.html")).substitute({"findings": "", "more": "", **parts}, **assets)


def _facts(record: RunRecord) -> list[str]:
    when = record.finished_at.strftime("%Y-%m-%d %H:%M %Z").strip()
    return [f"format {record.format}", _frame(record), when, f"wheelsight {__version__}"]


def _frame(record: RunRecord) -> str:
    return f"T_{record.estimate.frame}_{record.estimate.body}"


def _tiles(record: RunRecord, summary: Summary) -> list[tuple[str, str, str]]:
    posed = f"{summary.posed:,} of {summary.frames:,}"
    unit = summary.unit
    rate = f"{words.number(summary.frames_per_second)} {unit}s/s, 95 % under {words.duration(summary.p95_s)}"
    lost = f"{words.duration(summary.lost_s)} in all" if summary.lost_episodes else ""
    evaluation = record.evaluation
    if evaluation is None:
        error_tiles = [("ATE", words.UNKNOWN, "not evaluated")]
    else:
        ate = evaluation.ate.translation
        share = f"{words.percent(ate.rmse / summary.length_m)} of the path" if summary.length_m > 0 else ""
        tiles = [("ATE, RMSE", words.length(ate.rmse), share)]
        for name, error in (("second", evaluation.rpe_per_second), ("metre", evaluation.rpe_per_metre)):
            if error is not None:
                turn = f"{words.angle(error.rotation.in_degrees().rmse)} of rotation"
                tiles.append((f"RPE a {name}, RMSE", words.length(error.translation.rmse), turn))
        error_tiles = tiles
    return [
        *error_tiles,
        (f"{unit.capitalize()}s with a pose", words.percent(summary.pose_share), posed),
        *([("Lost episodes", str(summary.lost_episodes), lost)] if unit == "frame" else []),
        (f"Median time a {unit}", words.duration(summary.median_s), rate if summary.median_s > 0 else ""),
        ("Distance travelled", words.length(summary.length_m), "of the estimate"),
        ("Duration", words.duration(summary.duration_s), words.count(summary.frames, unit)),
        *([] if record.map is None else [map_tile(record.map)]),
        *([("Peak memory", f"{record.peak_memory_mb:,.0f} MB", "")] if record.peak_memory_mb is not None else []),
    ]


def shown_findings(verdict: RunVerdict) -> list[Finding]:
    """The findings at the top of a page: recognition in a known map, and all that are not green.

    If all are green, the share of frames with a pose.
    """
    in_map = [one for one in verdict.findings if one.about == "map"]
    concerns = [one for one in verdict.concerns if one.about != "map"]
    return [*in_map, *concerns] if concerns else [*in_map, *(one for one in verdict.findings if one.about == "poses")]


def _sections(record: RunRecord, summary: Summary) -> list[str]:
    return [
        sections.path_section(record, summary),
        loop_section(record),
        map_section(record),
        sections.errors(record),
        sections.certainty(record),
        sections.tracking(record, summary),
        sections.timing(record, summary),
        sections.pictures(record),
        settings(record),
    ]


def settings(record: RunRecord) -> str:
    """The resolved configuration, folded."""
    plain = json.loads(json.dumps(record.config, default=str))
    text = settings_text(plain) if plain else "none recorded"
    return html.section("settings", "Settings", "", html.folded("Show the settings of this run", text))
