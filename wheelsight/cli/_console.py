"""How the commands speak: tables on stdout, errors and progress on stderr, plain text where nobody watches."""

from __future__ import annotations

import codecs
import errno
import io
import json
import math
import sys
from collections.abc import Iterable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from rich.console import Console
    from rich.table import Table


@dataclass
class Quiet:
    """Whether -q was given."""

    on: bool = False


QUIET = Quiet()
INPUT_IS_WRONG = 2
_STDERR = 2
_WIDTH_OF_FILES = 200
_LETTERS = "wheelsight-letters"


# Signs that encodings such as cp1252 lack, in letters that all have; others become a question mark.
_IN_LETTERS = {"σ": "sigma", "α": "alpha", "β": "beta", "γ": "gamma", "≥": ">=", "≤": "<=", "−": "-", "→": "->"}
_IN_LETTERS |= {"×": "x", "°": " deg", "µ": "u", "±": "+-", "·": "-", "…": "...", "✓": "ok", "²": "2", "³": "3"}


def _speak_any_encoding() -> None:
    """Signs that the encoding of stdout and stderr lacks are written in letters."""
    codecs.register_error(_LETTERS, _told_in_letters)
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper) and stream.errors in ("strict", "backslashreplace"):
            stream.reconfigure(errors=_LETTERS)


def _told_in_letters(error: UnicodeError) -> tuple[str, int]:
    if not isinstance(error, UnicodeEncodeError):
        raise error
    missing = error.object[error.start : error.end]
    return "".join(_IN_LETTERS.get(sign, "?") for sign in missing), error.end


class _Loseable(io.FileIO):
    """Drops what it can no longer write: whoever closes a terminal must not break off what its program still does.

    A reader of stderr may go too. One of stdout, such as `head`, ends the program as ever.
    """

    def write(self, data: Any, /) -> int:
        try:
            return super().write(data)
        except OSError as error:
            if error.errno != errno.EIO and not (error.errno == errno.EPIPE and self.fileno() == _STDERR):
                raise
            return memoryview(data).nbytes


def prepare_streams() -> None:
    """From now on stdout and stderr take any text, and go on without their terminal once that is closed."""
    _speak_any_encoding()
    for name in ("stdout", "stderr"):
        stream = getattr(sys, name)
        if sys.platform == "win32" or not isinstance(stream, io.TextIOWrapper):
            continue  # on Windows a console that is closed ends its programs
        stream.flush()
        raw = _Loseable(stream.fileno(), "wb", closefd=False)
        buffer: Any = raw if stream.write_through else io.BufferedWriter(raw)
        how: dict[str, Any] = {"line_buffering": stream.line_buffering, "write_through": stream.write_through}
        setattr(sys, name, io.TextIOWrapper(buffer, stream.encoding, stream.errors, **how))


def console(stderr: bool = False) -> Console:
    """A console for stdout or stderr; made anew each time, since either may have been redirected."""
    from rich.console import Console

    # No markup: what people name their folders, recordings and areas may look like it.
    made = Console(stderr=stderr, highlight=False, markup=False, soft_wrap=True)
    if not made.is_terminal:
        made.width = max(made.width, _WIDTH_OF_FILES)
    return made


def print_error(message: str) -> None:
    """Print "error: message" on stderr, on one line however narrow the terminal."""
    _print_labelled("error", "bold red", message)


def print_warning(message: str) -> None:
    """Print "warning: message" on stderr, on one line however narrow the terminal."""
    _print_labelled("warning", "yellow", message)


def print_note(message: str) -> None:
    """Print a message about the work itself on stderr, unless -q was given."""
    if QUIET.on:
        return
    console(stderr=True).print(message, markup=False)


def print_json(document: Any) -> None:
    """Print nested values as JSON on stdout; numbers that JSON lacks (NaN) become null."""
    import typer

    typer.echo(json.dumps(_without_nan(document), indent=2, allow_nan=False))


def facts_table(title: str, facts: Iterable[tuple[str, str]]) -> Table:
    """A borderless table of names and values under a title."""
    from rich.table import Table
    from rich.text import Text

    table = Table(
        title=Text(title, style="bold"), title_justify="left", box=None, show_header=False, padding=(0, 2, 0, 0)
    )
    table.add_column(style="cyan", no_wrap=True)
    table.add_column(overflow="fold")
    for name, value in facts:
        table.add_row(name, Text(value))
    return table


def percent(share: float) -> str:
    """A share as a percentage that says 100 only when it is all; "unknown" for NaN."""
    if not math.isfinite(share):
        return "unknown"
    return "100 %" if share == 1 else f"{min(100 * share, 99.9):.1f} %"


def _print_labelled(label: str, style: str, message: str) -> None:
    from rich.text import Text

    console(stderr=True).print(Text.assemble((f"{label}: ", style), message))


def _without_nan(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _without_nan(inner) for key, inner in value.items()}
    if isinstance(value, list | tuple):
        return [_without_nan(inner) for inner in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value
