"""One drive with faults, from above: wheels, camera, the paper's filter and the default filter against the truth."""

from __future__ import annotations

import io
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.collections import PolyCollection
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patheffects import withStroke

from benchmarks.joined_cases import RATE_HZ, SIZE, recorded_along, robot_of
from benchmarks.joined_figures import Accuracy, accuracy_of
from benchmarks.joined_images import kept_events
from benchmarks.joined_runs import CAMERA, JOINED, PAPER, WHEELS, Answers, run_all
from wheelsight.core.files import write_bytes
from wheelsight.core.geometry import FloatArray, se3
from wheelsight_sim import SimulatedRecording, SimulationSettings, WheelFaults, World
from wheelsight_sim.clearance import footprints
from wheelsight_sim.faults import Covered, events_with

_SEED = 3
# Up one corridor, along another, and into the kitchen and hall of `floor4`.
_ROUTE = np.array([(4.0, 1.4), (1.2, 1.4), (1.2, 15.9), (21.8, 15.9), (21.8, 20.6), (33.0, 20.6)])
_SPEED_M_S, _DURATION_S = 0.5, 105.0
_COVERED_S, _LIFTED_S = (18.0, 23.0), (52.0, 55.0)
_COLOURS = {WHEELS: "#e08a1e", CAMERA: "#2f7fd1", PAPER: "#9a5fb8", JOINED: "#0b8f63"}
_WORDS = {
    WHEELS: "wheels alone",
    CAMERA: "camera alone",
    PAPER: "joined as in Ligocki's paper",
    JOINED: "joined by wheelsight",
}
_TRUTH, _INK, _WALL, _THING, _FAULT = "#1d2129", "#262b33", "#aab0b9", "#e4e2dc", "#d8453b"
_EYE_M, _THIN_M = 1.9, 0.05
_MARGIN_M, _BAR_M = 1.5, 5.0
_COVERAGE = 0.9
_LEGEND_INCHES = 1.0
_INCHES, _DOTS_PER_INCH = 10.0, 150


@dataclass(frozen=True, slots=True)
class _Fault:
    """Words beside the part of the way on which something went wrong."""

    words: str
    begin_s: float
    end_s: float
    aside_m: tuple[float, float]


_FAULTS = (
    _Fault("camera covered, 5 s", *_COVERED_S, (1.5, 0.0)),
    _Fault("a wheel lifted, 3 s", *_LIFTED_S, (0.0, -2.2)),
)


def picture_drive() -> SimulatedRecording:
    """Half a lap of `floor4`, on which the left wheel is lifted for 3 s."""
    settings = SimulationSettings("floor4", size=SIZE, rate_hz=RATE_HZ, seed=_SEED, robot=robot_of(_SEED))
    settings = replace(settings, speed_m_s=_SPEED_M_S, duration_s=_DURATION_S, realism="real")
    return recorded_along(_ROUTE, replace(settings, faults=WheelFaults(lifted_s=(_LIFTED_S,))))


def draw_joined(path: Path, odometry: str = "dense", images: Path | None = None) -> dict[str, Answers]:
    """Drive, run all four, and write the picture (PNG); answers what they said.

    Args:
        path: of the picture.
        odometry: the camera's.
        images: a folder that keeps rendered images, or None.
    """
    recording = picture_drive()
    events = recording.events() if images is None else kept_events(recording, images)
    covered = Covered(begin_s=_COVERED_S[0], end_s=_COVERED_S[1])
    answers = run_all(events_with([covered], events), recording.calibration, odometry)
    write_bytes(path, _picture(recording, answers))
    return answers


def _picture(recording: SimulatedRecording, answers: Mapping[str, Answers]) -> bytes:
    truth = recording.ground_truth
    reported = {name: _in_world(answers[name], truth.T_frame_body[0]) for name in _COLOURS}
    low, high = _window(recording.world, reported)
    size = (high - low) * _INCHES / (high - low)[0]
    figure = Figure(figsize=(size[0], size[1] + _LEGEND_INCHES), dpi=_DOTS_PER_INCH, facecolor="white")
    FigureCanvasAgg(figure)
    axes = figure.add_axes((0, 1 - size[1] / (size[1] + _LEGEND_INCHES), 1, size[1] / (size[1] + _LEGEND_INCHES)))
    axes.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), aspect="equal")
    axes.set_axis_off()
    _draw_world(axes, recording.world)
    for fault in _FAULTS:
        _draw_fault(axes, fault, truth.between(fault.begin_s, fault.end_s).positions_m)
    axes.plot(*truth.positions_m[:, :2].T, color=_TRUTH, lw=4.5, alpha=0.30, zorder=5, solid_capstyle="round")
    for name, xy in reported.items():
        axes.plot(*xy.T, color=_COLOURS[name], lw=2.2 if name == JOINED else 1.6, zorder=8 if name == JOINED else 7)
    _draw_ends(axes, reported, truth.positions_m)
    _draw_bar(axes, low, high)
    lines = [Line2D([], [], color=_TRUTH, lw=4.5, alpha=0.30, label=f"truth, {truth.length_m:.0f} m")]
    lines += [_line(name, accuracy_of(answers[name], truth)) for name in _COLOURS]
    figure.legend(handles=lines, loc="lower center", ncols=2, frameon=False, fontsize=10, labelcolor=_INK)
    return _png(figure)


def _line(name: str, accuracy: Accuracy) -> Line2D:
    rmse_m, reported = accuracy.rmse_m, " of its few poses" if accuracy.coverage < _COVERAGE else ""
    return Line2D([], [], color=_COLOURS[name], lw=2.4, label=f"{_WORDS[name]}, {rmse_m:.2f} m off (RMSE{reported})")


def _in_world(answers: Answers, T_odom_start: FloatArray) -> FloatArray:
    """Positions (N, 2) in the simulation's world, the first pose laid upon the truth; gaps are NaN."""
    nothing = np.full((4, 4), np.nan)
    T = np.array([nothing if e.T_filter_body is None else e.T_filter_body for e in answers.estimates])
    first = T[np.flatnonzero(~np.isnan(T[:, 0, 0]))[0]]
    return np.asarray((T_odom_start @ se3.invert(first) @ T)[:, :2, 3])


def _window(world: World, reported: Mapping[str, FloatArray]) -> tuple[FloatArray, FloatArray]:
    """Corners (2,) of what the picture shows: the world, and all that was reported."""
    xy = np.concatenate([*reported.values(), np.reshape(world.size_m, (2, 2))])
    low, high = np.nanmin(xy, axis=0), np.nanmax(xy, axis=0)
    return low - _MARGIN_M, high + _MARGIN_M


def _draw_world(axes: Axes, world: World) -> None:
    """Walls and furniture, pale."""
    for name, colour, order in (("wall_", _WALL, 3), ("", _THING, 2)):
        outlines = [
            np.asarray(thing.polygon.exterior.coords)
            for thing in footprints(world)
            if thing.bottom_m < _EYE_M and thing.top_m > _THIN_M
            if thing.is_solid and thing.name.startswith("wall_") == bool(name)
        ]
        axes.add_collection(
            PolyCollection(outlines, facecolors=colour, edgecolors=colour, linewidths=0.5, zorder=order)
        )


def _draw_fault(axes: Axes, fault: _Fault, positions_m: FloatArray) -> None:
    """A broad band along the way, and what it means."""
    axes.plot(*positions_m[:, :2].T, color=_FAULT, lw=16, alpha=0.22, zorder=4, solid_capstyle="round")
    middle = positions_m[len(positions_m) // 2, :2]
    _write(axes, middle + np.array(fault.aside_m), fault.words, _FAULT, "left" if fault.aside_m[0] > 0 else "center")


def _write(axes: Axes, place: FloatArray, words: str, colour: str, align: str) -> None:
    halo = [withStroke(linewidth=3, foreground="white")]
    x, y = place.tolist()
    axes.text(x, y, words, color=colour, fontsize=10, ha=align, va="center", zorder=10, path_effects=halo)


def _draw_ends(axes: Axes, reported: Mapping[str, FloatArray], positions_m: FloatArray) -> None:
    """Where the drive began, and where each takes itself to have ended; a cross where the camera had no pose more."""
    axes.plot(*positions_m[0, :2], "o", ms=9, mfc="white", mec=_TRUTH, mew=1.8, zorder=9)
    for name, xy in reported.items():
        known = np.flatnonzero(~np.isnan(xy[:, 0]))
        is_lost = known[-1] < 0.98 * len(xy)
        end, marker, size = xy[known[-1]], "X" if is_lost else "o", 10 if is_lost else 7
        axes.plot(*end, marker=marker, ms=size, color=_COLOURS[name], mec="white", mew=1.0, ls="", zorder=9)
        if is_lost:
            _write(axes, end + (0.7, 0.0), "lost", _COLOURS[name], "left")


def _draw_bar(axes: Axes, low: FloatArray, high: FloatArray) -> None:
    x, y = high[0] - _MARGIN_M - _BAR_M, low[1] + 0.5 * _MARGIN_M
    axes.plot([x, x + _BAR_M], [y, y], color=_INK, lw=3, solid_capstyle="butt", zorder=10)
    axes.text(x + _BAR_M / 2, y + 0.25, f"{_BAR_M:g} m", color=_INK, fontsize=10, ha="center", va="bottom", zorder=10)


def _png(figure: Figure) -> bytes:
    stream = io.BytesIO()
    figure.savefig(stream, format="png", metadata={"Software": None})
    return stream.getvalue()
