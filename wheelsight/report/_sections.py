"""The page's sections: each a question a reader has, and the figures that answer it.

Those that take `of` stand on a page of several odometries too, then under that odometry's name and in its colour.
"""

from __future__ import annotations

import numpy as np

from wheelsight.evaluation import Statistics
from wheelsight.pipeline import words
from wheelsight.pipeline.run_record import MatchPicture, RunRecord
from wheelsight.pipeline.summary import Summary, cold_frames
from wheelsight.report import _drawing as drawing
from wheelsight.report import _html as html
from wheelsight.report import figures
from wheelsight.report.pictures import data_uri

MOST_PICTURES = 12
_VIEW_NAMES = {"xy": "x–y", "xz": "x–z", "yz": "y–z"}


def path(record: RunRecord, summary: Summary) -> str:
    """Where the body went, in three views."""
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
    """How far off the estimate is, over time and in a table."""
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
    """Every error of a record that was evaluated, as numbers."""
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
    """How sure dead reckoning was of itself."""
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
    """Whether the camera was followed, frame by frame."""
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
    """How many matches each frame had."""
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
    """Whether it keeps up with the camera; a wheel reading is too quick to ask."""
    if not summary.median_s >= 0 or record.unit == "reading":
        return ""
    median, p95, longest = (words.duration(s) for s in (summary.median_s, summary.p95_s, summary.longest_s))
    colour = drawing.ODOMETRY_COLOURS.get(of, drawing.BLUE)
    numbers = f"Median {median}, 95 % under {p95}, longest {longest}"
    over = html.plot(
        _key("time", of),
        figures.time_figure(record, colour),
        "Time a frame",
        f"{numbers}; reading images is not included. Triangles at the upper edge are frames that took longer still."
        f"{_cold_sentence(record)}",
        f"Time a frame over the run. {numbers}.",
    )
    spread = html.plot(
        _key("time-histogram", of),
        figures.time_histogram_figure(record, colour),
        "Spread",
        "How many frames took how long: a narrow hill is a steady pace.",
        f"Histogram of the time a frame. {numbers}.",
    )
    pair = html.group("pair", [spread, *_stages(record, of, colour)])
    return html.section(_key("timing", of), _title("Was it quick enough?", of), "", over, pair)


def _cold_sentence(record: RunRecord) -> str:
    cold = cold_frames(record)
    if not cold:
        return ""
    which = "The first frame, which took" if len(cold) == 1 else f"The first {len(cold)} frames, which took up to"
    slowest = words.duration(max(frame.seconds for frame in cold))
    return f" {which} {slowest}, {'is' if len(cold) == 1 else 'are'} not drawn: kernels were still compiled or loaded."


def _stages(record: RunRecord, of: str, colour: str) -> list[str]:
    if not record.stage_seconds:
        return []
    stages = ", ".join(f"{name} {words.duration(seconds)}" for name, seconds in record.stage_seconds.items())
    plot = html.plot(
        _key("stages", of),
        figures.stage_figure(record, colour),
        "Stages",
        "Where the time of a usual frame goes.",
        f"Median time of each stage: {stages}.",
    )
    return [plot]


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
    shown = [_picture(record.pictures[i], start_s) for i in chosen]
    return html.section(_key("pictures", of), _title("What it saw", of), intro, html.group("pictures", shown))


def _picture(picture: MatchPicture, start_s: float) -> str:
    inliers, matches = int(np.count_nonzero(picture.is_inlier)), len(picture.is_inlier)
    caption = (
        f"{picture.stamp_s - start_s:.2f} s after the start (stamp {picture.stamp_s:.3f}) against stamp "
        f"{picture.reference_stamp_s:.3f}: {words.count(matches, 'match', 'matches')}, {words.count(inliers, 'inlier')}"
    )
    if matches:
        caption += f" ({words.percent(inliers / matches)})"
    return html.picture(data_uri(picture), caption + ".", f"Two frames side by side with their matches: {caption}.")


def _key(key: str, of: str) -> str:
    return f"{of}-{key}" if of else key


def _title(title: str, of: str) -> str:
    return f"{of.capitalize()}: {title[0].lower()}{title[1:]}" if of else title
