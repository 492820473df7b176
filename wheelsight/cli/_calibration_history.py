"""What calibrations are worth, as entries of a calibration file's history, and that history told."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

from wheelsight.calibration_history import Measured

if TYPE_CHECKING:
    from wheelsight.cli._calibration import Squares
    from wheelsight.odometry.extrinsics import BaseCalibration
    from wheelsight.odometry.wheels.trial import WheelTrial

HEAD = ("", "by", "what", "figures")


def measured_wheels(trial: WheelTrial) -> Measured:
    """What wheels fitted to a reference are worth, for the history."""
    before, after = (x.evaluation.ate.translation.rmse for x in (trial.before, trial.after))
    figures = {"segments": float(len(trial.fit.segments)), "ate_nominal_m": before, "ate_m": after}
    figures |= {f"sigma {name}": float(value) for name, value in trial.fit.sigmas.items()}
    return Measured(f"wheels, on {trial.recording}", "calibrate wheels", figures)


def measured_squares(squares: Squares) -> Measured:
    """The same of UMBmark."""
    before_m, after_m = squares.result.largest_error_m, squares.result.largest_error_after_m
    figures = {"side_m": squares.result.side_m, "error_nominal_m": before_m, "error_m": after_m}
    return Measured(f"wheels, by {squares.name}", "calibrate umbmark", figures)


def measured_mount(found: BaseCalibration) -> Measured:
    """The same of a camera's mount."""
    figures = {"pieces": float(len(found.fit.segments)), "views_with_floor": float(len(found.floor.tilts))}
    return Measured(f"T_base_camera, on {found.recording}", "calibrate base", figures)


def history_rows(history: Sequence[Measured]) -> list[tuple[str, ...]]:
    """A row an entry, the newest last."""
    return [
        (
            entry.date,
            entry.command,
            entry.what,
            ", ".join(f"{name} {value:.4g}" for name, value in entry.figures.items()),
        )
        for entry in history
    ]
