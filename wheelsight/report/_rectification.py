"""The page's section about areas that rectify wheels, and what it comes to in words."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Sequence

import numpy as np

from wheelsight.pipeline import words
from wheelsight.pipeline.rectification_record import RectificationRecord
from wheelsight.pipeline.run_record import RunRecord
from wheelsight.report import _html as html
from wheelsight.report import rectification_figures as figures

_DOUBT = 0.5
_WAYS = {"probabilistic": "probabilities, filtered", "paper": "eq. 5 of Trinh et al."}


def phrase(found: RectificationRecord) -> str | None:
    """What areas leave of the wheels' error, or None where that is not less."""
    if found.errors is None or not found.errors.left < 1:
        return None
    before, after = (words.length(s.mean) for s in (found.errors.wheels, found.errors.rectified))
    return f"Areas bring the wheels from {before} to {after} off (mean)"


def tiles(record: RunRecord) -> Iterable[tuple[str, str, str]]:
    """Key figures."""
    found = record.rectification
    if found is None:
        return
    if found.errors is not None:
        before = f"wheels alone {words.length(found.errors.wheels.mean)}"
        yield "In the map, mean error", words.length(found.errors.rectified.mean), before
    if found.is_judged.any():
        more = "" if found.belief is None else f"filtered {words.percent(found.accuracy(found.belief))}"
        yield "Right area, frame by frame", words.percent(found.accuracy(found.forest)), more


def notes(record: RunRecord) -> list[str]:
    """Frames that measured nothing, a model that names nothing, a model that is not trusted."""
    found = record.rectification
    if found is None or not found.looks:
        return []
    said = []
    unmeasured = [look.note for look in found.looks if look.probabilities is None]
    if unmeasured:
        kinds = Counter(note.removeprefix("no measurement: ") or "no pose yet" for note in unmeasured)
        which = ", ".join(f"{why} ({n:,})" for why, n in kinds.most_common(5))
        said.append(f"{words.count(len(unmeasured), 'frame')} told nothing of the area: {which}.")
    if found.way == "paper" and not any(look.named >= 0 for look in found.looks):
        said.append("The model was never sure enough to name an area, so that eq. 5 had nothing to go by.")
    distrusted = np.isfinite(found.trust) & (found.trust < _DOUBT)
    if distrusted.any():
        share = words.percent(float(distrusted.mean()))
        said.append(f"The model was not trusted in {share} of the frames, and corrected little there.")
    return said


def error_rows(found: RectificationRecord) -> tuple[tuple[str, ...], list[tuple[str, ...]]]:
    """Column names with units, and a row for the wheels alone and one for the rectified path; none without truth."""
    errors = found.errors
    if errors is None:
        return (), []
    both = ("wheels", errors.wheels, errors.wheels_m), ("rectified", errors.rectified, errors.rectified_m)
    columns = [
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
    ]
    return tuple(head for head, _ in columns), list(zip(*(cells for _, cells in columns), strict=True))


def section(records: Sequence[RunRecord]) -> str:
    """What areas did to the wheels: map, errors, probabilities along time; nothing of a run without places."""
    record = next((record for record in records if record.rectification is not None), None)
    if record is None or record.rectification is None:
        return ""
    found = record.rectification
    intro = (
        f"Wheels lead from frame to frame; the area that each frame shows corrects them, by {_WAYS[found.way]}. Here "
        f"nothing is laid upon anything: all paths are where they say they are in the map of the areas. {found.start}"
    )
    return html.section(
        "areas", "What areas did to the wheels", intro, _map(record), _errors(record, found), _time(record)
    )


def _map(record: RunRecord) -> str:
    return html.plot(
        "area-map",
        figures.area_map_figure(record),
        "On the map of areas",
        "Seen from above. All begin at the ring; squares are where each one ends.",
        "Areas from above with the paths of wheels alone, of rectified wheels, and of the ground truth where known.",
    )


def _errors(record: RunRecord, found: RectificationRecord) -> str:
    if found.errors is None:
        return html.paragraph("Without a ground truth, how far off either is cannot be said.", "missing")
    head, rows = error_rows(found)
    frames = words.count(len(found.errors.stamps_s), "frame")
    caption = f"Distance from the true base in x and y, nothing aligned, over {frames}."
    alt = (
        "Distances from the truth over time, "
        + "; ".join(
            f"{name} {words.length(one.mean)} in the mean"
            for name, one in (("wheels", found.errors.wheels), ("rectified", found.errors.rectified))
        )
        + "."
    )
    sentence = "Wheels drift away for good; what is rectified is brought back at each change of area."
    plot = html.plot("map-error", figures.map_error_figure(record), "Error in the map over time", sentence, alt)
    return html.table(caption, head, rows) + "\n" + plot


def _time(record: RunRecord) -> str:
    found = record.rectification
    assert found is not None
    if not found.looks:
        return html.paragraph("No frame was looked at.", "missing")
    sentence = "One row an area, in its colour on the map: the fuller, the more probable."
    if found.true_areas is not None:
        sentence += " The line is the area in which the robot truly was."
    alt = "Probability of each area over time"
    if found.is_judged.any():
        alt += f"; the most probable one is right in {words.percent(found.accuracy(found.forest))} of the frames"
    return html.plot("area-time", figures.area_time_figure(record), "Areas along time", sentence, alt + ".")
