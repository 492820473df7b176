"""Output of the commands: tables on stdout, errors and progress on stderr, log, and help. Plain text where nothing
watches.
"""

from __future__ import annotations

import codecs
import errno
import inspect
import io
import json
import logging
import math
import re
import sys
import threading
import time
from collections.abc import Callable, Iterable, Sequence
from contextlib import suppress
from dataclasses import dataclass, fields
from functools import cache
from typing import TYPE_CHECKING, Annotated, Any, Self, TypeVar, get_type_hints

import typer
import typer.core

from wheelsight.core.errors import OutputError

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


def _in_letters(error: UnicodeError) -> tuple[str, int]:
    if not isinstance(error, UnicodeEncodeError):
        raise error
    missing = error.object[error.start : error.end]
    return "".join(_IN_LETTERS.get(sign, "?") for sign in missing), error.end


class _Loseable(io.FileIO):
    """A stream that drops what it cannot write: a closed terminal must not stop the program.

    The reader of stderr may also close. A closed reader of stdout, such as `head`, ends the program.
    """

    def write(self, data: Any, /) -> int:
        try:
            return super().write(data)
        except OSError as error:
            if error.errno != errno.EIO and not (error.errno == errno.EPIPE and self.fileno() == _STDERR):
                raise
            return memoryview(data).nbytes


def prepare_streams() -> None:
    """Let stdout and stderr accept any text, and survive the end of their terminal."""
    # Replace characters that the encoding lacks by letters
    codecs.register_error(_LETTERS, _in_letters)
    for output in (sys.stdout, sys.stderr):
        if isinstance(output, io.TextIOWrapper) and output.errors in ("strict", "backslashreplace"):
            output.reconfigure(errors=_LETTERS)
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
    """A console for stdout or stderr. Each call makes a new one, since either may have been redirected."""
    from rich.console import Console

    # No markup: what people name their folders, recordings and areas may look like it.
    made = Console(stderr=stderr, highlight=False, markup=False, soft_wrap=True)
    if not made.is_terminal:
        made.width = max(made.width, _WIDTH_OF_FILES)
    return made


def print_error(message: str, label: str = "error", style: str = "bold red") -> None:
    """Print "error: message" on stderr, on one line however narrow the terminal."""
    from rich.text import Text

    console(stderr=True).print(Text.assemble((f"{label}: ", style), message))


def print_warning(message: str) -> None:
    """Print "warning: message" on stderr, on one line however narrow the terminal."""
    print_error(message, "warning", "yellow")


def print_note(message: str) -> None:
    """Print a progress message on stderr, unless -q was given."""
    if not QUIET.on:
        console(stderr=True).print(message, markup=False)


def print_json(document: Any) -> None:
    """Print nested values as JSON on stdout; numbers that JSON lacks (NaN) become null."""
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


def rows_table(title: str, head: Sequence[str], rows: Iterable[Sequence[str]], style: str | None = "bold") -> Table:
    """A table with a line below its head; all columns but the first are numbers."""
    from rich.box import SIMPLE_HEAD
    from rich.table import Table

    table = Table(title=title, title_justify="left", title_style=style or "table.title", box=SIMPLE_HEAD)
    for index, name in enumerate(head):
        table.add_column(name, justify="right" if index and name else "left")
    for row in rows:
        table.add_row(*row)
    return table


def percent(share: float) -> str:
    """A share as a percentage, 100 % only for 1; "unknown" for NaN."""
    if not math.isfinite(share):
        return "unknown"
    return "100 %" if share == 1 else f"{min(100 * share, 99.9):.1f} %"


def _without_nan(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _without_nan(inner) for key, inner in value.items()}
    if isinstance(value, list | tuple):
        return [_without_nan(inner) for inner in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value


_LOGGER = logging.getLogger("wheelsight")
_FORMAT = "%(asctime)s %(levelname)s %(name)s: %(message)s"
_LEVELS = (logging.WARNING, logging.INFO, logging.DEBUG)
_KEY = "wheelsight.logs"


class _Stderr(logging.Handler):
    """Shows records on stderr, above a line of progress."""

    def emit(self, record: logging.LogRecord) -> None:
        try:
            console(stderr=True).print(self.format(record))
        except Exception:  # as the handlers of logging do
            self.handleError(record)


@dataclass
class _Logs:
    """The log options of a command line; they may stand before and after the command."""

    verbose: int = 0
    is_quiet: bool = False
    file: str | None = None
    handlers: tuple[logging.Handler, ...] = ()

    def apply(self) -> None:
        """Open the handlers. Raises OutputError for a file that cannot be written."""
        self.close()
        QUIET.on = self.is_quiet
        level = _LEVELS[min(self.verbose, len(_LEVELS) - 1)]
        handlers: list[logging.Handler] = []
        if self.verbose:
            shown = _Stderr(level)
            shown.setFormatter(logging.Formatter("%(levelname)s: %(message)s"))
            handlers.append(shown)
        if self.file is not None:
            try:
                kept: logging.Handler = logging.FileHandler(self.file, encoding="utf-8", errors="backslashreplace")
            except (OSError, ValueError) as error:
                why = getattr(error, "strerror", None) or str(error)
                raise OutputError(f"{self.file}: no log can be written: {why}", fix="--log FILE") from error
            kept.setFormatter(logging.Formatter(_FORMAT))
            kept.setLevel(min(level, logging.INFO))
            handlers.append(kept)
        for handler in handlers:
            _LOGGER.addHandler(handler)
        if handlers:
            _LOGGER.setLevel(min(handler.level for handler in handlers))
        self.handlers = tuple(handlers)
        if self.file is not None:
            _LOGGER.info("wheelsight %s", " ".join(sys.argv[1:]))

    def close(self) -> None:
        """Remove the handlers and reset the level."""
        for handler in self.handlers:
            _LOGGER.removeHandler(handler)
            handler.close()
        _LOGGER.setLevel(logging.NOTSET)
        QUIET.on, self.handlers = False, ()


def _take(ctx: typer.Context, param: typer.CallbackParam, value: Any) -> None:
    root: Any = ctx.find_root()
    logs = root.meta.get(_KEY)
    if logs is None:
        logs = root.meta[_KEY] = _Logs()
        root.call_on_close(logs.close)
    if not value or ctx.resilient_parsing:
        return
    if param.name == "verbose":
        logs.verbose += value
    elif param.name == "quiet":
        logs.is_quiet = True
    else:
        logs.file = value
    logs.apply()


def _options(
    verbose: Annotated[
        int,
        typer.Option(
            "-v",
            "--verbose",
            count=True,
            show_default=False,
            callback=_take,
            help="Show the log: -v events, -vv details.",
        ),
    ] = 0,
    quiet: Annotated[
        bool,
        typer.Option(
            "-q", "--quiet", callback=_take, help="Neither progress nor notes; warnings, errors and results stay."
        ),
    ] = False,
    log_file: Annotated[
        str | None, typer.Option("--log", metavar="FILE", callback=_take, help="Append the log to a file, with times.")
    ] = None,
) -> None:
    """Options without a command."""


@cache
def log_options(panel: str | None) -> tuple[Any, ...]:
    """The log options as parameters of a command, in its panel of the help."""
    holder = typer.Typer(add_completion=False)
    holder.command()(_options)
    made = [param for param in typer.main.get_command(holder).params if param.name != "help"]
    for param in made:
        param.expose_value, param.rich_help_panel = False, panel  # type: ignore[attr-defined]
        param.metavar = "FILE" if param.name == "log_file" else ""
    return tuple(made)


_EXAMPLES, _LAST = "[bold]Examples[/bold]", "Help"


class _Readable:
    """Help and log options of commands and groups."""

    help: str | None

    def __init__(self, *given: Any, **named: Any) -> None:
        super().__init__(*given, **named)
        self.help = None if self.help is None else laid_out(self.help)

    def get_params(self, ctx: Any) -> list[Any]:
        """Add the log options. Flags show no metavar; --help gets a panel if all other options have one."""
        params: list[Any] = super().get_params(ctx)  # type: ignore[misc]
        for param in params:
            if getattr(param, "is_flag", False):
                param.metavar = ""
        *others, last = params
        options = [param for param in others if isinstance(param, typer.core.TyperOption)]
        if options and all(param.rich_help_panel for param in options):
            last.rich_help_panel = _LAST
        return [*others, *log_options(last.rich_help_panel), last]


class CliCommand(_Readable, typer.core.TyperCommand):
    """A command."""


class Group(_Readable, typer.core.TyperGroup):
    """A group of commands."""


def laid_out(text: str) -> str:
    """The help text with one line a paragraph, which the terminal wraps, and a prompt before each example."""
    body, heading, examples = inspect.cleandoc(text).partition(_EXAMPLES)
    paragraphs = [" ".join(paragraph.split()) for paragraph in body.split("\n\n") if paragraph.strip()]
    if heading:
        commands = [f"$ {line.strip()}" for line in examples.splitlines() if line.strip()]
        paragraphs.append("\n".join([heading, *commands]))
    return "\n\n".join(paragraphs)


Options = TypeVar("Options")


def takes(kind: type[Options]) -> Callable[[Callable[[Options], None]], Callable[..., None]]:
    """Turn a function of one dataclass into a command. Its options are the fields, with annotations and defaults."""
    # Of each class by the names of its own module: bases may come from others.
    hints, named = get_type_hints(kind, include_extras=True), inspect.signature(kind).parameters
    for one in fields(kind):  # type: ignore[arg-type]
        if "option" in one.metadata:
            flag = "--" + one.name.strip("_").replace("_", "-")
            hints[one.name] = Annotated[hints[one.name], one.metadata["option"](flag)]
    signature = inspect.Signature([one.replace(annotation=hints[name]) for name, one in named.items()])

    def command_of(work: Callable[[Options], None]) -> Callable[..., None]:
        def command(**given: Any) -> None:
            work(kind(**given))

        command.__name__, command.__doc__, command.__module__ = work.__name__, work.__doc__, work.__module__
        command.__annotations__ = {}
        command.__signature__ = signature  # type: ignore[attr-defined]
        return command

    return command_of


_LOOK_S, _ENDS_S = 0.1, 2.0
# Different lines of refusals at once, and one more each 10 s: less than 1 MB a day. Up to 10 minutes apart.
_NEW_LINES, _NEW_LINE_S, _LONGEST_S = 8.0, 10.0, 600.0
_TIMES = re.compile(r" \((\d+) times\)$")


class CountedLines:
    """Shows lines from its own thread, so that a blocked terminal blocks no other thread; counts repeats.

    A line that comes again and again is shown with its count after 1 s, 2 s, 4 s and so on, up to 10 minutes. Of lines
    that differ, which a stranger can make up, few are shown, and the others counted.

    Args:
        show: called with a line, in that thread.
    """

    def __init__(self, show: Callable[[str], None]) -> None:
        self._show = show
        self._lines: dict[str, _Line] = {}
        self._left, self._filled_s = _NEW_LINES, time.monotonic()
        self._changed, self._is_over = threading.Condition(), False
        self._thread = threading.Thread(target=self._run, name="wheelsight-lines", daemon=True)
        self._thread.start()

    def add(self, line: str, *, is_problem: bool = False) -> None:
        """Add a line. Problems of the robot are always shown."""
        found = _TIMES.search(line)
        text, times = (line[: found.start()], int(found[1])) if found else (line, 1)
        now_s = time.monotonic()
        with self._changed:
            if text not in self._lines and not is_problem:
                self._left = min(self._left + (now_s - self._filled_s) / _NEW_LINE_S, _NEW_LINES)
                self._filled_s = now_s
                if self._left < 1:
                    text = "refused others"
                else:
                    self._left -= 1
            kept = self._lines.setdefault(text, _Line(due_s=now_s))
            kept.times += times
            self._changed.notify()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        """Print the remaining lines, and end."""
        with self._changed:
            self._is_over = True
            self._changed.notify()
        self._thread.join(_ENDS_S)

    def _run(self) -> None:
        while True:
            with self._changed:
                is_over = self._is_over
                # Lines to print with their counts; lines that have not come for long are removed
                now_s = math.inf if is_over else time.monotonic()
                printed = []
                for known_text, said in list(self._lines.items()):
                    if said.times and said.due_s <= now_s:
                        printed.append((known_text, said.times))
                        said.times, said.due_s = 0, now_s + said.wait_s
                        said.wait_s = min(2 * said.wait_s, _LONGEST_S)
                    elif not said.times and said.due_s + said.wait_s < now_s:
                        del self._lines[known_text]
                if not printed and not is_over:
                    waits = any(line.times for line in self._lines.values())
                    self._changed.wait(_LOOK_S if waits else None)
                    continue
            for text, times in printed:
                with suppress(OSError):
                    self._show(text if times == 1 else f"{text} ({times} times)")
            if is_over:
                return


@dataclass
class _Line:
    """Number of repeats of a line since it was printed, and the time of its next print."""

    due_s: float
    wait_s: float = 1.0
    times: int = 0
