"""The sections of a run's page, each with its figures: tracking, time, certainty, loops, map, and the files beside the
page.
"""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from html import escape
from pathlib import Path
from urllib.parse import quote

import cv2
import numpy as np

from wheelsight.app.run import words
from wheelsight.app.run.run_record import MapPicture, MapRecord, RunRecord
from wheelsight.app.run.verdict import Summary, cold_frames
from wheelsight.core.files import StrPath
from wheelsight.core.geometry import ByteArray, FloatArray, se3
from wheelsight.evaluation import Statistics
from wheelsight_report import drawing, figures, html
from wheelsight_report import plotly as go
from wheelsight_report.drawing import (
    BLUE,
    GREEN,
    GREY,
    ORANGE,
    VERMILLION,
    keep_shape,
    poseless_stamps_s,
    with_gaps,
)
from wheelsight_report.figures import truth_path_m
from wheelsight_report.pictures import OrbitView, draw_cloud, draw_matches, packed, webp_uri

# Sections of every run. With `of` a section stands on a page of several odometries, under that name and in its colour.


MOST_PICTURES = 12
_VIEW_NAMES = {"xy": "x–y", "xz": "x–z", "yz": "y–z"}


def path_section(record: RunRecord, summary: Summary) -> str:
    """The path, in three views."""
    if not len(record.estimate):
        return html.section(
            "path", "Where it went", "", html.paragraph("No pose was found, so there is no path.", "missing")
        )
    who = record.estimate.body
    if record.evaluation is not None and record.ground_truth is not None:
        intro = (
            f"The {who}'s estimated path, laid upon the ground truth by one rigid motion: where the two lines part, "
            "the estimate is wrong. The blue line breaks where no pose is known."
        )
    else:
        intro = (
            f"The {who}'s estimated path in its own {record.estimate.frame}. The line breaks where no pose is known."
        )
    plots = []
    shown = {"xy": _VIEW_NAMES["xy"]} if record.is_planar else _VIEW_NAMES
    for view, name in shown.items():
        alt = f"Path seen in the {name} plane of the map, {words.length(summary.length_m)} long in all."
        sentence = f"Seen along the map's {({*'xyz'} - {*view}).pop()} axis."
        plots.append(html.plot(f"path-{view}", figures.trajectory_figure(record, view), name, sentence, alt))
    return html.section("path", "Where it went", intro, *(plots if record.is_planar else [html.group("triple", plots)]))


def errors(record: RunRecord) -> str:
    """The errors of the estimate, over time and in a table."""
    title = "How far off it was"
    if record.evaluation is None:
        why = record.evaluation_problem or "the recording has no ground truth"
        return html.section("errors", title, "", html.paragraph(f"Not evaluated: {why.rstrip('.')}.", "missing"))
    ate = record.evaluation.ate.translation
    sentence = (
        "ATE is the distance to the true position once both paths are laid upon each other; RPE is the error of the "
        f"motion from one {record.unit} to the next, so a spike there is a {record.unit} that was misjudged, or the "
        "step across a gap."
    )
    alt = f"ATE over time: {words.length(ate.rmse)} RMSE, {words.length(ate.max)} at most."
    plot = html.plot("errors", figures.error_figure(record), "Error over time", sentence, alt)
    return html.section("errors", title, "", plot, error_table(record))


def error_table(record: RunRecord) -> str:
    """All errors of an evaluated record."""
    assert record.evaluation is not None
    evaluation = record.evaluation
    step = "pose" if record.rectification is not None or record.is_joined else record.unit
    kinds = {
        "ATE": evaluation.ate,
        f"RPE a {step}": evaluation.rpe_per_frame,
        "RPE a second": evaluation.rpe_per_second,
        "RPE a metre": evaluation.rpe_per_metre,
    }
    ways: list[list[str]] = []
    turns: list[list[str]] = []
    for name, error in kinds.items():
        if error is None:
            ways.append([name, "no step that long", *[""] * 5])
            continue
        ways.append([f"{name}, translation", *_cells(error.translation)])
        turns.append([f"{name}, rotation", *_cells(error.rotation.in_degrees())])
    caption = "The same errors as numbers; the count is of poses or steps compared."
    loose = (
        "Their rotations. Only positions are aligned: where the path is short, that alignment's rotation is loose, and "
        "ATE, rotation shows it rather than the estimate's error."
    )
    return html.table(caption, _head("m"), ways) + "\n" + html.table(loose, _head("°"), turns)


def _head(unit: str) -> list[str]:
    return ["Error", *(f"{name} [{unit}]" for name in ("RMSE", "Mean", "Median", "Maximum", "Std")), "Count"]


def _cells(s: Statistics) -> list[str]:
    return [*(words.number(value, 4) for value in (s.rmse, s.mean, s.median, s.max, s.std)), f"{s.count:,}"]


def certainty(record: RunRecord, of: str = "") -> str:
    """The stated uncertainty of dead reckoning."""
    covariances = record.estimate.covariances
    if not record.is_planar or covariances is None or not len(record.estimate):
        return ""
    position_m, yaw_deg = figures.standard_deviations(record.estimate)
    end = f"{words.length(position_m[-1])} and {words.angle(yaw_deg[-1])} at the end"
    sentence = (
        "One standard deviation of the position, along its worst direction, and of the yaw, which grows with the "
        "way, since dead reckoning never sees a place again. Errors of calibration are not in it."
        if record.rectification is None
        else "One standard deviation of the position, along its worst direction, and of the yaw: what grows with the "
        "way, a change of area takes back."
    )
    alt = f"Standard deviations of position and yaw over time: {end}."
    figure = figures.certainty_figure(record, drawing.ODOMETRY_COLOURS.get(of))
    plot = html.plot(_key("certainty", of), figure, "Uncertainty over time", sentence, alt)
    return html.section(_key("certainty", of), _title("How sure it was", of), "", plot)


def tracking(record: RunRecord, summary: Summary, of: str = "") -> str:
    """The status of the camera, frame by frame."""
    if not record.frames:
        return ""
    lost = f", {words.count(summary.lost_episodes, 'lost episode')}" if record.unit == "frame" else ""
    status = html.plot(
        _key("status", of),
        figures.status_figure(record),
        "Status over time",
        "A pose is known only while tracking; failing is a frame or few without one, lost is when only seeing a "
        "known place again helps."
        if record.unit == "frame"
        else "Failing is a reading that was refused; the notes above say why.",
        f"Status over time: {words.percent(summary.pose_share)} of {record.unit}s have a pose{lost}.",
    )
    if record.unit == "reading":
        return html.section(_key("tracking", of), _title("Was every reading used?", of), "", status)
    return html.section(_key("tracking", of), _title("Was it ever lost?", of), "", status, matches(record, of))


def matches(record: RunRecord, of: str = "") -> str:
    """The number of matches of each frame."""
    if not any(frame.matches for frame in record.frames):
        return html.paragraph("No frame had any matches.", "missing")
    is_dense = record.odometry == "dense" or (record.is_joined and "dense" in record.config.get("odometry", ()))
    inliers = np.median([frame.inliers for frame in record.frames if not frame.is_skipped])
    return html.plot(
        _key("matches", of),
        figures.matches_figure(record),
        "Matches over time",
        "How many of a frame's points fall into what it is aligned with, and how many of them find a surface near them "
        "there (inliers): with few, the pose hangs by a thread."
        if is_dense
        else "How many points were found again in the reference frame, and how many of them agree on one motion "
        "(inliers): with few, the pose hangs by a thread.",
        f"Matches and inliers a frame over time; median {inliers:.0f} inliers.",
    )


def timing(record: RunRecord, summary: Summary, of: str = "") -> str:
    """Processing times of frames; none for wheel readings, which take microseconds."""
    if not summary.median_s >= 0 or record.unit == "reading":
        return ""
    median, p95, longest = (words.duration(s) for s in (summary.median_s, summary.p95_s, summary.longest_s))
    colour = drawing.ODOMETRY_COLOURS.get(of, drawing.BLUE)
    numbers = f"Median {median}, 95 % under {p95}, longest {longest}"
    cold = cold_frames(record)
    cold_sentence = ""
    if cold:
        which = "The first frame, which took" if len(cold) == 1 else f"The first {len(cold)} frames, which took up to"
        slowest = words.duration(max(frame.seconds for frame in cold))
        cold_sentence = (
            f" {which} {slowest}, {'is' if len(cold) == 1 else 'are'} not drawn: kernels were still compiled or loaded."
        )
    over = html.plot(
        _key("time", of),
        figures.time_figure(record, colour),
        "Time a frame",
        f"{numbers}; reading images is not included. Triangles at the upper edge are frames that took longer still."
        f"{cold_sentence}",
        f"Time a frame over the run. {numbers}.",
    )
    spread = html.plot(
        _key("time-histogram", of),
        figures.time_histogram_figure(record, colour),
        "Spread",
        "How many frames took how long: a narrow hill is a steady pace.",
        f"Histogram of the time a frame. {numbers}.",
    )
    plots = [spread]
    if record.stage_seconds:
        stages = ", ".join(f"{name} {words.duration(seconds)}" for name, seconds in record.stage_seconds.items())
        plot = html.plot(
            _key("stages", of),
            figures.stage_figure(record, colour),
            "Stages",
            "Where the time of a usual frame goes.",
            f"Median time of each stage: {stages}.",
        )
        plots.append(plot)
    pair = html.group("pair", plots)
    return html.section(_key("timing", of), _title("Was it quick enough?", of), "", over, pair)


def pictures(record: RunRecord, of: str = "") -> str:
    """A few frames with their matches."""
    if not record.pictures:
        return ""
    intro = (
        "Left the reference frame, right the current one. Green circles are matches that agree with the motion found, "
        "orange crosses those that do not; good ones move alike and lie all over the image."
    )
    chosen = np.linspace(0, len(record.pictures) - 1, min(len(record.pictures), MOST_PICTURES)).round().astype(int)
    if len(chosen) < len(record.pictures):
        intro += f" {len(chosen)} of {len(record.pictures)} pictures are shown."
    start_s = record.frames[0].stamp_s if record.frames else record.pictures[0].stamp_s
    shown = []
    for picture in (record.pictures[i] for i in chosen):
        inliers, matches = int(np.count_nonzero(picture.is_inlier)), len(picture.is_inlier)
        counts = f"{words.count(matches, 'match', 'matches')}, {words.count(inliers, 'inlier')}"
        caption = (
            f"{picture.stamp_s - start_s:.2f} s after the start (stamp {picture.stamp_s:.3f}) against stamp "
            f"{picture.reference_stamp_s:.3f}: {counts}"
        )
        caption += f" ({words.percent(inliers / matches)})" if matches else ""
        alt = f"Two frames side by side with their matches: {caption}."
        shown.append(html.picture(webp_uri(draw_matches(picture)), caption + ".", alt))
    return html.section(_key("pictures", of), _title("What it saw", of), intro, html.group("pictures", shown))


def _key(key: str, of: str) -> str:
    return f"{of}-{key}" if of else key


def _title(title: str, of: str) -> str:
    return f"{of.capitalize()}: {title[0].lower()}{title[1:]}" if of else title


_FILES = {
    "trajectory.txt": "where it went, in TUM's format: stamp, position, quaternion",
    "covariances.csv": "how surely each pose of it is known",
    "odom.txt": "the same way without leaps, as a controller follows it",
    "trajectory_corrected.txt": "likewise, as known at the end, with loops closed",
    "loops_judged.csv": "loops, and whether they were kept",
    "status.csv": "a row a frame: status, reason, matches, time, frames dropped",
    "areas.csv": "the area by each frame",
    "metrics.json": "all key figures",
    "config.yaml": "all settings, to run it again",
    "map.surfels": "the map; wheelsight export makes points or a mesh of it",
    "map.ply": "the map's points, for MeshLab, CloudCompare or Open3D",
    "mesh.ply": "the map as triangles",
    "map": "the map's folder, for wheelsight run --map-from, drive and export, which makes points or a mesh of it",
    "run.rrd": "the run for Rerun's viewer",
    "run.log": "what was said on the way",
}


def files_section(folder: StrPath | None, odometries: Sequence[str] = ()) -> str:
    """Links to the files in `folder`, and in folders of its odometries; "" without files."""
    if folder is None:
        return ""
    rows = []
    for shown in (f"{place}/{name}" if place else name for place in ("", *odometries) for name in _FILES):
        path = Path(folder) / shown
        if path.exists():
            slash, parts = ("/", [*path.iterdir()]) if path.is_dir() else ("", [path])
            link = f'<a href="{quote(shown)}{slash}">{escape(shown)}{slash}</a>'
            size, about = sum(part.stat().st_size for part in parts), _FILES[path.name]
            rows.append(f'<tr><th scope="row">{link}</th><td>{size / 1e3:,.2f}</td><td>{escape(about)}</td></tr>')
    if not rows:
        return ""
    intro = "Beside this page, as long as they lie where the run left them."
    head = "<thead><tr>" + "".join(f'<th scope="col">{name}</th>' for name in ("File", "Size [kB]", "What it is"))
    table = f'<div class="scroll"><table class="files">\n{head}</tr></thead>\n<tbody>\n' + "\n".join(rows)
    return html.section("files", "Files", intro, table + "\n</tbody>\n</table></div>")


# More lines than this hide what lies below.
_MOST_DRAWN = 400


def loop_section(record: RunRecord, of: str = "") -> str:
    """The section about loops; "" if none were requested."""
    correction = record.correction
    if correction is None:
        return ""
    ates = [
        words.length(found.ate.translation.rmse)
        for found in (record.evaluation, correction.evaluation)
        if found is not None
    ]
    errors = f" ATE is {ates[0]} as lived and {ates[1]} as known at the end." if len(ates) > 1 else ""
    intro = f"{correction.sentence}.{errors}"
    sentence = (
        "Both ways begin at one pose. A line joins the two views of a match where they lie in the end; one that was "
        "refused joins places apart."
    )
    alt = f"Way before and after {len(correction.found.loops.kept)} loops were closed"
    plot = html.plot(f"loops-plan{of and f'-{of}'}", loops_figure(record), "Before and after", sentence, alt)
    return html.section(f"loops{of and f'-{of}'}", f"Loops{of and f', {of}'}", intro, plot)


def loops_figure(record: RunRecord) -> go.Figure:
    """The path before and after loop closing from above, metres; with an evaluation, over the truth.

    Raises:
        ValueError: the run has no loops.
    """
    correction = record.correction
    if correction is None:
        raise ValueError("the run has no loops")
    figure = drawing.map_figure(560)
    hover = "x %{x:.2f}, y %{y:.2f} m"
    T = np.eye(4) if correction.evaluation is None else correction.evaluation.ate.T_truth_estimate
    paths = {
        "as lived": (se3.apply(T, record.estimate.positions_m), {"color": ORANGE, "width": 1.5}),
        "as known at the end": (se3.apply(T, correction.found.corrected.positions_m), {"color": BLUE, "width": 2}),
    }
    if correction.evaluation is not None:
        paths = {"ground truth": (truth_path_m(record), {"color": GREY, "width": 4}), **paths}
    for name, (positions_m, line) in paths.items():
        path = positions_m[:, :2]
        drawing.add_path(figure, path[keep_shape(path)], name=name, line=line, hover=hover)
    keyframes = se3.apply(T, correction.found.T_map_keyframe[:, :3, 3])[:, :2]
    judged = correction.found.loops.decisions
    is_kept = np.array([one.is_kept for one in judged], bool)
    ends = keyframes[np.array([(one.loop.first, one.loop.second) for one in judged], np.int64).reshape(-1, 2)]
    for name, which, colour in (("refused", ~is_kept, VERMILLION), ("kept", is_kept, GREEN)):
        drawn = ends[which]
        drawn = drawn[:: max(1, -(-len(drawn) // _MOST_DRAWN))]  # an even selection
        broken = np.concatenate([drawn, np.full((len(drawn), 1, 2), np.nan)], axis=1).reshape(-1, 2)
        figure.add_scatter(
            x=broken[:, 0],
            y=broken[:, 1],
            mode="lines+markers",
            name=f"{name}: {np.count_nonzero(which):,}",
            line={"color": colour, "width": 0.7},
            marker={"color": colour, "size": 3},
            hoverinfo="skip",
        )
    return figure


def map_section(record: RunRecord, of: str = "") -> str:
    """The map from above and from the camera's poses; "" without a map.

    `of` as in the page's other sections.
    """
    if record.map is None:
        return ""
    key, title = _key("map", of), _title("The map", of)
    if record.map.plan is None:
        return html.section(key, title, "", html.paragraph("It is empty: no frame had a pose.", "missing"))
    start_s = record.frames[0].stamp_s if record.frames else 0.0
    pictures = []
    for picture in record.map.pictures:
        when = f"{picture.stamp_s - start_s:.2f} s after the start"
        caption = f"{when}: left the frame, right the finished map from there"
        pictures.append(
            html.picture(webp_uri(draw_view(picture)), caption + ".", f"Frame and map side by side: {caption}.")
        )
    shown = html.group("pictures", pictures)
    sentence = (
        "Stable surfels seen from straight above, what faces down left out, and what stands upright drawn darker; the "
        "line is the path, from the circle to the square. White is not known."
    )
    if not record.map.is_levelled:
        sentence += " The vertical is estimated from the surfels: the calibration has none."
    colour = drawing.ODOMETRY_COLOURS.get(of, drawing.BLUE)
    alt = "The map seen from above, with the path of the camera over it."
    plan = html.plot(f"{key}-plan", plan_figure(record, colour), "From above", sentence, alt)
    figures_of = (figure(record, key), plan, shown if record.map.pictures else "")
    found = record.map
    status, file = found.status, f"{of}/{found.file}" if of else found.file
    intro = (
        f"{words.count(status.surfels, 'surfel')} (small disks) of {words.count(found.fused, 'frame')}, "
        f"{status.stable:,} of them stable: seen often enough to be sure. They took {status.memory_bytes / 1e6:,.0f} "
        f"MB of memory, and are in {file}; wheelsight export makes points or a mesh of it."
    )
    return html.section(key, title, intro, *figures_of)


def map_tile(found: MapRecord) -> tuple[str, str, str]:
    """A tile: name, value, and a relative value."""
    stable = words.percent(found.status.stable / found.status.surfels) if found.status.surfels else "0 %"
    return "Surfels in the map", f"{found.status.surfels:,}", f"{stable} of them stable"


_HEIGHT_PX = 640
_GUTTER_PX = 6
_PANEL_WIDTH_PX = 640


def plan_figure(record: RunRecord, colour: str = BLUE) -> go.Figure:
    """The map from above, metres, equal aspect, with the path of the body and a scale bar.

    The record's map must have a plan.
    """
    assert record.map is not None
    assert record.map.plan is not None
    plan = record.map.plan
    figure = drawing.style(go.Figure(), _HEIGHT_PX, hovermode="closest", showlegend=False)
    # Lower left and upper right of the plan's image, at the outer edges of its pixels
    (height, width), half_px = plan.is_known.shape, 0.5 * plan.m_per_px
    left_m, top_m = plan.corner_m[0] - half_px, plan.corner_m[1] + half_px
    (left, bottom), (right, top) = (left_m, top_m - height * plan.m_per_px), (left_m + width * plan.m_per_px, top_m)
    place = {"x": left, "y": top, "sizex": right - left, "sizey": top - bottom, "xref": "x", "yref": "y"}
    figure.add_layout_image(source=webp_uri(plan.image), layer="below", sizing="stretch", **place)
    _, positions_m = with_gaps(record.estimate.stamps_s, record.estimate.positions_m, poseless_stamps_s(record))
    path = positions_m @ plan.R_plan_map[:2].T
    path = path[keep_shape(path)]
    hover = "%{x:.2f}, %{y:.2f} m"
    drawing.add_path(figure, path, name="halo", line={"color": "#ffffff", "width": 5}, hover=hover)
    drawing.add_path(figure, path, name="path", line={"color": colour, "width": 2.5}, hover=hover)
    known = path[~np.isnan(path).any(axis=1)]
    marker = {"size": 11, "color": "#ffffff", "line": {"color": colour, "width": 3}}
    for name, symbol, points in (("start", "circle", known[:1]), ("end", "square", known[-1:])):
        at = {"x": points[:, 0], "y": points[:, 1], "hovertemplate": f"{name}: {hover}<extra></extra>"}
        figure.add_scatter(**at, mode="markers", marker={**marker, "symbol": symbol})
    # A scale bar above the plan at its right end
    length_m = bar_length_m(right - left)
    line = {"color": drawing.GREY, "width": 4}
    figure.add_shape(type="line", x0=right - length_m, x1=right, yref="paper", y0=1.015, y1=1.015, line=line)
    bar_place = {"x": right - length_m / 2, "y": 1.02, "yref": "paper", "yanchor": "bottom", "xanchor": "center"}
    figure.add_annotation(text=f"{length_m:g} m", showarrow=False, **bar_place)
    figure.update_xaxes(range=[left, right], title_text="m", constrain="domain", showgrid=False)
    figure.update_yaxes(range=[bottom, top], scaleanchor="x", scaleratio=1, constrain="domain", showgrid=False)
    figure.update_layout(plot_bgcolor="#ffffff")
    return figure


def bar_length_m(extent_m: float) -> float:
    """The longest of 1, 2, 5 times a power of ten that is no longer than a quarter of `extent_m`."""
    power = 10.0 ** math.floor(math.log10(extent_m / 4))
    return max(factor * power for factor in (1, 2, 5) if factor * power <= extent_m / 4)


def draw_view(picture: MapPicture) -> ByteArray:
    """The frame (left) and the map from where it was taken (right), (H, W, 3) uint8, red green blue."""
    panels = [_panel(picture.color), _panel(picture.rendered)]
    height = max(len(panel) for panel in panels)
    canvas = np.full((height, 2 * _PANEL_WIDTH_PX + _GUTTER_PX, 3), 255, np.uint8)
    for panel, left in zip(panels, (0, _PANEL_WIDTH_PX + _GUTTER_PX), strict=True):
        canvas[: len(panel), left : left + _PANEL_WIDTH_PX] = panel
    return canvas


def _panel(image: ByteArray) -> ByteArray:
    size = (_PANEL_WIDTH_PX, max(1, round(image.shape[0] * _PANEL_WIDTH_PX / image.shape[1])))
    how = cv2.INTER_AREA if image.shape[1] > _PANEL_WIDTH_PX else cv2.INTER_LINEAR
    return np.asarray(cv2.resize(image, size, interpolation=how), np.uint8)


_MOST_LOOPS = 400
_MOST_STEPS = 2000
_LEVELS = 2**16 - 1
_NORMAL_LEVELS = 127


def figure(record: RunRecord, key: str) -> str:
    """The map's points with path and loops, as HTML; nothing of a map without points."""
    found = record.map
    if found is None or found.cloud is None or found.plan is None:
        return ""
    R = found.plan.R_plan_map
    position = found.cloud.position.astype(float) @ R.T
    path, loops = path_steps(record) @ R.T, loop_steps(record) @ R.T
    view = OrbitView.of(position, path.reshape(-1, 3))
    still = webp_uri(draw_cloud(view, position, found.cloud, R, path, loops))
    counts = {"points": len(position), "path": len(path), "loops": len(loops)}
    # The lowest corner, and the length of a level of 16 bits
    low, step_m = np.round(position.min(axis=0), 4), max(float(np.ptp(position, axis=0).max()), 1e-3) / (_LEVELS - 1)
    data = counts | {"edge": round(found.cloud.edge_m, 5), "low": low.tolist(), "step": step_m} | view.to_dict()
    alt = f"{len(position):,} points of the map, seen aslant from above, with the path."
    kind = "stable surfels" if found.status.stable else "surfels"
    text = f"{len(found.cloud):,} points"
    if found.cloud.edge_m:
        text += f": the {found.cloud.of:,} {kind}, averaged in cubes of {words.length(found.cloud.edge_m)}"
    else:
        text += f", each one of the {kind}"
    text += ". Surfaces are seen from their front alone, so that one looks into rooms. The orange line is the path"
    text += "; green lines join places that were recognised" if len(loops) else ""
    text += (
        ". Drag to turn, with shift to move; two fingers zoom and move; the wheel zooms once the figure was "
        "clicked. Keys: arrows, with shift to move; + and −; Home."
    )
    # Lines as float32; then x, y, z in 16 bits, red, green, blue, and normals in 8, each less the one before
    level = np.rint((position - low) / step_m).clip(0, _LEVELS).astype("<u2")
    normal = np.rint(_NORMAL_LEVELS * (found.cloud.normal.astype(float) @ R.T)).astype(np.int8).view(np.uint8)
    lines = np.concatenate([path, loops]).astype("<f4").tobytes()
    planes = (np.diff(plane.T, axis=1, prepend=plane.T[:, :1] * 0) for plane in (level, found.cloud.color, normal))
    packed_points = packed(lines + b"".join(np.ascontiguousarray(plane).tobytes() for plane in planes))
    return (
        f"<figure>\n<figcaption><strong>To be turned.</strong> {escape(text)}</figcaption>\n"
        f'<div class="cloud" id="{key}-cloud" data-cloud="{escape(json.dumps(data))}">'
        f'<img src="{still}" alt="{escape(alt)}"><canvas tabindex="0" role="img" aria-label="{escape(alt)}"></canvas>'
        f'</div><script type="text/plain">{packed_points}</script>\n</figure>'
    )


def path_steps(record: RunRecord) -> FloatArray:
    """(m, 2, 3) steps of the way in the map, none over a gap; as known at the end where loops were closed."""
    way = record.estimate if record.correction is None else record.correction.found.corrected
    _, path = with_gaps(way.stamps_s, way.positions_m, poseless_stamps_s(record))
    path = path[keep_shape(path, _MOST_STEPS)]
    steps = np.stack([path[:-1], path[1:]], axis=1)
    return np.asarray(steps[~np.isnan(steps).any(axis=(1, 2))])


def loop_steps(record: RunRecord) -> FloatArray:
    """(k, 2, 3) lines between the ends of loops that were kept, in the map; evenly picked where there are too many."""
    if record.correction is None:
        return np.zeros((0, 2, 3))
    found = record.correction.found
    ends = np.array([(loop.first, loop.second) for loop in found.loops.kept], np.int64).reshape(-1, 2)
    return np.asarray(found.T_map_keyframe[ends[:: max(1, -(-len(ends) // _MOST_LOOPS))], :3, 3])
