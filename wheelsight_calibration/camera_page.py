"""The pages of a camera's calibration and of its mount on the robot: intrinsics, depth, mount, and their
uncertainty.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import numpy as np

from wheelsight.app.run import words
from wheelsight.core.depth_errors import DepthError
from wheelsight.core.files import StrPath
from wheelsight.core.geometry import BoolArray, FloatArray, PinholeCamera, so3
from wheelsight_calibration.base import QUANTITIES, BaseCalibration
from wheelsight_calibration.cameras import CameraCalibration, DepthResiduals
from wheelsight_calibration.residuals import ResidualPanel, residual_panels
from wheelsight_calibration.wheel_drive import drive_path
from wheelsight_calibration.wheel_page import HEAD as MOUNT_HEAD
from wheelsight_report import drawing, html
from wheelsight_report import plotly as go
from wheelsight_report.drawing import BLUE, GREY, ORANGE, PURPLE, VERMILLION
from wheelsight_report.plotly import make_subplots

_GOOD_PX, _FAIR_PX = 0.3, 0.6
_FOOTER = "Lengths are in metres, angles in degrees, σ is one standard deviation. This page needs no network."
_VIEW_HEAD = ("view", "distance", "tilt", "corners", "RMS", "depth less plane")


def write_camera_page(found: CameraCalibration, path: StrPath) -> None:
    """Write the page, atomically. Raises OutputError."""
    rms_px = found.color_residuals.rms_px
    text = f"The colour focal length is {found.color.fx:.1f} px, known to {_share(found, 'color')}."
    if len(found.depth_residuals.off_m):
        before, after = (
            float(np.sqrt((off**2).mean())) for off in (found.depth_residuals.before_m, found.depth_residuals.off_m)
        )
        text += f" Depth is off the boards' planes by {words.length(after)} after {words.length(before)}, RMS."
    remarks = [*found.warnings, *(f"{name} is left out: {reason}." for name, reason in found.left_out)]
    if not found.board.is_size_known:
        remarks.append("The size of the squares was not known: all lengths are by depth's nominal scale.")
    coverage = html.plot(
        "coverage",
        coverage_figure(found),
        "Where boards were seen",
        "The colour image; an area without boards is extrapolated. Corners that lean the same way show a bent board.",
        "Outlines of all boards in the colour image with the residuals of their corners",
    )
    lenses = html.section("lenses", "The cameras", "", html.table("What was found", HEAD, lens_rows(found)), coverage)
    plot = html.plot(
        "views",
        views_figure(found),
        "Views",
        "A view that stands out moved, or its board is bent.",
        "RMS of each view's corners over its distance",
    )
    views = html.section("views", "The views", "", plot, html.table("Each view", _VIEW_HEAD, view_rows(found)))
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
    page = html.page(
        kicker="wheelsight camera calibration",
        title="Cameras by a board",
        facts=html.facts_now(f"{len(found.views)} views of {found.board}", found.sensor),
        tone="green" if rms_px < _GOOD_PX else "amber" if rms_px < _FAIR_PX else "red",
        phrase=f"Corners are explained to {rms_px:.2f} px",
        sentences=[text],
        tiles=tiles,
        notes=remarks,
        sections=(lenses, _depth(found), views),
        footer=_FOOTER,
    )
    html.save(page, path)


def _share(found: CameraCalibration, name: str) -> str:
    lens = found.color if name == "color" else found.depth
    sigma = found.sigmas.get(f"{name}.fx")
    return "as it was given" if sigma is None or lens is None else f"{100 * sigma / lens.fx:.2g} %"


def _depth(found: CameraCalibration) -> str:
    depth = found.depth_residuals
    if not len(depth.off_m):
        return ""
    by_distance = html.plot(
        "by-distance",
        distance_figure(found),
        "By distance",
        "Each point is a cell of a depth image less the plane that its board lies in, by the corners in colour.",
        "Depth less the plane's over distance, before and after correction",
    )
    by_region = html.plot(
        "by-region",
        region_figure(found),
        "By place in the image",
        "Means over all views; white where no board was.",
        "Mean depth error over the image, before and after correction",
    )
    near_m, far_m = np.percentile(depth.depth_m, (1, 99)).tolist()
    correction = html.plot(
        "correction",
        correction_figure(found.depth_error, found.depth or found.color, near_m, far_m),
        "What is added to depth",
        "As recordings are read. Raw disparities become depths first.",
        "What is added to depth over distance, at three places of the image",
    )
    table = html.table("Depth on the boards' planes", DISTANCE_HEAD, distance_rows(found))
    return html.section("depth", "Depth", "", table, by_distance, by_region, correction)


_MOST_POINTS, _ARROWS_TIMES = 4000, 60
_ACROSS, _DOWN = 16, 12


def coverage_figure(found: CameraCalibration) -> go.Figure:
    """Outlines of all boards in the colour image, and the residual of each corner, times 60."""
    figure = drawing.style(go.Figure(), 460, hovermode="closest")
    columns, rows = found.board.columns, found.board.rows
    ring = [0, columns - 1, rows * columns - 1, (rows - 1) * columns, 0]
    for view in found.views:
        places = dict(zip(view.corners.ids.tolist(), view.corners.px.tolist(), strict=True))
        line = np.array([places[k] for k in ring if k in places]).reshape(-1, 2)
        figure.add_scatter(
            x=line[:, 0], y=line[:, 1], mode="lines", line={"color": GREY, "width": 1}, name=view.name,
            showlegend=False, hovertemplate=f"{view.name}: {view.distance_m:.2f} m<extra></extra>",
        )  # fmt: skip
    every = max(len(found.color_residuals.px) // _MOST_POINTS, 1)
    px, off = found.color_residuals.px[::every], found.color_residuals.off_px[::every]
    ends = np.stack([px, px + _ARROWS_TIMES * off, np.full_like(px, np.nan)], axis=1).reshape(-1, 2)
    figure.add_scatter(
        x=ends[:, 0], y=ends[:, 1], mode="lines", line={"color": BLUE, "width": 1},
        name=f"predicted less seen, × {_ARROWS_TIMES}", hoverinfo="skip",
    )  # fmt: skip
    figure.update_xaxes(range=[0, found.color.width], title_text="px")
    figure.update_yaxes(range=[found.color.height, 0], scaleanchor="x", scaleratio=1)
    return figure


def distance_figure(found: CameraCalibration) -> go.Figure:
    """Error of depth against the board's plane over distance, before and after, as mean and scatter of bands."""
    figure = drawing.style(go.Figure(), 340, hovermode="closest")
    depth = found.depth_residuals
    every = max(len(depth.off_m) // _MOST_POINTS, 1)
    for name, off_m, color in (("before", depth.before_m, ORANGE), ("after", depth.off_m, BLUE)):
        figure.add_scatter(
            x=depth.depth_m[::every], y=1e3 * off_m[::every], mode="markers", name=name, legendgroup=name,
            marker={"size": 3, "color": color, "opacity": 0.35}, hovertemplate="%{x:.2f} m: %{y:.1f} mm<extra></extra>",
        )  # fmt: skip
        middles = [float(np.median(depth.depth_m[inside])) for _, _, inside in bands(depth)]
        means = [1e3 * float(off_m[inside].mean()) for _, _, inside in bands(depth)]
        figure.add_scatter(
            x=middles, y=means, mode="lines+markers", name=f"{name}, mean", legendgroup=name, showlegend=False,
            line={"color": color, "width": 2}, hovertemplate="%{x:.2f} m: mean %{y:.1f} mm<extra></extra>",
        )  # fmt: skip
    figure.add_hline(y=0, line=drawing.DASHED)
    figure.update_xaxes(title_text="distance of the board's plane, m")
    drawing.panel_title(figure, "depth less the plane's, mm")
    return figure


def region_figure(found: CameraCalibration) -> go.Figure:
    """Mean depth error over the image, before and after, mm, in cells with boards."""
    camera = found.depth or found.color
    figure = make_subplots(rows=1, cols=2, shared_yaxes=True, horizontal_spacing=0.04)
    drawing.style(figure, 360, hovermode="closest")
    depth = found.depth_residuals
    u = (depth.px[:, 0] * _ACROSS / camera.width).astype(int).clip(0, _ACROSS - 1)
    v = (depth.px[:, 1] * _DOWN / camera.height).astype(int).clip(0, _DOWN - 1)
    cell, cells = v * _ACROSS + u, _ACROSS * _DOWN
    count = np.bincount(cell, minlength=cells)
    with np.errstate(invalid="ignore"):
        maps = [
            np.where(count > 0, np.bincount(cell, 1e3 * off_m, cells) / count, np.nan).reshape(_DOWN, _ACROSS)
            for off_m in (depth.before_m, depth.off_m)
        ]
    limit = max(float(np.nanmax(np.abs(maps))) if np.isfinite(maps).any() else 1.0, 0.1)
    for column, values in enumerate(maps, start=1):
        figure.add_heatmap(
            z=values, x=_middles(camera.width, _ACROSS), y=_middles(camera.height, _DOWN), zmin=-limit, zmax=limit,
            colorscale="RdBu", showscale=column == 2, colorbar={"title": "mm"},
            hovertemplate="%{x:.0f}, %{y:.0f} px: %{z:.1f} mm<extra></extra>", row=1, col=column,
        )  # fmt: skip
    figure.update_yaxes(autorange="reversed")
    for name, x in (("before", 0.0), ("after", 0.52)):
        figure.add_annotation(
            text=name, x=x, y=1, xref="paper", yref="paper", xanchor="left", yanchor="bottom", showarrow=False
        )
    return figure


def views_figure(found: CameraCalibration) -> go.Figure:
    """RMS of each view's corners over its distance."""
    figure = drawing.style(go.Figure(), 300, hovermode="closest")
    rms = found.color_residuals.of_views(len(found.views))
    usual = float(np.median(rms))
    figure.add_scatter(
        x=[view.distance_m for view in found.views], y=rms, mode="markers", text=[view.name for view in found.views],
        marker={"size": 8, "color": np.where(rms > 2 * usual, VERMILLION, BLUE)}, showlegend=False,
        hovertemplate="%{text}: %{x:.2f} m, %{y:.3f} px<extra></extra>",
    )  # fmt: skip
    figure.update_xaxes(title_text="distance of the board, m")
    figure.update_yaxes(rangemode="tozero")
    drawing.panel_title(figure, "corners' RMS, px")
    return figure


def correction_figure(error: DepthError, camera: PinholeCamera, near_m: float, far_m: float) -> go.Figure:
    """The depth correction over distance: in the image's middle, and at a third of the way to two corners."""
    figure = drawing.style(go.Figure(), 320, hovermode="x unified")
    depth_m = np.linspace(near_m, far_m, 120)
    for name, share, color in (("middle", 0.5, BLUE), ("upper left", 0.17, ORANGE), ("lower right", 0.83, VERMILLION)):
        px = np.tile([share * (camera.width - 1), share * (camera.height - 1)], (len(depth_m), 1))
        added_mm = 1e3 * (error.of_readings(depth_m, px, camera) - depth_m)
        drawing.add_line(figure, depth_m, added_mm, name=name, line={"color": color, "width": 2}, hover="%{y:.1f} mm")
    figure.add_hline(y=0, line=drawing.DASHED)
    figure.update_xaxes(title_text="depth as read, m", hoverformat=".2f")
    drawing.panel_title(figure, "added to it, mm")
    return figure


def _middles(length: int, count: int) -> FloatArray:
    return (np.arange(count) + 0.5) * length / count


HEAD = ("", "found", "± σ")
DISTANCE_HEAD = ("distance", "off before", "off after", "scatter", "σ of depth")
_BANDS_M = (0.0, 0.8, 1.2, 1.6, 2.0, 2.5, 3.0, 3.5, 4.0, 5.0, 6.0, 10.0)
_FEWEST_CELLS = 20
_BROWN = ("k1", "k2", "p1", "p2", "k3")


def lens_rows(found: CameraCalibration) -> list[tuple[str, ...]]:
    """A row for each estimated parameter, with its σ."""
    rows = _of_lens("colour", found.color, "color", found)
    if found.depth is not None and found.T_color_depth is not None:
        rows += _of_lens("depth", found.depth, "depth", found)
        T = found.T_color_depth
        turns_deg = np.degrees(so3.log(T[:3, :3]))
        for axis, way_m in zip("xyz", T[:3, 3], strict=True):
            rows.append((f"T_color_depth {axis}", f"{1e3 * way_m:.2f} mm", _sigma(found, f"T.{axis}", 1e3, " mm")))
        for axis, turn_deg in zip("xyz", turns_deg, strict=True):
            sigma = _sigma(found, f"T.turn_{axis}_deg", 1, "°")
            rows.append((f"turn about {axis}", f"{turn_deg:.3f}°", sigma))
    if not found.board.is_size_known:
        side = f"{1e3 * found.board.square_m:.2f} mm, by depth's scale"
        rows.append(("side of a square", side, _sigma(found, "square", 1e3, " mm")))
    rows.append(("colour corners, RMS", f"{found.color_residuals.rms_px:.3f} px", ""))
    if len(found.infrared_residuals.px):
        rows.append(("infrared corners, RMS", f"{found.infrared_residuals.rms_px:.3f} px", ""))
    return rows


def distance_rows(found: CameraCalibration) -> list[tuple[str, ...]]:
    """A row for each band of distance: depth error before and after, its scatter, and σ of the correction."""
    rows: list[tuple[str, ...]] = []
    for low, high, inside in bands(found.depth_residuals):
        off, before = found.depth_residuals.off_m[inside], found.depth_residuals.before_m[inside]
        sigma = ""
        if len(found.depth_sigma_m):
            middle_m = float(np.median(found.depth_residuals.depth_m[inside]))
            sigma = f"{1e3 * np.interp(middle_m, *found.depth_sigma_m.T):.1f} mm"
        rows.append(
            (
                f"{low:g} to {high:g} m",
                f"{1e3 * before.mean():+.1f} mm",
                f"{1e3 * off.mean():+.1f} mm",
                f"{1e3 * off.std():.1f} mm",
                sigma,
            )
        )
    return rows


def bands(depth: DepthResiduals) -> list[tuple[float, float, np.ndarray]]:
    """Bands of distance with enough cells: from, to, and which (N,)."""
    found = []
    for low, high in pairwise(_BANDS_M):
        inside = (depth.depth_m >= low) & (depth.depth_m < high)
        if np.count_nonzero(inside) >= _FEWEST_CELLS:
            found.append((low, high, inside))
    return found


def view_rows(found: CameraCalibration) -> list[tuple[str, ...]]:
    """A row for each view: distance, tilt, RMS of the corners and mean depth error."""
    rms = found.color_residuals.of_views(len(found.views))
    rows: list[tuple[str, ...]] = []
    for k, view in enumerate(found.views):
        n = view.T_color_board[:3, 2]
        off = found.depth_residuals.off_m[found.depth_residuals.view == k]
        rows.append(
            (
                view.name,
                f"{view.distance_m:.2f} m",
                f"{np.degrees(np.arccos(np.clip(n[2], -1, 1))):.0f}°",
                str(len(view.corners.ids)),
                f"{rms[k]:.3f} px",
                f"{1e3 * off.mean():+.1f} mm" if len(off) else "none",
            )
        )
    return rows


def _of_lens(name: str, lens: PinholeCamera, key: str, found: CameraCalibration) -> list[tuple[str, ...]]:
    rows: list[tuple[str, ...]] = [
        (f"{name} {field}", f"{getattr(lens, field):.2f} px", _sigma(found, f"{key}.{field}", 1, " px"))
        for field in ("fx", "fy", "cx", "cy")
    ]
    for number, value in zip(_BROWN, lens.distortion, strict=True):
        if f"{key}.{number}" in found.sigmas:
            rows.append((f"{name} {number}", f"{value:.4f}", _sigma(found, f"{key}.{number}", 1, "")))
    return rows


def _sigma(found: CameraCalibration, name: str, factor: float, unit: str) -> str:
    return f"{factor * found.sigmas[name]:.2g}{unit}" if name in found.sigmas else ""


_MOUNT_FOOTER = (
    "The base is between the driven wheels, on the ground: x forward, y left, z up. σ is one standard deviation. "
    "This page needs no network."
)


def write_base_page(found: BaseCalibration, path: StrPath) -> None:
    """Write the page about a mount's calibration, atomically. Raises OutputError."""
    tilt = max(found.sigmas[name] for name in ("roll", "pitch", "yaw"))
    place = max(found.sigmas[name] for name in ("x", "y", "height"))
    phrase = f"The camera's mount, to {words.angle(float(np.degrees(tilt)))} and {words.length(place)} (1 σ)"
    v = found.values
    ahead, aside = ("ahead of", "behind")[v["x"] < 0], ("left", "right")[v["y"] < 0]
    turned, tipped = ("left", "right")[v["yaw"] < 0], ("down", "up")[v["pitch"] < 0]
    late = ("late", "early")[v["delay"] < 0]
    yaw_deg, pitch_deg = (abs(np.degrees(v[name])) for name in ("yaw", "pitch"))
    sentence = (
        f"It sits {words.length(abs(v['x']))} {ahead} the axle, {words.length(abs(v['y']))} to the {aside} and "
        f"{words.length(v['height'])} over the floor, and looks {yaw_deg:.1f}° to the {turned} and "
        f"{pitch_deg:.1f}° {tipped}. The wheels' stamps are {words.duration(abs(v['delay']))} {late} by the "
        "camera's clock."
    )
    where = "The robot drives upwards; the wedge opens to where the camera looks."
    where += "" if found.nominal.T_base_camera is None else " Orange is where it was believed to sit."
    plot = html.plot("mount", mount_figure(found), "From above", where, "Axle, wheels and camera from above")
    table = html.table("Before and after", MOUNT_HEAD, mount_rows(found))
    mount = html.section("mount", "The mount", "", table, plot)
    plot = html.plot(
        "turns",
        turning_figure(found),
        "Turn rates",
        f"With {in_unit('delay', found.values['delay'])} taken off the wheels' stamps, both show one drive. "
        "Turns show x, y and the delay; the straight ways between them show yaw.",
        "Turn rates by wheels and camera over time",
    )
    turns = html.section("turns", "What the drive shows", "", plot)
    floor_plot = html.plot(
        "floor",
        floor_figure(found),
        "The floor, view by view",
        "Roll, pitch and height by each view alone, less those by all. Steps or a wave would mean a camera that moves "
        "on its mount, or ground that is not level.",
        "Roll, pitch and height by the floor in each view",
    )
    floor_section = html.section("floor", "The floor", "", floor_plot)
    residual_plot = html.plot(
        "pieces",
        residual_figure(found),
        "Residuals",
        "Wheels minus camera over each piece of the way; slips may lie at the edge.",
        "Residuals of the pieces over time, along, across and in turn",
    )
    residual_section = html.section("pieces", "What stayed unexplained", "", residual_plot)
    fit, floor, sightings = found.fit, found.floor, found.sightings
    along, _, turn = fit.spread
    slips = words.count(int(fit.is_slip.sum()), "of them a slip or jump", "of them slips or jumps")
    turned = np.degrees(np.abs(fit.segments.motions[:, 2]).sum())
    page = html.page(
        kicker="wheelsight camera mount",
        title=found.recording,
        facts=html.facts_now("wheels against camera, and the floor in depth"),
        tone="green",
        phrase=phrase,
        sentences=[sentence],
        tiles=[
            ("Frames followed", f"{len(sightings.camera):,}", f"of {sightings.frame_count:,}"),
            ("Pieces fitted", str(len(fit.segments)), slips),
            ("Turned", f"{turned:.0f}°", f"wheels and camera agree by {words.percent(found.turning.agreement)}"),
            ("Floor seen in", str(len(floor.tilts)), f"of {floor.view_count} views"),
            (
                "Left in a piece",
                words.length(float(along)),
                f"and {words.angle(float(np.degrees(turn)))}; median spread",
            ),
        ],
        notes=_mount_notes(found),
        sections=(mount, turns, floor_section, residual_section),
        footer=_MOUNT_FOOTER,
    )
    html.save(page, path)


def _mount_notes(found: BaseCalibration) -> list[str]:
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


_RATE_STEP_S = 0.2
_LOOK_M = 0.3
_DEGREES = 180 / np.pi


def mount_figure(found: BaseCalibration) -> go.Figure:
    """Axle, wheels and the camera before and after the calibration, from above; x points up."""
    figure = drawing.map_figure(420, ("left and right of the middle", "x, m: ahead of the axle"), left=88)
    half_m, radius_m = found.wheels.track_width_m / 2, found.wheels.left_radius_m
    for side_m in (half_m, -half_m):
        wheel = np.array([[-side_m, -radius_m], [-side_m, radius_m]])
        _line(figure, wheel, "wheel", {"color": GREY, "width": 9})
    _line(figure, np.array([[-half_m, 0.0], [half_m, 0.0]]), "axle", {"color": GREY, "width": 2})
    if found.nominal.T_base_camera is not None:
        _camera(figure, found.nominal.T_base_camera, "nominal", ORANGE)
    _camera(figure, found.T_base_camera, "calibrated", BLUE)
    figure.update_xaxes(tickvals=[])
    return figure


def turning_figure(found: BaseCalibration) -> go.Figure:
    """Turn rates by the wheels without their delay, and by the camera about the estimated axis, degrees a second."""
    camera = found.sightings.camera
    marks = np.arange(camera.stamps_s[0], camera.stamps_s[-1], _RATE_STEP_S)
    cuts = np.unique(np.searchsorted(camera.stamps_s, marks))
    stamps_s, T_odom_camera = camera.stamps_s[cuts], camera.T_frame_body[cuts]
    yaw_camera = _heading(T_odom_camera[:, :3, :3] @ np.asarray(found.T_base_camera[:3, :3].T))
    path = drive_path(found.sightings.drive, found.fit.wheels, stamps_s).T_frame_body
    figure = drawing.style(go.Figure(), 300, hovermode="x unified")
    middle_s = (stamps_s[1:] + stamps_s[:-1]) / 2 - found.sightings.span_s[0]
    for name, yaw, line in (
        ("wheels", _heading(path[:, :3, :3]), {"color": PURPLE, "width": 4}),
        ("camera", yaw_camera, {"color": BLUE, "width": 1.5}),
    ):
        rates = _DEGREES * np.diff(yaw) / np.diff(stamps_s)
        rates[np.diff(stamps_s) > 3 * _RATE_STEP_S] = np.nan
        drawing.add_line(figure, middle_s, rates, name=name, line=line, hover="%{y:.1f}°/s")
    drawing.time_axis_until(figure, float(middle_s[-1]), "seconds since the first frame")
    drawing.panel_title(figure, "turn rate, °/s, left is positive")
    return figure


def floor_figure(found: BaseCalibration) -> go.Figure:
    """Roll, pitch and height by the floor of each view, relative to the joint estimate."""
    roll, pitch, height = (found.floor.tilts - [found.values[name] for name in ("roll", "pitch", "height")]).T
    panels = (("roll", "°", _DEGREES * roll), ("pitch", "°", _DEGREES * pitch), ("height", "mm", 1e3 * height))
    stamps_s = found.floor.stamps_s - found.sightings.span_s[0]
    return _residuals(stamps_s, panels, np.zeros(len(stamps_s), bool), ("a view", ""))


def residual_figure(found: BaseCalibration) -> go.Figure:
    """Residuals of wheels and mount for each piece of the camera's path; slips stand out."""
    fit = found.fit
    along, across, turn = fit.residuals.T
    panels = (("along the way", "mm", 1e3 * along), ("across", "mm", 1e3 * across), ("turn", "°", _DEGREES * turn))
    middle_s = (fit.segments.start_s + fit.segments.end_s) / 2 - found.sightings.span_s[0]
    return _residuals(middle_s, panels, fit.is_slip, ("a piece", "slip or jump, hardly counted"))


def _residuals(
    stamps_s: FloatArray, panels: Sequence[tuple[str, str, FloatArray]], is_off: BoolArray, kinds: tuple[str, str]
) -> go.Figure:
    limits = [1.15 * max(float(np.abs(values[~is_off]).max(initial=0.0)), 1e-3) for _, _, values in panels]
    drawn = [ResidualPanel(*panel, limit) for panel, limit in zip(panels, limits, strict=True)]
    return residual_panels(stamps_s, drawn, is_off, kinds, "seconds since the first frame")


def _camera(figure: go.Figure, T_base_camera: FloatArray, name: str, color: str) -> None:
    """A wedge at the camera's position that opens in its viewing direction."""
    x, y = T_base_camera[:2, 3]
    ahead = T_base_camera[:2, 2]
    yaw = np.arctan2(ahead[1], ahead[0])
    corners = [(x, y)]
    corners += [(x + _LOOK_M * np.cos(yaw + side), y + _LOOK_M * np.sin(yaw + side)) for side in (0.35, -0.35)]
    outline = np.array([(-left, forward) for forward, left in [*corners, corners[0]]])
    figure.add_scatter(
        x=outline[:, 0],
        y=outline[:, 1],
        mode="lines",
        fill="toself",
        line={"color": color, "width": 2},
        opacity=0.55,
        name=name,
        hoveron="fills",
        text=f"{name}: x {x:.3f} m, y {y:.3f} m, yaw {np.degrees(yaw):.2f}°",
        hoverinfo="text",
    )


def _line(figure: go.Figure, points: FloatArray, name: str, line: dict[str, object]) -> None:
    figure.add_scatter(
        x=points[:, 0], y=points[:, 1], mode="lines", line=line, name=name, showlegend=False, hoverinfo="name"
    )


def _heading(R_odom_base: FloatArray) -> FloatArray:
    """Unwrapped yaw (N,) of rotations (N, 3, 3), about the first one's z axis."""
    R = R_odom_base[0].T @ R_odom_base
    return np.unwrap(np.arctan2(R[:, 1, 0], R[:, 0, 0]))


# Name, unit, and how many of it make one of radians, metres or seconds.
UNITS = {
    "roll": ("roll, leans right", "°", 180 / np.pi),
    "pitch": ("pitch, looks down", "°", 180 / np.pi),
    "yaw": ("yaw, looks left", "°", 180 / np.pi),
    "x": ("x, ahead of the axle", "mm", 1e3),
    "y": ("y, left of the middle", "mm", 1e3),
    "height": ("height over the floor", "mm", 1e3),
    "delay": ("delay of the wheels' stamps", "ms", 1e3),
}


def mount_rows(found: BaseCalibration) -> list[tuple[str, ...]]:
    """One row a quantity, as `wheel_page.HEAD` names the columns."""
    rows: list[tuple[str, ...]] = []
    for name in QUANTITIES:
        after, before = found.values[name], found.nominal_values.get(name)
        known, changed = "unknown", ""
        if before is not None:
            change = after - before
            if UNITS[name][1] == "°":
                change = float((change + np.pi) % (2 * np.pi) - np.pi)
            known, changed = in_unit(name, before), in_unit(name, change, signed=True)
        rows.append((UNITS[name][0], known, in_unit(name, after), in_unit(name, found.sigmas[name]), changed))
    return rows


def in_unit(name: str, value: float, *, signed: bool = False) -> str:
    """A quantity in its customary unit."""
    _, unit, factor = UNITS[name]
    places = 2 if unit == "°" else 1
    shown = round(factor * value, places) + 0.0  # no minus before nothing
    text = f"{shown:{'+' if signed else ''}.{places}f}"
    return f"{text}°" if unit == "°" else f"{text} {unit}"
