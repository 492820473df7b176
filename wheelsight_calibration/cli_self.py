"""`wheelsight calibrate robot FILE --from`: calibrates a robot by the map of a drive, and writes its file if asked."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import typer

from wheelsight.app.cli.console import console, print_warning, rows_table
from wheelsight.app.cli.progress import FrameProgress
from wheelsight.core.calibration import Calibration, calibration_fields, history_of, load_calibration, read_layer
from wheelsight.core.errors import CalibrationError
from wheelsight.core.inputs import is_there
from wheelsight.slam.maps import MapFolder, find_map
from wheelsight_calibration.cli_options import kept_in, page_beside, save_found
from wheelsight_calibration.self_calibration import SelfCalibration, calibrate_self
from wheelsight_calibration.self_page import SELF_HEAD, measured_self, notes_of, self_rows, summary, write_self_page

_PARTS = {
    "camera": ("color", "depth", "T_color_depth", "depth_error", "point_errors", "depth_noise"),
    "mount": ("T_base_camera",),
    "wheels": ("wheels",),
}


def calibrate_from(
    file: Path, source: Path, *, wheels: Path | None, out: Path | None, force: bool, sensor: str | None
) -> None:
    """Calibrate by a map, print the result, and write it into `out`, or into `file` if forced or not there yet.

    Raises:
        CalibrationError: `file` has other values than the map was made with, or the drive does not suffice.
        OutputError: the file to write is there already.
        typer.Exit: code 1 where nothing is better.
    """
    target = out if out is not None else file if force or not is_there(file) else None
    page = page_beside(target, force) if target is not None else None
    known = read_layer(file) if is_there(file) else {}
    made_with = MapFolder.open(find_map(source)).calibration
    if known:
        refuse_if_other(load_calibration(file, under=made_with), made_with, file)
    is_measured = any("T_base_camera" in entry.what for entry in history_of(known))
    with FrameProgress("calibrating", None, unit="") as progress:

        def on_step(what: str, done: int, total: int) -> None:
            progress.reach(done, total, what)

        found = calibrate_self(source, wheels=wheels, is_mount_measured=is_measured, sensor=sensor, on_step=on_step)
    print_self(found)
    if not found.is_better:
        raise typer.Exit(1)
    stdout = console()
    if target is None:
        text = f"{file} is as it was. Use what was found: wheelsight calibrate robot {file} --from {source} --force"
        stdout.print(text, markup=False)
        return
    kept = kept_in(target, [str(file)] if known and target != file else None)
    title = f"self-calibrated by {source}"
    written = save_found(fields_of(found), kept, found.model.calibration, title, target, measured_self(found))
    stdout.print(f"calibration: {written}", markup=False)
    if page is not None:
        write_self_page(found, page)
        stdout.print(f"page: {page}", markup=False)


def print_self(found: SelfCalibration) -> None:
    """Print the table before and after, what is kept, and why."""
    stdout = console()
    stdout.print(rows_table(f"{found.source}: the robot by its own drive", SELF_HEAD, self_rows(found)))
    stdout.print(summary(found), markup=False)
    if not found.is_better:
        print_warning("nothing is taken, and nothing is written")
    for note in notes_of(found):
        stdout.print(note, markup=False)


def fields_of(found: SelfCalibration) -> dict[str, Any]:
    """Return the fields of the file that the calibration concerns."""
    fields = calibration_fields(found.calibration)
    names = {"color", "depth", "T_color_depth", "depth_error", "point_errors", "depth_noise", "rolling_shutter_s"}
    names |= {"color_sigma_px", "depth_late_s", "frame_sigma_m", "frame_sigma_rad"}
    names |= {"T_base_camera"} if found.model.has_mount else set()
    names |= {"wheels"} if found.model.has_wheels else set()
    names |= {"gyro"} if found.model.has_gyro else set()
    return {name: value for name, value in fields.items() if name in names}


def refuse_if_other(ours: Calibration, made_with: Calibration, file: Path) -> None:
    """Raise CalibrationError if the map was made with other values than the robot's file has."""
    mine, theirs = calibration_fields(ours), calibration_fields(made_with)
    for word, names in _PARTS.items():
        for name in names:
            if not _is_same(mine.get(name), theirs.get(name)):
                raise CalibrationError(
                    f"has another {word} ({name}) than the map was made with",
                    path=file,
                    fix="give the file that the drive had, or drive with this one first",
                )


def _is_same(a: Any, b: Any) -> bool:
    if isinstance(a, dict) and isinstance(b, dict):
        return a.keys() == b.keys() and all(_is_same(a[name], b[name]) for name in a)
    if a is None or b is None:
        return a is b
    return np.shape(a) == np.shape(b) and bool(
        np.allclose(np.array(a, float), np.array(b, float), rtol=1e-6, atol=1e-9)
    )
