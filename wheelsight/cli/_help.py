"""How help is laid out: paragraphs as wide as the terminal, examples a line each, flags without a value."""

from __future__ import annotations

import inspect
from typing import Any

import typer.core

from wheelsight.cli._logs import log_options

_EXAMPLES, _LAST = "[bold]Examples[/bold]", "Help"


class _Readable:
    """What commands and groups of commands have in common."""

    help: str | None

    def __init__(self, *given: Any, **named: Any) -> None:
        super().__init__(*given, **named)
        self.help = None if self.help is None else laid_out(self.help)

    def get_params(self, ctx: Any) -> list[Any]:
        """As ever; a flag is not shown as if it took a value, and where all others have panels, so has --help."""
        params: list[Any] = super().get_params(ctx)  # type: ignore[misc]
        for param in params:
            if getattr(param, "is_flag", False):
                param.metavar = ""
        *others, last = params
        options = [param for param in others if isinstance(param, typer.core.TyperOption)]
        if options and all(param.rich_help_panel for param in options):
            last.rich_help_panel = _LAST
        return [*others, *log_options(last.rich_help_panel), last]


class Command(_Readable, typer.core.TyperCommand):
    """A command."""


class Group(_Readable, typer.core.TyperGroup):
    """A group of commands."""


def laid_out(text: str) -> str:
    """The lines of each paragraph as one, which the terminal wraps; examples, which come last, after a prompt each."""
    told, heading, examples = inspect.cleandoc(text).partition(_EXAMPLES)
    paragraphs = [" ".join(paragraph.split()) for paragraph in told.split("\n\n") if paragraph.strip()]
    if heading:
        commands = [f"$ {line.strip()}" for line in examples.splitlines() if line.strip()]
        paragraphs.append("\n".join([heading, *commands]))
    return "\n\n".join(paragraphs)
