"""The options that commands of calibration share, and what of FILE they keep and write."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from wheelsight.app.cli.options import can_draw, open_source, settings_from

if TYPE_CHECKING:
    from wheelsight.core.calibration import Calibration, Measured
    from wheelsight.core.calibration_parts import Wheels
    from wheelsight.io.recordings import Recording

Out = Annotated[
    Path,
    typer.Option(metavar="FILE", help="calibration.yaml to write; a page about it goes beside it.", show_default=False),
]
Force = Annotated[bool, typer.Option("--force", help="Overwrite FILE and its page; other parts of FILE stay.")]


def open_for(
    folder: Path, calibration: Sequence[str] | None, topics: Sequence[str] | None, rate_hz: float | None = None
) -> Recording:
    """The recording, with what `--calibration` says in place of its own; topics and stamps as the options say."""
    options = {"recording.calibration": calibration, "recording.rate_hz": rate_hz, "recording.topics": topics}
    return open_source(folder, settings_from(options))


def page_beside(out: Path, force: bool) -> Path | None:
    """Path of the page, or None if none can be drawn. Call it before any work.

    Raises:
        OutputError: it or `out` cannot or must not be written.
    """
    from wheelsight.core.errors import OutputError
    from wheelsight.core.files import check_name, make_output_folder

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
    return page if can_draw() else None


def kept_in(out: Path, calibration: Sequence[str] | None) -> dict[str, Any]:
    """What FILE is to hold besides what will be found: all that is in it, and over that what `--calibration` gave.

    Raises CalibrationError, before any work, for a FILE that is a calibration but a wrong one, or larger than any:
    nothing is lost unasked.
    """
    from wheelsight.core.calibration import FORMAT, laid_over, read_layer
    from wheelsight.core.errors import CalibrationError
    from wheelsight.core.inputs import YAML_FILE, read_bytes

    kept: dict[str, Any] = {}
    if out.is_file() and FORMAT.encode() in read_bytes(out, YAML_FILE, CalibrationError):
        kept = read_layer(out)
    for path in calibration or ():
        kept = laid_over(kept, read_layer(Path(path)))
    return kept


def save_found(
    found: Mapping[str, Any], kept: Mapping[str, Any], nominal: Calibration, source: str, out: Path, entry: Measured
) -> str:
    """Write found values over kept ones, and below them the wheels as they were known. Print FILE and what it keeps.

    `entry` goes to the end of the file's history.

    So FILE is enough for a recording that has no calibration of its own, and loses nothing of one that has.
    """
    from wheelsight.core.calibration import (
        FORMAT,
        HISTORY,
        NOMINAL,
        NOMINAL_PARTS,
        calibration_fields,
        laid_over,
        save_layer,
    )

    history = {HISTORY: [entry.as_field()]}
    document = laid_over(kept, {"format": FORMAT, "source": source, **found, **history})
    known = {name: part for name, part in calibration_fields(nominal).items() if name in NOMINAL_PARTS}
    if any(name not in document.get(part, ()) for part in known for name in known[part]):
        document[NOMINAL] = known
    save_layer(document, out)
    left = [word for word, name in _PARTS.items() if name in kept and name not in found]
    return f"{out} (kept in it: {', '.join(left)})" if left else str(out)


def wheel_fields(wheels: Wheels, *, delay: bool) -> dict[str, Any]:
    """What a calibration of wheels finds of them, and the ticks a turn that its radii go with."""
    from wheelsight.core.calibration_parts import WHEEL_SIGMAS

    names = ("left_radius_m", "right_radius_m", "track_width_m", "ticks_per_turn", *(["delay_s"] if delay else []))
    stated = [name for name in WHEEL_SIGMAS if getattr(wheels, name)]
    return {"wheels": {name: float(getattr(wheels, name)) for name in (*names, *stated)}}


_PARTS = {"cameras": "color", "mount": "T_base_camera", "wheels": "wheels", "gyro": "gyro", "drive": "drive_model"}
