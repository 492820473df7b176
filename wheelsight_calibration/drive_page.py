"""The result of a drive's identification: rows for a terminal, and the page with measured against predicted speeds."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np

from wheelsight.app.cli.console import console, print_warning, rows_table
from wheelsight.core.calibration import Measured
from wheelsight.core.drive_model import DriveAxis
from wheelsight.core.files import StrPath
from wheelsight_calibration.cli_results import print_end
from wheelsight_calibration.drive_fit import AxisFit, DriveFit
from wheelsight_report import drawing, html
from wheelsight_report import plotly as go
from wheelsight_report.drawing import BLUE, GREY, ORANGE
from wheelsight_report.plotly import make_subplots

Row = tuple[str, ...]
Pair = tuple[float, float]
_HEAD = ("", "straight on", "± σ", "turns", "± σ")
_WORDS = {"straight": "Straight on", "turn": "Turns"}
# Rim speeds from which the way to a standstill is stated.
_STOPS_M_S = (0.5, 1.0)


def _nothing(axis: DriveAxis) -> str:
    return ""


def drive_rows(fit: DriveFit) -> list[Row]:
    """One row a parameter, as `_HEAD` names the columns."""
    axes = (fit.model.straight, fit.model.turn)

    def row(name: str, value: Callable[[DriveAxis], str], sigma: Callable[[DriveAxis], str] = _nothing) -> Row:
        cells = [text(axis) if axis else "" for axis in axes for text in (value, sigma)]
        return (name, *cells)

    def stop_row(speed: float) -> Row:
        """Empty for an axis of which less than half of the speed was driven."""

        def of(axis: DriveAxis, seconds: float) -> str:
            return f"{speed * seconds:.2f}" if max(axis.largest_speed_m_s) >= 0.5 * speed else ""

        name = f"way to a stand from {speed:g} m/s, m"
        return row(name, lambda a: of(a, a.stop_s(0.0)), lambda a: of(a, a.stop_sigma_s))

    def each_way(
        name: str, values: Callable[[DriveAxis], Pair], sigmas: Callable[[DriveAxis], Pair | None] = lambda axis: None
    ) -> list[Row]:
        """A row for positive and a row for negative commands."""

        def one(i: int, way: str) -> Row:
            def sigma(axis: DriveAxis) -> str:
                pair = sigmas(axis)
                return "" if pair is None else f"{pair[i]:.3f}"

            return row(f"{name}, {way}", lambda axis: f"{values(axis)[i]:.3f}", sigma)

        return [one(0, "command > 0"), one(1, "command < 0")]

    def full_speed(axis: DriveAxis) -> Pair:
        return axis.speed_m_s(axis.largest_command[0]), axis.speed_m_s(-axis.largest_command[1])

    def full_sigma(axis: DriveAxis) -> Pair:
        ahead_m_s, back_m_s = full_speed(axis)
        return abs(ahead_m_s) * axis.gain_sigma[0], abs(back_m_s) * axis.gain_sigma[1]

    unit = ", m/s" if fit.model.command == "velocity" else ""
    rows = [
        row("dead time, s", lambda a: f"{a.dead_time_s:.3f}", lambda a: f"{a.dead_time_sigma_s:.3f}"),
        row("time constant, speeding up, s", lambda a: f"{a.rise_s:.3f}", lambda a: f"{a.rise_sigma_s:.3f}"),
        row("time constant, slowing down, s", lambda a: f"{a.fall_s:.3f}", lambda a: f"{a.fall_sigma_s:.3f}"),
        *each_way(f"dead zone{unit}", lambda a: a.dead_zone, lambda a: a.dead_zone_sigma),
        *each_way("full speed, m/s", full_speed, full_sigma),
        *each_way("largest command", lambda a: a.largest_command),
        *each_way("largest rim speed, m/s", lambda a: a.largest_speed_m_s),
        row("largest acceleration, m/s²", lambda a: f"{a.acceleration_m_s2:.2f}"),
        row("largest braking, m/s²", lambda a: f"{a.braking_m_s2:.2f}"),
        row("residual RMS, m/s", lambda a: f"{a.residual_m_s:.4f}"),
    ]
    rows += [stop_row(speed) for speed in _STOPS_M_S]
    found = (fit.straight, fit.turn)
    held = ["" if one is None or one.held_out_m_s is None else f"{one.held_out_m_s:.4f}" for one in found]
    rows.append(("residual RMS, held out, m/s", held[0], "", held[1], ""))
    ratio, sigma = fit.model.right_over_left, fit.model.right_over_left_sigma
    if sigma:
        rows.append(("right wheel over left", f"{ratio:.4f}", f"{sigma:.4f}", "", ""))
    return rows


def print_drive(fit: DriveFit, written: str, page: Path | None) -> None:
    """Print the model, what the drive did not show, and the paths of the files."""
    stdout = console()
    stdout.print(rows_table(f"{', '.join(fit.names)}: drive, by {fit.model.command} commands", _HEAD, drive_rows(fit)))
    for note in fit.not_shown:
        print_warning(f"not shown: {note}")
    print_end(fit.warnings, written, page)


def measured_drive(fit: DriveFit) -> Measured:
    """The history entry of a drive model."""
    figures: dict[str, float] = {}
    for name in _WORDS:
        axis: DriveAxis | None = getattr(fit.model, name)
        if axis is not None:
            figures |= {f"{name} dead_time_s": axis.dead_time_s, f"{name} fall_s": axis.fall_s}
            figures[f"{name} residual_m_s"] = axis.residual_m_s
    return Measured(f"drive_model, on {', '.join(fit.names)}", "calibrate drive", figures)


def write_drive_model_page(fit: DriveFit, path: StrPath) -> None:
    """Write the page about a drive model, atomically. Raises OutputError."""
    axes = [(name, axis) for name in _WORDS if (axis := getattr(fit, name)) is not None]
    straight = fit.model.straight
    shown = straight or fit.model.turn
    assert shown is not None
    stop = f"{shown.stop_s(0.0):.2f} m"
    tiles = [
        ("Dead time", f"{1e3 * shown.dead_time_s:.0f} ms", f"± {1e3 * shown.dead_time_sigma_s:.0f} ms"),
        ("Slowing down", f"{1e3 * shown.fall_s:.0f} ms", f"time constant, ± {1e3 * shown.fall_sigma_s:.0f} ms"),
        ("From 1 m/s to a stand", stop, f"{shown.stop_s():.2f} m at the 95 % worst"),
    ]
    sections = [html.section("model", "The model", "", html.table("Straight on and turns", _HEAD, drive_rows(fit)))]
    for name, axis in axes:
        alt = f"Measured and predicted speeds over time, {_WORDS[name].lower()}"
        sentence = "The prediction knows the commands alone; it runs free from the first sample on."
        over_time = html.plot(f"{name}-time", speed_figure(axis), "Measured and predicted", sentence, alt)
        alt = f"Speed over command, {_WORDS[name].lower()}"
        sentence = "Points are means of steps that lasted; the line is the model."
        gain = html.plot(f"{name}-gain", gain_figure(axis), "Speed over command", sentence, alt)
        held = "" if axis.held_out_m_s is None else f"{axis.held_out_m_s:.4f} m/s on steps that a fit did not use, and "
        intro = f"RMS error: {held}{axis.axis.residual_m_s:.4f} m/s on all."
        sections.append(html.section(name, _WORDS[name], intro, over_time, gain))
    errors = [axis.held_out_m_s for _, axis in axes if axis.held_out_m_s is not None]
    tone = "amber" if fit.not_shown else "green"
    page = html.page(
        kicker="wheelsight drive calibration",
        title=", ".join(fit.names),
        facts=html.facts_now(f"a lag with dead time, by {fit.model.command} commands"),
        tone=tone,
        phrase=f"It stands {stop} after a stop command at 1 m/s",
        sentences=[f"Where it was not fitted, predicted speeds err by {max(errors):.3f} m/s RMS at most."]
        if errors
        else [],
        tiles=tiles,
        notes=[*fit.warnings, *(f"Not shown: {note}." for note in fit.not_shown)],
        sections=tuple(sections),
        footer="Speeds are those of a rim in m/s; σ is one standard deviation. This page needs no network.",
    )
    html.save(page, path)


def speed_figure(fit: AxisFit) -> go.Figure:
    """Measured and free-running speeds over time, and below them the command; drives follow each other."""
    figure = make_subplots(rows=2, cols=1, shared_xaxes=True, vertical_spacing=0.12, row_heights=[0.7, 0.3])
    drawing.style(figure, 460, hovermode="x unified")
    begin_s = 0.0
    for number, (series, predicted) in enumerate(zip(fit.series, fit.predicted_m_s, strict=True)):
        stamps_s = series.stamps_s - series.stamps_s[0] + begin_s
        for name, values, color, width in (
            ("measured", series.speeds_m_s, GREY, 3),
            ("predicted", predicted, BLUE, 2),
        ):
            kept = drawing.keep_peaks(values)
            points = np.stack([stamps_s[kept], values[kept]], axis=-1)
            line = {"color": color, "width": width}
            drawing.add_path(figure, points, name=name, line=line, hover="%{y:.3f} m/s", row=1, in_legend=not number)
        ends_s = np.append(series.commands_s[1:], series.stamps_s[-1]) - series.stamps_s[0] + begin_s
        begins_s = np.append(begin_s, ends_s[:-1])
        points = np.stack([np.ravel([begins_s, ends_s], "F"), np.repeat(series.commands, 2)], axis=-1)
        line = {"color": ORANGE, "width": 2}
        drawing.add_path(figure, points, name="command", line=line, hover="%{y:.3f}", row=2, in_legend=not number)
        begin_s = float(stamps_s[-1]) + 1.0
    drawing.panel_title(figure, "speed of a rim, m/s", 1)
    drawing.panel_title(figure, "command", 2)
    drawing.time_axis_until(figure, begin_s, "seconds of all drives")
    return figure


def gain_figure(fit: AxisFit) -> go.Figure:
    """Speed over command: the model as a line, steps of over a second as points."""
    figure = drawing.style(go.Figure(), 320, hovermode="closest")
    most = max(fit.axis.largest_command)
    commands = np.linspace(-most, most, 301)
    line = np.stack([commands, [fit.axis.speed_m_s(command) for command in commands.tolist()]], axis=-1)
    drawing.add_path(figure, line, name="model", line={"color": BLUE, "width": 2}, hover="%{x:.2f}: %{y:.3f} m/s")
    points = []
    for series in fit.series:
        ends_s = np.append(series.commands_s[1:], series.stamps_s[-1])
        for command, begin_s, end_s in zip(series.commands, series.commands_s, ends_s, strict=True):
            which = (series.stamps_s > begin_s + _SETTLED_S) & (series.stamps_s < end_s) & series.is_good
            if which.any():
                points.append((command, series.speeds_m_s[which].mean()))
    x, y = np.reshape(points, (-1, 2)).T
    marker = {"size": 8, "color": ORANGE}
    figure.add_scatter(x=x, y=y, mode="markers", name="measured", marker=marker, hovertemplate="%{x:.2f}: %{y:.3f} m/s")
    figure.update_xaxes(title_text="command")
    drawing.panel_title(figure, "speed of a rim, m/s")
    return figure


# After a step, until the speed counts as that of its command.
_SETTLED_S = 1.5
