"""The page about a model of places, tested on another drive. The contact sheet is for a person who labels a drive."""

from __future__ import annotations

import json
from collections.abc import Sequence
from html import escape
from string import Template
from typing import Any

import numpy as np

from wheelsight import __version__
from wheelsight.app.run import words
from wheelsight.core.files import StrPath
from wheelsight.places import PlaceModel
from wheelsight_papers.dataset import ContactSheet, LabelledDrive
from wheelsight_papers.training import CalibrationCurve, PlaceTrial
from wheelsight_report import drawing, html
from wheelsight_report import plotly as go
from wheelsight_report.drawing import AREA_COLOURS, BLUE, GREY, VERMILLION
from wheelsight_report.pictures import jpeg_uri

# Shares of frames; with one wrong in ten, areas still rectify wheels.
_GOOD, _FAIR = 0.9, 0.7
_CALIBRATED = 0.05


def write_places_page(trial: PlaceTrial, model: PlaceModel, recording: str, path: StrPath) -> None:
    """Write the page about `trial` of `model` on `recording`, atomically, about 5 MB. Raises OutputError."""
    forest = f"{model.forest.tree_count} trees of at most {model.settings.max_depth} splits"
    facts = [f"described by {model.describer.kind}", forest, f"wheelsight {__version__}"]
    if trial.accuracy >= _GOOD:
        tone, phrase = "green", "It knows where it is"
    elif trial.accuracy >= _FAIR:
        tone, phrase = "amber", "It mostly knows where it is"
    else:
        tone, phrase = "red", "It often takes one area for another"
    counts = trial.confusion[:, :-1].copy()
    for area in range(len(counts)):
        counts[area, area] = 0
    judged = words.count(int(trial.is_judged.sum()), "frame")
    text = f"Of {judged} with a true area, {words.percent(trial.accuracy)} have it as the most probable one."
    if counts.any():
        true, named = divmod(int(counts.argmax()), counts.shape[1])
        worst = f"area {trial.area_names[true]} is taken for {trial.area_names[named]}"
        text += f" Most often {worst}: {words.count(int(counts[true, named]), 'frame')}."
    plot = html.plot(
        "confusion",
        confusion_figure(trial),
        "Confusion matrix",
        "Rows are true areas, columns what they were taken for; the darker, the larger the share of its row.",
        "Heat map of frames by true area and most probable area",
    )
    accuracy = html.table("Accuracy of each area", AREA_HEAD, area_rows(trial))
    as_table = html.fold("The same as a table", html.table("Frames", *confusion_rows(trial)))
    confusions = html.section("confusions", "What it takes for what", "", plot, as_table, accuracy)
    curve_plot = html.plot(
        "reliability",
        reliability_figure(trial),
        "Calibration curve",
        "Above the dashed line it is right more often than it says, below less often.",
        "Share of right answers over their probability",
    )
    table = html.fold("The same as a table", html.table("By how sure it is", CURVE_HEAD, curve_rows(trial.curve)))
    curve_section = html.section("sure", "Whether it knows how sure it is", "", curve_plot, table)
    plot = html.plot(
        "time",
        time_figure(trial),
        "Areas along time",
        "Mistakes at the border of two areas are mild; those in the middle of one are not.",
        "True and most probable area of each frame over time",
    )
    shares = [trial.confusion[i, i] / max(int(trial.confusion[i].sum()), 1) for i in range(len(trial.area_names))]
    seen = [i for i in range(len(shares)) if trial.confusion[i].sum()]
    least = min(seen, key=lambda i: shares[i])
    page = html.page(
        kicker="wheelsight places test",
        title=recording,
        facts=facts,
        tone=tone,
        phrase=phrase,
        sentences=[text],
        tiles=[
            (
                "Accuracy",
                words.percent(trial.accuracy),
                f"held out in training {words.percent(model.figures.accuracy)}",
            ),
            ("Least of an area", words.percent(float(shares[least])), f"area {trial.area_names[least]}"),
            ("Named", words.percent(trial.answered), f"from a probability of {model.least_confidence:.2f} on"),
            ("Right where named", words.percent(trial.answered_accuracy), ""),
            ("Calibration error", f"{trial.curve.error:.3f}", f"in training {model.figures.calibration_error:.3f}"),
            ("Frames judged", f"{int(trial.is_judged.sum()):,}", f"of {len(trial.answers):,} in all"),
        ],
        notes=_notes(trial, model),
        sections=(confusions, html.section("along", "Along the drive", "", plot), curve_section, _mistakes(trial)),
        footer="Frames that have no true area count nowhere. This page needs no network.",
    )
    html.save(page, path)


def _notes(trial: PlaceTrial, model: PlaceModel) -> list[str]:
    found = []
    absent = [name for i, name in enumerate(trial.area_names) if not trial.confusion[i].any()]
    if absent:
        found.append(f"The drive shows nothing of {', '.join(absent)}: nothing is known of how these fare.")
    if trial.curve.error > _CALIBRATED:
        side = "surer" if trial.curve.is_overconfident else "less sure"
        fix = "train on several drives in different light, so that whole drives can be held out"
        found.append(f"The model is {side} than it should be; {fix}.")
    blind = int(trial.confusion[:, -1].sum())
    if blind:
        found.append(f"{words.count(blind, 'frame has', 'frames have')} no depth and count as wrong.")
    tested = "A drive that the model was trained on, or one right after it, proves little: test on another day."
    return [*found, tested]


def _mistakes(trial: PlaceTrial) -> str:
    if not trial.mistakes:
        return html.section("mistakes", "Its surest mistakes", "None: every frame was taken for its own area.")
    start_s, names = trial.answers.stamps_s[0], trial.area_names
    shown = [
        html.picture(
            jpeg_uri(mistake.color),
            f"{mistake.stamp_s - start_s:.1f} s: in {names[mistake.true]}, taken for {names[mistake.named]}, "
            f"{words.percent(mistake.confidence)} sure.",
            f"frame of area {names[mistake.true]} taken for {names[mistake.named]}",
        )
        for mistake in trial.mistakes
    ]
    intro = "The surest of each pair of areas."
    return html.section("mistakes", "Its surest mistakes", intro, html.group("triple", shown))


_CELL_PX, _LEAST_PX = 52, 320
# Never so strong that the page's ink, dark or light, could not be read upon it.
_BLUES = [[0, "rgba(0,114,178,0.04)"], [1, "rgba(0,114,178,0.6)"]]


def confusion_figure(trial: PlaceTrial) -> go.Figure:
    """True areas in rows, most probable areas in columns; colour is the share of the row, figures are frames."""
    counts, names = trial.confusion, trial.area_names
    columns = (*names, "no depth") if counts[:, -1].any() else names
    counts = counts[:, : len(columns)]
    shares = counts / np.maximum(counts.sum(axis=1, keepdims=True), 1)
    figure = drawing.style(
        go.Figure(), max(_LEAST_PX, _CELL_PX * len(counts) + 100), margin={"r": 14, "t": 14, "b": 56}
    )
    pairs = [[f"in {true}, taken for {best}" for best in columns] for true in names]
    figure.add_heatmap(
        z=shares,
        text=[[f"{count:,}" if count else "" for count in row] for row in counts.tolist()],
        customdata=pairs,
        texttemplate="%{text}",
        textfont={"size": 14},
        colorscale=_BLUES,
        zmin=0,
        zmax=1,
        showscale=False,
        xgap=2,
        ygap=2,
        hovertemplate="%{customdata}: %{z:.1%} of its frames<extra></extra>",
    )
    figure.update_xaxes(title_text="most probable area", **_names_at_ticks(columns))
    figure.update_yaxes(title_text="true area", autorange="reversed", **_names_at_ticks(names))
    figure.update_layout(margin_l=_room_for(names))
    return figure


def reliability_figure(trial: PlaceTrial) -> go.Figure:
    """Share of right answers over their probability; the diagonal is perfect calibration."""
    curve = trial.curve
    figure = drawing.style(go.Figure(), 380, hovermode="closest", margin={"l": 58, "r": 14, "t": 34, "b": 56})
    line = {"color": GREY, "width": 1.5, "dash": "dash"}
    figure.add_scatter(x=[0, 1], y=[0, 1], mode="lines", line=line, name="as promised", hoverinfo="skip")
    sizes = 7 + 27 * np.sqrt(curve.count / curve.count.max())
    figure.add_scatter(
        x=curve.confidence,
        y=curve.accuracy,
        customdata=curve.count,
        mode="lines+markers",
        line={"color": BLUE, "width": 2},
        marker={"size": sizes, "color": BLUE, "opacity": 0.75, "line": {"width": 1, "color": "#ffffff"}},
        name="the model; larger: more frames",
        hovertemplate="says %{x:.1%}, is right %{y:.1%} of %{customdata} frames<extra></extra>",
    )
    figure.update_xaxes(title_text="probability of the most probable area", range=[-0.04, 1.06], tickformat=".0%")
    figure.update_yaxes(title_text="share that is right", range=[-0.06, 1.08], tickformat=".0%")
    return figure


def time_figure(trial: PlaceTrial) -> go.Figure:
    """The true area and the most probable one over time: marker size is probability, red is wrong."""
    answers = trial.answers
    seconds = answers.stamps_s - answers.stamps_s[0]
    height = max(_LEAST_PX, 34 * len(trial.area_names) + 110)
    figure = drawing.style(go.Figure(), height, hovermode="closest")
    truth = np.where(trial.is_judged, trial.labels, np.nan).astype(float)
    figure.add_scatter(
        x=seconds,
        y=truth,
        mode="lines",
        line={"color": GREY, "width": 11, "shape": "hv"},
        opacity=0.45,
        name="true area",
        hoverinfo="skip",
        connectgaps=False,
    )
    best, confidence = answers.probabilities.argmax(axis=1), answers.probabilities.max(axis=1)
    wrong = trial.is_judged & ~trial.is_right & answers.has_depth
    for name, which, color in (("most probable area", answers.has_depth & ~wrong, BLUE), ("wrong", wrong, VERMILLION)):
        figure.add_scatter(
            x=seconds[which],
            y=best[which],
            customdata=confidence[which],
            mode="markers",
            marker={"size": 2 + 6 * confidence[which], "color": color},
            name=name,
            hovertemplate="%{x:.2f} s: %{customdata:.0%} sure<extra>" + name + "</extra>",
            showlegend=bool(which.any()),
        )
    areas = len(trial.area_names)
    figure.update_yaxes(range=[areas - 0.4, -0.6], **_names_at_ticks(trial.area_names))
    drawing.time_axis_until(figure, float(seconds[-1]), "seconds since the first frame")
    figure.update_layout(margin_l=_room_for(trial.area_names))
    return figure


def _names_at_ticks(names: Sequence[str]) -> dict[str, Any]:
    """Places 0, 1, … of an axis by their names: given as text, names such as 1 would be taken for places."""
    ticks = {"tickmode": "array", "tickvals": list(range(len(names))), "ticktext": [escape(name) for name in names]}
    return {**ticks, "showgrid": False}


def _room_for(names: Sequence[str]) -> int:
    """Left margin in px that the longest name needs, and the axis' title beside it."""
    return 62 + 7 * min(max(map(len, names)), 24)


AREA_HEAD = ("area", "frames", "right", "named", "right where named", "precision", "mostly taken for")
TRAINING_HEAD = ("area", "frames", "held-out accuracy")
CURVE_HEAD = ("says", "is right", "frames")


def training_rows(model: PlaceModel, drives: Sequence[LabelledDrive]) -> list[tuple[str, ...]]:
    """One row an area, as TRAINING_HEAD names the columns."""
    labels = np.concatenate([drive.labels for drive in drives])
    counts = np.bincount(labels[labels >= 0], minlength=len(model.area_names)).tolist()
    shares = model.figures.area_accuracy
    return [
        (name, f"{count:,}", words.percent(share))
        for name, count, share in zip(model.area_names, counts, shares, strict=True)
    ]


def training_facts(model: PlaceModel) -> list[tuple[str, str]]:
    """Results of a model on held-out frames."""
    figures = model.figures
    before = f"{figures.raw_calibration_error:.3f} before its probabilities were scaled"
    named = f"{words.percent(figures.answered)} of frames, {words.percent(figures.answered_accuracy)} of them rightly"
    return [
        ("out-of-bag accuracy", f"{words.percent(figures.out_of_bag_accuracy)}; neighbouring frames flatter it"),
        ("held-out accuracy", words.percent(figures.accuracy)),
        ("calibration error", f"{figures.calibration_error:.3f}; {before}"),
        ("names an area from", f"a probability of {model.least_confidence:.2f}: {named}"),
    ]


def area_rows(trial: PlaceTrial) -> list[tuple[str, ...]]:
    """One row an area, as AREA_HEAD names the columns."""

    def percent(part: int, whole: int) -> str:
        return words.percent(part / whole if whole else None)

    rows, named = list[tuple[str, ...]](), trial.answers.named
    for index, name in enumerate(trial.area_names):
        true, taken = trial.labels == index, trial.confusion[index, :-1].copy()
        frames, right, answered = int(true.sum()), int(taken[index]), true & (named >= 0)
        taken[index] = 0
        other = int(taken.argmax())
        rows.append(
            (
                name,
                f"{frames:,}",
                percent(right, frames),
                percent(int(answered.sum()), frames),
                percent(int((answered & (named == index)).sum()), int(answered.sum())),
                percent(right, int(trial.confusion[:, index].sum())),
                f"{trial.area_names[other]} ({int(taken[other]):,})" if taken[other] else "",
            )
        )
    return rows


def confusion_rows(trial: PlaceTrial) -> tuple[tuple[str, ...], list[tuple[str, ...]]]:
    """Head and rows: frames by true area (rows) and most probable area (columns); "·" for none."""
    counts = trial.confusion
    blind = bool(counts[:, -1].any())
    shown = counts if blind else counts[:, :-1]
    head = ("true area", *trial.area_names, *(("no depth",) if blind else ()))
    cells = [tuple(f"{count:,}" if count else "·" for count in row) for row in shown.tolist()]
    return head, [(name, *row) for name, row in zip(trial.area_names, cells, strict=True)]


def curve_rows(curve: CalibrationCurve) -> list[tuple[str, ...]]:
    """One row for each bin of confidence that has frames."""
    bins = zip(curve.confidence.tolist(), curve.accuracy.tolist(), curve.count.tolist(), strict=True)
    return [(words.percent(said), words.percent(right), f"{count:,}") for said, right, count in bins]


def write_sheet(sheet: ContactSheet, path: StrPath, source: str = "") -> None:
    """Write the page to `path`, atomically; it needs no network, and a file opened by a double click serves.

    Args:
        sheet: what to show.
        path: of the page.
        source: where the proposed areas come from, in a few words; "" where nothing is proposed.

    Raises:
        OutputError: it cannot be written.
    """
    html.save(render_sheet(sheet, source), path)


def render_sheet(sheet: ContactSheet, source: str = "") -> str:
    """The page as self-contained HTML."""
    duration_s = float(sheet.borders_s[-1] - sheet.borders_s[0])
    facts = [
        words.count(sheet.frame_count, "frame"),
        words.duration(duration_s),
        f"a thumbnail every {words.duration(sheet.every_s)}",
        f"proposed areas: {source}" if source else "no areas proposed",
        f"wheelsight {__version__}",
    ]
    start_s = float(sheet.borders_s[0])
    plain = "".join(sign if sign.isalnum() or sign in "-_." else "_" for sign in sheet.name)
    data = json.dumps(
        {
            "name": sheet.name,
            "file": f"{plain or 'recording'}-labels.csv",
            "pictures": [jpeg_uri(picture) for picture in sheet.pictures],
            "seconds": [round(float(stamp_s) - start_s, 3) for stamp_s in sheet.stamps_s],
            # As text, since what a browser makes of a number may lack digits that stamps need.
            "borders": [f"{stamp_s:.6f}" for stamp_s in sheet.borders_s],
            "labels": sheet.labels.tolist(),
            "names": list(sheet.names),
            "colours": list(AREA_COLOURS),
            "polygons": [] if sheet.areas is None else [np.round(a.polygon, 3).tolist() for a in sheet.areas],
            "places": [
                ([round(value, 3) for value in xy] if np.isfinite(xy).all() else None) for xy in sheet.xy_m.tolist()
            ],
        },
        ensure_ascii=False,
    ).replace("<", "\\u003c")
    return Template(html.asset("sheet.html")).substitute(
        title=escape(sheet.name),
        facts=" · ".join(escape(fact) for fact in facts),
        style=html.asset("style.css") + html.asset("sheet.css"),
        data=data,
        script=html.asset("sheet.js"),
    )
