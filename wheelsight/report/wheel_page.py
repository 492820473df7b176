"""The page of a wheel calibration: what changed, how sure it is, and what it is worth on the part it did not use."""

from __future__ import annotations

from datetime import UTC, datetime
from html import escape
from pathlib import Path

import numpy as np

from wheelsight._version import __version__
from wheelsight.files import StrPath, write_text
from wheelsight.geometry import FloatArray
from wheelsight.odometry.wheels.trial import WheelTrial
from wheelsight.odometry.wheels.umbmark import Umbmark
from wheelsight.pipeline import words
from wheelsight.report import _html as html
from wheelsight.report import wheel_figures as figures
from wheelsight.report.page import fill_template
from wheelsight.report.wheel_tables import HEAD, error_rows, fit_rows, square_rows

_BETTER, _WORSE = 0.9, 1.1
_FOOTER = "Lengths are in metres, stamps in seconds, σ is one standard deviation. This page needs no network."


def write_wheel_page(trial: WheelTrial, path: StrPath) -> None:
    """Write the page about a calibration against a reference, atomically. Raises OutputError."""
    path = Path(path)
    phrase, tone = _verdict(trial)
    page = fill_template(
        kicker="wheelsight wheel calibration",
        title=escape(trial.recording),
        facts=_facts("least squares against a reference trajectory"),
        tone=tone,
        phrase=escape(phrase),
        sentences=escape(_sentences(trial)),
        tiles="\n".join(html.tile(*tile) for tile in _tiles(trial)),
        notes=_notes(trial),
        sections="\n".join((_wheels_section(fit_rows(trial.fit)), _proof(trial), _residuals(trial))),
        footer=escape(_FOOTER),
    )
    _write(path, page)


def write_squares_page(result: Umbmark, after_m: tuple[FloatArray, FloatArray], name: str, path: StrPath) -> None:
    """Write the page about a calibration by squares, atomically. Raises OutputError.

    `after_m` are the errors (n, 2) and (m, 2) that corrected wheels leave of clockwise and counter-clockwise runs.
    """
    path = Path(path)
    before_m, left_m = result.largest_error_m, result.largest_error_after_m
    runs = f"{len(result.clockwise_m)} clockwise and {len(result.counter_clockwise_m)} counter-clockwise"
    tiles = [
        ("E max,syst, nominal", words.length(before_m), "the worse direction's mean error"),
        ("E max,syst, corrected", words.length(left_m), "that the model leaves of these runs"),
        ("E_d", f"{result.diameter_ratio:.5f}", "right wheel over left wheel"),
        ("E_b", f"{result.track_factor:.5f}", "actual track width over nominal"),
    ]
    figure = figures.squares_figure(result, after_m)
    sentence = "Where each run truly ended, seen from where the robot believed to be; crosses are the means."
    alt = "Return position errors before and after correction"
    plot = html.plot("squares", figure, "Return position errors", sentence, alt)
    page = fill_template(
        kicker="wheelsight wheel calibration",
        title=escape(name),
        facts=_facts("UMBmark, Borenstein & Feng 1996"),
        tone="green" if left_m < _BETTER * before_m else "amber",
        phrase=escape(f"Systematic error {words.length(before_m)} before, {words.length(left_m)} after"),
        sentences=escape(
            f"From {runs} squares of {result.side_m:.3g} m. The mean wheel radius cannot be seen from it."
        ),
        tiles="\n".join(html.tile(*tile) for tile in tiles),
        notes="",
        sections="\n".join((_wheels_section(square_rows(result)), html.section("runs", "The runs", "", plot))),
        footer=escape(_FOOTER),
    )
    _write(path, page)


def _write(path: Path, page: str) -> None:
    # A folder's name may hold bytes that are no text; they must not cost the page.
    write_text(path, page.encode("utf-8", "replace").decode("utf-8"))


def _facts(method: str) -> str:
    when = datetime.now(UTC).strftime("%Y-%m-%d %H:%M UTC")
    return " · ".join(escape(fact) for fact in (method, when, f"wheelsight {__version__}"))


def _verdict(trial: WheelTrial) -> tuple[str, str]:
    path, drift = _changes(trial)
    if path < _BETTER and drift < _WORSE:
        return f"{1 / path:.1f} times nearer to the reference where it was not fitted", "green"
    if path > _WORSE and drift > _BETTER:
        return "No better than the nominal wheels where it was not fitted", "red"
    return "Little changes where it was not fitted", "amber"


def _changes(trial: WheelTrial) -> tuple[float, float]:
    """Error after over error before: of the whole path, and of a metre of it."""
    before, after = trial.before.evaluation, trial.after.evaluation
    path = after.ate.translation.rmse / max(before.ate.translation.rmse, 1e-9)
    if before.rpe_per_metre is None or after.rpe_per_metre is None:
        return path, path
    return path, after.rpe_per_metre.translation.rmse / max(before.rpe_per_metre.translation.rmse, 1e-9)


def _sentences(trial: WheelTrial) -> str:
    before, after = trial.before.evaluation, trial.after.evaluation
    ate = (words.length(evaluation.ate.translation.rmse) for evaluation in (after, before))
    length = words.length(trial.held_out.length_m)
    text = "Over the {} that the fit did not see, the path's error (ATE) is {} after {}".format(length, *ate)
    old, new = before.rpe_per_metre, after.rpe_per_metre
    if old is None or new is None:
        return text + "."
    turns = (words.angle(error.rotation.in_degrees().rmse) for error in (new, old))
    return text + ", and heading drifts by {} a metre after {}.".format(*turns)


def _tiles(trial: WheelTrial) -> list[tuple[str, str, str]]:
    fit, before, after = trial.fit, trial.before, trial.after
    tiles = [_tile("ATE, RMSE", *(x.evaluation.ate.translation.rmse for x in (before, after)))]
    old, new = before.evaluation.rpe_per_metre, after.evaluation.rpe_per_metre
    if old is not None and new is not None:
        tiles.append(_tile("RPE a metre, RMSE", old.translation.rmse, new.translation.rmse))
    slips = words.count(int(fit.is_slip.sum()), "of them a slip or jump", "of them slips or jumps")
    along, _, turn = fit.spread
    return [
        *tiles,
        _tile("Off at the end", before.end_error_m, after.end_error_m),
        ("Segments fitted", str(len(fit.segments)), slips),
        ("Left in a segment", words.length(float(along)), f"and {words.angle(float(np.degrees(turn)))}; median spread"),
    ]


def _tile(name: str, before: float, after: float) -> tuple[str, str, str]:
    return name, words.length(after), f"nominal wheels {words.length(before)}"


def _notes(trial: WheelTrial) -> str:
    x_m, y_m, yaw_rad = trial.fit.mount.tolist()
    ahead, aside, turned = ("ahead", "behind")[x_m < 0], ("left", "right")[y_m < 0], ("left", "right")[yaw_rad < 0]
    mount = (
        f"By the fit, what the reference follows sits {words.length(abs(x_m))} {ahead} and {words.length(abs(y_m))} "
        f"{aside} of the axle's middle and looks {words.angle(abs(np.degrees(yaw_rad)))} to the {turned}; "
        "the comparison allows for that."
    )
    found = [*trial.warnings, mount, "All errors hold the reference's own, and those of slips."]
    return html.section("notes", "What to know before trusting it", "", html.bullets(found, "notes"))


def _wheels_section(rows: list[tuple[str, ...]]) -> str:
    return html.section("wheels", "The wheels", "", html.table("Before and after", HEAD, rows))


def _proof(trial: WheelTrial) -> str:
    before_s = trial.split_s - trial.reference.stamps_s[0]
    intro = f"Fitted on the {words.duration(float(before_s))} before; what follows was not used."
    errors = html.table("Errors against the reference, RMSE", ("", "nominal", "calibrated"), error_rows(trial))
    drive = html.plot(
        "drive",
        figures.drive_figure(trial),
        "From above",
        "Both paths begin on the reference; nothing corrects them afterwards.",
        "Reference path with the dead-reckoned paths of nominal and calibrated wheels",
    )
    drift = html.plot(
        "drift",
        figures.drift_figure(trial),
        "Drift",
        "How far each path is from the reference as the robot drives on.",
        "Distance from the reference over distance gone",
    )
    return html.section("proof", "On the part it did not use", intro, errors, drive, drift)


def _residuals(trial: WheelTrial) -> str:
    plot = html.plot(
        "residuals",
        figures.residual_figure(trial),
        "Residuals",
        "Wheels minus reference over each segment; slips, or jumps of the reference, may lie at the edge.",
        "Residuals of the segments over time, along, across and in turn",
    )
    return html.section("segments", "On the part it was fitted to", "", plot)
