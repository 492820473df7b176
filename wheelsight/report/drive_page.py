"""The page and the picture of a drive: where it was to go, where it went, what held it, and what it saw."""

from __future__ import annotations

import math
from html import escape
from pathlib import Path

import numpy as np

from wheelsight._version import __version__
from wheelsight.files import StrPath, settings_text, write_text
from wheelsight.geometry import ByteArray
from wheelsight.mapping.occupancy_picture import PlanLine, PlanMark, picture_of, save_picture
from wheelsight.pipeline import words
from wheelsight.pipeline.drive_record import DriveRecord, FilmImage
from wheelsight.report import _html as html
from wheelsight.report import drive_figures as figures
from wheelsight.report.drive_tables import goal_rows, stop_rows, transition_rows
from wheelsight.report.page import fill_template
from wheelsight.report.places_sheet import jpeg_uri

_PLANNED, _DRIVEN, _STOPPED, _GOAL, _START = (230, 159, 0), (0, 114, 178), (213, 94, 0), (204, 121, 167), (0, 158, 115)
_WALKED = (86, 180, 233)
_ROBOT_EVERY_M = 1.0
_FOOTER = "Lengths are in metres, stamps in seconds, poses of the base in the map. This page needs no network."


def write_drive_picture(record: DriveRecord, path: StrPath) -> None:
    """drive.png: the map with what was planned and driven, atomically. Raises OutputError."""
    save_picture(drive_picture(record), path)


def drive_picture(record: DriveRecord) -> ByteArray:
    """(h, w, 3) uint8 red, green, blue."""
    poses = record.rows.poses
    known = poses[np.isfinite(poses).all(axis=1)]
    lines = [PlanLine(plan[:, :2], _PLANNED, "planned") for _, plan in record.plans]
    corners = record.footprint.at(figures.apart(known, _ROBOT_EVERY_M))
    lines += [PlanLine(np.vstack([outline, outline[:1]]), (150, 190, 215), width_px=1) for outline in corners]
    lines.append(PlanLine(known[:, :2], _DRIVEN, "driven", 3))
    marks = [PlanMark(stop.pose[:2], "cross", _STOPPED, "held") for stop in record.stops if stop.pose is not None]
    lines += [PlanLine(way, _WALKED, "somebody walked", 2) for way in figures.walked(record.people)]
    marks += [PlanMark(known[0, :2], "circle", _START, "start")] if len(known) else []
    marks += [PlanMark(goal.goal[:2], "square", _GOAL, "goal", goal.name) for goal in record.goals if goal.is_place]
    return picture_of(record.grid, lines=lines, marks=marks)


def write_drive_page(record: DriveRecord, path: StrPath) -> None:
    """Write the page, atomically, about 5 MB.

    Raises:
        OutputError: it cannot be written.
        ConfigError: plotly is not installed.
    """
    path = Path(path)
    write_text(path, render_drive(record).encode("utf-8", "replace").decode("utf-8"))


def render_drive(record: DriveRecord) -> str:
    """The page as HTML that refers to nothing outside itself."""
    phrase, sentences, tone = verdict(record)
    facts = [record.robot, record.finished_at.strftime("%Y-%m-%d %H:%M %Z").strip(), f"wheelsight {__version__}"]
    return fill_template(
        kicker="wheelsight drive",
        title=escape(f"{_names(record)} in {record.map_name}"),
        facts=" · ".join(escape(fact) for fact in facts),
        tone=tone,
        phrase=escape(phrase),
        sentences=escape(sentences),
        tiles="\n".join(html.tile(*tile) for tile in _tiles(record)),
        notes="",
        sections="\n".join(
            (_plan(record), _time_line(record), _film(record), _goals(record), _stops(record), _log(record))
        ),
        footer=escape(_FOOTER),
    )


def verdict(record: DriveRecord) -> tuple[str, str, str]:
    """Phrase, sentences and tone."""
    reached = sum(goal.result.has_arrived for goal in record.goals)
    of_all = f"{reached} of {words.count(record.asked, 'goal')} reached"
    if record.is_interrupted:
        return (
            "Interrupted",
            f"{reached} of {words.count(record.asked, 'goal')} reached; the robot was stopped.",
            "amber",
        )
    if not record.has_arrived:
        last = record.goals[-1] if record.goals else None
        why = "" if last is None else f"{last.name}: {last.result.reason} ({last.result.detail})."
        return of_all, why, "red"
    if record.contacts:
        return (
            f"Arrived, with {words.count(len(record.contacts), 'collision')}",
            f"{', '.join(record.contacts)}.",
            "red",
        )
    told = [f"{goal.name}: {goal.result.goal_change}." for goal in record.goals if goal.result.goal_change]
    if record.rests_on_start:
        told.append("Nothing of the map was recognised: all of it rests on the start that was said.")
    helped = sum(goal.result.recoveries for goal in record.goals)
    if helped:
        told.append(f"{words.count(helped, 'time')} it had to get itself out or find out where it was.")
    return "Arrived", " ".join(told) or "At every goal, by its own localization.", "amber" if told else "green"


def _names(record: DriveRecord) -> str:
    names = [goal.name for goal in record.goals]
    return "To " + (", then ".join(names) if names else "nowhere")


def _tiles(record: DriveRecord) -> list[tuple[str, str, str]]:
    held_s = sum(stop.end_s - stop.begin_s for stop in record.stops)
    near = words.length(record.clearance_m) if math.isfinite(record.clearance_m) else "nothing near"
    offs = [goal.off_m for goal in record.goals if goal.result.has_arrived and math.isfinite(goal.off_m)]
    tiles = [
        ("Way driven", words.length(record.way_m), f"first plans: {words.length(record.planned_m)}"),
        ("Time", words.duration(record.time_s), f"{words.number(record.way_m / max(record.time_s, 1e-9))} m/s in all"),
        ("Clearance", near, "least, as map and camera showed"),
        *_people_tile(record),
        ("Held", words.count(len(record.stops), "time"), f"{words.duration(held_s)} in all"),
        ("Plans", str(sum(goal.result.plans for goal in record.goals)), ""),
    ]
    if offs:
        tiles.append(("Off the goal", words.length(max(offs)), "at most, as the robot believes"))
    if record.loops is not None:
        tiles.append(("Loops closed", str(record.loops), "between keyframes of the map that it left"))
    periods = record.periods
    if periods.late:
        late = f"{words.count(periods.late, 'period')} of {periods.count:,} of the control loop took longer"
        tiles.append(("Longest period", words.duration(periods.longest_s), late))
    if record.truth:
        clear = f"true clearance {words.length(record.truth['clearance_m'])}"
        tiles.append(("Collisions", str(len(record.contacts)), clear))
    return tiles


def _people_tile(record: DriveRecord) -> list[tuple[str, str, str]]:
    if not len(record.people):
        return []
    return [
        ("Nearest person", words.length(float(record.people[:, 3].min())), "who walked, as the camera followed him")
    ]


def _plan(record: DriveRecord) -> str:
    intro = (
        "The map, what was planned (orange) and what was driven (blue), from the circle to the squares; crosses are "
        "where the robot was held, light blue where it knew somebody to walk."
    )
    alt = f"The map from above with the way of the robot, {words.length(record.way_m)} long."
    plot = html.plot("drive-map-plan", figures.plan_figure(record), "From above", "", alt)
    return html.section("plan", "Where it went", intro, plot)


def _time_line(record: DriveRecord) -> str:
    sentence = (
        "Above, what the navigator was about, where the localization stood, and what the collision monitor made of "
        "the commands; below, the speeds that the wheels measured. Single readings may run off an axis."
    )
    alt = f"States and speeds over {words.duration(record.time_s)}."
    plot = html.plot("time-line", figures.time_line_figure(record), "States and speeds", sentence, alt)
    return html.section("time", "What it did when", "", plot)


def _film(record: DriveRecord) -> str:
    if not record.images:
        return ""
    pictures = [_picture(image, max(image.stamp_s - record.begin_s, 0.0)) for image in record.images]
    return html.section("film", "What it saw", "Images of its camera on the way.", html.group("strip", pictures))


def _picture(image: FilmImage, after_s: float) -> str:
    return html.picture(jpeg_uri(image.color), f"{after_s:.1f} s", f"What the camera saw after {after_s:.1f} s")


def _goals(record: DriveRecord) -> str:
    body = html.table("Off the goal is as the robot believes.", *goal_rows(record))
    return html.section("goals", "Its goals", "", body)


def _stops(record: DriveRecord) -> str:
    if not record.stops:
        return html.section("stops", "What held it", "Nothing held it.")
    body = html.table(
        "Each time that the collision monitor held the robot, or it stopped by itself.", *stop_rows(record)
    )
    return html.section("stops", "What held it", "", body)


def _log(record: DriveRecord) -> str:
    rows = transition_rows(record)
    table = html.table("All changes of state.", ("Seconds", "From", "To", "Why"), rows)
    settings = settings_text(record.config["navigation"])
    return html.section(
        "log", "The log", "", html.fold("All changes of state", table), html.folded("Settings of navigation", settings)
    )
