"""The page of a camera calibration: lenses, depth's error before and after, where boards were seen, and each view."""

from __future__ import annotations

from datetime import UTC, datetime
from html import escape
from pathlib import Path

import numpy as np

from wheelsight._version import __version__
from wheelsight.camera_calibration.result import CameraCalibration
from wheelsight.files import StrPath, write_text
from wheelsight.pipeline import words
from wheelsight.report import _html as html
from wheelsight.report import camera_figures as figures
from wheelsight.report.camera_tables import HEAD, distance_rows, lens_rows, view_rows
from wheelsight.report.page import fill_template

_GOOD_PX, _FAIR_PX = 0.3, 0.6
_FOOTER = "Lengths are in metres, angles in degrees, σ is one standard deviation. This page needs no network."
_VIEW_HEAD = ("view", "distance", "tilt", "corners", "RMS", "depth less plane")


def write_camera_page(found: CameraCalibration, path: StrPath) -> None:
    """Write the page, atomically. Raises OutputError."""
    rms_px = found.color_residuals.rms_px
    when = datetime.now(UTC).strftime("%Y-%m-%d %H:%M UTC")
    facts = (f"{len(found.views)} views of {found.board}", found.sensor, when, f"wheelsight {__version__}")
    page = fill_template(
        kicker="wheelsight camera calibration",
        title=escape("Cameras by a board"),
        facts=" · ".join(escape(fact) for fact in facts),
        tone="green" if rms_px < _GOOD_PX else "amber" if rms_px < _FAIR_PX else "red",
        phrase=escape(f"Corners are explained to {rms_px:.2f} px"),
        sentences=escape(_sentences(found)),
        tiles="\n".join(html.tile(*tile) for tile in _tiles(found)),
        notes=_notes(found),
        sections="\n".join((_lenses(found), *_depth(found), _views(found))),
        footer=escape(_FOOTER),
    )
    write_text(Path(path), page.encode("utf-8", "replace").decode("utf-8"))


def _sentences(found: CameraCalibration) -> str:
    text = f"The colour focal length is {found.color.fx:.1f} px, known to {_share(found, 'color')}."
    if len(found.depth_residuals.off_m):
        before, after = (
            float(np.sqrt((off**2).mean())) for off in (found.depth_residuals.before_m, found.depth_residuals.off_m)
        )
        text += f" Depth is off the boards' planes by {words.length(after)} after {words.length(before)}, RMS."
    return text


def _share(found: CameraCalibration, name: str) -> str:
    lens = found.color if name == "color" else found.depth
    sigma = found.sigmas.get(f"{name}.fx")
    return "as it was given" if sigma is None or lens is None else f"{100 * sigma / lens.fx:.2g} %"


def _tiles(found: CameraCalibration) -> list[tuple[str, str, str]]:
    distances_m = [view.distance_m for view in found.views]
    tiles = [
        ("Views", str(len(found.views)), f"{len(found.left_out)} left out"),
        ("Corners, RMS", f"{found.color_residuals.rms_px:.3f} px", f"{found.dropped_corners} left out"),
        ("Distances", f"{min(distances_m):.2f} to {max(distances_m):.2f} m", "of the boards"),
        ("Focal length", f"± {_share(found, 'color')}", "of colour, 1 σ"),
    ]
    if "T.x" in found.sigmas:
        apart_m = float(np.sqrt(sum(found.sigmas[f"T.{axis}"] ** 2 for axis in "xyz")))
        tiles.append(("Cameras apart", f"± {words.length(apart_m)}", "1 σ"))
    if len(found.depth_residuals.off_m):
        tiles.append(("Planes, RMS", words.length(found.depth_residuals.rms_m), "of cells, after correction"))
    return tiles


def _notes(found: CameraCalibration) -> str:
    notes = [*found.warnings, *(f"{name} is left out: {reason}." for name, reason in found.left_out)]
    if not found.board.is_size_known:
        notes.append("The size of the squares was not known: all lengths are by depth's nominal scale.")
    return html.section("notes", "What to know before trusting it", "", html.bullets(notes, "notes")) if notes else ""


def _lenses(found: CameraCalibration) -> str:
    coverage = html.plot(
        "coverage",
        figures.coverage_figure(found),
        "Where boards were seen",
        "The colour image; an area without boards is extrapolated. Corners that lean the same way show a bent board.",
        "Outlines of all boards in the colour image with the residuals of their corners",
    )
    return html.section("lenses", "The cameras", "", html.table("What was found", HEAD, lens_rows(found)), coverage)


def _depth(found: CameraCalibration) -> list[str]:
    depth = found.depth_residuals
    if not len(depth.off_m):
        return []
    head = ("distance", "off before", "off after", "scatter", "σ of depth")
    by_distance = html.plot(
        "by-distance",
        figures.distance_figure(found),
        "By distance",
        "Each point is a cell of a depth image less the plane that its board lies in, by the corners in colour.",
        "Depth less the plane's over distance, before and after correction",
    )
    by_region = html.plot(
        "by-region",
        figures.region_figure(found),
        "By place in the image",
        "Means over all views; white where no board was.",
        "Mean depth error over the image, before and after correction",
    )
    near_m, far_m = np.percentile(depth.depth_m, (1, 99)).tolist()
    correction = html.plot(
        "correction",
        figures.correction_figure(found.depth_error, found.depth or found.color, near_m, far_m),
        "What is added to depth",
        "As recordings are read. Raw disparities become depths first.",
        "What is added to depth over distance, at three places of the image",
    )
    table = html.table("Depth on the boards' planes", head, distance_rows(found))
    return [html.section("depth", "Depth", "", table, by_distance, by_region, correction)]


def _views(found: CameraCalibration) -> str:
    plot = html.plot(
        "views",
        figures.views_figure(found),
        "Views",
        "A view that stands out moved, or its board is bent.",
        "RMS of each view's corners over its distance",
    )
    return html.section("views", "The views", "", plot, html.table("Each view", _VIEW_HEAD, view_rows(found)))
