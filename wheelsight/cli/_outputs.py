"""Places for outputs."""

from __future__ import annotations

from pathlib import Path


def can_draw() -> bool:
    """Whether a page can be drawn; warns where it cannot, and all but the page will be written."""
    from wheelsight.cli._console import print_warning
    from wheelsight.report import why_no_page

    why = why_no_page()
    if why is not None:
        print_warning(f"no page is drawn: {why}")
    return why is None


def check_out(out: Path, force: bool | None, option: str = "--out") -> None:
    """Raises OutputError, before any work, where `out` cannot or must not be written.

    `force` is None where the command has none; `option` is what names the file.
    """
    from wheelsight.errors import OutputError
    from wheelsight.files import check_name, make_output_folder

    check_name(out)
    if out.is_dir():
        raise OutputError("is a folder, not a file", path=out, fix=f"choose another {option}")
    if out.exists() and not force:
        fix = f"choose another {option}" + ("" if force is None else ", or add --force to overwrite")
        raise OutputError("is there already", path=out, fix=fix)
    make_output_folder(out.parent, force=True)


def check_rerun(target: str | None, force: bool | None = None) -> None:
    """Raises ConfigError, before any work, where Rerun is asked for and missing; of a file as `check_out`."""
    from wheelsight.extras import needed

    if target is None:
        return
    needed("rerun")
    from wheelsight.viewer import is_file

    if is_file(target):
        check_out(Path(target), force, "--rerun")
