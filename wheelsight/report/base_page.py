"""The page of a camera's mount: what changed, how sure it is, and what it was seen by."""

from __future__ import annotations

from datetime import UTC, datetime
from html import escape
from pathlib import Path

import numpy as np

from wheelsight._version import __version__
from wheelsight.files import StrPath, write_text
from wheelsight.odometry.extrinsics import BaseCalibration
from wheelsight.pipeline import words
from wheelsight.report import _html as html
from wheelsight.report import base_figures as figures
from wheelsight.report.base_tables import mount_rows, told
from wheelsight.report.page import fill_template
from wheelsight.report.wheel_tables import HEAD

_FOOTER = (
    "The base is between the driven wheels, on the ground: x forward, y left, z up. σ is one standard deviation. "
    "This page needs no network."
)


def write_base_page(found: BaseCalibration, path: StrPath) -> None:
    """Write the page about a mount's calibration, atomically. Raises OutputError."""
    path = Path(path)
    when = datetime.now(UTC).strftime("%Y-%m-%d %H:%M UTC")
    facts = ("wheels against camera, and the floor in depth", when, f"wheelsight {__version__}")
    page = fill_template(
        kicker="wheelsight camera mount",
        title=escape(found.recording),
        facts=" · ".join(escape(fact) for fact in facts),
        tone="green",
        phrase=escape(_phrase(found)),
        sentences=escape(_sentences(found)),
        tiles="\n".join(html.tile(*tile) for tile in _tiles(found)),
        notes=html.section("notes", "What to know before trusting it", "", html.bullets(_notes(found), "notes")),
        sections="\n".join((_mount(found), _turns(found), _floor(found), _pieces(found))),
        footer=escape(_FOOTER),
    )
    # A folder's name may hold bytes that are no text; they must not cost the page.
    write_text(path, page.encode("utf-8", "replace").decode("utf-8"))


def _phrase(found: BaseCalibration) -> str:
    tilt = max(found.sigmas[name] for name in ("roll", "pitch", "yaw"))
    place = max(found.sigmas[name] for name in ("x", "y", "height"))
    return f"The camera's mount, to {words.angle(float(np.degrees(tilt)))} and {words.length(place)} (1 σ)"


def _sentences(found: BaseCalibration) -> str:
    v = found.values
    ahead, aside = ("ahead of", "behind")[v["x"] < 0], ("left", "right")[v["y"] < 0]
    turned, tipped = ("left", "right")[v["yaw"] < 0], ("down", "up")[v["pitch"] < 0]
    late = ("late", "early")[v["delay"] < 0]
    return (
        f"It sits {words.length(abs(v['x']))} {ahead} the axle, {words.length(abs(v['y']))} to the {aside} and "
        f"{words.length(v['height'])} over the floor, and looks {_degrees(v['yaw'])} to the {turned} and "
        f"{_degrees(v['pitch'])} {tipped}. The wheels' stamps are {words.duration(abs(v['delay']))} {late} by the "
        "camera's clock."
    )


def _degrees(angle_rad: float) -> str:
    return f"{abs(np.degrees(angle_rad)):.1f}°"


def _tiles(found: BaseCalibration) -> list[tuple[str, str, str]]:
    fit, floor, sightings = found.fit, found.floor, found.sightings
    along, _, turn = fit.spread
    slips = words.count(int(fit.is_slip.sum()), "of them a slip or jump", "of them slips or jumps")
    turned = np.degrees(np.abs(fit.segments.motions[:, 2]).sum())
    return [
        ("Frames followed", f"{len(sightings.camera):,}", f"of {sightings.frame_count:,}"),
        ("Pieces fitted", str(len(fit.segments)), slips),
        ("Turned", f"{turned:.0f}°", f"wheels and camera agree by {words.percent(found.turning.agreement)}"),
        ("Floor seen in", str(len(floor.tilts)), f"of {floor.view_count} views"),
        ("Left in a piece", words.length(float(along)), f"and {words.angle(float(np.degrees(turn)))}; median spread"),
    ]


def _notes(found: BaseCalibration) -> list[str]:
    wheels, before = found.fit.wheels, found.wheels
    radius = (wheels.left_radius_m + wheels.right_radius_m) / (before.left_radius_m + before.right_radius_m) - 1
    track = wheels.track_width_m / before.track_width_m - 1
    lost = found.sightings.frame_count - len(found.sightings.camera)
    sizes = (
        f"By the camera's scale the wheels are {100 * radius:+.1f} % and the track {100 * track:+.1f} % off their "
        "nominal sizes. That was allowed for and is not written down: wheelsight calibrate wheels finds sizes."
    )
    delay = (
        "The delay holds all that lies between wheels and camera: their clocks, and how late the robot's body follows "
        "its wheels."
    )
    followed = [f"The camera was not followed in {words.count(lost, 'frame')}."] if lost else []
    return [*found.warnings, *followed, sizes, delay]


def _mount(found: BaseCalibration) -> str:
    before = found.nominal.T_base_camera is not None
    sentence = "The robot drives upwards; the wedge opens to where the camera looks."
    plot = html.plot(
        "mount",
        figures.mount_figure(found),
        "From above",
        sentence + (" Orange is where it was believed to sit." if before else ""),
        "Axle, wheels and camera from above",
    )
    return html.section("mount", "The mount", "", html.table("Before and after", HEAD, mount_rows(found)), plot)


def _turns(found: BaseCalibration) -> str:
    plot = html.plot(
        "turns",
        figures.turning_figure(found),
        "Turn rates",
        f"With {told('delay', found.values['delay'])} taken off the wheels' stamps, both tell of one drive. "
        "Turns show x, y and the delay; the straight ways between them show yaw.",
        "Turn rates by wheels and camera over time",
    )
    return html.section("turns", "What the drive shows", "", plot)


def _floor(found: BaseCalibration) -> str:
    plot = html.plot(
        "floor",
        figures.floor_figure(found),
        "The floor, view by view",
        "Roll, pitch and height by each view alone, less those by all. Steps or a wave would mean a camera that moves "
        "on its mount, or ground that is not level.",
        "Roll, pitch and height by the floor in each view",
    )
    return html.section("floor", "The floor", "", plot)


def _pieces(found: BaseCalibration) -> str:
    plot = html.plot(
        "pieces",
        figures.residual_figure(found),
        "Residuals",
        "Wheels minus camera over each piece of the way; slips may lie at the edge.",
        "Residuals of the pieces over time, along, across and in turn",
    )
    return html.section("pieces", "What stayed unexplained", "", plot)
