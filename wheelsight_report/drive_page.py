"""The page and the plan of a drive: goals, path, stops, and images of the camera."""

from __future__ import annotations

import math

import numpy as np

from wheelsight import __version__
from wheelsight.app.run import words
from wheelsight.app.run.drive_record import DriveRecord, TimeCause
from wheelsight.app.run.verdict import runs
from wheelsight.core.files import StrPath, settings_text
from wheelsight.core.geometry import ByteArray, FloatArray
from wheelsight.mapping import CellKind
from wheelsight.mapping.occupancy import COLOURS, PlanLine, PlanMark, picture_of, save_picture
from wheelsight_report import drawing, html
from wheelsight_report import plotly as go
from wheelsight_report.drawing import BLUE, GREEN, GREY, LAVENDER, ORANGE, PURPLE, SKY, VERMILLION, keep_shape
from wheelsight_report.pictures import jpeg_uri, png_uri
from wheelsight_report.plotly import make_subplots

_PLANNED, _DRIVEN, _STOPPED, _GOAL, _START = (230, 159, 0), (0, 114, 178), (213, 94, 0), (204, 121, 167), (0, 158, 115)
_WALKED = (86, 180, 233)
_ROBOT_EVERY_M = 1.0
_FOOTER = "Lengths are in metres, stamps in seconds, poses of the base in the map. This page needs no network."


def write_drive_picture(record: DriveRecord, path: StrPath) -> None:
    """Write drive.png, the map with planned and driven paths, atomically. Raises OutputError."""
    save_picture(drive_picture(record), path)


def drive_picture(record: DriveRecord) -> ByteArray:
    """(h, w, 3) uint8 red, green, blue."""
    poses = record.rows.poses
    known = poses[np.isfinite(poses).all(axis=1)]
    lines = [PlanLine(plan[:, :2], _PLANNED, "planned") for _, plan in record.plans]
    corners = record.footprint.at(apart(known, _ROBOT_EVERY_M))
    lines += [PlanLine(np.vstack([outline, outline[:1]]), (150, 190, 215), width_px=1) for outline in corners]
    lines.append(PlanLine(known[:, :2], _DRIVEN, "driven", 3))
    marks = [PlanMark(stop.pose[:2], "cross", _STOPPED, "held") for stop in record.stops if stop.pose is not None]
    lines += [PlanLine(way, _WALKED, "somebody walked", 2) for way in walked(record.people)]
    marks += [PlanMark(known[0, :2], "circle", _START, "start")] if len(known) else []
    marks += [PlanMark(goal.goal[:2], "square", _GOAL, "goal", goal.name) for goal in record.goals if goal.is_place]
    return picture_of(record.grid, lines=lines, marks=marks)


def write_drive_page(record: DriveRecord, path: StrPath) -> None:
    """Write the page, atomically, about 5 MB.

    Raises:
        OutputError: it cannot be written.
        ConfigError: plotly is not installed.
    """
    html.save(render_drive(record), path)


def render_drive(record: DriveRecord) -> str:
    """The page as self-contained HTML."""
    phrase, sentences, tone = verdict(record)
    facts = [record.robot, record.finished_at.strftime("%Y-%m-%d %H:%M %Z").strip(), f"wheelsight {__version__}"]
    named = [goal.name for goal in record.goals]
    goal_names = "To " + (", then ".join(named) if named else "nowhere")
    intro = (
        "The map, what was planned (orange) and what was driven (blue), from the circle to the squares; crosses are "
        "where the robot was held, light blue lines are people who walked."
    )
    alt = f"The map from above with the way of the robot, {words.length(record.way_m)} long."
    plot = html.plot("drive-map-plan", plan_figure(record), "From above", "", alt)
    plan = html.section("plan", "Where it went", intro, plot)
    sentence = (
        "Above, what the navigator was about, where the localization stood, and what the collision monitor made of "
        "the commands; below, the speeds that the wheels measured. Single readings may run off an axis."
    )
    time_alt = f"States and speeds over {words.duration(record.time_s)}."
    time_plot = html.plot("time-line", time_line_figure(record), "States and speeds", sentence, time_alt)
    time_section = html.section("time", "What it did when", "", time_plot)
    spent_alt = f"What {words.duration(record.time_s)} were spent on: {record.spent_words}."
    spent_plot = html.plot("spent", spent_figure(record), "Time by cause", "Each control period has one.", spent_alt)
    spent_table = html.fold("As a table", html.table("Time by cause.", *spent_rows(record)))
    spent = html.section("spent", "Where its time went", "", spent_plot, spent_table)
    film = ""
    if record.images:
        pictures = []
        for image in record.images:
            after = f"{max(image.stamp_s - record.begin_s, 0.0):.1f} s"
            pictures.append(html.picture(jpeg_uri(image.color), after, f"What the camera saw after {after}"))
        film = html.section("film", "What it saw", "Images of its camera on the way.", html.group("strip", pictures))
    body = html.table("Off the goal is as the robot believes.", *goal_rows(record))
    goals = html.section("goals", "Its goals", "", body)
    if not record.stops:
        stop_section = html.section("stops", "What held it", "Nothing held it.")
    else:
        caption = "Each time that the collision monitor held the robot, or it stopped by itself."
        stop_section = html.section("stops", "What held it", "", html.table(caption, *stop_rows(record)))
    table = html.table("All changes of state.", ("Seconds", "From", "To", "Why"), transition_rows(record))
    settings = html.folded("Settings of navigation", settings_text(record.config["navigation"]))
    log = html.section("log", "The log", "", html.fold("All changes of state", table), settings)
    held_s = sum(stop.end_s - stop.begin_s for stop in record.stops)
    near = words.length(record.clearance_m) if math.isfinite(record.clearance_m) else "nothing near"
    offs = [goal.off_m for goal in record.goals if goal.result.has_arrived and math.isfinite(goal.off_m)]
    tiles = [
        ("Way driven", words.length(record.way_m), f"first plans: {words.length(record.planned_m)}"),
        ("Time", words.duration(record.time_s), f"{words.number(record.way_m / max(record.time_s, 1e-9))} m/s in all"),
        ("Clearance", near, "least, as map and camera showed"),
        ("Held", words.count(len(record.stops), "time"), f"{words.duration(held_s)} in all"),
        ("Plans", str(sum(goal.result.plans for goal in record.goals)), ""),
    ]
    if len(record.people):
        nearest = words.length(float(record.people[:, 3].min()))
        tiles.insert(3, ("Nearest person", nearest, "who walked, as the camera followed him"))
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
    return html.page(
        kicker="wheelsight drive",
        title=f"{goal_names} in {record.map_name}",
        facts=facts,
        tone=tone,
        phrase=phrase,
        sentences=[sentences],
        tiles=tiles,
        sections=(plan, spent, time_section, film, goals, stop_section, log),
        footer=_FOOTER,
    )


def verdict(record: DriveRecord) -> tuple[str, str, str]:
    """Phrase, sentences and tone."""
    reached = sum(goal.result.has_arrived for goal in record.goals)
    of_all = f"{reached} of {words.count(record.asked, 'goal')} reached"
    if record.is_interrupted:
        return "Interrupted", f"{of_all}; the robot was stopped.", "amber"
    faults = [f"Warning: {warning}." for warning in record.warnings]
    if not record.has_arrived:
        last = record.goals[-1] if record.goals else None
        why = [] if last is None else [f"{last.name}: {last.result.reason} ({last.result.detail})."]
        return of_all, " ".join((*why, *faults)), "red"
    if record.contacts:
        collisions = words.count(len(record.contacts), "collision")
        return f"Arrived, with {collisions}", f"{', '.join(record.contacts)}.", "red"
    remarks = faults + [f"{goal.name}: {goal.result.goal_change}." for goal in record.goals if goal.result.goal_change]
    if record.rests_on_start:
        remarks.append("Nothing of the map was recognised: every pose rests on the given start.")
    helped = sum(goal.result.recoveries for goal in record.goals)
    if helped:
        remarks.append(f"{words.count(helped, 'time')} it had to recover or to find its pose.")
    return "Arrived", " ".join(remarks) or "At every goal, by its own localization.", "amber" if remarks else "green"


_PLAN_PX, _TIME_PX, _SPENT_PX = 640, 460, 260
_AROUND_M = 0.5
# A person who is tracked without a break has a row each 0.05 s; a walking person moves less than this in the time.
_SAME_WALKER_S, _SAME_WALKER_M = 0.5, 0.8
_BANDS = ("navigator", "localization", "monitor")
_BAND_COLOURS = {
    **{"idle": GREY, "planning": ORANGE, "driving": GREEN, "recovering": VERMILLION, "arrived": BLUE, "failed": PURPLE},
    **{
        "tracking": GREEN,
        "coasting": ORANGE,
        "initializing": SKY,
        "unconfirmed": LAVENDER,
        "failing": VERMILLION,
        "lost": PURPLE,
    },
    **{"free": GREEN, "slowed": ORANGE, "stopped": VERMILLION},
}


def plan_figure(record: DriveRecord) -> go.Figure:
    """The map from above, metres, equal aspect, with all plans, the driven path, stops, start and goals."""
    figure = drawing.style(go.Figure(), _PLAN_PX, hovermode="closest", showlegend=True)
    # Add the map as an image below all lines, and limit the axes to its known part
    colours = np.array([COLOURS[kind] for kind in CellKind], np.uint8)
    (height, width), (left, bottom) = np.array(record.grid.kind.shape) * record.grid.resolution_m, record.grid.origin
    place = {"x": left, "y": bottom + height, "sizex": width, "sizey": height, "xref": "x", "yref": "y"}
    figure.add_layout_image(source=png_uri(colours[record.grid.kind[::-1]]), layer="below", sizing="stretch", **place)
    cells = np.argwhere(record.grid.kind != CellKind.UNKNOWN)
    known_xy = (
        record.grid.middle_of(cells) if len(cells) else np.array([[left, bottom], [left + width, bottom + height]])
    )
    (x0, y0), (x1, y1) = known_xy.min(axis=0) - _AROUND_M, known_xy.max(axis=0) + _AROUND_M
    figure.update_xaxes(range=[x0, x1], title_text="m", constrain="domain", showgrid=False)
    figure.update_yaxes(range=[y0, y1], scaleanchor="x", scaleratio=1, constrain="domain", showgrid=False)
    hover = "%{x:.2f}, %{y:.2f} m"
    for number, (_, plan) in enumerate(record.plans):
        line = {"color": ORANGE, "width": 2}
        path = plan[keep_shape(plan[:, :2]), :2]
        drawing.add_path(figure, path, name="planned", line=line, hover=hover, in_legend=not number)
    path = record.rows.poses[:, :2]
    path = path[keep_shape(path)]
    if len(path):
        drawing.add_path(figure, path, name="driven", line={"color": BLUE, "width": 3}, hover=hover)
    for number, way in enumerate(walked(record.people)):
        line = {"color": SKY, "width": 2, "dash": "dot"}
        drawing.add_path(figure, way, name="somebody walked", line=line, hover=hover, in_legend=not number)
    known = record.rows.poses[np.isfinite(record.rows.poses).all(axis=1)]
    if len(known):
        _add_marks(figure, known[:1, :2], ["start"], "start", {"symbol": "circle", "color": GREEN})
    aims = [goal for goal in record.goals if goal.is_place]
    goals = np.array([goal.goal[:2] for goal in aims]).reshape(-1, 2)
    _add_marks(figure, goals, [goal.name for goal in aims], "goal", {"symbol": "square", "color": PURPLE})
    held = [stop for stop in record.stops if stop.pose is not None]
    places = np.array([stop.pose[:2] for stop in held if stop.pose is not None]).reshape(-1, 2)
    _add_marks(figure, places, [stop.reason for stop in held], "held", {"symbol": "x", "color": VERMILLION})
    figure.update_layout(plot_bgcolor="#ffffff")
    return figure


_CAUSE_COLOURS = {
    TimeCause.FULL_SPEED: GREEN,
    TimeCause.GAINS_SPEED: "#8fd3bd",
    TimeCause.BRAKES: "#c5e8dd",
    TimeCause.CAREFUL: BLUE,
    TimeCause.TURNS: SKY,
    TimeCause.NOT_SEEN_LATELY: ORANGE,
    TimeCause.NEVER_SEEN: "#b35900",
    TimeCause.OBSTACLE: VERMILLION,
    TimeCause.SENSORS: "#7a3e00",
    TimeCause.LOCALIZATION: LAVENDER,
    TimeCause.PLANNING: PURPLE,
    TimeCause.EXPLORING: "#e8b8d4",
    TimeCause.RECOVERY: "#8c5a7a",
    TimeCause.STANDS: GREY,
}


def spent_figure(record: DriveRecord) -> go.Figure:
    """One bar of seconds by cause, the longest first."""
    figure = drawing.style(go.Figure(), _SPENT_PX, hovermode="closest", showlegend=True)
    for cause, seconds in record.spent_s.items():
        share = words.percent(seconds / max(record.time_s, 1e-9))
        figure.add_bar(
            x=[seconds],
            y=["time"],
            orientation="h",
            name=cause,
            marker={"color": _CAUSE_COLOURS[TimeCause(cause)], "line": {"width": 0}},
            hovertemplate=f"{cause}: %{{x:.1f}} s, {share}<extra></extra>",
        )
    figure.update_layout(barmode="stack")
    figure.update_xaxes(title_text="s", range=[0, record.time_s])
    figure.update_yaxes(showticklabels=False, showgrid=False)
    return figure


def spent_rows(record: DriveRecord) -> words.Table:
    """Column names with units, and one row a cause."""
    seconds = list(record.spent_s.values())
    return words.table(
        ("The robot", list(record.spent_s)),
        words.column("Time", seconds, "s"),
        ("Share", [words.percent(one / max(record.time_s, 1e-9)) for one in seconds]),
    )


def time_line_figure(record: DriveRecord) -> go.Figure:
    """Bands of states, and speeds below; seconds since the begin."""
    rows, figure = record.rows, make_subplots(rows=3, cols=1, shared_xaxes=True, row_heights=[0.34, 0.36, 0.3])
    drawing.style(figure, _TIME_PX, hovermode="closest", showlegend=False)
    seconds = rows.stamps_s - record.begin_s
    for name, labels in zip(_BANDS, (rows.states, rows.status, rows.monitor), strict=True):
        reasons = rows.reasons if name == "monitor" else ("",) * len(labels)
        labelled = [*zip(labels, reasons, strict=True)]
        texts = [f"{label}: {reason}" if reason else label for label, reason in labelled]
        stretches = runs(texts)
        for label in dict.fromkeys(label for label, _ in labelled):
            own = [(begin, end) for begin, end, _ in stretches if labelled[begin][0] == label]
            begin_s = np.array([seconds[begin] for begin, _ in own])
            for_s = np.array([seconds[min(end, len(seconds) - 1)] for _, end in own]) - begin_s
            figure.add_bar(
                x=for_s,
                y=[name] * len(own),
                base=begin_s,
                orientation="h",
                marker={"color": _BAND_COLOURS.get(label, GREY), "line": {"width": 0}},
                text=[label if length_s > 0.08 * seconds[-1] else "" for length_s in for_s],
                textposition="inside",
                insidetextanchor="middle",
                customdata=[texts[begin] for begin, _ in own],
                hovertemplate="%{customdata}, from %{base:.1f} s for %{x:.1f} s<extra></extra>",
                row=1,
                col=1,
            )
    for row, name, values, colour in (
        (2, "speed, m/s", rows.forward_m_s, BLUE),
        (3, "turn, °/s", np.degrees(rows.turn_rad_s), PURPLE),
    ):
        line = {"color": colour, "width": 1.6}
        drawing.add_line(figure, seconds, values, name=name, line=line, hover="%{y:.2f}", row=row)
        known = values[np.isfinite(values)]
        if len(known):  # without the most extreme hundredth: single readings would flatten the rest
            low, high = np.minimum(np.percentile(known, 0.5), 0.0), np.maximum(np.percentile(known, 99.5), 0.0)
            air = 0.1 * max(float(high - low), 0.1)
            figure.update_yaxes(range=[float(low) - air, float(high) + air], row=row, col=1)
        drawing.panel_title(figure, name, row)
    figure.update_layout(barmode="overlay")
    figure.update_yaxes(autorange="reversed", showgrid=False, row=1, col=1)
    drawing.time_axis_until(figure, record.time_s, "seconds since the begin")
    return figure


def walked(people: FloatArray) -> list[FloatArray]:
    """Paths (M, 2) of people near the robot, from people (N, 4) as in `DriveRecord`: each sighting joins the nearest
    path.
    """
    ways: list[list[FloatArray]] = []
    for row in people:
        lately = [way for way in ways if 0 < row[0] - way[-1][0] < _SAME_WALKER_S]
        way = min(lately, key=lambda way: np.hypot(*(row - way[-1])[1:3]), default=None)
        if way is not None and np.hypot(*(row - way[-1])[1:3]) < _SAME_WALKER_M:
            way.append(row)
        else:
            ways.append([row])
    return [np.array(way)[:, 1:3] for way in ways if len(way) > 1]


def apart(poses: FloatArray, apart_m: float) -> FloatArray:
    """(M, 3) a selection of poses (N, 3) at a minimum distance, with the first and the last."""
    kept: list[FloatArray] = []
    for pose in poses:
        if not kept or np.hypot(*(pose - kept[-1])[:2]) >= apart_m:
            kept.append(pose)
    if len(poses):
        kept.append(poses[-1])
    return np.array(kept).reshape(-1, 3)


def _add_marks(figure: go.Figure, points: FloatArray, texts: list[str], name: str, marker: dict[str, str]) -> None:
    if not len(points):
        return
    rim = {"size": 12, "line": {"color": "#ffffff", "width": 2}}
    figure.add_scatter(
        x=points[:, 0],
        y=points[:, 1],
        text=texts,
        mode="markers",
        name=name,
        marker={**marker, **rim},
        hovertemplate="%{text}: %{x:.2f}, %{y:.2f} m<extra></extra>",
    )


def goal_rows(record: DriveRecord) -> words.Table:
    """Column names with units, and one row a goal."""
    goals = record.goals
    results = [goal.result for goal in goals]
    headings = [words.angle(goal.off_deg) if math.isfinite(goal.off_deg) else "any" for goal in goals]
    return words.table(
        ("Goal", [goal.name for goal in goals]),
        ("Asked", [place(goal.goal) if goal.is_place else "–" for goal in goals]),
        ("Became of it", [r.goal_change or "arrived" if r.has_arrived else f"{r.reason}: {r.detail}" for r in results]),
        words.column("Off", [goal.off_m if goal.is_place else None for goal in goals], "m"),
        ("Heading off", [text if goal.is_place else "–" for goal, text in zip(goals, headings, strict=True)]),
        words.column("Time", [result.time_s for result in results], "s"),
        words.column("Driven", [result.way_m for result in results], "m"),
        words.column("First plan", [result.planned_m for result in results], "m"),
        ("Plans", [str(result.plans) for result in results]),
        ("Recovered", [str(result.recoveries) for result in results]),
    )


def stop_rows(record: DriveRecord) -> words.Table:
    """Column names with units, and one row a stop."""
    return words.table(
        ("Why", [stop.reason for stop in record.stops]),
        ("After [s]", [f"{stop.begin_s - record.begin_s:.1f}" for stop in record.stops]),
        words.column("For", [stop.end_s - stop.begin_s for stop in record.stops], "s"),
        ("Where", [words.UNKNOWN if stop.pose is None else place(stop.pose) for stop in record.stops]),
    )


def transition_rows(record: DriveRecord) -> list[list[str]]:
    """One a change of state."""
    return [
        [f"{one.stamp_s - record.begin_s:.1f}", str(one.before), str(one.after), one.why]
        for goal in record.goals
        for one in goal.result.transitions
    ]


def place(pose: FloatArray) -> str:
    """A pose as text, such as "3.20, 1.50 m, 90°"."""
    yaw = "" if math.isnan(pose[2]) else f", {math.degrees(pose[2]):.0f}°"
    return f"{pose[0]:.2f}, {pose[1]:.2f} m{yaw}"
