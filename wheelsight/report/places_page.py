"""The page about a model of places on a drive that it was not trained on."""

from __future__ import annotations

from html import escape
from pathlib import Path

from wheelsight._version import __version__
from wheelsight.files import StrPath, write_text
from wheelsight.pipeline import words
from wheelsight.places import PlaceModel, PlaceTrial
from wheelsight.report import _html as html
from wheelsight.report import places_figures as figures
from wheelsight.report.page import fill_template
from wheelsight.report.places_sheet import jpeg_uri
from wheelsight.report.places_tables import AREA_HEAD, CURVE_HEAD, area_rows, confusion_rows, curve_rows

# Shares of frames; with one wrong in ten, areas still rectify wheels.
_GOOD, _FAIR = 0.9, 0.7
_CALIBRATED = 0.05


def write_places_page(trial: PlaceTrial, model: PlaceModel, recording: str, path: StrPath) -> None:
    """Write the page about `trial` of `model` on `recording`, atomically, about 5 MB. Raises OutputError."""
    path = Path(path)
    write_text(path, _render(trial, model, recording).encode("utf-8", "replace").decode("utf-8"))


def _render(trial: PlaceTrial, model: PlaceModel, recording: str) -> str:
    forest = f"{model.forest.tree_count} trees of at most {model.settings.max_depth} splits"
    facts = [f"described by {model.describer.kind}", forest, f"wheelsight {__version__}"]
    tone, phrase = _verdict(trial)
    return fill_template(
        kicker="wheelsight places test",
        title=escape(recording),
        facts=" · ".join(escape(fact) for fact in facts),
        tone=tone,
        phrase=escape(phrase),
        sentences=escape(_sentences(trial)),
        tiles="\n".join(html.tile(*tile) for tile in _tiles(trial, model)),
        notes=html.section("notes", "What to know before trusting it", "", html.bullets(_notes(trial, model), "notes")),
        sections="\n".join([_confusions(trial), _time(trial), _calibration(trial), _mistakes(trial)]),
        footer="Frames that have no true area count nowhere. This page needs no network.",
    )


def _verdict(trial: PlaceTrial) -> tuple[str, str]:
    if trial.accuracy >= _GOOD:
        return "green", "It knows where it is"
    if trial.accuracy >= _FAIR:
        return "amber", "It mostly knows where it is"
    return "red", "It often takes one area for another"


def _sentences(trial: PlaceTrial) -> str:
    counts = trial.confusion[:, :-1].copy()
    for area in range(len(counts)):
        counts[area, area] = 0
    judged = words.count(int(trial.is_judged.sum()), "frame")
    text = f"Of {judged} with a true area, {words.percent(trial.accuracy)} have it as the most probable one."
    if not counts.any():
        return text
    true, named = divmod(int(counts.argmax()), counts.shape[1])
    worst = f"area {trial.area_names[true]} is taken for {trial.area_names[named]}"
    return f"{text} Most often {worst}: {words.count(int(counts[true, named]), 'frame')}."


def _tiles(trial: PlaceTrial, model: PlaceModel) -> list[tuple[str, str, str]]:
    shares = [trial.confusion[i, i] / max(int(trial.confusion[i].sum()), 1) for i in range(len(trial.area_names))]
    seen = [i for i in range(len(shares)) if trial.confusion[i].sum()]
    worst = min(seen, key=lambda i: shares[i])
    kept = f"of {len(trial.answers):,} in all"
    return [
        ("Accuracy", words.percent(trial.accuracy), f"held out in training {words.percent(model.figures.accuracy)}"),
        ("Least of an area", words.percent(float(shares[worst])), f"area {trial.area_names[worst]}"),
        ("Named", words.percent(trial.answered), f"from a probability of {model.least_confidence:.2f} on"),
        ("Right where named", words.percent(trial.answered_accuracy), ""),
        ("Calibration error", f"{trial.curve.error:.3f}", f"in training {model.figures.calibration_error:.3f}"),
        ("Frames judged", f"{int(trial.is_judged.sum()):,}", kept),
    ]


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
    tested = "A drive that the model was trained on, or one right after it, tells little: test on another day."
    return [*found, tested]


def _confusions(trial: PlaceTrial) -> str:
    plot = html.plot(
        "confusion",
        figures.confusion_figure(trial),
        "Confusion matrix",
        "Rows are true areas, columns what they were taken for; the darker, the larger the share of its row.",
        "Heat map of frames by true area and most probable area",
    )
    accuracy = html.table("Accuracy of each area", AREA_HEAD, area_rows(trial))
    counts = html.fold("The same as a table", html.table("Frames", *confusion_rows(trial)))
    return html.section("confusions", "What it takes for what", "", plot, counts, accuracy)


def _time(trial: PlaceTrial) -> str:
    plot = html.plot(
        "time",
        figures.time_figure(trial),
        "Areas along time",
        "Mistakes at the border of two areas are mild; those in the middle of one are not.",
        "True and most probable area of each frame over time",
    )
    return html.section("along", "Along the drive", "", plot)


def _calibration(trial: PlaceTrial) -> str:
    plot = html.plot(
        "reliability",
        figures.reliability_figure(trial),
        "Calibration curve",
        "Above the dashed line it is right more often than it says, below less often.",
        "Share of right answers over their probability",
    )
    table = html.fold("The same as a table", html.table("By how sure it is", CURVE_HEAD, curve_rows(trial.curve)))
    return html.section("sure", "Whether it knows how sure it is", "", plot, table)


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
