"""Commands of many options: these are the fields of a class, and the command is handed one value."""

from __future__ import annotations

import inspect
from collections.abc import Callable
from typing import Any, TypeVar, get_type_hints

Options = TypeVar("Options")


def takes(kind: type[Options]) -> Callable[[Callable[[Options], None]], Callable[..., None]]:
    """Make a function of one dataclass a command whose options are the fields, with their annotations and defaults."""
    # Of each class by the names of its own module: bases may come from others.
    hints, named = get_type_hints(kind, include_extras=True), inspect.signature(kind).parameters
    signature = inspect.Signature([one.replace(annotation=hints[name]) for name, one in named.items()])

    def command_of(work: Callable[[Options], None]) -> Callable[..., None]:
        def command(**given: Any) -> None:
            work(kind(**given))

        command.__name__, command.__doc__, command.__module__ = work.__name__, work.__doc__, work.__module__
        command.__annotations__ = {}
        command.__signature__ = signature  # type: ignore[attr-defined]
        return command

    return command_of
