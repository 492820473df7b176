"""-v, -q and --log, which every command has: what of the library's log is shown, and where it is kept."""

from __future__ import annotations

import logging
import sys
from dataclasses import dataclass
from functools import cache
from typing import Annotated, Any

import typer

from wheelsight.cli import _console
from wheelsight.errors import OutputError

_LOGGER = logging.getLogger("wheelsight")
_FORMAT = "%(asctime)s %(levelname)s %(name)s: %(message)s"
_LEVELS = (logging.WARNING, logging.INFO, logging.DEBUG)
_KEY = "wheelsight.logs"


class _Stderr(logging.Handler):
    """Shows records on stderr, above a line of progress."""

    def emit(self, record: logging.LogRecord) -> None:
        try:
            _console.console(stderr=True).print(self.format(record))
        except Exception:  # as the handlers of logging do
            self.handleError(record)


@dataclass
class _Logs:
    """What the options of one command line ask for; they may stand before the command and after it."""

    verbose: int = 0
    is_quiet: bool = False
    file: str | None = None
    handlers: tuple[logging.Handler, ...] = ()

    def apply(self) -> None:
        """Raises OutputError for a file that cannot be written."""
        self.close()
        _console.QUIET.on = self.is_quiet
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
        """As if there had been no options."""
        for handler in self.handlers:
            _LOGGER.removeHandler(handler)
            handler.close()
        _LOGGER.setLevel(logging.NOTSET)
        _console.QUIET.on, self.handlers = False, ()


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
        str | None,
        typer.Option("--log", metavar="FILE", callback=_take, help="Append the log to a file, with times."),
    ] = None,
) -> None:
    """Options without a command."""


@cache
def log_options(panel: str | None) -> tuple[Any, ...]:
    """The options, as parameters of a command; in its panel of the help."""
    holder = typer.Typer(add_completion=False)
    holder.command()(_options)
    made = [param for param in typer.main.get_command(holder).params if param.name != "help"]
    for param in made:
        param.expose_value, param.rich_help_panel = False, panel  # type: ignore[attr-defined]
        param.metavar = "FILE" if param.name == "log_file" else ""
    return tuple(made)
