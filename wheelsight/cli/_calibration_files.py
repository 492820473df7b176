"""What the commands of `wheelsight calibrate` read and write: options, the recording, FILE and the page beside it."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from wheelsight.cli._options import settings_from

if TYPE_CHECKING:
    from wheelsight.recordings import Recording

Out = Annotated[
    Path,
    typer.Option(metavar="FILE", help="calibration.yaml to write; a page about it goes beside it.", show_default=False),
]
Force = Annotated[bool, typer.Option("--force", help="Overwrite FILE and its page.")]


def open_for(folder: Path, calibration: str | None) -> Recording:
    """The recording, with what `--calibration` says in place of its own."""
    from wheelsight.recordings import open_recording

    return open_recording(folder, settings_from({"--calibration": calibration}).recording.open_options())


def page_beside(out: Path, force: bool) -> Path:
    """Where the page goes; raises OutputError, before any work, where it or `out` cannot or must not be written."""
    from wheelsight.errors import OutputError
    from wheelsight.files import check_name, make_output_folder

    page = out.with_suffix(".html") if out.name else out / "page.html"  # of a folder, which is refused below
    if page == out:
        raise OutputError("is the name of the page, not of a calibration", path=out, fix="end it with .yaml")
    for path in (out, page):
        check_name(path)
        if path.is_dir():
            raise OutputError("is a folder, not a file", path=path, fix="choose another --out")
        if path.exists() and not force:
            raise OutputError("is there already", path=path, fix="choose another --out, or add --force to overwrite")
    make_output_folder(out.parent, force=True)
    return page
