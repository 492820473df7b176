"""The section about a run's map."""

from __future__ import annotations

from wheelsight.pipeline import words
from wheelsight.pipeline.map_record import MapPicture, MapRecord
from wheelsight.pipeline.run_record import RunRecord
from wheelsight.report import _cloud as points
from wheelsight.report import _drawing as drawing
from wheelsight.report import _html as html
from wheelsight.report import map_figures as figures


def section(record: RunRecord, of: str = "") -> str:
    """What the place looks like: from above, and from where the camera was; nothing of a run without a map.

    `of` as in the page's other sections.
    """
    if record.map is None:
        return ""
    key, title = (f"{of}-map", f"{of.capitalize()}: the map") if of else ("map", "The map")
    if record.map.plan is None:
        return html.section(key, title, "", html.paragraph("It is empty: no frame had a pose.", "missing"))
    start_s = record.frames[0].stamp_s if record.frames else 0.0
    shown = html.group("pictures", [_picture(picture, start_s) for picture in record.map.pictures])
    figures_of = (points.figure(record, key), _plan(record, of, key), shown if record.map.pictures else "")
    return html.section(key, title, _intro(record.map, of), *figures_of)


def tile(found: MapRecord) -> tuple[str, str, str]:
    """A key figure: name, value, what puts it into proportion."""
    stable = words.percent(found.status.stable / found.status.surfels) if found.status.surfels else "0 %"
    return "Surfels in the map", f"{found.status.surfels:,}", f"{stable} of them stable"


def _intro(found: MapRecord, of: str) -> str:
    status, file = found.status, f"{of}/{found.file}" if of else found.file
    return (
        f"{words.count(status.surfels, 'surfel')} (small disks) of {words.count(found.fused, 'frame')}, "
        f"{status.stable:,} of them stable: seen often enough to be sure. They took {status.memory_bytes / 1e6:,.0f} "
        f"MB of memory, and are in {file}, of which wheelsight export makes points or a mesh."
    )


def _plan(record: RunRecord, of: str, key: str) -> str:
    assert record.map is not None
    sentence = (
        "Stable surfels seen from straight above, what faces down left out, and what stands upright drawn darker; the "
        "line is the path, from the circle to the square. White is not known."
    )
    if not record.map.is_levelled:
        sentence += " Which way is up was judged by the surfels, since the calibration does not tell it."
    colour = drawing.ODOMETRY_COLOURS.get(of, drawing.BLUE)
    alt = "The map seen from above, with the path of the camera over it."
    return html.plot(f"{key}-plan", figures.plan_figure(record, colour), "From above", sentence, alt)


def _picture(picture: MapPicture, start_s: float) -> str:
    caption = f"{picture.stamp_s - start_s:.2f} s after the start: left the frame, right the finished map from there"
    return html.picture(figures.view_uri(picture), caption + ".", f"Frame and map side by side: {caption}.")
