"""Table and page of a robot's self-calibration: values before and after, and walls before and after."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from wheelsight.core.calibration import Measured
from wheelsight.core.files import StrPath
from wheelsight.core.geometry import FloatArray
from wheelsight_calibration.base import mount_values
from wheelsight_calibration.self_calibration import SelfCalibration, not_shown
from wheelsight_report import drawing, html
from wheelsight_report import plotly as go
from wheelsight_report.drawing import BLUE, ORANGE
from wheelsight_report.plotly import make_subplots

SELF_HEAD = ("", "before", "after", "± σ", "from drive")
_DISTANCES_M = (1.0, 2.0, 3.0, 4.0)
_BINS_M = (0.0, 1.0, 1.5, 2.0, 2.5, 3.0, 3.5, 4.0, 5.0, 6.0)
_FEWEST_IN_BIN = 30
_FOOTER = "Lengths are in metres, angles in degrees, σ is one standard deviation. This page needs no network."


class Quantity(NamedTuple):
    """A value before and after, its σ, and the share of information from the drive, in the unit of its text."""

    name: str
    unit: str
    places: int
    before: float
    after: float
    sigma: float
    share: float

    @property
    def row(self) -> tuple[str, ...]:
        """As `SELF_HEAD` names the columns."""
        before, after = (f"{value + 0.0:.{self.places}f}{self.unit}" for value in (self.before, self.after))
        return self.name, before, after, f"{self.sigma:.{self.places}f}{self.unit}", f"{100 * self.share:.0f} %"


def quantities_of(found: SelfCalibration) -> list[Quantity]:
    """Return what the calibration is about, in customary units."""
    model, rows = found.model, list[Quantity]()
    depths_m, count = np.array(_DISTANCES_M), model.camera_count
    J = np.zeros((len(depths_m), len(model)))
    J[:, :count] = model.depth_at(depths_m)
    sigmas, priors = (np.sqrt(np.einsum("dp,pq,dq->d", J, C, J)) for C in (found.covariance, model.prior))
    for z, change, sigma, prior in zip(_DISTANCES_M, J @ found.values, sigmas, priors, strict=True):
        share = max(1 - float(sigma / prior) ** 2, 0.0)
        after_m, sigma_m = z + float(change), float(sigma)
        rows.append(Quantity(f"depth read as {z:g} m", " mm", 0, 1e3 * z, 1e3 * after_m, 1e3 * sigma_m, share))
    sigma_of = dict(zip(model.names, np.sqrt(np.diag(found.covariance)).tolist(), strict=True))
    share_of = dict(zip(model.names, found.shares.tolist(), strict=True))
    old, new = model.calibration, found.calibration
    assert old.depth is not None
    assert new.depth is not None
    fx = old.depth.fx

    def add(name: str, key: str, unit: str, places: int, values: tuple[float, float], factor: float = 1.0) -> None:
        before, after = (value * factor for value in values)
        sigma = sigma_of[key] * (abs(before) if key in _RELATIVE else fx if key in _IN_PX else factor)
        rows.append(Quantity(name, unit, places, before, after, sigma, max(share_of[key], 0.0)))

    add("focal length", "focal_length", " px", 2, (fx, new.depth.fx))
    add("centre, x", "centre_x", " px", 2, (old.depth.cx, new.depth.cx))
    add("centre, y", "centre_y", " px", 2, (old.depth.cy, new.depth.cy))
    if model.has_mount:
        assert old.T_base_camera is not None
        assert new.T_base_camera is not None
        before, after = mount_values(old.T_base_camera), mount_values(new.T_base_camera)
        for name in ("roll", "pitch", "yaw"):
            add(f"camera's {name}", name, "°", 2, (before[name], after[name]), 180 / np.pi)
        for name in ("x", "y", "height"):
            add(f"camera's {name}", name, " mm", 1, (before[name], after[name]), 1e3)
    if model.has_wheels:
        assert old.wheels is not None
        assert new.wheels is not None
        for name in ("left_radius", "right_radius", "track_width"):
            pair = getattr(old.wheels, f"{name}_m"), getattr(new.wheels, f"{name}_m")
            add(name.replace("_", " "), name, " mm", 2, pair, 1e3)
        add("delay of wheels", "delay_s", " ms", 1, (old.wheels.delay_s, new.wheels.delay_s), 1e3)
    if model.has_gyro:
        pair = old.gyro.bias_rad_s, new.gyro.bias_rad_s
        add("gyro bias", "gyro_bias", " °/s", 3, pair, 180 / np.pi)
    return rows


_RELATIVE = ("focal_length", "left_radius", "right_radius", "track_width")
_IN_PX = ("centre_x", "centre_y")


def self_rows(found: SelfCalibration) -> list[tuple[str, ...]]:
    """Return one row a quantity."""
    return [quantity.row for quantity in quantities_of(found)]


def summary(found: SelfCalibration) -> str:
    """Return one line about walls that the calibration did not use."""
    pairs = found.held_out_pairs
    return (
        f"surfaces seen twice agree to {1e3 * pairs.after:.1f} mm after {1e3 * pairs.before:.1f} mm, on {pairs.number} "
        "pairs of views that were not used"
    )


def notes_of(found: SelfCalibration) -> list[str]:
    """Return sentences on what stays as it is, why, and what to drive for it."""
    notes = list(found.reasons)
    if found.is_better:
        for drive, names in not_shown(found).items():
            words = ", ".join(name.removesuffix("_s").replace("_", " ") for name in names)
            notes.append(f"Not shown, and kept: {words}. To show it: {drive}.")
    notes.append("A map keeps no images between keyframes: rolling shutter and depth's delay behind colour stay.")
    return notes


def measured_self(found: SelfCalibration) -> Measured:
    """Return the history entry."""
    model, pairs = found.model, found.held_out_pairs
    taken = [name for name, is_taken in zip(model.names, found.taken, strict=True) if is_taken]
    parts = ["camera"] if any(name in model.names[: model.camera_count] for name in taken) else []
    parts += ["T_base_camera"] if {"roll", "pitch", "yaw", "x", "y", "height"} & set(taken) else []
    parts += ["wheels"] if {"left_radius", "right_radius", "track_width"} & set(taken) else []
    figures = {"views": float(found.views), "pairs": float(found.pairs)}
    figures |= {"off_before_m": pairs.before, "off_m": pairs.after}
    return Measured(f"{', '.join(parts)}, by the map {found.source}", "calibrate robot", figures)


def write_self_page(found: SelfCalibration, path: StrPath) -> None:
    """Write the page about a self-calibration, atomically. Raises OutputError."""
    pairs, steps = found.held_out_pairs, found.held_out_steps
    walls = html.plot(
        "walls",
        _walls_figure(found),
        "Walls from above",
        "Patches of walls by all keyframes, before and after. A wall that is one thin line is seen at one place from "
        "everywhere.",
        "Plans of the walls before and after calibration",
    )
    apart = html.plot(
        "apart",
        _apart_figure(found),
        "Surfaces seen twice",
        "Median distance of a surface from itself in two views, over the larger depth, on pairs that were not used.",
        "Distance of surfaces from themselves over depth, before and after",
    )
    table = html.table("Before and after", SELF_HEAD, self_rows(found))
    tiles = [
        ("Keyframes", str(found.views), f"{found.pairs} pairs of them"),
        ("Surfaces seen twice", f"{1e3 * pairs.after:.1f} mm", f"after {1e3 * pairs.before:.1f} mm, not used"),
    ]
    if steps is not None:
        tiles.append(("Motions by wheels", f"{steps.after:.2f} σ", f"after {steps.before:.2f} σ, not used"))
    ratio = pairs.before / max(pairs.after, 1e-9)
    page = html.page(
        kicker="wheelsight self-calibration",
        title=found.source,
        facts=html.facts_now("keyframes, floor, wheels and gyroscope of a drive"),
        tone="green" if found.is_better else "amber",
        phrase=f"Surfaces agree {ratio:.1f} times better" if found.is_better else "Nothing is taken",
        sentences=[f"{summary(found).capitalize()}."],
        tiles=tiles,
        notes=notes_of(found),
        sections=(
            html.section("values", "What was found", "", table),
            html.section("before-after", "What it changes", "", walls, apart),
        ),
        footer=_FOOTER,
    )
    html.save(page, path)


def _walls_figure(found: SelfCalibration) -> go.Figure:
    figure = make_subplots(rows=1, cols=2, subplot_titles=("before", "after"), shared_yaxes=True)
    drawing.style(figure, 460, hovermode=False)
    for column, (points_m, color) in enumerate(zip(found.plans_m, (ORANGE, BLUE), strict=True), start=1):
        marker = {"size": 2, "color": color}
        figure.add_scatter(
            x=points_m[:, 0], y=points_m[:, 1], mode="markers", marker=marker, showlegend=False, row=1, col=column
        )
        figure.update_xaxes(title_text="x, m", row=1, col=column, matches="x")
    figure.update_yaxes(scaleanchor="x", scaleratio=1)
    return figure


def apart_by_depth(found: SelfCalibration) -> FloatArray:
    """Return rows (K, 4): depth, median distance of held-out surfaces before and after, metres, and their number."""
    at = np.digitize(found.distances_m, _BINS_M)
    rows = list[tuple[float, ...]]()
    for k in range(1, len(_BINS_M)):
        within = at == k
        if np.count_nonzero(within) >= _FEWEST_IN_BIN:
            before, after = np.median(np.abs(found.off_m[:, within]), axis=1).tolist()
            middle = (_BINS_M[k - 1] + _BINS_M[k]) / 2
            rows.append((middle, before, after, float(np.count_nonzero(within))))
    return np.array(rows).reshape(-1, 4)


def _apart_figure(found: SelfCalibration) -> go.Figure:
    figure = drawing.style(go.Figure(), 320, hovermode="x unified")
    rows = apart_by_depth(found)
    for column, name, color in ((1, "before", ORANGE), (2, "after", BLUE)):
        points = np.stack([rows[:, 0], 1e3 * rows[:, column]], axis=-1)
        line = {"color": color, "width": 2}
        drawing.add_path(figure, points, name=name, line=line, hover="%{y:.1f} mm")
    figure.update_xaxes(title_text="depth, m")
    drawing.panel_title(figure, "median distance, mm")
    return figure
