"""`wheelsight board`: a board to calibrate cameras by, for a printer."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer


def board(
    out: Annotated[Path, typer.Option(metavar="FILE", help="FILE.pdf or FILE.svg to write.", show_default=False)],
    board: Annotated[
        str,
        typer.Option(
            metavar="BOARD",
            help="9x6:25mm: inner corners and side of a square; charuco:9x6:28mm: squares and side, "
            "then :MARKER:DICTIONARY if need be.",
        ),
    ] = "9x6:25mm",
    paper: Annotated[str, typer.Option(metavar="PAPER", help="A4, A3, A2 or Letter.")] = "A4",
    force: Annotated[bool, typer.Option("--force", help="Overwrite FILE.")] = False,
) -> None:
    """Draw a checkerboard or a ChArUco board in true size, for wheelsight calibrate camera.

    Print it without scaling, measure the line below it, and glue it to something flat: glass, or a board of wood.
    Depth is measured on what it is glued to as well: let that be larger than the paper, and matt.

    [bold]Examples[/bold]

    wheelsight board --out board.pdf

    wheelsight board --board charuco:11x8:33mm --paper A3 --out charuco.pdf
    """
    from wheelsight.camera_calibration.board import board_from
    from wheelsight.camera_calibration.printing import as_pdf, as_svg, draw_board
    from wheelsight.cli._console import console
    from wheelsight.cli._outputs import check_out
    from wheelsight.errors import OutputError
    from wheelsight.files import write_bytes

    kind = out.suffix.lower()
    if kind not in (".pdf", ".svg"):
        raise OutputError("is neither a .pdf nor a .svg", path=out, fix="end --out with .pdf")
    check_out(out, force)
    wanted = board_from(board)
    sheet = draw_board(wanted, paper)
    write_bytes(out, as_pdf(sheet) if kind == ".pdf" else as_svg(sheet).encode())
    console().print(f"board: {out}", markup=False)
    console().print(f"then: wheelsight calibrate camera VIEWS --board {wanted} --out robot.yaml", markup=False)
