"""The work behind `wheelsight calibrate camera`: views read, cameras calibrated, the file and its page written."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

from wheelsight.cli._calibration_files import kept_in, page_beside, save_found

if TYPE_CHECKING:
    from wheelsight.camera_calibration.board import Board
    from wheelsight.camera_calibration.result import CameraCalibration
    from wheelsight.camera_calibration.settings import CameraCalibrationSettings
    from wheelsight.camera_calibration.task import CameraSetup

_MOST_LEFT_OUT = 12


@dataclass(frozen=True, slots=True)
class CameraTask:
    """What is to be calibrated, and where the result goes, as the options say."""

    board: Board
    out: Path
    setup: CameraSetup
    depth_factor: float
    calibration: list[str] | None
    settings: CameraCalibrationSettings
    force: bool

    def check(self) -> None:
        """Refuse, before any work, what could not be written. Raises OutputError, CalibrationError."""
        page_beside(self.out, self.force)
        kept_in(self.out, self.calibration)

    def calibrate(self, folders: Sequence[Path]) -> None:
        """Read views, calibrate by them, and write FILE and its page.

        Raises RecordingError, and CalibrationError where the views do not determine it.
        """
        from wheelsight.calibration import Calibration
        from wheelsight.camera_calibration.calibrate import calibrate_camera
        from wheelsight.camera_calibration.fields import camera_fields, measured
        from wheelsight.camera_calibration.folders import find_view_files, read_views
        from wheelsight.cli._calibration import show_steps
        from wheelsight.cli._progress import FrameProgress
        from wheelsight.report.camera_page import write_camera_page

        page, kept = page_beside(self.out, self.force), kept_in(self.out, self.calibration)
        with FrameProgress("searching boards", len(find_view_files(folders))) as progress:
            seen = read_views(folders, self.board, self.settings.detection, self.depth_factor, progress.advance)
        with show_steps() as on_step:
            found = calibrate_camera(seen, self.board, self.setup, self.settings, on_step)
        source = f"cameras calibrated by {len(found.views)} views of {found.board}"
        document = camera_fields(found, self.setup.nominal)
        written = save_found(document, kept, Calibration(), source, self.out, measured("camera", found))
        if page is not None:
            write_camera_page(found, page)
        _print(found, written, page)

    def by_folders(self, folders: Sequence[Path]) -> None:
        """The same, by the cameras of `--calibration` to begin with."""
        from wheelsight.calibration import load_calibration

        nominal = load_calibration(*self.calibration) if self.calibration else None
        replace(self, setup=replace(self.setup, nominal=nominal)).calibrate(folders)


def _print(found: CameraCalibration, written: str, page: Path | None) -> None:
    from wheelsight.cli._calibration import print_end, table
    from wheelsight.cli._console import console, print_warning
    from wheelsight.report.camera_tables import HEAD, distance_rows, lens_rows

    stdout = console()
    for name, reason in found.left_out[:_MOST_LEFT_OUT]:
        print_warning(f"{name} is left out: {reason}")
    if len(found.left_out) > _MOST_LEFT_OUT:
        print_warning(f"and {len(found.left_out) - _MOST_LEFT_OUT} more")
    stdout.print(table(f"cameras, by {len(found.views)} views of {found.board}", HEAD, lens_rows(found)))
    if len(found.depth_residuals.off_m):
        head = ("distance", "off before", "off after", "scatter", "σ of depth")
        stdout.print(table("depth on the boards' planes", head, distance_rows(found)))
    print_end(found.warnings, written, page)
